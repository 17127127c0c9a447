# SPDX-License-Identifier: Apache-2.0
"""Recordings and a rig as one estimation problem: what is predicted, when, and what is held out.

A model runs along each recording without a break and is read at the sensors' own times. What its
equations do not know of the gas (how warm it is, how much of it there is after seconds of small
errors) is drawn slowly to the taps, so that a reading is predicted from about one horizon before
it. An exact model loses nothing by that: what the pull takes up of the sensors' noise is a few
percent of it at the worst. See docs/residual.md.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim import layout as L
from pneu_sim.models import kind_of
from pneu_sim.rig import rig_in_recording
from pneu_sim.rig.build import build
from pneu_sim.rig.model import Model
from pneu_sim.rig.plan import Plan, plan_grid
from pneu_sim.rig.schema import Rig
from pneu_sim.simulate import (
    TICK_S,
    Course,
    InitialField,
    Prediction,
    RunOptions,
    initial_field,
    predict,
)
from pneu_sim.topics import encoder_channel
from pneu_sysid.cells import HALF, WHOLE, without_doubt
from pneu_sysid.courses import course_of, edges_of, first_part, index_of
from pneu_sysid.records import Recording, begins_of, noise_floor, read_recording
from pneu_sysid.start import (
    Beginning,
    Modes,
    beginnings,
    carried,
    doubt_of,
    modes_of,
    moved,
    remembered_s,
)
from pneu_sysid.units import checked

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

HELD_OUT_EVERY = 3
"""Every third stretch is kept aside; of three recordings or more, every third recording."""
TRIED_S = 0.3
"""Over this time the ways in which a recording may begin are tried."""
FEWEST_TRIED = 6
"""... or over this many readings of the slowest tap."""
FINEST = 1e-4
"""Share of the largest reading to which no sensor is trusted to tell a model of this kind wrong:
cells alone get more wrong. An encoder without noise, simulated or of 20 bits, would count a hundred
times what any pressure does, and a fit from a datasheet would end 50 times the noise off."""
LOOKS = 2
"""Times that the beginning is looked for: once from the room's temperature, once around it."""
LATER = 3.0
"""What a model leaves later on tells how far it may be trusted at the beginning: so many times as
late as the beginning is remembered."""


@dataclass(frozen=True)
class Rollouts:
    """What rigs predict.

    Attributes:
        readings: (n_rigs, n_stretches, horizon, n_taps) readings at their own times, Pa; NaN where
            a stretch has no such reading.
        along: Per recording all that was predicted along it.
    """

    readings: Floats
    along: list[Prediction]


