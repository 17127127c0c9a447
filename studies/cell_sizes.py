# SPDX-License-Identifier: Apache-2.0
"""Thesis 6.1: policies that learn with cells of one size, judged with cells of another.

The cart of ``rigs/rail.yaml``, its lines divided into so many cells altogether; the time step goes
with the cells. Stages, each of which goes on where it ended:

  train  policies by ``studies/settings/rail.yaml``, one for every number of cells
  judge  each of them with every number of cells
  page   ``docs/cell_sizes.md`` and its figure

``--size full`` takes the thesis' twelve numbers, 30 to 1800: a hundred hours of one core, most of
them for the last two.
"""

import argparse
import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console

from pneu_common.errors import InputError
from pneu_common.files import whole, write_whole
from pneu_common.progress import progress
from pneu_policy.control.robot_policy import RobotPolicy
from pneu_policy.learn.networks import mean_action
from pneu_policy.learn.rollout import roll_out
from pneu_policy.learn.settings import load_document
from pneu_policy.learn.sweep import Run, Workers, expand
from pneu_policy.learn.trainer import POLICY
from pneu_policy.task.robots import Robots, RobotSettings
from pneu_sim.rig.load import load_rig
from studies.digest import digest_of
from studies.stages import add_stages
from studies.training import add_workers, train_runs

ROOT = Path(__file__).resolve().parent.parent
OUT = Path("out") / "cell_sizes"
SETTINGS = Path("studies") / "settings" / "rail.yaml"
SEED = 33_000
"""Of the episodes that policies are judged by."""
SETTLED = 0.25
"""Share of an episode that is not judged: the gas comes from rest."""
THESIS = 38
"""Percent: the largest increase in fig. 6.1."""

