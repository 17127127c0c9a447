# SPDX-License-Identifier: Apache-2.0
"""What the walls of lines do to the gas: friction and heat, steady or with memory."""

import math

from pneu_sim import layout as L
from pneu_sim.compiling import each, inlined, sequence, vectorised

M0, M1, M2, M3, M4, M5 = L.UNSTEADY_WEIGHTS
TURNING = math.sqrt(12.0)
"""Where the Pade quotient of a decay is least, 0.07; beyond, it would rise again."""


@vectorised
def _coefficients(
    gas, mom, re_coef, rough, lam, turb, onset, relax, heat, heat_turb, phi, excess, film
):  # fmt: skip
    """See `find_coefficients`."""
    # wall heat of a Nusselt number of 1, pi k / A, over RELAX: k / mu is cp / Pr
    prandtl = gas.prandtl
    per_relax = gas.gamma * gas.r / ((gas.gamma - 1.0) * prandtl * L.UNSTEADY_RATE)
    gnielinski = 12.7 * (gas.recovery * gas.recovery - 1.0) / math.sqrt(8.0)  # of Pr^(2/3)
    for i in each(mom.size):
        re = abs(mom[i]) * re_coef[i] + 1.0
        x = 6.9 / re + rough[i]
        y = math.sqrt(math.sqrt(math.sqrt(x)))
        z = (y - 0.4) / (y + 0.4)
        z2 = z * z
        ln_y = 2.0 * z * (1.0 + z2 * (1.0 / 3.0 + z2 * (0.2 + z2 * (1.0 / 7.0 + z2 / 9.0))))
        # log10(x) = 8 (ln y) / ln 10, ln y = ln_y + ln 0.4
        # below Re 30 or so, where nothing asks for it, the formula has no meaning: f is 1 at most
        g = max(-1.8 * 8.0 * 0.43429448190325176 * (ln_y - 0.916290731874155), 1.0)
        s = min(max((re * onset[i] - 1.0) / 0.74, 0.0), 1.0)
        blend = s * s * (3.0 - 2.0 * s)
        # f / 8 = 1 / (8 g^2); both quotients by one division
        h = g + gnielinski
        q = 1.0 / (8.0 * g * g * h)
        excess[i] = blend * max(0.125 * re * h * q - 1.0, 0.0)
        phi[i] = lam[i] + turb[i] * excess[i]
        nusselt = (re - 1000.0) * prandtl * g * q
        more = max(nusselt - L.NUSSELT_LAMINAR, 0.0) * per_relax * relax[i]
        film[i] = heat[i] + blend * heat_turb[i] * more


@sequence
def find_coefficients(gas, cells):
    """Steady wall drag over Poiseuille's, phi = f Re / 64, and wall heat, at any Reynolds number.

    Laminar below the onset (Re 2300), Haaland's friction factor and with it Gnielinski's (1976)
    Nusselt number above 1.74 times that (4000), a smooth blend between. Haaland's logarithm is
    ln x = 8 ln x^(1/8), with a Pade form of the inner logarithm: relative error < 1e-4 in the
    friction factor, and nothing but square roots and divisions, which vectorise.

    Args:
        gas: The gas.
        cells: All slots.
    """
    P, D = cells.par, cells.wall
    _coefficients(
        gas, cells.state[L.MOM],
        P[L.REYNOLDS], P[L.ROUGH], P[L.LAMINAR], P[L.TURBULENT], P[L.ONSET], P[L.RELAX],
        P[L.HEAT], P[L.HEAT_TURBULENT], D[L.D_PHI], D[L.D_EXCESS], D[L.D_FILM],
    )  # fmt: skip


