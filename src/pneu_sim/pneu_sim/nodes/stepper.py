# SPDX-License-Identifier: Apache-2.0
"""The simulation's own thread: commands in, one control period after the other, samples out.

Nothing here imports ROS: clocks, publishing and the answers to requests are handed in.
"""

import math
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim import sensors
from pneu_sim.rig.schema import Rig
from pneu_sim.simulator import Simulator
from pneu_sim.valve import voltage_limits

BACKLOG_S = 0.1
"""Delay behind the clock up to which lost time is made up; beyond it, time is let slip."""
KEPT = 0.98
"""Share of the wanted factor below which the simulation is said not to keep time."""
GLANCE_S = 0.001
"""How often a clock that others set is looked at."""

Answer = Callable[[tuple[str, int]], object]
"""Told what was wrong (or nothing) and the stamp reached, ns."""


class TimeOfClock(Protocol):
    """A point in time, as ``rclpy.time.Time``."""

    @property
    def nanoseconds(self) -> int:
        """Time since the clock's zero, ns."""


class AnyClock(Protocol):
    """What is needed of a clock, as ``rclpy.clock.Clock``."""

    def now(self) -> TimeOfClock:
        """The present time."""


@dataclass(frozen=True)
class Sample:
    """What one period brought.

    Attributes:
        time_s: Simulated time since the last reset, s.
        stamp_ns: The same on the clock of the stamps, ns.
        taps: Noisy readings per tap, Pa; None right after a reset.
        joints: Per joint of a body its position, rad or m.
        speeds: Per joint its velocity, rad/s or m/s.
        encoders: Noisy readings per encoder, rad or m.
        volts: Voltages during the period that ends here.
        since_ns: Stamp of the beginning of that period, ns.
    """

    time_s: float
    stamp_ns: int
    taps: dict[str, float] | None
    joints: dict[str, float] = field(default_factory=dict)
    speeds: dict[str, float] = field(default_factory=dict)
    encoders: dict[str, float] = field(default_factory=dict)
    volts: dict[str, float] = field(default_factory=dict)
    since_ns: int = 0


@dataclass(frozen=True)
class InputReport:
    """How commands stand.

    Attributes:
        waiting: No command has come since the start.
        stale: Commands that are too old, by name.
        taken: Messages that held a usable command.
        ignored: Values that were not finite.
        clamped: Values beyond what the valve's curves know.
        volts: What is in force.
    """

    waiting: bool
    stale: list[str]
    taken: int
    ignored: int
    clamped: int
    volts: dict[str, float]


