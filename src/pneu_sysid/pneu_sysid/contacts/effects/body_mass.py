# SPDX-License-Identifier: Apache-2.0
"""A body that is heavier or lighter than its drawing."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup, explicit, moving_bodies


class BodyMass(SceneEffect):
    """Relative error of a body's mass, with its inertia."""

    name = "body_mass"
    title = "mass of a body"
    unit = ""
    lower = -0.9
    upper = 5.0
    typical = 0.05
    absent = 0.0
    formula = "mass and inertia times 1 + error"
    source = "thesis 2.3.2"

    def places(self, setup: Setup) -> list[str]:
        return [b.name for b in moving_bodies(setup) if b.name]

    def value(self, setup: Setup, place: str) -> float:
        return setup.massive.get(place, 1.0) - 1.0

    def put(self, setup: Setup, place: str, value: float) -> None:
        body = setup.spec.body(place)
        explicit(setup, body)
        by = (1.0 + value) / setup.massive.get(place, 1.0)
        body.mass *= by
        body.inertia = [x * by for x in body.inertia]
        body.fullinertia = [x * by for x in body.fullinertia]
        setup.massive[place] = 1.0 + value
