# SPDX-License-Identifier: Apache-2.0
"""Table 9.2: controllers of a joint on an emulated Kokoro that none of them was made on.

Stages, each skipped where its result is there already:

  tune   the PID of eq. 9.2 and a computed torque -> ``policies/kokoro_*.yaml``
  train  policies by ``studies/settings/kokoro_*.yaml``, several seeds -> ``policies/``
  wrong  some of these policies, trained on models that are not the robot
  judge  all of them on the laboratory's robot, in its own time
  page   ``docs/kokoro.md`` and its figures

All are made on ``rigs/kokoro_fitted.yaml``, which `pneu fit` made of a recording of the laboratory,
and judged on ``rigs/lab_kokoro.yaml``. Every policy is run, none is chosen. The targets' speed is
the one at which the PID's errors are about the thesis' own; nothing else was looked at for it.
"""

import argparse
import json
import math
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console

from pneu_common.documents import read_yaml
from pneu_common.errors import InputError
from pneu_common.files import whole, write_whole
from pneu_common.progress import progress
from pneu_policy.control.robot_controllers import save_robot_controller
from pneu_policy.control.robot_policy import RobotPolicy
from pneu_policy.judge.robot import JointTasks, judge_joint
from pneu_policy.learn.settings import load_document
from pneu_policy.learn.sweep import Run, Workers, expand
from pneu_policy.learn.trainer import POLICY
from pneu_policy.tune.joint_gains import JointTuneSettings, tune_joint
from pneu_sim.rig.load import load_rig
from pneu_sim.rig.schema import AttachedEffect
from studies.digest import digest_of
from studies.stages import add_stages
from studies.training import train_runs

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "out" / "kokoro"
POLICIES = ROOT / "policies"
KNOWN = "rigs/kokoro_fitted.yaml"
TRUE = "rigs/lab_kokoro.yaml"
DX_M = 0.06
"""Cell length of the laboratory's robot, m; training takes four times that."""
TASKS = JointTasks("elbow", -0.7, 0.7)
EXCERPT_S = 4.0
LOAD = AttachedEffect(
    effect="payload", place="elbow", parameters={"mass_kg": 0.3, "distance_m": 0.2}
)
"""What the robot carries besides, for a second look: nothing that any controller was made with."""
PLANTS = ("laboratory", "loaded")
DRAWN, DRAWN_RUNS = 4, 2
"""Loads drawn at random, and how many runs of each kind of target each is judged by."""
LIGHT_KG, HEAVY_KG = 0.05, 0.4
NEAR_M, FAR_M = 0.05, 0.3
WRONG = {
    # no fit has told how far its numbers may be off, so none are drawn
    "datasheet": ("the robot as datasheets have it", {"rig": "rigs/kokoro.yaml", "spread": 0.0}),
    "simple": ("the simple model of its air, parameters as fitted", {"model": "thin_plate"}),
}
"""Models that are not the robot, in words, and what is other in the training's environment."""
SOUGHT = ("position", "both", "uncorrelated")
"""Rows that are trained on them as well: what knows positions, and what does not."""


def drawn() -> dict[str, AttachedEffect]:
    """Loads that were drawn, by the name of the plant that carries each."""
    rng = np.random.default_rng(24)
    out = {}
    for _ in range(DRAWN):
        mass_kg = round(float(rng.uniform(LIGHT_KG, HEAVY_KG)), 2)
        distance_m = round(float(rng.uniform(NEAR_M, FAR_M)), 2)
        values = {"mass_kg": mass_kg, "distance_m": distance_m}
        load = AttachedEffect(effect="payload", place="elbow", parameters=values)
        out[f"{mass_kg:g} kg at {distance_m:g} m"] = load
    return out


Cell = tuple[float, float, float] | None
"""RMSE and adjusted RMSE, degrees, and apparent latency, ms, in the thesis."""


@dataclass(frozen=True)
class Line:
    """A row of the table.

    Attributes:
        name: Of its files.
        title: What it is.
        smooth: What the thesis has of it on smooth targets.
        jagged: On saw-teeth.
    """

    name: str
    title: str
    smooth: Cell = None
    jagged: Cell = None


