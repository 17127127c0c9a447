# SPDX-License-Identifier: Apache-2.0
"""Where the fit of a spool starts: bandwidths, limits and delays tried side by side.

A limit that is never reached has no slope to follow, and a spool that is slow for another reason
than the one assumed is a valley of its own; so what a spool may be is tried before it is fitted.
"""

import math
from collections.abc import Container, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.schema import FitParameter, Rig, Spool
from pneu_sysid.gauss_newton import Estimate, huber_cost
from pneu_sysid.problem import Problem
from pneu_sysid.trials import CHANCE, Told, costs_of, moved, residuals_of

Floats = NDArray[np.float64]

BANDWIDTHS = (0.6, 1.0, 1.6)
"""Factors on the bandwidth."""
DELAYS_S = (0.0, 2e-3, 5e-3)
"""Delays besides the one in the file."""
SPEEDS = (0.8, 0.55, 0.35, 0.2)
"""Limits of the speed, in parts of the largest that the unlimited spool would reach."""
ACCELERATIONS = (0.6, 0.35, 0.2, 0.1)
"""Limits of the acceleration, likewise."""
FASTER = (1.0, 1.35, 1.8)
"""A spool with a limit is as much faster where it is not reached."""
WIDER = (1.0, 2.0, 4.0)
"""Factors on the limit that a spool has, where the other one is tried."""
SLOWER = (1.0, 0.75, 0.55)
"""... and as much slower, perhaps, if it has none after all."""
WORTH = 0.03
"""A limit has to take away so much of what the cost is more than the noise's to be assumed, ..."""
FIRST_WORTH, MUCH_ELSE = 0.25, 2.0
"""... the first one of a spool so much as long as the cost is more than so many times the noise's.
Of rigs drawn at random, begun from their datasheets, the one that is set first took 0.47 and more,
that of a second valve 0.26 and more, but for one of 0.05, which is found later. Where there was
none 0.09 was the most of ten; it led a datasheet of rig B into a valley without a way out."""


@dataclass(frozen=True)
class _Trial:
    """What a spool may be, relative to what it would do without limits."""

    bandwidth: float = 1.0
    delay_s: float = 0.0
    speed: float | None = None
    acceleration: float | None = None
    wider: float = 1.0
    free: bool = False


def try_spools(
    rig: Rig, problem: Problem, known: Container[str] = (), told: Told | None = None
) -> Rig:
    """The rig with the bandwidths and delays, of those tried, with which it does best.

    Spools that follow at once stay as they are; closing gets a delay of its own.

    Args:
        rig: The rig.
        problem: The problem, on long cells.
        known: Valves whose spools are known already.
        told: Given the size of a batch, what is called with the fraction of it that is done.
    """
    for name, valve in rig.valves.items():
        if valve.spool.bandwidth_hz is None or name in known:
            continue
        trials = [_Trial(b, d) for b in BANDWIDTHS for d in DELAYS_S]
        rigs = _tried(rig, name, trials, 0.0)
        tell = None if told is None else told(len(rigs))
        r = problem.residual(problem.simulate(rigs, progress=tell, strict=False).readings)
        rig = rigs[int(np.argmin([huber_cost(np.nan_to_num(one, nan=1e6)) for one in r]))]
        spool = rig.valves[name].spool
        if spool.closing_delay_s is None:
            rig = _with(rig, name, spool.model_copy(update={"closing_delay_s": spool.delay_s}))
    return rig


def try_limits(
    rig: Rig,
    problem: Problem,
    used: NDArray[np.bool_],
    estimate: Estimate,
    fitted: Sequence[FitParameter],
    known: Container[str] = (),
    told: Told | None = None,
) -> tuple[Rig, bool]:
    """The rig with the limits of its spools, of those tried, with which it would do best.

    What the parameters of the last estimation could make good is taken out of every trial.

    Args:
        rig: The rig, as it was estimated.
        problem: The problem that it was estimated on.
        used: (n_stretches,) stretches that it was estimated on.
        estimate: The estimation.
        fitted: Its parameters.
        known: Valves whose spools are known already.
        told: Given the size of a batch, what is called with the fraction of it that is done.

    Returns:
        The rig, and whether a spool got a limit.
    """
    changed = False
    freed: set[str] = set()
    for name, valve in rig.valves.items():
        if name not in known and _is_limited(valve.spool):
            better = _without_limits(rig, name, problem, used, estimate, fitted, told)
            if better is not None:
                rig, changed = better, True
                freed.add(name)
    while True:
        # the one that takes away most first: beside it another's share may be too small to see
        found = [
            _best_limit(rig, name, problem, used, estimate, told)
            for name, valve in rig.valves.items()
            if name not in known and name not in freed and _may_be_limited(valve.spool)
        ]
        worth = [one for one in found if one is not None]
        if not worth:
            return rig, changed
        rig, changed = max(worth, key=lambda one: one[0])[1], True


def limits_missed(before: Rig, after: Rig, problem: Problem, used: NDArray[np.bool_]) -> bool:
    """Whether a rig that lost limits of its spools does worse for it, now that it was fitted.

    `try_limits` forecasts that to first order only.

    Args:
        before: The rig before.
        after: The rig that lost limits, if any, fitted.
        problem: The problem that it was fitted on.
        used: (n_stretches,) stretches that it was fitted on.
    """
    had = [name for name, valve in before.valves.items() if _is_limited(valve.spool)]
    if all(_is_limited(after.valves[name].spool) for name in had):
        return False
    r = residuals_of([before, after], problem, used)
    with_limits, without = 0.5 * np.sum(r**2, axis=(1, 2))
    return bool(without > with_limits + CHANCE)


