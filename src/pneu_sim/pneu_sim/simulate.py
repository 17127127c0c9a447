# SPDX-License-Identifier: Apache-2.0
"""Running models along recordings: many parameter sets at once, read at the sensors' own times."""

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pneu_common.tally import Tally
from pneu_sim import layout as L
from pneu_sim.device import Device, chosen
from pneu_sim.rig.cells import middles
from pneu_sim.rig.expand import with_cylinders
from pneu_sim.rig.model import S_BIAS, S_GAIN, S_LAG, S_OFFSET, Model
from pneu_sim.rig.network import reservoir_of_pipes
from pneu_sim.rig.plan import Plan
from pneu_sim.rig.schema import CLOSED, Rig
from pneu_sim.signals import Signal
from pneu_sim.spool import MEMORY
from pneu_sim.stepping import MORE_STEPS, advance, finite_lanes, unstable
from pneu_sim.tile import (
    Tile,
    Watch,
    fill_chambers,
    fill_pipes,
    lanes,
    pack,
    place_joints,
    reachable,
)
from pneu_sim.valve import openings_along

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

TILE = 8
"""Rigs advanced together at most: one vector register of doubles."""
CACHE_BYTES = 2**20
"""What their gas may take, half of a second-level cache: long lines fill vectors by themselves."""
TICK_S = 2e-3
"""Flows are told, and steps counted, from tick to tick; readings have their own times between."""
KNOTS = 16
"""Openings per tick: a spool that leaves its seat is between two of them for an eighth of a
millisecond, and linear there."""
HALVINGS = 40
"""Of the way on which a joint is looked for whose piston stands within its stroke."""
CHUNK = 2000
"""Ticks that are run at once: what must be in memory does not grow with the recording."""


@dataclass(frozen=True)
class InitialField:
    """Initial pressures as a linear map of tap readings: ``p = weight @ taps + constant``.

    Attributes:
        weight: (slots, n_taps).
        constant: (slots,).
        chamber_weight: (n_chambers, n_taps).
        chamber_constant: (n_chambers,).
    """

    weight: Floats
    constant: Floats
    chamber_weight: Floats
    chamber_constant: Floats


def initial_field(rig: Rig, plan: Plan, through_orifices: bool = True) -> InitialField:
    """Linear interpolation of tap readings along each pipe, as thesis 8.1.2 starts its roll-outs.

    A reservoir's pressure counts as known at its pipe end. A pipe without any known point takes the
    pressure of its nearest neighbour that has one, else the room's.

    Args:
        rig: The rig.
        plan: Its grid.
        through_orifices: Whether a neighbour behind an orifice counts: at rest they share one
            pressure, but what corrects the one says nothing of the other.
    """
    rig = with_cylinders(rig)
    n_taps = len(rig.taps)
    weight = np.zeros((plan.slots, n_taps))
    constant = np.zeros(plan.slots)
    known: dict[str, list[tuple[float, Floats, float]]] = {}
    tap_names = list(rig.taps)
    for name, pipe in rig.pipes.items():
        points: list[tuple[float, Floats, float]] = []
        for t, tap in enumerate(rig.taps.values()):
            if tap.pipe == name or (
                tap.chamber is not None and tap.chamber in (pipe.from_node, pipe.to_node)
            ):
                x = (
                    tap.position_m
                    if tap.pipe == name
                    else (0.0 if tap.chamber == pipe.from_node else pipe.length_m)
                )
                points.append((x, np.eye(n_taps)[t], 0.0))
        for x, node in ((0.0, pipe.from_node), (pipe.length_m, pipe.to_node)):
            if node in rig.reservoirs:
                points.append((x, np.zeros(n_taps), rig.reservoirs[node].pressure_pa))
        known[name] = sorted(points, key=lambda point: point[0])
    # spread to neighbours that share a node, then to those behind an orifice
    _spread_known(rig, known, {})
    if through_orifices:
        for _ in rig.orifices:
            beyond: dict[str, set[str]] = {}
            for orifice in rig.orifices.values():
                beyond.setdefault(orifice.from_node, set()).add(orifice.to_node)
                beyond.setdefault(orifice.to_node, set()).add(orifice.from_node)
            _spread_known(rig, known, beyond)
    for name, pipe in rig.pipes.items():
        first, n = plan.pipes[name]
        points = known[name] or [(0.0, np.zeros(n_taps), rig.ambient.pressure_pa)]
        xs = np.array([point[0] for point in points])
        centres = middles(pipe.length_m, n)
        for t in range(n_taps):
            weight[first : first + n, t] = np.interp(centres, xs, [p[1][t] for p in points])
        constant[first : first + n] = np.interp(centres, xs, [p[2] for p in points])
        for ghost, cell in ((first - 1, first), (first + n, first + n - 1)):
            weight[ghost] = weight[cell]
            constant[ghost] = constant[cell]
    chamber_weight = np.zeros((len(plan.chambers), n_taps))
    chamber_constant = np.zeros(len(plan.chambers))
    for c, chamber in enumerate(plan.chambers):
        direct = [t for t, name in enumerate(tap_names) if rig.taps[name].chamber == chamber]
        if direct:
            chamber_weight[c, direct] = 1.0 / len(direct)
            continue
        chamber_constant[c] = rig.ambient.pressure_pa
        for name, pipe in rig.pipes.items():
            if chamber in (pipe.from_node, pipe.to_node):
                first, n = plan.pipes[name]
                slot = first if chamber == pipe.from_node else first + n - 1
                chamber_weight[c] = weight[slot]
                chamber_constant[c] = constant[slot]
                break
    return InitialField(weight, constant, chamber_weight, chamber_constant)


