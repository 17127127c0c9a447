# SPDX-License-Identifier: Apache-2.0
"""Ends of pipes: what lies beyond them, what flows through, and what that feeds."""

import math

from pneu_sim import layout as L
from pneu_sim.compiling import apart, branching, folded, sequence
from pneu_sim.kernel.orifices import orifice_flow
from pneu_sim.kernel.waves import (
    choked_velocity,
    end_curve,
    equal_flux_velocity,
    leaving,
    power,
    shock_swept_out,
    wave_state,
)

JET_STEPS, JET_FOUND = 40, 1e-10
"""Of the search for the pressure behind a cushion, at most; the share of the chamber's to which it
is found."""
JOINT_STEPS, JOINT_FOUND = 20, 1e-7
"""Iteration limit and relative tolerance of Newton's method for the pressure of a joint; flows
are those of the tangent there, whose error is of the square of that."""
FOUND = 1e-9
"""Share of a vessel's pressure to which that at a pipe's end is found."""
END_STEPS, END_FOUND = 20, 1e-8
"""Iteration limit of Newton's method for the velocity at an end, and its tolerance: the square of
the last step over that of the speed of sound, which is the error that remains."""


@folded
def _outflow(d, v, p, p0, out, df, gamma):
    """State at a pipe end that gas leaves at a pressure, with the velocity there, or sonic."""
    if out * out * df <= gamma * p0:
        return df, out, p0
    out = choked_velocity(d, v, p, gamma)
    _, pf, _ = wave_state(d, v, p, out, gamma)
    return gamma * pf / (out * out), out, pf


@branching
def vessel_state(d, v, p, p0, t0, loss, guess, gamma, r_gas):
    """State at a pipe end that opens into a large vessel.

    Outflow leaves at the vessel's pressure, or sonic, or as fast as it comes; inflow comes from
    rest at the vessel's pressure and temperature, less ``loss`` velocity heads. Either way the wave
    that runs into the pipe fixes the rest (`wave_state`).

    Args:
        d: Density in the pipe's end, kg/m^3.
        v: Velocity there, positive out of the pipe, m/s.
        p: Pressure there, Pa.
        p0: Pressure of the vessel, Pa.
        t0: Temperature of the vessel, K.
        loss: Velocity heads lost on inflow.
        guess: Velocity at the end from which inflow is searched for, m/s; none where not negative.
        gamma: Ratio of specific heats.
        r_gas: Specific gas constant, J/(kg K).

    Returns:
        Density, outward velocity and pressure at the end.
    """
    if shock_swept_out(d, v, p, p0, gamma):
        return d, v, p
    k = 0.5 * (gamma - 1.0) * (1.0 + loss) / (gamma * r_gas * t0)
    head = gamma / (gamma - 1.0) * k * p0
    w = -guess
    if w <= 0.0:
        out, df = leaving(d, v, p, p0, gamma)
        if out >= 0.0:
            return _outflow(d, v, p, p0, out, df, gamma)
        z = math.sqrt(gamma * p0 * df)  # Bernoulli's law to first order in the velocity head
        w = -2.0 * z * out / (z + math.sqrt(z * (z - 4.0 * head * out)))
    # Newton's method; gas from rest is at most sonic: k w^2 <= (gamma - 1) / (gamma + 1)
    most = (gamma - 1.0) / (gamma + 1.0)
    pf, sonic = p0, False
    for _ in range(6):
        s = k * w * w
        if s > most:
            sonic = True
            w, s = math.sqrt(most / k), most
        y = power(1.0 - s, gamma / (gamma - 1.0))
        _, pf, z = wave_state(d, v, p, -w, gamma)
        step = (p0 * y - pf) / (2.0 * head * y * w / (1.0 - s) + z)
        if sonic and step >= 0.0:
            pf = p0 * y
            break
        w += step
        if (head + d) * step * step < FOUND * p0:  # what is left of the pressure, at most
            pf += z * step
            break
    if w <= 0.0:
        out, df = leaving(d, v, p, p0, gamma)
        return _outflow(d, v, p, p0, max(out, 0.0), df, gamma)
    tf = t0 - 0.5 * (gamma - 1.0) / (gamma * r_gas) * w * w
    return pf / (r_gas * tf), -w, pf


