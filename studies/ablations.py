# SPDX-License-Identifier: Apache-2.0
"""Thesis 7.6: how much the simple model costs as a cart, its cylinder and its lines change.

Four sizes are changed, one at a time, about ``rigs/rail.yaml``; for each value the simple model is
matched, and policies learn in either. Stages, each of which goes on where it ended:

  match  the simple model of every rig to its full one
  train  policies by ``studies/settings/rail.yaml``
  judge  all of them on the full model
  page   ``docs/ablations.md`` and its figure

``--size full`` takes the thesis' six values and ten seeds of 400 iterations.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from pneu_common.files import whole, write_whole
from pneu_policy.learn.settings import load_document
from pneu_policy.learn.sweep import Workers
from pneu_sim.rig.load import load_rig
from pneu_sim.rig.schema import Rig
from studies.digest import digest_of
from studies.stages import add_stages
from studies.training import add_workers
from studies.two_models import Case, best, judge, last, match, train, written

ROOT = Path(__file__).resolve().parent.parent
OUT = Path("out") / "ablations"
SETTINGS = Path("studies") / "settings" / "rail.yaml"
BASE = Path("rigs") / "rail.yaml"
SWAY_M = 0.1
"""Most that targets go to either side of the middle; a third of a shorter stroke."""
CELLS = 25
"""Most that a line is divided into; beyond 2.5 m its cells are longer than the rig's own."""
STANDARD_M_S2 = 9.80665


@dataclass(frozen=True)
class Size:
    """How large a study is.

    Attributes:
        seeds: Trainings by kind of model.
        iterations: Of each.
        values: How many of each ablation, evenly from those that the thesis spans.
    """

    seeds: dict[str, tuple[int, ...]]
    iterations: int
    values: int


SIZES = {
    "small": Size({"pde": (0,), "plate": (0, 1)}, 100, 3),
    "full": Size({"pde": (0,), "plate": tuple(range(10))}, 400, 6),
}


def _cylinder(rig: Rig, **changes: Any) -> Rig:
    cart = rig.cylinders["cart"].model_copy(update=changes)
    return rig.model_copy(update={"cylinders": {"cart": cart}})


def longer_cylinder(rig: Rig, stroke_m: float) -> Rig:
    """The cart by a cylinder of another stroke, its start in the middle.

    Args:
        rig: The rig.
        stroke_m: Stroke, m.
    """
    body = rig.bodies["cart"]
    slide = body.slide.model_copy(update={"start": 0.5 * stroke_m})  # type: ignore[union-attr]
    bodies = {"cart": body.model_copy(update={"slide": slide})}
    return _cylinder(rig, stroke_m=stroke_m).model_copy(update={"bodies": bodies})


def wider_cylinder(rig: Rig, area_mm2: float) -> Rig:
    """The cart by a cylinder of another bore, its rod thicker alike.

    Args:
        rig: The rig.
        area_mm2: Area of the piston, mm^2.
    """
    was = rig.cylinders["cart"]
    bore = 2.0 * float(np.sqrt(1e-6 * area_mm2 / np.pi))
    return _cylinder(rig, bore_m=bore, rod_m=was.rod_m * bore / was.bore_m)  # type: ignore[operator]


def longer_lines(rig: Rig, length_m: float) -> Rig:
    """The cart with other lines from its valves to its cylinder.

    Args:
        rig: The rig.
        length_m: Length of each, m.
    """
    pipes = {n: p.model_copy(update={"length_m": length_m}) for n, p in rig.pipes.items()}
    return rig.model_copy(update={"pipes": pipes})


def lighter_load(rig: Rig, ratio: float) -> Rig:
    """The cart with another mass.

    Args:
        rig: The rig.
        ratio: Greatest force of the gas over the weight.
    """
    supply = max(r.pressure_pa for r in rig.reservoirs.values()) - rig.ambient.pressure_pa
    force = supply * rig.cylinders["cart"].areas[0]
    body = rig.bodies["cart"].model_copy(update={"mass_kg": force / (ratio * STANDARD_M_S2)})
    return rig.model_copy(update={"bodies": {"cart": body}})


