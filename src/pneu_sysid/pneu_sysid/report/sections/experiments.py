# SPDX-License-Identifier: Apache-2.0
"""Experiments that were designed: what each was expected to tell, beside what it told."""

from pathlib import Path

from pneu_sysid.report import quantities as q
from pneu_sysid.report.contents import Contents, Result
from pneu_sysid.report.markup import Markup, join, table, tag

ID = "experiments"
TITLE = "Experiments"

_WIDE, _EDGE = 150, 4


def render(contents: Contents) -> Markup:
    """Return what every experiment told of the candidates that it was to tell apart.

    Args:
        contents: The results to report.
    """
    experiments: list[Result] = (contents.learn or {}).get("experiments") or []
    if not experiments:
        return Markup()
    rows, words = [], []
    for one in experiments:
        name = Path(str(one.get("plan"))).name
        said = [str(line) for line in one.get("words") or []]
        words += [tag("li", tag("code", name), f": {line}") for line in said]
        told: list[Result] = one.get("told_apart") or []
        length = q.number(one.get("seconds"))
        head = tag(
            "th", tag("code", name), f" {one.get('kind')}, {length} s", scope="row",
            rowspan=max(len(told), 1),
        )  # fmt: skip
        if not told:
            cell = tag("td", "was to tell parameters, or to be a first look", colspan=5)
            rows.append(tag("tr", head, cell))
        for k, pair in enumerate(told):
            rows.append(
                tag(
                    "tr",
                    head if k == 0 else None,
                    tag("td", tag("code", str(pair.get("one"))), " from ", _code(pair, "other")),
                    tag("td", q.number(pair.get("expected")), class_="num"),
                    tag("td", q.number(pair.get("found")), class_="num"),
                    tag("td", q.number(pair.get("needed")), class_="num"),
                    tag("td", _drawn(pair)),
                )
            )
    header = [
        "Experiment",
        "was to tell",
        tag("th", "expected", scope="col", class_="num"),
        tag("th", "found", scope="col", class_="num"),
        tag("th", "needed", scope="col", class_="num"),
        "",
    ]
    caption = (
        "Standard errors by which the first leads; negative where the other does. The dot is what"
        " was found, the hollow one what was expected, the tick what is needed."
    )
    return join(
        table(caption, header, rows),
        tag("ul", words, class_="warnings") if words else None,
    )


def _code(pair: Result, key: str) -> Markup:
    return tag("code", str(pair.get(key)))


def _drawn(pair: Result) -> Markup:
    """The three numbers on one line."""
    values = {key: pair.get(key) for key in ("expected", "found", "needed")}
    known = [v for v in values.values() if v is not None]
    if not known:
        return join(q.NONE)
    low, high = min(0.0, *known), max(1.0, *known)

    def x(at: float) -> float:
        return round(_EDGE + (_WIDE - 2 * _EDGE) * (at - low) / (high - low), 1)

    def dot(key: str, class_: str) -> Markup | None:
        at = values[key]
        return None if at is None else tag("circle", cx=x(at), cy=8, r=4, class_=class_)

    needed = values["needed"]
    name = ", ".join(f"{key} {q.number(value)}" for key, value in values.items())
    return tag(
        "svg",
        tag("title", name),
        tag("line", x1=_EDGE, x2=_WIDE - _EDGE, y1=8, y2=8, class_="rail"),
        tag("line", x1=x(0.0), x2=x(0.0), y1=5, y2=11, class_="rail"),
        None
        if needed is None
        else tag("line", x1=x(needed), x2=x(needed), y1=2, y2=14, class_="zero"),
        dot("expected", "hollow"),
        dot("found", "dot"),
        width=_WIDE,
        height=16,
        role="img",
        aria_label=name,
    )