@folded
def _jet(p, wave, z, p0, t0, left, gamma, r_gas):
    """By how much the flow that a pressure at a pipe's end takes exceeds what a jet brings."""
    w = (p - wave) / z
    t = max(t0 - 0.5 * (gamma - 1.0) / (gamma * r_gas) * w * w, 0.5 * t0)
    return p / (r_gas * t) * w - orifice_flow(p0, t0, p, left, gamma, r_gas)


@folded
def cushioned_state(d, v, p, p0, t0, shut, guess, gamma, r_gas):
    """State at a pipe end that opens into a chamber whose way out is partly shut.

    Outflow of the pipe is as in `vessel_state`. What enters it comes through the part of its end
    that is left, an isentropic orifice (thesis eq. 3.15-3.17), and mixes behind that without
    getting back any pressure.

    Args:
        d: Density in the pipe's end, kg/m^3.
        v: Velocity there, positive out of the pipe, m/s.
        p: Pressure there, Pa.
        p0: Pressure of the chamber, Pa.
        t0: Temperature of the chamber, K.
        shut: Part of the end that is shut.
        guess: See `vessel_state`.
        gamma: Ratio of specific heats.
        r_gas: Specific gas constant, J/(kg K).

    Returns:
        Density, outward velocity and pressure at the end.
    """
    z = math.sqrt(gamma * p * d)
    wave = p + z * v
    if shut <= 0.0 or wave >= p0:
        return vessel_state(d, v, p, p0, t0, 0.0, guess, gamma, r_gas)
    left = 1.0 - shut
    low, high = max(wave, 0.02 * p0), p0
    below = _jet(low, wave, z, p0, t0, left, gamma, r_gas)
    above = _jet(high, wave, z, p0, t0, left, gamma, r_gas)
    for _ in range(JET_STEPS):
        if below >= 0.0:  # what went out of the pipe draws in more than the jet brings
            high = low
            break
        pf = high - above * (high - low) / (above - below)
        f = _jet(pf, wave, z, p0, t0, left, gamma, r_gas)
        if f > 0.0:  # regula falsi, its other end drawn in (Illinois)
            high, above, below = pf, f, 0.5 * below
        else:
            low, below, above = pf, min(f, -1e-300), 0.5 * above
        if high - low < JET_FOUND * p0 or abs(f) <= JET_FOUND * p0 / z:
            high = pf
            break
    w = (high - wave) / z
    t = max(t0 - 0.5 * (gamma - 1.0) / (gamma * r_gas) * w * w, 0.5 * t0)
    return high / (r_gas * t), -w, high


@folded
def face_state(e, j, order, cells, ends):
    """Density, outward velocity and pressure of the gas at a pipe end.

    Args:
        e: The end.
        j: The lane.
        order: 1 Godunov, 2 MUSCL-Hancock.
        cells: All slots.
        ends: Ends of pipes.
    """
    S, X = cells.state, cells.work
    i = ends.table[e, L.E_CELL] * cells.lanes + j
    sign = float(ends.table[e, L.E_SIGN])
    if order == 1:
        return S[L.RHO, i], sign * X[L.W_U, i], X[L.W_P, i]
    if sign > 0:
        return X[L.W_RR, i], X[L.W_UR, i], X[L.W_PR, i]
    return X[L.W_RL, i], -X[L.W_UL, i], X[L.W_PL, i]


@folded
def turned(index, e, other):
    """Sign with which a velocity at one end is one at another, by the directions of their pipes.

    Args:
        index: Table of ends.
        e: The end.
        other: The other end.
    """
    return -1.0 if index[other, L.E_SIGN] == index[e, L.E_SIGN] else 1.0


