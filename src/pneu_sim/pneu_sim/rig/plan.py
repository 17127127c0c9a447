# SPDX-License-Identifier: Apache-2.0
"""The grid of a rig: which slot is which cell, end or port, whatever the numbers in them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim import layout as L
from pneu_sim.rig.expand import with_cylinders
from pneu_sim.rig.mechanics import (
    lay_bodies,
    lay_cylinders,
    lay_encoders,
    shortest_of_cylinders,
    slice_of,
)
from pneu_sim.rig.network import port_ends
from pneu_sim.rig.schema import CLOSED, Rig
from pneu_sim.rig.valve_kinds import SWITCH_STEP_S

Ints = NDArray[np.int64]

LEAST_STEP_S = 1e-7
"""A second of shorter steps would take minutes at least."""
MOST_CELLS = 1_000_000
"""More would fill the memory, and a second of simulation would take hours."""


@dataclass(frozen=True)
class Plan:
    """The part of a model that its parameters do not change: which slot is what.

    Attributes:
        pipes: Per pipe, first cell's slot and number of cells.
        slots: Number of slots, ghosts included.
        ends: Pipe ends, see ``layout``.
        ports: Valve ports, then orifices, see ``layout``.
        port_names: ``valve.port`` or the orifice's name.
        port_valve: Valve of each port; -1 for an orifice.
        reservoirs: Names; the last is the room as a sink where no rig reservoir is used.
        chambers: Names.
        valves: Names.
        commands: Command of each valve.
        taps: Names.
        cylinders: Names.
        cylinder: (n_cylinders, CYLINDER_COLUMNS) what holds the gas of each, see ``layout``.
        moves: (n_cylinders,) body that each moves, or -1.
        bodies: Names.
        body: (n_bodies, BODY_COLUMNS), see ``layout``.
        driven_by: (places,) cylinders that take hold of bodies, body by body.
        joints: Names.
        encoders: Names.
        encoder_of: (n_encoders,) joint that each is on, or -1 - cylinder.
        dt_s: Largest time step.
        regulators: (n_regulators, REG_COLUMNS) ports of pressure regulators, see ``layout``.
    """

    pipes: dict[str, tuple[int, int]]
    slots: int
    ends: Ints
    ports: Ints
    port_names: list[str]
    port_valve: list[int]
    reservoirs: list[str]
    chambers: list[str]
    valves: list[str]
    commands: list[str]
    taps: list[str]
    cylinders: list[str]
    cylinder: Ints
    moves: Ints
    bodies: list[str]
    body: Ints
    driven_by: Ints
    joints: list[str]
    encoders: list[str]
    encoder_of: Ints
    dt_s: float
    regulators: Ints


def plan_grid(rig: Rig, dx_m: float | None = None, fewest: int = 2) -> Plan:
    """Lays out slots, ends and ports of a rig.

    Args:
        rig: The rig.
        dx_m: Cell length that replaces the rig's, for every pipe alike in proportion.
        fewest: Cells that the shortest pipe has at least.

    Raises:
        InputError: The rig asks for a time step above the stable limit, or for more cells or
            steps than any run could be waited for.
    """
    rig = with_cylinders(rig)
    scale = 1.0 if dx_m is None else dx_m / rig.grid.dx_m
    pipes, slots, shortest = _lay_pipes(rig, scale, fewest)
    ends, at_node = _lay_ends(rig, pipes)
    ports, names, of_valve = _lay_ports(rig, at_node)
    body, driven_by, joints = lay_bodies(rig)
    moves = np.full(len(rig.cylinders), -1, dtype=np.int64)
    for b in range(len(body)):
        moves[driven_by[slice_of(body[b])]] = b
    return Plan(
        pipes=pipes,
        slots=slots,
        ends=ends,
        ports=ports,
        port_names=names,
        port_valve=of_valve,
        reservoirs=list(rig.reservoirs),
        chambers=list(rig.chambers),
        valves=list(rig.valves),
        commands=[valve.command for valve in rig.valves.values()],
        taps=list(rig.taps),
        cylinders=list(rig.cylinders),
        cylinder=lay_cylinders(rig, pipes, names),
        moves=moves,
        bodies=list(rig.bodies),
        body=body,
        driven_by=driven_by,
        joints=joints,
        encoders=list(rig.encoders),
        encoder_of=lay_encoders(rig, joints),
        dt_s=_step_s(rig, shortest, dx_m),
        regulators=_regulators(rig, names),
    )


def _lay_pipes(
    rig: Rig, scale: float, fewest: int
) -> tuple[dict[str, tuple[int, int]], int, float]:
    """First slot and number of cells of every pipe, number of slots, and shortest cell, m."""
    pipes: dict[str, tuple[int, int]] = {}
    slot = 0
    shortest = math.inf
    for name, pipe in rig.pipes.items():
        cells = max(fewest, round(pipe.length_m / ((pipe.dx_m or rig.grid.dx_m) * scale)))
        pipes[name] = (slot + 1, cells)
        slot += cells + 2
        shortest = min(shortest, pipe.length_m / cells)
    slot = max(slot, 3)  # passes over slots have some, if only ghosts
    shortest = min(shortest, shortest_of_cylinders(rig))
    if not math.isfinite(shortest):
        shortest = rig.grid.dx_m * scale  # vessels alone
    if slot > MOST_CELLS:
        raise InputError(
            f"grid.dx_m: found {rig.grid.dx_m * scale:g} m, which makes {slot:.2g} cells; allowed"
            f" are {MOST_CELLS}"
        )
    return pipes, slot, shortest


def _lay_ends(rig: Rig, pipes: dict[str, tuple[int, int]]) -> tuple[Ints, dict[str, list[int]]]:
    """(n_ends, END_COLUMNS) ends of pipes, and those that lie at each node without a vessel."""
    reservoirs, chambers = list(rig.reservoirs), list(rig.chambers)
    at_node: dict[str, list[int]] = {}
    ends = np.zeros((2 * len(pipes), L.END_COLUMNS), dtype=np.int64)
    ported = {node for ends_of_port in port_ends(rig) for node in ends_of_port}
    for k, (name, pipe) in enumerate(rig.pipes.items()):
        first, cells = pipes[name]
        last = first + cells - 1
        for side, node in enumerate((pipe.from_node, pipe.to_node)):
            e = 2 * k + side
            ends[e, L.E_CELL] = last if side else first
            ends[e, L.E_GHOST] = last + 1 if side else first - 1
            ends[e, L.E_FACE] = last if side else first - 1
            ends[e, L.E_SIGN] = 1 if side else -1
            if node == CLOSED:
                ends[e, L.E_KIND] = L.WALL
            elif node in reservoirs:
                ends[e, L.E_KIND] = L.RESERVOIR if rig.grid.thesis_ends else L.TANK
                ends[e, L.E_REF] = reservoirs.index(node)
            elif node in chambers:
                ends[e, L.E_KIND] = L.CHAMBER
                ends[e, L.E_REF] = chambers.index(node)
            elif node in ported:
                ends[e, L.E_KIND] = L.PORTED
                at_node[node] = [e]
            else:
                at_node.setdefault(node, []).append(e)
    for group in at_node.values():
        if len(group) < 2:
            continue
        if len(group) > 2 and not rig.grid.thesis_joints:
            for e in group:
                ends[e, L.E_KIND] = L.JUNCTION
                ends[e, L.E_REF] = group[0]
            continue
        # The first two ends in file order share a face; further ones branch onto the first.
        a, b, *rest = group
        ends[a, L.E_KIND] = ends[b, L.E_KIND] = L.LINK
        ends[a, L.E_REF], ends[b, L.E_REF] = b, a
        for e in rest:
            ends[e, L.E_KIND] = L.BRANCH
            ends[e, L.E_REF] = a
    return ends, at_node


def _lay_ports(rig: Rig, at_node: dict[str, list[int]]) -> tuple[Ints, list[str], list[int]]:
    """(n_ports, PORT_COLUMNS) ports of valves, then orifices; their names and their valves."""
    reservoirs, chambers = list(rig.reservoirs), list(rig.chambers)
    ports: list[list[int]] = []
    names: list[str] = []
    of_valve: list[int] = []

    def side_of(node: str) -> tuple[int, int]:
        if node in reservoirs:
            return L.SIDE_RESERVOIR, reservoirs.index(node)
        if node in chambers:
            return L.SIDE_CHAMBER, chambers.index(node)
        return L.SIDE_END, at_node[node][0]

    for v, (valve_name, valve) in enumerate(rig.valves.items()):
        for port_name, port in valve.ports.items():
            mode = L.ISO6358 if port.model == "iso6358" else L.EFFECTIVE_AREA
            ports.append([*side_of(port.from_node), *side_of(port.to_node), mode])
            names.append(f"{valve_name}.{port_name}")
            of_valve.append(v)
    for orifice_name, orifice in rig.orifices.items():
        ports.append([*side_of(orifice.from_node), *side_of(orifice.to_node), L.ISO6358])
        names.append(orifice_name)
        of_valve.append(-1)
    return np.array(ports, dtype=np.int64).reshape(-1, L.PORT_COLUMNS), names, of_valve


def _step_s(rig: Rig, shortest: float, dx_m: float | None) -> float:
    """Longest time step of a rig whose shortest cell is so long, s."""
    stable = rig.grid.cfl * shortest / rig.grid.wave_speed_m_s
    dt = stable
    if rig.grid.dt_s is not None and dx_m is None:
        limit = shortest / rig.grid.wave_speed_m_s
        if rig.grid.dt_s > limit:
            raise InputError(
                f"rig {rig.name!r}: grid.dt_s: found {rig.grid.dt_s:g} s, the stable limit is"
                f" {limit:.3g} s (shortest cell {shortest:.4g} m over"
                f" {rig.grid.wave_speed_m_s:g} m/s)"
            )
        dt = rig.grid.dt_s
    if any(valve.switch or valve.regulator for valve in rig.valves.values()):
        dt = min(dt, SWITCH_STEP_S)
    if rig.cylinders and dt < LEAST_STEP_S:
        raise InputError(
            f"rig {rig.name!r}: found a cell of {shortest:.3g} m, which needs steps of {dt:.2g} s;"
            f" allowed are {LEAST_STEP_S:g} s and more: give dead volumes more room, cells more"
            " length, or hold the gas of cylinders in chambers"
        )
    return dt


def _regulators(rig: Rig, port_names: Sequence[str]) -> Ints:
    """Ports of the regulators of a rig, in the order of its valves."""
    rows = [
        [port_names.index(f"{name}.{port}") for port in (of.fill, of.vent)]
        for name, of in ((name, valve.regulator) for name, valve in rig.valves.items())
        if of is not None
    ]
    return np.array(rows, dtype=np.int64).reshape(-1, L.REG_COLUMNS)


def common_plan(rigs: Sequence[Rig], dx_m: float | None = None, fewest: int = 2) -> Plan:
    """Plan of rigs that run side by side.

    Args:
        rigs: The rigs.
        dx_m: Cell length that replaces theirs, m.
        fewest: Cells that the shortest pipe has at least.

    Raises:
        InputError: They do not share one structure.
    """
    first = rigs[0]
    plan = plan_grid(first, dx_m, fewest)
    for other in rigs[1:]:
        own = plan_grid(other, dx_m, fewest)
        same = list(other.pipes) == list(first.pipes) and all(
            np.array_equal(getattr(own, table), getattr(plan, table))
            for table in ("ends", "ports", "cylinder", "moves", "body", "driven_by", "encoder_of")
        )
        if not same:
            raise InputError(
                f"rig {other.name!r} has other pipes, nodes or cells than {first.name!r}, or other"
                " ports, cylinders or bodies; rigs that run side by side share one structure"
            )
        if plan.cylinders:  # what dead volumes leave of cells may be shorter in another
            plan = replace(plan, dt_s=min(plan.dt_s, own.dt_s))
    return plan
