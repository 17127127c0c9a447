# SPDX-License-Identifier: Apache-2.0
"""Thesis 7.5: a cart that learns in the full model, and one that learns in the simple model.

Stages, each skipped where its result is there already:

  match  the simple model to the full one -> ``rigs/rail_plate.yaml`` (thesis 7.4)
  train  policies by ``studies/settings/rail.yaml``, several seeds, one kept every few iterations
  judge  all of them, at all stages of their training, on the full model
  page   ``docs/simple_model.md`` and its figures

The thesis trains 10 policies of each for 400 iterations; ``--seeds 10 --iterations 400`` does.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from pneu_common.files import whole, write_whole
from pneu_policy.learn.networks import mean_action
from pneu_policy.learn.settings import load_document
from pneu_policy.learn.sweep import Workers
from pneu_policy.task.robots import Robots
from pneu_sim.rig import load_rig
from studies.digest import digest_of
from studies.stages import add_stages
from studies.training import add_workers
from studies.two_models import SEED, TITLES, Case, best, judge, last, match, told, train

ROOT = Path(__file__).resolve().parent.parent
OUT = Path("out") / "simple_model"
SETTINGS = Path("studies") / "settings" / "rail.yaml"
FULL, PLATE = Path("rigs/rail.yaml"), Path("rigs/rail_plate.yaml")


def case(seeds: int = 3, iterations: int | None = None) -> Case:
    """The cart, learnt in either model.

    Args:
        seeds: How many trainings in each.
        iterations: Of each; None is the settings file's.
    """
    document = load_document(ROOT / SETTINGS)
    if iterations is not None:
        document["iterations"] = iterations
    each = tuple(range(seeds))
    return Case("rail", OUT, FULL, PLATE, document, {"pde": each, "plate": each})


def excerpt(env: Robots, weights: list[Any]) -> dict[str, Any]:
    """One episode of one cart, millimetres and volts by control period.

    Args:
        env: The carts.
        weights: Of the policy.
    """
    seen, _ = env.reset(seed=SEED)
    position, target, volts = [], [], []
    for _ in range(env.settings.horizon):
        seen, *_, info = env.step(mean_action(weights, seen))
        position.append(round(1e3 * float(info["position"][0, 0]), 3))
        target.append(round(1e3 * float(info["target"][0, 0]), 3))
        volts.append(round(float(info["volts"][0, 0]), 3))
    return {"position_mm": position, "target_mm": target, "volts": volts}


def _told(values_m: list[float]) -> str:
    of = 1e3 * np.array(values_m)
    return f"{of.mean():.3g} ({of.min():.3g} to {of.max():.3g})"


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Error over iterations, and an excerpt with commands, as thesis figs. 7.6 and 7.7.

    Args:
        rows: All that was judged.
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
        at = sorted({r["iteration"] for r in rows})
        label: str | None = f"trained in {TITLES[kind]}, judged on {TITLES[on]}"
        for one in told(rows, kind, on):
            axes.semilogy(at, 1e3 * np.array(one), color=colour, label=label)
            label = None
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
    for each in (axes, *right):
        each.spines[["top", "right"]].set_visible(False)
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
            ROOT / SETTINGS,
        ]
    )
    draw(rows, path.parent / "figures" / "simple_model.png")
    iterations = max(r["iteration"] for r in rows)
    seeds = len({r["seed"] for r in rows})
    own, plate = last(rows, "pde", "pde"), last(rows, "plate", "plate")
    moved, stopped = last(rows, "plate", "pde"), best(rows, "plate", "pde")
    volts = matched["volts"]
    length_m = max(pipe.length_m for pipe in load_rig(ROOT / FULL).pipes.values())
    lines = [
        "# What a simple model teaches: thesis 7.5",
        "",
        f"Made by `make simple-model`, from the sources, rigs and settings {sources}.",
        "",
        f"`rigs/rail.yaml`: a cart after a smooth target, by a valve and {length_m:g} m of line on"
        " either side. The simple model has no lines; what its valves let through is matched to"
        " the full model, opening by opening, with the joint held (thesis 7.4), and all else is"
        " the same.",
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
        f"{seeds} policies each, {iterations} iterations of 64 episodes of 2 s; the thesis has"
        " 10 and 400 (`--seeds 10 --iterations 400`). Error: mean of the distance from the target,"
        " mm, after the first half second; in brackets the seeds' least and most.",
        "",
        "| trained in | judged on | error, mm | thesis |",
        "|---|---|---|---|",
        f"| the full model | the full model | {_told(own)} | 0.037 |",
        f"| the simple model | the simple model | {_told(plate)} | |",
        f"| the simple model | the full model | {_told(moved)} | 13.6 |",
        f"| the same, each at its best iteration | the full model | {_told(stopped)} | 0.55 |",
        "",
        f"The policy of the full model has {np.mean(own) / np.mean(moved):.3f} times the error of"
        f" the simple model's on the full model, and {np.mean(own) / np.mean(stopped):.3f} times"
        " that of its best iteration, which nobody can know without the full model.",
        "",
        "![errors over iterations, and an excerpt](figures/simple_model.png)",
        "",
    ]
    write_whole(path, "\n".join(lines))


def main() -> int:
    """Runs the stages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    add_stages(parser, ("match", "train", "judge", "page"))
    add_workers(parser)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--iterations", type=int)
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "simple_model.md")
    asked = parser.parse_args()
    console = Console()
    one = case(asked.seeds, asked.iterations)
    if "match" in asked.stages:
        match([one])
    if "train" in asked.stages:
        train([one], Workers(asked.backend, asked.workers))
    if "judge" in asked.stages:
        judge([one], asked.workers, excerpt)
    if "page" in asked.stages:
        page(one.rows, one.matched, asked.page)
        console.print(f"{asked.page} is written")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
