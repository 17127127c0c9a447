# SPDX-License-Identifier: Apache-2.0
"""What plans would bring: rigs side by side, rolled out from one state under a voltage each."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_policy.control.predictive_settings import PredictiveSettings
from pneu_policy.control.shooting import SCALE_PA, cost
from pneu_sim.observe.drifts import Drifts
from pneu_sim.plant import Plant, State
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]


class Horizon:
    """Plans of one valve, tried on the model.

    A plan is a row of voltages, each held for the periods that the settings say. What is commanded
    in the periods before it, while it is being made, is decided.

    Attributes:
        lanes: How many plans are tried at once.
        knots: Voltages of a plan.
    """

    def __init__(
        self,
        rig: Rig,
        tap: str,
        taps: Sequence[str],
        settings: PredictiveSettings,
        lanes: int,
    ) -> None:
        """Builds the rigs.

        Args:
            rig: The rig, with all that delays its commands.
            tap: Tap that shall follow.
            taps: Taps that the observer is told.
            settings: How plans are made.
            lanes: How many plans are tried at once.

        Raises:
            InputError: The rig has no such tap, or not one valve.
        """
        if tap not in rig.taps:
            raise InputError(f"tap {tap!r}: rig {rig.name!r} has {', '.join(rig.taps)}")
        if len(rig.commands) != 1:
            raise InputError(f"rig {rig.name!r}: found {len(rig.commands)} valves, needed is one")
        self._s, self.lanes, self.knots = settings, lanes, len(settings.holds)
        fewest = settings.observer.fewest_cells
        self._plant = Plant([rig] * lanes, settings.dx_m, fewest_cells=fewest)
        self._drifts = Drifts(self._plant, settings.observer, taps)
        self._at = self._plant.plan.taps.index(tap)
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
        """What the tap would show.

        Args:
            decided: (every,) what is commanded until the plans begin, V.
            plans: (lanes, knots) V.

        Returns:
            (samples, lanes) Pa.
        """
        s = self._s
        volts = np.empty((self.lanes, s.every + s.periods))
        volts[:, : s.every] = decided
        volts[:, s.every :] = plans[:, self._held]
        told = np.repeat(volts, s.samples, axis=1)
        if self._late:
            told[:, self._late :] = told[:, : -self._late].copy()
            told[:, : self._late] = self._before_v
        each = told[:, None, :] + self._drifts.off_v().T[:, :, None]
        self._plant.set_state(self._state.of(self._from))
        _, readings = self._plant.advance(each, s.sample_s)
        return np.asarray(readings[1:, self._at])

    def cost(self, error: Floats, plans: Floats, now_v: float) -> Floats:
        """(lanes,) sums of squares of errors and of changes of the voltage.

        Args:
            error: (samples, lanes) Pa.
            plans: (lanes, knots) V.
            now_v: What is commanded until the plans begin, V.
        """
        return cost(error / SCALE_PA, plans, now_v, self.weight)

    @property
    def weight(self) -> float:
        """What a volt of change from knot to knot counts as, in the unit of errors."""
        return self._s.smooth_pa_per_v / SCALE_PA

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
