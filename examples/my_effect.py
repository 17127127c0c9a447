# SPDX-License-Identifier: Apache-2.0
"""An effect of one's own in one file: a line that runs past something hot, such as a motor.

The catalogue warms the whole room; this effect warms the wall of one stretch of one line. Try it
with ``pneu effects --effects examples/my_effect.py``; ``diagnose``, ``add`` and ``learn`` take it
alike. ``pneu effects --effects examples/my_effect.py --prove hot_stretch --rig RIG`` verifies it:
the properties that every effect must have, and the reference that `comparisons` declares.
"""

import math

import numpy as np

from pneu_sim import layout
from pneu_sim.effects import Comparison, Effect, EffectParameter, position_along_pipe
from pneu_sim.gas import AIR
from pneu_sim.rig.model import Model
from pneu_sim.rig.schema import Rig
from pneu_sim.simulator import Simulator

ROOM_K, PRESSURE_PA = 293.15, 4e5
SHUT = {
    "name": "shut",
    "grid": {"memory": False},
    "ambient": {"temperature_k": ROOM_K},
    "pipes": {
        "line": {
            "from": "closed",
            "to": "closed",
            "length_m": 1.0,
            "area_m2": 6e-6,
            "wall": {"nusselt": 4.0, "heat_turbulent": 0.0},
        }
    },
    "taps": {"end": {"pipe": "line", "position_m": 1.0}},
}
"""A line that is shut at both ends, all of it beside something hot."""


def warmed_pa(rig: Rig) -> float:
    """Return the pressure after 0.1 s."""
    simulator = Simulator(rig)
    simulator.set_state("line", PRESSURE_PA / (AIR.r_specific * ROOM_K), 0.0, PRESSURE_PA)
    return float(simulator.run(0.1).taps["end"][-1])


def predicted_pa(excess_k: float) -> float:
    """Return the reference, for gas at rest: m cv dT/dt = Nu pi k L (T_wall - T)."""
    density = PRESSURE_PA / (AIR.r_specific * ROOM_K)
    rate = 4.0 * math.pi * float(AIR.conductivity(ROOM_K)) / (density * 6e-6 * AIR.cv)
    warmer_k = excess_k * (1.0 - math.exp(-0.1 * rate))
    return PRESSURE_PA * (1.0 + warmer_k / ROOM_K)


class HotStretch(Effect):
    """Wall temperature above the room's, over a stretch of a pipe."""

    name = "hot_stretch"
    title = "line passes something hot"
    where = "pipe, at a position"
    formula = "T_wall = T_room + excess_k where |x - position_m| < length_m / 2"
    source = "convection at a wall: Incropera and DeWitt, Fundamentals of Heat and Mass Transfer"
    parameters = (
        EffectParameter("excess_k", "K", 0.0, -50.0, 150.0, 30.0, 1.0),
        position_along_pipe(),
        EffectParameter("length_m", "m", 0.5, 0.05, 5.0, 0.5, 0.02),
    )
    order = 6
    along_lines = True  # models that have volumes in place of lines have nothing of it
    exchanges = ("heat",)
    next_experiment = "Repeat the run with the hot part switched off and cold."

    def places(self, rig: Rig) -> list[str]:
        """Every pipe whose wall exchanges heat."""
        return [name for name, pipe in rig.pipes.items() if pipe.wall.nusselt > 0.0]

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        """Nothing: no field of a rig file says how warm a stretch of wall is."""

    def on_model(self, model: Model, rig: Rig, place: str, values: dict[str, float]) -> None:
        """Warms the wall of the cells in the stretch, in part where it covers them in part."""
        first, cells = model.plan.pipes[place]
        faces = np.linspace(0.0, rig.pipes[place].length_m, cells + 1)
        low = values["position_m"] - 0.5 * values["length_m"]
        high = low + values["length_m"]
        covered = np.minimum(faces[1:], high) - np.maximum(faces[:-1], low)
        share = np.clip(covered, 0.0, None) / np.diff(faces)
        model.cell[layout.WALL_T, first : first + cells] += values["excess_k"] * share

    def comparisons(self) -> tuple[Comparison, ...]:
        """Return the experiment with its closed-form reference."""
        everywhere = {"position_m": 0.5, "length_m": 1.0}
        rig = Rig.model_validate(SHUT)
        return (
            Comparison(
                what="gas at rest beside a warm wall, exponential",
                rig=rig,
                place="line",
                strengths=(5.0, -30.0, 150.0),
                measure=warmed_pa,
                expected=predicted_pa,
                shape=everywhere,
            ),
        )
