# SPDX-License-Identifier: Apache-2.0
"""`pneu tune`, which tunes a PID in simulation, and `pneu policy`, which shows what a file is."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from pneu_common.errors import InputError
from pneu_common.options import MOST_SEED, Force
from pneu_common.outputs import check_output
from pneu_common.progress import progress
from pneu_policy.tune.settings import TuneSettings

if TYPE_CHECKING:
    from pneu_policy.control.controllers import FeedForwardPid, PidController
    from pneu_policy.control.policy_file import PolicyFile
    from pneu_policy.control.robot_policy import RobotPolicy
    from pneu_policy.tune.gains import Tuned

ATM_PA = 101325.0


def register_tune(app: typer.Typer) -> None:
    """Adds `pneu tune` to the application.

    Args:
        app: The application.
    """
    app.command("tune")(tune_pid)


def register_policy(app: typer.Typer) -> None:
    """Adds `pneu policy` to the application.

    Args:
        app: The application.
    """
    app.command("policy")(show)


def tune_pid(
    rig: Annotated[Path, typer.Option("--rig", help="Rig file (YAML).", show_default=False)],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="File for the tuned PID (.yaml).", show_default=False),
    ],
    kind: Annotated[str, typer.Option("--kind", help="pid or feed_forward.")] = "pid",
    seed: Annotated[
        int, typer.Option("--seed", help="Seed of all that is drawn.", min=0, max=MOST_SEED)
    ] = 0,
    tap: Annotated[str, typer.Option("--tap", help="Tap whose pressure is controlled.")] = "end",
    target_period: Annotated[
        float,
        typer.Option("--target-period", help="Typical time between a target's extremes, s."),
    ] = TuneSettings.usual("target_period_s"),
    trials: Annotated[
        int,
        typer.Option(
            "--trials", help="Runs of each candidate, each on its own rig.", min=1, max=1000
        ),
    ] = TuneSettings.usual("trials"),
    candidates: Annotated[
        int, typer.Option("--candidates", help="Candidates of a generation.", min=5, max=1000)
    ] = TuneSettings.usual("candidates"),
    generations: Annotated[
        int, typer.Option("--generations", help="Generations.", min=1, max=1000)
    ] = TuneSettings.usual("generations"),
    force: Force = False,
) -> None:
    """Tune a PID, or one with feed-forward, on simulated rigs: same seed, same gains."""
    from pneu_policy.control.controllers import save_pid
    from pneu_policy.tune.gains import tune

    if output.suffix not in (".yaml", ".yml"):
        raise InputError(f"{output}: a PID is written as .yaml")
    check_output(output, force)
    settings = TuneSettings(
        rig=str(rig),
        kind=kind,  # type: ignore[arg-type]  # checked there
        seed=seed,
        tap=tap,
        target_period_s=target_period,
        trials=trials,
        candidates=candidates,
        generations=generations,
    )
    with progress(f"tuning {kind}") as tell:

        def after(generation: int, rmse_pa: float) -> None:
            tell(f"tuning {kind}", generation / generations, f"rmse {rmse_pa / ATM_PA:.4f} atm")

        tuned = tune(settings, after)
    save_pid(tuned.controller, tuned.provenance(), output)
    console = _console()
    console.print(_table(f"{output.name}: {kind}", _rows_of_tuned(tuned)))


def show(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Policy (.npz), or tuned PID (.yaml).")
    ],
    rig: Annotated[
        Path | None,
        typer.Option("--rig", help="Rig file that it must be for.", show_default=False),
    ] = None,
) -> None:
    """Show what the file of a controller is: what it sees, its rig, its training."""
    from pneu_policy.control import robot_policy
    from pneu_policy.control.controllers import FeedForwardPid, PidController, load_controller
    from pneu_policy.control.policy_file import PolicyFile
    from pneu_policy.control.weights import kind_of
    from pneu_sim.rig import load_rig

    if file.suffix == ".npz" and kind_of(file) == robot_policy.KEY:
        robot = robot_policy.RobotPolicy.load(file)
        if rig is not None:
            robot.check_rig(load_rig(rig))
        rows = _rows_of_robot(robot)
    elif file.suffix == ".npz":
        policy = PolicyFile.load(file)
        if rig is not None:
            policy.check_rig(load_rig(rig))
        rows = _rows_of_policy(policy)
    else:
        controller = load_controller(file)
        assert isinstance(controller, PidController | FeedForwardPid)
        if rig is not None and controller.tap not in load_rig(rig).taps:
            raise InputError(f"{file}: tap: found {controller.tap!r}, rig {rig} has no such tap")
        rows = _rows_of_pid(controller)
    _console().print(_table(file.name, rows))


def _rows_of_policy(policy: "PolicyFile") -> list[tuple[str, str]]:
    r = policy.recipe
    widths = [str(policy.weights[0][0].shape[1]), *(str(len(b)) for _, b in policy.weights)]
    numbers = sum(w.size + b.size for w, b in policy.weights)
    line = ", ".join(f"{points} points of {pipe}" for pipe, points in r.line)
    waves = f"{r.levels} levels of base {r.base:g}" if r.levels else "none"
    rows = [
        ("controls", f"{r.tap} by {', '.join(policy.rig['commands'])}"),
        ("every", f"{1e3 * r.period_s:g} ms"),
        ("network", f"{' - '.join(widths)}, tanh; {numbers} numbers"),
        ("deviation in training", f"{math.exp(policy.log_std):.3g}"),
        ("sees taps", ", ".join(r.taps)),
        ("sees targets at", ", ".join(f"{1e3 * t:g}" for t in r.preview_s) + " ms"),
        ("sees commands", f"the last {r.past}"),
        ("sees gas", line or "none"),
        ("positional encoding", waves),
        ("volts", f"{r.null_v:g} ± {r.half_v:g} V"),
        ("rig", str(policy.rig["name"])),
    ]
    lengths = ", ".join(f"{name} {length:g} m" for name, length in policy.rig["pipes"].items())
    rows.append(("its pipes", lengths))
    return rows + _rows_of(policy.training, "training")


def _rows_of_robot(policy: "RobotPolicy") -> list[tuple[str, str]]:
    r = policy.recipe
    widths = [str(policy.weights[0][0].shape[1]), *(str(len(b)) for _, b in policy.weights)]
    told = [("sees encoders", ", ".join(r.measured))] if r.see_motion else []
    if r.see_target:
        told.append(("sees targets of", ", ".join(r.tracked)))
    rows = [
        ("controls", f"{', '.join(r.tracked) or 'forces'} by {', '.join(r.commands)}"),
        ("every", f"{1e3 * r.period_s:g} ms"),
        ("network", f"{' - '.join(widths)}, tanh"),
        *told,
        ("sees required forces of", ", ".join(r.forces) or "none"),
        ("sees ways of pistons", "yes" if r.ways else "no"),
        ("sees taps", ", ".join(r.taps)),
        ("sees what lies ahead at", ", ".join(f"{1e3 * t:g}" for t in r.preview_s) + " ms"),
        ("sees actions", f"the last {r.past}"),
        ("positional encoding", f"{r.levels} levels of base {r.base:g}" if r.levels else "none"),
        ("volts", f"{r.null_v:g} ± {r.half_v:g} V"),
        ("runs on hardware", "yes" if r.hardware else "no: it sees what a model alone tells"),
        ("rig", str(policy.rig["name"])),
    ]
    return rows + _rows_of(policy.training, "training")


def _rows_of_pid(controller: "PidController | FeedForwardPid") -> list[tuple[str, str]]:
    from pneu_policy.control.controllers import FeedForwardPid

    rows = [
        ("controls", controller.tap),
        ("every", f"{1e3 * controller.period_s:g} ms"),
        *((name, f"{value:g}") for name, value in vars(controller.gains).items()),
    ]
    if isinstance(controller, FeedForwardPid):
        ahead = controller.ahead
        rows += [
            ("target_lead_s", f"{controller.target_lead_s:g}"),
            ("feed-forward gain", f"{ahead.gain:g}"),
            ("feed-forward lead_s", f"{ahead.lead_s:g}"),
            ("feed-forward volume_m3", f"{ahead.volume_m3:g}"),
        ]
    return rows + _rows_of(controller.tuned, "tuned")


def _rows_of_tuned(tuned: "Tuned") -> list[tuple[str, str]]:
    rows = _rows_of_pid(tuned.controller)
    rows.append(("rmse", f"{tuned.rmse_pa / ATM_PA:.4f} atm"))
    rows += [(f"rmse, {k}", f"{v / ATM_PA:.4f} atm") for k, v in tuned.of_kind_pa.items()]
    return rows


def _rows_of(data: Mapping[str, Any], name: str) -> list[tuple[str, str]]:
    """Plain data as rows, nested names joined by dots."""
    rows: list[tuple[str, str]] = []
    for key, value in data.items():
        if isinstance(value, Mapping):
            rows += _rows_of(value, f"{name}.{key}")
        else:
            shown = f"{value:.6g}" if isinstance(value, float) else str(value)
            rows.append((f"{name}.{key}", shown))
    return rows


def _table(title: str, rows: list[tuple[str, str]]) -> Table:
    table = Table(title=title, show_header=False)
    table.add_column("what", overflow="fold")
    table.add_column("value", overflow="fold")
    for what, value in rows:
        table.add_row(escape(what), escape(value))
    return table


def _console() -> Console:
    console = Console()
    return console if console.is_terminal else Console(width=140)
