# SPDX-License-Identifier: Apache-2.0
"""A batch of rigs on one grid as the arrays that the kernel works on, and the gas in them."""

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim import kernel
from pneu_sim import layout as L
from pneu_sim.device import Device
from pneu_sim.rig.build import area_steps, side_volumes, small_chambers
from pneu_sim.rig.mechanics import SLIPPED_M, within_stroke
from pneu_sim.rig.model import Model
from pneu_sim.rig.plan import Plan

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CHANGING = (
    "state",
    "wall",
    "end_velocity",
    "end_flow",
    "side_kept",
    "leak_flow",
    "port_flow",
    "reservoir_p",
    "chamber_state",
    "cylinder_state",
    "joint_state",
    "friction_heat",
    "regulator_state",
    "clock",
)
"""Arrays of a tile that its steps change and that the next ones begin from."""


@dataclass
class Tile:
    """Rigs that are advanced together; see ``layout`` for rows and columns.

    Attributes:
        models: The rigs, on one plan.
        compliant: Whether any wall yields.
        memory: Whether any wall's friction and heat have memory.
        cell: (PARAM_ROWS, slots, lanes) cell parameters.
        state: (STATE_ROWS, slots, lanes).
        work: (WORK_ROWS, slots, lanes) scratch; in second order more rows.
        wall: (WALL_ROWS, slots, lanes) what walls do, and did in the last step.
        soft: (SOFT_ROWS, slots, lanes) what yielding walls hold; no slots where none yields.
        end_velocity: (n_ends, 2, lanes) of the gas at ends with ports, m/s: what it is taken to be
            in the next step until that is solved, and what it was in the last.
        end_flow: (n_ends, lanes) what ports let through there in the last step, kg/(m^2 s).
        joint: (n_ends, JOINT_ROWS, lanes) scratch.
        ported: (n_ends, PORTED_ROWS, lanes) scratch.
        port: (n_ports, PORT_PARAMS, lanes).
        port_flow: (n_ports, 2, lanes) latest mass and enthalpy flows.
        regulator: (n_regulators, REG_PARAMS, lanes).
        regulator_state: (n_regulators, REG_STATE, lanes) what they show, where they stand.
        reservoir: (n_reservoirs, RESERVOIR_PARAMS, lanes).
        opening: (n_ports, lanes) scratch.
        reservoir_p: (n_reservoirs, lanes) present pressures.
        supplied: (n_reservoirs, lanes) scratch.
        drawn: (n_reservoirs, lanes) scratch.
        chamber: (n_chambers, CHAMBER_PARAMS, lanes).
        chamber_state: (n_chambers, 2, lanes) mass and energy.
        chamber_work: (n_chambers, CHAMBER_ROWS, lanes) scratch.
        small: (n_small,) chambers that fill and empty within a step.
        stiff: (n_small, lanes) in which rigs.
        cylinder: (n_cylinders, CYLINDER_PARAMS, lanes).
        cylinder_state: (n_cylinders, CYLINDER_STATE, lanes) where pistons stand.
        cylinder_work: (n_cylinders, CYLINDER_WORK, lanes) scratch.
        body: (n_bodies, BODY_PARAMS, lanes).
        body_joint: (n_joints, JOINT_PARAMS, lanes).
        joint_state: (n_joints, JOINT_STATE, lanes) where bodies are.
        friction_heat: (n_bodies, lanes) what friction and damping made, J.
        ripple_index: (n_ripples,) reservoirs whose pressure ripples.
        ripple: (n_ripples, RIPPLE_PARAMS, lanes).
        leak_index: (n_leaks, TERM_COLUMNS) what leaks to the room, and how.
        leak: (n_leaks, LEAK_PARAMS, lanes).
        leak_flow: (n_leaks, lanes) latest mass flows, kg/s, negative inwards.
        own: What further terms act on: (rows, TERM_COLUMNS) and (rows, columns, lanes) of each.
        acts: Those terms, compiled.
        ambient: (2, lanes) room pressure and temperature.
        tap_slot: (n_taps, lanes).
        tap_weight: (n_taps, lanes).
        tap_cell: (n_taps, lanes).
        tap_lost: (n_taps, 2, lanes).
        step_index: (n_steps, 5) faces where the area jumps.
        step_area: (n_steps, 2, lanes) areas on both sides of those.
        side_index: (n_sides, SIDE_COLUMNS) cells that have a volume beside them.
        side: (n_sides, lanes) how many times their own volume it is.
        side_kept: (n_sides, 3, lanes) what they took up in the last step, see `kernel.Sides`.
        clock: (2, lanes) time from which steps are counted, s, and how many there were since.
        dt_s: Length of those steps.
        device: On what it is advanced.
    """

    models: Sequence[Model]
    compliant: bool
    memory: bool
    cell: Floats
    state: Floats
    work: Floats
    wall: Floats
    soft: Floats
    end_velocity: Floats
    end_flow: Floats
    end_give: Floats
    joint: Floats
    ported: Floats
    port: Floats
    port_flow: Floats
    opening: Floats
    regulator: Floats
    regulator_state: Floats
    reservoir: Floats
    reservoir_p: Floats
    supplied: Floats
    drawn: Floats
    chamber: Floats
    chamber_state: Floats
    chamber_work: Floats
    small: Ints
    stiff: Floats
    cylinder: Floats
    cylinder_state: Floats
    cylinder_work: Floats
    body: Floats
    body_joint: Floats
    joint_state: Floats
    friction_heat: Floats
    ripple_index: Ints
    ripple: Floats
    leak_index: Ints
    leak_flow: Floats
    leak: Floats
    own: Sequence[tuple[Ints, Floats]]
    acts: tuple[Callable[..., Any], ...]
    ambient: Floats
    tap_slot: Ints
    tap_weight: Floats
    tap_cell: Ints
    tap_lost: Floats
    step_index: Ints
    step_area: Floats
    side_index: Ints
    side: Floats
    side_kept: Floats
    clock: Floats
    dt_s: float = 0.0
    device: Device = Device.CPU

    @property
    def time_s(self) -> Floats:
        """(lanes,) present time, s."""
        return self.clock[0] + self.clock[1] * self.dt_s

    def set_time(self, time_s: Floats | float) -> None:
        """Sets the present time, by which supplies ripple.

        Args:
            time_s: A number or one per lane, s.
        """
        self.clock[0] = time_s
        self.clock[1] = 0.0

    def count_by(self, dt_s: float) -> None:
        """Counts steps of another length from now on.

        Args:
            dt_s: Their length, s.
        """
        if dt_s != self.dt_s:
            self.set_time(self.time_s)
            self.dt_s = dt_s

    @property
    def plan(self) -> Plan:
        """The common grid."""
        return self.models[0].plan

    @property
    def lanes(self) -> int:
        """Number of rigs."""
        return len(self.models)

    @functools.cached_property
    def free(self) -> kernel.Rigs:
        """The batch as the kernel takes it, with taps that are not read."""
        return arrays(self, unwatched(self))

    @functools.cached_property
    def moving(self) -> kernel.Moving | None:
        """What of it moves, as the kernel takes it; None if nothing does."""
        return moving(self, unwatched(self)) if self.plan.cylinders else None


