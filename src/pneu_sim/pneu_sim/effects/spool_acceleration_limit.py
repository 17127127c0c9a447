# SPDX-License-Identifier: Apache-2.0
"""Spool acceleration limit: the spool's drive has only so much force."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class SpoolAccelerationLimit(Effect):
    """Limit of the spool's acceleration, its reciprocal added to the rig's.

    The strength is the reciprocal because it vanishes for a spool without a limit. A limit above
    the accelerations that a recording asks for is not felt, and a spool that follows at once (one
    without a bandwidth) knows none.
    """

    name: ClassVar[str] = "spool_acceleration_limit"
    title: ClassVar[str] = "spool limited in acceleration"
    where: ClassVar[str] = "valve whose spool has a bandwidth"
    formula: ClassVar[str] = "|x''| <= a, 1 / a = 1 / a_rig + inertia_s2_v"
    source: ClassVar[str] = (
        "force limit of a valve's solenoid: Merritt, Hydraulic Control Systems, Wiley 1967; Richer"
        " and Hurmuzlu 2000, J. Dyn. Sys. Meas. Control 122, 416-425"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("inertia_s2_v", "s^2/V", 0.0, 0.0, 1e-3, 1e-5, 3e-7),
    )
    order: ClassVar[int] = 2
    curved: ClassVar[bool] = True
    next_experiment: ClassVar[str] = (
        "Step the valve by 0.5, 2 and 8 V: with limited acceleration the time to open grows with"
        " the root of the step, with limited speed in proportion, without limits not at all."
    )

    def places(self, rig: Rig) -> list[str]:
        return [name for name, v in rig.valves.items() if v.spool.bandwidth_hz is not None]

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        inertia = values["inertia_s2_v"]
        if inertia == 0.0:
            return
        spool = rig.valves[place].spool
        if spool.max_acceleration_v_s2 is not None:
            inertia += 1.0 / spool.max_acceleration_v_s2
        spool.max_acceleration_v_s2 = 1.0 / inertia
