# SPDX-License-Identifier: Apache-2.0
"""Volumes beside a line: what they hold takes part in mass and energy, not in momentum.

The gas of a fitting, a ring or a valve's chamber beside a cell has the cell's pressure and
temperature, so the cell is so much larger for what is conserved of both. It does not flow along:
what pushes and what drags act on the gas of the line alone, and what enters the side leaves its
momentum there, as the gas of a chamber does. It lies beside the middle of the cell, before and
behind which the gas then has two velocities; or, where a pipe is closed or ends at ports, at that
end.
"""

from pneu_sim import layout as L
from pneu_sim.compiling import branching
from pneu_sim.kernel.faces import impose_jump


@branching
def mark_sides(cells, sides):
    """Keep density and momentum of the cells that have a side, before something acts on them.

    Args:
        cells: All slots.
        sides: Their sides.
    """
    for q in range(sides.table.shape[0]):
        for j in range(cells.lanes):
            i = sides.table[q, L.D_SLOT] * cells.lanes + j
            sides.kept[q, 0, j] = cells.state[L.RHO, i]
            sides.kept[q, 1, j] = cells.state[L.MOM, i]


@branching
def push_sides(cells, sides, shared):
    """Have what acted since `mark_sides` act on the gas of the line alone.

    So has the energy: what is at rest beside the line is no part of what moves. Its part of
    rho u^2 / 2 is in the cell's energy, by which the pressure is found as in any cell; so it is
    added and taken away as the velocity changes.

    Args:
        cells: All slots.
        sides: Their sides.
        shared: Whether what acted was shared by all gas of the cell, else it was on the line's.
    """
    for q in range(sides.table.shape[0]):
        for j in range(cells.lanes):
            more = sides.more[q, j]
            if more <= 0.0:
                continue
            i = sides.table[q, L.D_SLOT] * cells.lanes + j
            d, was = cells.state[L.RHO, i], sides.kept[q, 1, j]
            m = cells.state[L.MOM, i]
            if shared:
                a, b = cells.par[L.FACE, i - cells.lanes], cells.par[L.FACE, i]
                flow = cells.work[L.W_FM]
                sides.kept[q, 2, j] = a * flow[i - cells.lanes] - b * flow[i]
                m = was + (1.0 + more) * (m - was)
                m /= 1.0 + more * max(1.0 - sides.kept[q, 0, j] / d, 0.0)
                cells.state[L.MOM, i] = m
            moves = 0.5 * (m * m / d - was * was / sides.kept[q, 0, j])
            cells.state[L.ENE, i] += more / (1.0 + more) * moves


@branching
def soften_ends(dt, cells, sides, ends):
    """How far the pressure at pipe ends with a side follows what flows there within a step.

    Of an end by itself the wave that runs into the pipe takes up a flow, c / A per mass flow; the
    side takes it up besides, c^2 dt / V.

    Args:
        dt: Step, s.
        cells: All slots.
        sides: Sides of cells.
        ends: Ends of pipes.
    """
    for q in range(sides.table.shape[0]):
        e = sides.table[q, L.D_END]
        if e < 0:
            continue
        for j in range(cells.lanes):
            i = sides.table[q, L.D_SLOT] * cells.lanes + j
            far = sides.more[q, j] * cells.par[L.LENGTH, i]
            ends.give[e, j] = 1.0 / (1.0 + far / (cells.work[L.W_C, i] * dt))


@branching
def jump_at_sides(van_leer, dt, cells, sides):
    """Flow at the faces of cells that have a side in their middle: it jumps there.

    By what the side took up in the last step.

    Args:
        van_leer: Whether slopes are limited by van Leer's limiter, else by minmod.
        dt: Step, s.
        cells: All slots.
        sides: Sides of cells.
    """
    w = cells.lanes
    for q in range(sides.table.shape[0]):
        if sides.table[q, L.D_END] >= 0:
            continue
        for j in range(w):
            i = sides.table[q, L.D_SLOT] * w + j
            more = sides.more[q, j]
            lost = more / (1.0 + more) * sides.kept[q, 2, j]
            impose_jump(i, 0.5 * lost / cells.par[L.AREA, i], van_leer, dt, cells)


@branching
def press_sides(cells, sides, ends):
    """Pressure on closed ends that have a side.

    Args:
        cells: All slots.
        sides: Sides of cells.
        ends: Ends of pipes.
    """
    X = cells.work
    for q in range(sides.table.shape[0]):
        e = sides.table[q, L.D_END]
        if e < 0 or ends.table[e, L.E_KIND] != L.WALL:
            continue
        for j in range(cells.lanes):
            p = X[L.W_P, sides.table[q, L.D_SLOT] * cells.lanes + j]
            f = ends.table[e, L.E_FACE] * cells.lanes + j
            X[L.W_FP, f] = p + ends.give[e, j] * (X[L.W_FP, f] - p)
