# SPDX-License-Identifier: Apache-2.0
"""The hot loop of the lumped models: volumes that fill through ports, Runge-Kutta in time.

The pressure of a volume is what it started with plus what each side of a port has brought it. A
side's share is felt elsewhere in the volume after the travel time from there, so every share is
kept for as long as something still waits for it. Zero delays give the thin-plate model.
"""

import math

import numpy as np
from numpy.typing import NDArray

from pneu_sim.compiling import compiled

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LEAK_LINEAR = 0.999
"""Pressure ratio above which a leak's flow is linear in the pressure drop."""


@compiled
def flow_function(x: float, gamma: float) -> float:
    """Mass flow of an isentropic orifice over ``A p_u / sqrt(R T)`` (thesis eqs. 3.15-3.17).

    Args:
        x: Downstream over upstream pressure.
        gamma: Ratio of specific heats.
    """
    x = max(x, math.pow(2.0 / (gamma + 1.0), gamma / (gamma - 1.0)))
    root = math.pow(x, 1.0 / gamma)
    return math.sqrt(2.0 * gamma / (gamma - 1.0) * max(root * (root - x), 0.0))


@compiled
def port_flow(
    p_a: float,
    t_a: float,
    p_b: float,
    t_b: float,
    area: float,
    linear: float,
    gamma: float,
    r_gas: float,
) -> float:
    """Mass flow through an isentropic orifice, either way.

    Args:
        p_a: Pressure of side a, Pa.
        t_a: Temperature of side a, K.
        p_b: Pressure of side b, Pa.
        t_b: Temperature of side b, K.
        area: Effective area, m^2.
        linear: Pressure ratio above which the flow is linear in the pressure drop.
        gamma: Ratio of specific heats.
        r_gas: Specific gas constant, J/(kg K).

    Returns:
        Mass flow in kg/s, positive from a to b.
    """
    if area <= 0.0:
        return 0.0
    sign = 1.0
    if p_b > p_a:
        p_a, p_b = p_b, p_a
        t_a = t_b
        sign = -1.0
    x = p_b / p_a
    if x > linear:
        psi = flow_function(linear, gamma) * (1.0 - x) / (1.0 - linear)
    else:
        psi = flow_function(x, gamma)
    return sign * area * p_a / math.sqrt(r_gas * t_a) * psi


@compiled
def _pressure(
    v: int,
    delay: Floats,
    side: Ints,
    base: Floats,
    y: Floats,
    y0: Floats,
    ahead: float,
    h: float,
    ring: Floats,
    head: int,
) -> float:
    """Pressure of volume v at a point that each side's share reaches after its delay.

    ``ahead`` is how far ``y`` is past ``y0``, whose shares are at ``head`` of the ring.
    """
    n_sides = side.size
    p = base[v] + y[n_sides + v]
    for k in range(n_sides):
        if side[k] != v:
            continue
        d = delay[k]
        if d <= 0.0:
            p += y[k]
        elif d < ahead:
            p += y0[k] + (y[k] - y0[k]) * (ahead - d) / ahead
        else:
            back = (d - ahead) / h
            i = int(back)
            f = back - i
            size = ring.shape[0]
            p += (1.0 - f) * ring[(head - i) % size, k] + f * ring[(head - i - 1) % size, k]
    return p


@compiled
def _bulk(v: int, side: Ints, base: Floats, y: Floats) -> float:
    """Pressure that volume v has once all that entered it has spread."""
    p = base[v] + y[side.size + v]
    for k in range(side.size):
        if side[k] == v:
            p += y[k]
    return float(p)


@compiled
def _temperature(
    v: int, r_gas: float, volume: Floats, side: Ints, base: Floats, y: Floats
) -> float:
    """Temperature of the gas in volume v, from its pressure and mass."""
    p = _bulk(v, side, base, y)
    size = volume[v, 0] + volume[v, 1] * (p - volume[v, 2])
    return float(p * size / (y[side.size + base.size + v] * r_gas))


