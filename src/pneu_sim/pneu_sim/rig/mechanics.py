# SPDX-License-Identifier: Apache-2.0
"""Cylinders and bodies of a rig as tables and numbers, as the kernel takes them."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim import layout as L
from pneu_sim.bodies.kinds import NUMBER
from pneu_sim.rig.cylinder import Cylinder
from pneu_sim.rig.expand import chamber_of, part_name, port_name
from pneu_sim.rig.schema import Rig, joint_names
from pneu_sim.signals import velocity_of

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SIDES = ("head", "rod")
SLIPPED_M = 1e-9
"""Metres or radians by which a cylinder may be put beyond its stroke: rounding."""


def lay_cylinders(
    rig: Rig, pipes: Mapping[str, tuple[int, int]], port_names: Sequence[str]
) -> Ints:
    """What holds the gas of every cylinder.

    Args:
        rig: The rig, its cylinders' gas as chambers and pipes.
        pipes: Per pipe, first cell's slot and number of cells.
        port_names: Names of ports and orifices.

    Returns:
        (n_cylinders, CYLINDER_COLUMNS), see ``layout``.
    """
    chambers = list(rig.chambers)
    table = np.zeros((len(rig.cylinders), L.CYLINDER_COLUMNS), dtype=np.int64)
    table[:, [L.Y_PORT, L.Y_PORT_ROD]] = -1
    for k, (name, cylinder) in enumerate(rig.cylinders.items()):
        for s, side_name in enumerate(SIDES):
            side = cylinder.sides.get(side_name)
            row = table[k, L.COLUMNS_PER_SIDE * s : L.COLUMNS_PER_SIDE * (s + 1)]
            if side is None:
                row[L.Y_KIND] = L.GAS_ROOM
            elif cylinder.gas == "chamber":
                where = chamber_of(name, side_name, side)
                row[:] = L.GAS_CHAMBER, chambers.index(where), 0
            else:
                row[:] = L.GAS_CELLS, *pipes[part_name(name, side_name)]
            if side is not None and side.port_conductance_m3_s_pa is not None:
                table[k, L.Y_PORT + s] = port_names.index(port_name(name, side_name))
    return table


def shortest_of_cylinders(rig: Rig) -> float:
    """Length of the shortest cell beside a piston that has come to its end, m.

    Args:
        rig: The rig.
    """
    shortest = math.inf
    for cylinder in rig.cylinders.values():
        if cylinder.gas == "cells":
            for side_name, side in cylinder.sides.items():
                area = cylinder.areas[SIDES.index(side_name)]
                shortest = min(shortest, side.dead_volume_m3 / area)
    return shortest


def lay_bodies(rig: Rig) -> tuple[Ints, Ints, list[str]]:
    """Bodies, the cylinders that drive them, and the names of their joints.

    Args:
        rig: The rig.

    Returns:
        (n_bodies, BODY_COLUMNS), (places,) and the names.

    Raises:
        InputError: Two joints have one name.
    """
    cylinders = list(rig.cylinders)
    table = np.zeros((len(rig.bodies), L.BODY_COLUMNS), dtype=np.int64)
    places: list[int] = []
    joints: list[str] = []
    names = iter(joint_names(rig))
    for b, (name, body) in enumerate(rig.bodies.items()):
        driven = body.driven_by
        table[b] = NUMBER[type(body)], len(joints), len(body.joints), len(places), len(driven)
        places += [cylinders.index(cylinder) for cylinder in driven]
        for field in body.joint_fields:
            called = next(names)
            if called in joints:
                raise InputError(
                    f"rig {rig.name!r}: bodies.{name}.{field}.name: found {called!r}, which another"
                    " joint is named already"
                )
            if called in map(velocity_of, joints) or velocity_of(called) in joints:
                raise InputError(
                    f"rig {rig.name!r}: bodies.{name}.{field}.name: found {called!r}, beside which"
                    " a joint and another's velocity would have one name"
                )
            joints.append(called)
    return table, np.array(places, dtype=np.int64), joints


def lay_encoders(rig: Rig, joints: Sequence[str]) -> Ints:
    """What every encoder is on.

    Args:
        rig: The rig.
        joints: Names of the joints of its bodies.

    Returns:
        (n_encoders,) number of a joint, or -1 - number of a cylinder. Joints of a mechanism are
        not numbered here: 0.
    """
    cylinders = list(rig.cylinders)
    table = np.zeros(len(rig.encoders), dtype=np.int64)
    for e, (name, encoder) in enumerate(rig.encoders.items()):
        if encoder.cylinder is not None:
            table[e] = -1 - cylinders.index(encoder.cylinder)
        elif rig.mechanism is None:
            table[e] = joints.index(encoder.on(name))
    return table


def slice_of(row: Ints) -> slice:
    """The places of a body in the list of cylinders that drive bodies.

    Args:
        row: (BODY_COLUMNS,) of its table.
    """
    return slice(int(row[L.B_PLACE]), int(row[L.B_PLACE] + row[L.B_PLACES]))


def within_stroke(extension: float, stroke: float) -> bool:
    """Whether a piston may be put somewhere.

    Args:
        extension: Where, m or rad.
        stroke: Its stroke, likewise.
    """
    return -SLIPPED_M <= extension <= stroke + SLIPPED_M


def check_starts(rig: Rig) -> None:
    """Raises InputError where a body's joints put a piston beyond its stroke as they start.

    Args:
        rig: The rig.
    """
    if not rig.bodies:
        return
    # The compiler is loaded where there are bodies.
    from pneu_sim.kernel.equations.kinds import levers

    rows, _ = body_rows(rig)
    for b, (name, body) in enumerate(rig.bodies.items()):
        start = np.array([joint.start for joint in body.joints])
        extension = np.zeros(len(body.driven_by))
        lever = np.zeros((extension.size, start.size))
        levers(NUMBER[type(body)], rows[:, :, None], b, 0, start, extension, lever)
        for driven, found in zip(body.driven_by, extension.tolist(), strict=True):
            stroke = rig.cylinders[driven].stroke
            if not within_stroke(found, stroke):
                joints = ", ".join(
                    f"{field}.start {joint.start:g}"
                    for field, joint in zip(body.joint_fields, body.joints, strict=True)
                )
                raise InputError(
                    f"rig {rig.name!r}: bodies.{name}: found {joints}, which put cylinder"
                    f" {driven!r} at an extension of {found:.6g}; its stroke allows 0 to {stroke:g}"
                )


def cylinder_rows(rig: Rig) -> Floats:
    """Numbers of all cylinders.

    Args:
        rig: The rig.

    Returns:
        (n_cylinders, CYLINDER_PARAMS), see ``layout``.
    """
    rows = np.zeros((len(rig.cylinders), L.CYLINDER_PARAMS))
    for row, cylinder in zip(rows, rig.cylinders.values(), strict=True):
        _fill_row(row, cylinder)
        row[L.PY_ROOM_P] = rig.ambient.pressure_pa
        row[L.PY_ROOM_T] = rig.ambient.temperature_k
    return rows


def _fill_row(row: Floats, cylinder: Cylinder) -> None:
    """Numbers of one cylinder but those of the room."""
    friction = cylinder.friction
    row[L.PY_STROKE] = cylinder.stroke
    row[L.PY_COULOMB] = friction.coulomb_n
    row[L.PY_PER_PA] = friction.coulomb_n_per_pa
    row[L.PY_BREAKAWAY] = friction.breakaway_n
    row[L.PY_STRIBECK] = friction.stribeck_m_s
    row[L.PY_VISCOUS] = friction.viscous_n_s_m
    row[L.PY_LEAK] = cylinder.piston_leak_m2
    row[L.PY_ROD_LEAK] = cylinder.rod_leak_m2
    row[L.PY_SPRING] = cylinder.spring_n_m
    row[L.PY_PRELOAD] = cylinder.spring_preload_n
    row[L.PY_STOP] = cylinder.stop_stiffness_n_m
    row[L.PY_STOP_DAMPING] = cylinder.stop_damping_n_s_m
    row[L.PY_START] = cylinder.start_m
    row[L.PY_SOFT] = friction.presliding_m_n
    row[L.PY_SOFT_DAMPING] = friction.presliding_n_s_m
    row[L.PY_MASS] = cylinder.loose_kg
    for s, side_name in enumerate(SIDES):
        area = cylinder.areas[s]
        row[L.PY_AREA + s] = area
        side = cylinder.sides.get(side_name)
        if side is None:
            continue
        row[L.PY_DEAD + s] = side.dead_volume_m3
        film = cylinder.heat_w_m2_k * cylinder.perimeter_m(side_name)
        row[L.PY_FILM + s] = film
        covers = 2.0 * cylinder.heat_w_m2_k * area if cylinder.rotary is None else 0.0
        # the dead volume as a disc of the bore
        dead = film * side.dead_volume_m3 / area if film > 0.0 else 0.0
        row[L.PY_HEAT + s] = side.heat_w_per_k + covers + dead
        if side.cushion is not None:
            row[L.PY_CUSHION + s] = side.cushion.length_m
            row[L.PY_LEFT + s] = side.cushion.opening


def body_rows(rig: Rig) -> tuple[Floats, Floats]:
    """Numbers of all bodies and of their joints.

    Args:
        rig: The rig.

    Returns:
        (n_bodies, BODY_PARAMS) and (n_joints, JOINT_PARAMS), see ``layout``.
    """
    rows = np.zeros((len(rig.bodies), L.BODY_PARAMS))
    joints: list[tuple[float, ...]] = []
    for row, body in zip(rows, rig.bodies.values(), strict=True):
        numbers = body.numbers()
        row[: len(numbers)] = numbers
        joints += [
            (
                joint.viscous,
                joint.dry_friction,
                -math.inf if joint.lower is None else joint.lower,
                math.inf if joint.upper is None else joint.upper,
                joint.stop_stiffness,
                joint.stop_damping,
                float(joint.held),
                joint.start,
                joint.play,
                joint.spring,
                joint.spring_at,
                joint.stop_hold,
            )
            for joint in body.joints
        ]
    return rows, np.array(joints, dtype=float).reshape(-1, L.JOINT_PARAMS)
