# SPDX-License-Identifier: Apache-2.0
"""The HTML report of a scene: verdict, where the model fails, what was tried and found."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pneu_sysid.contacts.foresee import Foreseen
from pneu_sysid.report import quantities as q
from pneu_sysid.report import write_page
from pneu_sysid.report.markup import Markup, join, table, tag
from pneu_sysid.report.sections.verdict import WORDS
from pneu_sysid.results.scenes import (
    SceneDiagnoseResult,
    SceneFitResult,
    SceneHead,
    SceneLearnResult,
)

Floats = NDArray[np.float64]

NOTE = (
    "Recordings are foretold whole from how they begin; lengths in metres, angles in radians unless"
    " a degree sign says otherwise."
)
LEFT, TOP, WIDTH, HEIGHT, RIGHT, BOTTOM = 72, 12, 620, 190, 16, 40  # px
LINES = 3
"""Components of a sensor that are drawn, at most."""

Foretold = Mapping[str, Sequence[Foreseen]]
"""What each of several models foretells of the same recordings, by its name."""


def write_scene_report(
    path: Path,
    result: SceneHead,
    foretold: Foretold,
    fit: SceneFitResult | None = None,
    diagnosis: SceneDiagnoseResult | None = None,
    learned: SceneLearnResult | None = None,
) -> Path:
    """Writes the report: one file that loads nothing.

    Args:
        path: The file, replaced if it is there.
        result: The result of the command; what it was made from.
        foretold: What models foretell of the recordings.
        fit: What was fitted.
        diagnosis: What is missing.
        learned: What was added.

    Returns:
        Its path.

    Raises:
        InputError: It cannot be written.
    """
    judged = learned or diagnosis
    sections = [
        ("verdict", "Verdict", _verdict(judged, result)),
        ("waterfall", "Error per added effect", _steps(learned)),
        ("errors", "Where it fails", _errors(result, foretold)),
        ("ranking", "Candidates", _candidates(diagnosis)),
        ("fit", "Fitted", _parameters(fit)),
        ("findings", "Findings", _list(result.findings)),
    ]
    heading = f"{Path(result.scene).stem}: {_count(result.recordings, 'recording')}"
    return write_page(path, heading, sections, result.pneu_version, NOTE)


def _count(things: Sequence[str], word: str) -> str:
    return things[0] if len(things) == 1 else f"{len(things)} {word}s"


def _list(lines: Sequence[str]) -> Markup:
    return tag("ul", [tag("li", line) for line in lines]) if lines else Markup()


def _verdict(judged: SceneDiagnoseResult | SceneLearnResult | None, result: SceneHead) -> Markup:
    sources = tag(
        "dl",
        tag("dt", "Scene"),
        tag("dd", tag("code", result.scene)),
        tag("dt", "Recordings"),
        tag("dd", ", ".join(result.recordings)),
        class_="sources",
    )
    if judged is None:
        return sources
    mark, word = WORDS[judged.verdict]
    card = tag(
        "div",
        tag("p", tag("span", mark, aria_hidden="true", class_="mark"), word, class_="word"),
        tag("p", judged.sentence, class_="sentence"),
        class_=f"card {judged.verdict}",
    )
    return join(card, sources)


def _steps(learned: SceneLearnResult | None) -> Markup:
    if learned is None:
        return Markup()
    most = max((s.held_out_loss or 0.0 for s in learned.steps), default=0.0) or 1.0
    rows = []
    for step in learned.steps:
        name = "the scene as it was" if step.added is None else f"+ {step.added} at {step.place}"
        loss = step.held_out_loss or 0.0
        bar = _bar(loss / most, 240, f"{loss:.3g}")
        strength = q.with_error(step.strength, step.std_error, step.unit) if step.added else ""
        rows.append(
            tag(
                "tr",
                tag("th", name, scope="row"),
                tag("td", strength),
                tag("td", q.number(step.held_out_loss), class_="num"),
                tag("td", bar),
            )
        )
    head = ["", "strength", tag("th", "cost per knot", scope="col", class_="num"), ""]
    return table("What is left of recordings that are kept aside", head, rows)


def _bar(share: float, width: int, label: str) -> Markup:
    """A share as a bar, of all of the width at most."""
    long = round(width * max(0.0, min(1.0, share)), 1)
    drawn = tag("rect", x=0, y=2, width=long, height=12, class_="held")
    return tag("svg", drawn, width=width, height=16, role="img", aria_label=label)


def _candidates(diagnosis: SceneDiagnoseResult | None) -> Markup:
    if diagnosis is None:
        return Markup()
    rows, others = [], []
    for c in diagnosis.candidates:
        if not c.tested:
            others.append(
                tag(
                    "tr",
                    tag("th", f"{c.title} at {c.place}", scope="row"),
                    tag("td", q.number(c.score), class_="num"),
                )
            )
            continue
        bar = _bar(c.held_out_gain or 0.0, 120, q.percent(c.held_out_gain))
        rows.append(
            tag(
                "tr",
                tag("th", c.title, tag("small", f"at {c.place}"), scope="row"),
                tag("td", q.with_error(c.strength, c.std_error, c.unit)),
                tag("td", bar, " ", q.percent(c.held_out_gain)),
                tag("td", q.number(c.significance), class_="num"),
                tag("td", ", ".join(c.indistinguishable_from) or "-"),
            )
        )
    head = [
        "effect",
        "strength",
        "explains of what is kept aside",
        tag("th", "standard errors", scope="col", class_="num"),
        "not to be told from",
    ]
    first = table("Refitted, and judged by recordings kept aside", head, rows, class_="ranking")
    if not others:
        return first
    score = tag("th", "log-likelihood it would add", scope="col", class_="num")
    second = table("To first order, over all recordings fitted", ["effect", score], others)
    return join(first, tag("details", tag("summary", "Candidates that were only scored"), second))


def _parameters(fit: SceneFitResult | None) -> Markup:
    if fit is None:
        return Markup()
    rows = [
        tag(
            "tr",
            tag("th", f"{p.effect} at {p.place}", scope="row"),
            tag("td", q.number(p.start), class_="num"),
            tag("td", q.with_error(p.value, p.std_error, p.unit)),
            tag("td", tag("span", "at its bound", class_="badge") if p.at_bound else ""),
        )
        for p in fit.parameters
    ]
    start = tag("th", "start", scope="col", class_="num")
    return join(
        table(f"{fit.unknowns} unknowns", ["parameter", start, "found", ""], rows),
        _list(fit.notes),
    )


def _errors(result: SceneHead, foretold: Foretold) -> Markup:
    if not foretold:
        return Markup()
    parts = [_key(list(foretold))]
    for sensor, unit in result.sensors.items():
        scale, shown = (180.0 / np.pi, "°") if unit == "rad" else (1.0, unit)
        times, lines = _over_time(sensor, foretold, scale)
        middle = [(f"m{k}", m) for k, (m, _, _) in enumerate(lines)]
        bands = [(k, low, high) for k, (_, low, high) in enumerate(lines)]
        drawn = _chart(f"off, {shown}", times, middle, bands)
        note = (
            "median over recordings; the band holds four fifths of them; one that has ended counts"
            " by how it ended"
        )
        parts.append(tag("figure", tag("h3", sensor), drawn, tag("figcaption", note)))
        parts.append(_worst(sensor, shown, foretold))
    return join(parts, _table(result, foretold))


def _key(names: Sequence[str]) -> Markup:
    shown = [(tag("span", class_=f"swatch m{k % 4}"), f" {name} ") for k, name in enumerate(names)]
    return tag("p", shown, class_="key")


def _over_time(
    sensor: str, foretold: Foretold, scale: float
) -> tuple[Floats, list[tuple[Floats, Floats, Floats]]]:
    """Times, and per model median, tenth and ninetieth percentile over recordings."""
    every = [f for each in foretold.values() for f in each]
    longest = max(float(f.time_s[sensor][-1] - f.chain.time_s[0]) for f in every)
    times = np.linspace(0.0, longest, 160)
    out = []
    for each in foretold.values():
        rows = np.full((len(each), len(times)), np.nan)
        for row, f in zip(rows, each, strict=True):
            t = f.time_s[sensor] - f.chain.time_s[0]
            off = np.where(np.isfinite(f.off[sensor]), f.off[sensor], np.nan)
            row[:] = np.interp(times, t, off) * scale
        seen = np.any(np.isfinite(rows), axis=0)
        found = np.full((3, len(times)), np.nan)
        found[:, seen] = np.nanpercentile(rows[:, seen], [50.0, 10.0, 90.0], axis=0)
        out.append((found[0], found[1], found[2]))
    return times, out


def _worst(sensor: str, unit: str, foretold: Foretold) -> Markup:
    """The recording that the first model foretells worst, component by component."""
    first = next(iter(foretold.values()))
    known = [f for f in first if sensor in f.read]
    if not known:
        return Markup()
    finite = [np.nan_to_num(f.mean(sensor), posinf=np.finfo(float).max) for f in known]
    name = known[int(np.argmax(finite))].track.name
    parts: list[Markup] = []
    for k in range(min(LINES, known[0].read[sensor].shape[1])):
        lines: list[tuple[str, Floats]] = []
        times = np.zeros(0)
        for number, each in enumerate(foretold.values()):
            f = next(f for f in each if f.track.name == name)
            times = f.time_s[sensor] - f.chain.time_s[0]
            if not lines:
                lines.append(("measured", f.read[sensor][:, k]))
            lines.append((f"m{number % 4}", f.told[sensor][:, k]))
        width = known[0].read[sensor].shape[1]
        axis = f"{sensor}{'' if width == 1 else ' ' + 'xyzw'[k]}, {unit}"
        parts.append(_chart(axis, times, lines, []))
    return tag(
        "details",
        tag("summary", f"{name}, which is foretold worst, beside what was measured (dark)"),
        parts,
    )


def _chart(
    axis: str,
    times: Floats,
    lines: Sequence[tuple[str, Floats]],
    bands: Sequence[tuple[int, Floats, Floats]],
) -> Markup:
    """Lines over time, with bands behind them."""
    values = [y for _, y in lines] + [y for _, low, high in bands for y in (low, high)]
    flat = np.concatenate(values) if values else np.zeros(1)
    flat = flat[np.isfinite(flat)]
    low, high = (0.0, 1.0) if not len(flat) else (float(np.min(flat)), float(np.max(flat)))
    if bands:
        low = min(low, 0.0)
    if high - low < 1e-12:
        high = low + 1.0
    end = float(times[-1]) or 1.0

    def x(at: float) -> float:
        return round(LEFT + WIDTH * at / end, 1)

    def y(at: float) -> float:
        return round(TOP + HEIGHT * (1.0 - (at - low) / (high - low)), 1)

    drawn: list[Markup] = []
    for tick in _ticks(low, high):
        drawn.append(tag("line", x1=LEFT, x2=LEFT + WIDTH, y1=y(tick), y2=y(tick), class_="grid"))
        drawn.append(tag("text", f"{tick:.3g}", x=LEFT - 8, y=y(tick) + 4, class_="tick end"))
    for tick in _ticks(0.0, end):
        base = TOP + HEIGHT + 18
        drawn.append(tag("text", f"{tick:.3g}", x=x(tick), y=base, class_="tick middle"))
    for k, bottom, top in bands:
        there = np.isfinite(bottom) & np.isfinite(top)
        edge = [(x(t), y(v)) for t, v in zip(times[there], top[there], strict=True)]
        back = [(x(t), y(v)) for t, v in zip(times[there], bottom[there], strict=True)]
        points = " ".join(f"{a},{b}" for a, b in [*edge, *back[::-1]])
        drawn.append(tag("polygon", points=points, class_=f"m{k % 4} band"))
    for name, line in lines:
        drawn += [
            tag("polyline", points=points, class_=f"curve {name}")
            for points in _runs(line, x, y, times)
        ]
    drawn.append(tag("text", "time, s", x=LEFT + WIDTH / 2, y=TOP + HEIGHT + 36, class_="axis"))
    turned = f"translate(14 {TOP + HEIGHT / 2}) rotate(-90)"
    drawn.append(tag("text", axis, transform=turned, class_="axis"))
    size = (LEFT + WIDTH + RIGHT, TOP + HEIGHT + BOTTOM)
    return tag(
        "svg",
        tag("title", f"{axis} over time"),
        drawn,
        viewBox=f"0 0 {size[0]} {size[1]}",
        width=size[0],
        role="img",
        class_="chart",
    )


def _ticks(low: float, high: float) -> list[float]:
    """Some five round numbers."""
    raw = (high - low) / 5.0
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * next(m for m in (1.0, 2.0, 5.0, 10.0) if m * power >= raw)
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [float(step * k) for k in range(first, last + 1)]


def _runs(
    line: Floats, x: Callable[[float], float], y: Callable[[float], float], times: Floats
) -> list[str]:
    """Points of each stretch that is known."""
    out: list[list[str]] = [[]]
    for t, v in zip(times, line, strict=True):
        if np.isfinite(v):
            out[-1].append(f"{x(t)},{y(v)}")
        elif out[-1]:
            out.append([])
    return [" ".join(points) for points in out if len(points) > 1]


def _table(result: SceneHead, foretold: Foretold) -> Markup:
    rows = []
    names = [f.track.name for f in next(iter(foretold.values()))]
    for k, recording in enumerate(names):
        cells = []
        for sensor, unit in result.sensors.items():
            for each in foretold.values():
                mean = each[k].mean(sensor) * (180.0 / np.pi if unit == "rad" else 1.0)
                shown = f"{mean:.3g}" if np.isfinite(mean) else "ran away"
                cells.append(tag("td", shown, class_="num"))
        rows.append(tag("tr", tag("th", recording, scope="row"), cells))
    head: list[Markup | str] = ["recording"]
    for sensor, unit in result.sensors.items():
        for name in foretold:
            label = f"{sensor}, {'°' if unit == 'rad' else unit}"
            words = f"{label}: {name}" if len(foretold) > 1 else label
            head.append(tag("th", words, scope="col", class_="num"))
    return tag(
        "details",
        tag("summary", "Every recording"),
        table("Mean over the whole recording of how far it is off", head, rows),
    )
