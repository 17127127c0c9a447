# SPDX-License-Identifier: Apache-2.0
"""Reservoirs: what they supply while their pressure ripples."""

import math

from pneu_sim import layout as L
from pneu_sim.compiling import branching


@branching
def supply(step, dt, clock, reservoirs):
    """What every reservoir supplies at the middle of a step: its pressure and its ripples.

    Args:
        step: The step of this run.
        dt: Step, s.
        clock: (2, lanes) see `Clock`.
        reservoirs: The reservoirs.
    """
    supplied, par = reservoirs.supplied, reservoirs.ripple
    for r in range(supplied.shape[0]):
        for j in range(supplied.shape[1]):
            supplied[r, j] = reservoirs.pressure[r, j]
    for q in range(reservoirs.ripple_of.size):
        for j in range(clock.shape[1]):
            time = clock[0, j] + (clock[1, j] + step + 0.5) * dt
            x = par[q, L.RIPPLE_RATE, j] * time + par[q, L.RIPPLE_PHASE, j]
            supplied[reservoirs.ripple_of[q], j] += par[q, L.RIPPLE_AMPLITUDE, j] * math.sin(x)
