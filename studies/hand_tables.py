# SPDX-License-Identifier: Apache-2.0
"""The experiments of thesis 2.7 on an emulated arm whose truth is hidden, and effects it may have.

Stages, each skipped where its result is there already:

  record   five recordings of an exercise, through bridge and graph
  cross    tables 2.2 and 2.3: parameters of each recording on every one
  without  2.7.1: force, then torque left out and foretold
  starts   table 2.4: 33 starts, each parameter halved to doubled at random
  effects  a tip that is softer, a force sensor that lags, an encoder's scale: each sealed, recorded
           through the graph twice, and named by `diagnose` of what was identified before
  page     ``docs/hand_tables.md``; a section of which there is no new result stays as it was
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from rich.console import Console

from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_common.progress import progress
from pneu_hw_bridge.hand_lab.hidden import open_truth, seal_truth
from pneu_sim.hand.truth import Lie, Truth
from pneu_sysid.contacts.diagnose import diagnose_scene
from pneu_sysid.contacts.fit import fit_scene
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.read import read_tracks
from pneu_sysid.contacts.scene import Loaded, load_scene, save_scene
from pneu_sysid.contacts.tables import cross, leave_out, spread
from studies.digest import digest_of, sources_digest
from studies.stages import add_stages

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "out" / "hand_tables"
SCENE = ROOT / "scenes/phantom/hanging.yaml"
HAND = ROOT / "scenes/phantom/hand.yaml"
HIDDEN = ROOT / "scenes/phantom/hidden.json"
SEEDS = (1, 2, 3, 4, 5)
SECONDS, EFFECT_SECONDS = 6.0, 4.0
STARTS = 33
FINER = (1.0, 0.5, 0.25)
"""Shares of the scene's knot spacing with which parameters are identified again."""
RATE = 0.25
"""Seconds of the emulated plant in one of the machine's, so that a busy machine keeps up."""
FITTED = ("contact_friction", "contact_stiffness")
"""What is fitted where an effect is sought; all else is as identified before, yet in doubt."""

Tell = Callable[[str, float], None]


def effects() -> dict[str, tuple[Truth, tuple[str, ...], str]]:
    """What is hidden besides, the effects that are right names of it, and words for it."""
    base = open_truth(HIDDEN)
    softer = []
    for change in base.model:
        if change.of == "joint" and change.set == "stiffness":
            change = change.but(to=0.5 * float(change.to or 0.0))
        softer.append(change)
    lag = {name: Lie(lag_s=0.003) for name in ("phantom_force", "phantom_torque")}
    return {
        "soft tip": (
            base.but(model=tuple(softer)),
            ("joint_stiffness@phantom_tip_y", "joint_stiffness@phantom_tip_x"),
            "the tip's springs, half as stiff",
        ),
        "lag": (
            base.but(sensors=lag),
            ("sensor_lag@/lab/phantom/wrench",),
            "force and torque, 3 ms late",
        ),
        "encoder": (
            base.but(sensors={"phantom_linkage": Lie(gain=1.02)}),
            ("sensor_scale@phantom_linkage",),
            "the linkage's encoder, 2 % more",
        ),
    }


