# SPDX-License-Identifier: Apache-2.0
"""Ports of valves and orifices: what each side offers, and what flows."""

import math

from pneu_sim import layout as L
from pneu_sim.compiling import branching, folded
from pneu_sim.kernel.ends import face_state
from pneu_sim.kernel.orifices import ANR_DENSITY, ANR_TEMPERATURE, iso6358_flow
from pneu_sim.kernel.waves import choked_velocity, end_curve, equal_flux_velocity, power
from pneu_sim.riemann import hllc_flux

PORT_STEPS = 30
"""Iteration limit of the linearisation of a port's sides."""
TANGENT = 3e-4
"""Tolerance of that linearisation: change of the end velocity over the speed of sound. The relative
error of the pressure is of its square, 1e-7."""


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
def warmth(j, kind, ref, gas, cells, ends, reservoirs, chambers):
    """Stagnation temperature of what a port draws from one side, K.

    Args:
        j: The lane.
        kind: Kind of the side.
        ref: Which one of those.
        gas: The gas.
        cells: All slots.
        ends: Ends of pipes.
        reservoirs: Reservoirs.
        chambers: Chambers.
    """
    if kind == L.SIDE_END:
        i = ends.table[ref, L.E_CELL] * cells.lanes + j
        u = cells.work[L.W_U, i]
        return cells.work[L.W_T, i] + 0.5 * (gas.gamma - 1.0) / (gas.gamma * gas.r) * u * u
    if kind == L.SIDE_CHAMBER:
        return chambers.work[ref, L.H_TEMPERATURE, j]
    return reservoirs.par[ref, L.R_TEMPERATURE, j]


@folded
def _at_end(k, j, end, vf, least, far_t, others, c, gas, order, cells, ends, ports):
    """Pressure at a pipe's end as a linear function of a port's flow, about a given velocity.

    The stagnation pressure of the line it leaves (ISO 6358-1) drives the port, against the static
    pressure of the line it enters plus the velocity heads its jet does not recover.

    Args:
        k: The port.
        j: The lane.
        end: The end of the pipe.
        vf: Velocity at the end, as known so far, positive out of the pipe, m/s.
        least: The velocity of gas that enters at its own speed of sound, m/s; from there on the
            pressure goes with the flow.
        far_t: Stagnation temperature of what enters, K.
        others: What other ports take from the pipe's end, kg/s.
        c: Sonic conductance of the port as it is opened, m^3/(s Pa).
        gas: The gas.
        order: 1 Godunov, 2 MUSCL-Hancock.
        cells: All slots.
        ends: Ends of pipes.
        ports: Ports.

    Returns:
        Pressure that there would be with no flow of this port, by how much it falls per flow;
        flow at which the tangent lies, and the velocity's growth per flow; stagnation temperature
        of what leaves.
    """
    gamma = gas.gamma
    d, v, p = face_state(end, j, order, cells, ends)
    area = cells.par[L.FACE, ends.table[end, L.E_FACE] * cells.lanes + j]
    cp = gamma * gas.r / (gamma - 1.0)
    before = equal_flux_velocity(d, v, p, vf, cp * far_t, gamma)
    df, q, z, m, slope = end_curve(d, before, p, vf, cp * far_t, gamma)
    ported = ends.ported
    ported[end, L.N_SPEED, j], ported[end, L.N_STATIC, j] = vf, q
    ported[end, L.N_FALL, j], ported[end, L.N_FLUX, j] = z, m
    ported[end, L.N_SLOPE, j], ported[end, L.N_ENTHALPY, j] = slope, cp * far_t
    held = 0.0
    if ends.give[end, j] != 1.0:
        held = (1.0 / ends.give[end, j] - 1.0) / math.sqrt(gamma * p / d)
    grow = area * (max(slope, 1e-3 * df) + held * z)
    at = area * (m + held * (p - q)) - others
    t0 = q / (gas.r * df) + 0.5 * vf * vf / cp
    falls = z / grow if vf > least else 1.0 / (area * (held - m / q))
    if at > 0.0 and vf > 0.0:
        # One head is the stagnation pressure, along an isentrope; two are the momentum that
        # arrives; each falls with the velocity up to that of sound, the former by rho0 (c - v), the
        # latter by rho (c - v)^2 / c. What other ports bring has none.
        heads = ports.par[k, L.Q_HEAD, j] * min(max(at + others, 0.0) / at, 1.0)
        dynamic = 0.5 * df * vf * vf
        share = min(max(2.0 - heads, 0.0), 1.0)
        more = (1.0 - share) * dynamic
        less = (share - 1.0) * (df * vf - dynamic * z / (gamma * q))
        if share > 0.0:
            rest = q * power(t0 * gas.r * df / q, gamma / (gamma - 1.0))
            more += share * (rest - q)
            less += share * (rest / (gas.r * t0) * (z / df - vf) - z)
        falls = max(z + heads * less, 0.0) / grow
        q += heads * more
    elif vf < 0.0:
        # A port that is wider than the line is no nozzle of its own: what it lets in is set in
        # motion by the line's mouth, and no less drives it than the stagnation pressure there.
        share = 0.0
        wide = c * ANR_DENSITY * math.sqrt(ANR_TEMPERATURE * gas.r / gamma) / area
        if wide > 0.5:
            wide *= (0.5 * (gamma + 1.0)) ** (0.5 * (gamma + 1.0) / (gamma - 1.0))
            share = max(1.0 - 1.0 / (wide * wide), 0.0)
        if share > 0.0:
            rest = q * power(t0 * gas.r * df / q, gamma / (gamma - 1.0))
            rises = rest / q * ((z - df * vf) / grow if vf > least else falls)
            falls += share * (rises - falls)
            q += share * (rest - q)
        if at < 0.0:
            x = (1.0 - share) * ports.par[k, L.Q_JET, j] * abs(at) / (df * area * area)
            falls += x
            q += 0.5 * x * abs(at)
    return q + falls * at, falls, at, 1.0 / grow, t0


