# SPDX-License-Identifier: Apache-2.0
"""The backend is swapped by one argument: the controller stays the same, and works on each."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from tests.live_graph import own_domain, running_graph, wait_for  # isort: skip

from pneu_msgs.msg import PressureTarget, ValveCommand
from rcl_interfaces.srv import GetParameters, ListParameters
from sensor_msgs.msg import FluidPressure
from std_msgs.msg import Float64, Float64MultiArray

from pneu_common.errors import InputError
from pneu_graph.launch.plan import Plan
from pneu_graph.nodes import common
from pneu_sim.rig import load_rig
from pneu_sysid.records import read_recording

pytestmark = pytest.mark.realtime

ROOT = Path(__file__).parent.parent
LAUNCH = ROOT / "ros_ws/src/pneu_bringup/launch/rig.launch.yaml"
BACKENDS = {"sim": "simulator", "modbus": "valve_bridge", "replay": "replay"}
SAME = ("pid", "target")


def processes(scratch, **arguments):
    """Per node its command line and the contents of its parameter files."""
    scratch.mkdir(exist_ok=True)
    plan = Plan(LAUNCH, arguments, dict(os.environ), scratch)
    found = {}
    for spec in plan.processes:
        words = [
            Path(word).read_text() if Path(word).is_file() and word.endswith(".yaml") else word
            for word in spec.command
        ]
        (name,) = [w.removeprefix("__node:=") for w in spec.command if w.startswith("__node:=")]
        found[name] = words
    return found


def remaps(words):
    return [words[i + 1] for i, word in enumerate(words) if word in ("-r", "--remap")]


def test_the_controller_is_the_same_process_on_every_backend(tmp_path):
    of = {name: processes(tmp_path / name, backend=name, bag="x") for name in BACKENDS}
    for name, own in BACKENDS.items():
        assert sorted(of[name]) == sorted([own, *SAME])
    for node in SAME:
        one, *others = [of[name][node] for name in BACKENDS]
        assert all(words == one for words in others), node
        assert remaps(one) == [f"__node:={node}", "__ns:=/lab"]
    # What remaps there are, the backends have: the replay yields the command topic.
    moved = {name: [r for r in remaps(of[name][own]) if not r.startswith("__")]
             for name, own in BACKENDS.items()}  # fmt: skip
    assert moved == {"sim": [], "modbus": [], "replay": ["valve/command:=recorded/command"]}


def test_simulated_time_reaches_every_node(tmp_path):
    found = processes(tmp_path / "a", use_sim_time="true", watch="true", record="bag")
    assert sorted(found) == ["identify", "pid", "recorder", "simulator", "target"]
    for node, words in found.items():
        assert "use_sim_time: true" in " ".join(words), node


def test_an_unknown_backend_is_refused(tmp_path):
    with pytest.raises(InputError, match="sim, modbus, replay"):
        processes(tmp_path / "a", backend="magic")


@pytest.fixture(scope="module", autouse=True)
def domain():
    with own_domain():
        yield


@contextlib.contextmanager
def process(*words):
    """A `pneu` command that runs meanwhile and is ended as by Ctrl-C."""
    running = subprocess.Popen(
        [sys.executable, "-m", "pneu_common.cli", *words],
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        cwd=ROOT,
    )
    try:
        yield running
        running.send_signal(signal.SIGINT)
        running.wait(25.0)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(running.pid, signal.SIGKILL)
        running.wait()


@pytest.mark.long
def test_a_recording_that_cannot_begin_stops_the_launch(tmp_path):
    """Who asks for one does not want to run without."""
    (tmp_path / "there").mkdir()
    words = ["launch", "pneu_bringup", "rig.launch.yaml", f"record:={tmp_path / 'there'}"]
    done = subprocess.run(
        [sys.executable, "-m", "pneu_common.cli", *words],
        cwd=ROOT, capture_output=True, text=True, timeout=90.0,
    )  # fmt: skip
    assert done.returncode == 1
    assert "exists already; a bag is written to a new path" in done.stdout + done.stderr


def parameters_of(graph, node):
    """All parameters of a running node."""
    names = graph.call(ListParameters, f"{node}/list_parameters", ListParameters.Request())
    request = GetParameters.Request(names=sorted(names.result.names))
    values = graph.call(GetParameters, f"{node}/get_parameters", request).values
    return dict(zip(request.names, map(str, values), strict=True))


OWN = {
    "voltage": {"topic": "daq/setpoint", "type": "std_msgs/msg/Float64", "field": "data"},
    "end": {"topic": "daq/end_bar", "type": "std_msgs/msg/Float64", "field": "data", "scale": 1e5},
    "supply": {"topic": "daq/rest", "type": "std_msgs/msg/Float64MultiArray", "field": "data[1]"},
    "middle": {"topic": "daq/rest", "type": "std_msgs/msg/Float64MultiArray", "field": "data[0]"},
}
"""Channels as a data logger may have them: other topics, types, units, several in one message."""


def rig_with_own_channels(path, channels=OWN):
    document = YAML().load((ROOT / "rigs/lab.yaml").read_text())
    for part in ("commands", "taps"):
        for name, entry in document[part].items():
            if name in channels:
                entry["channel"] = channels[name]
    YAML().dump(document, path)
    return path


@pytest.mark.long
@pytest.mark.parametrize("backend", ["sim", "modbus"])
def test_all_follow_the_channels_of_the_rig_file(tmp_path, backend):
    rig = rig_with_own_channels(tmp_path / "own.yaml")
    ready = tmp_path / "ready"
    lab = ("lab", "--rig", "rigs/lab.yaml", "--dx", "0.1", "--port", "0", "--control-port", "0")
    words = [f"backend:={backend}", f"rig:={rig}"]
    with contextlib.ExitStack() as stack:
        if backend == "modbus":
            stack.enter_context(process(*lab, "--allow-slow", "--ready-file", str(ready)))
            wait_for(ready.is_file, 60.0)
            words.append(f"port:={json.loads(ready.read_text())['modbus_port']}")
        graph = stack.enter_context(running_graph())
        commands = graph.listen(Float64, "/lab/daq/setpoint", common.COMMAND_QOS)
        bars = graph.listen(Float64, "/lab/daq/end_bar")
        rest = graph.listen(Float64MultiArray, "/lab/daq/rest")
        usual = graph.listen(FluidPressure, "/lab/taps/exhaust/pressure")  # has kept its own
        stack.enter_context(process("launch", "pneu_bringup", "rig.launch.yaml", *words))
        wait_for(lambda: len(bars) > 300 and len(commands) > 300, 60.0)
        wait_for(lambda: np.ptp([m.data for m in bars]) > 0.5, 60.0)  # the controller moves it
        wait_for(lambda: min(m.data for m in commands) < 5.0 < 5.1 < max(m.data for m in commands))
        assert all(0.9 < m.data < 7.0 for m in bars)
        middle, supply = np.array([list(m.data) for m in rest]).T
        assert np.median(supply) == pytest.approx(635e3, rel=0.05) and np.ptp(middle) > 3e4
        assert 0.9e5 < np.median([m.fluid_pressure for m in usual]) < 1.5e5
        assert graph.probe.count_publishers("/lab/valve/command") == 0
        assert graph.probe.count_publishers("/lab/taps/end/pressure") == 0


@pytest.mark.long
def test_a_channel_of_another_distribution_is_simulated_recorded_and_read(tmp_path, monkeypatch):
    """A message type that only a folder beside knows; recordings carry what it means."""
    gauge = {
        "topic": "gauges/end",
        "type": "my_msgs/msg/Gauge",
        "field": "bar_gauge",
        "scale": 1e5,
        "offset": 101325.0,
    }
    path = rig_with_own_channels(tmp_path / "own.yaml", {"end": gauge})
    monkeypatch.setenv("PNEU_INTERFACE_PATH", str(ROOT / "examples/my_msgs"))
    bag = tmp_path / "bag"
    words = [f"rig:={path}", f"record:={bag}"]
    with running_graph() as graph:
        commands = graph.listen(ValveCommand, "/lab/valve/command", common.COMMAND_QOS)
        with process("launch", "pneu_bringup", "rig.launch.yaml", *words):
            # its own topic feeds the controller, which else would not open the valve
            wait_for(lambda: sum(m.voltage_v[0] > 5.1 for m in commands) > 200, 60.0)
    monkeypatch.delenv("PNEU_INTERFACE_PATH")
    rig = load_rig(path)
    recording = read_recording(
        bag,
        commands={name: command.channel for name, command in rig.commands.items()},
        pressures={name: tap.channel for name, tap in rig.taps.items()},
    )
    ends, middle = (recording.pressures[tap].values for tap in ("end", "middle"))
    assert ends.size > 500 and np.ptp(ends) > 5e4
    assert np.median(ends) == pytest.approx(np.median(middle), rel=0.1)


def run(graph, seconds, **arguments):
    """Launches a backend; returns the controller's parameters, commands, and tracking errors."""
    commands = graph.listen(ValveCommand, "/lab/valve/command", common.COMMAND_QOS)
    pressures = graph.listen(FluidPressure, "/lab/taps/end/pressure")
    targets = graph.listen(PressureTarget, "/lab/target", common.COMMAND_QOS)
    words = [f"{name}:={value}" for name, value in arguments.items()]
    with process("launch", "pneu_bringup", "rig.launch.yaml", *words):
        wait_for(lambda: len(pressures) > 10 and len(commands) > 10 and targets, 30.0)
        names = {n for n, ns in graph.probe.get_node_names_and_namespaces() if ns == "/lab"}
        parameters = parameters_of(graph, "/lab/pid")
        commands.clear()
        pressures.clear()
        time.sleep(seconds)
        volts = [m.voltage_v[0] for m in commands]
        publishers = graph.probe.count_publishers("/lab/valve/command")
    return names, parameters, volts, [m.fluid_pressure for m in pressures], publishers


