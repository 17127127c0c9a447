# SPDX-License-Identifier: Apache-2.0
"""Spool speed limit: the spool moves no faster than its drive lets it."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class SpoolSpeedLimit(Effect):
    """Limit of the spool's speed, its reciprocal added to the rig's.

    The strength is the time that a volt of way takes, because it vanishes for a spool without a
    limit. A limit above the speeds that a recording asks for is not felt.
    """

    name: ClassVar[str] = "spool_speed_limit"
    title: ClassVar[str] = "spool limited in speed"
    where: ClassVar[str] = "valve"
    formula: ClassVar[str] = "|x'| <= v, 1 / v = 1 / v_rig + slowness_s_v"
    source: ClassVar[str] = (
        "rate limit of a valve's drive: Merritt, Hydraulic Control Systems, Wiley 1967; Tao and"
        " Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities, 1996"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("slowness_s_v", "s/V", 0.0, 0.0, 0.1, 3e-3, 6e-5),
    )
    order: ClassVar[int] = 2
    curved: ClassVar[bool] = True
    next_experiment: ClassVar[str] = (
        "Step the valve by a small and by a large voltage: a spool limited in speed takes time in"
        " proportion to the step, a slow linear one the same time for both."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.valves)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        slowness = values["slowness_s_v"]
        if slowness == 0.0:
            return
        spool = rig.valves[place].spool
        if spool.max_speed_v_s is not None:
            slowness += 1.0 / spool.max_speed_v_s
        spool.max_speed_v_s = 1.0 / slowness
