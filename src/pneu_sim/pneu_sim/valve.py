# SPDX-License-Identifier: Apache-2.0
"""From commanded volts to port openings: delay, backlash, spool motion, overlap, opening curve."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pneu_sim.compiling import compiled
from pneu_sim.rig import model as M
from pneu_sim.signals import SAME_S, Signal

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

KNOTS_PER_SAMPLE = 4
"""Openings are computed this many times per sample interval, and linear between."""
FINEST = 0.05
"""A spool that is not solved exactly takes steps of this, in units of 1/(2 pi bandwidth)."""


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
def _means(time: Floats, command: Floats, begin: float, h: float, out: Floats) -> None:
    """Means of a held command over successive intervals."""
    i = _in_force(time, begin)
    for k in range(out.size):
        t = begin + k * h
        end = begin + (k + 1) * h
        base = command[i]
        extra = 0.0  # beyond the first of the interval: a command that stays is met exactly
        while i + 1 < time.size and time[i + 1] < end:
            i += 1
            t = max(t, time[i])
            extra += (command[i] - command[i - 1]) * (end - t)
        out[k] = base + extra / h


@compiled
def _played(target: float, command: float, half: float) -> float:
    """What a spool is told after backlash: it lags the command by half the play at most."""
    return min(max(target, command - half), command + half)


@compiled
def _slew(
    time: Floats,
    command: Floats,
    i: int,
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
        event = i + 1 < time.size and time[i + 1] < end
        span = (max(time[i + 1], t) if event else end) - t
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
        target = _played(target, command[i], half)


@compiled
def _rate_limited(
    time: Floats,
    command: Floats,
    begin: float,
    rest: float,
    h: float,
    row: Floats,
    memory: Floats,
    out: Floats,
) -> None:
    """Positions of a spool that follows at once but for its speed: its means about the knots.

    The means make them smooth functions of the delay and the speed, as those of the command do for
    a spool without a limit.

    Args:
        time: Times at which commands act but for the delay, s.
        command: Volts from then on.
        begin: Time of the first knot less the delay, s.
        rest: Where a spool without a past stands, volts.
        h: Interval of the knots, s.
        row: Valve parameters.
        memory: (4,) command after backlash and position at the last knot, and by how much the mean
            position over the half interval before it differs.
        out: (K + 1,) positions.
    """
    half = 0.5 * row[5]
    speed = row[9]
    i = _in_force(time, begin + SAME_S)
    target, x, differs, _ = memory
    if math.isnan(target):
        target = x = rest
        differs = 0.0
    before = x + differs
    target = _played(target, command[i], half)
    for k in range(out.size):
        at = begin + k * h
        middle = begin + (k + 0.5) * h
        last = k == out.size - 1
        if last:  # what lies ahead is the next call's to do
            memory[0] = target
            memory[1] = x
            memory[2] = before - x
        i, target, x, ahead = _slew(time, command, i, at, middle, half, speed, target, x)
        out[k] = 0.5 * (before + ahead)
        if not last:
            end = begin + (k + 1) * h
            i, target, x, before = _slew(time, command, i, middle, end, half, speed, target, x)


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
def _at_once(
    mean: Floats, first: float, rest: float, row: Floats, memory: Floats, out: Floats
) -> None:
    """Positions of a spool that follows at once, at every knot: the mean command about it.

    Args:
        mean: (K,) volts about all knots but the first.
        first: Command at the first knot, volts.
        rest: Where a spool without a past stands, volts.
        row: Valve parameters.
        memory: (4,) see `spool_positions`.
        out: (K + 1,) positions.
    """
    half = 0.5 * row[5]
    target = rest if math.isnan(memory[0]) else memory[0]
    target = _played(target, first, half)
    out[0] = target
    for k in range(1, out.size):
        target = _played(target, mean[k - 1], half)
        out[k] = target
    memory[0] = target
    memory[1] = target
    memory[2] = 0.0
    memory[3] = 0.0


@compiled
def _lagging(
    time: Floats,
    command: Floats,
    begin: float,
    rest: float,
    h: float,
    row: Floats,
    memory: Floats,
    out: Floats,
) -> None:
    """Positions at the knots of a spool with a bandwidth (thesis eq. 5.4, corrected).

    Every command begins at its own time: while the acceleration is at its limit a command counts by
    how long it lasts and not by its size, so its mean over an interval would act for all of it.
    Without limits and integral the steps are exact.

    Args:
        time: Times at which commands act but for the delay, s.
        command: Volts from then on.
        begin: Time of the first knot less the delay, s.
        rest: Where a spool without a past stands, volts.
        h: Interval of the knots, s.
        row: Valve parameters.
        memory: (4,) see `spool_positions`.
        out: (K + 1,) positions.
    """
    w = row[0]
    zeta = row[1]
    limit = row[3]
    speed = row[9]
    half = 0.5 * row[5]
    linear = row[2] == 0.0 and limit == math.inf and speed == math.inf
    target, x, v, acc = memory
    i = _in_force(time, begin + SAME_S)
    if math.isnan(target):
        target = x = rest
        v = acc = 0.0
    target = _played(target, command[i], half)
    usual = h if linear else h / max(1, math.ceil(h * w / FINEST))
    u11, u12, u21, u22 = _response(w, zeta, usual)
    out[0] = x
    for k in range(1, out.size):
        t = begin + (k - 1) * h
        end = begin + k * h
        while True:
            event = i + 1 < time.size and time[i + 1] < end - SAME_S
            span = (max(time[i + 1], t) if event else end) - t
            sub = math.ceil(span / usual - 1e-9)
            hs = usual
            a11, a12, a21, a22 = u11, u12, u21, u22
            if sub > 0 and abs(span - sub * usual) > 1e-9 * usual:
                hs = span / sub
                a11, a12, a21, a22 = _response(w, zeta, hs)
            gain = 0.5 * row[2] * w * w * hs
            for _ in range(sub):
                if linear:
                    d = x - target
                    x = target + a11 * d + a12 * v
                    v = a21 * d + a22 * v
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
                x += v * hs + share * (moved - v * hs)
                v += allowed
                # What the spool cannot follow must not wind up.
                acc += share * (half_acc + gain * (target - x))
            if not event:
                break
            t += span
            i += 1
            target = _played(target, command[i], half)
        out[k] = x
    memory[0] = target
    memory[1] = x
    memory[2] = v
    memory[3] = acc


@compiled
def spool_positions(
    command: Floats, dt: float, knots: int, row: Floats, past: int, memory: Floats, out: Floats
) -> None:
    """Spool position in volts at every knot, for one valve.

    Commands act at their own times, so that a delay need not be a whole number of samples and small
    changes of it change the result smoothly: a spool with a bandwidth takes them piece by piece,
    one that follows at once their mean about each knot. Backlash is a play operator on the
    command. The spool obeys thesis eq. 5.4, corrected: an acceleration that opposes the error, with
    an optional integral term, limited in size as its speed is. A spool that follows at once but for
    its speed is solved exactly.

    Args:
        command: (past + T,) volts, held between samples.
        dt: Sample interval, s.
        knots: Knots per sample interval.
        row: Valve parameters, see ``pneu_sim.rig.model``.
        past: How many of the commands lie before the first position.
        memory: (4,) command after backlash, position, speed (of a spool that follows at once but
            for its speed, how far its mean position over half an interval of the knots before
            differs) and integral term, changed in place; a NaN first has the spool at rest on the
            first command.
        out: ((T - 1) * knots + 1,) positions.
    """
    h = dt / knots
    origin = past * dt - row[4]
    told = np.empty(command.size)
    for i in range(command.size):
        told[i] = i * dt
    room = np.empty(command.size)
    acting = np.empty(command.size)
    n = _acting(told, command, row[8], row[10], room, acting)
    time = room[:n]
    rest = command[past]
    if row[0] > 0.0:
        _lagging(time, acting[:n], origin, rest, h, row, memory, out)
    elif row[9] < math.inf:
        _rate_limited(time, acting[:n], origin, rest, h, row, memory, out)
    else:
        mean = np.empty(out.size - 1)
        _means(time, acting[:n], origin + 0.5 * h, h, mean)
        first = acting[_in_force(time, origin + SAME_S)]
        _at_once(mean, first, rest, row, memory, out)


@compiled
def _port_openings(
    x: Floats, row: Floats, lo: float, hi: float, table: Floats, out: Floats
) -> None:
    """Opening of one port along the spool's positions."""
    offset = row[6]
    dead = row[7]
    null = row[8]
    top = table.size - 1
    scale = top / (hi - lo)
    for k in range(x.size):
        s = x[k] - offset - null
        if dead > 0.0:
            s = math.copysign(max(abs(s) - dead, 0.0), s)
        f = min(max((null + s - lo) * scale, 0.0), float(top))
        i = min(int(f), top - 1)
        out[k] = table[i] + (f - i) * (table[i + 1] - table[i])


