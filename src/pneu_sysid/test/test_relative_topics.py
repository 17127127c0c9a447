# SPDX-License-Identifier: Apache-2.0
"""A relative topic of a rig file means the one topic of a bag that ends so."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from pneu_common.errors import InputError
from pneu_sim.channels import Channel
from pneu_sysid.records import read_recording

STORE = get_typestore(Stores.ROS2_JAZZY)
FLOAT = "std_msgs/msg/Float64"
TAP = {"end": Channel(topic="end/pressure", field="data", type=FLOAT)}


def bag_of(path: Path, **level_of: float) -> Path:
    """A bag of constant levels with a little ripple; __ in a name stands for /."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for name, level in level_of.items():
            connection = writer.add_connection(name.replace("__", "/"), FLOAT, typestore=STORE)
            for i in range(50):
                message = STORE.types[FLOAT](data=level + i % 2)
                writer.write(connection, 10**9 + i * 10**7, STORE.serialize_cdr(message, FLOAT))
    return path


def mean(path: Path) -> float:
    recording = read_recording(path, commands={}, pressures=TAP)
    return float(np.mean(recording.pressures["end"].values))


@pytest.mark.parametrize(
    "name", ["__end__pressure", "__lab__end__pressure", "__a__b__end__pressure"]
)
def test_it_is_found_in_any_namespace(tmp_path, name):
    # A name that merely ends in the same letters is another topic.
    bag = bag_of(tmp_path / "bag", **{name: 2e5, "__lab__bend__pressure": 9e5})
    assert mean(bag) == pytest.approx(2e5 + 0.5)


def test_two_that_match_are_refused_by_name(tmp_path):
    bag = bag_of(tmp_path / "bag", __a__end__pressure=2e5, __b__end__pressure=3e5)
    with pytest.raises(InputError, match="/a/end/pressure or /b/end/pressure"):
        mean(bag)


def test_one_that_matches_to_the_letter_wins(tmp_path):
    bag = bag_of(tmp_path / "bag", end__pressure=2e5, __b__end__pressure=3e5)
    assert mean(bag) == pytest.approx(2e5 + 0.5)


def test_an_absolute_topic_is_taken_by_its_word(tmp_path):
    bag = bag_of(tmp_path / "bag", __lab__end__pressure=2e5)
    absolute = {"end": Channel(topic="/end/pressure", field="data", type=FLOAT)}
    with pytest.raises(InputError, match="no topic '/end/pressure' in the bag"):
        read_recording(bag, commands={}, pressures=absolute)
