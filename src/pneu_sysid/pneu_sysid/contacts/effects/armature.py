# SPDX-License-Identifier: Apache-2.0
"""Inertia of a motor and its gear as a joint feels it."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup, hinges


class Armature(SceneEffect):
    """Inertia of a rotor at a joint."""

    name = "armature"
    title = "rotor inertia"
    unit = "kg m^2 or kg"
    lower = 0.0
    upper = 10.0
    typical = 1e-4
    absent = 0.0
    formula = "inertia is added to the joint's diagonal"
    source = "MuJoCo, armature"

    def places(self, setup: Setup) -> list[str]:
        return hinges(setup)

    def value(self, setup: Setup, place: str) -> float:
        return float(setup.spec.joint(place).armature)

    def put(self, setup: Setup, place: str, value: float) -> None:
        setup.spec.joint(place).armature = value
