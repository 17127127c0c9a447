# SPDX-License-Identifier: Apache-2.0
"""What the nodes of all controllers share: life cycle, topics, ages, the safe voltage, diagnostics.

A lifecycle node commands valves while active only, and a deactivation ends with the safe voltage.
It hears the taps, encoders and target that its controller asks for, and commands the safe voltage
where one of them is missing, stale or unusable. Which voltages else, and what a target is, is said
by the node of the controller.
"""

import functools
import math
from abc import abstractmethod
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.clock import JumpThreshold, ROSClock
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import qos_profile_sensor_data

from pneu_common.errors import InputError
from pneu_common.garbage import spare_what_stays
from pneu_graph.nodes import common
from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_sim import topics
from pneu_sim.rig import Rig, load_rig

NO_READING = "no pressure reading"
NO_NUMBER = "reading is no number"
NO_PRESSURE = "reading cannot be true"
FROZEN = "reading does not change"
OLD_READING = "reading is of another time"
NO_TARGET = "no target"
SHORT_TARGET = "target too short"
NO_CLOCK = "clock runs wrong"
FAILED = "the controller failed"
READINGS_LOST = (NO_READING, NO_NUMBER, NO_PRESSURE, FROZEN, OLD_READING)

LAST_WORD_S = 0.2
"""So long a node that ends waits for its last word to be heard, s."""
AT_REST_V = 0.2
"""With the valve so near to its safe voltage a pressure may well stay the same, V."""
LEAP_S = 0.5
"""Simulated time that goes on by more at once has jumped, s."""
MOST_SEEN = 64


@dataclass
class Reading:
    """The newest reading of a tap or an encoder.

    Attributes:
        stamp_ns: When it was taken, ns.
        value: What it says, Pa, rad or m.
        arrival_ns: When a reading with this stamp came first, by the clock that ages go by, ns.
        changed_ns: When one that said something else came last, likewise, ns.
        off_s: How much older it was than its arrival, by the node's clock, s.
    """

    stamp_ns: int
    value: float
    arrival_ns: int
    changed_ns: int
    off_s: float


@dataclass
class ControllingParameters(Parameters):
    """What the nodes of all controllers are told."""

    rig: str = parameter(
        "",
        "Rig file of what is controlled, which a policy must be for; its channels say on which"
        " topics. Empty: nothing is checked, and they are valve/command and taps/<tap>/pressure.",
        read_only=True,
    )
    sensor_timeout_s: float = parameter(
        0.05,
        "Age of the newest reading at which the safe voltage is published, s.",
        within=(0.001, 1.0),
        read_only=True,
    )
    target_timeout_s: float = parameter(
        0.25,
        "Age of the newest target at which the safe voltage is published, s.",
        within=(0.001, 10.0),
        read_only=True,
    )
    safe_voltage_v: float = parameter(
        5.0,
        "Published while sensor or target are stale, and on deactivation, V.",
        within=(-24.0, 24.0),
        read_only=True,
    )
    lowest_pa: float = parameter(
        1e4,
        "Lowest pressure, absolute, that a reading or a target can have, Pa.",
        within=(0.0, 1e8),
        read_only=True,
    )
    highest_pa: float = parameter(
        1.6e6,
        "Highest pressure, absolute, that a reading or a target can have, Pa.",
        within=(1.0, 1e8),
        read_only=True,
    )
    frozen_after_s: float = parameter(
        0.25,
        "A tap whose readings stay the same for so long while the valve is driven is dead, s; 0"
        " believes it, as of a model without noise.",
        within=(0.0, 10.0),
        read_only=True,
    )
    stamp_tolerance_s: float = parameter(
        10.0,
        "By so much a reading's stamp may differ from the node's clock when it comes, s.",
        within=(0.01, 1e6),
        read_only=True,
    )
    clock_factor: float = parameter(
        20.0,
        "By so much simulated time may pass faster or slower than real time.",
        within=(1.0, 1e6),
        read_only=True,
    )
    clock_window_s: float = parameter(
        0.1,
        "The rate of simulated time is looked at over so long, s of the machine's time.",
        within=(0.01, 60.0),
        read_only=True,
    )
    autostart: bool = parameter(False, "Configure and activate at start.", read_only=True)


