# SPDX-License-Identifier: Apache-2.0
"""How a rig moved at each tick: which way and how fast, against what load, and how near an end.

All of it is a model's own word, from the pistons and joints of its run.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.schema import Rig
from pneu_sim.simulate import TICK_S, Prediction
from pneu_sysid.sensor_units import joints_of
from pneu_sysid.ticks import STILL, Ticks

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

REVERSING_S = 0.05
"""So long before and after its direction changes a piston counts as reversing, if it rests in
between for no longer."""
BANDS = 3
"""Bands of speed and of load."""
NEAR = 0.1
"""An end is near within this part of the way, or where its cushion throttles."""
EXTENSION, SPEED, FORCE = 0, 1, 2
"""Columns of `Prediction.cylinders`."""


def motion_sets(rig: Rig, along: Sequence[Prediction]) -> list[Ticks]:
    """Parts of recordings by how pistons that move something, and joints, moved.

    Args:
        rig: The rig.
        along: What a model of it predicts along each recording, all kept; nothing moves in a lumped
            one, of which there are no parts.
    """
    if not rig.bodies or any(not one.cylinders.shape[1] for one in along):
        return []
    out = []
    moving = {name for body in rig.bodies.values() for name in body.driven_by}
    for k, (name, cylinder) in enumerate(rig.cylinders.items()):
        if name not in moving:
            continue
        extension, speed, force = (
            [one.cylinders[0, :, k, column] for one in along]
            for column in (EXTENSION, SPEED, FORCE)
        )
        unit = "N" if cylinder.rotary is None else "N m"
        out += _directions(name, speed)
        out += _bands(name, force, unit)
        cushions = [
            0.0 if side is None or side.cushion is None else side.cushion.length_m
            for side in (cylinder.head, cylinder.rod)
        ]
        head, rod = (max(NEAR * cylinder.stroke, length) for length in cushions)
        ends = ("head end", "rod end")
        out += _ends(name, extension, (head, cylinder.stroke - rod), ends)
    for k, (name, (joint, unit)) in enumerate(joints_of(rig).items()):
        if joint.held:
            continue
        position, speed = ([one.joints[0, :, k, column] for one in along] for column in (0, 1))
        out += _speeds(name, speed, f"{unit}/s")
        if joint.lower is not None and joint.upper is not None:
            margin = NEAR * (joint.upper - joint.lower)
            inner = joint.lower + margin, joint.upper - margin
            out += _ends(name, position, inner, ("lower stop", "upper stop"))
    return out


def _directions(name: str, speed: list[Floats]) -> list[Ticks]:
    """Extending, retracting, at rest, and reversing from one to the other."""
    limit = _still(speed)
    signs = [np.sign(np.where(np.abs(v) > limit, v, 0.0)) for v in speed]
    turning = [_reversals(sign) for sign in signs]
    wanted = (("extending", 1.0), ("retracting", -1.0), ("at rest", 0.0))
    out = [
        Ticks(
            "motion",
            f"{name} {word}",
            [(s == sign) & ~t for s, t in zip(signs, turning, strict=True)],
            name,
        )
        for word, sign in wanted
    ]
    return [*out, Ticks("motion", f"{name} reversing", turning, name)]


def _reversals(sign: Floats) -> Mask:
    """(ticks,) where a direction changes within a short time."""
    reach = round(REVERSING_S / TICK_S)
    out = np.zeros(sign.size, dtype=bool)
    moves = np.flatnonzero(sign)
    for before, after in pairwise(moves[_edges(sign[moves])].tolist()):
        if sign[before] != sign[after] and after - before <= 2 * reach:
            middle = (before + after) // 2
            out[max(0, middle - reach) : middle + reach + 1] = True
    return out


def _edges(sign: Floats) -> NDArray[np.int64]:
    """Where signs differ from the one before or the one after."""
    changes = np.flatnonzero(np.diff(sign))
    return np.union1d(changes, changes + 1)


def _still(speed: list[Floats]) -> float:
    """Speed below which something counts as at rest."""
    return STILL * float(np.nanpercentile(np.abs(np.concatenate(speed)), 99))


def _speeds(name: str, speed: list[Floats], unit: str) -> list[Ticks]:
    """Equal bands of speed, either way; rest is in none."""
    most = float(np.nanpercentile(np.abs(np.concatenate(speed)), 99))
    if not most > 0.0:
        return []
    edges = np.linspace(0.0, most, BANDS + 1)
    size = [np.abs(v) for v in speed]
    out = []
    for k, (low, high) in enumerate(pairwise(edges.tolist())):
        last = k == BANDS - 1
        words = f"below {high:.3g}" if k == 0 else f"{low:.3g}-{high:.3g}"
        words = f"above {low:.3g}" if last else words
        lower = STILL * most if k == 0 else low
        masks = [(v > lower) & (last | (v <= high)) for v in size]
        label = f"{name} {words} {unit}"
        out.append(Ticks("speed", label, masks, name, lower, None if last else high))
    return out


def _bands(name: str, values: list[Floats], unit: str) -> list[Ticks]:
    """Equal bands of the force of the gas on a piston; positive extends."""
    low, high = np.nanpercentile(np.concatenate(values), [1.0, 99.0])
    if not high > low:
        return []
    edges = np.linspace(low, high, BANDS + 1)
    which = [np.digitize(v, edges[1:-1]) for v in values]
    return [
        Ticks(
            "load",
            f"gas on {name} {a:.3g} to {b:.3g} {unit}",
            [of == k for of in which],
            name,
            a,
            b,
        )
        for k, (a, b) in enumerate(pairwise(edges.tolist()))
    ]


def _ends(
    name: str, at: list[Floats], inner: tuple[float, float], words: tuple[str, str]
) -> list[Ticks]:
    """Near either end, or between."""
    low, high = inner
    return [
        Ticks("stop", f"{name} near its {words[0]}", [x < low for x in at], name, None, low),
        Ticks(
            "stop", f"{name} between its ends", [(x >= low) & (x <= high) for x in at], name, *inner
        ),
        Ticks("stop", f"{name} near its {words[1]}", [x > high for x in at], name, high, None),
    ]
