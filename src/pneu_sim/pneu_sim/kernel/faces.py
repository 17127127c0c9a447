# SPDX-License-Identifier: Apache-2.0
"""Faces between cells: limited slopes, states on both sides, and the flux through each."""

import math

from pneu_sim import layout as L
from pneu_sim.compiling import branching, each, folded, inlined, sequence, vectorised
from pneu_sim.kernel.waves import choked_velocity, end_curve, wave_state
from pneu_sim.riemann import exact_flux, hllc

STEP_STEPS, STEP_FOUND = 40, 1e-9
"""Iteration limit of Newton's method for the flow over a step of area, and its tolerance, relative
to the pressure."""
FADE = 50.0
"""Inverse of the heads of a loss from which on the flux of other faces plays no part."""
SECANT = 1e-5
"""Change of the pressure, relative, from which on its secant is no rounding in single precision."""
CHOKED = 1e-7
"""Relative tolerance of the flow with which a fitting chokes."""
LOSS_STEPS = 20
"""Iteration limit of the search for the state behind a fitting."""
EXACT = 6
"""Steps of Newton's method for an exact Riemann problem, whose error falls by squares."""
TINY = 1e-90
"""Keeps sums of differences from zero; even three of them multiply to a number."""


@inlined
def limited(a, b, van_leer):
    """Half a limited slope of a cell, from its differences to both neighbours (thesis 4.6.4).

    Args:
        a: Difference to the neighbour on the left.
        b: Difference to the neighbour on the right.
        van_leer: Whether by van Leer's limiter, else by minmod.
    """
    ab = max(a * b, 0.0)
    smooth = ab / (a + b + TINY)
    least = 0.5 * (a if abs(a) < abs(b) else b) * (1.0 if ab > 0.0 else 0.0)
    return smooth if van_leer else least


@inlined
def _smoothly(a0, b0, a1, b1, a2, b2):
    """Half of van Leer's slopes of three quantities, by one division."""
    s0 = a0 + b0 + TINY
    s1 = a1 + b1 + TINY
    s2 = a2 + b2 + TINY
    s01 = s0 * s1
    y = 1.0 / (s01 * s2)
    k0 = max(a0 * b0, 0.0) * (s1 * s2 * y)
    k1 = max(a1 * b1, 0.0) * (s0 * s2 * y)
    return k0, k1, max(a2 * b2, 0.0) * (s01 * y)


@vectorised
def _slopes(gamma, van_leer, dt, w, held, cell, left, right):
    """See `reconstruct`."""
    rho, mom, ene = held
    length, p, ri, drag, warm = cell
    rl, ul, pl, il = left
    rr, ur, pr, ir = right
    gm = gamma - 1.0
    half = 0.5 * dt
    rho_a, mom_a, ene_a = rho, mom, ene
    rho, mom, ene = rho[w:], mom[w:], ene[w:]
    rho_b, mom_b, ene_b = rho[w:], mom[w:], ene[w:]
    length, p, ri, drag, warm = length[w:], p[w:], ri[w:], drag[w:], warm[w:]
    rl, ul, pl, il = rl[w:], ul[w:], pl[w:], il[w:]
    rr, ur, pr, ir = rr[w:], ur[w:], pr[w:], ir[w:]
    for i in each(rho_b.size):
        d, m, e, i0 = rho[i], mom[i], ene[i], ri[i]
        a0, b0 = d - rho_a[i], rho_b[i] - d
        a1, b1 = m - mom_a[i], mom_b[i] - m
        a2, b2 = e - ene_a[i], ene_b[i] - e
        if van_leer:
            d0, d1, d2 = _smoothly(a0, b0, a1, b1, a2, b2)
        else:
            d0, d1, d2 = limited(a0, b0, False), limited(a1, b1, False), limited(a2, b2, False)
        live = 1.0 if length[i] > 0.0 else 0.0
        d0 *= live
        d1 *= live
        d2 *= live
        r1 = d - d0
        m1 = m - d1
        e1 = e - d2
        r2 = d + d0
        m2 = m + d1
        e2 = e + d2
        y = 1.0 / (r1 * r2)
        u1 = m1 * (r2 * y)
        u2 = m2 * (r1 * y)
        p1 = gm * (e1 - 0.5 * m1 * u1)
        p2 = gm * (e2 - 0.5 * m2 * u2)
        h = half * live / length[i]
        f0 = h * (m1 - m2)
        f1 = h * (m1 * u1 + p1 - m2 * u2 - p2) + half * drag[i]
        f2 = h * (u1 * (e1 + p1) - u2 * (e2 + p2)) + half * warm[i]
        r1 += f0
        r2 += f0
        m1 += f1
        m2 += f1
        y = 1.0 / (r1 * r2)
        i1 = r2 * y
        i2 = r1 * y
        u1 = m1 * i1
        u2 = m2 * i2
        p1 = gm * (e1 + f2 - 0.5 * m1 * u1)
        p2 = gm * (e2 + f2 - 0.5 * m2 * u2)
        q = p[i]
        low = min(min(r1, r2) - 0.05 * d, 0.0) + min(min(p1, p2) - 0.05 * q, 0.0)
        keep = low >= 0.0
        u0 = m * i0
        rl[i] = r1 if keep else d
        ul[i] = u1 if keep else u0
        pl[i] = p1 if keep else q
        il[i] = i1 if keep else i0
        rr[i] = r2 if keep else d
        ur[i] = u2 if keep else u0
        pr[i] = p2 if keep else q
        ir[i] = i2 if keep else i0


