# SPDX-License-Identifier: Apache-2.0
"""Learned and classical pressure control: train, tune, try on the emulated lab, write it up.

Stages, each skipped where its result is there already, so that an interrupted study goes on:

  train     policies by ``studies/settings/<tube>_<variant>.yaml`` -> ``policies/``
  ppo       the same task by another algorithm, a library's, as a yardstick
  tune      a PID and a PID with feed-forward for each tube -> ``policies/``
  simulate  all of them on the calibrated rigs, in simulation
  live      those of the tables on the emulated lab, whose plants nobody trained on
  limit     the best that those plants could do
  page      ``docs/pressure.md``, ``docs/pressure.json``, ``docs/figures/pressure_*.png``

A variant is trained with several seeds. In an evaluation the run with target seed n takes the
policy of training seed n modulo their number: every policy is run, none is chosen.
"""

import argparse
import hashlib
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import joblib
from rich.console import Console

from pneu_common.errors import InputError
from pneu_common.progress import progress
from pneu_hw_bridge.lab.sealed import open_sealed
from pneu_policy.control.policy_file import PolicyFile
from pneu_policy.judge.evaluate import evaluate_simulated
from pneu_policy.judge.limit import evaluate_limit
from pneu_policy.judge.results import Evaluation, error_rows, load, rich_table
from pneu_policy.judge.tasks import Conditions, Tasks
from pneu_policy.learn.settings import load_document
from pneu_policy.learn.sweep import Run, expand
from pneu_policy.learn.trainer import HISTORY, POLICY
from pneu_policy.live.evaluate import evaluate_live
from pneu_policy.live.rig import LivePlant
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import Rig
from studies import pressure_page
from studies.stages import add_stages

ROOT = Path(__file__).resolve().parent.parent
SETTINGS = ROOT / "studies" / "settings"
POLICIES = ROOT / "policies"
OUT = ROOT / "out" / "pressure"
TASKS = Tasks(seeds=(101, 102, 103, 104, 105), duration_s=8.0)
"""Five runs of each task, as in the thesis; seeds that no tuning has seen."""
PIDS = ("pid", "feed_forward")
SIMULATED_ONLY = ("line", "no_encoding", "no_encoding_fine")
"""One sees the gas of the tube, which no sensor of the lab tells; all are compared in the model."""
STAGES = ("train", "ppo", "tune", "simulate", "live", "limit", "page")


@dataclass(frozen=True)
class Tube:
    """One of the two testbeds.

    Attributes:
        rig: The calibrated rig, on which is trained.
        sealed: What its plant in the lab has besides.
    """

    rig: Path
    sealed: Path


TUBES = {
    "short": Tube(
        ROOT / "rigs" / "rig_a_fitted.yaml", ROOT / "rigs" / "plants" / "short.sealed.json"
    ),
    "long": Tube(
        ROOT / "rigs" / "rig_b_fitted.yaml", ROOT / "rigs" / "plants" / "long.sealed.json"
    ),
}


def pneu(console: Console, *words: str) -> None:
    """Runs a `pneu` command to its end; its failure is ours.

    Args:
        console: Where to say what is done.
        *words: Its arguments.
    """
    console.print(f"$ pneu {' '.join(words)}", style="cyan")
    command = [sys.executable, "-m", "pneu_common.cli", *words]
    status = subprocess.run(command, check=False, cwd=ROOT).returncode
    if status:
        raise SystemExit(status)


def variants(tube: str) -> dict[str, Path]:
    """Settings of a tube's trainings by variant.

    Args:
        tube: Name of the tube.
    """
    return {
        file.stem.removeprefix(f"{tube}_"): file for file in sorted(SETTINGS.glob(f"{tube}_*.yaml"))
    }


def through_observers(tube: str) -> dict[str, Path]:
    """Settings of trainings by what an observer tells, for `studies.predictive`, by variant.

    Args:
        tube: Name of the tube.
    """
    return {
        f"{file.stem.removeprefix(f'{tube}_')}_observed": file
        for file in sorted((SETTINGS / "observed").glob(f"{tube}_*.yaml"))
    }


def train(console: Console, workers: int) -> None:
    """Trains what is not trained as its settings say, and puts it where policies are kept."""
    for tube in TUBES:
        for variant, settings in (variants(tube) | through_observers(tube)).items():
            out = OUT / "training" / f"{tube}_{variant}"
            runs = expand(load_document(settings), out)
            kept = {
                run.folder: POLICIES / f"{tube}_{variant}_{run.settings.seed}.npz" for run in runs
            }
            if all(is_of(kept[run.folder], run) for run in runs):
                continue
            words = ["train", str(settings.relative_to(ROOT)), "-o", str(out.relative_to(ROOT))]
            pneu(console, *words, "--resume", "--workers", str(workers))
            POLICIES.mkdir(exist_ok=True)
            for folder, path in kept.items():
                shutil.copyfile(folder / POLICY, path)


def is_of(path: Path, run: Run) -> bool:
    """Whether a policy is there and was trained as a run asks.

    Args:
        path: Its file.
        run: The run.
    """
    if not path.exists():
        return False
    return run.made(PolicyFile.load(path).training)


def ppo(console: Console, workers: int) -> None:
    """Trains the first variant by PPO with as many samples, for its learning curve alone."""
    document = load_document(SETTINGS / "short_pde.yaml")
    runs = [
        run
        for run in expand(document, OUT / "training" / "short_ppo")
        if not (run.folder / HISTORY).exists()
    ]
    console.print(f"{len(runs)} runs of PPO", style="cyan")
    joblib.Parallel(n_jobs=workers)(joblib.delayed(ppo_run)(run) for run in runs)


