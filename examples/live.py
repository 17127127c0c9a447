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

import json
import sys
import time
from pathlib import Path

import numpy as np
from emulated_lab import Lab, prepare, record, run, shown
from rich.console import Console
from rich.table import Table

from pneu_hw_bridge.lab.sealed import open_sealed, seal
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import AttachedEffect

OUT = Path("out/live")
RIG = "rigs/lab.yaml"
TAPS = ("supply", "valve_out", "middle", "end", "exhaust")
LAB = Lab(
    out=OUT,
    rig=RIG,
    registers="logging_plc",
    dx_m=0.035,
    seconds=8.0,
    launch=(),
    topics={
        "/clock": (1, 2),
        "/lab/valve/command": (1, 2),
        "/lab/target": (1, 2),
        "/lab/valve/applied": (1, 1),
        **{f"/lab/taps/{tap}/pressure": (1, 2 if tap == "end" else 1) for tap in TAPS},
    },
)
MOST_HEALTHY_PA = 2500.0
"""Ten times the sensors' noise: an error that hides what could be learned."""


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
    if len(sys.argv) > 1 and not sys.argv[1].isdigit():
        sys.exit(f"seed: found {sys.argv[1]!r}, a whole number is needed")
    seed = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    began = time.monotonic()
    console = prepare(OUT)
    seal([hidden(seed)], OUT / "hidden.sealed")
    model = str(OUT / "calibrated.yaml")
    console.rule()
    console.print(
        "[bold]A healthy lab, to calibrate the model's delay from the device to the valve.[/bold]"
    )
    healthy = record(LAB, "healthy", console)
    run(console, "fit", str(healthy), "--rig", RIG, "-o", model)
    check(console, model)
    console.rule()
    console.print("[bold]A lab with a fault that nobody is told, and a controller on it.[/bold]")
    bag = record(LAB, "faulty", console, "--sealed", str(OUT / "hidden.sealed"))
    console.rule()
    console.print("[bold]What does the model lack?[/bold]")
    run(console, "learn", str(bag), "--rig", model, "-o", str(OUT / "learned"))
    console.rule()
    right = judge(console, open_sealed(OUT / "hidden.sealed")[0])
    console.print(f"({time.monotonic() - began:.0f} s)")
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