def _spread_known(
    rig: Rig, known: dict[str, list[tuple[float, Floats, float]]], beyond: dict[str, set[str]]
) -> None:
    """Gives pipes without a known point that of a neighbour; ``beyond`` leads through orifices."""
    for _ in rig.pipes:
        for name, pipe in rig.pipes.items():
            if known[name]:
                continue
            nodes = {pipe.from_node, pipe.to_node} - {CLOSED}
            nodes |= {far for node in list(nodes) for far in beyond.get(node, ())}
            for other, neighbour in rig.pipes.items():
                shared = nodes & {neighbour.from_node, neighbour.to_node}
                if other != name and known[other] and shared:
                    at_start = neighbour.from_node in shared
                    point = known[other][0 if at_start else -1]
                    known[name] = [(0.0, point[1], point[2])]
                    break


@dataclass(frozen=True)
class Start:
    """The gas and the spools as a run begins, at rest.

    Attributes:
        pressure: (slots,) Pa.
        chamber_pressure: (n_chambers,) Pa.
        temperature: (slots,) K, or None for the room's.
        chamber_temperature: (n_chambers,) K, or None for its wall's.
        joints: (n_joints, 2) positions and velocities of joints, or None for where the rig has
            them, at rest; a piston that would stand beyond its stroke stands at its end.
        at_null: Whether the spools stand closed, else where the first command has them.
    """

    pressure: Floats
    chamber_pressure: Floats
    temperature: Floats | None = None
    chamber_temperature: Floats | None = None
    joints: Floats | None = None
    at_null: bool = False


def rest(rig: Rig, plan: Plan) -> Start:
    """A rig at rest: lines open to a reservoir at its pressure, all else at the room's.

    Args:
        rig: The rig.
        plan: Its grid.
    """
    rig = with_cylinders(rig)
    room = rig.ambient.pressure_pa
    pressure = np.full(plan.slots, room)
    for name, k in reservoir_of_pipes(rig, plan.reservoirs).items():
        first, n = plan.pipes[name]
        reservoir = rig.reservoirs.get(plan.reservoirs[k])
        if reservoir is not None:
            pressure[first - 1 : first + n + 1] = reservoir.pressure_pa
    return Start(pressure, np.full(len(plan.chambers), room), at_null=True)


@dataclass(frozen=True)
class Course:
    """A recording as models follow it: what drives them, and when they are read.

    Sensors are the taps, then the encoders.

    Attributes:
        commands: Volts per command, each held until the next.
        begin_s: Time at which the run begins, s.
        end_s: Time that it reaches at least, s.
        time_s: (n_sensors, m) when each is read, s, increasing; inf beyond its last reading.
        measured: (n_sensors, m) what was read, Pa, rad or m; NaN where nothing was.
        gain: (n_sensors, m) share of measured minus predicted by which the gas, or a position, is
            corrected then; 0 lets the model run free.
        start: How it begins.
        push: (n_sensors, m) change of a velocity by that difference, 1/s; None is none.
    """

    commands: dict[str, Signal]
    begin_s: float
    end_s: float
    time_s: Floats
    measured: Floats
    gain: Floats
    start: Start
    push: Floats | None = None

    @property
    def ticks(self) -> int:
        """Number of ticks of the run, both ends counted."""
        return max(2, math.ceil((self.end_s - self.begin_s) / TICK_S - 1e-6) + 1)