def ppo_run(run: Run) -> None:
    """One of these runs.

    Args:
        run: Where its history goes, and what is trained.
    """
    # Here, because it is wanted by this stage alone and takes seconds to import.
    from pneu_policy.learn.ppo import train_ppo

    history = train_ppo(run.settings)
    run.folder.mkdir(parents=True, exist_ok=True)
    history.save(run.folder / HISTORY)


def tune(console: Console) -> None:
    """Tunes what is not tuned."""
    for tube, parts in TUBES.items():
        for kind in PIDS:
            path = POLICIES / f"{tube}_{kind}.yaml"
            if path.exists():
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            words = ["tune", "--rig", str(parts.rig.relative_to(ROOT)), "--kind", kind]
            words += ["--target-period", str(TASKS.period_s)]
            pneu(console, *words, "-o", str(path.relative_to(ROOT)))


def policies(tube: str, variant: str) -> list[Path]:
    """Policies of a variant, by the seed of their training.

    Args:
        tube: Name of the tube.
        variant: Name of the variant.
    """
    pattern = re.compile(rf"{re.escape(tube)}_{re.escape(variant)}_(\d+)\.npz")
    found = [(pattern.fullmatch(file.name), file) for file in POLICIES.glob("*.npz")]
    return [file for _, file in sorted((int(match[1]), file) for match, file in found if match)]


def controllers(tube: str, live: bool) -> dict[str, list[Path]]:
    """Files of the controllers of a tube by name.

    Args:
        tube: Name of the tube.
        live: Whether those are left out that no real rig could run.
    """
    found = {
        variant: policies(tube, variant)
        for variant in variants(tube)
        if not (live and variant in SIMULATED_ONLY)
    }
    for kind in PIDS:
        found[kind] = [path for path in [POLICIES / f"{tube}_{kind}.yaml"] if path.exists()]
    # The order of the table's columns.
    known = ["pde", "plate", "pde_fine", "plate_fine"]
    order = sorted(found, key=lambda n: (known.index(n) if n in known else 9, n in PIDS))
    return {name: found[name] for name in order if found[name]}


def revealed(tube: str) -> Rig:
    """The plant of a tube's lab, with what it hides.

    Args:
        tube: Name of the tube.
    """
    rig = load_rig(TUBES[tube].rig)
    effects = [*rig.effects, *open_sealed(TUBES[tube].sealed)]
    return rig.model_copy(update={"effects": effects})


def opened(name: str) -> Evaluation:
    """What a stage has found so far.

    Args:
        name: Of its folder.
    """
    path = OUT / name / "evaluation.json"
    plants = {
        tube: [hashlib.sha256(file.read_bytes()).hexdigest() for file in (parts.rig, parts.sealed)]
        for tube, parts in TUBES.items()
    }
    settings = {"tasks": TASKS.to_dict(), "conditions": asdict(Conditions()), "plants": plants}
    if not path.exists():
        return Evaluation(settings, folder=path.parent)
    found = load(path)
    if found.settings != settings:
        raise InputError(
            f"{path}: was made with other tasks or plants; remove its folder to begin anew"
        )
    return found


def simulate(console: Console, told: Callable[[str, float], None]) -> None:
    """All controllers on the rigs they were trained or tuned on."""
    evaluation = opened("simulated")
    for tube, parts in TUBES.items():
        chosen = controllers(tube, live=False)
        evaluate_simulated(evaluation, chosen, {tube: load_rig(parts.rig)}, TASKS, None, told)
    console.print(rich_table("in simulation, on the calibrated rig", *error_rows(evaluation)))


def live(console: Console, told: Callable[[str, float], None]) -> None:
    """The controllers of the tables on the emulated lab."""
    evaluation = opened("live")
    for tube, parts in TUBES.items():
        plant = LivePlant(tube, parts.rig, parts.sealed)
        evaluate_live(evaluation, controllers(tube, live=True), [plant], TASKS, progress=told)
    console.print(rich_table("on the emulated lab", *error_rows(evaluation)))


def limit(console: Console, told: Callable[[str, float], None], workers: int) -> None:
    """The best that the lab's plants could do on the same targets."""
    evaluation = opened("live")
    plants = {tube: revealed(tube) for tube in TUBES}
    evaluate_limit(evaluation, plants, "end", TASKS, workers=workers, progress=told)
    console.print(rich_table("on the emulated lab", *error_rows(evaluation)))


def main(arguments: list[str] | None = None) -> int:
    """Runs the study; returns the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_stages(parser, STAGES)
    parser.add_argument("--workers", type=int, default=2, help="processes of train, ppo and limit")
    options = parser.parse_args(arguments)
    console = Console(width=160)
    try:
        for stage in options.stages:
            console.rule(stage)
            if stage == "train":
                train(console, options.workers)
            elif stage == "ppo":
                ppo(console, options.workers)
            elif stage == "tune":
                tune(console)
            elif stage == "page":
                pressure_page.write(ROOT, OUT)
            else:
                run_stage(console, stage, options.workers)
    except InputError as error:
        console.print(str(error))
        return 2
    return 0


def run_stage(console: Console, stage: str, workers: int) -> None:
    """A stage that takes long, with its progress.

    Args:
        console: Where to show it.
        stage: Name of the stage.
        workers: Processes for the limit.
    """
    with progress(stage) as told:
        if stage == "simulate":
            simulate(console, told)
        elif stage == "live":
            live(console, told)
        else:
            limit(console, told, workers)


if __name__ == "__main__":
    sys.exit(main())
