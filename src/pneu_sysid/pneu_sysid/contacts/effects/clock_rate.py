# SPDX-License-Identifier: Apache-2.0
"""A recording whose seconds are longer or shorter than they should be."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup


class ClockRate(SceneEffect):
    """Relative error of the recording's clock."""

    name = "clock_rate"
    title = "rate of the recording's clock"
    unit = ""
    lower = -0.3
    upper = 0.3
    typical = 0.005
    absent = 0.0
    in_mjcf = False
    formula = "times of the recording, times 1 + error"
    source = "geometry"

    def places(self, setup: Setup) -> list[str]:
        return ["clock"]

    def value(self, setup: Setup, place: str) -> float:
        return setup.clock - 1.0

    def put(self, setup: Setup, place: str, value: float) -> None:
        setup.clock = 1.0 + value
