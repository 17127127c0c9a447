# SPDX-License-Identifier: Apache-2.0
"""The loop of an arm: a process of its own, so that nothing of the graph ever holds it up.

At every tick: the newest frame of the device, commands, records of the force sensor, the
governor's torques, out. When its node ends, however it ends, the socket between them closes: the
loop gives no torque any more and ends. When this process is killed the device's own watchdog is
left, which lets go within milliseconds.
"""

import contextlib
import gc
import json
import socket
import sys
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from pneu_common.errors import InputError
from pneu_common.garbage import spare_what_stays
from pneu_hw_bridge.child import JSON, LONGEST, packed
from pneu_hw_bridge.phantom.device import Device, DeviceGoneError, Frame
from pneu_hw_bridge.phantom.emulated import EmulatedDevice
from pneu_hw_bridge.phantom.governor import STATES, Governor, Limits
from pneu_hw_bridge.phantom.net_ft import Calibration, NetFt
from pneu_hw_bridge.phantom.openhaptics import LIBRARY, OpenHapticsDevice
from pneu_hw_bridge.phantom.wire import (
    COMMAND,
    JointSample,
    WrenchSample,
    command_of,
    packed_samples,
)
from pneu_hw_bridge.priority import precedence
from pneu_sim.hand.settings import JointSettings

REPORT_S = 0.5
"""How often the node is told how the loop does."""

SPAN = 1 << 32


def device_of(told: str, library: str = LIBRARY) -> Device:
    """The device that is named.

    Args:
        told: ``emulated:SOCKET`` or ``openhaptics:NAME``.
        library: OpenHaptics' library.

    Raises:
        InputError: It is neither.
    """
    kind, _, name = told.partition(":")
    if kind == "emulated" and name:
        return EmulatedDevice(name)
    if kind == "openhaptics":
        return OpenHapticsDevice(name, library)
    raise InputError(f"device: found {told!r}, allowed are emulated:SOCKET and openhaptics:NAME")