DARK = 40.0
"""Percent that are drawn darkest."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Size:
    """How large a study is.

    Attributes:
        cells: Numbers of cells, of all lines together.
        seeds: Trainings with each.
        iterations: Of each.
    """

    cells: tuple[int, ...]
    seeds: int
    iterations: int


SIZES = {
    "small": Size((10, 20, 30, 60, 90, 120), 1, 100),
    "full": Size((30, 60, 90, 120, 150, 180, 300, 360, 450, 600, 900, 1800), 3, 400),
}


def document(cells: int, iterations: int) -> dict[str, Any]:
    """Fields of `TrainSettings` for a number of cells.

    Args:
        cells: Of all lines together.
        iterations: Of the training.
    """
    settings = load_document(ROOT / SETTINGS) | {"iterations": iterations, "keep_every": 0}
    lines = load_rig(ROOT / settings["env"]["rig"]).pipes.values()
    settings["env"]["dx_m"] = sum(line.length_m for line in lines) / cells
    return settings


def runs(size: Size) -> dict[int, list[Run]]:
    """Trainings by number of cells.

    Args:
        size: How large the study is.
    """
    return {
        cells: expand(
            document(cells, size.iterations) | {"sweep": {"seed": list(range(size.seeds))}},
            OUT / f"cells_{cells}",
        )
        for cells in size.cells
    }


def train(size: Size, workers: Workers) -> None:
    """Trains what is not trained yet.

    Args:
        size: How large the study is.
        workers: Where.

    Raises:
        InputError: A training failed.
    """
    # those that take longest first, so that no core is left with one of them at the end
    asked = [run for cells in sorted(size.cells, reverse=True) for run in runs(size)[cells]]
    train_runs(asked, workers)


def _judge(files: list[Path], cells: int) -> tuple[list[float], int, float]:
    """Mean error of policies with a number of cells, m; how many there are; the time step, s."""
    env = Robots(RobotSettings(**document(cells, 1)["env"]))
    errors = []
    for file in files:
        episodes = roll_out(env, partial(mean_action, RobotPolicy.load(file).weights), SEED)
        errors.append(float(np.abs(episodes.error[round(SETTLED * len(episodes.error)) :]).mean()))
    return errors, env.plant.cells, env.plant.step_s


def judge(size: Size, workers: int) -> None:
    """Judges every policy with every number of cells.

    Args:
        size: How large the study is.
        workers: Numbers of cells at a time.
    """
    files = [run.folder / POLICY for of in runs(size).values() for run in of]
    missing = [file for file in files if not file.exists()]
    if missing:
        raise InputError(f"{missing[0]}: is missing; the stage train makes it")
    of = digest_of(files)
    path = OUT / "judge.json"
    if path.exists() and json.loads(path.read_text(encoding="utf-8"))["of"] == of:
        return
    jobs = joblib.Parallel(workers, return_as="generator", pre_dispatch="all")(
        joblib.delayed(_judge)(files, cells) for cells in size.cells
    )
    found: dict[str, Any] = {"of": of, "cells": size.cells, "errors_m": [], "grid": []}
    with progress("judging") as tell:
        for done, (errors, count, step_s) in enumerate(jobs, 1):
            if count != size.cells[done - 1]:
                raise InputError(f"cells: found {count}, {size.cells[done - 1]} were asked for")
            found["errors_m"].append(errors)
            found["grid"].append([count, step_s])
            tell("cells", done / len(size.cells), str(size.cells[done - 1]))
    write_whole(path, json.dumps(found))


def table(errors_m: Floats) -> Floats:
    """Percent by which errors differ from those with the cells of training.

    Args:
        errors_m: (trained, seeds, tested) mean errors.

    Returns:
        (trained, tested), the mean over seeds.
    """
    mean = errors_m.mean(axis=1)
    return np.asarray(100.0 * (mean / np.diag(mean)[:, None] - 1.0))


def draw(cells: list[int], percent: Floats, path: Path) -> None:
    """The table as a picture, as thesis fig. 6.1.

    Args:
        cells: Numbers of cells.
        percent: (trained, tested).
        path: Picture.
    """
    n = len(cells)
    figure = Figure(figsize=(1.6 + 0.62 * n, 1.2 + 0.55 * n), layout="constrained")
    axes = figure.add_subplot()
    axes.imshow(percent, cmap="RdBu_r", vmin=-DARK, vmax=DARK)
    for row in range(n):
        for column in range(n):
            value = percent[row, column]
            told = f"{value:+.0f}" if round(value) else "0"
            axes.text(column, row, told, ha="center", va="center", fontsize=9,
                      color="white" if abs(value) > 0.7 * DARK else "black")  # fmt: skip
    axes.set_xticks(range(n), [str(c) for c in cells])
    axes.set_yticks(range(n), [str(c) for c in cells])
    axes.set(xlabel="cells in the test", ylabel="cells in training")
    with whole(path) as aside:
        figure.savefig(aside, format="png", dpi=120)


def agreeing(percent: Floats) -> int:
    """From which number of cells on no increase is beyond the thesis' largest.

    Args:
        percent: (trained, tested), in the order of the numbers.

    Returns:
        Its place in that order.
    """
    return next(k for k in range(len(percent)) if percent[k:, k:].max() <= THESIS)


def page(size: Size, path: Path) -> None:
    """Writes the page.

    Args:
        size: How large the study was.
        path: The page.
    """
    file = OUT / "judge.json"
    if not file.exists():
        raise InputError(f"{file}: is missing; the stage judge makes it")
    found = json.loads(file.read_text(encoding="utf-8"))
    cells, n = list(found["cells"]), len(found["cells"])
    errors = np.array(found["errors_m"]).T.reshape(n, -1, n)
    percent = table(errors)
    draw(cells, percent, path.parent / "figures" / "cell_sizes.png")
    sources = digest_of(
        [
            ROOT / "src/pneu_sim/pneu_sim",
            ROOT / "src/pneu_policy/pneu_policy",
            ROOT / "rigs/rail.yaml",
            ROOT / SETTINGS,
        ]
    )
    row, column = np.unravel_index(int(np.argmax(percent)), percent.shape)
    fine = agreeing(percent)
    lines = [
        "# Cells of one size in training, of another in the test: thesis 6.1",
        "",
        f"Made by `make cell-sizes`, from the sources, rig and settings {sources}.",
        "",
        "The cart of `rigs/rail.yaml` after a smooth target, its lines divided into so many cells"
        f" altogether; {errors.shape[1]} trained for each, {size.iterations} iterations. Percent"
        " by which the mean error in the test is more than with the cells of training.",
        "",
        f"The largest increase is {percent.max():.0f} % (trained with {cells[row]} cells, tested"
        f" with {cells[column]}); with {cells[fine]} cells and more, both in training and in the"
        f" test, it is {percent[fine:, fine:].max():.0f} %. In the thesis, with 30 to 1800 cells,"
        f" it is {THESIS} % at most.",
        "",
        "| cells | time step at most, us | error where it was trained, mm |",
        "|---|---|---|",
        *(
            f"| {count} | {1e6 * step_s:.0f} | {1e3 * errors[k, :, k].mean():.2f} |"
            for k, (count, step_s) in enumerate(found["grid"])
        ),
        "",
        "| trained with | " + " | ".join(f"{c}" for c in cells) + " |",
        "|---|" + "---|" * n,
        *(
            f"| {cells[k]} | " + " | ".join(f"{x:+.0f}" for x in percent[k]) + " |"
            for k in range(n)
        ),
        "",
        "![errors over cells](figures/cell_sizes.png)",
        "",
    ]
    write_whole(path, "\n".join(lines))


def main() -> int:
    """Runs the stages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    add_stages(parser, ("train", "judge", "page"))
    parser.add_argument("--size", choices=tuple(SIZES), default="small")
    add_workers(parser)
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "cell_sizes.md")
    asked = parser.parse_args()
    size = SIZES[asked.size]
    if "train" in asked.stages:
        train(size, Workers(asked.backend, asked.workers))
    if "judge" in asked.stages:
        judge(size, asked.workers)
    if "page" in asked.stages:
        page(size, asked.page)
        Console().print(f"{asked.page} is written")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
