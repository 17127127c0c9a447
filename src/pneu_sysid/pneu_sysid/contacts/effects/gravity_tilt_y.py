# SPDX-License-Identifier: Apache-2.0
"""A floor that is not level: gravity leans along y."""

import numpy as np

from pneu_sysid.contacts.effects.base import SceneEffect, Setup


class GravityTiltY(SceneEffect):
    """Angle of gravity towards y."""

    name = "gravity_tilt_y"
    title = "direction of gravity, towards y"
    unit = "rad"
    lower = -0.3
    upper = 0.3
    typical = 0.01
    absent = 0.0
    formula = "gravity is turned about x by this angle"
    source = "geometry"

    def places(self, setup: Setup) -> list[str]:
        return ["world"] if setup.spec.option.gravity[2] else []

    def value(self, setup: Setup, place: str) -> float:
        g = setup.spec.option.gravity
        return float(np.arctan2(g[1], -g[2]))

    def put(self, setup: Setup, place: str, value: float) -> None:
        g = np.array(setup.spec.option.gravity)
        size = np.hypot(g[1], g[2])
        setup.spec.option.gravity = [g[0], size * np.sin(value), -size * np.cos(value)]
