# SPDX-License-Identifier: Apache-2.0
"""Gas that pistons move: the cells that appear and vanish, chambers that grow, work done both ways.

A piston stands in a wide pipe whose last cell in use it bounds (thesis 5.6, 5.7), or between
chambers. In a step it moves at one speed. The face of the gas on it has the pressure that a wall of
that speed meets; that pressure does the work, and is the force. So what a body gains the gas loses,
to rounding.
"""

import math

from pneu_sim import layout as L
from pneu_sim.compiling import branching, entry, folded
from pneu_sim.kernel.faces import limited
from pneu_sim.kernel.orifices import orifice_flow
from pneu_sim.kernel.waves import wave_state

LONGEST = 2.1
"""The last cell is cut in two when it is so many times as long as the others, and joined with its
neighbour when it is shorter than they are: no cell asks for a shorter step, and one that is cut is
not joined at once."""


@folded
def _way(k, side, j, cylinders):
    """How far the piston stands from the end of a side."""
    x = cylinders.state[k, L.SY_EXTENSION, j]
    return x if side == 0 else cylinders.par[k, L.PY_STROKE, j] - x


@folded
def _volume(k, side, j, cylinders):
    """Volume of the gas on a side; where a stop yields it is not used up."""
    par = cylinders.par
    dead = par[k, L.PY_DEAD + side, j]
    return max(dead + par[k, L.PY_AREA + side, j] * _way(k, side, j, cylinders), 0.2 * dead)


@folded
def _set_chamber(k, side, j, cylinders, chambers):
    """Volume and wall of a side that is a chamber."""
    par, c = cylinders.par, cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_REF]
    chambers.par[c, L.C_VOLUME, j] = _volume(k, side, j, cylinders)
    wetted = max(_way(k, side, j, cylinders), 0.0)
    heat = par[k, L.PY_HEAT + side, j] + par[k, L.PY_FILM + side, j] * wetted
    cylinders.work[k, L.WY_HEAT + side, j] = heat


@folded
def _warm(c, j, conductance, rate, gas, dt, chambers):
    """Heat from the wall of a chamber over a step, J, and by how much it warms the gas in half.

    Exact for gas that relaxes to its wall while work heats it steadily, so that it is of second
    order and stays calm however strongly the wall holds it.
    """
    wall = chambers.par[c, L.C_WALL_T, j]
    capacity = chambers.state[c, 0, j] * gas.r / (gas.gamma - 1.0)
    excess = chambers.work[c, L.H_TEMPERATURE, j] - wall
    x = 0.5 * dt * conductance / capacity
    steady = 0.5 * dt * rate / x
    half = (excess - steady) * math.expm1(-x) - 0.5 * dt * rate
    share = -math.expm1(-2.0 * x) / (2.0 * x)
    return -dt * conductance * (excess * share + steady * (1.0 - share)), half


@folded
def _lay(k, side, j, cells, cylinders):
    """Lengths and volumes of the cells of a side, for its piston's place and its count of cells."""
    w = cells.lanes
    first = cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_REF]
    most = cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_CELLS]
    count = int(cylinders.state[k, L.SY_COUNT + side, j])
    area = cylinders.par[k, L.PY_AREA + side, j]
    longest = (cylinders.par[k, L.PY_DEAD + side, j] / area) + cylinders.par[k, L.PY_STROKE, j]
    dx = longest / most
    for n in range(most):
        i = (first + n) * w + j
        length = dx
        if n == count - 1:
            length = _volume(k, side, j, cylinders) / area - n * dx
        cells.par[L.LENGTH, i] = length if n < count else -1.0
        cells.par[L.INV_VOLUME, i] = 1.0 / (area * length) if n < count else 0.0


@entry
def settle(cells, chambers, cylinders):
    """Volumes and lengths as the pistons stand; what a call begins from.

    Args:
        cells: All slots.
        chambers: Chambers.
        cylinders: Cylinders.
    """
    for k in range(cylinders.table.shape[0]):
        for side in range(2):
            kind = cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_KIND]
            for j in range(cells.lanes):
                if kind == L.GAS_CHAMBER:
                    _set_chamber(k, side, j, cylinders, chambers)
                elif kind == L.GAS_CELLS:
                    _lay(k, side, j, cells, cylinders)


