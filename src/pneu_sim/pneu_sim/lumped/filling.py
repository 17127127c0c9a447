# SPDX-License-Identifier: Apache-2.0
"""The hot loop of the lumped models: volumes that fill through ports, Runge-Kutta in time.

The pressure of a volume is what it started with plus what each side of a port has brought it. A
side's share is felt elsewhere in the volume after the travel time from there, so every share is
kept for as long as something still waits for it. Zero delays give the thin-plate model.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pneu_sim import layout as L
from pneu_sim.compiling import branching, entry, folded
from pneu_sim.kernel.regulators import fill_opening, regulate, vent_opening
from pneu_sim.lumped.model import (
    RELIEF_COLUMNS,
    V_COMPLIANCE,
    V_LEAK,
    V_POROUS,
    V_REST_P,
    V_VOLUME,
    VOLUME_COLUMNS,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LEAK_LINEAR = 0.999
"""Pressure ratio above which a leak's flow is linear in the pressure drop."""


@folded
def flow_function(x: float, gamma: float) -> float:
    """Mass flow of an isentropic orifice over ``A p_u / sqrt(R T)`` (thesis eqs. 3.15-3.17).

    Args:
        x: Downstream over upstream pressure.
        gamma: Ratio of specific heats.
    """
    x = max(x, math.pow(2.0 / (gamma + 1.0), gamma / (gamma - 1.0)))
    root = math.pow(x, 1.0 / gamma)
    return math.sqrt(2.0 * gamma / (gamma - 1.0) * max(root * (root - x), 0.0))


@entry
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


class Volumes(NamedTuple):
    """Rigs reduced to volumes and sources, see ``LumpedModel``; of one of them without the lanes.

    Attributes:
        gamma: Ratio of specific heats.
        r_gas: Specific gas constant, J/(kg K).
        exponent: (lanes,) polytropic exponents.
        side: (2 n_ports,) place of each side, alike for all.
        area: (lanes, n_ports) effective areas fully open, m^2.
        linear: (lanes, n_ports) pressure ratios above which flow is linear.
        source: (lanes, n_sources, 2) pressure, Pa, and temperature, K.
        volume: (lanes, n_volumes, 5 + 3 n) volumes and what leaks from them.
        tap: (n_taps,) place of each tap, alike for all.
        chamber: (n_chambers,) place of each chamber, alike for all.
        tap_delay: (lanes, n_taps, 2 n_ports) travel times, s.
        side_delay: (lanes, 2 n_ports, 2 n_ports) travel times, s.
        drag: (lanes, 2 n_ports, 2) laminar and turbulent resistance times length.
        room: (lanes, 2) pressure and temperature of the room and of every wall.
        regulated: (n_regulators, REG_COLUMNS) ports of regulators, alike for all.
        regulator: (lanes, n_regulators, REG_PARAMS) their numbers.
    """

    gamma: float
    r_gas: float
    exponent: Floats
    side: Ints
    area: Floats
    linear: Floats
    source: Floats
    volume: Floats
    tap: Ints
    chamber: Ints
    tap_delay: Floats
    side_delay: Floats
    drag: Floats
    room: Floats
    regulated: Ints
    regulator: Floats


class Shares(NamedTuple):
    """What the sides of ports have brought to the volumes; of one rig without the lanes.

    Attributes:
        base: (lanes, n_volumes) initial pressures, Pa.
        now: (lanes, 2 n_ports + 2 n_volumes) pressures that each side has brought, those that all
            of a volume have in common, Pa, and masses, kg.
        past: (lanes, steps, 2 n_ports) what sides had brought, step by step, a ring.
        head: (lanes, 1) newest row of that.
        opening: (lanes, n_ports) of the ports at this moment; NaN before any has been told.
        regulator: (lanes, n_regulators, REG_STATE) where the regulators stand.
    """

    base: Floats
    now: Floats
    past: Floats
    head: Ints
    opening: Floats
    regulator: Floats


class Goals(NamedTuple):
    """What volumes are drawn to.

    Attributes:
        pressure: (lanes, intervals + 1, n_taps) Pa, linear between, NaN where there is none; no
            rows where nothing is drawn.
        rate: 1/s.
    """

    pressure: Floats
    rate: float


class Scratch(NamedTuple):
    """Scratch of a step of one rig.

    Attributes:
        before: Shares at its beginning.
        after: Shares at its end, so far.
        rate: Their rates of change.
        opening: (n_ports,) at a stage.
        flow: (n_ports,) kg/s at a stage.
        goal: (n_taps,) at a stage.
    """

    before: Floats
    after: Floats
    rate: Floats
    opening: Floats
    flow: Floats
    goal: Floats


