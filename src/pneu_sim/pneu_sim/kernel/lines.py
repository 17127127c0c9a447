# SPDX-License-Identifier: Apache-2.0
"""The gas in the cells of all lines: its primitive state, and what the faces carry to it.

Finite volumes in conservative variables (thesis ch. 4 and 5). A wall that yields holds gas too: the
cells then keep what the pipe holds, and the gas is taken out of it for the passes that look at it.
"""

import math

from pneu_sim import layout as L
from pneu_sim.compiling import branching, each, sequence, vectorised


@vectorised
def _invert(rho, ri):
    """Reciprocals, slot by slot."""
    for i in each(rho.size):
        ri[i] = 1.0 / rho[i]


@sequence
def invert_density(cells):
    """Take the reciprocal of the density of every slot.

    Args:
        cells: All slots.
    """
    _invert(cells.state[L.RHO], cells.work[L.W_RI])


@vectorised
def _primitive(gamma, r, mom, ene, ri, u, p, c, t):
    """See `find_primitive`."""
    gm = gamma - 1.0
    i_r = 1.0 / r
    for i in each(mom.size):
        d = ri[i]
        v = mom[i] * d
        q = gm * (ene[i] - 0.5 * mom[i] * v)
        u[i] = v
        p[i] = q
        c[i] = math.sqrt(gamma * q * d)
        t[i] = q * d * i_r


@sequence
def find_primitive(gas, cells):
    """Velocity, pressure, speed of sound and temperature of every slot (thesis table 4.1).

    Args:
        gas: The gas.
        cells: All slots.
    """
    S, X = cells.state, cells.work
    u, p, c, t = X[L.W_U], X[L.W_P], X[L.W_C], X[L.W_T]
    _primitive(gas.gamma, gas.r, S[L.MOM], S[L.ENE], X[L.W_RI], u, p, c, t)


@branching
def take_gas(gas, cells):
    """Turn what a yielding pipe holds per nominal volume into the state of its gas.

    The wall widens the area by ``s = 1 + kappa (p - rest)`` and stores elastic energy, so that the
    pipe holds ``E = s (p / (g - 1) + rho u^2 / 2) + kappa (p^2 - rest^2) / 2`` per nominal volume.
    What is taken away is kept, for `give_back`.

    Args:
        gas: The gas.
        cells: All slots.
    """
    rho, mom, ene = cells.state[L.RHO], cells.state[L.MOM], cells.state[L.ENE]
    kappa, rest, soft = cells.par[L.COMPLIANCE], cells.par[L.REST_P], cells.soft
    gamma = gas.gamma
    gm = gamma - 1.0
    for i in each(rho.size):
        k = kappa[i]
        if k <= 0.0:
            soft[L.SOFT_STRETCH, i] = 1.0
            soft[L.SOFT_RHO, i] = soft[L.SOFT_MOM, i] = soft[L.SOFT_ENE, i] = 0.0
            continue
        pa = rest[i]
        v = mom[i] / rho[i]
        e = gm * (ene[i] - 0.5 * mom[i] * v + 0.5 * k * pa * pa)
        b = 1.0 - k * pa
        q = 2.0 * e / (b + math.sqrt(b * b + 2.0 * k * (gamma + 1.0) * e))
        s = 1.0 + k * (q - pa)
        d = rho[i] / s
        g = q / gm + 0.5 * d * v * v
        soft[L.SOFT_STRETCH, i] = s
        soft[L.SOFT_RHO, i] = rho[i] - d
        soft[L.SOFT_MOM, i] = mom[i] - d * v
        soft[L.SOFT_ENE, i] = ene[i] - g
        rho[i] = d
        mom[i] = d * v
        ene[i] = g


@vectorised
def _add(rho, mom, ene, d_rho, d_mom, d_ene):
    """What is held besides, slot by slot."""
    for i in each(rho.size):
        rho[i] += d_rho[i]
        mom[i] += d_mom[i]
        ene[i] += d_ene[i]


@sequence
def give_back(cells):
    """Undo `take_gas`; what happened to the gas meanwhile happens to the pipe.

    Args:
        cells: All slots.
    """
    S, soft = cells.state, cells.soft
    d_rho, d_mom, d_ene = soft[L.SOFT_RHO], soft[L.SOFT_MOM], soft[L.SOFT_ENE]
    _add(S[L.RHO], S[L.MOM], S[L.ENE], d_rho, d_mom, d_ene)