def lanes(arrays: Sequence[Floats]) -> Floats:
    """Stacks per-rig arrays with the rig as the innermost index.

    Args:
        arrays: One array per rig, of one shape.
    """
    return np.ascontiguousarray(np.stack(arrays, axis=-1))


def _rows(
    tables: Sequence[Mapping[int, Sequence[tuple[float, ...]]]], columns: int
) -> tuple[list[int], Floats]:
    """Lists by number, one table per rig, as rows that all rigs have; missing ones are zero.

    Args:
        tables: Per rig its entries by number.
        columns: Length of an entry.

    Returns:
        The number of each row, and (rows, columns, rigs).
    """
    numbers: list[int] = []
    for number in sorted({n for table in tables for n in table}):
        numbers += [number] * max(len(table.get(number, ())) for table in tables)
    rows = np.zeros((len(numbers), columns, len(tables)))
    for j, table in enumerate(tables):
        for number, entries in table.items():
            first = numbers.index(number)
            for k, entry in enumerate(entries):
                rows[first + k, :, j] = entry
    return numbers, rows


def _leaks(models: Sequence[Model]) -> tuple[Ints, Floats]:
    """Leaks to the room as the kernel takes them."""
    kinds = {
        L.ORIFICE: [{slot: [(a, 0.0, 1.0)] for slot, a in m.leaks.items()} for m in models],
        L.POROUS: [{slot: [(g, 0.0, 1.0)] for slot, g in m.porous.items()} for m in models],
        L.RELIEF: [m.reliefs for m in models],
    }
    index: list[tuple[int, int]] = []
    rows = []
    for kind, tables in kinds.items():
        slots, of_kind = _rows(tables, L.LEAK_PARAMS)
        index += [(slot, kind) for slot in slots]
        rows.append(of_kind)
    return np.array(index, dtype=np.int64).reshape(-1, L.TERM_COLUMNS), np.concatenate(rows)


