# SPDX-License-Identifier: Apache-2.0
"""The thin-plate model (thesis 3.2.1, 8.1.3): volumes filled through isentropic orifices.

Every line that ends closed is one volume at one pressure; a line open to a reservoir has the
reservoir's pressure. The flow through a port is that of an ideal orifice,

    mdot = C_e A_v p_u / sqrt(R T) * sqrt(2 g / (g - 1) (x^(2/g) - x^((g + 1)/g))),

``x = p_d / p_u``, not below its critical value ``(2 / (g + 1))^(g / (g - 1))`` (eqs. 3.15-3.17).
The area is the opening times the one that passes the port's sonic conductance when choked, or the
port's own. Volumes follow ``V dp/dt = n R T mdot`` with polytropic exponent n; gas leaves at the
volume's temperature ``p V / (m R)`` and enters at its own, of which an isothermal wall (n = 1)
leaves nothing and an adiabatic one (n = g) all.
"""

import numpy as np

from pneu_sim import layout as L
from pneu_sim.gas import AIR, Gas
from pneu_sim.lumped.model import (
    RELIEF_COLUMNS,
    V_COMPLIANCE,
    V_LEAK,
    V_POROUS,
    V_REST_P,
    V_VOLUME,
    VOLUME_COLUMNS,
    LumpedModel,
)
from pneu_sim.lumped.network import Network, reduce_network
from pneu_sim.rig.build import build as build_full
from pneu_sim.rig.expand import with_cylinders
from pneu_sim.rig.model import Model
from pneu_sim.rig.plan import Plan
from pneu_sim.rig.schema import Rig

MOST_LINEAR = 0.9999
"""An orifice's flow has no slope where pressures meet; above this ratio it is always linear."""


def build(rig: Rig, plan: Plan | None = None, gas: Gas = AIR) -> LumpedModel:
    """Reduces a rig to its thin-plate model.

    Volumes are those of the full model's cells and chambers, so that dead volumes, blockages,
    yielding walls, leaks and whatever acts on spools and sensors count here too. Friction, wall
    heat, losses, droop and ripples have no counterpart.

    Args:
        rig: The rig.
        plan: Its grid plan; None makes the rig's own.
        gas: The gas.

    Returns:
        The model.

    Raises:
        InputError: The rig has no such reduction.
    """
    network = reduce_network(rig)
    full = build_full(rig, plan, gas)
    rig = with_cylinders(rig)
    plan = full.plan
    ports = plan.ports
    ideal = gas.area_from_conductance(full.port[:, L.Q_CONDUCTANCE])
    area = np.where(ports[:, L.P_MODE] == L.ISO6358, ideal, full.port[:, L.Q_AREA])
    sides = [
        place
        for row in ports
        for place in (
            _place(rig, plan, network, row[L.P_A], row[L.P_AI]),
            _place(rig, plan, network, row[L.P_B], row[L.P_BI]),
        )
    ]
    volume, cells = _volumes(full, network)
    of_taps = [
        network.of_node[str(tap.chamber)] if tap.pipe is None else network.of_pipe[tap.pipe]
        for tap in rig.taps.values()
    ]
    n_sides = 2 * len(ports)
    return LumpedModel(
        base=full,
        exponent=rig.lumped.exponent,
        side=np.array(sides, dtype=np.int64),
        area=rig.lumped.discharge * area,
        linear=np.minimum(full.port[:, L.Q_LAMINAR], MOST_LINEAR),
        source=np.take(full.reservoir, (L.R_PRESSURE, L.R_TEMPERATURE), axis=1),
        volume=volume,
        cells=cells,
        tap=np.array(of_taps, dtype=np.int64),
        chamber=np.array([network.of_node[name] for name in plan.chambers], dtype=np.int64),
        tap_delay_s=np.zeros((len(of_taps), n_sides)),
        side_delay_s=np.zeros((n_sides, n_sides)),
        drag=np.zeros((n_sides, 2)),
    )


def _place(rig: Rig, plan: Plan, network: Network, kind: int, index: int) -> int:
    """Volume or source at one side of a port."""
    if kind == L.SIDE_RESERVOIR:
        return network.of_node[plan.reservoirs[index]]
    if kind == L.SIDE_CHAMBER:
        return network.of_node[plan.chambers[index]]
    return network.of_pipe[list(rig.pipes)[index // 2]]


def _volumes(full: Model, network: Network) -> tuple[np.ndarray, list[np.ndarray]]:
    """Rows of the volumes, and the slots of their pipes."""
    plan = full.plan
    rows = np.zeros((len(network.volumes), VOLUME_COLUMNS))
    rows[:, V_REST_P] = full.ambient[0]
    cells = []
    reliefs: list[list[tuple[float, float, float]]] = []
    for k, volume in enumerate(network.volumes):
        slots = [np.arange(s, s + n) for s, n in (plan.pipes[name] for name in volume.pipes)]
        own = np.concatenate(slots) if slots else np.zeros(0, dtype=np.int64)
        cells.append(own.astype(np.int64))
        size = 1.0 / full.cell[L.INV_VOLUME, own]
        rows[k, V_VOLUME] = size.sum()
        rows[k, V_COMPLIANCE] = (size * full.cell[L.COMPLIANCE, own]).sum()
        for name in volume.chambers:
            chamber = full.chamber[plan.chambers.index(name)]
            rows[k, V_VOLUME] += chamber[L.C_VOLUME]
            rows[k, V_COMPLIANCE] += chamber[L.C_COMPLIANCE]
        slots_of = {-1 - plan.chambers.index(name) for name in volume.chambers} | set(own.tolist())
        rows[k, V_LEAK] = sum(leak for slot, leak in full.leaks.items() if slot in slots_of)
        rows[k, V_POROUS] = sum(leak for slot, leak in full.porous.items() if slot in slots_of)
        valves: dict[tuple[float, float], float] = {}
        for slot in slots_of & set(full.reliefs):
            for area, opens, span in full.reliefs[slot]:
                valves[opens, span] = valves.get((opens, span), 0.0) + area
        reliefs.append([(area, *at) for at, area in sorted(valves.items())])
    most = max((len(valves_of) for valves_of in reliefs), default=0)
    more = np.zeros((len(reliefs), most * RELIEF_COLUMNS))
    for k, valves_of in enumerate(reliefs):
        more[k, : len(valves_of) * RELIEF_COLUMNS] = np.ravel(valves_of)
    return np.concatenate([rows, more], axis=1), cells