def _is_limited(spool: Spool) -> bool:
    """Whether a spool has a limit."""
    return spool.max_speed_v_s is not None or spool.max_acceleration_v_s2 is not None


def _without_limits(
    rig: Rig,
    name: str,
    problem: Problem,
    used: NDArray[np.bool_],
    estimate: Estimate,
    fitted: Sequence[FitParameter],
    told: Told | None,
) -> Rig | None:
    """The rig whose spool has no limits, where it would do better so; else None.

    While much else was wrong a limit may have explained what another bandwidth does better, and
    the fit that followed made the spool faster until the limit was all that slowed it down.
    """
    trials = [_Trial(bandwidth, free=True) for bandwidth in SLOWER]
    rigs = _tried(rig, name, trials, 0.0)
    # a limit that is not there makes nothing good
    gone = np.array([p.path.startswith(f"valves.{name}.spool.max_") for p in fitted])
    costs, amounts = costs_of(rig, rigs, problem, used, estimate, told, gone)
    k = int(np.argmin(costs[1:]))
    if costs[1 + k] >= costs[0] + CHANCE:
        return None
    # with what the others make good, or the next step would lead back
    return moved(rigs[k], fitted, amounts[1 + k], gone)


def _may_be_limited(spool: Spool) -> bool:
    """Whether a spool has a bandwidth, and not yet both of its limits."""
    both = spool.max_speed_v_s is not None and spool.max_acceleration_v_s2 is not None
    return spool.bandwidth_hz is not None and not both


def _best_limit(
    rig: Rig,
    name: str,
    problem: Problem,
    used: NDArray[np.bool_],
    estimate: Estimate,
    told: Told | None,
) -> tuple[float, Rig] | None:
    """The best further limit of one spool: the share of the cost that it takes away, and the rig.

    A limit that stands has taken over some of what the other one does, so it is tried wider too.
    """
    spool = rig.valves[name].spool
    step_v = largest_step_v(problem, rig.valves[name].command)
    if step_v <= 0.0:
        return None
    if spool.max_speed_v_s is not None:
        trials = [_Trial(acceleration=a, wider=w) for w in WIDER for a in ACCELERATIONS]
    elif spool.max_acceleration_v_s2 is not None:
        trials = [_Trial(speed=s, wider=w) for w in WIDER for s in SPEEDS]
    else:
        trials = [_Trial(b, speed=s) for b in FASTER for s in SPEEDS]
        trials += [_Trial(b, acceleration=a) for b in FASTER for a in ACCELERATIONS]
    costs, _ = costs_of(rig, _tried(rig, name, trials, step_v), problem, used, estimate, told)
    k = int(np.argmin(costs[1:]))
    noise = 0.5 * float(np.isfinite(problem.measured[used]).sum())
    first = not _is_limited(spool) and costs[0] > MUCH_ELSE * noise
    worth = FIRST_WORTH if first else WORTH
    if costs[0] - costs[1 + k] < worth * max(costs[0] - noise, 0.0) + CHANCE:
        return None
    return 1.0 - costs[1 + k] / costs[0], _tried(rig, name, [trials[k]], step_v)[0]


def largest_step_v(problem: Problem, command: str) -> float:
    """The largest change of a command at once, V.

    Args:
        problem: The problem.
        command: Name of the command.
    """
    steps = [
        float(np.max(np.abs(np.diff(r.commands[command].values)), initial=0.0))
        for r in problem.recordings
    ]
    return max(steps, default=0.0)


def _tried(rig: Rig, name: str, trials: list[_Trial], step_v: float) -> list[Rig]:
    """A rig for each trial of one of its spools."""
    given = rig.valves[name].spool
    return [_with(rig, name, _spool(given, trial, step_v)) for trial in trials]


def _spool(given: Spool, trial: _Trial, step_v: float) -> Spool:
    """A spool as a trial has it."""
    assert given.bandwidth_hz is not None
    bandwidth = given.bandwidth_hz * trial.bandwidth
    values = {"bandwidth_hz": bandwidth, "delay_s": given.delay_s + trial.delay_s}
    if given.closing_delay_s is not None:
        values["closing_delay_s"] = given.closing_delay_s + trial.delay_s
    if trial.free:
        return given.model_copy(
            update={**values, "max_speed_v_s": None, "max_acceleration_v_s2": None}
        )
    if given.max_speed_v_s is not None:
        values["max_speed_v_s"] = trial.wider * given.max_speed_v_s
    if given.max_acceleration_v_s2 is not None:
        values["max_acceleration_v_s2"] = trial.wider * given.max_acceleration_v_s2
    # of the unlimited spool after a step: x'' at once, x' at its first peak
    omega, zeta = 2.0 * math.pi * given.bandwidth_hz, min(given.damping, 0.999)
    root = math.sqrt(1.0 - zeta * zeta)
    if trial.speed is not None:
        fastest = step_v * omega * math.exp(-zeta / root * math.acos(zeta))
        values["max_speed_v_s"] = trial.speed * fastest
    if trial.acceleration is not None:
        values["max_acceleration_v_s2"] = trial.acceleration * step_v * omega**2
    return given.model_copy(update=values)


def _with(rig: Rig, valve: str, spool: Spool) -> Rig:
    valves = {**rig.valves, valve: rig.valves[valve].model_copy(update={"spool": spool})}
    return rig.model_copy(update={"valves": valves})
