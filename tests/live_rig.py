# SPDX-License-Identifier: Apache-2.0
"""For tests of faults: the processes of the launch file one by one, the lab, and what the lab saw.

Times of the valves come from the lab, which notes by the machine's steady clock when they got their
safe voltage; how they are judged: measured.py.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from std_srvs.srv import Trigger
from tests.live_graph import wait_and_see, wait_for
from tests.measured import MachineStalledError, Watch

from pneu_common.errors import InputError
from pneu_graph.bag.reader import BagReader
from pneu_graph.launch.plan import Plan
from pneu_hw_bridge.lab.asking import ask

ROOT = Path(__file__).parent.parent
LAUNCH = ROOT / "ros_ws/src/pneu_bringup/launch/rig.launch.yaml"
PARAMETERS = ROOT / "ros_ws/src/pneu_bringup/config/lab.yaml"
ALMOST_S = 0.02
"""A stall by which the device's watchdog may come before the bridge's."""


def activate_anew(graph, bridge):
    """Deactivates and activates a bridge, which a reset alone does not set in motion."""
    for which in (Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE):
        request = ChangeState.Request(transition=Transition(id=which))
        assert graph.call(ChangeState, f"{bridge}/change_state", request).success


class Processes:
    """Processes that can be killed and started again; what they print is kept in files."""

    def __init__(self, folder):
        self.folder = folder
        self.running = {}
        self.ended = {}

    def start(self, name, command, environment=None):
        """Starts one under a name that is free."""
        assert not self.alive(name), name
        with self.log(name).open("ab") as out:
            self.running[name] = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=out,
                env=environment,
                cwd=ROOT,
                start_new_session=True,
            )

    def log(self, name):
        return self.folder / f"{name}.log"

    def alive(self, name):
        return name in self.running and self.running[name].poll() is None

    def pids(self):
        return {name: p.pid for name, p in self.running.items() if p.poll() is None}

    def signal(self, name, number):
        """Sends a signal; returns steady times before and after."""
        before_s = time.monotonic()
        self.running[name].send_signal(number)
        return before_s, time.monotonic()

    def kill(self, name):
        """Kills without any warning; returns steady times before and after."""
        when = self.signal(name, signal.SIGKILL)
        self.running.pop(name).wait(10.0)
        return when

    def end(self, name):
        """Ends one as by Ctrl-C; returns its exit status, also when it is asked again."""
        if name in self.running:
            process = self.running[name]
            process.send_signal(signal.SIGINT)
            self.ended[name] = process.wait(60.0)
            del self.running[name]
        return self.ended[name]

    def close(self):
        for process in self.running.values():
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait(10.0)

    def complaints(self):
        """Log files with a traceback or more lines than a node in good order writes."""
        found = {}
        for path in self.folder.glob("*.log"):
            text = path.read_text(errors="replace")
            if "Traceback" in text or text.count("\n") > 2000:
                found[path.name] = text[-3000:]
        return found


class LaunchedNodes(Processes):
    """The nodes of the launch file, each with the command line that the launch gives it."""

    def __init__(self, folder, overrides, **arguments):
        super().__init__(folder)
        parameters = folder / "parameters.yaml"
        parameters.write_text(PARAMETERS.read_text() + overrides)
        self._arguments = {"params": str(parameters), **arguments}
        self._plans = 0

    def launch(self, *names, **arguments):
        """Starts some nodes, or all; arguments of the launch may differ from those before."""
        self._plans += 1
        scratch = self.folder / f"plan{self._plans}"
        scratch.mkdir()
        words = {key: str(value) for key, value in {**self._arguments, **arguments}.items()}
        environment = {**os.environ, "PNEU_STATE_DIR": str(self.folder / "state")}
        plan = Plan(LAUNCH, words, environment, scratch)
        for spec in plan.processes:
            (name,) = [w[8:] for w in spec.command if w.startswith("__node:=")]
            if not names or name in names:
                self.start(name, spec.command, spec.environment)


class Lab:
    """The emulated device, which can be killed and started again at the same ports."""

    def __init__(self, processes):
        self._processes = processes
        self._ready = processes.folder / "lab.json"
        self.port = self.control_port = 0

    def start(self):
        self._ready.unlink(missing_ok=True)
        command = [sys.executable, "-m", "pneu_common.cli", "lab", "--rig", "rigs/lab.yaml"]
        command += ["--port", str(self.port), "--control-port", str(self.control_port)]
        command += ["--dx", "0.1", "--allow-slow", "--ready-file", str(self._ready)]
        self._processes.start("lab", command)
        wait_for(lambda: self._ready.is_file() or not self._processes.alive("lab"), 60.0)
        ports = json.loads(self._ready.read_text())
        self.port, self.control_port = ports["modbus_port"], ports["control_port"]

    def ask(self, what, **details):
        return ask(self.control_port, {"do": what, **details})

    def volts(self):
        return self.ask("status")["volts"]["voltage"]

    def reached(self, volts, since_s):
        """When the valves got a voltage after a moment; None if they did not."""
        for change in self.ask("history")["history"]:
            if change["steady_s"] >= since_s and change["volts"]["voltage"] == volts:
                return change["steady_s"]
        return None

    def resting_since(self, status=None):
        """Since when the valves have their safe voltage, and by whom; None if they have not."""
        rest = (status or self.ask("status"))["safe"][-1]
        return None if rest["ended_s"] is not None else (rest["begun_s"], rest["cause"])


class ValveWatch(Watch):
    """Measures how soon the valves are safe after something that is about to happen."""

    def safe(self, begun_s, known_s=None, by=None):
        """Waits for the safe voltage, which must have come in time.

        Args:
            begun_s: Steady time before what happened.
            known_s: Steady time after it, where that is known.
            by: Who must have written it: the bridge (write), or the device (watchdog).
        """
        status = {}

        def rests():
            status.update(self._lab.ask("status"))
            return self._lab.resting_since(status) is not None

        wait_for(rests, 3.0)
        at_s, cause = self._lab.resting_since(status)
        if at_s < begun_s:
            raise MachineStalledError("the valves were at rest before")
        self.judge(at_s, begun_s, known_s)
        if by is not None and cause != by:
            stalled_s = self.stalled_s(begun_s, at_s, known_s)
            text = f"by {cause} and not {by}; the machine stalled for {stalled_s:.3f} s"
            assert stalled_s > ALMOST_S, text
            raise MachineStalledError(text)

    def judge_rests(self, rests, begun_s, end_s):
        """Fails where valves were vented without need, for which the machine is no excuse.

        Args:
            rests: When they were.
            begun_s: Steady time at which the watch began.
            end_s: Steady time at which it ended.
        """
        if rests:
            stalled_s = self.stalled_s(begun_s, end_s)
            text = f"vented {len(rests)} times; the machine stalled for {stalled_s:.3f} s"
            assert stalled_s > ALMOST_S, text
            raise MachineStalledError(text)


# So that the controller itself never commands what is safe to the bridge.
OVERRIDES = """
/lab/pid:
  ros__parameters:
    low_v: 0.5
