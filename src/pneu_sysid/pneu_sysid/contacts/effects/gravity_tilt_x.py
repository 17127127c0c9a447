# SPDX-License-Identifier: Apache-2.0
"""A floor that is not level: gravity leans along x."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup, lean_gravity


class GravityTiltX(SceneEffect):
    """Angle of gravity towards x."""

    name = "gravity_tilt_x"
    title = "direction of gravity, towards x"
    unit = "rad"
    lower = -0.3
    upper = 0.3
    typical = 0.01
    absent = 0.0
    formula = "gravity is turned towards x by this angle"
    source = "geometry"

    def places(self, setup: Setup) -> list[str]:
        return ["world"] if any(setup.spec.option.gravity) else []

    def value(self, setup: Setup, place: str) -> float:
        return setup.lean[0]

    def put(self, setup: Setup, place: str, value: float) -> None:
        setup.lean = (value, setup.lean[1])
        lean_gravity(setup)