@folded
def _joining(d, v, p, q, h, gamma):
    """Mass flux from a pipe's end into a joint of a given pressure, and its slope.

    Args:
        d: Density in the pipe's end, kg/m^3.
        v: Velocity there, positive out of the pipe, m/s.
        p: Pressure there, Pa.
        q: Pressure of the joint, Pa.
        h: Total enthalpy of what the joint gives, J/kg.
        gamma: Ratio of specific heats.

    Returns:
        Flow, its slope, and the pressure at the end, which is above the joint's where it chokes.
    """
    if shock_swept_out(d, v, p, q, gamma):
        return d * v, 0.0, p
    out, _ = leaving(d, v, p, q, gamma)
    most = choked_velocity(d, v, p, gamma)
    if out >= most:
        _, q, _, m, _ = end_curve(d, v, p, most, h, gamma)
        return m, 0.0, q
    # what enters is at most sonic
    sonic = -math.sqrt(2.0 * (gamma - 1.0) / (gamma + 1.0) * h)
    if out <= sonic:
        k = gamma / (gamma - 1.0) * sonic / (h - 0.5 * sonic * sonic)
        return k * q, -k, q
    _, _, z, m, slope = end_curve(d, v, p, out, h, gamma)
    return m, slope / z, q


@folded
def _carried(d, v, p, q, gamma):
    """Total enthalpy of what leaves a pipe's end on which there is a pressure, J/kg."""
    out, df = leaving(d, v, p, q, gamma)
    return gamma / (gamma - 1.0) * q / df + 0.5 * out * out


@branching
def join(gas, order, cells, ends):
    """Common pressure of every joint of three or more ends, and what each end passes to it.

    Each end's flow follows the joint's static pressure along the exact wave that this sends into
    its pipe; the flows sum to zero. What flows out has the mixed total enthalpy of what flows in.

    Args:
        gas: The gas.
        order: 1 Godunov, 2 MUSCL-Hancock.
        cells: All slots.
        ends: Ends of pipes.
    """
    w, index, joint, gamma = cells.lanes, ends.table, ends.joint, gas.gamma
    for first in range(index.shape[0]):
        if index[first, L.E_KIND] != L.JUNCTION or index[first, L.E_REF] != first:
            continue
        for j in range(w):
            # as waves of little strength have it
            push = give = heat = 0.0
            for e in range(index.shape[0]):
                if index[e, L.E_KIND] == L.JUNCTION and index[e, L.E_REF] == first:
                    d, v, p = face_state(e, j, order, cells, ends)
                    k = cells.par[L.FACE, index[e, L.E_FACE] * w + j] * math.sqrt(d / (gamma * p))
                    push += k * (p + math.sqrt(gamma * p * d) * v)
                    heat += k * gamma / (gamma - 1.0) * p / d
                    give += k
            q, mixed = push / give, heat / give
            for attempt in range(JOINT_STEPS):
                push = give = heat = mass = 0.0
                for e in range(index.shape[0]):
                    if index[e, L.E_KIND] == L.JUNCTION and index[e, L.E_REF] == first:
                        d, v, p = face_state(e, j, order, cells, ends)
                        a = cells.par[L.FACE, index[e, L.E_FACE] * w + j]
                        m, k, joint[e, L.J_PRESSURE, j] = _joining(d, v, p, q, mixed, gamma)
                        joint[e, L.J_FLOW, j] = m
                        joint[e, L.J_SLOPE, j] = k
                        push += a * m
                        give += a * k
                        if m > 0.0:  # its total enthalpy, which the wave has changed
                            mass += a * m
                            heat += a * m * _carried(d, v, p, joint[e, L.J_PRESSURE, j], gamma)
                step = min(max(push / max(give, 1e-300), -0.8 * q), q)
                if abs(step) < JOINT_FOUND * q or attempt == JOINT_STEPS - 1:
                    break
                q += step
                mixed = heat / max(mass, 1e-300) if mass > 0.0 else mixed
            heat = mass = 0.0
            for e in range(index.shape[0]):
                if index[e, L.E_KIND] == L.JUNCTION and index[e, L.E_REF] == first:
                    # what is left of the sum, so that no mass is lost
                    joint[e, L.J_FLOW, j] -= joint[e, L.J_SLOPE, j] * push / max(give, 1e-300)
                    m = joint[e, L.J_FLOW, j]
                    if m > 0.0:
                        d, v, p = face_state(e, j, order, cells, ends)
                        a = cells.par[L.FACE, index[e, L.E_FACE] * w + j]
                        mass += a * m
                        heat += a * m * _carried(d, v, p, joint[e, L.J_PRESSURE, j], gamma)
            joint[first, L.J_MASS, j] = mass
            joint[first, L.J_HEAT, j] = heat


