# SPDX-License-Identifier: Apache-2.0
"""Where the models fail: error over sensor noise by sensor and regime, and by sensor and time."""

import numpy as np

from pneu_sysid.report import quantities as q
from pneu_sysid.report.contents import Contents, Result, ratio, regimes_of, unique
from pneu_sysid.report.heat import heat_class, legend
from pneu_sysid.report.markup import Markup, join, tag
from pneu_sysid.results.compare import regime_order
from pneu_sysid.sensor_units import Unit

ID = "residual-maps"
TITLE = "Where the models fail"

_BINS = 90
_MAX_COLUMNS = 18  # of the regime map; more models go below
_NAMES = {
    "flow_direction": "Flow direction",
    "choked": "Choking",
    "opening": "Valve opening",
    "pressure": "Pressure level",
    "frequency": "Frequency band",
    "time": "Time",
    "position": "Position",
    "motion": "Motion",
    "speed": "Speed",
    "load": "Load",
    "stop": "Ends of the way",
}
_MAP_WIDTH, _ROW_PX = 1120, 20
_CHARACTER_PX, _LONGEST_LABEL = 7.4, 32


def render(contents: Contents) -> Markup:
    """Return both maps of every model, all on one colour scale.

    Args:
        contents: The results to report.
    """
    over_time = [_time_map(model, contents) for model in contents.models]
    together = max(1, _MAX_COLUMNS // max(1, len(contents.sensors_of(contents.compare))))
    regimes = [
        _regime_map(contents.models[i : i + together], contents)
        for i in range(0, len(contents.models), together)
    ]
    if not any(over_time) and not any(regimes):
        return Markup()
    return join(
        legend(),
        tag("h3", "By sensor and regime") if any(regimes) else None,
        regimes,
        tag("h3", "By sensor and time") if any(over_time) else None,
        over_time,
        tag("p", "Click a cell to see that stretch above. Grey: no samples.", class_="note")
        if any(over_time)
        else None,
    )


def _regime_map(models: list[Result], contents: Contents) -> Markup:
    taps, floors = contents.sensors_of(contents.compare), contents.noise_floor
    cells: dict[tuple[str, str], dict[tuple[int, str], Result]] = {}
    for index, model in enumerate(models):
        for regime in regimes_of(model):
            key = (str(regime.get("kind")), str(regime.get("label")))
            cells.setdefault(key, {})[index, str(regime.get("encoder"))] = regime
    if not cells:
        return Markup()
    kinds = [k for k in _NAMES if any(key[0] == k for key in cells)]
    kinds += unique(kind for kind, _ in cells if kind not in _NAMES)
    rows = []
    for kind in kinds:
        title = tag("th", _NAMES.get(kind, kind), colspan=99, scope="rowgroup")
        rows.append(tag("tr", title, class_="kind"))
        found_of = {label: found for (k, label), found in cells.items() if k == kind}
        # In the order of their own scale, whatever the order in the result.
        for label in sorted(
            found_of, key=lambda one: regime_order(next(iter(found_of[one].values())))
        ):
            found = found_of[label]
            row = [
                (
                    [
                        _cell(found.get((index, tap)), floors.get(tap), contents.unit(tap))
                        for tap in taps
                    ],
                    tag("td", class_="gap"),
                )
                for index in range(len(models))
            ]
            rows.append(tag("tr", tag("th", label, scope="row"), row))
    gap = tag("td", class_="gap")
    upper = [
        (tag("th", model.get("name") or "model", colspan=len(taps), scope="colgroup"), gap)
        for model in models
    ]
    lower = [([_tap_header(tap) for tap in taps], gap) for _ in models]
    return tag(
        "div",
        tag(
            "table",
            tag("thead", tag("tr", tag("td"), upper, class_="names"), tag("tr", tag("td"), lower)),
            tag("tbody", rows),
            class_="heat",
        ),
        class_="scroll",
    )


def _tap_header(tap: str) -> Markup:
    """A header that may break after each underscore, so that many taps fit side by side."""
    first, *rest = tap.split("_")
    parts = [first, *(("_", tag("wbr"), part) for part in rest)]
    return tag("th", parts, scope="col", class_="num")


def _cell(regime: Result | None, floor: float | None, unit: Unit) -> Markup:
    regime = regime or {}
    times = ratio(regime.get("rmse"), floor)
    rmse, bias = regime.get("rmse"), regime.get("bias")
    mean = "" if bias is None else f"mean {q.amount(bias, unit, signed=True)} {unit.drawn}, "
    hint = (
        f"measured minus model: {q.amount(rmse, unit)} {unit.drawn} RMS, {mean}"
        f"{q.percent(regime.get('share'))} of the sensor's squared error, "
        f"{regime.get('samples') or 'no'} samples"
    )
    return tag("td", q.number(times, 2), class_=f"num cell {heat_class(times)}", title=hint)


def _time_map(model: Result, contents: Contents) -> Markup:
    series = (contents.compare or {}).get("series") or {}
    name = str(model.get("name"))
    predicted: dict[str, list[float]] = {}
    for key in ("model", "model_encoders"):
        predicted |= (series.get(key) or {}).get(name) or {}
    measured = {**(series.get("measured") or {}), **(series.get("measured_encoders") or {})}
    time_s = np.asarray(series.get("time_s") or [], dtype=np.float64)
    taps = [
        tap for tap in contents.sensors_of(contents.compare) if tap in predicted and tap in measured
    ]
    if time_s.size < 2 or not taps:
        return Markup()
    edges = np.linspace(time_s[0], time_s[-1], _BINS + 1)
    bins = np.clip(np.searchsorted(edges, time_s, side="right") - 1, 0, _BINS - 1)
    labels = [
        tap if len(tap) <= _LONGEST_LABEL else f"{tap[: _LONGEST_LABEL - 1]}…" for tap in taps
    ]
    left = max(110.0, 16.0 + _CHARACTER_PX * max(map(len, labels)))
    step = (_MAP_WIDTH - left) / _BINS
    drawn = []
    for row, tap in enumerate(taps):
        residual = np.asarray(measured[tap], dtype=np.float64) - np.asarray(
            predicted[tap], dtype=np.float64
        )
        use = np.isfinite(residual)
        samples = np.bincount(bins[use], minlength=_BINS)
        squares = np.bincount(bins[use], weights=residual[use] ** 2, minlength=_BINS)
        drawn.append(tag("text", labels[row], x=left - 8, y=row * _ROW_PX + 14, class_="tick end"))
        for i in range(_BINS):
            rmse = float(np.sqrt(squares[i] / samples[i])) if samples[i] else None
            drawn.append(
                tag(
                    "rect",
                    x=round(left + i * step, 2),
                    y=row * _ROW_PX,
                    width=round(step + 0.1, 2),
                    height=_ROW_PX - 1,
                    class_=heat_class(ratio(rmse, contents.noise_floor.get(tap))),
                    data_span=f"{edges[i]:.4g},{edges[i + 1]:.4g}",
                )
            )
    bottom = len(taps) * _ROW_PX
    for tick in _time_ticks(float(edges[0]), float(edges[-1])):
        x = left + (tick - edges[0]) / (edges[-1] - edges[0]) * (_MAP_WIDTH - left)
        drawn.append(
            tag("text", f"{tick:g} s", x=round(float(x), 1), y=bottom + 14, class_="tick middle")
        )
    name = str(model.get("name") or "model")
    return tag(
        "figure",
        tag("figcaption", name),
        tag(
            "svg",
            tag("title", f"Error of {name} by sensor and time"),
            drawn,
            viewBox=f"0 0 {_MAP_WIDTH + 16} {bottom + 20}",
            role="img",
            class_="chart timemap",
        ),
    )


def _time_ticks(start: float, end: float) -> np.ndarray:
    rough = (end - start) / 8.0
    decade = 10.0 ** np.floor(np.log10(rough))
    step = next(m * decade for m in (1, 2, 5, 10) if m * decade >= rough)
    return np.arange(np.ceil(start / step), np.floor(end / step + 1e-9) + 1) * step