@pytest.mark.long
def test_one_launch_file_runs_the_controller_on_all_three(tmp_path):
    seen = {}
    bag = tmp_path / "bag"
    with running_graph() as graph:
        names, seen["sim"], volts, pressures, publishers = run(graph, 4.0, record=bag)
        assert {"simulator", "pid", "target", "recorder"} <= names
        assert publishers == 1 and len(volts) > 300
        assert max(volts) > 5.1 > 4.9 > min(volts)
        assert max(pressures) - min(pressures) > 50e3
    assert (bag / "metadata.yaml").is_file()
    with running_graph() as graph:
        names, seen["replay"], volts, again, publishers = run(graph, 2.0, backend="replay", bag=bag)
        assert {"replay", "pid", "target"} <= names and "simulator" not in names
        assert publishers == 1  # the recorded commands are elsewhere
        assert len(volts) > 150 and max(again) > 105e3
    ready = tmp_path / "ready"
    lab = ("lab", "--rig", "rigs/lab.yaml", "--dx", "0.1", "--port", "0", "--control-port", "0")
    with process(*lab, "--allow-slow", "--ready-file", str(ready)), running_graph() as graph:
        wait_for(ready.is_file, 60.0)
        port = json.loads(ready.read_text())["modbus_port"]
        names, seen["modbus"], volts, pressures, _ = run(graph, 4.0, backend="modbus", port=port)
        assert {"valve_bridge", "pid", "target"} <= names
        assert max(volts) > 5.1 and max(pressures) - min(pressures) > 50e3
    assert seen["sim"] == seen["replay"] == seen["modbus"]
