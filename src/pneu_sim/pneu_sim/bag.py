# SPDX-License-Identifier: Apache-2.0
"""Writing signals of a rig as a rosbag2 MCAP recording, on the topics that the rig file names."""

import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pneu_sim.channels import Channel
from pneu_sim.errors import InputError
from pneu_sim.rig.schema import Rig

FLUID_PRESSURE = "sensor_msgs/msg/FluidPressure"
FLOAT64 = "std_msgs/msg/Float64"
FIELD_OF = {FLUID_PRESSURE: "fluid_pressure", FLOAT64: "data"}
"""Message types that are written, and the field that holds the number."""

FIRST_STAMP_S = 1.0
"""Where recordings without a clock time begin: a stamp of zero would count as absent."""


def write_bag(
    path: str | Path,
    rig: Rig,
    rate_hz: float,
    commands: Mapping[str, ArrayLike],
    pressures: Mapping[str, ArrayLike],
    start_time_s: float = 0.0,
) -> None:
    """Writes a recording, whole or not at all.

    Pressures go out as stamped ``FluidPressure`` and commands as ``Float64``, unless the channel
    names the other type; scale and offset of the channel are undone. NaN samples are left out.

    Args:
        path: Folder of the bag, or a file that ends in ``.mcap``; must not exist yet.
        rig: Rig whose channels say which topics the signals have.
        rate_hz: Sampling rate.
        commands: (T,) volts per command.
        pressures: (T,) absolute pressures per tap, Pa.
        start_time_s: Clock time of the first sample, Unix time.

    Raises:
        InputError: The path exists or cannot be written, or a signal has no topic or a message type
            that is not written.
    """
    path = Path(path)
    if path.exists():
        raise InputError(f"{path}: exists already; a recording is written to a new path")
    signals = [
        _signal(path, f"commands.{name}", rig.commands.get(name), FLOAT64, name, values)
        for name, values in commands.items()
    ] + [
        _signal(path, f"taps.{name}", rig.taps.get(name), FLUID_PRESSURE, name, values)
        for name, values in pressures.items()
    ]
    sizes = {values.size for *_, values in signals}
    if len(sizes) != 1:
        raise InputError(
            f"{path}: signals of one recording are equally long, found {sorted(sizes)}"
        )
    begin_ns = round((start_time_s if start_time_s > 0.0 else FIRST_STAMP_S) * 1e9)
    stamps_ns = begin_ns + np.rint(np.arange(sizes.pop()) * (1e9 / rate_hz)).astype(np.int64)
    aside: Path | None = None
    try:
        aside = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
        name = path.name.removesuffix(".mcap")
        _write(aside / name, signals, stamps_ns)
        written = aside / name
        if path.suffix == ".mcap":
            written = next(written.glob("*.mcap"))
        os.replace(written, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        if aside is not None:
            shutil.rmtree(aside, ignore_errors=True)


def _signal(
    path: Path, where: str, part: Any, usual: str, name: str, values: ArrayLike
) -> tuple[str, str, str, np.ndarray]:
    """Topic, message type, name and raw values of a signal."""
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
    raw = (np.asarray(values, dtype=float) - channel.offset) / channel.scale
    return channel.topic, kind, name, raw


def _write(
    folder: Path, signals: list[tuple[str, str, str, np.ndarray]], stamps_ns: np.ndarray
) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    header = store.types["std_msgs/msg/Header"]
    time = store.types["builtin_interfaces/msg/Time"]
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = [
            writer.add_connection(topic, kind, typestore=store) for topic, kind, *_ in signals
        ]
        for i, stamp in enumerate(stamps_ns.tolist()):
            for connection, (_, kind, name, values) in zip(connections, signals, strict=True):
                value = float(values[i])
                if not np.isfinite(value):
                    continue
                if kind == FLUID_PRESSURE:
                    stamped = header(time(stamp // 10**9, stamp % 10**9), name)
                    message = store.types[kind](stamped, value, 0.0)
                else:
                    message = store.types[kind](value)
                writer.write(connection, stamp, store.serialize_cdr(message, kind))