@folded
def _one(rigs: Volumes, j: int) -> Volumes:
    """One rig of several."""
    return Volumes(
        rigs.gamma, rigs.r_gas, rigs.exponent[j], rigs.side, rigs.area[j], rigs.linear[j],
        rigs.source[j], rigs.volume[j], rigs.tap, rigs.chamber, rigs.tap_delay[j],
        rigs.side_delay[j], rigs.drag[j], rigs.room[j], rigs.regulated, rigs.regulator[j],
    )  # fmt: skip


@folded
def _felt(
    v: int, delay: Floats, rig: Volumes, shares: Shares, before: Floats, ahead: float, h: float
) -> float:
    """Pressure of volume v at a point that each side's share reaches after its delay.

    The shares are ``ahead`` past those before, which are at the head of the ring, ``h`` apart.
    """
    side, now, ring, head = rig.side, shares.now, shares.past, shares.head[0]
    p = shares.base[v] + now[side.size + v]
    for k in range(side.size):
        if side[k] != v:
            continue
        d = delay[k]
        if d <= 0.0:
            p += now[k]
        elif d < ahead:
            p += before[k] + (now[k] - before[k]) * (ahead - d) / ahead
        else:
            back = (d - ahead) / h
            i = int(back)
            f = back - i
            size = ring.shape[0]
            p += (1.0 - f) * ring[(head - i) % size, k] + f * ring[(head - i - 1) % size, k]
    return p


@folded
def _bulk(v: int, rig: Volumes, shares: Shares) -> float:
    """Pressure that volume v has once all that entered it has spread."""
    side = rig.side
    p = shares.base[v] + shares.now[side.size + v]
    for k in range(side.size):
        if side[k] == v:
            p += shares.now[k]
    return float(p)


@folded
def _size(row: Floats, p: float) -> float:
    """Size of a volume at a pressure, m^3."""
    return float(row[V_VOLUME] + row[V_COMPLIANCE] * (p - row[V_REST_P]))


@folded
def _temperature(v: int, rig: Volumes, shares: Shares) -> float:
    """Temperature of the gas in volume v, from its pressure and mass."""
    p = _bulk(v, rig, shares)
    mass = shares.now[rig.side.size + shares.base.size + v]
    return float(p * _size(rig.volume[v], p) / (mass * rig.r_gas))


@folded
def _at_side(
    k: int, rig: Volumes, shares: Shares, before: Floats, ahead: float, h: float
) -> tuple[float, float]:
    """Pressure and temperature at one side of a port."""
    v = rig.side[k]
    if v < 0:
        return rig.source[-1 - v, 0], rig.source[-1 - v, 1]
    p = _felt(v, rig.side_delay[k], rig, shares, before, ahead, h)
    return p, _temperature(v, rig, shares)


@branching
def _through_ports(
    rig: Volumes, shares: Shares, scratch: Scratch, sound: float, ahead: float, h: float
) -> None:
    """What flows through the ports, and what that brings to both sides."""
    gamma, r_gas, exponent, wall = rig.gamma, rig.r_gas, rig.exponent, rig.room[1]
    masses = rig.side.size + shares.base.size
    # Of the enthalpy that enters, the wall sets the isothermal part (see thin_plate).
    own = min(float((exponent - 1.0) / (gamma - 1.0)), 1.0)
    for q in range(rig.area.size):
        a, b = 2 * q, 2 * q + 1
        p_a, t_a = _at_side(a, rig, shares, scratch.before, ahead, h)
        p_b, t_b = _at_side(b, rig, shares, scratch.before, ahead, h)
        area = rig.area[q] * scratch.opening[q]
        m = port_flow(p_a, t_a, p_b, t_b, area, rig.linear[q], gamma, r_gas)
        scratch.flow[q] = m
        for k in (a, b):
            v = rig.side[k]
            if v < 0:
                continue
            p = p_a if k == a else p_b
            into = -m if k == a else m
            laminar, turbulent = float(rig.drag[k, 0]), float(rig.drag[k, 1])
            lost = max(laminar, turbulent * abs(m) ** 0.75)
            into *= math.exp(-lost * r_gas * wall / (2.0 * p * sound))
            if into > 0.0:
                t = own * (t_b if k == a else t_a) + (1.0 - own) * wall
            else:
                t = t_a if k == a else t_b
            row = rig.volume[v]
            yielding = exponent * p * row[V_COMPLIANCE]
            scratch.rate[k] = exponent * r_gas * t * into / (_size(row, p) + yielding)
            scratch.rate[masses + v] += into


