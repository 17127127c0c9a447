# SPDX-License-Identifier: Apache-2.0
"""Reservoirs whose pressure in a rig file is not what taps read at rest."""

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.network import volume_of_tap, volumes_of
from pneu_sim.rig.schema import Rig
from pneu_sysid.gross.findings import GrossError
from pneu_sysid.problem import Problem

Floats = NDArray[np.float64]

GAUGE = (0.75, 1.25)
"""A reservoir given above the room's pressure is off by this much of it."""
RESERVOIR = 0.15
"""A reservoir further from what its taps read is not meant; the fit's own range is 10 %."""
STEADY = 0.25
"""A tap in a reservoir's own pipe moves by no more of its reading."""


def wrong_reservoirs(rig: Rig, problem: Problem) -> tuple[list[GrossError], Rig]:
    """Reservoirs whose pressure is not what the taps of their own volume read at rest.

    Args:
        rig: The rig as its file says.
        problem: It and its recordings.

    Returns:
        What is wrong, and the rig with it put right.
    """
    volume, _ = volumes_of(rig)
    room = rig.ambient.pressure_pa
    errors, out = [], rig.model_copy(deep=True)
    for name, reservoir in rig.reservoirs.items():
        fed = {
            volume[f"pipe:{p}"]
            for p, pipe in rig.pipes.items()
            if name in (pipe.from_node, pipe.to_node)
        }
        others = {
            volume[f"pipe:{p}"]
            for p, pipe in rig.pipes.items()
            for node in (pipe.from_node, pipe.to_node)
            if node in rig.reservoirs and node != name
        }
        levels = {}
        for tap in rig.taps:
            if volume_of_tap(volume, rig.taps[tap]) not in fed - others:
                continue
            values = np.concatenate([r.pressures[tap].values for r in problem.recordings])
            # friction and sag only take away from a supply, and add to a sink
            level = float(np.median(_resting(values)))
            low, high = np.quantile(values, (0.05, 0.95))
            # what moves more is no volume with a reservoir at its end: the tap is elsewhere
            if high - low < STEADY * level:
                levels[tap] = level
        if not levels:
            continue
        tap, level = max(levels.items(), key=lambda item: item[1])
        file = reservoir.pressure_pa
        apart = level - file
        gauge = GAUGE[0] * room < apart < GAUGE[1] * room
        if not gauge and abs(apart) < RESERVOIR * file:
            continue
        what = f"reservoirs.{name}.pressure_pa"
        meant = (
            f"it seems to be given above the room's pressure instead of absolute; {file + room:.4g}"
            " would fit"
            if gauge
            else f"about {level:.4g} would fit"
        )
        noise = float(problem.noise_pa[problem.taps.index(tap)])
        sentence = f"{what}: found {file:.4g}, where tap {tap!r} reads {level:.4g} at rest; {meant}"
        errors.append(GrossError(what, sentence, abs(apart) / noise, 1.0))
        out.reservoirs[name] = reservoir.model_copy(update={"pressure_pa": level})
    return errors, out


def _resting(values: Floats) -> Floats:
    """The quietest quarter of a signal, by how much it moves within some readings."""
    window = 8
    if values.size < 4 * window:
        return values
    blocks = values[: values.size // window * window].reshape(-1, window)
    span = np.ptp(blocks, axis=1)
    return np.asarray(blocks[span <= np.quantile(span, 0.25)].ravel())
