# SPDX-License-Identifier: Apache-2.0
"""What plans would bring: rigs side by side, rolled out from one state under a voltage each."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_policy.control.predictive_settings import PredictiveSettings
from pneu_policy.control.shooting import cost
from pneu_sim.observe.drifts import Drifts, that_may_drift
from pneu_sim.plant import Plant, State
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Aim:
    """What is controlled, by what.

    Attributes:
        sensor: Tap or encoder that shall follow.
        used: Taps and encoders that the observer is told.
        signs: By command 1 where it is the voltage of a plan, -1 where it is as far on the other
            side of the null, as of the valve at the other side of a piston (thesis eq. 9.2); empty
            for the rig's only one.
    """

    sensor: str
    used: tuple[str, ...]
    signs: Mapping[str, float] = field(default_factory=dict)

    def signs_of(self, rig: Rig) -> Floats:
        """(commands,) the signs in the order of a rig's commands.

        Args:
            rig: The rig.

        Raises:
            InputError: The rig has no such sensor, or other commands.
        """
        known = {**rig.taps, **rig.encoders}
        for name in (self.sensor, *self.used):
            if name not in known:
                raise InputError(f"taps: {name!r}: rig {rig.name!r} has {', '.join(known)}")
        signs = self.signs or dict.fromkeys(rig.commands, 1.0)
        if set(signs) != set(rig.commands) or (not self.signs and len(signs) != 1):
            needed = ", ".join(self.signs) or "one alone"
            raise InputError(
                f"rig {rig.name!r}: found commands {', '.join(rig.commands)}, planned is {needed}"
            )
        return np.array([signs[name] for name in rig.commands])


class Horizon:
    """Plans of one voltage, tried on the model.

    A plan is a row of voltages, each held for the periods that the settings say. What is commanded
    in the periods before it, while it is being made, is decided.

    Attributes:
        lanes: How many plans are tried at once.
        knots: Voltages of a plan.
        scale: The unit of errors, Pa, rad or m.
        weight: What a volt of change from knot to knot counts as, in that unit.
    """

    def __init__(self, rig: Rig, aim: Aim, settings: PredictiveSettings, lanes: int) -> None:
        """Builds the rigs.

        Args:
            rig: The rig, with all that delays its commands.
            aim: What is controlled, by what.
            settings: How plans are made.
            lanes: How many plans are tried at once.

        Raises:
            InputError: The rig has no such sensor, or other commands.
        """
        self._signs = aim.signs_of(rig)
        self._commands = list(rig.commands)
        self.scale, self.weight = settings.scale, settings.weight
        self._s, self.lanes, self.knots = settings, lanes, len(settings.holds)
        fewest = settings.observer.fewest_cells
        member = that_may_drift(rig, settings.observer)
        self._plant = Plant([member] * lanes, settings.dx_m, fewest_cells=fewest)
        self._drifts = Drifts(self._plant, settings.observer, aim.used)
        plan = self._plant.plan
        self._at = [*plan.taps, *plan.encoders].index(aim.sensor)
        self._held = np.repeat(np.arange(self.knots), settings.holds)
        self._late, self._before_v = 0, settings.null_v
        self._from = np.zeros(lanes, dtype=np.int64)

    @property
    def ahead_s(self) -> Floats:
        """Times of the samples from now on, s."""
        s = self._s
        return np.asarray((1 + np.arange((s.every + s.periods) * s.samples)) * s.sample_s)

    def at_rest(self) -> tuple[State, Floats]:
        """Returns the state of one rig at rest, and that it is not off its file."""
        one = self._plant.state().of(np.zeros(1, dtype=np.int64))
        return one, np.zeros(len(self._drifts.unknowns))

    def begin(self, state: State, drifted: Floats) -> None:
        """Takes the state that plans begin from, and by how much the rig is off its file.

        Args:
            state: Of one rig on the same grid.
            drifted: (unknowns,) see `pneu_sim.observe.drifts.Drifts`.
        """
        self._state = state
        self._drifts.take(drifted)

    def late(self, late_s: float, before_v: float) -> None:
        """Says how much later than they are told commands reach the valve, from now on.

        Args:
            late_s: Beyond what the rig knows, s.
            before_v: What is in force until then, V.
        """
        self._late, self._before_v = max(0, round(late_s / self._s.sample_s)), before_v

    def roll(self, decided: Floats, plans: Floats) -> Floats:
        """What the sensor would show.

        Args:
            decided: (every,) what is commanded until the plans begin, V.
            plans: (lanes, knots) V.

        Returns:
            (samples, lanes) Pa, rad or m.
        """
        s = self._s
        volts = np.empty((self.lanes, s.every + s.periods))
        volts[:, : s.every] = decided
        volts[:, s.every :] = plans[:, self._held]
        told = np.repeat(volts, s.samples, axis=1)
        if self._late:
            told[:, self._late :] = told[:, : -self._late].copy()
            told[:, : self._late] = self._before_v
        each = self.each(told) + self._drifts.off_v().T[:, :, None]
        self._plant.set_state(self._state.of(self._from))
        _, readings = self._plant.advance(each, s.sample_s)
        return np.asarray(readings[1:, self._at])

    def each(self, volts: Floats) -> Floats:
        """What every valve is commanded.

        Args:
            volts: (..., periods) voltages of plans, V.

        Returns:
            (..., valves, periods) V.
        """
        other = 2.0 * self._s.null_v - volts
        return np.stack([volts if sign > 0.0 else other for sign in self._signs], axis=-2)

    def voltage_of(self, volts: Mapping[str, float]) -> float | None:
        """The voltage of a plan by which valves have these (`each`); None where one is not told.

        Args:
            volts: By command, V.
        """
        told = [volts.get(name, math.nan) for name in self._commands]
        null_v = self._s.null_v
        every = zip(told, self._signs, strict=True)
        one = [v if sign > 0.0 else 2.0 * null_v - v for v, sign in every]
        mean = sum(one) / len(one)
        return mean if math.isfinite(mean) else None

    def cost(self, error: Floats, plans: Floats, now_v: float) -> Floats:
        """(lanes,) sums of squares of errors and of changes of the voltage.

        Args:
            error: (samples, lanes) Pa, rad or m.
            plans: (lanes, knots) V.
            now_v: What is commanded until the plans begin, V.
        """
        return cost(error / self.scale, plans, now_v, self.weight)

    def every(self, plan: Floats) -> Floats:
        """(periods,) the voltage of every period of a plan.

        Args:
            plan: (knots,) V.
        """
        return np.asarray(plan[self._held])

    @property
    def middles_s(self) -> Floats:
        """(knots,) middles of what the voltages of a plan are held for, s after it begins."""
        ends = np.cumsum(self._s.holds)
        return np.asarray((ends - 0.5 * np.array(self._s.holds)) * self._s.period_s)

    def allowed(self, plans: Floats, now_v: float) -> Floats:
        """Plans within the range and the rate of the valve.

        Args:
            plans: (lanes, knots) V.
            now_v: What is commanded until the plans begin, V.
        """
        s = self._s
        out = np.clip(plans, s.low_v, s.high_v)
        if s.most_rate_v_s is not None:
            most = s.most_rate_v_s * s.period_s
            before = np.full(len(out), now_v)
            for k in range(self.knots):
                out[:, k] = before = np.clip(out[:, k], before - most, before + most)
        return np.asarray(out)