@folded
def _beyond_vessel(e, j, gas, cells, ends, reservoirs, chambers):
    """Density, velocity and pressure that a ghost beyond a tank, chamber or joint takes.

    Extrapolated through the state at the end, so that slopes stay second order.
    """
    S, X, index = cells.state, cells.work, ends.table
    i = index[e, L.E_CELL] * cells.lanes + j
    kind = index[e, L.E_KIND]
    ref = index[e, L.E_REF]
    sign = float(index[e, L.E_SIGN])
    d, v, q = S[L.RHO, i], sign * X[L.W_U, i], X[L.W_P, i]
    guess = sign * ends.velocity[e, 0, j]
    if kind == L.TANK:
        t0 = reservoirs.par[ref, L.R_TEMPERATURE, j]
        loss = reservoirs.par[ref, L.R_LOSS, j]
        p0 = reservoirs.supplied[ref, j]
        d1, v1, q1 = vessel_state(d, v, q, p0, t0, loss, guess, gas.gamma, gas.r)
    elif kind == L.CHAMBER:
        p0 = chambers.work[ref, L.H_PRESSURE, j]
        t0 = chambers.work[ref, L.H_TEMPERATURE, j]
        shut = chambers.work[ref, L.H_SHUT, j]
        d1, v1, q1 = cushioned_state(d, v, q, p0, t0, shut, guess, gas.gamma, gas.r)
    else:
        q1 = ends.joint[e, L.J_PRESSURE, j]
        d1 = d * (1.0 + (q1 - q) / (gas.gamma * q))
        v1 = ends.joint[e, L.J_FLOW, j] / d1
    beyond = max(2.0 * d1 - d, 0.2 * min(d, d1))
    return beyond, sign * (2.0 * v1 - v), max(2.0 * q1 - q, 0.2 * min(q, q1))


