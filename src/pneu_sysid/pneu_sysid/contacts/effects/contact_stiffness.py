# SPDX-License-Identifier: Apache-2.0
"""How hard what touches pushes back for how deep it is in."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup, of_bodies, ruling, touching
from pneu_sysid.contacts.solref import direct


class ContactStiffness(SceneEffect):
    """Stiffness of contacts per effective mass."""

    name = "contact_stiffness"
    title = "stiffness of contacts"
    unit = "1/s^2"
    lower = 1e2
    upper = 1e7
    typical = 1e3
    logarithmic = True
    of_contacts = True
    formula = (
        "reference acceleration = -damping / dmax * velocity"
        " - stiffness * impedance / dmax^2 * depth, dmax: largest impedance"
    )
    source = "MuJoCo, modeling: solref of two negative numbers; thesis 2.3.2"

    def places(self, setup: Setup) -> list[str]:
        return of_bodies(setup)

    def value(self, setup: Setup, place: str) -> float:
        return direct(touching(setup, place)[-1])[0]

    def put(self, setup: Setup, place: str, value: float) -> None:
        for geom in ruling(setup, place):
            geom.solref = [-value, -direct(geom)[1]]