@dataclass
class Problem:
    """Everything about recordings that does not change with the parameters.

    Arrays over readings have the shape (n_stretches, horizon, n_taps): the k-th reading of each tap
    in each stretch, NaN where a stretch has fewer. The stretches of all recordings follow one
    another.

    Attributes:
        recordings: The recordings.
        taps: Names of the taps that are compared.
        time_s: When each reading was taken, s.
        measured: What was read, Pa.
        noise_pa: (n_taps,) sensor noise floor.
        noise_words: Per tap what is to be said of its noise floor, where it is in doubt.
        of: (n_stretches,) recording that each stretch belongs to.
        span_s: (n_stretches, 2) when each begins and ends, s.
        pull_s: Time constant with which the gas is drawn to the taps; None lets it run free.
        dx_m: Cell length; None is the rig's own.
        workers: Threads of a batch; None is one per core.
        grid_pa: (n_stretches, horizon, n_taps) what a finer grid adds to every prediction, Pa.
        doubt_pa: (n_stretches, horizon, n_taps) one deviation of what the rig's own cells may get
            wrong, in the units of the sensors; None where nothing is known of that.
        fewest_cells: Cells that the shortest pipe has at least.
        aside: (n_stretches,) which stretches are kept aside; None is every third.
    """

    recordings: list[Recording]
    taps: list[str]
    time_s: Floats
    measured: Floats
    noise_pa: Floats
    noise_words: dict[str, str]
    of: Ints
    span_s: Floats
    pull_s: float | None
    dx_m: float | None = None
    workers: int | None = None
    grid_pa: Floats | None = None
    doubt_pa: Floats | None = None
    fewest_cells: int = 2
    aside: NDArray[np.bool_] | None = None
    _courses: list[Course] = field(default_factory=list, repr=False)
    _from: list[Ints] = field(default_factory=list, repr=False)
    _in_doubt: list[int] = field(default_factory=list, repr=False)
    _prepared: dict[str, "_Prepared"] = field(default_factory=dict, repr=False)
    _finer: dict[str, "_Prepared"] = field(default_factory=dict, repr=False)

    @property
    def name(self) -> str:
        """Names of the recordings in one line."""
        return ", ".join(recording.name for recording in self.recordings)

    @property
    def stretches(self) -> int:
        """Number of stretches."""
        return int(self.of.size)

    @property
    def horizon(self) -> int:
        """Most readings of a tap in a stretch."""
        return int(self.time_s.shape[1])

    @property
    def held_out(self) -> NDArray[np.bool_]:
        """(n_stretches,) which stretches are kept aside."""
        if self.aside is not None:
            return self.aside
        return np.asarray(self._apart % HELD_OUT_EVERY == HELD_OUT_EVERY - 1)

    @property
    def judged(self) -> NDArray[np.bool_]:
        """(n_stretches,) stretches that verdicts are judged on: all where none is held out."""
        held = self.held_out
        return held if held.any() else np.ones_like(held)

    @property
    def _apart(self) -> Ints:
        """(n_stretches,) what is kept aside as a whole: a recording if there are several."""
        return self.of if len(self.recordings) >= HELD_OUT_EVERY else np.arange(self.stretches)

    def keeping_alike(self, residual: Floats) -> "Problem":
        """The same problem, what is kept aside as badly predicted as what is not.

        An effect may be felt in few stretches: with every third kept aside it could be in none of
        them. Of every three in the order of their errors the middle one is. What was chosen to be
        kept aside stays so.

        Args:
            residual: (n_stretches, m) in noise deviations.
        """
        if self.aside is not None:  # somebody chose
            return self
        of = self._apart
        groups = range(int(of.max()) + 1)
        count = np.isfinite(self.measured).sum(axis=(1, 2))
        square = np.sum(residual**2, axis=1)
        mean = [square[of == g].sum() / max(int(count[of == g].sum()), 1) for g in groups]
        chosen = np.argsort(-np.array(mean), kind="stable")[1::HELD_OUT_EVERY]
        return replace(self, aside=np.isin(of, chosen))

    def target(self) -> Floats:
        """(n_stretches, horizon, n_taps) measured readings."""
        return self.measured

    def periods_s(self) -> Floats:
        """(n_taps,) median time between the readings of each tap, s."""
        with np.errstate(invalid="ignore"):
            steps = np.diff(self.time_s, axis=1)
        return np.array(
            [
                np.median(column) if (column := s[np.isfinite(s)]).size else TICK_S
                for s in np.moveaxis(steps, -1, 0)
            ]
        )

    def simulate(
        self,
        rigs: Sequence[Rig],
        progress: Callable[[float], None] | None = None,
        strict: bool = True,
        flows: bool = False,
    ) -> Rollouts:
        """Runs rigs along the recordings, in one batch.

        Args:
            rigs: Rigs of one structure and one ``model``.
            progress: Called with the fraction done.
            strict: Whether an unstable simulation is an error; else its predictions are not finite.
            flows: Whether flows and chamber pressures are kept too.

        Returns:
            The predictions.
        """
        ready = self._prepare(rigs[0])
        every = range(len(self.recordings))
        along = self._run(rigs, ready, ready.courses, every, progress, strict, flows)
        readings = np.concatenate(
            [self._arranged(p.readings, c) for c, p in enumerate(along)], axis=1
        )
        if self.grid_pa is not None:
            readings += self.grid_pa
        return Rollouts(self._without_start(readings, ready), along)

    def predict(
        self, rigs: Sequence[Rig], progress: Callable[[float], None] | None = None
    ) -> Floats:
        """(n_rigs, n_stretches, horizon, n_taps) predicted readings, Pa.

        Args:
            rigs: Rigs of one structure.
            progress: Called with the fraction done.
        """
        return self.simulate(rigs, progress=progress).readings

    def residual(self, readings: Floats) -> Floats:
        """Measured minus predicted, weighed (`weighed`); 0 where nothing was measured.

        Args:
            readings: (..., n_stretches, horizon, n_taps) predictions.
        """
        return self.weighed(self.measured - readings)

    def weighed(self, error: Floats) -> Floats:
        """Errors in units of each sensor's noise, without what cells are found to get wrong.

        Args:
            error: (..., n_stretches, horizon, n_taps); what was not measured counts for nothing.
        """
        missing = ~np.isfinite(self.measured)
        r = np.where(missing, 0.0, error / self.noise_pa)
        if self.doubt_pa is None:
            return r
        return without_doubt(r, np.where(missing, 0.0, self.doubt_pa / self.noise_pa))

    def doubt_cells(self, rig: Rig, readings: Floats | None = None) -> None:
        """Finds what the cells of a rig may get wrong: a part of what halving them changes.

        Args:
            rig: The rig.
            readings: (n_stretches, horizon, n_taps) what it predicts on its own cells, where that
                is known.
        """
        if not kind_of(rig).along_lines:
            return
        self._prepare(rig)
        own = self.with_grid(rig.grid.dx_m)
        with ThreadPoolExecutor(1) as pool:  # beside the run on the rig's own
            halved = pool.submit(self.with_grid(HALF * rig.grid.dx_m).predict, [rig])
            known = own.predict([rig])[0] if readings is None else readings
            self.doubt_pa = WHOLE * (halved.result()[0] - known)

    def wrong_of_cells(self, rigs: Sequence[Rig]) -> tuple[Floats, Floats]:
        """What rigs predict on cells as they are, and what these get wrong of it (`cells`), Pa.

        Args:
            rigs: Rigs of one structure.

        Returns:
            Both (n_rigs, n_stretches, horizon, n_taps), the second to be added to the first.
        """
        self._prepare(rigs[0])
        dx_m = self.dx_m or rigs[0].grid.dx_m
        own = self.with_grid(dx_m)
        with ThreadPoolExecutor(1) as pool:  # beside the run on cells as they are
            halved = pool.submit(self.with_grid(HALF * dx_m).predict, rigs)
            readings = own.predict(rigs)
            return readings, WHOLE * (halved.result() - readings)

    def mended(self, rig: Rig) -> "Problem":
        """The same problem, what its cells get wrong of a rig made good.

        Of rigs near that one it is good to a fraction, unlike what another one's cells get wrong: a
        volume is smeared over the cell that it is in.

        Args:
            rig: The rig.
        """
        return replace(self, grid_pa=self.wrong_of_cells([rig])[1][0])

    def with_grid(self, dx_m: float) -> "Problem":
        """The same problem on another grid; recordings begin there as they were found to here.

        Args:
            dx_m: Cell length that replaces the rig's.
        """
        return replace(self, dx_m=dx_m, grid_pa=None, _prepared={}, _finer=dict(self._prepared))

    def coarsened(self, rig: Rig, factor: float, readings: Floats | None = None) -> "Problem":
        """The same problem on longer cells, whose error at a rig is made good.

        What changes between this rig and another is told by the longer cells, which cost a
        fraction; the rig itself is predicted as it is on its own. A short pipe may become a single
        cell: with two, it alone would hold the time steps of all down.

        Args:
            rig: The rig.
            factor: By how much longer.
            readings: (n_stretches, horizon, n_taps) its predictions on this grid, where they are
                known.
        """
        self._prepare(rig)
        out = self.with_grid(factor * (self.dx_m or rig.grid.dx_m))
        out.fewest_cells = 1
        with ThreadPoolExecutor(1) as pool:  # beside the run on this grid
            coarse = pool.submit(out.predict, [rig])
            fine = self.predict([rig])[0] if readings is None else readings
            out.grid_pa = fine - coarse.result()[0]
        return out

    def prepare(self, rig: Rig) -> None:
        """Finds how each recording begins with a rig; all later rigs of its structure begin alike.

        Args:
            rig: The rig.
        """
        self._prepare(rig)

    def _prepare(self, rig: Rig) -> "_Prepared":
        """Grid of a structure, and how each recording begins, found with the first rig that has it.

        All later rigs of that structure begin alike, so that their predictions can be compared.
        """
        key = rig.model + ",".join(f"{n}:{p.from_node}:{p.to_node}" for n, p in rig.pipes.items())
        if key in self._prepared:
            return self._prepared[key]
        plan = plan_grid(rig, self.dx_m, self.fewest_cells)
        ready = _Prepared(plan, initial_field(rig, plan, through_orifices=False), [], [])
        found = self._finer.get(key)
        if found is not None:
            ready.courses[:] = [
                replace(course, start=carried(course.start, found.plan, plan))
                for course in found.courses
            ]
            ready.modes[:] = found.modes
            self._prepared[key] = ready
            return ready
        filled = initial_field(rig, plan)
        chosen = [self._begun(rig, ready, filled, c) for c in range(len(self.recordings))]
        ready.courses[:] = [
            replace(course, begin_s=b.begin_s, start=b.start)
            for course, b in zip(self._courses, chosen, strict=True)
        ]
        self._settle_noise(rig, ready)
        ready.modes[:] = [None] * len(chosen)
        if kind_of(rig).along_lines and rig.fit.horizon_s is not None:
            for c in range(len(chosen)):
                self._look_back(rig, ready, c)
        self._prepared[key] = ready
        return ready

    def _begun(self, rig: Rig, ready: "_Prepared", filled: InitialField, c: int) -> Beginning:
        """The way of beginning after which a rig follows the first readings best."""
        ways = beginnings(rig, ready.plan, filled, self.recordings[c])
        if len(ways) == 1:
            return ways[0]
        course = self._courses[c]
        slowest = max(s.period_s for s in self.recordings[c].readings.values())
        until = max(TRIED_S, FEWEST_TRIED * slowest if np.isfinite(slowest) else 0.0)
        costs = []
        for way in ways:
            tried = first_part(replace(course, begin_s=way.begin_s, start=way.start), until)
            along = self._run([rig], ready, [tried], [c], None, False, False)
            r = (tried.measured - along[0].readings[0]) / self.noise_pa[:, None]
            r = r[np.isfinite(tried.measured)]
            # (a few wild readings must not decide)
            costs.append(float(np.sum(np.log1p(np.where(np.isfinite(r), r * r, np.inf)))))
        return ways[int(np.argmin(costs))]

    def _settle_noise(self, rig: Rig, ready: "_Prepared") -> None:
        """Looks for the noise in what a model leaves, where the signal's motion hides it."""
        if not self._in_doubt:
            return
        every = range(len(self.recordings))
        along = self._run([rig], ready, ready.courses, every, None, False, False)
        for t in list(self._in_doubt):
            found = []
            for course, out in zip(ready.courses, along, strict=True):
                left = course.measured[t] - out.readings[0, t]
                good = np.isfinite(left)
                if good.sum() > 2 * FEWEST_TRIED:
                    found.append(noise_floor(course.time_s[t, good], left[good]))
            if found and (least := min(f.sigma_pa for f in found)) < self.noise_pa[t]:
                largest = float(np.nanmax(np.abs(self.measured[..., t])))
                self.noise_pa[t] = max(least, FINEST * largest)
            if found and not all(f.motion for f in found):
                self.noise_words.pop(self.taps[t], None)
        self._in_doubt.clear()

    def _look_back(self, rig: Rig, ready: "_Prepared", c: int) -> None:
        """Finds how a recording most likely began, and how its predictions depend on that."""
        rig = rig_in_recording(rig, self.recordings[c].name)
        model = build(rig, ready.plan)
        course = ready.courses[c]
        mine = self.of == c
        seen = np.isfinite(self.measured[mine])
        walls = model.chamber[:, L.C_WALL_T]
        remembered = remembered_s(rig, course.start)
        until = course.begin_s + (1.0 + LATER) * remembered
        # A model that lacks something must not make up for it with gas that was hotter or colder
        # at the beginning than it was.
        before = self._left(model, ready, course, c, until)
        doubt = doubt_of(before, course.time_s[:, : before.shape[1]] > course.begin_s + remembered)
        for again in range(LOOKS):
            wanted = modes_of(
                rig, ready.plan, course.start, self.taps, self.noise_pa, self.recordings[c]
            )
            short = first_part(course, course.begin_s + remembered)
            starts = [course.start, *(mode.start for mode in wanted)]
            options = RunOptions(self.workers, strict=False)
            out = predict([[model] * len(starts)], [short], ready.field, [starts], options)[0]
            reached = out.readings.shape[2]
            along = np.full((len(starts), *course.time_s.shape), np.nan)
            along[:, :, :reached] = out.readings
            at = self._arranged(along, c)
            step = np.array([mode.step for mode in wanted])[:, None, None, None]
            change = (at[1:] - at[:1]) / (self.noise_pa * step)
            known = seen & np.isfinite(change).all(axis=0)
            modes = Modes(np.where(known, change, 0.0), np.array([m.std for m in wanted]), doubt)
            ready.modes[c] = modes
            if again == LOOKS - 1:
                break
            r = np.where(known, (self.measured[mine] - at[0]) / self.noise_pa, 0.0)
            amounts = modes.amounts(r[None])[0]
            start = moved(course.start, wanted, amounts, rig.ambient.temperature_k, walls)
            course = replace(course, start=start)
        after = self._left(model, ready, course, c, until)
        if np.sum(after**2) < np.sum(before**2):
            ready.courses[c] = course
        else:
            ready.modes[c] = None

    def _left(
        self, model: Model, ready: "_Prepared", course: Course, c: int, until_s: float
    ) -> Floats:
        """(n_taps, m) residual of a model along the first part of a course, in noise deviations.

        0 where nothing is compared.
        """
        part = first_part(course, until_s)
        options = RunOptions(self.workers, strict=False)
        out = predict([[model]], [part], ready.field, None, options)[0]
        left = (part.measured - out.readings[0]) / self.noise_pa[:, None]
        compared = np.isfinite(left) & (part.time_s >= self.span_s[self.of == c, 0].min())
        return np.where(compared, left, 0.0)

    def _run(
        self,
        rigs: Sequence[Rig],
        ready: "_Prepared",
        courses: list[Course],
        of: Sequence[int],
        progress: Callable[[float], None] | None,
        strict: bool,
        flows: bool,
    ) -> list[Prediction]:
        own: list[Sequence[Rig]] = [rigs] * len(courses)
        if any(rig.recordings for rig in rigs):
            own = [[rig_in_recording(rig, self.recordings[c].name) for rig in rigs] for c in of]
        options = RunOptions(self.workers, progress, strict, flows)
        return kind_of(rigs[0]).predict(own, ready.plan, courses, ready.field, options)

    def _arranged(self, readings: Floats, c: int) -> Floats:
        """(K, n_taps, m) values along a recording as (K, its stretches, horizon, n_taps)."""
        index = self._from[c]
        out = np.full((readings.shape[0], *index.shape), np.nan)
        for t in range(index.shape[2]):
            has = index[:, :, t] >= 0
            out[:, :, :, t][:, has] = readings[:, t][:, index[:, :, t][has]]
        return out

    def _without_start(self, readings: Floats, ready: "_Prepared") -> Floats:
        """Predictions after what is not known of the beginning was taken from the readings."""
        for c, modes in enumerate(ready.modes):
            if modes is None:
                continue
            mine = self.of == c
            r = np.where(
                np.isfinite(self.measured[mine]),
                (self.measured[mine] - readings[:, mine]) / self.noise_pa,
                0.0,
            )
            readings[:, mine] += modes.explain(r) * self.noise_pa
        return readings


