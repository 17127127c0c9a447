# SPDX-License-Identifier: Apache-2.0
"""Candidate effects, best first: what each explains, how strong it is, and its look-alikes."""

from pneu_sysid.report import quantities as q
from pneu_sysid.report.contents import Contents, Result
from pneu_sysid.report.markup import Markup, join, table, tag

ID = "ranking"
TITLE = "Candidate effects"

_SHOWN = 10
_BAR_PX, _ZERO_PX = 190, 30
_BARS = (
    ("explained_fraction", "score", "first-order"),
    ("refit_fraction", "refit", "after refit"),
    ("held_out_gain", "held", "held-out gain"),
)


def render(contents: Contents) -> Markup:
    """Return the ranking of the tested candidates and what an unknown effect depends on.

    Args:
        contents: The results to report.
    """
    diagnose = contents.diagnose or {}
    candidates = [c for c in diagnose.get("candidates") or [] if c.get("tested") is not False]
    parts: list[Markup] = []
    if contents.learn and diagnose.get("sentence"):
        parts.append(tag("p", diagnose["sentence"]))
    if candidates:
        parts.append(
            tag(
                "p",
                [
                    (tag("span", class_=f"swatch {kind}"), label, " ")
                    for _, kind, label in (
                        ("", "score", "excess error explained, first order"),
                        ("", "refit", "explained after a refit"),
                        ("", "held", "fall of the error on held-out data"),
                    )
                ],
                class_="key",
            )
        )
        parts.append(_ranking(candidates[:_SHOWN], 1))
        if rest := candidates[_SHOWN:]:
            summary = tag("summary", f"{len(rest)} more candidates")
            parts.append(tag("details", summary, _ranking(rest, _SHOWN + 1)))
    parts.append(_depends(diagnose))
    return join(parts)


def _ranking(candidates: list[Result], first: int) -> Markup:
    rows = []
    for rank, candidate in enumerate(candidates, start=first):
        place = candidate.get("place")
        position = candidate.get("position_m")
        where = f"{place or ''}" + (f" {q.number(position)} m" if position is not None else "")
        mates = candidate.get("indistinguishable_from") or []
        experiment = candidate.get("next_experiment")
        rows.append(
            tag(
                "tr",
                tag("td", rank, class_="num"),
                tag(
                    "th",
                    tag("code", f"{candidate.get('effect')}" + (f" @ {where}" if where else "")),
                    tag("small", str(candidate["title"])) if candidate.get("title") else None,
                    scope="row",
                ),
                tag("td", _bars(candidate)),
                tag(
                    "td",
                    q.with_error(
                        candidate.get("strength"),
                        candidate.get("std_error"),
                        candidate.get("unit"),
                    ),
                    _whisker(candidate.get("strength"), candidate.get("std_error")),
                ),
                tag("td", q.number(candidate.get("significance"), 2), class_="num"),
                tag(
                    "td",
                    tag("p", "Not told apart from: ", ", ".join(map(str, mates)), class_="mates")
                    if mates
                    else None,
                    tag("p", f"Next experiment: {experiment}") if experiment else None,
                    class_="text",
                ),
                class_="first",
            )
        )
    header = [
        "#",
        "Effect and place",
        "Explains",
        "Strength",
        tag("th", "Strength over its error", scope="col", class_="num"),
        "Look-alikes on this recording",
    ]
    caption = "Strengths with one standard error; its line spans two, the tick is zero."
    return table(caption, header, rows, class_="ranking")


def _bars(candidate: Result) -> Markup:
    drawn = []
    for row, (key, kind, label) in enumerate(_BARS):
        value = candidate.get(key)
        y = 17 * row
        if value is not None:
            # A negative gain goes to the left of zero; beyond the margin only its number counts.
            length = max(-_ZERO_PX, min(1.0, value) * _BAR_PX)
            drawn.append(
                tag(
                    "rect",
                    x=round(_ZERO_PX + min(length, 0), 1),
                    y=y + 3,
                    width=round(abs(length), 1),
                    height=11,
                    class_=f"bar {kind}",
                )
            )
        end = _ZERO_PX + max(0.0, min(1.0, value or 0.0)) * _BAR_PX
        drawn.append(
            tag(
                "text",
                tag("title", label),
                q.percent(value),
                x=round(end + 6, 1),
                y=y + 13,
                class_="tick",
            )
        )
    drawn.append(tag("line", x1=_ZERO_PX, x2=_ZERO_PX, y1=0, y2=51, class_="zero"))
    name = ", ".join(f"{label} {q.percent(candidate.get(key))}" for key, _, label in _BARS)
    return tag("svg", drawn, width=_ZERO_PX + _BAR_PX + 50, height=52, role="img", aria_label=name)


def _whisker(strength: float | None, error: float | None) -> Markup | None:
    if strength is None or not error:
        return None
    low, high = min(0.0, strength - 2 * error), max(0.0, strength + 2 * error)

    def x(value: float) -> float:
        return round(4 + 142 * (value - low) / (high - low), 1)

    return tag(
        "svg",
        tag("line", x1=4, x2=146, y1=8, y2=8, class_="rail"),
        tag("line", x1=x(0), x2=x(0), y1=2, y2=14, class_="zero"),
        tag(
            "line",
            x1=x(strength - 2 * error),
            x2=x(strength + 2 * error),
            y1=8,
            y2=8,
            class_="interval",
        ),
        tag("circle", cx=x(strength), cy=8, r=3.5, class_="dot"),
        width=150,
        height=16,
        class_="whisker",
        aria_hidden="true",
    )


def _depends(diagnose: Result) -> Markup:
    entries = [e for e in diagnose.get("depends_on") or [] if e.get("gain") is not None]
    if not entries:
        return Markup()
    rows = []
    for entry in entries:
        length = round(max(0.0, min(1.0, entry["gain"])) * _BAR_PX, 1)
        bar = tag(
            "svg",
            tag("rect", x=0, y=1, width=length, height=12, class_="bar held"),
            width=_BAR_PX,
            height=14,
            aria_hidden="true",
        )
        rows.append(
            tag(
                "tr",
                tag("th", str(entry.get("variable")), scope="row"),
                tag("td", str(entry.get("tap") or "all")),
                tag("td", bar, tag("span", q.percent(entry["gain"]), class_="after")),
            )
        )
    caption = "How much of the held-out error a smooth function of one variable takes away"
    return join(
        tag("h3", "What the remaining error depends on"),
        table(caption, ["Variable", "Tap", "Held-out gain"], rows),
    )