@compiled
def batch_openings(
    commands: Floats,
    dt: float,
    knots: int,
    past: int,
    spool: Floats,
    memory: Floats,
    port_valve: Ints,
    curve_v: Floats,
    curve: Floats,
    out: Floats,
) -> None:
    """Openings of the ports of many rigs side by side, as `openings` gives those of one.

    Args:
        commands: (lanes, valves, past + T) volts, held between samples.
        dt: Sample interval, s.
        knots: Knots per sample interval.
        past: How many of the commands lie before the first opening.
        spool: (lanes, valves, VALVE_COLUMNS) valve parameters, see ``pneu_sim.rig.model``.
        memory: (lanes, valves, 4) where the spools stand, changed in place; see `spool_positions`.
        port_valve: (ports,) valve of each port; -1 for an orifice, which is open.
        curve_v: (lanes, ports, 2) voltage range of the opening curve.
        curve: (lanes, ports, points) opening curve.
        out: ((T - 1) * knots + 1, ports, lanes) openings.
    """
    count = out.shape[0]
    positions = np.empty((spool.shape[1], count))
    column = np.empty(count)
    for j in range(spool.shape[0]):
        for v in range(spool.shape[1]):
            spool_positions(
                commands[j, v], dt, knots, spool[j, v], past, memory[j, v], positions[v]
            )
        for q in range(port_valve.size):
            v = port_valve[q]
            if v < 0:
                out[:, q, j] = 1.0
                continue
            lo, hi = curve_v[j, q]
            _port_openings(positions[v], spool[j, v], lo, hi, curve[j, q], column)
            out[:, q, j] = column


