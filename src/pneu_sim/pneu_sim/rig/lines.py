# SPDX-License-Identifier: Apache-2.0
"""The pipes of a rig as numbers of their cells: shape, walls, losses."""

import math

import numpy as np
from numpy.typing import NDArray

from pneu_sim import layout as L
from pneu_sim.gas import Gas
from pneu_sim.rig.cells import Narrowed, areas, faces_near, narrowed_by, spread
from pneu_sim.rig.plan import Plan
from pneu_sim.rig.schema import Pipe, Rig

Floats = NDArray[np.float64]


def cells_of(rig: Rig, plan: Plan, gas: Gas) -> Floats:
    """(PARAM_ROWS, slots) numbers of all cells, see ``layout``; slots that are none are ghosts.

    Args:
        rig: The rig, its effects applied.
        plan: Its grid plan.
        gas: The gas.
    """
    room = rig.ambient
    cell = np.zeros((L.PARAM_ROWS, plan.slots))
    cell[L.LENGTH] = -1.0
    cell[L.AREA] = 1.0
    cell[L.ROUGH] = 1.0
    cell[L.WALL_T] = room.temperature_k
    cell[L.REST_P] = room.pressure_pa
    for name, pipe in rig.pipes.items():
        first, n = plan.pipes[name]
        span = slice(first, first + n)
        faces = np.linspace(0.0, pipe.length_m, n + 1)
        narrowed = narrowed_by(pipe, faces)
        cell[L.FACE, first - 1 : first + n] = _shape(cell[:, span], pipe, faces, narrowed)
        _walls(cell[:, span], pipe, narrowed, gas, room.temperature_k)
        cell[[L.LOSS, L.RESISTANCE], first - 1 : first + n] = _losses(pipe, faces, narrowed)
    if not rig.grid.memory:
        # One rig of a batch may have memory where the others have none.
        cell[[L.UNSTEADY, L.HEAT_UNSTEADY]] = 0.0
    return cell


def _shape(cell: Floats, pipe: Pipe, faces: Floats, narrowed: Narrowed) -> Floats:
    """Lengths, areas and volumes of the cells of a pipe; returns the areas of its faces."""
    dx = pipe.length_m / (faces.size - 1)
    centres = 0.5 * (faces[1:] + faces[:-1])
    area, plain = areas(pipe, faces)
    face = plain * narrowed.face
    tapering = np.diff(plain) / (area * dx)
    volume = area * dx * narrowed.area * narrowed.length
    volume[0] += pipe.volume_from_m3
    volume[-1] += pipe.volume_to_m3
    for extra in pipe.volumes:
        for i, share in spread(extra.position_m, centres):
            volume[i] += share * extra.volume_m3
    cell[L.AREA] = area * narrowed.area
    cell[L.INV_VOLUME] = 1.0 / volume
    cell[L.LENGTH] = dx * narrowed.length
    # beside a narrowing a taper is one of steps
    plain_there = (narrowed.face == 1.0)[:-1] & (narrowed.face == 1.0)[1:] & (narrowed.area == 1.0)
    cell[L.TAPER] = np.where(plain_there, tapering, 0.0)
    return face


def _walls(cell: Floats, pipe: Pipe, narrowed: Narrowed, gas: Gas, room_k: float) -> None:
    """Friction, heat and yielding of the walls of a pipe whose cells have their areas."""
    mu, k_gas = float(gas.viscosity(room_k)), float(gas.conductivity(room_k))
    wall, area = pipe.wall, cell[L.AREA]
    diameter = np.sqrt(4.0 * area / math.pi)
    plain = area / narrowed.area
    cell[L.VISCOUS] = 8.0 * math.pi * mu / plain * narrowed.viscous
    cell[L.LAMINAR] = wall.laminar
    cell[L.UNSTEADY] = wall.unsteady * 4.0 * math.pi * mu / area
    cell[L.RELAX] = L.UNSTEADY_RATE * math.pi * mu / area
    cell[L.REYNOLDS] = diameter / mu
    cell[L.ROUGH] = (wall.roughness_m / (3.7 * diameter)) ** 1.11
    cell[L.TURBULENT] = wall.turbulent * narrowed.turbulent / narrowed.viscous
    cell[L.ONSET] = 1.0 / wall.onset_reynolds
    cell[L.QUICKEN] = wall.turbulent_fade
    if wall.heat_kappa is None:
        cell[L.HEAT] = wall.nusselt * math.pi * k_gas / area
        cell[L.HEAT_TURBULENT] = wall.heat_turbulent
    else:
        cell[L.HEAT] = wall.heat_kappa / np.sqrt(area)
    cell[L.HEAT_UNSTEADY] = wall.heat_unsteady * 4.0 * math.pi * k_gas / area
    # Heat is per volume of all gas of the cell: a volume beside it has no wall, and that of one
    # that is narrowed in part is no longer than the cell itself.
    volume = 1.0 / cell[L.INV_VOLUME]
    share = area * (cell[L.LENGTH] / narrowed.length) / volume
    cell[[L.HEAT, L.HEAT_TURBULENT, L.HEAT_UNSTEADY]] *= share
    # its wall alone yields, not what lies beside it
    cell[L.COMPLIANCE] = wall.compliance_per_pa * area * cell[L.LENGTH] / volume


def lost_beyond(
    pipe: Pipe, n: int, position_m: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """What is lost between a point of a pipe and either of its ends: heads over A^2, and R over A.

    At fittings in the outermost cells alone: they are at the face next to those, on the other side
    of the point, so that the gas of its cell has the pressure behind them.

    Args:
        pipe: The pipe.
        n: Its cells.
        position_m: Where the point is.

    Returns:
        1/m^4 and Pa s/m^3 at the end that it is from, and at the one that it is to.
    """
    if n < 2:
        return (0.0, 0.0), (0.0, 0.0)
    faces = np.linspace(0.0, pipe.length_m, n + 1)
    plain = areas(pipe, faces)[1]
    fittings = [(0.0, pipe.loss_from, 0.0), (pipe.length_m, pipe.loss_to, 0.0)]
    fittings += [(loss.position_m, loss.k, loss.resistance_pa_s_m) for loss in pipe.losses]
    found = []
    for beyond, face in (
        ([f for f in fittings if f[0] < min(position_m, faces[1])], 1),
        ([f for f in fittings if f[0] > max(position_m, faces[-2])], -2),
    ):
        heads, resistance = sum(f[1] for f in beyond), sum(f[2] for f in beyond)
        found.append((float(heads / plain[face] ** 2), float(resistance / plain[face])))
    return found[0], found[1]


def _losses(pipe: Pipe, faces: Floats, narrowed: Narrowed) -> Floats:
    """(2, n + 1) what is lost at the faces of a pipe: velocity heads over A^2, and R over A.

    Losses at an end are those of the face next to it.
    """
    lost = np.zeros((2, faces.size))
    lost[0] = narrowed.heads
    ends = ((0.0, pipe.loss_from, 0.0), (pipe.length_m, pipe.loss_to, 0.0))
    along = [(loss.position_m, loss.k, loss.resistance_pa_s_m) for loss in pipe.losses]
    for x, heads, resistance in (*ends, *along):
        for f, share in faces_near(x, faces):
            lost[:, f] += share * heads, share * resistance
    plain = areas(pipe, faces)[1]
    return np.array([lost[0] / plain**2, lost[1] / plain])
