# SPDX-License-Identifier: Apache-2.0
"""What the governor of an arm lets through, and why it does not."""

import contextlib
import math
import socket

import pytest

from pneu_hw_bridge.phantom import servo as servo_module
from pneu_hw_bridge.phantom.device import Frame
from pneu_hw_bridge.phantom.governor import Governor, Limits, State
from pneu_hw_bridge.phantom.servo import Servo
from pneu_hw_bridge.phantom.wire import SAMPLES, samples_of
from pneu_sim.hand.drive import JointCommand
from pneu_sim.hand.settings import JointSettings

pytestmark = pytest.mark.realtime

JOINT = JointSettings(
    motor="m",
    encoder="e",
    torque_limit_n_m=0.5,
    continuous_n_m=0.1,
    velocity_limit_rad_s=10.0,
    lower_rad=-0.5,
    upper_rad=0.5,
    stiffness_n_m_rad=4.0,
    damping_n_m_s_rad=0.1,
)
STEP_S = 5e-4


class Arm:
    """A governor that is told, tick by tick, what an arm and a controller would."""

    def __init__(self, sensor: bool = True, rate: float = 1.0) -> None:
        limits = Limits(
            names=("a", "b"),
            joints=(JOINT, JOINT),
            watchdog_s=0.05,
            device_timeout_s=0.005,
            sensor_timeout_s=0.008,
            needs_sensor=sensor,
            dwell_s=0.2,
        )
        self.governor = Governor(limits)
        self.governor.publishers(1)
        self.governor.enable(True)
        self.now_s = 100.0
        self.rate = rate  # seconds of the device in one of the machine's
        self.counts = [0, 0]
        self.command: list[JointCommand] | None = [JointCommand(effort_n_m=0.2)] * 2
        self.device, self.sensor = True, sensor
        self.refused = ""

    def run(self, seconds: float) -> list[list[float]]:
        out = []
        for _ in range(max(1, round(seconds / STEP_S))):
            self.now_s += STEP_S
            if self.device:
                self.governor.frame(self.counts, "", self.rate * self.now_s, self.now_s)
            if self.sensor:
                self.governor.sensor("", self.now_s)
            if self.command is not None:
                self.refused = self.governor.command(self.command, self.now_s)
            out.append(self.governor.torques(self.now_s))
        return out

    def silent_for(self, seconds: float) -> float:
        """How long torques go on, s."""
        given = [any(t) for t in self.run(seconds)]
        return STEP_S * (max((k for k, on in enumerate(given) if on), default=-1) + 1)


def test_a_torque_passes_and_a_position_is_held_by_a_spring() -> None:
    arm = Arm()
    assert arm.run(0.01)[-1] == [0.2, 0.2]
    arm.counts = [25, 0]  # 0.005 rad
    arm.command = [JointCommand(position_rad=0.05), JointCommand(position_rad=0.0)]
    held = arm.run(0.2)[-1]
    assert held[0] == pytest.approx(4.0 * (0.05 - 0.005), abs=1e-6)
    assert held[1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("silence", "within_s"), [("device", 0.0055), ("sensor", 0.0085), ("command", 0.0505)]
)
def test_torques_end_when_somebody_falls_silent(silence: str, within_s: float) -> None:
    arm = Arm()
    arm.run(0.1)
    setattr(arm, silence, None if silence == "command" else False)
    assert 0.0 < arm.silent_for(0.06) <= within_s
    assert arm.governor.state()[0] is State.HOLDING
    # and they come back by themselves, but not at once
    arm.device, arm.sensor, arm.command = True, True, [JointCommand(effort_n_m=0.1)] * 2
    assert not any(any(t) for t in arm.run(0.15))
    assert any(arm.run(0.2)[-1])


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (JointCommand(effort_n_m=0.51), "found 0.51 N m, allowed are 0.5"),
        (JointCommand(effort_n_m=-3.0), "allowed are 0.5 either way"),
        (JointCommand(position_rad=0.6), "found 0.6 rad, allowed are -0.5 to 0.5"),
        (JointCommand(velocity_rad_s=-11.0), "allowed are 10 either way"),
        (JointCommand(effort_n_m=math.inf), "not finite"),
    ],
)
def test_what_is_beyond_a_limit_ends_torques_at_once(command: JointCommand, says: str) -> None:
    arm = Arm()
    arm.run(0.05)
    arm.command = [JointCommand(effort_n_m=0.1), command]
    assert arm.run(STEP_S) == [[0.0, 0.0]]
    assert says in arm.refused
    assert says in arm.governor.state()[1]


def test_a_spring_that_asks_for_more_is_clamped() -> None:
    arm = Arm()
    arm.counts = [-2000, 0]
    arm.command = [JointCommand(position_rad=0.4), JointCommand()]
    assert arm.run(0.05)[-1][0] == 0.5
    assert arm.governor.counters.clamped > 0


