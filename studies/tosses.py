# SPDX-License-Identifier: Apache-2.0
"""Objects that were really tossed: what is found of them, and how well other tosses are foretold.

A scene is fitted to every second recording of a folder and foretells the others, whole, from how
each begins; beside it stand the parameters that the authors of the recordings give, in the same
MuJoCo model. Then it is asked what is missing, and what is named is added. The page says what it
was made from.
"""

import argparse
import hashlib
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from pneu_common.files import write_whole
from pneu_sysid.contacts.diagnose import SceneDiagnosis, diagnose_scene
from pneu_sysid.contacts.fit import SceneFit, fit_scene
from pneu_sysid.contacts.foresee import Foreseen, foresee
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.read import read_tracks
from pneu_sysid.contacts.scene import Loaded, Value, load_scene
from pneu_sysid.contacts.track import Track
from studies import toss_peer
from studies.digest import sources_digest

ROOT = Path(__file__).resolve().parent.parent


KEPT = ROOT / "out" / "tosses"
"""Sections that are done, so that a run that was ended goes on from there."""


@dataclass(frozen=True)
class Object:
    """An object that was tossed.

    Attributes:
        scene: Its scene file.
        side_m: Length that positions are told in percent of, m.
        authors: What the authors of the recordings give of it.
        published: What else is published of it.
    """

    scene: str
    side_m: float
    authors: tuple[Value, ...]
    published: str = ""


OBJECTS = {
    "cube": Object(
        "scenes/cube.yaml",
        0.1048,
        (Value(effect="contact_friction", at="all", value=0.18),),
        "Published: friction and corners within 5 % of the truth (Dojo.jl, documentation of its"
        " system identification).",
    ),
    "elbow": Object(
        "scenes/elbow.yaml", 0.1, (Value(effect="contact_friction", at="all", value=0.3),)
    ),
}


def with_authors(loaded: Loaded, thing: Object) -> tuple[Value, ...]:
    """The scene's values with those that the authors give.

    Args:
        loaded: The scene.
        thing: The object.
    """
    given = {(v.effect, v.at): v for v in loaded.scene.values}
    for value in thing.authors:
        given[value.effect, value.at] = value
    return tuple(given.values())


FRAMES = ("frame_tilt_x", "frame_tilt_y")
"""Effects that say of the recordings' frame what their authors do not."""


def in_frame(values: tuple[Value, ...], fitted: tuple[Value, ...]) -> tuple[Value, ...]:
    """Values in a frame that stands as it was found.

    Args:
        values: They.
        fitted: Those that were found.
    """
    found = {(v.effect, v.at): v for v in fitted if v.effect in FRAMES}
    return tuple(found.get((v.effect, v.at), v) for v in values)


def row(name: str, thing: Object, foreseen: list[Foreseen]) -> str:
    """A line of the table of what was foretold.

    Args:
        name: Of the model.
        thing: The object.
        foreseen: What it foretold.
    """
    place = 100.0 / thing.side_m * np.array([f.mean("position") for f in foreseen])
    turn = np.degrees([f.mean("orientation") for f in foreseen])
    lost = int(np.sum(~np.isfinite(place) | ~np.isfinite(turn)))
    return (
        f"| {name} | {np.mean(place):.1f} | {np.median(place):.1f} | {np.mean(turn):.1f} |"
        f" {np.median(turn):.1f} | {lost} |"
    )


def parameters(fit: SceneFit) -> list[str]:
    """Fitted parameters as lines of a table.

    Args:
        fit: The fit.
    """
    out = []
    for k, p in enumerate(fit.parameters):
        value, error = fit.told(k)
        out.append(f"| {p.label} | {value:.4g} | {error:.2g} | {p.effect.unit or '-'} |")
    return out


def beside_authors(fit: SceneFit, thing: Object, words: str) -> list[str]:
    """How far fitted parameters are from those that the authors give.

    Args:
        fit: The fit.
        thing: The object.
        words: Which model it is.
    """
    given = {(v.effect, v.at): v.value for v in thing.authors}
    out = []
    for k, p in enumerate(fit.parameters):
        theirs = given.get((p.effect.name, p.place))
        if theirs:
            share = 100.0 * (fit.told(k)[0] / theirs - 1.0)
            out.append(f"* {p.label} {words}: {share:+.1f} % from the authors' {theirs:g}")
    return out