@folded
def _conductance(j, end, ports):
    """Of all ports at a pipe's end together, m^3/(s Pa)."""
    total = 0.0
    for k in range(ports.table.shape[0]):
        for kind, ref in ((L.P_A, L.P_AI), (L.P_B, L.P_BI)):
            if ports.table[k, kind] == L.SIDE_END and ports.table[k, ref] == end:
                total += ports.opening[k, j] * ports.par[k, L.Q_CONDUCTANCE, j]
    return total


@folded
def solve_port(k, j, gas, order, cells, ends, ports, reservoirs, chambers):
    """Flow of an ISO 6358 port from what is on its sides, and its stagnation temperature.

    Args:
        k: The port.
        j: The lane.
        gas: The gas.
        order: 1 Godunov, 2 MUSCL-Hancock.
        cells: All slots.
        ends: Ends of pipes; of the port itself `ported` has its last flow.
        ports: Ports.
        reservoirs: Reservoirs.
        chambers: Chambers.

    Returns:
        Mass flow, kg/s, and the temperature, K: of a line it is that behind the wave by which its
        gas is set in motion.
    """
    ported = ends.ported
    ka = ports.table[k, L.P_A]
    ia = ports.table[k, L.P_AI]
    kb = ports.table[k, L.P_B]
    ib = ports.table[k, L.P_BI]
    m = ports.flow[k, 0, j]
    opening = ports.opening[k, j]
    c = opening * ports.par[k, L.Q_CONDUCTANCE, j]
    if c <= 0.0:
        return 0.0, 1.0
    width = 1.0 - ports.par[k, L.Q_LAMINAR, j]
    if ports.par[k, L.Q_WIDENING, j] != 0.0:
        width *= min(opening, 1.0) ** ports.par[k, L.Q_WIDENING, j]
    ta = warmth(j, ka, ia, gas, cells, ends, reservoirs, chambers)
    tb = warmth(j, kb, ib, gas, cells, ends, reservoirs, chambers)
    pa = pb = za = zb = va = vb = at_a = at_b = grow_a = grow_b = 0.0
    lowest_a = highest_a = lowest_b = highest_b = near = others_a = others_b = 0.0
    sonic = 2.0 * gas.gamma * gas.r / (gas.gamma + 1.0)
    if ka == L.SIDE_END:
        va = float(ends.table[ia, L.E_SIGN]) * ends.velocity[ia, 0, j]
        d, v, p = face_state(ia, j, order, cells, ends)
        lowest_a, highest_a = -math.sqrt(sonic * tb), choked_velocity(d, v, p, gas.gamma)
        near = TANGENT * math.sqrt(gas.gamma * p / d)
        others_a = ported[ia, L.N_MASS, j] - m
    elif ka == L.SIDE_CHAMBER:
        pa = chambers.work[ia, L.H_PRESSURE, j]
    else:
        pa = reservoirs.supplied[ia, j]
    if kb == L.SIDE_END:
        vb = float(ends.table[ib, L.E_SIGN]) * ends.velocity[ib, 0, j]
        d, v, p = face_state(ib, j, order, cells, ends)
        lowest_b, highest_b = -math.sqrt(sonic * ta), choked_velocity(d, v, p, gas.gamma)
        near = TANGENT * math.sqrt(gas.gamma * p / d)
        others_b = ported[ib, L.N_MASS, j] + m
    elif kb == L.SIDE_CHAMBER:
        pb = chambers.work[ib, L.H_PRESSURE, j]
    else:
        pb = reservoirs.supplied[ib, j]
    for attempt in range(PORT_STEPS):
        # beyond a few, it goes to and fro over a bend between sonic and slower flow
        part = 1.0 if attempt < 4 else 0.5
        if ka == L.SIDE_END:
            va = min(max(va, lowest_a), highest_a)
            pa, za, at_a, grow_a, t0 = _at_end(
                k, j, ia, va, lowest_a, tb, others_a, c, gas, order, cells, ends, ports
            )
            ta = t0 if va > 0.0 else ta
        if kb == L.SIDE_END:
            vb = min(max(vb, lowest_b), highest_b)
            pb, zb, at_b, grow_b, t0 = _at_end(
                k, j, ib, vb, lowest_b, ta, others_b, c, gas, order, cells, ends, ports
            )
            tb = t0 if vb > 0.0 else tb
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
        moved = 0.0
        if ka == L.SIDE_END:
            was = va
            va = min(max(va + part * (m - at_a) * grow_a, lowest_a), highest_a)
            moved = abs(va - was)
        if kb == L.SIDE_END:
            was = vb
            vb = min(max(vb - part * (m + at_b) * grow_b, lowest_b), highest_b)
            moved = max(moved, abs(vb - was))
        if moved <= near:
            break
    # a port that would take more is wider than the pipe, whose own end chokes; several share it
    if m > 0.0 and ka == L.SIDE_END and va >= highest_a:
        share = c / _conductance(j, ia, ports)
        m = min(m, max(at_a, share * (at_a + others_a), 0.0))
    elif m < 0.0 and kb == L.SIDE_END and vb >= highest_b:
        share = c / _conductance(j, ib, ports)
        m = max(m, min(-at_b, -share * (at_b + others_b), 0.0))
    # from which the state at the end, and the next step, begin
    if ka == L.SIDE_END:
        ends.velocity[ia, 0, j] = float(ends.table[ia, L.E_SIGN]) * va
    if kb == L.SIDE_END:
        ends.velocity[ib, 0, j] = float(ends.table[ib, L.E_SIGN]) * vb
    return m, ta if m >= 0.0 else tb


