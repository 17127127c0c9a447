# SPDX-License-Identifier: Apache-2.0
"""The steps in which a calibration comes near: how much flows, how fast, and then all of it.

Long cells and short predictions come first. What is left to the end is told by long cells too,
whose error at the present rig is made good by a run on the rig's own: only what changes with a
parameter has to be told by them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from pneu_common.progress import Tell
from pneu_sim.models import kind_of
from pneu_sim.rig.parameters import value_of
from pneu_sim.rig.plan import plan_grid
from pneu_sim.rig.schema import FitParameter, Rig
from pneu_sysid.bends import bends_told
from pneu_sysid.curves import Bends, Mirrors, curve_ties
from pneu_sysid.gauss_newton import DAMPINGS, Estimate, minimise
from pneu_sysid.parameters import in_short_steps, rig_at, std_inside, variables_of
from pneu_sysid.problem import Problem, make_problem, pull_of
from pneu_sysid.records import Recording
from pneu_sysid.slopes import Variable

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SETTLED = 0.03
"""A step that gained no more of the cost need not be taken again, if ..."""
NEAR = 0.4
"""... by its own forecast the parameters are, root mean square, so many standard errors from where
the next one would leave them: little of the cost may be much of a parameter that is seldom seen."""
WORKS = 0.25
"""A Jacobian serves the next step too as long as it gains so much."""
AT_NOISE = 1.15
"""Times the noise, of all taps, at which an estimation that gains little is done."""
UNSTABLE = 1e4
"""Residual, in noise deviations, that a simulation counts with once it is unstable."""
SECANTS = 2
"""Steps with a Jacobian corrected by secants, for each that is computed."""
SLOW_PULL_S = 0.06
"""Over so short a time a prediction is nearly linear in what flows."""
COARSEST = 4.0
"""Cells of the first steps are at most this much longer than the rig's."""
FEWEST_CELLS = 20
"""... as long as so many are left."""
APPROACH_S = 8.0
"""So much of all recordings together serves the first steps; the last take all."""
LEAST_S = 3.0
"""... but no less of any."""
SLOW_PARTS = (
    "conductance_m3_s_pa",
    "critical_ratio",
    "area_m2",
    "fraction",
    "leakage",
    "volume_m3",
    "pressure_pa",
)
"""Ends of the paths of what says how much flows, and how much it fills."""
TRIED = 45
"""Runs that it takes to try what a spool may be, about."""
ENDS_HEAVY = 30.0
"""Ends, ports and chambers of a rig cost as much time as so many cells."""


@dataclass(frozen=True)
class Step:
    """One step of a calibration.

    Attributes:
        words: What it is, for people.
        dx_m: Length of its cells.
        pull_s: Time constant of the pull to the taps; None is the rig's own.
        iterations: Gauss-Newton iterations, at most.
        slow: Whether only what says how much flows is fitted.
        corrected: Whether the error of its cells is made good.
        part: Whether long recordings are cut.
        tries: Whether what spools may be is tried first.
        limits: Whether limits of spools are tried first, which the step before makes possible.
        again: Whether it is left out once nothing more is gained, or no limit is found.
        along: Whether what the recordings hardly show is looked along (`looked_along`).
    """

    words: str
    dx_m: float
    pull_s: float | None
    iterations: int
    slow: bool = False
    corrected: bool = False
    part: bool = False
    tries: bool = False
    limits: bool = False
    again: bool = False
    along: bool = False


