# SPDX-License-Identifier: Apache-2.0
"""Commands and samples as a servo process and its node send them; all else is plain values."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from pneu_sim.hand.drive import JointCommand

COMMAND, SAMPLES = b"C", b"S"

_COMMAND = struct.Struct("<B9d")
_SENT = struct.Struct("<d")
_COUNTS = struct.Struct("<HH")
_JOINTS = struct.Struct("<qqd9d")
_WRENCH = struct.Struct("<QqdI6d")


@dataclass(frozen=True)
class JointSample:
    """What was at a tick.

    Attributes:
        device_ns: When, by the device's clock, which tells the time of day; negative where it has
            none.
        host_ns: When the frame was taken, by this machine's clock.
        steady_s: The same by the steady clock.
        position_rad: Of each joint.
        velocity_rad_s: Of each joint.
        effort_n_m: Torque that is given from then on.
    """

    device_ns: int
    host_ns: int
    steady_s: float
    position_rad: tuple[float, ...]
    velocity_rad_s: tuple[float, ...]
    effort_n_m: tuple[float, ...]


@dataclass(frozen=True)
class WrenchSample:
    """A record of the force sensor.

    Attributes:
        sample: Number of the box's sample, without end.
        host_ns: When it was there, by the clock that frames are stamped by.
        steady_s: The same by a clock that is not set.
        status: Status word.
        values: Force, N, and torque, N m.
    """

    sample: int
    host_ns: int
    steady_s: float
    status: int
    values: tuple[float, ...]


def packed_command(command: Sequence[JointCommand], sent_s: float) -> bytes:
    """A command.

    Args:
        command: Of each joint, three at most.
        sent_s: When it was sent, by the steady clock.
    """
    numbers = [x for c in command for x in (c.position_rad, c.velocity_rad_s, c.effort_n_m)]
    numbers += [0.0] * (9 - len(numbers))
    return COMMAND + _COMMAND.pack(len(command), *numbers) + _SENT.pack(sent_s)


def command_of(message: bytes) -> tuple[list[JointCommand], float]:
    """The command of a message, and when it was sent.

    Args:
        message: As packed.
    """
    count, *numbers = _COMMAND.unpack_from(message, 1)
    (sent_s,) = _SENT.unpack_from(message, 1 + _COMMAND.size)
    return [JointCommand(*numbers[3 * k : 3 * k + 3]) for k in range(count)], sent_s


def packed_samples(joints: Sequence[JointSample], wrenches: Sequence[WrenchSample]) -> bytes:
    """Samples.

    Args:
        joints: They.
        wrenches: They.
    """
    parts = [SAMPLES, _COUNTS.pack(len(joints), len(wrenches))]
    for j in joints:
        numbers = [
            x
            for of in (j.position_rad, j.velocity_rad_s, j.effort_n_m)
            for x in (*of, 0.0, 0.0, 0.0)[:3]
        ]
        parts.append(_JOINTS.pack(j.device_ns, j.host_ns, j.steady_s, *numbers))
    for w in wrenches:
        parts.append(_WRENCH.pack(w.sample, w.host_ns, w.steady_s, w.status, *w.values))
    return b"".join(parts)


def samples_of(message: bytes, count: int) -> tuple[list[JointSample], list[WrenchSample]]:
    """The samples of a message.

    Args:
        message: As packed.
        count: Joints of the device.
    """
    n, m = _COUNTS.unpack_from(message, 1)
    at = 1 + _COUNTS.size
    joints, wrenches = [], []
    for _ in range(n):
        device, host, steady, *x = _JOINTS.unpack_from(message, at)
        parts = (tuple(x[0:count]), tuple(x[3 : 3 + count]), tuple(x[6 : 6 + count]))
        joints.append(JointSample(device, host, steady, *parts))
        at += _JOINTS.size
    for _ in range(m):
        sample, host, steady, status, *x = _WRENCH.unpack_from(message, at)
        wrenches.append(WrenchSample(sample, host, steady, status, tuple(x)))
        at += _WRENCH.size
    return joints, wrenches
