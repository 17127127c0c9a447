# SPDX-License-Identifier: Apache-2.0
"""A picture of a cylinder's friction: over pressure, along the stroke, and what is left."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pneu_common.files import whole
from pneu_sysid.seals.estimate import predicted
from pneu_sysid.seals.identify import Identified, friction_at


def draw_friction(seals: Sequence[tuple[str, Identified]], path: Path) -> None:
    """Draws what was found of one cylinder or of several, one below the other.

    Args:
        seals: Names, and what was found.
        path: The picture; its folder must exist.

    Raises:
        InputError: It cannot be written.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(
        len(seals), 3, figsize=(13.0, 4.0 * len(seals)), layout="constrained", squeeze=False
    )
    try:
        for row, (name, found) in zip(axes, seals, strict=True):
            _over_pressure(row[0], name, found)
            _along_stroke(row[1], found)
            _errors(row[2], found)
        with whole(path) as aside:
            figure.savefig(aside, format=path.suffix.removeprefix("."), dpi=110)
    finally:
        pyplot.close(figure)


def _over_pressure(axis: Any, name: str, found: Identified) -> None:
    """Half differences of the force over pressure, and the law."""
    pieces = found.pieces
    levels = pieces.levels
    for k, halves in enumerate(pieces.cycle_friction()):
        bar = 1e-5 * levels[k].gauge_pa
        axis.plot(np.full(halves.size, bar), halves, ".", color="0.7", ms=4, zorder=1)
        if halves.size:
            spread = float(np.std(halves, ddof=1)) if halves.size > 1 else 0.0
            axis.errorbar(
                bar, halves.mean(), spread, fmt="o", color="black", ms=4, capsize=3, zorder=3,
                label="half difference of the force, with spread of cycles" if k == 0 else None,
            )  # fmt: skip
    top = max(level.gauge_pa for level in levels)
    share = max(level.mean_gauge_pa for level in levels) / top if top > 0.0 else 0.5
    gauge = np.linspace(0.0, 1.1 * top, 60)
    value, error = friction_at(found, share * gauge)
    axis.plot(1e-5 * gauge, value, color="C3", zorder=2, label="named, with standard error")
    axis.fill_between(1e-5 * gauge, value - error, value + error, color="C3", alpha=0.2, lw=0)
    axis.axhline(0.0, color="C0", ls="--", label="no friction")
    axis.set_ylim(bottom=min(0.0, axis.get_ylim()[0]))
    axis.set_title(name)
    axis.set_xlabel("gauge pressure, bar")
    axis.set_ylabel("friction, N")
    axis.legend(fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 0.05))


def _along_stroke(axis: Any, found: Identified) -> None:
    """The force without gas over the place, at the lowest and at the highest pressure."""
    pieces = found.pieces
    r = pieces.readings
    of, way = pieces.level[r.piece], pieces.way[r.piece]
    law = predicted(pieces, found.best)
    gain = found.best.gain if found.best.law else 0.0
    rest = r.rest_n - gain * r.load_n
    order = np.argsort([level.gauge_pa for level in pieces.levels])
    place = 100.0 * r.place
    for colour, k in (("C0", order[0]), ("C1", order[-1])):
        sides = [rest[(of == k) & (way == w)].mean() for w in (1.0, -1.0)]
        zero = 0.5 * (sides[0] + sides[1])
        bar = 1e-5 * pieces.levels[k].gauge_pa
        for w in (1.0, -1.0):
            at = (of == k) & (way == w)
            axis.plot(
                place[at], rest[at] - zero, ".", color=colour, ms=1.5, alpha=0.25,
                label=f"{bar:.1f} bar, measured" if w > 0 else None, rasterized=True,
            )  # fmt: skip
            axis.plot(
                [0.0, 100.0], [law[at].mean()] * 2, color=colour, lw=2.0,
                label=f"{bar:.1f} bar, named" if w > 0 else None,
            )  # fmt: skip
        if order.size == 1:
            break
    axis.axhline(0.0, color="0.3", ls="--", lw=0.8)
    axis.set_title("force less the gas's: pressed in above, drawn out below")
    axis.set_xlabel("place along the stroke, %")
    axis.set_ylabel("force, N")
    axis.legend(fontsize=8, loc="center", markerscale=6)


def _errors(axis: Any, found: Identified) -> None:
    """Error of the laws, term after term, at every pressure."""
    levels = found.pieces.levels
    order = np.argsort([level.gauge_pa for level in levels])
    x = np.arange(order.size)
    width = 0.8 / len(found.steps)
    before: tuple[str, ...] = ()
    for n, step in enumerate(found.steps):
        both = np.sqrt(np.mean(step.by_level**2, axis=1))[order]
        new = [t for t in step.law if t not in before]
        before = step.law
        label = f"+ {new[0]}" if new else "no friction"
        axis.bar(x + (n - 0.5 * (len(found.steps) - 1)) * width, both, width, label=label)
    noise = [levels[k].noise_n for k in order]
    axis.plot(x, noise, "k_", ms=30, label="noise")
    axis.set_yscale("log")
    axis.set_ylim(top=5.0 * float(max(s.by_level.max() for s in found.steps)))
    axis.set_xticks(x, [f"{1e-5 * levels[k].gauge_pa:.1f}" for k in order])
    axis.set_title("error of the model, by pressure")
    axis.set_xlabel("gauge pressure, bar")
    axis.set_ylabel("error, N")
    axis.legend(fontsize=8, ncols=2)
