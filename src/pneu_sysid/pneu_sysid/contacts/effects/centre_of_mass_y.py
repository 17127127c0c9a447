# SPDX-License-Identifier: Apache-2.0
"""A centre of mass that is not where the drawing has it, along y."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup, explicit, moving_bodies


class CentreOfMassY(SceneEffect):
    """Shift of a body's centre of mass along its y."""

    name = "centre_of_mass_y"
    title = "centre of mass along y"
    unit = "m"
    lower = -0.5
    upper = 0.5
    typical = 0.001
    absent = 0.0
    formula = "centre of mass is shifted along the body's y"
    source = "thesis 2.3.2"

    def places(self, setup: Setup) -> list[str]:
        return [b.name for b in moving_bodies(setup) if b.name]

    def value(self, setup: Setup, place: str) -> float:
        return setup.shifted.get((place, 1), 0.0)

    def put(self, setup: Setup, place: str, value: float) -> None:
        body = setup.spec.body(place)
        inertial = explicit(setup, body)
        inertial[1] += value - setup.shifted.get((place, 1), 0.0)
        body.ipos = inertial
        setup.shifted[place, 1] = value
