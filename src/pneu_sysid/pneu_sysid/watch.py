# SPDX-License-Identifier: Apache-2.0
"""A model run alongside incoming commands and taps: what it leaves unexplained, window by window.

Each window is one roll-out as in identification (thesis 8.1.2): the state is drawn to the taps
during a warm-up, then the model runs on the commands alone and is compared. So the residual does
not drift away over hours, and its figures are those of ``pneu fit`` and ``pneu compare``.
"""

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pneu_sim.errors import InputError
from pneu_sim.rig.schema import Rig
from pneu_sysid.problem import make_problem
from pneu_sysid.records import Recording

Floats = NDArray[np.float64]

GAP_PERIODS = 3.0
"""A pause of this many periods between samples is a gap."""


@dataclass(frozen=True)
class Window:
    """The outcome of one window.

    Attributes:
        end_s: Time of its last sample, s.
        length_s: Its length, s.
        taps: Names.
        residual_pa: Newest measured minus model per tap, Pa; NaN where there is no reading.
        rms_pa: Root mean square per tap, Pa; NaN where there is no reading.
        noise_pa: Noise of the sensors, Pa; NaN where it is not known.
        expected_pa: Error that the model had where it was calibrated, noise included, Pa.
    """

    end_s: float
    length_s: float
    taps: list[str]
    residual_pa: Floats
    rms_pa: Floats
    noise_pa: Floats
    expected_pa: Floats

    @property
    def times_expected(self) -> float:
        """Error over that expected, at the tap where it is largest; NaN without any reading."""
        ratio = self.rms_pa / self.expected_pa
        return float(np.nanmax(ratio)) if np.isfinite(ratio).any() else math.nan

    @property
    def worst_tap(self) -> str:
        """The tap where the error is largest beside that expected."""
        ratio = np.nan_to_num(self.rms_pa / self.expected_pa, nan=-1.0)
        return self.taps[int(np.argmax(ratio))]


class _Trace:
    """Samples of one signal in order of time, as far back as they are needed."""

    def __init__(self) -> None:
        self.times: deque[float] = deque()
        self.values: deque[float] = deque()

    def add(self, time_s: float, value: float) -> None:
        self.times.append(time_s)
        self.values.append(value)

    def drop_before(self, time_s: float, keep: int) -> None:
        while len(self.times) > keep and self.times[1] <= time_s:
            self.times.popleft()
            self.values.popleft()

    def arrays(self) -> tuple[Floats, Floats]:
        return np.array(self.times), np.array(self.values)


class Watch:
    """Collects samples and judges the model on every window that is full.

    Times are those of the samples' stamps. Nothing here waits; `window` costs a roll-out.
    """

    def __init__(
        self, rig: Rig, rate_hz: float, window_s: float | None = None, dx_m: float | None = None
    ) -> None:
        """Starts empty.

        Args:
            rig: The model.
            rate_hz: Rate at which signals are compared, Hz; not above that of the taps.
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
        self._warm_up = round(rig.fit.warm_up_s * rate_hz)
        self._noise = np.array([tap.noise_pa for tap in rig.taps.values()])
        self._noise[self._noise == 0.0] = np.nan
        self._floor = np.full(len(rig.taps), np.nan)
        calibration = rig.calibration
        if calibration is not None:
            for t, name in enumerate(rig.taps):
                self._noise[t] = calibration.noise_floor_pa.get(name, self._noise[t])
                self._floor[t] = calibration.rmse_pa.get(name, np.nan)
        self.clear()

    def clear(self) -> None:
        """Forgets all samples, as after a jump of time."""
        self._commands = {name: _Trace() for name in self._rig.commands}
        self._taps = {name: _Trace() for name in self._rig.taps}
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

    def reading(self, name: str, time_s: float, pressure_pa: float) -> None:
        """Notes a reading; one from before the latest of its tap makes a new start.

        Args:
            name: Tap.
            time_s: When it was taken, s.
            pressure_pa: Its value, Pa; what is not finite is ignored.
        """
        if not math.isfinite(pressure_pa) or name not in self._taps:
            return
        trace = self._taps[name]
        if trace.times and time_s <= trace.times[-1]:
            if time_s > trace.times[-1] - 1.0 / self._rate_hz:
                return  # the same sample twice
            self.clear()
            trace = self._taps[name]
        trace.add(time_s, pressure_pa)
        self._latest_s = max(self._latest_s, time_s)

    def is_full(self) -> bool:
        """Whether a new window can be judged."""
        begins = [t.times[0] for t in self._taps.values() if t.times]
        length = (self._warm_up + self._samples) / self._rate_hz
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
        count = self._warm_up + self._samples
        # One period back, so that taps that come one after the other are all there.
        end = self._latest_s - 1.0 / self._rate_hz
        times = end - np.arange(count - 1, -1, -1) / self._rate_hz
        self._judged_s = end
        commands: dict[str, Floats] = {}
        for name, trace in self._commands.items():
            at, values = trace.arrays()
            index = np.searchsorted(at, times + 1e-9, side="right") - 1
            commands[name] = values[np.maximum(index, 0)]
            trace.drop_before(times[0], keep=1)
        pressures: dict[str, Floats] = {}
        for name, trace in self._taps.items():
            at, values = trace.arrays()
            pressures[name] = self._sampled(at, values, times)
            trace.drop_before(times[0], keep=2)
        measured = np.stack(list(pressures.values()), axis=-1)
        if not np.isfinite(measured).mean(axis=0).max() > 0.5:
            return None
        recording = Recording("live", times - times[0], commands, pressures, self._rate_hz)
        problem = make_problem(self._rig, recording, self._window_s, self._dx_m, workers=1)
        problem = replace(problem, starts=[0], warm_up=self._warm_up, horizon=self._samples)
        error = (problem.target() - problem.predict([self._rig])[0])[0]
        present = np.isfinite(error)
        squares = np.where(present, error, 0.0) ** 2
        number = present.sum(axis=0)
        rms = np.sqrt(squares.sum(axis=0) / np.maximum(number, 1))
        rms[number == 0] = np.nan
        noise = np.where(np.isfinite(self._noise), self._noise, problem.noise_pa)
        expected = np.fmax(self._floor, noise)
        return Window(end, self._window_s, list(self._taps), error[-1], rms, noise, expected)

    def _sampled(self, at: Floats, values: Floats, times: Floats) -> Floats:
        """Readings at given times, NaN in gaps and beyond the ends."""
        if at.size < 2:
            return np.full(times.size, np.nan)
        right = np.clip(np.searchsorted(at, times), 1, at.size - 1)
        span = at[right] - at[right - 1]
        out = np.interp(times, at, values)
        out[(span > GAP_PERIODS / self._rate_hz) | (times < at[0]) | (times > at[-1])] = np.nan
        return out


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