@entry
def count_cells(lanes, cylinders):
    """How many cells of each side are in use, wherever its piston was put.

    Args:
        lanes: Rigs side by side.
        cylinders: Cylinders.
    """
    for k in range(cylinders.table.shape[0]):
        for side in range(2):
            if cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_KIND] != L.GAS_CELLS:
                continue
            most = cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_CELLS]
            for j in range(lanes):
                area = cylinders.par[k, L.PY_AREA + side, j]
                dead = cylinders.par[k, L.PY_DEAD + side, j] / area
                dx = (dead + cylinders.par[k, L.PY_STROKE, j]) / most
                n = int(_volume(k, side, j, cylinders) / area / dx * (1.0 + 1e-12))
                cylinders.state[k, L.SY_COUNT + side, j] = min(max(n, 1), most)


@folded
def _last(k, side, j, cells, cylinders):
    """Entry of the cell beside the piston, and how the piston's speed looks from there."""
    first = cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_REF]
    count = int(cylinders.state[k, L.SY_COUNT + side, j])
    return (first + count - 1) * cells.lanes + j, (1.0 if side == 0 else -1.0)


@branching
def open_cushions(ports, chambers, cylinders):
    """Throttle the ways in of sides whose pistons come to their ends; inflow finds them open.

    A port shrinks; where there is none, the pipe's end.

    Args:
        ports: Ports; those of cylinders are orifices.
        chambers: Chambers.
        cylinders: Cylinders.
    """
    for k in range(cylinders.table.shape[0]):
        for side in range(2):
            q = cylinders.table[k, L.Y_PORT + side]
            if q < 0 and cylinders.table[k, L.COLUMNS_PER_SIDE * side] != L.GAS_CHAMBER:
                continue
            for j in range(ports.opening.shape[1]):
                length = cylinders.par[k, L.PY_CUSHION + side, j]
                way = _way(k, side, j, cylinders)
                share = 1.0
                if length > 0.0 and way < length:
                    left = cylinders.par[k, L.PY_LEFT + side, j]
                    share = left + (1.0 - left) * max(way, 0.0) / length
                length = cylinders.par[k, L.PY_THROTTLE + side, j]
                if length > 0.0 and way < length:
                    left = 1.0 / math.sqrt(1.0 + cylinders.par[k, L.PY_HEADS + side, j])
                    left += (1.0 - left) * max(way, 0.0) / length
                    share = 1.0 / math.sqrt(1.0 / (share * share) + 1.0 / (left * left) - 1.0)
                if q < 0:
                    c = cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_REF]
                    chambers.work[c, L.H_SHUT, j] = 1.0 - share
                elif ports.flow[q, 0, j] <= 0.0:
                    ports.opening[q, j] *= share


@branching
def fill_piston_ghosts(gas, cells, cylinders):
    """What lies beyond the last cell in use: the gas mirrored about the piston, which may speed up.

    The pressure goes on with the slope that an accelerated piston holds up, -rho dv/dt.

    Args:
        gas: The gas.
        cells: All slots.
        cylinders: Cylinders.
    """
    w, S, X = cells.lanes, cells.state, cells.work
    for k in range(cylinders.table.shape[0]):
        for side in range(2):
            if cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_KIND] != L.GAS_CELLS:
                continue
            for j in range(w):
                i, sign = _last(k, side, j, cells, cylinders)
                g = i + w
                d, p = S[L.RHO, i], X[L.W_P, i]
                push = sign * cylinders.state[k, L.SY_PUSH, j]
                more = -d * push * cells.par[L.LENGTH, i]
                more = min(max(more, -0.5 * p), 0.5 * p)
                v = 2.0 * sign * cylinders.state[k, L.SY_SPEED, j] - X[L.W_U, i]
                q = p + more
                r = d * (1.0 + more / (gas.gamma * p))
                S[L.RHO, g] = r
                S[L.MOM, g] = r * v
                S[L.ENE, g] = q / (gas.gamma - 1.0) + 0.5 * r * v * v
                X[L.W_U, g] = v
                X[L.W_P, g] = q
                X[L.W_C, g] = math.sqrt(gas.gamma * q / r)
                X[L.W_T, g] = q / (r * gas.r)
                X[L.W_RI, g] = 1.0 / r


