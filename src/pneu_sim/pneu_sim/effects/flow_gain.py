# SPDX-License-Identifier: Apache-2.0
"""Flow gain: a valve or orifice passes more or less air than the rig says, by one factor."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import flow_paths
from pneu_sim.rig.schema import Port, Rig


class FlowGain(Effect):
    """Relative error of sonic conductance and effective area."""

    name: ClassVar[str] = "flow_gain"
    title: ClassVar[str] = "error of the flow gain C"
    where: ClassVar[str] = "valve, valve port or orifice"
    formula: ClassVar[str] = "C = C_rig (1 + error); m = C p_1 rho_0 sqrt(T_0 / T_1) when choked"
    source: ClassVar[str] = "ISO 6358-1:2013 (sonic conductance)"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("error", "relative", 0.0, -0.8, 2.0, 0.15, 5e-3),
    )
    order: ClassVar[int] = 3
    next_experiment: ClassVar[str] = (
        "Fill and exhaust at several openings while choked: a gain error scales every rate by one"
        " factor and leaves holds alone; a known volume added at the end tells it from dead volume."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(flow_paths(rig))

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        for path in flow_paths(rig)[place]:
            path.conductance_m3_s_pa *= 1.0 + values["error"]
            if isinstance(path, Port):
                path.area_m2 *= 1.0 + values["error"]
