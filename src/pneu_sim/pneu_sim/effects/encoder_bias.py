# SPDX-License-Identifier: Apache-2.0
"""Encoder bias: an encoder reads a constant beside the truth."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class EncoderBias(Effect):
    """Offset of an encoder, added to the rig's."""

    name: ClassVar[str] = "encoder_bias"
    title: ClassVar[str] = "encoder with an offset"
    where: ClassVar[str] = "encoder"
    formula: ClassVar[str] = "reading = truth + bias"
    source: ClassVar[str] = "Doebelin, Measurement Systems, 5th ed. 2004 (zero offset)"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("bias", "rad or m", 0.0, -3.2, 3.2, 0.02, 5e-4),
    )
    order: ClassVar[int] = 0
    next_experiment: ClassVar[str] = (
        "Drive the joint to both of its stops and compare the readings there with where the"
        " stops are."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.encoders)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.encoders[place].bias += values["bias"]