@folded
def _evolve(i, length, d0, d1, d2, gm, half, cells):
    """States at both faces of a cell half a step on, from half slopes; as `faces.reconstruct`."""
    S, X, D = cells.state, cells.work, cells.wall
    rho, mom, ene, p = S[L.RHO, i], S[L.MOM, i], S[L.ENE, i], X[L.W_P, i]
    r1, m1, e1 = rho - d0, mom - d1, ene - d2
    r2, m2, e2 = rho + d0, mom + d1, ene + d2
    u1, u2 = m1 / r1, m2 / r2
    p1 = gm * (e1 - 0.5 * m1 * u1)
    p2 = gm * (e2 - 0.5 * m2 * u2)
    h = half / length
    f0 = h * (m1 - m2)
    f1 = h * (m1 * u1 + p1 - m2 * u2 - p2) + half * D[L.D_DRAG, i]
    f2 = h * (u1 * (e1 + p1) - u2 * (e2 + p2)) + half * D[L.D_WARM, i]
    r1 += f0
    r2 += f0
    m1 += f1
    m2 += f1
    u1, u2 = m1 / r1, m2 / r2
    p1 = gm * (e1 + f2 - 0.5 * m1 * u1)
    p2 = gm * (e2 + f2 - 0.5 * m2 * u2)
    if min(r1, r2) < 0.05 * rho or min(p1, p2) < 0.05 * p:
        r1 = r2 = rho
        u1 = u2 = mom / rho
        p1 = p2 = p
    X[L.W_RL, i], X[L.W_UL, i], X[L.W_PL, i], X[L.W_IL, i] = r1, u1, p1, 1.0 / r1
    X[L.W_RR, i], X[L.W_UR, i], X[L.W_PR, i], X[L.W_IR, i] = r2, u2, p2, 1.0 / r2


@folded
def _slope(i, near_left, near_right, van_leer, gm, half, cells):
    """Face states of a cell whose neighbours lie nearer or farther than its own length."""
    w, S = cells.lanes, cells.state
    a, b = near_left, near_right
    d0 = limited(a * (S[0, i] - S[0, i - w]), b * (S[0, i + w] - S[0, i]), van_leer)
    d1 = limited(a * (S[1, i] - S[1, i - w]), b * (S[1, i + w] - S[1, i]), van_leer)
    d2 = limited(a * (S[2, i] - S[2, i - w]), b * (S[2, i + w] - S[2, i]), van_leer)
    _evolve(i, cells.par[L.LENGTH, i], d0, d1, d2, gm, half, cells)


@branching
def reshape(gas, scheme, dt, cells, cylinders):
    """Face states of the two cells beside every piston, whose middles are not evenly spaced.

    Args:
        gas: The gas.
        scheme: How the equations are solved.
        dt: Step, s.
        cells: All slots.
        cylinders: Cylinders.
    """
    if scheme.order == 1:
        return
    w, gm, half = cells.lanes, gas.gamma - 1.0, 0.5 * dt
    van_leer = scheme.limiter == L.VAN_LEER
    for k in range(cylinders.table.shape[0]):
        for side in range(2):
            if cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_KIND] != L.GAS_CELLS:
                continue
            for j in range(w):
                i, _ = _last(k, side, j, cells, cylinders)
                if cylinders.state[k, L.SY_COUNT + side, j] < 2.0:
                    continue
                long, dx = cells.par[L.LENGTH, i], cells.par[L.LENGTH, i - w]
                apart = 0.5 * (long + dx)
                _slope(i, long / apart, 1.0, van_leer, gm, half, cells)
                _slope(i - w, 1.0, dx / apart, van_leer, gm, half, cells)


