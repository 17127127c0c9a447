# SPDX-License-Identifier: Apache-2.0
"""Payload: a link carries something that the rig does not say."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import joints
from pneu_sim.rig.schema import Rig


class Payload(Effect):
    """A point mass on what a joint moves; on what slides it acts alike at any distance."""

    name: ClassVar[str] = "payload"
    title: ClassVar[str] = "load that a link carries"
    where: ClassVar[str] = "joint"
    formula: ClassVar[str] = (
        "about a rotary joint I = I_rig + mass_kg distance_m^2, and its weight at that distance;"
        " on a slide M = M_rig + mass_kg"
    )
    source: ClassVar[str] = "Newton's second law"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("mass_kg", "kg", 0.0, 0.0, 50.0, 0.15, 3e-3),
        EffectParameter("distance_m", "m", 0.2, 0.02, 1.0, 0.2, 0.01, fitted=True),
    )
    arm: ClassVar[str] = "distance_m"
    order: ClassVar[int] = 6
    next_experiment: ClassVar[str] = (
        "Hold the joint at several angles, and swing it fast: the pressures that hold it tell"
        " mass times distance, those that swing it mass times distance squared."
    )

    def places(self, rig: Rig) -> list[str]:
        return [name for name, (body, field) in joints(rig).items() if field in body.loaded]

    def fitted(self, rig: Rig, place: str) -> tuple[EffectParameter, ...]:
        body, field = joints(rig)[place]
        return () if field in body.arm_free else super().fitted(rig, place)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        body, field = joints(rig)[place]
        body.carry(field, values["mass_kg"], values["distance_m"])