def longest_delay_s(spool: Floats) -> float:
    """How far back the commands lie that valves may still have to follow.

    Args:
        spool: (..., VALVE_COLUMNS) valve parameters.

    Returns:
        The longest delay of opening or closing, s.
    """
    late = spool[..., M.V_DELAY] + np.maximum(spool[..., M.V_CLOSING], 0.0)
    return float(np.max(late, initial=0.0))


@dataclass
class SpoolState:
    """Where the spools of a rig stand, and the commands that are still on their way to them.

    Attributes:
        memory: Per valve, see `spool_positions`.
        past: Per valve the latest commands, volts.
        dt_s: Interval of those.
        at_null: Whether spools without a past stand closed, else where the first command has them.
    """

    memory: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    past: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    dt_s: float = 0.0
    at_null: bool = False

    def before(self, valve: str, delay_s: float, dt_s: float) -> NDArray[np.float64]:
        """Commands at intervals of ``dt_s`` that reach back over a delay.

        Args:
            valve: Name of the valve.
            delay_s: How far back, s.
            dt_s: Interval, s.
        """
        held = self.past.get(valve)
        if held is None or delay_s <= 0.0:
            return np.empty(0)
        count = math.ceil(delay_s / dt_s) + 1
        ago = (np.arange(count, 0, -1) - 0.5) * dt_s
        index = held.size - 1 - (ago / self.dt_s).astype(int)
        return np.asarray(held[np.maximum(index, 0)])


