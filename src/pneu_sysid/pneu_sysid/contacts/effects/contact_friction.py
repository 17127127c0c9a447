# SPDX-License-Identifier: Apache-2.0
"""Sliding friction between what touches: the slope of the friction cone."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup, of_bodies, ruling, touching


class ContactFriction(SceneEffect):
    """Coefficient of sliding friction."""

    name = "contact_friction"
    title = "friction of contacts"
    unit = ""
    lower = 0.005
    upper = 3.0
    typical = 0.1
    of_contacts = True
    formula = "|tangential force| <= coefficient * normal force"
    source = "Coulomb; MuJoCo, computation: friction cones"

    def places(self, setup: Setup) -> list[str]:
        return of_bodies(setup)

    def value(self, setup: Setup, place: str) -> float:
        return float(touching(setup, place)[-1].friction[0])

    def put(self, setup: Setup, place: str, value: float) -> None:
        for geom in ruling(setup, place):
            geom.friction[0] = value
