# SPDX-License-Identifier: Apache-2.0
"""Decides at every tick which torques may go to the motors; pure, the steady time is passed in.

States, the first that applies wins:

=========  =============================================  =====================================
state      because                                        left by
=========  =============================================  =====================================
E_STOP     somebody called for it                         ``reset``
TRIPPED    a joint is too fast or beyond its range, an    ``reset``, once it is within
           encoder jumps
DISABLED   the bridge is not active                       ``enable``
HOLDING    no fresh command, a command that was refused,  by itself, once nothing was wrong for
           several publishers, device or force sensor     the dwell and a new command has come
           stale or faulty
FOLLOWING  nothing is wrong
=========  =============================================  =====================================

In every state but FOLLOWING torques are zero, at once: the arm is counterbalanced, and gives way.
"""

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from pneu_sim.hand.drive import JointCommand, VelocityFilter, torque_of
from pneu_sim.hand.settings import JointSettings

AFTER_RESET = "waits after a reset for a command without torque, or for activation"

BEYOND_RAD = 0.1
"""Past the end of its range by more, a joint cannot be."""

HOT_S = 30.0
"""Time constant of a motor's heat."""


class State(enum.Enum):
    """What the governor lets through."""

    E_STOP = "e_stop"
    TRIPPED = "tripped"
    DISABLED = "disabled"
    HOLDING = "holding"
    FOLLOWING = "following"


STATES = list(State)


@dataclass(frozen=True)
class Limits:
    """What a governor goes by.

    Attributes:
        names: Of the joints.
        joints: Their limits.
        watchdog_s: Without a new command for so long torques end.
        device_timeout_s: Without a new frame of the device for so long.
        sensor_timeout_s: Without a new record of the force sensor for so long.
        needs_sensor: Whether there is one.
        dwell_s: After anything went wrong commands are followed again once nothing did for so long.
    """

    names: tuple[str, ...]
    joints: tuple[JointSettings, ...]
    watchdog_s: float
    device_timeout_s: float
    sensor_timeout_s: float
    needs_sensor: bool
    dwell_s: float


@dataclass
class Counters:
    """What happened.

    Attributes:
        accepted: Commands taken.
        refused: Commands refused: not finite, beyond a limit, or of the wrong publisher.
        clamped: Ticks at which a torque was clamped to its limit.
        warm: Ticks at which it was clamped to what the motor stands for long.
        watchdog: Times the command watchdog ended following.
        trips: Trips.
        e_stops: Emergency stops.
    """

    accepted: int = 0
    refused: int = 0
    clamped: int = 0
    warm: int = 0
    watchdog: int = 0
    trips: int = 0
    e_stops: int = 0