FEWER = {"trials": 4, "candidates": 16, "generations": 15}
"""Of a computed torque, whose plans take longer."""

TUNED = (
    Line("joint_pid", "PID (eq. 9.2)", (13.7, 11.6, 20.0), (17.9, 9.4, 63.0)),
    Line("computed_torque", "computed torque, forces by PI (not in the thesis)"),
)
LEARNED = (
    Line("position", "position", (33.6, 33.3, 41.0)),
    Line("hints", "position, force hints", (6.0, 6.0, -4.0), (8.3, 8.2, 9.0)),
    Line("both", "hybrid (plan): force and position", None, (19.7, 18.8, 34.0)),
    Line("force", "hybrid (plan): force", (4.0, 3.8, -3.0), (8.6, 7.3, 26.0)),
    Line("uncorrelated", "hybrid: force, uncorrelated", (2.7, 2.3, -5.0), (4.4, 3.4, 16.0)),
)
PLANNED = (Line("predictive", "predictive, plans on the model (not in the thesis)"),)
LINES = (*TUNED, *PLANNED, *LEARNED)


def tuning(kind: str) -> JointTuneSettings:
    """How a controller is tuned.

    Args:
        kind: ``joint_pid`` or ``computed_torque``.
    """
    return JointTuneSettings(
        rig=KNOWN,
        kind=kind,  # type: ignore[arg-type]
        encoder="elbow",
        cylinder="forearm",
        taps=("head_port", "rod_port"),
        low=TASKS.low,
        high=TASKS.high,
        target_period_s=TASKS.period_s,
        dx_m=0.25,
        **({} if kind == "joint_pid" else FEWER),
    )


def tune(console: Console, workers: int) -> None:
    """Tunes what is not tuned as it should be.

    Args:
        console: Where to tell.
        workers: Tunings at a time.
    """
    asked = [line.name for line in TUNED if not _tuned(line.name)]
    jobs = joblib.Parallel(workers, return_as="generator_unordered")(
        joblib.delayed(_tune)(kind) for kind in asked
    )
    with progress("tuning") as tell:
        for done, said in enumerate(jobs, 1):
            tell("controllers", done / len(asked), said)
            console.print(said)


def _tune(kind: str) -> str:
    found = tune_joint(tuning(kind))
    save_robot_controller(found.controller, POLICIES / f"kokoro_{kind}.yaml", found.provenance())
    return f"{kind}: {math.degrees(found.rmse):.2f} degrees on the model"


def _tuned(kind: str) -> bool:
    path = POLICIES / f"kokoro_{kind}.yaml"
    if not path.exists():
        return False
    document = read_yaml(path, "controller")
    return bool(document["tuned"]["settings"] == tuning(kind).plain())


def runs_of(name: str) -> list[Run]:
    """Trainings of a row.

    Args:
        name: Of the row.
    """
    settings = ROOT / "studies" / "settings" / f"kokoro_{name}.yaml"
    return expand(load_document(settings), OUT / "training" / name)


def files_of(line: Line) -> list[Path]:
    """Controllers of a row, one to each seed.

    Args:
        line: The row.
    """
    if line in (*TUNED, *PLANNED):
        return [POLICIES / f"kokoro_{line.name}.yaml"]
    return [_kept(line.name, run) for run in runs_of(line.name)]


def _kept(name: str, run: Run) -> Path:
    return POLICIES / f"kokoro_{name}_{run.settings.seed}.npz"


def _trained(name: str, run: Run) -> bool:
    path = _kept(name, run)
    return path.exists() and run.made(RobotPolicy.load(path).training)


def train(console: Console, workers: int) -> None:
    """Trains what is not trained as its settings say.

    Args:
        console: Where to tell.
        workers: Trainings at a time.
    """
    for line in LEARNED:
        runs = runs_of(line.name)
        if all(_trained(line.name, run) for run in runs):
            continue
        out = OUT / "training" / line.name
        words = [sys.executable, "-m", "pneu_common.cli", "train"]
        words += [f"studies/settings/kokoro_{line.name}.yaml", "-o", str(out), "--resume"]
        console.print(f"training {line.name}")
        subprocess.run([*words, "--workers", str(workers)], cwd=ROOT, check=True)
        for run in runs:
            shutil.copyfile(run.folder / POLICY, _kept(line.name, run))


