# SPDX-License-Identifier: Apache-2.0
"""Thesis 7.5: a cart that learns in the full model, and one that learns in the simple model.

Stages, each skipped where its result is there already:

  match  the simple model to the full one -> ``rigs/rail_plate.yaml`` (thesis 7.4)
  train  policies by ``studies/settings/rail_*.yaml``, several seeds, one kept every few iterations
  judge  all of them, at all stages of their training, on the full model
  page   ``docs/simple_model.md`` and its figures

The thesis trains 10 policies of each for 400 iterations; ``--seeds 10 --iterations 400`` does.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from pneu_common.errors import InputError
from pneu_common.files import whole, write_whole
from pneu_common.progress import progress
from pneu_policy.control.robot_policy import RobotPolicy
from pneu_policy.learn.networks import mean_action
from pneu_policy.learn.rollout import roll_out
from pneu_policy.learn.settings import TrainSettings, load_document
from pneu_policy.learn.sweep import Run, expand
from pneu_policy.task.robots import Robots, RobotSettings
from pneu_sim.lumped.match import Matched, match_thin_plate
from pneu_sim.rig.load import load_rig, save_rig
from studies.digest import digest_of
from studies.stages import add_stages

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "out" / "simple_model"
FULL, PLATE = "rigs/rail.yaml", "rigs/rail_plate.yaml"
KINDS = ("pde", "plate")
TITLES = {"pde": "the full model", "plate": "the simple model"}
SEED = 31_000
"""Of the episodes that policies are judged by."""
SETTLED = 0.25
"""Share of an episode that is not judged: the gas comes from rest."""


def match() -> dict[str, Any]:
    """The simple model, matched; writes its rig file."""
    rig = load_rig(ROOT / FULL)
    with progress("matching") as tell:
        found: Matched = match_thin_plate(
            rig, levels=5, progress=lambda share: tell("openings", share, "")
        )
    told = found.rig.model_copy(
        update={
            "name": "rail_plate",
            "description": "rigs/rail.yaml by the thin-plate model, its openings matched to the"
            " full model (thesis 7.4) by `make simple-model`.",
        }
    )
    save_rig(told, ROOT / PLATE)
    return {
        "volts": found.volts.tolist(),
        "scales": {name: of.tolist() for name, of in found.scales.items()},
        "rmse_pa": {name: of.tolist() for name, of in found.rmse_pa.items()},
        "unmatched_pa": {name: of.tolist() for name, of in found.unmatched_pa.items()},
    }


def runs_of(kind: str, seeds: int | None = None, iterations: int | None = None) -> list[Run]:
    """Trainings of a kind.

    Args:
        kind: ``pde`` or ``plate``.
        seeds: How many in place of the file's.
        iterations: Likewise.
    """
    document = load_document(ROOT / "studies" / "settings" / f"rail_{kind}.yaml")
    if seeds is not None:
        document["sweep"] = {"seed": list(range(seeds))}
    if iterations is not None:
        document["iterations"] = iterations
    return expand(document, OUT / "training" / kind)


def train(console: Console, workers: int, seeds: int | None, iterations: int | None) -> None:
    """Trains what is not trained yet.

    Args:
        console: Where to tell.
        workers: Trainings at a time.
        seeds: How many in place of the file's.
        iterations: Likewise.
    """
    for kind in KINDS:
        out = OUT / "training" / kind
        words = [sys.executable, "-m", "pneu_common.cli", "train"]
        words += [f"studies/settings/rail_{kind}.yaml", "-o", str(out), "--resume"]
        for run in runs_of(kind, seeds, iterations):
            words += ["--seed", str(run.settings.seed)]
        if iterations is not None:
            words += ["--iterations", str(iterations)]
        console.print(f"training in {TITLES[kind]}")
        subprocess.run([*words, "--workers", str(workers)], cwd=ROOT, check=True)


def judged_on(kind: str, model: str) -> RobotSettings:
    """Episodes by which a policy is judged on a model.

    Args:
        kind: In what it was trained; it sees what it saw there.
        model: ``pde`` or ``plate``.
    """
    document = load_document(ROOT / "studies" / "settings" / f"rail_{kind}.yaml")
    del document["sweep"]
    settings = TrainSettings(**document).env
    assert isinstance(settings, RobotSettings)
    return settings.model_copy(update={"rig": str(ROOT / (FULL if model == "pde" else PLATE))})


def _judge(kind: str, run: Run) -> list[dict[str, Any]]:
    files = sorted(run.folder.glob("policy_*.npz"))
    rows = []
    for model in KINDS if kind == "plate" else ("pde",):
        env = Robots(judged_on(kind, model))
        for file in files:
            weights = RobotPolicy.load(file).weights
            episodes = roll_out(env, lambda seen, w=weights: mean_action(w, seen), SEED)
            error = np.abs(episodes.error[round(SETTLED * len(episodes.error)) :])
            row = {
                "kind": kind,
                "on": model,
                "seed": run.settings.seed,
                "iteration": int(file.stem.split("_")[1]),
                "mean_mm": 1e3 * float(error.mean()),
                "rmse_mm": 1e3 * float(np.sqrt((error**2).mean())),
                "score": episodes.score,
            }
            if file == files[-1]:
                row |= _excerpt(env, weights)
            rows.append(row)
    return rows


def _excerpt(env: Robots, weights: list[Any]) -> dict[str, Any]:
    """One episode of one cart, millisecond by control period."""
    seen, _ = env.reset(seed=SEED)
    position, target, volts = [], [], []
    for _ in range(env.settings.horizon):
        seen, *_, info = env.step(mean_action(weights, seen))
        position.append(round(1e3 * float(info["position"][0, 0]), 3))
        target.append(round(1e3 * float(info["target"][0, 0]), 3))
        volts.append(round(float(info["volts"][0, 0]), 3))
    return {"position_mm": position, "target_mm": target, "volts": volts}


def judge(workers: int, seeds: int | None, iterations: int | None) -> list[dict[str, Any]]:
    """Every kept policy on the full model, and those of the simple one on that as well.

    Args:
        workers: At a time.
        seeds: How many in place of the file's.
        iterations: Likewise.
    """
    asked = [(kind, run) for kind in KINDS for run in runs_of(kind, seeds, iterations)]
    found: list[dict[str, Any]] = []
    jobs = joblib.Parallel(workers, return_as="generator")(
        joblib.delayed(_judge)(*one) for one in asked
    )
    with progress("judged") as tell:
        for done, rows in enumerate(jobs, 1):
            found += rows
            tell("trainings", done / len(asked), f"{rows[0]['kind']} {rows[0]['seed']}")
    return found


def errors(rows: list[dict[str, Any]], kind: str, on: str, best: bool = False) -> list[float]:
    """Mean error of every seed, mm, at the end of training or at its best iteration.

    Args:
        rows: All of them.
        kind: In what they were trained.
        on: On what they are judged.
        best: Whether the best iteration by this very error is taken.
    """
    own: dict[int, dict[int, float]] = {}
    for row in rows:
        if row["kind"] == kind and row["on"] == on:
            own.setdefault(row["seed"], {})[row["iteration"]] = row["mean_mm"]
    return [min(of.values()) if best else of[max(of)] for of in own.values()]


def _told(values: list[float]) -> str:
    return f"{np.mean(values):.3g} ({min(values):.3g} to {max(values):.3g})"


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Error over iterations, and an excerpt with commands, as thesis figs. 7.6 and 7.7.

    Args:
        rows: All of them.
        path: Picture.
    """
    figure = Figure(figsize=(11.0, 6.0), layout="constrained")
    grid = figure.add_gridspec(2, 2)
    axes = figure.add_subplot(grid[:, 0])
    styles = (
        ("pde", "pde", "tab:blue"),
        ("plate", "plate", "tab:grey"),
        ("plate", "pde", "tab:red"),
    )
    for kind, on, colour in styles:
        own = [r for r in rows if r["kind"] == kind and r["on"] == on]
        for seed in sorted({r["seed"] for r in own}):
            one = [r for r in own if r["seed"] == seed]
            label = f"trained in {TITLES[kind]}, judged on {TITLES[on]}" if seed == 0 else None
            told = [r["iteration"] for r in one], [r["mean_mm"] for r in one]
            axes.semilogy(*told, color=colour, label=label)
    axes.set(xlabel="iteration", ylabel="mean error, mm")
    axes.legend(frameon=False, fontsize="small")
    right = [figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])]
    for kind, colour in (("pde", "tab:blue"), ("plate", "tab:red")):
        own = [r for r in rows if r["kind"] == kind and r["on"] == "pde" and "volts" in r]
        time = 0.01 * np.arange(1, len(own[0]["volts"]) + 1)
        if kind == "pde":
            right[0].plot(time, own[0]["target_mm"], color="black", linewidth=3.0, alpha=0.2)
        right[0].plot(time, own[0]["position_mm"], color=colour, linewidth=1.0)
        right[1].plot(time, own[0]["volts"], color=colour, linewidth=0.8)
    right[0].set(ylabel="cart, mm (grey: target)")
    right[1].set(ylabel="command of the head's valve, V", xlabel="s")
    for one in (axes, *right):
        one.spines[["top", "right"]].set_visible(False)
    with whole(path) as aside:
        figure.savefig(aside, format="png", dpi=120)


