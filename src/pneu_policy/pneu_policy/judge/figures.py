# SPDX-License-Identifier: Apache-2.0
"""Figures of an evaluation: sample runs as in thesis figs. 9.3 to 9.5, and errors with spread."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pneu_common.files import whole
from pneu_policy.judge.metrics import ATM_PA, Track, target_at
from pneu_policy.judge.results import LIMIT, Evaluation, Run, load_track, spread

TARGET_COLOUR = "0.25"
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#882255", "#999933")
"""Wong's palette, which the colour-blind can tell apart, and two more."""
LIMIT_COLOUR = "0.55"
SHOWN_S = (1.0, 7.0)
"""Part of a run that is shown."""
MIN_SHOWN = 20
"""Instants that a picture needs."""


def colours(names: Sequence[str]) -> dict[str, str]:
    """A colour per controller, the same in all figures of an evaluation.

    Args:
        names: Names of the controllers.
    """
    others = [name for name in names if name != LIMIT]
    found = {name: COLOURS[i % len(COLOURS)] for i, name in enumerate(others)}
    return {**found, LIMIT: LIMIT_COLOUR}


def write_figures(evaluation: Evaluation, folder: Path) -> list[Path]:
    """Draws the errors of all controllers and, per plant, a sample run of each.

    Args:
        evaluation: What was found, with its folder of runs.
        folder: Where the pictures go.

    Returns:
        The pictures.

    Raises:
        InputError: They cannot be written.
    """
    out = []
    if any(run.metrics is not None for run in evaluation.runs):
        out.append(draw_errors(evaluation, folder / "errors.png"))
    for plant in evaluation.plants():
        path = folder / f"runs-{plant}.png"
        if draw_runs(evaluation, plant, evaluation.names(), path):
            out.append(path)
    return out


def draw_runs(
    evaluation: Evaluation,
    plant: str,
    names: Sequence[str],
    path: Path,
    seed: int | None = None,
    shown_s: tuple[float, float] = SHOWN_S,
) -> bool:
    """Draws one run of each controller: target and pressure above, the error below.

    Args:
        evaluation: What was found, with its folder of runs.
        plant: Name of the plant.
        names: Controllers, one column each.
        path: The picture.
        seed: Seed of the target; None is the first that all have.
        shown_s: Part of the run, s.

    Returns:
        Whether there was anything to draw.

    Raises:
        InputError: It cannot be written.
    """
    rows = []
    for kind in evaluation.kinds():
        chosen = _first_seed(evaluation, plant, kind, names) if seed is None else seed
        tracks = {name: _track(evaluation, plant, kind, chosen, name) for name in names}
        found = {name: track for name, track in tracks.items() if track is not None}
        if found:
            rows.append((kind, chosen, found))
    columns = [name for name in names if any(name in found for _, _, found in rows)]
    if not rows or not columns:
        return False
    plt = _pyplot()
    figure, panels = plt.subplots(
        2 * len(rows),
        len(columns),
        figsize=(max(4.0 * len(columns), 6.0), 3.6 * len(rows)),
        height_ratios=[2, 1] * len(rows),
        sharex=True,
        sharey="row",
        squeeze=False,
        layout="constrained",
    )
    colour = colours(evaluation.names())
    for row, (kind, chosen, found) in enumerate(rows):
        worst = 0.0
        for column, name in enumerate(columns):
            top, bottom = panels[2 * row, column], panels[2 * row + 1, column]
            track = found.get(name)
            if track is None:
                top.text(0.5, 0.5, "no valid run", transform=top.transAxes, ha="center")
                continue
            part = (track.time_s >= shown_s[0]) & (track.time_s <= shown_s[1])
            if np.count_nonzero(part) < MIN_SHOWN:  # a run that is shorter is shown whole
                part = np.ones(track.time_s.size, dtype=bool)
            time, pressure = track.time_s[part], track.pressure_pa[part] / ATM_PA
            target = target_at(track, time) / ATM_PA
            top.plot(time, pressure, color=colour[name], lw=1.3, label="pressure")
            top.plot(time, target, color=TARGET_COLOUR, lw=1.0, ls=(0, (4, 2)), label="target")
            bottom.fill_between(time, pressure - target, color=colour[name], lw=0.0, alpha=0.8)
            bottom.axhline(0.0, color=TARGET_COLOUR, lw=0.6)
            run = _run(evaluation, plant, kind, chosen, name)
            if run is not None and run.metrics is not None:
                rmse = run.metrics.rmse_atm
                text = f"{rmse:.4f}" if name == LIMIT else f"{rmse:.3f}"
                top.set_title(f"{name}, {kind}: RMSE {text} atm", fontsize=10)
            worst = max(worst, float(np.quantile(np.abs(pressure - target), 0.995)))
            if column == 0:
                top.set_ylabel("pressure, atm")
                bottom.set_ylabel("error, atm")
            for panel in (top, bottom):
                panel.grid(alpha=0.3)
                panel.set_xlim(time[0], time[-1])
        # One scale for all controllers, that of the worst.
        panels[2 * row + 1, 0].set_ylim(-1.15 * max(worst, 1e-3), 1.15 * max(worst, 1e-3))
    for panel in panels[-1]:
        panel.set_xlabel("time, s")
    panels[0, 0].legend(loc="upper right", fontsize=8, framealpha=0.9)
    figure.suptitle(f"{plant}: one run of each controller on the same targets", fontsize=12)
    _save(figure, path)
    return True