@branching
def squeeze(gas, dt, ports, chambers, cylinders):
    """Half a step of what pistons, ports and walls do to the pressure of the chambers of cylinders.

    The heat of their walls is given to them here, all of the step's. The pressure is added to the
    sums of `find_middle`, before these are divided.

    Args:
        gas: The gas.
        dt: Step, s.
        ports: Ports, with the flows of this step.
        chambers: Chambers.
        cylinders: Cylinders, with the speeds foreseen.
    """
    gm = gas.gamma - 1.0
    for k in range(cylinders.table.shape[0]):
        for side in range(2):
            if cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_KIND] != L.GAS_CHAMBER:
                continue
            c = cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_REF]
            for j in range(cylinders.work.shape[2]):
                sign = 1.0 if side == 0 else -1.0
                area = cylinders.par[k, L.PY_AREA + side, j]
                p = chambers.work[c, L.H_PRESSURE, j]
                volume = chambers.par[c, L.C_VOLUME, j]
                growth = sign * area * cylinders.work[k, L.WY_SPEED, j]
                gain = 0.0
                for q in range(ports.table.shape[0]):
                    if ports.table[q, L.P_A] == L.SIDE_CHAMBER and ports.table[q, L.P_AI] == c:
                        gain -= ports.flow[q, 1, j]
                    if ports.table[q, L.P_B] == L.SIDE_CHAMBER and ports.table[q, L.P_BI] == c:
                        gain += ports.flow[q, 1, j]
                rate = (gm * gain - gas.gamma * p * growth) / volume
                chambers.work[c, L.H_MIDDLE, j] += 0.5 * dt * rate
                conductance = cylinders.work[k, L.WY_HEAT + side, j]
                if conductance > 0.0:
                    t = chambers.work[c, L.H_TEMPERATURE, j]
                    heat, half = _warm(
                        c, j, conductance, -gm * t * growth / volume, gas, dt, chambers
                    )
                    chambers.work[c, L.H_MIDDLE, j] += p / t * half
                    chambers.state[c, 1, j] += heat


@folded
def _face(k, side, j, gas, order, dt, cells, chambers, cylinders):
    """Pressure of the gas on the piston at the middle of the step."""
    kind = cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_KIND]
    if kind == L.GAS_CHAMBER:
        return chambers.work[cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_REF], L.H_MIDDLE, j]
    if kind == L.GAS_ROOM:
        return cylinders.par[k, L.PY_ROOM_P, j]
    S, X = cells.state, cells.work
    i, sign = _last(k, side, j, cells, cylinders)
    wall = sign * cylinders.work[k, L.WY_SPEED, j]
    if order == 1:
        return wave_state(S[L.RHO, i], X[L.W_U, i], X[L.W_P, i], wall, gas.gamma)[1]
    # the face of the cell stands where the piston was; half a step later it is elsewhere
    on = 0.5 * dt * wall / cells.par[L.LENGTH, i]
    d = X[L.W_RR, i] + on * (X[L.W_RR, i] - X[L.W_RL, i])
    u = X[L.W_UR, i] + on * (X[L.W_UR, i] - X[L.W_UL, i])
    p = X[L.W_PR, i] + on * (X[L.W_PR, i] - X[L.W_PL, i])
    d, p = max(d, 0.05 * S[L.RHO, i]), max(p, 0.05 * X[L.W_P, i])
    return wave_state(d, u, p, wall, gas.gamma)[1]


@branching
def press(gas, order, dt, cells, chambers, cylinders):
    """Pressures of the gas on both sides of every piston, and the force on it.

    Args:
        gas: The gas.
        order: 1 Godunov, 2 MUSCL-Hancock.
        dt: Step, s.
        cells: All slots.
        chambers: Chambers, with the pressures at the middle of the step.
        cylinders: Cylinders, with the speeds foreseen.
    """
    par, work = cylinders.par, cylinders.work
    for k in range(cylinders.table.shape[0]):
        for j in range(cells.lanes):
            head = _face(k, 0, j, gas, order, dt, cells, chambers, cylinders)
            rod = _face(k, 1, j, gas, order, dt, cells, chambers, cylinders)
            work[k, L.WY_FACE, j] = head
            work[k, L.WY_FACE_ROD, j] = rod
            room = par[k, L.PY_ROOM_P, j]
            a, b = par[k, L.PY_AREA, j], par[k, L.PY_AREA_ROD, j]
            force = head * a - rod * b - room * (a - b)
            cylinders.state[k, L.SY_FORCE, j] = force
            cylinders.state[k, L.SY_IMPULSE, j] += dt * force


@folded
def _side_gas(k, side, j, cells, chambers, cylinders):
    """Pressure and temperature of the gas beside the piston."""
    kind = cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_KIND]
    if kind == L.GAS_CHAMBER:
        c = cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_REF]
        return chambers.work[c, L.H_PRESSURE, j], chambers.work[c, L.H_TEMPERATURE, j]
    if kind == L.GAS_CELLS:
        i, _ = _last(k, side, j, cells, cylinders)
        return cells.work[L.W_P, i], cells.work[L.W_T, i]
    return cylinders.par[k, L.PY_ROOM_P, j], cylinders.par[k, L.PY_ROOM_T, j]