@branching
def fill_ghosts(gas, vessels, cells, ends, reservoirs, chambers):
    """Set the ghost beyond every pipe end to what the end sees.

    Without ``vessels``, those beyond tanks, chambers and junctions keep their old state: there the
    flux comes from `cross_ends`, and only slopes and taps in the last half cell look at the ghost.

    Args:
        gas: The gas.
        vessels: Whether those beyond tanks, chambers and joints are set too.
        cells: All slots.
        ends: Ends of pipes.
        reservoirs: Reservoirs.
        chambers: Chambers.
    """
    w, S, X, index, gamma = cells.lanes, cells.state, cells.work, ends.table, gas.gamma
    rho, mom, ene = S[L.RHO], S[L.MOM], S[L.ENE]
    i_gm, i_r = 1.0 / (gamma - 1.0), 1.0 / gas.r
    for e in apart(index.shape[0]):
        kind = index[e, L.E_KIND]
        ref = index[e, L.E_REF]
        vessel = kind == L.TANK or kind == L.CHAMBER or kind == L.JUNCTION
        if vessel and not vessels:
            continue
        if kind == L.RESERVOIR or vessel:
            for j in range(w):
                g = index[e, L.E_GHOST] * w + j
                if vessel:
                    d, v, p = _beyond_vessel(e, j, gas, cells, ends, reservoirs, chambers)
                    k = 1.0 / d
                    t = p * k * i_r
                else:
                    p, v = reservoirs.supplied[ref, j], 0.0
                    t = reservoirs.par[ref, L.R_TEMPERATURE, j]
                    d = p / (gas.r * t)
                    k = 1.0 / d
                rho[g], mom[g], ene[g] = d, d * v, p * i_gm + 0.5 * d * v * v
                X[L.W_U, g], X[L.W_P, g], X[L.W_T, g], X[L.W_RI, g] = v, p, t, k
                X[L.W_C, g] = math.sqrt(gamma * p * k)
            continue
        # the others mirror a cell: their own, or LINK and BRANCH their partner's
        own = kind == L.WALL or kind == L.PORTED
        source = e if own else ref
        turn = -1.0 if own else turned(index, e, ref)
        for j in range(w):
            g = index[e, L.E_GHOST] * w + j
            i = index[source, L.E_CELL] * w + j
            u = X[L.W_U, i]
            if kind == L.PORTED:
                # flow goes on to the ports, and its drag over the last half of the cell with it,
                # as in steady flow without heat (Fanno; Shapiro 1953, table 6.2)
                d, p = rho[i], X[L.W_P, i]
                slow = max(1.0 - d * u * u / (gamma * p), 0.3)
                fall = index[e, L.E_SIGN] * cells.par[L.LENGTH, i] * cells.wall[L.D_DRAG, i]
                fall = min(max(fall / (slow * p), -0.5), 0.5)
                q = p * (1.0 + fall * (1.0 + (gamma - 1.0) * (1.0 - slow)))
                d1 = d * (1.0 + fall)
                v = 2.0 * ends.flow[e, j] / (d * (1.0 + 0.5 * fall)) - u
                rho[g], mom[g], ene[g] = d1, d1 * v, q * i_gm + 0.5 * d1 * v * v
                X[L.W_U, g], X[L.W_P, g], X[L.W_T, g] = v, q, q / (d1 * gas.r)
                X[L.W_C, g], X[L.W_RI, g] = math.sqrt(gamma * q / d1), 1.0 / d1
                continue
            v = turn * u
            rho[g], mom[g], ene[g] = rho[i], rho[i] * v, ene[i] + 0.5 * rho[i] * (v * v - u * u)
            X[L.W_U, g], X[L.W_P, g], X[L.W_T, g] = v, X[L.W_P, i], X[L.W_T, i]
            X[L.W_C, g], X[L.W_RI, g] = X[L.W_C, i], X[L.W_RI, i]


@branching
def mirror_faces(cells, ends):
    """Give ghosts at walls and links the reconstructed face state of what they mirror.

    Args:
        cells: All slots.
        ends: Ends of pipes.
    """
    w, X, index = cells.lanes, cells.work, ends.table
    for e in range(index.shape[0]):
        kind = index[e, L.E_KIND]
        if kind != L.WALL and kind != L.LINK:
            continue
        source = e if kind == L.WALL else index[e, L.E_REF]
        turn = -1.0 if kind == L.WALL else turned(index, e, source)
        for j in range(w):
            i = index[source, L.E_CELL] * w + j
            if index[source, L.E_SIGN] > 0:
                d, v, p, r = X[L.W_RR, i], X[L.W_UR, i], X[L.W_PR, i], X[L.W_IR, i]
            else:
                d, v, p, r = X[L.W_RL, i], X[L.W_UL, i], X[L.W_PL, i], X[L.W_IL, i]
            g = index[e, L.E_GHOST] * w + j
            if index[e, L.E_SIGN] > 0:
                X[L.W_RL, g], X[L.W_UL, g], X[L.W_PL, g], X[L.W_IL, g] = d, turn * v, p, r
            else:
                X[L.W_RR, g], X[L.W_UR, g], X[L.W_PR, g], X[L.W_IR, g] = d, turn * v, p, r


