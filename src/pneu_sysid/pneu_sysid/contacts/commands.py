# SPDX-License-Identifier: Apache-2.0
"""What `pneu fit`, `compare`, `diagnose` and `learn` do where they are given a scene for a rig."""

import math
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console

from pneu_common.errors import InputError
from pneu_common.progress import progress
from pneu_common.tables import Column, NamedTable
from pneu_sysid.contacts.diagnose import SceneDiagnosis, diagnose_scene
from pneu_sysid.contacts.effects import find_scene_effect
from pneu_sysid.contacts.fit import fit_scene
from pneu_sysid.contacts.foresee import Foreseen, foresee
from pneu_sysid.contacts.learn import learn_scene
from pneu_sysid.contacts.outcome import (
    result_of_compare,
    result_of_diagnosis,
    result_of_fit,
    result_of_learning,
)
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.read import read_tracks
from pneu_sysid.contacts.report import write_scene_report
from pneu_sysid.contacts.scene import Loaded, Value, load_scene, save_scene
from pneu_sysid.contacts.track import Track
from pneu_sysid.results.files import write_json
from pneu_sysid.results.scenes import (
    SceneCompareResult,
    SceneDiagnoseResult,
    SceneFitResult,
    SceneLearnResult,
)


def fit(
    bags: list[Path],
    path: Path,
    output: Path,
    json_path: Path | None,
    report: Path | None,
    workers: int | None,
    console: Console,
) -> None:
    """Fits a scene to recordings and writes it.

    Args:
        bags: The recordings.
        path: The scene file.
        output: Where the fitted scene goes.
        json_path: Where the result goes.
        report: Where the HTML report goes.
        workers: Threads.
        console: Where it is told.
    """
    loaded, tracks = _read(bags, path, console)
    begun = time.monotonic()
    with progress("fitting") as tell:
        found = fit_scene(
            loaded,
            tracks,
            physics=Physics(workers),
            tell=lambda note, done: tell("fitting", done, note),
        )
    save_scene(loaded, found.values, output)
    result = result_of_fit(path, output, found, tracks, time.monotonic() - begun)
    console.print(parameter_table(result, f"{loaded.scene.name} fitted"))
    for note in result.notes:
        console.print(note, style="yellow")
    console.print(f"{result.unknowns} unknowns; wrote {output}")
    _write(result, json_path, console)
    if report is not None:
        foretold = _foretold(
            loaded, tracks, {"before": loaded.scene.values, "fitted": found.values}
        )
        _say(write_scene_report(report, result, foretold, fit=result), console)


def compare(
    bags: list[Path],
    paths: Sequence[Path],
    json_path: Path | None,
    report: Path | None,
    console: Console,
) -> None:
    """Foretells whole recordings from how they begin, by one scene or several.

    Args:
        bags: The recordings.
        paths: Scene files.
        json_path: Where the result of the first goes.
        report: Where the HTML report goes.
        console: Where it is told.
    """
    results: list[tuple[str, SceneCompareResult]] = []
    foretold: dict[str, list[Foreseen]] = {}
    for path in paths:
        loaded, tracks = _read(bags, path, console)
        with progress("foretelling"):
            foreseen = foresee(loaded, tracks)
        results.append((loaded.scene.name, result_of_compare(path, loaded, tracks, foreseen)))
        foretold[path.stem if path.stem not in foretold else str(path)] = foreseen
    console.print(misread_table(results))
    _, first = results[0]
    console.print(f"From the first {first.start_s:g} s of each recording, over all of it.")
    _write(first, json_path, console)
    if report is not None:
        _say(write_scene_report(report, first, foretold), console)