@dataclass
class _Prepared:
    """Grid of a structure and how each recording begins."""

    plan: Plan
    field: InitialField
    courses: list[Course]
    modes: list[Modes | None]


def record_for(
    rig: Rig, path: str, start_s: float | None = None, end_s: float | None = None
) -> Recording:
    """Reads the recording of a rig: its commands, tap pressures and measured spool positions.

    Args:
        path: Bag or text file.
        rig: Rig whose channels say where the signals are.
        start_s: Start of the part to keep, in s after the start of the recording.
        end_s: End of the part to keep, in s after the start of the recording.

    Raises:
        InputError: The recording cannot be read as the rig describes, or is in other units.
    """
    commands = {n: c.channel for n, c in rig.commands.items() if c.channel is not None}
    missing = set(rig.commands) - set(commands)
    if missing:
        raise InputError(f"rig {rig.name!r}: commands.{sorted(missing)[0]} has no channel to read")
    pressures = {n: t.channel for n, t in rig.taps.items() if t.channel is not None}
    encoders = {name: encoder_channel(rig, name) for name in rig.encoders}
    if not pressures and not encoders:
        raise InputError(f"rig {rig.name!r}: no tap has a channel, so nothing can be compared")
    recording = read_recording(
        path,
        commands=commands,
        pressures=pressures,
        text=rig.text,
        rate_hz=rig.rate_hz,
        start_s=start_s,
        end_s=end_s,
        positions={n: v.position for n, v in rig.valves.items() if v.position is not None},
        encoders=encoders,
    )
    return checked(rig, str(path), recording)