@folded
def impose_jump(i, jump, van_leer, dt, cells):
    """Have the flow jump in the middle of a cell, where gas leaves the line there.

    Before and behind that place the gas has two velocities. The jump belongs to no slope: the one
    of the momentum is limited by the differences to the neighbours without it. A slope with a part
    of it would be taken for gas that gathers in the cell, and the pressure there would be off by up
    to rho c times the jump, however short the cell.

    Args:
        i: The cell.
        jump: Half the flow that leaves over the area of the cell, kg/(m^2 s).
        van_leer: Whether slopes are limited by van Leer's limiter, else by minmod.
        dt: Step, s.
        cells: All slots.
    """
    w, X, mom = cells.lanes, cells.work, cells.state[L.MOM]
    a, b = mom[i] - mom[i - w], mom[i + w] - mom[i]
    more = limited(a + jump, b + jump, van_leer) - limited(a, b, van_leer)
    # what half a step of the slope's divergence makes of the cell, gas at rest
    filled = -dt * more / cells.par[L.LENGTH, i]
    pressed = filled * X[L.W_C, i] ** 2
    X[L.W_RL, i] += filled
    X[L.W_RR, i] += filled
    X[L.W_PL, i] += pressed
    X[L.W_PR, i] += pressed
    X[L.W_IL, i] = 1.0 / X[L.W_RL, i]
    X[L.W_IR, i] = 1.0 / X[L.W_RR, i]
    X[L.W_UL, i] += (jump - more) * X[L.W_IL, i]
    X[L.W_UR, i] -= (jump - more) * X[L.W_IR, i]


@sequence
def reconstruct(gas, van_leer, dt, cells):
    """MUSCL-Hancock face states from limited slopes of the conservative variables (thesis 4.6.4).

    The half-step evolution makes the time step second order, to match the reconstruction; it
    includes what the wall did in the last step, which in a long line balances the pressure's slope.
    Where a face state would lose more than 95 % of the cell's density or pressure, the cell falls
    back to its mean, which keeps the scheme positive.

    Args:
        gas: The gas.
        van_leer: Whether by van Leer's limiter, else by minmod.
        dt: Step, s.
        cells: All slots.
    """
    P, S, X, D = cells.par, cells.state, cells.work, cells.wall
    _slopes(
        gas.gamma,
        van_leer,
        dt,
        cells.lanes,
        (S[L.RHO], S[L.MOM], S[L.ENE]),
        (P[L.LENGTH], X[L.W_P], X[L.W_RI], D[L.D_DRAG], D[L.D_WARM]),
        (X[L.W_RL], X[L.W_UL], X[L.W_PL], X[L.W_IL]),
        (X[L.W_RR], X[L.W_UR], X[L.W_PR], X[L.W_IR]),
    )


@vectorised
def _tapering(gamma, dt, growth, u, rl, pl, il, rr, pr, ir):
    """See `taper`."""
    for i in each(u.size):
        x = -0.5 * dt * u[i] * growth[i]
        y = 1.0 + x
        z = 1.0 / y
        q = 1.0 + gamma * x
        rl[i] *= y
        rr[i] *= y
        il[i] *= z
        ir[i] *= z
        pl[i] *= q
        pr[i] *= q


