# SPDX-License-Identifier: Apache-2.0
"""Decides at every moment which voltage may go to the valves; pure, the steady time is passed in.

States, the first that applies wins:

=========  ==========================================  ===========================================
state      because                                     left by
=========  ==========================================  ===========================================
E_STOP     somebody called for it                      ``reset``
TRIPPED    a pressure rose above its limit             ``reset``, once the pressure is below again
           a joint is beyond its limits or too fast    ``reset``, once the joint is within them
           an encoder jumps or is frozen
DISABLED   the bridge is not active                    ``enable``
HOLDING    no fresh command, several publishers, bus   by itself when the reason has been gone for
           down, sensor stale, frozen, out of range    the dwell and a new command has come
           or below its limit
FOLLOWING  nothing is wrong
=========  ==========================================  ===========================================

In every state but FOLLOWING the output is the safe voltage, at once and without slew limit.
"""

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from pneu_hw_bridge.safety.limits import SHORTEST_WATCHDOG_S, Limits
from pneu_hw_bridge.safety.motion import EncoderWatch

AT_REST = 1e-3
"""Share of an output's range within which a command is its safe voltage: the step of a converter of
ten bits."""


class State(enum.Enum):
    """What the supervisor lets through."""

    E_STOP = "e_stop"
    TRIPPED = "tripped"
    DISABLED = "disabled"
    HOLDING = "holding"
    FOLLOWING = "following"


@dataclass
class Counters:
    """What happened to commands and readings.

    Attributes:
        accepted: Commands taken.
        not_finite: Commands refused because a voltage was infinite.
        out_of_range: Commands refused because a voltage lay far outside its range.
        unknown: Commands refused because they named no output of this bridge, or were malformed.
        competing: Commands refused because of who publishes: several, or somebody who is not known.
        clamped: Voltages clamped to their range.
        slew_limited: Outputs held back by the slew limit.
        watchdog: Times the command watchdog ended following.
        bad_readings: Readings that were not finite or out of range.
        trips: Trips, by a pressure or an encoder.
        e_stops: Emergency stops.
    """

    accepted: int = 0
    not_finite: int = 0
    out_of_range: int = 0
    unknown: int = 0
    competing: int = 0
    clamped: int = 0
    slew_limited: int = 0
    watchdog: int = 0
    bad_readings: int = 0
    trips: int = 0
    e_stops: int = 0


@dataclass
class _Sensor:
    """What is known of one sensor."""

    seen_s: float = -math.inf
    value_pa: float = math.nan
    changed_s: float = -math.inf
    good: bool = False


@dataclass
class Latches:
    """What outlives a reconfiguration and is only left by a reset.

    Attributes:
        e_stop: Why the emergency stop was called for; empty if it was not.
        trip: Why the bridge tripped; empty if it did not.
    """

    e_stop: str = ""
    trip: str = ""


