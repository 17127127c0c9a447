# SPDX-License-Identifier: Apache-2.0
"""A plan played on a rig that runs on the graph, and recorded: simulated, emulated or real."""

import signal
import subprocess
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pneu_common.errors import InputError
from pneu_graph.bag.recorder_process import Recorder
from pneu_graph.launch.guard import on_death_of_parent
from pneu_graph.tools.executables import command_of
from pneu_sysid.design.plan import Plan
from pneu_sysid.design.played import UNTIMELY, UntimelyError

BEGIN_S = 30.0
"""So long the recorder may take until it has written something: it hears whatever there is."""
MUCH_LATER = 20.0
"""A plan on a device whose time waits for the machine may take so many times as long ..."""
PATIENCE_S = 120.0
"""... and so much longer, the start of its node included."""
END_S = 20.0
SETTLE_S = 2.0
"""Before a plan begins the safe voltage is commanded so long."""


@dataclass(frozen=True)
class LiveRig:
    """Where a rig runs.

    Attributes:
        namespace: Namespace of its topics.
        sim_time: Whether the graph goes by /clock.
    """

    namespace: str = "lab"
    sim_time: bool = False


def play(
    plan: Plan,
    plan_file: Path,
    rig_file: Path,
    bag: Path,
    where: LiveRig,
    tell: Callable[[str, float], None],
) -> None:
    """Plays a plan by the node `play` and records all that is told meanwhile.

    Args:
        plan: The plan.
        plan_file: Its file.
        rig_file: The rig's, whose channels say on which topics.
        bag: Folder of the bag; it must be new.
        where: Where the rig runs.
        tell: Called with a stage and the fraction done.

    Raises:
        UntimelyError: The plan was broken off for nothing but time.
        InputError: No rig is heard, or the plan was broken off; what was recorded is kept.
    """
    if bag.exists():
        raise InputError(f"{bag}: exists already; each experiment is recorded anew")
    stage = f"playing {plan_file.name}"
    tell(stage, 0.0)
    recorder = Recorder(bag, str(rig_file))
    node = None
    try:
        _await(lambda: bag.exists() or recorder.ended, BEGIN_S)
        if not bag.exists():
            raise InputError(
                f"{bag}: nothing was recorded within {BEGIN_S:g} s; is a rig running on this graph?"
                " `pneu launch pneu_bringup rig.launch.yaml controller:=none` starts one"
            )
        words = [*command_of("pneu_policy", "play"), "--ros-args"]
        words += ["-r", f"__ns:=/{where.namespace.strip('/')}"]
        words += ["-p", f"plan:={plan_file}", "-p", f"rig:={rig_file}"]
        words += ["-p", f"settle_s:={SETTLE_S}"]
        words += ["-p", f"use_sim_time:={str(where.sim_time).lower()}"]
        node = subprocess.Popen(
            words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            text=True, preexec_fn=on_death_of_parent(),
        )  # fmt: skip
        status, said = _followed(node, plan.seconds, lambda f: tell(stage, f))
    finally:
        if node is not None and node.poll() is None:
            node.send_signal(signal.SIGINT)  # its last word is the safe voltage
            try:
                node.wait(END_S)
            except subprocess.TimeoutExpired:
                node.kill()
        there = recorder.end_and_wait()
    if status != 0:
        kept = f"; what was recorded is kept in {bag}" if there else ""
        last = said[-1] if said else f"its node ended with status {status}"
        kind = UntimelyError if status == UNTIMELY else InputError
        raise kind(f"{plan_file}: was not played to the end: {last}{kept}")
    tell(stage, 1.0)


def _await(there: Callable[[], bool], seconds: float) -> bool:
    end = time.monotonic() + seconds
    while not there() and time.monotonic() < end:
        time.sleep(0.05)
    return there()


def _followed(
    node: "subprocess.Popen[str]", seconds: float, tell: Callable[[float], None]
) -> tuple[int, list[str]]:
    """Waits for the node; its exit status and what it said that matters, the last at the end."""
    said: list[str] = []
    begun = time.monotonic()
    longest = SETTLE_S + MUCH_LATER * seconds + PATIENCE_S

    def listen() -> None:
        assert node.stdout is not None
        for line in node.stdout:
            if line.strip():
                said.append(line.strip())

    threading.Thread(target=listen, daemon=True).start()
    while node.poll() is None:
        passed = time.monotonic() - begun
        if passed > longest:
            raise InputError(
                f"the plan of {seconds:g} s was not played within {longest:.0f} s; the last that"
                f" its node said was: {said[-1] if said else 'nothing'}"
            )
        tell(min(passed / (SETTLE_S + seconds), 0.99))
        time.sleep(0.1)
    return int(node.returncode), said