def steps_of(rig: Rig, approach: bool, iterations: int) -> list[Step]:
    """The steps of a calibration.

    Args:
        rig: The rig.
        approach: Whether it has to come near first; else it is nearly right.
        iterations: Iterations of a step on the rig's own horizon, at most.
    """
    if not kind_of(rig).along_lines or not approach:
        return [
            Step("all", rig.grid.dx_m, None, iterations),
            Step("all again", rig.grid.dx_m, None, max(3, iterations // 2)),
        ]
    coarse = rig.grid.dx_m * float(np.clip(cells_of(rig) / FEWEST_CELLS, 1.0, COARSEST))
    pull = pull_of(rig)
    out = []
    if rig.moves or pull is None or pull > 1.5 * SLOW_PULL_S:
        near = SLOW_PULL_S if pull is None else min(SLOW_PULL_S, pull)
        out.append(Step("slow: what flows", coarse, near, 3, slow=True, part=True))
    few = max(1, iterations // 4)
    out.append(Step("fast: spools and waves", coarse, None, few, part=True, tries=True))
    out.append(Step("fast: limits of spools", coarse, None, few, limits=True))
    if rig.moves and pull is not None and pull > 1.5 * SLOW_PULL_S:
        # What moves bounces and sticks: far ahead a prediction is anything but linear in it.
        out.append(Step("all, a little ahead", coarse, SLOW_PULL_S, few + 1, corrected=True))
        middle = float(np.sqrt(SLOW_PULL_S * pull))
        out.append(Step("all, further ahead", coarse, middle, few, corrected=True))
    out.append(Step("all", coarse, None, few, corrected=True))
    late = "limits of spools that were not seen before"
    out.append(Step(late, coarse, None, 1, corrected=True, limits=True, again=True))
    out += [
        Step(f"all, {time} time", coarse, None, 1, corrected=True, again=True)
        for time in ("second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth")
    ]
    return out


class Work:
    """How much of a calibration is done, and who is told of it."""

    def __init__(self, ends: dict[Step, tuple[float, float]], tell: Tell) -> None:
        """Nothing is done yet.

        Args:
            ends: Per step what all is worth when it is done, and what one run in it is worth.
            tell: Called with a stage, the fraction done and a note.
        """
        self._ends, self._tell = ends, tell
        self._total = 1.05 * max((end for end, _ in ends.values()), default=1.0)
        self._done = self._until = 0.0
        self._mark = 0.0, 0.0  # what was done, and the fraction told, when the last step was added
        self.words = ""

    @classmethod
    def of_steps(cls, steps: list[tuple[Step, float, int, int]], tell: Tell) -> "Work":
        """What some steps are worth.

        Args:
            steps: Each with what one run is worth, how many parameters it fits, and how many
                valves the rig has.
            tell: Called with a stage, the fraction done and a note.
        """
        ends, sofar = {}, 0.0
        for step, weight, count, valves in steps:
            sofar += weight * runs_of(step, count, valves)
            ends[step] = (sofar, weight)
        return cls(ends, tell)

    def begin(self, step: Step) -> Callable[[int], Callable[[float], None]]:
        """Begins a step: given the size of a batch, what is called with the fraction done of it.

        Args:
            step: The step.
        """
        self.words = step.words
        self._until, weight = self._ends[step]

        def told(count: int) -> Callable[[float], None]:
            begun = self._done

            def tell(fraction: float) -> None:
                self._done = min(begun + weight * count * fraction, self._until)
                self._tell("calibrating", self._fraction(), self.words)

            return tell

        return told

    def add(self, step: Step, weight: float, runs: int) -> None:
        """Takes up a step that nobody knew of beforehand; what is told done does not go back.

        Args:
            step: The step.
            weight: What one run in it is worth.
            runs: How many it takes.
        """
        self._mark = self._done, self._fraction()
        self._ends[step] = (self._done + weight * runs, weight)
        self._total = 1.05 * self._ends[step][0]

    def _fraction(self) -> float:
        """What is told done: from the mark on what is left shares what was left to be told."""
        done, told = self._mark
        return told + (1.0 - told) * (self._done - done) / (self._total - done)

    def finish(self, step: Step) -> None:
        """Ends a step, whether or not all of it had to be done.

        Args:
            step: The step.
        """
        self._done = self._ends[step][0]


def weight_of(rig: Rig, step: Step, seconds: float) -> float:
    """What one run of a rig in a step costs, in any unit.

    Args:
        rig: The rig.
        step: The step.
        seconds: Length of the recordings, s.
    """
    runs = min(seconds, APPROACH_S) if step.part else seconds
    return runs * (cells_of(rig, step.dx_m) + ENDS_HEAVY) / step.dx_m


def runs_of(step: Step, count: int, valves: int) -> int:
    """How many runs a step takes at most, told in those of its own cells.

    Args:
        step: The step.
        count: Parameters.
        valves: Valves.
    """
    once = 30 if step.corrected else 0
    fitted = count // 2 if step.slow else count
    tried = TRIED * valves if step.tries or step.limits else 0
    return round(step.iterations * (fitted + 1 + len(DAMPINGS)) + 3 + once + tried)


def is_slow(parameter: FitParameter) -> bool:
    """Whether a parameter says how much flows, how much it fills, or what that moves.

    Args:
        parameter: The parameter.
    """
    parts = parameter.path.split(".")
    if parts[0] in ("cylinders", "bodies"):
        return True
    name = parts[-2] if parts[-1].isdigit() else parts[-1]
    return name in SLOW_PARTS


def residual_function(
    problem: Problem,
    chosen: Mask,
    rig_of: Callable[[Floats], Rig],
    told: Callable[[int], Callable[[float], None]] | None = None,
) -> Callable[[Sequence[Floats]], Floats]:
    """Batched residuals over chosen stretches for `gauss_newton.minimise`.

    Args:
        problem: The problem.
        chosen: (n_stretches,) stretches to use.
        rig_of: Rig at a parameter vector.
        told: Given the size of a batch, what is called with the fraction of it that is done.
    """

    def residuals(points: Sequence[Floats]) -> Floats:
        tell = None if told is None else told(len(points))
        rigs = [rig_of(x) for x in points]
        y = problem.simulate(rigs, progress=tell, strict=False).readings
        r = problem.residual(y)[:, chosen].reshape(len(points), int(chosen.sum()), -1)
        # a trial that no longer can be simulated is only a bad one
        r[~(np.abs(r) < UNSTABLE)] = UNSTABLE
        return r

    return residuals


def cells_of(rig: Rig, dx_m: float | None = None) -> int:
    """Number of cells of a rig.

    Args:
        rig: The rig.
        dx_m: Length of its cells in place of its own, m.
    """
    return sum(n for _, n in plan_grid(rig, dx_m).pipes.values())


def settled(estimate: Estimate) -> bool:
    """Whether the last estimation gained too little for another like it.

    Args:
        estimate: The estimation.
    """
    return estimate.gained < SETTLED and estimate.ahead < _near(estimate)


def gained_little(estimate: Estimate) -> bool:
    """Whether the last estimation has gained no more than `settled` lets be gained yet.

    Args:
        estimate: The estimation.
    """
    return estimate.history[0] - estimate.history[-1] < _near(estimate)


def _near(estimate: Estimate) -> float:
    """Cost of the distance at which parameters are near (``NEAR``)."""
    # half the square of the distance in standard errors, of data that count for less than samples
    return 0.5 * estimate.values.size * (NEAR * estimate.weight) ** 2


def at_noise(estimate: Estimate, problem: Problem, used: Mask) -> bool:
    """Whether an estimation leaves so little that a new Jacobian is not worth its time.

    Args:
        estimate: The estimation.
        problem: Its problem.
        used: (n_stretches,) stretches that it used.
    """
    return float(np.sum(estimate.residual**2)) < AT_NOISE**2 * _readings(problem, used)


def _readings(problem: Problem, used: Mask) -> int:
    """How many readings there are, at least one."""
    return max(int(np.isfinite(problem.measured[used]).sum()), 1)


def brought_back(
    rig: Rig,
    problem: Problem,
    used: Mask,
    hidden: Sequence[FitParameter],
    centres: Sequence[float],
    off: Sequence[float],
) -> tuple[Rig, list[FitParameter]]:
    """Brings back what was driven to where nothing shows it, where that explains no less.

    On the way down some parameters are driven so far that they change nothing any more, as does a
    wall's heat once the gas is as warm as the wall. That says nothing of where they were before.

    Args:
        rig: The rig.
        problem: The recordings.
        used: (n_stretches,) stretches that count.
        hidden: Parameters that are not seen where they are.
        centres: Where each was before all, in the unit that it is estimated in.
        off: By how many standard deviations of what was known of it each is off that.

    Returns:
        The rig, the same where all stay; and those that are seen where they were.
    """
    rigs = [rig_at(rig, [p], np.array([c])) for p, c in zip(hidden, centres, strict=True)]
    here, *there = (problem.residual(y)[used] for y in problem.predict([rig, *rigs]))
    seen = [p for p, r in zip(hidden, there, strict=True) if np.sum((r - here) ** 2) > 1.0]
    back = [
        (p, c)
        for p, c, deviations, r in zip(hidden, centres, off, there, strict=True)
        if np.sum(r**2) - np.sum(here**2) < deviations**2
    ]
    if back:
        rig = rig_at(rig, [p for p, _ in back], np.array([c for _, c in back]))
    return rig, seen


def problem_of(rig: Rig, recordings: list[Recording], step: Step, workers: int | None) -> Problem:
    """The problem that a step solves.

    Recordings begin as they are found to with the rig as it is. What its cells may get wrong is
    known to it once that decides: far from the rig it is not what is wrong, a little ahead it is
    not seen.

    Args:
        rig: The rig.
        recordings: The recordings.
        step: The step.
        workers: Threads of a batch.
    """
    if step.part:
        part_s = max(APPROACH_S / len(recordings), LEAST_S)
        recordings = [r.until(part_s) for r in recordings]
    dx_m = None if step.dx_m == rig.grid.dx_m else step.dx_m
    problem = make_problem(rig, recordings, pull_s=step.pull_s, dx_m=dx_m, workers=workers)
    if step.corrected:
        problem.prepare(rig)
        own = problem.with_grid(rig.grid.dx_m).predict([rig])[0]
        problem.grid_pa = own - problem.predict([rig])[0]
        problem.doubt_cells(rig, own)
    elif dx_m is None and step.pull_s is None and not step.part:
        problem.doubt_cells(rig)
    return problem


def centred(
    rig: Rig, parameters: list[FitParameter], centres: dict[tuple[str, str | None], float]
) -> list[Variable]:
    """Variables of an estimation that starts at a rig, with the datasheet as the prior's centre.

    Args:
        rig: The rig.
        parameters: What is estimated.
        centres: Centre by path and recording.
    """
    out = []
    for v, p in zip(variables_of(rig, parameters), parameters, strict=True):
        centre = centres[p.path, p.recording]
        out.append(replace(v, centre=centre, std=std_inside(p, centre)))
    return out


def take(
    rig: Rig,
    problem: Problem,
    parameters: list[FitParameter],
    centres: dict[tuple[str, str | None], float],
    used: Mask,
    iterations: int,
    robust: bool,
    told: Callable[[int], Callable[[float], None]] | None = None,
    slope: Floats | None = None,
    mirrors: Mirrors | None = None,
    bends: Bends | None = None,
    along: bool = False,
) -> tuple[Rig, Estimate, Bends]:
    """Takes one step: the rig after it, the estimate, and how much opening curves bend by it.

    Args:
        rig: The rig.
        problem: The problem.
        parameters: What is estimated.
        centres: Centre of the prior by path and recording.
        used: (n_stretches,) stretches to use.
        iterations: At most so many.
        robust: Whether outliers weigh less.
        told: See `residual_function`.
        slope: Jacobian to begin with, where it is known.
        mirrors: Opening curves that are about the mirrors of others.
        bends: How much opening curves bend, as far as that is known.
        along: Whether what the recordings hardly show is looked along.
    """
    variables = centred(rig, parameters, centres)
    both = along and bool(rig.bodies)  # pistons come to covers, and joints to stops
    if both:
        variables = in_short_steps(variables, parameters)
    estimate = minimise(
        residual_function(problem, used, partial(rig_at, rig, parameters), told),
        variables,
        iterations=iterations,
        robust=robust,
        ties=curve_ties(rig, parameters, mirrors, bends)[:2],
        secants=SECANTS,
        slope=slope,
        along=along,
        both=both,
    )
    after = rig_at(rig, parameters, estimate.values)
    return after, estimate, bends_told(estimate, variables, curve_ties(after, parameters, mirrors))


def start_of(rig: Rig, parameters: list[FitParameter]) -> list[float]:
    """Value of each parameter in a rig, within its bounds.

    Args:
        rig: The rig.
        parameters: The parameters.
    """
    return [float(np.clip(value_of(rig, p), p.lower, p.upper)) for p in parameters]
