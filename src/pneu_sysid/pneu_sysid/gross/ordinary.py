# SPDX-License-Identifier: Apache-2.0
"""What an ordinary fit would make of a rig: some Gauss-Newton steps of what datasheets leave open.

The cost is the sum of the logarithms of the taps' errors, so that no tap drowns another's.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.parameters import get_parameter, with_parameters
from pneu_sim.rig.schema import Rig
from pneu_sysid.gross.guesses import Guess
from pneu_sysid.problem import Problem, make_problem
from pneu_sysid.records import Recording
from pneu_sysid.sensor_units import encoder_units, unit_of

Floats = NDArray[np.float64]

PULL_S = 0.3
"""Long enough for a wrong part to show, short enough for two Gauss-Newton steps to converge."""
LEAD_S = 0.4
"""How a recording begins is not looked for: what follows of it is forgotten after a pull."""
STEP = 0.02
DAMPINGS = (1e-3, 1e-1, 1e1)
PRIOR = 0.05
"""Weight of a knob's prior, in the logarithm of the error: three sigmas cost a fifth."""
NOISE_FLOOR = 3.0
SPREAD_FLOOR = 0.02
"""Errors below three times the noise, or 2 % of how far the pressures spread, are not gross."""
LOST = 10.0
"""What cannot be simulated counts as so many times the spread."""
DELAY_S = 2e-3
"""Limits of a spool's speed and delays that no datasheet has, one sigma."""


@dataclass(frozen=True)
class Knob:
    """What an ordinary fit may change: by its standard deviation, and at most by its reach.

    Its paths are scaled by the exponential of how far it is turned.

    Attributes:
        paths: What it scales.
        std: One standard deviation.
        reach: How far it may be turned.
        curve_of: Valve whose opening curves it bends.
        delay_of: Valve that it delays.
    """

    paths: tuple[str, ...]
    std: float
    reach: float
    curve_of: str = ""
    delay_of: str = ""

    def bend(self, rig: Rig, x: float) -> None:
        """Bends a valve's opening curves by the exponent x, or delays it.

        Args:
            rig: The rig; it is changed.
            x: How far the knob is turned.
        """
        if self.delay_of:
            rig.valves[self.delay_of].spool.delay_s += DELAY_S * max(x, 0.0)
        if not self.curve_of:
            return
        valve = rig.valves[self.curve_of]
        for port in valve.ports.values():
            curve = port.opening
            if curve.mirror is None:
                away = np.abs(np.array(curve.voltage_v) - valve.spool.null_v)
                share = np.maximum(away / away.max(), 1e-3)
                curve.fraction = [float(v) for v in np.array(curve.fraction) * share**x]


def knobs_of(rig: Rig) -> list[Knob]:
    """What an ordinary fit would change most, with the uncertainty that datasheets have.

    Args:
        rig: The rig.
    """
    out = []
    for v, valve in rig.valves.items():
        for p, port in valve.ports.items():
            size = "conductance_m3_s_pa" if port.model == "iso6358" else "area_m2"
            out.append(Knob((f"valves.{v}.ports.{p}.{size}",), 0.3, 0.7))
        out.append(Knob((), 0.3, 0.8, curve_of=v))
        out.append(Knob((), 1.0, 3.0, delay_of=v))
        if valve.spool.bandwidth_hz is not None:
            out.append(Knob((f"valves.{v}.spool.bandwidth_hz",), 0.3, 1.1))
    out += [Knob((f"orifices.{o}.conductance_m3_s_pa",), 0.3, 0.7) for o in rig.orifices]
    out += [Knob((f"chambers.{c}.volume_m3",), 0.2, 0.6) for c in rig.chambers]
    for name, reservoir in rig.reservoirs.items():
        if reservoir.pressure_pa > 1.05 * rig.ambient.pressure_pa:
            out.append(Knob((f"reservoirs.{name}.pressure_pa",), 0.03, 0.1))
    return out


class Bench:
    """Recordings and a structure, and what rigs of that structure leave there.

    Attributes:
        rig: The structure.
        problem: It and the recordings, without fits of how they begin.
        noise_pa: (n_sensors,) noise of each, Pa, rad or m; of encoders the others are no Pa either.
        seen: (n_stretches, horizon, n_taps) readings that count.
        count: (n_taps,) how many they are.
        spread_pa: (n_taps,) how far they spread.
        floor_pa: (n_taps,) what is no gross error.
    """

    def __init__(self, rig: Rig, recordings: list[Recording], like: Problem) -> None:
        """Prepares the recordings.

        Args:
            rig: The structure.
            recordings: The recordings.
            like: A problem whose noise and cells are taken.
        """
        self.rig = rig.model_copy(deep=True)
        for name, noise in zip(like.taps, like.noise_pa.tolist(), strict=True):
            if name in self.rig.taps:
                told: dict[str, float] = {"noise_pa": noise, "quantum_pa": 0.0}
                self.rig.taps[name] = self.rig.taps[name].model_copy(update=told)
            else:
                told = {"noise": noise, "quantum": 0.0}
                self.rig.encoders[name] = self.rig.encoders[name].model_copy(update=told)
        self.problem = make_problem(self.rig, recordings, PULL_S, like.dx_m, like.workers)
        self.noise_pa = self.problem.noise_pa
        measured, time = self.problem.measured, self.problem.time_s
        first = np.nanmin(time, axis=(1, 2), keepdims=True)
        self.seen = np.isfinite(measured) & (time > first + LEAD_S)
        self.count = np.maximum(self.seen.sum(axis=(0, 1)), 1)
        values = np.where(self.seen, measured, 0.0)
        mean = values.sum(axis=(0, 1)) / self.count
        spread = np.sqrt(np.sum(np.where(self.seen, values - mean, 0.0) ** 2, axis=(0, 1)))
        spread /= np.sqrt(self.count)
        # (a supply hardly moves: what is a small part of all motion is not looked at more closely)
        units = encoder_units(self.rig)
        kind = np.array([unit_of(name, units).si for name in self.problem.taps])
        most = np.array([spread[kind == one].max() for one in kind])  # of all in one unit
        self.spread_pa = np.maximum(spread, 0.3 * most)
        self.floor_pa = np.hypot(NOISE_FLOOR * self.noise_pa, SPREAD_FLOOR * self.spread_pa)

    def left(self, rigs: Sequence[Rig]) -> Floats:
        """(n_rigs, n_stretches, horizon, n_taps) measured minus predicted, Pa.

        Args:
            rigs: Rigs of the structure.
        """
        y = self.problem.simulate(rigs, strict=False).readings
        left = np.where(self.seen, self.problem.measured - y, 0.0)
        return saturated(left, LOST * self.spread_pa) * self.seen

    def mean(self, left: Floats) -> Floats:
        """(..., n_taps) mean squares, Pa^2.

        Args:
            left: (..., n_stretches, horizon, n_taps), Pa.
        """
        return np.asarray(np.sum(left * left, axis=(-3, -2)) / self.count)

    def score(self, left: Floats) -> Floats:
        """Sum of the logarithms of the taps' errors.

        Args:
            left: (..., n_stretches, horizon, n_taps), Pa.
        """
        return np.asarray(0.5 * np.sum(np.log(self.mean(left) + self.floor_pa**2), axis=-1))