def even_course(
    field: InitialField,
    commands: Mapping[str, Floats],
    dt_s: float,
    readings: Floats,
    gain: float = 0.0,
) -> Course:
    """A course whose sensors are read together, at the instants of the commands.

    Joints begin where the rig has them.

    Args:
        field: Map from taps to the pressures at the start.
        commands: Per command its (T,) volts.
        dt_s: Sample interval, s.
        readings: (T, n_sensors) of the taps, or of taps and encoders; the first pressures fill the
            rig, all that is finite draws its gas.
        gain: Share of measured minus predicted by which the gas is corrected at each.
    """
    samples, sensors = readings.shape
    time = dt_s * np.arange(samples, dtype=np.float64)
    first = readings[0, : field.weight.shape[1]]
    start = Start(
        field.weight @ first + field.constant,
        field.chamber_weight @ first + field.chamber_constant,
    )
    return Course(
        {
            name: Signal(time, np.asarray(volts, dtype=np.float64))
            for name, volts in commands.items()
        },
        0.0,
        float(time[-1]),
        np.tile(time, (sensors, 1)),
        np.ascontiguousarray(readings.T, dtype=np.float64),
        np.full((sensors, samples), gain),
        start,
    )


@dataclass(frozen=True)
class Prediction:
    """What a batch of models predicts along one course.

    Attributes:
        readings: (n_models, n_sensors, m) readings at their own times, Pa, rad or m.
        tick_s: (ticks,) times of what follows, s.
        flows: (n_models, ticks, n_ports) port flows, kg/s; empty where not asked for.
        chambers: (n_models, ticks, n_chambers) pressures, Pa; likewise.
        taps: (n_models, ticks, n_taps) pressures of the gas at the taps, Pa; likewise.
        joints: (n_models, ticks, n_joints, 2) positions and velocities of joints; likewise, and
            empty of models in which nothing moves.
        cylinders: (n_models, ticks, n_cylinders, 3) extensions, m, their speeds, m/s, and forces of
            gas and room on pistons, N (rad, rad/s and N m of rotary ones); likewise.
    """

    readings: Floats
    tick_s: Floats
    flows: Floats
    chambers: Floats
    taps: Floats
    joints: Floats = field(default_factory=lambda: np.empty((0, 0, 0, 2)))
    cylinders: Floats = field(default_factory=lambda: np.empty((0, 0, 0, 3)))


class RunOptions(NamedTuple):
    """How models are run along recordings.

    Attributes:
        workers: Threads; None is one per core.
        progress: Called with the fraction done.
        strict: Whether an unstable run is an error; else its predictions are not finite.
        flows: Whether flows, chamber and tap pressures, and what moves, are kept from tick to tick.
        device: On what they are computed; None is what the environment asks for.
    """

    workers: int | None = None
    progress: Callable[[float], None] | None = None
    strict: bool = True
    flows: bool = False
    device: Device | None = None


