# SPDX-License-Identifier: Apache-2.0
"""Three arms push a cylinder along paths: policies of one model and of an ensemble (thesis 2.9).

Stages, each skipped where its result is there already:

  train     policies by ``studies/settings/push_*.yaml``, several seeds -> ``policies/``
  simulate  all of them on plants with a hidden truth, in their own time
  live      all of them on emulated arms, each behind its bridge, over the graph
  page      ``docs/pushing.md`` and its figure

The truth is that of the arm which the models were identified on, and a cylinder half, as, and twice
as heavy as in the models. Every policy is run, none is chosen; what fell or was lost counts as it
is.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from ruamel.yaml import YAML

from pneu_common.errors import InputError
from pneu_common.files import whole, write_whole
from pneu_common.progress import progress
from pneu_hw_bridge.hand_lab.hidden import open_truth
from pneu_policy.control.push_policy import PushPolicy
from pneu_policy.judge.pushed import Pushed, push_plant
from pneu_policy.learn.settings import load_document
from pneu_policy.learn.sweep import Run, expand
from pneu_policy.learn.trainer import POLICY
from pneu_policy.live.pushed_bag import pushed_in
from pneu_policy.task.push_paths import PathKind, PushPath
from pneu_sim.hand.loading import Hand
from pneu_sim.hand.truth import Change, Truth
from studies.digest import digest_of
from studies.stages import add_stages

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "out" / "pushing"
POLICIES = ROOT / "policies"
HAND = ROOT / "scenes/phantom/pushing.yaml"
HIDDEN = ROOT / "scenes/phantom/hidden.json"
KINDS = ("single", "ensemble")
MASSES = (0.5, 1.0, 2.0)
SECONDS = 8.0
LIVE_RATE = 0.2
"""Seconds of the emulated plant in one of the machine's, so that a busy machine keeps up."""


@dataclass(frozen=True)
class Course:
    """A path of the judgement.

    Attributes:
        kind: Its kind.
        reach_m: Furthest from the middle.
        period_s: Of a round, or of the quickest sine.
        seed: Its seed; training draws others.
    """

    kind: PathKind
    reach_m: float
    period_s: float
    seed: int

    def path(self) -> PushPath:
        """The path."""
        return PushPath(self.kind, self.reach_m, self.period_s, self.seed)


COURSES = (
    Course("circle", 0.03, 5.0, 1),
    Course("circle", 0.03, 7.0, 2),
    Course("eight", 0.03, 7.0, 3),
    Course("wander", 0.03, 4.0, 901),
    Course("wander", 0.03, 6.0, 902),
    Course("wander", 0.03, 8.0, 903),
)
LIVE = COURSES[0]


def truth_of(mass: float) -> Truth:
    """What is hidden: the arm's, of all three, and the cylinder's mass.

    Args:
        mass: Times that of the models.
    """
    arms = list(Hand(HAND).settings.arms)
    changes = []
    for change in open_truth(HIDDEN).model:
        own = arms if change.name.startswith("phantom_") else [""]
        changes += [change.but(name=change.name.replace("phantom_", f"{a}_")) for a in own]
    changes.append(Change(of="geom", name="object", set="mass", times=mass))
    return Truth(model=tuple(changes))


def runs_of(kind: str) -> list[Run]:
    """Trainings of a kind.

    Args:
        kind: ``single`` or ``ensemble``.
    """
    settings = ROOT / "studies" / "settings" / f"push_{kind}.yaml"
    return expand(load_document(settings), OUT / "training" / kind)


def kept(kind: str, run: Run) -> Path:
    """Where a policy is kept.

    Args:
        kind: ``single`` or ``ensemble``.
        run: Its training.
    """
    return POLICIES / f"push_{kind}_{run.settings.seed}.npz"


def trained(path: Path, run: Run) -> bool:
    """Whether a policy is there and was trained as a run asks.

    Args:
        path: Its file.
        run: The run.
    """
    return path.exists() and run.made(PushPolicy.load(path).training)


def train(console: Console, workers: int) -> None:
    """Trains what is not trained as its settings say.

    Args:
        console: Where to tell.
        workers: Trainings at a time.
    """
    for kind in KINDS:
        runs = runs_of(kind)
        if all(trained(kept(kind, run), run) for run in runs):
            continue
        out = OUT / "training" / kind
        words = [sys.executable, "-m", "pneu_common.cli", "train"]
        words += [f"studies/settings/push_{kind}.yaml", "-o", str(out), "--resume"]
        console.print(f"training {kind}")
        subprocess.run([*words, "--workers", str(workers)], cwd=ROOT, check=True)
        for run in runs:
            shutil.copyfile(run.folder / POLICY, kept(kind, run))


def _plain(pushed: Pushed) -> dict[str, Any]:
    return {
        "rms_mm": 1e3 * pushed.rms_m,
        "thing_mm": np.round(1e3 * pushed.thing_m, 2).tolist(),
        "path_mm": np.round(1e3 * pushed.path_m, 2).tolist(),
    }