"""


class HardwareRig:
    """The launch file's nodes with the bridge as backend, the lab, a recorder, and a probe."""

    def __init__(self, folder, graph, domain):
        self.folder, self.graph, self.domain = folder, graph, domain
        self.nodes = LaunchedNodes(folder, OVERRIDES, backend="modbus")
        self.lab = Lab(self.nodes)
        self.bag = folder / "bag"

    def start(self):
        self.graph.mark()
        self.lab.start()
        self.relaunch(record=self.bag)
        self.follows(40.0)
        self.records()

    def relaunch(self, *names, **arguments):
        self.nodes.launch(*names, port=self.lab.port, **arguments)

    def records(self):
        """Waits until there is something in the bag."""
        self.graph.wait_until_told("recorder: bag", "recording", self.graph.mark(), 20.0)
        end = time.monotonic() + 20.0
        while self.recorded(self.bag) < 100:  # looked at seldom: each look reads the whole bag
            assert time.monotonic() < end, "nothing is recorded"
            time.sleep(0.3)

    def recorded(self, bag):
        try:
            return BagReader(bag).metadata.message_count
        except InputError:  # not there yet, or its first bytes are just being written
            return 0

    def follows(self, seconds=6.0):
        """Waits until the controller's commands are in the register, and stay there."""

        def follows():
            return self.lab.resting_since() is None

        wait_for(follows, seconds)
        end = time.monotonic() + seconds
        while wait_and_see(lambda: not follows(), 0.3):
            assert time.monotonic() < end, "the valves are not followed for long"
            wait_for(follows, seconds)

    def recovers(self):
        """Releases a trip, which stays by design, and waits until the valves are followed."""
        status = self.graph.wait_until_told("bridge: safety", "", self.graph.mark())
        if "tripped" in status.message:
            self.reset()
        self.follows()

    def reset(self):
        """Releases an emergency stop or a trip, and activates the bridge anew."""
        answer = self.graph.call(Trigger, "/lab/valve_bridge/reset_e_stop", Trigger.Request())
        assert answer.success, answer.message
        activate_anew(self.graph, "/lab/valve_bridge")

    def watch(self, *others):
        """A watch for which the bridge, the lab, and other processes of the graph have to run."""
        pids = self.nodes.pids()
        return ValveWatch(self.lab, [pids[name] for name in ("valve_bridge", "lab", *others)])

    def stays_undisturbed(self, seconds):
        """Shows that the valves are followed all the time."""
        self.follows()
        watch = self.watch()
        begun_s = time.monotonic()
        time.sleep(seconds)
        end_s = time.monotonic()
        rests = [
            rest
            for rest in self.lab.ask("status")["safe"]
            if begun_s < (rest["ended_s"] or end_s) and rest["begun_s"] < end_s
        ]
        watch.judge_rests(rests, begun_s, end_s)