@folded
def _leaked(row: Floats, p: float, t: float, rig: Volumes) -> float:
    """What leaves a volume for the room, kg/s."""
    room, r_gas = rig.room, rig.r_gas
    leak = port_flow(p, t, room[0], room[1], row[V_LEAK], LEAK_LINEAR, rig.gamma, r_gas)
    leak += row[V_POROUS] * (p - room[0]) * (p + room[0])
    for k in range(VOLUME_COLUMNS, row.size, RELIEF_COLUMNS):
        if p > row[k + 1] and p > room[0] and row[k] > 0.0:
            area = row[k] * min((p - row[k + 1]) / row[k + 2], 1.0)
            leak += port_flow(p, t, room[0], room[1], area, LEAK_LINEAR, rig.gamma, r_gas)
    return float(leak)


@folded
def _regulate(
    at: float, h: float, opening: Floats, lane: int, rig: Volumes, shares: Shares, scratch: Scratch
) -> None:
    """Moves the regulators on by a step; they see the pressures at its beginning."""
    knots = opening.shape[0] - 1
    i = min(int(at * knots), knots - 1)
    for k in range(rig.regulated.shape[0]):
        fill = rig.regulated[k, L.REG_FILL]
        change = opening[i + 1, fill, lane] - opening[i, fill, lane]
        share = opening[i, fill, lane] + (at * knots - i) * change
        p, _ = _at_side(2 * fill + 1, rig, shares, scratch.before, 0.0, h)
        regulate(p, share, h, rig.regulator[k], shares.regulator[k])


@folded
def _open_regulated(rig: Volumes, shares: Shares, scratch: Scratch) -> None:
    """Openings of the regulators' ports as they stand."""
    for k in range(rig.regulated.shape[0]):
        par, state = rig.regulator[k], shares.regulator[k]
        scratch.opening[rig.regulated[k, L.REG_FILL]] = fill_opening(par, state)
        scratch.opening[rig.regulated[k, L.REG_VENT]] = vent_opening(par, state)


@branching
def _rates(
    rig: Volumes,
    shares: Shares,
    scratch: Scratch,
    sound: float,
    pull: float,
    ahead: float,
    h: float,
) -> None:
    """Rates of change of all shares, of the volumes' common shares and of their masses."""
    n_sides, n_volumes = rig.side.size, shares.base.size
    scratch.rate[:] = 0.0
    _through_ports(rig, shares, scratch, sound, ahead, h)
    for v in range(n_volumes):
        row = rig.volume[v]
        p = _bulk(v, rig, shares)
        t = _temperature(v, rig, shares)
        leak = _leaked(row, p, t, rig)
        carried = t if leak > 0.0 else rig.room[1]
        size = _size(row, p)
        yielding = p * row[V_COMPLIANCE]
        rise = -rig.exponent * rig.r_gas * carried * leak / (size + rig.exponent * yielding)
        mass = -leak
        if pull > 0.0:
            error = 0.0
            count = 0
            for i in range(rig.tap.size):
                if rig.tap[i] == v and scratch.goal[i] > 0.0:
                    delay = rig.tap_delay[i]
                    seen = _felt(v, delay, rig, shares, scratch.before, ahead, h)
                    error += scratch.goal[i] - seen
                    count += 1
            if count > 0:
                drawn = pull * error / count
                rise += drawn
                mass += drawn * (size + yielding) / (rig.r_gas * t)
        scratch.rate[n_sides + v] = rise
        scratch.rate[n_sides + n_volumes + v] += mass


@branching
def _step(
    s: int,
    n_sub: int,
    h: float,
    rig: Volumes,
    shares: Shares,
    scratch: Scratch,
    sound: float,
    opening: Floats,
    lane: int,
    pull: float,
    goals: Floats,
) -> None:
    """One Runge-Kutta step of all shares, the s-th of an interval.

    Openings are given at the knots of the interval, goals at its ends.
    """
    now, before, after = shares.now, scratch.before, scratch.after
    for i in range(now.size):
        before[i] = now[i]
        after[i] = now[i]
    knots = opening.shape[0] - 1
    _regulate((s + 0.5) / n_sub, h, opening, lane, rig, shares, scratch)
    for stage in range(4):
        part = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
        at = (s + part) / n_sub
        i = min(int(at * knots), knots - 1)
        for q in range(scratch.opening.size):
            change = opening[i + 1, q, lane] - opening[i, q, lane]
            scratch.opening[q] = opening[i, q, lane] + (at * knots - i) * change
        _open_regulated(rig, shares, scratch)
        if pull > 0.0:
            for t in range(rig.tap.size):
                scratch.goal[t] = (1.0 - at) * goals[0, t] + at * goals[1, t]
        _rates(rig, shares, scratch, sound, pull, part * h, h)
        weight = h / 6.0 if stage in (0, 3) else h / 3.0
        ahead = h if stage == 2 else 0.5 * h
        for i in range(now.size):
            after[i] += weight * scratch.rate[i]
            now[i] = before[i] + ahead * scratch.rate[i]
    for i in range(now.size):
        now[i] = after[i]
    shares.head[0] = (shares.head[0] + 1) % shares.past.shape[0]
    for i in range(rig.side.size):
        shares.past[shares.head[0], i] = now[i]


