# SPDX-License-Identifier: Apache-2.0
"""Dry friction of a joint."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup, hinges


class JointFriction(SceneEffect):
    """Coulomb friction of a joint."""

    name = "joint_friction"
    title = "dry friction of a joint"
    unit = "N m or N"
    lower = 0.0
    upper = 50.0
    typical = 0.005
    absent = 0.0
    formula = "torque = -friction * sign(velocity), less where it sticks"
    source = "Coulomb; MuJoCo, frictionloss"

    def places(self, setup: Setup) -> list[str]:
        return hinges(setup)

    def value(self, setup: Setup, place: str) -> float:
        return float(setup.spec.joint(place).frictionloss)

    def put(self, setup: Setup, place: str, value: float) -> None:
        setup.spec.joint(place).frictionloss = value
