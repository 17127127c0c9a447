# SPDX-License-Identifier: Apache-2.0
"""Values of a rig into messages and out of them, for every form a channel may have."""

import math
from pathlib import Path

import pytest
from geometry_msgs.msg import WrenchStamped
from pneu_msgs.msg import ValveCommand
from sensor_msgs.msg import JointState

from pneu_common.errors import InputError
from pneu_sim import topics
from pneu_sim.channels import Channel
from pneu_sim.rig import load_rig

ROOT = Path(__file__).parents[3]
LAB = load_rig(ROOT / "rigs/lab.yaml")


def with_channels(taps=None, commands=None):
    rig = LAB.model_copy(deep=True)
    for name, channel in (taps or {}).items():
        rig.taps[name].channel = channel
    for name, channel in (commands or {}).items():
        rig.commands[name].channel = channel
    return rig


def test_the_lab_rig_has_the_topics_of_the_live_graph():
    (command,) = topics.command_topics(LAB)
    assert (command.name, command.type) == ("valve/command", "pneu_msgs/msg/ValveCommand")
    assert [t.name for t in topics.tap_topics(LAB)] == [f"taps/{n}/pressure" for n in LAB.taps]


def test_without_channels_the_conventions_hold():
    rig = with_channels(dict.fromkeys(LAB.taps), dict.fromkeys(LAB.commands))
    assert topics.command_topics(rig) == topics.command_topics(LAB)
    assert topics.tap_topics(rig) == topics.tap_topics(LAB)


def test_a_valve_command_is_read_by_name_whatever_its_order():
    (topic,) = topics.command_topics(LAB)
    assert topic.read(ValveCommand(name=["x", "voltage"], voltage_v=[1.0, 7.0])) == {"voltage": 7.0}
    assert topic.read(ValveCommand(name=["x"], voltage_v=[1.0])) == {}
    assert topic.read(ValveCommand(voltage_v=[6.0])) == {"voltage": 6.0}
    assert topic.read(ValveCommand()) == {}
    nothing = topic.read(ValveCommand(name=["voltage"], voltage_v=[math.nan]))
    assert math.isnan(nothing["voltage"])


def test_scale_and_offset_are_undone_on_the_way_out():
    gauge = Channel(
        topic="end_bar", field="data", type="std_msgs/Float64", scale=1e5, offset=101325
    )
    rig = with_channels(taps={"end": gauge})
    (topic,) = [t for t in topics.tap_topics(rig) if t.name == "end_bar"]
    message = topic.message({"end": 301325.0})
    assert message.data == pytest.approx(2.0)
    assert topic.read(message) == {"end": pytest.approx(301325.0)}


def test_elements_of_one_message_share_it():
    fields = {n: Channel(topic="joints", field=f"effort[{i}]", type="sensor_msgs/msg/JointState")
              for i, n in ((3, "supply"), (0, "end"))}  # fmt: skip
    rig = with_channels(taps=fields)
    (topic,) = [t for t in topics.tap_topics(rig) if t.name == "joints"]
    message = topic.message({"supply": 6e5, "end": 2e5})
    assert message.effort[0] == 2e5 and message.effort[3] == 6e5
    assert math.isnan(message.effort[1]) and len(message.effort) == 4
    assert topic.read(message) == {"supply": 6e5, "end": 2e5}
    assert topic.read(JointState(effort=[1.0])) == {"end": 1.0}
    assert topic.message({"middle": 1.0}) is None


def test_nested_fields_are_reached():
    channel = Channel(topic="f", field="wrench.force.x", type="geometry_msgs/msg/WrenchStamped")
    rig = with_channels(commands={"voltage": channel})
    (topic,) = topics.command_topics(rig)
    message = topic.message({"voltage": 4.5})
    assert isinstance(message, WrenchStamped) and message.wrench.force.x == 4.5
    assert topic.read(message) == {"voltage": 4.5}


@pytest.mark.parametrize(
    ("channel", "told"),
    [
        (Channel(topic="a", field="x[", type="std_msgs/Float64"), "allowed is a path"),
        (Channel(topic="a", field="x[99999]", type="std_msgs/Float64"), "allowed is a path"),
        (Channel(topic="a", type="Float64"), "package/msg/Name"),
        (Channel(topic="taps/end/pressure", type="std_msgs/Float64"), "it can have one"),
    ],
)
def test_bad_channels_are_refused_in_a_sentence(channel, told):
    with pytest.raises(InputError, match=told):
        topics.tap_topics(with_channels(taps={"middle": channel}))


def test_an_unknown_type_is_refused():
    with pytest.raises(InputError, match="not known"):
        topics.message_class("no_such_package/msg/Thing")


@pytest.mark.parametrize(
    ("recorded", "wanted", "same"),
    [
        ("/lab/taps/end/pressure", "taps/end/pressure", True),
        ("/taps/end/pressure", "taps/end/pressure", True),
        ("/bend/pressure", "end/pressure", False),
        ("/lab/taps/end/pressure", "/taps/end/pressure", False),
        ("/valve/voltage", "/valve/voltage", True),
    ],
)
def test_relative_topics(recorded, wanted, same):
    assert topics.same_topic(recorded, wanted) is same
