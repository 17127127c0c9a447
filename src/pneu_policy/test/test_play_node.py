# SPDX-License-Identifier: Apache-2.0
"""The play node: a plan commanded once as it is written; what is wrong breaks it off for good."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.graph_fixtures import domain, graph  # isort: skip
from tests.live_graph import wait_and_see, wait_for  # isort: skip

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from pneu_msgs.msg import ValveCommand
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import FluidPressure

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_policy.nodes import play as play_module
from pneu_policy.nodes.play import PlayNode
from pneu_sim.rig import load_rig, save_rig
from pneu_sysid.design.plan import Bounds, Expected, Plan, Volts
from pneu_sysid.design.played import BROKEN_OFF, UNTIMELY
from pneu_sysid.results.files import write_json

pytestmark = [pytest.mark.realtime, pytest.mark.takes(20)]

__all__ = ["domain", "graph"]  # fixtures

ROOT = Path(__file__).parents[3]
SAFE_V = 5.0


@pytest.fixture
def files(tmp_path):
    """A rig with one tap, and a plan for it of a second and a half in three steps."""
    lab = load_rig(ROOT / "rigs" / "lab.yaml")
    rig = lab.model_copy(update={"taps": {"end": lab.taps["end"]}})
    save_rig(rig, tmp_path / "rig.yaml")
    plan = Plan(
        pneu_version="test",
        rig="lab",
        kind="steps",
        seconds=1.5,
        seed=0,
        commands={"voltage": Volts(time_s=[0.0, 0.5, 1.0], volts=[6.0, 7.0, 4.0])},
        limits=Bounds(
            low_v={"voltage": 0.0}, high_v={"voltage": 10.0}, slew_v_s=2000.0, highest_pa=6e5,
            lowest_pa=0.0,
        ),
        expected=Expected(highest_pa={}, lowest_pa={}, fastest_pa_s={}, air_kg=None),
    )  # fmt: skip
    write_json(tmp_path / "plan.json", plan)
    return {"rig": str(tmp_path / "rig.yaml"), "plan": str(tmp_path / "plan.json")}


class Plant:
    """A tap that is read, and a bridge that tells whether it follows."""

    def __init__(self, graph, timer=True):
        self.readings, self.level = True, None
        self.probe = graph.probe
        self.pressure = self.probe.create_publisher(FluidPressure, "taps/end/pressure", 10)
        self.told = self.probe.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.commands = graph.listen(ValveCommand, "valve/command", common.COMMAND_QOS)
        if timer:
            self.probe.create_timer(0.01, self.tick, clock=common.steady_clock())

    def read(self, stamp):
        message = FluidPressure(fluid_pressure=2e5)
        message.header.stamp = stamp
        self.pressure.publish(message)

    def tick(self):
        if self.readings:
            self.read(self.probe.get_clock().now().to_msg())
        if self.level is not None:
            status = DiagnosticStatus(name="valve_bridge: safety", message="as the test has it")
            status.level = bytes([self.level])
            self.told.publish(DiagnosticArray(status=[status]))

    def volts(self):
        """All that was commanded, without repetitions."""
        volts = [command.voltage_v[0] for command in list(self.commands)]
        return [v for k, v in enumerate(volts) if k == 0 or v != volts[k - 1]]


def play(graph, files, **more):
    return graph.add(PlayNode, autostart=True, settle_s=0.2, rate_hz=100.0, **files, **more)


def test_it_plays_once_and_ends_safe(graph, files):
    node = play(graph, files)
    plant = Plant(graph)
    wait_for(node.done.done)
    assert node.done.result() is True
    wait_for(lambda: plant.volts()[-1] == SAFE_V)
    assert plant.volts() == [SAFE_V, 6.0, 7.0, 4.0, SAFE_V]


def test_it_waits_for_the_bridge(graph, files):
    node = play(graph, files)
    plant = Plant(graph)
    plant.level = 1
    wait_for(lambda: plant.commands)
    wait_and_see(lambda: False, 1.0)
    assert plant.volts() == [SAFE_V]
    plant.level = 0
    wait_for(node.done.done)
    assert node.done.result() is True


def test_a_bridge_that_was_not_heard_yet_may_be_there_all_the_same(graph, files, monkeypatch):
    monkeypatch.setattr(play_module, "patience_s", lambda known_s: 1e9)
    node = play(graph, files)
    plant = Plant(graph)
    wait_for(lambda: plant.commands)
    wait_and_see(lambda: False, 1.0)
    assert plant.volts() == [SAFE_V]
    plant.level = 0
    wait_for(node.done.done)
    assert node.done.result() is True


def test_a_bridge_that_is_heard_late_and_does_not_follow_breaks_it_off(graph, files):
    node = play(graph, files)
    plant = Plant(graph)
    wait_for(lambda: 6.0 in plant.volts())
    plant.level = 1
    wait_for(node.done.done)
    assert (node.done.result(), node.status) == (False, UNTIMELY)
    wait_for(lambda: plant.volts()[-1] == SAFE_V)


def test_it_gives_up_where_it_cannot_begin(graph, files):
    node = play(graph, files, begin_within_s=1.0)
    plant = Plant(graph)
    plant.level = 2
    wait_for(node.done.done)
    assert node.done.result() is False
    assert node.status == BROKEN_OFF
    assert plant.volts() in ([], [SAFE_V])


@pytest.mark.parametrize("what", ["the bridge trips", "a tap falls silent"])
def test_what_is_wrong_breaks_it_off_for_good(graph, files, what):
    node = play(graph, files, sensor_timeout_s=0.5)
    plant = Plant(graph)
    wait_for(lambda: 6.0 in plant.volts())
    if what == "the bridge trips":
        plant.level = 2
    else:
        plant.readings = False
    wait_for(node.done.done)
    assert node.done.result() is False
    assert node.status == (BROKEN_OFF if what == "the bridge trips" else UNTIMELY)
    wait_for(lambda: plant.volts()[-1] == SAFE_V)
    plant.level, plant.readings = 0, True  # all is well again: it does not go on
    assert not wait_and_see(lambda: plant.volts()[-1] != SAFE_V, 1.0)


@pytest.mark.parametrize(("window_s", "played"), [(10.0, True), (0.1, False)])
def test_a_clock_that_stands_still_for_a_moment_is_waited_for(graph, files, window_s, played):
    """The rig of such a clock stands still too; how long a moment is can be told."""
    node = play(graph, files, use_sim_time=True, clock_window_s=window_s)
    plant = Plant(graph, timer=False)
    clock = graph.probe.create_publisher(Clock, "/clock", 10)
    wait_for(lambda: clock.get_subscription_count() and plant.pressure.get_subscription_count())
    ticks, stood = 0, False
    while not node.done.done() and ticks < 5000:
        ticks += 1
        stamp = common.to_stamp(10**11 + ticks * 4_000_000)
        clock.publish(Clock(clock=stamp))
        plant.read(stamp)
        time.sleep(0.004)
        if not stood and 6.0 in plant.volts():
            stood = True
            time.sleep(1.0)
    assert stood
    assert node.done.done() and node.done.result() is played
    if not played:
        assert node.status == UNTIMELY


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"plan": ""}, "parameter plan: found nothing"),
        ({"plan": "nowhere.json"}, "nowhere.json: cannot be read .No such file"),
        ({"rig": ""}, "parameter rig: found nothing"),
        ({"rig": str(ROOT / "rigs" / "kokoro.yaml")}, "is for rig 'lab' with commands voltage"),
    ],
)
def test_what_it_cannot_play_is_refused(graph, files, wrong, words):
    with pytest.raises(InputError, match=words):
        play(graph, {**files, **wrong})


def test_as_a_process_its_status_says_whether_all_was_played(graph, files):
    words = [sys.executable, "-m", "pneu_common.cli", "run", "pneu_policy", "play", "--ros-args"]
    words += ["-p", "settle_s:=0.1", "-p", f"rig:={files['rig']}"]
    plant = Plant(graph)
    assert subprocess.run([*words, "-p", f"plan:={files['plan']}"], timeout=120).returncode == 0
    assert plant.volts()[-1] == SAFE_V
    plan = json.loads(Path(files["plan"]).read_text())
    plan["commands"]["voltage"]["volts"][1] = 99.0
    Path(files["plan"]).write_text(json.dumps(plan))
    done = subprocess.run(
        [*words, "-p", f"plan:={files['plan']}"], timeout=120, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert "commands.voltage: found 4 to 99 V, its limits are 0 to 10" in done.stderr
