# SPDX-License-Identifier: Apache-2.0
"""Stepping lumped models side by side."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_sim import layout as L
from pneu_sim.lumped.filling import (
    Goals,
    Scratch,
    Shares,
    Volumes,
    advance_volumes,
    begin_volumes,
    port_flow,
)
from pneu_sim.lumped.model import V_VOLUME, LumpedModel
from pneu_sim.rig.valve_kinds import SWITCH_STEP_S
from pneu_sim.solver import Series, Solver
from pneu_sim.switching import has_switch

Floats = NDArray[np.float64]

STABLE = 1.5
"""Step times the fastest rate of any volume; the Runge-Kutta method is stable up to 2.8."""


class LumpedSolver(Solver):
    """Rigs reduced to volumes, of one structure."""

    def __init__(self, models: Sequence[LumpedModel], pull_1_s: float = 0.0) -> None:
        """Lays the rigs out.

        Args:
            models: The rigs, on one plan.
            pull_1_s: Rate at which volumes will be drawn to goals, 1/s.
        """
        first = models[0]
        self.models, self.plan = [m.base for m in models], first.plan
        self.step_s = STABLE / max(*(fastest(m) for m in models), pull_1_s, 1e-9)
        if len(self.plan.regulators) or has_switch(np.stack([m.base.spool for m in models])):
            self.step_s = min(self.step_s, SWITCH_STEP_S)
        self._cells = first.cells
        self._pull_1_s = pull_1_s
        widest = max(m.volume.shape[1] for m in models)  # one may have more relief valves
        volume = [np.pad(m.volume, ((0, 0), (0, widest - m.volume.shape[1]))) for m in models]
        gas = first.base.gas
        self._rigs = Volumes(
            gas.gamma,
            gas.r_specific,
            np.array([m.exponent for m in models]),
            first.side,
            np.stack([m.area for m in models]),
            np.stack([m.linear for m in models]),
            np.stack([m.source for m in models]),
            np.stack(volume),
            first.tap,
            first.chamber,
            np.stack([m.tap_delay_s for m in models]),
            np.stack([m.side_delay_s for m in models]),
            np.stack([m.drag for m in models]),
            np.stack([m.base.ambient for m in models]),
            self.plan.regulators,
            np.stack([m.base.regulator for m in models]),
        )
        self._sources = self._rigs.source.copy()
        self._base = np.zeros((len(models), len(first.volume)))
        self._shares = self._no_shares(1.0)
        self._past_s = 0.0
        ports, size = first.area.size, self._shares.now.shape[1]
        self._scratch = Scratch(
            np.zeros(size),
            np.zeros(size),
            np.zeros(size),
            np.zeros(ports),
            np.zeros(ports),
            np.full(first.tap.size, np.nan),
        )

    def _no_shares(self, step_s: float) -> Shares:
        """Shares of nothing, with the past that steps of some length need."""
        rigs, n_sides = self._rigs, self._rigs.side.size
        longest = max(float(np.max(d, initial=0.0)) for d in (rigs.tap_delay, rigs.side_delay))
        lanes, volumes = self._base.shape
        return Shares(
            self._base,
            np.zeros((lanes, n_sides + 2 * volumes)),
            np.zeros((lanes, int(longest / step_s) + 3, n_sides)),
            np.zeros((lanes, 1), dtype=np.int64),
            np.zeros((lanes, rigs.area.shape[1])),
            np.zeros((lanes, len(rigs.regulated), L.REG_STATE)),
        )

    def steps(self, interval_s: float) -> int:
        """Steps in an interval; powers of 2, the same for parameters that differ a little.

        Args:
            interval_s: Its length, s.
        """
        return 2 ** math.ceil(math.log2(super().steps(interval_s)))

    def fill(
        self,
        pressure_pa: Floats,
        chamber_pressure_pa: Floats,
        temperature_k: Floats,
        chamber_temperature_k: Floats,
    ) -> None:
        """Fills all with gas at rest, at the room's temperature; see `Solver.fill`.

        Args:
            pressure_pa: (slots, lanes); a volume gets the mean of its pipes'.
            chamber_pressure_pa: (n_chambers, lanes); of those without pipes, of its chambers'.
            temperature_k: Not looked at.
            chamber_temperature_k: Not looked at.
        """
        del temperature_k, chamber_temperature_k
        self._base[:] = self._rigs.room[:, :1]
        for v, cells in enumerate(self._cells):
            chambers = np.flatnonzero(self._rigs.chamber == v)
            if cells.size:
                self._base[:, v] = np.mean(pressure_pa[cells], axis=0)
            elif chambers.size:
                self._base[:, v] = np.mean(chamber_pressure_pa[chambers], axis=0)
        self._rigs.source[:] = self._sources
        begin_volumes(self._rigs, self._shares)

    def advance(self, opening: Floats, interval_s: float, goals_pa: Floats | None = None) -> Series:
        """Advances all; see `Solver.advance`.

        Args:
            opening: (intervals, knots + 1, n_ports, lanes).
            interval_s: Length of an interval, s.
            goals_pa: (lanes, intervals + 1, n_taps) pressures that volumes are drawn to, NaN where
                there is none.
        """
        steps = max(self.steps(interval_s), opening.shape[1] - 1)
        step_s = interval_s / steps
        if step_s != self._past_s:
            self._remember_at(step_s)
        if goals_pa is None:
            goals_pa = np.zeros((self.lanes, 0, len(self.plan.taps)))
        out = Series.empty(self.plan, len(opening) + 1, self.lanes)
        out.temperatures.fill(math.nan)
        advance_volumes(
            self._rigs, self._shares, self._scratch, steps, step_s, np.ascontiguousarray(opening),
            Goals(goals_pa, self._pull_1_s), out.taps, out.flows, out.chambers,
        )  # fmt: skip
        return out

    def _remember_at(self, step_s: float) -> None:
        """What has been brought to the volumes, told at steps of another length."""
        old, new = self._shares, self._no_shares(step_s)
        for name in ("now", "opening", "regulator"):
            getattr(new, name)[:] = getattr(old, name)
        size = old.past.shape[1]
        back = np.arange(new.past.shape[1]) * step_s / (self._past_s or math.inf)
        i = np.minimum(back.astype(int), size - 2)
        f = np.minimum(back - i, 1.0)[:, None]
        for j, head in enumerate(old.head[:, 0]):
            rows = old.past[j, (head - np.arange(size)) % size]  # the newest first
            new.past[j, -np.arange(len(back)) % len(back)] = (1.0 - f) * rows[i] + f * rows[i + 1]
        self._shares, self._past_s = new, step_s

    def state(self) -> list[NDArray[Any]]:
        """Returns copies of all that the future depends on; see `Solver.state`."""
        parts = [np.moveaxis(part, 0, -1).copy() for part in self._shares]
        # The past is told at steps of this length.
        return [*parts, np.full(self.lanes, self._past_s)]

    def set_state(self, parts: Sequence[NDArray[Any]]) -> None:
        """Goes back to a state; see `Solver.set_state`.

        Args:
            parts: As of `state`.
        """
        *shares, step_s = parts
        if step_s[0] != self._past_s:
            self._past_s = float(step_s[0])
            self._shares = self._no_shares(self._past_s or 1.0)
        for own, part in zip(self._shares, shares, strict=True):
            own[:] = np.moveaxis(part, -1, 0)

    def set_reservoir(self, index: int, pressure_pa: Floats | float) -> None:
        """Changes what a reservoir supplies, at once.

        Args:
            index: Its number.
            pressure_pa: A number or one per rig, Pa.
        """
        self._rigs.source[:, index, 0] = pressure_pa


def fastest(model: LumpedModel) -> float:
    """Returns the fastest rate at which any volume may settle, 1/s: all ports open and linear.

    Args:
        model: The model.
    """
    gas = model.base.gas
    warm = gas.gamma * max(model.base.ambient[1], *model.source[:, 1], 0.0)
    rates = np.zeros(len(model.volume))
    for q, (area, linear) in enumerate(zip(model.area, model.linear, strict=True)):
        edge = port_flow(1.0, warm, linear, warm, area, linear, gas.gamma, gas.r_specific)
        slope = model.base.curve[q].max() * edge / (1.0 - linear)
        for place in model.side[2 * q : 2 * q + 2]:
            if place >= 0:
                row = model.volume[place]
                rates[place] += model.exponent * gas.r_specific * warm * slope / row[V_VOLUME]
    return float(rates.max(initial=0.0))
