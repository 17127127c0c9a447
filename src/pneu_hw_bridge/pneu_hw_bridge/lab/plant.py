# SPDX-License-Identifier: Apache-2.0
"""A rig simulated in real time, in a thread: voltages in, noisy and late readings out.

Simulated time is the steady clock's, whatever the machine is busy with: a voltage acts from the
moment at which it was set, and a reading is that of the moment asked for. Where the thread is late,
the reading is waited for, as on a slow device; it never shows a wrong moment. Whether the machine
can keep up is measured before the start, and refused where it cannot. Time that cannot be caught up
is skipped, counted and reported.

For a device with a clock of its own the plant also keeps samples, taken at even intervals of
simulated time, which is the device's time: a sample is the plant's state exactly at the time it
carries, and a voltage acts exactly from the time that is told of it. Such a plant may be paced:
where the machine is late, the device's time waits rather than run on without the plant; and it
waits for a reader that would else lose samples.
"""

import math
import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_common.garbage import spare_what_stays
from pneu_sim import sensors
from pneu_sim.effects.places import sources
from pneu_sim.rig.schema import Rig
from pneu_sim.simulator import Simulator

Floats = NDArray[np.float64]

LEAST_FACTOR = 1.3
"""Least speed, times real time, at which a plant is started."""

MOST_CATCH_UP_S = 2.0
"""Lag that is still caught up; beyond that time is skipped."""

BLOCK_SAMPLES = 20
"""Most samples simulated at once while catching up."""

KEPT_S = 1.0
"""How long the past is kept for readings beyond their latency."""

PACED_CATCH_UP_S = 0.005
"""Lag that a paced plant catches up; beyond that its time waits. Enough for a sleep too long, and
little, since what is caught up runs faster than whoever controls it."""

READER_GONE_S = 1.0
"""A paced plant waits no longer than this for a reader, s."""


@dataclass(frozen=True)
class Pace:
    """How a device with a clock of its own samples and passes its time.

    Attributes:
        period_s: Interval of its samples, s; a multiple of the plant's.
        kept: Samples that it shows.
        factor: Seconds of device time per second, where the plant is paced; None where device time
            is real time.
        standing: Whether time stands still at first, where the plant is paced.
    """

    period_s: float
    kept: int
    factor: float | None = None
    standing: bool = False


@dataclass(frozen=True)
class Sample:
    """What the sensors showed at one time.

    Attributes:
        number: Number of the sample.
        time_s: Simulated time, s.
        readings: Per tap its reading, Pa, and per encoder its own, rad or m.
    """

    number: int
    time_s: float
    readings: dict[str, float]


@dataclass(frozen=True)
class PlantStatus:
    """How the plant is doing.

    Attributes:
        time_s: Simulated time.
        speed: Simulated time per computing time: how many times faster than real time it could run.
        lag_s: How far it is behind at the moment.
        worst_lag_s: How far it has been behind.
        skipped_s: Time that was skipped because it could not be caught up.
        waited_s: Time in which a paced plant's time waited for the machine, or for its reader.
        supply_lost: Whether the supply is cut off.
        standing: Whether a paced plant's time was made to stand still.
    """

    time_s: float
    speed: float
    lag_s: float
    worst_lag_s: float
    skipped_s: float
    waited_s: float
    supply_lost: bool
    standing: bool