@compiled
def _rates(
    y: Floats,
    y0: Floats,
    ahead: float,
    h: float,
    ring: Floats,
    head: int,
    opening: Floats,
    goal: Floats,
    nudge_rate: float,
    gamma: float,
    r_gas: float,
    exponent: float,
    sound: float,
    side: Ints,
    area: Floats,
    linear: Floats,
    source: Floats,
    volume: Floats,
    tap: Ints,
    tap_delay: Floats,
    side_delay: Floats,
    drag: Floats,
    room: Floats,
    base: Floats,
    flow: Floats,
    out: Floats,
) -> None:
    """Rates of change of all shares, of the volumes' common shares and of their masses."""
    n_sides = side.size
    n_volumes = base.size
    # Of the enthalpy that enters, the wall sets the isothermal part (see thin_plate).
    own = min((exponent - 1.0) / (gamma - 1.0), 1.0)
    out[:] = 0.0
    for q in range(area.size):
        a, b = 2 * q, 2 * q + 1
        va, vb = side[a], side[b]
        if va >= 0:
            p_a = _pressure(va, side_delay[a], side, base, y, y0, ahead, h, ring, head)
            t_a = _temperature(va, r_gas, volume, side, base, y)
        else:
            p_a, t_a = source[-1 - va, 0], source[-1 - va, 1]
        if vb >= 0:
            p_b = _pressure(vb, side_delay[b], side, base, y, y0, ahead, h, ring, head)
            t_b = _temperature(vb, r_gas, volume, side, base, y)
        else:
            p_b, t_b = source[-1 - vb, 0], source[-1 - vb, 1]
        m = port_flow(p_a, t_a, p_b, t_b, area[q] * opening[q], linear[q], gamma, r_gas)
        flow[q] = m
        for k in (a, b):
            v = side[k]
            if v < 0:
                continue
            p = p_a if k == a else p_b
            into = -m if k == a else m
            lost = max(drag[k, 0], drag[k, 1] * abs(m) ** 0.75)
            into *= math.exp(-lost * r_gas * room[1] / (2.0 * p * sound))
            if into > 0.0:
                t = own * (t_b if k == a else t_a) + (1.0 - own) * room[1]
            else:
                t = t_a if k == a else t_b
            size = volume[v, 0] + volume[v, 1] * (p - volume[v, 2])
            out[k] = exponent * r_gas * t * into / (size + exponent * p * volume[v, 1])
            out[n_sides + n_volumes + v] += into
    for v in range(n_volumes):
        p = _bulk(v, side, base, y)
        t = _temperature(v, r_gas, volume, side, base, y)
        leak = port_flow(p, t, room[0], room[1], volume[v, 3], LEAK_LINEAR, gamma, r_gas)
        leak += volume[v, 4] * (p - room[0]) * (p + room[0])
        for k in range(5, volume.shape[1], 3):
            if p > volume[v, k + 1] and p > room[0] and volume[v, k] > 0.0:
                open_area = volume[v, k] * min((p - volume[v, k + 1]) / volume[v, k + 2], 1.0)
                leak += port_flow(p, t, room[0], room[1], open_area, LEAK_LINEAR, gamma, r_gas)
        carried = t if leak > 0.0 else room[1]
        size = volume[v, 0] + volume[v, 1] * (p - volume[v, 2])
        rise = -exponent * r_gas * carried * leak / (size + exponent * p * volume[v, 1])
        mass = -leak
        if nudge_rate > 0.0:
            error = 0.0
            count = 0
            for i in range(tap.size):
                if tap[i] == v and goal[i] > 0.0:
                    error += goal[i] - _pressure(
                        v, tap_delay[i], side, base, y, y0, ahead, h, ring, head
                    )
                    count += 1
            if count > 0:
                pull = nudge_rate * error / count
                rise += pull
                mass += pull * (size + p * volume[v, 1]) / (r_gas * t)
        out[n_sides + v] = rise
        out[n_sides + n_volumes + v] += mass


