# SPDX-License-Identifier: Apache-2.0
"""End cushion: gas leaves a cylinder through a narrow way while its piston comes to that end."""

from typing import ClassVar

from pneu_sim import layout as L
from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import ways_in
from pneu_sim.rig.mechanics import SIDES
from pneu_sim.rig.model import Model
from pneu_sim.rig.schema import Rig


class EndCushion(Effect):
    """A throttle that closes over the end of a stroke, besides one that the rig has."""

    name: ClassVar[str] = "end_cushion"
    title: ClassVar[str] = "cushion at the end of a stroke"
    where: ClassVar[str] = "side of a cylinder"
    formula: ClassVar[str] = (
        "1 / A^2 = 1 / A_rig^2 + 1 / A_x^2 - 1 / A_whole^2 for gas that leaves; A_x grows linearly"
        " from A_whole / sqrt(1 + K) at the end of the stroke to A_whole at length_m from it"
    )
    source: ClassVar[str] = (
        "cushioned cylinders: Beater, Pneumatic Drives, Springer 2007, ch. 5; minor loss of an"
        " orifice in a line: Idelchik, Handbook of Hydraulic Resistance, 4th ed. 2007"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("K", "velocity heads", 0.0, 0.0, 1e5, 100.0, 1.5),
        EffectParameter("length_m", "m or rad", 0.01, 1e-3, 0.1, 0.01, 5e-4, fitted=True),
    )
    order: ClassVar[int] = 5
    curved: ClassVar[bool] = True
    next_experiment: ClassVar[str] = (
        "Run full strokes into this end at two speeds: a cushion holds back what leaves over its"
        " last millimetres, and the pressure there rises before the piston stands."
    )

    def places(self, rig: Rig) -> list[str]:
        return ways_in(rig)

    def limits(self, parameter: EffectParameter, rig: Rig, place: str) -> tuple[float, float]:
        low, high = super().limits(parameter, rig, place)
        if parameter.name == "length_m":
            # as long as the way, it would throttle everywhere
            high = min(high, 0.8 * rig.cylinders[place.rsplit(".", 1)[0]].stroke)
        return min(low, high), high

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        del rig, place, values  # the rig's own cushion, of another length, stays as it is

    def on_model(self, model: Model, rig: Rig, place: str, values: dict[str, float]) -> None:
        cylinder, side = place.rsplit(".", 1)
        row, s = model.cylinder[model.plan.cylinders.index(cylinder)], SIDES.index(side)
        row[L.PY_THROTTLE + s] = values["length_m"]
        row[L.PY_HEADS + s] += values["K"]