@vectorised
def _decay(prandtl, dt, relax, quicken, ri, excess, a_u, a_t, fade):
    """See `find_decay`."""
    i_pr = 1.0 / prandtl
    for i in each(ri.size):
        x = dt * relax[i] * ri[i]
        y = min(x * i_pr, TURNING)
        x = min(x, TURNING)
        even_x, even_y = 12.0 + x * x, 12.0 + y * y
        below_x, below_y = even_x + 6.0 * x, even_y + 6.0 * y
        more = 1.0 + quicken[i] * (110.0 / 28.0) * x * excess[i]
        both = below_x * below_y
        q = 1.0 / (both * more)  # all quotients by one division
        a_u[i] = (even_x - 6.0 * x) * (below_y * more * q)
        a_t[i] = (even_y - 6.0 * y) * (below_x * more * q)
        fade[i] = both * q


@sequence
def find_decay(gas, dt, cells):
    """Decay over one step of the slowest memory states of wall drag and wall heat.

    ``exp(-x)`` as a Pade quotient; each faster state decays by the fourth power of the one before.
    In turbulent flow every memory fades faster (after Vardy and Brown 2003, with their decay tied
    to what turbulence adds to the drag; QUICKEN is the gain on that).

    Args:
        gas: The gas.
        dt: Step, s.
        cells: All slots.
    """
    P, X, D = cells.par, cells.work, cells.wall
    a_u, a_t, fade = D[L.D_AU], D[L.D_AT], D[L.D_FADE]
    _decay(gas.prandtl, dt, P[L.RELAX], P[L.QUICKEN], X[L.W_RI], D[L.D_EXCESS], a_u, a_t, fade)


@vectorised
def _steadily(gas, dt, gas_is, was, wall, drag, warm):
    """See `act_steadily`."""
    rho, mom, ene, ri = gas_is
    u, t_old, il, ir = was
    visc, wall_t, phi, film = wall
    cv = gas.r / (gas.gamma - 1.0)
    recovered = gas.recovery / (2.0 * gas.gamma * cv)
    i_cv = 1.0 / cv
    i_dt = 1.0 / dt
    half = 0.5 * dt
    for i in each(rho.size):
        k = ri[i]
        v0 = mom[i] * k
        t0 = (ene[i] * k - 0.5 * v0 * v0) * i_cv
        x = half * (il[i] + ir[i]) * visc[i] * phi[i]
        h = half * (il[i] + ir[i]) * film[i] * i_cv
        hold = 1.0 + x + 0.5 * x * x
        keep = 1.0 + h + 0.5 * h * h
        q = 1.0 / (hold * keep)
        v = (u[i] + (1.0 + 0.5 * x) * (v0 - u[i])) * (keep * q)
        goal = wall_t[i] - 0.5 * recovered * (u[i] * u[i] + v0 * v0)
        t = (t_old[i] + (1.0 + 0.5 * h) * (t0 - t_old[i]) + (keep - 1.0) * goal) * (hold * q)
        # Friction turns kinetic energy into heat, so it leaves the total alone (thesis 5.1).
        mom[i] = rho[i] * v
        g = rho[i] * cv * (t - t0)
        ene[i] += g
        drag[i] = rho[i] * (v - v0) * i_dt
        warm[i] = g * i_dt


@sequence
def act_steadily(gas, order, dt, cells):
    """Quasi-steady friction and heat, of second order and stable however strong they are.

    What the faces bring in a step comes evenly over it, dv/dt = a - k v; the exponential of its
    solution is taken as 1 / (1 + x + x^2 / 2). A steady flow stays as it is.

    A wall that conducts nothing has the recovery temperature T + r u^2 / (2 cp), r = Pr^(1/3) in
    turbulent flow (White, Viscous Fluid Flow); heat is driven by the difference to that.

    Args:
        gas: The gas.
        order: 1 Godunov, 2 MUSCL-Hancock.
        dt: Step, s.
        cells: All slots.
    """
    P, S, X, D = cells.par, cells.state, cells.work, cells.wall
    # at both sides of the cells in the middle of the step, where that is known
    il, ir = X[L.W_RI if order == 1 else L.W_IL], X[L.W_RI if order == 1 else L.W_IR]
    _steadily(
        gas,
        dt,
        (S[L.RHO], S[L.MOM], S[L.ENE], X[L.W_RI]),
        (X[L.W_U], X[L.W_T], il, ir),
        (P[L.VISCOUS], P[L.WALL_T], D[L.D_PHI], D[L.D_FILM]),
        D[L.D_DRAG],
        D[L.D_WARM],
    )


