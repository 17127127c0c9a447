# SPDX-License-Identifier: Apache-2.0
"""Where the spool of a valve stands: delay, backlash, bandwidth and limits (thesis eq. 5.4).

The equation is taken as the errata of the thesis have it, with an acceleration that opposes the
error.

Time is cut into intervals, each with knots at even distances, both ends among them. What a spool
does in one depends on nothing that is commanded later, so that a run may be cut between any two.
"""

import math

import numpy as np
from numpy.typing import NDArray

from pneu_sim.compiling import compiled
from pneu_sim.rig.model import (
    V_CLOSING,
    V_DAMPING,
    V_DELAY,
    V_FREQUENCY,
    V_HYSTERESIS,
    V_INTEGRAL,
    V_LIMIT,
    V_NULL,
    V_OFF,
    V_ON,
    V_SPEED,
)
from pneu_sim.signals import SAME_S
from pneu_sim.switching import switched

Floats = NDArray[np.float64]

FINEST = 0.05
"""A spool that is not solved exactly takes steps of this, in units of 1/(2 pi bandwidth)."""
MEMORY = 4
"""Numbers that say where a spool stands: command after backlash, position, speed, integral term."""


@compiled
def _in_force(time: Floats, at: float) -> int:
    """Which of some held commands is in force; the first also holds before its time."""
    return max(int(np.searchsorted(time, at, side="right")) - 1, 0)


@compiled
def _acting(
    time: Floats, command: Floats, null: float, later: float, out_time: Floats, out_command: Floats
) -> int:
    """Changes of a command at the times they act, where closing takes longer than opening.

    Args:
        time: Times of the commands, s.
        command: Volts, each held until the next.
        null: Voltage that closes.
        later: How much later than the others a change towards it acts, s; may be negative.
        out_time: Times at which changes act but for the delay of opening, s; the first, from which
            the others differ, has been there before any of them.
        out_command: Volts from then on.

    Returns:
        How many there are.
    """
    out_time[0] = time[0] - abs(later)
    out_command[0] = last = command[0]
    n = 1
    for i in range(1, time.size):
        new = command[i]
        if new == last:
            continue  # no change: it supersedes nothing
        at = time[i] + (0.0 if abs(new - null) > abs(last - null) else later)
        while n > 1 and out_time[n - 1] > at - SAME_S:
            n -= 1
        out_time[n] = at
        out_command[n] = new
        n += 1
        last = new
    return n


@compiled
def _mean(
    time: Floats, volts: Floats, i: int, base: float, begin: float, end: float
) -> tuple[int, float]:
    """The command in force at the end of a while, and its mean; ``i`` is in force as it begins.

    Begin and end are told from ``base`` on, the times of the commands are not.
    """
    held = volts[i]
    extra = 0.0  # beyond the first of the while: a command that stays is met exactly
    while i + 1 < time.size and time[i + 1] - base < end - SAME_S:
        i += 1
        t = max(time[i] - base, begin)
        extra += (volts[i] - volts[i - 1]) * (end - t)
    return i, held + extra / (end - begin)


@compiled
def _played(target: float, command: float, half: float) -> float:
    """What a spool is told after backlash: it lags the command by half the play at most."""
    return min(max(target, command - half), command + half)


@compiled
def _at_once(
    time: Floats,
    volts: Floats,
    i: int,
    base: float,
    h: float,
    half: float,
    memory: Floats,
    out: Floats,
) -> int:
    """A spool that follows at once, over one interval: at each knot the mean command about it.

    At the ends it is the mean over the half beside them that is within.

    Args:
        time: Times of the commands, s.
        volts: Each held until the next.
        i: The one in force as the interval begins.
        base: When that is, less the delay, s.
        h: Distance of the knots, s.
        half: Half of the backlash, volts.
        memory: (4,) see `spool_positions`.
        out: (knots + 1,) positions.

    Returns:
        The command in force at the end.
    """
    target = memory[0]
    knots = out.size - 1
    if i + 1 >= time.size or time[i + 1] - base >= knots * h - SAME_S:
        target = _played(target, volts[i], half)
        out[:] = target
    else:
        for k in range(knots + 1):
            begin = max(k - 0.5, 0.0) * h
            end = min(k + 0.5, float(knots)) * h
            i, mean = _mean(time, volts, i, base, begin, end)
            target = _played(target, mean, half)
            out[k] = target
    memory[0] = target
    memory[1] = target
    return i


