# SPDX-License-Identifier: Apache-2.0
"""Dry friction of a joint's bearing: more, the more the joint carries."""

from pneu_sysid.contacts.bearings import feel_load
from pneu_sysid.contacts.effects.base import SceneEffect, Setup, hinges


class JointLoadFriction(SceneEffect):
    """Friction of a bearing by the force that goes through it."""

    name = "joint_load_friction"
    title = "friction of a joint by its load"
    unit = "N m/N or N/N"
    lower = 0.0
    upper = 1.0
    typical = 0.001
    absent = 0.0
    formula = "torque = -value * |force through the joint| * tanh(velocity / 0.1)"
    source = "Coulomb: coefficient of friction times radius of the pin"

    def places(self, setup: Setup) -> list[str]:
        return hinges(setup)

    def value(self, setup: Setup, place: str) -> float:
        return setup.loaded.get(place, 0.0)

    def put(self, setup: Setup, place: str, value: float) -> None:
        setup.loaded[place] = value
        if value:
            feel_load(setup.spec, place)