def _own_terms(
    models: Sequence[Model],
) -> tuple[list[tuple[Ints, Floats]], tuple[Callable[..., Any], ...]]:
    """What the terms of effects act on in any of the models, and those terms."""
    own, acts = [], []
    for name in sorted({name for model in models for name in model.terms}):
        found = [model.terms.get(name) for model in models]
        first = next(term for term in found if term is not None)
        slots, par = _rows([{} if term is None else term.rows for term in found], first.columns)
        own.append((np.array([(slot, 0) for slot in slots], dtype=np.int64), par))
        acts.append(first.act)
    return own, tuple(acts)


def pack(
    models: Sequence[Model],
    compliant: bool | None = None,
    memory: bool | None = None,
    device: Device = Device.CPU,
) -> Tile:
    """Lays a batch of rigs out for the kernel, its gas yet to be filled in.

    Args:
        models: The rigs, on one plan.
        compliant: Whether any wall yields; None looks.
        memory: Whether any wall has memory; None looks.
        device: On what it will be advanced.
    """
    plan, w = models[0].plan, len(models)
    ends, ports, chambers = plan.ends.shape[0], plan.ports.shape[0], len(plan.chambers)
    reservoirs = models[0].reservoir.shape[0]
    compliant = any(m.compliant for m in models) if compliant is None else compliant
    cell = lanes([m.cell for m in models])
    ripple_of, ripple = _rows([m.ripples for m in models], L.RIPPLE_PARAMS)
    leak_index, leak = _leaks(models)
    own, acts = _own_terms(models)
    step_index, step_area = area_steps(models)
    side_index, side = side_volumes(models)
    small, stiff = small_chambers(models)
    rows = L.WORK_ROWS if models[0].order == 1 else L.WORK_ROWS_OF_SECOND
    tile = Tile(
        models=models,
        compliant=compliant,
        memory=any(m.memory for m in models) if memory is None else memory,
        cell=cell,
        state=np.zeros((L.STATE_ROWS, plan.slots, w)),
        work=np.zeros((rows, plan.slots, w)),
        wall=np.zeros((L.WALL_ROWS, plan.slots, w)),
        soft=np.zeros((L.SOFT_ROWS, plan.slots if compliant else 0, w)),
        end_velocity=np.zeros((ends, 2, w)),
        end_flow=np.zeros((ends, w)),
        end_give=np.ones((ends, w)),
        joint=np.zeros((ends, L.JOINT_ROWS, w)),
        ported=np.zeros((ends, L.PORTED_ROWS, w)),
        port=lanes([m.port for m in models]),
        port_flow=np.zeros((ports, 2, w)),
        opening=np.zeros((ports, w)),
        regulator=lanes([m.regulator for m in models]),
        regulator_state=np.zeros((len(plan.regulators), L.REG_STATE, w)),
        reservoir=np.zeros((*models[0].reservoir.shape, w)),
        reservoir_p=np.zeros((reservoirs, w)),
        supplied=np.zeros((reservoirs, w)),
        drawn=np.zeros((reservoirs, w)),
        chamber=lanes([m.chamber for m in models]),
        chamber_state=np.zeros((chambers, 2, w)),
        chamber_work=np.zeros((chambers, L.CHAMBER_ROWS, w)),
        small=small,
        stiff=stiff,
        cylinder=lanes([m.cylinder for m in models]),
        cylinder_state=np.zeros((len(plan.cylinders), L.CYLINDER_STATE, w)),
        cylinder_work=np.zeros((len(plan.cylinders), L.CYLINDER_WORK, w)),
        body=lanes([m.body for m in models]),
        body_joint=lanes([m.joint for m in models]),
        joint_state=np.zeros((len(plan.joints), L.JOINT_STATE, w)),
        friction_heat=np.zeros((len(plan.bodies), w)),
        ripple_index=np.array(ripple_of, dtype=np.int64),
        ripple=ripple,
        leak_index=leak_index,
        leak=leak,
        leak_flow=np.zeros((len(leak_index), w)),
        own=own,
        acts=acts,
        ambient=lanes([m.ambient for m in models]),
        tap_slot=np.ascontiguousarray(np.stack([m.tap_slot for m in models], axis=-1)),
        tap_weight=lanes([m.tap_weight for m in models]),
        tap_cell=np.ascontiguousarray(np.stack([m.tap_cell for m in models], axis=-1)),
        tap_lost=lanes([m.tap_lost for m in models]),
        step_index=step_index,
        step_area=step_area,
        side_index=side_index,
        side=side,
        side_kept=np.zeros((len(side_index), 3, w)),
        clock=np.zeros((2, w)),
        device=device,
    )
    forget(tile)
    return tile


