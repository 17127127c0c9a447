# SPDX-License-Identifier: Apache-2.0
"""Encoder lag: an encoder answers late and smoothed (a filter, a slow bus)."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class EncoderLag(Effect):
    """Time constant of an encoder's first-order lag, added to the rig's."""

    name: ClassVar[str] = "encoder_lag"
    title: ClassVar[str] = "slow encoder"
    where: ClassVar[str] = "encoder"
    formula: ClassVar[str] = "lag_s r' + r = q"
    source: ClassVar[str] = "Doebelin, Measurement Systems, 5th ed. 2004 (first-order instruments)"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("lag_s", "s", 0.0, 0.0, 0.1, 5e-3, 1.5e-4),
    )
    order: ClassVar[int] = 2
    next_experiment: ClassVar[str] = (
        "Let the joint run into a stop at full speed: a slow encoder shows it arriving late"
        " and gradually."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.encoders)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.encoders[place].lag_s += values["lag_s"]