@compiled
def _step(
    y: Floats,
    y0: Floats,
    y1: Floats,
    h: float,
    ring: Floats,
    head: int,
    opening: Floats,
    begin: float,
    width: float,
    now: Floats,
    goal: Floats,
    nudge_rate: float,
    goal_left: Floats,
    goal_right: Floats,
    goal_begin: float,
    goal_width: float,
    gamma: float,
    r_gas: float,
    exponent: float,
    sound: float,
    side: Ints,
    area: Floats,
    linear: Floats,
    source: Floats,
    volume: Floats,
    tap: Ints,
    tap_delay: Floats,
    side_delay: Floats,
    drag: Floats,
    room: Floats,
    base: Floats,
    flow: Floats,
    rate: Floats,
) -> int:
    """One Runge-Kutta step of all shares in place; returns the ring's new head.

    ``opening`` is read from knot ``begin`` to ``begin + width``; the goals that the volumes are
    drawn to lie between the two given, from ``goal_begin`` to ``goal_begin + goal_width``.
    """
    y0[:] = y
    y1[:] = y
    for stage in range(4):
        part = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
        x = begin + part * width
        i = min(int(x), opening.shape[0] - 2)
        for q in range(now.size):
            now[q] = opening[i, q] + (x - i) * (opening[i + 1, q] - opening[i, q])
        if nudge_rate > 0.0:
            f = goal_begin + part * goal_width
            for t in range(tap.size):
                goal[t] = (1.0 - f) * goal_left[t] + f * goal_right[t]
        _rates(
            y, y0, part * h, h, ring, head, now, goal, nudge_rate, gamma, r_gas, exponent,
            sound, side, area, linear, source, volume, tap, tap_delay, side_delay,
            drag, room, base, flow, rate,
        )  # fmt: skip
        weight = h / 6.0 if stage in (0, 3) else h / 3.0
        ahead = h if stage == 2 else 0.5 * h
        for i in range(y.size):
            y1[i] += weight * rate[i]
            y[i] = y0[i] + ahead * rate[i]
    y[:] = y1
    head = (head + 1) % ring.shape[0]
    ring[head] = y[: side.size]
    return head


@compiled
def longest_delay(side: Ints, tap: Ints, tap_delay: Floats, side_delay: Floats) -> float:
    """Longest travel time that a model asks for, s.

    Args:
        side: (2 n_ports,) place of each side.
        tap: (n_taps,) place of each tap.
        tap_delay: (n_taps, 2 n_ports) travel times, s.
        side_delay: (2 n_ports, 2 n_ports) travel times, s.
    """
    longest = 0.0
    for k in range(side.size):
        for i in range(side.size):
            longest = max(longest, side_delay[i, k])
        for i in range(tap.size):
            longest = max(longest, tap_delay[i, k])
    return longest


@compiled
def begin_volumes(
    base: Floats, volume: Floats, n_sides: int, r_gas: float, room: Floats, y: Floats
) -> None:
    """Shares of volumes that stand at rest at the room's temperature.

    Args:
        base: (n_volumes,) initial pressures, Pa.
        volume: (n_volumes, 5 + 3 n) see ``LumpedModel``.
        n_sides: Sides of ports.
        r_gas: Specific gas constant, J/(kg K).
        room: (2,) pressure and temperature of the room.
        y: (n_sides + 2 n_volumes,) the shares, written.
    """
    y[:] = 0.0
    for v in range(base.size):
        size = volume[v, 0] + volume[v, 1] * (base[v] - volume[v, 2])
        y[n_sides + base.size + v] = base[v] * size / (r_gas * room[1])