def forget(tile: Tile) -> None:
    """Has a batch as if nothing had ever flowed: time zero, and reservoirs as the rigs have them.

    Args:
        tile: The batch.
    """
    for name in (*CHANGING, "work", "soft", "joint", "ported", "chamber_work"):
        getattr(tile, name)[:] = 0.0
    # Ghosts have no wall; the floor keeps their unused memory finite.
    tile.wall[L.D_STAY] = 1.0 / np.maximum(tile.cell[L.RELAX], 1e-12)
    tile.reservoir[:] = lanes([m.reservoir for m in tile.models])
    tile.reservoir_p[:] = tile.reservoir[:, L.R_PRESSURE]
    if tile.plan.cylinders:
        tile.cylinder_state[:, L.SY_EXTENSION] = tile.cylinder[:, L.PY_START]
        place_joints(tile, tile.body_joint[:, L.PJ_START], 0.0)


def place_joints(
    tile: Tile, position: Floats, velocity: Floats | float, pressed: bool = False
) -> None:
    """Sets bodies and the pistons that move them, whatever the gas; others stand where they stood.

    Args:
        tile: The batch.
        position: (n_joints, lanes) rad or m.
        velocity: (n_joints, lanes) per second; a joint that is held has none.
        pressed: Whether pistons may be pressed into their stops, as steps press them.

    Raises:
        InputError: A piston would stand beyond its stroke; nothing has moved then.
    """
    moves = moving(tile, unwatched(tile))
    joints, cylinders = _standing(tile, position, velocity, pressed)
    stood = tile.cylinder_state[:, L.SY_EXTENSION] == cylinders[:, L.SY_EXTENSION]
    counts = slice(L.SY_COUNT, L.SY_COUNT_ROD + 1)
    before = tile.cylinder_state[:, counts].copy()
    tile.joint_state[:] = joints
    tile.cylinder_state[:] = cylinders
    kernel.count_cells(tile.lanes, moves.cylinders)
    # cells beside a piston that did not move are as many as they were, if they were counted
    kept = stood[:, None] & (before > 0.0)
    tile.cylinder_state[:, counts] = np.where(kept, before, tile.cylinder_state[:, counts])
    settle(tile)


def check_place(tile: Tile, position: Floats) -> None:
    """Raises InputError where joints would put a piston beyond its stroke.

    Args:
        tile: The batch.
        position: (n_joints, lanes) rad or m.
    """
    _standing(tile, position, 0.0)


