# SPDX-License-Identifier: Apache-2.0
"""An effect with a term of its own in the gas's equations: a heated wire within a line.

No number of the catalogue's model stands for heat that the gas is given whatever its temperature.
The effect brings the term that adds it, a pass that is compiled with the solver's own. Try it with
``pneu effects --effects examples/my_term.py``; ``diagnose``, ``add`` and ``learn`` take it alike.
"""

from typing import Any

from pneu_sim import layout as L
from pneu_sim.compiling import branching
from pneu_sim.effects import Effect, EffectParameter
from pneu_sim.rig.model import Model
from pneu_sim.rig.schema import Rig


@branching
def heat(gas: Any, dt: float, cells: Any, chambers: Any, term: Any) -> None:
    """Adds heat to the gas of some slots: watts per slot."""
    for row in range(term.table.shape[0]):
        for lane in range(cells.lanes):
            i = term.table[row, L.K_SLOT] * cells.lanes + lane
            cells.state[L.ENE, i] += dt * term.par[row, 0, lane] * cells.par[L.INV_VOLUME, i]


class HeatedWire(Effect):
    """Power that a wire along a pipe gives to the gas."""

    name = "heated_wire"
    title = "heated wire within a line"
    where = "pipe"
    formula = "dE/dt = power_w / volume"
    source = "first law of thermodynamics"
    parameters = (EffectParameter("power_w", "W", 0.0, 0.0, 1e3, 2.0, 0.05),)
    order = 6
    next_experiment = "Repeat the run with the wire switched off."

    def places(self, rig: Rig) -> list[str]:
        """Every pipe."""
        return list(rig.pipes)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        """Nothing: no field of a rig file says it."""

    def on_model(self, model: Model, rig: Rig, place: str, values: dict[str, float]) -> None:
        """Shares the power among the cells of the pipe."""
        first, cells = model.plan.pipes[place]
        for slot in range(first, first + cells):
            model.add_term(self.name, heat, slot, (values["power_w"] / cells,))