class Inputs:
    """The newest commands, and the safe voltages where they are missing or too old.

    Attributes:
        timeout_s: Age in simulated time that makes a command stale, s; 0 is never.
        lock: Guards everything here.
    """

    def __init__(self, rig: Rig, timeout_s: float, vent_v: float | None) -> None:
        """Starts with safe voltages.

        Args:
            rig: The rig.
            timeout_s: Age in simulated time that makes a command stale, s; 0 is never.
            vent_v: Safe voltage; None is the null voltage of each command's valve.
        """
        self.timeout_s = timeout_s
        self.lock = threading.Lock()
        null = {valve.command: valve.spool.null_v for valve in rig.valves.values()}
        self._safe = {
            name: null.get(name, 0.0) if vent_v is None else vent_v for name in rig.commands
        }
        self._limits = voltage_limits(rig)
        self._volts: dict[str, float] = {}
        self._fresh: set[str] = set()
        self._since_s: dict[str, float] = {}
        self._taken = self._ignored = self._clamped = 0

    def take(self, volts: Mapping[str, float]) -> None:
        """Notes commands; what is not finite is ignored.

        Args:
            volts: Volts by name.
        """
        finite = {name: v for name, v in volts.items() if math.isfinite(v)}
        good = {
            name: min(max(v, self._limits[name][0]), self._limits[name][1])
            for name, v in finite.items()
        }
        with self.lock:
            self._clamped += sum(finite[name] != good[name] for name in good)
            self._ignored += len(volts) - len(good)
            if good:
                self._taken += 1
                self._volts.update(good)
                self._fresh.update(good)

    def now(self, time_s: float) -> dict[str, float]:
        """Voltages for the period that begins.

        Args:
            time_s: Simulated time, s.
        """
        with self.lock:
            for name in self._fresh:
                self._since_s[name] = time_s
            self._fresh.clear()
            return {
                name: safe if self._is_stale(name, time_s) else self._volts[name]
                for name, safe in self._safe.items()
            }

    def forget(self) -> None:
        """Back to the safe voltages, as after a reset."""
        with self.lock:
            self._volts.clear()
            self._fresh.clear()
            self._since_s.clear()

    def report(self, time_s: float) -> InputReport:
        """How commands stand.

        Args:
            time_s: Simulated time, s.
        """
        with self.lock:
            stale = [n for n in self._safe if n in self._volts and self._is_stale(n, time_s)]
            volts = {
                name: safe if self._is_stale(name, time_s) else self._volts[name]
                for name, safe in self._safe.items()
            }
            waiting = bool(self._safe) and not self._volts
            return InputReport(waiting, stale, self._taken, self._ignored, self._clamped, volts)

    def _is_stale(self, name: str, time_s: float) -> bool:
        if name not in self._volts:
            return True
        age = time_s - self._since_s.get(name, time_s)
        return self.timeout_s > 0.0 and age > self.timeout_s - 1e-9


@dataclass
class PaceReport:
    """How fast the simulation ran since the last report.

    Attributes:
        wanted: Simulated seconds per second asked for; infinite for as fast as possible, NaN in
            lock-step.
        reached: Simulated seconds per second.
        behind: Whether it did not keep time.
        slipped_s: Time let slip since the start, s.
    """

    wanted: float
    reached: float
    behind: bool
    slipped_s: float


class Pacing:
    """Decides when the next period is due."""

    def __init__(self, pace: str, factor: float, clock: AnyClock, follows: bool) -> None:
        """Starts at the first call of `wait`.

        Args:
            pace: ``real_time``, ``as_fast_as_possible`` or ``lock_step``.
            factor: Simulated seconds per second of the clock, for ``real_time``.
            clock: The clock to keep to.
            follows: Whether others set that clock, so that it may stand still or jump.
        """
        self.pace = pace
        self.factor = factor
        self.slipped_s = 0.0
        self._clock = clock
        self._follows = follows
        self._anchor: tuple[int, float] | None = None  # clock, simulated time
        self._latest = 0

    def set_factor(self, factor: float) -> None:
        """Changes the factor from now on.

        Args:
            factor: Simulated seconds per second of the clock.
        """
        self.factor = factor
        self._anchor = None

    def restart(self) -> None:
        """Counts from now on, as after a reset."""
        self._anchor = None

    def now_s(self) -> float:
        """The clock, s."""
        return self._clock.now().nanoseconds * 1e-9

    def wait(self, time_s: float, ended: threading.Event) -> None:
        """Returns when the clock has reached a simulated time.

        Args:
            time_s: Simulated time, s.
            ended: Ends the wait early.
        """
        if self.pace != "real_time":
            return
        while not ended.is_set():
            now = self._clock.now().nanoseconds
            anchor = self._anchor
            if anchor is None or now < self._latest:
                self._anchor = anchor = (now, time_s)
            self._latest = now
            left = (time_s - anchor[1]) / self.factor - (now - anchor[0]) * 1e-9
            if left <= 0.0:
                if left < -BACKLOG_S:
                    self.slipped_s -= left
                    self._anchor = (now, time_s)
                return
            ended.wait(min(left, GLANCE_S) if self._follows else left)


@dataclass
class _Request:
    answer: Answer
    periods: int = 0
    pressures_pa: dict[str, float] | None = None