@dataclass
class Governor:
    """The state machine. Times are seconds of one steady clock that never jumps.

    Attributes:
        limits: What it goes by.
        e_stopped: Why the emergency stop was called for; empty where it was not.
        tripped: Why it tripped; empty where it did not.
        enabled: Whether the bridge is active.
        counters: What happened.
    """

    limits: Limits
    e_stopped: str = ""
    tripped: str = ""
    enabled: bool = False
    counters: Counters = field(default_factory=Counters)

    def __post_init__(self) -> None:
        count = len(self.limits.joints)
        self.velocity = VelocityFilter(count)
        self.position_rad = [math.nan] * count
        self._command: tuple[JointCommand, ...] | None = None
        self._command_s = -math.inf
        self._refused = ""
        self._publishers = 0
        self._wrong_publisher = "nobody publishes commands"
        self._frame_s = self._last_frame_s = -math.inf
        self._last_at_s = -math.inf
        self._device = "no frame yet"
        self._sensor_s = -math.inf
        self._sensor = "no record yet"
        self._followed = False
        self._free_from_s = -math.inf
        self._to_rest = False  # whether after a reset a command without torque is awaited
        self._why = ""
        self._heat = [0.0] * count
        self._heat_s = -math.inf

    # What others tell

    def enable(self, on: bool) -> None:
        """Lets commands through from now on, or none.

        Args:
            on: Which.
        """
        self.enabled = on
        self._to_rest = False
        self._forget()
        if on:
            self._free_from_s = -math.inf

    def e_stop(self, reason: str) -> None:
        """Stops until it is reset.

        Args:
            reason: Who called for it.
        """
        if not self.e_stopped:
            self.counters.e_stops += 1
            self.e_stopped = reason or "called for"
        self._forget()

    def reset(self, now_s: float) -> str:
        """Releases the emergency stop and a trip, where nothing speaks against it.

        That alone moves nothing (ISO 13850, 4.1.4): a controller that went on commanding is
        followed after a command without torque, or after `enable`.

        Args:
            now_s: Now.

        Returns:
            Why not; empty where it was released.
        """
        if self.tripped:
            if now_s - self._frame_s > self.limits.device_timeout_s:
                return "the joints' positions are not known"
            if wrong := self._out_of_range():
                return f"still, {wrong}"
        self._to_rest = self._to_rest or bool(self.e_stopped or self.tripped)
        self.e_stopped = self.tripped = ""
        self._free_from_s = -math.inf
        self._forget()
        return ""

    def publishers(self, count: int, wrong: str = "") -> None:
        """Takes note of who publishes commands.

        Args:
            count: How many.
            wrong: Why they are not followed, whatever their number.
        """
        if count > 1:
            wrong = f"{count} publishers on the command topic, one is allowed"
        elif not count:
            wrong = "nobody publishes commands"
        self._publishers, self._wrong_publisher = count, wrong
        if wrong:
            self._forget()

    def frame(self, counts: Sequence[int], fault: str, at_s: float, now_s: float) -> None:
        """Takes a frame of the device; trips where it says what must not be.

        Args:
            counts: Of its encoders.
            fault: What the device says is wrong.
            at_s: When it was read, by the clock that tells frames apart best.
            now_s: Now.
        """
        late = now_s - self._frame_s > self.limits.device_timeout_s
        self._frame_s, self._device = now_s, fault
        joints = self.limits.joints
        position = [c / j.counts_per_rad for c, j in zip(counts, joints, strict=False)]
        if late:
            self.velocity.forget()
        elif not math.isnan(self.position_rad[0]):
            step_s = max(now_s - self._last_frame_s, at_s - self._last_at_s, 1e-4)
            for name, joint, new, old in zip(
                self.limits.names, joints, position, self.position_rad, strict=True
            ):
                most = 5.0 * joint.velocity_limit_rad_s * step_s + 4.0 / joint.counts_per_rad
                if abs(new - old) > most:
                    self._trip(
                        f"encoder: {name} jumped by {new - old:.3f} rad within"
                        f" {1e3 * step_s:.1f} ms"
                    )
        self._last_frame_s, self._last_at_s = now_s, at_s
        self.position_rad = position
        self.velocity.take(position, at_s)
        if wrong := self._out_of_range():
            self._trip(wrong)

    def sensor(self, fault: str, now_s: float) -> None:
        """Takes note of a record of the force sensor.

        Args:
            fault: What its status word says is wrong; empty where nothing is.
            now_s: Now.
        """
        self._sensor_s, self._sensor = now_s, fault

    def command(self, command: Sequence[JointCommand], sent_s: float) -> str:
        """Takes a command, or refuses it as a whole: torques then end.

        Args:
            command: Of each joint.
            sent_s: When it was sent; the watchdog counts from then on.

        Returns:
            Why it was refused; empty where it was taken.
        """
        if self._wrong_publisher or not self.enabled or self.e_stopped or self.tripped:
            self.counters.refused += 1
            return self._wrong_publisher or self.e_stopped or self.tripped or "not active"
        if wrong := self._impossible(command):
            self.counters.refused += 1
            self._forget()
            self._refused = wrong
            return wrong
        if self._to_rest and any(
            torque_of(*one) != 0.0
            for one in zip(
                self.limits.joints,
                command,
                self.position_rad,
                self.velocity.velocity_rad_s,
                strict=True,
            )
        ):
            self._refused = AFTER_RESET
            return AFTER_RESET
        self._to_rest = False
        self.counters.accepted += 1
        self._refused = ""
        self._command, self._command_s = tuple(command), sent_s
        return ""

    # What it decides

    def reasons(self, now_s: float) -> list[str]:
        """Why commands are held back now, but for latches and not being enabled.

        Args:
            now_s: Now.
        """
        limits, found = self.limits, []
        age_s = now_s - self._frame_s
        if age_s > limits.device_timeout_s:
            found.append(
                "device: no frame yet" if math.isinf(age_s) else f"device: silent for {age_s:.3f} s"
            )
        elif self._device:
            found.append(f"device: {self._device}")
        if limits.needs_sensor:
            age_s = now_s - self._sensor_s
            if age_s > limits.sensor_timeout_s:
                found.append(
                    "force sensor: no record yet"
                    if math.isinf(age_s)
                    else f"force sensor: silent for {age_s:.3f} s"
                )
            elif self._sensor:
                found.append(f"force sensor: {self._sensor}")
        if self._wrong_publisher:
            found.append(self._wrong_publisher)
        elif self._refused:
            found.append(self._refused)
        elif self._command is None:
            found.append("command: none yet")
        elif now_s - self._command_s > limits.watchdog_s:
            found.append(f"command: none for {now_s - self._command_s:.3f} s")
        return found

    def torques(self, now_s: float) -> list[float]:
        """Torques to give now, N m. Called at every tick.

        Args:
            now_s: Now; never before an earlier call.
        """
        joints = self.limits.joints
        zero = [0.0] * len(joints)
        self._cool()
        if self.e_stopped or self.tripped or not self.enabled:
            self._followed = False
            self._why = self.e_stopped or self.tripped or "not active"
            return zero
        wrong = self.reasons(now_s)
        if wrong:
            faults = [w for w in wrong if not w.startswith("command: none yet")]
            if self._followed and self._command is not None:
                self.counters.watchdog += now_s - self._command_s > self.limits.watchdog_s
            if faults and (self._followed or now_s < self._free_from_s):
                self._free_from_s = now_s + self.limits.dwell_s
            if faults:  # what held it back may be gone the next moment; a new command moves it
                self._command = None
            self._followed = False
            self._why = "; ".join(wrong)
            return zero
        if now_s < self._free_from_s:
            self._why = "waits after a fault"
            return zero
        assert self._command is not None
        self._followed, self._why = True, ""
        out = []
        for k, (joint, command) in enumerate(zip(joints, self._command, strict=True)):
            asked = torque_of(joint, command, self.position_rad[k], self.velocity.velocity_rad_s[k])
            most = joint.torque_limit_n_m
            if self._heat[k] > joint.continuous_n_m**2:
                most = joint.continuous_n_m
                self.counters.warm += abs(asked) > most
            elif abs(asked) > most:
                self.counters.clamped += 1
            torque = min(max(asked, -most), most)
            self._heat[k] += torque**2 * self._share
            out.append(torque)
        return out

    def state(self) -> tuple[State, str]:
        """The state that the last call of `torques` found, and why."""
        if self.e_stopped:
            return State.E_STOP, self._why
        if self.tripped:
            return State.TRIPPED, self._why
        if not self.enabled:
            return State.DISABLED, "not active"
        return (State.FOLLOWING, "") if self._followed else (State.HOLDING, self._why)

    def _cool(self) -> None:
        """By the time that frames are of: an emulated plant may go slower than the machine."""
        at_s = self._last_at_s
        known = math.isfinite(self._heat_s)  # there was a frame before
        step_s = min(max(at_s - self._heat_s, 0.0), HOT_S) if known else 0.0
        self._heat_s = at_s
        self._share = step_s / HOT_S
        self._heat = [h * (1.0 - self._share) for h in self._heat]

    def _impossible(self, command: Sequence[JointCommand]) -> str:
        if len(command) != len(self.limits.joints):
            return f"command: found {len(command)} joints, {len(self.limits.joints)} are needed"
        for name, joint, one in zip(self.limits.names, self.limits.joints, command, strict=True):
            if any(math.isinf(x) for x in (one.position_rad, one.velocity_rad_s, one.effort_n_m)):
                return f"command: {name}: found a number that is not finite"
            if abs(one.effort_n_m) > joint.torque_limit_n_m:  # false for NaN
                return (
                    f"command: {name}: found {one.effort_n_m:.4g} N m, allowed are"
                    f" {joint.torque_limit_n_m:g} either way"
                )
            if one.position_rad < joint.lower_rad or one.position_rad > joint.upper_rad:
                return (
                    f"command: {name}: found {one.position_rad:.4g} rad, allowed are"
                    f" {joint.lower_rad:g} to {joint.upper_rad:g}"
                )
            if abs(one.velocity_rad_s) > joint.velocity_limit_rad_s:
                return (
                    f"command: {name}: found {one.velocity_rad_s:.4g} rad/s, allowed are"
                    f" {joint.velocity_limit_rad_s:g} either way"
                )
        return ""

    def _out_of_range(self) -> str:
        limits = self.limits
        for k, (name, joint) in enumerate(zip(limits.names, limits.joints, strict=True)):
            at, speed = self.position_rad[k], self.velocity.velocity_rad_s[k]
            if not joint.lower_rad - BEYOND_RAD <= at <= joint.upper_rad + BEYOND_RAD:
                return (
                    f"{name} is at {at:.3f} rad, its range ends at {joint.lower_rad:g} and"
                    f" {joint.upper_rad:g}"
                )
            if abs(speed) > joint.velocity_limit_rad_s:
                return (
                    f"{name} moves at {speed:.1f} rad/s, allowed are {joint.velocity_limit_rad_s:g}"
                )
        return ""

    def _trip(self, why: str) -> None:
        if not self.tripped:
            self.counters.trips += 1
            self.tripped = why
            self._forget()

    def _forget(self) -> None:
        self._command, self._command_s = None, -math.inf
        self._refused = ""