@dataclass(frozen=True)
class Ablation:
    """A size that is changed.

    Attributes:
        title: What it is, with its unit.
        change: Makes a rig of another size.
        now: What it is in the rig that is changed.
        ends: Least and most value, as in the thesis.
        trend: What the thesis found.
    """

    title: str
    change: Callable[[Rig, float], Rig]
    now: float
    ends: tuple[float, float]
    trend: str

    def values(self, count: int) -> list[float]:
        """Sizes, geometrically from end to end.

        Args:
            count: How many; of three the middle one is the rig as it is.
        """
        if count == 3:
            return [self.ends[0], self.now, self.ends[1]]
        return [float(v) for v in np.geomspace(*self.ends, count)]


def ablations(rig: Rig) -> dict[str, Ablation]:
    """What is changed.

    Args:
        rig: The rig that is changed.
    """
    supply = max(r.pressure_pa for r in rig.reservoirs.values()) - rig.ambient.pressure_pa
    area = rig.cylinders["cart"].areas[0]
    weight = rig.bodies["cart"].mass_kg * STANDARD_M_S2  # type: ignore[union-attr]
    cylinder = rig.cylinders["cart"]
    return {
        "area": Ablation(
            "area of the piston, mm^2", wider_cylinder, 1e6 * area, (30.0, 500.0),
            "the simple model falls behind as it grows",
        ),
        "stroke": Ablation(
            "stroke of the cylinder, m", longer_cylinder, cylinder.stroke, (0.04, 1.0),
            "no change",
        ),
        "force": Ablation(
            "greatest force over the weight", lighter_load, supply * area / weight, (1.0, 50.0),
            "the simple model falls behind as it grows",
        ),
        "line": Ablation(
            "length of each line, m", longer_lines, rig.pipes["head_line"].length_m, (0.2, 10.0),
            "the simple model falls behind most of all",
        ),
    }  # fmt: skip


def document_of(rig: Rig, iterations: int) -> dict[str, Any]:
    """Fields of `TrainSettings` for a cart.

    Args:
        rig: The cart.
        iterations: Of the training.
    """
    document = load_document(ROOT / SETTINGS) | {"iterations": iterations}
    stroke = rig.cylinders["cart"].stroke
    middle, sway = 0.5 * stroke, min(SWAY_M, stroke / 3.0)
    env = document["env"]
    length = rig.pipes["head_line"].length_m
    env["dx_m"] = max(rig.grid.dx_m, length / CELLS)
    env["goal"]["ranges"] = {"cart": [middle - sway, middle + sway]}
    env["recipe"]["encoders"]["cart"] |= {"centre": middle, "range": max(middle, sway)}
    return document


def cases(size: Size, only: Sequence[str]) -> dict[str, list[tuple[float, Case]]]:
    """All cases, by ablation with their values; the rig as it is stands in each of them.

    Args:
        size: How large the study is.
        only: Ablations that are made.
    """
    base = load_rig(ROOT / BASE)
    found: dict[str, list[tuple[float, Case]]] = {}
    for name, ablation in ablations(base).items():
        if name not in only:
            continue
        found[name] = []
        for value in ablation.values(size.values):
            same = value == ablation.now
            rig = base if same else ablation.change(base, value)
            word = "as_it_is" if same else f"{name}_{value:.3g}"
            rig = rig.model_copy(update={"name": f"rail_{word}".replace(".", "_")})
            folder = OUT / word
            one = Case(
                word, folder, written(rig, folder / "rig.yaml"), folder / "plate.yaml",
                document_of(rig, size.iterations), size.seeds,
            )  # fmt: skip
            found[name].append((value, one))
    return found


def distinct(found: dict[str, list[tuple[float, Case]]]) -> list[Case]:
    """Each case once.

    Args:
        found: By ablation.
    """
    return list({case.name: case for of in found.values() for _, case in of}.values())


