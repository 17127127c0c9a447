# SPDX-License-Identifier: Apache-2.0
"""Forces that are felt before bodies touch, an invisible pillow between them."""

from pneu_sysid.contacts.effects.base import ALL, SceneEffect, Setup, of_bodies, ruling, touching


class RemoteDistance(SceneEffect):
    """Distance at which contacts begin: the sum of the margins of both geoms.

    At `ALL` each geom has half of it. At one geom it is the margin of that geom alone.
    """

    name = "remote_distance"
    title = "remote distance of contacts"
    unit = "m"
    lower = 0.0
    upper = 0.02
    typical = 2e-4
    absent = 0.0
    of_contacts = True
    formula = "contacts begin at this distance (sum of both margins)"
    source = "thesis 2.5.1"

    def places(self, setup: Setup) -> list[str]:
        return of_bodies(setup)

    def value(self, setup: Setup, place: str) -> float:
        margin = float(touching(setup, place)[-1].margin)
        return 2.0 * margin if place == ALL else margin

    def put(self, setup: Setup, place: str, value: float) -> None:
        for geom in ruling(setup, place):
            geom.margin = 0.5 * value if place == ALL else value
