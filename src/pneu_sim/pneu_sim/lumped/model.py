# SPDX-License-Identifier: Apache-2.0
"""The numbers of a lumped model: volumes, sources, ports, and the lines' delays and resistances."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.model import Model
from pneu_sim.rig.plan import Plan

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Columns of a volume's row (see LumpedModel.volume).
V_VOLUME, V_COMPLIANCE, V_REST_P, V_LEAK, V_POROUS = 0, 1, 2, 3, 4
VOLUME_COLUMNS = 5
# After them, as often as a volume of the rig needs: area, set pressure and range of a relief valve.
RELIEF_COLUMNS = 3


@dataclass
class LumpedModel:
    """A rig reduced to volumes and sources; pressures in Pa, volumes in m^3, areas in m^2.

    Places are volumes from 0 on, or ``-1 - k`` for source k. A *side* is one end of a port: side
    ``2 q`` is the ``from`` end of port q, side ``2 q + 1`` its ``to`` end.

    Attributes:
        base: The model of the same rig in full: spools, opening curves, sensors, room, gas.
        exponent: Polytropic exponent of the volumes.
        side: (2 n_ports,) place of each side.
        area: (n_ports,) effective area fully open.
        linear: (n_ports,) pressure ratio above which the flow is linear in the pressure drop.
        source: (n_sources, 2) pressure and temperature.
        volume: (n_volumes, 5 + 3 n) volume at rest, growth per pascal, rest pressure, leak area,
            flow of porous leaks over p^2 - p_room^2, then the relief valves.
        cells: Per volume the slots of its pipes, for the initial pressure.
        tap: (n_taps,) place of each tap.
        chamber: (n_chambers,) place of each chamber.
        tap_delay_s: (n_taps, 2 n_ports) travel time from each side to each tap.
        side_delay_s: (2 n_ports, 2 n_ports) the same to the sides.
        drag: (2 n_ports, 2) resistance of the line behind each side over its length, R_t L: laminar
            in Pa s/m, and turbulent per (kg/s)^0.75.
    """

    base: Model
    exponent: float
    side: Ints
    area: Floats
    linear: Floats
    source: Floats
    volume: Floats
    cells: list[Ints]
    tap: Ints
    chamber: Ints
    tap_delay_s: Floats
    side_delay_s: Floats
    drag: Floats

    @property
    def plan(self) -> Plan:
        """Grid plan of the rig: names and order of ports, taps and chambers."""
        return self.base.plan