def wrong_runs(model: str, name: str) -> list[Run]:
    """Trainings of a row on a model that is not the robot.

    Args:
        model: Which of `WRONG`.
        name: Of the row.
    """
    document = load_document(ROOT / "studies" / "settings" / f"kokoro_{name}.yaml")
    document["env"] |= WRONG[model][1]
    return expand(document, OUT / "wrong" / model / name)


def train_wrong(workers: int) -> None:
    """Trains them.

    Args:
        workers: Trainings at a time.

    Raises:
        InputError: A training failed.
    """
    runs = [run for model in WRONG for name in SOUGHT for run in wrong_runs(model, name)]
    train_runs(runs, Workers("loky", workers))


def _judge(
    name: str, file: Path, plant: str, runs: int, seconds: float, rig: str = KNOWN
) -> list[dict[str, Any]]:
    known, true = load_rig(ROOT / rig), load_rig(ROOT / TRUE)
    load = {"loaded": LOAD, **drawn()}.get(plant)
    if load is not None:
        true = true.model_copy(update={"effects": [*true.effects, load]})
    tasks = JointTasks(TASKS.encoder, TASKS.low, TASKS.high, runs=runs, seconds=seconds)
    rows = []
    for run in judge_joint(file, known, true, tasks, DX_M):
        inside = run.time_s <= run.time_s[0] + EXCERPT_S
        rows.append(
            {
                "line": name,
                "plant": plant,
                "file": str(file),
                "kind": run.kind,
                "run": run.run,
                "rmse_deg": math.degrees(run.rmse),
                "latency_ms": 1e3 * run.latency_s,
                "adjusted_deg": math.degrees(run.adjusted_rmse),
                "effort_v": run.effort_v,
                "time_s": np.round(run.time_s[inside], 4).tolist(),
                "position_deg": np.round(np.degrees(run.position[inside]), 3).tolist(),
                "target_deg": np.round(np.degrees(run.target[inside]), 3).tolist(),
                "volts": np.round(run.volts[:, inside[: run.volts.shape[1]]], 3).tolist(),
            }
        )
    return rows


def judge(workers: int, runs: int, seconds: float) -> list[dict[str, Any]]:
    """Every controller on the laboratory's robot, as it is and loaded.

    Args:
        workers: At a time.
        runs: Runs of each kind of target.
        seconds: How long each is judged.
    """
    asked = [
        (line.name, file, plant, runs, seconds)
        for line in LINES
        for file in files_of(line)
        for plant in PLANTS
    ]
    asked += [
        (line.name, files_of(line)[0], plant, min(DRAWN_RUNS, runs), seconds)
        for line in LINES
        for plant in drawn()
    ]
    found: list[dict[str, Any]] = []
    jobs = joblib.Parallel(workers, return_as="generator")(
        joblib.delayed(_judge)(*one) for one in asked
    )
    with progress("judged") as tell:
        for done, rows in enumerate(jobs, 1):
            found += rows
            name = Path(rows[0]["file"]).name
            tell("controllers", done / len(asked), f"{name}, {rows[0]['plant']}")
    return found


