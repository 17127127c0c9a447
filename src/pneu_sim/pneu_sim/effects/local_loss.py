# SPDX-License-Identifier: Apache-2.0
"""Local loss: a fitting, elbow or quick connector costs pressure where air flows through it."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter, position_along_pipe
from pneu_sim.effects.places import on_pipe
from pneu_sim.rig.schema import LocalLoss as LossPart
from pneu_sim.rig.schema import Rig


class LocalLoss(Effect):
    """A fitting that costs velocity heads without narrowing the line."""

    name: ClassVar[str] = "local_loss"
    title: ClassVar[str] = "fitting with a minor loss"
    where: ClassVar[str] = "pipe, at a position"
    formula: ClassVar[str] = "dp = K rho u |u| / 2"
    source: ClassVar[str] = "Idelchik, Handbook of Hydraulic Resistance, 4th ed. 2007"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("K", "velocity heads", 0.0, 0.0, 200.0, 3.0, 0.1),
        position_along_pipe(),
    )
    order: ClassVar[int] = 3
    along_lines: ClassVar[bool] = True
    next_experiment: ClassVar[str] = (
        "Blow through at several flows with a tap on either side: the drop at a fitting grows with"
        " flow squared over pressure and does not depend on the distance between the taps."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.pipes)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        pipe = rig.pipes[place]
        at = on_pipe(pipe, values["position_m"])
        pipe.losses.append(LossPart(position_m=at, k=values["K"]))
