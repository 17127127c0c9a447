# SPDX-License-Identifier: Apache-2.0
"""A body that yields sideways to what pushes it: soft skin, a silicone tip."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup, carried, touching
from pneu_sysid.contacts.names import AXES
from pneu_sysid.contacts.springs import add_spring, compliance, place_of


class SpringyTip(SceneEffect):
    """Compliance of a body that touches, along an axis of its own."""

    name = "springy_tip"
    title = "body that yields"
    unit = "m/N"
    lower = 1e-6
    upper = 0.1
    typical = 1e-4
    absent = 0.0
    adds_joint = True
    formula = "displacement = compliance * force, damped with a time constant of 2 ms"
    source = "thesis 2.5.2"

    def places(self, setup: Setup) -> list[str]:
        feeling = {geom.parent.name for geom in touching(setup)}
        bodies = [body for body in carried(setup) if body.name in feeling]
        return [f"{body.name}.{axis}" for body in bodies for axis in AXES]

    def value(self, setup: Setup, place: str) -> float:
        return compliance(setup.spec, self.name, place)

    def put(self, setup: Setup, place: str, value: float) -> None:
        body, axis = place_of(place)
        add_spring(setup.spec, self.name, body, axis, value, slides=True)
