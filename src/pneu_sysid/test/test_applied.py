# SPDX-License-Identifier: Apache-2.0
"""What a bridge confirms is read in place of what was decided, and by the time it took effect."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from pneu_sim.channels import Channel
from pneu_sysid.records import read_recording

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


def volts(path: Path) -> np.ndarray:
    return read_recording(path, commands=COMMAND, pressures=TAP).commands["voltage"]


DECIDED = {"/lab/valve/command": [(0.0, 5.0), (10.0, 9.0)]}


def test_what_was_decided_counts_where_nothing_was_confirmed(tmp_path):
    expected = np.where(np.arange(50) < 10, 5.0, 9.0)
    np.testing.assert_array_equal(volts(bag_of(tmp_path / "bag", DECIDED)), expected)
    silent = bag_of(tmp_path / "silent", {**DECIDED, "/lab/valve/applied": []})
    np.testing.assert_array_equal(volts(silent), expected)


def test_what_was_confirmed_counts_from_when_it_took_effect(tmp_path):
    """A change between two points of the grid is spread so that its time is kept."""
    applied = [(0.0, 5.0), (12.25, 8.0), (30.0, 8.0), (40.5, 2.0), (40.75, 4.0)]
    found = volts(bag_of(tmp_path / "bag", {**DECIDED, "/lab/valve/applied": applied}))
    expected = np.full(50, 5.0)
    expected[12] = 5.0 + 0.75 * 3.0
    expected[13:] = 8.0
    expected[40] = 0.5 * 8.0 + 0.25 * 2.0 + 0.25 * 4.0
    expected[41:] = 4.0
    np.testing.assert_allclose(found, expected, rtol=1e-7)


def test_a_channel_needs_what_was_decided_too():
    with pytest.raises(ValueError, match="needs a topic, too"):
        Channel(column=1, applied="valve/applied")