def reachable(tile: Tile, position: Floats) -> NDArray[np.bool_]:
    """(lanes,) whether joints may stand somewhere, every piston within its stroke.

    Args:
        tile: The batch.
        position: (n_joints, lanes) rad or m.
    """
    moves = moving(tile, unwatched(tile))
    joints, cylinders = np.zeros_like(tile.joint_state), tile.cylinder_state.copy()
    joints[:, L.SJ_POSITION] = position
    kernel.stand(moves.bodies._replace(state=joints), moves.cylinders._replace(state=cylinders))
    at, stroke = cylinders[:, L.SY_EXTENSION], tile.cylinder[:, L.PY_STROKE]
    return np.asarray(((at >= -SLIPPED_M) & (at <= stroke + SLIPPED_M)).all(axis=0))


def _standing(
    tile: Tile, position: Floats, velocity: Floats | float, pressed: bool = False
) -> tuple[Floats, Floats]:
    """States of joints and cylinders with the joints somewhere else; nothing is changed."""
    moves = moving(tile, unwatched(tile))
    held = tile.body_joint[:, L.PJ_HELD] > 0.0
    joints, cylinders = np.zeros_like(tile.joint_state), tile.cylinder_state.copy()
    joints[:, L.SJ_POSITION] = position
    joints[:, L.SJ_VELOCITY] = np.where(held, 0.0, velocity)
    cylinders[:, [L.SY_PUSH, L.SY_IMPULSE, L.SY_SIDE, L.SY_BENT]] = 0.0
    # in the middle of its play
    tight = moves.bodies.joint.copy()
    tight[:, L.PJ_PLAY] = 0.0
    kernel.stand(
        moves.bodies._replace(state=joints, joint=tight),
        moves.cylinders._replace(state=cylinders),
    )
    for j, model in enumerate(() if pressed else tile.models):
        check_extensions(model, cylinders[:, L.SY_EXTENSION, j])
    return joints, cylinders


def settle(tile: Tile) -> None:
    """Has volumes and cells be those of the places where the pistons stand.

    Args:
        tile: The batch.
    """
    if tile.moving is not None:
        kernel.settle(tile.free.cells, tile.free.chambers, tile.moving.cylinders)


def force_at_rest(tile: Tile) -> Floats:
    """Force of gas and room on every piston by the pressures beside it, (n_cylinders, lanes), N.

    Args:
        tile: The batch, its pressures computed.
    """
    moves = moving(tile, unwatched(tile))
    kernel.lean(tile.free.cells, tile.free.chambers, moves.cylinders)
    return tile.cylinder_state[:, L.SY_FORCE].copy()


def rearrange(tile: Tile, position: Floats, velocity: Floats) -> None:
    """Moves bodies and their pistons elsewhere; gas keeps its pressure and temperature.

    Whether pistons are within their strokes is not looked at (`check_place`); steps press them into
    their stops. Gas in cells comes to rest where its piston moved, all of it as beside its way in.

    Args:
        tile: The batch.
        position: (n_joints, lanes) rad or m.
        velocity: (n_joints, lanes) per second.
    """
    before = tile.chamber[:, L.C_VOLUME].copy()
    stood = tile.cylinder_state[:, L.SY_EXTENSION].copy()
    place_joints(tile, position, velocity, pressed=True)
    tile.chamber_state *= (tile.chamber[:, L.C_VOLUME] / before)[:, None]
    for row, moved in zip(
        tile.plan.cylinder, tile.cylinder_state[:, L.SY_EXTENSION] != stood, strict=True
    ):
        for side in range(2):
            kind, first, most = row[L.COLUMNS_PER_SIDE * side : L.COLUMNS_PER_SIDE * (side + 1)]
            if kind != L.GAS_CELLS or not moved.any():
                continue
            slots = slice(first - 1, first + most + 1)
            kept = tile.state[:, slots].copy()
            density, _, pressure = gas_in(tile, slice(first, first + 1))
            shape = (most + 2, tile.lanes)
            density, pressure = (np.broadcast_to(of, shape) for of in (density, pressure))
            hold_gas(tile, slots, density, np.zeros(shape), pressure)
            tile.state[:, slots] = np.where(moved, tile.state[:, slots], kept)


