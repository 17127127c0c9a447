# SPDX-License-Identifier: Apache-2.0
"""A spring at a joint."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup, hinges


class JointStiffness(SceneEffect):
    """Stiffness of a spring at a joint."""

    name = "joint_stiffness"
    title = "spring at a joint"
    unit = "N m/rad or N/m"
    lower = 0.0
    upper = 1e5
    typical = 0.01
    absent = 0.0
    formula = "torque = -stiffness * (position - rest)"
    source = "thesis 2.5.2"

    def places(self, setup: Setup) -> list[str]:
        return hinges(setup)

    def value(self, setup: Setup, place: str) -> float:
        return float(setup.spec.joint(place).stiffness[0])

    def put(self, setup: Setup, place: str, value: float) -> None:
        setup.spec.joint(place).stiffness[0] = value
