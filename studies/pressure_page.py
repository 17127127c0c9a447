# SPDX-License-Identifier: Apache-2.0
"""The page, the figures and the data of the study of pressure control."""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pneu_common.files import write_whole
from pneu_hw_bridge.lab.sealed import open_sealed
from pneu_policy.judge import figures
from pneu_policy.judge.results import (
    LIMIT,
    Evaluation,
    error_rows,
    load,
    markdown,
    rows,
    save,
    spread,
)
from pneu_policy.learn.history import History

THESIS = {
    ("short", "smooth"): (0.090, 0.319),
    ("short", "jagged"): (0.181, 0.315),
    ("long", "smooth"): (0.173, 0.460),
    ("long", "jagged"): (0.225, 0.392),
}
"""Table 9.1: RMSE of the policies trained in the full and in the thin-plate model, atm."""

TITLES = {
    "pde": "trained in the full model, all taps; the target told in steps of 40 ms (thesis 9.2.1)",
    "plate": "trained in the thin-plate model, which knows the controlled tap alone; else as `pde`",
    "pde_fine": "as `pde`, the target told in steps of 10 ms at first, four past commands seen",
    "plate_fine": "as `plate`, with what `pde_fine` is told",
    "pde_plain": "as `pde`, trained as in the thesis on one rig without delay or noise",
    "plate_plain": "as `plate`, trained likewise",
    "one_tap": "as `pde_fine`, but sees the controlled tap alone",
    "no_encoding": "as `pde` without positional encoding",
    "no_encoding_fine": "as `pde_fine` without positional encoding",
    "line": "as `pde_fine`, sees the gas at points of the tube as well (simulation only)",
    "pid": "PID, tuned on the full model by `pneu tune`",
    "feed_forward": "PID with feed-forward from the target ahead, tuned likewise",
    LIMIT: "the plant's limit: voltages optimised with plant and target known",
}
WITHOUT = (
    ("pde_fine", "one_tap", "without the other taps"),
    ("line", "pde_fine", "without the gas along the tube"),
    ("pde", "no_encoding", "without positional encoding"),
    ("pde_fine", "no_encoding_fine", "without positional encoding, target told finely"),
)
"""Variants with something, those without it, and what it is."""
COMPARED = """## What is compared

All policies share the algorithm, its settings, the number of episodes, the targets, and, but for
the `_plain` ones, noise and commands that are 3 to 12 ms late. They differ in the model, and, as in
the thesis, in what the model knows: all taps, or the controlled one alone. `one_tap` stands
between: the full model, one tap.
Each model's ensemble is drawn by the standard errors of its own calibration; those of the thin
plate are wide, and some of its draws stand at the bounds of their parameters (the spool's bandwidth
of the long tube at 164 Hz).

The settings (discount, iterations, averaging) were chosen on the short tube and the full model. The
`_fine` policies were added after the others had been looked at in simulation, on the targets of the
table too; on the lab nothing had run before.

What was found is told in [control.md](control.md#what-the-study-found).
"""
MAIN = ("pde", "plate", "pde_fine", "plate_fine", "pid", "feed_forward", LIMIT)
PLAIN = ("pde", "plate", "pde_plain", "plate_plain")


def write(root: Path, out: Path) -> None:
    """Writes page, figures and data from what the stages have found.

    Args:
        root: The repository.
        out: Folder of the stages.
    """
    live = load(out / "live" / "evaluation.json")
    simulated_path = out / "simulated" / "evaluation.json"
    simulated = load(simulated_path) if simulated_path.exists() else None
    docs = root / "docs"
    pictures = _draw(live, docs / "figures")
    training, curves = _training(out / "training", docs)
    save(live, docs / "pressure.json")
    parts = [_head(live), _table(live), _marks(live), COMPARED, _all(live), *pictures]
    parts += [_without(live, simulated), *curves, _time(training), _simulated(simulated)]
    parts += [_plants(root), _measured(live)]
    text = "\n".join(part.rstrip() + "\n" for part in parts if part)
    write_whole(docs / "pressure.md", text)


def _head(live: Evaluation) -> str:
    lines = [
        "# Pressure control: learned and classical",
        "",
        "Made by `make study-pressure`. Policies are trained in simulation alone and run unchanged",
        "on the emulated lab, whose plants differ from every model that was trained on (below).",
        "",
        "| controller | |",
        "|---|---|",
        *(f"| `{name}` | {TITLES.get(name, '')} |" for name in live.names()),
    ]
    return "\n".join(lines)


def _table(live: Evaluation) -> str:
    heads, body = error_rows(_only(live, MAIN))
    tasks = live.settings["tasks"]
    text = (
        f"{len(tasks['seeds'])} runs of {tasks['duration_s']:g} s of each task, the first"
        f" {tasks['skip_s']:g} s not judged; mean ± standard deviation over the runs, each with"
        " another target. Of learned controllers the run with target seed n takes training seed n"
        " modulo their number, so that all are run and none is chosen."
    )
    return f"## Table 9.1 on the emulated lab\n\n{text}\n\n{markdown(heads, body)}{_plain(live)}"


