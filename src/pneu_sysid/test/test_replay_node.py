# SPDX-License-Identifier: Apache-2.0
"""The replay node on a graph: every sample of a bag, in its order and at its pace."""

import itertools
import time
from pathlib import Path

import numpy as np
import pytest

from tests.graph_fixtures import domain, graph  # isort: skip
from tests.live_graph import wait_for  # isort: skip

from pneu_msgs.msg import TapPressures
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import FluidPressure, JointState
from std_msgs.msg import Float64

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_sim import bag
from pneu_sim.init import TEMPLATES
from pneu_sim.rig import load_rig
from pneu_sim.run import run_from_rest
from pneu_sim.signals import Motion, Signal
from pneu_sysid.nodes.replay import ReplayNode, load_events

pytestmark = pytest.mark.realtime

__all__ = ["domain", "graph"]  # fixtures

RIG = str(Path(__file__).parents[3] / "rigs/rig_a.yaml")
RATE_HZ = 100.0
START_S = 1_700_000_000.0
COUNT = 100


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """One second: taps with level and slope of their own, a command that steps."""
    rig = load_rig(RIG)
    at = np.arange(COUNT)
    time_s = at / RATE_HZ
    taps = {n: Signal(time_s, 2e5 + 1e4 * k + 7.0 * at) for k, n in enumerate(rig.taps)}
    path = tmp_path_factory.mktemp("bags") / "bag"
    bag.write_bag(path, rig, {"voltage": Signal(time_s, 5.0 + at // 50)}, taps, START_S)
    return str(path)


def replay(graph, recorded, **parameters):
    values = {"bag": recorded, "rig": RIG, "start_delay_s": 0.5, **parameters}
    return graph.add(ReplayNode, **values)


def test_all_comes_out_as_it_was_recorded(graph, recorded):
    end = graph.listen(FluidPressure, "/taps/end/pressure", 1000)
    volts = graph.listen(Float64, "/valve/voltage", 1000)
    together = graph.listen(TapPressures, "taps/pressures", 1000)
    clock = graph.listen(Clock, "/clock", 1000)
    began = time.monotonic()
    node = replay(graph, recorded, publish_clock=True)
    wait_for(node.done.done)
    assert time.monotonic() - began > 1.4  # it looked for clocks, waited, played
    wait_for(lambda: len(end) == COUNT and len(volts) == COUNT)
    assert [m.fluid_pressure for m in end] == [2e5 + 3e4 + 7.0 * k for k in range(COUNT)]
    assert [m.data for m in volts] == [5.0 + k // 50 for k in range(COUNT)]
    stamps = [common.from_stamp(m.header.stamp) for m in end]
    assert stamps[0] == START_S * 1e9
    assert {b - a for a, b in itertools.pairwise(stamps)} == {10_000_000}
    assert [list(m.pressure_pa)[3] for m in together] == [m.fluid_pressure for m in end]
    times = [common.from_stamp(m.clock) for m in clock]
    assert times == sorted(times) and set(stamps) <= set(times)
    assert max(b - a for a, b in itertools.pairwise(times)) <= 4_000_000  # clock_rate_hz


@pytest.mark.parametrize("mode", ["all", "commands"])
def test_joints_come_out_as_they_were_recorded(graph, tmp_path, mode):
    file = TEMPLATES / "cylinder.yaml"
    rig = load_rig(file)
    volts = {"voltage": np.repeat([5.0, 10.0], COUNT // 2)}
    seen = run_from_rest(rig, volts, 1 / RATE_HZ)
    time_s = np.arange(COUNT) / RATE_HZ
    motion = Motion(time_s, seen.joints, seen.speeds)
    commands, taps = ({n: Signal(time_s, v) for n, v in of.items()} for of in (volts, seen.taps))
    bag.write_bag(tmp_path / "bag", rig, commands, taps, START_S, motion=motion)
    joints = graph.listen(JointState, "joint_states", 1000)
    volts = graph.listen(Float64, "/valve/voltage", 1000)
    node = replay(
        graph, str(tmp_path / "bag"), rig=str(file), publish_clock=True, mode=mode, rate=4.0
    )
    wait_for(node.done.done)
    wait_for(lambda: len(volts) == COUNT)
    if mode == "commands":
        assert node.count_publishers("joint_states") == 0
        return
    wait_for(lambda: len(joints) == COUNT)
    assert all(list(m.name) == ["load_slide"] for m in joints)
    assert [m.position[0] for m in joints] == seen.joints["load_slide"].tolist()
    assert [m.velocity[0] for m in joints] == seen.speeds["load_slide"].tolist()
    stamps = [common.from_stamp(m.header.stamp) for m in joints]
    assert (stamps[0], stamps[-1] - stamps[0]) == (START_S * 1e9, (COUNT - 1) * 10_000_000)


def test_without_a_clock_stamps_are_of_the_present(graph, recorded):
    end = graph.listen(FluidPressure, "/taps/end/pressure", 1000)
    node = replay(graph, recorded, mode="taps", rate=4.0)
    wait_for(node.done.done)
    wait_for(lambda: len(end) == COUNT)
    stamps = [common.from_stamp(m.header.stamp) for m in end]
    assert abs(stamps[0] - time.time_ns()) < 10e9
    assert {b - a for a, b in itertools.pairwise(stamps)} == {10_000_000}
    assert node.count_publishers("/valve/voltage") == 0


def test_commands_alone(graph, recorded):
    volts = graph.listen(Float64, "/valve/voltage", 1000)
    node = replay(graph, recorded, mode="commands", rate=4.0)
    wait_for(node.done.done)
    wait_for(lambda: len(volts) == COUNT)
    assert node.count_publishers("/taps/end/pressure") == 0


def test_the_rate_is_that_of_the_wall(graph, recorded):
    end = graph.listen(FluidPressure, "/taps/end/pressure", 1000)
    replay(graph, recorded, rate=0.5)
    wait_for(lambda: end)
    began, count = time.monotonic(), len(end)
    time.sleep(1.0)
    assert (len(end) - count) / (time.monotonic() - began) == pytest.approx(50.0, rel=0.1)


def test_a_loop_sets_the_clock_back(graph, recorded):
    clock = graph.listen(Clock, "/clock", 10000)
    replay(graph, recorded, loop=True, publish_clock=True, rate=4.0)

    def set_back():
        times = [common.from_stamp(m.clock) for m in list(clock)]
        return sum(b < a for a, b in itertools.pairwise(times)) >= 2

    wait_for(set_back)


def test_there_is_one_clock(graph, recorded):
    graph.probe.create_publisher(Clock, "/clock", 1)
    with pytest.raises(InputError, match="/clock already has a publisher"):
        replay(graph, recorded)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"bag": ""}, "parameter bag: found nothing"),
        ({"bag": "nowhere"}, "nowhere"),
        ({"mode": "some"}, "allowed are all, taps, commands"),
    ],
)
def test_bad_parameters_are_refused_in_a_sentence(graph, recorded, changed, told):
    with pytest.raises(InputError, match=told):
        replay(graph, recorded, **changed)


def test_events_of_a_real_recording_are_in_order():
    rig = load_rig(Path(__file__).parents[3] / "rigs/rig_a_fitted.yaml")
    events = load_events(rig, Path(__file__).parents[3] / "data/bags/a_healthy_2", "all")
    stamps = [stamp for stamp, _ in events]
    assert stamps == sorted(stamps) and len(stamps) > 1000
