# SPDX-License-Identifier: Apache-2.0
"""Friction that keeps what touches from spinning about the normal."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup, of_bodies, ruling, touching


class ContactSpin(SceneEffect):
    """Torsional friction, a lever arm."""

    name = "contact_spin"
    title = "torsional friction of contacts"
    unit = "m"
    lower = 0.0
    upper = 0.1
    typical = 0.002
    candidate = False
    of_contacts = True
    formula = "|moment about the normal| <= coefficient * normal force"
    source = "MuJoCo, computation: friction cones, condim 4"

    def places(self, setup: Setup) -> list[str]:
        return of_bodies(setup)

    def value(self, setup: Setup, place: str) -> float:
        return float(touching(setup, place)[-1].friction[1])

    def put(self, setup: Setup, place: str, value: float) -> None:
        for geom in ruling(setup, place):
            geom.friction[1] = value