@folded
def through_port(k, j, gas, order, cells, ends, ports, reservoirs, chambers):
    """Flow of an ISO 6358 port, and what it takes from and brings to the pipes on its sides.

    Args:
        k: The port.
        j: The lane.
        gas: The gas.
        order: 1 Godunov, 2 MUSCL-Hancock.
        cells: All slots.
        ends: Ends of pipes.
        ports: Ports.
        reservoirs: Reservoirs.
        chambers: Chambers.
    """
    ka, ia = ports.table[k, L.P_A], ports.table[k, L.P_AI]
    kb, ib = ports.table[k, L.P_B], ports.table[k, L.P_BI]
    m, t = solve_port(k, j, gas, order, cells, ends, ports, reservoirs, chambers)
    heat = m * gas.gamma * gas.r / (gas.gamma - 1.0) * t
    if ka == L.SIDE_END:
        ends.ported[ia, L.N_MASS, j] += m - ports.flow[k, 0, j]
        ends.ported[ia, L.N_HEAT, j] += heat
    if kb == L.SIDE_END:
        ends.ported[ib, L.N_MASS, j] -= m - ports.flow[k, 0, j]
        ends.ported[ib, L.N_HEAT, j] -= heat
    ports.flow[k, 0, j] = m
    ports.flow[k, 1, j] = heat


