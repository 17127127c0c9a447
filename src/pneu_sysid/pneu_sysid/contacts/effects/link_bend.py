# SPDX-License-Identifier: Apache-2.0
"""A link that bends where it is held."""

import numpy as np

from pneu_sysid.contacts.effects.base import SceneEffect, Setup, carried
from pneu_sysid.contacts.names import ADDED, AXES
from pneu_sysid.contacts.springs import add_spring, compliance, place_of

ALONG = 0.99
"""Cosine beyond which a joint turns about an axis already."""


class LinkBend(SceneEffect):
    """Compliance of a link against turning about an axis of its own."""

    name = "link_bend"
    title = "link that bends"
    unit = "rad/(N m)"
    lower = 1e-5
    upper = 10.0
    typical = 0.01
    absent = 0.0
    adds_joint = True
    formula = "angle = compliance * moment, damped with a time constant of 2 ms"
    source = "thesis 2.5.2: bending of the kinematic structure"

    def places(self, setup: Setup) -> list[str]:
        out = []
        for body in carried(setup):
            hinges = [
                np.asarray(j.axis) / np.linalg.norm(j.axis)
                for j in body.joints
                if int(j.type) == 3 and not j.name.startswith(ADDED)
            ]
            out += [
                f"{body.name}.{axis}"
                for k, axis in enumerate(AXES)
                if all(abs(h[k]) < ALONG for h in hinges)
            ]
        return out

    def value(self, setup: Setup, place: str) -> float:
        return compliance(setup.spec, self.name, place)

    def put(self, setup: Setup, place: str, value: float) -> None:
        body, axis = place_of(place)
        add_spring(setup.spec, self.name, body, axis, value, slides=False)