@branching
def _write_down(
    k: int, j: int, h: float, rig: Volumes, shares: Shares, scratch: Scratch, taps: Floats,
    flows: Floats, chambers: Floats,
) -> None:  # fmt: skip
    """Pressures at taps and in chambers, and flows of ports, as sample k of rig j."""
    for i in range(rig.tap.size):
        v = rig.tap[i]
        if v < 0:
            taps[k, i, j] = rig.source[-1 - v, 0]
        else:
            taps[k, i, j] = _felt(v, rig.tap_delay[i], rig, shares, shares.now, 0.0, h)
    for q in range(rig.area.size):
        flows[k, q, j] = scratch.flow[q]
    for c in range(rig.chamber.size):
        v = rig.chamber[c]
        chambers[k, c, j] = rig.source[-1 - v, 0] if v < 0 else _bulk(v, rig, shares)


@entry
def begin_volumes(rigs: Volumes, shares: Shares) -> None:
    """Shares of volumes that stand at rest at the room's temperature.

    Args:
        rigs: The rigs.
        shares: Their initial pressures are given, the rest is written.
    """
    shares.now[:] = 0.0
    shares.past[:] = 0.0
    shares.head[:] = 0
    shares.opening[:] = np.nan
    shares.regulator[:] = 0.0
    masses = rigs.side.size + shares.base.shape[1]
    for j in range(shares.base.shape[0]):
        for v in range(shares.base.shape[1]):
            p = shares.base[j, v]
            size = _size(rigs.volume[j, v], p)
            shares.now[j, masses + v] = p * size / (rigs.r_gas * rigs.room[j, 1])


@entry
def advance_volumes(
    rigs: Volumes,
    shares: Shares,
    scratch: Scratch,
    n_sub: int,
    h: float,
    opening: Floats,
    goals: Goals,
    taps: Floats,
    flows: Floats,
    chambers: Floats,
) -> None:
    """Advances rigs side by side and records them, the present state first.

    Args:
        rigs: The rigs.
        shares: What has been brought to their volumes, changed in place.
        scratch: Scratch.
        n_sub: Steps in an interval.
        h: Step, s.
        opening: (intervals, knots + 1, n_ports, lanes) openings, linear from knot to knot.
        goals: What volumes are drawn to.
        taps: (intervals + 1, n_taps, lanes) pressures, Pa.
        flows: (intervals + 1, n_ports, lanes) kg/s.
        chambers: (intervals + 1, n_chambers, lanes) pressures, Pa.
    """
    intervals = opening.shape[0]
    drawn = goals.pressure.shape[1] > 0
    pull = goals.rate if drawn else 0.0
    for j in range(rigs.area.shape[0]):
        rig = _one(rigs, j)
        own = Shares(
            shares.base[j],
            shares.now[j],
            shares.past[j],
            shares.head[j],
            shares.opening[j],
            shares.regulator[j],
        )
        sound = math.sqrt(rig.gamma * rig.r_gas * rig.room[1])
        for q in range(own.opening.size):
            if intervals > 0 and math.isnan(own.opening[q]):
                own.opening[q] = opening[0, 0, q, j]
        for k in range(intervals + 1):
            for q in range(own.opening.size):
                scratch.opening[q] = 0.0 if math.isnan(own.opening[q]) else own.opening[q]
            _open_regulated(rig, own, scratch)
            for i in range(own.now.size):
                scratch.before[i] = own.now[i]
            _rates(rig, own, scratch, sound, 0.0, 0.0, h)
            _write_down(k, j, h, rig, own, scratch, taps, flows, chambers)
            if k == intervals:
                break
            aims = k if drawn else 0
            for s in range(n_sub):
                _step(
                    s, n_sub, h, rig, own, scratch, sound, opening[k], j, pull,
                    goals.pressure[j, aims : aims + 2],
                )  # fmt: skip
            for q in range(own.opening.size):
                own.opening[q] = opening[k, -1, q, j]
