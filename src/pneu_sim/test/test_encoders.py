# SPDX-License-Identifier: Apache-2.0
"""Encoders: what they make of a joint's position, in the plant, in messages, tables and bags."""

import csv
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import JointState
from typer.testing import CliRunner

from pneu_common.cli import build_app
from pneu_common.errors import InputError
from pneu_sim import topics
from pneu_sim.channels import Channel
from pneu_sim.plant import Plant
from pneu_sim.rig import load_rig
from pneu_sim.rig.encoder import Encoder
from pneu_sim.simulator import Simulator

KOKORO = Path(__file__).parents[3] / "rigs" / "rig_j.yaml"
APART = {"head": 8.0, "rod": 3.0}
STEP_S = 2e-3


def kokoro(**encoders):
    rig = load_rig(KOKORO).model_copy(deep=True)
    rig.encoders = {name: Encoder(**of) for name, of in encoders.items()}
    return rig


def test_an_encoder_shows_the_joint_or_the_piston_with_gain_and_bias_about_zero():
    rig = kokoro(
        plain={"joint": "elbow"},
        off={"joint": "elbow", "gain": 1.1, "bias": -0.02},
        rod_end={"cylinder": "forearm"},
    )
    seen = Simulator(rig).run(0.2, APART, STEP_S)
    assert np.ptp(seen.joints["elbow"]) > 0.3
    np.testing.assert_array_equal(seen.encoders["plain"], seen.joints["elbow"])
    np.testing.assert_allclose(seen.encoders["off"], 1.1 * seen.joints["elbow"] - 0.02, atol=1e-12)
    np.testing.assert_array_equal(seen.encoders["rod_end"], seen.extensions["forearm"])


def test_a_lag_is_that_of_first_order_and_a_late_clock_shows_what_was():
    lag_s, late_s = 0.03, 0.02
    rig = kokoro(
        slow={"joint": "elbow", "lag_s": lag_s}, late={"joint": "elbow", "offset_s": late_s}
    )
    fine_s = 1e-3  # over which positions are linear to a sensor
    seen = Simulator(rig).run(0.4, APART, fine_s)
    true, slow = seen.joints["elbow"], seen.encoders["slow"]
    # lag * d(slow)/dt = true - slow, integrated over each interval
    gained = lag_s * np.diff(slow)
    owed = 0.5 * fine_s * ((true - slow)[1:] + (true - slow)[:-1])
    assert np.max(np.abs(gained - owed)) < 1e-3 * np.max(np.abs(owed)) + 1e-6
    k = round(late_s / fine_s)
    np.testing.assert_allclose(seen.encoders["late"][k:], true[:-k], atol=1e-9)


def test_a_run_cut_anywhere_and_taken_back_reads_the_same():
    rig = kokoro(slow={"joint": "elbow", "lag_s": 0.03}, late={"joint": "elbow", "offset_s": 0.01})
    volts = np.tile(np.array([8.0, 3.0])[None, :, None], (1, 1, 60))
    whole = Plant([rig, rig])
    _, want = whole.advance(volts, STEP_S)
    cut = Plant([rig, rig])
    pieces = [cut.advance(volts[:, :, a:b], STEP_S)[1][1:] for a, b in ((0, 7), (7, 31))]
    kept = cut.state()
    first = cut.advance(volts[:, :, 31:], STEP_S)[1][1:]
    cut.set_state(kept)
    again = cut.advance(volts[:, :, 31:], STEP_S)[1][1:]
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(np.concatenate([*pieces, first]), want[1:])
    assert want.shape[1:] == (len(rig.taps) + 2, 2)


def test_encoders_share_a_joint_state_by_their_names():
    rig = kokoro(elbow={}, other={"joint": "shoulder"})
    (topic,) = topics.encoder_topics(rig)
    assert (topic.name, topic.type) == ("joint_states", "sensor_msgs/msg/JointState")
    message = topic.message({"elbow": 0.3, "other": -0.1})
    assert list(message.name) == ["elbow", "other"] and list(message.position) == [0.3, -0.1]
    assert len(message.velocity) == 0
    assert topic.read(JointState(name=["x", "other"], position=[9.0, 0.2])) == {"other": 0.2}
    assert topic.read(JointState(position=[1.0])) == {}
    assert topics.encoder_channel(rig, "elbow") == Channel(
        topic="/joint_states", field="position", type="sensor_msgs/msg/JointState"
    )


def test_an_encoder_may_be_a_number_in_degrees():
    degrees = Channel(topic="elbow_deg", scale=np.pi / 180.0)
    rig = kokoro(elbow={"channel": degrees})
    (topic,) = topics.encoder_topics(rig)
    assert topic.message({"elbow": np.pi / 4}).data == pytest.approx(45.0)
    assert topics.encoder_channel(rig, "elbow").type == "std_msgs/msg/Float64"


def test_a_field_that_is_no_position_is_refused():
    channel = Channel(topic="joint_states", field="effort", type="sensor_msgs/JointState")
    with pytest.raises(InputError, match="found 'effort', of a JointState an encoder is"):
        topics.encoder_topics(kokoro(elbow={"channel": channel}))


def simulated(output, *options):
    steps = ["--steps", "head=8:0.2", "--steps", "rod=3:0.2"]
    result = CliRunner().invoke(
        build_app(), ["simulate", "--rig", str(KOKORO), *steps, *options, "-o", str(output)]
    )
    assert result.exit_code == 0, result.output


def test_simulate_writes_what_encoders_read_in_place_of_joints(tmp_path):
    simulated(tmp_path / "run.csv")
    with (tmp_path / "run.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert "elbow" in rows[0] and not [name for name in rows[0] if "velocity" in name]
    simulated(tmp_path / "bag")
    with AnyReader([tmp_path / "bag"]) as reader:
        (connection,) = [c for c in reader.connections if c.topic == "/joint_states"]
        told = [
            reader.deserialize(data, connection.msgtype)
            for _, _, data in reader.messages([connection])
        ]
    assert all(list(m.name) == ["elbow"] and not m.velocity.size for m in told)
    read = [float(row["elbow"]) for row in rows]
    np.testing.assert_allclose([m.position[0] for m in told], read, rtol=1e-8, atol=1e-12)
