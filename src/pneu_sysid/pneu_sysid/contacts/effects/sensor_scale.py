# SPDX-License-Identifier: Apache-2.0
"""A sensor, or a system of cameras, whose unit is not what it says."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup


class SensorScale(SceneEffect):
    """Relative error of a sensor's gain."""

    name = "sensor_scale"
    title = "scale of a sensor"
    unit = ""
    lower = -0.5
    upper = 0.5
    typical = 0.01
    absent = 0.0
    in_mjcf = False
    formula = "reading times 1 + error"
    source = "sensor calibration"

    def places(self, setup: Setup) -> list[str]:
        return [name for name, width in setup.widths.items() if width != 4]

    def value(self, setup: Setup, place: str) -> float:
        return setup.readings[place].gain - 1.0

    def put(self, setup: Setup, place: str, value: float) -> None:
        setup.readings[place].gain = 1.0 + value
