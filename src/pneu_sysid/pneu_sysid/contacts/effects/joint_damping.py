# SPDX-License-Identifier: Apache-2.0
"""Viscous damping of a joint."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup, hinges


class JointDamping(SceneEffect):
    """Viscous damping of a joint."""

    name = "joint_damping"
    title = "damping of a joint"
    unit = "N m s/rad or N s/m"
    lower = 0.0
    upper = 100.0
    typical = 0.001
    absent = 0.0
    formula = "torque = -damping * velocity"
    source = "thesis 2.3.2"

    def places(self, setup: Setup) -> list[str]:
        return hinges(setup)

    def value(self, setup: Setup, place: str) -> float:
        return float(setup.spec.joint(place).damping[0])

    def put(self, setup: Setup, place: str, value: float) -> None:
        setup.spec.joint(place).damping[0] = value
