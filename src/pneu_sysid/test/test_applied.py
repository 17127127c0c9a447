# SPDX-License-Identifier: Apache-2.0
"""What a bridge confirms is read in place of what was decided, at the time it took effect."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from pneu_sim.channels import Channel
from pneu_sysid.records import Signal, read_recording

STORE = get_typestore(Stores.ROS2_JAZZY)
FLOAT = "std_msgs/msg/Float64"
COMMAND = {"voltage": Channel(topic="valve/command", applied="valve/applied", type=FLOAT)}
TAP = {"end": Channel(topic="end/pressure", type=FLOAT)}
START_NS, PERIOD_NS = 10**9, 10**7


def bag_of(path: Path, commands: dict[str, list[tuple[float, float]]]) -> Path:
    """A bag of 50 pressures and of commands as (time in periods, volts)."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        events = [("/lab/end/pressure", float(i), 2e5 + i % 3) for i in range(50)]
        events += [(topic, at, volts) for topic, pairs in commands.items() for at, volts in pairs]
        connections = {
            topic: writer.add_connection(topic, FLOAT, typestore=STORE)
            for topic in ["/lab/end/pressure", *commands]
        }
        for topic, at, value in sorted(events, key=lambda event: event[1]):
            data = STORE.serialize_cdr(STORE.types[FLOAT](data=value), FLOAT)
            writer.write(connections[topic], START_NS + round(at * PERIOD_NS), data)
    return path


def volts(path: Path) -> Signal:
    return read_recording(path, commands=COMMAND, pressures=TAP).commands["voltage"]


DECIDED = {"/lab/valve/command": [(0.0, 5.0), (10.0, 9.0)]}


def same(found: Signal, expected: list[tuple[float, float]]) -> None:
    at, values = np.transpose(expected)
    np.testing.assert_array_equal(found.time_s, np.rint(at * PERIOD_NS) / 1e9)
    np.testing.assert_array_equal(found.values, values)


def test_what_was_decided_counts_where_nothing_was_confirmed(tmp_path):
    expected = [(0.0, 5.0), (10.0, 9.0)]
    same(volts(bag_of(tmp_path / "bag", DECIDED)), expected)
    silent = bag_of(tmp_path / "silent", {**DECIDED, "/lab/valve/applied": []})
    same(volts(silent), expected)


def test_what_was_confirmed_counts_from_when_it_took_effect(tmp_path):
    """Changes between two readings keep their own times."""
    applied = [(0.0, 5.0), (12.25, 8.0), (30.0, 8.0), (40.5, 2.0), (40.75, 4.0)]
    found = volts(bag_of(tmp_path / "bag", {**DECIDED, "/lab/valve/applied": applied}))
    same(found, applied)
    at = np.array([12.0, 12.2, 12.3, 40.0, 40.6, 40.8]) * PERIOD_NS / 1e9
    assert found.held(at).tolist() == [5.0, 5.0, 8.0, 8.0, 2.0, 4.0]


def test_a_channel_needs_what_was_decided_too():
    with pytest.raises(ValueError, match="needs a topic, too"):
        Channel(column=1, applied="valve/applied")