def _plain(live: Evaluation) -> str:
    """What training on one rig without delay or noise does, where it was tried."""
    if "pde_plain" not in live.names():
        return ""
    short = _only(live, PLAIN)
    short = replace(short, runs=[run for run in short.runs if run.plant == "short"])
    text = (
        "Trained as in the thesis on one rig without delay or noise (`_plain`), beside the above:"
    )
    return f"\n{text}\n\n{markdown(*error_rows(short))}"


def _marks(live: Evaluation) -> str:
    """Beside the thesis: errors, and how much worse the thin plate's policies are."""
    heads = ["policies", "task", "full model", "thesis", "thin plate / full model", "thesis", "met"]
    body = []
    pairs = (("pde", "plate"), ("pde_fine", "plate_fine"), ("pde_plain", "plate_plain"))
    for full, simple in pairs:
        for (plant, kind), (pde, plate) in THESIS.items():
            ours, _ = spread(live.values("rmse_atm", full, plant, kind))
            other, _ = spread(live.values("rmse_atm", simple, plant, kind))
            if not (math.isfinite(ours) and math.isfinite(other)):
                continue
            # The thesis' ratios are given to one digit after the point.
            low, worse = ours <= pde, other / ours >= round(plate / pde, 1)
            met = [what for what, is_met in (("error", low), ("ratio", worse)) if is_met]
            body.append(
                [
                    f"`{full}`, `{simple}`",
                    f"{plant}, {kind}",
                    f"{ours:.3f}",
                    f"{pde:.3f}",
                    f"{other / ours:.1f}",
                    f"{plate / pde:.1f}",
                    " and ".join(met) or "none",
                ]
            )
    return (
        f"Beside thesis table 9.1, which is of another rig, RMSE in atm:\n\n{markdown(heads, body)}"
    )


def _all(live: Evaluation) -> str:
    text = (
        "Latency is the shift of the target that fits best, positive where the pressure is late,"
        " and the adjusted error what is left then (thesis table 9.2). Effort is the command's RMS"
        " about null, rate that of its change. Oscillation is the error's RMS above the targets'"
        " band; reversals are turns of at least 5 kPa beyond those of the target."
    )
    return f"## All figures\n\n{text}\n\n{markdown(*rows(live))}"


def _draw(live: Evaluation, folder: Path) -> list[str]:
    main = [n for n in MAIN if n in live.names()]
    out = []
    figures.draw_errors(live, folder / "pressure_errors.png", main)
    out.append("![errors of all runs](figures/pressure_errors.png)\n")
    for plant in live.plants():
        if figures.draw_runs(live, plant, main, folder / f"pressure_{plant}.png"):
            out.append(f"![runs on the {plant} tube](figures/pressure_{plant}.png)\n")
    pair = [n for n in ("pde_fine", "one_tap") if n in live.names()]
    path = folder / "pressure_taps.png"
    if "one_tap" in pair and figures.draw_runs(live, "short", pair, path):
        out.append("![with and without the other taps](figures/pressure_taps.png)\n")
    return out


def _without(live: Evaluation, simulated: Evaluation | None) -> str:
    """What extra state features and positional encoding are good for."""
    heads = ["", "where", "target", "with", "without", "ratio"]
    body = []
    for where, evaluation in (("lab", live), ("simulation", simulated)):
        for whole, variant, title in WITHOUT:
            for kind in evaluation.kinds() if evaluation else ():
                assert evaluation is not None
                full = evaluation.values("rmse_atm", whole, "short", kind)
                less = evaluation.values("rmse_atm", variant, "short", kind)
                if full and less:
                    a, b = spread(full), spread(less)
                    cells = [f"{m:.3f} ± {d:.3f}" for m, d in (a, b)]
                    body.append([title, where, kind, *cells, f"{b[0] / a[0]:.2f}"])
    if not body:
        return ""
    return (
        "## What helps\n\nShort tube, RMSE in atm. The thesis has 0.090 with and 0.140 without the"
        f" other taps (fig. 9.5).\n\n{markdown(heads, body)}"
    )