def check_extensions(model: Model, extension: Floats) -> None:
    """Raises InputError where a cylinder stands beyond its stroke.

    Args:
        model: The rig.
        extension: (n_cylinders,) where each stands, m.
    """
    for k, name in enumerate(model.plan.cylinders):
        stroke = model.cylinder[k, L.PY_STROKE]
        if not within_stroke(extension[k], stroke):
            raise InputError(
                f"cylinders.{name}: found an extension of {extension[k]:.6g}, driven past its"
                f" stroke; allowed is 0 to {stroke:g}"
            )


def fill_pipes(
    tile: Tile, pressure: Floats, temperature: Floats, velocity: Floats | float = 0.0
) -> None:
    """Sets the gas in all slots, at rest at ports, and forgets what its walls remember.

    Args:
        tile: The batch.
        pressure: (slots, lanes) Pa.
        temperature: (slots, lanes) or broadcast to it, K.
        velocity: (slots, lanes) m/s.
    """
    tile.end_velocity[:] = tile.end_flow[:] = 0.0
    tile.side_kept[:] = tile.leak_flow[:] = 0.0
    rho = pressure / (tile.models[0].gas.r_specific * temperature)
    hold_gas(tile, slice(None), rho, np.broadcast_to(velocity, rho.shape), pressure)


def gas_in(tile: Tile, slots: slice | Ints) -> tuple[Floats, Floats, Floats]:
    """Density, velocity and pressure of the gas in some slots, each (slots, lanes).

    Args:
        tile: The batch.
        slots: Which.
    """
    cell, (mass, momentum, energy) = tile.cell[:, slots], tile.state[:3, slots]
    gm = tile.models[0].gas.gamma - 1.0
    k, rest = cell[L.COMPLIANCE], cell[L.REST_P]
    u = momentum / mass
    e = gm * (energy - 0.5 * momentum * u + 0.5 * k * rest**2)
    b = 1.0 - k * rest
    p = 2.0 * e / (b + np.sqrt(b * b + 2.0 * k * (gm + 2.0) * e))
    return mass / (1.0 + k * (p - rest)), u, p


def fill_chambers(
    tile: Tile, pressure: Floats, temperature: Floats, which: slice = slice(None)
) -> None:
    """Sets the gas in chambers.

    Args:
        tile: The batch.
        pressure: (chambers, lanes) Pa.
        temperature: (chambers, lanes) K.
        which: Which chambers.
    """
    gas = tile.models[0].gas
    rows, state = tile.chamber[which], tile.chamber_state[which]
    com, rest = rows[:, L.C_COMPLIANCE], rows[:, L.C_REST_P]
    volume = rows[:, L.C_VOLUME] + com * (pressure - rest)
    state[:, 0] = pressure * volume / (gas.r_specific * temperature)
    state[:, 1] = pressure * volume / (gas.gamma - 1.0) + 0.5 * com * (pressure**2 - rest**2)


@dataclass
class Watch:
    """How a batch is read at times of its sensors' own, and corrected by what they measured.

    Sensors are the taps, then the encoders.

    Attributes:
        time_steps: (n_sensors, m, lanes) when each is read, in steps since the start; inf beyond.
        measured: (n_sensors, m, lanes) what was measured then; NaN where nothing was.
        gain: (n_sensors, m, lanes) share of the difference by which gas or joint is corrected then.
        sensor: (n_sensors, SENSOR_ROWS, lanes) see ``layout``.
        spread: (slots, n_taps) how a correction at the taps spreads over the slots.
        spread_chamber: (n_chambers, n_taps) likewise over the chambers.
        push: (n_sensors, m, lanes) change of a joint's velocity by the difference, 1/s; None is
            none.
        readings: (n_sensors, m, lanes) what the sensors read; NaN before it is reached.
        step: Steps since the start.
        next_read: (n_sensors, lanes) next reading of each.
        shown: (n_sensors, lanes) present reading before gain and bias.
        felt: (n_sensors, lanes) pressure or position one step ago.
        error: (n_sensors, lanes) scratch.
    """

    time_steps: Floats
    measured: Floats
    gain: Floats
    sensor: Floats
    spread: Floats
    spread_chamber: Floats
    push: Floats | None = None
    readings: Floats = field(init=False)
    step: int = 0
    next_read: Ints = field(init=False)
    shown: Floats = field(init=False)
    felt: Floats = field(init=False)
    error: Floats = field(init=False)

    def __post_init__(self) -> None:
        """Nothing is read yet."""
        sensors, _, w = self.time_steps.shape
        self.readings = np.full(self.time_steps.shape, np.nan)
        self.next_read = np.zeros((sensors, w), dtype=np.int64)
        self.shown = np.full((sensors, w), np.nan)
        self.felt = np.full((sensors, w), np.nan)
        self.error = np.zeros((sensors, w))


