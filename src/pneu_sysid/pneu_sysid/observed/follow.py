# SPDX-License-Identifier: Apache-2.0
"""An observer led along a recording: what it says of every sensor, and of the model."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.observe.drifts import Unknown
from pneu_sim.observe.observer import Estimate, Observer
from pneu_sim.observe.settings import ObserverSettings
from pneu_sim.rig.schema import Rig
from pneu_sysid.records.recording import Recording

Floats = NDArray[np.float64]
Spoil = Callable[[float, dict[str, float]], dict[str, float]]
"""Changes readings, told the time, s: to see what faults do."""


@dataclass(frozen=True)
class Followed:
    """What an observer said along a recording.

    Attributes:
        time_s: (n,) times, s.
        read: By sensor (n,) what was recorded, Pa, rad or m; NaN where nothing was.
        mean: By sensor (n,) what the observer says.
        std: By sensor (n,) its standard deviation.
        wrong: (n,) what it says is wrong with the model, in words.
        matter: (n,) by sensor what is the matter with those it does not believe.
        drifts: What of the rig drifts slowly, its value at the end, and its standard deviation.
    """

    time_s: Floats
    read: dict[str, Floats]
    mean: dict[str, Floats]
    std: dict[str, Floats]
    wrong: list[list[str]]
    matter: list[dict[str, str]]
    drifts: list[tuple[Unknown, float, float]] = field(default_factory=list)

    def error(self, sensor: str, begin_s: float = 0.0, end_s: float = math.inf) -> Floats:
        """Recorded less said, Pa, rad or m, of a while, where anything was recorded.

        Args:
            sensor: The sensor.
            begin_s: From when on, s.
            end_s: Until when, s.
        """
        off = self.read[sensor] - self.mean[sensor]
        return off[(self.time_s >= begin_s) & (self.time_s < end_s) & np.isfinite(off)]

    def covered(
        self, sensor: str, noise: float, sigmas: float, begin_s: float, end_s: float
    ) -> float:
        """Share of the readings of a while within an interval about what was said.

        Args:
            sensor: The sensor.
            noise: Of the sensor, one sigma, Pa, rad or m.
            sigmas: Half width of the interval, in standard deviations of a reading.
            begin_s: From when on, s.
            end_s: Until when, s.
        """
        z = (self.read[sensor] - self.mean[sensor]) / np.sqrt(self.std[sensor] ** 2 + noise**2)
        z = z[(self.time_s >= begin_s) & (self.time_s < end_s) & np.isfinite(z)]
        return float(np.mean(np.abs(z) < sigmas))


def evenly(recording: Recording, period_s: float) -> tuple[Floats, Floats, dict[str, Floats]]:
    """A recording at even times: means of its commands between them, readings nearest to them.

    Args:
        recording: The recording.
        period_s: Between the times, s.

    Returns:
        (n,) times, s, (commands, n - 1) volts, and by sensor (n,) readings, NaN where none is.
    """
    count = int((recording.end_s - max(recording.start_s, 0.0)) / period_s + 1e-6) + 1
    time: Floats = np.arange(count, dtype=np.float64) * period_s
    volts = []
    for signal in recording.commands.values():
        at = np.maximum(np.searchsorted(signal.time_s, time, side="right") - 1, 0)
        steps = signal.values[:-1] * np.diff(signal.time_s)
        area = np.concatenate([[0.0], np.cumsum(steps)])
        volts.append(np.diff(area[at] + signal.values[at] * (time - signal.time_s[at])) / period_s)
    read = {}
    for name, signal in {**recording.pressures, **recording.encoders}.items():
        values = np.full(count, np.nan)
        at = np.rint(signal.time_s / period_s).astype(int)
        there = (at >= 0) & (at < count)
        values[at[there]] = signal.values[there]
        read[name] = values
    return time, np.array(volts).reshape(len(recording.commands), -1), read


def follow(
    rig: Rig,
    recording: Recording,
    used: Sequence[str],
    settings: ObserverSettings | None = None,
    period_s: float = 0.002,
    spoil: Spoil | None = None,
    only_first: bool = False,
    steps_back: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Followed:
    """Leads an observer along a recording.

    Args:
        rig: The rig, calibrated.
        recording: The recording.
        used: Taps and encoders whose readings are taken.
        settings: How it is followed.
        period_s: Time between steps, s.
        spoil: What is done to the readings before.
        only_first: Whether only the first readings are taken: a simulation from there.
        steps_back: So many steps later readings still count (`pneu_sim.observe.past`).
        progress: Called with the fraction done.

    Raises:
        InputError: The recording has none of these sensors, or the rig cannot be followed.
    """
    time, volts, read = evenly(recording, period_s)
    if not set(used) & read.keys():
        raise InputError(
            f"{recording.name}: sensors: found {', '.join(read)}, none of {', '.join(used)}"
        )
    observer = Observer(rig, settings, used, steps_back)
    commands = list(recording.commands)
    order = [commands.index(name) for name in observer.plant.plan.commands]
    mean = {name: np.empty(time.size) for name in observer.sensors}
    std = {name: np.empty(time.size) for name in observer.sensors}
    wrong: list[list[str]] = []
    matter: list[dict[str, str]] = []

    def keep(n: int, told: Estimate) -> None:
        for name in observer.sensors:
            mean[name][n], std[name][n] = told.mean[name], told.std[name]

    for n in range(time.size):
        now = {name: float(values[n]) for name, values in read.items()}
        if spoil is not None:
            now = spoil(float(time[n]), now)
        if n == 0:
            observer.begin(now, _first(recording))
        else:
            observer.advance(volts[order, n - 1 : n], period_s)
        if n == 0 or not only_first:
            observer.assimilate(now)
        keep(n, observer.estimate())
        if len(observer.past.states) > steps_back > 0:
            keep(n - steps_back, observer.estimate_of(observer.past.states[0].shown))
        wrong.append(list(observer.watch.wrong))
        matter.append({t: m for t in observer.used if (m := observer.trust.matter(t))})
        if progress is not None and n % 250 == 0:
            progress(n / time.size)
    for back, one in enumerate(reversed(observer.past.states)):
        keep(time.size - 1 - back, observer.estimate_of(one.shown))
    drifts = observer.drifts.slow(observer.settings.slow_s)
    return Followed(time, read, mean, std, wrong, matter, drifts)


def _first(recording: Recording) -> Mapping[str, float]:
    """What valves were told when a recording begins."""
    out = {}
    for name, signal in recording.commands.items():
        at = max(int(np.searchsorted(signal.time_s, 0.0, side="right")) - 1, 0)
        out[name] = float(signal.values[at])
    return out
