# SPDX-License-Identifier: Apache-2.0
"""Every effect of the catalogue hidden in recordings of calibrated rigs, and what is learned.

Rigs of different shape, three of lines and a joint, are drawn at random and calibrated from their
datasheets. Each effect is injected once on each, and healthy recordings are looked at beside them;
with ``--without`` each effect is taken out of the catalogue, on one of the rigs in turn, before its
own recording is looked at. What was found is kept by a digest of code and settings: an interrupted
run goes on, and the page shows one version only.
"""

import argparse
import json
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from pneu_common.files import write_whole
from pneu_sim.effects import registry
from pneu_sim.effects.base import POSITION
from pneu_sim.rig.schema import CLOSED, Rig
from pneu_sysid.learn import Learned, learn
from studies.calibration_rigs import draw_case
from studies.confusion_cases import (
    FELT,
    RIGS,
    SECONDS,
    Injection,
    calibrated,
    load_recording,
    recordings_of,
)
from studies.digest import digest_of, sources_digest

ROOT = Path(__file__).resolve().parent.parent
STORE = ROOT / "out" / "confusion"
KEPT = ROOT / "docs" / "found"
STRENGTH_WITHIN = 0.2
PLACE_WITHIN = 0.1
"""Of the length of its pipe, or 10 cm if that is more."""

CLASSES = (
    {"sensor_bias", "sensor_gain"},
    {"clock_offset", "common_clock_offset", "sensor_lag", "valve_delay", "closing_delay"}
    | {"spool_bandwidth", "spool_speed_limit", "spool_acceleration_limit"},
    {"dead_band", "hysteresis", "null_offset", "spool_leakage"},
    {"flow_gain", "critical_ratio", "fill_exhaust_asymmetry", "local_loss", "area_error"},
    {"blockage", "local_loss", "junction_loss", "area_error", "roughness"}
    | {"laminar_friction", "turbulent_friction", "unsteady_friction"},
    {"leak", "porous_leak", "relief_valve", "spool_leakage"}
    | {"chamber_leak", "chamber_porous_leak", "chamber_relief_valve"}
    | {"piston_leak", "rod_leak"},
    {"dead_volume", "wall_compliance", "chamber_volume", "chamber_compliance"}
    | {"length_error", "area_error", "cylinder_volume"},
    {"wall_heat", "chamber_heat", "chamber_convection", "cylinder_heat"}
    | {"ambient_temperature", "supply_temperature"},
    {"regulator_droop", "supply_level", "supply_ripple", "supply_temperature"},
    {"ambient_pressure", "ambient_temperature"},
    {"piston_friction", "joint_friction", "seal_friction", "piston_stiction"},
    {"piston_damping", "joint_damping"},
    {"payload", "centre_of_mass", "external_spring"},
    {"encoder_lag", "clock_offset"},
    {"encoder_bias", "encoder_gain", "crank_error"},
)
"""Effects of one kind: where one is taken out of the catalogue, another may be named for it."""


@dataclass
class Found:
    """What was learned from one recording.

    Attributes:
        injection: What is hidden in it.
        verdict: The verdict.
        steps: Effect, place, position, strength and its standard error of all that was added.
        alike: What it was not told apart from.
        before: Times the noise on what was kept aside, before.
        after: The same after.
        seconds: How long it took, s.
        length_m: Length of the pipe that it is on, m; 0 where that has no meaning.
        off_m: Way along the pipes from where it is to where it was found, m; None where it has no
            position, or no way leads there.
    """

    injection: Injection
    verdict: str
    steps: list[dict[str, Any]]
    alike: list[str]
    before: float
    after: float
    seconds: float
    length_m: float = 0.0
    off_m: float | None = None

    @property
    def healthy(self) -> bool:
        """Whether nothing is hidden in it."""
        return not self.injection.effect

    @property
    def felt(self) -> bool:
        """Whether what is hidden changes the readings enough to be found."""
        return self.injection.felt >= FELT

    @property
    def named(self) -> bool:
        """Whether the hidden effect comes first."""
        return bool(self.steps) and self.steps[0]["effect"] == self.injection.effect

    @property
    def tied(self) -> bool:
        """Whether it comes first, or is said not to be told from what does."""
        return self.named or (
            bool(self.steps) and any(a.split("@")[0] == self.injection.effect for a in self.alike)
        )

    @property
    def at(self) -> dict[str, Any] | None:
        """The step that names the hidden effect."""
        return next((s for s in self.steps if s["effect"] == self.injection.effect), None)

    @property
    def placed(self) -> bool:
        """Whether the hidden effect was found where it is."""
        step = self.at
        if step is None:
            return False
        if POSITION not in self.injection.values or step["position_m"] is None:
            return bool(step["place"] == self.injection.place)
        return self.off_m is not None and self.off_m <= max(0.1, PLACE_WITHIN * self.length_m)

    @property
    def within(self) -> bool:
        """Whether it was found where it is, or within twice the error that is told of that."""
        told_m = (self.at or {}).get("position_error_m") or 0.0
        return self.placed or (self.off_m is not None and self.off_m <= 2.0 * told_m)

    @property
    def strength_error(self) -> float | None:
        """Relative error of its strength."""
        step = self.at
        return None if step is None else step["strength"] / self.injection.strength - 1.0

    @property
    def superfluous(self) -> int:
        """Effects that were added besides."""
        return sum(s["effect"] != self.injection.effect for s in self.steps)


