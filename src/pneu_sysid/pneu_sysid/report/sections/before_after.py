# SPDX-License-Identifier: Apache-2.0
"""Error of each sensor before the first effect was added and after the last."""

from pneu_sysid.report import quantities as q
from pneu_sysid.report.contents import Contents, both, ratio
from pneu_sysid.report.heat import heat_class
from pneu_sysid.report.markup import Markup, join, tag

ID = "before-after"
TITLE = "Before and after"

_PARTS = (("rmse", "Training"), ("held_out_rmse", "Held-out"))


def render(contents: Contents) -> Markup:
    """Return the table of errors before and after learning, per tap.

    Args:
        contents: The results to report.
    """
    steps = (contents.learn or {}).get("steps") or []
    if len(steps) < 2:
        return Markup()
    first, last = steps[0], steps[-1]
    floors = contents.noise_floor
    parts = [(key, name) for key, name in _PARTS if both(first, key) or both(last, key)]
    rows = []
    for tap in contents.sensors_of(contents.learn):
        cells, unit = [], contents.unit(tap)
        for key, _ in parts:
            before, after = (both(step, key).get(tap) for step in (first, last))
            for value in (before, after):
                times = ratio(value, floors.get(tap))
                cells.append(tag("td", q.amount(value, unit), class_="num"))
                cells.append(tag("td", q.times(times), class_=f"num cell {heat_class(times)}"))
            fall = ratio(before, after)
            cells.append(tag("td", q.number(fall) if fall else q.NONE, class_="num strong"))
        floor = tag("td", q.amount(floors.get(tap), unit), class_="num")
        rows.append(tag("tr", tag("th", contents.named(tap), scope="row"), floor, cells))
    upper = tag(
        "tr",
        tag("th", "Sensor" if contents.encoders else "Tap", rowspan=2, scope="col"),
        tag("th", contents.headed("Sensor noise"), rowspan=2, scope="col", class_="num"),
        [tag("th", name, colspan=5, scope="colgroup", class_="group") for _, name in parts],
    )
    before_, after_ = contents.headed("before"), contents.headed("after")
    names = (before_, "over noise", after_, "over noise", "falls by factor")
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
