# SPDX-License-Identifier: Apache-2.0
"""Poses told in a frame that is not level: the world is turned about its x."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup, tilt_world


class FrameTiltX(SceneEffect):
    """Angle about x of the true vertical, in the frame of the poses."""

    name = "frame_tilt_x"
    title = "frame of the poses not level, about x"
    unit = "rad"
    lower = -0.3
    upper = 0.3
    typical = 0.01
    absent = 0.0
    formula = "gravity and all that is fixed are turned about x by this angle"
    source = "geometry: calibration of motion capture against the floor"

    def places(self, setup: Setup) -> list[str]:
        return ["world"] if any(setup.spec.option.gravity) else []

    def value(self, setup: Setup, place: str) -> float:
        return setup.tilt[0]

    def put(self, setup: Setup, place: str, value: float) -> None:
        tilt_world(setup, (value, setup.tilt[1]))