@branching
def recall_ports(cells, ends, ports):
    """Have the flows of the last step stand in for ports not yet solved at this one (Gauss-Seidel).

    Args:
        cells: All slots.
        ends: Ends of pipes.
        ports: Ports.
    """
    index, ported = ports.table, ends.ported
    ported[:] = 0.0
    for k in range(index.shape[0]):
        if index[k, L.P_MODE] != L.ISO6358:
            continue
        for j in range(cells.lanes):
            if index[k, L.P_A] == L.SIDE_END:
                ported[index[k, L.P_AI], L.N_MASS, j] += ports.flow[k, 0, j]
            if index[k, L.P_B] == L.SIDE_END:
                ported[index[k, L.P_BI], L.N_MASS, j] -= ports.flow[k, 0, j]


@folded
def is_small(q, j, chambers):
    """Whether the q-th of the small chambers is one in a lane, and has gas that can be balanced.

    Args:
        q: Which of `Chambers.small`.
        j: The lane.
        chambers: Chambers.
    """
    c = chambers.small[q]
    fine = chambers.state[c, 0, j] > 0.0 and chambers.state[c, 1, j] > 0.0
    return chambers.stiff[q, j] > 0.0 and fine


@folded
def at_small(k, j, ports, chambers):
    """Whether a port is one of a small chamber.

    Args:
        k: The port.
        j: The lane.
        ports: Ports.
        chambers: Chambers.
    """
    found = False
    for q in range(chambers.small.size):
        for kind, ref in ((L.P_A, L.P_AI), (L.P_B, L.P_BI)):
            if ports.table[k, kind] == L.SIDE_CHAMBER and ports.table[k, ref] == chambers.small[q]:
                found = found or is_small(q, j, chambers)
    return found


@branching
def cross_ports(gas, order, cells, ends, ports, reservoirs, chambers):
    """Flow of every port at this step; sums per pipe end what leaves through ports.

    Those of small chambers have theirs already, see `small`.

    Args:
        gas: The gas.
        order: 1 Godunov, 2 MUSCL-Hancock.
        cells: All slots.
        ends: Ends of pipes, after `recall_ports`.
        ports: Ports.
        reservoirs: Reservoirs.
        chambers: Chambers.
    """
    for k in range(ports.table.shape[0]):
        for j in range(cells.lanes):
            if chambers.small.size > 0 and at_small(k, j, ports, chambers):
                continue
            if ports.table[k, L.P_MODE] == L.EFFECTIVE_AREA:
                _through_area(k, j, gas, cells, ends, ports)
            else:
                through_port(k, j, gas, order, cells, ends, ports, reservoirs, chambers)


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
