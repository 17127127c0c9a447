# SPDX-License-Identifier: Apache-2.0
"""What every result of a recording begins with."""

from pneu_sysid.results.base import Perhaps, Result
from pneu_sysid.sensor_units import EncoderUnit


class Head(Result):
    """What every result begins with."""

    pneu_version: str
    """Version of the program."""
    recording: str
    """Name of the recording; of several, all in one line."""
    recordings: list[str] = []
    """Names of the recordings."""
    rigs: list[str]
    """Names of the rigs."""
    taps: list[str]
    """Taps that are compared."""
    encoders: dict[str, EncoderUnit] = {}
    """Encoders that are compared, and the unit of all that is told of each."""
    noise_floor_pa: dict[str, Perhaps]
    """Per tap the sensor's white noise with quantisation, one sigma."""
    noise_floor: dict[str, Perhaps] = {}
    """The same per encoder, in its unit."""
    findings: list[str] = []
    """What was wrong with the recording and how it was handled."""

    @property
    def sensors(self) -> list[str]:
        """Taps, then encoders."""
        return [*self.taps, *self.encoders]

    @property
    def noise_of(self) -> dict[str, float | None]:
        """The noise of every sensor, each in its unit: Pa, rad or m."""
        return {**self.noise_floor_pa, **self.noise_floor}
