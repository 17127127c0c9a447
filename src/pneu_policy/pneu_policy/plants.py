# SPDX-License-Identifier: Apache-2.0
"""Many rigs side by side, one control period at a time: what controllers are trained on.

The same rig file gives a plant by the full model or by a lumped one (thesis 3.2.1): its ``model``
says which. A plant tells what its sensors show, without noise; commands reach the valves after the
delay of each rig.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim import layout as L
from pneu_sim import tile as tiles
from pneu_sim.gas import AIR, Gas
from pneu_sim.lumped import batch as lumped_batch
from pneu_sim.lumped import filling
from pneu_sim.lumped.kinds import Lumped
from pneu_sim.models import kind_of
from pneu_sim.rig.build import build
from pneu_sim.rig.model import S_BIAS, S_GAIN, S_LAG, S_OFFSET, V_DELAY, V_NULL, Model
from pneu_sim.rig.plan import Plan, common_plan, reservoir_of_pipes
from pneu_sim.rig.schema import Rig
from pneu_sim.valve import KNOTS_PER_SAMPLE, batch_openings, longest_delay_s

Floats = NDArray[np.float64]

SAMPLE_S = 2e-3
"""Openings and sensors are followed at least this finely within a period."""

WIDTH = 16
"""Rigs that the kernel advances together: two vector registers of doubles."""


@dataclass
class State:
    """What a plant was in at a moment, lane by lane.

    Attributes:
        parts: Arrays whose last index is the lane.
    """

    parts: list[NDArray[Any]]


class Plant(ABC):
    """Rigs of one structure side by side, each commanded by its own voltage.

    Attributes:
        rigs: The rigs.
        count: How many.
        taps: Names of their taps.
        period_s: Control period, s.
        step_s: Time step of the physics, s; the period is a whole number of them.
    """

    step_s: float

    def __init__(self, rigs: Sequence[Rig], models: Sequence[Model], period_s: float) -> None:
        """Takes what all plants share.

        Args:
            rigs: The rigs.
            models: Their numbers.
            period_s: Control period, s.

        Raises:
            InputError: The rigs have another number of commands than one, or a tap's clock is off.
        """
        plan = models[0].plan
        if len(plan.commands) != 1:
            raise InputError(
                f"rig {rigs[0].name!r}: found {len(plan.commands)} valves, this controls one"
            )
        if not (math.isfinite(period_s) and 2e-4 <= period_s <= 1.0):
            raise InputError(f"period_s: found {period_s:g}, allowed are 0.0002 to 1 s")
        self.rigs = list(rigs)
        self.count = len(self.rigs)
        self.taps = tuple(plan.taps)
        self.period_s = period_s
        self._models = list(models)
        sensor = np.stack([m.sensor for m in models], axis=-1)  # (taps, 4, lanes)
        if np.any(sensor[:, S_OFFSET] != 0.0):
            raise InputError(f"rig {rigs[0].name!r}: a tap's clock is off, a controller's must not")
        self._samples = max(1, math.ceil(period_s / SAMPLE_S - 1e-9))
        self._sensor = sensor
        self._fit_samples(len(plan.port_valve))

    def _fit_samples(self, ports: int) -> None:
        """All that follows from the number of samples in a period."""
        sensor, models = self._sensor, self._models
        self._sample_s = self.period_s / self._samples
        lag = np.maximum(sensor[:, S_LAG], 1e-9)
        self._keep = np.exp(-self._sample_s / lag)
        self._ramp = (1.0 - self._keep) * lag / self._sample_s
        self._lags = bool(np.any(sensor[:, S_LAG] > 0.0))
        self._gain, self._bias = sensor[:, S_GAIN], sensor[:, S_BIAS]
        self._room = np.array([m.ambient[0] for m in models])
        self._spool = np.stack([m.spool for m in models])
        self._null_v = self._spool[:, 0, V_NULL].copy()
        self._curve = np.stack([m.curve for m in models])
        self._curve_v = np.stack([m.curve_v for m in models])
        self._port_valve = np.array(models[0].plan.port_valve, dtype=np.int64)
        self._opening = np.empty((self._samples * KNOTS_PER_SAMPLE + 1, ports, self.count))
        self._fit_past()

    def _fit_past(self) -> None:
        longest = longest_delay_s(self._spool[:, 0])
        self._past = math.ceil(longest / self._sample_s) + 1
        self._volts = np.repeat(self._null_v[:, None], self._past + self._samples + 1, axis=1)
        self._memory = np.zeros((self.count, 1, 4))
        self._close()

    def _close(self) -> None:
        """Spools at rest on a command that has long been the closed valve's."""
        self._volts[:] = self._null_v[:, None]
        self._memory[:, :, :2] = self._null_v[:, None, None]
        self._memory[:, :, 2:] = 0.0

    def set_delay(self, delay_s: Floats) -> None:
        """Sets how late commands reach the valves, from the next reset on.

        Args:
            delay_s: (count,) delay beyond the rig's own, s.
        """
        own = np.array([model.spool[0, V_DELAY] for model in self._models])
        self._spool[:, 0, V_DELAY] = own + delay_s
        self._fit_past()

    def reset(self, pressure_pa: Floats | float) -> Floats:
        """Fills what lies behind the valve with gas at rest; the valve has long been closed.

        Args:
            pressure_pa: (count,) pressure there, Pa; all else has its reservoir's.

        Returns:
            Readings as of `readings`.
        """
        self._close()
        self._at_taps = self._fill(np.broadcast_to(np.asarray(pressure_pa, float), (self.count,)))
        self._lagged = self._at_taps.copy()
        return self.readings()

    def step(self, volts: Floats | float) -> Floats:
        """Advances by one period under a voltage each.

        Args:
            volts: (count,) voltages.

        Returns:
            Readings at the end of the period, as of `readings`.

        Raises:
            InputError: A simulation became unstable.
        """
        # The last column begins only where the next period does.
        self._volts[:, : self._past] = self._volts[:, self._samples : self._samples + self._past]
        self._volts[:, self._past :] = np.broadcast_to(volts, (self.count,))[:, None]
        batch_openings(
            self._volts[:, None, :], self._sample_s, KNOTS_PER_SAMPLE, self._past, self._spool,
            self._memory, self._port_valve, self._curve_v, self._curve, self._opening,
        )  # fmt: skip
        series = self._advance(self._opening)
        if self._lags:
            before = self._at_taps
            for now in series:
                # First-order lag, exact for a pressure that is linear between samples.
                self._lagged = (
                    self._keep * self._lagged
                    + (self._ramp - self._keep) * before
                    + (1.0 - self._ramp) * now
                )
                before = now
        self._at_taps = series[-1]
        if not np.isfinite(self._at_taps).all():
            raise InputError(f"rig {self.rigs[0].name!r}: the simulation became unstable")
        return self.readings()

    def readings(self) -> Floats:
        """Returns what the sensors show now, without noise: (count, taps), Pa."""
        seen = self._lagged if self._lags else self._at_taps
        return np.ascontiguousarray((self._room + self._gain * (seen - self._room) + self._bias).T)

    def state(self) -> State:
        """Returns all that the future depends on, to come back to it with `set_state`."""
        parts = [np.moveaxis(self._volts, 0, -1), np.moveaxis(self._memory, 0, -1)]
        parts += [self._at_taps, self._lagged, *self._parts()]
        return State([part.copy() for part in parts])

    def set_state(self, state: State, lanes: NDArray[np.int64] | None = None) -> None:
        """Goes back to a state, or puts rigs into the states of others.

        Args:
            state: A state of this plant, or of one of the same structure.
            lanes: (count,) the lane of the state that each rig takes; None is its own.
        """
        take = np.arange(self.count) if lanes is None else np.asarray(lanes)
        volts, memory, at_taps, lagged, *rest = (part[..., take] for part in state.parts)
        self._volts = np.ascontiguousarray(np.moveaxis(volts, -1, 0))
        self._memory = np.ascontiguousarray(np.moveaxis(memory, -1, 0))
        self._at_taps, self._lagged = at_taps, lagged
        for own, part in zip(self._parts(), rest, strict=True):
            own[...] = part

    def set_step(self, step_s: float) -> None:
        """Sets the time step of the physics, from the next reset on.

        Args:
            step_s: Step that divides the period, s; shorter than the stable one.
        """
        steps = round(self.period_s / step_s)
        # Samples hold whole steps: the most samples, up to the usual, that divide the steps.
        usual = max(1, math.ceil(self.period_s / SAMPLE_S - 1e-9))
        self._samples = max(n for n in range(1, usual + 1) if steps % n == 0)
        self._fit_samples(self._opening.shape[1])
        self._take_steps(steps)
        self.step_s = self.period_s / steps

    @abstractmethod
    def _take_steps(self, steps: int) -> None: ...

    @abstractmethod
    def line(self, points: Sequence[tuple[str, int]]) -> Floats:
        """Gas at evenly spaced points of lines.

        Args:
            points: Pipes with their numbers of points.

        Returns:
            (count, 3 points): per pipe densities, kg/m^3, velocities, m/s, and pressures, Pa.
        """

    @abstractmethod
    def _fill(self, pressure_pa: Floats) -> Floats: ...

    @abstractmethod
    def _advance(self, opening: Floats) -> Floats: ...

    @abstractmethod
    def _parts(self) -> list[Floats]: ...