def _training(folder: Path, docs: Path) -> tuple[list[dict[str, Any]], list[str]]:
    """Trainings by variant and seed; those of a study before where they are not there any more."""
    found: list[dict[str, Any]] = []
    groups: dict[str, list[History]] = {}
    for path in sorted(folder.glob("*/seed-*/history.json")):
        history = History.load(path)
        if not history.rows:
            continue
        variant, seed = path.parent.parent.name, path.parent.name.removeprefix("seed-")
        first = history.learned()
        judged = [row for row in history.rows if row["eval_rmse"] is not None]
        found.append(
            {
                "variant": variant,
                "seed": int(seed),
                "samples_to_0.1_atm": None if first is None else first["samples"],
                "seconds_to_0.1_atm": None if first is None else first["wall_s"],
                "samples": history.rows[-1]["samples"],
                "seconds": history.rows[-1]["wall_s"],
                "rmse_atm": judged[-1]["eval_rmse"] if judged else None,
            }
        )
        groups.setdefault(variant, []).append(history)
    kept = docs / "pressure_training.json"
    if not found:
        return (json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else []), []
    kept.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    from pneu_policy.learn.curves import learning_curves

    pictures = []
    for tube in ("short", "long"):
        chosen = {n.removeprefix(f"{tube}_"): h for n, h in groups.items() if n.startswith(tube)}
        if chosen:
            learning_curves(chosen, docs / "figures" / f"pressure_training_{tube}.png", tube)
            pictures.append(
                f"![learning curves, {tube} tube](figures/pressure_training_{tube}.png)\n"
            )
    return found, pictures


def _time(training: Sequence[dict[str, Any]]) -> str:
    """How long training took."""
    body = []
    for variant in dict.fromkeys(one["variant"] for one in training):
        own = [one for one in training if one["variant"] == variant]
        reached = [one for one in own if one["seconds_to_0.1_atm"] is not None]
        body.append(
            [
                variant.replace("_", ", ", 1).replace("_", " "),
                str(len(own)),
                f"{len(reached)} of {len(own)}",
                _range([one["seconds_to_0.1_atm"] / 60.0 for one in reached], "{:.1f}"),
                _range([one["samples_to_0.1_atm"] / 1e3 for one in reached], "{:.0f}"),
                _range([one["seconds"] / 60.0 for one in own], "{:.1f}"),
                _range([one["rmse_atm"] for one in own if one["rmse_atm"] is not None], "{:.3f}"),
            ]
        )
    if not body:
        return ""
    heads = ["training", "seeds", "reached 0.1 atm", "after min", "after 1000 samples"]
    heads += ["whole, min", "error in its own model, atm"]
    text = (
        "Each error is that of the policy without exploration in the model it was trained in; least"
        " and greatest of all seeds. Times are of one core, with as many trainings beside as the"
        " machine has cores."
    )
    return f"## Training\n\n{text}\n\n{markdown(heads, body)}"


def _range(values: Sequence[float], form: str) -> str:
    if not values:
        return "-"
    low, high = form.format(min(values)), form.format(max(values))
    return low if low == high else f"{low} to {high}"


def _simulated(simulated: Evaluation | None) -> str:
    if simulated is None:
        return ""
    return (
        "## In simulation\n\nThe same targets on the calibrated rig itself, with sensor noise and a"
        f" delay of 4 ms:\n\n{markdown(*error_rows(simulated))}"
    )


def _plants(root: Path) -> str:
    lines = [
        "## The plants",
        "",
        "The lab simulates the calibrated rig on cells of half its length, behind Modbus, with",
        "sensor noise of 250 Pa and readings that are 2 ms old, and with these effects besides.",
        "They were chosen once, as fractions of the typical sizes of",
        "[effects.md](effects.md), before any controller was tried.",
        "",
        "| tube | effect | at | |",
        "|---|---|---|---|",
    ]
    for file in sorted((root / "rigs" / "plants").glob("*.sealed.json"), reverse=True):
        for effect in open_sealed(file):
            numbers = ", ".join(f"{name} {value:g}" for name, value in effect.parameters.items())
            tube = file.name.partition(".")[0]
            lines.append(f"| {tube} | {effect.effect} | {effect.place} | {numbers} |")
    return "\n".join(lines)


def _measured(live: Evaluation) -> str:
    tasks = live.settings["tasks"]
    own = [run for run in live.runs if run.controller != LIMIT]
    again = [run for run in own if run.attempts > 1]
    failed = [run for run in own if run.metrics is None]
    text = (
        f"Targets lie between {tasks['low_pa'] / 1e3:g} and {tasks['high_pa'] / 1e3:g} kPa with"
        f" {tasks['period_s']:g} s from one extreme to the next (`pneu_policy.task.targets`)."
        " Errors are computed from the recording alone, with the sensor's own reading. The limit is"
        " of the"
        " known plant on 30 cells per tube and without noise, each voltage held for 10 ms. Of"
        f" {len(own)} runs on the lab {len(again)} were repeated, because the machine had not kept"
        f" up; {len(failed)} are missing for that reason."
    )
    return f"## How it was measured\n\n{text}"


def _only(evaluation: Evaluation, names: Sequence[str]) -> Evaluation:
    runs = [run for run in evaluation.runs if run.controller in names]
    return replace(evaluation, runs=runs)