@dataclass
class _Meter:
    """Marks for the factor reached."""

    clock_s: float = math.nan
    time_s: float = 0.0
    slipped_s: float = 0.0
    lock: threading.Lock = field(default_factory=threading.Lock)


class Stepper:
    """Runs a rig in a thread of its own.

    Attributes:
        pacing: Decides when the next period is due.
        time_s: Simulated time since the last reset, s.
        failure: Why the simulation stopped, until a reset; empty while it runs.
    """

    def __init__(
        self,
        rig: Rig,
        inputs: Inputs,
        pacing: Pacing,
        period_s: float,
        dx_m: float | None,
        seed: int,
        origin_ns: Callable[[], int] | None,
        publish: Callable[[Sample], None],
        running: Callable[[], bool],
    ) -> None:
        """Builds the grid; `start` sets it going.

        Args:
            rig: The rig.
            inputs: Its commands.
            pacing: Decides when the next period is due.
            period_s: Control period, s.
            dx_m: Cell length that replaces the rig's.
            seed: Seed of the sensor noise.
            origin_ns: Stamp of a start, asked for at each; None is zero.
            publish: Called from the thread with each sample.
            running: Whether publishing is possible still.

        Raises:
            InputError: The rig cannot be simulated step by step.
        """
        self.pacing = pacing
        self.time_s = 0.0
        self.failure = ""
        self._simulator = Simulator(rig, dx_m)
        self._simulator.plant.refuse_early_clocks()
        self._inputs = inputs
        self._period_s = period_s
        self._periods = 0
        self._seed = seed
        self._rng = np.random.default_rng(seed)
        taps, encoders = rig.taps.values(), rig.encoders.values()
        self._noise = np.array([*(t.noise_pa for t in taps), *(e.noise for e in encoders)])
        self._quantum = np.array([*(t.quantum_pa for t in taps), *(e.quantum for e in encoders)])
        self._make_origin = origin_ns or (lambda: 0)
        self._origin_ns = 0
        self._publish = publish
        self._running = running
        self._requests: deque[_Request] = deque()
        self._wake = threading.Condition()
        self._ended = threading.Event()
        self._meter = _Meter()
        self._thread = threading.Thread(target=self._run, name="simulation", daemon=True)

    @property
    def stamp_ns(self) -> int:
        """Stamp of the present simulated time, ns."""
        return self._origin_ns + round(self.time_s * 1e9)

    def start(self) -> None:
        """Starts the thread; kernels are compiled or loaded before time counts."""
        # A period is run and thrown away: the first call loads the kernels, which takes long.
        self._simulator.run(self._period_s, self._inputs.now(0.0), self._period_s)
        self._simulator.reset()
        self._thread.start()

    def stop(self) -> None:
        """Ends the thread and waits for it."""
        self._ended.set()
        with self._wake:
            self._wake.notify_all()
        if self._thread.is_alive():
            self._thread.join()

    def state(self, pipe: str) -> dict[str, NDArray[np.float64]]:
        """Gas in the cells of one pipe; for the stepper's own thread only.

        Args:
            pipe: Name of the pipe.
        """
        return self._simulator.state(pipe)

    def ask_step(self, duration_s: float, answer: Answer) -> None:
        """Has the simulation advance in lock-step.

        Args:
            duration_s: How far, s.
            answer: Called from the thread when it is done.

        Raises:
            InputError: It does not run in lock-step, or the duration is no whole number of periods.
        """
        if self.pacing.pace != "lock_step":
            raise InputError(f"pace: found {self.pacing.pace}, steps are taken in lock_step only")
        periods = round(duration_s / self._period_s)
        if periods < 1 or abs(periods * self._period_s - duration_s) > 1e-6 * duration_s:
            raise InputError(
                f"duration: found {duration_s:g} s, it must be a whole number of control periods"
                f" of {self._period_s:g} s"
            )
        self._ask(_Request(answer, periods=periods))

    def ask_reset(self, pressures_pa: dict[str, float], answer: Answer) -> None:
        """Has the simulation start again from rest.

        Args:
            pressures_pa: Pressures of pipes and chambers, Pa.
            answer: Called from the thread when it is done.
        """
        self._ask(_Request(answer, pressures_pa=pressures_pa))

    def pace_report(self) -> PaceReport:
        """How fast the simulation ran since the last report."""
        meter, pacing = self._meter, self.pacing
        with meter.lock:
            now, time_s = pacing.now_s(), self.time_s
            passed = now - meter.clock_s
            reached = (time_s - meter.time_s) / passed if passed > 0.0 else math.nan
            slipped = pacing.slipped_s > meter.slipped_s
            meter.clock_s, meter.time_s, meter.slipped_s = now, time_s, pacing.slipped_s
        wanted = {"real_time": pacing.factor, "lock_step": math.nan}.get(pacing.pace, math.inf)
        behind = pacing.pace == "real_time" and slipped and not reached > KEPT * wanted
        return PaceReport(wanted, reached, behind, pacing.slipped_s)

    def _ask(self, request: _Request) -> None:
        with self._wake:
            self._requests.append(request)
            self._wake.notify_all()

    def _run(self) -> None:
        self._origin_ns = self._make_origin()
        try:
            self._publish(Sample(0.0, self.stamp_ns, None))
            while not self._ended.is_set() and self._running():
                idle = self.pacing.pace == "lock_step" or bool(self.failure)
                request = self._next_request(wait=idle)
                if request is not None:
                    self._serve(request)
                elif not idle:
                    self._one_period()
        except Exception:
            # Publishing fails when the context goes down under it, which is an ordinary end.
            if self._running() and not self._ended.is_set():
                raise

    def _next_request(self, wait: bool) -> _Request | None:
        with self._wake:
            if wait and not self._requests and not self._ended.is_set():
                self._wake.wait(0.1)
            return self._requests.popleft() if self._requests else None

    def _serve(self, request: _Request) -> None:
        message = ""
        if request.pressures_pa is not None:
            try:
                self._reset(request.pressures_pa)
            except InputError as error:
                message = str(error)
        for _ in range(request.periods):
            if self._ended.is_set() or self.failure:
                break
            self._one_period()
        request.answer((message or self.failure, self.stamp_ns))

    def _reset(self, pressures_pa: dict[str, float]) -> None:
        self._simulator.reset(pressures_pa)
        self._rng = np.random.default_rng(self._seed)
        self._inputs.forget()
        self.failure = ""
        self._periods = 0
        self.time_s = 0.0
        with self._meter.lock:
            self._meter.clock_s = math.nan
        self._origin_ns = self._make_origin()
        self.pacing.restart()
        self._publish(Sample(0.0, self.stamp_ns, None))

    def _one_period(self) -> None:
        """Advances by one period, waits until it is due, publishes what the sensors say."""
        since_ns, volts = self.stamp_ns, self._inputs.now(self.time_s)
        try:
            readings = self._simulator.run(self._period_s, volts, self._period_s)
        except InputError as error:
            self.failure = str(error)
            return
        self._periods += 1
        time_s = self._periods * self._period_s
        clean = np.array([s[-1] for s in (*readings.taps.values(), *readings.encoders.values())])
        noisy = sensors.corrupt(clean[None, :], self._noise, self._quantum, self._rng)[0]
        self.pacing.wait(time_s, self._ended)
        self.time_s = time_s
        if self._running() and not self._ended.is_set():
            count, shown = len(readings.taps), noisy.tolist()
            taps = dict(zip(readings.taps, shown[:count], strict=True))
            encoders = dict(zip(readings.encoders, shown[count:], strict=True))
            joints, speeds = (
                {name: float(series[-1]) for name, series in of.items()}
                for of in (readings.joints, readings.speeds)
            )
            self._publish(
                Sample(time_s, self.stamp_ns, taps, joints, speeds, encoders, volts, since_ns)
            )
