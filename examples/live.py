# SPDX-License-Identifier: Apache-2.0
"""The live path: a lab with a hidden fault, its bridge, a controller, a bag, and what is learned.

The emulated lab is a process of its own behind Modbus TCP. Which effect it hides is drawn by a seed
and sealed in a file, which nothing but the last line of this story opens. The lab's device samples
and takes commands by a clock of its own, which the recording and the controller go by; where this
machine is busy the device's time waits for it, so that a recording shows the rig and not the
machine.

    python examples/live.py [seed]

The exit status is 0 where the effect that was named is the one under the seal.
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
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from pneu_hw_bridge.lab.asking import ask
from pneu_hw_bridge.lab.sealed import open_sealed, seal
from pneu_runtime import hook
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import AttachedEffect

hook.install()  # of the machine's own rclpy, where there is one
import rclpy  # noqa: E402

ROOT = Path(__file__).resolve().parent.parent
OUT = Path("out/live")
RIG = "rigs/lab.yaml"
REGISTERS = "logging_plc"
SECONDS = 8.0
"""Length of a recording by the device's clock."""
PACE = "1"
"""Seconds of device time per second."""
DX_M = "0.035"
"""Cells of the lab: shorter than the model's, so that the one is not the other."""
MOST_HEALTHY_PA = 2500.0
"""Ten times the sensors' noise: an error that hides what could be learned."""
READY_S = 120.0
"""How long the lab may take to be ready; the first time it compiles its kernels."""
END_S = 20.0
"""How long a command may take to end after it was asked to."""
GRAPH_S = 60.0
"""How long the nodes may take to find each other."""
MATCH_S = 0.5
"""For the last of them to be known on both sides."""
LONGEST_S = 120.0
"""How long the machine may take for one recording."""


def hidden(seed: int) -> AttachedEffect:
    """Draws the fault of the lab.

    Args:
        seed: Of the draw.
    """
    rng = np.random.default_rng(seed)
    where = {"position_m": float(rng.uniform(0.4, 1.2))}
    choices = [
        ("leak", "tube", {"area_m2": float(rng.uniform(1.2e-8, 3e-8)), **where}),
        ("sensor_lag", "middle", {"lag_s": float(rng.uniform(0.006, 0.012))}),
        ("valve_delay", "valve", {"delay_s": float(rng.uniform(0.004, 0.008))}),
    ]
    effect, place, parameters = choices[int(rng.integers(len(choices)))]
    return AttachedEffect(effect=effect, place=place, parameters=parameters)


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


def wait_for_graph(process: subprocess.Popen[bytes], log: Path) -> None:
    """Waits until controller, target, bridge and recorder have found each other.

    Args:
        process: The launch.
        log: What it printed.
    """
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    node = rclpy.create_node("live", context=context)
    needed = {"valve/command": (1, 2), "target": (1, 2), "valve/applied": (1, 1)}
    needed |= {f"taps/{tap}/pressure": (1, 1) for tap in load_rig(RIG).taps}
    needed["taps/end/pressure"] = (1, 2)
    topics = {f"/lab/{name}": counts for name, counts in needed.items()} | {"/clock": (1, 2)}
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


def record(name: str, sealed: list[str], console: Console) -> Path:
    """Runs lab, bridge and controller, and returns the bag.

    Args:
        name: Of the bag.
        sealed: Options of the lab that hide an effect.
        console: Where to say what is done.
    """
    ready, bag, log = OUT / f"{name}.ready", OUT / name, OUT / f"{name}.lab.log"
    lab = ["lab", "--rig", RIG, *sealed, "--registers", REGISTERS, "--paced", PACE, "--standing"]
    lab += ["--port", "0", "--dx", DX_M, "--control-port", "0", "--ready-file", str(ready)]
    console.print(f"$ pneu {' '.join(lab)}", style="cyan")
    with pneu(*lab, log=log) as device:
        wait_for(ready, device, log, READY_S)
        ports = json.loads(ready.read_text())
        words = ["launch", "pneu_bringup", "rig.launch.yaml", "backend:=modbus"]
        words += [f"registers:={REGISTERS}", f"port:={ports['modbus_port']}", f"record:={bag}"]
        words += ["use_sim_time:=true"]
        console.print(f"$ pneu {' '.join(words)}", style="cyan")
        launch_log = OUT / f"{name}.launch.log"
        with pneu(*words, log=launch_log) as launch:
            wait_for(bag, launch, launch_log, 30.0)
            wait_for_graph(launch, launch_log)
            go = {"do": "go", "seconds": SECONDS}
            console.print(f"$ pneu lab go --seconds {SECONDS:g}", style="cyan")
            ask(ports["control_port"], go)
            end = time.monotonic() + LONGEST_S
            while not ask(ports["control_port"], {"do": "status"})["plant"]["standing"]:
                if launch.poll() is not None or device.poll() is not None:
                    raise SystemExit(launch_log.read_text(errors="replace"))
                if time.monotonic() > end:
                    raise SystemExit(f"{SECONDS:g} s of the device took more than {LONGEST_S:g} s")
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


