# SPDX-License-Identifier: Apache-2.0
"""A floor that is not level: gravity leans along y."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup, lean_gravity


class GravityTiltY(SceneEffect):
    """Angle of gravity towards y."""

    name = "gravity_tilt_y"
    title = "direction of gravity, towards y"
    unit = "rad"
    lower = -0.3
    upper = 0.3
    typical = 0.01
    absent = 0.0
    formula = "gravity is turned towards y by this angle"
    source = "geometry"

    def places(self, setup: Setup) -> list[str]:
        return ["world"] if any(setup.spec.option.gravity) else []

    def value(self, setup: Setup, place: str) -> float:
        return setup.lean[1]

    def put(self, setup: Setup, place: str, value: float) -> None:
        setup.lean = (setup.lean[0], value)
        lean_gravity(setup)
