# SPDX-License-Identifier: Apache-2.0
"""Error of each tap before the first effect was added and after the last."""

from pneu_sysid.report import quantities as q
from pneu_sysid.report.contents import Contents, ratio
from pneu_sysid.report.heat import heat_class
from pneu_sysid.report.markup import Markup, join, tag

ID = "before-after"
TITLE = "Before and after"

_PARTS = (("rmse_pa", "Training"), ("held_out_rmse_pa", "Held-out"))


def render(contents: Contents) -> Markup:
    """Return the table of errors before and after learning, per tap.

    Args:
        contents: The results to report.
    """
    steps = (contents.learn or {}).get("steps") or []
    if len(steps) < 2:
        return Markup()
    first, last = steps[0], steps[-1]
    floors = contents.noise_floor_pa
    parts = [(key, name) for key, name in _PARTS if first.get(key) or last.get(key)]
    rows = []
    for tap in contents.taps_of(contents.learn):
        cells = []
        for key, _ in parts:
            before, after = ((step.get(key) or {}).get(tap) for step in (first, last))
            for value in (before, after):
                times = ratio(value, floors.get(tap))
                cells.append(tag("td", q.kilopascal(value), class_="num"))
                cells.append(tag("td", q.times(times), class_=f"num cell {heat_class(times)}"))
            fall = ratio(before, after)
            cells.append(tag("td", q.number(fall) if fall else q.NONE, class_="num strong"))
        floor = tag("td", q.kilopascal(floors.get(tap)), class_="num")
        rows.append(tag("tr", tag("th", tap, scope="row"), floor, cells))
    upper = tag(
        "tr",
        tag("th", "Tap", rowspan=2, scope="col"),
        tag("th", "Sensor noise, kPa", rowspan=2, scope="col", class_="num"),
        [tag("th", name, colspan=5, scope="colgroup", class_="group") for _, name in parts],
    )
    names = ("before, kPa", "over noise", "after, kPa", "over noise", "falls by factor")
    lower = tag(
        "tr", [[tag("th", name, scope="col", class_="num") for name in names] for _ in parts]
    )
    added = [
        f"{step['added']} @ {step['place']}" if step.get("place") else str(step["added"])
        for step in steps
        if step.get("added")
    ]
    caption = f"RMS error without and with {', '.join(added)}" if added else "RMS error"
    return join(
        tag(
            "div",
            tag(
                "table",
                tag("caption", caption),
                tag("thead", upper, lower),
                tag("tbody", rows),
            ),
            class_="scroll",
        )
    )