@folded
def _ported_state(e, j, flow, gas, order, cells, ends):
    """Velocity and pressure at a pipe's end through whose ports there is a flow per area.

    Returns:
        Outward velocity, pressure, and flow per area of the pipe itself: a side takes up the rest.
    """
    gamma = gas.gamma
    d, v, p = face_state(e, j, order, cells, ends)
    h0 = gamma / (gamma - 1.0) * p / d
    if flow < 0.0:
        mass = ends.ported[e, L.N_MASS, j]
        h0 = ends.ported[e, L.N_HEAT, j] / mass if ends.ported[e, L.N_HEAT, j] < 0.0 else h0
    held = 0.0
    if ends.give[e, j] != 1.0:
        held = (1.0 / ends.give[e, j] - 1.0) / math.sqrt(gamma * p / d)
    known = ends.ported[e, :, j]
    if known[L.N_SLOPE] > 0.0:
        # what its port was solved with, as good as a first step of the search below
        z, slope = known[L.N_FALL], known[L.N_SLOPE]
        step = flow - known[L.N_FLUX] - held * (p - known[L.N_STATIC])
        step /= max(slope + held * z, 0.01 * d)
        out = known[L.N_SPEED] + step
        alike = out >= 0.0 or abs(known[L.N_ENTHALPY] - h0) < 1e-9 * h0
        if alike and step * step * d < END_FOUND * p:
            return out, known[L.N_STATIC] - z * step, known[L.N_FLUX] + slope * step
    most = choked_velocity(d, v, p, gamma)
    least = -math.sqrt(2.0 * (gamma - 1.0) / (gamma + 1.0) * h0)
    out = min(max(float(ends.table[e, L.E_SIGN]) * ends.velocity[e, 0, j], least), most)
    q, m = p, 0.0
    for _ in range(END_STEPS):
        before = equal_flux_velocity(d, v, p, out, h0, gamma)
        df, q, z, m, slope = end_curve(d, before, p, out, h0, gamma)
        step = (flow - m - held * (p - q)) / max(slope + held * z, 0.01 * d)
        step = min(max(step, least - out), most - out)
        out += step
        if step * step < END_FOUND * q / df:
            q -= z * step
            m += slope * step
            break
    if out <= least and flow < m + held * (p - q):
        # sonic as it enters: the pressure is what brings it through
        more = (flow - held * p) / ((m / q - held) * q)
        q *= more
        m *= more
    return out, q, m


@folded
def _foresee(e, j, velocity, ends):
    """Keep the velocity at an end, and what it will be in the next step if it goes on to change."""
    ends.velocity[e, 0, j] = 2.0 * velocity - ends.velocity[e, 1, j]
    ends.velocity[e, 1, j] = velocity


@folded
def _through_ports(e, j, gas, order, cells, ends, ports):
    """Outward fluxes of mass, momentum and energy where a pipe ends at ports, per area."""
    w, X = cells.lanes, cells.work
    i = ends.table[e, L.E_CELL] * w + j
    face = cells.par[L.FACE, ends.table[e, L.E_FACE] * w + j]
    out = ends.ported[e, L.N_MASS, j]
    push = ends.ported[e, L.N_PUSH, j]
    if push != 0.0:  # through a variable area, see `ports`
        out = 0.0
        for k in range(ports.table.shape[0]):
            if ports.table[k, L.P_A] == L.SIDE_END and ports.table[k, L.P_AI] == e:
                out += ports.flow[k, 0, j]
            if ports.table[k, L.P_B] == L.SIDE_END and ports.table[k, L.P_BI] == e:
                out -= ports.flow[k, 0, j]
        p = X[L.W_P, i] + push / face
        uf = out / (face * cells.state[L.RHO, i])
    else:
        uf, p, m = _ported_state(e, j, out / face, gas, order, cells, ends)
        p += m * uf
    sign = float(ends.table[e, L.E_SIGN])
    _foresee(e, j, sign * uf, ends)
    ends.flow[e, j] = sign * out / face
    i_face = 1.0 / face
    return out * i_face, p, ends.ported[e, L.N_HEAT, j] * i_face