def judge_wrong(workers: int, runs: int, seconds: float) -> list[dict[str, Any]]:
    """The policies of models that are not the robot, on the laboratory's robot.

    Args:
        workers: At a time.
        runs: Runs of each kind of target.
        seconds: How long each is judged.
    """
    asked = []
    for model, (_, other) in WRONG.items():
        for name in SOUGHT:
            files = [run.folder / POLICY for run in wrong_runs(model, name)]
            rig = str(other.get("rig", KNOWN))
            asked += [(name, file, "laboratory", runs, seconds, rig) for file in files]
    missing = [file for _, file, *_ in asked if not file.exists()]
    if missing:
        raise InputError(f"{missing[0]}: is missing; the stage wrong makes it")
    jobs = joblib.Parallel(workers, return_as="generator")(
        joblib.delayed(_judge)(*one) for one in asked
    )
    found: list[dict[str, Any]] = []
    with progress("judged, models that are not the robot") as tell:
        for done, ((_, file, *_), rows) in enumerate(zip(asked, jobs, strict=True), 1):
            model = file.relative_to(OUT / "wrong").parts[0]
            for row in rows:  # excerpts of these are not drawn
                kept = ("line", "file", "kind", "run", "rmse_deg", "latency_ms", "adjusted_deg")
                found.append({k: row[k] for k in kept} | {"plant": model})
            tell("controllers", done / len(asked), f"{model}, {file.parent.name}")
    return found


def rms(
    rows: list[dict[str, Any]],
    name: str,
    kind: str,
    what: str = "rmse_deg",
    plant: str = "laboratory",
) -> list[float]:
    """A figure of a row, root mean square over its runs, for each of its files.

    Args:
        rows: All runs.
        name: Of the row.
        kind: Kind of target.
        what: Which figure.
        plant: Which of `PLANTS`.
    """
    own: dict[str, list[float]] = {}
    for row in rows:
        if (row["line"], row["kind"], row["plant"]) == (name, kind, plant):
            own.setdefault(row["file"], []).append(row[what])
    if what == "latency_ms":
        return [float(np.mean(values)) for values in own.values()]
    return [float(np.sqrt(np.mean(np.square(values)))) for values in own.values()]


def _spread(values: list[float], digits: int = 1) -> str:
    if not values:
        return "-"
    told = f"{np.mean(values):.{digits}f}"
    if len(values) == 1:
        return told
    return f"{told} ({min(values):.{digits}f} to {max(values):.{digits}f})"


def _table(rows: list[dict[str, Any]]) -> list[str]:
    lines = [
        "| controller | target | RMSE, degrees | latency, ms | adjusted RMSE | effort, V | thesis:"
        " RMSE, latency, adjusted |",
        "|---|---|---|---|---|---|---|",
    ]
    for line in LINES:
        for kind, theirs in (("smooth", line.smooth), ("jagged", line.jagged)):
            told = "-" if theirs is None else f"{theirs[0]:g}, {theirs[2]:g} ms, {theirs[1]:g}"
            lines.append(
                f"| {line.title} | {kind} | {_spread(rms(rows, line.name, kind))}"
                f" | {_spread(rms(rows, line.name, kind, 'latency_ms'), 0)}"
                f" | {_spread(rms(rows, line.name, kind, 'adjusted_deg'))}"
                f" | {_spread(rms(rows, line.name, kind, 'effort_v'))} | {told} |"
            )
    return lines


def _loaded(rows: list[dict[str, Any]]) -> list[str]:
    lines = [
        "| controller | smooth: as it is | loaded | jagged: as it is | loaded |",
        "|---|---|---|---|---|",
    ]
    for line in LINES:
        told = [
            _spread(rms(rows, line.name, kind, plant=plant))
            for kind in TASKS.kinds
            for plant in PLANTS
        ]
        lines.append(f"| {line.title} | {' | '.join(told)} |")
    return lines


def _drawn(rows: list[dict[str, Any]]) -> list[str]:
    lines = [f"| controller | {' | '.join(drawn())} |", f"|---|{'---|' * DRAWN}"]
    for line in LINES:
        told = [
            " and ".join(_spread(rms(rows, line.name, kind, plant=plant)) for kind in TASKS.kinds)
            for plant in drawn()
        ]
        lines.append(f"| {line.title} | {' | '.join(told)} |")
    return lines


def _least(means: dict[str, dict[Any, float]]) -> dict[str, str]:
    """The row with the least error, by kind of target."""

    def row(kind: str) -> str:
        return min(means, key=lambda name: means[name][kind])

    return {kind: row(kind) for kind in TASKS.kinds}


