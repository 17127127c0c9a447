# SPDX-License-Identifier: Apache-2.0
"""The live path: a lab with a hidden fault, its bridge, a controller, a bag, and what is learned.

The emulated lab is a process of its own behind Modbus TCP. Which effect it hides is drawn by a seed
and sealed in a file, which nothing but the last line of this story opens.

    python examples/live.py [seed]
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

from pneu_hw_bridge.lab.sealed import open_sealed, seal
from pneu_sim.rig.schema import AttachedEffect

ROOT = Path(__file__).resolve().parent.parent
OUT = Path("out/live")
RIG = "rigs/lab.yaml"
SECONDS = 8.0
READY_S = 60.0
"""How long the lab may take to be ready; the first time it compiles its kernels."""


def hidden(seed: int) -> AttachedEffect:
    """Draws the fault of the lab."""
    rng = np.random.default_rng(seed)
    where = {"position_m": float(rng.uniform(0.5, 1.2))}
    choices = [
        ("leak", "tube", {"area_m2": float(rng.uniform(6e-9, 1.5e-8)), **where}),
        ("sensor_lag", "middle", {"lag_s": float(rng.uniform(0.006, 0.012))}),
        ("spool_leakage", "valve.supply", {"fraction": float(rng.uniform(0.002, 0.004))}),
    ]
    effect, place, parameters = choices[int(rng.integers(len(choices)))]
    return AttachedEffect(effect=effect, place=place, parameters=parameters)


@contextlib.contextmanager
def pneu(*words: str, log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A `pneu` command in the background; ended as by Ctrl-C, and for good."""
    with log.open("wb") as stream:
        process = subprocess.Popen(
            [sys.executable, "-m", "pneu_sim.cli", *words],
            stdout=stream,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            yield process
            process.send_signal(signal.SIGINT)
            process.wait(20.0)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def wait_for(path: Path, process: subprocess.Popen[bytes], log: Path, seconds: float) -> None:
    """Waits for a file that a process writes; its log tells why where it does not."""
    end = time.monotonic() + seconds
    while not path.exists():
        if process.poll() is not None or time.monotonic() > end:
            raise SystemExit(f"{path} did not appear:\n{log.read_text(errors='replace')}")
        time.sleep(0.05)


def record(name: str, sealed: list[str], console: Console) -> Path:
    """Runs lab, bridge and controller, and returns the bag."""
    ready, bag = OUT / f"{name}.ready", OUT / name
    os.environ.setdefault("ROS_DOMAIN_ID", str(random.randint(1, 100)))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    lab = ["lab", "--rig", RIG, *sealed, "--port", "0"]
    lab += ["--control-port", "0", "--allow-slow", "--ready-file", str(ready)]
    console.print(f"$ pneu {' '.join(lab)}", style="cyan")
    with pneu(*lab, log=OUT / "lab.log") as device:
        wait_for(ready, device, OUT / "lab.log", READY_S)
        port = json.loads(ready.read_text())["modbus_port"]
        words = ["launch", "pneu_bringup", "rig.launch.yaml", "backend:=modbus"]
        words += [f"port:={port}", f"record:={bag}"]
        console.print(f"$ pneu {' '.join(words)}", style="cyan")
        with pneu(*words, log=OUT / "launch.log") as launch:
            wait_for(bag, launch, OUT / "launch.log", 30.0)
            time.sleep(SECONDS)
    return bag


def run(console: Console, *words: str) -> None:
    """Runs a `pneu` command to its end; its failure is ours."""
    console.print(f"$ pneu {' '.join(words)}", style="cyan")
    status = subprocess.run([sys.executable, "-m", "pneu_sim.cli", *words], check=False).returncode
    if status:
        raise SystemExit(status)


def main() -> int:
    """Runs the story; returns the exit status."""
    os.chdir(ROOT)
    console = Console(width=140) if not sys.stdout.isatty() else Console()
    seed = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    began = time.monotonic()
    shutil.rmtree(OUT, ignore_errors=True)
    OUT.mkdir(parents=True)
    seal([hidden(seed)], OUT / "hidden.sealed")
    model = str(OUT / "calibrated.yaml")
    console.print("[bold]A healthy lab, to calibrate the model's delay over the bus.[/bold]")
    healthy = record("healthy", [], console)
    run(console, "fit", str(healthy), "--rig", RIG, "-o", model)
    console.print("[bold]A lab with a fault that nobody is told, and a controller on it.[/bold]")
    bag = record("faulty", ["--sealed", str(OUT / "hidden.sealed")], console)
    console.print("[bold]What does the model lack?[/bold]")
    run(console, "learn", str(bag), "--rig", model, "-o", str(OUT / "learned"))
    (effect,) = open_sealed(OUT / "hidden.sealed")
    strength = ", ".join(f"{name} {value:.3g}" for name, value in effect.parameters.items())
    console.print(f"[bold]Under the seal: {effect.effect} at {effect.place} ({strength})[/bold]")
    console.print(f"({time.monotonic() - began:.0f} s)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