def width_of(slots: int) -> int:
    """How many rigs are advanced together: as many as the cache holds.

    Args:
        slots: Of each.
    """
    rows = L.PARAM_ROWS + L.STATE_ROWS + L.WORK_ROWS_OF_SECOND + L.WALL_ROWS
    return min(max(CACHE_BYTES // (8 * rows * slots), 1), TILE)


def shares(count: int, workers: int, slots: int) -> list[slice]:
    """Parts of a batch that are run together: few enough for the cache, enough for all workers.

    Args:
        count: Models.
        workers: Threads.
        slots: Of each model.
    """
    parts = max(math.ceil(count / width_of(slots)), min(workers, count))
    edges = [round(k * count / parts) for k in range(parts + 1)]
    return [slice(a, b) for a, b in pairwise(edges) if b > a]


def predict(
    models: Sequence[Sequence[Model]],
    courses: Sequence[Course],
    field: InitialField,
    starts: Sequence[Sequence[Start]] | None = None,
    options: RunOptions = RunOptions(),
) -> list[Prediction]:
    """Runs every model along every recording, in one batch.

    Each reading is predicted at the time at which the sensor took it. The gas may be corrected by
    the readings as it goes (see `Course`), spread over lines and chambers as the field has it.

    Args:
        models: (n_courses, n_models) parameter sets, all on one common plan.
        courses: The recordings.
        field: How readings spread over lines and chambers.
        starts: (n_courses, n_models) where each begins; None is the course's own start.
        options: How.

    Returns:
        The predictions, one per course.

    Raises:
        InputError: A prediction is not finite, and that is an error.
    """
    plan, count = models[0][0].plan, len(models[0])
    device = chosen() if options.device is None else options.device
    threads = options.workers or os.cpu_count() or 1
    parts = shares(count, threads, plan.slots)
    if device != Device.CPU:  # all models of a recording side by side
        threads, parts = 1, [slice(0, count)]
    out = []
    for course in courses:
        kept = course.ticks if options.flows else 0
        out.append(
            Prediction(
                np.full((count, *course.time_s.shape), np.nan),
                course.begin_s + TICK_S * np.arange(course.ticks, dtype=np.float64),
                np.empty((count, kept, plan.ports.shape[0])),
                np.empty((count, kept, len(plan.chambers))),
                np.empty((count, kept, len(plan.taps))),
                np.empty((count, kept, len(plan.joints), 2)),
                np.empty((count, kept, len(plan.cylinders), 3)),
            )
        )
    tasks = [(c, part) for c in range(len(courses)) for part in parts]
    tally = Tally([courses[c].ticks for c, _ in tasks], options.progress)

    def run(k: int) -> None:
        c, part = tasks[k]
        of = [courses[c].start] * count if starts is None else list(starts[c])
        _run(
            models[c][part],
            of[part],
            courses[c],
            field,
            part,
            out[c],
            device,
            options.strict,
            tally.of(k),
        )

    if threads > 1 and len(tasks) > 1:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(run, range(len(tasks))))
    else:
        for k in range(len(tasks)):
            run(k)
    return out


def _run(
    models: Sequence[Model],
    starts: Sequence[Start],
    course: Course,
    field: InitialField,
    part: slice,
    out: Prediction,
    device: Device,
    strict: bool,
    tell: Callable[[float], None],
) -> None:
    """Runs some models along a course, those that become unstable again with more steps."""
    which = list(range(len(models)))
    for more in (1, *MORE_STEPS):
        wrong = _pass(
            [models[j] for j in which],
            [starts[j] for j in which],
            course,
            field,
            part.start + np.array(which),
            out,
            device,
            more,
            tell if more == 1 else lambda _: None,
        )
        which = [j for j, failed in zip(which, wrong, strict=True) if failed]
        if not which:
            break
    tell(1.0)
    if strict and which:
        raise unstable(TICK_S / _steps(models[0].plan))


def _steps(plan: Plan) -> int:
    """Steps per tick."""
    return max(1, math.ceil(TICK_S / plan.dt_s - 1e-9))


def _pass(
    models: Sequence[Model],
    starts: Sequence[Start],
    course: Course,
    field: InitialField,
    rows: Ints,
    out: Prediction,
    device: Device,
    more: int,
    tell: Callable[[float], None],
) -> NDArray[np.bool_]:
    """Runs some models along a course, chunk by chunk, into their rows of the prediction.

    Args:
        models: The models.
        starts: Where each begins.
        course: The course.
        field: How readings spread over lines and chambers.
        rows: Their rows.
        out: The prediction.
        device: On what they are computed.
        more: How many times as many steps as usual are taken.
        tell: Called with the fraction done.

    Returns:
        Which of them became unstable.
    """
    plan = models[0].plan
    n_sub = _steps(plan) * more
    dt = TICK_S / n_sub
    tile = pack(models, device=device)
    if any(s.joints is not None for s in starts):
        place_joints(tile, *_within_stroke(tile, starts))
    fill_pipes(
        tile,
        lanes([s.pressure for s in starts]),
        _temperatures(tile, [s.temperature for s in starts]),
    )
    walls = tile.chamber[:, L.C_WALL_T]
    warm = [
        walls[:, j] if s.chamber_temperature is None else s.chamber_temperature
        for j, s in enumerate(starts)
    ]
    fill_chambers(tile, lanes([s.chamber_pressure for s in starts]), lanes(warm))
    tile.set_time(course.begin_s)
    watch = _watch(models, course, field, dt)
    memory = np.full((len(models), len(plan.valves), MEMORY), np.nan)
    valves = [
        (m.spool.tobytes(), m.curve.tobytes(), m.curve_v.tobytes(), s.at_null)
        for m, s in zip(models, starts, strict=True)
    ]
    like = [valves.index(of) for of in valves]
    ticks = course.ticks
    wrong = np.zeros(len(models), dtype=bool)
    for kept in (out.flows, out.chambers, out.taps, out.joints, out.cylinders):
        kept[rows] = np.nan
    for first in range(0, ticks - 1, CHUNK):
        count = min(CHUNK, ticks - 1 - first)
        opened: list[Floats] = []
        for j, k in enumerate(like):
            if k < j:  # valves as an earlier model has them
                opened.append(opened[k])
                continue
            shape, at_null = (count, KNOTS), starts[j].at_null
            opened.append(
                openings_along(
                    models[j],
                    course.commands,
                    course.begin_s,
                    first,
                    shape,
                    TICK_S,
                    memory[j],
                    at_null,
                )
            )
        series = advance(tile, n_sub, dt, lanes(opened), watch, first + count + 1 >= ticks)
        if out.flows.shape[1]:
            span = slice(first, first + count + 1)
            for kept, found in (
                (out.flows, series.flows),
                (out.chambers, series.chambers),
                (out.taps, series.taps),
                (out.joints, series.joints),
                (out.cylinders, series.cylinders),
            ):
                kept[rows, span] = np.moveaxis(found, -1, 0)
        wrong |= ~finite_lanes(series.taps) | np.isnan(tile.work[L.W_P]).any(axis=0)
        if wrong.all():
            break
        tell((first + count + 1) / ticks)
    readings = np.moveaxis(watch.readings, -1, 0)[:, : len(course.time_s)]
    out.readings[rows] = readings
    due = np.isfinite(course.time_s)
    return wrong | ~np.isfinite(readings[:, due]).all(axis=1)


def _temperatures(tile: Tile, given: Sequence[Floats | None]) -> Floats:
    """(slots, lanes) temperatures at the start, the room's where none is given."""
    room = tile.ambient[1]
    columns = [np.full(tile.plan.slots, room[j]) if t is None else t for j, t in enumerate(given)]
    return lanes(columns)


def _watch(models: Sequence[Model], course: Course, field: InitialField, dt: float) -> Watch:
    """The readings of a course, as each model's sensors take them."""
    w = len(models)
    taps = len(models[0].plan.taps)
    sensor = np.empty((taps + len(models[0].plan.encoders), L.SENSOR_ROWS, w))
    late = np.empty((w, sensor.shape[0]))
    for j, model in enumerate(models):
        each = np.concatenate([model.sensor, model.encoder])
        lag, gain = each[:, S_LAG], each[:, S_GAIN]
        lags = lag > 0.0
        r = dt / np.where(lags, lag, 1.0)
        keep = np.where(lags, np.exp(-r), 0.0)
        mean = np.where(lags, (1.0 - np.exp(-r)) / r, 0.0)
        about = np.where(np.arange(gain.size) < taps, model.ambient[0], 0.0)
        sensor[:, L.SENSE_KEEP, j] = keep
        sensor[:, L.SENSE_OLD, j] = np.where(lags, mean - keep, 0.0)
        sensor[:, L.SENSE_NEW, j] = 1.0 - mean
        sensor[:, L.SENSE_GAIN, j] = gain
        sensor[:, L.SENSE_BIAS, j] = (1.0 - gain) * about + each[:, S_BIAS]
        late[j] = each[:, S_OFFSET]
    # A course that knows of no encoders reads none.
    more = ((0, sensor.shape[0] - len(course.time_s)), (0, 0))
    due = np.pad(course.time_s, more, constant_values=np.inf)
    measured = np.pad(course.measured, more, constant_values=np.nan)
    gains = np.pad(course.gain, more)
    push = np.zeros_like(gains) if course.push is None else np.pad(course.push, more)
    time = (due[None] - late[:, :, None] - course.begin_s) / dt
    # A clock that is ahead asks for what lies beyond the end: it gets the end.
    last = (course.ticks - 1) * round(TICK_S / dt)
    time = np.where(np.isfinite(time), np.minimum(time, last), np.inf)
    return Watch(
        lanes(list(time)),
        lanes([measured] * w),
        lanes([gains] * w),
        sensor,
        field.weight,
        field.chamber_weight,
        lanes([push] * w),
    )


def _within_stroke(tile: Tile, starts: Sequence[Start]) -> tuple[Floats, Floats]:
    """(n_joints, lanes) positions and velocities of joints at the start.

    What an encoder read may lie a little beyond where a piston can stand; on the way from where
    the rig has its joints to there the farthest that can be is taken.
    """
    usual = tile.body_joint[:, L.PJ_START]
    wanted, velocity = usual.copy(), np.zeros_like(usual)
    for j, start in enumerate(starts):
        if start.joints is not None:
            wanted[:, j], velocity[:, j] = start.joints.T
    if reachable(tile, wanted).all():
        return wanted, velocity
    low, high = np.zeros(tile.lanes), np.ones(tile.lanes)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        fine = reachable(tile, usual + middle * (wanted - usual))
        low, high = np.where(fine, middle, low), np.where(fine, high, middle)
    there = reachable(tile, wanted)
    return (
        np.where(there, wanted, usual + low * (wanted - usual)),
        np.where(there, velocity, 0.0),
    )
