# SPDX-License-Identifier: Apache-2.0
"""A picture of what an observer said of every sensor, over what was recorded."""

from pathlib import Path
from typing import Any

import numpy as np

from pneu_common.files import whole
from pneu_sysid.observed.follow import Followed
from pneu_sysid.observed.summary import NINETY
from pneu_sysid.results.observe import ObserveResult
from pneu_sysid.sensor_units import unit_of

MOST = 3.0
"""Errors are drawn up to this many half widths of their usual intervals."""
COLOURS = {"model": "tab:red", "sensor": "tab:orange"}


def draw_observed(found: Followed, result: ObserveResult, path: Path) -> None:
    """Draws every sensor, recorded and observed, and below it the error with 90 % intervals.

    Args:
        found: What an observer said.
        result: The same in figures.
        path: The picture; its folder must exist.

    Raises:
        InputError: It cannot be written.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    count = len(result.observed)
    figure, axes = pyplot.subplots(
        count, 2, figsize=(13.0, 1.9 * count + 0.8), layout="constrained", squeeze=False,
        sharex=True,
    )  # fmt: skip
    try:
        for row, sensor in zip(axes, result.observed, strict=True):
            unit = unit_of(sensor.name, result.encoders)
            scale = unit.drawn_scale
            mean, std = scale * found.mean[sensor.name], scale * found.std[sensor.name]
            read = scale * found.read.get(sensor.name, np.full(mean.size, np.nan))
            row[0].plot(found.time_s, read, ".", color="0.65", markersize=2, label="recorded")
            row[0].plot(found.time_s, mean, color="tab:blue", linewidth=1.0, label="observed")
            row[0].set_ylabel(f"{sensor.name}, {unit.drawn}")
            taken = "its readings taken" if sensor.used else "never shown to the observer"
            row[0].set_title(taken, fontsize="small")
            noise = scale * (result.noise_of.get(sensor.name) or 0.0)
            wide = NINETY * np.hypot(std, noise)
            row[1].plot(found.time_s, read - mean, ".", color="0.6", markersize=1.5)
            for side in (-1.0, 1.0):
                row[1].plot(found.time_s, side * wide, color="tab:blue", linewidth=0.8)
            most = MOST * float(np.quantile(wide[found.time_s >= result.begin_s], 0.95))
            row[1].set_ylim(-most, most)
            row[1].set_title(_words(sensor.times_noise, sensor.within_90), fontsize="small")
            _mark(row[1], result, sensor.name)
        axes[0, 0].legend(loc="upper right", fontsize="small")
        for column, title in enumerate(("s", "s; recorded less observed, and 90 % intervals")):
            axes[-1, column].set_xlabel(title)
        for axis in axes.flat:
            axis.spines[["top", "right"]].set_visible(False)
        figure.suptitle(f"{result.recording}, {', '.join(result.rigs)}", fontsize="medium")
        with whole(path) as aside:
            figure.savefig(aside, format=path.suffix.removeprefix("."), dpi=110)
    finally:
        pyplot.close(figure)


def _words(times_noise: float | None, within: float | None) -> str:
    if times_noise is None or within is None:
        return "not recorded"
    return f"error {times_noise:.2f} times the noise, {100 * within:.0f} % within the intervals"


def _mark(axis: Any, result: ObserveResult, sensor: str) -> None:
    """Where something was said to be wrong, of this sensor or of the model."""
    for said in result.said:
        if said.kind == "model" or said.subject == sensor:
            axis.axvspan(said.start_s, said.end_s, color=COLOURS[said.kind], alpha=0.15, lw=0)