def pull_of(rig: Rig) -> float | None:
    """Time constant with which the gas of a rig is drawn to its taps, s; None lets it run free.

    A constant error of the flow then makes the error of pressure that it makes, root mean square,
    in runs of the horizon's length that each begin with the right pressure (thesis 8.1.2).

    Args:
        rig: The rig.
    """
    if rig.fit.nudge_s is not None or rig.fit.horizon_s is None:
        return rig.fit.nudge_s
    return float(rig.fit.horizon_s / np.sqrt(3.0))


def make_problem(
    rig: Rig,
    source: Recording | Sequence[Recording],
    pull_s: float | None = None,
    dx_m: float | None = None,
    workers: int | None = None,
    aside: Sequence[tuple[float, float]] = (),
) -> Problem:
    """Lays out how a rig is compared with recordings.

    Args:
        rig: The rig; its ``fit`` section sets the horizon.
        source: The recordings.
        pull_s: Replaces the rig's time constant of the pull to the taps.
        dx_m: Replaces the rig's cell length.
        workers: Threads of a batch.
        aside: Parts to be kept aside, from and to, s of the recordings one after the other
            (`begins_of`); every third stretch unless there is one.

    Raises:
        InputError: There is no recording, or one is too short, or parts to be kept aside are none
            or all of the stretches.
    """
    recordings = [source] if isinstance(source, Recording) else list(source)
    if not recordings:
        raise InputError(f"rig {rig.name!r}: no recording was given, at least one is needed")
    taps = [*rig.taps, *rig.encoders]
    pull = pull_s or pull_of(rig)
    lead = rig.fit.warm_up_s if rig.fit.horizon_s is not None else 0.0
    problem = Problem(
        recordings=recordings,
        taps=taps,
        time_s=np.empty(0),
        measured=np.empty(0),
        noise_pa=np.empty(len(taps)),
        noise_words={},
        of=np.empty(0, dtype=np.int64),
        span_s=np.empty((0, 2)),
        pull_s=pull,
        dx_m=dx_m,
        workers=workers,
    )
    _set_noise(problem, rig)
    parts = []
    for recording in recordings:
        course = course_of(recording, taps, pull)
        edges = edges_of(recording, rig.fit.horizon_s, lead)
        problem._courses.append(course)
        parts.append((course, edges, index_of(course, edges)))
    most = max(index.shape[1] for _, _, index in parts)
    times, values, spans, of = [], [], [], []
    for c, (course, edges, index) in enumerate(parts):
        wide = np.full((index.shape[0], most, len(taps)), -1, dtype=np.int64)
        wide[:, : index.shape[1]] = index
        problem._from.append(wide)
        times.append(problem._arranged(course.time_s[None], c)[0])
        values.append(problem._arranged(course.measured[None], c)[0])
        spans.append(np.stack([edges[:-1], edges[1:]], axis=1))
        of += [c] * index.shape[0]
    problem.time_s, problem.measured = np.concatenate(times), np.concatenate(values)
    problem.span_s, problem.of = np.concatenate(spans), np.array(of, dtype=np.int64)
    if aside:
        problem.aside = _kept_aside(problem, aside)
    return problem


