# SPDX-License-Identifier: Apache-2.0
"""How deep what touches is in where it has become as hard as it gets."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup, of_bodies, ruling, touching


class ContactWidth(SceneEffect):
    """Depth over which contacts harden."""

    name = "contact_width"
    title = "softness of contacts"
    unit = "m"
    lower = 1e-5
    upper = 0.02
    typical = 5e-4
    logarithmic = True
    of_contacts = True
    formula = "impedance rises with depth up to this width"
    source = "MuJoCo, modeling: solimp; thesis 2.3.2"

    def places(self, setup: Setup) -> list[str]:
        return of_bodies(setup)

    def value(self, setup: Setup, place: str) -> float:
        return float(touching(setup, place)[-1].solimp[2])

    def put(self, setup: Setup, place: str, value: float) -> None:
        for geom in ruling(setup, place):
            geom.solimp[2] = value
