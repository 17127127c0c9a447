# SPDX-License-Identifier: Apache-2.0
"""A batch of rigs on one grid, as the arrays that the kernel works on, and stepping it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sim import kernel
from pneu_sim import layout as L
from pneu_sim.errors import InputError
from pneu_sim.rig.build import Model, Plan, area_steps
from pneu_sim.valve import KNOTS_PER_SAMPLE

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass
class Tile:
    """Rigs that are advanced together; see ``layout`` for rows and columns.

    Attributes:
        models: The rigs, on one plan.
        compliant: Whether any wall yields.
        memory: Whether any wall's friction and heat have memory.
        cell: (PARAM_ROWS, slots, lanes) cell parameters.
        state: (STATE_ROWS, slots, lanes).
        work: (WORK_ROWS, slots, lanes) scratch.
        port: (n_ports, PORT_PARAMS, lanes).
        port_flow: (n_ports, 2, lanes) latest mass and enthalpy flows.
        reservoir: (n_reservoirs, RESERVOIR_PARAMS, lanes).
        reservoir_p: (n_reservoirs, lanes) present pressures.
        chamber: (n_chambers, CHAMBER_PARAMS, lanes).
        chamber_state: (n_chambers, 2, lanes) mass and energy.
        leak_slot: (n_leaks,) slots that leak to the room.
        leak_area: (n_leaks, lanes) effective areas.
        ambient: (2, lanes) room pressure and temperature.
        tap_slot: (n_taps, lanes).
        tap_weight: (n_taps, lanes).
        step_index: (n_steps, 5) faces where the area jumps.
        step_area: (n_steps, 2, lanes) areas on both sides of those.
    """

    models: Sequence[Model]
    compliant: bool
    memory: bool
    cell: Floats
    state: Floats
    work: Floats
    port: Floats
    port_flow: Floats
    reservoir: Floats
    reservoir_p: Floats
    chamber: Floats
    chamber_state: Floats
    leak_slot: Ints
    leak_area: Floats
    ambient: Floats
    tap_slot: Ints
    tap_weight: Floats
    step_index: Ints
    step_area: Floats

    @property
    def plan(self) -> Plan:
        """The common grid."""
        return self.models[0].plan

    @property
    def lanes(self) -> int:
        """Number of rigs."""
        return len(self.models)


def lanes(arrays: Sequence[Floats]) -> Floats:
    """Stacks per-rig arrays with the rig as the innermost index.

    Args:
        arrays: One array per rig, of one shape.
    """
    return np.ascontiguousarray(np.stack(arrays, axis=-1))


def pack(
    models: Sequence[Model], compliant: bool | None = None, memory: bool | None = None
) -> Tile:
    """Lays a batch of rigs out for the kernel, its gas yet to be filled in.

    Args:
        models: The rigs, on one plan.
        compliant: Whether any wall yields; None looks.
        memory: Whether any wall has memory; None looks.
    """
    plan, w = models[0].plan, len(models)
    reservoir = lanes([m.reservoir for m in models])
    leak_slot = np.array(sorted({slot for m in models for slot in m.leaks}), dtype=np.int64)
    leak_area = np.array([[m.leaks.get(int(s), 0.0) for m in models] for s in leak_slot])
    step_index, step_area = area_steps(models)
    return Tile(
        models=models,
        compliant=any(m.compliant for m in models) if compliant is None else compliant,
        memory=any(m.memory for m in models) if memory is None else memory,
        cell=lanes([m.cell for m in models]),
        state=np.zeros((L.STATE_ROWS, plan.slots, w)),
        work=np.zeros((L.WORK_ROWS, plan.slots, w)),
        port=lanes([m.port for m in models]),
        port_flow=np.zeros((plan.ports.shape[0], 2, w)),
        reservoir=reservoir,
        reservoir_p=np.ascontiguousarray(reservoir[:, L.R_PRESSURE]),
        chamber=lanes([m.chamber for m in models]),
        chamber_state=np.zeros((len(plan.chambers), 2, w)),
        leak_slot=leak_slot,
        leak_area=leak_area.reshape(leak_slot.size, w),
        ambient=lanes([m.ambient for m in models]),
        tap_slot=np.ascontiguousarray(np.stack([m.tap_slot for m in models], axis=-1)),
        tap_weight=lanes([m.tap_weight for m in models]),
        step_index=step_index,
        step_area=step_area,
    )


def fill_pipes(
    tile: Tile, pressure: Floats, temperature: Floats, velocity: Floats | float = 0.0
) -> None:
    """Sets the gas in all slots and forgets what its walls remember.

    Args:
        tile: The batch.
        pressure: (slots, lanes) Pa.
        temperature: (slots, lanes) or broadcast to it, K.
        velocity: (slots, lanes) m/s.
    """
    gas = tile.models[0].gas
    k, rest = tile.cell[L.COMPLIANCE], tile.cell[L.REST_P]
    stretch = 1.0 + k * (pressure - rest)
    rho = pressure * stretch / (gas.r_specific * temperature)
    tile.state[:] = 0.0
    tile.state[L.RHO] = rho
    tile.state[L.MOM] = rho * velocity
    tile.state[L.ENE] = (
        pressure * stretch / (gas.gamma - 1.0)
        + 0.5 * k * (pressure**2 - rest**2)
        + 0.5 * rho * velocity**2
    )


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


def fill_chambers(tile: Tile, pressure: Floats, temperature: Floats) -> None:
    """Sets the gas in the chambers.

    Args:
        tile: The batch.
        pressure: (n_chambers, lanes) Pa.
        temperature: (n_chambers, lanes) K.
    """
    gas = tile.models[0].gas
    com, rest = tile.chamber[:, L.C_COMPLIANCE], tile.chamber[:, L.C_REST_P]
    volume = tile.chamber[:, L.C_VOLUME] + com * (pressure - rest)
    tile.chamber_state[:, 0] = pressure * volume / (gas.r_specific * temperature)
    tile.chamber_state[:, 1] = pressure * volume / (gas.gamma - 1.0) + 0.5 * com * (
        pressure**2 - rest**2
    )


def advance(
    tile: Tile,
    samples: int,
    n_sub: int,
    dt_s: float,
    opening: Floats,
    nudge_p: Floats | None = None,
    nudge_rate: float = 0.0,
    nudge_field: tuple[Floats, Floats] | None = None,
    strict: bool = True,
) -> tuple[Floats, Floats, Floats]:
    """Advances a batch in place.

    Args:
        tile: The batch.
        samples: Recorded samples; the first is the present state.
        n_sub: Steps between samples.
        dt_s: Step, s.
        opening: ((samples - 1) * KNOTS_PER_SAMPLE + 1, n_ports, lanes) openings.
        nudge_p: (n, n_taps, lanes) measured pressures to which the state is drawn during the first
            n - 1 samples.
        nudge_rate: Rate of that pull, 1/s.
        nudge_field: (slots, n_taps) and (n_chambers, n_taps) weights that spread the taps' errors.
        strict: Whether an unstable lane is an error; else its predictions are not finite.

    Returns:
        (samples, n_taps, lanes) tap pressures, (samples, n_ports, lanes) port flows and
        (samples, n_chambers, lanes) chamber pressures.

    Raises:
        InputError: A prediction is not finite, and ``strict``.
    """
    first, plan, w = tile.models[0], tile.plan, tile.lanes
    tap_out = np.zeros((samples, len(plan.taps), w))
    flow_out = np.zeros((samples, plan.ports.shape[0], w))
    chamber_out = np.zeros((samples, len(plan.chambers), w))
    nudge = np.full((1, len(plan.taps), w), np.nan) if nudge_p is None else nudge_p
    kernel.advance(
        samples,
        n_sub,
        dt_s,
        KNOTS_PER_SAMPLE,
        w,
        first.gas.gamma,
        first.gas.r_specific,
        first.gas.prandtl,
        first.order,
        first.flux,
        first.limiter,
        first.newton,
        tile.compliant,
        tile.memory,
        tile.cell.reshape(L.PARAM_ROWS, -1),
        tile.state.reshape(L.STATE_ROWS, -1),
        tile.work.reshape(L.WORK_ROWS, -1),
        plan.ends,
        tile.step_index,
        tile.step_area,
        plan.ports,
        tile.port,
        # The kernel reads one knot beyond the last.
        np.concatenate([opening, opening[-1:]]),
        tile.port_flow,
        tile.reservoir,
        tile.reservoir_p,
        tile.chamber,
        tile.chamber_state,
        tile.leak_slot,
        tile.leak_area,
        tile.ambient,
        tile.tap_slot,
        tile.tap_weight,
        nudge.shape[0] - 1,
        nudge_rate,
        nudge,
        *(nudge_field or (np.zeros((plan.slots, 0)), np.zeros((len(plan.chambers), 0)))),
        tap_out,
        flow_out,
        chamber_out,
    )
    if strict and not np.isfinite(tap_out).all():
        raise InputError(
            f"the simulation became unstable at a time step of {dt_s:.3g} s; raise"
            " grid.wave_speed_m_s or lower grid.cfl"
        )
    return tap_out, flow_out, chamber_out
