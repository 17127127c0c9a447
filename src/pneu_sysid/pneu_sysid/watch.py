# SPDX-License-Identifier: Apache-2.0
"""A model run alongside incoming commands and readings: what it leaves unexplained, by windows.

Each window is one stretch as in identification: the model runs along the readings at their own
times, its gas drawn slowly to the taps, and is compared after a warm-up. So the residual does not
drift away over hours, and its figures are those of ``pneu fit`` and ``pneu compare``.
"""

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.rig.schema import Rig
from pneu_sysid.problem import make_problem, pull_of
from pneu_sysid.records import Recording, Signal
from pneu_sysid.sensor_units import apart

Floats = NDArray[np.float64]

WARN_TIMES, ERROR_TIMES = 3.0, 10.0
"""Multiples of the expected error that are worth a warning, and from which on a model does not
describe its rig."""
CLOSE = 0.9
"""Readings closer than this many periods are one too many."""
MARGIN = 4.0
"""Periods that a window is longer than its stretch: readings need not fall on its ends, nor come
quite as often as was told."""
EARLIER_S = 1.0
"""Commands from this long before a window still matter to its spools."""
LEAST = 0.5
"""A window in which every sensor lacks more than this share of its readings is not judged."""


@dataclass(frozen=True)
class Window:
    """The outcome of one window.

    Attributes:
        end_s: Time of its last sample, s.
        length_s: Its length, s.
        sensors: Names of the taps, then of the encoders; of the former all is in Pa, of the latter
            in rad or m.
        residual: Newest measured minus model of each; NaN where there is no reading.
        rms: Root mean square of each; NaN where there is no reading.
        noise: Noise of each; NaN where it is not known.
        expected: Error that the model had where it was calibrated, noise included.
        courses: Of each its readings in the window: their times, s, what was read, and what the
            model predicts.
    """

    end_s: float
    length_s: float
    sensors: list[str]
    residual: Floats
    rms: Floats
    noise: Floats
    expected: Floats
    courses: list[tuple[Floats, Floats, Floats]] = field(default_factory=list)

    @property
    def times_expected(self) -> float:
        """Error over that expected, at the sensor where it is largest; NaN without any reading."""
        ratio = self.rms / self.expected
        return float(np.nanmax(ratio)) if np.isfinite(ratio).any() else math.nan

    @property
    def worst(self) -> str:
        """The sensor where the error is largest beside that expected."""
        ratio = np.nan_to_num(self.rms / self.expected, nan=-1.0)
        return self.sensors[int(np.argmax(ratio))]


class _Trace:
    """Samples of one signal in order of time, as far back as they are needed."""

    def __init__(self) -> None:
        self.times: deque[float] = deque()
        self.values: deque[float] = deque()

    def add(self, time_s: float, value: float) -> None:
        self.times.append(time_s)
        self.values.append(value)

    def drop_before(self, time_s: float) -> None:
        while len(self.times) > 1 and self.times[1] <= time_s:
            self.times.popleft()
            self.values.popleft()

    def since(self, time_s: float) -> Signal:
        """What is noted, on times that begin there."""
        return Signal(np.array(self.times) - time_s, np.array(self.values))


