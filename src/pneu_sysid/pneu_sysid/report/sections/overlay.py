# SPDX-License-Identifier: Apache-2.0
"""What each sensor measured and models predict over time, to zoom into."""

from typing import Any

import numpy as np

from pneu_sysid.report import quantities as q
from pneu_sysid.report.contents import Contents, errors_of, ratio
from pneu_sysid.report.embed import json_block, packed
from pneu_sysid.report.markup import Markup, join, tag

ID = "overlay"
TITLE = "Measured against model"

_MAX_NUMBERS = 330_000  # embedded samples; about 1.8 MB of base64
_WORST_SHOWN = 6


def render(contents: Contents) -> Markup:
    """Return the viewer, its switches and its data.

    Args:
        contents: The results to report.
    """
    series = (contents.compare or {}).get("series") or {}
    time_s = np.asarray(series.get("time_s") or [], dtype=np.float64)
    measured = {**(series.get("measured") or {}), **(series.get("measured_encoders") or {})}
    if time_s.size < 2 or not measured:
        return Markup()
    taps = [tap for tap in contents.sensors_of(contents.compare) if tap in measured] or list(
        measured
    )
    of_encoders = series.get("model_encoders") or {}
    models = {
        name: {**(values or {}), **(of_encoders.get(name) or {})}
        for name, values in (series.get("model") or {}).items()
    }
    commands = series.get("command") or {}

    count = len(taps) * (1 + len(models)) + len(commands)
    # Taps that are read one after the other are thinned together, reading by reading of each.
    stride = max(1, -(-time_s.size * count // _MAX_NUMBERS))
    kept = np.zeros(time_s.size, dtype=bool)
    for values in measured.values():
        kept[np.flatnonzero(np.isfinite(np.asarray(values, dtype=np.float64)))[::stride]] = True

    def thinned(values: Any) -> str:
        array = np.full(time_s.size, np.nan)
        given = np.asarray(values if values is not None else [], dtype=np.float64)
        array[: given.size] = given[: time_s.size]
        return packed(array[kept])

    data = {
        "time": packed(time_s[kept], "<f8"),
        "taps": taps,
        "gap": [stride * ((series.get("gap_s") or {}).get(tap) or 0.0) for tap in taps],
        "noise": [contents.noise_floor.get(tap) for tap in taps],
        "unit": [contents.unit(tap).drawn for tap in taps],
        "scale": [contents.unit(tap).drawn_scale for tap in taps],
        "measured": [thinned(measured[tap]) for tap in taps],
        "models": [
            {"name": name, "taps": [thinned(values.get(tap)) for tap in taps]}
            for name, values in models.items()
        ],
        "commands": [{"name": name, "values": thinned(v)} for name, v in commands.items()],
        "segments": [s for s in series.get("segments") or [] if None not in s],
    }
    hint = (
        "Drag across a stretch to zoom in, Shift-drag to move, click and turn the wheel to zoom, "
        "double-click for all. Keys: ← → + − 0. Each stretch of the recording is one band; below "
        "each sensor is measured minus model, with twice the sensor noise shaded."
    )
    thinning = f" Every {stride}th sample is shown." if stride > 1 else ""
    figure = tag(
        "figure",
        tag(
            "div",
            _switches("Sensors" if contents.encoders else "Taps", "tap", taps),
            _switches("Lines", "model", list(models)),
            tag(
                "fieldset",
                tag("legend", "Residuals"),
                tag(
                    "label",
                    tag("input", type="checkbox", checked=True, data_kind="logarithmic"),
                    "logarithmic beyond the sensor noise, so that good and bad models both show",
                ),
            ),
            class_="switches",
        ),
        tag(
            "div",
            tag("button", "Whole recording", type="button", data_span="all"),
            _worst(contents),
            tag("output", class_="range"),
            class_="buttons",
        ),
        tag(
            "canvas",
            "Measured and modelled readings over time; the tables give the errors.",
            tabindex=0,
            role="img",
            aria_label="Measured and modelled readings of each sensor over time",
        ),
        tag("figcaption", hint, thinning),
        id="viewer",
    )
    return join(
        figure,
        tag("noscript", tag("p", "This plot needs JavaScript; all else on the page does not.")),
        json_block("viewer-data", data),
    )


def _switches(title: str, kind: str, names: list[str]) -> Markup:
    boxes = [
        tag(
            "label",
            tag("input", type="checkbox", checked=True, data_kind=kind, data_index=i),
            tag("span", class_=f"line m{i % 4}") if kind == "model" else None,
            name,
        )
        for i, name in enumerate(names)
    ]
    legend = (
        tag("label", tag("span", class_="line measured"), "measured") if kind == "model" else None
    )
    return tag("fieldset", tag("legend", title), legend, boxes)


def _worst(contents: Contents) -> list[Markup]:
    """Buttons for the stretches where the models err most, for the eye to go there first."""
    floors = contents.noise_floor
    found = [
        (
            # kPa and mrad are compared by what the sensors can tell
            ratio(stretch["rmse"], floors.get(tap)) or 0.0
            if contents.encoders
            else stretch["rmse"],
            str(model.get("name")),
            f"{tap}: {q.amount(stretch['rmse'], contents.unit(tap))} {contents.unit(tap).drawn}",
            stretch["start_s"],
            stretch["end_s"],
        )
        for model in contents.models
        for tap, entry in errors_of(model).items()
        for stretch in entry["worst"]
        if None not in (stretch.get("rmse"), stretch.get("start_s"), stretch.get("end_s"))
    ]
    # The two worst of each model: the worse model would else take every button.
    chosen: list[tuple[float, str, str, float, float]] = []
    for model in contents.models:
        own = sorted((f for f in found if f[1] == str(model.get("name"))), reverse=True)
        chosen += own[: max(1, _WORST_SHOWN // len(contents.models))]
    return [
        tag(
            "button",
            f"{name}, {error} at {q.seconds(start)}–{q.seconds(end)} s",
            type="button",
            title=f"Worst stretches of {name}",
            data_span=f"{start},{end}",
        )
        for _, name, error, start, end in chosen
    ]
