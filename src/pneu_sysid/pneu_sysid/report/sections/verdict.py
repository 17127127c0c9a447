# SPDX-License-Identifier: Apache-2.0
"""The verdict: one sentence, and the few figures that carry it."""

from pneu_sysid.report import quantities as q
from pneu_sysid.report.contents import Contents, Result
from pneu_sysid.report.markup import Markup, join, tag
from pneu_sysid.sensor_units import Unit

ID = "verdict"
TITLE = "Verdict"

WORDS = {
    "nothing_missing": ("✓", "Nothing is missing"),
    "effect": ("➤", "A missing effect was found"),
    "ambiguous": ("≈", "Several effects explain it equally well"),
    "unknown": ("?", "Something is missing that the catalogue does not hold"),
}
"""Mark and words of each verdict, for rigs and scenes."""

# What is said of the rig that learning ends with, once something was added to it.
_AFTER = {
    "nothing_missing": "nothing more is missing",
    "effect": "the error falls",
    "ambiguous": "several further effects fit equally well",
    "unknown": "what remains is not in the catalogue",
}


def render(contents: Contents) -> Markup:
    """Return the verdict card, the key figures and what they were made from.

    Args:
        contents: The results to report.
    """
    judged = contents.learn or contents.diagnose
    kind = str((judged or {}).get("verdict") or "none")
    mark, word = WORDS.get(kind, ("•", "Result"))
    sentence = (judged or {}).get("sentence") or _own_sentence(contents)
    added = [step for step in (contents.learn or {}).get("steps") or [] if step.get("added")]
    if added and kind in _AFTER:
        word = f"{len(added)} effect{'s' if len(added) > 1 else ''} added; {_AFTER[kind]}"
    card = tag(
        "div",
        tag("p", tag("span", mark, aria_hidden="true", class_="mark"), word, class_="word"),
        tag("p", sentence, class_="sentence"),
        [
            tag("p", said, class_="note")
            for said in (contents.diagnose or {}).get("statements") or []
        ],
        class_=f"card {kind if kind in WORDS else 'none'}",
    )
    tiles = [*_learned(contents.learn), *_diagnosed(contents), *_compared(contents)]
    if not tiles:
        tiles = _fitted(contents.fit)
    return join(card, tag("div", tiles, class_="tiles"), _sources(contents))


def _own_sentence(contents: Contents) -> str:
    ranked = sorted(
        (m for m in contents.models if m.get("times_noise") is not None),
        key=lambda model: model["times_noise"],
    )
    if ranked:
        best = ranked[0]
        sentence = f"{best.get('name')} errs by {q.times(best['times_noise'])} the sensor noise"
        others = [f"{m.get('name')} by {q.times(m['times_noise'])}" for m in ranked[1:]]
        return sentence + (f", {', '.join(others)}." if others else ".")
    if contents.fit:
        if short := contents.fit.get("shortfall"):
            taps = ", ".join(f"{q.times(v)} at {tap}" for tap, v in short["times_noise"].items())
            return f"The calibration stops short: it leaves more than the noise, {taps}."
        parameters = _not_held(contents.fit)
        good = sum(bool(p.get("identified")) for p in parameters)
        return f"{good} of {len(parameters)} fitted parameters are identified by this recording."
    return "The results carry no verdict."


def _not_held(fit: Result) -> list[Result]:
    """What a fit was allowed to change."""
    return [p for p in fit.get("parameters") or [] if not p.get("held")]


def _tile(value: str | Markup, label: str, note: str = "") -> Markup:
    return tag(
        "div",
        tag("p", value, class_="value long" if "±" in value else "value"),
        tag("p", label, class_="label"),
        tag("p", note, class_="note") if note else None,
        class_="tile",
    )


def _strength(effect: Result) -> str:
    unit = str(effect.get("unit") or "").partition(",")[0]  # what it means is in the ranking
    return q.with_error(effect.get("strength"), effect.get("std_error"), unit)


def _arrow(before: str, after: str) -> Markup:
    return join(
        tag("span", before, class_="was"),
        " → ",
        tag("span", after, class_="is"),
    )


def _learned(learn: Result | None) -> list[Markup]:
    steps = (learn or {}).get("steps") or []
    if not steps:
        return []
    first, last = steps[0], steps[-1]
    tiles = []
    for key, label in (
        ("held_out_times_noise", "held-out error over sensor noise"),
        ("total_times_noise", "training error over sensor noise"),
    ):
        if first.get(key) is not None and last.get(key) is not None:
            tiles.append(_tile(_arrow(q.times(first[key]), q.times(last[key])), label))
    for step in steps:
        if step.get("added"):
            place = step.get("place")
            tiles.append(
                _tile(
                    _strength(step),
                    f"{step['added']} @ {place}" if place else str(step["added"]),
                    "added",
                )
            )
    return tiles[:5]


def _diagnosed(contents: Contents) -> list[Markup]:
    diagnose = contents.diagnose or {}
    candidates = diagnose.get("candidates") or []
    if not candidates or diagnose.get("verdict") not in ("effect", "ambiguous"):
        return []
    best = candidates[0]
    tiles = []
    if not contents.learn:
        tiles.append(
            _tile(
                _strength(best),
                f"{best.get('effect')} @ {best.get('place')}",
                "best candidate",
            )
        )
    explained = best.get("refit_fraction")
    if explained is None:
        explained = best.get("explained_fraction")
    tiles.append(_tile(q.percent(explained), f"of the excess error explained by {best['effect']}"))
    return tiles


def _compared(contents: Contents) -> list[Markup]:
    if contents.learn:
        return []
    return [
        _tile(
            q.times(model.get("times_noise")),
            f"{model.get('name')}: error over sensor noise",
            ""
            if contents.encoders and model.get("rmse_pa") is None
            else f"{q.kilopascal(model.get('rmse_pa'))} kPa RMS"
            + (" at the taps" if contents.encoders else ""),
        )
        for model in contents.models[:4]
    ]


def _fitted(fit: Result | None) -> list[Markup]:
    if not fit:
        return []
    return [
        _tile(str(len(_not_held(fit))), "fitted parameters"),
        _tile(q.number(fit.get("condition")), "condition number"),
    ]


def _sources(contents: Contents) -> Markup:
    noise: dict[Unit, list[float]] = {}
    for sensor, floor in contents.noise_floor.items():
        noise.setdefault(contents.unit(sensor), []).append(floor)
    spreads = []
    for unit, floors in noise.items():
        low, high = (q.number(unit.scale * end(floors)) for end in (min, max))
        spreads.append(f"{low} {unit.told}" if low == high else f"{low} to {high} {unit.told}")
    entries = {
        "Recording": ", ".join(contents.head("recording")),
        "Rig": ", ".join(contents.head("rig", "rigs", "rig(s)")),
        "Taps": ", ".join(contents.taps),
        "Encoders": ", ".join(contents.encoders),
        "Sensor noise": ", ".join(spreads),
        "Written to": ", ".join(contents.head("output")),
    }
    return tag(
        "dl",
        [(tag("dt", key), tag("dd", value)) for key, value in entries.items() if value],
        class_="sources",
    )
