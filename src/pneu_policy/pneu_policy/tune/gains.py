# SPDX-License-Identifier: Apache-2.0
"""Tuning of PID and feed-forward PID: a stated search, on stated targets, with a seed.

Candidates are run on simulated rigs drawn from the calibration's uncertainty, with sensor noise and
late commands, as policies are trained; all candidates meet the same rigs, targets, noise and
delays. What is least is the RMSE of target minus pressure over all of them; see
`pneu_policy.tune.search`. The same settings give the same gains.
"""

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_policy.control.controllers import FeedForwardPid, PidController
from pneu_policy.control.feed_forward import HALF_WINDOW_S, FeedForward
from pneu_policy.control.pid import Gains
from pneu_policy.task.ensembles import draw_rigs
from pneu_policy.task.plants import ControlPlant
from pneu_policy.task.targets import Target
from pneu_policy.tune.search import Knob, seek
from pneu_policy.tune.settings import TuneSettings
from pneu_sim.models import kind_of
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]

TARGETS_WITHIN_S = 60.0
"""Targets are taken from a random place within this time of their start."""

PREVIEW_S = 0.2
"""No term looks further ahead than this, which is what policies see (thesis 9.1.1)."""


PID_KNOBS = (
    Knob("kp_v_per_pa", 1e-6, 1e-4, 1e-5),
    Knob("ki_v_per_pa_s", 1e-6, 1e-2, 1e-4),
    Knob("kd_v_s_per_pa", 1e-9, 1e-6, 3e-8),
    Knob("derivative_hz", 5.0, 100.0, 40.0),
    Knob("integral_v", 0.2, 5.0, 1.0),
)
FORWARD_KNOBS = (
    *PID_KNOBS,
    Knob("gain", 0.2, 3.0, 1.0),
    Knob("lead_s", HALF_WINDOW_S, PREVIEW_S - HALF_WINDOW_S, 0.03, log=False),
    Knob("target_lead_s", 0.0, 0.1, 0.01, log=False),
)


@dataclass(frozen=True)
class Tuned:
    """What a tuning found.

    Attributes:
        controller: The best candidate.
        rmse_pa: Its RMSE over all runs, Pa.
        of_kind_pa: Its RMSE per kind of target, Pa.
        history_pa: Least RMSE after each generation, Pa.
        evaluations: Candidates that were run.
        settings: What was tuned, and on what.
        rig_sha256: Digest of the rig file.
    """

    controller: PidController | FeedForwardPid
    rmse_pa: float
    of_kind_pa: dict[str, float]
    history_pa: list[float]
    evaluations: int
    settings: TuneSettings
    rig_sha256: str

    def provenance(self) -> dict[str, Any]:
        """Returns how the gains were found, as plain data for a file."""
        return {
            "search": "differential evolution, best/1/bin",
            "rmse_pa": self.rmse_pa,
            "rmse_of_kind_pa": dict(self.of_kind_pa),
            "evaluations": self.evaluations,
            "rig_sha256": self.rig_sha256,
            "settings": self.settings.plain(),
        }