@branching
def yield_half(gas, dt, cells):
    """Have reconstructed states yield to what they become in half a step.

    The wall takes up part of what is compressed: D rho / Dt = -phi rho du/dx along with the gas,
    phi = 1 / (1 + kappa gamma p / s), where a rigid wall has 1.

    Args:
        gas: The gas.
        dt: Step, s.
        cells: All slots.
    """
    X, kappa, length = cells.work, cells.par[L.COMPLIANCE], cells.par[L.LENGTH]
    for i in each(length.size):
        if kappa[i] > 0.0 and length[i] > 0.0:
            k = kappa[i] * gas.gamma * X[L.W_P, i] / cells.soft[L.SOFT_STRETCH, i]
            g = 0.5 * dt / length[i] * k / (1.0 + k) * (X[L.W_UR, i] - X[L.W_UL, i])
            d, p = g * cells.state[L.RHO, i], g * gas.gamma * X[L.W_P, i]
            X[L.W_RL, i] += d
            X[L.W_RR, i] += d
            X[L.W_PL, i] += p
            X[L.W_PR, i] += p
            X[L.W_IL, i] = 1.0 / X[L.W_RL, i]
            X[L.W_IR, i] = 1.0 / X[L.W_RR, i]


@branching
def widen_faces(order, cells):
    """Areas of the faces of yielding pipes; a pipe's end is held by its fitting.

    Args:
        order: 1 Godunov, 2 MUSCL-Hancock, whose areas are those at the middle of the step.
        cells: All slots.
    """
    w, length, face, X = cells.lanes, cells.par[L.LENGTH], cells.par[L.FACE], cells.work
    kappa, stretch = cells.par[L.COMPLIANCE], cells.soft[L.SOFT_STRETCH]
    for i in each(length.size - w):
        s = 1.0
        if length[i] > 0.0 and length[i + w] > 0.0:
            s = 0.5 * (stretch[i] + stretch[i + w])
            if order == 2:
                s += 0.5 * kappa[i] * (X[L.W_PR, i] - X[L.W_P, i])
                s += 0.5 * kappa[i + w] * (X[L.W_PL, i + w] - X[L.W_P, i + w])
        cells.soft[L.SOFT_FACE, i] = face[i] * s


@vectorised
def _balance(dt, w, face, inv, pl, pr, fm, fp, fe, rho, mom, ene, ri):
    """See `conserve`."""
    # Shifted views instead of an index i + w: what keeps the loop free of gathers.
    right, gm, gp, ge = face[w:], fm[w:], fp[w:], fe[w:]
    inv, pl, pr, rho, mom, ene, ri = inv[w:], pl[w:], pr[w:], rho[w:], mom[w:], ene[w:], ri[w:]
    for i in each(rho.size):
        k = dt * inv[i]
        a = face[i]
        b = right[i]
        d = rho[i] + k * (a * fm[i] - b * gm[i])
        rho[i] = d
        ri[i] = 1.0 / d
        mom[i] += k * (a * fp[i] - b * gp[i] + 0.5 * (pl[i] + pr[i]) * (b - a))
        ene[i] += k * (a * fe[i] - b * ge[i])


@sequence
def conserve(order, dt, cells, face):
    """Add what the faces carry, and the wall reaction of a changing area (thesis eq. 4.1-4.8).

    That wall has the cell's pressure; with order 2 the one in the middle of the step.

    Args:
        order: 1 Godunov, 2 MUSCL-Hancock.
        dt: Step, s.
        cells: All slots.
        face: Area of the face between each slot and the next.
    """
    S, X = cells.state, cells.work
    inv, ri = cells.par[L.INV_VOLUME], X[L.W_RI]
    pl, pr = X[L.W_P if order == 1 else L.W_PL], X[L.W_P if order == 1 else L.W_PR]
    fm, fp, fe = X[L.W_FM], X[L.W_FP], X[L.W_FE]
    _balance(dt, cells.lanes, face, inv, pl, pr, fm, fp, fe, S[L.RHO], S[L.MOM], S[L.ENE], ri)
