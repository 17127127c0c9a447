# SPDX-License-Identifier: Apache-2.0
"""What leaks from lines and chambers to the room, or enters from there."""

from pneu_sim import layout as L
from pneu_sim.compiling import branching, folded
from pneu_sim.kernel.faces import impose_jump
from pneu_sim.kernel.orifices import orifice_flow

RELIEF_STEPS = 40
"""Halvings of the range in which a pressure is sought: to below its rounding."""


@folded
def leak_flow(kind, size, opens, span, p, t, p_room, t_room, gamma, r_gas):
    """Mass flow of a leak to the room in kg/s, negative inwards.

    Args:
        kind: ORIFICE, POROUS or RELIEF.
        size: Effective area, m2; of a POROUS leak its flow over p^2 - p_room^2, kg/(s Pa^2).
        opens: Pressure at which a RELIEF begins to open, Pa.
        span: By how much more it is fully open, Pa.
        p: Pressure inside, Pa.
        t: Temperature inside, K.
        p_room: Pressure of the room, Pa.
        t_room: Temperature of the room, K.
        gamma: Ratio of specific heats.
        r_gas: Specific gas constant, J/(kg K).
    """
    if kind == L.POROUS:
        return size * (p - p_room) * (p + p_room)
    if kind == L.RELIEF:
        if p <= opens or p <= p_room:
            return 0.0
        size *= min((p - opens) / span, 1.0)
    if p >= p_room:
        return orifice_flow(p, t, p_room, size, gamma, r_gas)
    return -orifice_flow(p_room, t_room, p, size, gamma, r_gas)


@folded
def _relieved(size, opens, span, p, t, p_room, t_room, brought, falls, gamma, r_gas):
    """Pressure for which a relief valve of a cell lets through its flow of a step.

    It may open wide within a pressure that a step brings or takes many times over. Where the flow
    at the present one would take more than what lies above its opening, it is that of the pressure
    it leaves behind, p' = p + brought - falls m(p').
    """
    low = max(opens, p_room)
    m = leak_flow(L.RELIEF, size, opens, span, p, t, p_room, t_room, gamma, r_gas)
    if p <= low or falls * m <= p - low:
        return p
    high = p + brought
    if high <= low:
        return low
    for _ in range(RELIEF_STEPS):
        middle = 0.5 * (low + high)
        m = leak_flow(L.RELIEF, size, opens, span, middle, t, p_room, t_room, gamma, r_gas)
        if middle + falls * m > p + brought:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


@branching
def jump_at_leaks(van_leer, dt, cells, term):
    """Flow at the faces of cells that leak: it jumps in their middle, by that of the last step.

    Args:
        van_leer: Whether slopes are limited by van Leer's limiter, else by minmod.
        dt: Step, s.
        cells: All slots.
        term: What leaks, and how.
    """
    w = cells.lanes
    for q in range(term.table.shape[0]):
        slot = term.table[q, L.K_SLOT]
        if slot < 0:
            continue
        for j in range(w):
            i = slot * w + j
            if term.flow[q, j] != 0.0:
                jump = 0.5 * term.flow[q, j] / cells.par[L.AREA, i]
                impose_jump(i, jump, van_leer, dt, cells)


@branching
def leak(gas, dt, cells, chambers, term):
    """Take from lines and chambers what leaks to the room, or add what enters from there.

    Args:
        gas: The gas.
        dt: Step, s.
        cells: All slots.
        chambers: Chambers.
        term: What leaks, and how.
    """
    w, S, X, par = cells.lanes, cells.state, cells.work, term.par
    gamma, r_gas = gas.gamma, gas.r
    cp = gamma * (r_gas / (gamma - 1.0))
    for q in range(term.table.shape[0]):
        slot = term.table[q, L.K_SLOT]
        kind = term.table[q, L.K_KIND]
        for j in range(w):
            size = par[q, L.LEAK_SIZE, j]
            if size <= 0.0:
                continue
            opens = par[q, L.LEAK_SET, j]
            span = par[q, L.LEAK_RANGE, j]
            pa = term.room[0, j]
            ta = term.room[1, j]
            if slot < 0:
                c = -1 - slot
                p = chambers.work[c, L.H_PRESSURE, j]
                t = chambers.work[c, L.H_TEMPERATURE, j]
                m = leak_flow(kind, size, opens, span, p, t, pa, ta, gamma, r_gas)
                h = m * cp * (t if p >= pa else ta)
                chambers.state[c, 0, j] -= dt * m
                chambers.state[c, 1, j] -= dt * h
            else:
                i = slot * w + j
                p = X[L.W_P, i]
                t = X[L.W_T, i]
                if kind == L.RELIEF:
                    g = dt * cells.par[L.INV_VOLUME, i]
                    before, after = cells.par[L.FACE, i - w], cells.par[L.FACE, i]
                    into = before * X[L.W_FE, i - w] - after * X[L.W_FE, i]
                    falls = g * gamma * r_gas * t
                    brought = (gamma - 1.0) * g * into
                    p = _relieved(
                        size, opens, span, p, t, pa, ta, brought, falls, gamma, r_gas
                    )  # fmt: skip
                m = leak_flow(kind, size, opens, span, p, t, pa, ta, gamma, r_gas)
                term.flow[q, j] = m
                if p >= pa:
                    v = X[L.W_U, i]
                    h = m * (cp * t + 0.5 * v**2)
                else:
                    v = 0.0
                    h = m * cp * ta
                g = dt * cells.par[L.INV_VOLUME, i]
                S[L.RHO, i] -= g * m
                S[L.MOM, i] -= g * m * v
                S[L.ENE, i] -= g * h