def _simulated(kind: str, seed: int, mass: float, number: int) -> dict[str, Any]:
    policy = PushPolicy.load(POLICIES / f"push_{kind}_{seed}.npz")
    pushed = push_plant(
        Hand(HAND), truth_of(mass), policy, COURSES[number].path(), SECONDS, seed=number
    )
    return {"kind": kind, "seed": seed, "mass": mass, "course": number, **_plain(pushed)}


def simulate(workers: int) -> list[dict[str, Any]]:
    """Every policy on every plant and path.

    Args:
        workers: At a time.
    """
    asked = [
        (kind, run.settings.seed, mass, number)
        for kind in KINDS
        for run in runs_of(kind)
        for mass in MASSES
        for number in range(len(COURSES))
    ]
    found = []
    with progress("simulated") as tell:
        jobs = joblib.Parallel(workers, return_as="generator")(
            joblib.delayed(_simulated)(*one) for one in asked
        )
        for one in jobs:
            found.append(one)
            tell("runs", len(found) / len(asked), f"{one['kind']} {one['rms_mm']:.1f} mm")
    return found


def _live(kind: str, seed: int, mass: float, folder: Path) -> dict[str, Any]:
    """A policy over the graph, on emulated arms; what cannot be read of it is told as its fault."""
    truth = folder / "truth.yaml"
    with truth.open("w", encoding="utf-8") as stream:
        YAML(typ="safe").dump(truth_of(mass).plain(), stream)
    bag = folder / "bag"
    words = [sys.executable, "-m", "pneu_common.cli", "launch", "pneu_bringup", "push.launch.yaml"]
    values = {
        "backend": "emulated", "hand": HAND, "policy": POLICIES / f"push_{kind}_{seed}.npz",
        "truth": truth, "record": bag, "devices": folder / "dev", "path": LIVE.kind,
        "reach": LIVE.reach_m, "period": LIVE.period_s, "seed": LIVE.seed, "seconds": SECONDS,
        "rate": LIVE_RATE, "patience": 10.0,
    }  # fmt: skip
    environment = os.environ | {"PNEU_STATE_DIR": str(folder / "state"), "ROS_DOMAIN_ID": "79"}
    done = subprocess.run(
        [*words, *(f"{k}:={v}" for k, v in values.items())],
        cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    row: dict[str, Any] = {"kind": kind, "seed": seed, "mass": mass}
    said = done.stdout + done.stderr
    faults = [line for line in said.splitlines() if "tripped" in line or "meanwhile" in line]
    row["faults"] = faults[:3]
    try:
        return row | _plain(pushed_in(bag))
    except InputError as error:
        return row | {"rms_mm": None, "faults": [*faults[:3], str(error), said[-400:]]}


def live() -> list[dict[str, Any]]:
    """Every policy on emulated arms, with a cylinder half and twice as heavy."""
    asked = [
        (kind, run.settings.seed, mass)
        for mass in MASSES
        if mass != 1.0
        for run in runs_of(KINDS[0])
        for kind in KINDS
    ]
    found = []
    with progress("emulated arms") as tell:
        for kind, seed, mass in asked:
            with tempfile.TemporaryDirectory(prefix="pneu-") as folder:
                found.append(_live(kind, seed, mass, Path(folder)))
            tell("runs", len(found) / len(asked), f"{kind} {found[-1]['rms_mm']} mm")
    return found


def _mean(rows: list[dict[str, Any]], kind: str, mass: float, seed: int | None = None) -> float:
    own = [
        r["rms_mm"]
        for r in rows
        if r["kind"] == kind and r["mass"] == mass and seed in (None, r["seed"])
    ]
    return float(np.mean(own)) if own and None not in own else float("nan")


def _table(rows: list[dict[str, Any]], masses: tuple[float, ...]) -> list[str]:
    seeds = sorted({r["seed"] for r in rows})
    lines = [
        "| mass | policies of | " + " | ".join(f"seed {s}" for s in seeds) + " | mean |",
        "|---|---|" + "---|" * (len(seeds) + 1),
    ]
    for mass in masses:
        for kind in KINDS:
            each = [f"{_mean(rows, kind, mass, s):.2f}" for s in seeds]
            of = "one model" if kind == "single" else "an ensemble"
            lines.append(
                f"| x {mass:g} | {of} | {' | '.join(each)} | {_mean(rows, kind, mass):.2f} |"
            )
    return lines


def _share(rows: list[dict[str, Any]], mass: float) -> str:
    return f"{_mean(rows, 'ensemble', mass) / _mean(rows, 'single', mass):.2f}"


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Where the cylinder went on the circle, by every policy.

    Args:
        rows: Runs in simulation.
        path: Picture.
    """
    figure = Figure(figsize=(9.0, 6.2), layout="constrained")
    panels = figure.subplots(2, len(MASSES), sharex=True, sharey=True)
    for line, kind in enumerate(KINDS):
        for column, mass in enumerate(MASSES):
            axes = panels[line][column]
            own = [r for r in rows if r["kind"] == kind and r["mass"] == mass and r["course"] == 0]
            wanted = np.array(own[0]["path_mm"])
            axes.plot(wanted[:, 0], wanted[:, 1], color="black", linewidth=2.5, alpha=0.25)
            for r in own:
                went = np.array(r["thing_mm"])
                axes.plot(went[:, 0], went[:, 1], linewidth=0.9)
            of = "one model" if kind == "single" else "ensemble"
            axes.set_title(f"{of}, mass x {mass:g}", fontsize="medium")
            axes.set_aspect("equal")
            axes.set(xlim=(-45, 45), ylim=(-45, 45))
            axes.spines[["top", "right"]].set_visible(False)
    figure.supxlabel("mm")
    figure.supylabel("mm")
    with whole(path) as aside:
        figure.savefig(aside, format="png", dpi=130)


def page(found: dict[str, list[dict[str, Any]]], path: Path) -> None:
    """Writes the page.

    Args:
        found: Rows by stage.
        path: The page.
    """
    sources = digest_of(
        [ROOT / "src/pneu_sim/pneu_sim/hand", ROOT / "src/pneu_policy/pneu_policy", HAND.parent]
    )
    picture = path.parent / "figures" / "pushing.png"
    draw(found["simulate"], picture)
    example = PushPolicy.load(kept(KINDS[1], runs_of(KINDS[1])[0])).training
    env = example["settings"]["env"]
    recipe = env["recipe"]
    drawn = " and ".join(
        f"{d['set']} of the {d['name']} times {d['times'][0]:g} to {d['times'][1]:g}"
        for d in env["drawn"]
    )
    lines = [
        "# Three arms push a cylinder along a path",
        "",
        "Made by `make pushing`, from the sources and scenes " + sources + ".",
        "",
        "Policies by the natural policy gradient (thesis 2.9, 3.1), of"
        f" {len({r['seed'] for r in found['simulate']})} seeds each and none chosen:"
        f" {example['iterations']} updates, {example['samples']} control periods of"
        f" {1e3 * recipe['period_s']:g} ms. They push tips along the plane by forces up to"
        f" {recipe['force_n']:g} N each way and see tips, cylinder and path. *One model* has the"
        " values that were identified from a recording of an arm; *an ensemble* has besides, in"
        f" each of its {env['num_envs']} plants, {drawn}. They are judged on a plant that hides"
        " other values for tips and contacts, in finer steps, with counts of encoders and noise of"
        " motion capture.",
        "",
        "## In simulated time",
        "",
        f"How far off the path, mm, root mean square over {SECONDS:g} s; mean over"
        f" {len(COURSES)} paths: two circles, an eight, three that wander.",
        "",
        *_table(found["simulate"], MASSES),
        "",
        "The ensemble's error is "
        + ", ".join(f"{_share(found['simulate'], m)} times at mass x {m:g}" for m in MASSES)
        + " that of one model's policies.",
        "",
        "![where the cylinder went](figures/pushing.png)",
        "",
    ]
    if found.get("live"):
        masses = tuple(m for m in MASSES if m != 1.0)
        faults = [r for r in found["live"] if r["faults"]]
        lines += [
            "## On emulated arms",
            "",
            "`pneu launch pneu_bringup push.launch.yaml backend:=emulated`: three emulated"
            " devices, each behind its bridge and its 2 kHz loop, and the policy's node, on the"
            f" first circle; the plant goes {LIVE_RATE:g} s in a second of the machine's. What the"
            " recording shows, mm:",
            "",
            *_table(found["live"], masses),
            "",
            "The ensemble's error is "
            + ", ".join(f"{_share(found['live'], m)} times at mass x {m:g}" for m in masses)
            + f" that of one model's policies. {len(faults)} of {len(found['live'])} runs had a"
            " bridge that tripped or readings that came late"
            + (
                ": " + "; ".join(f"{r['kind']} {r['seed']} x {r['mass']:g}" for r in faults)
                if faults
                else ""
            )
            + ".",
            "",
        ]
    write_whole(path, "\n".join(lines))


def main() -> int:
    """Runs the stages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    add_stages(parser, ("train", "simulate", "live", "page"))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "pushing.md")
    asked = parser.parse_args()
    stages = asked.stages
    console = Console()
    OUT.mkdir(parents=True, exist_ok=True)
    if "train" in stages:
        train(console, asked.workers)
    found: dict[str, list[dict[str, Any]]] = {}
    for stage in ("simulate", "live"):
        file = OUT / f"{stage}.json"
        if stage in stages:
            rows = simulate(asked.workers) if stage == "simulate" else live()
            write_whole(file, json.dumps(rows))
        if file.exists():
            found[stage] = json.loads(file.read_text(encoding="utf-8"))
            for mass in sorted({row["mass"] for row in found[stage]}):
                told = ", ".join(f"{k} {_mean(found[stage], k, mass):.2f} mm" for k in KINDS)
                console.print(f"{stage}, mass x {mass:g}: {told}")
    if "page" in stages:
        if "simulate" not in found:
            raise InputError("page: there are no runs yet; the stage simulate makes them")
        page(found, asked.page)
        console.print(f"{asked.page} is written")
    return 0


if __name__ == "__main__":
    sys.exit(main())