def draw(found: dict[str, list[tuple[float, Case]]], path: Path) -> None:
    """Errors over what was changed, as thesis fig. 7.8.

    Args:
        found: By ablation.
        path: Picture.
    """
    named = ablations(load_rig(ROOT / BASE))
    figure = Figure(figsize=(11.0, 7.0), layout="constrained")
    grid = figure.subplots(2, 2, sharey=True)
    for axes, (name, of) in zip(grid.flat, found.items(), strict=False):
        for kind, colour, way, words in (
            ("pde", "tab:blue", last, "the full model"),
            ("plate", "tab:red", best, "the simple model, its best iteration"),
            ("plate", "tab:orange", last, "the simple model, its last iteration"),
        ):
            each = [1e3 * np.array(way(case.rows, kind, "pde")) for _, case in of]
            at = [value for value, _ in of]
            axes.loglog(at, [e.mean() for e in each], "o-", color=colour, label=words)
            axes.vlines(at, [e.min() for e in each], [e.max() for e in each], color=colour)
        axes.set(xlabel=named[name].title)
        axes.set_xticks([value for value, _ in of], [f"{value:.3g}" for value, _ in of])
        axes.set_xticks([], minor=True)
        axes.spines[["top", "right"]].set_visible(False)
    for axes in grid[:, 0]:
        axes.set(ylabel="mean error, mm")
    grid[0, 0].legend(frameon=False, fontsize="small", title="trained in")
    with whole(path) as aside:
        figure.savefig(aside, format="png", dpi=120)


def page(found: dict[str, list[tuple[float, Case]]], path: Path) -> None:
    """Writes the page.

    Args:
        found: By ablation.
        path: The page.
    """
    sources = digest_of(
        [
            ROOT / "src/pneu_sim/pneu_sim",
            ROOT / "src/pneu_policy/pneu_policy",
            ROOT / BASE,
            ROOT / SETTINGS,
        ]
    )
    draw(found, path.parent / "figures" / "ablations.png")
    first = distinct(found)[0]
    seeds, iterations = first.seeds, first.document["iterations"]
    lines = [
        "# When a simple model is enough: thesis 7.6",
        "",
        f"Made by `make ablations`, from the sources, rig and settings {sources}.",
        "",
        "The cart of `rigs/rail.yaml` after a smooth target, one of its sizes changed at a time,"
        f" the simple model matched anew. {len(seeds['pde'])} trained in the full model,"
        f" {len(seeds['plate'])} in the simple one, {iterations} iterations; all are judged on the"
        " full model. Mean error, mm, in brackets the seeds' least and most. The simple model's"
        " best iteration is chosen by that very error, as in the thesis. A line is divided into"
        f" {CELLS} cells at most.",
        "",
    ]
    named = ablations(load_rig(ROOT / BASE))
    for name, of in found.items():
        ablation = named[name]
        lines += [
            f"## {ablation.title[0].upper()}{ablation.title[1:]}",
            "",
            "| | in the full model | in the simple one, best iteration | last iteration |"
            " best over full | last over full |",
            "|---|---|---|---|---|---|",
        ]
        for value, case in of:
            own, stopped, ended = (
                1e3 * np.array(way(case.rows, kind, "pde"))
                for way, kind in ((last, "pde"), (best, "plate"), (last, "plate"))
            )
            told = (f"{e.mean():.2f} ({e.min():.2f} to {e.max():.2f})" for e in (stopped, ended))
            lines.append(
                f"| {value:.3g} | {own.mean():.2f} | {' | '.join(told)} |"
                f" {stopped.mean() / own.mean():.2f} | {ended.mean() / own.mean():.2f} |"
            )
        lines += ["", f"In the thesis: {ablation.trend}.", ""]
    lines += ["![errors over sizes](figures/ablations.png)", ""]
    write_whole(path, "\n".join(lines))


def main() -> int:
    """Runs the stages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    add_stages(parser, ("match", "train", "judge", "page"))
    parser.add_argument("--size", choices=tuple(SIZES), default="small")
    names = tuple(ablations(load_rig(ROOT / BASE)))
    parser.add_argument("--only", nargs="+", choices=names, default=names)
    add_workers(parser)
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "ablations.md")
    asked = parser.parse_args()
    console = Console()
    found = cases(SIZES[asked.size], asked.only)
    all_of_them = distinct(found)
    if "match" in asked.stages:
        match(all_of_them, asked.workers)
    if "train" in asked.stages:
        train(all_of_them, Workers(asked.backend, asked.workers))
    if "judge" in asked.stages:
        judge(all_of_them, asked.workers)
    if "page" in asked.stages:
        page(found, asked.page)
        console.print(f"{asked.page} is written")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