def saturated(left: Floats, wild: Floats) -> Floats:
    """Return residuals no larger than a limit, with their sign; the limit where there is none.

    A residual that passes the lower limit must not jump to the upper one: differences over a step
    would take the jump for a slope.

    Args:
        left: (..., n_taps) residuals; NaN where nothing could be simulated.
        wild: (n_taps,) limits, positive.
    """
    return np.asarray(np.clip(np.where(np.isnan(left), wild, left), -wild, wild))


@dataclass
class Settled:
    """A guess after some Gauss-Newton steps.

    Attributes:
        guess: The guess.
        bench: What it is measured on.
        x: (n_knobs,) how far each of `knobs_of` is turned.
        left: (n_stretches, horizon, n_taps) measured minus predicted, Pa.
        cost: The cost, prior included.
        done: Whether further steps gain nothing.
    """

    guess: Guess
    bench: "Bench"
    x: Floats
    left: Floats
    cost: float
    done: bool = False

    @property
    def mean_pa2(self) -> Floats:
        """(n_taps,) mean square of what is left, Pa^2."""
        return self.bench.mean(self.left)

    @property
    def times_noise(self) -> float:
        """What is left of all taps, in times the noise."""
        return float(np.sqrt(np.mean(self.mean_pa2 / self.bench.noise_pa**2)))


def turned(rig: Rig, knobs: list[Knob], x: Floats) -> Rig:
    """A rig with its knobs turned.

    Args:
        rig: The rig.
        knobs: Its knobs.
        x: (n_knobs,) how far each is turned.
    """
    scaled = {
        path: get_parameter(rig, path) * math.exp(value)
        for knob, value in zip(knobs, x, strict=True)
        for path in knob.paths
    }
    out = with_parameters(rig, scaled)
    for knob, value in zip(knobs, x, strict=True):
        knob.bend(out, float(value))
    return out


def settle(at: Settled, steps: int) -> Settled:
    """Gives a guess some damped Gauss-Newton steps of what an ordinary fit would change.

    Args:
        at: Where it stands.
        steps: How many at most.
    """
    bench, rig = at.bench, at.guess.rig
    knobs = knobs_of(rig)
    std, reach = np.array([k.std for k in knobs]), np.array([k.reach for k in knobs])
    x, r, cost, done = at.x, at.left, at.cost, at.done
    for _ in range(steps):
        if done or not knobs:
            break
        points = [x + STEP * e for e in np.eye(len(knobs))]
        change = (bench.left([turned(rig, knobs, p) for p in points]) - r) / STEP
        weight = 1.0 / np.sqrt((bench.mean(r) + bench.floor_pa**2) * bench.count)
        a = (change * weight).reshape(len(knobs), -1)
        hessian = a @ a.T + np.diag(PRIOR / std**2)
        gradient = a @ (r * weight).ravel() + PRIOR * x / std**2
        trials = [
            _bounded(hessian + d * np.diag(np.diag(hessian)), gradient, x, reach) for d in DAMPINGS
        ]
        found = bench.left([turned(rig, knobs, y) for y in trials])
        costs = bench.score(found) + 0.5 * PRIOR * np.sum((np.array(trials) / std) ** 2, axis=1)
        k = int(np.argmin(costs))
        done = not float(costs[k]) < cost - 0.01
        if costs[k] < cost:
            x, r, cost = trials[k], found[k], float(costs[k])
    return replace(at, x=x, left=r, cost=cost, done=done)


def _bounded(hessian: Floats, gradient: Floats, x: Floats, reach: Floats) -> Floats:
    """Where a Newton step leads within bounds, what meets one being held there."""
    step = np.zeros(x.size)
    free = np.ones(x.size, dtype=bool)
    while free.any():
        rest = gradient + hessian[:, ~free] @ step[~free]
        step[free] = -np.linalg.solve(hessian[np.ix_(free, free)], rest[free])
        beyond = free & (np.abs(x + step) > reach)
        if not beyond.any():
            break
        step[beyond] = np.clip(x + step, -reach, reach)[beyond] - x[beyond]
        free &= ~beyond
    return np.asarray(np.clip(x + step, -reach, reach))