def section(
    name: str,
    thing: Object,
    tracks: list[Track],
    console: Console,
    workers: int | None,
) -> list[str]:
    """What the page says of one object.

    Args:
        name: Its name.
        thing: It.
        tracks: Its recordings.
        console: Where progress is told.
        workers: Threads.
    """
    loaded = load_scene(ROOT / thing.scene)
    physics = Physics(workers)
    used, others = tracks[::2], tracks[1::2]
    begun = time.monotonic()

    def tell(note: str, done: float = 0.0) -> None:
        console.print(f"{name}: {note} ({time.monotonic() - begun:.0f} s)")

    rows = [
        row("the authors' friction", thing, foresee(loaded, others, with_authors(loaded, thing)))
    ]
    if toss_peer.available():
        tell("mujoco.sysid")
        peer = toss_peer.fitted(loaded, foresee(loaded, used), loaded.scene.values)
        rows.append(row("mujoco.sysid", thing, foresee(loaded, others, peer)))
        its = ", ".join(f"{v.effect} {v.value:.4g}" for v in peer if v.value is not None)
        told = f"`mujoco.sysid` with its defaults, from the same start: {its}."
    else:
        told = "`mujoco.sysid` is not installed: left out."
    tell("fitting")
    fit = fit_scene(loaded, used, physics=physics)
    rows.append(row("fitted", thing, foresee(loaded, others, fit.values)))
    if any(v.effect in FRAMES for v in fit.values):
        theirs = in_frame(with_authors(loaded, thing), fit.values)
        rows.insert(
            1, row("the authors' friction, frame as fitted", thing, foresee(loaded, others, theirs))
        )
    tell("diagnosing")
    found: SceneDiagnosis = diagnose_scene(loaded, tracks, fit.values, physics, tell)
    lines = [
        f"## {name}",
        "",
        f"{len(used)} tosses fitted, {len(others)} others foretold from their first"
        f" {loaded.scene.start_s:g} s.",
        "",
        f"* verdict: {found.verdict}",
        f"* {found.sentence}",
        "",
        "| candidate | found | std. error | cost kept aside falls by | standard errors |",
        "|---|---|---|---|---|",
    ]
    for f in found.finalists:
        lines.append(
            f"| {f.label} | {f.strength:.4g} | {f.std_error:.2g} | {100 * f.gain:.1f} % |"
            f" {f.lead:.1f} |"
        )
    lines += [
        "",
        "| parameter | fitted | std. error | unit |",
        "|---|---|---|---|",
        *parameters(fit),
    ]
    beside = beside_authors(fit, thing, "as it is")
    if found.verdict in ("effect", "ambiguous"):
        tell("with what is missing")
        best = found.finalists[0]
        p = best.score.parameter
        start = Value(effect=p.effect.name, at=p.place, value=best.strength)
        better = fit_scene(loaded, used, (*fit.values, start), physics)
        rows.append(row(f"with {best.label}", thing, foresee(loaded, others, better.values)))
        lines += ["", f"With {best.label}:", "", "| parameter | fitted | std. error | unit |"]
        lines += ["|---|---|---|---|", *parameters(better)]
        beside += beside_authors(better, thing, f"with {best.label}")
    head = (
        "| model | position, % of the side, mean | median | turn, degrees, mean | median | lost |"
    )
    notes = [thing.published, ""] if thing.published else []
    return [*lines, "", *beside, "", *notes, told, "", head, "|---" * 6 + "|", *rows, ""]


def digest(folder: Path) -> str:
    """Digest of the recordings in a folder.

    Args:
        folder: The folder.
    """
    total = hashlib.sha256()
    for file in sorted(folder.glob("*.csv")):
        total.update(file.name.encode())
        total.update(file.read_bytes())
    return total.hexdigest()[:12]


def main(arguments: list[str] | None = None) -> int:
    """Runs the study; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder with folders cube and elbow of CSV files")
    parser.add_argument("--only", nargs="*", choices=list(OBJECTS), default=list(OBJECTS))
    parser.add_argument("--most", type=int, default=64, help="tosses of each, evenly")
    parser.add_argument("--page", type=Path, help="file that receives the page")
    parser.add_argument("--workers", type=int)
    options = parser.parse_args(arguments)
    console, sources = Console(width=140), sources_digest()
    lines = ["# Tosses", "", "Made by `make tosses TOSSES=folder`.",
             f"Made from the sources {sources}.", ""]  # fmt: skip
    KEPT.mkdir(parents=True, exist_ok=True)
    for name in options.only:
        thing = OBJECTS[name]
        folder = options.folder / name
        files = sorted(folder.glob("*.csv"))
        if len(files) > options.most:
            files = [files[int(k)] for k in np.linspace(0, len(files) - 1, options.most).round()]
        tracks = read_tracks(files, load_scene(ROOT / thing.scene))
        lines[3] += f" {name}: {digest(folder)}."
        kept = KEPT / f"{name}_{options.most}_{sources}_{digest(folder)}.md"
        if not kept.exists():
            found = section(name, thing, tracks, console, options.workers)
            write_whole(kept, "\n".join(found))
        lines += kept.read_text(encoding="utf-8").split("\n")
    text = "\n".join(lines)
    console.print(text, soft_wrap=True)
    if options.page is not None:
        write_whole(options.page, text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
