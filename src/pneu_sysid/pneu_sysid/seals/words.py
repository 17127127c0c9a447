# SPDX-License-Identifier: Apache-2.0
"""What drag tests say of a cylinder's friction, in words, in a table and as a JSON result."""

import numpy as np

from pneu_common.installed import version
from pneu_common.tables import Column, NamedTable
from pneu_sim.rig.schema import Rig
from pneu_sysid.results.friction import (
    FrictionLaw,
    FrictionLevel,
    FrictionResult,
    FrictionStep,
    FrictionStrength,
)
from pneu_sysid.seals.estimate import Estimate
from pneu_sysid.seals.identify import UNEXPLAINED, Identified, common_terms, friction_at, score
from pneu_sysid.seals.laws import FIELDS, SHORT, TITLES, UNITS, Term
from pneu_sysid.seals.reading import DragTest

BAR = 1e5


def share_of_gauge(found: Identified) -> float:
    """Mean gauge pressure of both sides over that of the measured one.

    Args:
        found: What was found.
    """
    top = max(found.pieces.levels, key=lambda level: level.gauge_pa)
    return top.mean_gauge_pa / top.gauge_pa if top.gauge_pa > 0.0 else 0.5


def base_and_growth(found: Identified) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """F0 and k of ``F0 + k p``, N and N per bar of the measured side, each with standard error.

    F0 has all that does not grow with pressure, at the usual speed.

    Args:
        found: What was found.

    Returns:
        None where the pressures cannot tell.
    """
    if not found.spans.pressures:
        return None
    base, error = friction_at(found, np.zeros(1))
    per_bar = share_of_gauge(found) * BAR
    growth = found.best.strength.get("pressure", 0.0)
    growth_error = found.best.std_error.get("pressure", 0.0)
    return (float(base[0]), float(error[0])), (per_bar * growth, per_bar * growth_error)


def _number(value: float, error: float) -> str:
    """A value and its standard error, to the digits that the error leaves."""
    digits = int(np.clip(1 - np.floor(np.log10(max(error, 1e-12))), 0, 4))
    return f"{value:.{digits}f} ± {error:.{digits}f}"


def law_in_words(law: tuple[Term, ...]) -> str:
    """Terms of a law.

    Args:
        law: The terms.
    """
    return " and ".join(SHORT[t] for t in law) if law else "no friction"


def strengths_in_words(found: Identified) -> str:
    """The friction that is named, with its numbers.

    Args:
        found: What was found.
    """
    e = found.best
    parts = []
    for term in e.law:
        value, error = e.strength[term], e.std_error[term]
        if term == "pressure":
            per_bar = share_of_gauge(found) * BAR
            parts.append(f"{_number(per_bar * value, per_bar * error)} N per bar of gauge pressure")
        elif term == "viscous":
            parts.append(f"{_number(value, error)} N s/m times the speed")
        elif term == "breakaway":
            parts.append(
                f"{_number(value, error)} N more at rest, which vanishes over"
                f" {1e3 * e.stribeck_m_s:.2g} mm/s"
            )
        else:
            parts.append(f"{_number(value, error)} N")
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)


def sentence_of(found: Identified) -> str:
    """The verdict in one sentence.

    Args:
        found: What was found.
    """
    left = found.steps[-1].judged_n
    before = found.steps[0].judged_n
    if found.verdict == "nothing_missing":
        if found.own is not None:
            return (
                f"Nothing is missing: the friction of the rig file leaves {found.own:.3g} N, what"
                f" would be fitted here {left:.3g} N."
            )
        return (
            f"Nothing is missing: without friction the force is explained to {left:.3g} N,"
            f" {found.times_noise:.2f} times the noise."
        )
    if found.verdict == "unknown":
        near = (
            f" (the nearest, {law_in_words(found.best.law)}, explains only"
            f" {100.0 * found.explained:.0f} % of the squared error on strokes kept aside)"
            if found.best.law
            else ""
        )
        return (
            f"Something is missing that no friction law here explains{near}; most of it varies"
            f" {next(iter(found.left_n))}."
        )
    aside = "on strokes kept aside" if found.steps[0].held_out_n is not None else "of the strokes"
    more = "; more is missing besides" if found.times_noise > UNEXPLAINED else ""
    tail = (
        f"; it explains {100.0 * found.explained:.0f} % of the squared error {aside}"
        f" ({before:.3g} N without, {left:.3g} N with it){more}."
    )
    if found.verdict == "ambiguous":
        laws = [found.best, *found.alike]
        named = "; or ".join(law_in_words(e.law) for e in laws)
        return f"Friction is missing, and several laws are equally good: {named}{tail}"
    firm = common_terms(found.best, found.alike)
    # Beside others constant friction needs no name: its number tells.
    titles = [TITLES[t] for t in firm if t != "constant" or len(firm) == 1]
    return f"Missing: {' and '.join(titles)}, {strengths_in_words(found)}{tail}"


