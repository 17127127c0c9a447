# SPDX-License-Identifier: Apache-2.0
"""Faults of whole processes: the launch file's nodes in front of the lab, killed, hung or stopped.

Times are those of the lab: from before the fault to the first safe voltage that the device keeps.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.live_graph import own_domain, running_graph, wait_for  # isort: skip

from pneu_msgs.msg import ValveCommand
from std_srvs.srv import Trigger
from tests.live_rig import LAUNCH, OVERRIDES, PARAMETERS, HardwareRig

from pneu_graph.nodes import common

ROOT = Path(__file__).resolve().parent.parent
COMMANDS = "/lab/valve/command"
SERVICE = "/lab/valve_bridge/e_stop"
LOOK_S = 0.6
PNEU = [sys.executable, "-c", "from pneu_common.entry import main; main()"]


@dataclass(frozen=True)
class ProcessFault:
    """One kind of fault.

    Attributes:
        name: What happens.
        begin: Brings it about.
        mend: Has everything work again.
        within_s: The mark, if it is another one.
    """

    name: str
    begin: Callable[[HardwareRig], Any]
    mend: Callable[[HardwareRig], Any]
    within_s: float | None = None


def bridge_gets(number: int) -> Callable[[HardwareRig], Any]:
    """Sends the bridge a signal.

    Args:
        number: Which.
    """
    return lambda rig: rig.nodes.signal("valve_bridge", number)


def controller_gets(number: int) -> Callable[[HardwareRig], Any]:
    """Sends the controller a signal.

    Args:
        number: Which.
    """
    return lambda rig: rig.nodes.signal("pid", number)


def begin_anew(name: str) -> Callable[[HardwareRig], Any]:
    """Starts a process that has ended; a bridge that was killed waits for somebody to look.

    Args:
        name: Which.
    """

    def mend(rig: HardwareRig) -> None:
        rig.nodes.running.pop(name).wait(10.0)
        since = rig.graph.mark()
        rig.relaunch(name)
        if name == "valve_bridge":
            told = rig.graph.wait_until_told("bridge: safety", "", since, 30.0)
            if "killed" in told.message:
                rig.reset()
        rig.follows(30.0)

    return mend


def goes_on(name: str) -> Callable[[HardwareRig], Any]:
    """Has a process that hangs go on.

    Args:
        name: Which.
    """

    def mend(rig: HardwareRig) -> None:
        rig.nodes.signal(name, signal.SIGCONT)
        rig.follows(30.0)

    return mend


def reset(rig: HardwareRig) -> None:
    """Releases a stop."""
    rig.reset()
    rig.follows(30.0)


def stop_by_service(rig: HardwareRig) -> None:
    """Calls the bridge's service."""
    rig.graph.call(Trigger, SERVICE, Trigger.Request())


def stop_from_a_shell(rig: HardwareRig) -> None:
    """`pneu stop`, from the key on."""
    subprocess.run([*PNEU, "stop", "--local"], capture_output=True, check=False, cwd=ROOT)


def rival(rig: HardwareRig) -> None:
    """A second node that publishes commands."""
    rig.rival = rig.graph.probe.create_publisher(ValveCommand, COMMANDS, common.COMMAND_QOS)


def rival_goes(rig: HardwareRig) -> None:
    """It goes away."""
    rig.graph.probe.destroy_publisher(rig.rival)
    rig.follows(30.0)


FAULTS = [
    ProcessFault("kill -9 of the bridge", bridge_gets(signal.SIGKILL), begin_anew("valve_bridge")),
    ProcessFault("SIGTERM to the bridge", bridge_gets(signal.SIGTERM), begin_anew("valve_bridge")),
    ProcessFault("SIGINT to the bridge", bridge_gets(signal.SIGINT), begin_anew("valve_bridge")),
    ProcessFault("SIGHUP to the bridge", bridge_gets(signal.SIGHUP), begin_anew("valve_bridge")),
    ProcessFault("the bridge hangs", bridge_gets(signal.SIGSTOP), goes_on("valve_bridge")),
    ProcessFault("kill -9 of the controller", controller_gets(signal.SIGKILL), begin_anew("pid")),
    ProcessFault("the controller hangs", controller_gets(signal.SIGSTOP), goes_on("pid")),
    ProcessFault("a second node commands", rival, rival_goes),
    ProcessFault("emergency stop by service", stop_by_service, reset),
    ProcessFault("pneu stop in a shell, from the key on", stop_from_a_shell, reset, within_s=0.3),
]