def unwatched(tile: Tile) -> Watch:
    """Sensors that are not read.

    Args:
        tile: The batch.
    """
    taps = len(tile.plan.taps)
    sensors = taps + len(tile.plan.encoders)
    none = np.zeros((sensors, 0, tile.lanes))
    return Watch(
        none,
        none,
        none,
        np.zeros((sensors, L.SENSOR_ROWS, tile.lanes)),
        np.zeros((tile.plan.slots, taps)),
        np.zeros((len(tile.plan.chambers), taps)),
    )


def arrays(tile: Tile, watch: Watch) -> kernel.Rigs:
    """A batch as the kernel takes it.

    Args:
        tile: The batch.
        watch: Taps that are read.
    """
    first, plan = tile.models[0], tile.plan
    taps = slice(0, len(plan.taps))
    rippling = tile.ripple_index.size > 0
    return kernel.Rigs(
        kernel.Gas(
            first.gas.gamma,
            first.gas.r_specific,
            first.gas.prandtl,
            first.gas.prandtl ** (1.0 / 3.0),
        ),
        kernel.Scheme(
            first.order,
            first.flux,
            first.limiter,
            first.newton,
            tile.compliant,
            tile.memory,
            bool((plan.ends[:, L.E_KIND] == L.JUNCTION).any()),
            bool(tile.cell[L.TAPER].any()),
        ),
        kernel.Cells(
            tile.lanes,
            tile.cell.reshape(L.PARAM_ROWS, -1),
            tile.state.reshape(L.STATE_ROWS, -1),
            tile.work.reshape(len(tile.work), -1),
            tile.wall.reshape(L.WALL_ROWS, -1),
            tile.soft.reshape(L.SOFT_ROWS, -1),
        ),
        kernel.Steps(tile.step_index, tile.step_area),
        kernel.Sides(tile.side_index, tile.side, tile.side_kept),
        kernel.Ends(
            plan.ends, tile.end_velocity, tile.end_flow, tile.end_give, tile.joint, tile.ported
        ),
        kernel.Ports(
            plan.ports,
            tile.port,
            tile.port_flow,
            tile.opening,
            kernel.Regulators(plan.regulators, tile.regulator, tile.regulator_state),
        ),
        kernel.Reservoirs(
            tile.reservoir,
            tile.reservoir_p,
            # where none ripples, what is supplied is the pressure itself
            tile.supplied if rippling else tile.reservoir_p,
            tile.drawn,
            tile.ripple_index,
            tile.ripple,
        ),
        kernel.Chambers(
            tile.chamber, tile.chamber_state, tile.chamber_work, tile.small, tile.stiff
        ),
        (
            kernel.Term(tile.leak_index, tile.leak, tile.ambient, tile.leak_flow),
            *(kernel.Term(index, par, tile.ambient, tile.leak_flow[:0]) for index, par in tile.own),
        ),
        kernel.Taps(
            tile.tap_slot,
            tile.tap_weight,
            tile.tap_cell,
            tile.tap_lost,
            watch.sensor[taps],
            watch.time_steps[taps],
            watch.measured[taps],
            watch.gain[taps],
            watch.spread,
            watch.spread_chamber,
            watch.next_read[taps],
            watch.shown[taps],
            watch.felt[taps],
            watch.error[taps],
            watch.readings[taps],
        ),
    )


