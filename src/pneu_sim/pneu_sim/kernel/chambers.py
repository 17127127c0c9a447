# SPDX-License-Identifier: Apache-2.0
"""Well-mixed volumes: pressure and temperature of what they hold, and the heat of their walls."""

import math

from pneu_sim import layout as L
from pneu_sim.compiling import branching, folded
from pneu_sim.kernel.ends import face_state
from pneu_sim.kernel.pistons import squeeze

GRAVITY_M_S2 = 9.81


@folded
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


@branching
def find_chambers(gas, chambers):
    """Pressure and temperature of every chamber.

    Args:
        gas: The gas.
        chambers: Chambers.
    """
    par, state, work = chambers.par, chambers.state, chambers.work
    for c in range(state.shape[0]):
        for j in range(state.shape[2]):
            vol = par[c, L.C_VOLUME, j]
            com = par[c, L.C_COMPLIANCE, j]
            rest = par[c, L.C_REST_P, j]
            p = chamber_pressure(state[c, 1, j], vol, com, rest, gas.gamma)
            work[c, L.H_PRESSURE, j] = p
            work[c, L.H_TEMPERATURE, j] = p * (vol + com * (p - rest)) / (state[c, 0, j] * gas.r)


@branching
def find_middle(gas, order, dt, cells, ends, ports, chambers, moving):
    """Pressure of every chamber at the middle of the step, implicit in what its pipes bring.

    With the pressure at the step's beginning instead, a chamber would feed an oscillation.

    Args:
        gas: The gas.
        order: 1 Godunov, 2 MUSCL-Hancock.
        dt: Step, s.
        cells: All slots.
        ends: Ends of pipes.
        ports: Ports, with the flows of this step.
        chambers: Chambers.
        moving: Cylinders, with the speeds foreseen, and bodies; None has none.
    """
    w, par, work, gamma = cells.lanes, chambers.par, chambers.work, gas.gamma
    for c in range(work.shape[0]):
        for j in range(w):
            work[c, L.H_MIDDLE, j] = work[c, L.H_PRESSURE, j]
            work[c, L.H_WEIGHT, j] = 1.0
            work[c, L.H_INFLOW, j] = 0.0
    for e in range(ends.table.shape[0]):
        if ends.table[e, L.E_KIND] == L.CHAMBER:
            c = ends.table[e, L.E_REF]
            for j in range(w):
                d, v, p = face_state(e, j, order, cells, ends)
                z = math.sqrt(gamma * p * d)
                q = work[c, L.H_PRESSURE, j]
                vol = par[c, L.C_VOLUME, j] + par[c, L.C_COMPLIANCE, j] * (
                    (gamma + 1.0) * q - par[c, L.C_REST_P, j]
                )
                a = cells.par[L.FACE, ends.table[e, L.E_FACE] * w + j]
                k = 0.5 * dt * gamma * q * a / (z * vol)
                if p + z * v < q:
                    k *= 1.0 - work[c, L.H_SHUT, j]  # a cushion lets it follow the less
                work[c, L.H_MIDDLE, j] += k * (p + z * v)
                work[c, L.H_WEIGHT, j] += k
    if moving is not None:
        squeeze(gas, dt, ports, chambers, moving.cylinders)
    for c in range(work.shape[0]):
        for j in range(w):
            work[c, L.H_MIDDLE, j] = max(
                work[c, L.H_MIDDLE, j] / work[c, L.H_WEIGHT, j], 0.05 * work[c, L.H_PRESSURE, j]
            )


@folded
def convection(c, j, gas, chambers):
    """Conductance of a chamber's wall by what rises along it and by the jet that enters, W/K.

    Nu = 0.56 Re_d^0.67 + 0.104 Ra_H^0.352: Woodfield, Monde and Mitsutake 2007, J. Therm. Sci.
    Technol. 2(2), 180, of vessels being charged, as quoted in HydDown's manual. While nothing
    enters the second term is left. Re is of the jet where it enters, Ra and Nu are of the gas's
    height. The jet stirs its share of the wall.

    Args:
        c: The chamber.
        j: The lane.
        gas: The gas.
        chambers: Chambers, with what enters in this step.
    """
    par, work = chambers.par, chambers.work
    t, wall = work[c, L.H_TEMPERATURE, j], par[c, L.C_WALL_T, j]
    film = 0.5 * (t + wall)
    mu = par[c, L.C_VISCOUS, j] * film * math.sqrt(film) / (film + par[c, L.C_SUTHERLAND, j])
    d, height = par[c, L.C_INLET, j], par[c, L.C_HEIGHT, j]
    nu = mu * gas.r * film / work[c, L.H_PRESSURE, j]
    rayleigh = gas.prandtl * GRAVITY_M_S2 * abs(t - wall) / film * height**3 / (nu * nu)
    nusselt = 0.104 * rayleigh**0.352
    if d > 0.0:
        stirred = 0.56 * (4.0 * work[c, L.H_INFLOW, j] / (math.pi * d * mu)) ** 0.67
        nusselt += par[c, L.C_STIRRED, j] * stirred
    cp = gas.gamma * gas.r / (gas.gamma - 1.0)
    return par[c, L.C_CONVECTION, j] * nusselt * mu * cp / gas.prandtl / height


@branching
def heat_chambers(gas, dt, chambers):
    """Heat that passes between the walls of chambers and the gas in them.

    Implicit in the gas's temperature, so that no step is too long for a small chamber.

    Args:
        gas: The gas.
        dt: Step, s.
        chambers: Chambers.
    """
    par, state, work = chambers.par, chambers.state, chambers.work
    cv = gas.r / (gas.gamma - 1.0)
    for c in range(state.shape[0]):
        for j in range(state.shape[2]):
            h = dt * par[c, L.C_HEAT, j]
            if par[c, L.C_CONVECTION, j] > 0.0:
                h += dt * convection(c, j, gas, chambers)
            if h > 0.0:
                gain = h / (1.0 + h / (state[c, 0, j] * cv))
                state[c, 1, j] += gain * (par[c, L.C_WALL_T, j] - work[c, L.H_TEMPERATURE, j])