@sequence
def taper(gas, dt, cells):
    """Half a step of what a changing area does to the reconstructed states (thesis eq. 4.1).

    Args:
        gas: The gas.
        dt: Step, s.
        cells: All slots.
    """
    X = cells.work
    rl, pl, il = X[L.W_RL], X[L.W_PL], X[L.W_IL]
    rr, pr, ir = X[L.W_RR], X[L.W_PR], X[L.W_IR]
    _tapering(gas.gamma, dt, cells.par[L.TAPER], X[L.W_U], rl, pl, il, rr, pr, ir)


@branching
def close_outermost(cells):
    """Give the outermost slots, which have one neighbour only, their own state on both sides.

    Args:
        cells: All slots.
    """
    w, rho, X = cells.lanes, cells.state[L.RHO], cells.work
    for j in range(w):
        for i in (j, rho.size - w + j):
            X[L.W_RL, i] = X[L.W_RR, i] = rho[i]
            X[L.W_UL, i] = X[L.W_UR, i] = X[L.W_U, i]
            X[L.W_PL, i] = X[L.W_PR, i] = X[L.W_P, i]
            X[L.W_IL, i] = X[L.W_IR, i] = X[L.W_RI, i]


@branching
def flatten_steps(cells, steps):
    """Take cells beside an area step towards their means: a slope across the step has no meaning.

    The means are those at the middle of the step.

    In proportion to the step, up to one that takes a quarter of the area, so that results change
    smoothly from no step to a small one.

    Args:
        cells: All slots.
        steps: Faces at which the area jumps.
    """
    w, X = cells.lanes, cells.work
    for q in range(steps.table.shape[0]):
        for j in range(w):
            af = cells.par[L.FACE, steps.table[q, 0] * w + j]
            ratio = af / max(steps.area[q, 0, j], steps.area[q, 1, j])
            keep = max(1.0 - 4.0 * (1.0 - ratio), 0.0)
            if keep >= 1.0:
                continue
            for side in (1, 3):
                i = steps.table[q, side] * w + j
                for left, right in ((L.W_RL, L.W_RR), (L.W_UL, L.W_UR), (L.W_PL, L.W_PR)):
                    middle = 0.5 * (X[left, i] + X[right, i])
                    X[left, i] = middle + keep * (X[left, i] - middle)
                    X[right, i] = middle + keep * (X[right, i] - middle)
                X[L.W_IL, i] = 1.0 / X[L.W_RL, i]
                X[L.W_IR, i] = 1.0 / X[L.W_RR, i]


@vectorised
def _hllc_faces(gamma, w, c, rr, ur, pr, ir, rl, ul, pl, il, fm, fp, fe):
    """HLLC flux through every face from the state right in each cell and left in the next."""
    rl, ul, pl, il, cn = rl[w:], ul[w:], pl[w:], il[w:], c[w:]
    for i in each(rl.size):
        fm[i], fp[i], fe[i] = hllc(
            rr[i], ur[i], pr[i], ir[i], rl[i], ul[i], pl[i], il[i], c[i] + cn[i], gamma
        )


@inlined
def _exact_faces(gamma, newton, w, rr, ur, pr, rl, ul, pl, fm, fp, fe):
    """Godunov flux from the exact Riemann solution through every face (thesis 4.6.3)."""
    rl, ul, pl = rl[w:], ul[w:], pl[w:]
    for i in each(rl.size):
        fm[i], fp[i], fe[i] = exact_flux(rr[i], ur[i], pr[i], rl[i], ul[i], pl[i], gamma, newton)


@sequence
def cross(gas, scheme, cells):
    """Flux of mass, momentum and energy through every face, per area.

    Args:
        gas: The gas.
        scheme: How the equations are solved.
        cells: All slots.
    """
    w, X = cells.lanes, cells.work
    u, p, c, ri, rho = X[L.W_U], X[L.W_P], X[L.W_C], X[L.W_RI], cells.state[L.RHO]
    fm, fp, fe = X[L.W_FM], X[L.W_FP], X[L.W_FE]
    if scheme.order == 1:
        rl, ul, pl, il = rr, ur, pr, ir = rho, u, p, ri
    else:
        rl, ul, pl, il = X[L.W_RL], X[L.W_UL], X[L.W_PL], X[L.W_IL]
        rr, ur, pr, ir = X[L.W_RR], X[L.W_UR], X[L.W_PR], X[L.W_IR]
    if scheme.flux == L.HLLC:
        _hllc_faces(gas.gamma, w, c, rr, ur, pr, ir, rl, ul, pl, il, fm, fp, fe)
    else:
        _exact_faces(gas.gamma, scheme.newton, w, rr, ur, pr, rl, ul, pl, fm, fp, fe)