def moving(tile: Tile, watch: Watch) -> kernel.Moving:
    """What of a batch moves, as the kernel takes it.

    Args:
        tile: The batch.
        watch: Encoders that are read.
    """
    plan = tile.plan
    cylinders = kernel.Cylinders(
        plan.cylinder, plan.moves, tile.cylinder, tile.cylinder_state, tile.cylinder_work
    )
    own = slice(len(plan.taps), None)
    push = np.zeros_like(watch.gain) if watch.push is None else watch.push
    encoders = kernel.Encoders(
        plan.encoder_of,
        watch.sensor[own],
        watch.time_steps[own],
        watch.measured[own],
        watch.gain[own],
        push[own],
        watch.next_read[own],
        watch.shown[own],
        watch.felt[own],
        np.zeros((len(plan.encoders), 2, tile.lanes)),
        watch.readings[own],
    )
    return kernel.Moving(cylinders, _bodies(tile), encoders)


def _bodies(tile: Tile) -> kernel.Bodies:
    """Bodies of a batch, with scratch for the equations of the largest."""
    plan = tile.plan
    n = int(plan.body[:, L.B_JOINTS].max(initial=1))
    places = int(plan.body[:, L.B_PLACES].max(initial=1))
    return kernel.Bodies(
        plan.body,
        plan.driven_by,
        tile.body,
        tile.body_joint,
        tile.joint_state,
        tile.friction_heat,
        np.zeros(n),
        np.zeros(n),
        np.zeros(n),
        np.zeros((n, n)),
        np.zeros(places),
        np.zeros((places, n)),
        np.zeros((n + places, n)),
        np.zeros((n + places, n)),
        np.zeros(n + places),
        np.zeros(n + places),
        np.zeros(n + places),
        np.zeros(n + places),
        np.zeros(n + places),
        np.zeros(places),
        np.zeros(places),
        np.zeros(n),
        np.zeros(places),
        np.zeros((places, n)),
    )


def hold_gas(tile: Tile, slots: slice, density: Floats, velocity: Floats, pressure: Floats) -> None:
    """Sets the gas in some slots, whose walls forget what they remember.

    Args:
        tile: The batch.
        slots: Which.
        density: (slots, lanes) kg/m^3; what follows likewise.
        velocity: m/s.
        pressure: Pa.
    """
    cell, state = tile.cell[:, slots], tile.state[:, slots]
    k, rest = cell[L.COMPLIANCE], cell[L.REST_P]
    stretch = 1.0 + k * (pressure - rest)
    state[:] = 0.0
    state[L.RHO] = density * stretch
    state[L.MOM] = density * stretch * velocity
    state[L.ENE] = (
        pressure * stretch / (tile.models[0].gas.gamma - 1.0)
        + 0.5 * k * (pressure**2 - rest**2)
        + 0.5 * density * stretch * velocity**2
    )


def sound(tile: Tile) -> bool:
    """Whether the gas of all cells in use has density and energy above zero.

    Args:
        tile: The batch.
    """
    mass, momentum, energy = tile.state[:3]
    used = tile.cell[L.INV_VOLUME] > 0.0
    # NaN compares as false; what moves has more energy than there is where pressure is negative
    fine = (mass > 0.0) & (energy * mass > 0.5 * momentum * momentum)
    return bool((fine | ~used).all())


def held(tile: Tile) -> tuple[Floats, Floats]:
    """Mass, kg, and energy, J, of all gas and yielding walls, each (lanes,).

    Args:
        tile: The batch.
    """
    inverse = tile.cell[L.INV_VOLUME]
    volume = np.where(inverse > 0.0, 1.0 / np.where(inverse > 0.0, inverse, 1.0), 0.0)
    mass, energy = (
        np.sum(tile.state[row] * volume, axis=0) + tile.chamber_state[:, column].sum(axis=0)
        for row, column in ((L.RHO, 0), (L.ENE, 1))
    )
    # what lies beside a line does not move with it, see `kernel.sides`
    slots = tile.side_index[:, L.D_SLOT]
    moves = 0.5 * tile.state[L.MOM, slots] ** 2 / tile.state[L.RHO, slots] * volume[slots]
    return mass, energy - np.sum(tile.side / (1.0 + tile.side) * moves, axis=0)
