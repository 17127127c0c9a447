# SPDX-License-Identifier: Apache-2.0
"""Recordings of scenes as bags: joints, wrenches, inertial units, poses, each at its own rate."""

from collections.abc import Iterable
from functools import reduce
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sysid.contacts.read_csv import unit_quaternions
from pneu_sysid.contacts.scene import Loaded
from pneu_sysid.contacts.track import Series, Track
from pneu_sysid.records.bag import Messages, read_messages
from pneu_sysid.records.clock import clock_jumps

Floats = NDArray[np.float64]

JOINT_STATE = "sensor_msgs/msg/JointState"
OF_JOINTS = {
    "jointpos": "position",
    "tendonpos": "position",
    "jointvel": "velocity",
    "tendonvel": "velocity",
}
"""What a ``JointState`` tells of a sensor of the MJCF; of all others, its effort."""
OF_SENSORS: dict[str, dict[str, str]] = {
    "geometry_msgs/msg/WrenchStamped": {"force": "wrench.force", "torque": "wrench.torque"},
    "geometry_msgs/msg/Wrench": {"force": "force", "torque": "torque"},
    "sensor_msgs/msg/Imu": {
        "gyro": "angular_velocity",
        "accelerometer": "linear_acceleration",
        "framequat": "orientation",
    },
    "geometry_msgs/msg/PoseStamped": {
        "framepos": "pose.position",
        "framequat": "pose.orientation",
    },
    "geometry_msgs/msg/Pose": {"framepos": "position", "framequat": "orientation"},
}
"""Where messages of usual types have what a sensor of the MJCF reads."""
PARTS = {1: ("",), 3: ("x", "y", "z"), 4: ("w", "x", "y", "z")}


def read_scene_bag(path: str | Path, loaded: Loaded) -> Track:
    """Reads a bag.

    Args:
        path: rosbag2 folder or bare .mcap file.
        loaded: The scene.

    Raises:
        InputError: The bag is unreadable, or lacks what the scene needs.
    """
    path = Path(path)
    wanted = {}
    for name, settings in loaded.scene.sensors.items():
        if settings.topic is None:
            raise InputError(f"{path}: sensors: {name}: the scene names no topic for it")
        wanted[name] = settings.topic
    for name, control in loaded.scene.controls.items():
        if control.topic is not None:
            wanted[name] = control.topic
    messages, findings = read_messages(path, wanted)
    origin = min(int(m.stamp_ns.min()) for m in messages.values())
    setup = loaded.setup()
    sensors, controls = {}, {}
    for name, settings in loaded.scene.sensors.items():
        told = messages[str(settings.topic)]
        kind = setup.spec.sensor(name).type.name.removeprefix("mjSENS_").lower()
        what = f"{path}: sensors: {name}: topic '{told.topic}' ({told.msgtype})"
        thing = settings.joint or str(setup.spec.sensor(name).objname)
        values = _values(told, kind, settings.field, thing, loaded.widths[name], what)
        time, values = _in_order(told, values, origin, what)
        if loaded.widths[name] == 4:
            values = unit_quaternions(values, what)
        else:
            values = values * settings.unit
        sensors[name] = Series(time, values)
    for name, control in loaded.scene.controls.items():
        if control.topic is None:
            raise InputError(f"{path}: controls: {name}: the scene names no topic for it")
        told = messages[control.topic]
        what = f"{path}: controls: {name}: topic '{told.topic}' ({told.msgtype})"
        thing = control.joint or str(setup.spec.actuator(name).target)
        values = _values(told, "effort", control.field, thing, 1, what)
        time, values = _in_order(told, values, origin, what)
        controls[name] = Series(time, values * control.unit)
    found = tuple(str(finding) for finding in findings)
    return Track(path.name.removesuffix(".mcap"), sensors, controls, found)


def _values(
    told: Messages, kind: str, field: str | None, thing: str, width: int, what: str
) -> Floats:
    """(m, width) what messages say, NaN where they do not."""
    if told.msgtype == JOINT_STATE:
        part = field or OF_JOINTS.get(kind, "effort")
        if part not in ("position", "velocity", "effort"):
            raise InputError(f"{what}: field {part!r}: position, velocity and effort are allowed")
        return _of_joint(told, thing, part, what)
    if field is None:
        known = OF_SENSORS.get(told.msgtype, {})
        if kind not in known:
            raise InputError(
                f"{what}: which of its fields a sensor of type {kind} reads is not known; name it"
                " with field, such as wrench.force"
            )
        field = known[kind]
    rows = np.full((len(told.messages), width), np.nan)
    try:
        for k, message in enumerate(told.messages):
            at = reduce(getattr, field.split("."), message)
            rows[k] = [float(getattr(at, p) if p else at) for p in PARTS[width]]
    except (AttributeError, TypeError):
        parts = ", ".join(p for p in PARTS[width] if p) or "one number"
        raise InputError(f"{what}: field {field!r} is not there, or has not {parts}") from None
    return rows


def _of_joint(told: Messages, joint: str, part: str, what: str) -> Floats:
    rows = np.full((len(told.messages), 1), np.nan)
    names: dict[str, None] = {}
    for k, message in enumerate(told.messages):
        listed = [str(name) for name in message.name]
        names |= dict.fromkeys(listed)
        values = getattr(message, part)
        if joint in listed and (at := listed.index(joint)) < len(values):
            rows[k, 0] = values[at]
    if joint not in names:
        known = ", ".join(map(repr, names)) or "none"
        raise InputError(f"{what}: no joint {joint!r}, it has {known}; joint names another")
    return rows


def _in_order(told: Messages, values: Floats, origin_ns: int, what: str) -> tuple[Floats, Floats]:
    """Times from the bag's first stamp and their values, finite and rising."""
    jumps = [k for k in clock_jumps(told.stamp_ns) if told.stamp_ns[k] < told.stamp_ns[k - 1]]
    if jumps:
        back = _seconds(told.stamp_ns[[jumps[0] - 1, jumps[0]]] - origin_ns)
        raise InputError(
            f"{what}: time runs backwards: message {jumps[0] + 1} is stamped {back[1]:.3f} s, the"
            f" one before it {back[0]:.3f} s"
        )
    good = np.isfinite(values).all(axis=1)
    order = np.argsort(told.stamp_ns[good], kind="stable")
    time = _seconds(told.stamp_ns[good][order] - origin_ns)
    later = np.concatenate([[True], np.diff(time) > 0.0]) if len(time) else good
    if later.sum() < 4:
        raise InputError(f"{what}: has {int(later.sum())} readings, too few")
    return time[later], values[good][order][later]


def _seconds(stamp_ns: Iterable[int]) -> Floats:
    return np.asarray(stamp_ns, dtype=np.float64) * 1e-9
