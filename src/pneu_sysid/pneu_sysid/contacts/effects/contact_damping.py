# SPDX-License-Identifier: Apache-2.0
"""How hard what touches pushes back for how fast it comes."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup, of_bodies, ruling, touching
from pneu_sysid.contacts.solref import direct


class ContactDamping(SceneEffect):
    """Damping of contacts per effective mass."""

    name = "contact_damping"
    title = "damping of contacts"
    unit = "1/s"
    lower = 1.0
    upper = 1e5
    typical = 1e2
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
        return direct(touching(setup, place)[-1])[1]

    def put(self, setup: Setup, place: str, value: float) -> None:
        for geom in ruling(setup, place):
            geom.solref = [-direct(geom)[0], -value]