def diagnose(
    bags: list[Path],
    path: Path,
    json_path: Path | None,
    report: Path | None,
    workers: int | None,
    console: Console,
) -> None:
    """Says which effect a scene's model is missing.

    Args:
        bags: The recordings.
        path: The scene file.
        json_path: Where the result goes.
        report: Where the HTML report goes.
        workers: Threads.
        console: Where it is told.
    """
    loaded, tracks = _read(bags, path, console)
    with progress("diagnosing") as tell:
        found = diagnose_scene(
            loaded,
            tracks,
            physics=Physics(workers),
            tell=lambda note, done: tell("diagnosing", done, note),
        )
    console.print(candidate_table(found))
    console.print(found.sentence, style="bold")
    console.print(
        f"Fitted to {len(found.used)} recordings or stretches, judged by {len(found.aside)} others."
    )
    result = result_of_diagnosis(path, loaded, tracks, found)
    _write(result, json_path, console)
    if report is not None:
        models = {"as it is": found.base.values}
        if found.verdict in ("effect", "ambiguous"):
            models[f"with {found.finalists[0].label}"] = found.finalists[0].fit.values
        shown = _aside(tracks, found)
        _say(
            write_scene_report(report, result, _foretold(loaded, shown, models), diagnosis=result),
            console,
        )


def learn(
    bags: list[Path],
    path: Path,
    output: Path,
    json_path: Path | None,
    workers: int | None,
    console: Console,
) -> None:
    """Adds effects to a scene until none is worth it.

    Args:
        bags: The recordings.
        path: The scene file.
        output: Folder of the results.
        json_path: Where the result goes besides.
        workers: Threads.
        console: Where it is told.
    """
    loaded, tracks = _read(bags, path, console)
    with progress("learning") as tell:
        found = learn_scene(
            loaded,
            tracks,
            output,
            Physics(workers),
            lambda note, done: tell("learning", done, note),
        )
    result = result_of_learning(path, loaded, tracks, found, output)
    console.print(step_table(result))
    console.print(found.sentence, style="bold")
    save_scene(loaded, found.values, output / "scene.yaml")
    write_json(output / "learn.json", result)
    _write(result, json_path, console)
    console.print(f"wrote {output / 'scene.yaml'}")
    first = found.diagnoses[0]
    models = {"before": first.base.values}
    if found.added:
        models["after"] = found.values
    page = write_scene_report(
        output / "report.html",
        result,
        _foretold(loaded, _aside(tracks, first), models),
        diagnosis=result_of_diagnosis(path, loaded, tracks, first),
        learned=result,
    )
    _say(page, console)


def _aside(tracks: list[Track], found: SceneDiagnosis) -> list[Track]:
    """The recordings that were kept aside, or all where stretches of one were."""
    return [t for t in tracks if t.name in found.aside] or tracks


def _foretold(
    loaded: Loaded, tracks: Sequence[Track], models: dict[str, tuple[Value, ...]]
) -> dict[str, list[Foreseen]]:
    """What several models foretell of the same recordings."""
    with progress("foretelling"):
        return {name: foresee(loaded, tracks, values) for name, values in models.items()}


def _say(page: Path, console: Console) -> None:
    console.print(f"report: {page}")


def _read(bags: list[Path], path: Path, console: Console) -> tuple[Loaded, list[Track]]:
    loaded = load_scene(path)
    tracks = read_tracks(bags, loaded)
    if not tracks:
        raise InputError("no recording was given")
    for finding in dict.fromkeys(f"{t.name}: {f}" for t in tracks for f in t.findings):
        console.print(finding, style="yellow")
    return loaded, tracks


def _write(
    result: SceneCompareResult | SceneFitResult | SceneDiagnoseResult | SceneLearnResult,
    json_path: Path | None,
    console: Console,
) -> None:
    if json_path is not None:
        write_json(json_path, result)
        console.print(f"wrote {json_path}")


def misread_table(results: Sequence[tuple[str, SceneCompareResult]]) -> NamedTable:
    """Return the error of each sensor of several scenes, with the recording where it is largest.

    Args:
        results: Name and comparison of each scene.
    """
    table = NamedTable(
        "off over the whole recording, mean",
        [Column("scene"), Column("sensor"), Column("unit"), Column("mean", "number"),
         Column("median", "number"), Column("worst", "number"), Column("in", "words")],
    )  # fmt: skip
    for name, result in results:
        for sensor, unit in result.sensors.items():
            # a model that ran away is worse than any that did not
            each = {
                recording: math.inf if (mean := off[sensor].mean) is None else mean
                for recording, off in result.off.items()
            }
            worst = max(each, key=lambda recording: each[recording])
            shown = [result.mean[sensor], result.median[sensor], each[worst]]
            told = ["ran away" if x is None or x == math.inf else f"{x:.4g}" for x in shown]
            table.add_row(name, sensor, unit, *told, worst)
    return table