def found_of(injection: Injection, rig: Rig, learned: Learned, seconds: float) -> Found:
    """What was learned, in short.

    Args:
        injection: What is hidden.
        rig: The calibrated rig.
        learned: What was learned.
        seconds: How long it took, s.
    """
    steps = []
    for step, effect in zip(learned.steps[1:], learned.rig.effects, strict=True):
        steps.append(
            {
                "effect": step.added,
                "place": effect.place,
                "position_m": effect.parameters.get(POSITION),
                "position_error_m": step.position_error_m,
                "strength": step.strength,
                "std_error": step.std_error,
            }
        )
    pipe = rig.pipes.get(injection.place)
    at = next((s for s in steps if s["effect"] == injection.effect), None)
    off = None
    if at is not None and at["position_m"] is not None and POSITION in injection.values:
        hidden = injection.place, injection.values[POSITION]
        off = way_m(rig, hidden, (str(at["place"]), float(at["position_m"])))
    return Found(
        injection,
        learned.verdict,
        steps,
        learned.alike,
        learned.steps[0].held_out_times_noise or 0.0,
        learned.steps[-1].held_out_times_noise or 0.0,
        seconds,
        pipe.length_m if pipe is not None else 0.0,
        off,
    )


def way_m(rig: Rig, a: tuple[str, float], b: tuple[str, float]) -> float | None:
    """The way between two places along the pipes of a rig, m; None where there is none.

    What sits just before a joint sits just behind it too, on another pipe.

    Args:
        rig: The rig.
        a: Pipe and position along it, m.
        b: The same of the other.
    """
    if a[0] == b[0]:
        return abs(a[1] - b[1])
    ends = {CLOSED, *rig.reservoirs, *rig.chambers}
    ways = dict(zip(_nodes(rig, a[0]), (a[1], rig.pipes[a[0]].length_m - a[1]), strict=True))
    for _ in rig.pipes:  # no way goes through more pipes than there are
        for name, pipe in rig.pipes.items():
            for here, there in (_nodes(rig, name), _nodes(rig, name)[::-1]):
                if here in ways and here not in ends:
                    far = ways[here] + pipe.length_m
                    ways[there] = min(ways.get(there, far), far)
    begin, end = _nodes(rig, b[0])
    found = [
        ways[node] + left
        for node, left in ((begin, b[1]), (end, rig.pipes[b[0]].length_m - b[1]))
        if node in ways and node not in ends
    ]
    return min(found, default=None)


def _nodes(rig: Rig, pipe: str) -> tuple[str, str]:
    return rig.pipes[pipe].from_node, rig.pipes[pipe].to_node


class Store:
    """What was found, one file for one study and version of code and settings.

    Beside it goes what the repository keeps of this version, in ``docs/found``: a study that takes
    hours may go on on another machine.

    Args:
        name: Name of the file: the study, and what tells versions apart.
    """

    def __init__(self, name: str) -> None:
        STORE.mkdir(parents=True, exist_ok=True)
        self._file = STORE / f"{name}.json"
        self.cases: dict[str, Found] = {}
        for file in (KEPT / f"{name}.json", self._file):
            if not file.exists():
                continue
            for case, data in json.loads(file.read_text()).items():
                injection = Injection(**data.pop("injection"))
                self.cases[case] = Found(injection, **data)

    def add(self, name: str, found: Found) -> None:
        """Keeps a case; the file is whole at any time.

        Args:
            name: Name of the case.
            found: What was found.
        """
        self.cases[name] = found
        kept = {k: asdict(v) for k, v in self.cases.items()}
        write_whole(self._file, json.dumps(kept, indent=1))


