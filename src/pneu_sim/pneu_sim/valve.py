# SPDX-License-Identifier: Apache-2.0
"""From commanded volts to port openings: spools (`pneu_sim.spool`), overlap, opening curves."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pneu_sim.compiling import compiled
from pneu_sim.rig import model as M
from pneu_sim.rig.model import Model
from pneu_sim.rig.schema import Rig, Valve
from pneu_sim.rig.valve_kinds import SWITCH_STEP_S
from pneu_sim.signals import Signal
from pneu_sim.spool import MEMORY, spool_positions
from pneu_sim.switching import PAST_PERIODS, has_switch

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

KNOTS_PER_SAMPLE = 4
"""Parts into which a sample interval is cut; openings are given at their ends, linear between.
Where a valve is switched, there are as many more as resolve its pulses."""


@compiled
def _port_openings(
    positions: Floats,
    spool: Floats,
    port_valve: Ints,
    curve_v: Floats,
    curve: Floats,
    out: Floats,
) -> None:
    """Openings of the ports of one rig where its spools stand; overlap and opening curve.

    Args:
        positions: (valves, intervals, knots + 1) V.
        spool: (valves, VALVE_COLUMNS) valve parameters.
        port_valve: (ports,) valve of each port; -1 for an orifice, which is open.
        curve_v: (ports, 2) voltage range of the opening curve.
        curve: (ports, points) opening curve.
        out: (intervals, knots + 1, ports) openings.
    """
    for q in range(port_valve.size):
        v = port_valve[q]
        if v < 0:
            out[:, :, q] = 1.0
            continue
        dead = spool[v, M.V_DEAD]
        null = spool[v, M.V_NULL]
        lo, hi = curve_v[q]
        top = curve.shape[1] - 1
        scale = top / (hi - lo)
        for n in range(out.shape[0]):
            for k in range(out.shape[1]):
                x = positions[v, n, k] - spool[v, M.V_OFFSET] - null
                if dead > 0.0:
                    x = math.copysign(max(abs(x) - dead, 0.0), x)
                f = min(max((null + x - lo) * scale, 0.0), float(top))
                i = min(int(f), top - 1)
                out[n, k, q] = curve[q, i] + (f - i) * (curve[q, i + 1] - curve[q, i])


@compiled
def _batch_openings(
    time: Floats,
    volts: Floats,
    origin: float,
    first: int,
    interval: float,
    spool: Floats,
    at_null: bool,
    memory: Floats,
    port_valve: Ints,
    curve_v: Floats,
    curve: Floats,
    out: Floats,
) -> None:
    """Openings of the ports of many rigs side by side, told at common times.

    Args:
        time: (n,) when the valves are told, s.
        volts: (lanes, valves, n) what, each held until the next.
        origin: Time from which intervals are counted, s.
        first: Number of the first interval.
        interval: Length of one, s.
        spool: (lanes, valves, VALVE_COLUMNS) valve parameters, see ``pneu_sim.rig.model``.
        at_null: Whether spools at rest stand closed, else where the first command has them.
        memory: (lanes, valves, 4) where the spools stand, changed in place; see `spool_positions`.
        port_valve: (ports,) valve of each port; -1 for an orifice, which is open.
        curve_v: (lanes, ports, 2) voltage range of the opening curve.
        curve: (lanes, ports, points) opening curve.
        out: (intervals, knots + 1, ports, lanes) openings.
    """
    positions = np.empty((spool.shape[1], out.shape[0], out.shape[1]))
    for j in range(spool.shape[0]):
        for v in range(spool.shape[1]):
            spool_positions(
                time, volts[j, v], origin, first, interval, spool[j, v], at_null, memory[j, v],
                positions[v],
            )  # fmt: skip
        _port_openings(positions, spool[j], port_valve, curve_v[j], curve[j], out[:, :, :, j])


class Spools:
    """The valves of rigs side by side, and the commands that are still on their way to them.

    Attributes:
        memory: (lanes, valves, 4) where the spools stand, see `spool_positions`.
        spool: (lanes, valves, VALVE_COLUMNS) parameters of the valves, see ``pneu_sim.rig.model``.
    """

    def __init__(self, models: Sequence[Model]) -> None:
        """Has the spools closed.

        Args:
            models: The rigs, on one plan.
        """
        plan = models[0].plan
        self.spool = np.stack([m.spool for m in models])
        self._curve = np.stack([m.curve for m in models])
        self._curve_v = np.stack([m.curve_v for m in models])
        self._port_valve = np.array(plan.port_valve, dtype=np.int64)
        self.close()

    def close(self, long_since: bool = False) -> None:
        """Has the spools at rest with the valves closed.

        Args:
            long_since: Whether they have been told to for long, so that the first command is under
                way for as long as any; else the first is what they have been told all along.
        """
        lanes, valves, _ = self.spool.shape
        null = self.spool[:, :, M.V_NULL]
        self.memory = np.zeros((lanes, valves, MEMORY))
        self.memory[:, :, :2] = null[:, :, None]
        self._longest_s = longest_delay_s(self.spool)
        self._time = np.full(int(long_since), -math.inf)
        self._volts = np.repeat(null[:, :, None], int(long_since), axis=2)

    def follow(
        self,
        volts: Floats,
        origin_s: float,
        first: int,
        interval_s: float,
        knots: int | None = None,
    ) -> Floats:
        """Openings of the ports under further commands.

        Args:
            volts: (lanes, valves, intervals) each held for one interval; 1 lane is for all.
            origin_s: Time from which intervals are counted, s.
            first: Number of the first one.
            interval_s: Length of one, s.
            knots: Into how many parts one is cut; None takes what the valves need.

        Returns:
            (intervals, knots + 1, ports, lanes) openings, dimensionless; linear between.
        """
        if knots is None:
            knots = KNOTS_PER_SAMPLE
            if has_switch(self.spool):
                knots = max(knots, math.ceil(interval_s / SWITCH_STEP_S - 1e-9))
        lanes, valves, _ = self.spool.shape
        past, count = self._time.size, volts.shape[2]
        told = origin_s + (first + np.arange(count + 1)) * interval_s
        time, held = np.empty(past + count), np.empty((lanes, valves, past + count))
        time[:past], time[past:] = self._time, told[:-1]
        held[:, :, :past], held[:, :, past:] = self._volts, volts
        out = np.empty((count, knots + 1, self._port_valve.size, lanes))
        _batch_openings(
            time, held, origin_s, first, interval_s, self.spool, True, self.memory,
            self._port_valve, self._curve_v, self._curve, out,
        )  # fmt: skip
        keep = max(int(np.searchsorted(time, told[-1] - self._longest_s - interval_s)) - 1, 0)
        self._time, self._volts = time[keep:].copy(), held[:, :, keep:].copy()
        return out

    def reach(self) -> None:
        """Remembers commands for as long as the valves, now of other parameters, may need them."""
        self._longest_s = max(self._longest_s, longest_delay_s(self.spool))

    def state(self) -> list[Floats]:
        """Returns when commands were told, which, and where the spools stand, rig by rig last."""
        volts, memory = np.moveaxis(self._volts, 0, -1), np.moveaxis(self.memory, 0, -1)
        return [self._time.copy(), volts.copy(), memory.copy()]

    def set_state(self, parts: Sequence[Floats]) -> None:
        """Goes back to a state.

        Args:
            parts: As of `state`.
        """
        self._time = parts[0].copy()
        # A copy in any case: of one rig the moved array is contiguous as it is.
        self._volts, self.memory = (np.moveaxis(part, -1, 0).copy(order="C") for part in parts[1:])


def longest_delay_s(spool: Floats) -> float:
    """How far back the commands lie that valves may still have to follow.

    Args:
        spool: (..., VALVE_COLUMNS) valve parameters.

    Returns:
        The longest delay of opening or closing, s; of a modulated switch the periods before it.
    """
    late = spool[..., M.V_DELAY] + np.maximum(spool[..., M.V_CLOSING], 0.0)
    modulated = spool[..., M.V_PERIOD] > 0.0
    late += np.where(modulated, np.abs(spool[..., M.V_CLOSING]), 0.0)
    late += PAST_PERIODS * spool[..., M.V_PERIOD]
    return float(np.max(late, initial=0.0))


def openings_along(
    model: Model,
    commands: Mapping[str, Signal],
    origin_s: float,
    first: int,
    shape: tuple[int, int],
    interval_s: float,
    memory: Floats,
    at_null: bool = False,
) -> Floats:
    """Opening fraction of every port along commands that each have times of their own.

    Args:
        model: The rig.
        commands: Per command its volts, each held until the next.
        origin_s: Time from which intervals are counted, s.
        first: Number of the first interval.
        shape: How many intervals, and into how many parts one is cut.
        interval_s: Length of one, s.
        memory: (n_valves, 4) where the spools stand, brought up to the end; NaN has them at rest.
            See `spool_positions`.
        at_null: Whether spools at rest stand closed, else where the command has them.

    Returns:
        (intervals, parts + 1, n_ports) openings, dimensionless; orifices are open.
    """
    plan, knots = model.plan, shape[1] + 1
    positions = np.empty((len(plan.commands), shape[0], knots))
    for v, name in enumerate(plan.commands):
        signal, row = commands[name], model.spool[v]
        spool_positions(
            signal.time_s, signal.values, origin_s, first, interval_s, row, at_null, memory[v],
            positions[v],
        )  # fmt: skip
    out = np.empty((shape[0], knots, plan.ports.shape[0]))
    port_valve = np.array(plan.port_valve, dtype=np.int64)
    _port_openings(positions, model.spool, port_valve, model.curve_v, model.curve, out)
    return out


def evenly_open(
    model: Model, commands: Mapping[str, Signal], begin_s: float, step_s: float, count: int
) -> Floats:
    """Opening fraction of every port at evenly spaced times, from rest.

    Args:
        model: The rig.
        commands: Per command its volts, each held until the next.
        begin_s: Time of the first, s.
        step_s: Distance, s.
        count: How many, 2 at least.

    Returns:
        (count, n_ports) openings, dimensionless.
    """
    memory = np.full((len(model.plan.valves), MEMORY), np.nan)
    whole_s = (count - 1) * step_s
    return openings_along(model, commands, begin_s, 0, (1, count - 1), whole_s, memory)[0]


def positions_along(
    row: Floats, command: Signal, begin_s: float, step_s: float, count: int
) -> Floats:
    """Positions of one spool at evenly spaced times, from rest.

    Args:
        row: Valve parameters, see ``pneu_sim.rig.model``.
        command: Volts, each held until the next.
        begin_s: Time of the first position, s.
        step_s: Distance, s.
        count: How many, 2 at least.

    Returns:
        (count,) positions, volts.
    """
    positions, memory = np.empty((1, count)), np.full(MEMORY, np.nan)
    spool_positions(
        command.time_s, command.values, begin_s, 0, (count - 1) * step_s, row, False, memory,
        positions,
    )  # fmt: skip
    return positions[0]


def duty(valve: Valve) -> bool:
    """Return whether the command of a valve is the duty cycle of a pulse-width modulation.

    Args:
        valve: The valve.
    """
    return valve.switch is not None and valve.switch.pwm_hz is not None


def voltage_limits(rig: Rig) -> dict[str, tuple[float, float]]:
    """Return the range of each command: of the opening curves of its valves, V, or of a duty cycle.

    Args:
        rig: The rig.
    """
    found: dict[str, tuple[float, float]] = {}
    for valve in rig.valves.values():
        if duty(valve):
            volts = [0.0, 1.0]
        else:
            volts = [valve.spool.null_v]
            for port in valve.ports.values():
                volts += port.opening.voltage_v
                if port.opening.mirror is not None:
                    curve = valve.ports[port.opening.mirror].opening.voltage_v
                    volts += [2.0 * valve.spool.null_v - v for v in curve]
        low, high = found.get(valve.command, (math.inf, -math.inf))
        found[valve.command] = (min(low, *volts), max(high, *volts))
    return {name: found.get(name, (-math.inf, math.inf)) for name in rig.commands}
