# SPDX-License-Identifier: Apache-2.0
"""Equations of a creature of a torso and two legs; see ``pneu_sim.bodies.dog``."""

import math

from pneu_sim.bodies.crank import CRANK_NUMBERS
from pneu_sim.bodies.dog import CRANKS, FRONT, GROUND, LEG_NUMBERS
from pneu_sim.compiling import branching, folded
from pneu_sim.kernel.equations.crank import crank
from pneu_sim.kernel.equations.ground import contact


@folded
def _inertia(par, b, j, at, i, trig, v, mass, force):
    """Adds a leg's inertia, weight and Coriolis forces, and its hip's; see the top of the file.

    Args:
        par: Numbers of all bodies.
        b: Which body.
        j: Which lane.
        at: Where the leg's numbers begin.
        i: Coordinate of its hip; the knee's is the next.
        trig: Cosine and sine of the angles of torso, thigh and shank.
        v: (7,) velocities.
        mass: (7, 7) of which the columns up to each row's own are added to, or written.
        force: (7,) added to, or written.
    """
    cp, sp, ca, sa, ce, se = trig
    h, m, s1, first2 = par[b, at, j], par[b, at + 3, j], par[b, at + 4, j], par[b, at + 6, j]
    g, coupling = par[b, 0, j], par[b, at + 8, j]
    vp, va = v[2], v[2] + v[i]
    ve = va + v[i + 1]
    vp, va, ve = vp * vp, va * va, ve * ve

    on_shank = par[b, at + 7, j]
    both = coupling * (ca * ce + sa * se)
    thigh_shank = both + on_shank
    on_leg = par[b, at + 5, j] + both + thigh_shank
    x_leg, x_shank = s1 * ca + first2 * ce, first2 * ce
    z_leg, z_shank = s1 * sa + first2 * se, first2 * se
    p_shank = h * first2 * (se * cp - ce * sp)
    p_leg = p_shank + h * s1 * (sa * cp - ca * sp)
    mass[0, 0] += m
    mass[1, 1] += m
    mass[2, 0] += x_leg - m * h * sp
    mass[2, 1] += z_leg + m * h * cp
    mass[2, 2] += m * h * h + 2.0 * p_leg + on_leg
    mass[i, 0] = x_leg
    mass[i, 1] = z_leg
    mass[i, 2] = p_leg + on_leg
    mass[i, i] = on_leg
    mass[i + 1, 0] = x_shank
    mass[i + 1, 1] = z_shank
    mass[i + 1, 2] = p_shank + thigh_shank
    mass[i + 1, i] = thigh_shank
    mass[i + 1, i + 1] = on_shank

    # Each link's end speeds towards its joint, and what hangs there pulls outwards.
    bent = coupling * (se * ca - ce * sa)
    thigh_in, shank_in = h * s1 * (ca * cp + sa * sp), h * first2 * (ce * cp + se * sp)
    f_shank = shank_in * vp - bent * va - g * first2 * se
    f_leg = f_shank + thigh_in * vp + bent * ve - g * s1 * sa
    force[0] += m * h * cp * vp + s1 * sa * va + first2 * se * ve
    force[1] += m * h * sp * vp - s1 * ca * va - first2 * ce * ve - g * m
    force[2] += f_leg - thigh_in * va - shank_in * ve - g * m * h * cp
    force[i] = f_leg
    force[i + 1] = f_shank


@folded
def _touch(par, b, j, at, i, trig, z, v, force):
    """Adds the forces of the ground on hip, knee and foot of a leg.

    Args:
        par: Numbers of all bodies.
        b: Which body.
        j: Which lane.
        at: Where the leg's numbers begin.
        i: Coordinate of its hip; the knee's is the next.
        trig: Cosine and sine of the angles of torso, thigh and shank.
        z: Height of the torso's centre, m.
        v: (7,) velocities.
        force: (7,) added to.
    """
    cp, sp, ca, sa, ce, se = trig
    h, l1, l2 = par[b, at, j], par[b, at + 1, j], par[b, at + 2, j]
    va = v[2] + v[i]
    ve = va + v[i + 1]
    hip_u, hip_w = v[0] - h * sp * v[2], v[1] + h * cp * v[2]
    knee_u, knee_w = hip_u + l1 * ca * va, hip_w + l1 * sa * va
    foot_u, foot_w = knee_u + l2 * ce * ve, knee_w + l2 * se * ve
    hip_z = z + h * sp
    knee_z = hip_z - l1 * ca
    foot_x, foot_y = contact(par, b, j, GROUND, knee_z - l2 * ce, foot_u, foot_w)
    knee_x, knee_y = contact(par, b, j, GROUND, knee_z, knee_u, knee_w)
    hip_x, hip_y = contact(par, b, j, GROUND, hip_z, hip_u, hip_w)
    knee_x, knee_y = knee_x + foot_x, knee_y + foot_y
    hip_x, hip_y = hip_x + knee_x, hip_y + knee_y
    on_shank = l2 * (ce * foot_x + se * foot_y)
    on_leg = on_shank + l1 * (ca * knee_x + sa * knee_y)
    force[0] += hip_x
    force[1] += hip_y
    force[2] += on_leg + h * (cp * hip_y - sp * hip_x)
    force[i] += on_leg
    force[i + 1] += on_shank


@branching
def mechanics(par, b, j, q, v, mass, force):
    """Mass matrix, weight, Coriolis forces and the ground's; equations at the file's top.

    Args:
        par: Numbers of all bodies.
        b: Which body.
        j: Which lane.
        q: (7,) positions, m and rad.
        v: (7,) velocities.
        mass: (7, 7) written.
        force: (7,) written.
    """
    mass[0, 0] = par[b, 1, j]
    mass[1, 0] = 0.0
    mass[1, 1] = par[b, 1, j]
    mass[2, 0] = 0.0
    mass[2, 1] = 0.0
    mass[2, 2] = par[b, 2, j]
    force[0] = 0.0
    force[1] = -par[b, 0, j] * par[b, 1, j]
    force[2] = 0.0
    cp, sp = math.cos(q[2]), math.sin(q[2])
    for leg in range(2):
        at, i = FRONT + leg * LEG_NUMBERS, 3 + 2 * leg
        a = q[2] + q[i]
        e = a + q[i + 1]
        trig = (cp, sp, math.cos(a), math.sin(a), math.cos(e), math.sin(e))
        _inertia(par, b, j, at, i, trig, v, mass, force)
        _touch(par, b, j, at, i, trig, q[1], v, force)
    for i in range(5, 7):  # the legs move each other by the torso alone
        mass[i, 3] = 0.0
        mass[i, 4] = 0.0
    for i in range(7):
        for k in range(i):
            mass[k, i] = mass[i, k]


@branching
def levers(par, b, j, q, extension, lever):
    """Extensions by the four cranks; see ``pneu_sim.bodies.crank``.

    Args:
        par: Numbers of all bodies.
        b: Which body.
        j: Which lane.
        q: (7,) positions, m and rad.
        extension: (4,) written.
        lever: (4, 7) written.
    """
    for c in range(4):
        for i in range(7):
            lever[c, i] = 0.0
        extension[c], lever[c, 3 + c] = crank(par, b, j, CRANKS + CRANK_NUMBERS * c, q[3 + c])
