# SPDX-License-Identifier: Apache-2.0
"""A rig and recordings made ready for the search of what is missing: the dear part, done once."""

from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pneu_sim.models import kind_of
from pneu_sim.rig.schema import Rig
from pneu_sysid.candidates import Project, Sensitivity, residual_matrix, sensitivities
from pneu_sysid.compare import grid_check
from pneu_sysid.evidence import blocks_of
from pneu_sysid.nuisance import nuisance_of
from pneu_sysid.problem import Problem, make_problem
from pneu_sysid.records import Recording
from pneu_sysid.results.compare import Numerics
from pneu_sysid.sites import all_sites
from pneu_sysid.spectrum import lines_of
from pneu_sysid.standing import Standing, standing_of
from pneu_sysid.thresholds import Thresholds

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

GRID_S = 5.0
"""So much of each recording tells whether the grid is fine enough."""
REFIT_CELLS, SCORE_CELLS = 2.0, 4.0
"""Candidates are refitted and scored on cells so many times as long: only what they change of the
prediction counts..."""
FAITHFUL = 0.3
"""... as long as an effect changes what the longer cells get wrong by less than this share of the
noise at every tap; else it is fitted on the rig's own. A volume on a few long cells is another."""


@dataclass
class Bench:
    """What stays the same while one effect after another is tried on a rig.

    Attributes:
        rig: The rig as it was given.
        problem: The problem, on the rig's own cells.
        readings: (n_stretches, horizon, n_taps) what the rig predicts, Pa.
        standing: How it stands to the recordings.
        known: What each candidate changes of the prediction.
        project: Takes out of residuals what is uncertain anyway; None where nothing is.
        blocks: (n_stretches, m) block of time of each reading.
        thresholds: What decides.
        numerics: The check of the grid, once it is done.
        grid_pa: (n_stretches, horizon, n_taps) what longer cells get wrong about the rig, Pa; None
            where that was not needed so far.
    """

    rig: Rig
    problem: Problem
    readings: Floats = field(repr=False)
    standing: Standing
    known: list[Sensitivity] = field(repr=False)
    project: Project | None
    blocks: Ints = field(repr=False)
    thresholds: Thresholds
    numerics: "Future[Numerics | None]" = field(repr=False)
    grid_pa: Floats | None = field(default=None, repr=False)

    def residual(self, readings: Floats) -> Floats:
        """(n_stretches, m) residual in noise deviations, without what is uncertain anyway.

        Args:
            readings: (n_stretches, horizon, n_taps) predictions, Pa.
        """
        r = residual_matrix(self.problem, readings)
        return r if self.project is None else self.project(r)

    def held_sum(self, residual: Floats) -> float:
        """Squared error on what verdicts are judged on.

        Args:
            residual: (n_stretches, m) in noise deviations, without what is uncertain anyway.
        """
        return float(np.sum(residual[self.held_out] ** 2))

    def unexplained(self, residual: Floats) -> bool:
        """Whether something is missing, on what is kept aside or over all, whatever explains it.

        Args:
            residual: (n_stretches, m) in noise deviations, without what is uncertain anyway.
        """
        limit = self.thresholds.unexplained
        count = np.isfinite(self.problem.measured).sum(axis=(0, 1))
        whole = float(np.sum(count * self.standing.floor**2))
        return (
            self.held_sum(residual) > limit * self.floor
            or float(np.sum(residual**2)) > limit * whole
        )

    def allowed(self, before: float) -> float:
        """Squared error that an answer may leave there.

        Args:
            before: What there was.
        """
        limits = self.thresholds
        return max(limits.unexplained * self.floor, limits.relative**2 * before)

    def coarser(self, rig: Rig, readings: Floats | None = None) -> Problem:
        """The problem that effects are refitted on.

        Args:
            rig: The rig about which they are.
            readings: What it predicts on its own cells, where that is known.
        """
        if not kind_of(rig).along_lines:
            return self.problem
        longer = self.problem.coarsened(rig, REFIT_CELLS, readings)
        if rig is self.rig:
            self.grid_pa = longer.grid_pa
        return longer

    @property
    def doubtful(self) -> Floats | None:
        """(n_stretches, m) what cells of twice the length get wrong about the rig, in noise units.

        About as much as its own do near fronts, which they smear. None where that is not known.
        """
        if self.grid_pa is None:
            return None
        wrong = self.grid_pa / self.problem.noise_pa
        wrong = np.where(np.isfinite(self.problem.measured), wrong, 0.0)
        flat = np.nan_to_num(wrong).reshape(self.problem.stretches, -1)
        return flat if self.project is None else np.asarray(self.project(flat))

    def faithful(self, rig: Rig, readings: Floats) -> tuple[Problem, Floats]:
        """The problem that effects of a rig are fitted on in the end: longer cells if they may be.

        Args:
            rig: The rig.
            readings: What it predicts on its own cells.

        Returns:
            That, and (n_stretches, m) what the effects change of what longer cells get wrong, in
            noise deviations: cells as long as the rig's get some of it wrong too.
        """
        none = np.zeros((self.problem.stretches, readings[0].size))
        longer = self.coarser(rig, readings)
        if longer.grid_pa is None:
            return self.problem, none
        if self.grid_pa is None:
            self.coarser(self.rig, self.readings)
        assert self.grid_pa is not None
        wrong = (longer.grid_pa - self.grid_pa) / self.problem.noise_pa
        wrong = np.where(np.isfinite(self.problem.measured), wrong, np.nan)
        share = np.sqrt(np.nanmean(wrong**2, axis=(0, 1)))
        chosen = longer if np.nanmax(share) < FAITHFUL else self.problem
        return chosen, np.nan_to_num(wrong).reshape(none.shape)

    @property
    def held_out(self) -> NDArray[np.bool_]:
        """(n_stretches,) stretches that verdicts are judged on; all where none is kept aside."""
        return self.problem.judged

    @property
    def readings_held(self) -> int:
        """Number of readings that verdicts are judged on."""
        return int(np.isfinite(self.problem.measured[self.held_out]).sum())

    @property
    def floor(self) -> float:
        """Squared error that is to be expected on them: what the calibration left, or noise."""
        count = np.isfinite(self.problem.measured[self.held_out]).sum(axis=(0, 1))
        return float(np.sum(count * self.standing.floor**2))


