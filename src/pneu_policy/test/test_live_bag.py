# SPDX-License-Identifier: Apache-2.0
"""Figures come from a recording: one whose content is known, and ones that must not count."""

import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from pneu_msgs.msg import PressureTarget, ValveCommand
from rclpy.serialization import serialize_message
from sensor_msgs.msg import FluidPressure

from pneu_graph.bag.bag_writer import BagWriter
from pneu_graph.bag.metadata import Topic
from pneu_graph.bag.qos import OfferedQos
from pneu_graph.nodes import common
from pneu_graph.nodes.type_support import definition_text, type_hash
from pneu_policy.judge.metrics import ATM_PA
from pneu_policy.judge.tasks import Tasks
from pneu_policy.live.bag import LateError, track_of

ZERO_NS = 1_700_000_000_000_000_000
TASKS = Tasks(kinds=("smooth",), seeds=(0,), duration_s=3.0, skip_s=0.5)
END_S = 3.3
KINDS = {
    "/lab/taps/end/pressure": "sensor_msgs/msg/FluidPressure",
    "/lab/target": "pneu_msgs/msg/PressureTarget",
    "/lab/valve/command": "pneu_msgs/msg/ValveCommand",
    "/lab/valve/applied": "pneu_msgs/msg/ValveCommand",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}


def target(time_s):
    return 350e3 + 100e3 * math.sin(2.0 * math.pi * max(time_s, 0.0))


def volts(time_s):
    return 5.0 + math.sin(2.0 * math.pi * time_s)


def record(folder, rate_hz=500.0, late_s=0.02, vented=(9.0, 9.0), without="", plans_late=()):
    """A run in which the pressure is the target of a while ago, and the valve is vented once."""
    writer = BagWriter(folder)
    for topic, name in KINDS.items():
        if topic != without:
            offers = [OfferedQos.from_profile(common.COMMAND_QOS)]
            writer.add_topic(Topic(topic, name, type_hash(name), offers), definition_text(name))

    def write(topic, time_s, message):
        at_ns = ZERO_NS + round(time_s * 1e9)
        message.header.stamp = common.to_stamp(at_ns)
        if topic != without:
            writer.write(topic, serialize_message(message), at_ns + 300_000, at_ns)

    for k in range(round(0.5 * rate_hz) * -1, round(END_S * rate_hz)):
        at = k / rate_hz
        message = FluidPressure(fluid_pressure=target(at - late_s))
        write("/lab/taps/end/pressure", at, message)
    for k in range(round(END_S * 100)):
        values = [target(k * 0.01 + 0.01 * ahead) for ahead in range(50)]
        write("/lab/target", k * 0.01, PressureTarget(tap="end", step_s=0.01, pressure_pa=values))
    for k in range(-10, round(END_S * 100)):
        at = k * 0.01
        command = ValveCommand(name=["voltage"], voltage_v=[volts(at)])
        write("/lab/valve/command", at, command)
        held = 0.0 if vented[0] <= at < vented[1] else volts(at)
        write("/lab/valve/applied", at + 0.002, ValveCommand(name=["voltage"], voltage_v=[held]))
    for second, late in enumerate(plans_late):
        told = {"plans": 1000 + 100 * second, "plans late": late}
        values = [KeyValue(key=key, value=str(value)) for key, value in told.items()]
        status = DiagnosticStatus(values=values)
        write("/diagnostics", float(second), DiagnosticArray(status=[status]))
    assert writer.close() == []
    return folder


def test_the_figures_of_a_known_recording(tmp_path):
    found = TASKS.judge(track_of(record(tmp_path / "bag"), "end"))
    assert found.latency_s == pytest.approx(0.02, abs=2e-4)
    # The difference of two sines of amplitude A a while d apart has the amplitude 2 A sin(pi f d).
    amplitude = 2.0 * 100e3 * math.sin(math.pi * 0.02)
    assert found.rmse_atm == pytest.approx(amplitude / math.sqrt(2.0) / ATM_PA, rel=0.01)
    assert found.adjusted_rmse_atm < 0.002
    assert found.effort_v == pytest.approx(math.sqrt(0.5), rel=0.01)


def test_time_begins_with_the_first_target(tmp_path):
    track = track_of(record(tmp_path / "bag"), "end")
    assert track.target_time_s[0] == 0.0
    assert track.time_s[0] == pytest.approx(-0.5, abs=1e-6)
    assert np.interp(1.0, track.time_s, track.pressure_pa) == pytest.approx(target(0.98), abs=10.0)


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ({"vented": (1.0, 1.1)}, r"the valve did not follow the commands for 0\.100 s"),
        ({"rate_hz": 150.0}, "150 readings per second, needed are 200"),
        ({"without": "/lab/valve/applied"}, "0 messages of /lab/valve/applied were recorded"),
    ],
)
def test_a_run_that_shows_another_thing_does_not_count(tmp_path, fault, told):
    with pytest.raises(LateError, match=told):
        track_of(record(tmp_path / "bag", **fault), "end")


def test_a_run_whose_plans_were_late_does_not_count(tmp_path):
    with pytest.raises(LateError, match="12 of 300 plans were not made in time"):
        track_of(record(tmp_path / "late", plans_late=(40, 44, 48, 52)), "end")
    # those of before do not count, nor do a few
    track_of(record(tmp_path / "fine", plans_late=(400, 401, 403, 404)), "end")


def test_a_recording_cut_short_does_not_count(tmp_path):
    bag = record(tmp_path / "bag")
    (file,) = bag.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(LateError, match=r"recorded|recording"):
        track_of(bag, "end")
