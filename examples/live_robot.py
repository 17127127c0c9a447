# SPDX-License-Identifier: Apache-2.0
"""The live path with a robot: a Kokoro with a hidden fault, its bridge, a bag, and what is learned.

The emulated laboratory has a Kokoro that is not the one of the rig file; which effect it hides
besides is drawn by a seed and sealed in a file, which nothing but the end of this story opens.
A controller moves its elbow about, in jumps and slowly, over all of its range (the node `joint`).

    python examples/live_robot.py [--seed SEED] [--calibrate FILE]

The model is rigs/kokoro_fitted.yaml, which `--calibrate rigs/kokoro_fitted.yaml` makes from a
recording of the same laboratory without a fault; that takes some minutes. Where there is no such
file the model is calibrated first. The exit status is 0 where the effect that was named is the one
under the seal, or is told to be a look-alike of it.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from emulated_lab import Lab, prepare, record, run, shown
from rich.console import Console
from rich.table import Table

from pneu_hw_bridge.lab.sealed import open_sealed, seal
from pneu_sim.rig.schema import AttachedEffect

OUT = Path("out/live_robot")
RIG = "rigs/kokoro.yaml"
MODEL = Path("rigs/kokoro_fitted.yaml")
TAPS = ("head_valve", "head_port", "rod_valve", "rod_port")
SEALED = OUT / "hidden.sealed"


def lab(seed: int, seconds: float) -> Lab:
    """The laboratory, its bridge and the controller that moves the elbow.

    Args:
        seed: Of the targets.
        seconds: Length of a recording, s.
    """
    params = OUT / f"params_{seed}.yaml"
    bridge = "rate_hz: 500.0, publish_rate_hz: 500.0, autostart: true"
    params.write_text(
        f"/**/valve_bridge: {{ros__parameters: {{{bridge}}}}}\n"
        f"/**/joint: {{ros__parameters: {{seed: {seed}, rate_hz: 125.0}}}}\n"
    )
    return Lab(
        out=OUT,
        rig="rigs/lab_kokoro.yaml",
        registers="kokoro_logger",
        dx_m=0.06,
        seconds=seconds,
        launch=(f"rig:={RIG}", "controller:=joint", f"params:={params}"),
        topics={
            "/clock": (1, 2),
            "/lab/valve/command": (1, 2),
            "/lab/valve/applied": (1, 1),
            "/joint_states": (1, 2),
            **{f"/taps/{tap}/pressure": (1, 2 if "port" in tap else 1) for tap in TAPS},
        },
    )


def hidden(seed: int) -> AttachedEffect:
    """Draws the fault of the robot's mechanics.

    Args:
        seed: Of the draw.
    """
    rng = np.random.default_rng(seed)
    choices = [
        ("payload", "elbow", {"mass_kg": float(rng.uniform(0.1, 0.25)), "distance_m": 0.2}),
        ("seal_friction", "forearm", {"force_n_per_pa": float(rng.uniform(1.5e-5, 4e-5))}),
        ("backlash", "elbow", {"width": float(rng.uniform(0.01, 0.03))}),
        ("piston_leak", "forearm", {"area_m2": float(rng.uniform(3e-8, 1e-7))}),
    ]
    effect, place, parameters = choices[int(rng.integers(len(choices)))]
    return AttachedEffect(effect=effect, place=place, parameters=parameters)


def errors(learned: dict[str, Any]) -> Table:
    """Errors on the part kept aside after each step, per sensor in its unit.

    Args:
        learned: Result of `pneu learn`.
    """
    steps, table = learned["steps"], Table(title="error on the part kept aside")
    table.add_column("sensor")
    table.add_column("unit")
    for step in steps:
        name = f"+ {step['added']} at {step['place']}" if step["added"] else "calibrated model"
        table.add_column(name, justify="right")
    table.add_column("noise", justify="right")
    units = {tap: "Pa" for tap in learned["taps"]} | learned["encoders"]
    for sensor, unit in units.items():
        key, floor = ("held_out_rmse_pa", "noise_floor_pa")
        if unit != "Pa":
            key, floor = "held_out_rmse", "noise_floor"
        values = [*(step[key].get(sensor) for step in steps), learned[floor].get(sensor)]
        digits = "{:.0f}" if unit == "Pa" else "{:.5f}"
        shown_values = ("" if value is None else digits.format(value) for value in values)
        table.add_row(sensor, unit, *shown_values)
    return table


def judge(console: Console, sealed: AttachedEffect) -> bool:
    """Shows the errors before and after, and what was named beside what was hidden.

    Args:
        console: Where to show it.
        sealed: What was hidden.

    Returns:
        Whether the first that was named is it, or was told to be a look-alike of it.
    """
    learned = json.loads((OUT / "learned" / "learn.json").read_text())
    console.print(errors(learned))
    named = [step for step in learned["steps"] if step["added"]]
    console.print(f"[bold]The verdict: {learned['sentence']}[/bold]")
    console.rule()
    console.print(
        f"[bold]Under the seal: {sealed.effect} at {sealed.place} ({shown(sealed.parameters)})."
        "[/bold]"
    )
    if not named:
        console.print("[bold red]Not named: nothing was found.[/]")
        return False
    first, *others = named
    found = f"{first['added']} at {first['place']}, {first['strength']:.3g} {first['unit']}"
    if first["std_error"] is not None:
        found += f" (standard error {first['std_error']:.2g})"
    right = (first["added"], first["place"].split(":")[0]) == (sealed.effect, sealed.place)
    told_alike = learned["sentence"].partition("not to be told from")[2]
    tied = not right and not others and f"{sealed.effect}@{sealed.place}" in told_alike
    said = "Named rightly" if right else "Told as a look-alike" if tied else "Not named"
    beside = ", ".join(f"{step['added']} at {step['place']}" for step in others)
    more = f"; beside it was added {beside}" if others else ""
    console.print(
        f"[bold {'green' if right or tied else 'red'}]{said}: found was {found}{more}.[/]"
    )
    return right or tied


def main() -> int:
    """Runs the story; returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=1, help="of the effect that is drawn")
    parser.add_argument("--calibrate", type=Path, metavar="FILE", help="calibrate a model anew")
    options = parser.parse_args()
    if options.seed < 0:
        sys.exit(f"seed: found {options.seed}, it must not be negative")
    began = time.monotonic()
    console = prepare(OUT)
    fitted = options.calibrate
    if fitted is None and not MODEL.exists():
        fitted = OUT / "calibrated.yaml"
    model = MODEL if fitted is None else fitted
    if fitted is not None:
        console.rule()
        console.print("[bold]A healthy Kokoro, to calibrate the model.[/bold]")
        healthy = record(lab(0, 20.0), "healthy", console)
        run(console, "fit", str(healthy), "--rig", RIG, "-o", str(model), "--force")
    seal([hidden(options.seed)], SEALED)
    console.rule()
    console.print("[bold]A Kokoro with a fault that nobody is told, and it moves.[/bold]")
    bag = record(lab(options.seed + 1, 16.0), "faulty", console, "--sealed", str(SEALED))
    console.print("[bold]What does the model lack?[/bold]")
    run(console, "learn", str(bag), "--rig", str(model), "-o", str(OUT / "learned"))
    right = judge(console, open_sealed(SEALED)[0])
    console.print(f"({time.monotonic() - began:.0f} s)")
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