def _kept_aside(problem: Problem, parts: Sequence[tuple[float, float]]) -> NDArray[np.bool_]:
    """(n_stretches,) those whose middle lies in one of the parts."""
    begins = np.array(begins_of(problem.recordings))
    middle = problem.span_s.mean(axis=1) + begins[problem.of]
    kept = np.zeros(problem.stretches, dtype=bool)
    for begin_s, end_s in parts:
        kept |= (middle >= begin_s) & (middle <= end_s)
    if not kept.any() or kept.all():
        named = ", ".join(f"{begin_s:g} to {end_s:g} s" for begin_s, end_s in parts)
        raise InputError(
            f"kept aside: found {named}, which is {'all' if kept.any() else 'none'} of the"
            f" {problem.stretches} stretches; at least one is needed on either side"
        )
    return kept


def _set_noise(problem: Problem, rig: Rig) -> None:
    """Noise of each sensor: what the rig says of it, else an estimate from the readings."""
    told = [(tap.noise_pa, tap.quantum_pa) for tap in rig.taps.values()]
    told += [(encoder.noise, encoder.quantum) for encoder in rig.encoders.values()]
    of_pressures = _scale(problem.recordings, list(rig.taps))
    for t, (name, (white, quantum)) in enumerate(zip(problem.taps, told, strict=True)):
        scale = of_pressures if name in rig.taps else _scale(problem.recordings, [name])
        noise = 0.0
        if white > 0.0:
            noise = float(np.hypot(white, quantum / np.sqrt(12.0)))
        else:
            found = [
                noise_floor(s.time_s, s.values)
                for r in problem.recordings
                if (s := r.readings.get(name)) is not None and len(s) > FEWEST_TRIED
            ]
            if found:
                noise = float(np.median([f.sigma_pa for f in found]))
                if all(f.motion for f in found):
                    problem._in_doubt.append(t)
                    problem.noise_words[name] = found[0].sentence
            else:
                noise = 0.0 if name in rig.encoders else 1.0
        problem.noise_pa[t] = max(noise, FINEST * scale)


def _scale(recordings: list[Recording], sensors: list[str]) -> float:
    """The largest of all readings of some sensors."""
    largest = [
        float(np.max(np.abs(s.values)))
        for r in recordings
        for name, s in r.readings.items()
        if name in sensors and len(s)
    ]
    return max(largest, default=0.0) or 1.0
