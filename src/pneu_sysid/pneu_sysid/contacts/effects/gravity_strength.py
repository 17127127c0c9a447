# SPDX-License-Identifier: Apache-2.0
"""Bodies that fall faster or slower than they should."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup, lean_gravity


class GravityStrength(SceneEffect):
    """Relative error of gravity."""

    name = "gravity_strength"
    title = "strength of gravity"
    unit = ""
    lower = -0.5
    upper = 0.5
    typical = 0.01
    absent = 0.0
    formula = "gravity times 1 + error"
    source = "9.80665 m/s^2 is within 0.3 % wherever one stands"

    def places(self, setup: Setup) -> list[str]:
        return ["world"] if any(setup.spec.option.gravity) else []

    def value(self, setup: Setup, place: str) -> float:
        return setup.heavier - 1.0

    def put(self, setup: Setup, place: str, value: float) -> None:
        setup.heavier = 1.0 + value
        lean_gravity(setup)
