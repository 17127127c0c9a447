# SPDX-License-Identifier: Apache-2.0
"""Writing signals of a rig as a rosbag2 MCAP recording, on the topics that the rig file names."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_common.files import scratch_beside
from pneu_sim.channels import Channel
from pneu_sim.rig.schema import Rig
from pneu_sim.signals import Signal

FLUID_PRESSURE = "sensor_msgs/msg/FluidPressure"
FLOAT64 = "std_msgs/msg/Float64"
FIELD_OF = {FLUID_PRESSURE: "fluid_pressure", FLOAT64: "data"}
"""Message types that are written, and the field that holds the number."""

FIRST_STAMP_S = 1.0
"""Where recordings without a clock time begin: a stamp of zero would count as absent."""


def write_bag(
    path: str | Path,
    rig: Rig,
    commands: Mapping[str, Signal],
    pressures: Mapping[str, Signal],
    start_time_s: float = 0.0,
    replace: bool = False,
) -> None:
    """Writes a recording, every signal at its own times, whole or not at all.

    Pressures go out as stamped ``FluidPressure`` and commands as ``Float64``, unless the channel
    names the other type; scale and offset of the channel are undone. NaN samples are left out.

    Args:
        path: Folder of the bag, or a file that ends in ``.mcap``; must not exist yet.
        rig: Rig whose channels say which topics the signals have.
        commands: Volts per command; they may begin before time 0.
        pressures: Absolute pressures per tap, Pa.
        start_time_s: Clock time of time 0, Unix time; where it is 0, the first sample is at
            ``FIRST_STAMP_S`` or later.
        replace: Whether an ``.mcap`` file that exists is replaced.

    Raises:
        InputError: The path exists or cannot be written, or a signal has no topic or a message type
            that is not written.
    """
    path = Path(path)
    if path.exists() and not (replace and path.is_file() and path.suffix == ".mcap"):
        raise InputError(f"{path}: exists already; a recording is written to a new path")
    signals = [
        _signal(path, f"commands.{name}", rig.commands.get(name), FLOAT64, name, signal)
        for name, signal in commands.items()
    ] + [
        _signal(path, f"taps.{name}", rig.taps.get(name), FLUID_PRESSURE, name, signal)
        for name, signal in pressures.items()
    ]
    if not signals:
        raise InputError(f"{path}: found no signal to write, at least one is needed")
    topics = [signal.topic for signal in signals]
    for signal in signals:
        if topics.count(signal.topic) > 1:
            raise InputError(
                f"{path}: {signal.name}: topic {signal.topic!r} is that of another signal of the"
                " rig too; a bag needs one for each"
            )
    everything = (*commands.values(), *pressures.values())
    earliest_s = min((float(signal.time_s[0]) for signal in everything if len(signal)), default=0.0)
    begin_s = start_time_s
    if begin_s + min(earliest_s, 0.0) <= 0.0:
        begin_s = FIRST_STAMP_S - min(earliest_s, 0.0)
    begin_ns = round(begin_s * 1e9)
    with scratch_beside(path) as aside:
        name = path.name.removesuffix(".mcap")
        _write(aside / name, signals, begin_ns)
        written = aside / name
        if path.suffix == ".mcap":
            written = next(written.glob("*.mcap"))
        os.replace(written, path)


@dataclass(frozen=True)
class _Channel:
    """What is written of a signal.

    Attributes:
        topic: Topic.
        kind: Message type.
        name: Name of the command or tap.
        time_ns: (n,) times after the start of the recording, ns.
        raw: (n,) values as the topic carries them.
    """

    topic: str
    kind: str
    name: str
    time_ns: NDArray[np.int64]
    raw: NDArray[np.float64]


def _signal(path: Path, where: str, part: Any, usual: str, name: str, signal: Signal) -> _Channel:
    """A signal as its channel in the rig file wants it written."""
    channel: Channel | None = getattr(part, "channel", None)
    if channel is None or channel.topic is None:
        raise InputError(f"{path}: {where} has no topic in the rig file, which a bag needs")
    kind = channel.type or usual
    if kind.count("/") == 1:
        kind = kind.replace("/", "/msg/")
    if FIELD_OF.get(kind) != channel.field:
        raise InputError(
            f"{path}: {where}: found field {channel.field!r} of {kind}, written are"
            f" {' and '.join(f'{field!r} of {t}' for t, field in FIELD_OF.items())}"
        )
    time_s, values = np.asarray(signal.time_s), np.asarray(signal.values, dtype=float)
    if time_s.shape != values.shape:
        raise InputError(
            f"{path}: {where}: found {time_s.size} times of {values.size} values, one each needed"
        )
    good = np.isfinite(values)
    raw = (values[good] - channel.offset) / channel.scale
    return _Channel(channel.topic, kind, name, np.rint(time_s[good] * 1e9).astype(np.int64), raw)


def _write(folder: Path, channels: list[_Channel], begin_ns: int) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    header = store.types["std_msgs/msg/Header"]
    time = store.types["builtin_interfaces/msg/Time"]
    # In the order of time, as a recorder writes; at one instant commands come before readings.
    time_ns = np.concatenate([channel.time_ns for channel in channels])
    which = np.repeat(np.arange(len(channels)), [channel.raw.size for channel in channels])
    raw = np.concatenate([channel.raw for channel in channels])
    order = np.argsort(time_ns, kind="stable")
    rows = zip(time_ns[order].tolist(), which[order].tolist(), raw[order].tolist(), strict=True)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = [
            writer.add_connection(channel.topic, channel.kind, typestore=store)
            for channel in channels
        ]
        for after_ns, k, value in rows:
            stamp, kind = begin_ns + after_ns, channels[k].kind
            if kind == FLUID_PRESSURE:
                stamped = header(time(stamp // 10**9, stamp % 10**9), channels[k].name)
                message = store.types[kind](stamped, value, 0.0)
            else:
                message = store.types[kind](value)
            writer.write(connections[k], stamp, store.serialize_cdr(message, kind))