def statements_of(found: Identified) -> list[str]:
    """What else the strokes say, or cannot.

    Args:
        found: What was found.
    """
    spans, e = found.spans, found.best
    slow, fast = (1e3 * v for v in spans.speed_m_s)
    out = []
    if found.alike:
        others = "; ".join(law_in_words(a.law) for a in found.alike)
        out.append(
            f"As good as {law_in_words(e.law)}: {others}. {_apart(e, found.alike)}, would tell."
        )
    if not spans.pressures:
        low, high = (
            min(p.gauge_pa for p in found.pieces.levels),
            max(p.gauge_pa for p in found.pieces.levels),
        )
        at = (
            f"One pressure only ({low / BAR:.2f} bar)"
            if high - low < 0.05 * BAR
            else f"Pressures of {low / BAR:.2f} to {high / BAR:.2f} bar only"
        )
        out.append(
            f"{at}: whether friction grows with it cannot be told; drag at another pressure, at the"
            " same speed."
        )
    if not spans.speeds:
        out.append(
            f"Speeds of {slow:.3g} to {fast:.3g} mm/s: viscous friction and breakaway (Stribeck)"
            " cannot be told from constant friction; drag at several speeds, at the same pressure."
        )
    if spans.pressures and e.law and "pressure" not in e.law:
        out += _not_seen(found)
    if spans.pressures and spans.speeds and "pressure" in e.law:
        out += _moved_together(found)
    if found.own is not None and found.verdict != "nothing_missing":
        out.append(f"The friction that the rig file has leaves {found.own:.3g} N.")
    if spans.pressures and e.law and abs(e.gain) > max(3.0 * e.gain_error, 0.01):
        out.append(
            f"The force goes with {1.0 + e.gain:.3f} ± {e.gain_error:.3f} times the gas's push: the"
            " bore, the force's scale or the pressure's is off by that, or one way's friction"
            " grows more than the other's."
        )
    if found.times_noise > UNEXPLAINED:
        parts = [f"{v:.2g} N {k}" for k, v in found.left_n.items() if v > found.noise_n]
        if parts:
            out.append(
                f"What is left, {found.steps[-1].judged_n:.2g} N, varies: {', '.join(parts)}."
            )
    if found.steps[0].held_out_n is None:
        out.append("There are too few strokes to keep any aside: errors are of those fitted to.")
    return out


def _not_seen(found: Identified) -> list[str]:
    """How little friction grows with pressure, where it is not seen to."""
    law = {*found.best.law, "pressure"}
    growing = next((e for e in found.laws if set(e.law) == law), None)
    if growing is None:  # it would fall
        return ["Friction is not seen to grow with pressure."]
    per_bar = share_of_gauge(found) * BAR
    value, error = growing.strength["pressure"], growing.std_error["pressure"]
    return [
        "Friction is not seen to grow with pressure:"
        f" {_number(per_bar * value, per_bar * error)} N per bar of gauge pressure."
    ]


def _moved_together(found: Identified) -> list[str]:
    """A warning where the machine slowed down as pressure rose."""
    r = found.pieces.readings
    of = found.pieces.level[r.piece]
    count = len(found.pieces.levels)
    speed = [float(r.speed_m_s[of == k].mean()) for k in range(count)]
    pressure = [level.gauge_pa for level in found.pieces.levels]
    if count < 3 or max(speed) < 1.2 * min(speed):
        return []
    together = float(np.corrcoef(speed, pressure)[0, 1])
    if abs(together) < 0.8:
        return []
    first, last = (1e3 * speed[int(k)] for k in (np.argmin(pressure), np.argmax(pressure)))
    return [
        f"The speed changed with the pressure, from {first:.3g} to {last:.3g} mm/s from the lowest"
        " to the highest: what is due to which is told by the law's form alone."
    ]


def _apart(best: Estimate, alike: list[Estimate]) -> str:
    """What would tell laws apart."""
    differ = {t for e in alike for t in set(e.law) ^ set(best.law)}
    if differ & {"viscous", "breakaway"}:
        return "Strokes at one pressure and several speeds, some ten times slower than others"
    return "Strokes at one speed and more pressures"