def draw_errors(evaluation: Evaluation, path: Path, names: Sequence[str] | None = None) -> Path:
    """Draws the mean error of each controller on each task with its spread and every run.

    Args:
        evaluation: What was found.
        path: The picture.
        names: Controllers; None is all.

    Returns:
        The picture.

    Raises:
        InputError: It cannot be written.
    """
    shown = list(evaluation.names() if names is None else names)
    tasks = [
        (plant, kind)
        for plant in evaluation.plants()
        for kind in evaluation.kinds()
        if any(evaluation.values("rmse_atm", name, plant, kind) for name in shown)
    ]
    plt = _pyplot()
    figure, panel = plt.subplots(
        figsize=(max(1.0 + 0.45 * len(tasks) * (len(shown) + 1), 6.0), 4.2), layout="constrained"
    )
    colour = colours(evaluation.names())
    width = 0.84 / max(len(shown), 1)
    for n, name in enumerate(shown):
        at = np.arange(len(tasks)) + (n - 0.5 * (len(shown) - 1)) * width
        values = [evaluation.values("rmse_atm", name, *task) for task in tasks]
        means = [spread(cell)[0] for cell in values]
        panel.bar(at, means, 0.92 * width, color=colour[name], alpha=0.85, label=name)
        for x, cell, mean in zip(at, values, means, strict=True):
            deviation = spread(cell)[1]
            if np.isfinite(deviation):
                panel.errorbar(x, mean, deviation, color="k", lw=1.0, capsize=2.5)
            dots = np.full(len(cell), x) + np.linspace(-0.2, 0.2, len(cell)) * width
            panel.plot(dots, cell, ".", color="k", ms=3.5, alpha=0.7)
    panel.set_xticks(range(len(tasks)), [f"{plant}, {kind}" for plant, kind in tasks])
    panel.set_ylabel("RMSE, atm")
    panel.grid(axis="y", alpha=0.25)
    panel.set_axisbelow(True)
    figure.legend(ncols=min(len(shown), 6), fontsize=9, loc="outside lower center", frameon=False)
    panel.set_title("mean, standard deviation and every run", fontsize=10)
    _save(figure, path)
    return path


def _first_seed(evaluation: Evaluation, plant: str, kind: str, names: Sequence[str]) -> int:
    """The first seed that most controllers have a valid run of."""
    counts: dict[int, int] = {}
    for run in evaluation.runs:
        if run.plant == plant and run.kind == kind and run.controller in names and run.metrics:
            counts[run.seed] = counts.get(run.seed, 0) + 1
    return min(counts, key=lambda seed: (-counts[seed], seed), default=0)


def _run(evaluation: Evaluation, plant: str, kind: str, seed: int, name: str) -> Run | None:
    key = Run(name, plant, kind, seed, None).key
    return next((run for run in evaluation.runs if run.key == key and run.metrics), None)


def _track(evaluation: Evaluation, plant: str, kind: str, seed: int, name: str) -> Track | None:
    run = _run(evaluation, plant, kind, seed, name)
    if run is None or evaluation.folder is None:
        return None
    path = evaluation.folder / "tracks" / f"{run.key}.npz"
    return load_track(path) if path.exists() else None


def _pyplot() -> Any:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def _save(figure: Any, path: Path) -> None:
    """Writes a picture, whole or not at all."""
    try:
        with whole(path) as aside:
            path.parent.mkdir(parents=True, exist_ok=True)
            figure.savefig(aside, format=path.suffix.removeprefix("."), dpi=110)
    finally:
        _pyplot().close(figure)