@inlined
def _fading(a):
    """Decay of the six memory states over a step, and how much of a change each takes up.

    Args:
        a: Decay of the slowest; each next one decays four times faster.
    """
    a2 = a * a
    a4 = a2 * a2
    a8 = a4 * a4
    a16 = a8 * a8
    a32 = a16 * a16
    a64 = a32 * a32
    a128 = a64 * a64
    a256 = a128 * a128
    a512 = a256 * a256
    a1024 = a512 * a512
    b0 = M0 - M0 * a
    b1 = M1 * 0.25 - M1 * 0.25 * a4
    b2 = M2 * 0.0625 - M2 * 0.0625 * a16
    b3 = M3 * 0.015625 - M3 * 0.015625 * a64
    b4 = M4 * 0.00390625 - M4 * 0.00390625 * a256
    b5 = M5 * 0.0009765625 - M5 * 0.0009765625 * a1024
    return a, a4, a16, a64, a256, a1024, b0, b1, b2, b3, b4, b5


@inlined
def _remember(given, hold, tie, before, xi, a, f, x0, x1, x2, x3, x4, x5):
    """One step of recursive convolution (Zielke 1968, Kagawa 1983), implicit in what is sought.

    Steady part and memory are solved together; the memory acts with its mean of before and after.

    Args:
        given: What there would be without memory, times `hold`.
        hold: How hard that is held.
        tie: How hard the memory holds.
        before: What it was at the step's beginning.
        xi: How much of a change is remembered.
        a: Decay of the slowest memory state.
        f: Further decay of all of them.
        x0: Memory states.
        x1: The next.
        x2: The next.
        x3: The next.
        x4: The next.
        x5: The fastest.

    Returns:
        What it is then, and the memory states then.
    """
    a0, a1, a2, a3, a4, a5, b0, b1, b2, b3, b4, b5 = _fading(a)
    z0, z1, z2, z3, z4, z5 = a0 * x0, a1 * x1, a2 * x2, a3 * x3, a4 * x4, a5 * x5
    b = 0.5 * xi * (b0 + b1 + b2 + b3 + b4 + b5)
    s = 0.5 * ((x0 + x1 + x2 + x3 + x4 + x5) + f * (z0 + z1 + z2 + z3 + z4 + z5))
    v = (given - tie * (s - b * before)) / (hold + tie * b)
    d = xi * (v - before)
    return (
        v,
        f * z0 + b0 * d,
        f * z1 + b1 * d,
        f * z2 + b2 * d,
        f * z3 + b3 * d,
        f * z4 + b4 * d,
        f * z5 + b5 * d,
    )


@vectorised
def _drag(dt, gas_is, wall, fading, drag, y):
    """See `drag_with_memory`."""
    rho, mom, ri, u, il, ir = gas_is
    phi, visc, unst = wall
    decay, fade, stay = fading
    y0, y1, y2, y3, y4, y5 = y
    i_dt = 1.0 / dt
    half = 0.5 * dt
    for i in each(rho.size):
        v0 = mom[i] * ri[i]
        x = half * (il[i] + ir[i]) * visc[i] * phi[i]
        g = 1.0 + 0.5 * x
        v, y0[i], y1[i], y2[i], y3[i], y4[i], y5[i] = _remember(
            u[i] + g * (v0 - u[i]),
            1.0 + x * g,
            g * half * (il[i] + ir[i]) * unst[i],
            u[i],
            rho[i] * stay[i] * i_dt,
            decay[i],
            fade[i],
            y0[i],
            y1[i],
            y2[i],
            y3[i],
            y4[i],
            y5[i],
        )
        m = rho[i] * v
        drag[i] = (m - mom[i]) * i_dt
        mom[i] = m


