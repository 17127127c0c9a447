# SPDX-License-Identifier: Apache-2.0
"""What a recording holds of a scene's sensors and actuators, whatever file it came from."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from pneu_sysid.contacts.manifold import conjugate, exponential, logarithm, product

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Series:
    """Readings of one sensor, or what one actuator was told.

    Attributes:
        time_s: (m,) rising.
        values: (m, w); quaternions of unit length, scalar first, without jumps of sign.
    """

    time_s: Floats
    values: Floats

    @property
    def every_s(self) -> float:
        """Usual time between readings, s."""
        return float(np.median(np.diff(self.time_s))) if len(self.time_s) > 1 else float("inf")

    def at(self, time_s: Floats, turns: bool = False) -> Floats:
        """Readings at other times, along straight lines between those that there are.

        Args:
            time_s: (n,).
            turns: Whether they are quaternions, which turn evenly instead.

        Returns:
            (n, w); beyond the ends as at the ends.
        """
        t = np.clip(time_s, self.time_s[0], self.time_s[-1])
        k = np.clip(np.searchsorted(self.time_s, t, side="right") - 1, 0, len(self.time_s) - 2)
        share = ((t - self.time_s[k]) / (self.time_s[k + 1] - self.time_s[k]))[:, None]
        a, b = self.values[k], self.values[k + 1]
        if not turns:
            return np.asarray(a + share * (b - a))
        return product(a, exponential(share * logarithm(product(conjugate(a), b))))

    def smooth(self, time_s: Floats, turns: bool = False) -> Floats:
        """Readings at other times, along curves of even curvature.

        Args:
            time_s: (n,), within the series' own.
            turns: Whether they are quaternions.

        Returns:
            (n, w).
        """
        if len(self.time_s) < 4:
            return self.at(time_s, turns)
        t = np.clip(time_s, self.time_s[0], self.time_s[-1])
        if not turns:
            return np.asarray(CubicSpline(self.time_s, self.values)(t))
        turned = RotationSpline(self.time_s, Rotation.from_quat(self.values, scalar_first=True))(t)
        return unbroken(turned.as_quat(scalar_first=True))

    def mean_over(self, from_s: Floats, to_s: Floats) -> Floats:
        """Means over spans of time, for sensors that are faster than the knots.

        Of the straight lines between readings, not of the readings in a span: those come and go as
        a span is moved, and a lag would have no slope.

        Args:
            from_s: (n,) where each span begins.
            to_s: (n,) where it ends, later.

        Returns:
            (n, w); beyond the ends as at the ends.
        """
        steps = np.diff(self.time_s)[:, None] * 0.5 * (self.values[1:] + self.values[:-1])
        whole = np.concatenate([np.zeros((1, self.values.shape[1])), np.cumsum(steps, axis=0)])

        def until(time_s: Floats) -> Floats:
            k = np.clip(np.searchsorted(self.time_s, time_s, side="right") - 1, 0, None)
            between = 0.5 * (self.values[k] + self.at(time_s))
            return np.asarray(whole[k] + (time_s - self.time_s[k])[:, None] * between)

        return (until(to_s) - until(from_s)) / (to_s - from_s)[:, None]


@dataclass(frozen=True)
class Track:
    """A recording of a scene.

    Attributes:
        name: Its name.
        sensors: By the MJCF's name of the sensor.
        controls: By the MJCF's name of the actuator.
        findings: What was found while it was read, a sentence each.
    """

    name: str
    sensors: dict[str, Series]
    controls: dict[str, Series] = field(default_factory=dict)
    findings: tuple[str, ...] = ()

    @property
    def span_s(self) -> tuple[float, float]:
        """From when to when all sensors tell, s."""
        series = [s for s in self.sensors.values() if len(s.time_s)]
        return max(s.time_s[0] for s in series), min(s.time_s[-1] for s in series)

    def between(self, start_s: float, end_s: float, name: str) -> "Track":
        """A stretch of the recording.

        Args:
            start_s: Where it begins.
            end_s: Where it ends, which is in it.
            name: What it is called.
        """

        def cut(series: Series) -> Series:
            inside = (series.time_s >= start_s - 1e-9) & (series.time_s <= end_s + 1e-9)
            return Series(series.time_s[inside], series.values[inside])

        sensors = {k: cut(s) for k, s in self.sensors.items()}
        return Track(name, sensors, dict(self.controls), self.findings)


def unwound(series: Series) -> Series:
    """An angle that goes on where its encoder begins anew after a turn.

    Args:
        series: (m, 1) rad.
    """
    return Series(series.time_s, np.unwrap(series.values, axis=0))


def unbroken(q: Floats) -> Floats:
    """Quaternions of unit length without jumps of sign.

    Args:
        q: (m, 4).
    """
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    flips = np.cumprod(np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0))
    return np.asarray(q * np.concatenate([[1.0], flips])[:, None])
