# SPDX-License-Identifier: Apache-2.0
"""What the live examples share: an emulated lab behind Modbus, recorded through the bridge.

The lab is a process of its own. Its device samples and takes commands by a clock of its own, which
recording and controller go by; where this machine is busy the device's time waits for it, so that a
recording shows the rig and not the machine.
"""

import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from pneu_hw_bridge.lab.asking import ask
from pneu_runtime import hook

hook.install()  # of the machine's own rclpy, where there is one
import rclpy  # noqa: E402

ROOT = Path(__file__).resolve().parent.parent
PACE = "1"
"""Seconds of device time per second, at most."""
READY_S = 120.0
"""How long the lab may take to be ready; the first time it compiles its kernels."""
END_S = 20.0
"""How long a command may take to end after it was asked to."""
GRAPH_S = 60.0
"""How long the nodes may take to find each other."""
MATCH_S = 0.5
"""For the last of them to be known on both sides."""
LONGEST = 15.0
"""By how much longer than by the device's clock the machine may take for a recording."""


@dataclass(frozen=True)
class Lab:
    """An emulated lab and what runs on it.

    Attributes:
        out: Folder of all that is made.
        rig: Rig file of the plant.
        registers: Register map, with a clock.
        dx_m: Cells of the plant: not those of the model, so that the one is not the other.
        seconds: Length of a recording by the device's clock, s.
        launch: More arguments of the launch file.
        topics: What the graph is whole with: per topic how many publish and how many listen.
    """

    out: Path
    rig: str
    registers: str
    dx_m: float
    seconds: float
    launch: Sequence[str]
    topics: Mapping[str, tuple[int, int]]


def prepare(out: Path) -> Console:
    """Empties the folder of an example, gives it a domain of its own, and returns where to print.

    Args:
        out: The folder.
    """
    os.chdir(ROOT)
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    os.environ.setdefault("ROS_DOMAIN_ID", str(random.randint(1, 100)))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    return Console(width=140) if not sys.stdout.isatty() else Console()


@contextlib.contextmanager
def pneu(*words: str, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A `pneu` command in the background; ended as by Ctrl-C, and for good.

    Args:
        *words: Its arguments.
        log: File for what it prints.
    """
    with log.open("wb") as stream:
        process = subprocess.Popen(
            [sys.executable, "-m", "pneu_common.cli", *words],
            stdout=stream,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            yield process
            process.send_signal(signal.SIGINT)
            process.wait(END_S)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def wait_for(path: Path, process: subprocess.Popen[bytes], log: Path, seconds: float) -> None:
    """Waits for a file that a process writes; its log tells why where it does not.

    Args:
        path: The file.
        process: The process.
        log: What the process printed.
        seconds: How long to wait, s.
    """
    end = time.monotonic() + seconds
    while not path.exists():
        if process.poll() is not None or time.monotonic() > end:
            raise SystemExit(f"{path} did not appear:\n{log.read_text(errors='replace')}")
        time.sleep(0.05)


def wait_for_graph(
    topics: Mapping[str, tuple[int, int]], process: subprocess.Popen[bytes], log: Path
) -> None:
    """Waits until controller, bridge and recorder have found each other.

    Args:
        topics: Per topic how many publish and how many listen, at least.
        process: The launch.
        log: What it printed.
    """
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    node = rclpy.create_node("live", context=context)
    end = time.monotonic() + GRAPH_S
    try:
        while not all(
            node.count_publishers(topic) >= publishers and node.count_subscribers(topic) >= heard
            for topic, (publishers, heard) in topics.items()
        ):
            if process.poll() is not None or time.monotonic() > end:
                raise SystemExit(f"the graph is not whole:\n{log.read_text(errors='replace')}")
            time.sleep(0.05)
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)
    time.sleep(MATCH_S)


def record(lab: Lab, name: str, console: Console, *more: str) -> Path:
    """Runs lab, bridge and controller, and returns the bag.

    Args:
        lab: The lab.
        name: Of the bag.
        console: Where to say what is done.
        *more: Options of the lab, such as those that hide an effect.
    """
    ready, bag, log = lab.out / f"{name}.ready", lab.out / name, lab.out / f"{name}.lab.log"
    words = ["lab", "--rig", lab.rig, *more, "--registers", lab.registers, "--paced", PACE]
    words += ["--standing", "--port", "0", "--dx", f"{lab.dx_m:g}", "--control-port", "0"]
    words += ["--ready-file", str(ready)]
    console.print(f"$ pneu {' '.join(words)}", style="cyan")
    with pneu(*words, log=log) as device:
        wait_for(ready, device, log, READY_S)
        ports = json.loads(ready.read_text())
        words = ["launch", "pneu_bringup", "rig.launch.yaml", "backend:=modbus"]
        words += [f"registers:={lab.registers}", f"port:={ports['modbus_port']}"]
        words += [f"record:={bag}", "use_sim_time:=true", *lab.launch]
        console.print(f"$ pneu {' '.join(words)}", style="cyan")
        launch_log = lab.out / f"{name}.launch.log"
        with pneu(*words, log=launch_log) as launch:
            wait_for(bag, launch, launch_log, 30.0)
            wait_for_graph(lab.topics, launch, launch_log)
            console.print(f"$ pneu lab go --seconds {lab.seconds:g}", style="cyan")
            ask(ports["control_port"], {"do": "go", "seconds": lab.seconds})
            end = time.monotonic() + LONGEST * lab.seconds
            while not ask(ports["control_port"], {"do": "status"})["plant"]["standing"]:
                if launch.poll() is not None or device.poll() is not None:
                    raise SystemExit(launch_log.read_text(errors="replace"))
                if time.monotonic() > end:
                    raise SystemExit(
                        f"{lab.seconds:g} s of the device took more than"
                        f" {LONGEST * lab.seconds:g} s"
                    )
                time.sleep(0.1)
            time.sleep(MATCH_S)  # for the last samples to be written
    return bag


def run(console: Console, *words: str) -> None:
    """Runs a `pneu` command to its end; its failure is ours.

    Args:
        console: Where to say what is done.
        *words: Its arguments.
    """
    console.print(f"$ pneu {' '.join(words)}", style="cyan")
    status = subprocess.run(
        [sys.executable, "-m", "pneu_common.cli", *words], check=False
    ).returncode
    if status:
        raise SystemExit(status)


def shown(parameters: Mapping[str, float]) -> str:
    """Numbers of an effect in words.

    Args:
        parameters: By name.
    """
    return ", ".join(f"{name} {value:.3g}" for name, value in parameters.items())