@dataclass
class Supervisor:
    """The state machine. Times are seconds of one steady clock that never jumps.

    Attributes:
        limits: What it goes by.
        latches: Emergency stop and trip.
        enabled: Whether the bridge is active.
        counters: What happened.
    """

    limits: Limits
    latches: Latches = field(default_factory=Latches)
    enabled: bool = False
    counters: Counters = field(default_factory=Counters)

    def __post_init__(self) -> None:
        self._bus = "not connected yet"
        self._publishers = 0
        self._wrong_publisher = ""
        self._target = {name: math.nan for name in self.limits.outputs}
        self._fresh_s = {name: -math.inf for name in self.limits.outputs}
        self._sensors = {name: _Sensor() for name in self.limits.sensors}
        self._encoders = {n: EncoderWatch(n, one) for n, one in self.limits.encoders.items()}
        self._output = self.safe()
        self._output_s: float | None = None
        self._followed = False
        self._to_rest: set[str] = set()  # outputs whose safe voltage is awaited after a reset
        self._wait_from_s = -math.inf
        self._waits_for = ""
        self._mostly_s = 0.0
        self._usually_s = 0.0

    def safe(self) -> dict[str, float]:
        """Returns the safe voltages."""
        return {name: output.safe_v for name, output in self.limits.outputs.items()}

    # What others tell

    def enable(self) -> None:
        """Lets commands through from now on; older ones are forgotten."""
        self.enabled = True
        self._to_rest.clear()
        self._wait_from_s = -math.inf
        self._forget_commands()

    def disable(self) -> None:
        """Lets no command through."""
        self.enabled = False
        self._forget_commands()

    def e_stop(self, reason: str) -> None:
        """Stops until it is reset.

        Args:
            reason: Who called for it.
        """
        if not self.latches.e_stop:
            self.counters.e_stops += 1
            self.latches.e_stop = reason
        self._forget_commands()

    def reset(self, now_s: float) -> str:
        """Releases the emergency stop and a trip, where nothing speaks against it.

        That alone moves nothing (ISO 13850, 4.1.4): a controller that went on commanding is
        followed after it has commanded the safe voltage of every output, or after `enable`.

        Args:
            now_s: Now.

        Returns:
            Why not; empty where it was released.
        """
        if self.latches.trip:
            for name, limit in self.limits.sensors.items():
                if math.isinf(limit.trip_above_pa):
                    continue
                sensor = self._sensors[name]
                if not sensor.good or now_s - sensor.seen_s > self.limits.sensor_timeout_s:
                    return f"the pressure at {name} is not known"
                if sensor.value_pa > limit.trip_above_pa:
                    return (
                        f"{name} is still at {sensor.value_pa:.0f} Pa, above"
                        f" {limit.trip_above_pa:.0f} Pa"
                    )
            for name, watch in self._encoders.items():
                if not watch.good or now_s - watch.seen_s > self.limits.sensor_timeout_s:
                    return f"the position of {name} is not known"
                if beyond := watch.beyond():
                    return f"still, {beyond}"
                watch.forget()
        if self.latches.e_stop or self.latches.trip:
            self._wait_from_s = -math.inf
            self._to_rest = set(self.limits.outputs)
        self.latches.e_stop = ""
        self.latches.trip = ""
        self._forget_commands()
        return ""

    def publishers(self, count: int, wrong: str = "") -> None:
        """Takes note of the publishers of the command topic.

        Args:
            count: How many; a command is not followed before there is one.
            wrong: Why they are not followed, whatever their number; empty where they may be.
        """
        if count > 1:
            wrong = f"{count} publishers on the command topic, one is allowed"
        self._publishers, self._wrong_publisher = count, wrong
        if wrong or not count:  # where there is none any more, that no command comes is not wrong
            self._forget_commands()

    def takes(self, mostly_s: float, usually_s: float) -> None:
        """Takes note of how long it takes from a decision until all outputs are written.

        Args:
            mostly_s: In 95 of 100 cases at most, s; NaN where it is not known.
            usually_s: In every other case at most, s; NaN where it is not known.
        """
        self._mostly_s = 0.0 if math.isnan(mostly_s) else mostly_s
        self._usually_s = 0.0 if math.isnan(usually_s) else usually_s

    @property
    def watchdog_s(self) -> float:
        """How long a command is followed: shorter where it takes long to write.

        With what it takes to write the valves are safe within `Limits.safe_within_s`.
        """
        left_s = self.limits.safe_within_s - self._mostly_s
        return min(self.limits.watchdog_s, max(left_s, SHORTEST_WATCHDOG_S))

    def bus(self, fault: str) -> None:
        """Takes note of the bus.

        Args:
            fault: What is wrong with it; empty where it works.
        """
        if fault and not self._bus:
            self._forget_commands()
        self._bus = fault

    def command(self, voltages: Mapping[str, float], now_s: float) -> str:
        """Takes a command, or refuses it as a whole.

        Args:
            voltages: Volts per output; NaN is no command for that one.
            now_s: When it was sent; the watchdog counts from then on.

        Returns:
            Why it was refused; empty where it was taken.
        """
        margin = self.limits.clamp_margin_v
        taken: dict[str, float] = {}
        for name, value in voltages.items():
            limit = self.limits.outputs.get(name)
            if limit is None:
                self.counters.unknown += 1
                known = ", ".join(self.limits.outputs)
                return f"command {name!r}: this bridge has {known}"
            if math.isnan(value):
                continue
            if math.isinf(value):
                self.counters.not_finite += 1
                return f"command {name!r}: found {value}"
            if not limit.lower_v - margin <= value <= limit.upper_v + margin:
                self.counters.out_of_range += 1
                return (
                    f"command {name!r}: found {value:g} V, allowed are {limit.lower_v:g} to"
                    f" {limit.upper_v:g} V"
                )
            taken[name] = value
        if not taken:
            self.counters.not_finite += 1
            return "the command has no voltage but NaN"
        if self._wrong_publisher or not self._publishers:
            self.counters.competing += 1
            return self._wrong_publisher or "nobody is known to publish commands"
        if self.latches.e_stop or self.latches.trip:
            return self.latches.e_stop or self.latches.trip
        if not self.enabled:
            return "not active"
        for name, value in taken.items():
            limit = self.limits.outputs[name]
            if abs(value - limit.safe_v) <= AT_REST * (limit.upper_v - limit.lower_v):
                self._to_rest.discard(name)
        if self._to_rest:
            return self._awaits()
        self.counters.accepted += 1
        for name, value in taken.items():
            limit = self.limits.outputs[name]
            clamped = min(max(value, limit.lower_v), limit.upper_v)
            if clamped != value:
                self.counters.clamped += 1
            self._target[name] = clamped
            self._fresh_s[name] = now_s
        return ""

    def _awaits(self) -> str:
        """What is awaited after a reset, for people."""
        outputs = ", ".join(f"{n} {v:g} V" for n, v in self.safe().items() if n in self._to_rest)
        return f"waits after a reset for the safe voltage ({outputs}), or for activation"

    def reading(self, name: str, value_pa: float, now_s: float) -> None:
        """Takes a reading; trips where it is too high.

        Args:
            name: Tap.
            value_pa: Its reading.
            now_s: When it was acquired.
        """
        limit, sensor = self.limits.sensors[name], self._sensors[name]
        sensor.seen_s = now_s
        sensor.good = limit.lower_pa <= value_pa <= limit.upper_pa  # false for NaN
        if not sensor.good:
            self.counters.bad_readings += 1
        if value_pa != sensor.value_pa:
            sensor.changed_s = now_s
        sensor.value_pa = value_pa
        # A sensor that has come to the end of its range shows an over-pressure all the same; beyond
        # that by more than its span it shows nothing: the number was spoilt on its way.
        most_pa = 2.0 * limit.upper_pa - limit.lower_pa
        if limit.trip_above_pa < value_pa <= most_pa:
            self._trip(
                f"over-pressure: {name} rose to {value_pa:.0f} Pa, above"
                f" {limit.trip_above_pa:.0f} Pa"
            )

    def position(self, name: str, value: float, now_s: float, taken_s: float | None) -> None:
        """Takes an encoder's reading; trips where it says what must not be, or cannot be.

        Args:
            name: Encoder.
            value: Its reading, rad or m.
            now_s: When it was acquired.
            taken_s: The same by the clock that tells readings apart best, s; None where it is not
                known well enough to tell a speed.
        """
        watch = self._encoders[name]
        force = self._force(name, now_s)
        wrong = watch.take(value, now_s, taken_s, force, self.limits.sensor_timeout_s)
        if not watch.good:
            self.counters.bad_readings += 1
        if wrong:
            self._trip(f"encoder: {wrong}")

    def _force(self, name: str, now_s: float) -> float | None:
        """What the gas pushes a joint with, N or N m; None where that is not known."""
        frozen = self.limits.encoders[name].frozen
        if frozen is None:
            return None
        total = frozen.offset
        for tap, area in frozen.force.items():
            sensor = self._sensors[tap]
            if not sensor.good or now_s - sensor.seen_s > self.limits.sensor_timeout_s:
                return None
            total += area * sensor.value_pa
        return total

    def _trip(self, why: str) -> None:
        """Trips, where it has not yet."""
        if not self.latches.trip:
            self.counters.trips += 1
            self.latches.trip = why
            self._forget_commands()

    # What it decides

    def reasons(self, now_s: float) -> list[str]:
        """Returns why commands are held back now, but for latches and not being enabled.

        Args:
            now_s: Now.
        """
        found = [f"bus: {self._bus}"] if self._bus else []
        if self._wrong_publisher:
            found.append(self._wrong_publisher)
        for name, limit in self.limits.sensors.items():
            sensor = self._sensors[name]
            age_s = now_s - sensor.seen_s
            if age_s > self.limits.sensor_timeout_s:
                since = "never read" if math.isinf(age_s) else f"stale for {age_s:.2f} s"
                found.append(f"sensor {name}: {since}")
            elif not sensor.good:
                found.append(f"sensor {name}: {sensor.value_pa:g} Pa is out of its range")
            elif sensor.value_pa < limit.hold_below_pa:
                found.append(
                    f"sensor {name}: {sensor.value_pa:.0f} Pa is below {limit.hold_below_pa:.0f} Pa"
                )
            elif sensor.seen_s - sensor.changed_s > limit.frozen_after_s:
                found.append(f"sensor {name}: frozen at {sensor.value_pa:.0f} Pa")
        for name, watch in self._encoders.items():
            age_s = now_s - watch.seen_s
            if age_s > self.limits.sensor_timeout_s:
                since = "never read" if math.isinf(age_s) else f"stale for {age_s:.2f} s"
                found.append(f"encoder {name}: {since}")
            elif not watch.good:
                found.append(f"encoder {name}: {watch.value:g} is out of its range")
        within_s = self.limits.safe_within_s
        if (at_best_s := SHORTEST_WATCHDOG_S + self._usually_s) > within_s:
            found.append(
                f"the device is too slow: valves would be safe after {at_best_s:.2f} s at best,"
                f" allowed is {within_s:g} s (safe_within_s)"
            )
        if self._to_rest:
            found.append(self._awaits())
        watchdog_s = self.watchdog_s
        for name, fresh_s in self._fresh_s.items():
            age_s = now_s - fresh_s
            if math.isinf(age_s):
                found.append(f"command {name}: none yet")
            elif age_s > watchdog_s:
                most = f", allowed {watchdog_s:.3f} s as the device is slow"
                slow = watchdog_s < self.limits.watchdog_s
                found.append(f"command {name}: none for {age_s:.2f} s{most if slow else ''}")
        left_s = self._wait_from_s + self.limits.dwell_s - now_s
        if left_s > 0.0:
            found.append(f"waits {left_s:.1f} s after: {self._waits_for}")
        return found

    def state(self, now_s: float) -> State:
        """Returns the state.

        Args:
            now_s: Now.
        """
        if self.latches.e_stop:
            return State.E_STOP
        if self.latches.trip:
            return State.TRIPPED
        if not self.enabled:
            return State.DISABLED
        return State.HOLDING if self.reasons(now_s) else State.FOLLOWING

    def explain(self, now_s: float) -> str:
        """Returns the reasons of the present state for people.

        Args:
            now_s: Now.
        """
        state = self.state(now_s)
        if state is State.E_STOP:
            return f"e-stop: {self.latches.e_stop}"
        if state is State.TRIPPED:
            return self.latches.trip
        if state is State.DISABLED:
            return "not active"
        return "; ".join(self.reasons(now_s))

    def output(self, now_s: float) -> dict[str, float]:
        """Returns the voltages to write now. Called at every cycle of the bus.

        Args:
            now_s: Now; never before an earlier call.
        """
        if self.state(now_s) is not State.FOLLOWING:
            self._dwell(now_s)
            if self._followed and any(
                now_s - fresh_s > self.watchdog_s and not math.isinf(fresh_s)
                for fresh_s in self._fresh_s.values()
            ):
                self.counters.watchdog += 1
            self._followed = False
            self._output = self.safe()
            self._output_s = now_s
            # What held it back may be gone the next moment; only a new command moves the valves.
            if self.enabled and self._held_by_fault(now_s):
                self._forget_commands()
            return dict(self._output)
        self._followed = True
        before_s = now_s if self._output_s is None else self._output_s
        step = self.limits.slew_v_s * max(now_s - before_s, 0.0)
        for name, target in self._target.items():
            last = self._output[name]
            allowed = min(max(target, last - step), last + step)
            if allowed != target:
                self.counters.slew_limited += 1
            self._output[name] = allowed
        self._output_s = now_s
        return dict(self._output)

    def _dwell(self, now_s: float) -> None:
        """Begins to wait anew, once commands were followed, as long as anything goes wrong.

        Valves that flutter with a sensor or a controller would wear out, and nobody could read the
        log. That no command has come yet is not wrong.
        """
        waiting = now_s < self._wait_from_s + self.limits.dwell_s
        if not (self._followed or waiting):
            return
        wrong = [
            r
            for r in self.reasons(now_s)
            if not r.startswith("waits ") and not r.endswith(": none yet")
        ]
        if wrong or self._followed:
            self._wait_from_s = now_s
            self._waits_for = "; ".join(wrong) or "the commands ended"

    def _held_by_fault(self, now_s: float) -> bool:
        """Whether anything but the lack of commands, or the wait after a fault, holds."""
        return any(not reason.startswith(("command ", "waits ")) for reason in self.reasons(now_s))

    def _forget_commands(self) -> None:
        for name in self._fresh_s:
            self._fresh_s[name] = -math.inf
            self._target[name] = math.nan
