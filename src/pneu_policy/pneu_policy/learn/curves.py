# SPDX-License-Identifier: Apache-2.0
"""Learning curves: score and tracking error against samples, by group of runs (thesis 7.2, 7.5)."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_common.files import whole
from pneu_policy.learn.history import History

COLOURS = (
    "#1f5fa8", "#c8501e", "#2e8b57", "#8a3ffc", "#b8860b",
    "#555555", "#e377c2", "#17becf", "#000000",
)  # fmt: skip
"""Told apart also where colours are not seen well, in this order."""

_POINTS = 200

PANELS = (
    ("eval_score", "score (sum of rewards)", "linear"),
    ("eval_rmse", "tracking error, RMS", "log"),
)


def learning_curves(
    groups: Mapping[str, Sequence[History]],
    path: str | Path,
    title: str = "",
) -> None:
    """Draws the evaluations of runs: each run as a light line, the mean of a group in bold.

    The mean of errors is the geometric one, as their axis is logarithmic. It goes as far as all
    runs of the group do.

    Args:
        groups: Histories by the name that the legend shows.
        path: Picture; its ending decides the format.
        title: What stands above.

    Raises:
        InputError: There is nothing to draw, or the picture cannot be written.
    """
    path = Path(path)
    if not groups or not all(groups.values()):
        raise InputError(f"{path}: no histories to draw")
    figure = Figure(figsize=(11.0, 3.8), layout="constrained")
    panels = figure.subplots(1, 2)
    for axes, (key, label, scale) in zip(panels, PANELS, strict=True):
        for number, (name, histories) in enumerate(groups.items()):
            again, colour = divmod(number, len(COLOURS))
            style = (COLOURS[colour], "--" if again else "-")
            _draw_group(axes, key, name, histories, style, scale)
        axes.set(xlabel="samples (control periods)", ylabel=label, yscale=scale, xlim=(0, None))
        axes.ticklabel_format(axis="x", style="sci", scilimits=(0, 5), useMathText=True)
        axes.grid(True, which="both" if scale == "log" else "major", alpha=0.25, linewidth=0.5)
        axes.spines[["top", "right"]].set_visible(False)
    one = next(iter(groups.values()))[0]  # groups of one picture are of one task
    panels[1].axhline(one.mark, color="black", linewidth=0.8, linestyle=":")
    panels[1].set_ylabel(f"{PANELS[1][1]} ({one.unit})")
    panels[1].yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    panels[1].yaxis.set_major_formatter("{x:g}")
    panels[1].yaxis.set_minor_formatter(NullFormatter())
    # Beside the panels, as many groups would hide the curves.
    panels[1].legend(frameon=False, loc="center left", bbox_to_anchor=(1.02, 0.5), fontsize="small")
    if title:
        figure.suptitle(title)
    kind = path.suffix.removeprefix(".") or "png"
    # without a date, the same histories make the same file
    undated: dict[str, Any] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind, {})
    try:
        with whole(path) as aside:
            figure.savefig(aside, format=kind, dpi=150, metadata=undated)
    except InputError:  # before its base, ValueError
        raise
    except ValueError as error:
        raise InputError(f"{path}: cannot be drawn as {kind!r} ({error})") from None


def _draw_group(
    axes: Axes,
    key: str,
    name: str,
    histories: Sequence[History],
    style: tuple[str, str],
    scale: str,
) -> None:
    colour, dashes = style
    curves = [_curve(history, key) for history in histories]
    for samples, values in curves:
        light = 0.35 if len(curves) > 1 else 1.0
        axes.plot(samples, values, color=colour, alpha=light, linewidth=0.9)
    label = f"{name} ({len(curves)} seeds)" if len(curves) > 1 else name
    begin = max(samples[0] for samples, _ in curves)
    end = min(samples[-1] for samples, _ in curves)
    grid = np.linspace(begin, max(begin, end), _POINTS)
    log = scale == "log"
    each = [np.interp(grid, x, np.log(y) if log else y) for x, y in curves]
    mean = np.mean(each, axis=0)
    axes.plot(
        grid,
        np.exp(mean) if log else mean,
        color=colour,
        linestyle=dashes,
        linewidth=2.0,
        label=label,
    )


def _curve(history: History, key: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rows = [row for row in history.rows if row[key] is not None]
    if not rows:
        raise InputError(f"a history without {key} cannot be drawn")
    return np.array([row["samples"] for row in rows]), np.array([row[key] for row in rows])