def _wrong(rows: list[dict[str, Any]]) -> list[str]:
    """What models that are not the robot make of the order of rows."""
    title = {line.name: line.title for line in LINES}
    words = {"laboratory": "the model fitted to the robot"} | {k: w for k, (w, _) in WRONG.items()}
    lines = [
        "| trained on | controller | smooth, degrees | jagged |",
        "|---|---|---|---|",
    ]
    first: dict[str, dict[str, str]] = {}
    ahead: list[str] = []
    for model, told in words.items():
        each = {
            name: {kind: rms(rows, name, kind, plant=model) for kind in TASKS.kinds}
            for name in SOUGHT
        }
        lines += [
            f"| {told} | {title[name]} | {_spread(of['smooth'])} | {_spread(of['jagged'])} |"
            for name, of in each.items()
        ]
        means = {n: {k: float(np.mean(v)) for k, v in of.items()} for n, of in each.items()}
        first[model] = _least(means)
        ahead += [
            f"{told}, {kind}"
            for kind in TASKS.kinds
            if means["uncorrelated"][kind] < means["position"][kind]
        ]
    best = "; ".join(
        f"{words[model]}: {', '.join(f'{kind} {title[name]}' for kind, name in of.items())}"
        for model, of in first.items()
    )
    turned = all(name == "uncorrelated" for model in WRONG for name in first[model].values())
    never = all(name != "uncorrelated" for of in first.values() for name in of.values())
    verdict = (
        "A model that is not the robot does turn the order round."
        if turned
        else "No such model turns the order round: the uncorrelated hybrid leads with none."
        if never
        else "The order depends on the model and on the target."
    )
    behind = (
        f"The position policy falls behind the uncorrelated hybrid, as in the thesis, with:"
        f" {'; '.join(ahead)}."
        if ahead
        else "Nowhere does the position policy fall behind the uncorrelated hybrid."
    )
    return [*lines, "", f"Least error, by what was trained on: {best}. {verdict} {behind}"]


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Excerpts of every controller, the first seed and run of each.

    Args:
        rows: All runs.
        path: Picture.
    """
    figure = Figure(figsize=(11.0, 1.55 * len(LINES) + 0.6), layout="constrained")
    panels = figure.subplots(len(LINES), 2, sharex=True, sharey=True, squeeze=False)
    for line, pair in zip(LINES, panels, strict=True):
        for kind, axes in zip(TASKS.kinds, pair, strict=True):
            own = [
                r
                for r in rows
                if (r["line"], r["kind"], r["run"]) == (line.name, kind, 0) and "time_s" in r
            ]
            time = np.array(own[0]["time_s"]) - own[0]["time_s"][0]
            axes.plot(time, own[0]["target_deg"], color="black", linewidth=2.5, alpha=0.25)
            axes.plot(time, own[0]["position_deg"], color="tab:blue", linewidth=1.0)
            error = np.mean(rms(rows, line.name, kind))
            axes.set_title(f"{line.title}, {kind}: {error:.1f}°", fontsize="small")
            axes.spines[["top", "right"]].set_visible(False)
    figure.supxlabel("s")
    figure.supylabel("elbow, degrees (grey: target)")
    with whole(path) as aside:
        figure.savefig(aside, format="png", dpi=120)


def page(rows: list[dict[str, Any]], path: Path) -> None:
    """Writes the page.

    Args:
        rows: All runs.
        path: The page.
    """
    sources = digest_of(
        [
            ROOT / "src/pneu_sim/pneu_sim",
            ROOT / "src/pneu_policy/pneu_policy",
            ROOT / KNOWN,
            ROOT / TRUE,
            *(file for line in LINES for file in files_of(line)),
        ]
    )
    draw(rows, path.parent / "figures" / "kokoro.png")
    runs = len({r["run"] for r in rows})
    training = RobotPolicy.load(files_of(LEARNED[-1])[0]).training
    pid = {kind: np.mean(rms(rows, "joint_pid", kind)) for kind in TASKS.kinds}
    means = {
        line.name: {kind: float(np.mean(rms(rows, line.name, kind))) for kind in TASKS.kinds}
        for line in LEARNED
    }
    best = _least(means)
    title = {line.name: line.title for line in LINES}
    lines = [
        "# A joint of Kokoro: table 9.2",
        "",
        f"Made by `make kokoro`, from the sources, rigs and policies {sources}.",
        "",
        "Controllers are made on `rigs/kokoro_fitted.yaml`, which `pneu fit` made of a recording of"
        " the emulated laboratory, and judged on the laboratory's robot, `rigs/lab_kokoro.yaml`:"
        " heavier link, tighter seals, other valves and tubes than any datasheet said, cells of"
        f" {DX_M:g} m where training had 0.25 m, noise, counts of encoders, and commands that come"
        f" 2 to 10 ms late. {runs} runs of each kind of target, policies of"
        f" {len(files_of(LEARNED[0]))} seeds each"
        f" ({training['iterations']} updates, {training['samples']} control periods); every one is"
        " run, none is chosen. In brackets: the seeds' least and most.",
        "",
        f"Targets span {math.degrees(TASKS.low):.0f} to {math.degrees(TASKS.high):.0f} degrees,"
        f" with {TASKS.period_s[0]:g} s (smooth) and {TASKS.period_s[1]:g} s (jagged) from one"
        " extreme to the next: about as fast as makes the PID of eq. 9.2 err as much as the thesis'"
        " own does. Its gains, and those of the computed torque, are tuned for these very targets"
        " on the fitted model (`policies/kokoro_*.yaml`).",
        "",
        *_table(rows),
        "",
        "Best learned controller over the PID: "
        + "; ".join(
            f"{kind} {means[best[kind]][kind]:.1f} of {pid[kind]:.1f} degrees, a share of"
            f" {means[best[kind]][kind] / pid[kind]:.2f} ({title[best[kind]]})"
            for kind in TASKS.kinds
        )
        + ".",
        "",
        "![excerpts of all controllers](figures/kokoro.png)",
        "",
        "## With a load that nobody knows",
        "",
        f"The same with {LOAD.parameters['mass_kg']:g} kg at {LOAD.parameters['distance_m']:g} m"
        " from the joint, which neither plans nor policies were told; RMSE, degrees. The predictive"
        " controller finds it out while it moves:",
        "",
        *_loaded(rows),
        "",
        f"The same with loads drawn at random, {DRAWN_RUNS} runs of each kind of target, policies"
        " of the first seed; smooth and jagged:",
        "",
        *_drawn(rows),
        "",
        "## On models that are not the robot",
        "",
        "The thesis has the rows in the other order: who knows positions does worse there, and the"
        " uncorrelated hybrid best; it takes for the cause that policies fit themselves to a model"
        " that is not the robot. Here the model is fitted to the robot. So the same policies are"
        " trained on models that are not, and judged on the laboratory's robot, seeds as above:",
        "",
        *_wrong(rows),
        "",
    ]
    write_whole(path, "\n".join(lines))


def main() -> int:
    """Runs the stages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    add_stages(parser, ("tune", "train", "wrong", "judge", "page"))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=12.0)
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "kokoro.md")
    asked = parser.parse_args()
    console = Console()
    OUT.mkdir(parents=True, exist_ok=True)
    if "tune" in asked.stages:
        tune(console, asked.workers)
    if "train" in asked.stages:
        train(console, asked.workers)
    if "wrong" in asked.stages:
        train_wrong(asked.workers)
    files = [OUT / "judge.json", OUT / "judge_wrong.json"]
    if "judge" in asked.stages:
        for file, way in zip(files, (judge, judge_wrong), strict=True):
            write_whole(file, json.dumps(way(asked.workers, asked.runs, asked.seconds)))
    missing = [file for file in files if not file.exists()]
    if missing:
        raise InputError(f"{missing[0]}: there are no runs yet; the stage judge makes them")
    rows = [row for file in files for row in json.loads(file.read_text(encoding="utf-8"))]
    for line in LINES:
        told = ", ".join(f"{kind} {_spread(rms(rows, line.name, kind))}" for kind in TASKS.kinds)
        console.print(f"{line.title}: {told} degrees")
    if "page" in asked.stages:
        page(rows, asked.page)
        console.print(f"{asked.page} is written")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
