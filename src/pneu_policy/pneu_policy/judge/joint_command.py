# SPDX-License-Identifier: Apache-2.0
"""`pneu evaluate-joint`: controllers of a joint on a simulated robot (thesis table 9.2)."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_common.options import MOST_SEED, Force
from pneu_common.outputs import check_output
from pneu_common.progress import progress
from pneu_common.tables import Column, NamedTable

if TYPE_CHECKING:
    from pneu_policy.judge.robot import JointRun


def register_evaluate_joint(app: typer.Typer) -> None:
    """Adds this subcommand to the `pneu` application.

    Args:
        app: The application.
    """
    app.command("evaluate-joint")(evaluate_joint)


def evaluate_joint(
    controllers: Annotated[
        list[Path],
        typer.Argument(metavar="CONTROLLER...", help="Policies (.npz) and tuned ones (.yaml)."),
    ],
    rig: Annotated[
        Path, typer.Option("--rig", help="Rig as controllers know it.", show_default=False)
    ],
    joint: Annotated[
        str, typer.Option("--joint", help="Encoder of the joint.", show_default=False)
    ],
    low: Annotated[float, typer.Option(help="Lowest target, rad or m.", show_default=False)],
    high: Annotated[float, typer.Option(help="Highest target, rad or m.", show_default=False)],
    plant: Annotated[
        Path | None,
        typer.Option("--plant", help="The robot itself.", show_default="the rig, as it is known"),
    ] = None,
    periods: Annotated[
        str,
        typer.Option(help="Typical times from one extreme to the next, s: smooth, then jagged."),
    ] = "0.6,0.2",
    runs: Annotated[int, typer.Option(help="Runs of each kind of target.", min=1, max=1000)] = 5,
    seconds: Annotated[
        float, typer.Option(help="How long a run is judged, s.", min=1.0, max=3600.0)
    ] = 20.0,
    dx: Annotated[
        float | None,
        typer.Option(help="Cell length of the robot, m.", show_default="the plant's"),
    ] = None,
    seed: Annotated[
        int, typer.Option(help="Of targets, delays and noise.", min=0, max=MOST_SEED)
    ] = 7000,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="All runs as this file.", show_default=False)
    ] = None,
    force: Force = False,
) -> None:
    """Try controllers of a joint on random targets: error, apparent latency, what is left."""
    from pneu_policy.judge.robot import JointTasks, judge_joint
    from pneu_sim.rig import load_rig

    check_output(json_file, force)
    if not low < high:
        raise InputError(f"--low: found {low:g}, allowed is below --high, {high:g}")
    if dx is not None and not 1e-4 <= dx <= 1.0:
        raise InputError(f"--dx: found {dx:g}, allowed are 0.0001 to 1 m")
    known = load_rig(rig)
    true = known if plant is None else load_rig(plant)
    for name, one in (("--rig", known), ("--plant", true)):
        if joint not in one.encoders:
            raise InputError(
                f"--joint: found {joint!r}, {name} has {', '.join(one.encoders) or 'no encoders'}"
            )
    tasks = JointTasks(joint, low, high, _periods(periods), runs=runs, seconds=seconds, seed=seed)
    found: dict[str, list[JointRun]] = {}
    with progress("evaluating") as tell:
        for file in controllers:

            def told(share: float, name: str = file.name) -> None:
                tell(name, share, "")

            found[str(file)] = judge_joint(file, known, true, tasks, dx, told)
    console = Console()
    console = console if console.is_terminal else Console(width=140)
    console.print(_table(found, tasks.kinds))
    if json_file is not None:
        rows = [_plain(file, run) for file, of in found.items() for run in of]
        document = {"pneu_joint_evaluation": 1, "rig": str(rig), "runs": rows}
        write_whole(json_file, json.dumps(document, indent=1) + "\n")


def _periods(text: str) -> tuple[float, float]:
    try:
        smooth, jagged = (float(word) for word in text.split(","))
    except ValueError:
        raise InputError(f"--periods: found {text!r}, needed are two such as 0.6,0.2") from None
    if not all(0.01 <= period <= 100.0 for period in (smooth, jagged)):
        raise InputError(f"--periods: found {text!r}, allowed are 0.01 to 100 s")
    return smooth, jagged


def _plain(file: str, run: "JointRun") -> dict[str, Any]:
    return {
        "controller": file,
        "kind": run.kind,
        "run": run.run,
        "rmse": run.rmse,
        "latency_s": run.latency_s,
        "adjusted_rmse": run.adjusted_rmse,
        "effort_v": run.effort_v,
    }


def _table(found: "dict[str, list[JointRun]]", kinds: tuple[str, ...]) -> NamedTable:
    table = NamedTable(
        "means over runs; errors as root mean squares",
        [
            Column("controller"),
            Column("target"),
            *(
                Column(head, "number")
                for head in ("RMSE, rad or m", "latency, ms", "adjusted RMSE", "effort, V")
            ),
        ],
    )
    for file, runs in found.items():
        for kind in kinds:
            own = [run for run in runs if run.kind == kind]
            rmse = math.sqrt(sum(run.rmse**2 for run in own) / len(own))
            left = math.sqrt(sum(run.adjusted_rmse**2 for run in own) / len(own))
            late = 1e3 * sum(run.latency_s for run in own) / len(own)
            effort = sum(run.effort_v for run in own) / len(own)
            table.add_row(
                Path(file).name, kind, f"{rmse:.4f}", f"{late:.0f}", f"{left:.4f}", f"{effort:.2f}"
            )
    return table