@folded
def _into_vessel(e, j, gas, order, cells, ends, reservoirs, chambers):
    """Outward fluxes of mass, momentum and energy where a pipe opens into a vessel, per area."""
    ref, gamma = ends.table[e, L.E_REF], gas.gamma
    sign = float(ends.table[e, L.E_SIGN])
    guess = sign * ends.velocity[e, 0, j]
    if ends.table[e, L.E_KIND] == L.CHAMBER:
        p0 = chambers.work[ref, L.H_MIDDLE, j]
        t0 = chambers.work[ref, L.H_TEMPERATURE, j]
        shut = chambers.work[ref, L.H_SHUT, j]
        d, v, p = face_state(e, j, order, cells, ends)
        d, v, p = cushioned_state(d, v, p, p0, t0, shut, guess, gamma, gas.r)
    else:
        p0 = reservoirs.supplied[ref, j]
        t0 = reservoirs.par[ref, L.R_TEMPERATURE, j]
        loss = reservoirs.par[ref, L.R_LOSS, j]
        d, v, p = face_state(e, j, order, cells, ends)
        d, v, p = vessel_state(d, v, p, p0, t0, loss, guess, gamma, gas.r)
    _foresee(e, j, sign * v, ends)
    m = d * v
    return m, p + m * v, v * (gamma / (gamma - 1.0) * p + 0.5 * m * v)


@folded
def _into_joint(e, j, gas, order, cells, ends):
    """Outward fluxes of mass, momentum and energy where a pipe meets others, per area."""
    joint, ref, gamma = ends.joint, ends.table[e, L.E_REF], gas.gamma
    m = joint[e, L.J_FLOW, j]
    q = joint[e, L.J_PRESSURE, j]
    if m > 0.0:
        d, v, p = face_state(e, j, order, cells, ends)
        _, df = leaving(d, v, p, q, gamma)
        return m, q + m * m / df, m * _carried(d, v, p, q, gamma)
    h = joint[ref, L.J_HEAT, j] / max(joint[ref, L.J_MASS, j], 1e-300)
    # enthalpy less what is in the velocity m / density, of which it is a quadratic equation
    x = gamma / (gamma - 1.0) * q
    df = 0.0 if m == 0.0 else (x + math.sqrt(x * x + 2.0 * h * m * m)) / (2.0 * h)
    return m, q + (m * m / df if m < 0.0 else 0.0), m * h


@folded
def _pass_on(e, j, dt, cells, ends, reservoirs, chambers):
    """What flows through an end reaches the vessel, the partner's face or the partner's cell."""
    w, S, X, index = cells.lanes, cells.state, cells.work, ends.table
    fm, fp, fe = X[L.W_FM], X[L.W_FP], X[L.W_FE]
    kind = index[e, L.E_KIND]
    ref = index[e, L.E_REF]
    f = index[e, L.E_FACE] * w + j
    sign = float(index[e, L.E_SIGN])
    face = cells.par[L.FACE, f]
    if kind == L.CHAMBER:
        k = dt * face * sign
        chambers.state[ref, 0, j] += k * fm[f]
        chambers.state[ref, 1, j] += k * fe[f]
        chambers.work[ref, L.H_INFLOW, j] += max(face * sign * fm[f], 0.0)
    elif kind == L.RESERVOIR or kind == L.TANK:
        reservoirs.drawn[ref, j] -= sign * fm[f] * face
    elif kind == L.LINK:
        if e > ref:  # the first of the two ends carries the common face
            o = index[ref, L.E_FACE] * w + j
            turn = turned(index, e, ref)
            fm[f] = turn * fm[o]
            fp[f] = fp[o]
            fe[f] = turn * fe[o]
    elif kind == L.BRANCH:
        # Thesis fig. 5.6: mass and energy join the partner's cell; its fictitious wall
        # opposite takes up the push of the branch.
        k = index[ref, L.E_CELL] * w + j
        g = sign * dt * face * cells.par[L.INV_VOLUME, k]
        S[L.RHO, k] += g * fm[f]
        S[L.MOM, k] += g * turned(index, e, ref) * (fp[f] - X[L.W_P, k])
        S[L.ENE, k] += g * fe[f]


