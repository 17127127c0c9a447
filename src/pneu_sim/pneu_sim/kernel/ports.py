# SPDX-License-Identifier: Apache-2.0
"""Ports of valves and orifices: what each side offers, and what flows."""

import math

from pneu_sim import layout as L
from pneu_sim.compiling import branching, folded
from pneu_sim.kernel.ends import face_state
from pneu_sim.kernel.orifices import iso6358_flow
from pneu_sim.riemann import hllc_flux


@folded
def _riemann_port(j, gamma, ea, eb, cells, ends):
    """Flux through a valve opened between two pipe ends as a smaller common face (thesis 5.4)."""
    w, S, X, index = cells.lanes, cells.state, cells.work, ends.table
    ia = index[ea, L.E_CELL] * w + j
    ib = index[eb, L.E_CELL] * w + j
    va = float(index[ea, L.E_SIGN]) * X[L.W_U, ia]
    vb = -float(index[eb, L.E_SIGN]) * X[L.W_U, ib]
    return hllc_flux(S[L.RHO, ia], va, X[L.W_P, ia], S[L.RHO, ib], vb, X[L.W_P, ib], gamma)


@folded
def _through_area(k, j, gas, cells, ends, ports):
    """Flow of a port that is a variable area between two pipe ends."""
    ia = ports.table[k, L.P_AI]
    ib = ports.table[k, L.P_BI]
    area = ports.opening[k, j] * ports.par[k, L.Q_AREA, j]
    m, push, h = _riemann_port(j, gas.gamma, ia, ib, cells, ends)
    ports.flow[k, 0, j] = area * m
    ports.flow[k, 1, j] = area * h
    for e, sign in ((ia, 1.0), (ib, -1.0)):
        i = ends.table[e, L.E_CELL] * cells.lanes + j
        ends.ported[e, L.N_PUSH, j] += area * (push - cells.work[L.W_P, i])
        ends.ported[e, L.N_HEAT, j] += sign * (area * h)


@folded
def _head(j, end, flow, heads, cells, ends):
    """Velocity heads at a pipe end: twice their pressure per flow, 1/(m s), and the Mach number.

    Stagnation pressure (one head) has its first compressible term; the momentum flux (two heads)
    is exact without.
    """
    i = ends.table[end, L.E_CELL] * cells.lanes + j
    area, c = cells.par[L.AREA, i], cells.work[L.W_C, i]
    y = flow / (cells.state[L.RHO, i] * area * area * c)
    x = y * c
    mach = min(y * area, 0.95)
    return heads * x * (1.0 + 0.25 * mach * mach * min(max(2.0 - heads, 0.0), 1.0)), mach


@folded
def _at_end(k, j, end, out, gas, order, cells, ends, ports):
    """What a port sees in a pipe: pressure at no flow, impedance, temperature.

    The stagnation pressure of the line it leaves (ISO 6358) drives the port, against the static
    pressure of the line it enters plus the velocity heads its jet does not recover; both heads are
    linearised about the last step's flow ``out`` of the pipe.
    """
    i = ends.table[end, L.E_CELL] * cells.lanes + j
    d, v, p = face_state(end, j, order, cells, ends)
    dc = math.sqrt(gas.gamma * p * d)
    z = dc / (d * cells.par[L.FACE, ends.table[end, L.E_FACE] * cells.lanes + j])
    p = max(p + dc * v - z * ends.ported[end, L.N_MASS, j], 0.05 * p)
    if out > 0.0:
        heads = ports.par[k, L.Q_HEAD, j]
        x, mach = _head(j, end, out, heads, cells, ends)
        # rarefied gas has less head: at 2 heads the slope is (1 - M)^2, never negative
        lean = z * max(1.0 - heads * mach * (1.0 - 0.5 * mach), 0.02)
        p += (lean - z + 0.5 * x) * out
        z = lean
    elif out < 0.0:
        x, _ = _head(j, end, -out, ports.par[k, L.Q_JET, j], cells, ends)
        z += x
        p += 0.5 * x * out
    return p, z, cells.work[L.W_T, i]


@folded
def _side(k, j, kind, ref, out, gas, order, cells, ends, ports, reservoirs, chambers):
    """What a port sees on one side: pressure at no flow, impedance, temperature."""
    if kind == L.SIDE_END:
        return _at_end(k, j, ref, out, gas, order, cells, ends, ports)
    if kind == L.SIDE_CHAMBER:
        return chambers.work[ref, L.H_PRESSURE, j], 0.0, chambers.work[ref, L.H_TEMPERATURE, j]
    return reservoirs.supplied[ref, j], 0.0, reservoirs.par[ref, L.R_TEMPERATURE, j]