class Trials:
    """The runs that all candidates must do."""

    def __init__(self, settings: TuneSettings, rig: Rig) -> None:
        """Draws rigs, targets, delays and noise.

        Args:
            settings: What is tuned, and on what.
            rig: The rig.

        Raises:
            InputError: The rig has no such tap, or cannot be controlled so.
        """
        s = settings
        if s.tap not in rig.taps:
            raise InputError(f"tap: found {s.tap!r}, rig {rig.name!r} has {', '.join(rig.taps)}")
        rng = np.random.default_rng([s.seed, 1])
        n = s.trials
        self.settings = s
        self.kinds = [s.kinds[k % len(s.kinds)] for k in range(n)]
        seeds = rng.integers(2**31, size=n)
        self._targets = [
            Target(kind, s.low_pa, s.high_pa, s.target_period_s, int(seed), jitter=s.jitter)
            for kind, seed in zip(self.kinds, seeds, strict=True)
        ]
        self._begins = rng.uniform(0.0, TARGETS_WITHIN_S, n)
        self._delays = rng.uniform(*s.delay_s, n)
        self.steps = round(s.seconds / s.period_s)
        self._noise = s.noise_pa * rng.normal(size=(self.steps, n))
        rigs = draw_rigs(rig, n, s.seed, s.spread)
        dx_m = s.dx_m if kind_of(rig).along_lines else None
        self._plant = ControlPlant(rigs * s.candidates, s.period_s, dx_m)
        self._tap = self._plant.taps.index(s.tap)

    def run(self, candidates: Sequence[PidController | FeedForwardPid]) -> Floats:
        """Errors of some candidates.

        Args:
            candidates: As many as the settings say, or fewer.

        Returns:
            (candidates, trials) mean of the squared error, Pa^2.
        """
        s, n = self.settings, self.settings.trials
        lanes = s.candidates * n
        times = np.arange(self.steps + 1) * s.period_s
        wanted = np.empty((self.steps + 1, lanes))
        ahead: list[list[list[float]]] = []
        controllers = []
        for lane in range(lanes):
            # Lanes without a candidate repeat the first.
            one = candidates[lane // n if lane // n < len(candidates) else 0]
            target, begin = self._targets[lane % n], self._begins[lane % n]
            told = target.at(begin + times[:, None] + np.array(one.preview_s))
            wanted[:, lane] = told[:, 0]
            ahead.append(told.tolist())
            controllers.append(_fresh(one))
        self._plant.set_delay(np.tile(self._delays, s.candidates))
        seen = self._plant.reset(wanted[0])[:, self._tap]
        volts = np.empty(lanes)
        square = np.zeros(lanes)
        taps_pa = {s.tap: 0.0}
        for k in range(self.steps):
            noisy = (seen + np.tile(self._noise[k], s.candidates)).tolist()
            for lane, controller in enumerate(controllers):
                taps_pa[s.tap] = noisy[lane]
                volts[lane] = controller.step(taps_pa, ahead[lane][k])
            seen = self._plant.step(volts)[:, self._tap]
            square += (wanted[k + 1] - seen) ** 2
        return (square / self.steps).reshape(s.candidates, n)[: len(candidates)]


def _fresh(one: PidController | FeedForwardPid) -> PidController | FeedForwardPid:
    """The same controller with a memory of its own."""
    if isinstance(one, FeedForwardPid):
        return FeedForwardPid(one.gains, one.ahead, one.target_lead_s, one.tap, one.period_s)
    return PidController(one.gains, one.tap, one.period_s)


def make_candidate(
    settings: TuneSettings, plain: FeedForwardPid | PidController, shares: Floats
) -> PidController | FeedForwardPid:
    """A controller from a point of the search.

    Args:
        settings: What is tuned.
        plain: A controller for the rig; what is tuned in it is replaced.
        shares: Per knob its share of the range, 0 to 1.
    """
    knobs = FORWARD_KNOBS if settings.kind == "feed_forward" else PID_KNOBS
    # Seven digits are more than a tuning finds, and read well in a file.
    set_to = {k.name: float(f"{k.value(float(x)):.7g}") for k, x in zip(knobs, shares, strict=True)}
    gains = replace(plain.gains, **{knob.name: set_to[knob.name] for knob in PID_KNOBS})
    if not isinstance(plain, FeedForwardPid):
        return PidController(gains, plain.tap, plain.period_s)
    ahead = replace(plain.ahead, gain=set_to["gain"], lead_s=set_to["lead_s"])
    return FeedForwardPid(gains, ahead, set_to["target_lead_s"], plain.tap, plain.period_s)


def _plain(settings: TuneSettings, rig: Rig) -> PidController | FeedForwardPid:
    """A controller for a rig, not yet tuned."""
    (valve,) = rig.valves.values()
    gains = Gains(1e-5, null_v=valve.spool.null_v)
    if settings.kind == "pid":
        return PidController(gains, settings.tap, settings.period_s)
    ahead = FeedForward.of_rig(rig, settings.tap)
    return FeedForwardPid(gains, ahead, 0.0, settings.tap, settings.period_s)


def tune(settings: TuneSettings, progress: Callable[[int, float], None] | None = None) -> Tuned:
    """Seeks the gains with the least RMSE.

    Args:
        settings: What is tuned, and on what.
        progress: Called after each generation with its number and the least RMSE so far, Pa.

    Returns:
        What was found.

    Raises:
        InputError: The rig file or a setting is wrong.
    """
    s = settings
    rig = load_rig(s.rig)
    if len(rig.valves) != 1:
        raise InputError(f"{s.rig}: found {len(rig.valves)} valves, a PID commands one")
    trials = Trials(s, rig)
    knobs = FORWARD_KNOBS if s.kind == "feed_forward" else PID_KNOBS
    rng = np.random.default_rng([s.seed, 2])
    plain = _plain(s, rig)
    history: list[float] = []
    least, best, square = math.inf, np.empty(0), np.empty(0)

    def of_generation(points: Floats) -> Floats:
        """(candidates,) mean squares of a (knobs, candidates) generation."""
        nonlocal least, best, square
        errors = trials.run([make_candidate(s, plain, point) for point in points.T])
        values = errors.mean(axis=1)
        k = int(np.argmin(values))
        if values[k] < least:
            least, best, square = float(values[k]), points[:, k].copy(), errors[k]
        history.append(math.sqrt(least))
        if progress is not None:
            progress(len(history), history[-1])
        return np.asarray(values)

    seek(of_generation, knobs, s.candidates, s.generations, rng)
    of_kind = {
        str(kind): float(np.sqrt(np.mean(square[[k == kind for k in trials.kinds]])))
        for kind in dict.fromkeys(trials.kinds)
    }
    return Tuned(
        controller=make_candidate(s, plain, best),
        rmse_pa=history[-1],
        of_kind_pa=of_kind,
        history_pa=history,
        evaluations=s.candidates * len(history),
        settings=s,
        rig_sha256=hashlib.sha256(Path(s.rig).read_bytes()).hexdigest(),
    )
