# SPDX-License-Identifier: Apache-2.0
"""Spool bandwidth: the spool follows its command more slowly than the rig says."""

import math
from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig

HIGHEST_HZ = 1e5
"""Highest natural frequency given to an instant spool with limits, whose motion is stepped through;
far above any sample rate."""


class SpoolBandwidth(Effect):
    """Lag of the second-order spool, added to the rig's.

    The strength is the group delay at low frequency, ``2 zeta / omega``, because it vanishes for an
    instant spool; the natural frequency that belongs to it follows from the formula.
    """

    name: ClassVar[str] = "spool_bandwidth"
    title: ClassVar[str] = "spool slower than assumed"
    where: ClassVar[str] = "valve"
    formula: ClassVar[str] = (
        "2 zeta / omega = 2 zeta / omega_rig + lag_s, with x'' = omega^2 (u - x) - 2 zeta omega x'"
    )
    source: ClassVar[str] = (
        "second-order spool: Merritt, Hydraulic Control Systems, Wiley 1967; for pneumatic valves"
        " Richer and Hurmuzlu 2000, J. Dyn. Sys. Meas. Control 122, 416-425"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("lag_s", "s", 0.0, 0.0, 0.1, 5e-3, 1e-4),
    )
    order: ClassVar[int] = 2
    curved: ClassVar[bool] = True
    next_experiment: ClassVar[str] = (
        "Sweep a small command sine from 1 to 100 Hz with the tap nearest the valve: a slow spool"
        " loses amplitude as its phase falls, a pure delay keeps it."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.valves)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        lag = values["lag_s"]
        if lag == 0.0:
            return
        spool = rig.valves[place].spool
        if spool.bandwidth_hz is not None:
            lag += spool.damping / (math.pi * spool.bandwidth_hz)
        limits = (spool.max_acceleration_v_s2, spool.max_speed_v_s)
        stepped = spool.integral > 0.0 or limits != (None, None)
        highest = HIGHEST_HZ if stepped else math.inf
        spool.bandwidth_hz = min(spool.damping / (math.pi * lag), highest)
