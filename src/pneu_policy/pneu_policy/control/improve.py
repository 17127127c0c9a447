# SPDX-License-Identifier: Apache-2.0
"""How a plan is made better: by differences between rigs side by side, or by draws (MPPI).

None needs a derivative of the model. All draws are common to what is compared, and a plan is
warm-started by the last one.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pneu_policy.control.horizon import Horizon
from pneu_policy.control.predictive_settings import PredictiveSettings
from pneu_policy.control.shooting import LANES, differences, steps_of

Floats = NDArray[np.float64]

DAMPING = (1e-4, 1e-2, 1.0)
"""Levenberg-Marquardt terms that are tried, relative to the mean square of the derivatives."""
UNTRIED = 1e-2
"""That of a step which is taken untried."""
LARGE_V = 1.0
"""A step that changes a voltage by so much is tried first: a linear model may not reach so far. So
is one that takes a voltage farther than it is from null, and farther than differences told: there
the flow bends most, and a spool that differences did not move out of its dead band seems to need
many times what it does."""
LEARN = 0.1
"""Share of the variances of the draws that is learnt anew with every plan."""
LEAST, MOST = 0.4, 2.0
"""The spread of the draws stays within these shares of what it began with."""


class Improve(Protocol):
    """A way of making a plan better.

    Attributes:
        lanes: How many plans it tries at once.
    """

    lanes: int

    def better(self, horizon: Horizon, plan: Floats, target: Floats, decided: Floats) -> Floats:
        """A better plan, or the same.

        Args:
            horizon: Where it is tried; it has begun.
            plan: (knots,) V.
            target: (samples,) Pa, rad or m.
            decided: (every,) what is commanded until it begins, V.
        """

    def reset(self) -> None:
        """Forgets what it has learnt."""


class GaussNewton:
    """One step of Gauss and Newton with box constraints, derivatives by differences.

    One roll-out of all differences makes a step, which is taken untried as in the real-time
    iteration of Diehl, Bock and Schloeder (2005, SIAM J. Control Optim. 43, 1714): the next plan
    begins from where it led. A step that goes farther than a linear model may hold is tried first
    (``LARGE_V``), in several dampings and lengths; a second roll-out says which is best, if any
    (Nocedal and Wright, Numerical Optimization, 2nd ed. 2006, ch. 10).
    """

    def __init__(self, settings: PredictiveSettings) -> None:
        """Starts anew.

        Args:
            settings: How plans are made.
        """
        self._s = settings
        self.lanes = -(-max(1 + len(settings.holds), 2 * len(DAMPING) + 1) // LANES) * LANES
        self.reset()

    def reset(self) -> None:
        """Begins with the first difference."""
        self._turn = 0

    def better(self, horizon: Horizon, plan: Floats, target: Floats, decided: Floats) -> Floats:
        """See `Improve.better`.

        Args:
            horizon: Where it is tried.
            plan: (knots,).
            target: (samples,).
            decided: (every,).
        """
        s, knots, now_v = self._s, horizon.knots, float(decided[-1])
        plans, signed = differences(plan, self._turn, self.lanes, s.low_v, s.high_v)
        self._turn += 1
        seen = horizon.roll(decided, plans)
        if not np.isfinite(seen).all():
            return plan
        dampings, bounds = (UNTRIED, *DAMPING), (s.low_v, s.high_v)
        error, (first, *steps) = steps_of(
            plan, seen, signed, target, now_v, bounds, horizon.weight, dampings, horizon.scale
        )
        quick = horizon.allowed((plan + first)[None], now_v)[0]
        far = np.abs(quick - plan)
        if not np.any(far >= np.clip(np.abs(plan - s.null_v), np.abs(signed), LARGE_V)):
            return np.asarray(quick)
        tried = [plan + 0.5**k * step for k in range(2) for step in steps]
        tried += [np.full(knots, s.null_v)] * (self.lanes - len(tried))
        candidates = horizon.allowed(np.stack(tried[: self.lanes]), now_v)
        costs = horizon.cost(horizon.roll(decided, candidates) - target[:, None], candidates, now_v)
        costs = np.where(np.isfinite(costs), costs, np.inf)
        best = int(np.argmin(costs))
        stay = float(horizon.cost(error[:, None] * horizon.scale, plan[None], now_v)[0])
        return np.asarray(candidates[best]) if costs[best] < stay else plan


class PathIntegral:
    """Model-predictive path-integral control, with or without variances that are learnt.

    Plans are drawn about the last one, half of them as mirror images of the others, and their mean
    is taken with weights that fall exponentially with their costs (Williams et al. 2017, IEEE
    Trans. Robot. 34, 1603). Learnt, the variance of every voltage is that of the same weights, as
    in the covariance adaptation of path integrals (Stulp and Sigaud 2012, ICML); whole covariances
    of so few draws run away.
    """

    def __init__(self, settings: PredictiveSettings) -> None:
        """Starts anew.

        Args:
            settings: How plans are made.
        """
        self._s = settings
        self.lanes = settings.plans
        self._adapts = settings.method == "adaptive"
        self.reset()

    def reset(self) -> None:
        """Draws by the spread of the settings, from the first draw on."""
        knots = len(self._s.holds)
        self._rng = np.random.default_rng([self._s.observer.seed, 9])
        self._variance = np.full(knots, self._s.spread_v**2)

    def better(self, horizon: Horizon, plan: Floats, target: Floats, decided: Floats) -> Floats:
        """See `Improve.better`.

        Args:
            horizon: Where it is tried.
            plan: (knots,).
            target: (samples,).
            decided: (every,).
        """
        s, count, now_v = self._s, self.lanes, float(decided[-1])
        half = self._rng.standard_normal((count // 2, horizon.knots))
        drawn = np.concatenate([half, -half])[: count - 1] * np.sqrt(self._variance)
        plans = horizon.allowed(plan + np.concatenate([np.zeros((1, horizon.knots)), drawn]), now_v)
        costs = horizon.cost(horizon.roll(decided, plans) - target[:, None], plans, now_v)
        fine = np.isfinite(costs)
        if not fine[0]:
            return plan
        width = s.temperature * max(float(np.std(costs[fine])), 1e-12)
        least = float(costs[fine].min())
        weights = np.where(fine, np.exp(-(np.where(fine, costs, least) - least) / width), 0.0)
        weights /= weights.sum()
        mean = weights @ plans
        if self._adapts:
            # about the plan before, so that what keeps going one way is drawn farther
            learnt = weights @ (plans - plan) ** 2
            self._variance = (1.0 - LEARN) * self._variance + LEARN * learnt
            least, most = (LEAST * s.spread_v) ** 2, (MOST * s.spread_v) ** 2
            self._variance = np.clip(self._variance, least, most)
        return np.asarray(mean)


def improvement(settings: PredictiveSettings) -> Improve:
    """The way that settings ask for.

    Args:
        settings: How plans are made.
    """
    return GaussNewton(settings) if settings.method == "gauss_newton" else PathIntegral(settings)
