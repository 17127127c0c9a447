# SPDX-License-Identifier: Apache-2.0
"""Error of every compared model at every sensor, against the sensor noise."""

import math

from pneu_sysid.report import quantities as q
from pneu_sysid.report.contents import Contents, Result, both, errors_of, ratio
from pneu_sysid.report.markup import Markup, join, table, tag

ID = "errors"
TITLE = "Error per sensor and model"

_BAR_PX = 150


def render(contents: Contents) -> Markup:
    """Return the table of errors per tap and model, and what the grid adds to them.

    Args:
        contents: The results to report.
    """
    models = contents.models
    if not models:
        return Markup()
    floors = contents.noise_floor
    sensors = contents.sensors_of(contents.compare)
    ratios = [_times(model, name, floors) or 0.0 for model in models for name in sensors]
    longest = max([*ratios, *(m.get("times_noise") or 0.0 for m in models), 2.0])

    rows = [
        tag(
            "tr",
            tag(
                "th",
                "all sensors" if contents.encoders else "all taps",
                rowspan=len(models),
                scope="rowgroup",
            )
            if i == 0
            else None,
            tag("td", rowspan=len(models)) if i == 0 else None,
            _name(model, i),
            tag(
                "td",
                None if contents.encoders else q.kilopascal(model.get("rmse_pa")),
                class_="num",
            ),
            tag("td", colspan=4),
            tag("td", _bar(model.get("times_noise"), longest, i)),
            class_="first total" if i == 0 else "total",
        )
        for i, model in enumerate(models)
    ]
    for tap in sensors:
        unit = contents.unit(tap)
        for i, model in enumerate(models):
            entry = errors_of(model).get(tap) or {}
            rows.append(
                tag(
                    "tr",
                    tag("th", contents.named(tap), rowspan=len(models), scope="rowgroup")
                    if i == 0
                    else None,
                    tag("td", q.amount(floors.get(tap), unit), rowspan=len(models), class_="num")
                    if i == 0
                    else None,
                    _name(model, i),
                    tag("td", q.amount(entry.get("rmse"), unit), class_="num"),
                    tag("td", q.number(entry.get("rmse_atm"), 2), class_="num"),
                    tag("td", q.percent(entry.get("normalised")), class_="num"),
                    tag("td", q.amount(entry.get("bias"), unit, signed=True), class_="num"),
                    tag("td", q.milliseconds(entry.get("lag_s"), signed=True), class_="num"),
                    tag("td", _bar(_times(model, tap, floors), longest, i)),
                    class_="first" if i == 0 else None,
                )
            )
    noise, rms, bias = map(contents.headed, ("noise", "RMS", "bias"))
    numeric = (noise, "", rms, "RMS, atm", "of signal std", bias, "lag, ms")
    header = [
        "Sensor" if contents.encoders else "Tap",
        *(
            tag("th", name or "Model", scope="col", class_="num" if name else None)
            for name in numeric
        ),
        "RMS over noise (log)",
    ]
    caption = "Bias is measured minus model. A positive lag means that the measurement comes later."
    return join(table(caption, header, rows, class_="models"), _numerics(contents))


def _times(model: Result, tap: str, floors: dict[str, float]) -> float | None:
    entry = errors_of(model).get(tap) or {}
    given = entry.get("times_noise")
    return given if given is not None else ratio(entry.get("rmse"), floors.get(tap))


def _name(model: Result, index: int) -> Markup:
    kind = model.get("model")
    return tag(
        "td",
        tag("span", class_=f"swatch m{index % 4}"),
        str(model.get("name") or kind or f"model {index + 1}"),
        tag("small", f" {kind}") if kind and kind != model.get("name") else None,
    )


def _bar(times: float | None, longest: float, index: int) -> Markup:
    if times is None:
        return join(q.NONE)
    # Logarithmic from 0.5, so that the noise floor itself has a visible length.
    share = math.log(max(times, 0.51) / 0.5) / math.log(longest / 0.5)
    floor = math.log(2.0) / math.log(longest / 0.5)
    svg = tag(
        "svg",
        tag(
            "rect", x=0, y=2, width=round(_BAR_PX * share, 1), height=10, class_=f"bar m{index % 4}"
        ),
        tag(
            "line",
            x1=round(_BAR_PX * floor, 1),
            x2=round(_BAR_PX * floor, 1),
            y1=0,
            y2=14,
            class_="limit",
        ),
        width=_BAR_PX,
        height=14,
        aria_hidden="true",
    )
    return join(svg, tag("span", q.times(times), class_="after"))


def _numerics(contents: Contents) -> Markup | None:
    for result in (contents.compare, contents.diagnose):
        numerics = (result or {}).get("numerics") or {}
        if not numerics:
            continue
        change = {
            tap: value for tap, value in both(numerics, "change").items() if value is not None
        }
        floors = contents.noise_floor
        detail = ""
        if change and numerics.get("dx_m") and numerics.get("refined_dx_m"):
            most = max(change, key=lambda tap: change[tap] / floors.get(tap, 1.0))
            unit = contents.unit(most)
            detail = (
                f" Cells of {q.number(1e3 * numerics['dx_m'])} mm against "
                f"{q.number(1e3 * numerics['refined_dx_m'])} mm change the predictions by "
                f"{q.amount(change[most], unit)} {unit.drawn} RMS at most, at {most}."
            )
        return tag(
            "p",
            tag("strong", "Grid: "),
            numerics.get("sentence") or "",
            detail,
            class_="note warning" if numerics.get("discretisation") else "note",
        )
    return None
