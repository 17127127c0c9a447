# SPDX-License-Identifier: Apache-2.0
"""What there is to see of a session: errors, regimes, signals at any zoom, what was found.

It reads what tasks have written into the session's folder and computes nothing of its own but
errors over the parts that somebody looks at.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import Rig
from pneu_sysid.results.compare import CompareResult, regime_order
from pneu_sysid.results.diagnose import Candidate, DiagnoseResult
from pneu_sysid.tasks.expect import EXPECTED
from pneu_sysid.tasks.regime_masks import Key, RegimeMasks
from pneu_sysid.tasks.signals import SIGNALS, Signals, Trace
from pneu_workbench.store import Store, as_steps
from pneu_workbench.traces import Floats, Pyramid
from pneu_workbench.versions import Version, Versions

Mask = NDArray[np.bool_]
Kind = Literal[
    "measured", "model", "residual", "beside", "residual_beside", "trial", "candidate", "command"
]
KINDS = ("measured", "model", "residual", "command")
"""Those that each version has of its own."""


@dataclass(frozen=True)
class Part:
    """A part of the recordings that is looked at.

    Attributes:
        begin_s: Where it begins, s; None is where they do.
        end_s: Where it ends.
        regime: The readings of one regime alone; None is all.
    """

    begin_s: float | None = None
    end_s: float | None = None
    regime: Key | None = None


@dataclass(frozen=True)
class MapRow:
    """A regime in the map.

    Attributes:
        key: The regime.
        words: It, in words.
        times_noise: Error of each sensor over its noise, in that regime.
        chosen: Whether the readings that belong to it can be shown alone.
    """

    key: Key
    words: str
    times_noise: dict[str, float]
    chosen: bool


@dataclass
class Seen:
    """What is looked at, besides the versions.

    Attributes:
        beside: Number of the version that is drawn beside; None is the one before.
        early: Folder with what was measured, before anything is known of the model; or empty.
        tried: Folder with the signals of a strength that is tried; or empty.
        diagnosis: What was found missing, in which version and folder.
    """

    beside: int | None = None
    early: str = ""
    tried: str = ""
    diagnosis: dict[str, Any] | None = None


class View:
    """A session as it is seen."""

    def __init__(self, folder: Path, store: Store, versions: Callable[[], Versions], seen: Seen):
        """Looks at a session.

        Args:
            folder: Where it is kept.
            store: Its signals.
            versions: Tells its versions.
            seen: What is looked at.
        """
        self._folder, self._store, self._versions, self._seen = folder, store, versions, seen

    # ---- versions ---------------------------------------------------------------------------

    @property
    def beside(self) -> Version | None:
        """The version that is drawn beside the present one; None without one."""
        versions, asked = self._versions(), self._seen.beside
        chosen = versions.before
        if asked is not None and asked < len(versions.all) and asked != versions.at:
            chosen = versions.all[asked]
        there = chosen is not None and (self._folder / chosen.folder / SIGNALS).exists()
        return chosen if there else None

    def comparison(self) -> CompareResult | None:
        """What the present version leaves; None without one."""
        told = self._told("compare.json")
        return None if told is None else CompareResult(**told)

    def visited(self) -> dict[str, Any] | None:
        """Where the recordings have been, and what is kept aside of them; None without any."""
        return self._told("visited.json")

    def expected(self, task: str) -> tuple[float, float] | None:
        """How long a task is expected to take on the present version, s, at least and at most.

        Args:
            task: ``suspect`` or ``add``; of others nothing is expected.
        """
        try:
            told = (self._told(EXPECTED) or {}).get(task)
        except FileNotFoundError:  # of a session that an earlier version made
            return None
        return None if told is None else (float(told[0]), float(told[1]))

    def rig(self) -> Rig | None:
        """The present version's rig; None without one, or where its file is gone."""
        now = self._versions().now
        try:
            return None if now is None else load_rig(now.rig)
        except InputError:
            return None

    @property
    def asked(self) -> str:
        """Folder of what the present version was found to be missing; empty without any."""
        told, now = self._seen.diagnosis, self._versions().now
        return "" if told is None or now is None or told["of"] != now.number else told["folder"]

    @property
    def found(self) -> DiagnoseResult | None:
        """What the present version is missing; None as long as nobody asked."""
        told = self._seen.diagnosis
        return DiagnoseResult(**told["result"]) if told is not None and self.asked else None

    def candidates(self) -> list[Candidate]:
        """Candidates that were tried, best first, of the diagnosis of the present version."""
        found = self.found
        return [] if found is None else [one for one in found.candidates if one.tested]

    def _told(self, name: str) -> dict[str, Any] | None:
        now = self._versions().now
        if now is None:
            return None
        return dict(json.loads((self._folder / now.folder / name).read_text(encoding="utf-8")))

    # ---- signals ----------------------------------------------------------------------------

    def sensors(self) -> list[tuple[str, str, float]]:
        """Sensors with their units and noise floors, SI."""
        signals = self._signals()
        if signals is None:
            return []
        about = signals.about
        return [(name, about.units[name], about.noise[name]) for name in signals.sensors]

    def commands(self) -> list[str]:
        """Names of commands."""
        signals = self._signals()
        return [] if signals is None else list(signals.commands)

    def span_s(self) -> tuple[float, float]:
        """First and last time of all readings, s."""
        signals = self._signals()
        times = [] if signals is None else [t.time_s for t in signals.sensors.values()]
        times = [time for time in times if time.size]
        if not times:
            return 0.0, 0.0
        return min(float(t[0]) for t in times), max(float(t[-1]) for t in times)

    def marks(self) -> list[tuple[float, float, str, str]]:
        """What was found while the recordings were read: begin and end, s, channel, and what."""
        signals = self._signals()
        return [] if signals is None else signals.about.marks

    def kept_aside(self) -> list[tuple[float, float]]:
        """Stretches that are kept aside for judging, neighbours as one, s."""
        signals = self._signals()
        out: list[tuple[float, float]] = []
        for begin, end, held in [] if signals is None else signals.about.segments:
            if held and out and begin - out[-1][1] < 1e-6:
                out[-1] = out[-1][0], end
            elif held:
                out.append((begin, end))
        return out

    def state(self) -> str:
        """Another word whenever signals are others."""
        now, beside = self._versions().now, self.beside
        return f"{self._own()} {now.number if now else ''} {beside.folder if beside else ''}"

    def pyramid(
        self, kind: Kind, name: str, candidate: int | None = None, regime: Key | None = None
    ) -> Pyramid:
        """A signal, to be shown at any zoom.

        Args:
            kind: Which of a sensor's signals, or a command.
            name: Of the sensor or the command.
            candidate: Whose predicted residual is meant.
            regime: Only readings of it; the others are gaps.

        Raises:
            KeyError: There is no such signal.
        """
        folder, key = self._folder_of(kind), f"candidate_{candidate}"
        if folder is None:
            raise KeyError(name)

        def values(signals: Signals) -> tuple[Floats, Floats]:
            if kind == "command":
                return as_steps(signals, name)
            trace = signals.sensors[name]
            told = _told_by(kind, trace, signals.about.noise[name], key)
            if regime is None:
                return trace.time_s, told
            return trace.time_s, np.where(
                self._within(name, trace, Part(regime=regime)), told, np.nan
            )

        own = key if kind == "candidate" else kind if kind in KINDS else "model"
        if kind == "residual_beside":
            own = "residual"
        if regime is not None and kind != "command":
            own += f" in {' '.join(regime)} of {self._own()}"
        return self._store.pyramid(folder, own, name, values)

    def _own(self) -> str:
        """Folder of what is present; empty without any."""
        now = self._versions().now
        return self._seen.early if now is None else now.folder

    def _signals(self) -> Signals | None:
        own = self._own()
        try:
            return self._store.signals(own) if own else None
        except InputError:  # what was early is gone, or a model is yet to be run again
            return None

    def _folder_of(self, kind: Kind) -> str | None:
        """Name of the folder that holds a kind of signal; None where there is none."""
        if kind == "trial":
            return self._seen.tried or None
        if kind == "candidate":
            return self.asked or None
        if kind in ("beside", "residual_beside"):
            beside = self.beside
            return None if beside is None else beside.folder
        return self._own() or None

    # ---- where it fails ---------------------------------------------------------------------

    def errors(self, part: Part, beside: bool = False) -> dict[str, float]:
        """Error of each sensor over its noise in a part; without those that say nothing there.

        Args:
            part: The part.
            beside: Of the version beside.
        """
        signals = self._signals()
        if beside:
            other = self.beside
            signals = None if other is None else self._store.signals(other.folder)
        if signals is None:
            return {}
        out = {}
        for name, trace in signals.sensors.items():
            value = _rms(trace, self._within(name, trace, part), signals.about.noise[name])
            if value is not None:
                out[name] = value
        return out

    def touches(self, sensor: str, part: Part) -> bool:
        """Whether a sensor has readings in a part.

        Args:
            sensor: Its name.
            part: The part.
        """
        signals = self._signals()
        if signals is None or sensor not in signals.sensors:
            return False
        return bool(self._within(sensor, signals.sensors[sensor], part).any())

    def map(self, part: Part) -> list[MapRow]:
        """Errors by regime, in order, within a part; what is of frequencies is of all time.

        Args:
            part: The part; its own regime does not matter.
        """
        left, signals = self.comparison(), self._signals()
        if left is None or signals is None:
            return []
        told: dict[Key, dict[str, float]] = {}
        order: dict[Key, Any] = {}
        for regime in left.models[0].all_regimes:
            if regime.kind == "time":
                continue
            key: Key = (regime.kind, regime.of, regime.label)
            order.setdefault(key, regime_order(regime.model_dump()))
            if regime.times_noise is not None:
                told.setdefault(key, {})[regime.sensor] = regime.times_noise
        if part.begin_s is not None or part.end_s is not None:
            for key in told:
                if key[0] != "frequency":
                    told[key] = self.errors(replace(part, regime=key))
        return [
            MapRow(key, words_of(key), told.get(key, {}), key[0] != "frequency")
            for key in sorted(order, key=lambda k: order[k])
        ]

    def _within(self, sensor: str, trace: Trace, part: Part) -> Mask:
        """(n,) which readings of a sensor lie in a part."""
        mask = np.ones(trace.time_s.size, dtype=bool)
        if part.begin_s is not None:
            mask &= trace.time_s >= part.begin_s
        if part.end_s is not None:
            mask &= trace.time_s <= part.end_s
        if part.regime is not None:
            of_regime = self._mask(sensor, part.regime)
            known = of_regime is not None and of_regime.size == mask.size
            mask &= of_regime if known else False
        return mask

    def _mask(self, sensor: str, regime: Key) -> Mask | None:
        masks = self._regimes()
        return None if masks is None else masks.of(sensor, regime)

    def _regimes(self) -> RegimeMasks | None:
        now = self._versions().now
        return None if now is None else self._store.regimes(now.folder)


def _told_by(kind: Kind, trace: Trace, noise: float, candidate: str) -> Floats:
    """What a kind of signal says at a sensor's own times."""
    if kind == "measured":
        return trace.measured
    if kind in ("residual", "residual_beside"):
        return (trace.measured - trace.model) / noise
    if kind == "candidate":
        return trace.changes[candidate] / noise
    return trace.model


def _rms(trace: Trace, mask: Mask, noise: float) -> float | None:
    """Root mean square of an error over noise; None of nothing."""
    error = (trace.measured[mask] - trace.model[mask]) / noise
    error = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(error * error))) if error.size else None


def words_of(key: Key) -> str:
    """A regime in words.

    Args:
        key: It.
    """
    kind, of, label = key
    words = [] if kind in label.split() else [kind.replace("_", " ")]
    return ", ".join([*words, *([of] if of and of not in label else []), label])
