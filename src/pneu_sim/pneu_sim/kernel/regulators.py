# SPDX-License-Identifier: Apache-2.0
"""Pressure regulators: what they measure at their outlet, and how far they open for it.

A regulator is a control loop of its own. A sensor with a lag shows the pressure at the outlet, what
is missing of the set-point beyond a dead zone asks for an opening in proportion and by an integral,
and a spool follows with a lag: to one side it opens the port that fills, to the other the one that
vents. The set-point comes in as the opening that the fill was given by its curve.
"""

import math

from pneu_sim import layout as L
from pneu_sim.compiling import branching, folded

SHUT = 1e-9
"""A spool this close to its middle is there; it would else creep there for ever."""


@folded
def regulate(p, share, dt, par, state):
    """Moves one regulator on by a step; exact where pressure and demand stay over it.

    Args:
        p: Pressure at its outlet, Pa.
        share: Share of its range that is asked for.
        dt: Step, s.
        par: (REG_PARAMS,) its numbers.
        state: (REG_STATE,) changed in place; zeros before it has seen any pressure.
    """
    seen = state[L.REG_SEEN]
    if seen <= 0.0 or par[L.REG_SENSOR] <= 0.0:
        seen = p
    else:
        seen = p + (seen - p) * math.exp(-dt / par[L.REG_SENSOR])
    state[L.REG_SEEN] = seen
    missing = par[L.REG_LOW] + share * par[L.REG_SPAN] - seen
    dead = par[L.REG_DEAD]
    missing -= min(max(missing, -dead), dead)
    asked = missing / par[L.REG_BAND]
    rate = par[L.REG_RATE]
    total = state[L.REG_SUM]
    if rate > 0.0:
        if missing == 0.0:
            total *= math.exp(-dt * rate)
        elif abs(asked + total) < 1.0 or asked * total < 0.0:  # what is fully open winds up no more
            total = min(max(total + dt * rate * asked, -1.0), 1.0)
        state[L.REG_SUM] = total
    goal = min(max(asked + total, -1.0), 1.0)
    x = goal + (state[L.REG_SPOOL] - goal) * math.exp(-dt / par[L.REG_LAG])
    state[L.REG_SPOOL] = 0.0 if abs(x) < SHUT else x


@folded
def fill_opening(par, state):
    """Opening of the port that fills.

    Args:
        par: (REG_PARAMS,) the regulator's numbers.
        state: (REG_STATE,) where it stands.
    """
    leak = par[L.REG_FILL_LEAK]
    return leak + (1.0 - min(leak, 1.0)) * max(state[L.REG_SPOOL], 0.0)


@folded
def vent_opening(par, state):
    """Opening of the port that vents.

    Args:
        par: (REG_PARAMS,) the regulator's numbers.
        state: (REG_STATE,) where it stands.
    """
    leak = par[L.REG_VENT_LEAK]
    return leak + (1.0 - min(leak, 1.0)) * max(-state[L.REG_SPOOL], 0.0)


@branching
def regulate_ports(dt, cells, ends, ports, chambers):
    """What the regulators make of the openings of their ports at this step.

    Args:
        dt: Step, s.
        cells: All slots.
        ends: Ends of pipes.
        ports: Ports, regulators among them.
        chambers: Chambers.
    """
    regulators = ports.regulators
    for k in range(regulators.table.shape[0]):
        fill = regulators.table[k, L.REG_FILL]
        vent = regulators.table[k, L.REG_VENT]
        ref = ports.table[fill, L.P_BI]
        for j in range(cells.lanes):
            if ports.table[fill, L.P_B] == L.SIDE_CHAMBER:
                p = chambers.work[ref, L.H_PRESSURE, j]
            else:
                p = cells.work[L.W_P, ends.table[ref, L.E_CELL] * cells.lanes + j]
            par = regulators.par[k, :, j]
            state = regulators.state[k, :, j]
            regulate(p, ports.opening[fill, j], dt, par, state)
            ports.opening[fill, j] = fill_opening(par, state)
            ports.opening[vent, j] = vent_opening(par, state)
