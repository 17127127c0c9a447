# SPDX-License-Identifier: Apache-2.0
"""What slows bodies in flight."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup


class AirDrag(SceneEffect):
    """Drag of bodies that move freely, linear in their velocity."""

    name = "air_drag"
    title = "drag of the air"
    unit = "N s/m"
    lower = 0.0
    upper = 10.0
    typical = 0.005
    absent = 0.0
    in_mjcf = False
    formula = "force = -drag * velocity, on every free body"
    source = "Stokes; at higher speeds a mean over what was flown"

    def places(self, setup: Setup) -> list[str]:
        return ["air"] if any(int(j.type) == 0 for j in setup.spec.joints) else []

    def value(self, setup: Setup, place: str) -> float:
        return setup.drag

    def put(self, setup: Setup, place: str, value: float) -> None:
        setup.drag = value