def record(bag: Path, truth: Path, seconds: float, seed: int, folder: Path) -> None:
    """Records an exercise of the emulated arm.

    Args:
        bag: Where to.
        truth: What is hidden.
        seconds: How long.
        seed: Of the path and of the noise.
        folder: For sockets and memory.

    Raises:
        InputError: There is no recording afterwards.
    """
    values = {
        "backend": "emulated", "hand": HAND, "truth": truth, "record": bag, "seconds": seconds,
        "seed": seed, "devices": folder / "dev", "rate": RATE, "patience": 8.0,
    }  # fmt: skip
    words = [sys.executable, "-m", "pneu_common.cli", "launch", "pneu_bringup", "hand.launch.yaml"]
    environment = os.environ | {"PNEU_STATE_DIR": str(folder / "state"), "ROS_DOMAIN_ID": "77"}
    done = subprocess.run(
        [*words, *(f"{k}:={v}" for k, v in values.items())],
        cwd=ROOT, env=environment, capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    if not (bag / "metadata.yaml").is_file():
        raise InputError(f"{bag}: was not recorded: {(done.stdout + done.stderr)[-600:]}")


def bags(tell: Tell) -> list[Path]:
    """The five recordings, made where they are not there.

    Args:
        tell: Called with a note and the fraction done.
    """
    found = [OUT / f"recording_{seed}" for seed in SEEDS]
    for k, (bag, seed) in enumerate(zip(found, SEEDS, strict=True)):
        tell(f"recording {seed}", k / len(SEEDS))
        if not (bag / "metadata.yaml").is_file():
            record(bag, HIDDEN, SECONDS, seed, OUT)
    return found


def tabled(physics: Physics, stage: str, tell: Tell) -> dict[str, Any]:
    """Figures of a table.

    Args:
        physics: What evaluates models.
        stage: Which.
        tell: Called with a note and the fraction done.
    """
    loaded = load_scene(SCENE)
    tracks = read_tracks([OUT / f"recording_{seed}" for seed in SEEDS], loaded)
    if stage == "cross":
        crossed = cross(loaded, tracks, physics, tell)
        return {
            "names": crossed.names,
            "labels": crossed.labels,
            "values": crossed.values.tolist(),
            "manual": crossed.manual.tolist(),
            "costs": crossed.costs.tolist(),
            "worst": crossed.worst,
            "gain": crossed.gain,
        }
    if stage == "knots":
        return {"rows": [finer(loaded, share, physics, tell) for share in FINER]}
    if stage == "starts":
        many = spread(loaded, tracks[:1], physics, STARTS, 0, (), tell)
        return {
            "labels": many.labels,
            "values": many.values.tolist(),
            "costs": many.costs.tolist(),
            "same": many.same,
        }
    fitted = load_scene(identified(physics, tell))
    left = leave_out(fitted, tracks[:1], physics, ("phantom_force", "phantom_torque"), tell)
    return {"rows": [asdict(one) for one in left]}


def finer(loaded: Loaded, share: float, physics: Physics, tell: Tell) -> dict[str, Any]:
    """Parameters of the first recording with knots closer together.

    Args:
        loaded: The scene.
        share: Of the scene's spacing.
        physics: What evaluates models.
        tell: Called with a note and the fraction done.
    """
    was = loaded.scene.knots
    knots = was.model_copy(
        update={
            "step_s": share * was.step_s,
            "contact_step_s": share * (was.contact_step_s or was.step_s),
        }
    )
    other = Loaded(loaded.scene.model_copy(update={"knots": knots}), SCENE.parent)
    tracks = read_tracks([OUT / f"recording_{SEEDS[0]}"], other)
    found = fit_scene(other, tracks, physics=physics, tell=tell)
    each = [found.told(k) for k in range(len(found.parameters))]
    return {
        "step_s": knots.step_s,
        "contact_step_s": knots.contact_step_s,
        "labels": [p.label for p in found.parameters],
        "values": [value for value, _ in each],
        "errors": [error for _, error in each],
    }


def identified(physics: Physics, tell: Tell) -> Path:
    """The scene as identified from the first recording, made where it is not there.

    Args:
        physics: What evaluates models.
        tell: Called with a note and the fraction done.
    """
    path = OUT / "identified.yaml"
    if not path.is_file():
        loaded = load_scene(SCENE)
        tracks = read_tracks([OUT / f"recording_{SEEDS[0]}"], loaded)
        found = fit_scene(loaded, tracks, physics=physics, tell=tell)
        save_scene(loaded, found.values, path)
    return path


def held(loaded: Loaded) -> Loaded:
    """The scene with what was identified written into its MJCF, where it may be doubted.

    Args:
        loaded: The scene as identified.
    """
    mjcf, path = OUT / "held.xml", OUT / "held.yaml"
    write_whole(mjcf, loaded.setup(loaded.scene.values).spec.to_xml())
    values = tuple(v for v in loaded.scene.values if v.effect in FITTED)
    scene = loaded.scene.model_copy(update={"mjcf": mjcf.name, "values": values})
    save_scene(Loaded(scene, OUT), values, path)
    return load_scene(path)


def sought(physics: Physics, name: str, tell: Tell) -> dict[str, Any]:
    """Records an effect twice and has it named.

    Args:
        physics: What evaluates models.
        name: Which.
        tell: Called with a note and the fraction done.
    """
    truth, right, words = effects()[name]
    folder = OUT / name.replace(" ", "_")
    folder.mkdir(parents=True, exist_ok=True)
    sealed = folder / "hidden.json"
    seal_truth(truth, sealed)
    recorded = [folder / f"recording_{seed}" for seed in (11, 12)]
    for bag, seed in zip(recorded, (11, 12), strict=True):
        if not (bag / "metadata.yaml").is_file():
            tell(f"recording {name}", 0.0)
            record(bag, sealed, EFFECT_SECONDS, seed, folder)
    loaded = held(load_scene(identified(physics, tell)))
    begun = time.monotonic()
    found = diagnose_scene(loaded, read_tracks(recorded, loaded), physics=physics, tell=tell)
    return {
        "name": name,
        "words": words,
        "right": list(right),
        "verdict": found.verdict,
        "sentence": found.sentence,
        "minutes": (time.monotonic() - begun) / 60.0,
        "finalists": [
            {
                "label": f.label,
                "strength": f.strength,
                "error": f.std_error,
                "gain": f.gain,
                "lead": f.lead,
            }
            for f in found.finalists
        ],
    }


def hidden_values() -> dict[str, str]:
    """What is hidden, by the parameter that it is a value of."""
    told = {}
    for change in open_truth(HIDDEN).model:
        name = f"contact_{change.set}@all" if change.of == "geom" else ""
        told[name or f"joint_{change.set}@{change.name}"] = f"{change.to:.4g}"
    return told


def _ringing_hz(joint: str) -> float:
    """Frequency of a joint on its hidden spring, all else moving as it likes."""
    model = load_scene(SCENE).setup().spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    dof = int(model.joint(joint).dofadr[0])
    spring = float(hidden_values()[f"joint_stiffness@{joint}"])
    return float(np.sqrt(spring * np.linalg.inv(inertia)[dof, dof]) / (2.0 * np.pi))


def _knots(rows: list[dict[str, Any]]) -> list[str]:
    """What the spacing of knots does to parameters."""
    labels, truly = rows[0]["labels"], hidden_values()
    off = [
        {
            label: 100.0 * (value / float(truly[label]) - 1.0)
            for label, value in zip(labels, row["values"], strict=True)
        }
        for row in rows
    ]
    lines = [
        "The first recording again, with knots closer together, near contacts twice as close as"
        " elsewhere: value, its standard error, and how far it is from the hidden one.",
        "",
        "| knots every | " + " | ".join(labels) + " |",
        "|---" * (1 + len(labels)) + "|",
    ]
    for row, far in zip(rows, off, strict=True):
        cells = [
            f"{value:.4g} ± {error:.1g}, {far[label]:+.0f} %"
            for label, value, error in zip(labels, row["values"], row["errors"], strict=True)
        ]
        lines.append(f"| {1e3 * row['step_s']:g} ms | {' | '.join(cells)} |")
    worst = [max(far, key=lambda label: abs(far[label])) for far in off[:: len(off) - 1]]
    return [
        *lines,
        "",
        f"The tip rings at {_ringing_hz('phantom_tip_y'):.0f} Hz, a period of"
        f" {1e3 / _ringing_hz('phantom_tip_y'):.1f} ms. Furthest from the hidden value with the"
        f" scene's knots is {worst[0]}, by {off[0][worst[0]]:+.0f} %, with the closest {worst[1]},"
        f" by {off[-1][worst[1]]:+.0f} %.",
    ]


EFFECTS = "An effect that is hidden besides"


def page(kept: dict[str, Any], path: Path) -> None:
    """Writes the page.

    Args:
        kept: Figures of each stage, and the digest of the sources that they were made by.
        path: The page.
    """
    new: dict[str, list[str]] = {}
    for stage, of in kept.items():
        if not stage.startswith("effect "):
            made = f"Scenes {digest_of([HAND.parent])}, sources {of['sources']}."
            for title, lines in TOLD[stage](of["figures"]).items():
                new[title] = [*lines, "", made]
    if named := {stage: of for stage, of in kept.items() if stage.startswith("effect ")}:
        sources = " and ".join(sorted({of["sources"] for of in named.values()}))
        made = f"Scenes {digest_of([HAND.parent])}, sources {sources}."
        new[EFFECTS] = [*_effects([named[stage]["figures"] for stage in sorted(named)]), "", made]
    old = sections(path.read_text(encoding="utf-8")) if path.is_file() else {}
    lines = [
        "# An arm that touches: the experiments of thesis 2.7",
        "",
        "Made by `make hand-tables`, section by section; each names the scenes and sources that it"
        " is of.",
        "",
        f"Five recordings of {SECONDS:g} s through `hand.launch.yaml backend:=emulated`: a Phantom"
        " taps and presses a cylinder on a string. The truth is hidden in"
        " `scenes/phantom/hidden.json`; the hand-tuned parameters are those of"
        " `scenes/phantom/hanging.xml`.",
        "",
    ]
    for title in (*TITLES, EFFECTS):
        if told := new.get(title, old.get(title)):
            lines += [f"## {title}", "", *told, ""]
    write_whole(path, "\n".join(lines))


def sections(text: str) -> dict[str, list[str]]:
    """Sections of a page by their titles, as lines.

    Args:
        text: The page.
    """
    found = {}
    for section in text.split("\n## ")[1:]:
        title, _, rest = section.partition("\n")
        found[title] = rest.strip().splitlines()
    return found


def _cross(crossed: dict[str, Any]) -> dict[str, list[str]]:
    """Tables 2.2 and 2.3."""
    heads = " | ".join(crossed["labels"])
    values = [f"| recording | {heads} |", "|---" * (1 + len(crossed["labels"])) + "|"]
    for name, row in zip(crossed["names"], crossed["values"], strict=True):
        values.append(f"| {name} | " + " | ".join(f"{v:.4g}" for v in row) + " |")
    truly = hidden_values()
    values.append("| hidden | " + " | ".join(truly.get(k, "") for k in crossed["labels"]) + " |")
    costs = [
        "| recording | hand-tuned | " + " | ".join(f"of {n}" for n in crossed["names"]) + " |",
        "|---" * (2 + len(crossed["names"])) + "|",
    ]
    for k, name in enumerate(crossed["names"]):
        row = [crossed["manual"][k], *crossed["costs"][k]]
        costs.append(f"| {name} | " + " | ".join(f"{v:.4g}" for v in row) + " |")
    costs += [
        "",
        f"At worst {crossed['worst']:.2f} times a recording's own cost (thesis: 1.39);"
        f" hand-tuned at least {crossed['gain']:.2f} times.",
    ]
    return {TITLES[0]: values, TITLES[1]: costs}


def _without(without: dict[str, Any]) -> dict[str, list[str]]:
    """Sensors left out."""
    lines = [
        "| sensor | RMSE without it | with it | its range | RMSE over range |",
        "|---|---|---|---|---|",
    ]
    for row in without["rows"]:
        lines.append(
            f"| {row['sensor']} | {row['rmse']:.4g} | {row['with_it']:.4g} |"
            f" {row['span']:.4g} | {100 * row['rmse'] / row['span']:.1f} % |"
        )
    return {TITLES[3]: lines}


def _starts(starts: dict[str, Any]) -> dict[str, list[str]]:
    """Table 2.4."""
    values, costs = np.array(starts["values"]), np.array(starts["costs"])
    lines = [
        "| | mean | standard deviation | of the mean |",
        "|---|---|---|---|",
        f"| cost | {costs.mean():.5g} | {costs.std():.2g} |"
        f" {100 * costs.std() / costs.mean():.2f} % |",
    ]
    for k, label in enumerate(starts["labels"]):
        mean, std = values[:, k].mean(), values[:, k].std()
        lines.append(f"| {label} | {mean:.5g} | {std:.2g} | {100 * std / mean:.2f} % |")
    return {
        TITLES[4]: [*lines, "", f"{100 * starts['same']:.0f} % end within 2 % of the least cost."]
    }


def _effects(named: list[dict[str, Any]]) -> list[str]:
    """What was hidden, and what was named."""
    lines = [
        "What was identified before is written into the MJCF; friction and stiffness of"
        f" contacts are fitted again. Two recordings of {EFFECT_SECONDS:g} s, of which every"
        " second stretch is fitted, and the others judge.",
        "",
        "| hidden | verdict | named | found | standard errors | minutes |",
        "|---|---|---|---|---|---|",
    ]
    for one in named:
        best = one["finalists"][0] if one["finalists"] else None
        told = one["verdict"] in ("effect", "ambiguous") and best is not None
        label = best["label"] if told and best else "nothing"
        ok = "" if told and label in one["right"] else " (WRONG)"
        figure = f"{best['strength']:.4g} ± {best['error']:.1g}" if told and best else "-"
        lead = f"{best['lead']:.1f}" if told and best else "-"
        lines.append(
            f"| {one['words']} | {one['verdict']} | {label}{ok} | {figure} | {lead} |"
            f" {one['minutes']:.0f} |"
        )
    return [*lines, "", *(f"* {one['words']}: {one['sentence']}" for one in named)]


TITLES = (
    "Parameters of each recording (table 2.2)",
    "Cost of each with parameters of every one (table 2.3)",
    "How close knots must be",
    "A sensor left out and foretold (2.7.1)",
    f"{STARTS} starts, each parameter halved to doubled (table 2.4)",
)
TOLD: dict[str, Callable[[Any], dict[str, list[str]]]] = {
    "cross": _cross,
    "knots": lambda knots: {TITLES[2]: _knots(knots["rows"])},
    "without": _without,
    "starts": _starts,
}
"""Sections of the page, by the stage that makes them."""


def main() -> int:
    """Runs the stages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    add_stages(parser, ("record", "cross", "knots", "without", "starts", "effects", "page"))
    parser.add_argument(
        "--only", nargs="*", help="effects that are sought", default=list(effects())
    )
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "hand_tables.md")
    parser.add_argument("--workers", type=int)
    asked = parser.parse_args()
    console, physics = Console(width=140), Physics(asked.workers)
    sources = sources_digest()  # as they are imported now
    OUT.mkdir(parents=True, exist_ok=True)
    chosen = asked.stages
    todo: list[tuple[str, Callable[[Tell], Any]]] = [
        (stage, lambda tell, stage=stage: tabled(physics, stage, tell))
        for stage in ("cross", "knots", "without", "starts")
        if stage in chosen
    ]
    if "effects" in chosen:
        todo += [
            (f"effect {name}", lambda tell, name=name: sought(physics, name, tell))
            for name in asked.only
        ]
    if "record" in chosen or todo:
        with progress("recording") as tell:
            bags(lambda note, done: tell("recording", done, note))
    for stage, make in todo:
        file = OUT / f"{stage.replace(' ', '_')}.json"
        if file.is_file():
            continue
        with progress(stage) as tell:
            figures = make(lambda note, done, stage=stage: tell(stage, done, note))  # type: ignore[misc]
        write_whole(file, json.dumps({"sources": sources, "figures": figures}))
        console.print(f"{stage}: {json.dumps(figures)[:600]}")
    if "page" in chosen:
        kept = {}
        for stage in (
            "cross",
            "knots",
            "without",
            "starts",
            *(f"effect {name}" for name in effects()),
        ):
            file = OUT / f"{stage.replace(' ', '_')}.json"
            if file.is_file():
                kept[stage] = json.loads(file.read_text(encoding="utf-8"))
        page(kept, asked.page)
        console.print(f"{asked.page} is written")
    return 0


if __name__ == "__main__":
    sys.exit(main())