class Servo:
    """The loop.

    Attributes:
        governor: What decides.
        device: The device.
        sensor: The force sensor's client.
    """

    def __init__(
        self,
        link: socket.socket,
        device: Device,
        limits: Limits,
        every: int,
        sensor: NetFt | None = None,
        calibration: Calibration | None = None,
    ) -> None:
        """Begins nothing yet.

        Args:
            link: To the node.
            device: The device, opened.
            limits: Of the governor.
            every: Ticks from one sample for the node to the next.
            sensor: The force sensor's client.
            calibration: What its counts mean.
        """
        self.governor = Governor(limits)
        self.device = device
        self.sensor = sensor
        self._calibration = calibration
        self._link = link
        self._every = every
        self._ticks = 0
        self._told_at = -every
        self._dropped = 0
        self._ended = ""
        self._report_s = 0.0
        self._told: tuple[str, str] = ("", "")
        self._joints: list[JointSample] = []
        self._wrenches: list[WrenchSample] = []
        self._records: deque[tuple[int, int, tuple[float, ...]]] = deque(maxlen=1024)
        self._clocked = False
        self._sample: int | None = None
        self._late_s = 0.0
        self._last_s = 0.0

    def tick(self, frame: Frame | None) -> Sequence[float] | None:
        """One tick.

        Args:
            frame: What the device has read since the last one.

        Returns:
            Torques; None where the loop is to end.
        """
        now_s, now_ns = time.monotonic(), time.time_ns()
        governor = self.governor
        if self._ticks:
            self._late_s = max(self._late_s, now_s - self._last_s)
        self._last_s = now_s
        if frame is not None:
            self._clocked = frame.device_ns is not None
            at_s = now_s if frame.device_ns is None else 1e-9 * frame.device_ns
            governor.frame(frame.counts, frame.fault, at_s, now_s)
        # Records that were there a tick ago are no younger than this frame.
        clock_ns = now_ns if frame is None or frame.device_ns is None else frame.device_ns
        self._told_by(clock_ns, now_s if clock_ns == now_ns else 1e-9 * clock_ns, frame is not None)
        if self.sensor is not None:
            self._feel(now_s)
        self._listen(now_s)
        torques = governor.torques(now_s)
        if self._ended:
            return None
        self._ticks += 1
        # Counted from the last one told: a device that is slower than the loop may have its frames
        # at every second tick, and never at those of an even number.
        if frame is not None and self._ticks >= self._told_at + self._every:
            self._told_at = self._ticks
            self._joints.append(
                JointSample(
                    -1 if frame.device_ns is None else frame.device_ns,
                    now_ns,
                    now_s,
                    tuple(governor.position_rad),
                    tuple(governor.velocity.velocity_rad_s),
                    tuple(torques),
                )
            )
        if self._joints or self._wrenches:
            self._send(packed_samples(self._joints, self._wrenches))
            self._joints, self._wrenches = [], []
        state, why = governor.state()
        if (state.value, why.split(" for ")[0]) != self._told or now_s > self._report_s + REPORT_S:
            self._told, self._report_s = (state.value, why.split(" for ")[0]), now_s
            self._send(packed(self.report(now_s)))
        return torques

    def report(self, now_s: float) -> dict[str, Any]:
        """How the loop does, as plain values.

        Args:
            now_s: The steady time.
        """
        state, why = self.governor.state()
        worst, self._late_s = self._late_s, 0.0
        told: dict[str, Any] = {
            "state": STATES.index(state),
            "why": why,
            "e_stop": self.governor.e_stopped,
            "trip": self.governor.tripped,
            "counters": asdict(self.governor.counters),
            "ticks": self._ticks,
            "missed": getattr(self.device, "missed", 0),
            "longest_s": worst,
            "dropped": self._dropped,
            "at_s": now_s,
        }
        if self.sensor is not None:
            told["sensor"] = asdict(self.sensor.received)
            told["sensor_error"] = self.sensor.error
        return told

    def _told_by(self, clock_ns: int, steady_s: float, known: bool) -> None:
        """Hands on the records of the tick before, with the time by the clock that frames have."""
        if known or not self._clocked:
            while self._records:
                sample, status, values = self._records.popleft()
                self._wrenches.append(WrenchSample(sample, clock_ns, steady_s, status, values))

    def _feel(self, now_s: float) -> None:
        assert self.sensor is not None and self._calibration is not None
        by = self._calibration
        for record in self.sensor.poll(now_s):
            self.governor.sensor(record.fault, now_s)
            if self._sample is None:
                self._sample = record.sample
            ahead = (record.sample - self._sample) % SPAN
            if ahead < SPAN // 2:  # else the box began anew
                self._sample += ahead
            else:
                self._sample = record.sample
            c = record.counts
            values = (
                *(x / by.counts_per_n for x in c[:3]),
                *(x / by.counts_per_n_m for x in c[3:]),
            )
            self._records.append((self._sample, record.status, values))

    def _listen(self, now_s: float) -> None:
        while not self._ended:
            try:
                message = self._link.recv(LONGEST)
            except BlockingIOError:
                return
            except OSError as error:
                self._ended = f"the node cannot be heard: {error}"
                return
            if not message:
                self._ended = "the node has ended"
            elif message[:1] == COMMAND:
                command, sent_s = command_of(message)
                self.governor.command(command, min(sent_s, now_s))
            elif message[:1] == JSON:
                self._obey(json.loads(message[1:]), now_s)

    def _obey(self, told: dict[str, Any], now_s: float) -> None:
        governor = self.governor
        if "e_stop" in told:
            governor.e_stop(str(told["e_stop"]))
        if "enable" in told:
            governor.enable(bool(told["enable"]))
        if "publishers" in told:
            governor.publishers(*told["publishers"])
        if "trip" in told:  # of a bridge before this one
            governor.tripped = governor.tripped or str(told["trip"])
        if "reset" in told:
            told["refused"] = governor.reset(now_s)
        if told.get("end"):
            self._ended = "told to"
        if "answer" in told:  # by then torques are what the governor says
            torques = governor.torques(now_s)
            answer = {"answer": told["answer"], "zero": not any(torques)}
            self._send(packed(answer | {"refused": told.get("refused", "")}))

    def _send(self, message: bytes) -> None:
        try:
            self._link.send(message)
        except BlockingIOError:  # the node is busy; what it reads later is newer
            self._dropped += 1
        except OSError as error:
            self._ended = f"the node cannot be told: {error}"


def run(link: socket.socket) -> None:
    """Runs a servo until its node ends or tells it to.

    Args:
        link: To the node, whose first message says what is driven.
    """
    told = json.loads(link.recv(LONGEST)[1:])
    joints = tuple(JointSettings.model_validate(j) for j in told["joints"].values())
    limits = Limits(
        names=tuple(told["joints"]),
        joints=joints,
        watchdog_s=told["watchdog_s"],
        device_timeout_s=told["device_timeout_s"],
        sensor_timeout_s=told["sensor_timeout_s"],
        needs_sensor=told["sensor"] is not None,
        dwell_s=told["dwell_s"],
    )
    device: Device | None = None
    sensor: NetFt | None = None
    calibration: Calibration | None = None
    try:
        device = device_of(told["device"], told["library"])
        if told["sensor"] is not None:
            sensor = NetFt(told["sensor"]["host"], told["sensor"]["port"])
            calibration = Calibration(**told["sensor"]["calibration"])
        device.open()
    except InputError as error:
        link.send(packed({"failed": str(error)}))
        return
    servo = Servo(link, device, limits, told["every"], sensor, calibration)
    link.setblocking(False)
    with contextlib.suppress(OSError):
        link.send(packed({"ready": told["device"]}))
    spare_what_stays()
    gc.disable()  # nothing here goes in circles
    try:
        device.run(servo.tick, told["rate_hz"])
    except DeviceGoneError as error:
        with contextlib.suppress(OSError):
            link.send(packed({"gone": str(error)}))
    finally:
        device.close()
        if sensor is not None:
            sensor.close()


def main() -> None:
    """Runs the servo on the socket whose number is the argument."""
    with precedence(), socket.socket(fileno=int(sys.argv[1])) as link:
        sys.setswitchinterval(1e-4)
        run(link)


if __name__ == "__main__":
    main()
