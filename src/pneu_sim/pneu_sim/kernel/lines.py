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
def widen_faces(cells):
    """Areas of the faces of yielding pipes; a pipe's end is held by its fitting.

    Args:
        cells: All slots.
    """
    w, length, face = cells.lanes, cells.par[L.LENGTH], cells.par[L.FACE]
    stretch, out = cells.soft[L.SOFT_STRETCH], cells.soft[L.SOFT_FACE]
    for i in each(length.size - w):
        inside = length[i] > 0.0 and length[i + w] > 0.0
        out[i] = face[i] * (0.5 * (stretch[i] + stretch[i + w]) if inside else 1.0)


@vectorised
def _balance(dt, w, face, inv, p, fm, fp, fe, rho, mom, ene, ri):
    """See `conserve`."""
    # Shifted views instead of an index i + w: what keeps the loop free of gathers.
    right, gm, gp, ge = face[w:], fm[w:], fp[w:], fe[w:]
    inv, p, rho, mom, ene, ri = inv[w:], p[w:], rho[w:], mom[w:], ene[w:], ri[w:]
    for i in each(rho.size):
        k = dt * inv[i]
        a = face[i]
        b = right[i]
        d = rho[i] + k * (a * fm[i] - b * gm[i])
        rho[i] = d
        ri[i] = 1.0 / d
        mom[i] += k * (a * fp[i] - b * gp[i] + p[i] * (b - a))
        ene[i] += k * (a * fe[i] - b * ge[i])


@sequence
def conserve(dt, cells, face):
    """Add what the faces carry, and the wall reaction of a changing area (thesis eq. 4.1-4.8).

    Args:
        dt: Step, s.
        cells: All slots.
        face: Area of the face between each slot and the next.
    """
    S, X = cells.state, cells.work
    inv, p, ri = cells.par[L.INV_VOLUME], X[L.W_P], X[L.W_RI]
    fm, fp, fe = X[L.W_FM], X[L.W_FP], X[L.W_FE]
    _balance(dt, cells.lanes, face, inv, p, fm, fp, fe, S[L.RHO], S[L.MOM], S[L.ENE], ri)
