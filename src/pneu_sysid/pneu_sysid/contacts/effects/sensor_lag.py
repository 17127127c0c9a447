# SPDX-License-Identifier: Apache-2.0
"""A sensor that tells late.

Sensors of one message, such as force and torque at a wrist, are late together.
"""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup


class SensorLag(SceneEffect):
    """Lag of a sensor."""

    name = "sensor_lag"
    title = "lag of a sensor"
    unit = "s"
    lower = -0.05
    upper = 0.05
    typical = 0.002
    absent = 0.0
    in_mjcf = False
    formula = "reading of a time ago; negative: its stamps are late"
    source = "sensor calibration"

    def places(self, setup: Setup) -> list[str]:
        return [*setup.readings, *setup.messages]

    def sought(self, setup: Setup) -> list[str]:
        together = {name for names in setup.messages.values() for name in names}
        return [name for name in self.places(setup) if name not in together]

    def value(self, setup: Setup, place: str) -> float:
        return setup.readings[setup.messages.get(place, (place,))[0]].lag_s

    def put(self, setup: Setup, place: str, value: float) -> None:
        for name in setup.messages.get(place, (place,)):
            setup.readings[name].lag_s = value
