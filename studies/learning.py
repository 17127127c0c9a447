# SPDX-License-Identifier: Apache-2.0
"""The natural policy gradient beside PPO of stable-baselines3: same robots, samples, networks.

Tasks whose episodes last: the cart of thesis 7.5 and the hand of 7.7.2. Stages, each of which goes
on where it ended:

  npg   policies by ``studies/settings`` rail and arm, several seeds
  ppo   the same by PPO, its own settings as its authors have them
  page  ``docs/learning.md`` and its figure

Time is what a process computed for, so that it is the same beside other work.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from pneu_common.errors import InputError
from pneu_common.files import whole, write_whole
from pneu_common.progress import progress
from pneu_policy.learn.history import History
from pneu_policy.learn.settings import load_document
from pneu_policy.learn.sweep import Run, Workers, expand
from pneu_policy.learn.trainer import HISTORY
from studies.digest import digest_of
from studies.stages import add_stages
from studies.training import add_workers, train_runs

ROOT = Path(__file__).resolve().parent.parent
OUT = Path("out") / "learning"
SETTINGS = Path("studies") / "settings"
TASKS = {"rail": "a cart after a target", "arm": "a hand after a target"}
WAYS = {"npg": "natural policy gradient", "ppo": "PPO, stable-baselines3"}
COLOURS = {"npg": "#1f5fa8", "ppo": "#c8501e"}


def runs(task: str, way: str, seeds: int, iterations: int | None) -> list[Run]:
    """Trainings of a task.

    Args:
        task: Name of its settings.
        way: ``npg`` or ``ppo``.
        seeds: How many.
        iterations: Of each; None is the settings file's.
    """
    document = load_document(ROOT / SETTINGS / f"{task}.yaml")
    document |= {"keep_every": 0, "average_decay": 0.0, "sweep": {"seed": list(range(seeds))}}
    if iterations is not None:
        document["iterations"] = iterations
    return expand(document, OUT / task / way)


def _ppo(run: Run) -> str:
    # Here, because it is wanted by this stage alone and takes seconds to import.
    from pneu_policy.learn.ppo import train_ppo

    history = train_ppo(run.settings)
    run.folder.mkdir(parents=True, exist_ok=True)
    history.save(run.folder / HISTORY)
    return str(run.folder)


def by_ppo(asked: list[Run], workers: int) -> None:
    """The same by PPO.

    Args:
        asked: The trainings.
        workers: At a time.
    """
    todo = [run for run in asked if not (run.folder / HISTORY).exists()]
    jobs = joblib.Parallel(workers, return_as="generator_unordered", pre_dispatch="all")(
        joblib.delayed(_ppo)(run) for run in todo
    )
    with progress("ppo") as tell:
        for done, name in enumerate(jobs, 1):
            tell("trainings", done / len(todo), name)


def histories(task: str, way: str, seeds: int, iterations: int | None) -> list[History]:
    """How the trainings of a task went.

    Args:
        task: Name of its settings.
        way: ``npg`` or ``ppo``.
        seeds: How many.
        iterations: Of each.
    """
    files = [run.folder / HISTORY for run in runs(task, way, seeds, iterations)]
    missing = [file for file in files if not file.exists()]
    if missing:
        raise InputError(f"{missing[0]}: is missing; the stage {way} makes it")
    return [History.load(file) for file in files]


def judged(history: History) -> Iterator[dict[str, Any]]:
    """Rows with an evaluation.

    Args:
        history: Of a training.
    """
    return (row for row in history.rows if row["eval_score"] is not None)


def draw(found: dict[str, dict[str, list[History]]], path: Path) -> None:
    """Return over samples and over time.

    Args:
        found: Histories by task and way.
        path: Picture.
    """
    figure = Figure(figsize=(11.0, 3.4 * len(found)), layout="constrained")
    grid = figure.subplots(len(found), 2, squeeze=False, sharey="row")
    for axes, (task, ways) in zip(grid, found.items(), strict=True):
        for way, of in ways.items():
            for number, history in enumerate(of):
                rows = list(judged(history))
                scores = [row["eval_score"] for row in rows]
                label = WAYS[way] if number == 0 else None
                for one, at in zip(axes, ("samples", "cpu_s"), strict=True):
                    one.plot([row[at] for row in rows], scores, color=COLOURS[way], label=label)
        axes[0].set(ylabel="return without exploration", title=TASKS[task])
        axes[0].set(xlabel="samples (control periods)")
        axes[1].set(xlabel="time of one core, s")
        for one in axes:
            one.spines[["top", "right"]].set_visible(False)
    grid[0, 0].legend(frameon=False, loc="lower right")
    with whole(path) as aside:
        figure.savefig(aside, format="png", dpi=110)


def page(found: dict[str, dict[str, list[History]]], path: Path) -> None:
    """Writes the page.

    Args:
        found: Histories by task and way.
        path: The page.
    """
    draw(found, path.parent / "figures" / "learning.png")
    sources = digest_of(
        [
            ROOT / "src/pneu_sim/pneu_sim",
            ROOT / "src/pneu_policy/pneu_policy",
            *(ROOT / "rigs" / f"{task}.yaml" for task in found),
            *(ROOT / SETTINGS / f"{task}.yaml" for task in found),
        ]
    )
    lines = [
        "# The natural policy gradient beside PPO",
        "",
        f"Made by `make learning`, from the sources, rigs and settings {sources}.",
        "",
        "The same robots, episodes, networks and number of samples; PPO is that of"
        " stable-baselines3 with its own defaults, its batches as large as our value function's."
        " Return and error without exploration, at the end of training: mean over seeds, in"
        " brackets the least and the most. Time is that of one core.",
        "",
        "| task | | seeds | samples | return | error, mm | time, s | samples to the other's |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for task, ways in found.items():
        ends = {way: [h.rows[-1] for h in of] for way, of in ways.items()}
        for way, rows in ends.items():
            other = np.mean([r["eval_score"] for w, of in ends.items() if w != way for r in of])
            first = [
                next((r["samples"] for r in judged(h) if r["eval_score"] >= other), None)
                for h in ways[way]
            ]
            reached = [s for s in first if s is not None]
            told = f"{np.mean(reached):.0f}" if len(reached) == len(first) else "not reached"
            score, error = ([r[k] for r in rows] for k in ("eval_score", "eval_rmse"))
            lines.append(
                f"| {TASKS[task]} | {WAYS[way]} | {len(rows)} | {rows[0]['samples']} |"
                f" {np.mean(score):.0f} ({min(score):.0f} to {max(score):.0f}) |"
                f" {np.mean(error):.2f} ({min(error):.2f} to {max(error):.2f}) |"
                f" {np.mean([r['cpu_s'] for r in rows]):.0f} | {told} |"
            )
    lines += ["", "![return over samples and time](figures/learning.png)", ""]
    write_whole(path, "\n".join(lines))


def main() -> int:
    """Runs the stages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    add_stages(parser, ("npg", "ppo", "page"))
    parser.add_argument("--tasks", nargs="+", choices=tuple(TASKS), default=tuple(TASKS))
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--iterations", type=int, help="of each training; 400 is the thesis'")
    add_workers(parser)
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "learning.md")
    asked = parser.parse_args()
    each = (asked.seeds, asked.iterations)
    if "npg" in asked.stages:
        of = [run for task in asked.tasks for run in runs(task, "npg", *each)]
        train_runs(of, Workers(asked.backend, asked.workers))
    if "ppo" in asked.stages:
        by_ppo([run for task in asked.tasks for run in runs(task, "ppo", *each)], asked.workers)
    if "page" in asked.stages:
        found = {t: {way: histories(t, way, *each) for way in WAYS} for t in asked.tasks}
        page(found, asked.page)
        Console().print(f"{asked.page} is written")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