@pytest.mark.parametrize("rate", [1.0, 0.25])
def test_a_motor_that_gets_warm_is_held_to_what_it_stands(rate: float) -> None:
    """By the device's time: an emulated one may go slower than the machine."""
    arm = Arm(rate=rate)
    arm.command = [JointCommand(effort_n_m=0.5), JointCommand(effort_n_m=0.09)]
    given = arm.run(4.0 / rate)
    # 0.1^2 = 0.5^2 (1 - exp(-t / 30 s))
    lasts = rate * STEP_S * sum(t[0] == 0.5 for t in given)
    assert lasts == pytest.approx(-30.0 * math.log(1.0 - 0.04), rel=0.05)
    assert given[-1] == pytest.approx([0.1, 0.09])


@pytest.mark.parametrize(
    ("counts", "says"),
    [
        ([1000, 0], "encoder: a jumped by 0.200 rad"),
        ([0, -900], "encoder: b jumped"),
    ],
)
def test_an_encoder_that_jumps_trips(counts: list[int], says: str) -> None:
    arm = Arm()
    arm.run(0.05)
    arm.counts = counts
    assert arm.run(STEP_S) == [[0.0, 0.0]]
    assert says in arm.governor.tripped
    assert not any(any(t) for t in arm.run(1.0))
    assert arm.governor.reset(arm.now_s) == ""
    arm.governor.enable(True)
    assert any(arm.run(0.01)[-1])


def test_a_joint_beyond_its_range_trips_and_cannot_be_released_there() -> None:
    arm = Arm()
    for k in range(400):
        arm.counts = [round(5000 * 0.61 * k / 399), 0]
        arm.run(STEP_S)
    assert "its range ends at -0.5 and 0.5" in arm.governor.tripped
    assert "still, a is at" in arm.governor.reset(arm.now_s)
    arm.counts = [2500, 0]
    arm.governor.e_stop("")  # what is stopped is not watched less
    arm.now_s += 1.0
    arm.run(0.1)
    assert arm.governor.reset(arm.now_s) == ""


def test_a_joint_that_is_too_fast_trips() -> None:
    arm = Arm()
    for k in range(60):
        arm.counts = [-1500 + k * 40, 0]  # 16 rad/s
        arm.run(STEP_S)
    assert "allowed are 10" in arm.governor.tripped


def test_a_stop_lasts_until_it_is_reset() -> None:
    arm = Arm()
    arm.run(0.05)
    arm.governor.e_stop("somebody")
    assert arm.run(1.0)[-1] == [0.0, 0.0]
    assert arm.governor.state()[0] is State.E_STOP
    assert arm.governor.reset(arm.now_s) == ""
    assert not any(any(t) for t in arm.run(0.5)), "a reset alone moves nothing (ISO 13850)"
    assert "without torque, or for activation" in arm.refused
    given, arm.command = arm.command, [JointCommand(effort_n_m=0.0)] * 2
    arm.run(STEP_S)
    arm.command = given
    assert any(arm.run(0.01)[-1])


def test_two_publishers_are_not_followed() -> None:
    arm = Arm()
    arm.run(0.05)
    arm.governor.publishers(2)
    assert arm.run(STEP_S) == [[0.0, 0.0]]
    assert "2 publishers" in arm.refused


def test_an_arm_without_a_sensor_waits_for_none() -> None:
    assert any(Arm(sensor=False).run(0.05)[-1])


@pytest.mark.parametrize("late", [0, 1, 2, 3])
def test_samples_are_told_whichever_ticks_frames_come_at(late: int) -> None:
    """A device that is slower than the loop: a quarter as many frames as ticks, at any of four."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        ours.setblocking(False)
        theirs.setblocking(False)
        limits = Limits(("a", "b"), (JOINT, JOINT), 0.05, 0.1, 0.1, False, 0.0)
        servo = Servo(theirs, object(), limits, every=2)  # type: ignore[arg-type]
        stamps = []
        for tick in range(80):
            frame = Frame((tick, 0, 0), 1_000_000 * tick, "") if tick % 4 == late else None
            servo.tick(frame)
            with contextlib.suppress(BlockingIOError):
                while message := ours.recv(65536):
                    if message[:1] == SAMPLES:
                        stamps += [joint.device_ns for joint in samples_of(message, 2)[0]]
        assert stamps == [1_000_000 * tick for tick in range(late, 80, 4)]


def test_the_longest_wait_between_ticks_is_reported_once(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        theirs.setblocking(False)
        monkeypatch.setattr(servo_module, "REPORT_S", 1e9)  # the loop sends changes only
        limits = Limits(("a", "b"), (JOINT, JOINT), 0.05, 0.1, 0.1, False, 0.0)
        servo = Servo(theirs, object(), limits, every=1000)  # type: ignore[arg-type]
        for at_s in (100.0, 100.001, 100.009, 100.010):
            monkeypatch.setattr("time.monotonic", lambda at_s=at_s: at_s)
            servo.tick(None)
        assert servo.report(100.010)["longest_s"] == pytest.approx(0.008)
        assert servo.report(100.010)["longest_s"] == 0.0