@compiled
def _slew(
    time: Floats,
    volts: Floats,
    i: int,
    base: float,
    begin: float,
    end: float,
    half: float,
    speed: float,
    target: float,
    x: float,
) -> tuple[int, float, float, float]:
    """A spool that follows at once but for its speed, exactly, over half an interval of the knots.

    Returns:
        The command in force, the command after backlash and the position at the end, and the mean
        position.
    """
    start = x
    area = 0.0
    t = begin
    while True:
        event = i + 1 < time.size and time[i + 1] - base < end - SAME_S
        span = (max(time[i + 1] - base, t) if event else end) - t
        way = target - x
        need = abs(way) / speed
        if need >= span:
            step = math.copysign(speed * span, way)
            area += (x - start + 0.5 * step) * span
            x += step
        else:
            area += (x - start + 0.5 * way) * need + (target - start) * (span - need)
            x = target
        if not event:
            return i, target, x, start + area / (end - begin)
        t += span
        i += 1
        target = _played(target, volts[i], half)


@compiled
def _rate_limited(
    time: Floats,
    volts: Floats,
    i: int,
    base: float,
    h: float,
    half: float,
    speed: float,
    memory: Floats,
    out: Floats,
) -> int:
    """A spool that follows at once but for its speed, over one interval: its means about the knots.

    The means make them smooth functions of the delay and the speed, as those of the command do for
    a spool without a limit. At the ends they are over the half beside them that is within.

    Args:
        time: Times of the commands, s.
        volts: Each held until the next.
        i: The one in force as the interval begins.
        base: When that is, less the delay, s.
        h: Distance of the knots, s.
        half: Half of the backlash, volts.
        speed: Limit of the speed, V/s.
        memory: (4,) see `spool_positions`.
        out: (knots + 1,) positions.

    Returns:
        The command in force at the end.
    """
    target, x = _played(memory[0], volts[i], half), memory[1]
    knots = out.size - 1
    before = 0.0
    for k in range(knots):
        begin, middle, end = k * h, (k + 0.5) * h, (k + 1) * h
        i, target, x, ahead = _slew(time, volts, i, base, begin, middle, half, speed, target, x)
        out[k] = ahead if k == 0 else 0.5 * (before + ahead)
        i, target, x, before = _slew(time, volts, i, base, middle, end, half, speed, target, x)
    out[knots] = before
    memory[0] = target
    memory[1] = x
    return i


@compiled
def _response(w: float, zeta: float, h: float) -> tuple[float, float, float, float]:
    """Exact response of the linear spool's distance and speed over a time."""
    if zeta < 1.0:
        wd = w * math.sqrt(1.0 - zeta * zeta)
        e = math.exp(-zeta * w * h)
        c = math.cos(wd * h)
        s = math.sin(wd * h) / wd
    else:
        wd = w * math.sqrt(max(zeta * zeta - 1.0, 1e-12))
        e = math.exp(-zeta * w * h)
        c = math.cosh(wd * h)
        s = math.sinh(wd * h) / wd
    return e * (c + zeta * w * s), e * s, -e * w * w * s, e * (c - zeta * w * s)