class ControllingNode(LifecycleNode):
    """A target and readings in, valve commands out."""

    parameters: type[ControllingParameters] = ControllingParameters
    """What it is told."""

    takes_nan = False
    """Whether a reading that is no number counts as the newest one; else it is not heard at all."""

    def __init__(self, name: str, **options: Any) -> None:
        """Declares the parameters; with ``autostart`` it is active at once.

        Args:
            name: Name of the node.
            options: Keywords of ``rclpy.lifecycle.LifecycleNode``.

        Raises:
            InputError: The parameters make no controller.
        """
        super().__init__(name, **options)
        self._diagnostics: common.Diagnostics | None = None
        self._refused = ""
        self._taps: tuple[str, ...] = ()
        self._encoders: tuple[str, ...] = ()
        self._valves: tuple[str, ...] = ()
        self._spare: frozenset[str] = frozenset()
        self._lost: dict[str, tuple[str, str]] = {}
        self._rig: Rig | None = None
        self._period_s = math.nan
        try:
            self._params = self.parameters.declare(self)
            if not self._params.lowest_pa < self._params.highest_pa:
                raise InputError(
                    f"highest_pa: found {self._params.highest_pa:g}, lowest_pa is"
                    f" {self._params.lowest_pa:g}"
                )
            self._set_up()
            self._state, self._detail = "inactive", ""
            self._commands = self._sensor_losses = self._target_losses = self._jumps = 0
            self._reported_ns: int | None = None
            self._clock_seen: deque[tuple[int, int]] = deque(maxlen=MOST_SEEN)
            self._forget()
            if self._params.autostart:
                self.trigger_configure()
                if self._refused:
                    raise InputError(self._refused)
                self.trigger_activate()
        except InputError:
            self.destroy_node()
            raise

    # ---- what the node of a controller says ----------------------------------------------------

    def _set_up(self) -> None:
        """Takes what its parameters say, once they are declared.

        Raises:
            InputError: They make no controller, whatever else there is.
        """

    @abstractmethod
    def _make(self) -> None:
        """Makes the controller; sets ``_taps``, ``_encoders``, ``_valves`` and ``_period_s``.

        Taps in ``_spare`` may be lost as long as another one is there: ``_lost`` tells which are.

        Raises:
            InputError: The parameters make none; the node then stays unconfigured.
        """

    @abstractmethod
    def _rest(self) -> None:
        """Lets the controller forget the past; there may be none yet."""

    @abstractmethod
    def _hear_target(self) -> Any:
        """The subscription to targets."""

    def _hear_more(self) -> list[Any]:
        """Subscriptions to what the controller hears besides."""
        return []

    @abstractmethod
    def _forget_target(self) -> None:
        """Lets go of the target that was heard last."""

    @abstractmethod
    def _target_lost(self, now_ns: int) -> tuple[str, str] | None:
        """What is wrong with the target, and the particulars.

        Args:
            now_ns: The present, ns.
        """

    @abstractmethod
    def _asked(self) -> Mapping[str, float] | None:
        """Voltages for the newest readings, by command; None leaves those before."""

    def _known_topics(self) -> tuple[list[topics.Topic], list[topics.Topic]]:
        """Topics of readings and of commands where no rig file says which."""
        heard = topics.usual_tap_topics(self._taps) + topics.usual_encoder_topics(self._encoders)
        return heard, topics.usual_command_topics(self._valves)

    def _afterwards(self) -> None:
        """Does what need not be done before the voltages go out."""

    def _figures(self) -> Mapping[str, object]:
        """More figures for /diagnostics."""
        return {}

    def _about(self) -> str:
        """What is controlled, for /diagnostics."""
        return ""

    # ---- lifecycle -----------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Makes the controller, publishers, subscriptions and diagnostics.

        Args:
            state: Where it comes from.
        """
        if self._diagnostics is None:  # else it has told of a refusal so far
            self._diagnostics = common.Diagnostics(self, self._report)
        try:
            self._rig = load_rig(self._params.rig) if self._params.rig else None
            self._make()
            self._find_topics()
        except InputError as error:
            self._refused = " ".join(str(error).split())
            self.get_logger().error(f"not configured: {self._refused}")
            self._diagnostics.publish()
            return TransitionCallbackReturn.FAILURE
        self._refused = ""
        self._publishers_made = [
            (
                topic,
                self.create_lifecycle_publisher(
                    topics.message_class(topic.type), topic.name, common.COMMAND_QOS
                ),
            )
            for topic in self._command_topics
        ]
        self._subscriptions_made = [
            self.create_subscription(
                topics.message_class(topic.type),
                topic.name,
                functools.partial(self._on_readings, topic),
                qos_profile_sensor_data,
            )
            for topic in self._reading_topics
        ]
        self._subscriptions_made += [self._hear_target(), *self._hear_more()]
        # Created while inactive, so that activation waits for nothing.
        self._timer = self.create_timer(self._period_s, self._tick)
        self._timer.cancel()
        threshold = JumpThreshold(
            min_forward=Duration(seconds=LEAP_S),
            min_backward=Duration(nanoseconds=-1),
            on_clock_change=True,
        )
        self._jump = self.get_clock().create_jump_callback(threshold, post_callback=self._on_jump)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begins to command the valves.

        Args:
            state: Where it comes from.
        """
        self._forget()
        self._clock_seen.clear()
        spare_what_stays()  # a controller is made after the node has said that it is ready
        self._state, self._detail = "waiting", ""
        self._timer.reset()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Commands the safe voltage once, then nothing.

        Args:
            state: Where it comes from.
        """
        self._timer.cancel()
        self._publish(self._safe())
        self._state, self._detail = "inactive", ""
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Gives up publishers and subscriptions.

        Args:
            state: Where it comes from.
        """
        self._close()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Commands the safe voltage where it was active, and gives up everything.

        Args:
            state: Where it comes from.
        """
        if self._state != "inactive":
            self._publish(self._safe())
        self._state, self._detail = "inactive", ""
        if state.label != "unconfigured":
            self._close()
        self._close_diagnostics()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Commands the safe voltage and starts over unconfigured.

        Args:
            state: Where it comes from.
        """
        return self.on_shutdown(state)

    def _close(self) -> None:
        self.destroy_timer(self._timer)
        self._close_diagnostics()
        for subscription in self._subscriptions_made:
            self.destroy_subscription(subscription)
        for _, publisher in self._publishers_made:
            self.destroy_lifecycle_publisher(publisher)
        self._jump.unregister()

    def _close_diagnostics(self) -> None:
        if self._diagnostics is not None:
            self._diagnostics.close()
            self._diagnostics = None

    def _find_topics(self) -> None:
        """Where readings come from and commands go to.

        Raises:
            InputError: The rig has no such tap, encoder or command.
        """
        rig = self._rig
        if rig is None:
            self._reading_topics, self._command_topics = self._known_topics()
            return
        asked: tuple[tuple[str, tuple[str, ...], Mapping[str, Any]], ...] = (
            ("tap", self._taps, rig.taps),
            ("encoder", self._encoders, rig.encoders),
            ("parameter command", self._valves, rig.commands),
        )
        for what, names, known in asked:
            for name in names:
                if name not in known:
                    raise InputError(
                        f"{what}: found {name!r}, rig {rig.name!r} has {', '.join(known) or 'none'}"
                    )
        self._reading_topics = topics.only(topics.tap_topics(rig), self._taps)
        if self._encoders:
            self._reading_topics += topics.only(topics.encoder_topics(rig), self._encoders)
        self._command_topics = topics.only(topics.command_topics(rig), self._valves)

    # ---- callbacks -----------------------------------------------------------------------------

    def _forget(self) -> None:
        """Forgets what belongs to the past, as after a jump of the clock, but not how it ran.

        A clock that leaps again and again would otherwise never be found to run wrong.
        """
        self._rest()
        self._readings: dict[str, Reading] = {}
        self._forget_target()
        self._volts = self._safe()

    def _safe(self) -> dict[str, float]:
        """The safe voltage of every valve."""
        return dict.fromkeys(self._valves, self._params.safe_voltage_v)

    def _now_ns(self) -> int:
        """The clock that ages are told by: steady, or simulated where that is in use."""
        clock = self.get_clock()
        simulated = isinstance(clock, ROSClock) and clock.ros_time_is_active
        return int((clock if simulated else self._steady).now().nanoseconds)

    _steady = common.steady_clock()

    def _on_jump(self, jump: Any) -> None:
        self._jumps += 1
        self._forget()

    def _on_readings(self, topic: topics.Topic, message: Any) -> None:
        header = getattr(message, "header", None)
        if header is not None:
            stamp_ns = common.from_stamp(header.stamp)
        else:  # a type without one says what is now
            stamp_ns = int(self.get_clock().now().nanoseconds)
        for name, value in topic.read(message).items():
            if self.takes_nan or math.isfinite(value):
                self._take_reading(name, value, stamp_ns)

    def _take_reading(self, name: str, value: float, stamp_ns: int) -> None:
        now_ns = self._now_ns()
        before = self._readings.get(name)
        # A sensor that stalls may be repeated on and on; that does not make its reading younger.
        arrival = (
            before.arrival_ns if before is not None and before.stamp_ns == stamp_ns else now_ns
        )
        same = before is not None and before.value == value
        self._readings[name] = Reading(
            stamp_ns,
            value,
            arrival,
            before.changed_ns if before is not None and same else now_ns,
            (int(self.get_clock().now().nanoseconds) - stamp_ns) * 1e-9,
        )

    def _fault(self, now_ns: int) -> tuple[str, str] | None:
        """What keeps it from controlling, and the particulars."""
        rate = self._clock_rate(now_ns)
        if not 1.0 / self._params.clock_factor <= rate <= self._params.clock_factor:
            return NO_CLOCK, f"simulated time passes {rate:.3g} times as fast as real time"
        self._lost = {
            name: wrong
            for name in (*self._taps, *self._encoders)
            if (wrong := self._lost_reading(name, now_ns)) is not None
        }
        for name, wrong in self._lost.items():
            if name not in self._spare or self._lost.keys() >= set(self._taps):
                return wrong
        return self._target_lost(now_ns)

    def _lost_reading(self, name: str, now_ns: int) -> tuple[str, str] | None:
        """What is wrong with a reading, and the particulars."""
        reading = self._readings.get(name)
        if reading is None:
            return NO_READING, f"never heard {self._where(name)}"
        if now_ns - reading.arrival_ns > self._params.sensor_timeout_s * 1e9:
            age = f"for {self._params.sensor_timeout_s:g} s"
            return NO_READING, f"{age} nothing new of {self._where(name)}"
        if not math.isfinite(reading.value):
            return NO_NUMBER, f"found {reading.value} as {self._where(name)}"
        wrong = self._untrue(name, reading, now_ns) if name in self._taps else None
        if wrong is not None:
            return wrong
        if abs(reading.off_s) > self._params.stamp_tolerance_s:
            when = "old" if reading.off_s > 0.0 else "ahead"
            return OLD_READING, f"{abs(reading.off_s):.3g} s {when} as {self._where(name)}"
        return None

    def _untrue(self, tap: str, reading: Reading, now_ns: int) -> tuple[str, str] | None:
        """What is wrong with a pressure, which is never so low, so high, or so still."""
        low_pa, high_pa = self._params.lowest_pa, self._params.highest_pa
        if not low_pa <= reading.value <= high_pa:
            possible = f"possible are {low_pa:g} to {high_pa:g}"
            return NO_PRESSURE, f"{reading.value:g} Pa as {self._where(tap)}, {possible}"
        safe = self._params.safe_voltage_v
        drives = self._state == FROZEN or any(
            abs(volts - safe) > AT_REST_V for volts in self._volts.values()
        )
        still_ns = now_ns - reading.changed_ns
        if self._params.frozen_after_s and drives and still_ns > self._params.frozen_after_s * 1e9:
            return (
                FROZEN,
                f"{reading.value:g} Pa for {self._params.frozen_after_s:g} s as {self._where(tap)}",
            )
        return None

    def _clock_rate(self, now_ns: int) -> float:
        """How much faster the clock of ages runs than the steady one, lately; 1 if not known."""
        steady_ns = int(self._steady.now().nanoseconds)
        seen, window_ns = self._clock_seen, 1e9 * self._params.clock_window_s
        if not seen or steady_ns - seen[-1][0] > window_ns / MOST_SEEN:
            seen.append((steady_ns, now_ns))
        passed_ns = steady_ns - seen[0][0]
        if passed_ns < window_ns:
            return 1.0
        while len(seen) > 1 and steady_ns - seen[1][0] >= window_ns:
            seen.popleft()
        return (now_ns - seen[0][1]) / max(steady_ns - seen[0][0], 1)

    def _where(self, name: str) -> str:
        (topic,) = topics.only(self._reading_topics, {name})
        return f"{name!r} on {self.resolve_topic_name(topic.name)}"

    def _tick(self) -> None:
        try:
            fault = self._fault(self._now_ns())
            if fault is not None:
                self._lose(*fault)
            else:
                self._control()
            for name, volts in self._volts.items():
                if not math.isfinite(volts):
                    self._lose(FAILED, f"it wants {volts} V of {name!r}")
                    break
        except Exception as error:  # nothing ends a node that holds a valve but its own end
            self._forget()
            self._lose(FAILED, f"{type(error).__name__}: {error}")
        self._publish(self._volts)
        try:
            self._afterwards()
        except Exception as error:  # likewise
            self._forget()
            self._lose(FAILED, f"{type(error).__name__}: {error}")

    def end(self) -> None:
        """Says the safe voltage as the last word, at the end of the process."""
        if self._state != "inactive":
            self._publish(self._safe())
            for _, publisher in self._publishers_made:
                publisher.wait_for_all_acked(Duration(seconds=LAST_WORD_S))

    def _lose(self, what: str, detail: str) -> None:
        if self._state != what:
            self._sensor_losses += what in READINGS_LOST
            self._target_losses += what in (NO_TARGET, SHORT_TARGET)
            self._rest()
        if (self._state, self._detail) != (what, detail):
            self.get_logger().warning(
                f"{what}: safe voltage of {self._params.safe_voltage_v:g} V ({detail})"
            )
            self._state, self._detail = what, detail
        self._volts = self._safe()

    def _control(self) -> None:
        if self._state != "tracking":
            self.get_logger().info("tracking")
            self._state, self._detail = "tracking", ""
        asked = self._asked()
        if asked is not None:
            self._volts = dict(asked)

    def _publish(self, volts: Mapping[str, float]) -> None:
        stamp = self.get_clock().now().to_msg()
        for topic, publisher in self._publishers_made:
            publisher.publish(topic.message(volts, stamp))
        self._commands += 1

    def _report(self) -> list[DiagnosticStatus]:
        single = len(self._volts) == 1
        told: dict[str, object] = {
            "voltage (V)" if single else f"voltage {name} (V)": volts
            for name, volts in self._volts.items()
        }
        values: Mapping[str, object] = {
            **told,
            **self._figures(),
            "commands": self._commands,
            "readings lost": self._sensor_losses,
            "targets lost": self._target_losses,
            "jumps of the clock": self._jumps,
        }
        level, text = DiagnosticStatus.OK, self._state
        if self._detail:
            level, text = DiagnosticStatus.WARN, f"{text}: safe voltage ({self._detail})"
        # Reports are timed by the steady clock, control by this one: then no command is sent.
        before_ns, self._reported_ns = self._reported_ns, self._now_ns()
        if self._reported_ns == before_ns and self._state != "inactive":
            level, text = DiagnosticStatus.WARN, "the clock stands still: no commands"
        if self._refused:
            level, text = DiagnosticStatus.ERROR, f"not configured: {self._refused}"
        return [common.status(level, f"{self.get_name()}: control", text, values, self._about())]
