# SPDX-License-Identifier: Apache-2.0
"""Thesis 7.7: carts with poles, arms and a dog that learn in either model, their sizes at random.

Tasks: a pole kept upright while its cart follows a target, a pole swung up, a hand that follows a
target, a creature that walks. Each with the rig as it is and with sizes drawn at random from the
thesis' ranges; the dog as it is alone. Stages, each of which goes on where it ended:

  match  the simple model of every rig to its full one
  train  policies by ``studies/settings``: balance, swing_up, arm, dog
  judge  all of them on the full model
  page   ``docs/configurations.md`` and its figures

``--size medium`` gives a pole that swings up the iterations that it needs, and two trainings in
either model: some two hours on two cores. ``--size full`` draws 100 carts and 20 arms, with eight
trainings in each simple model, twelve for the dog, as in the thesis. ``--tasks`` takes some of the
tasks alone.
"""

import argparse
import math
from collections.abc import Callable
from dataclasses import dataclass
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
from pneu_sim.bodies.arm import Arm
from pneu_sim.bodies.cart_pole import CartPole
from pneu_sim.rig.load import load_rig
from pneu_sim.rig.schema import Rig
from studies.digest import digest_of
from studies.poses import draw_strip, film
from studies.stages import add_stages
from studies.training import add_workers
from studies.two_models import SEED, Case, judge, match, told, train, written

ROOT = Path(__file__).resolve().parent.parent
OUT = Path("out") / "configurations"
SETTINGS = Path("studies") / "settings"
TOTAL_KG = 2.0
"""Of cart and rod together (thesis 7.7.1)."""
STANDARD_M_S2 = 9.80665


@dataclass(frozen=True)
class Size:
    """How large a study is.

    Attributes:
        drawn: Rigs drawn at random by task, besides the one as it is.
        full: Trainings in each full model, by task.
        plate: Trainings in each simple model, by task.
        iterations: Of each, by task.
    """

    drawn: dict[str, int]
    full: dict[str, int]
    plate: dict[str, int]
    iterations: dict[str, int]


TASKS = ("balance", "swing_up", "arm", "dog")
SIZES = {
    "small": Size(
        dict.fromkeys(TASKS, 1) | {"dog": 0},
        dict.fromkeys(TASKS, 1),
        dict.fromkeys(TASKS, 1),
        dict.fromkeys(TASKS, 100) | {"dog": 120},
    ),
    "medium": Size(
        dict.fromkeys(TASKS, 1) | {"dog": 0},
        dict.fromkeys(TASKS, 1) | {"swing_up": 2},
        dict.fromkeys(TASKS, 1) | {"swing_up": 2},
        dict.fromkeys(TASKS, 100) | {"dog": 120, "swing_up": 400},
    ),
    "full": Size(
        {"balance": 100, "swing_up": 100, "arm": 20, "dog": 0},
        dict.fromkeys(TASKS, 1),
        dict.fromkeys(TASKS, 8) | {"dog": 12},
        dict.fromkeys(TASKS, 400),
    ),
}

TITLES = {
    "balance": "A pole upright, its cart after a target",
    "swing_up": "A pole swung up",
    "arm": "A hand after a target",
    "dog": "A creature that walks",
}
SUCCESS = {
    "balance": "the pole within 15 degrees of upright and the cart within 2 % of its track from the"
    " target",
    "swing_up": "the pole within 3 degrees of upright and slow",
    "arm": "the hand within 1 % of the arm's length doubled from the target",
    "dog": "half a metre a second or faster",
}
THESIS = {
    "balance": "fig. 7.9, right: the full model's policies ahead of the simple one's on the full"
    " model, for some configurations by little, for others the simple one is not applicable at all",
    "swing_up": "fig. 7.9, left: the same",
    "arm": "fig. 7.10: success about 40 % on average at the end of learning",
    "dog": "fig. 7.11: the simple model's policies underperform on the full one",
}


def _resized(rig: Rig, cylinder: dict[str, Any], lines_mm2: float, body: Any, name: str) -> Rig:
    cylinders = {n: c.model_copy(update=cylinder) for n, c in rig.cylinders.items()}
    pipes = {n: p.model_copy(update={"area_m2": 1e-6 * lines_mm2}) for n, p in rig.pipes.items()}
    return rig.model_copy(
        update={"name": name, "cylinders": cylinders, "pipes": pipes, "bodies": body}
    )


