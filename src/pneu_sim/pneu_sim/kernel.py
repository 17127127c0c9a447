# SPDX-License-Identifier: Apache-2.0
"""The gas kernel: quasi-one-dimensional Euler equations on a network, many rigs at once.

Finite volumes in conservative variables (thesis ch. 4 and 5). One step is a handful of passes over
flat arrays (see ``layout``): primitive state, reconstruction, fluxes, ends and ports, update with
the wall terms. Each pass is a plain loop without Python objects, so that the same source can be
compiled for other targets. Everything a step needs is passed in; nothing is kept between calls but
the arrays.
"""

import math

import numpy as np

from pneu_sim import layout as L
from pneu_sim.compiling import njit
from pneu_sim.riemann import exact_flux, hllc_flux

# No reassociation: sums keep their order, so that results do not depend on the batch size.
FAST = {"contract", "nsz", "nnan", "ninf", "arcp"}
M0, M1, M2, M3, M4, M5 = L.UNSTEADY_WEIGHTS
ANR_DENSITY = 1.185  # kg/m^3, ISO 6358 reference state
ANR_TEMPERATURE = 293.15  # K
WALL_EVERY = 4


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _primitive(n, gamma, r_gas, mom, ene, ri, u, p, c, t):
    """Velocity, pressure, speed of sound and temperature of every slot (thesis table 4.1).

    ``ri`` is the inverse density.
    """
    gm = gamma - 1.0
    i_r = 1.0 / r_gas
    for i in range(n):
        d = ri[i]
        v = mom[i] * d
        q = gm * (ene[i] - 0.5 * mom[i] * v)
        u[i] = v
        p[i] = q
        c[i] = math.sqrt(gamma * q * d)
        t[i] = q * d * i_r