class Watch:
    """Collects samples and judges the model on every window that is full.

    Times are those of the samples' stamps. Nothing here waits; `window` costs a run of the model.
    """

    def __init__(
        self, rig: Rig, rate_hz: float, window_s: float | None = None, dx_m: float | None = None
    ) -> None:
        """Starts empty.

        Args:
            rig: The model.
            rate_hz: Rate at which sensors are read, Hz; of faster ones readings are left out.
            window_s: Length of what is compared, s; None is the horizon of the rig's fit.
            dx_m: Cell length that replaces the rig's.

        Raises:
            InputError: The window is shorter than a few samples.
        """
        self._rig = rig
        self._rate_hz = rate_hz
        self._window_s = window_s or rig.fit.horizon_s or 0.5
        self._dx_m = dx_m
        self._samples = round(self._window_s * rate_hz)
        if self._samples < 10:
            raise InputError(
                f"window_s: found {self._window_s:g} s, at {rate_hz:g} Hz it must be at least"
                f" {10 / rate_hz:g} s"
            )
        self._warm_up_s = rig.fit.warm_up_s
        fit = {"horizon_s": self._window_s, "nudge_s": pull_of(rig)}
        # One window is one stretch; the gas is drawn to the taps as in the fit.
        self._model = rig.model_copy(update={"fit": rig.fit.model_copy(update=fit)})
        noise = [tap.noise_pa for tap in rig.taps.values()]
        self._noise = np.array(noise + [encoder.noise for encoder in rig.encoders.values()])
        self._noise[self._noise == 0.0] = np.nan
        self._floor = np.full(self._noise.size, np.nan)
        calibration = rig.calibration
        if calibration is not None:
            for t, name in enumerate((*rig.taps, *rig.encoders)):
                self._noise[t] = calibration.noise.get(name, self._noise[t])
                self._floor[t] = calibration.left.get(name, np.nan)
        self.clear()

    def clear(self) -> None:
        """Forgets all samples, as after a jump of time."""
        self._commands = {name: _Trace() for name in self._rig.commands}
        self._sensors = {name: _Trace() for name in (*self._rig.taps, *self._rig.encoders)}
        self._judged_s = -math.inf
        self._latest_s = -math.inf

    def command(self, name: str, time_s: float, volts: float) -> None:
        """Notes a command.

        Args:
            name: Command.
            time_s: When it took effect, s.
            volts: Its value, V; what is not finite is ignored.
        """
        if math.isfinite(volts) and name in self._commands:
            self._commands[name].add(time_s, volts)

    def reading(self, name: str, time_s: float, value: float) -> None:
        """Notes a reading; one from before the latest of its sensor makes a new start.

        Args:
            name: Tap or encoder.
            time_s: When it was taken, s.
            value: Its value, Pa, rad or m; what is not finite is ignored.
        """
        if not math.isfinite(value) or name not in self._sensors:
            return
        trace = self._sensors[name]
        if trace.times and time_s <= trace.times[-1]:
            if time_s > trace.times[-1] - 1.0 / self._rate_hz:
                return  # the same reading twice
            self.clear()
            trace = self._sensors[name]
        if not trace.times or time_s - trace.times[-1] > CLOSE / self._rate_hz:
            trace.add(time_s, value)
        self._latest_s = max(self._latest_s, time_s)

    def is_full(self) -> bool:
        """Whether a new window can be judged."""
        begins = [t.times[0] for t in self._sensors.values() if t.times]
        length = self._warm_up_s + self._window_s + (1.0 + MARGIN) / self._rate_hz
        return (
            bool(begins)
            and all(trace.times for trace in self._commands.values())
            and self._latest_s - min(begins) > length
            and self._latest_s - self._judged_s > self._window_s
        )

    def window(self) -> Window | None:
        """Judges the newest window.

        Returns:
            The outcome; None where none is full, or its signals are too patchy to run along.

        Raises:
            InputError: The model became unstable.
        """
        if not self.is_full():
            return None
        # One period back, so that taps that come one after the other are all there.
        end = self._latest_s - 1.0 / self._rate_hz
        begin = end - self._warm_up_s - self._window_s - MARGIN / self._rate_hz
        self._judged_s = end
        for trace in self._commands.values():
            trace.drop_before(begin - EARLIER_S)
        for trace in self._sensors.values():
            trace.drop_before(begin)
        commands = {name: trace.since(begin) for name, trace in self._commands.items()}
        readings = {
            name: trace.since(begin).within(0.0, end - begin)
            for name, trace in self._sensors.items()
            if trace.times
        }
        enough = LEAST * self._rate_hz * (end - begin)
        readings = {name: signal for name, signal in readings.items() if len(signal)}
        if max((len(signal) for signal in readings.values()), default=0) < enough:
            return None
        pressures, encoders = apart(readings, self._rig.encoders)
        try:
            problem = make_problem(
                self._model,
                Recording("live", commands, pressures, encoders=encoders),
                None,
                self._dx_m,
                workers=1,
            )
        except InputError:
            return None  # the readings of this window end before it does
        predicted = problem.predict([self._rig])[0]
        error = problem.target() - predicted
        present = np.isfinite(error)
        squares = np.where(present, error, 0.0) ** 2
        number = present.sum(axis=(0, 1))
        rms = np.sqrt(squares.sum(axis=(0, 1)) / np.maximum(number, 1))
        rms[number == 0] = np.nan
        newest = np.full(len(self._sensors), np.nan)
        for t in range(newest.size):
            if number[t]:
                newest[t] = error[:, :, t][present[:, :, t]][-1]
        noise = np.where(np.isfinite(self._noise), self._noise, problem.noise_pa)
        expected = np.fmax(self._floor, noise)
        courses = [
            (
                problem.time_s[:, :, t][there] + begin,
                problem.measured[:, :, t][there],
                predicted[:, :, t][there],
            )
            for t in range(newest.size)
            for there in (present[:, :, t],)
        ]
        sensors = list(self._sensors)
        return Window(end, self._window_s, sensors, newest, rms, noise, expected, courses)


class Verdict:
    """Turns windows into a level that does not flicker."""

    def __init__(self, warn_times: float, error_times: float, patience: int = 3) -> None:
        """Starts without an opinion.

        Args:
            warn_times: Multiple of the expected error that is worth a warning.
            error_times: Multiple at which the model no longer describes the rig.
            patience: How many windows are looked back on; their median counts, since a window in
                which little happens, or something unusual, says little.
        """
        self.warn_times = warn_times
        self.error_times = error_times
        self._recent: deque[float] = deque(maxlen=patience)

    def add(self, window: Window) -> None:
        """Takes a window into account.

        Args:
            window: The window.
        """
        if math.isfinite(window.times_expected):
            self._recent.append(window.times_expected)

    @property
    def times_expected(self) -> float:
        """Median over the last windows of the error, in multiples of the expected one."""
        return float(np.median(self._recent)) if self._recent else math.nan

    @property
    def level(self) -> int:
        """0 as expected, 1 warning, 2 error; -1 before there are enough windows."""
        if len(self._recent) < (self._recent.maxlen or 1):
            return -1
        lasting = self.times_expected
        return 2 if lasting > self.error_times else 1 if lasting > self.warn_times else 0