def _bore(area_mm2: float) -> dict[str, float]:
    """Bore of a piston of an area, and a rod in proportion as those of ISO 6432."""
    bore = 2.0 * math.sqrt(1e-6 * area_mm2 / math.pi)
    return {"bore_m": bore, "rod_m": 0.375 * bore}


def drawn_cart(rig: Rig, number: int) -> Rig:
    """A cart with a pole, its sizes at random (thesis 7.7.1).

    Args:
        rig: The rig as it is.
        number: Which of them, as seed.
    """
    rng = np.random.default_rng([77, number])
    track, rod = _between(rng, 0.6, 4.0), _between(rng, 0.1, 1.0)
    area, line, ratio = _between(rng, 50, 500), _between(rng, 5, 50), _between(rng, 0.2, 5.0)
    body = rig.bodies["cart_pole"]
    assert isinstance(body, CartPole)
    tip = TOTAL_KG * ratio / (1.0 + ratio)
    changed = body.model_copy(
        update={
            "cart_kg": TOTAL_KG - tip,
            "rod": body.rod.model_copy(update={"length_m": rod, "tip_kg": tip}),
            "closed_at_m": -0.5 * track,
        }
    )
    cylinder = {"stroke_m": track} | _bore(area)
    return _resized(rig, cylinder, line, {"cart_pole": changed}, f"cart_pole_{number}")


