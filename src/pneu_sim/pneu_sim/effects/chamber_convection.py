# SPDX-License-Identifier: Apache-2.0
"""Chamber convection: gas warmer or colder than a chamber's wall rises or sinks along it."""

from typing import Any, ClassVar

from pneu_sim import layout as L
from pneu_sim.compiling import branching
from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.model import Model
from pneu_sim.rig.schema import Rig

TURBULENT = 0.13
"""Nusselt over cube root of Rayleigh number; at this power the size of the chamber drops out."""
GRAVITY_M_S2 = 9.81


@branching
def convect(gas: Any, dt: float, cells: Any, chambers: Any, term: Any) -> None:
    """Passes heat between the gas of chambers and their walls by natural convection.

    Args:
        gas: The gas.
        dt: Step, s.
        cells: All slots.
        chambers: Chambers.
        term: Per row a chamber, and: area of its wall, m2; reference viscosity, Pa s; reference
            temperature and Sutherland's constant, K.
    """
    cv = gas.r / (gas.gamma - 1.0)
    for row in range(term.table.shape[0]):
        c = -1 - term.table[row, L.K_SLOT]
        for j in range(cells.lanes):
            area = term.par[row, 0, j]
            if area <= 0.0:
                continue
            p = chambers.work[c, L.H_PRESSURE, j]
            t = chambers.work[c, L.H_TEMPERATURE, j]
            wall = chambers.par[c, L.C_WALL_T, j]
            film = 0.5 * (t + wall)
            ref, extra = term.par[row, 2, j], term.par[row, 3, j]
            mu = term.par[row, 1, j] * (film / ref) ** 1.5 * (ref + extra) / (film + extra)
            rho = p / (gas.r * film)
            k = gas.gamma * cv * mu / gas.prandtl
            rise = gas.prandtl * GRAVITY_M_S2 * abs(t - wall) / film * (rho / mu) ** 2
            h = dt * area * TURBULENT * k * rise ** (1.0 / 3.0)
            # Implicit in the gas's temperature, so that no step is too long for a small chamber.
            gain = h / (1.0 + h / (chambers.state[c, 0, j] * cv))
            chambers.state[c, 1, j] += gain * (wall - t)


class ChamberConvection(Effect):
    """Natural convection along a chamber's wall. Lumped models have none.

    Its conductance grows with the gas's density and with the difference of temperatures.
    """

    name: ClassVar[str] = "chamber_convection"
    title: ClassVar[str] = "natural convection at chamber walls"
    where: ClassVar[str] = "chamber"
    formula: ClassVar[str] = (
        "q = area_m2 h (T_room - T), h = 0.13 k (g Pr |T - T_room| / (T_f nu^2))^(1/3), k and nu at"
        " T_f = (T + T_room) / 2"
    )
    source: ClassVar[str] = (
        "turbulent natural convection, Nu = 0.13 Ra^(1/3): McAdams, Heat Transmission, 3rd ed.,"
        " 1954, ch. 7"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("area_m2", "m^2", 0.0, 0.0, 5.0, 2e-2, 5e-4),
    )
    order: ClassVar[int] = 4
    next_experiment: ClassVar[str] = (
        "Empty the chamber from two pressures, and record the gas's temperature with a thin"
        " thermocouple: a conductance that is constant warms dense and thin gas alike."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.chambers)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        pass  # no field of a rig file says it

    def on_model(self, model: Model, rig: Rig, place: str, values: dict[str, float]) -> None:
        gas = model.gas
        numbers = (values["area_m2"], gas.mu_ref, gas.t_ref, gas.sutherland_k)
        model.add_term(self.name, convect, -1 - model.plan.chambers.index(place), numbers)