@compiled
def advance_volumes(
    n_sub: int,
    h: float,
    gamma: float,
    r_gas: float,
    exponent: Floats,
    side: Ints,
    area: Floats,
    linear: Floats,
    source: Floats,
    volume: Floats,
    tap: Ints,
    tap_delay: Floats,
    side_delay: Floats,
    drag: Floats,
    room: Floats,
    base: Floats,
    opening: Floats,
    y: Floats,
    ring: Floats,
    head: Ints,
    tap_out: Floats,
) -> None:
    """Advances models side by side over the knots of their openings and tells their taps.

    Args:
        n_sub: Steps in all.
        h: Step, s.
        gamma: Ratio of specific heats.
        r_gas: Specific gas constant, J/(kg K).
        exponent: (lanes,) polytropic exponents; in what follows lanes come first likewise.
        side: (2 n_ports,) place of each side, alike for all lanes.
        area: (lanes, n_ports) effective areas fully open, m^2.
        linear: (lanes, n_ports) pressure ratios above which flow is linear.
        source: (lanes, n_sources, 2) pressure, Pa, and temperature, K.
        volume: (lanes, n_volumes, 5 + 3 n) see ``LumpedModel``.
        tap: (n_taps,) place of each tap, alike for all lanes.
        tap_delay: (lanes, n_taps, 2 n_ports) travel times, s.
        side_delay: (lanes, 2 n_ports, 2 n_ports) travel times, s.
        drag: (lanes, 2 n_ports, 2) laminar and turbulent resistance times length.
        room: (lanes, 2) pressure and temperature of the room.
        base: (lanes, n_volumes) initial pressures, Pa.
        opening: (knots, n_ports, lanes) openings, evenly spaced from now to the end.
        y: (lanes, 2 n_ports + 2 n_volumes) shares, changed in place.
        ring: (lanes, steps, 2 n_ports) past shares, changed in place.
        head: (lanes,) newest row of those, changed in place.
        tap_out: (lanes, n_taps) pressures at the end.
    """
    n_y = y.shape[1]
    y0, y1, rate = np.zeros(n_y), np.zeros(n_y), np.zeros(n_y)
    now = np.zeros(area.shape[1])
    flow = np.zeros(area.shape[1])
    goal = np.full(tap.size, np.nan)
    width = (opening.shape[0] - 1) / n_sub
    for j in range(area.shape[0]):
        sound = math.sqrt(gamma * r_gas * room[j, 1])
        opened = np.ascontiguousarray(opening[:, :, j])
        for s in range(n_sub):
            head[j] = _step(
                y[j], y0, y1, h, ring[j], head[j], opened, s * width, width, now, goal, 0.0,
                goal, goal, 0.0, 0.0, gamma, r_gas, exponent[j], sound, side, area[j], linear[j],
                source[j], volume[j], tap, tap_delay[j], side_delay[j], drag[j], room[j], base[j],
                flow, rate,
            )  # fmt: skip
        y0[:] = y[j]
        for t in range(tap.size):
            if tap[t] < 0:
                tap_out[j, t] = source[j, -1 - tap[t], 0]
            else:
                tap_out[j, t] = _pressure(
                    tap[t], tap_delay[j, t], side, base[j], y[j], y0, 0.0, h, ring[j], head[j]
                )


