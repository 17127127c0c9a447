# SPDX-License-Identifier: Apache-2.0
"""How near parts of a rig are to a sensor, along lines, and how much it therefore corrects them."""

import math

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.cells import middles
from pneu_sim.rig.expand import with_cylinders
from pneu_sim.rig.network import end_nodes
from pneu_sim.rig.plan import Plan
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]


def gaspari_cohn(distance: Floats) -> Floats:
    """The compactly supported correlation of Gaspari and Cohn 1999, eq. 4.10.

    Args:
        distance: In units of half of its support, 0 or more.

    Returns:
        1 at no distance, 0 from 2 on.
    """
    r = np.asarray(distance, dtype=float)
    near = 1.0 + r * r * (-5.0 / 3.0 + r * (5.0 / 8.0 + r * (0.5 - 0.25 * r)))
    safe = np.maximum(r, 1e-9)
    far = (
        4.0
        + r * (-5.0 + r * (5.0 / 3.0 + r * (5.0 / 8.0 + r * (-0.5 + r / 12.0))))
        - (2.0 / (3.0 * safe))
    )
    return np.where(r <= 1.0, near, np.where(r < 2.0, np.maximum(far, 0.0), 0.0))


def distances(rig: Rig, plan: Plan) -> tuple[Floats, Floats]:
    """Ways along lines from every tap; no way leads through a valve, an orifice or a reservoir.

    Args:
        rig: The rig.
        plan: Its grid.

    Returns:
        (n_taps, slots) to every cell, m, ghosts as the cells beside them; and (n_taps, n_chambers)
        to every chamber, m. Infinite where no way leads.
    """
    whole = with_cylinders(rig)
    ends = {name: end_nodes(whole, name) for name in plan.pipes}
    slots = np.full((len(plan.taps), plan.slots), math.inf)
    chambers = np.full((len(plan.taps), len(plan.chambers)), math.inf)
    for t, name in enumerate(plan.taps):
        tap = whole.taps[name]
        node: dict[str, float] = {}
        if tap.pipe is not None:
            length = whole.pipes[tap.pipe].length_m
            begin, end = ends[tap.pipe]
            node[begin], node[end] = tap.position_m, length - tap.position_m
        else:
            assert tap.chamber is not None
            node[tap.chamber] = 0.0
        for _ in plan.pipes:  # as many rounds as a way can have pipes
            for pipe, (begin, end) in ends.items():
                length = whole.pipes[pipe].length_m
                for a, b in ((begin, end), (end, begin)):
                    if a in node and a not in whole.reservoirs:
                        node[b] = min(node.get(b, math.inf), node[a] + length)
        for pipe, (first, n) in plan.pipes.items():
            length = whole.pipes[pipe].length_m
            at = middles(length, n)
            begin, end = ends[pipe]
            far = np.full(n, math.inf)
            if tap.pipe == pipe:
                far = np.abs(at - tap.position_m)
            for n_from, along in ((begin, at), (end, length - at)):
                if n_from in node and n_from not in whole.reservoirs:
                    far = np.minimum(far, node[n_from] + along)
            slots[t, first - 1 : first + n + 1] = np.pad(far, 1, mode="edge")
        for c, chamber in enumerate(plan.chambers):
            chambers[t, c] = node.get(chamber, math.inf)
    return slots, chambers