@entry
def lean(cells, chambers, cylinders):
    """Force of gas and room on every piston by the pressures beside it, no wave being on its way.

    Args:
        cells: All slots, their pressures computed.
        chambers: Chambers, likewise.
        cylinders: Cylinders.
    """
    par, work = cylinders.par, cylinders.work
    for k in range(cylinders.table.shape[0]):
        for j in range(cells.lanes):
            for side in range(2):
                p, _ = _side_gas(k, side, j, cells, chambers, cylinders)
                work[k, L.WY_FACE + side, j] = p
            room = par[k, L.PY_ROOM_P, j]
            a, b = par[k, L.PY_AREA, j], par[k, L.PY_AREA_ROD, j]
            cylinders.state[k, L.SY_FORCE, j] = (
                work[k, L.WY_FACE, j] * a - work[k, L.WY_FACE_ROD, j] * b - room * (a - b)
            )


@folded
def _give(k, side, j, mass, heat, cells, chambers, cylinders):
    """Add mass and energy to the gas beside the piston."""
    kind = cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_KIND]
    if kind == L.GAS_CHAMBER:
        c = cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_REF]
        chambers.state[c, 0, j] += mass
        chambers.state[c, 1, j] += heat
    elif kind == L.GAS_CELLS:
        i, _ = _last(k, side, j, cells, cylinders)
        cells.state[L.RHO, i] += mass * cells.par[L.INV_VOLUME, i]
        cells.state[L.ENE, i] += heat * cells.par[L.INV_VOLUME, i]


@folded
def _seep(size, p, t, p_other, t_other, gas):
    """Mass flow, kg/s, and enthalpy flow, W, through a leak between two gases."""
    cp = gas.gamma * gas.r / (gas.gamma - 1.0)
    if p >= p_other:
        m = orifice_flow(p, t, p_other, size, gas.gamma, gas.r)
        return m, m * cp * t
    m = orifice_flow(p_other, t_other, p, size, gas.gamma, gas.r)
    return -m, -m * cp * t_other


@branching
def leak_past(gas, dt, cells, chambers, cylinders):
    """Gas that passes the seals of piston and rod.

    Args:
        gas: The gas.
        dt: Step, s.
        cells: All slots.
        chambers: Chambers.
        cylinders: Cylinders.
    """
    par = cylinders.par
    for k in range(cylinders.table.shape[0]):
        for j in range(cells.lanes):
            past, out = par[k, L.PY_LEAK, j], par[k, L.PY_ROD_LEAK, j]
            if past <= 0.0 and out <= 0.0:
                continue
            p, t = _side_gas(k, 1, j, cells, chambers, cylinders)
            if past > 0.0:
                p_head, t_head = _side_gas(k, 0, j, cells, chambers, cylinders)
                m, h = _seep(past, p_head, t_head, p, t, gas)
                _give(k, 0, j, -dt * m, -dt * h, cells, chambers, cylinders)
                _give(k, 1, j, dt * m, dt * h, cells, chambers, cylinders)
            if out > 0.0:
                p_room, t_room = par[k, L.PY_ROOM_P, j], par[k, L.PY_ROOM_T, j]
                m, h = _seep(out, p, t, p_room, t_room, gas)
                _give(k, 1, j, -dt * m, -dt * h, cells, chambers, cylinders)


@branching
def work_on_gas(dt, cells, chambers, cylinders):
    """Work of the pistons in this step: on chambers at once, on cells by the flux at their faces.

    Args:
        dt: Step, s.
        cells: All slots.
        chambers: Chambers.
        cylinders: Cylinders, with their ways in this step.
    """
    X = cells.work
    for k in range(cylinders.table.shape[0]):
        for side in range(2):
            kind = cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_KIND]
            c = cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_REF]
            for j in range(cells.lanes):
                sign = 1.0 if side == 0 else -1.0
                p = cylinders.work[k, L.WY_FACE + side, j]
                move = sign * cylinders.work[k, L.WY_MOVE, j]
                if kind == L.GAS_CHAMBER:
                    area = cylinders.par[k, L.PY_AREA + side, j]
                    chambers.state[c, 1, j] -= p * area * move
                elif kind == L.GAS_CELLS:
                    i, _ = _last(k, side, j, cells, cylinders)
                    X[L.W_FM, i] = 0.0
                    X[L.W_FP, i] = p
                    X[L.W_FE, i] = p * move / dt