@sequence
def drag_with_memory(order, dt, cells):
    """Wall friction with memory; its steady part as in `act_steadily`.

    Args:
        order: 1 Godunov, 2 MUSCL-Hancock.
        dt: Step, s.
        cells: All slots.
    """
    P, S, X, D = cells.par, cells.state, cells.work, cells.wall
    # at both sides of the cells in the middle of the step, where that is known
    il, ir = X[L.W_RI if order == 1 else L.W_IL], X[L.W_RI if order == 1 else L.W_IR]
    _drag(
        dt,
        (S[L.RHO], S[L.MOM], X[L.W_RI], X[L.W_U], il, ir),
        (D[L.D_PHI], P[L.VISCOUS], P[L.UNSTEADY]),
        (D[L.D_AU], D[L.D_FADE], D[L.D_STAY]),
        D[L.D_DRAG],
        (S[L.Y0], S[L.Y0 + 1], S[L.Y0 + 2], S[L.Y0 + 3], S[L.Y0 + 4], S[L.Y0 + 5]),
    )


@vectorised
def _heat(gas, dt, gas_is, wall, fading, warm, y):
    """See `heat_with_memory`."""
    rho, mom, ene, ri, u, t_old, il, ir = gas_is
    film, unst, wall_t = wall
    decay, fade, stay = fading
    y0, y1, y2, y3, y4, y5 = y
    cv = gas.r / (gas.gamma - 1.0)
    i_cv = 1.0 / cv
    i_dt = 1.0 / dt
    i_rate = gas.prandtl / dt
    per_heat = 0.5 * dt * i_cv
    recovered = gas.recovery / (2.0 * gas.gamma * cv)
    for i in each(rho.size):
        v0 = mom[i] * ri[i]
        t0 = (ene[i] * ri[i] - 0.5 * v0 * v0) * i_cv
        h = per_heat * (il[i] + ir[i])
        x = h * film[i]
        k = 1.0 + 0.5 * x
        goal = wall_t[i] - 0.5 * recovered * (u[i] * u[i] + v0 * v0)
        t, y0[i], y1[i], y2[i], y3[i], y4[i], y5[i] = _remember(
            t_old[i] + k * (t0 - t_old[i] + x * goal),
            1.0 + x * k,
            k * h * unst[i],
            t_old[i],
            rho[i] * stay[i] * i_rate,
            decay[i],
            fade[i],
            y0[i],
            y1[i],
            y2[i],
            y3[i],
            y4[i],
            y5[i],
        )
        g = rho[i] * cv * (t - t0)
        ene[i] += g
        warm[i] = g * i_dt


@sequence
def heat_with_memory(gas, order, dt, cells):
    """Wall heat with memory: the thermal twin of the drag, at the thermal diffusivity.

    Args:
        gas: The gas.
        order: 1 Godunov, 2 MUSCL-Hancock.
        dt: Step, s.
        cells: All slots.
    """
    P, S, X, D = cells.par, cells.state, cells.work, cells.wall
    # at both sides of the cells in the middle of the step, where that is known
    il, ir = X[L.W_RI if order == 1 else L.W_IL], X[L.W_RI if order == 1 else L.W_IR]
    _heat(
        gas,
        dt,
        (S[L.RHO], S[L.MOM], S[L.ENE], X[L.W_RI], X[L.W_U], X[L.W_T], il, ir),
        (D[L.D_FILM], P[L.HEAT_UNSTEADY], P[L.WALL_T]),
        (D[L.D_AT], D[L.D_FADE], D[L.D_STAY]),
        D[L.D_WARM],
        (S[L.Z0], S[L.Z0 + 1], S[L.Z0 + 2], S[L.Z0 + 3], S[L.Z0 + 4], S[L.Z0 + 5]),
    )