def tables_of(found: Identified) -> list[NamedTable]:
    """How the model without friction fails, and what the terms do.

    Args:
        found: What was found.
    """
    numbers = [
        Column(name, "number", drop)
        for name, drop in (
            ("bar", 0),
            ("cycles", 3),
            ("without, in", 0),
            ("without, out", 0),
            ("noise", 0),
            ("half difference", 0),
            ("named", 0),
            ("left, in", 1),
            ("left, out", 1),
        )
    ]
    by_level = NamedTable(
        "error without friction and with it, N: rod pressed in, drawn out",
        [Column("recording"), *numbers],
    )
    for level in _levels(found):
        half = "-" if level.half_difference_n is None else f"{level.half_difference_n:.2f}"
        spread = "" if level.spread_n is None else f" ± {level.spread_n:.2f}"
        by_level.add_row(
            level.name,
            f"{level.gauge_pa / BAR:.2f}",
            str(level.cycles),
            *(f"{v:.3f}" for v in level.without_n),
            f"{level.noise_n:.3f}",
            half + spread,
            f"{level.friction_n:.2f}",
            *(f"{v:.3f}" for v in level.with_n),
        )
    added = NamedTable(
        "terms, the one that helps most first",
        [
            Column("added"),
            Column("error, N", "number"),
            Column("on strokes kept aside, N", "number"),
            Column("times noise", "number"),
        ],
    )
    for step in _steps(found):
        held_out = "-" if step.held_out_rmse_n is None else f"{step.held_out_rmse_n:.3f}"
        name = "nothing yet" if step.added is None else step.added
        times = "-" if step.times_noise is None else f"{step.times_noise:.1f}"
        added.add_row(name, f"{step.rmse_n:.3f}", held_out, times)
    return [by_level, added]


def _levels(found: Identified) -> list[FrictionLevel]:
    pieces = found.pieces
    halves = pieces.cycle_friction()
    speeds = pieces.mean(pieces.readings.speed_m_s)
    out = []
    for k, level in enumerate(pieces.levels):
        at = friction_at(
            found, np.array([level.mean_gauge_pa]), float(speeds[pieces.level == k].mean())
        )[0]
        out.append(
            FrictionLevel(
                name=level.name,
                gauge_pa=level.gauge_pa,
                cycles=int(halves[k].size),
                half_difference_n=float(halves[k].mean()) if halves[k].size else None,
                spread_n=float(np.std(halves[k], ddof=1)) if halves[k].size > 1 else None,
                friction_n=float(at[0]),
                without_n=(
                    float(found.steps[0].by_level[k, 0]),
                    float(found.steps[0].by_level[k, 1]),
                ),
                with_n=(
                    float(found.steps[-1].by_level[k, 0]),
                    float(found.steps[-1].by_level[k, 1]),
                ),
                noise_n=level.noise_n,
            )
        )
    return sorted(out, key=lambda level: level.gauge_pa)


def _steps(found: Identified) -> list[FrictionStep]:
    out = []
    before: set[Term] = set()
    for step in found.steps:
        new = [t for t in step.law if t not in before]
        before = set(step.law)
        out.append(
            FrictionStep(
                added=SHORT[new[0]] if new else None,
                rmse_n=step.rmse_n,
                held_out_rmse_n=step.held_out_n,
                times_noise=step.judged_n / found.noise_n if found.noise_n > 0.0 else None,
            )
        )
    return out


def result_of_friction(
    rig: Rig, file: str, output: str | None, tests: list[DragTest], found: Identified
) -> FrictionResult:
    """The JSON result.

    Args:
        rig: The rig.
        file: Its file.
        output: Rig file that is written.
        tests: The drag tests.
        found: What was found.
    """
    assert rig.drag is not None
    e = found.best
    known = base_and_growth(found)
    several = len(tests) > 1
    told = [f"{t.name}: {f}" if several else f for t in tests for f in t.findings]
    return FrictionResult(
        pneu_version=version(),
        recording=", ".join(t.name for t in tests),
        recordings=[t.name for t in tests],
        rigs=[rig.name],
        taps=[],
        noise_floor_pa={},
        findings=told + found.pieces.findings,
        rig=file,
        output=output,
        noise_n=found.noise_n,
        levels=_levels(found),
        steps=_steps(found),
        strengths=[
            FrictionStrength(
                path=f"cylinders.{rig.drag.cylinder}.friction.{FIELDS[t]}",
                value=e.strength[t],
                std_error=e.std_error[t],
                unit=UNITS[t],
            )
            for t in e.law
        ],
        base_n=None if known is None else known[0][0],
        base_std_error_n=None if known is None else known[0][1],
        per_bar_n=None if known is None else known[1][0],
        per_bar_std_error_n=None if known is None else known[1][1],
        gain=e.gain if e.law else 0.0,
        gain_std_error=e.gain_error,
        zero_n=e.zero_n,
        own_rmse_n=found.own,
        explained=found.explained,
        left_n=found.left_n,
        laws=[
            FrictionLaw(terms=list(a.law), behind=score(a) - score(found.laws[0]))
            for a in found.laws
        ],
        verdict=found.verdict,
        sentence=sentence_of(found),
        statements=statements_of(found),
    )
