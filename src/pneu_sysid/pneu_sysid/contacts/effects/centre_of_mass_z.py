# SPDX-License-Identifier: Apache-2.0
"""A centre of mass that is not where the drawing has it, along z."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup, explicit, moving_bodies


class CentreOfMassZ(SceneEffect):
    """Shift of a body's centre of mass along its z."""

    name = "centre_of_mass_z"
    title = "centre of mass along z"
    unit = "m"
    lower = -0.5
    upper = 0.5
    typical = 0.001
    absent = 0.0
    formula = "centre of mass is shifted along the body's z"
    source = "thesis 2.3.2"

    def places(self, setup: Setup) -> list[str]:
        return [b.name for b in moving_bodies(setup) if b.name]

    def value(self, setup: Setup, place: str) -> float:
        return setup.shifted.get((place, 2), 0.0)

    def put(self, setup: Setup, place: str, value: float) -> None:
        body = setup.spec.body(place)
        inertial = explicit(setup, body)
        inertial[2] += value - setup.shifted.get((place, 2), 0.0)
        body.ipos = inertial
        setup.shifted[place, 2] = value