@folded
def at_face(d, u, p, area, face, gamma):
    """State of a cell carried to a smaller face at its edge, in steady flow without loss.

    Args:
        d: Density in the cell, kg/m^3.
        u: Velocity, m/s.
        p: Pressure, Pa.
        area: Area of the cell, m^2.
        face: Area of the face, m^2, at most ``area``.
        gamma: Ratio of specific heats.

    Returns:
        Density, velocity and pressure at the face. Where the flow would choke, the sonic state.
    """
    if face >= area or u == 0.0:
        return d, u, p
    gm = gamma - 1.0
    c2 = gamma * p / d
    g = d * u * area / face
    h = c2 / gm + 0.5 * u * u
    critical = 2.0 * gm * h / (gamma + 1.0)  # square of the sonic speed
    if g * g > 0.3 * d * d * c2:
        d1 = d * (critical / c2) ** (1.0 / gm)
        c1 = math.sqrt(critical)
        if abs(g) >= d1 * c1 * 0.9999:
            return d1, math.copysign(c1, u), d1 * critical / gamma
        floor = d1 / d
    else:
        floor = 0.6
    r = max(1.0 - 0.5 * (g * g / (d * d) - u * u) / c2, floor + 0.02)
    for _ in range(4):
        t = c2 * r**gm
        e = g * g / (d * d * r * r)
        r -= (t / gm + 0.5 * e - h) * r / (t - e)
        r = max(r, floor)
    return d * r, g / (d * r), p * r**gamma


@folded
def _squeezed(d, u, p, ratio, gamma):
    """State of supersonic flow in a smaller area, without loss; sonic where it cannot pass."""
    k = gamma - 1.0
    c2 = gamma * p / d
    h = c2 / k + 0.5 * u * u
    critical = 2.0 * k * h / (gamma + 1.0)
    sonic = (critical / c2) ** (1.0 / k)  # densities over that before it
    g = u * ratio
    if g * g >= critical * sonic * sonic:
        return d * sonic, math.sqrt(critical), d * sonic * critical / gamma
    low, high = 1.0, sonic
    for _ in range(40):  # what flows grows with the density up to the sonic one
        r = 0.5 * (low + high)
        if 2.0 * (h - c2 * r**k / k) * r * r > g * g:
            high = r
        else:
            low = r
    return d * low, g / low, p * low**gamma


@branching
def _widened(density, velocity, pressure, area, wide, h0, gamma):
    """State behind a jet that fills a wider pipe, whose step bears its pressure (Borda, Carnot)."""
    k = gamma / (gamma - 1.0)
    g = density * velocity * area / wide
    push = pressure + g * velocity
    below = k * push + math.sqrt(max(k * k * push * push - 4.0 * (k - 0.5) * g * g * h0, 0.0))
    y = 2.0 * h0 / below
    return 1.0 / y, g * y, push - g * g * y


@folded
def _fanno_loss(d, u, p, heads, resistance, gamma):
    """State behind a fitting without length, of the same area: Fanno flow, whose entropy grows.

    Per unit of the loss the momentum flux falls by ``rho u^2 / 2`` per head and by ``u`` per
    resistance, with the velocity there (Shapiro 1953, chapter 6; integrated in closed form).

    Args:
        d: Density before it, kg/m^3.
        u: Velocity, not negative, m/s.
        p: Pressure, Pa.
        heads: Velocity heads lost.
        resistance: Pressure lost per velocity besides, Pa s/m.
        gamma: Ratio of specific heats.

    Returns:
        Density, velocity and pressure behind it, and whether the gas passes: what would be faster
        than sound behind it does not.
    """
    s = d * u * u / p
    lost = heads * s + 2.0 * resistance * u / p
    k = (gamma - 1.0) / gamma
    whole, bend = 1.0 + 0.5 * k * s, (1.0 - 0.5 * k) * s
    if lost <= 0.0:
        return d, u, p, True
    if whole <= bend or whole - bend + bend * math.log(bend / whole) <= lost:
        return d, u, p, False
    x = 1.0 - lost / (whole - bend)  # density behind, squared, over that before
    for _ in range(LOSS_STEPS):
        x = max(x, bend / whole * (1.0 + 1e-9))
        step = (whole * (1.0 - x) + bend * math.log(x) - lost) / (whole - bend / x)
        x += step
        if abs(step) < 1e-12:
            break
    x = max(x, bend / whole)
    r = math.sqrt(x)
    return d * r, u / r, p * r * (1.0 + 0.5 * k * s * (1.0 - 1.0 / x)), True


