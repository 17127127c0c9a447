# SPDX-License-Identifier: Apache-2.0
"""`pneu train`: trains policies from a settings file, one run or a sweep."""

import importlib.util
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_common.options import MOST_SEED
from pneu_common.progress import progress
from pneu_common.tables import Column, NamedTable


def register_train(app: typer.Typer) -> None:
    """Adds `pneu train` to the application.

    Args:
        app: The application.
    """
    app.command("train")(train)


def train(
    settings: Annotated[
        Path, typer.Argument(metavar="SETTINGS", help="Settings of the training (YAML).")
    ],
    out: Annotated[
        Path, typer.Option("-o", "--out", help="Folder for checkpoints, histories and policies.")
    ],
    seed: Annotated[
        list[int] | None,
        typer.Option(
            "--seed",
            help="Seed in place of the file's; several make several runs.",
            min=0,
            max=MOST_SEED,
        ),
    ] = None,
    iterations: Annotated[
        int | None, typer.Option("--iterations", help="In place of the file's.", min=1)
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from the checkpoints in the folder.")
    ] = False,
    workers: Annotated[
        int | None, typer.Option("--workers", help="Runs at a time; -1 takes all cores.")
    ] = None,
    backend: Annotated[
        str | None, typer.Option("--backend", help="loky (this machine) or ray (a cluster).")
    ] = None,
    address: Annotated[
        str | None, typer.Option("--address", help="Address of the Ray cluster.")
    ] = None,
) -> None:
    """Train policies by the natural policy gradient.

    Finished runs in the folder are not trained again. Ctrl-C ends with a checkpoint.
    """
    if importlib.util.find_spec("torch") is None:
        raise InputError(
            "training needs PyTorch, which is not installed: `pip install '.[learn]'` in a checkout"
            " of pneu, or 'FILE.whl[learn]' for a wheel of it"
        )
    from pneu_policy.learn import sweep
    from pneu_policy.learn.settings import load_document
    from pneu_policy.learn.trainer import CHECKPOINT

    document = load_document(settings)
    if iterations is not None:
        document["iterations"] = iterations
    if seed:
        axes = document.get("sweep") or {}
        document["sweep"] = {**axes, "seed": list(seed)} if len(seed) > 1 or axes else None
        document["seed"] = seed[0]
    try:
        where = document.get("run") or {}
        if not isinstance(where, dict):
            raise InputError(f"run: found {where!r}, a mapping is needed")
        asked = {"workers": workers, "backend": backend, "address": address}
        where = {**where, **{key: value for key, value in asked.items() if value is not None}}
        places = sweep.Workers.from_dict(where)
        runs = sweep.expand(document, out)
    except InputError as error:
        raise InputError(f"{settings}: {error}") from None
    for run in runs:
        if run.history() is None and (run.folder / CHECKPOINT).exists() and not resume:
            raise InputError(
                f"{run.folder}: holds the checkpoint of a run that is not finished; --resume goes"
                " on from it"
            )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot be made a folder ({error.strerror})") from None

    console = Console()
    console = console if console.is_terminal else Console(width=140)
    outcomes = _train_one(runs[0]) if len(runs) == 1 else _train_many(runs, places)
    console.print(_table(outcomes))
    _draw(outcomes, out)
    failed = [outcome for outcome in outcomes if outcome.fault]
    for outcome in failed:
        trace = outcome.run.folder.with_name(f"{outcome.run.name}.error.txt")
        write_whole(trace, outcome.trace or "")
        console.print(f"[red]{outcome.run.name}: {escape(outcome.fault or '')}[/red]")
    if failed:
        raise typer.Exit(1)


def _train_one(run: Any) -> list[Any]:
    """In this process, with a bar that shows score and error."""
    from pneu_policy.learn import sweep

    history = run.history()
    if history is None:
        with progress(run.name) as tell:
            unit = run.settings.env.unit[0]

            def report(row: dict[str, Any]) -> None:
                judged = row["eval_rmse"]
                said = f"score {row['score']:.2f}  error {row['rmse']:.3f} {unit}"
                if judged is not None:
                    said += f"  (without exploration {judged:.3f})"
                tell(run.name, row["iteration"] / run.settings.iterations, said)

            try:
                history = sweep.train(run, report=report)
            except FloatingPointError as error:
                raise InputError(f"{run.folder}: {error}") from error
    return [sweep.Outcome(run, history)]


def _train_many(runs: list[Any], places: Any) -> list[Any]:
    from pneu_policy.learn import sweep

    outcomes = []
    with progress(f"training {len(runs)} policies") as tell:
        for outcome in sweep.train_all(runs, places):
            outcomes.append(outcome)
            ended = "failed" if outcome.fault else "finished"
            tell("runs", len(outcomes) / len(runs), f"{outcome.run.name} {ended}")
    return outcomes


def _draw(outcomes: list[Any], out: Path) -> None:
    """Draws the learning curves, runs that differ in their seed alone as one group."""
    from pneu_policy.learn.curves import learning_curves

    groups: dict[str, list[Any]] = {}
    for outcome in sorted(outcomes, key=lambda outcome: str(outcome.run.folder)):
        if outcome.history is not None:
            words = [w for w in outcome.run.name.split("_") if not w.startswith("seed-")]
            groups.setdefault("_".join(words) or "all runs", []).append(outcome.history)
    if groups:
        learning_curves(groups, out / "curves.png")


def _table(outcomes: list[Any]) -> NamedTable:
    told = next((o.history for o in outcomes if o.history is not None), None)
    unit, mark = (told.unit, told.mark) if told else ("-", 0.0)
    numbers = {"iterations": 1, "samples": 2, "score": 0, f"error, {unit}": 0}
    table = NamedTable(
        "",
        [
            Column("run"),
            *(Column(head, "number", drop) for head, drop in numbers.items()),
            Column(f"{mark:g} {unit} after"),
            Column("time", "number"),
        ],
    )
    for outcome in outcomes:
        if outcome.history is None:
            table.add_row(outcome.run.name, "failed", "", "", "", "", "")
            continue
        last, first = outcome.history.rows[-1], outcome.history.learned()
        reached = "-" if first is None else f"{first['wall_s']:.0f} s, {first['samples']} samples"
        # A run that is asked for fewer iterations than it has done may end between evaluations.
        judged = last["eval_score"] is not None
        table.add_row(
            outcome.run.name,
            str(last["iteration"]),
            str(last["samples"]),
            f"{last['eval_score']:.2f}" if judged else "-",
            f"{last['eval_rmse']:.4f}" if judged else "-",
            reached,
            f"{last['wall_s']:.0f} s",
        )
    return table