@folded
def _copy_cell(i, g, cells):
    """Give a cell all that another remembers."""
    for row in range(L.STATE_ROWS):
        cells.state[row, g] = cells.state[row, i]
    for row in range(cells.work.shape[0]):
        cells.work[row, g] = cells.work[row, i]
    for row in range(L.WALL_ROWS):
        cells.wall[row, g] = cells.wall[row, i]


@folded
def _tilt(i, g, share, gm, cells):
    """Lean two halves of a cell as its face states do, so that a cut changes no slope.

    Args:
        i: The half on the left, of the whole's state.
        g: The half on the right, likewise.
        share: Length of the left half over that of the whole.
        gm: Ratio of specific heats less one.
        cells: All slots, with the face states of the whole.
    """
    S, X = cells.state, cells.work
    dl, ul, pl = X[L.W_RL, i], X[L.W_UL, i], X[L.W_PL, i]
    dr, ur, pr = X[L.W_RR, i], X[L.W_UR, i], X[L.W_PR, i]
    left, right = 0.5 * (1.0 - share), 0.5 * share  # of the way from face to face, to either side
    density = dr - dl
    momentum = dr * ur - dl * ul
    energy = (pr - pl) / gm + 0.5 * (dr * ur * ur - dl * ul * ul)
    for row, lean in ((L.RHO, density), (L.MOM, momentum), (L.ENE, energy)):
        S[row, i] -= left * lean
        S[row, g] += right * lean
    X[L.W_RI, i] = 1.0 / S[L.RHO, i]


@folded
def _stretch(k, side, j, order, gm, cells, cylinders):
    """Give the last cell its new length; cut it in two, or join it with its neighbour."""
    w, S, P = cells.lanes, cells.state, cells.par
    most = cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_CELLS]
    i, _ = _last(k, side, j, cells, cylinders)
    count = int(cylinders.state[k, L.SY_COUNT + side, j])
    area = cylinders.par[k, L.PY_AREA + side, j]
    dead = cylinders.par[k, L.PY_DEAD + side, j] / area
    dx = (dead + cylinders.par[k, L.PY_STROKE, j]) / most
    length = _volume(k, side, j, cylinders) / area - (count - 1) * dx
    scale = 1.0 / (P[L.INV_VOLUME, i] * area * length)
    for row in range(3):
        S[row, i] *= scale
    cells.work[L.W_RI, i] = 1.0 / S[L.RHO, i]
    if length > LONGEST * dx and count < most:
        g = i + w
        _copy_cell(i, g, cells)
        if order == 2:
            _tilt(i, g, dx / length, gm, cells)
        P[L.LENGTH, i] = dx
        P[L.INV_VOLUME, i] = 1.0 / (area * dx)
        i, length = g, length - dx
        count += 1
    elif length < dx and count > 1:
        g = i
        i -= w
        share = length / (dx + length)
        for row in range(L.STATE_ROWS):
            S[row, i] += share * (S[row, g] - S[row, i])
        P[L.LENGTH, g] = -1.0
        P[L.INV_VOLUME, g] = 0.0
        length += dx
        count -= 1
    # by the length itself, as `_lay` has it: a run may be cut here
    length = _volume(k, side, j, cylinders) / area - (count - 1) * dx
    P[L.LENGTH, i] = length
    P[L.INV_VOLUME, i] = 1.0 / (area * length)
    cells.work[L.W_RI, i] = 1.0 / S[L.RHO, i]
    cylinders.state[k, L.SY_COUNT + side, j] = count


@branching
def make_room(gas, order, cells, chambers, cylinders):
    """Volumes of the gas as the pistons now stand.

    Args:
        gas: The gas.
        order: 1 Godunov, 2 MUSCL-Hancock.
        cells: All slots.
        chambers: Chambers.
        cylinders: Cylinders, moved.
    """
    for k in range(cylinders.table.shape[0]):
        for side in range(2):
            kind = cylinders.table[k, L.COLUMNS_PER_SIDE * side + L.Y_KIND]
            for j in range(cells.lanes):
                if kind == L.GAS_CHAMBER:
                    _set_chamber(k, side, j, cylinders, chambers)
                elif kind == L.GAS_CELLS:
                    _stretch(k, side, j, order, gas.gamma - 1.0, cells, cylinders)
