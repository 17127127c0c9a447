# SPDX-License-Identifier: Apache-2.0
"""A sensor that reads too much by a constant."""

from pneu_sysid.contacts.effects.base import SceneEffect, Setup, components, split


class SensorBias(SceneEffect):
    """Bias of one component of a sensor."""

    name = "sensor_bias"
    title = "bias of a sensor"
    unit = "of the sensor"
    lower = -1e3
    upper = 1e3
    typical = 0.01
    absent = 0.0
    in_mjcf = False
    formula = "reading plus bias"
    source = "sensor calibration"

    def places(self, setup: Setup) -> list[str]:
        return components(setup)

    def value(self, setup: Setup, place: str) -> float:
        name, component = split(place)
        return setup.readings[name].bias.get(component, 0.0)

    def put(self, setup: Setup, place: str, value: float) -> None:
        name, component = split(place)
        setup.readings[name].bias[component] = value