@njit(cache=True, nogil=True, error_model="numpy")
def _take_gas(n, gamma, rho, mom, ene, kappa, rest, stretch, d_rho, d_mom, d_ene):
    """Turn what a yielding pipe holds per nominal volume into the state of its gas.

    The wall widens the area by ``s = 1 + kappa (p - rest)`` and stores elastic energy, so that the
    pipe holds ``E = s (p / (g - 1) + rho u^2 / 2) + kappa (p^2 - rest^2) / 2`` per nominal volume.
    What is taken away is kept, for `_give_back`.
    """
    gm = gamma - 1.0
    for i in range(n):
        k = kappa[i]
        if k <= 0.0:
            stretch[i] = 1.0
            d_rho[i] = d_mom[i] = d_ene[i] = 0.0
            continue
        pa = rest[i]
        v = mom[i] / rho[i]
        e = gm * (ene[i] - 0.5 * mom[i] * v + 0.5 * k * pa * pa)
        b = 1.0 - k * pa
        q = 2.0 * e / (b + math.sqrt(b * b + 2.0 * k * (gamma + 1.0) * e))
        s = 1.0 + k * (q - pa)
        d = rho[i] / s
        g = q / gm + 0.5 * d * v * v
        stretch[i] = s
        d_rho[i] = rho[i] - d
        d_mom[i] = mom[i] - d * v
        d_ene[i] = ene[i] - g
        rho[i] = d
        mom[i] = d * v
        ene[i] = g


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _give_back(n, rho, mom, ene, d_rho, d_mom, d_ene):
    """Undo `_take_gas`; what happened to the gas meanwhile happens to the pipe."""
    for i in range(n):
        rho[i] += d_rho[i]
        mom[i] += d_mom[i]
        ene[i] += d_ene[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _widen_faces(n, w, face, length, stretch, out):
    """Areas of the faces of yielding pipes; a pipe's end is held by its fitting."""
    for i in range(n - w):
        inside = length[i] > 0.0 and length[i + w] > 0.0
        out[i] = face[i] * (0.5 * (stretch[i] + stretch[i + w]) if inside else 1.0)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _reconstruct(
    n,
    w,
    gamma,
    dt,
    van_leer,
    rho,
    mom,
    ene,
    length,
    p,
    drag,
    warm,
    rl,
    ul,
    pl,
    il,
    rr,
    ur,
    pr,
    ir,
):
    """MUSCL-Hancock face states from limited slopes of the conservative variables (thesis 4.6.4).

    The half-step evolution makes the time step second order, to match the reconstruction; it
    includes what the wall did in the last step, which in a long line balances the pressure's slope.
    Where a face state would lose more than 95 % of the cell's density or pressure, the cell falls
    back to its mean, which keeps the scheme positive.
    """
    gm = gamma - 1.0
    half = 0.5 * dt
    rho_a, mom_a, ene_a = rho, mom, ene
    rho_b, mom_b, ene_b = rho[2 * w :], mom[2 * w :], ene[2 * w :]
    rho, mom, ene, length, p = rho[w:], mom[w:], ene[w:], length[w:], p[w:]
    drag, warm = drag[w:], warm[w:]
    rl, ul, pl, il, rr, ur, pr, ir = (
        rl[w:],
        ul[w:],
        pl[w:],
        il[w:],
        rr[w:],
        ur[w:],
        pr[w:],
        ir[w:],
    )
    for i in range(n - 2 * w):
        live = 1.0 if length[i] > 0.0 else 0.0
        a = rho[i] - rho_a[i]
        b = rho_b[i] - rho[i]
        ab = max(a * b, 0.0)
        vl = ab / (a + b + 1e-300)
        mm = 0.5 * (a if abs(a) < abs(b) else b) * (1.0 if ab > 0.0 else 0.0)
        d0 = live * (vl if van_leer else mm)
        a = mom[i] - mom_a[i]
        b = mom_b[i] - mom[i]
        ab = max(a * b, 0.0)
        vl = ab / (a + b + 1e-300)
        mm = 0.5 * (a if abs(a) < abs(b) else b) * (1.0 if ab > 0.0 else 0.0)
        d1 = live * (vl if van_leer else mm)
        a = ene[i] - ene_a[i]
        b = ene_b[i] - ene[i]
        ab = max(a * b, 0.0)
        vl = ab / (a + b + 1e-300)
        mm = 0.5 * (a if abs(a) < abs(b) else b) * (1.0 if ab > 0.0 else 0.0)
        d2 = live * (vl if van_leer else mm)
        r1 = rho[i] - d0
        m1 = mom[i] - d1
        e1 = ene[i] - d2
        r2 = rho[i] + d0
        m2 = mom[i] + d1
        e2 = ene[i] + d2
        u1 = m1 / r1
        u2 = m2 / r2
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
        i1 = 1.0 / r1
        i2 = 1.0 / r2
        u1 = m1 * i1
        u2 = m2 * i2
        p1 = gm * (e1 + f2 - 0.5 * m1 * u1)
        p2 = gm * (e2 + f2 - 0.5 * m2 * u2)
        low = min(min(r1, r2) - 0.05 * rho[i], 0.0) + min(min(p1, p2) - 0.05 * p[i], 0.0)
        keep = low >= 0.0
        i0 = 1.0 / rho[i]
        u0 = mom[i] * i0
        rl[i] = r1 if keep else rho[i]
        ul[i] = u1 if keep else u0
        pl[i] = p1 if keep else p[i]
        il[i] = i1 if keep else i0
        rr[i] = r2 if keep else rho[i]
        ur[i] = u2 if keep else u0
        pr[i] = p2 if keep else p[i]
        ir[i] = i2 if keep else i0


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _hllc(n, w, gamma, c, rr, ur, pr, ir, rl, ul, pl, il, fm, fp, fe):
    """HLLC flux through every face; pressure-based wave speeds (Toro 2009, sec. 10.5.2).

    Same scheme as `riemann.hllc_flux`, arranged for few divisions: inverse densities come with the
    states, the star pressure estimate takes the cells' speeds of sound, and the star flux is
    F + S (U* - U) over one common denominator.
    """
    gm = 1.0 / (gamma - 1.0)
    k = (gamma + 1.0) / (2.0 * gamma)
    # Shifted views instead of an index i + w: what keeps the loop free of gathers.
    rl, ul, pl, il, cn = rl[w:], ul[w:], pl[w:], il[w:], c[w:]
    for i in range(n - w):
        d1 = rr[i]
        v1 = ur[i]
        q1 = pr[i]
        d2 = rl[i]
        v2 = ul[i]
        q2 = pl[i]
        q = 0.5 * (q1 + q2) - 0.125 * (v2 - v1) * (d1 + d2) * (c[i] + cn[i])
        s1 = v1 - math.sqrt(gamma * ir[i] * (q1 + k * max(q - q1, 0.0)))
        s2 = v2 + math.sqrt(gamma * il[i] * (q2 + k * max(q - q2, 0.0)))
        a1 = d1 * (s1 - v1)
        a2 = d2 * (s2 - v2)
        # Speed of the contact s = x / a, with a < 0; for one at rest every product below vanishes
        # exactly. It shares one division with the weight g of the star flux.
        x = (q2 - q1) + (a1 * v1 - a2 * v2)
        a = a1 - a2
        left = x <= 0.0
        sk = s1 if left else s2
        sb = min(s1, 0.0) if left else max(s2, 0.0)
        b = sk * a - x
        y = 1.0 / (a * b)
        s = x * b * y
        g = sb * a * a * y  # = sb / (sk - s): zero where the flow through the face is supersonic
        d = d1 if left else d2
        v = v1 if left else v2
        q = q1 if left else q2
        a = a1 if left else a2
        e = q * gm + 0.5 * d * v * v
        dv = s - v
        m = d * v
        x = q + a * dv
        fm[i] = m + g * d * dv
        fp[i] = m * v + q + g * (dv * m + x - q)
        fe[i] = v * (e + q) + g * (dv * e + x * s - q * v)


@njit(cache=True, nogil=True, error_model="numpy")
def _exact(n, w, gamma, newton, rr, ur, pr, rl, ul, pl, fm, fp, fe):
    """Godunov flux from the exact Riemann solution through every face (thesis 4.6.3)."""
    for i in range(n - w):
        j = i + w
        fm[i], fp[i], fe[i] = exact_flux(rr[i], ur[i], pr[i], rl[j], ul[j], pl[j], gamma, newton)


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _conserve(n, w, dt, rho, mom, ene, face, inv, p, fm, fp, fe, ri):
    """Add what the faces carry, and the wall reaction of a changing area (thesis eq. 4.1-4.8)."""
    rho, mom, ene, inv, p, ri = rho[w:], mom[w:], ene[w:], inv[w:], p[w:], ri[w:]
    right, gm, gp, ge = face[w:], fm[w:], fp[w:], fe[w:]
    for i in range(n - w):
        k = dt * inv[i]
        a = face[i]
        b = right[i]
        d = rho[i] + k * (a * fm[i] - b * gm[i])
        rho[i] = d
        ri[i] = 1.0 / d
        mom[i] += k * (a * fp[i] - b * gp[i] + p[i] * (b - a))
        ene[i] += k * (a * fe[i] - b * ge[i])


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _wall_coefficients(
    n, prandtl, per_relax, mom, re_coef, rough, turb, onset, relax, heat, heat_turb, phi, film
):
    """Steady wall drag relative to laminar, phi = f Re / 64, and wall heat, at any Reynolds number.

    Laminar below the onset (Re 2300), Haaland's friction factor and with it Gnielinski's (1976)
    Nusselt number above 1.74 times that (4000), a smooth blend between; ``onset`` is the inverse of
    that Reynolds number, ``per_relax`` times ``relax`` the wall heat per Nusselt number, ``film``
    the wall heat in W/(m^3 K). Haaland's logarithm is ln x = 8 ln x^(1/8), with a Pade form of the
    inner logarithm: relative error < 1e-4 in the friction factor, and nothing but square roots and
    divisions, which vectorise.
    """
    gnielinski = 12.7 * (prandtl ** (2.0 / 3.0) - 1.0) / math.sqrt(8.0)
    for i in range(n):
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
        phi[i] = 1.0 + blend * turb[i] * max(re / (64.0 * g * g) - 1.0, 0.0)
        # f / 8 = 1 / (8 g^2)
        nusselt = (re - 1000.0) * prandtl / (8.0 * g * (g + gnielinski))
        more = max(nusselt - L.NUSSELT_LAMINAR, 0.0) * per_relax * relax[i]
        film[i] = heat[i] + blend * heat_turb[i] * more


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _steady_wall(n, gamma, r_gas, dt, rho, mom, ene, phi, film, visc, loss, wall_t, drag, warm):
    """Quasi-steady friction and heat, implicit in the end-of-step velocity and temperature."""
    cv = r_gas / (gamma - 1.0)
    i_dt = 1.0 / dt
    for i in range(n):
        ri = 1.0 / rho[i]
        v0 = mom[i] * ri
        v = v0 / (1.0 + dt * (visc[i] * phi[i] * ri + 0.5 * loss[i] * abs(v0)))
        t0 = (ene[i] * ri - 0.5 * v0 * v0) / cv
        h = dt * film[i] * ri / cv
        t = (t0 + h * wall_t[i]) / (1.0 + h)
        # Friction turns kinetic energy into heat, so it leaves the total alone (thesis 5.1).
        mom[i] = rho[i] * v
        g = rho[i] * cv * (t - t0)
        ene[i] += g
        drag[i] = rho[i] * (v - v0) * i_dt
        warm[i] = g * i_dt


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _inverse(n, x, y):
    """Take the reciprocal, y = 1 / x."""
    for i in range(n):
        y[i] = 1.0 / x[i]


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _decay(n, dt, prandtl, rho, relax, quicken, phi, a_u, a_t, fade):
    """Decay over one step of the slowest memory states of wall drag and wall heat.

    ``exp(-x)`` as a Pade quotient; each faster state decays by the fourth power of the one before.
    In turbulent flow every memory fades faster, by ``fade`` (after Vardy and Brown 2003, with their
    decay tied to the drag ratio; ``quicken`` is the gain on that).
    """
    i_pr = 1.0 / prandtl
    for i in range(n):
        x = dt * relax[i] / rho[i]
        y = x * i_pr
        a_u[i] = (12.0 - 6.0 * x + x * x) / (12.0 + 6.0 * x + x * x)
        a_t[i] = (12.0 - 6.0 * y + y * y) / (12.0 + 6.0 * y + y * y)
        fade[i] = 1.0 / (1.0 + quicken[i] * (110.0 / 28.0) * x * (phi[i] - 1.0))


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _unsteady_drag(
    n, dt, rho, mom, ri, u, phi, a1, fade, stay, visc, loss, unst, drag, y0, y1, y2, y3, y4, y5
):
    """Wall friction with memory by recursive convolution (Zielke 1968, Kagawa 1983).

    Steady part and memory are solved together, implicitly in the new velocity; the memory acts with
    its mean of before and after. ``stay`` is the inverse of the slowest decay rate times density;
    ``ri`` the inverse density.
    """
    i_dt = 1.0 / dt
    half = 0.5 * dt
    for i in range(n):
        r = ri[i]
        v0 = mom[i] * r
        xi = rho[i] * stay[i] * i_dt
        f = fade[i]
        a = a1[i]
        b0 = M0 - M0 * a
        x0 = y0[i]
        z0 = a * x0
        a *= a
        a *= a
        b1 = M1 * 0.25 - M1 * 0.25 * a
        x1 = y1[i]
        z1 = a * x1
        a *= a
        a *= a
        b2 = M2 * 0.0625 - M2 * 0.0625 * a
        x2 = y2[i]
        z2 = a * x2
        a *= a
        a *= a
        b3 = M3 * 0.015625 - M3 * 0.015625 * a
        x3 = y3[i]
        z3 = a * x3
        a *= a
        a *= a
        b4 = M4 * 0.00390625 - M4 * 0.00390625 * a
        x4 = y4[i]
        z4 = a * x4
        a *= a
        a *= a
        b5 = M5 * 0.0009765625 - M5 * 0.0009765625 * a
        x5 = y5[i]
        z5 = a * x5
        h = dt * r
        c = h * unst[i]
        b = 0.5 * xi * (b0 + b1 + b2 + b3 + b4 + b5)
        s = 0.5 * ((x0 + x1 + x2 + x3 + x4 + x5) + f * (z0 + z1 + z2 + z3 + z4 + z5))
        v = (v0 - c * (s - b * u[i])) / (
            1.0 + h * visc[i] * phi[i] + half * loss[i] * abs(v0) + c * b
        )
        d = xi * (v - u[i])
        y0[i] = f * z0 + b0 * d
        y1[i] = f * z1 + b1 * d
        y2[i] = f * z2 + b2 * d
        y3[i] = f * z3 + b3 * d
        y4[i] = f * z4 + b4 * d
        y5[i] = f * z5 + b5 * d
        m = rho[i] * v
        drag[i] = (m - mom[i]) * i_dt
        mom[i] = m


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _unsteady_heat(
    n,
    gamma,
    r_gas,
    prandtl,
    dt,
    rho,
    mom,
    ene,
    ri,
    t_old,
    film,
    a1,
    fade,
    stay,
    unst,
    wall_t,
    warm,
    y0,
    y1,
    y2,
    y3,
    y4,
    y5,
):
    """Wall heat with memory: the thermal twin of the unsteady drag, at the thermal diffusivity."""
    cv = r_gas / (gamma - 1.0)
    i_cv = 1.0 / cv
    i_dt = 1.0 / dt
    i_rate = prandtl / dt
    per_heat = dt * i_cv
    for i in range(n):
        r = ri[i]
        v0 = mom[i] * r
        t0 = (ene[i] * r - 0.5 * v0 * v0) * i_cv
        xi = rho[i] * stay[i] * i_rate
        f = fade[i]
        a = a1[i]
        b0 = M0 - M0 * a
        x0 = y0[i]
        z0 = a * x0
        a *= a
        a *= a
        b1 = M1 * 0.25 - M1 * 0.25 * a
        x1 = y1[i]
        z1 = a * x1
        a *= a
        a *= a
        b2 = M2 * 0.0625 - M2 * 0.0625 * a
        x2 = y2[i]
        z2 = a * x2
        a *= a
        a *= a
        b3 = M3 * 0.015625 - M3 * 0.015625 * a
        x3 = y3[i]
        z3 = a * x3
        a *= a
        a *= a
        b4 = M4 * 0.00390625 - M4 * 0.00390625 * a
        x4 = y4[i]
        z4 = a * x4
        a *= a
        a *= a
        b5 = M5 * 0.0009765625 - M5 * 0.0009765625 * a
        x5 = y5[i]
        z5 = a * x5
        h = per_heat * r
        c = h * unst[i]
        q = h * film[i]
        b = 0.5 * xi * (b0 + b1 + b2 + b3 + b4 + b5)
        s = 0.5 * ((x0 + x1 + x2 + x3 + x4 + x5) + f * (z0 + z1 + z2 + z3 + z4 + z5))
        t = (t0 + q * wall_t[i] - c * (s - b * t_old[i])) / (1.0 + q + c * b)
        d = xi * (t - t_old[i])
        y0[i] = f * z0 + b0 * d
        y1[i] = f * z1 + b1 * d
        y2[i] = f * z2 + b2 * d
        y3[i] = f * z3 + b3 * d
        y4[i] = f * z4 + b4 * d
        y5[i] = f * z5 + b5 * d
        g = rho[i] * cv * (t - t0)
        ene[i] += g
        warm[i] = g * i_dt


@njit(cache=True, nogil=True, error_model="numpy")
def chamber_pressure(energy, volume, compliance, rest_p, gamma):
    """Pressure of a chamber of internal energy ``energy``; volume = volume + compliance (p - rest).

    Args:
        energy: Internal energy of its gas and of its yielding wall, J.
        volume: Volume at the pressure `rest_p`, m3.
        compliance: Growth of the volume per pascal, m3/Pa.
        rest_p: Pressure at which the wall is at rest, Pa.
        gamma: Ratio of specific heats.
    """
    e = (gamma - 1.0) * (energy + 0.5 * compliance * rest_p * rest_p)
    b = volume - compliance * rest_p
    return 2.0 * e / (b + math.sqrt(b * b + 2.0 * compliance * (gamma + 1.0) * e))


@njit(cache=True, nogil=True, error_model="numpy")
def iso6358_flow(p_a, z_a, t_a, p_b, z_b, t_b, conductance, ratio, laminar=1.0):
    """Mass flow a to b through an ISO 6358 port between two lines, in closed form.

    The pressures at the port follow the flow along the characteristics that reach it,
    p1 = p_a - z_a m and p2 = p_b + z_b m with z = c / A (zero for a chamber or reservoir), so the
    flow is implicit and needs no laminar patch where the pressures meet.

    Args:
        p_a: Pressure of side a with no flow, Pa.
        z_a: Impedance c / A of side a, 1/(m s).
        t_a: Temperature of side a, K.
        p_b: Pressure of side b with no flow, Pa.
        z_b: Impedance of side b, 1/(m s).
        t_b: Temperature of side b, K.
        conductance: Sonic conductance C times opening, m^3/(s Pa).
        ratio: Critical pressure ratio b.
        laminar: Pressure ratio above which the flow is linear in the pressure drop; 1 is never.

    Returns:
        Mass flow in kg/s, positive from a to b.
    """
    if conductance <= 0.0:
        return 0.0
    sign = 1.0
    if p_b > p_a:
        p_a, p_b = p_b, p_a
        z_a, z_b = z_b, z_a
        t_a = t_b
        sign = -1.0
    k = conductance * ANR_DENSITY * math.sqrt(ANR_TEMPERATURE / t_a)
    if laminar < 1.0:
        g = (laminar - ratio) / (1.0 - ratio)
        slope = k * math.sqrt(1.0 - g * g) / (1.0 - laminar)
        m = slope * (p_a - p_b) / (1.0 + slope * (z_a + z_b))
        if p_b + z_b * m > laminar * (p_a - z_a * m):
            return sign * m
    m = k * p_a / (1.0 + k * z_a)
    if p_b + z_b * m > ratio * (p_a - z_a * m):
        d = p_a - p_b
        z = z_a + z_b
        e = (1.0 - 2.0 * ratio) * p_a + p_b
        g = (1.0 - 2.0 * ratio) * z_a - z_b
        a2 = (1.0 - ratio) ** 2 / (k * k) - z * g
        b1 = z * e + d * g
        disc = b1 * b1 + 4.0 * a2 * d * e
        m = 2.0 * d * e / (b1 + math.sqrt(max(disc, 0.0)) + 1e-300)
    return sign * m


@njit(cache=True, nogil=True, error_model="numpy")
def orifice_flow(p_a, t_a, p_b, area, gamma, r_gas):
    """Isentropic orifice (thesis eq. 3.15-3.17): mass flow in kg/s from a to b, p_a >= p_b.

    Args:
        p_a: Upstream pressure, Pa.
        t_a: Upstream temperature, K.
        p_b: Downstream pressure, Pa.
        area: Effective area, m2.
        gamma: Ratio of specific heats.
        r_gas: Specific gas constant, J/(kg K).
    """
    x = max(p_b / p_a, (2.0 / (gamma + 1.0)) ** (gamma / (gamma - 1.0)))
    s = x ** (2.0 / gamma) - x ** ((gamma + 1.0) / gamma)
    return (
        area * p_a / math.sqrt(r_gas * t_a) * math.sqrt(max(2.0 * gamma / (gamma - 1.0) * s, 0.0))
    )


@njit(cache=True, nogil=True, error_model="numpy")
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


@njit(cache=True, nogil=True, error_model="numpy")
def _leaks(w, gamma, r_gas, dt, leak_index, leak_par, ambient, P, S, X, ch_p, ch_t, ch_state):
    """Take from lines and chambers what leaks to the room, or add what enters from there."""
    cp = gamma * (r_gas / (gamma - 1.0))
    for q in range(leak_index.shape[0]):
        slot = leak_index[q, L.K_SLOT]
        kind = leak_index[q, L.K_KIND]
        for j in range(w):
            size = leak_par[q, L.LEAK_SIZE, j]
            if size <= 0.0:
                continue
            opens = leak_par[q, L.LEAK_SET, j]
            span = leak_par[q, L.LEAK_RANGE, j]
            pa = ambient[0, j]
            ta = ambient[1, j]
            if slot < 0:
                c = -1 - slot
                p = ch_p[c, j]
                t = ch_t[c, j]
                m = leak_flow(kind, size, opens, span, p, t, pa, ta, gamma, r_gas)
                h = m * cp * (t if p >= pa else ta)
                ch_state[c, 0, j] -= dt * m
                ch_state[c, 1, j] -= dt * h
            else:
                i = slot * w + j
                p = X[L.W_P, i]
                t = X[L.W_T, i]
                m = leak_flow(kind, size, opens, span, p, t, pa, ta, gamma, r_gas)
                if p >= pa:
                    v = X[L.W_U, i]
                    h = m * (cp * t + 0.5 * v**2)
                else:
                    v = 0.0
                    h = m * cp * ta
                g = dt * P[L.INV_VOLUME, i]
                S[L.RHO, i] -= g * m
                S[L.MOM, i] -= g * m * v
                S[L.ENE, i] -= g * h


@njit(cache=True, nogil=True, error_model="numpy")
def vessel_state(d, v, p, p0, t0, loss, gamma, r_gas):
    """State at a pipe end that opens into a large vessel.

    Outflow leaves at the vessel's pressure, or sonic; inflow comes from rest at the vessel's
    pressure and temperature, less ``loss`` velocity heads. Either way the wave that arrives from
    the pipe fixes the rest (linearised characteristic p + rho c v).

    Args:
        d: Density in the pipe's end, kg/m^3.
        v: Velocity there, positive out of the pipe, m/s.
        p: Pressure there, Pa.
        p0: Pressure of the vessel, Pa.
        t0: Temperature of the vessel, K.
        loss: Velocity heads lost on inflow.
        gamma: Ratio of specific heats.
        r_gas: Specific gas constant, J/(kg K).

    Returns:
        Density, outward velocity and pressure at the end.
    """
    z = math.sqrt(gamma * p * d)
    wave = p + z * v
    if wave >= p0:
        out = (wave - p0) / z
        pf = p0
        df = d * math.exp(math.log(pf / p) / gamma)
        if out * out * df > gamma * pf:
            # sonic at the face: along the isentrope of the end cell
            c = z / d
            g = (gamma - 1.0) / (gamma + 1.0)
            cf = 2.0 / (gamma + 1.0) * c + g * v
            out = cf
            pf = p * (cf / c) ** (2.0 * gamma / (gamma - 1.0))
            df = gamma * pf / (cf * cf)
        return df, out, pf
    c0sq = gamma * r_gas * t0
    k = 0.5 * (gamma - 1.0) * (1.0 + loss) / c0sq
    e = gamma / (gamma - 1.0)
    w_max = math.sqrt(2.0 / (gamma + 1.0) * c0sq / (1.0 + loss))
    # Bernoulli's law to first order in the velocity head, then Newton's method.
    drive = p0 - wave
    w = min(2.0 * drive / (z + math.sqrt(z * z + 4.0 * e * k * p0 * drive)), w_max)
    for _ in range(4):
        x = max(1.0 - k * w * w, 0.05)
        y = math.exp(e * math.log(x))
        f = p0 * y - wave - z * w
        df_dw = -p0 * e * y / x * 2.0 * k * w - z
        step = f / df_dw
        w = min(max(w - step, 0.0), w_max)
        if abs(step) < 1e-6 * w:  # the next one would be of the order of rounding
            break
    pf = wave + z * w if w < w_max else p0 * math.exp(e * math.log(1.0 - k * w * w))
    tf = t0 - 0.5 * (gamma - 1.0) / (gamma * r_gas) * w * w
    return pf / (r_gas * tf), -w, pf


@njit(cache=True, nogil=True, error_model="numpy")
def at_face(d, u, p, area, face, into, gamma):
    """State of a cell carried to a smaller face at its edge, in steady flow.

    Towards the face the flow contracts without loss. From the face into the cell it spreads as a
    jet does (Borda and Carnot): the wall of the step bears the jet's pressure.

    Args:
        d: Density in the cell, kg/m^3.
        u: Velocity, m/s.
        p: Pressure, Pa.
        area: Area of the cell, m^2.
        face: Area of the face, m^2, at most ``area``.
        into: Whether the flow comes from the face.
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
    if into:
        k = gamma / gm
        share = face / area
        b = k * (p + d * u * u)
        disc = b * b - 4.0 * h * g * g * (k * share - 0.5)
        d1 = (b + math.sqrt(max(disc, 0.0))) / (2.0 * h)
        p1 = p + d * u * u - share * g * g / d1
        return d1, g / d1, max(p1, 0.05 * p)
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


@njit(cache=True, nogil=True, error_model="numpy")
def _face_state(e, w, j, order, ends, S, X):
    """Density, outward velocity and pressure of the gas at a pipe end."""
    i = ends[e, L.E_CELL] * w + j
    sign = float(ends[e, L.E_SIGN])
    if order == 1:
        return S[L.RHO, i], sign * X[L.W_U, i], X[L.W_P, i]
    if sign > 0:
        return X[L.W_RR, i], X[L.W_UR, i], X[L.W_PR, i]
    return X[L.W_RL, i], -X[L.W_UL, i], X[L.W_PL, i]


@njit(cache=True, nogil=True, error_model="numpy")
def _joints(w, gamma, order, ends, P, S, X, joint):
    """Common pressure of every joint of three or more ends, and what each end passes to it.

    The outgoing characteristic of each end gives its mass flow against the common static pressure;
    the flows sum to zero. What flows out has the mixed total enthalpy of what flows in.
    ``joint[e]`` holds, for the first end of a joint, sums (0, 1, 4, 5); for each end its outward
    mass flow per area (2) and the joint's pressure (3).
    """
    h = gamma / (gamma - 1.0)
    for e in range(ends.shape[0]):
        for j in range(w):
            joint[e, 0, j] = joint[e, 1, j] = joint[e, 4, j] = joint[e, 5, j] = 0.0
    for e in range(ends.shape[0]):
        if ends[e, L.E_KIND] == L.JUNCTION:
            ref = ends[e, L.E_REF]
            for j in range(w):
                d, v, p = _face_state(e, w, j, order, ends, S, X)
                a = P[L.FACE, ends[e, L.E_FACE] * w + j]
                k = a / math.sqrt(gamma * p / d)
                joint[ref, 0, j] += a * d * v + k * p
                joint[ref, 1, j] += k
    for e in range(ends.shape[0]):
        if ends[e, L.E_KIND] == L.JUNCTION:
            ref = ends[e, L.E_REF]
            for j in range(w):
                d, v, p = _face_state(e, w, j, order, ends, S, X)
                q = joint[ref, 0, j] / joint[ref, 1, j]
                m = d * v + (p - q) / math.sqrt(gamma * p / d)
                joint[e, 2, j] = m
                joint[e, 3, j] = q
                if m > 0.0:
                    a = P[L.FACE, ends[e, L.E_FACE] * w + j]
                    joint[ref, 4, j] += a * m
                    joint[ref, 5, j] += a * m * (h * p / d + 0.5 * v * v)


@njit(cache=True, nogil=True, error_model="numpy")
def _flatten_steps(w, step_index, step_area, P, S, X):
    """Take cells beside an area step towards their means: a slope across the step has no meaning.

    In proportion to the step, up to one that takes a quarter of the area, so that results change
    smoothly from no step to a small one.
    """
    for q in range(step_index.shape[0]):
        for j in range(w):
            af = P[L.FACE, step_index[q, 0] * w + j]
            ratio = af / max(step_area[q, 0, j], step_area[q, 1, j])
            keep = max(1.0 - 4.0 * (1.0 - ratio), 0.0)
            if keep >= 1.0:
                continue
            for side in (1, 3):
                i = step_index[q, side] * w + j
                d, v, p = S[L.RHO, i], X[L.W_U, i], X[L.W_P, i]
                X[L.W_RL, i] = d + keep * (X[L.W_RL, i] - d)
                X[L.W_UL, i] = v + keep * (X[L.W_UL, i] - v)
                X[L.W_PL, i] = p + keep * (X[L.W_PL, i] - p)
                X[L.W_IL, i] = 1.0 / X[L.W_RL, i]
                X[L.W_RR, i] = d + keep * (X[L.W_RR, i] - d)
                X[L.W_UR, i] = v + keep * (X[L.W_UR, i] - v)
                X[L.W_PR, i] = p + keep * (X[L.W_PR, i] - p)
                X[L.W_IR, i] = 1.0 / X[L.W_RR, i]


@njit(cache=True, nogil=True, error_model="numpy")
def _step_faces(w, gamma, dt, order, flux, newton, step_index, step_area, P, S, X):
    """Fluxes through faces where the area jumps, and the force on the wall of the jump.

    Both cells' states are carried to the face by steady flow before they meet, so that steady flow
    across the step stays steady (well balanced, after Kroner and Thanh 2005). The momentum this
    takes is what the step's wall reacts with, in place of the cell's pressure.
    """
    for q in range(step_index.shape[0]):
        for j in range(w):
            i = step_index[q, 0] * w + j
            k = i + w
            af = P[L.FACE, i]
            al = step_area[q, 0, j]
            ar = step_area[q, 1, j]
            if al == af and ar == af:
                continue
            if order == 1:
                dl, ul, pl = S[L.RHO, i], X[L.W_U, i], X[L.W_P, i]
                dr, ur, pr = S[L.RHO, k], X[L.W_U, k], X[L.W_P, k]
            else:
                dl, ul, pl = X[L.W_RR, i], X[L.W_UR, i], X[L.W_PR, i]
                dr, ur, pr = X[L.W_RL, k], X[L.W_UL, k], X[L.W_PL, k]
            d1, v1, p1 = at_face(dl, ul, pl, al, af, ul < 0.0, gamma)
            d2, v2, p2 = at_face(dr, ur, pr, ar, af, ur > 0.0, gamma)
            if flux == L.HLLC:
                fm, fp, fe = hllc_flux(d1, v1, p1, d2, v2, p2, gamma)
            else:
                fm, fp, fe = exact_flux(d1, v1, p1, d2, v2, p2, gamma, newton)
            X[L.W_FM, i], X[L.W_FP, i], X[L.W_FE, i] = fm, fp, fe
            gl = af * (p1 + d1 * v1 * v1) - al * (pl + dl * ul * ul)
            gr = af * (p2 + d2 * v2 * v2) - ar * (pr + dr * ur * ur)
            m = step_index[q, 1] * w + j
            g = dt * P[L.INV_VOLUME, m] * (gl - X[L.W_P, m] * (af - al))
            S[L.MOM, m] += step_index[q, 2] * g
            m = step_index[q, 3] * w + j
            g = dt * P[L.INV_VOLUME, m] * (gr - X[L.W_P, m] * (af - ar))
            S[L.MOM, m] -= step_index[q, 4] * g


@njit(cache=True, nogil=True, fastmath=FAST, error_model="numpy")
def _taper(n, gamma, dt, taper, u, rl, pl, il, rr, pr, ir):
    """Half a step of what a changing area does to the reconstructed states (thesis eq. 4.1)."""
    for i in range(n):
        x = -0.5 * dt * u[i] * taper[i]
        y = 1.0 + x
        z = 1.0 / y
        q = 1.0 + gamma * x
        rl[i] *= y
        rr[i] *= y
        il[i] *= z
        ir[i] *= z
        pl[i] *= q
        pr[i] *= q


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_ghosts(w, gamma, r_gas, vessels, ends, end_u, joint, S, X, res_par, res_p, ch_p, ch_t):
    """Set the ghost beyond every pipe end to what the end sees.

    Without ``vessels``, those beyond tanks, chambers and junctions keep their old state: there the
    flux comes from `_ends`, and only slopes and taps in the last half cell look at the ghost.
    """
    rho, mom, ene = S[L.RHO], S[L.MOM], S[L.ENE]
    for e in range(ends.shape[0]):
        cell = ends[e, L.E_CELL] * w
        ghost = ends[e, L.E_GHOST] * w
        kind = ends[e, L.E_KIND]
        ref = ends[e, L.E_REF]
        if not vessels and (kind == L.TANK or kind == L.CHAMBER or kind == L.JUNCTION):
            continue
        for j in range(w):
            i = cell + j
            g = ghost + j
            if kind == L.WALL:
                rho[g] = rho[i]
                mom[g] = -mom[i]
                ene[g] = ene[i]
            elif kind == L.PORTED:
                v = 2.0 * end_u[e, j] - X[L.W_U, i]
                rho[g] = rho[i]
                mom[g] = rho[i] * v
                ene[g] = ene[i] + 0.5 * rho[i] * (v * v - X[L.W_U, i] ** 2)
            elif kind == L.RESERVOIR:
                rho[g] = res_p[ref, j] / (r_gas * res_par[ref, L.R_TEMPERATURE, j])
                mom[g] = 0.0
                ene[g] = res_p[ref, j] / (gamma - 1.0)
            elif kind == L.TANK or kind == L.CHAMBER or kind == L.JUNCTION:
                # Extrapolated through the state at the end, so that slopes stay second order.
                sign = float(ends[e, L.E_SIGN])
                d, v, q = rho[i], sign * X[L.W_U, i], X[L.W_P, i]
                if kind == L.TANK:
                    t0 = res_par[ref, L.R_TEMPERATURE, j]
                    loss = res_par[ref, L.R_LOSS, j]
                    d1, v1, q1 = vessel_state(d, v, q, res_p[ref, j], t0, loss, gamma, r_gas)
                elif kind == L.CHAMBER:
                    d1, v1, q1 = vessel_state(
                        d, v, q, ch_p[ref, j], ch_t[ref, j], 0.0, gamma, r_gas
                    )
                else:
                    q1 = joint[e, 3, j]
                    d1 = d * (1.0 + (q1 - q) / (gamma * q))
                    v1 = joint[e, 2, j] / d1
                rho[g] = max(2.0 * d1 - d, 0.2 * min(d, d1))
                v = 2.0 * v1 - v
                q = max(2.0 * q1 - q, 0.2 * min(q, q1))
                mom[g] = sign * rho[g] * v
                ene[g] = q / (gamma - 1.0) + 0.5 * rho[g] * v * v
            else:  # LINK and BRANCH see the partner's cell, turned to this pipe's direction
                k = ends[ref, L.E_CELL] * w + j
                turn = -1.0 if ends[ref, L.E_SIGN] == ends[e, L.E_SIGN] else 1.0
                rho[g] = rho[k]
                mom[g] = turn * mom[k]
                ene[g] = ene[k]
            m = rho[g]
            X[L.W_U, g] = mom[g] / m
            X[L.W_P, g] = (gamma - 1.0) * (ene[g] - 0.5 * mom[g] ** 2 / m)
            X[L.W_C, g] = math.sqrt(gamma * X[L.W_P, g] / m)
            X[L.W_T, g] = X[L.W_P, g] / (m * r_gas)
            X[L.W_RI, g] = 1.0 / m


@njit(cache=True, nogil=True, error_model="numpy")
def _ghost_faces(w, ends, X):
    """Give ghosts at walls and links the reconstructed face state of what they mirror."""
    for e in range(ends.shape[0]):
        kind = ends[e, L.E_KIND]
        if kind != L.WALL and kind != L.LINK:
            continue
        source = e if kind == L.WALL else ends[e, L.E_REF]
        turn = -1.0 if kind == L.WALL or ends[source, L.E_SIGN] == ends[e, L.E_SIGN] else 1.0
        for j in range(w):
            i = ends[source, L.E_CELL] * w + j
            if ends[source, L.E_SIGN] > 0:
                d, v, p, r = X[L.W_RR, i], X[L.W_UR, i], X[L.W_PR, i], X[L.W_IR, i]
            else:
                d, v, p, r = X[L.W_RL, i], X[L.W_UL, i], X[L.W_PL, i], X[L.W_IL, i]
            g = ends[e, L.E_GHOST] * w + j
            if ends[e, L.E_SIGN] > 0:
                X[L.W_RL, g], X[L.W_UL, g], X[L.W_PL, g], X[L.W_IL, g] = d, turn * v, p, r
            else:
                X[L.W_RR, g], X[L.W_UR, g], X[L.W_PR, g], X[L.W_IR, g] = d, turn * v, p, r


@njit(cache=True, nogil=True, error_model="numpy")
def _side(kind, index, w, j, gamma, order, ends, port_net, P, S, X, res_par, res_p, ch_p, ch_t):
    """What a port sees on one side: pressure at no flow, impedance, temperature, total enthalpy."""
    if kind == L.SIDE_END:
        i = ends[index, L.E_CELL] * w + j
        d, v, p = _face_state(index, w, j, order, ends, S, X)
        c = math.sqrt(gamma * p / d)
        z = c / P[L.FACE, ends[index, L.E_FACE] * w + j]
        q = p + d * c * v - z * port_net[index, j]
        return max(q, 0.05 * p), z, X[L.W_T, i]
    if kind == L.SIDE_CHAMBER:
        return ch_p[index, j], 0.0, ch_t[index, j]
    return res_p[index, j], 0.0, res_par[index, L.R_TEMPERATURE, j]


@njit(cache=True, nogil=True, error_model="numpy")
def _riemann_port(w, j, gamma, ends, ea, eb, area, S, X):
    """Flux through a valve opened between two pipe ends as a smaller common face (thesis 5.4)."""
    ia = ends[ea, L.E_CELL] * w + j
    ib = ends[eb, L.E_CELL] * w + j
    sa = float(ends[ea, L.E_SIGN])
    sb = -float(ends[eb, L.E_SIGN])
    fm, fp, fe = hllc_flux(
        S[L.RHO, ia],
        sa * X[L.W_U, ia],
        X[L.W_P, ia],
        S[L.RHO, ib],
        sb * X[L.W_U, ib],
        X[L.W_P, ib],
        gamma,
    )
    return area * fm, fp, area * fe


@njit(cache=True, nogil=True, error_model="numpy")
def _head(w, j, end, flow, heads, ends, P, S, X):
    """Velocity heads at a pipe end: twice their pressure per flow, 1/(m s), and the Mach number.

    Stagnation pressure (one head) has its first compressible term; the momentum flux (two heads)
    is exact without.
    """
    i = ends[end, L.E_CELL] * w + j
    area = P[L.AREA, i]
    x = abs(flow) / (S[L.RHO, i] * area * area)
    mach = min(x * area / X[L.W_C, i], 0.95)
    return heads * x * (1.0 + 0.25 * mach * mach * min(max(2.0 - heads, 0.0), 1.0)), mach


@njit(cache=True, nogil=True, error_model="numpy")
def _most_out(w, j, end, flow, gamma, order, ends, P, S, X):
    """Most that can leave a pipe end, kg/s, its gas sonic there; infinite if ``flow`` is far below.

    A port that would take more is wider than the pipe: the pipe's own end chokes, along the
    isentrope and the characteristic that arrive there (as in `vessel_state`).
    """
    d, v, p = _face_state(end, w, j, order, ends, S, X)
    c = math.sqrt(gamma * p / d)
    face = P[L.FACE, ends[end, L.E_FACE] * w + j]
    if flow < 0.4 * d * c * face:
        return math.inf
    cf = min(max(2.0 / (gamma + 1.0) * c + (gamma - 1.0) / (gamma + 1.0) * v, 0.1 * c), c + abs(v))
    return face * cf * d * math.exp(2.0 / (gamma - 1.0) * math.log(cf / c))


@njit(cache=True, nogil=True, error_model="numpy")
def _ports(
    w,
    gamma,
    r_gas,
    order,
    ends,
    ports,
    port_par,
    opening,
    port_m,
    port_net,
    port_h,
    port_push,
    P,
    S,
    X,
    res_par,
    res_p,
    ch_p,
    ch_t,
):
    """Flow of every port at this step; sums per pipe end what leaves through ports."""
    cp = gamma * r_gas / (gamma - 1.0)
    for e in range(ends.shape[0]):
        for j in range(w):
            port_net[e, j] = 0.0
            port_h[e, j] = 0.0
            port_push[e, j] = 0.0
    # Flows of the last step stand in for ports not yet solved at this one (Gauss-Seidel).
    for k in range(ports.shape[0]):
        for j in range(w):
            if ports[k, L.P_MODE] == L.ISO6358:
                if ports[k, L.P_A] == L.SIDE_END:
                    port_net[ports[k, L.P_AI], j] += port_m[k, 0, j]
                if ports[k, L.P_B] == L.SIDE_END:
                    port_net[ports[k, L.P_BI], j] -= port_m[k, 0, j]
    for k in range(ports.shape[0]):
        ka = ports[k, L.P_A]
        ia = ports[k, L.P_AI]
        kb = ports[k, L.P_B]
        ib = ports[k, L.P_BI]
        for j in range(w):
            if ports[k, L.P_MODE] == L.EFFECTIVE_AREA:
                area = opening[k, j] * port_par[k, L.Q_AREA, j]
                m, push, h = _riemann_port(w, j, gamma, ends, ia, ib, area, S, X)
                na = ends[ia, L.E_CELL] * w + j
                nb = ends[ib, L.E_CELL] * w + j
                port_push[ia, j] += area * (push - X[L.W_P, na])
                port_push[ib, j] += area * (push - X[L.W_P, nb])
                port_m[k, 0, j] = m
                port_m[k, 1, j] = h
                port_h[ia, j] += h
                port_h[ib, j] -= h
                continue
            if ka == L.SIDE_END:
                port_net[ia, j] -= port_m[k, 0, j]
            if kb == L.SIDE_END:
                port_net[ib, j] += port_m[k, 0, j]
            pa, za, ta = _side(
                ka, ia, w, j, gamma, order, ends, port_net, P, S, X, res_par, res_p, ch_p, ch_t
            )
            pb, zb, tb = _side(
                kb, ib, w, j, gamma, order, ends, port_net, P, S, X, res_par, res_p, ch_p, ch_t
            )
            # The stagnation pressure of the line it leaves (ISO 6358) drives the port, against
            # the static pressure of the line it enters plus the velocity heads its jet does
            # not recover; both heads are linearised about the last step's flow.
            m_old = port_m[k, 0, j]
            if m_old > 0.0:
                if ka == L.SIDE_END:
                    h = port_par[k, L.Q_HEAD, j]
                    x, mach = _head(w, j, ia, m_old, h, ends, P, S, X)
                    # rarefied gas has less head: at h = 2 the slope is (1 - M)^2, never negative
                    lean = za * max(1.0 - h * mach * (1.0 - 0.5 * mach), 0.02)
                    pa += (lean - za + 0.5 * x) * m_old
                    za = lean
                if kb == L.SIDE_END:
                    x, mach = _head(w, j, ib, m_old, port_par[k, L.Q_JET, j], ends, P, S, X)
                    zb += x
                    pb -= 0.5 * x * m_old
            elif m_old < 0.0:
                if kb == L.SIDE_END:
                    h = port_par[k, L.Q_HEAD, j]
                    x, mach = _head(w, j, ib, m_old, h, ends, P, S, X)
                    lean = zb * max(1.0 - h * mach * (1.0 - 0.5 * mach), 0.02)
                    pb -= (lean - zb + 0.5 * x) * m_old
                    zb = lean
                if ka == L.SIDE_END:
                    x, mach = _head(w, j, ia, m_old, port_par[k, L.Q_JET, j], ends, P, S, X)
                    za += x
                    pa += 0.5 * x * m_old
            c = opening[k, j] * port_par[k, L.Q_CONDUCTANCE, j]
            ratio = port_par[k, L.Q_RATIO, j]
            width = 1.0 - port_par[k, L.Q_LAMINAR, j]
            if port_par[k, L.Q_WIDENING, j] != 0.0:
                width *= min(opening[k, j], 1.0) ** port_par[k, L.Q_WIDENING, j]
            m = iso6358_flow(
                pa,
                za,
                ta,
                pb,
                zb,
                tb,
                c,
                ratio,
                1.0 - width,
            )
            if m > 0.0 and ka == L.SIDE_END:
                most = _most_out(w, j, ia, m, gamma, order, ends, P, S, X)
                m = min(m, max(most - port_net[ia, j], 0.0))
            elif m < 0.0 and kb == L.SIDE_END:
                most = _most_out(w, j, ib, -m, gamma, order, ends, P, S, X)
                m = max(m, min(port_net[ib, j] - most, 0.0))
            up_kind, up_index, up_t = (ka, ia, ta) if m >= 0.0 else (kb, ib, tb)
            h0 = cp * up_t
            if up_kind == L.SIDE_END:
                v = X[L.W_U, ends[up_index, L.E_CELL] * w + j]
                h0 += 0.5 * v * v
            port_m[k, 0, j] = m
            port_m[k, 1, j] = m * h0
            if ka == L.SIDE_END:
                port_net[ia, j] += m
                port_h[ia, j] += m * h0
            if kb == L.SIDE_END:
                port_net[ib, j] -= m
                port_h[ib, j] -= m * h0


@njit(cache=True, nogil=True, error_model="numpy")
def _chamber_middle(w, gamma, dt, order, ends, P, S, X, ch_par, ch_p, ch_half, weight):
    """Pressure of every chamber at the middle of the step, implicit in what its pipes bring.

    With the pressure at the step's beginning instead, a chamber would feed an oscillation.
    """
    n_ch = ch_p.shape[0]
    for c in range(n_ch):
        for j in range(w):
            ch_half[c, j] = ch_p[c, j]
            weight[c, j] = 1.0
    for e in range(ends.shape[0]):
        if ends[e, L.E_KIND] == L.CHAMBER:
            c = ends[e, L.E_REF]
            for j in range(w):
                d, v, p = _face_state(e, w, j, order, ends, S, X)
                z = math.sqrt(gamma * p * d)
                com = ch_par[c, L.C_COMPLIANCE, j]
                q = ch_p[c, j]
                vol = ch_par[c, L.C_VOLUME, j] + com * (
                    (gamma + 1.0) * q - ch_par[c, L.C_REST_P, j]
                )
                a = P[L.FACE, ends[e, L.E_FACE] * w + j]
                k = 0.5 * dt * gamma * q * a / (z * vol)
                ch_half[c, j] += k * (p + z * v)
                weight[c, j] += k
    for c in range(n_ch):
        for j in range(w):
            ch_half[c, j] = max(ch_half[c, j] / weight[c, j], 0.05 * ch_p[c, j])


@njit(cache=True, nogil=True, error_model="numpy")
def _ends(
    w,
    gamma,
    dt,
    order,
    ends,
    ports,
    port_m,
    port_net,
    port_h,
    port_push,
    end_u,
    joint,
    P,
    S,
    X,
    ch_state,
    ch_half,
    ch_t,
    res_par,
    res_p,
    supplied,
    r_gas,
):
    """Overwrite the fluxes of pipe ends that are not simple faces, and update what they feed."""
    fm, fp, fe = X[L.W_FM], X[L.W_FP], X[L.W_FE]
    face = P[L.FACE]
    area_mode = False
    for k in range(ports.shape[0]):
        area_mode = area_mode or ports[k, L.P_MODE] == L.EFFECTIVE_AREA
    for e in range(ends.shape[0]):
        kind = ends[e, L.E_KIND]
        ref = ends[e, L.E_REF]
        f0 = ends[e, L.E_FACE] * w
        sign = float(ends[e, L.E_SIGN])
        for j in range(w):
            f = f0 + j
            i = ends[e, L.E_CELL] * w + j
            if kind == L.WALL:
                fm[f] = 0.0
                fe[f] = 0.0
            elif kind == L.PORTED:
                out = port_net[e, j]
                if area_mode and port_push[e, j] != 0.0:
                    out = 0.0
                    for k in range(ports.shape[0]):
                        if ports[k, L.P_A] == L.SIDE_END and ports[k, L.P_AI] == e:
                            out += port_m[k, 0, j]
                        if ports[k, L.P_B] == L.SIDE_END and ports[k, L.P_BI] == e:
                            out -= port_m[k, 0, j]
                    fp[f] = X[L.W_P, i] + port_push[e, j] / face[f]
                else:
                    d, v, p = _face_state(e, w, j, order, ends, S, X)
                    c = math.sqrt(gamma * p / d)
                    uf = out / (d * face[f])
                    fp[f] = max(p + d * c * (v - uf), 0.05 * p) + d * uf * uf
                fm[f] = sign * out / face[f]
                fe[f] = sign * port_h[e, j] / face[f]
                end_u[e, j] = sign * out / (S[L.RHO, i] * face[f])
            elif kind == L.CHAMBER or kind == L.TANK:
                d, v, p = _face_state(e, w, j, order, ends, S, X)
                if kind == L.CHAMBER:
                    p0, t0, loss = ch_half[ref, j], ch_t[ref, j], 0.0
                else:
                    p0, t0 = supplied[ref, j], res_par[ref, L.R_TEMPERATURE, j]
                    loss = res_par[ref, L.R_LOSS, j]
                d, v, p = vessel_state(d, v, p, p0, t0, loss, gamma, r_gas)
                m = d * v
                fm[f] = sign * m
                fp[f] = p + m * v
                fe[f] = sign * v * (gamma / (gamma - 1.0) * p + 0.5 * m * v)
            elif kind == L.JUNCTION:
                d, v, p = _face_state(e, w, j, order, ends, S, X)
                m = joint[e, 2, j]
                q = joint[e, 3, j]
                if m > 0.0:
                    h = gamma / (gamma - 1.0) * p / d + 0.5 * v * v
                    d += (q - p) * d / (gamma * p)
                else:
                    h = joint[ref, 5, j] / max(joint[ref, 4, j], 1e-300)
                    if m < 0.0:
                        d = gamma / (gamma - 1.0) * q / h
                fm[f] = sign * m
                fp[f] = q + m * m / d
                fe[f] = sign * m * h
            if kind == L.CHAMBER:
                k = dt * face[f] * sign
                ch_state[ref, 0, j] += k * fm[f]
                ch_state[ref, 1, j] += k * fe[f]
            elif kind == L.RESERVOIR or kind == L.TANK:
                a = dt / (dt + res_par[ref, L.R_TAU, j])
                drawn = -sign * fm[f] * face[f]
                goal = res_par[ref, L.R_PRESSURE, j] - res_par[ref, L.R_DROOP, j] * drawn
                res_p[ref, j] += a * (goal - res_p[ref, j])
            elif kind == L.LINK:
                if e > ref:  # the first of the two ends carries the common face
                    o = ends[ref, L.E_FACE] * w + j
                    turn = -1.0 if ends[ref, L.E_SIGN] == ends[e, L.E_SIGN] else 1.0
                    fm[f] = turn * fm[o]
                    fp[f] = fp[o]
                    fe[f] = turn * fe[o]
            elif kind == L.BRANCH:
                # Thesis fig. 5.6: mass and energy join the partner's cell; its fictitious wall
                # opposite takes up the push of the branch.
                k = ends[ref, L.E_CELL] * w + j
                g = sign * dt * face[f] * P[L.INV_VOLUME, k]
                turn = -1.0 if ends[ref, L.E_SIGN] == ends[e, L.E_SIGN] else 1.0
                S[L.RHO, k] += g * fm[f]
                S[L.MOM, k] += g * turn * (fp[f] - X[L.W_P, k])
                S[L.ENE, k] += g * fe[f]
    for k in range(ports.shape[0]):
        for side in range(2):
            kind = ports[k, L.P_A] if side == 0 else ports[k, L.P_B]
            index = ports[k, L.P_AI] if side == 0 else ports[k, L.P_BI]
            g = -dt if side == 0 else dt
            if kind == L.SIDE_CHAMBER:
                for j in range(w):
                    ch_state[index, 0, j] += g * port_m[k, 0, j]
                    ch_state[index, 1, j] += g * port_m[k, 1, j]


@njit(cache=True, nogil=True, error_model="numpy")
def _at_tap(w, t, j, tap_slot, tap_weight, X, ch_p):
    """Return the pressure of the gas at tap t of lane j."""
    sl = tap_slot[t, j]
    if sl < 0:
        return ch_p[-1 - sl, j]
    a = tap_weight[t, j]
    return (1.0 - a) * X[L.W_P, sl * w + j] + a * X[L.W_P, (sl + 1) * w + j]


@njit(cache=True, nogil=True, error_model="numpy")
def _read(
    w,
    step,
    tap_slot,
    tap_weight,
    X,
    ch_p,
    sensor,
    read_t,
    read_p,
    read_gain,
    next_read,
    shown,
    felt,
    error,
    read_out,
):
    """Read the taps that are due since the last step; return whether the state is to be corrected.

    Between two steps a reading is linear. ``error`` gets what each tap asks of the state, in Pa.
    """
    corrected = False
    m = read_t.shape[1]
    for t in range(read_t.shape[0]):
        for j in range(w):
            i = next_read[t, j]
            error[t, j] = 0.0
            # A sensor that does not lag need not be looked at until a reading is near.
            if sensor[t, L.SENSE_KEEP, j] == 0.0 and (i >= m or read_t[t, i, j] > step + 1):
                continue
            p = _at_tap(w, t, j, tap_slot, tap_weight, X, ch_p)
            before = shown[t, j]
            if math.isnan(before):
                before = p
                shown[t, j] = p
            else:
                # First-order lag, exact for a pressure that is linear between steps.
                shown[t, j] = (
                    sensor[t, L.SENSE_KEEP, j] * before
                    + sensor[t, L.SENSE_OLD, j] * felt[t, j]
                    + sensor[t, L.SENSE_NEW, j] * p
                )
            felt[t, j] = p
            while i < m and read_t[t, i, j] <= step:
                f = min(max(read_t[t, i, j] - (step - 1), 0.0), 1.0)
                value = before + f * (shown[t, j] - before)
                gain = sensor[t, L.SENSE_GAIN, j]
                value = gain * value + sensor[t, L.SENSE_BIAS, j]
                read_out[t, i, j] = value
                # One in doubt (not a number) asks for nothing.
                asked = read_gain[t, i, j] * (read_p[t, i, j] - value) / gain
                if asked > 0.0 or asked < 0.0:
                    error[t, j] += asked
                    corrected = True
                i += 1
            next_read[t, j] = i
    return corrected


@njit(cache=True, nogil=True, error_model="numpy")
def _correct(slots, w, gamma, error, spread_slot, spread_chamber, P, S, X, ch_p, ch_state):
    """Correct the gas by what the taps ask, spread over lines and chambers.

    Gas is added or taken at its own temperature and velocity: what a model gets wrong that lasts is
    mass, and the wall keeps the temperature.
    """
    rho, mom, ene = S[L.RHO], S[L.MOM], S[L.ENE]
    n_taps = error.shape[0]
    for i in range(slots):
        if P[L.INV_VOLUME, i * w] <= 0.0:
            continue
        for j in range(w):
            d = 0.0
            for t in range(n_taps):
                d += spread_slot[i, t] * error[t, j]
            q = i * w + j
            grow = 1.0 + max(d / X[L.W_P, q], -0.5)
            rho[q] *= grow
            mom[q] *= grow
            ene[q] *= grow
    for c in range(ch_p.shape[0]):
        for j in range(w):
            d = 0.0
            for t in range(n_taps):
                d += spread_chamber[c, t] * error[t, j]
            grow = 1.0 + max(d / ch_p[c, j], -0.5)
            ch_state[c, 0, j] *= grow
            ch_state[c, 1, j] *= grow


@njit(cache=True, nogil=True, error_model="numpy")
def advance(
    n_out,
    n_sub,
    dt,
    knots,
    lanes,
    gamma,
    r_gas,
    prandtl,
    order,
    flux,
    limiter,
    newton,
    compliant,
    unsteady,
    P,
    S,
    X,
    ends,
    step_index,
    step_area,
    ports,
    port_par,
    opening,
    port_m,
    res_par,
    res_p,
    ch_par,
    ch_state,
    ripple_index,
    ripple_par,
    begin_s,
    leak_index,
    leak_par,
    ambient,
    tap_slot,
    tap_weight,
    read_t,
    read_p,
    read_gain,
    sensor,
    spread_slot,
    spread_chamber,
    first_step,
    closing,
    next_read,
    shown,
    felt,
    read_out,
    tap_out,
    flow_out,
    chamber_out,
):
    """Advance one tile of rigs and record its taps.

    Args:
        n_out: Number of recorded samples; sample 0 is the initial state.
        n_sub: Steps between samples.
        dt: Step, s.
        knots: Opening knots per sample interval.
        lanes: Rigs in the tile.
        gamma: Ratio of specific heats.
        r_gas: Specific gas constant, J/(kg K).
        prandtl: Prandtl number.
        order: 1 Godunov, 2 MUSCL-Hancock.
        flux: HLLC or EXACT.
        limiter: MINMOD or VAN_LEER.
        newton: Newton iterations of the exact star pressure.
        compliant: Whether any wall yields.
        unsteady: Whether wall friction and heat have memory.
        P: (PARAM_ROWS, slots*lanes) cell parameters.
        S: (STATE_ROWS, slots*lanes) state, changed in place.
        X: (WORK_ROWS, slots*lanes) scratch.
        ends: (n_ends, END_COLUMNS) integers.
        step_index: (n_steps, 5) faces where the area jumps: face, then the cell and its direction
            on the left and on the right.
        step_area: (n_steps, 2, lanes) areas left and right of those faces.
        ports: (n_ports, PORT_COLUMNS) integers.
        port_par: (n_ports, PORT_PARAMS, lanes).
        opening: ((n_out-1)*knots + 1, n_ports, lanes) opening fractions.
        port_m: (n_ports, 2, lanes) mass flow kg/s and enthalpy flow W of the last step.
        res_par: (n_reservoirs, RESERVOIR_PARAMS, lanes).
        res_p: (n_reservoirs, lanes) present pressures, changed in place.
        ch_par: (n_chambers, CHAMBER_PARAMS, lanes).
        ch_state: (n_chambers, 2, lanes) mass kg and energy J, changed in place.
        ripple_index: (n_ripples,) reservoirs whose pressure ripples.
        ripple_par: (n_ripples, RIPPLE_PARAMS, lanes).
        begin_s: (lanes,) time at the first sample, s.
        leak_index: (n_leaks, LEAK_COLUMNS) what leaks to the room, and how.
        leak_par: (n_leaks, LEAK_PARAMS, lanes).
        ambient: (2, lanes) room pressure and temperature.
        tap_slot: (n_taps, lanes) slot left of each tap, or -1 - chamber.
        tap_weight: (n_taps, lanes) weight of the next slot.
        read_t: (n_taps, m, lanes) when each tap is read, in steps since the start, increasing; inf
            beyond the last reading.
        read_p: (n_taps, m, lanes) what was measured then, Pa; NaN where nothing was.
        read_gain: (n_taps, m, lanes) share of the difference by which the state is corrected then.
        sensor: (n_taps, SENSOR_ROWS, lanes) what each sensor makes of the pressure, see ``layout``.
        spread_slot: (slots, n_taps) how a correction at the taps spreads over the slots.
        spread_chamber: (n_chambers, n_taps) the same for the chambers.
        first_step: Steps since the start that earlier calls have made.
        closing: Whether this call is the last, so that the taps are read at its very end too.
        next_read: (n_taps, lanes) the next reading, kept from call to call.
        shown: (n_taps, lanes) what the sensors make of the pressure before gain and bias, Pa,
            likewise; NaN has them at rest.
        felt: (n_taps, lanes) the pressure behind that, Pa, likewise.
        read_out: (n_taps, m, lanes) what the sensors read then, Pa.
        tap_out: (n_out, n_taps, lanes) recorded pressures.
        flow_out: (n_out, n_ports, lanes) recorded port flows, kg/s.
        chamber_out: (n_out, n_chambers, lanes) recorded chamber pressures.
    """
    w = lanes
    n = S.shape[1]
    cv = r_gas / (gamma - 1.0)
    n_ends = ends.shape[0]
    n_ch = ch_state.shape[0]
    n_ports = ports.shape[0]
    port_net = np.zeros((n_ends, w))
    port_h = np.zeros((n_ends, w))
    port_push = np.zeros((n_ends, w))
    n_taps = tap_out.shape[1]
    error = np.zeros((n_taps, w))
    reading = read_t.shape[1] > 0
    corrected = False
    end_u = np.zeros((n_ends, w))
    joint = np.zeros((n_ends, 6, w))
    joints = False
    for e in range(n_ends):
        joints = joints or ends[e, L.E_KIND] == L.JUNCTION
    tapered = False
    for i in range(n):
        tapered = tapered or P[L.TAPER, i] != 0.0
    ch_p = np.zeros((n_ch, w))
    ch_t = np.zeros((n_ch, w))
    ch_half = np.zeros((n_ch, w))
    ch_weight = np.zeros((n_ch, w))
    now = np.zeros((n_ports, w))
    # What a reservoir supplies; where none ripples, that is its pressure itself.
    rippling = ripple_index.size > 0
    supplied = np.zeros_like(res_p) if rippling else res_p
    rho, mom, ene = S[L.RHO], S[L.MOM], S[L.ENE]
    soft = np.zeros((5, n if compliant else 0))
    # wall heat of a Nusselt number of 1, pi k / A, over RELAX: k / mu is cp / Pr
    per_relax = gamma * r_gas / ((gamma - 1.0) * prandtl * L.UNSTEADY_RATE)
    stay = np.zeros(n)
    for i in range(n):
        # ghosts have no wall; the floor keeps their unused memory finite
        stay[i] = 1.0 / max(P[L.RELAX, i], 1e-12)
    step = 0
    for k in range(n_out):
        for s in range(n_sub):
            if compliant:
                _take_gas(
                    n,
                    gamma,
                    rho,
                    mom,
                    ene,
                    P[L.COMPLIANCE],
                    P[L.REST_P],
                    soft[0],
                    soft[1],
                    soft[2],
                    soft[3],
                )
            if step == 0 or compliant or corrected:  # else `_conserve` has left it
                _inverse(n, rho, X[L.W_RI])
            _primitive(
                n,
                gamma,
                r_gas,
                mom,
                ene,
                X[L.W_RI],
                X[L.W_U],
                X[L.W_P],
                X[L.W_C],
                X[L.W_T],
            )
            for c in range(n_ch):
                for j in range(w):
                    vol = ch_par[c, L.C_VOLUME, j]
                    com = ch_par[c, L.C_COMPLIANCE, j]
                    pr = chamber_pressure(
                        ch_state[c, 1, j], vol, com, ch_par[c, L.C_REST_P, j], gamma
                    )
                    ch_p[c, j] = pr
                    vol += com * (pr - ch_par[c, L.C_REST_P, j])
                    ch_t[c, j] = pr * vol / (ch_state[c, 0, j] * r_gas)
            corrected = False
            if reading and (closing or k < n_out - 1):
                corrected = _read(
                    w,
                    first_step + step,
                    tap_slot,
                    tap_weight,
                    X,
                    ch_p,
                    sensor,
                    read_t,
                    read_p,
                    read_gain,
                    next_read,
                    shown,
                    felt,
                    error,
                    read_out,
                )
            if s == 0:
                for t in range(n_taps):
                    for j in range(w):
                        tap_out[k, t, j] = _at_tap(w, t, j, tap_slot, tap_weight, X, ch_p)
                for q in range(n_ports):
                    for j in range(w):
                        flow_out[k, q, j] = port_m[q, 0, j]
                for c in range(n_ch):
                    for j in range(w):
                        chamber_out[k, c, j] = ch_p[c, j]
                if k == n_out - 1:
                    if compliant:
                        _give_back(n, rho, mom, ene, soft[1], soft[2], soft[3])
                    break
            x = k * knots + (s + 0.5) / n_sub * knots
            ix = int(x)
            fx = x - ix
            for q in range(n_ports):
                for j in range(w):
                    now[q, j] = (1.0 - fx) * opening[ix, q, j] + fx * opening[ix + 1, q, j]

            if rippling:
                supplied[:] = res_p
                for q in range(ripple_index.size):
                    for j in range(w):
                        t_s = begin_s[j] + (step + 0.5) * dt
                        x = ripple_par[q, L.RIPPLE_RATE, j] * t_s + ripple_par[q, L.RIPPLE_PHASE, j]
                        supplied[ripple_index[q], j] += ripple_par[
                            q, L.RIPPLE_AMPLITUDE, j
                        ] * math.sin(x)

            if joints:
                _joints(w, gamma, 1, ends, P, S, X, joint)
            vessels = order == 2 or s == n_sub - 1 or reading
            _fill_ghosts(
                w, gamma, r_gas, vessels, ends, end_u, joint, S, X, res_par, supplied, ch_p, ch_t
            )
            if order == 1:
                rr, ur, pr_, ir = rho, X[L.W_U], X[L.W_P], X[L.W_RI]
                rl, ul, pl, il = rr, ur, pr_, ir
            else:
                _reconstruct(
                    n,
                    w,
                    gamma,
                    dt,
                    limiter == L.VAN_LEER,
                    rho,
                    mom,
                    ene,
                    P[L.LENGTH],
                    X[L.W_P],
                    X[L.W_DRAG],
                    X[L.W_WARM],
                    X[L.W_RL],
                    X[L.W_UL],
                    X[L.W_PL],
                    X[L.W_IL],
                    X[L.W_RR],
                    X[L.W_UR],
                    X[L.W_PR],
                    X[L.W_IR],
                )
                if tapered:
                    _taper(
                        n,
                        gamma,
                        dt,
                        P[L.TAPER],
                        X[L.W_U],
                        X[L.W_RL],
                        X[L.W_PL],
                        X[L.W_IL],
                        X[L.W_RR],
                        X[L.W_PR],
                        X[L.W_IR],
                    )
                for j in range(w):  # the outermost slots have one neighbour only
                    for i in (j, n - w + j):
                        X[L.W_RL, i] = X[L.W_RR, i] = rho[i]
                        X[L.W_UL, i] = X[L.W_UR, i] = X[L.W_U, i]
                        X[L.W_PL, i] = X[L.W_PR, i] = X[L.W_P, i]
                        X[L.W_IL, i] = X[L.W_IR, i] = X[L.W_RI, i]
                _flatten_steps(w, step_index, step_area, P, S, X)
                _ghost_faces(w, ends, X)
                rr, ur, pr_, ir = X[L.W_RR], X[L.W_UR], X[L.W_PR], X[L.W_IR]
                rl, ul, pl, il = X[L.W_RL], X[L.W_UL], X[L.W_PL], X[L.W_IL]
            if flux == L.HLLC:
                _hllc(
                    n,
                    w,
                    gamma,
                    X[L.W_C],
                    rr,
                    ur,
                    pr_,
                    ir,
                    rl,
                    ul,
                    pl,
                    il,
                    X[L.W_FM],
                    X[L.W_FP],
                    X[L.W_FE],
                )
            else:
                _exact(
                    n, w, gamma, newton, rr, ur, pr_, rl, ul, pl, X[L.W_FM], X[L.W_FP], X[L.W_FE]
                )
            _step_faces(w, gamma, dt, order, flux, newton, step_index, step_area, P, S, X)
            if joints and order == 2:
                _joints(w, gamma, 2, ends, P, S, X, joint)
            if n_ports > 0:
                _ports(
                    w,
                    gamma,
                    r_gas,
                    order,
                    ends,
                    ports,
                    port_par,
                    now,
                    port_m,
                    port_net,
                    port_h,
                    port_push,
                    P,
                    S,
                    X,
                    res_par,
                    supplied,
                    ch_p,
                    ch_t,
                )
            _chamber_middle(w, gamma, dt, order, ends, P, S, X, ch_par, ch_p, ch_half, ch_weight)
            _ends(
                w,
                gamma,
                dt,
                order,
                ends,
                ports,
                port_m,
                port_net,
                port_h,
                port_push,
                end_u,
                joint,
                P,
                S,
                X,
                ch_state,
                ch_half,
                ch_t,
                res_par,
                res_p,
                supplied,
                r_gas,
            )
            for c in range(n_ch):
                for j in range(w):
                    h = dt * ch_par[c, L.C_HEAT, j]
                    if h > 0.0:
                        cap = ch_state[c, 0, j] * cv
                        gain = h / (1.0 + h / cap)
                        ch_state[c, 1, j] += gain * (ch_par[c, L.C_WALL_T, j] - ch_t[c, j])
            _leaks(
                w, gamma, r_gas, dt, leak_index, leak_par, ambient, P, S, X, ch_p, ch_t, ch_state
            )
            face = P[L.FACE]
            if compliant:
                _give_back(n, rho, mom, ene, soft[1], soft[2], soft[3])
                _widen_faces(n, w, P[L.FACE], P[L.LENGTH], soft[0], soft[4])
                face = soft[4]
            _conserve(
                n,
                w,
                dt,
                rho,
                mom,
                ene,
                face,
                P[L.INV_VOLUME],
                X[L.W_P],
                X[L.W_FM],
                X[L.W_FP],
                X[L.W_FE],
                X[L.W_RI],
            )
            if compliant:  # the wall acts on the gas as it now is
                _take_gas(
                    n,
                    gamma,
                    rho,
                    mom,
                    ene,
                    P[L.COMPLIANCE],
                    P[L.REST_P],
                    soft[0],
                    soft[1],
                    soft[2],
                    soft[3],
                )
                _inverse(n, rho, X[L.W_RI])
            # Drag ratio and decay factors follow density and Reynolds number, which change little
            # within a few steps: refreshed every WALL_EVERY steps.
            if step % WALL_EVERY == 0:
                _wall_coefficients(
                    n,
                    prandtl,
                    per_relax,
                    mom,
                    P[L.REYNOLDS],
                    P[L.ROUGH],
                    P[L.TURBULENT],
                    P[L.ONSET],
                    P[L.RELAX],
                    P[L.HEAT],
                    P[L.HEAT_TURBULENT],
                    X[L.W_PHI],
                    X[L.W_FILM],
                )
                if unsteady:
                    _decay(
                        n,
                        dt,
                        prandtl,
                        rho,
                        P[L.RELAX],
                        P[L.QUICKEN],
                        X[L.W_PHI],
                        X[L.W_AU],
                        X[L.W_AT],
                        X[L.W_FADE],
                    )
            step += 1
            if unsteady:
                _unsteady_heat(
                    n,
                    gamma,
                    r_gas,
                    prandtl,
                    dt,
                    rho,
                    mom,
                    ene,
                    X[L.W_RI],
                    X[L.W_T],
                    X[L.W_FILM],
                    X[L.W_AT],
                    X[L.W_FADE],
                    stay,
                    P[L.HEAT_UNSTEADY],
                    P[L.WALL_T],
                    X[L.W_WARM],
                    S[L.Z0],
                    S[L.Z0 + 1],
                    S[L.Z0 + 2],
                    S[L.Z0 + 3],
                    S[L.Z0 + 4],
                    S[L.Z0 + 5],
                )
                _unsteady_drag(
                    n,
                    dt,
                    rho,
                    mom,
                    X[L.W_RI],
                    X[L.W_U],
                    X[L.W_PHI],
                    X[L.W_AU],
                    X[L.W_FADE],
                    stay,
                    P[L.VISCOUS],
                    P[L.LOSS],
                    P[L.UNSTEADY],
                    X[L.W_DRAG],
                    S[L.Y0],
                    S[L.Y0 + 1],
                    S[L.Y0 + 2],
                    S[L.Y0 + 3],
                    S[L.Y0 + 4],
                    S[L.Y0 + 5],
                )
            else:
                _steady_wall(
                    n,
                    gamma,
                    r_gas,
                    dt,
                    rho,
                    mom,
                    ene,
                    X[L.W_PHI],
                    X[L.W_FILM],
                    P[L.VISCOUS],
                    P[L.LOSS],
                    P[L.WALL_T],
                    X[L.W_DRAG],
                    X[L.W_WARM],
                )
            if compliant:
                _give_back(n, rho, mom, ene, soft[1], soft[2], soft[3])
            if corrected:
                _correct(
                    n // w, w, gamma, error, spread_slot, spread_chamber, P, S, X, ch_p, ch_state
                )