@compiled
def _lagging(
    time: Floats,
    volts: Floats,
    i: int,
    base: float,
    h: float,
    row: Floats,
    memory: Floats,
    out: Floats,
) -> int:
    """A spool with a bandwidth, over one interval: its means about the knots.

    As its bandwidth grows it comes to one that follows at once, whatever the length of intervals.

    Every command begins at its own time: while the acceleration is at its limit a command counts by
    how long it lasts and not by its size, so its mean over a while would act for all of it. Without
    limits and integral the steps are exact, and so are the means.

    Args:
        time: Times of the commands, s.
        volts: Each held until the next.
        i: The one in force as the interval begins.
        base: When that is, less the delay, s.
        h: Distance of the knots, s.
        row: Valve parameters.
        memory: (4,) see `spool_positions`.
        out: (knots + 1,) positions.

    Returns:
        The command in force at the end.
    """
    w = row[V_FREQUENCY]
    zeta = row[V_DAMPING]
    limit = row[V_LIMIT]
    speed = row[V_SPEED]
    half = 0.5 * row[V_HYSTERESIS]
    linear = row[V_INTEGRAL] == 0.0 and limit == math.inf and speed == math.inf
    target, x, v, acc = memory
    target = _played(target, volts[i], half)
    part = 0.5 * h
    usual = part if linear else part / max(1, math.ceil(part * w / FINEST))
    u11, u12, u21, u22 = _response(w, zeta, usual)
    before = 0.0
    for m in range(2 * (out.size - 1)):
        t = m * part
        end = (m + 1) * part
        area, start = 0.0, x  # of the way from there, in this half of a knot's distance
        while True:
            event = i + 1 < time.size and time[i + 1] - base < end - SAME_S
            span = (max(time[i + 1] - base, t) if event else end) - t
            sub = math.ceil(span / usual - 1e-9)
            hs = usual
            a11, a12, a21, a22 = u11, u12, u21, u22
            if sub > 0 and abs(span - sub * usual) > 1e-9 * usual:
                hs = span / sub
                a11, a12, a21, a22 = _response(w, zeta, hs)
            gain = 0.5 * row[V_INTEGRAL] * w * w * hs
            for _ in range(sub):
                x0, v0 = x, v
                if linear:
                    d = x - target
                    x = target + a11 * d + a12 * v
                    v = a21 * d + a22 * v
                    # its equation of motion, integrated over the step
                    faster = v - v0
                    area += (target - start) * hs - (faster + 2.0 * zeta * w * (x - x0)) / (w * w)
                    continue
                # The exact step without limits, of which these let a share happen: all of it
                # where none is reached, so that the step is continuous in them.
                half_acc = gain * (target - x)
                goal = target + (acc + half_acc) / (w * w)
                moved = goal + a11 * (x - goal) + a12 * v - x
                faster = a21 * (x - goal) + a22 * v - v
                allowed = min(max(faster, -limit * hs), limit * hs)
                if abs(v + allowed) > speed:
                    allowed = math.copysign(speed, v + allowed) - v
                share = 1.0 if allowed == faster else allowed / faster
                evenly = (x0 - start + 0.5 * v0 * hs) * hs
                whole = (goal - start) * hs - (faster + 2.0 * zeta * w * moved) / (w * w)
                area += evenly + share * (whole - evenly)
                x += v * hs + share * (moved - v * hs)
                v += allowed
                # What the spool cannot follow must not wind up.
                acc += share * (half_acc + gain * (target - x))
            if not event:
                break
            t += span
            i += 1
            target = _played(target, volts[i], half)
        mean = start + area / part
        if m % 2 == 1:
            before = mean
        else:
            out[m // 2] = mean if m == 0 else 0.5 * (before + mean)
    out[out.size - 1] = before
    memory[0] = target
    memory[1] = x
    memory[2] = v
    memory[3] = acc
    return i


@compiled
def spool_positions(
    time: Floats,
    volts: Floats,
    origin: float,
    first: int,
    interval: float,
    row: Floats,
    at_null: bool,
    memory: Floats,
    out: Floats,
) -> None:
    """Positions of one spool at the knots of successive intervals.

    Commands act at their own times, so that a delay need not be a whole number of samples and small
    changes of it change the result smoothly: a spool with a bandwidth takes them piece by piece,
    one that follows at once their mean about each knot. Backlash is a play operator on the
    command. The spool obeys thesis eq. 5.4, corrected: an acceleration that opposes the error, with
    an optional integral term, limited in size as its speed is. A spool that follows at once but for
    its speed is solved exactly.

    Args:
        time: (n,) when it is told, s.
        volts: (n,) what, each held until the next; the first also before its time.
        origin: Time from which intervals are counted, s.
        first: Number of the first interval.
        interval: Length of one, s.
        row: Valve parameters, see ``pneu_sim.rig.model``.
        at_null: Whether a spool at rest stands closed, else where the first command has it.
        memory: (4,) command after backlash, position, speed and integral term, changed in place; a
            NaN first has the spool at rest.
        out: (intervals, knots + 1) positions, V; both ends of an interval are its own.
    """
    begin = origin + first * interval
    if row[V_ON] != row[V_OFF]:
        early = begin - row[V_DELAY] - 2.0 * abs(row[V_CLOSING])
        time, volts = switched(time, volts, early, begin + out.shape[0] * interval, row)
    if row[V_CLOSING] != 0.0:
        room = np.empty(time.size)
        acting = np.empty(time.size)
        n = _acting(time, volts, row[V_NULL], row[V_CLOSING], room, acting)
        time = room[:n]
        volts = acting[:n]
    h = interval / (out.shape[1] - 1)
    half = 0.5 * row[V_HYSTERESIS]
    i = _in_force(time, begin - row[V_DELAY] + SAME_S)
    if math.isnan(memory[0]):
        memory[:] = 0.0
        memory[:2] = row[V_NULL] if at_null else volts[i]
    for k in range(out.shape[0]):
        base = origin + (first + k) * interval - row[V_DELAY]
        while i + 1 < time.size and time[i + 1] <= base + SAME_S:
            i += 1
        if row[V_FREQUENCY] > 0.0:
            i = _lagging(time, volts, i, base, h, row, memory, out[k])
        elif row[V_SPEED] < math.inf:
            i = _rate_limited(time, volts, i, base, h, half, row[V_SPEED], memory, out[k])
        else:
            i = _at_once(time, volts, i, base, h, half, memory, out[k])