def drawn_by() -> str:
    """Digest of what the rigs and recordings are drawn by."""
    files = ("confusion_cases", "calibration_rigs", "joint_rigs", "joint_runs")
    return digest_of(ROOT / "studies" / f"{name}.py" for name in files)


def key_of_sources() -> str:
    """Digest of the code and of what the rigs and recordings are drawn by."""
    return f"{sources_digest()}_{drawn_by()}"


def recordings_folder() -> Path:
    """Where recordings of this version of the simulator are kept."""
    simulator = digest_of(sorted((ROOT / "src" / "pneu_sim" / "pneu_sim").rglob("*.py")))
    return STORE / f"recordings_{simulator}_{drawn_by()}"


def main(arguments: list[str] | None = None) -> int:
    """Runs the study; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", help="names of effects; 'none' for healthy ones")
    shapes = [shape for shape, _ in RIGS]
    parser.add_argument("--rigs", nargs="*", help="shapes", default=shapes, choices=shapes)
    parser.add_argument("--without", action="store_true", help="each taken out of the catalogue")
    parser.add_argument("--page", type=Path, help="file that receives the page, whatever was run")
    parser.add_argument("--budget-s", type=float, default=float("inf"))
    options = parser.parse_args(arguments)
    console = Console(width=170)
    key = key_of_sources()
    store = Store(f"found_{key}")
    begun = time.monotonic()
    total = 0
    out_on = taken_out_on() if options.without else {}
    for shape, seed in RIGS:
        if shape not in options.rigs:
            continue
        rig = calibrated(shape, seed, STORE / f"rigs_{key}")
        for injection, path in recordings_of(shape, seed, recordings_folder()):
            if options.only and (injection.effect or "none") not in options.only:
                continue
            for without in (False, True) if out_on.get(injection.effect) == shape else (False,):
                total += 1
                name = injection.key + (" without it" if without else "")
                if name in store.cases:
                    continue
                if time.monotonic() - begun > options.budget_s:
                    continue
                started = time.monotonic()
                learned = learn(
                    rig, load_recording(path), without=[injection.effect] if without else []
                )
                found = found_of(injection, rig, learned, time.monotonic() - started)
                store.add(name, found)
                console.print(line_of(name, found), soft_wrap=True)
    text = page(store.cases, total, options.rigs)
    console.print(text)
    whole = ROOT / "docs" / "confusion.md"
    file = options.page or (whole if len(options.rigs) == len(RIGS) and not options.only else None)
    if file is not None:
        write_whole(file, text)
    return 0


def taken_out_on() -> dict[str, str]:
    """On which rig each effect is taken out: in turn, on one that has a place for it."""
    rigs = {shape: draw_case(shape, seed, count=0).truth for shape, seed in RIGS}
    out = {}
    for number, effect in enumerate(registry().values()):
        fitting = [shape for shape, rig in rigs.items() if effect.places(rig)]
        if fitting:
            out[effect.name] = fitting[number % len(fitting)]
    return out


def of_one_kind(a: str, b: str) -> bool:
    """Whether two effects are of one kind.

    Args:
        a: Name of one.
        b: Name of the other.
    """
    return any(a in kind and b in kind for kind in CLASSES)


def line_of(name: str, found: Found) -> str:
    """A case as a line of the table.

    Args:
        name: Its name.
        found: What was found.
    """
    hidden = found.injection
    true = "" if found.healthy else f"{hidden.strength:.3g}"
    at = hidden.values.get(POSITION)
    place = hidden.place + (f":{at:.2f}" if at is not None else "")
    steps = " + ".join(
        f"{s['effect']}@{s['place']}"
        + (f":{s['position_m']:.2f}" if s["position_m"] is not None else "")
        + (f"±{e:.2f}" if (e := s.get("position_error_m")) is not None and e < 10.0 else "")
        + f" {s['strength']:.3g}"
        for s in found.steps
    )
    error = found.strength_error
    return (
        f"| {name} | {place} {true} | {hidden.felt:.1f} | {found.before:.2f} -> {found.after:.2f} |"
        f" {found.verdict} | {steps} | {', '.join(found.alike)} |"
        f" {'' if error is None else f'{100 * error:+.0f} %'} | {mark_of(name, found)} |"
    )


def table(cases: dict[str, Found]) -> list[str]:
    """Cases as the lines of a table.

    Args:
        cases: What was found, by name.
    """
    return [
        "| recording | hidden | felt, x noise | kept aside, x noise | verdict | found | not told"
        " from | strength | wrong |",
        "|---" * 9 + "|",
        *(line_of(k, f) for k, f in cases.items()),
    ]


def mark_of(name: str, found: Found) -> str:
    """What is wrong with what was found; empty where nothing is.

    Args:
        name: Name of the case.
        found: What was found.
    """
    if name.endswith("without it"):
        sure = found.verdict == "effect" and bool(found.steps)
        if not sure:
            return ""
        mate = of_one_kind(found.injection.effect, found.steps[0]["effect"])
        return "of its kind" if mate else "SURE OF ANOTHER"
    if found.healthy:
        return "ACCUSED" if found.steps or found.verdict != "nothing_missing" else ""
    if not found.felt:
        return "not felt"
    wrong = []
    if not found.tied:
        wrong.append("OTHER" if found.steps else "MISSED")
    elif found.at is not None:
        if not found.placed:
            wrong.append("place within its error" if found.within else "PLACE")
        if abs(found.strength_error or 0.0) > STRENGTH_WITHIN:
            wrong.append("STRENGTH")
    if found.superfluous and found.named:
        wrong.append("SUPERFLUOUS")
    return " ".join(wrong)


def share(part: int, whole: int) -> str:
    """``a of b (c %)``.

    Args:
        part: How many.
        whole: Of how many.
    """
    return f"{part} of {whole}" + (f" ({100 * part / whole:.0f} %)" if whole else "")


def places_line(located: list[Found]) -> str:
    """How many of those that were named were found where they are.

    Args:
        located: They.
    """
    right = share(sum(f.placed for f in located), len(located))
    told = share(sum(f.within for f in located), len(located))
    return f"* place right, of those: {right}, or within twice the error that is told of it {told}"


def page(cases: dict[str, Found], planned: int, shapes: list[str]) -> str:
    """The results as a page.

    Args:
        cases: What was found, by name.
        planned: How many there are to be.
        shapes: Of which rigs.
    """
    cases = {k: f for k, f in cases.items() if k.startswith(tuple(shapes))}
    taken_out = {k: f for k, f in cases.items() if k.endswith("without it")}
    whole = {k: f for k, f in cases.items() if k not in taken_out}
    healthy = [f for f in whole.values() if f.healthy]
    felt = [f for f in whole.values() if not f.healthy and f.felt]
    tied = [f for f in felt if f.tied]
    located = [f for f in tied if f.at is not None]
    right = [f for f in located if abs(f.strength_error or 0.0) <= STRENGTH_WITHIN]
    besides = sum(bool(f.superfluous) for f in tied if f.named)
    accused = sum(bool(mark_of(k, f)) for k, f in whole.items() if f.healthy)
    marks = [mark_of(k, f) for k, f in taken_out.items() if f.felt]
    lines = [
        "# Confusion matrix",
        "",
        f"Made by `make confusion` of these rigs: {', '.join(shapes)}; drawn at random and"
        f" calibrated from their datasheets; every effect hidden in a recording of {SECONDS:g} s of"
        " each, from a plant of finer cells and other numerics, at a place, a position and a"
        f" strength of its own. An effect that changes no sensor by {FELT:g} times the noise,"
        " even at the strongest tried, is not counted.",
        f"Made from the sources {sources_digest()}.",
        "",
        f"* run: {len(cases)} of {planned}" + ("" if len(cases) == planned else " (not all)"),
        f"* first, or said not to be told from what is first: {share(len(tied), len(felt))},"
        f" first {share(sum(f.named for f in felt), len(felt))}",
        places_line(located),
        f"* strength within {100 * STRENGTH_WITHIN:.0f} %: {share(len(right), len(located))}",
        f"* with something superfluous: {share(besides, len(felt))}",
        f"* healthy recordings accused: {share(accused, len(healthy))}",
    ]
    if taken_out:
        sure, mates = marks.count("SURE OF ANOTHER"), marks.count("of its kind")
        lines.append(
            "* taken out of the catalogue, each on one rig: one of its kind named for it"
            f" {share(mates, len(marks))}, another for sure {share(sure, len(marks))}"
        )
    lines += ["", *table(cases)]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