@branching
def _passed(d1, v1, p1, a1, d2, v2, p2, a2, face, heads, resistance, gamma):
    """Flow between two cells over a step of area and a fitting: a Riemann problem with both.

    A wave runs into each cell; between them the flow is steady over the step: it contracts to the
    face without loss, at most until it is sonic there, fills what lies behind as a jet does, and
    loses what the fitting takes.

    Args:
        d1: Density in the cell it comes from, kg/m^3.
        v1: Velocity there, towards the step, m/s.
        p1: Pressure there, Pa, at which gas at rest would flow.
        a1: Area there, m^2.
        d2: Density in the other cell.
        v2: Velocity there, likewise towards the step.
        p2: Pressure there.
        a2: Area there.
        face: Area of the face, at most these.
        heads: Heads of the velocity in the other cell that are lost.
        resistance: Pressure lost per velocity there, Pa s/m.
        gamma: Ratio of specific heats.

    Returns:
        Mass flow, total enthalpy, momentum flux per area before the step, at the face, behind it.
    """
    k = gamma / (gamma - 1.0)
    most = choked_velocity(d1, v1, p1, gamma)
    _, q1, z1 = wave_state(d1, v1, p1, 0.0, gamma)
    _, q2, z2 = wave_state(d2, v2, p2, 0.0, gamma)
    wide = a1 / a2
    half, drive = z1 + (z2 + resistance) * wide, q1 - q2
    u = 2.0 * drive / (half + math.sqrt(half * half + 2.0 * heads * d1 * wide * wide * drive))
    u = min(u, most)
    m = h0 = push = thrust = behind = 0.0
    low, high = 0.0, most
    choked = False  # behind the fitting
    u_before, left_before = u, 0.0
    for _ in range(STEP_STEPS):
        df, q1, z1, flux, slope = end_curve(d1, v1, p1, u, 0.0, gamma)
        h0 = k * q1 / df + 0.5 * u * u
        dn, un, pn = at_face(df, u, q1, a1, face, gamma)
        m = face * dn * un
        over = a1 * flux / max(m, 1e-300)
        dw, uw, pw = _widened(dn, un, pn, face, a2, h0, gamma)
        dw, uw, pw, fine = _fanno_loss(dw, uw, pw, heads, resistance, gamma)
        if not fine and over <= 1.0 + 1e-6:
            choked, high = True, u
            u = 0.5 * (low + high)
            continue
        _, q2, z2 = wave_state(d2, v2, p2, -uw, gamma)
        push, thrust, behind = q1 + flux * u, pn + dn * un * un, pw + dw * uw * uw
        left = pw - q2
        if over > 1.0 + 1e-6:  # more comes than the face passes when sonic
            high = u
            u /= over
            continue
        stuck = choked and high - low <= CHOKED * high
        if left >= 0.0 and (over > 1.0 + 1e-9 or u >= most or stuck):
            # Sonic at the face, before or behind it: what lies behind takes what is passed, and is
            # sonic at most.
            g = m / a2
            sonic = math.sqrt(2.0 * (gamma - 1.0) / (gamma + 1.0) * h0)
            uw = min(g * h0 / (k * q2), sonic)
            for _ in range(STEP_STEPS):
                dw, q2, z2, flux, slope = end_curve(d2, v2, p2, -uw, h0, gamma)
                step = min((g + flux) / max(slope, 0.01 * dw), sonic - uw)
                uw += step
                if abs(step) < 1e-6 * uw:
                    break
            behind = q2 + dw * uw * uw
            if uw >= sonic and g > -flux:
                behind *= -g / flux
            break
        if left > 0.0:
            low = u
        else:
            high = u
        resists = z2 + heads * dw * uw + resistance
        falls = z1 + resists * a1 * max(slope, 0.05 * df) / (a2 * dw)
        if left_before != 0.0 and abs(u - u_before) * z1 > SECANT * q1:
            # a secant, which knows what that slope leaves out
            secant = (left_before - left) / (u - u_before)
            falls = secant if secant > 0.3 * falls else falls
        u_before, left_before = u, left
        step = left / falls
        was = u
        u += step
        if u > high:
            u = most if high >= most else 0.5 * (low + high)
        elif u < low:
            u = 0.5 * (low + high)
        if abs(u - was) * z1 <= STEP_FOUND * q1:
            break
    if heads + resistance == 0.0 and v1 * v1 * d1 > gamma * p1 and m > d1 * v1 * a1:
        # A shock that brings more than comes would run with the flow: it is swept through, and the
        # flow contracts at a supersonic speed.
        dn, un, pn = _squeezed(d1, v1, p1, a1 / face, gamma)
        m, h0, push = d1 * v1 * a1, k * p1 / d1 + 0.5 * v1 * v1, p1 + d1 * v1 * v1
        # around the jet, the wall of the step bears the pressure of the gas that is there
        thrust = pn + dn * un * un
        behind = p2 + face / a2 * (thrust - p2)
    return m, h0, push, thrust, behind