class PdePlant(Plant):
    """Rigs by the full model."""

    def __init__(
        self, rigs: Sequence[Rig], period_s: float, dx_m: float | None = None, gas: Gas = AIR
    ) -> None:
        """Builds the grids.

        Args:
            rigs: The rigs, of one structure.
            period_s: Control period, s; the time step divides it.
            dx_m: Cell length that replaces the rigs' own, m.
            gas: The gas.

        Raises:
            InputError: The rigs do not share one structure, or cannot be controlled so.
        """
        self.plan, models = _on_one_plan(rigs, dx_m, gas)
        super().__init__(rigs, models, period_s)
        # A whole number of steps in every sample, and so in every period.
        self._n_sub = max(1, math.ceil(self._sample_s / self.plan.dt_s - 1e-9))
        self.step_s = self._sample_s / self._n_sub
        self._gas = gas
        compliant = any(m.compliant for m in models)
        # Walls whose friction and heat remember nothing need no memory kept.
        memory = any(
            m.memory and any(p.wall.unsteady > 0.0 or p.wall.heat_unsteady > 0.0 for p in pipes)
            for m, pipes in zip(models, (r.pipes.values() for r in rigs), strict=True)
        )
        # The last tile is filled up, so that the kernel knows one width or two.
        count = -(-self.count // WIDTH) * WIDTH if self.count > 2 else self.count
        padded = [*models, *[models[-1]] * (count - self.count)]
        width = min(WIDTH, count)
        self._tiles = [
            tiles.pack(padded[i : i + width], compliant, memory) for i in range(0, count, width)
        ]
        self._lanes = [
            np.minimum(np.arange(i, i + width), self.count - 1) for i in range(0, count, width)
        ]

    def _take_steps(self, steps: int) -> None:
        self._n_sub = steps // self._samples

    def _fill(self, pressure_pa: Floats) -> Floats:
        first = self.rigs[0]
        fed = reservoir_of_pipes(first, self.plan)
        out = np.empty((len(self.taps), self.count))
        for tile, lanes in zip(self._tiles, self._lanes, strict=True):
            p = np.repeat(pressure_pa[None, lanes], self.plan.slots, axis=0)
            for name in first.pipes:
                start, n = self.plan.pipes[name]
                if name in fed:
                    p[start - 1 : start + n + 1] = tile.reservoir[fed[name], L.R_PRESSURE]
            tile.reservoir_p[:] = tile.reservoir[:, L.R_PRESSURE]
            tile.port_flow[:] = 0.0
            tile.set_time(0.0)
            tiles.fill_pipes(tile, p, tile.ambient[1])
            chambers = np.repeat(pressure_pa[None, lanes], len(self.plan.chambers), axis=0)
            tiles.fill_chambers(tile, chambers, np.tile(tile.ambient[1], (len(chambers), 1)))
            for t in range(len(self.taps)):
                slot = tile.tap_slot[t]
                for k, lane in enumerate(lanes):
                    if slot[k] >= 0:
                        w = tile.tap_weight[t, k]
                        out[t, lane] = (1.0 - w) * p[slot[k], k] + w * p[slot[k] + 1, k]
                    else:
                        out[t, lane] = pressure_pa[lane]
        return out

    def _advance(self, opening: Floats) -> Floats:
        series = np.empty((self._samples, len(self.taps), self.count))
        for tile, lanes in zip(self._tiles, self._lanes, strict=True):
            taps, _, _ = tiles.advance_safely(
                tile, self._samples + 1, self._n_sub, self.step_s,
                np.ascontiguousarray(opening[:, :, lanes]), strict=False,
            )  # fmt: skip
            series[:, :, lanes] = taps[1:]
        return series

    def _parts(self) -> list[Floats]:
        if len(self._tiles) == 1 and self._tiles[0].lanes == self.count:
            t = self._tiles[0]
            return [getattr(t, name) for name in tiles.CHANGING]
        return [_Spread(self._tiles, self._lanes, self.count, name) for name in tiles.CHANGING]  # type: ignore[misc]

    def line(self, points: Sequence[tuple[str, int]]) -> Floats:
        """Gas at evenly spaced points of lines; see `Plant.line`.

        Args:
            points: Pipes with their numbers of points.
        """
        columns = []
        for pipe, n in points:
            if pipe not in self.plan.pipes:
                raise InputError(
                    f"line: found pipe {pipe!r}, the rig has {', '.join(self.plan.pipes)}"
                )
            start, cells = self.plan.pipes[pipe]
            slots = start + np.minimum(((np.arange(n) + 0.5) * cells / n).astype(int), cells - 1)
            gas = np.empty((3, n, self.count))
            for tile, lanes in zip(self._tiles, self._lanes, strict=True):
                gas[:, :, lanes] = tiles.gas_in(tile, slots)
            columns.append(gas.reshape(3 * n, self.count).T)
        return np.concatenate(columns, axis=1)


class _Spread:
    """One array of all tiles as if it were one, its last index the rig."""

    def __init__(
        self, parts: list[tiles.Tile], lanes: list[NDArray[np.int64]], count: int, name: str
    ) -> None:
        self._parts = [getattr(part, name) for part in parts]
        self._lanes = lanes
        self._count = count

    def copy(self) -> Floats:
        whole = np.empty((*self._parts[0].shape[:-1], self._count))
        for part, lanes in zip(self._parts, self._lanes, strict=True):
            whole[..., lanes] = part
        return whole

    def __setitem__(self, key: Any, value: Floats) -> None:
        for part, lanes in zip(self._parts, self._lanes, strict=True):
            part[...] = value[..., lanes]


class LumpedPlant(Plant):
    """Rigs by a lumped model: the thin plate's, or the delay line's."""

    def __init__(self, rigs: Sequence[Rig], period_s: float, gas: Gas = AIR) -> None:
        """Reduces the rigs to their volumes.

        Args:
            rigs: The rigs, of one structure.
            period_s: Control period, s.
            gas: The gas.

        Raises:
            InputError: The rigs do not share one structure, or have no such reduction.
        """
        plan, _ = _on_one_plan(rigs, None, gas)
        kind = kind_of(rigs[0])
        if not isinstance(kind, Lumped):
            raise InputError(
                f"rig {rigs[0].name!r}: model: found {rigs[0].model}, with which no controller can"
                " be trained"
            )
        models = [kind.build(rig, plan, gas) for rig in rigs]
        super().__init__(rigs, [m.base for m in models], period_s)
        first = models[0]
        self._gas = gas
        self._first = first
        self._exponent = np.array([m.exponent for m in models])
        self._area = np.stack([m.area for m in models])
        self._linear = np.stack([m.linear for m in models])
        self._source = np.stack([m.source for m in models])
        widest = max(m.volume.shape[1] for m in models)  # one may have more relief valves
        self._volume = np.stack(
            [np.pad(m.volume, ((0, 0), (0, widest - m.volume.shape[1]))) for m in models]
        )
        self._tap_delay = np.stack([m.tap_delay_s for m in models])
        self._side_delay = np.stack([m.side_delay_s for m in models])
        self._drag = np.stack([m.drag for m in models])
        self._ambient = np.stack([m.base.ambient for m in models])
        fastest = max(lumped_batch.fastest(m) for m in models)
        # In powers of two, so that the step is the same for parameters that differ a little.
        steps = max(period_s * fastest / lumped_batch.STEP, self._samples * KNOTS_PER_SAMPLE)
        self._n_sub = 2 ** math.ceil(math.log2(steps))
        self.step_s = period_s / self._n_sub
        self._longest = max(
            filling.longest_delay(first.side, first.tap, m.tap_delay_s, m.side_delay_s)
            for m in models
        )
        n_sides = first.side.size
        self._y = np.zeros((self.count, n_sides + 2 * self._volume.shape[1]))
        self._take_steps(self._n_sub)
        self._head = np.zeros(self.count, dtype=np.int64)
        self._base = np.zeros((self.count, self._volume.shape[1]))
        self._out = np.zeros((self.count, len(self.taps)))

    def _take_steps(self, steps: int) -> None:
        self._n_sub = steps
        self._ring = np.zeros(
            (self.count, int(self._longest * steps / self.period_s) + 3, self._first.side.size)
        )

    def _fill(self, pressure_pa: Floats) -> Floats:
        self._base[:] = pressure_pa[:, None]
        self._ring[:] = 0.0
        self._head[:] = 0
        for j in range(self.count):
            filling.begin_volumes(
                self._base[j], self._volume[j], self._first.side.size, self._gas.r_specific,
                self._ambient[j], self._y[j],
            )  # fmt: skip
        seen = [
            self._source[:, -1 - place, 0] if place < 0 else self._base[:, place]
            for place in self._first.tap
        ]
        return np.stack(seen)

    def _advance(self, opening: Floats) -> Floats:
        filling.advance_volumes(
            self._n_sub, self.step_s, self._gas.gamma, self._gas.r_specific, self._exponent,
            self._first.side, self._area, self._linear, self._source, self._volume,
            self._first.tap, self._tap_delay, self._side_delay, self._drag, self._ambient,
            self._base, opening, self._y, self._ring, self._head, self._out,
        )  # fmt: skip
        # Sensors lag along a straight line through the period.
        share = (np.arange(self._samples) + 1.0) / self._samples
        now = self._out.T
        return self._at_taps + share[:, None, None] * (now - self._at_taps)

    def _parts(self) -> list[Floats]:
        return [
            np.moveaxis(self._y, 0, -1),
            np.moveaxis(self._ring, 0, -1),
            self._head,
            np.moveaxis(self._base, 0, -1),
        ]

    def line(self, points: Sequence[tuple[str, int]]) -> Floats:
        """A lumped model has no states along its lines.

        Args:
            points: Pipes with their numbers of points.

        Raises:
            InputError: Always.
        """
        raise InputError(
            f"line: found {', '.join(pipe for pipe, _ in points)}; the {self.rigs[0].model} model"
            " knows no gas along its lines"
        )


def _on_one_plan(rigs: Sequence[Rig], dx_m: float | None, gas: Gas) -> tuple[Plan, list[Model]]:
    """Plan of the first rig and the models of all on it."""
    plan = common_plan(rigs, dx_m)
    for other in rigs[1:]:
        if other.model != rigs[0].model:
            raise InputError(
                f"rig {other.name!r}: model: found {other.model}, {rigs[0].name!r} beside it has"
                f" {rigs[0].model}"
            )
    return plan, [build(rig, plan, gas) for rig in rigs]


def make_plant(
    rigs: Sequence[Rig], period_s: float, dx_m: float | None = None, gas: Gas = AIR
) -> Plant:
    """Builds the plant that the rigs' ``model`` asks for.

    Args:
        rigs: The rigs, of one structure.
        period_s: Control period, s.
        dx_m: Cell length of the full model that replaces the rigs' own, m.
        gas: The gas.

    Returns:
        The plant; `Plant.reset` begins.

    Raises:
        InputError: The rigs do not share one structure, or cannot be controlled so.
    """
    if kind_of(rigs[0]).along_lines:
        return PdePlant(rigs, period_s, dx_m, gas)
    return LumpedPlant(rigs, period_s, gas)
