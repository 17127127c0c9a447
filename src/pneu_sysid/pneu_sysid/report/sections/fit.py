# SPDX-License-Identifier: Apache-2.0
"""Fitted parameters: where they stop short, values, errors, what cannot be told, correlations."""

from pneu_sysid.report import quantities as q
from pneu_sysid.report.contents import Contents, Result, both, ratio, unique
from pneu_sysid.report.heat import heat_class
from pneu_sysid.report.markup import Markup, join, table, tag

ID = "fit"
TITLE = "Fitted parameters"

_LARGEST_MATRIX = 24


def render(contents: Contents) -> Markup:
    """Return where the fit stops short, parameters, warnings, correlations and its error.

    Args:
        contents: The results to report.
    """
    fit = contents.fit
    if not fit:
        return Markup()
    warnings = [str(line) for line in fit.get("warnings") or []]
    short = fit.get("shortfall") or {}
    lines = [str(line) for line in [*(short.get("where") or []), *(short.get("help") or [])]]
    notes = []
    if fit.get("condition") is not None:
        notes.append(f"Condition number {q.number(fit['condition'])}.")
    history = [cost for cost in fit.get("history") or [] if cost is not None]
    if len(history) > 1:
        notes.append(
            f"Cost {q.number(history[0])} → {q.number(history[-1])} "
            f"in {len(history) - 1} iterations."
        )
    return join(
        tag("p", tag("strong", str(short["sentence"]))) if short else None,
        tag("ul", [tag("li", line) for line in lines], class_="warnings") if lines else None,
        tag("ul", [tag("li", line) for line in warnings], class_="warnings") if warnings else None,
        _parameters(fit.get("parameters") or []),
        tag("p", " ".join(notes), class_="note") if notes else None,
        _correlations(fit.get("correlations") or []),
        _errors(fit, contents),
    )


def _parameters(parameters: list[Result]) -> Markup | None:
    if not parameters:
        return None
    promised = any(parameter.get("expected_error") is not None for parameter in parameters)
    rows = []
    for parameter in parameters:
        relative = ratio(parameter.get("std_error"), abs(parameter.get("value") or 0.0))
        marks = [
            tag("span", text, class_="badge")
            for show, text in (
                (parameter.get("at_bound"), "at its bound"),
                (parameter.get("held"), "held"),
                (
                    parameter.get("identified") is False and not parameter.get("held"),
                    "not identified",
                ),
            )
            if show
        ]
        rows.append(
            tag(
                "tr",
                tag("th", tag("code", str(parameter.get("path"))), scope="row"),
                tag(
                    "td",
                    q.with_error(
                        parameter.get("value"), parameter.get("std_error"), parameter.get("unit")
                    ),
                ),
                tag("td", q.percent(relative), class_="num"),
                tag("td", _expected(parameter), class_="num") if promised else None,
                tag("td", q.number(parameter.get("start")), class_="num"),
                tag("td", _range(parameter)),
                tag("td", marks),
                class_="weak" if marks else None,
            )
        )
    header = [
        "Parameter",
        "Value ± standard error",
        tag("th", "relative", scope="col", class_="num"),
        *([tag("th", "error expected", scope="col", class_="num")] if promised else []),
        tag("th", "start", scope="col", class_="num"),
        "between its bounds",
        "",
    ]
    return table("The tick is the start, the dot the fitted value.", header, rows)


def _expected(parameter: Result) -> str:
    """The standard error that was promised, and what it was among rigs as this one might be."""
    among = [q.number(x) for x in parameter.get("expected_range") or []]
    error = q.number(parameter.get("expected_error"))
    return f"{error} ({' to '.join(among)})" if among else error


def _range(parameter: Result) -> Markup:
    low, high = parameter.get("lower"), parameter.get("upper")
    value, start = parameter.get("value"), parameter.get("start")
    if low is None or high is None or value is None or not high > low:
        return join(q.NONE)

    def x(at: float) -> float:
        return round(4 + 112 * min(1.0, max(0.0, (at - low) / (high - low))), 1)

    name = f"{q.number(low)} to {q.number(high)}"
    return tag(
        "svg",
        tag("title", name),
        tag("line", x1=4, x2=116, y1=8, y2=8, class_="rail"),
        tag("line", x1=x(start), x2=x(start), y1=2, y2=14, class_="zero")
        if start is not None
        else None,
        tag("circle", cx=x(value), cy=8, r=4, class_="dot"),
        width=120,
        height=16,
        role="img",
        aria_label=name,
    )


def _correlations(correlations: list[Result]) -> Markup | None:
    pairs = {
        (str(c.get("a")), str(c.get("b"))): c["value"]
        for c in correlations
        if c.get("value") is not None
    }
    if not pairs:
        return None
    names = unique(name for pair in pairs for name in pair)
    if len(names) > _LARGEST_MATRIX:
        items = [tag("li", f"{a} with {b}: {value:+.3f}") for (a, b), value in pairs.items()]
        return join(tag("h3", "Strong correlations"), tag("ul", items))
    rows = []
    for i, a in enumerate(names):
        cells = []
        for b in names[: i + 1]:
            value = 1.0 if a == b else pairs.get((a, b), pairs.get((b, a)))
            if value is None:
                cells.append(tag("td", "·", class_="num", title="below 0.9 in size"))
            elif a == b:
                cells.append(tag("td", i + 1, class_="num diagonal"))
            else:
                step = 3 if abs(value) >= 0.99 else 2 if abs(value) >= 0.95 else 1
                sign = "pos" if value > 0 else "neg"
                text = f"{value:+.3f}".replace("-", "−")
                cells.append(
                    tag("td", text, class_=f"num cell {sign}{step}", title=f"{a} with {b}")
                )
        rows.append(tag("tr", tag("th", f"{i + 1}  ", tag("code", a), scope="row"), cells))
    header = ["", *(tag("th", i + 1, scope="col", class_="num") for i in range(len(names)))]
    return join(
        tag("h3", "Correlated parameters"),
        table(
            "Correlations of 0.9 and more: the recording fixes a combination of these, "
            "not each. A dot is below 0.9.",
            header,
            rows,
            class_="heat correlations",
        ),
    )


def _errors(fit: Result, contents: Contents) -> Markup | None:
    parts = [
        (both(fit, "rmse"), "training"),
        (both(fit, "held_out_rmse"), "held-out"),
    ]
    parts = [(errors, name) for errors, name in parts if errors]
    if not parts:
        return None
    rows = []
    for tap in contents.sensors_of(contents.fit):
        cells = []
        for errors, _ in parts:
            times = ratio(errors.get(tap), contents.noise_floor.get(tap))
            cells.append(tag("td", q.amount(errors.get(tap), contents.unit(tap)), class_="num"))
            cells.append(tag("td", q.times(times), class_=f"num cell {heat_class(times)}"))
        rows.append(tag("tr", tag("th", contents.named(tap), scope="row"), cells))
    header: list[str | Markup] = ["Sensor" if contents.encoders else "Tap"]
    for _, name in parts:
        header.append(tag("th", contents.headed(name), scope="col", class_="num"))
        header.append(tag("th", "over noise", scope="col", class_="num"))
    return join(tag("h3", "Error of the fit"), table("RMS error per sensor", header, rows))
