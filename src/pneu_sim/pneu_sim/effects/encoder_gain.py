# SPDX-License-Identifier: Apache-2.0
"""Encoder gain: an encoder reads angles too large or too small by a factor."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class EncoderGain(Effect):
    """Relative error of an encoder's scale."""

    name: ClassVar[str] = "encoder_gain"
    title: ClassVar[str] = "encoder with a wrong scale"
    where: ClassVar[str] = "encoder"
    formula: ClassVar[str] = "reading = truth (1 + error)"
    source: ClassVar[str] = "Doebelin, Measurement Systems, 5th ed. 2004 (sensitivity error)"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("error", "relative", 0.0, -0.5, 1.0, 0.02, 5e-4),
    )
    order: ClassVar[int] = 0
    next_experiment: ClassVar[str] = (
        "Drive the joint from stop to stop and compare the difference of the readings with"
        " the way between."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.encoders)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.encoders[place].gain *= 1.0 + values["error"]