def page(rows: list[dict[str, Any]], matched: dict[str, Any], path: Path) -> None:
    """Writes the page.

    Args:
        rows: All judged policies.
        matched: What the match found.
        path: The page.
    """
    sources = digest_of(
        [
            ROOT / "src/pneu_sim/pneu_sim",
            ROOT / "src/pneu_policy/pneu_policy",
            ROOT / FULL,
            ROOT / PLATE,
            *(ROOT / "studies" / "settings" / f"rail_{kind}.yaml" for kind in KINDS),
        ]
    )
    draw(rows, path.parent / "figures" / "simple_model.png")
    last = max(r["iteration"] for r in rows)
    seeds = len({r["seed"] for r in rows})
    own, plate = errors(rows, "pde", "pde"), errors(rows, "plate", "plate")
    moved, best = errors(rows, "plate", "pde"), errors(rows, "plate", "pde", True)
    volts = matched["volts"]
    lines = [
        "# What a simple model teaches: thesis 7.5",
        "",
        f"Made by `make simple-model`, from the sources, rigs and settings {sources}.",
        "",
        "`rigs/rail.yaml`: a cart after a smooth target, by a valve and a metre of line on either"
        " side. The simple model has no lines; what its valves let through is matched to the full"
        " model, opening by opening, with the joint held (thesis 7.4), and all else is the same.",
        "",
        "| command, V | " + " | ".join(f"{v:g}" for v in volts) + " |",
        "|---|" + "---|" * len(volts),
        *(
            f"| scale of the opening, valve {name} | " + " | ".join(f"{x:.2f}" for x in of) + " |"
            for name, of in matched["scales"].items()
        ),
        *(
            f"| error of pressures, kPa, {name} (unmatched) | "
            + " | ".join(
                f"{a / 1e3:.1f} ({b / 1e3:.1f})"
                for a, b in zip(of, matched["unmatched_pa"][name], strict=True)
            )
            + " |"
            for name, of in matched["rmse_pa"].items()
        ),
        "",
        f"{seeds} policies each, {last} iterations of 64 episodes of 2 s; the thesis has 10 and 400"
        " (`--seeds 10 --iterations 400`). Error: mean of the distance from the target, mm, after"
        " the first half second; in brackets the seeds' least and most.",
        "",
        "| trained in | judged on | error, mm | thesis |",
        "|---|---|---|---|",
        f"| the full model | the full model | {_told(own)} | 0.037 |",
        f"| the simple model | the simple model | {_told(plate)} | |",
        f"| the simple model | the full model | {_told(moved)} | 13.6 |",
        f"| the same, each at its best iteration there | the full model | {_told(best)} | 0.55 |",
        "",
        f"The policy of the full model has {np.mean(own) / np.mean(moved):.3f} times the error of"
        f" the simple model's on the full model, and {np.mean(own) / np.mean(best):.3f} times that"
        " of its best iteration, which nobody can know without the full model.",
        "",
        "![errors over iterations, and an excerpt](figures/simple_model.png)",
        "",
    ]
    write_whole(path, "\n".join(lines))


def main() -> int:
    """Runs the stages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    add_stages(parser, ("match", "train", "judge", "page"))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seeds", type=int)
    parser.add_argument("--iterations", type=int)
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "simple_model.md")
    asked = parser.parse_args()
    stages = asked.stages
    console = Console()
    OUT.mkdir(parents=True, exist_ok=True)
    files = {name: OUT / f"{name}.json" for name in ("match", "judge")}
    if "match" in stages and not (files["match"].exists() and (ROOT / PLATE).exists()):
        write_whole(files["match"], json.dumps(match()))
    if "train" in stages:
        train(console, asked.workers, asked.seeds, asked.iterations)
    if "judge" in stages:
        rows = judge(asked.workers, asked.seeds, asked.iterations)
        write_whole(files["judge"], json.dumps(rows))
    if "page" in stages:
        for name, file in files.items():
            if not file.exists():
                raise InputError(f"page: there is no {file.name} yet; the stage {name} makes it")
        found, matched = (
            json.loads(files[n].read_text(encoding="utf-8")) for n in ("judge", "match")
        )
        page(found, matched, asked.page)
        console.print(f"{asked.page} is written")
    return 0


if __name__ == "__main__":
    sys.exit(main())