LAUNCHES: dict[str, Callable[[subprocess.Popen[bytes], int], Any]] = {
    "kill -9 of the launch": lambda launch, bridge: launch.kill(),
    "the launch's terminal is closed": lambda launch, bridge: launch.send_signal(signal.SIGHUP),
    "kill -9 of the bridge of a launch": lambda launch, bridge: os.kill(bridge, signal.SIGKILL),
}
"""What becomes of a whole launch, and of the bridge in it."""


def tries_of(folder: Path, count: int) -> Iterator[tuple[ProcessFault, list[float], str]]:
    """Tries every fault on one running graph.

    Args:
        folder: For files.
        count: How often each is tried.

    Yields:
        The fault, seconds until valves were safe, and what went wrong besides.
    """
    with own_domain() as domain, running_graph() as graph, ExitStack() as at_the_end:
        os.environ["PNEU_RUN_DIR"] = str(folder / "run")
        rig = HardwareRig(folder, graph, domain)
        at_the_end.callback(rig.nodes.close)
        graph.mark()
        rig.lab.start()
        rig.relaunch()
        rig.follows(60.0)
        for fault in FAULTS:
            seconds, wrong = [], ""
            for _ in range(count):
                try:
                    rig.follows(30.0)
                    seconds.append(safe_after(rig.lab, lambda f=fault: f.begin(rig)))
                    fault.mend(rig)
                except (AssertionError, TimeoutError) as error:
                    wrong = str(error) or "not mended in time"
            yield fault, seconds, wrong


def safe_after(lab: Any, begin: Callable[[], Any]) -> float:
    """Seconds from before something until the valves have the safe voltage that they keep.

    Args:
        lab: The device.
        begin: What happens.
    """
    begun_s = time.monotonic()
    begin()
    left_s = begun_s + LOOK_S - time.monotonic()
    time.sleep(max(left_s, 0.05))
    rest = lab.resting_since()
    return float("inf") if rest is None else max(rest[0] - begun_s, 0.0)


def launches(folder: Path, count: int) -> Iterator[tuple[str, list[float], str]]:
    """A whole launch that is killed, or whose terminal is closed, or whose bridge dies.

    Args:
        folder: For files.
        count: How often each is tried.

    Yields:
        What happened, seconds until valves were safe, and what was left running.
    """
    folder.mkdir()
    parameters = folder / "parameters.yaml"
    parameters.write_text(PARAMETERS.read_text() + OVERRIDES)
    with own_domain(), running_graph() as graph, ExitStack() as at_the_end:
        processes = HardwareRig(folder, graph, 0)
        at_the_end.callback(processes.nodes.close)
        processes.lab.start()
        for name, end in LAUNCHES.items():
            seconds, wrong = [], ""
            for k in range(count):
                state = folder / f"{name}{k}"
                environment = {
                    **os.environ,
                    "PNEU_STATE_DIR": str(state),
                    "PNEU_RUN_DIR": str(folder / "run"),
                    "ROS_LOG_DIR": str(folder / "log"),
                }
                words = ["launch", str(LAUNCH), "backend:=modbus", f"params:={parameters}"]
                with (folder / "launch.log").open("ab") as out:
                    launch = subprocess.Popen(
                        [*PNEU, *words, f"port:={processes.lab.port}"],
                        env=environment, stdout=out, stderr=out, start_new_session=True,
                    )  # fmt: skip
                children: list[int] = []
                try:
                    processes.follows(60.0)
                    children = children_of(launch.pid)
                    bridge = next(pid for pid in children if "valve_bridge" in command_of(pid))
                    seconds.append(
                        safe_after(processes.lab, lambda e=end, one=launch, b=bridge: e(one, b))
                    )
                    wait_for(lambda c=children: not any(map(command_of, c)), 10.0)
                except (AssertionError, TimeoutError, StopIteration) as error:
                    left = [command_of(pid)[:60] for pid in children if command_of(pid)]
                    wrong = f"left running: {left}" if left else str(error) or "never followed"
                finally:
                    for pid in (launch.pid, *children):
                        kill(pid)
                    launch.wait(10.0)
            yield name, seconds, wrong


def children_of(pid: int) -> list[int]:
    """The processes that one has started.

    Args:
        pid: Which one.
    """
    found = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        found += [int(word) for word in task.read_text().split()]
    return found


def command_of(pid: int) -> str:
    """The command line of a process; empty where it has ended.

    Args:
        pid: Which one.
    """
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
    except OSError:
        return ""


def kill(pid: int) -> None:
    """Kills a process that may have ended.

    Args:
        pid: Which one.
    """
    try:
        os.kill(pid, signal.SIGKILL)
    except ProcessLookupError:
        return
