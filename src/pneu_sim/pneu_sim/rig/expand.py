# SPDX-License-Identifier: Apache-2.0
"""The gas of cylinders as chambers and pipes, so that all that knows those knows cylinders too.

A side whose gas is well mixed is a chamber at the side's node; one whose gas is held in cells is a
pipe that begins at the node and ends, closed, where the piston stands when it is farthest away. A
port that throttles is an orifice before either. What changes with the piston is left to the kernel.
"""

import math
from typing import Any

from pneu_common.errors import InputError
from pneu_sim.rig.cylinder import Cylinder, Side
from pneu_sim.rig.schema import CLOSED, Chamber, Orifice, Pipe, Rig, Wall


def part_name(cylinder: str, side: str) -> str:
    """Name of the chamber or pipe that a side of a cylinder is, where its node is none.

    Args:
        cylinder: Name of the cylinder.
        side: ``head`` or ``rod``.
    """
    return f"{cylinder}.{side}"


def port_name(cylinder: str, side: str) -> str:
    """Name of the orifice that the port of a side is.

    Args:
        cylinder: Name of the cylinder.
        side: ``head`` or ``rod``.
    """
    return f"{cylinder}.{side}.port"


def chamber_of(name: str, side_name: str, side: Side) -> str:
    """Name of the chamber of a side whose gas is well mixed.

    Args:
        name: Name of the cylinder.
        side_name: ``head`` or ``rod``.
        side: The side.
    """
    if side.node == CLOSED or side.port_conductance_m3_s_pa is not None:
        return part_name(name, side_name)
    return side.node


def dead_length_m(rig: Rig, name: str, side: str) -> float:
    """Length that the dead volume of a side takes of its bore.

    Args:
        rig: The rig.
        name: Name of a cylinder whose gas is held in cells.
        side: ``head`` or ``rod``.

    Raises:
        InputError: Its stroke is shorter than a cell.
    """
    cylinder = rig.cylinders[name]
    dx = cylinder.dx_m or rig.grid.dx_m
    if cylinder.stroke < dx:
        raise InputError(
            f"rig {rig.name!r}: cylinders.{name}: found a stroke of {cylinder.stroke:g} m, shorter"
            f" than a cell of {dx:g} m; give it a smaller dx_m, or gas: chamber"
        )
    return cylinder.sides[side].dead_volume_m3 / _area(cylinder, side)


def with_cylinders(rig: Rig) -> Rig:
    """A rig whose cylinders' gas is chambers and pipes; the rig itself where it has none.

    Args:
        rig: The rig, left as it is; effects are applied or not.

    Returns:
        The rig; only for what reads it: it is not checked, and not to be written to a file.

    Raises:
        InputError: A stroke is shorter than a cell.
    """
    if not rig.cylinders:
        return rig
    pipes, chambers, orifices = dict(rig.pipes), dict(rig.chambers), dict(rig.orifices)
    taps = dict(rig.taps)
    for name, cylinder in rig.cylinders.items():
        for side_name, side in cylinder.sides.items():
            node, own = side.node, part_name(name, side_name)
            if side.port_conductance_m3_s_pa is not None:
                orifices[port_name(name, side_name)] = Orifice.model_construct(
                    from_node=node,
                    to_node=own,
                    conductance_m3_s_pa=side.port_conductance_m3_s_pa,
                    critical_ratio=side.port_critical_ratio,
                )
                node = own
            if cylinder.gas == "chamber":
                where = chamber_of(name, side_name, side)
                chambers[where] = Chamber.model_construct(
                    volume_m3=_volume(cylinder, side_name)  # its wall is the cylinder's
                )
                moved: dict[str, Any] = {"chamber": where}
            else:
                dead_m = dead_length_m(rig, name, side_name)
                pipes[own] = _pipe(cylinder, side_name, node, dead_m)
                moved = {"chamber": None, "pipe": own, "position_m": 0.0}
            for tap_name, tap in rig.taps.items():
                if tap.chamber is not None and tap.chamber == side.node:
                    taps[tap_name] = tap.model_copy(update=moved)
    return rig.model_copy(
        update={"pipes": pipes, "chambers": chambers, "orifices": orifices, "taps": taps}
    )


def gas_of_sides(rig: Rig) -> dict[str, str]:
    """The chamber or pipe that holds the gas of every side, by either of the side's names.

    Args:
        rig: The rig.

    Returns:
        By the node of a side, unless it is closed, and by ``cylinder.side``.
    """
    held: dict[str, str] = {}
    for name, cylinder in rig.cylinders.items():
        for side_name, side in cylinder.sides.items():
            own = part_name(name, side_name)
            part = own if cylinder.gas == "cells" else chamber_of(name, side_name, side)
            held[own] = part
            if side.node != CLOSED:
                held[side.node] = part
    return held


def _area(cylinder: Cylinder, side: str) -> float:
    return cylinder.areas[0 if side == "head" else 1]


def _volume(cylinder: Cylinder, side: str) -> float:
    """Gas space of a side while the piston stands where it starts, m3."""
    way = cylinder.start_m if side == "head" else cylinder.stroke - cylinder.start_m
    return cylinder.sides[side].dead_volume_m3 + _area(cylinder, side) * way


def _pipe(cylinder: Cylinder, side: str, node: str, dead_m: float) -> Pipe:
    """A side whose gas is held in cells, as a pipe as long as it ever gets."""
    area = _area(cylinder, side)
    film = cylinder.heat_w_m2_k * cylinder.perimeter_m(side)
    wall = Wall(
        laminar=cylinder.gas_friction,
        turbulent=cylinder.gas_friction,
        unsteady=0.0,
        heat_unsteady=0.0,
        heat_turbulent=0.0,
        heat_kappa=film / math.sqrt(area),  # the kernel has kappa sqrt(A) per length
    )
    return Pipe.model_construct(
        from_node=node,
        to_node=CLOSED,
        length_m=dead_m + cylinder.stroke,
        area_m2=area,
        dx_m=cylinder.dx_m,
        wall=wall,
    )