@branching
def cross_steps(gas, scheme, dt, cells, steps):
    """Fluxes through faces where the area jumps or a fitting is, and the force on its wall.

    What flows is that of `_passed`, by which steady flow across the step stays steady. The momentum
    that this takes is what the step's wall reacts with, in place of the cell's pressure.

    Args:
        gas: The gas.
        scheme: How the equations are solved.
        dt: Step, s.
        cells: All slots.
        steps: Those faces.
    """
    w, P, S, X, gamma = cells.lanes, cells.par, cells.state, cells.work, gas.gamma
    for q in range(steps.table.shape[0]):
        for j in range(w):
            i = steps.table[q, 0] * w + j
            k = i + w
            af = P[L.FACE, i]
            al = steps.area[q, 0, j]
            ar = steps.area[q, 1, j]
            heads, resistance = P[L.LOSS, i], P[L.RESISTANCE, i]
            if al == af and ar == af and heads + resistance <= 0.0:
                continue
            if steps.table[q, 1] == steps.table[q, 3]:  # the only cell of its pipe
                drag = 0.5 * heads * al * al * abs(X[L.W_U, i]) + resistance * al / S[L.RHO, i]
                S[L.MOM, i] /= 1.0 + dt * drag / P[L.LENGTH, i]
                continue
            if scheme.order == 1:
                dl, ul, pl = S[L.RHO, i], X[L.W_U, i], X[L.W_P, i]
                dr, ur, pr = S[L.RHO, k], X[L.W_U, k], X[L.W_P, k]
            else:
                dl, ul, pl = X[L.W_RR, i], X[L.W_UR, i], X[L.W_PR, i]
                dr, ur, pr = X[L.W_RL, k], X[L.W_UL, k], X[L.W_PL, k]
            _, held_l, _ = wave_state(dl, ul, pl, 0.0, gamma)
            _, held_r, _ = wave_state(dr, -ur, pr, 0.0, gamma)
            if held_l >= held_r:
                m, h0, gl, fp, gr = _passed(
                    dl, ul, pl, al, dr, -ur, pr, ar, af, heads * ar * ar, resistance * ar, gamma
                )
            else:
                m, h0, gr, fp, gl = _passed(
                    dr, -ur, pr, ar, dl, ul, pl, al, af, heads * al * al, resistance * al, gamma
                )
                m = -m
            fm, fe = m / af, m * h0 / af
            keep = max(1.0 - 4.0 * (1.0 - af / max(al, ar)), 0.0)
            lost = heads * af * af + resistance * af / math.sqrt(gamma * pl * dl)
            keep *= max(1.0 - FADE * lost, 0.0)
            if keep > 0.0:
                # a small step, or loss, changes the flux of other faces a little
                em, ep, ee = exact_flux(dl, ul, pl, dr, ur, pr, gamma, EXACT)
                fm += keep * (X[L.W_FM, i] - em)
                fe += keep * (X[L.W_FE, i] - ee)
                more = keep * (X[L.W_FP, i] - ep)
                fp, gl, gr = fp + more, gl + more, gr + more
            X[L.W_FM, i], X[L.W_FP, i], X[L.W_FE, i] = fm, fp, fe
            c = steps.table[q, 1] * w + j
            p = X[L.W_P, c] if scheme.order == 1 else 0.5 * (X[L.W_PL, c] + X[L.W_PR, c])
            g = dt * P[L.INV_VOLUME, c] * (af * fp - al * gl - p * (af - al))
            S[L.MOM, c] += steps.table[q, 2] * g
            c = steps.table[q, 3] * w + j
            p = X[L.W_P, c] if scheme.order == 1 else 0.5 * (X[L.W_PL, c] + X[L.W_PR, c])
            g = dt * P[L.INV_VOLUME, c] * (af * fp - ar * gr - p * (af - ar))
            S[L.MOM, c] -= steps.table[q, 4] * g
