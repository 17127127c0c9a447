# SPDX-License-Identifier: Apache-2.0
"""A floor that is not level: gravity leans along x."""

import numpy as np

from pneu_sysid.contacts.effects.base import SceneEffect, Setup


class GravityTiltX(SceneEffect):
    """Angle of gravity towards x."""

    name = "gravity_tilt_x"
    title = "direction of gravity, towards x"
    unit = "rad"
    lower = -0.3
    upper = 0.3
    typical = 0.01
    absent = 0.0
    formula = "gravity is turned about y by this angle"
    source = "geometry"

    def places(self, setup: Setup) -> list[str]:
        return ["world"] if setup.spec.option.gravity[2] else []

    def value(self, setup: Setup, place: str) -> float:
        g = setup.spec.option.gravity
        return float(np.arctan2(g[0], -g[2]))

    def put(self, setup: Setup, place: str, value: float) -> None:
        g = np.array(setup.spec.option.gravity)
        size = np.hypot(g[0], g[2])
        setup.spec.option.gravity = [size * np.sin(value), g[1], -size * np.cos(value)]