@folded
def _find_fluxes(gas, order, cells, ends, ports, reservoirs, chambers):
    """Fluxes of pipe ends that are not simple faces, each from what is known before any is."""
    w, X, index = cells.lanes, cells.work, ends.table
    fm, fp, fe = X[L.W_FM], X[L.W_FP], X[L.W_FE]
    for e in apart(index.shape[0]):
        kind = index[e, L.E_KIND]
        sign = float(index[e, L.E_SIGN])
        for j in range(w):
            f = index[e, L.E_FACE] * w + j
            if kind == L.WALL:
                fm[f] = 0.0
                fe[f] = 0.0
            elif kind == L.PORTED:
                m, push, h = _through_ports(e, j, gas, order, cells, ends, ports)
                fm[f], fp[f], fe[f] = sign * m, push, sign * h
            elif kind == L.CHAMBER or kind == L.TANK:
                m, push, h = _into_vessel(e, j, gas, order, cells, ends, reservoirs, chambers)
                fm[f], fp[f], fe[f] = sign * m, push, sign * h
            elif kind == L.JUNCTION:
                m, push, h = _into_joint(e, j, gas, order, cells, ends)
                fm[f], fp[f], fe[f] = sign * m, push, sign * h


@folded
def _given(r, j, cells, ends):
    """By how much the flow into the lines at a reservoir grows with its pressure, m s."""
    total = 0.0
    for e in range(ends.table.shape[0]):
        kind = ends.table[e, L.E_KIND]
        if (kind == L.RESERVOIR or kind == L.TANK) and ends.table[e, L.E_REF] == r:
            face = cells.par[L.FACE, ends.table[e, L.E_FACE] * cells.lanes + j]
            total += face / cells.work[L.W_C, ends.table[e, L.E_CELL] * cells.lanes + j]
    return total


@folded
def _feed(dt, cells, ends, ports, reservoirs, chambers):
    """What flows through ends and ports reaches what they feed; supplies droop by all of it."""
    par, drawn = reservoirs.par, reservoirs.drawn
    drawn[:] = 0.0
    for e in range(ends.table.shape[0]):
        for j in range(cells.lanes):
            _pass_on(e, j, dt, cells, ends, reservoirs, chambers)
    for k in range(ports.table.shape[0]):
        for side in range(2):
            kind = ports.table[k, L.P_A if side == 0 else L.P_B]
            ref = ports.table[k, L.P_AI if side == 0 else L.P_BI]
            sign = -1.0 if side == 0 else 1.0
            g = sign * dt
            if kind == L.SIDE_CHAMBER:
                for j in range(cells.lanes):
                    chambers.state[ref, 0, j] += g * ports.flow[k, 0, j]
                    chambers.state[ref, 1, j] += g * ports.flow[k, 1, j]
                    chambers.work[ref, L.H_INFLOW, j] += max(sign * ports.flow[k, 0, j], 0.0)
            elif kind == L.SIDE_RESERVOIR:
                for j in range(cells.lanes):
                    drawn[ref, j] -= sign * ports.flow[k, 0, j]
    for r in range(drawn.shape[0]):
        for j in range(cells.lanes):
            a = dt / (dt + par[r, L.R_TAU, j])
            goal = par[r, L.R_PRESSURE, j] - par[r, L.R_DROOP, j] * drawn[r, j]
            if par[r, L.R_DROOP, j] > 0.0:
                # implicit in what lines draw the less as it droops
                a /= 1.0 + a * par[r, L.R_DROOP, j] * _given(r, j, cells, ends)
            reservoirs.pressure[r, j] += a * (goal - reservoirs.pressure[r, j])


@sequence
def cross_ends(gas, order, dt, cells, ends, ports, reservoirs, chambers):
    """Overwrite the fluxes of pipe ends that are not simple faces, and update what they feed.

    Args:
        gas: The gas.
        order: 1 Godunov, 2 MUSCL-Hancock.
        dt: Step, s.
        cells: All slots.
        ends: Ends of pipes.
        ports: Ports.
        reservoirs: Reservoirs.
        chambers: Chambers.
    """
    _find_fluxes(gas, order, cells, ends, ports, reservoirs, chambers)
    _feed(dt, cells, ends, ports, reservoirs, chambers)