def openings(
    model: M.Model,
    commands: dict[str, NDArray[np.float64]],
    dt_s: float,
    knots: int = KNOTS_PER_SAMPLE,
    spools: SpoolState | None = None,
) -> NDArray[np.float64]:
    """Opening fraction of every port along a recording.

    Args:
        model: The rig.
        commands: Per command its (T,) volts, held between samples.
        dt_s: Sample interval, s.
        knots: Knots per sample interval.
        spools: Where the spools stand, brought up to the last sample; None has them at rest.

    Returns:
        ((T - 1) * knots + 1, n_ports) openings, dimensionless.
    """
    plan = model.plan
    size = 0
    for series in commands.values():
        size = series.size
    count = max((size - 1) * knots + 1, 1)
    positions: dict[int, NDArray[np.float64]] = {}
    spools = spools or SpoolState()
    for v, name in enumerate(plan.commands):
        x = np.empty(count)
        valve, delay_s = plan.valves[v], longest_delay_s(model.spool[v])
        past = spools.before(valve, delay_s, dt_s)
        series = np.concatenate([past, commands[name]])
        if valve not in spools.memory:
            null = float(model.spool[v, M.V_NULL])
            at_rest = [null, null, 0.0, 0.0] if spools.at_null else [np.nan] * 4
            spools.memory[valve] = np.array(at_rest)
        memory = spools.memory[valve]
        spool_positions(series, dt_s, knots, model.spool[v], past.size, memory, x)
        positions[v] = x
        # The last command only begins at the last sample.
        held = series[:-1] if series.size > 1 else series
        spools.past[valve] = held[-(math.ceil(delay_s / dt_s) + 2) :]
    spools.dt_s = dt_s
    return _of_ports(model, positions, count)


def _of_ports(model: M.Model, positions: dict[int, Floats], count: int) -> Floats:
    """(count, n_ports) openings where the spools of the valves stand; orifices are open."""
    result = np.ones((count, model.plan.ports.shape[0]))
    for q, v in enumerate(model.plan.port_valve):
        if v >= 0:
            out = np.empty(count)
            lo, hi = model.curve_v[q]
            _port_openings(positions[v], model.spool[v], lo, hi, model.curve[q], out)
            result[:, q] = out
    return result


def openings_along(
    model: M.Model,
    commands: Mapping[str, Signal],
    begin_s: float,
    step_s: float,
    count: int,
    memory: Floats,
    at_null: bool = False,
) -> Floats:
    """Opening fraction of every port along commands that each have times of their own.

    Args:
        model: The rig.
        commands: Per command its volts, each held until the next.
        begin_s: Time of the first opening, s.
        step_s: Interval of the openings, s.
        count: How many.
        memory: (n_valves, 4) where the spools stand, brought up to the last opening; NaN has them
            at rest. See `spool_positions`.
        at_null: Whether spools at rest stand closed, else where the command has them.

    Returns:
        (count, n_ports) openings, dimensionless.
    """
    positions = {
        v: positions_along(
            model.spool[v], commands[name], begin_s, step_s, count, memory[v], at_null
        )
        for v, name in enumerate(model.plan.commands)
    }
    return _of_ports(model, positions, count)


def positions_along(
    row: Floats,
    command: Signal,
    begin_s: float,
    step_s: float,
    count: int,
    memory: Floats,
    at_null: bool = False,
) -> Floats:
    """Positions of one spool along a command that has times of its own.

    Args:
        row: Valve parameters, see ``pneu_sim.rig.model``.
        command: Volts, each held until the next.
        begin_s: Time of the first position, s.
        step_s: Interval of the positions, s.
        count: How many.
        memory: (4,) where the spool stands, brought up to the last position; NaN has it at rest.
            See `spool_positions`.
        at_null: Whether a spool at rest stands closed, else where the command has it.

    Returns:
        (count,) positions, volts.
    """
    if row[M.V_CLOSING] != 0.0:
        command = _as_it_acts(command, row)
    positions = np.empty(count)
    at = begin_s + step_s * np.arange(count) - row[M.V_DELAY]
    first = float(command.held(at[0]))
    rest = float(row[M.V_NULL]) if at_null else first
    if row[M.V_FREQUENCY] <= 0.0:
        if row[M.V_SPEED] < math.inf:
            _rate_limited(
                command.time_s, command.values, at[0], rest, step_s, row, memory, positions
            )
            return positions
        _at_once(command.mean_between(at + 0.5 * step_s), first, rest, row, memory, positions)
        return positions
    _lagging(command.time_s, command.values, at[0], rest, step_s, row, memory, positions)
    return positions


def _as_it_acts(signal: Signal, row: Floats) -> Signal:
    """A command whose closing changes are moved to when they act but for the delay of opening."""
    time, values = np.empty(len(signal)), np.empty(len(signal))
    n = _acting(signal.time_s, signal.values, row[M.V_NULL], row[M.V_CLOSING], time, values)
    return Signal(time[:n], values[:n])