@folded
def _most_out(j, end, flow, gas, order, cells, ends):
    """Most that can leave a pipe end, kg/s, its gas sonic there; infinite if ``flow`` is far below.

    A port that would take more is wider than the pipe: the pipe's own end chokes, along the
    isentrope and the characteristic that arrive there (as in `vessel_state`).
    """
    gamma = gas.gamma
    d, v, p = face_state(end, j, order, cells, ends)
    dc = math.sqrt(gamma * p * d)
    face = cells.par[L.FACE, ends.table[end, L.E_FACE] * cells.lanes + j]
    if flow < 0.4 * dc * face:
        return math.inf
    c = dc / d
    cf = min(max(2.0 / (gamma + 1.0) * c + (gamma - 1.0) / (gamma + 1.0) * v, 0.1 * c), c + abs(v))
    return face * cf * d * math.exp(2.0 / (gamma - 1.0) * math.log(cf / c))


@folded
def _through_port(k, j, gas, order, cells, ends, ports, reservoirs, chambers):
    """Flow of an ISO 6358 port, and what it takes from and brings to the pipes on its sides."""
    ported = ends.ported
    ka = ports.table[k, L.P_A]
    ia = ports.table[k, L.P_AI]
    kb = ports.table[k, L.P_B]
    ib = ports.table[k, L.P_BI]
    old = ports.flow[k, 0, j]
    if ka == L.SIDE_END:
        ported[ia, L.N_MASS, j] -= old
    if kb == L.SIDE_END:
        ported[ib, L.N_MASS, j] += old
    pa, za, ta = _side(k, j, ka, ia, old, gas, order, cells, ends, ports, reservoirs, chambers)
    pb, zb, tb = _side(k, j, kb, ib, -old, gas, order, cells, ends, ports, reservoirs, chambers)
    opening = ports.opening[k, j]
    c = opening * ports.par[k, L.Q_CONDUCTANCE, j]
    width = 1.0 - ports.par[k, L.Q_LAMINAR, j]
    if ports.par[k, L.Q_WIDENING, j] != 0.0:
        width *= min(opening, 1.0) ** ports.par[k, L.Q_WIDENING, j]
    m = iso6358_flow(
        pa,
        za,
        ta,
        pb,
        zb,
        tb,
        c,
        ports.par[k, L.Q_RATIO, j],
        1.0 - width,
        ports.par[k, L.Q_SHARE, j],
    )
    if m > 0.0 and ka == L.SIDE_END:
        most = _most_out(j, ia, m, gas, order, cells, ends)
        m = min(m, max(most - ported[ia, L.N_MASS, j], 0.0))
    elif m < 0.0 and kb == L.SIDE_END:
        most = _most_out(j, ib, -m, gas, order, cells, ends)
        m = max(m, min(ported[ib, L.N_MASS, j] - most, 0.0))
    up_kind, up, up_t = (ka, ia, ta) if m >= 0.0 else (kb, ib, tb)
    h0 = gas.gamma * gas.r / (gas.gamma - 1.0) * up_t
    if up_kind == L.SIDE_END:
        v = cells.work[L.W_U, ends.table[up, L.E_CELL] * cells.lanes + j]
        h0 += 0.5 * v * v
    ports.flow[k, 0, j] = m
    ports.flow[k, 1, j] = m * h0
    if ka == L.SIDE_END:
        ported[ia, L.N_MASS, j] += m
        ported[ia, L.N_HEAT, j] += m * h0
    if kb == L.SIDE_END:
        ported[ib, L.N_MASS, j] -= m
        ported[ib, L.N_HEAT, j] -= m * h0


@branching
def cross_ports(gas, order, cells, ends, ports, reservoirs, chambers):
    """Flow of every port at this step; sums per pipe end what leaves through ports.

    Args:
        gas: The gas.
        order: 1 Godunov, 2 MUSCL-Hancock.
        cells: All slots.
        ends: Ends of pipes.
        ports: Ports.
        reservoirs: Reservoirs.
        chambers: Chambers.
    """
    index, ported = ports.table, ends.ported
    ported[:] = 0.0
    # Flows of the last step stand in for ports not yet solved at this one (Gauss-Seidel).
    for k in range(index.shape[0]):
        if index[k, L.P_MODE] != L.ISO6358:
            continue
        for j in range(cells.lanes):
            if index[k, L.P_A] == L.SIDE_END:
                ported[index[k, L.P_AI], L.N_MASS, j] += ports.flow[k, 0, j]
            if index[k, L.P_B] == L.SIDE_END:
                ported[index[k, L.P_BI], L.N_MASS, j] -= ports.flow[k, 0, j]
    for k in range(index.shape[0]):
        for j in range(cells.lanes):
            if index[k, L.P_MODE] == L.EFFECTIVE_AREA:
                _through_area(k, j, gas, cells, ends, ports)
            else:
                _through_port(k, j, gas, order, cells, ends, ports, reservoirs, chambers)


@folded
def open_ports(at, fraction, opening, ports):
    """Opening of every port between two of those that were given.

    Args:
        at: Number of the earlier one.
        fraction: How far between the two.
        opening: (knots, n_ports, lanes) what was given.
        ports: Ports.
    """
    for k in range(ports.opening.shape[0]):
        for j in range(ports.opening.shape[1]):
            ports.opening[k, j] = (1.0 - fraction) * opening[at, k, j] + fraction * (
                opening[at + 1, k, j]
            )