class Plant:
    """The rig and its thread.

    Attributes:
        rig: The rig, hidden effects included.
    """

    def __init__(
        self,
        rig: Rig,
        safe_v: Mapping[str, float],
        dx_m: float | None = None,
        sample_s: float = 1e-3,
        latency_s: float = 0.0,
        noise_pa: float | None = None,
        quantum_pa: float | None = None,
        seed: int = 0,
        pace: Pace | None = None,
    ) -> None:
        """Builds the rig at rest; `start` begins.

        Args:
            rig: The rig.
            safe_v: Voltages that it starts with.
            dx_m: Cell length that replaces the rig's.
            sample_s: Interval at which sensors are sampled and voltages taken, s.
            latency_s: Age of a reading when it becomes visible, s.
            noise_pa: White noise, one sigma, that replaces that of the rig's taps.
            quantum_pa: Quantisation step that replaces that of the rig's taps.
            seed: Seed of the noise.
            pace: How a device with a clock of its own samples it; None for one without.

        Raises:
            InputError: The rig cannot be simulated so, or needs other voltages.
        """
        if not 2e-4 <= sample_s <= 0.1:
            raise InputError(f"sample_s: found {sample_s:g}, needed are 0.0002 to 0.1 s")
        if not 0.0 <= latency_s <= 1.0:
            raise InputError(f"latency_s: found {latency_s:g}, needed are 0 to 1 s")
        self._every = 1 if pace is None else round(pace.period_s / sample_s)
        if pace is not None and abs(self._every * sample_s - pace.period_s) > 1e-9:
            raise InputError(
                f"period_s: found {pace.period_s:g}, needed is a multiple of the plant's"
                f" {sample_s:g} s"
            )
        if pace is not None and pace.factor is not None and not 0.01 <= pace.factor <= 1.0:
            raise InputError(f"pace: found {pace.factor:g}, needed are 0.01 to 1")
        missing = sorted(set(rig.commands) ^ set(safe_v))
        if missing:
            raise InputError(
                f"rig {rig.name!r} and the register map differ in command {missing[0]!r}"
            )
        self.rig = rig
        self._simulator = Simulator(rig, dx_m=dx_m)
        self._sample_s = sample_s
        self._latency_s = latency_s
        self._seed = seed
        self._pace = pace
        self._rng = np.random.default_rng(seed)
        taps, encoders = rig.taps.values(), rig.encoders.values()
        self._names = [*rig.taps, *rig.encoders]
        noise = [t.noise_pa if noise_pa is None else noise_pa for t in taps]
        quantum = [t.quantum_pa if quantum_pa is None else quantum_pa for t in taps]
        self._noise = np.array([*noise, *(one.noise for one in encoders)])
        self._quantum = np.array([*quantum, *(one.quantum for one in encoders)])
        self._volts = dict(safe_v)
        self._acting = dict(safe_v)
        self._changes: deque[tuple[float, dict[str, float]]] = deque()
        self._lock = threading.Lock()
        self._supplies = {name: rig.reservoirs[name].pressure_pa for name in sources(rig)}
        self._supply_lost = False
        self._supply_applied = False
        kept = math.ceil((latency_s + KEPT_S) / sample_s) + BLOCK_SAMPLES
        self._past: deque[Floats] = deque(maxlen=kept)
        late = math.ceil(latency_s / sample_s / self._every)
        self._taken: deque[Sample] = deque(maxlen=late + 1 + (pace.kept if pace else 0))
        self._promised = 0
        self._shown = 0
        self._shown_s = -math.inf
        self._standing = pace is not None and pace.standing
        self._until: int | None = None
        self._begun_s = math.nan
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._lag_s = self._worst_lag_s = self._skipped_s = self._waited_s = 0.0
        self._busy_s = self._done_s = 0.0
        self.failure = ""
        self._start_over()

    def measure(self, duration_s: float = 0.3) -> float:
        """Returns how many times faster than real time the plant runs, then starts it from rest.

        Args:
            duration_s: Simulated time to measure over, s.
        """
        self._advance(1, self._acting)  # compiles what is not compiled yet
        self._busy_s = self._done_s = 0.0
        for _ in range(max(1, round(duration_s / self._sample_s))):
            self._advance(1, self._acting)
        speed = self._done_s / self._busy_s
        self._start_over()
        return speed

    def _start_over(self) -> None:
        self._simulator.reset()
        self._past.clear()
        self._taken.clear()
        self._own_rng = np.random.default_rng(self._seed)
        self._samples = 0
        self._advance(1, self._acting)
        self._promised = self._samples

    def start(self, allow_slow: bool = False) -> float:
        """Begins to run in real time.

        Args:
            allow_slow: Start even where the machine cannot keep up.

        Returns:
            How many times faster than real time the plant runs.

        Raises:
            InputError: The machine cannot keep up.
        """
        speed = self.measure()
        paced = self._pace is not None and self._pace.factor is not None
        if speed < LEAST_FACTOR and not (allow_slow or paced):
            raise InputError(
                f"rig {self.rig.name!r} runs at {speed:.2f} times real time here, needed are"
                f" {LEAST_FACTOR:g}; choose a longer cell (--dx) or a coarser rig"
            )
        spare_what_stays()
        self._begun_s = time.monotonic() - self._samples * self._sample_s
        self._thread = threading.Thread(target=self._run, name="plant", daemon=True)
        self._thread.start()
        return speed

    def stop(self) -> None:
        """Ends the thread."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(2.0)

    def apply(self, volts: Mapping[str, float]) -> None:
        """Sets voltages from this moment on.

        Args:
            volts: Per command its voltage.
        """
        with self._lock:
            self._volts = {**self._volts, **volts}
            self._changes.append((time.monotonic(), self._volts))

    def take(self, volts: Mapping[str, float]) -> float:
        """Sets voltages from the next sample on that is not being simulated yet.

        Args:
            volts: Per command its voltage.

        Returns:
            The simulated time from which on they act, s.
        """
        with self._lock:
            self._volts = self._acting = {**self._volts, **volts}
            return self._promised * self._sample_s

    def now_s(self) -> float:
        """Returns the device's time, s: of a paced plant its simulated time, else a steady one."""
        if self._pace is None or self._pace.factor is None:
            return time.monotonic()
        return self._samples * self._sample_s

    def stand(self) -> None:
        """Has the time of a paced plant stand still.

        Raises:
            InputError: The plant is not paced.
        """
        self._check_paced()
        self._standing = True

    def go(self, seconds: float | None = None) -> None:
        """Has the time of a paced plant pass again.

        Args:
            seconds: Simulated time after which it stands still again, s; None is never.

        Raises:
            InputError: The plant is not paced, or the time is not positive.
        """
        self._check_paced()
        if seconds is not None and not (seconds > 0.0 and math.isfinite(seconds)):
            raise InputError(f"seconds: found {seconds:g}, must be positive")
        with self._lock:
            steps = None if seconds is None else max(1, round(seconds / self._sample_s))
            self._until = None if steps is None else self._promised + steps
            self._standing = False

    def _check_paced(self) -> None:
        if self._pace is None or self._pace.factor is None:
            raise InputError("only the time of a lab with --paced can stand still")

    def taken(self, at_s: float) -> list[Sample] | None:
        """Returns the samples that a device with a clock shows, the newest first.

        Args:
            at_s: Steady time at which it is asked.

        Returns:
            None where the plant is not yet there; a paced one always is, by its own time.
        """
        assert self._pace is not None
        with self._lock:
            now_s = self._samples * self._sample_s
            if self._pace.factor is None and math.isfinite(self._begun_s):
                since_s = at_s - self._begun_s
                if since_s - self._latency_s > now_s + self._sample_s:
                    return None
                now_s = min(now_s, since_s)
            visible = [
                one for one in self._taken if one.time_s <= now_s - self._latency_s + 1e-9
            ] or [self._taken[0]]
            shown = visible[: -self._pace.kept - 1 : -1]
            self._shown = round(shown[0].time_s / self._sample_s)
            self._shown_s = time.monotonic()
        return shown

    def newest(self) -> Sample:
        """Returns the newest sample, shown or not."""
        with self._lock:
            return self._taken[-1]

    def volts(self) -> dict[str, float]:
        """Returns the voltages that the valves have now."""
        return dict(self._volts)

    def supply(self, lost: bool) -> None:
        """Cuts the supply off, or restores it.

        Args:
            lost: Whether it is cut off.
        """
        self._supply_lost = lost

    def readings(self, at_s: float | None = None) -> dict[str, float] | None:
        """Returns what taps, Pa, and encoders, rad or m, show at a moment; None before it is there.

        Args:
            at_s: Steady time, at most `KEPT_S` ago; None is the newest that there is.
        """
        with self._lock:
            # From the newest sample back. The converter works when it is asked, not at samples.
            back = 0.0
            if at_s is not None and math.isfinite(self._begun_s):
                since_s = at_s - self._latency_s - self._begun_s
                back = self._samples - since_s / self._sample_s
            if back < 0.0:
                return None
            right = min(int(back), len(self._past) - 1)
            left = min(right + 1, len(self._past) - 1)
            share = back - int(back)
            late, early = self._past[-1 - right], self._past[-1 - left]
        clean = (1.0 - share) * late + share * early
        noisy = sensors.corrupt(clean[None], self._noise, self._quantum, self._rng)[0]
        return dict(zip(self._names, noisy.tolist(), strict=True))

    def status(self) -> PlantStatus:
        """Returns how the plant is doing."""
        return PlantStatus(
            time_s=self._samples * self._sample_s,
            speed=self._done_s / self._busy_s if self._busy_s > 0.0 else math.nan,
            lag_s=self._lag_s,
            worst_lag_s=self._worst_lag_s,
            skipped_s=self._skipped_s,
            waited_s=self._waited_s,
            supply_lost=self._supply_lost,
            standing=self._standing,
        )

    def _run(self) -> None:
        while not self._stop.is_set():
            with self._lock:
                paced = self._pace is not None and self._pace.factor is not None
                due, lag_s = self._due_when_paced() if paced else self._due()
                if self._pace is not None:
                    due = min(due, 1)  # so that a voltage acts soon, and alike however late it is
                held = self._held(due) if due else {}
                self._promised = self._samples + due
            if not due:
                time.sleep(max(self._sample_s - max(lag_s, 0.0), 0.3 * self._sample_s))
                continue
            try:
                self._advance(due, held)
            except InputError as error:  # became unstable
                self.failure = str(error)
                return

    def _due(self) -> tuple[int, float]:
        """How many samples are due by the steady clock, and how far the plant is behind it, s."""
        now_s = time.monotonic()
        lag_s = now_s - self._begun_s - self._samples * self._sample_s
        self._lag_s = max(lag_s, 0.0)
        self._worst_lag_s = max(self._worst_lag_s, self._lag_s)
        if lag_s > MOST_CATCH_UP_S:
            self._begun_s += lag_s - self._sample_s
            self._skipped_s += lag_s
            lag_s = self._sample_s
        return min(int(lag_s / self._sample_s + 1e-6), BLOCK_SAMPLES), lag_s

    def _due_when_paced(self) -> tuple[int, float]:
        """The same where the plant's time waits for what it cannot do without."""
        assert self._pace is not None and self._pace.factor is not None
        factor, h = self._pace.factor, self._sample_s
        now_s = time.monotonic()
        lag_s = (now_s - self._begun_s) * factor - self._samples * h
        if lag_s > PACED_CATCH_UP_S:
            self._begun_s += (lag_s - PACED_CATCH_UP_S) / factor
            if not self._standing:
                self._waited_s += (lag_s - PACED_CATCH_UP_S) / factor
            lag_s = PACED_CATCH_UP_S
        due = int(lag_s / h + 1e-6)
        if self._until is not None:
            left = self._until - self._samples
            self._standing = self._standing or left <= 0
            due = min(due, left)
        if now_s - self._shown_s < READER_GONE_S:
            # One sample less than it shows: the reader may ask just before the next is taken.
            ahead = (self._pace.kept - 1) * self._every + math.ceil(self._latency_s / h)
            due = min(due, max(self._shown + ahead - self._samples, 0))
        return (0, 0.0) if self._standing else (due, lag_s)

    def _held(self, samples: int) -> dict[str, Floats]:
        """The voltages of the next samples; where one changes during a sample, their mean."""
        h = self._sample_s
        begin_s = self._begun_s + self._samples * h
        series = {name: np.full(samples, volts) for name, volts in self._acting.items()}
        while self._changes and self._changes[0][0] < begin_s + samples * h:
            at_s, volts = self._changes.popleft()
            at = max((at_s - begin_s) / h, 0.0)
            k = int(at)
            for name, values in series.items():
                values[k] += (k + 1 - at) * (volts[name] - self._acting[name])
                values[k + 1 :] = volts[name]
            self._acting = volts
        return series

    def _advance(self, samples: int, held: Mapping[str, float | Floats]) -> None:
        """Simulates some samples under given voltages."""
        begun_s = time.perf_counter()
        if self._supply_lost != self._supply_applied:
            self._supply_applied = self._supply_lost
            for name, pressure_pa in self._supplies.items():
                room = self.rig.ambient.pressure_pa
                self._simulator.set_reservoir(name, room if self._supply_lost else pressure_pa)
        duration_s = samples * self._sample_s
        taken = self._simulator.run(duration_s, held, self._sample_s)
        clean = np.stack([*taken.taps.values(), *taken.encoders.values()], axis=-1)
        with self._lock:
            self._past.extend(clean[1:])
            if self._pace is not None:
                first = 0 if self._samples == 0 else 1  # the state at the very beginning is one too
                self._sample(clean[first:], self._samples + first)
            self._samples += samples
        self._done_s += duration_s
        self._busy_s += time.perf_counter() - begun_s

    def _sample(self, rows: Floats, begin: int) -> None:
        """Takes the samples that fall on rows of readings, the first at a given time in steps."""
        for step, clean in enumerate(rows, begin):
            if step % self._every:
                continue
            noisy = sensors.corrupt(clean[None], self._noise, self._quantum, self._own_rng)[0]
            readings = dict(zip(self._names, noisy.tolist(), strict=True))
            self._taken.append(Sample(step // self._every, step * self._sample_s, readings))
