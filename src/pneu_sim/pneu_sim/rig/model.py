# SPDX-License-Identifier: Apache-2.0
"""One rig in numbers, as the kernels take them and as effects may change them."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_sim import layout as L
from pneu_sim.gas import Gas
from pneu_sim.rig.plan import Plan

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CURVE_POINTS = 4097
"""Points of the uniform table into which an opening curve is drawn out."""

# Columns of a valve's row (see Model.spool).
V_FREQUENCY, V_DAMPING, V_INTEGRAL, V_LIMIT, V_DELAY = 0, 1, 2, 3, 4
V_HYSTERESIS, V_OFFSET, V_DEAD, V_NULL = 5, 6, 7, 8
V_SPEED, V_CLOSING = 9, 10
V_OFF, V_ON, V_THRESHOLD, V_PERIOD = 11, 12, 13, 14
VALVE_COLUMNS = 15
# Columns of a tap's row (see Model.sensor).
S_LAG, S_GAIN, S_BIAS, S_OFFSET = 0, 1, 2, 3
SENSOR_COLUMNS = 4


@dataclass
class OwnTerm:
    """A term that an effect adds to the equations of the gas.

    Attributes:
        act: The compiled term, see `pneu_sim.kernel.terms`.
        columns: How many numbers it takes for a slot.
        rows: Slot, or -1 - chamber, to those numbers, as often as it acts there.
    """

    act: Callable[..., Any]
    columns: int
    rows: dict[int, list[tuple[float, ...]]] = field(default_factory=dict)


@dataclass
class Model:
    """One rig in numbers; effects may edit any of it before it is run.

    Attributes:
        plan: Structure.
        gas: Gas.
        cell: (PARAM_ROWS, slots) cell parameters.
        port: (n_ports, PORT_PARAMS).
        reservoir: (n_reservoirs, RESERVOIR_PARAMS).
        chamber: (n_chambers, CHAMBER_PARAMS).
        cylinder: (n_cylinders, CYLINDER_PARAMS).
        body: (n_bodies, BODY_PARAMS).
        joint: (n_joints, JOINT_PARAMS).
        leaks: Slot, or -1 - chamber, to effective area, m^2.
        porous: The same to the flow of porous leaks over p^2 - p_room^2, kg/(s Pa^2).
        reliefs: The same to relief valves: effective area m^2, set pressure and range, Pa.
        ripples: Reservoir to ripples of its pressure: amplitude Pa, angular frequency rad/s, phase
            rad.
        spool: (n_valves, VALVE_COLUMNS) natural frequency rad/s, damping, integral gain,
            acceleration limit, delay, hysteresis, null offset, dead-band, null voltage, speed
            limit, how much longer than that the delay of closing is, voltages off and on of a
            switch (alike where there is none), its threshold, period of its modulation (0: none).
        curve: (n_ports, CURVE_POINTS) opening over ``curve_v``; orifices are constant.
        curve_v: (n_ports, 2) voltage range of the table.
        tap_slot: (n_taps,) slot left of the tap, or -1 - chamber.
        tap_weight: (n_taps,) weight of the next slot.
        tap_cell: (n_taps,) slot whose flow loses pressure on its way to or from the tap ...
        tap_lost: (n_taps, 2) ... and what of m |m| / rho and of m / rho it loses; 0 where nothing.
        sensor: (n_taps, 4) lag, gain, bias, clock offset.
        encoder: (n_encoders, 4) likewise.
        ambient: (2,) pressure, temperature.
        end_area: (n_ends,) area of each pipe at its ends.
        thesis_joints: Whether pipes are joined as in the thesis, see the rig's grid.
        terms: Terms that effects add to the equations, by the effect's name.
        regulator: (n_regulators, REG_PARAMS) how valves hold the pressure behind them.
    """

    plan: Plan
    gas: Gas
    cell: Floats
    port: Floats
    reservoir: Floats
    chamber: Floats
    cylinder: Floats
    body: Floats
    joint: Floats
    leaks: dict[int, float]
    porous: dict[int, float]
    reliefs: dict[int, list[tuple[float, float, float]]]
    ripples: dict[int, list[tuple[float, float, float]]]
    spool: Floats
    curve: Floats
    curve_v: Floats
    tap_slot: Ints
    tap_weight: Floats
    tap_cell: Ints
    tap_lost: Floats
    sensor: Floats
    encoder: Floats
    ambient: Floats
    end_area: Floats
    order: int = 2
    flux: int = L.HLLC
    limiter: int = L.VAN_LEER
    newton: int = 2
    memory: bool = True
    compliant: bool = field(default=False)
    thesis_joints: bool = False
    terms: dict[str, OwnTerm] = field(default_factory=dict)
    regulator: Floats = field(default_factory=lambda: np.zeros((0, L.REG_PARAMS)))

    def add_term(
        self, name: str, act: Callable[..., Any], slot: int, numbers: tuple[float, ...]
    ) -> None:
        """Has a term of an effect act on a slot.

        Args:
            name: Name of the effect.
            act: The compiled term, see `pneu_sim.kernel.terms`; the same for all of the name.
            slot: The slot, or -1 - chamber.
            numbers: What it takes there; all zero where it is to do nothing.
        """
        term = self.terms.setdefault(name, OwnTerm(act, len(numbers)))
        term.rows.setdefault(slot, []).append(numbers)
