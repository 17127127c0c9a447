# SPDX-License-Identifier: Apache-2.0
"""How the error falls with each added effect, on training and on held-out data."""

import math

from pneu_sysid.report import quantities as q
from pneu_sysid.report.contents import Contents, Result, both, ratio
from pneu_sysid.report.heat import heat_class
from pneu_sysid.report.markup import Markup, join, table, tag

ID = "waterfall"
TITLE = "Error per added effect"

_TOP, _HEIGHT, _BOTTOM, _LEFT = 16, 230, 66, 62  # px
_COLUMN_PX = 210
_SERIES = (("total_times_noise", "train"), ("held_out_times_noise", "held"))


def render(contents: Contents) -> Markup:
    """Return the waterfall chart and the error of each tap at each step.

    Args:
        contents: The results to report.
    """
    steps = (contents.learn or {}).get("steps") or []
    levels = [step[key] for step in steps for key, _ in _SERIES if (step.get(key) or 0) > 0]
    chart = _chart(steps, levels) if levels else Markup()
    return join(chart, _per_tap(steps, contents)) if steps else Markup()


def _chart(steps: list[Result], levels: list[float]) -> Markup:
    low = min(0.8, 0.85 * min(levels))
    high = max(2.0, 1.35 * max(levels))
    width = _LEFT + _COLUMN_PX * len(steps) + 96

    def y(level: float) -> float:
        share = math.log(level / low) / math.log(high / low)
        return round(_TOP + _HEIGHT * (1.0 - share), 1)

    drawn = [
        join(
            tag("line", x1=_LEFT, x2=width - 96, y1=y(t), y2=y(t), class_="grid"),
            tag("text", f"{t:g}", x=_LEFT - 8, y=y(t) + 4, class_="tick end"),
        )
        for t in _ticks(low, high)
    ]
    title = "RMS error over sensor noise (log)"
    drawn.append(
        tag(
            "text",
            title,
            transform=f"translate(14 {_TOP + _HEIGHT / 2}) rotate(-90)",
            class_="axis",
        )
    )
    last: dict[str, float] = {}
    for index, step in enumerate(steps):
        left = _LEFT + _COLUMN_PX * index
        for side, (key, name) in enumerate(_SERIES):
            level = step.get(key)
            if not level or level <= 0:
                continue
            x, bar = left + 34 + 72 * side, 64
            if name in last:
                before = last[name]
                top, size = min(y(before), y(level)), abs(y(before) - y(level))
                worse = " worse" if level > before else ""
                drawn.append(
                    tag("rect", x=x, y=top, width=bar, height=size, class_=f"drop {name}{worse}")
                )
                drawn.append(
                    tag(
                        "line",
                        x1=x - _COLUMN_PX + bar,
                        x2=x,
                        y1=y(before),
                        y2=y(before),
                        class_=f"link {name}",
                    )
                )
            drawn.append(
                tag("line", x1=x, x2=x + bar, y1=y(level), y2=y(level), class_=f"level {name}")
            )
            drawn.append(
                tag("text", q.times(level), x=x + bar / 2, y=y(level) - 7, class_="value middle")
            )
            last[name] = level
        middle, base = left + 34 + 68, _TOP + _HEIGHT + 20
        for row, line in enumerate(_label(step)):
            kind = "name" if row == 0 else "tick"
            drawn.append(tag("text", line, x=middle, y=base + 17 * row, class_=f"{kind} middle"))
    drawn.append(tag("line", x1=_LEFT, x2=width - 96, y1=y(1), y2=y(1), class_="floor"))
    drawn.append(tag("text", "sensor noise", x=width - 90, y=y(1) + 4, class_="floor-name"))
    key = tag(
        "p",
        tag("span", class_="swatch train"),
        "training part ",
        tag("span", class_="swatch held"),
        "held-out part, not used for fitting ",
        tag("span", class_="swatch floor"),
        "sensor noise: the best a model can do",
        class_="key",
    )
    svg = tag(
        "svg",
        tag("title", "Error over sensor noise after each added effect"),
        drawn,
        viewBox=f"0 0 {width} {_TOP + _HEIGHT + _BOTTOM}",
        width=width,
        role="img",
        class_="chart",
    )
    return join(key, tag("div", svg, class_="scroll"))


def _ticks(low: float, high: float) -> list[float]:
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ticks = [m * 10.0**d for d in decades for m in (1, 2, 5)]
    return [tick for tick in ticks if low <= tick <= high]


def _label(step: Result) -> list[str]:
    if not step.get("added"):
        return ["base model", "no effect added"]
    lines = [f"+ {step['added']}", f"@ {step['place']}" if step.get("place") else ""]
    unit = str(step.get("unit") or "").partition(",")[0]
    lines.append(q.with_error(step.get("strength"), step.get("std_error"), unit))
    return [line if len(line) <= 30 else line[:29] + "…" for line in lines if line]


def _per_tap(steps: list[Result], contents: Contents) -> Markup:
    floors = contents.noise_floor
    header = [
        "Step",
        *(
            tag("th", contents.named(tap), scope="col", class_="num")
            for tap in contents.sensors_of(contents.learn)
        ),
    ]
    rows = []
    for step in steps:
        for key, part in (("rmse", "training"), ("held_out_rmse", "held-out")):
            errors = both(step, key)
            if not errors:
                continue
            cells = []
            for tap in contents.sensors_of(contents.learn):
                times = ratio(errors.get(tap), floors.get(tap))
                cells.append(
                    tag(
                        "td",
                        q.amount(errors.get(tap), contents.unit(tap)),
                        class_=f"num cell {heat_class(times)}",
                    )
                )
            name = _label(step)[0]
            rows.append(tag("tr", tag("th", f"{name}, {part}", scope="row"), cells))
    if not rows:
        return Markup()
    return tag(
        "details",
        tag("summary", "Error of each sensor after each step"),
        table(
            f"{contents.headed('RMS error')}; coloured by its ratio to the sensor noise",
            header,
            rows,
        ),
    )