def step_table(result: SceneLearnResult) -> NamedTable:
    """Return the held-out cost after every added effect.

    Args:
        result: What was learned.
    """
    table = NamedTable(
        "cost per knot of what is kept aside",
        [Column("added"), Column("strength", "words"), Column("cost", "number")],
    )
    for step in result.steps:
        name = "nothing yet" if step.added is None else f"{step.added}@{step.place}"
        strength = (
            "" if step.strength is None else f"{step.strength:.3g} ± {step.std_error or 0.0:.1g}"
        )
        cost = "-" if step.held_out_loss is None else f"{step.held_out_loss:.4g}"
        table.add_row(name, f"{strength} {step.unit or ''}".strip(), cost)
    return table


def parameter_table(result: SceneFitResult, title: str) -> NamedTable:
    """Fitted parameters as a table.

    Args:
        result: The fit.
        title: Its title.
    """
    table = NamedTable(
        title,
        [Column("parameter"), Column("start", "number"), Column("value", "number"),
         Column("std. error", "number"), Column("unit"), Column("", "words")],
    )  # fmt: skip
    for p in result.parameters:
        error = "-" if p.std_error is None else f"{p.std_error:.2g}"
        start, value = ("-" if x is None else f"{x:.5g}" for x in (p.start, p.value))
        note = "at bound" if p.at_bound else ""
        table.add_row(f"{p.effect}@{p.place}", start, value, error, p.unit or "-", note)
    return table


def candidate_table(found: SceneDiagnosis) -> NamedTable:
    """Candidates as a table, those that were refitted first.

    Args:
        found: The diagnosis.
    """
    table = NamedTable(
        "candidates, best first",
        [Column("effect"), Column("place"), Column("strength", "words"), Column("score", "number"),
         Column("held out", "number"), Column("t", "number"), Column("not to be told from")],
    )  # fmt: skip
    for f in found.finalists:
        p = f.score.parameter
        strength = f"{f.strength:.3g} ± {f.std_error:.1g} {p.effect.unit}".strip()
        table.add_row(
            p.effect.name, p.place, strength, f"{f.score.gain:.3g}", f"{100 * f.gain:.0f} %",
            f"{f.lead:.1f}", ", ".join(f.alike),
        )  # fmt: skip
    return table


def add(
    name: str,
    place: str,
    bags: list[Path],
    path: Path,
    output: Path,
    workers: int | None,
    console: Console,
) -> None:
    """Adds an effect to a scene and fits it.

    Args:
        name: The effect.
        place: Where; empty where it has one place only.
        bags: The recordings.
        path: The scene file.
        output: Where the better scene goes.
        workers: Threads.
        console: Where it is told.
    """
    loaded, tracks = _read(bags, path, console)
    effect = find_scene_effect(name)
    setup = loaded.setup(loaded.scene.values)
    places = effect.places(setup)
    at = place or (places[0] if len(places) == 1 else "")
    if at not in places:
        raise InputError(
            f"effect {name!r}: place {place!r} is not one of {', '.join(places) or 'none here'}"
        )
    now = effect.value(setup, at)
    start = now * 1.1 if effect.logarithmic else now + effect.typical
    value = Value(effect=name, at=at, value=float(np.clip(start, effect.lower, effect.upper)))
    kept = tuple(v for v in loaded.scene.values if (v.effect, v.at) != (name, at))
    with progress("adding") as tell:
        found = fit_scene(
            loaded,
            tracks,
            (*kept, value),
            Physics(workers),
            lambda note, done: tell("adding", done, note),
        )
    save_scene(loaded, found.values, output)
    result = result_of_fit(path, output, found, tracks, None)
    console.print(parameter_table(result, f"{loaded.scene.name} with {name}@{at}"))
    console.print(f"wrote {output}")