def bench_of(
    rig: Rig,
    recording: Recording | Sequence[Recording],
    refine: bool,
    workers: int | None,
    tell: Callable[[str, float], None],
    thresholds: Thresholds,
    without: Collection[str],
    aside: Sequence[tuple[float, float]] = (),
) -> Bench:
    """Makes a rig and recordings ready for the search.

    Args:
        rig: The rig.
        recording: The recording, or several.
        refine: Check the grid.
        workers: Threads of a batch.
        tell: Called with a stage's name and the fraction done.
        thresholds: What decides.
        without: Names of effects that are not tried.
        aside: Parts that are kept aside, see `make_problem`.
    """
    tell("base", 0.0)
    problem = make_problem(rig, recording, workers=workers, aside=aside)
    # The check of the grid is one long run; it fills what the search leaves of the processor.
    checking = ThreadPoolExecutor(1)
    numerics = checking.submit(_grid, problem, rig, refine)
    checking.shutdown(wait=False)
    readings = problem.predict([rig])[0]
    problem = problem.keeping_alike(residual_matrix(problem, readings))
    rough = problem
    if kind_of(rig).along_lines:
        rough = problem.coarsened(rig, SCORE_CELLS, readings)
    nuisance = nuisance_of(rig, rough)
    lines = lines_of(problem, residual_matrix(problem, readings))
    pulses_hz = lines[0].frequency_hz if lines and lines[0].share >= thresholds.pulses else None
    sites = all_sites(rig, without=without, pulses_hz=pulses_hz)
    known = sensitivities(rough, rig, sites, thresholds, lambda f: tell("scores", f))
    return Bench(
        rig=rig,
        problem=problem,
        readings=readings,
        standing=standing_of(rig, problem, residual_matrix(problem, readings), thresholds),
        known=known,
        project=None
        if nuisance is None
        else nuisance.without(np.ones(problem.stretches, dtype=bool)),
        blocks=blocks_of(problem, thresholds.block),
        thresholds=thresholds,
        numerics=numerics,
    )


def _grid(problem: Problem, rig: Rig, refine: bool) -> Numerics | None:
    """Whether the grid is fine enough, where that is asked and there is one.

    The beginning of long recordings tells it: shorter cells cost four times as much.
    """
    if not refine or not kind_of(rig).along_lines:
        return None
    part = [recording.until(min(GRID_S, recording.end_s)) for recording in problem.recordings]
    problem = make_problem(rig, part, workers=problem.workers)
    readings = problem.predict([rig])[0]
    compared = {
        tap: readings[:, :, k]
        for k, tap in enumerate(problem.taps)
        if np.isfinite(problem.measured[:, :, k]).any()
    }
    return grid_check(problem, rig, compared)
