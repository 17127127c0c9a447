# SPDX-License-Identifier: Apache-2.0
"""A sensor that tells late."""

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
        return list(setup.readings)

    def value(self, setup: Setup, place: str) -> float:
        return setup.readings[place].lag_s

    def put(self, setup: Setup, place: str, value: float) -> None:
        setup.readings[place].lag_s = value