@compiled
def fill(
    n_out: int,
    n_sub: int,
    h: float,
    knots: int,
    gamma: float,
    r_gas: float,
    exponent: float,
    side: Ints,
    area: Floats,
    linear: Floats,
    source: Floats,
    volume: Floats,
    tap: Ints,
    chamber: Ints,
    tap_delay: Floats,
    side_delay: Floats,
    drag: Floats,
    room: Floats,
    starts: Ints,
    base: Floats,
    opening: Floats,
    nudge_n: int,
    nudge_rate: float,
    goals: Floats,
    tap_out: Floats,
    flow_out: Floats,
    chamber_out: Floats,
) -> None:
    """Rolls one model out from every start and records its taps.

    Args:
        n_out: Samples per roll-out; sample 0 is the initial state.
        n_sub: Steps between samples.
        h: Step, s.
        knots: Opening knots per sample interval.
        gamma: Ratio of specific heats.
        r_gas: Specific gas constant, J/(kg K).
        exponent: Polytropic exponent of the volumes.
        side: (2 n_ports,) place of each side: a volume, or -1 - source.
        area: (n_ports,) effective areas fully open, m^2.
        linear: (n_ports,) pressure ratios above which flow is linear.
        source: (n_sources, 2) pressure, Pa, and temperature, K.
        volume: (n_volumes, 5 + 3 n) see ``LumpedModel``.
        tap: (n_taps,) place of each tap.
        chamber: (n_chambers,) place of each chamber.
        tap_delay: (n_taps, 2 n_ports) travel times, s.
        side_delay: (2 n_ports, 2 n_ports) travel times, s.
        drag: (2 n_ports, 2) laminar and turbulent resistance times length.
        room: (2,) pressure and temperature of the room and of every wall.
        starts: (n_starts,) first sample of each roll-out.
        base: (n_starts, n_volumes) initial pressures, Pa.
        opening: ((T - 1) * knots + 1, n_ports) opening fractions along the recording.
        nudge_n: Samples during which the volumes are drawn to their taps.
        nudge_rate: Rate of that pull, 1/s.
        goals: (T, n_taps) measured pressures, NaN where there are none.
        tap_out: (n_starts, n_out, n_taps) recorded pressures.
        flow_out: (n_starts, n_out, n_ports) recorded flows, kg/s.
        chamber_out: (n_starts, n_out, n_chambers) recorded pressures.
    """
    n_sides = side.size
    n_volumes = base.shape[1]
    n_ports = area.size
    n_y = n_sides + 2 * n_volumes
    sound = math.sqrt(gamma * r_gas * room[1])
    longest = longest_delay(side, tap, tap_delay, side_delay)
    ring = np.zeros((int(longest / h) + 3, n_sides))
    y = np.zeros(n_y)
    y0 = np.zeros(n_y)
    y1 = np.zeros(n_y)
    rate = np.zeros(n_y)
    now = np.zeros(n_ports)
    goal = np.full(tap.size, np.nan)
    flow = np.zeros(n_ports)
    for j in range(starts.size):
        ring[:] = 0.0
        head = 0
        begin_volumes(base[j], volume, n_sides, r_gas, room, y)
        for k in range(n_out):
            i = min((starts[j] + k) * knots, opening.shape[0] - 1)
            _rates(
                y, y, 0.0, h, ring, head, opening[i], goal, 0.0, gamma, r_gas, exponent,
                sound, side, area, linear, source, volume, tap, tap_delay, side_delay,
                drag, room, base[j], flow, rate,
            )  # fmt: skip
            for t in range(tap.size):
                if tap[t] < 0:
                    tap_out[j, k, t] = source[-1 - tap[t], 0]
                else:
                    tap_out[j, k, t] = _pressure(
                        tap[t], tap_delay[t], side, base[j], y, y, 0.0, h, ring, head
                    )
            for q in range(n_ports):
                flow_out[j, k, q] = flow[q]
            for c in range(chamber.size):
                if chamber[c] < 0:
                    chamber_out[j, k, c] = source[-1 - chamber[c], 0]
                else:
                    chamber_out[j, k, c] = _bulk(chamber[c], side, base[j], y)
            if k == n_out - 1:
                break
            pull = nudge_rate if k < nudge_n else 0.0
            g = min(starts[j] + k, goals.shape[0] - 1)
            following = min(g + 1, goals.shape[0] - 1)
            for s in range(n_sub):
                head = _step(
                    y, y0, y1, h, ring, head, opening, (starts[j] + k + s / n_sub) * knots,
                    knots / n_sub, now, goal, pull, goals[g], goals[following], s / n_sub,
                    1.0 / n_sub, gamma, r_gas, exponent, sound, side, area, linear, source, volume,
                    tap, tap_delay, side_delay, drag, room, base[j], flow, rate,
                )  # fmt: skip