def check(console: Console, model: str) -> None:
    """Says so where the model does not explain a healthy lab.

    Args:
        console: Where to say it.
        model: The calibrated rig file.
    """
    calibration = load_rig(model).calibration
    assert calibration is not None
    worst_pa = max(calibration.rmse_pa.values())
    if worst_pa > MOST_HEALTHY_PA:
        console.print(
            f"[yellow]The model leaves {worst_pa:.0f} Pa of a healthy lab, more than"
            f" {MOST_HEALTHY_PA:.0f} Pa. What is learned below may be wrong.[/yellow]"
        )


def shown(parameters: dict[str, float]) -> str:
    """Numbers of an effect in words.

    Args:
        parameters: By name.
    """
    return ", ".join(f"{name} {value:.3g}" for name, value in parameters.items())


def judge(console: Console, sealed: AttachedEffect) -> bool:
    """Shows the errors before and after, and what was named beside what was hidden.

    Args:
        console: Where to show it.
        sealed: What was hidden.

    Returns:
        Whether the one is the other.
    """
    learned = json.loads((OUT / "learned" / "learn.json").read_text())
    steps = learned["steps"]
    table = Table(title="error on the part kept aside, Pa (the sensors' noise is 250)")
    table.add_column("tap")
    for step in steps:
        name = f"+ {step['added']} at {step['place']}" if step["added"] else "calibrated model"
        table.add_column(name, justify="right")
    for tap in learned["taps"]:
        errors = [step["held_out_rmse_pa"].get(tap) for step in steps]
        table.add_row(tap, *("" if error is None else f"{error:.0f}" for error in errors))
    console.print(table)
    named = [(step["added"], step["place"]) for step in steps if step["added"]]
    # The place may carry how far along the pipe it is, which is shown but not asked for.
    right = [(effect, place.split(":")[0]) for effect, place in named[:1]] == [
        (sealed.effect, sealed.place)
    ]
    console.print(
        f"[bold]Under the seal: {sealed.effect} at {sealed.place} ({shown(sealed.parameters)})."
        "[/bold]"
    )
    first, *others = [f"{effect} at {place}" for effect, place in named] or ["nothing"]
    verdict = "Named rightly" if right else f"Not named: found was {first}"
    more = f"; beside it was added {', '.join(others)}" if others else ""
    console.print(f"[bold {'green' if right else 'red'}]{verdict}{more}.[/]")
    return right


def main() -> int:
    """Runs the story; returns the exit status."""
    os.chdir(ROOT)
    console = Console(width=140) if not sys.stdout.isatty() else Console()
    if len(sys.argv) > 1 and not sys.argv[1].isdigit():
        sys.exit(f"seed: found {sys.argv[1]!r}, a whole number is needed")
    seed = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    began = time.monotonic()
    shutil.rmtree(OUT, ignore_errors=True)
    OUT.mkdir(parents=True)
    os.environ.setdefault("ROS_DOMAIN_ID", str(random.randint(1, 100)))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    seal([hidden(seed)], OUT / "hidden.sealed")
    model = str(OUT / "calibrated.yaml")
    console.rule()
    console.print(
        "[bold]A healthy lab, to calibrate the model's delay from the device to the valve.[/bold]"
    )
    healthy = record("healthy", [], console)
    run(console, "fit", str(healthy), "--rig", RIG, "-o", model)
    check(console, model)
    console.rule()
    console.print("[bold]A lab with a fault that nobody is told, and a controller on it.[/bold]")
    bag = record("faulty", ["--sealed", str(OUT / "hidden.sealed")], console)
    console.rule()
    console.print("[bold]What does the model lack?[/bold]")
    run(console, "learn", str(bag), "--rig", model, "-o", str(OUT / "learned"))
    console.rule()
    right = judge(console, open_sealed(OUT / "hidden.sealed")[0])
    console.print(f"({time.monotonic() - began:.0f} s)")
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