def drawn_arm(rig: Rig, number: int) -> Rig:
    """An arm, its sizes at random (thesis 7.7.2), that can hold its links out level.

    Cranks stay as they are. Those that are too weak to hold themselves are drawn anew.

    Args:
        rig: The rig as it is.
        number: Which of them, as seed.
    """
    rng = np.random.default_rng([772, number])
    body = rig.bodies["arm"]
    assert isinstance(body, Arm)
    supply = max(r.pressure_pa for r in rig.reservoirs.values()) - rig.ambient.pressure_pa
    while True:
        elbow_kg, hand_kg = _between(rng, 0.2, 2.0), _between(rng, 0.2, 2.0)
        upper, fore = _between(rng, 0.15, 0.4), _between(rng, 0.15, 0.4)
        area, line = _between(rng, 100, 700), _between(rng, 5, 50)
        changed = body.model_copy(
            update={
                "upper_arm": body.upper_arm.model_copy(
                    update={"length_m": upper, "tip_kg": elbow_kg}
                ),
                "forearm": body.forearm.model_copy(update={"length_m": fore, "tip_kg": hand_kg}),
            }
        )
        own = [body.upper_arm.mass_kg, body.forearm.mass_kg]
        moment = STANDARD_M_S2 * (
            upper * (0.5 * own[0] + elbow_kg + own[1] + hand_kg) + fore * (0.5 * own[1] + hand_kg)
        )
        lever = math.hypot(*body.shoulder_crank.pin_m)
        if moment < 0.5 * supply * 1e-6 * area * lever:
            break
    return _resized(rig, _bore(area), line, {"arm": changed}, f"arm_{number}")


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """A size, its logarithm even between two."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def _cart_document(document: dict[str, Any], rig: Rig) -> None:
    env, stroke = document["env"], rig.cylinders["cart"].stroke
    goal, end = env["goal"], 0.49 * stroke
    env["recipe"]["encoders"]["cart"]["range"] = 0.5 * stroke
    if goal["kind"] == "track":
        sway = min(0.3, 0.3 * stroke)
        goal["ranges"] = {"cart": [-sway, sway]}
        goal["within"]["cart"] = [-end, end]
        goal["near"] = 0.02 * stroke
    else:
        goal["rail_m"] = [-end, end]
        env["start"]["cart"] = [-0.3 * stroke, 0.3 * stroke]


def _arm_document(document: dict[str, Any], rig: Rig) -> None:
    env, body = document["env"], rig.bodies["arm"]
    assert isinstance(body, Arm)
    lengths = [body.upper_arm.length_m, body.forearm.length_m]
    env["recipe"]["chain"]["lengths_m"] = lengths
    env["goal"]["near"] = 0.02 * sum(lengths)


def _as_it_is(document: dict[str, Any], rig: Rig) -> None:
    del document, rig


MADE: dict[str, tuple[str, Callable[[Rig, int], Rig] | None, Callable[[dict[str, Any], Rig], None]]]
MADE = {
    "balance": ("cart_pole", drawn_cart, _cart_document),
    "swing_up": ("cart_pole", drawn_cart, _cart_document),
    "arm": ("arm", drawn_arm, _arm_document),
    "dog": ("dog", None, _as_it_is),
}
"""By task its rig, how others are drawn, and what of its settings goes with their sizes."""


def cases(size: Size, tasks: tuple[str, ...] = TASKS) -> dict[str, list[Case]]:
    """All cases, by task.

    Args:
        size: How large the study is.
        tasks: Which tasks.
    """
    found: dict[str, list[Case]] = {}
    for task in tasks:
        name, draw, fit = MADE[task]
        base = load_rig(ROOT / "rigs" / f"{name}.yaml")
        rigs = [base] + ([draw(base, k) for k in range(size.drawn[task])] if draw else [])
        found[task] = []
        for rig in rigs:
            document = load_document(ROOT / SETTINGS / f"{task}.yaml")
            document["iterations"] = size.iterations[task]
            fit(document, rig)
            folder = OUT / f"{task}_{rig.name}"
            seeds = {"pde": tuple(range(size.full[task])), "plate": tuple(range(size.plate[task]))}
            found[task].append(
                Case(
                    folder.name, folder, written(rig, folder / "rig.yaml"), folder / "plate.yaml",
                    document, seeds,
                )
            )  # fmt: skip
    return found


def excerpt(env: Robots, weights: list[Any]) -> dict[str, Any]:
    """One episode of one robot: where its encoders are, by control period.

    Args:
        env: The robots.
        weights: Of the policy.
    """
    seen, _ = env.reset(seed=SEED)
    path, lasted = [], env.settings.horizon
    for k in range(env.settings.horizon):
        seen, _, ended, _, info = env.step(mean_action(weights, seen))
        place = [round(float(x), 4) for x in info["position"][0]]
        target = [round(float(x), 4) for x in info["target"][0]] if "target" in info else []
        path.append([place, target])
        if ended[0]:
            lasted = k + 1
            break
    return {"path": path, "lasted_steps": lasted, "encoders": list(env.recipe.encoders)}


def sizes_of(rig: Rig) -> str:
    """The sizes that are drawn, in words.

    Args:
        rig: The rig.
    """
    cylinder, pipe = next(iter(rig.cylinders.values())), next(iter(rig.pipes.values()))
    area, line = 1e6 * cylinder.areas[0], 1e6 * (pipe.area_m2 or 0.0)
    body = next(iter(rig.bodies.values()))
    if isinstance(body, CartPole):
        return (
            f"track {cylinder.stroke:.2f} m, piston {area:.0f} mm^2, line {line:.0f} mm^2, rod"
            f" {body.rod.length_m:.2f} m, rod to cart {body.rod.tip_kg / body.cart_kg:.2f}"
        )
    if isinstance(body, Arm):
        return (
            f"masses {body.upper_arm.tip_kg:.2f} and {body.forearm.tip_kg:.2f} kg, links"
            f" {body.upper_arm.length_m:.2f} and {body.forearm.length_m:.2f} m, pistons"
            f" {area:.0f} mm^2, lines {line:.0f} mm^2"
        )
    return "as it is"


def draw(found: dict[str, list[Case]], path: Path) -> None:
    """Return and success over iterations, as thesis figs. 7.9 to 7.11.

    Args:
        found: By task.
        path: Picture.
    """
    figure = Figure(figsize=(3.4 * len(found), 6.0), layout="constrained")
    grid = figure.subplots(2, len(found), squeeze=False)
    styles = (
        ("plate", "plate", "tab:blue", "simple, judged on simple"),
        ("pde", "pde", "tab:purple", "full, judged on full"),
        ("plate", "pde", "tab:green", "simple, judged on full"),
    )
    for column, (task, of) in enumerate(found.items()):
        for axes, what in zip(grid[:, column], ("score", "success"), strict=True):
            for kind, on, colour, words in styles:
                at = sorted({row["iteration"] for row in of[0].rows})
                curves = [one for case in of for one in told(case.rows, kind, on, what)]
                for curve in curves:
                    axes.plot(at, curve, color=colour, linewidth=0.6, alpha=0.4)
                axes.plot(at, np.mean(curves, axis=0), color=colour, linewidth=2.0, label=words)
            axes.spines[["top", "right"]].set_visible(False)
        grid[0, column].set(title=TITLES[task])
        grid[0, column].title.set_fontsize("small")
        grid[1, column].set(xlabel="iteration", ylim=(0.0, 1.0))
    grid[0, 0].set(ylabel="return")
    grid[1, 0].set(ylabel="share of time that is a success")
    grid[0, 0].legend(frameon=False, fontsize="small", title="trained in")
    with whole(path) as aside:
        figure.savefig(aside, format="png", dpi=110)


def page(found: dict[str, list[Case]], size: str, path: Path) -> None:
    """Writes the page.

    Args:
        found: By task.
        size: How large the study is, by name.
        path: The page.
    """
    used = sorted({MADE[task][0] for task in found})
    sources = digest_of(
        [
            ROOT / "src/pneu_sim/pneu_sim",
            ROOT / "src/pneu_policy/pneu_policy",
            *(ROOT / "rigs" / f"{name}.yaml" for name in used),
            *(ROOT / SETTINGS / f"{task}.yaml" for task in found),
        ]
    )
    figures = path.parent / "figures"
    draw(found, figures / "configurations.png")
    lines = [
        "# Poles, arms, a dog: thesis 7.7",
        "",
        f"Made by `make configurations` (`--size {size}`), from the sources, rigs and settings"
        f" {sources}.",
        "",
        "Policies trained in the full model and in the simple one that was matched to it, judged"
        " over 64 or more episodes without exploration, at the end of training; the first quarter"
        " of each is not counted. The first row of each table is the rig as it stands in `rigs`,"
        " the others are drawn at random from the thesis' ranges, and none is left out. Where there"
        " are several trainings, which differ by their seeds, each has its figure.",
        "",
    ]
    for task, of in found.items():
        lines += [
            f"## {TITLES[task]}",
            "",
            f"Success: {SUCCESS[task]}. {of[0].document['iterations']} iterations. In the thesis,"
            f" {THESIS[task]}.",
            "",
            "| robot | success, full on full | simple on simple | simple on full |"
            " return, full on full | simple on simple | simple on full |",
            "|---|---|---|---|---|---|---|",
        ]
        for case in of:
            cells = []
            for what, form in (("success", "{:.0f} %"), ("score", "{:.0f}")):
                for kind, on in (("pde", "pde"), ("plate", "plate"), ("plate", "pde")):
                    ends = [one[-1] for one in told(case.rows, kind, on, what)]
                    scale = 100.0 if what == "success" else 1.0
                    cells.append(", ".join(form.format(scale * end) for end in ends))
            lines.append(f"| {sizes_of(load_rig(case.rig))} | {' | '.join(cells)} |")
        own = [r for r in of[0].rows if r["kind"] == "pde" and "path" in r]
        if own:
            rig = load_rig(of[0].rig)
            draw_strip(rig, own[0], figures / f"learnt_{task}.png")
            film(rig, own[0], of[0].document["env"]["recipe"]["period_s"],
                 figures / f"learnt_{task}.gif")  # fmt: skip
            lines += [
                "",
                f"![poses](figures/learnt_{task}.png)",
                "",
                f"[As a film](figures/learnt_{task}.gif), at the speed of life.",
            ]
        lines += [""]
    lines += ["![return and success over iterations](figures/configurations.png)", ""]
    write_whole(path, "\n".join(lines))


def main() -> int:
    """Runs the stages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    add_stages(parser, ("match", "train", "judge", "page"))
    parser.add_argument("--size", choices=tuple(SIZES), default="small")
    parser.add_argument("--tasks", nargs="+", choices=TASKS, default=TASKS)
    add_workers(parser)
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "configurations.md")
    asked = parser.parse_args()
    found = cases(SIZES[asked.size], tuple(asked.tasks))
    all_of_them = [case for of in found.values() for case in of]
    if "match" in asked.stages:
        match(all_of_them, asked.workers)
    if "train" in asked.stages:
        train(all_of_them, Workers(asked.backend, asked.workers))
    if "judge" in asked.stages:
        judge(all_of_them, asked.workers, excerpt)
    if "page" in asked.stages:
        page(found, asked.size, asked.page)
        Console().print(f"{asked.page} is written")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
