# SPDX-License-Identifier: Apache-2.0
"""Bounded Gauss-Newton with a batched Jacobian: every column and every trial step is one batch.

Where many variables only matter in combination the way down is a narrow bent valley, out of which a
straight step leads. So steps are bent as the residual itself does along them (geodesic
acceleration: Transtrum and Sethna 2012, arXiv:1201.5885).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from pneu_sysid.slopes import Residuals, Variable, jacobian, looked_along

Floats = NDArray[np.float64]

FEW = 8
"""So many variables need no finely graded damping; where none of their steps gains, shorter ones
are tried: a position along a pipe has kinks, past which a slope tells nothing."""
DAMPINGS = (1e-6, 1e-3, 1e-1, 1e1)
LAST_DAMPINGS = (1e2, 1e3, 1e4)
FINER_DAMPINGS = (1e-8, 1e-6, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 1e1)
"""Of more variables; all of them are tried at first, then ... The least one is little even beside
what is known beforehand of combinations that data hardly show, a millionth is not."""
BELOW, BESIDE = 2, 4
"""... so many about the last best, beginning so far below it."""
AS_FORECAST = 0.9
"""A step that gains so much of what the best linear forecast promises need not be bent."""
PROBE = 0.1
"""The residual is looked at after this part of a step, to see how it bends."""
MOST_BENT = 0.75
"""Twice the bend is at most this part of the step; a longer bend is not to be trusted."""
FAR_FROM_FORECAST = 0.5
"""Where no step gains so much of the forecast, nor what is worth another, ..."""
PARTS = (0.5, 0.25, 0.1)
"""... so much of the least damped one is tried: damping shortens a step along what data hardly show
before it shortens what bends, be that a number that nothing else depends on."""
LAST_LOOKS = 6
"""At the end what data hardly show is looked along so often at most, a step each, as long as that
gains."""
SECANT_WORTH = 0.05
"""A step that takes away so much of the cost is followed by one with the same Jacobian."""
ROUNDING = float(np.sqrt(np.finfo(float).eps))
"""A step that changes residuals by no more than this share of them does not correct the Jacobian.

Half of the digits of such a change are rounding, which the update divides by the step's length."""
MOST_FORECAST = 2.0
"""A cluster that is left out counts with no more than this times the usual residual."""
HUBER = 3.0
"""Residuals beyond this many noise deviations count linearly under the robust loss."""


@dataclass(frozen=True)
class Estimate:
    """Result of a fit.

    Attributes:
        values: (P,) estimates.
        std_errors: (P,) standard errors, robust against correlation within a stretch: what leaving
            out stretch after stretch makes of the estimate, and what the prior's centre may be off.
        covariance: (P, P).
        correlation: (P, P).
        condition: Condition number of the column-scaled Jacobian.
        cost: Half the sum of squares at the end, prior included.
        history: Cost after each iteration, the start first.
        gained: Share of the data's cost at the start that is gone at the end.
        ahead: By how much the cost is to fall yet, by the last linear forecast.
        residual: (n_clusters, m) at the estimate.
        jacobian: (n_clusters, m, P) at the last linearisation.
        gain: (P, P) what the estimate becomes by per unit of a score ``J^T r``.
        left_out: (n_clusters, m) residual of each cluster at the estimate from all others.
        at_bound: (P,) which estimates sit on a bound.
        visible: (P,) whether the data constrain the parameter at all.
        weight: Deviations of noise that count as one against the prior (`_noise_of_scores`).
    """

    values: Floats
    std_errors: Floats
    covariance: Floats
    correlation: Floats
    condition: float
    cost: float
    history: list[float]
    gained: float
    ahead: float
    residual: Floats
    jacobian: Floats
    gain: Floats
    left_out: Floats
    at_bound: NDArray[np.bool_]
    visible: NDArray[np.bool_]
    weight: float = 1.0

    def amounts(self, residuals: Floats, held: NDArray[np.bool_] | None = None) -> Floats:
        """How far the variables would move for other residuals, to first order, without bounds.

        Args:
            residuals: (K, n_clusters, m).
            held: (P,) which variables stay; None is none.

        Returns:
            (K, P): what they explain is ``jacobian`` times that.
        """
        free = np.einsum("smp,ksm->kp", self.jacobian, residuals) @ self.gain
        if held is None or not held.any():
            return np.asarray(free)
        # the gain is the inverse of what the variables are known by: holding some is conditioning
        own = np.linalg.pinv(self.gain[np.ix_(held, held)], hermitian=True)
        out = free - free[:, held] @ own @ self.gain[held]
        out[:, held] = 0.0
        return np.asarray(out)


def _weights(r: Floats, robust: bool) -> Floats:
    """Square roots of the Huber weights."""
    if not robust:
        return np.ones_like(r)
    return np.sqrt(np.minimum(1.0, HUBER / np.maximum(np.abs(r), 1e-12)))


def huber_cost(r: Floats) -> float:
    """Robust half sum of squares: linear beyond ``HUBER`` noise deviations.

    Args:
        r: Residuals in noise units, any shape.
    """
    a = np.abs(r)
    return float(np.sum(np.where(a <= HUBER, 0.5 * a * a, HUBER * (a - 0.5 * HUBER))))


def _cost(r: Floats, robust: bool) -> float:
    return huber_cost(r) if robust else 0.5 * float(np.sum(r * r))


def minimise(
    residuals: Residuals,
    variables: Sequence[Variable],
    iterations: int = 10,
    tolerance: float = 1e-3,
    robust: bool = False,
    ties: tuple[Floats, Floats] | None = None,
    secants: int = 0,
    slope: Floats | None = None,
    along: bool = False,
    both: bool = False,
) -> Estimate:
    """Minimises the sum of squared residuals plus a Gaussian prior, within bounds.

    Each iteration linearises by one batched call, solves the bounded linear problem at several
    dampings, and tries all of those steps in one more batched call (thesis 8.1.2, with bounds by an
    active set instead of a barrier). As long as that pays, the Jacobian is corrected by what the
    step has shown (Broyden 1965) and used again.

    Args:
        residuals: Batched residual function, in units of the noise.
        variables: What to estimate.
        iterations: At most this many.
        tolerance: Stops when the cost falls by less than this fraction.
        robust: Huber loss instead of squares.
        ties: Prior relations between variables, (K, P) matrix and (K,) right side, in units of
            their standard deviation: the smoothness of a curve.
        secants: Steps that may be taken besides with a Jacobian corrected by secants, for each that
            is computed.
        slope: (n_clusters, m, P) Jacobian to begin with, of nearly the same problem; None computes
            it.
        along: Whether what residuals hardly show is looked along (`looked_along`), wherever the
            Jacobian is computed and at the end.
        both: Whether the Jacobian is of differences to both sides, which kinks do not mislead.

    Returns:
        The estimate.
    """
    tie_a, tie_b = ties if ties is not None else (np.zeros((0, len(variables))), np.zeros(0))
    x = np.array([v.value for v in variables], dtype=float)
    lower = np.array([v.lower for v in variables])
    upper = np.array([v.upper for v in variables])
    span = np.array([v.upper - v.lower for v in variables])
    centre = np.array([v.value if v.centre is None else v.centre for v in variables])
    precision = np.array([0.0 if np.isinf(v.std) else 1.0 / v.std for v in variables])
    x = np.clip(x, lower, upper)

    prior = precision

    def total(r: Floats, at: Floats) -> float:
        apart = np.concatenate([(at - centre) * prior, scale * (tie_a @ at - tie_b)])
        return _cost(r, robust) + 0.5 * float(np.sum(apart**2))

    def linearised(w: Floats) -> _Linear:
        flat = (j * w[..., None]).reshape(-1, x.size)
        # residual is measured - model, so the model's sensitivities are -j
        a = np.vstack([flat * span, np.diag(prior * span), scale * tie_a * span])
        return _Linear.of(
            a,
            np.concatenate([(r * w).ravel(), prior * (x - centre), scale * (tie_a @ x - tie_b)]),
            r.size,
        )

    scale, best_damping = 1.0, None
    history: list[float] = []
    if slope is None:
        r, j = jacobian(residuals, x, variables, both=both)
    else:
        r, j = residuals([x])[0], slope
    if along:
        j = looked_along(residuals, x, r, j, variables)
    history.append(total(r, x))
    begun = _cost(r, robust)
    left, reused = iterations - 1, 0
    fresh, rescaled = slope is None, False
    looks = 0
    while True:
        w = _weights(r, robust)
        if fresh or not rescaled:
            # by what the step would leave: what it takes away says nothing against the prior
            ahead = _after(j * w[..., None], r * w, x, centre, precision, span)
            scale, rescaled = _noise_of_scores(j * w[..., None], ahead), True
            prior = precision * scale
        cost = total(r, x)
        linear = linearised(w)
        low, high = (lower - x) / span, (upper - x) / span
        for dampings in _dampings(x.size, best_damping):
            steps = linear.steps(low, high, dampings)
            trials = [np.clip(x + step * span, lower, upper) for step in steps]
            found = residuals(trials)
            costs = [total(found[k], trials[k]) for k in range(len(trials))]
            forecast = max(linear.gain(step) for step in steps)
            if x.size > FEW and cost - np.nanmin(costs) < AS_FORECAST * forecast:
                bends = _bends(residuals, x, trials, r, j)
                bent = [
                    np.clip(y + linear.bent(step, bend * w, damping) * span, lower, upper)
                    for y, step, bend, damping in zip(trials, steps, bends, dampings, strict=True)
                ]
                trials, found = [*trials, *bent], np.concatenate([found, residuals(bent)])
                costs += [total(found[k], trials[k]) for k in range(len(steps), len(trials))]
            won = cost - np.nanmin(costs)
            if x.size > FEW and won < min(tolerance * cost, FAR_FROM_FORECAST * forecast):
                parts = [x + part * (trials[0] - x) for part in PARTS]
                found = np.concatenate([found, residuals(parts)])
                trials = [*trials, *parts]
                costs += [total(found[k], trials[k]) for k in range(len(costs), len(trials))]
            best = int(np.nanargmin(costs))
            gain = (cost - costs[best]) / max(cost, 1e-300)
            if gain > 0.0:
                # steps, then the same bent, then parts of the least damped one
                best_damping = dampings[best % len(steps) if best < 2 * len(steps) else 0]
                break
        if gain > 0.0:
            # nor is it spoilt along what residuals hardly show by how they bend along a step
            change = found[best] - r
            if not looks and np.linalg.norm(change) > ROUNDING * np.linalg.norm(r):
                j = _secant(j, change, (trials[best] - x) / span, span)
            x, r = trials[best], found[best]
            history.append(costs[best])
        if gain > SECANT_WORTH and reused < secants:
            fresh, reused = False, reused + 1
            continue
        if left < 1 or (gain < tolerance and (fresh or gain > 0.0)):
            # along a valley the cost falls by little, but by more than chance
            if not along or looks == LAST_LOOKS or (looks and gain * cost < scale**2):
                break
            j, looks = looked_along(residuals, x, r, j, variables), looks + 1
            continue
        r, j = jacobian(residuals, x, variables, r, both)
        if along:
            j = looked_along(residuals, x, r, j, variables)
        fresh, left, reused = True, left - 1, 0
    gained = 1.0 - _cost(r, robust) / max(begun, 1e-300)
    last = linearised(_weights(r, robust))
    yet = last.gain(last.steps((lower - x) / span, (upper - x) / span, DAMPINGS[:1])[0])
    return _summary(x, r, j, variables, precision, scale, history, gained, yet, robust, tie_a)


def _bends(
    residuals: Residuals, x: Floats, trials: Sequence[Floats], r: Floats, j: Floats
) -> list[Floats]:
    """(n_clusters, m) second derivatives of the residual along trial steps, one for each.

    Args:
        residuals: Batched residual function.
        x: (P,) point.
        trials: (P,) ends of the steps.
        r: (n_clusters, m) residual at the point.
        j: (n_clusters, m, P) Jacobian there.
    """
    probed = residuals([x + PROBE * (y - x) for y in trials])
    return [
        2.0 / PROBE * ((p - r) / PROBE - j @ (y - x)) for p, y in zip(probed, trials, strict=True)
    ]


def _dampings(size: int, last: float | None) -> Iterator[tuple[float, ...]]:
    """Dampings to be tried, one lot after the other until one gains.

    Args:
        size: Number of variables.
        last: The best one of the step before; None at first.
    """
    if size <= FEW:
        # one or two variables need no finely graded damping
        yield DAMPINGS if size > 2 else DAMPINGS[::2]
        yield LAST_DAMPINGS
        return
    if last is not None:
        begin = FINER_DAMPINGS.index(last) - BELOW
        begin = min(max(begin, 0), len(FINER_DAMPINGS) - BESIDE)
        yield FINER_DAMPINGS[begin : begin + BESIDE]
    yield FINER_DAMPINGS


@dataclass(frozen=True)
class _Linear:
    """A linear least-squares problem, reduced to as many rows as variables.

    Attributes:
        left: (n, P) orthonormal columns that the rows of residuals were reduced by.
        upper: (P, P) triangle.
        right: (P,) right side.
        size: (P,) size of each variable's column.
    """

    left: Floats
    upper: Floats
    right: Floats
    size: Floats

    @classmethod
    def of(cls, a: Floats, b: Floats, rows: int) -> "_Linear":
        """Reduces ``|a x + b|^2``.

        Args:
            a: (n, P).
            b: (n,).
            rows: So many of the first rows are residuals; the others are linear anyway.
        """
        q, upper = np.linalg.qr(a)
        norms = np.linalg.norm(upper, axis=0)
        return cls(q[:rows], upper, q.T @ b, np.maximum(norms, 1e-6 * norms.max()))

    def steps(self, low: Floats, high: Floats, dampings: Sequence[float]) -> list[Floats]:
        """(P,) steps within bounds, one for each damping.

        Args:
            low: (P,) least steps.
            high: (P,) greatest steps.
            dampings: Levenberg-Marquardt terms, relative to the squares of sizes.
        """
        return damped_steps(self.upper, -self.right, low, high, dampings, self.size)

    def gain(self, step: Floats) -> float:
        """By how much half the sum of squares is to fall along a step.

        Args:
            step: (P,).
        """
        after = self.upper @ step + self.right
        return 0.5 * float(self.right @ self.right - after @ after)

    def bent(self, step: Floats, bend: Floats, damping: float) -> Floats:
        """(P,) what is to be added to a step, as residuals bend along it.

        Args:
            step: (P,).
            bend: (n_clusters, m) second derivative of the residual along the step.
            damping: Of the step.
        """
        free = np.full(step.size, np.inf)
        out = damped_steps(
            self.upper, -0.5 * (self.left.T @ bend.ravel()), -free, free, [damping], self.size
        )[0]
        most = 0.5 * MOST_BENT * float(np.linalg.norm(step * self.size))
        length = float(np.linalg.norm(out * self.size))
        return out if length <= most else out * (most / length)


def damped_steps(
    matrix: Floats,
    right: Floats,
    low: Floats,
    high: Floats,
    dampings: Sequence[float],
    size: Floats,
) -> list[Floats]:
    """Bounded least-squares steps of a linear problem, one for each damping.

    Args:
        matrix: (n, P) of the problem.
        right: (n,) its right side.
        low: (P,) least steps.
        high: (P,) greatest steps.
        dampings: Levenberg-Marquardt terms, relative to the squares of what follows.
        size: (P,) size of each variable's column.

    Returns:
        (P,) steps.
    """
    return [
        lsq_linear(
            np.vstack([matrix, np.diag(math.sqrt(damping) * size)]),
            np.concatenate([right, np.zeros(size.size)]),
            bounds=(low - 1e-12, high + 1e-12),
            method="bvls",  # of a hundred variables still thirty times as fast as "trf"
        ).x
        for damping in dampings
    ]


def _after(
    j: Floats, r: Floats, x: Floats, centre: Floats, precision: Floats, span: Floats
) -> Floats:
    """(n_clusters, m) what would be left of a residual after a step with the plain prior."""
    flat = j.reshape(-1, x.size) * span
    weight = precision * span
    hessian = flat.T @ flat + np.diag(weight**2)
    size = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    push = -(flat.T @ r.ravel()) - precision**2 * (x - centre) * span
    step = np.linalg.pinv(hessian / np.outer(size, size), rcond=1e-12, hermitian=True)
    return np.asarray(r + (flat @ (step @ (push / size) / size)).reshape(r.shape))


def _secant(j: Floats, change: Floats, step: Floats, span: Floats) -> Floats:
    """A Jacobian that agrees with the last step (Broyden's good update), in units of the span."""
    length = float(step @ step)  # not zero: the residual has changed
    missed = change - (j * span) @ step
    return np.asarray(j + missed[..., None] * (step / (length * span)))


def _noise_of_scores(j: Floats, r: Floats) -> float:
    """By how much the data weigh less than independent samples of unit noise would; at least 1.

    The misfit of an imperfect model lasts over many samples. How the scores ``J^T r`` scatter from
    stretch to stretch, against what white noise would give, says what a prior has to meet (the
    design effect of cluster sampling, here its median over the variables).
    """
    information = np.einsum("smp,smp->p", j, j)
    seen = information > 0.0
    if j.shape[0] < 2 or not seen.any():
        return max(1.0, float(np.sqrt(np.mean(r * r))))
    scores = np.einsum("smp,sm->sp", j, r)[:, seen]
    scatter = np.sum((scores - scores.mean(axis=0)) ** 2, axis=0)
    return max(1.0, float(np.sqrt(np.median(scatter / information[seen]))))


def _summary(
    x: Floats,
    r: Floats,
    j: Floats,
    variables: Sequence[Variable],
    precision: Floats,
    weight: float,
    history: list[float],
    gained: float,
    ahead: float,
    robust: bool,
    tie_a: Floats,
) -> Estimate:
    w = _weights(r, robust)
    jw = j * w[..., None]
    lower = np.array([v.lower for v in variables])
    upper = np.array([v.upper for v in variables])
    span = np.array([v.upper - v.lower for v in variables])
    information = np.matmul(np.swapaxes(jw, 1, 2), jw)  # (n_clusters, P, P)
    norms = np.sqrt(np.einsum("spp->p", information))
    # Invisible: even the whole allowed range would not move the residual by one noise deviation.
    visible = norms * span > 1.0
    at_bound = (x - lower < 1e-9 * span) | (upper - x < 1e-9 * span)
    prior = np.diag(precision**2) + tie_a.T @ tie_a
    hessian = information.sum(axis=0) + weight**2 * prior
    # Scaled by data and prior together: a variable that only rounding moves would else have a unit
    # column of noise and a prior beside which all others vanish.
    scale = np.sqrt(np.diag(hessian))
    scale = np.where(scale > 0.0, scale, 1.0)
    units = np.outer(scale, scale)
    hessian /= units
    values = np.linalg.eigvalsh(hessian)
    condition = float(np.sqrt(values[-1] / max(values[0], 1e-300)))
    inverse = np.linalg.pinv(hessian, rcond=1e-12)
    moves = left_out_moves(hessian, information / units, np.einsum("smp,sm->sp", jw, r * w) / scale)
    # The data weigh less than white noise would, so the prior was given as much more weight; what
    # its centre is off by is what it says nevertheless.
    off = weight**4 * inverse @ (prior / units) @ inverse
    clusters = moves.shape[0]
    share = (clusters - 1) / clusters if clusters > 1 else 1.0
    covariance = (share * moves.T @ moves + off) / units
    white = inverse / units
    # The cluster estimate is noisy where stretches are few: never below the white-noise one.
    sd = np.sqrt(np.maximum(np.diag(covariance), np.diag(white)))
    sd = np.where(visible, sd, np.inf)
    correlation = white / np.sqrt(np.outer(np.diag(white), np.diag(white)) + 1e-300)
    return Estimate(
        values=x,
        std_errors=sd,
        covariance=covariance,
        correlation=correlation,
        condition=condition,
        cost=history[-1],
        history=history,
        gained=gained,
        ahead=ahead,
        residual=r,
        jacobian=j,
        gain=white,
        left_out=_left_out(r, r + np.einsum("smp,sp->sm", j, moves / scale)),
        at_bound=at_bound,
        visible=visible,
        weight=weight,
    )


def _left_out(fitted: Floats, left: Floats) -> Floats:
    """Residuals of clusters that were left out, no larger than the linear forecast is worth.

    A cluster that alone tells of a variable is forecast with that variable anywhere within its
    prior, which no data of another cluster would have allowed.
    """
    own = np.sqrt(np.sum(fitted**2, axis=1))
    found = np.sqrt(np.sum(left**2, axis=1))
    most = MOST_FORECAST * np.sqrt(np.mean(own**2))
    return np.asarray(
        left * np.minimum(1.0, np.maximum(own, most) / np.maximum(found, 1e-300))[:, None]
    )


def left_out_moves(hessian: Floats, information: Floats, scores: Floats) -> Floats:
    """(n_clusters, P) by how much the estimate moves when one cluster is left out (jackknife).

    To first order, with the information of the cluster taken out too: a cluster that alone tells
    of a variable has fitted it to its own errors, which its residual no longer shows (CR3 of
    Bell and McCaffrey 2002).

    Args:
        hessian: (P, P) of data and prior.
        information: (n_clusters, P, P) of each cluster.
        scores: (n_clusters, P).
    """
    if scores.shape[0] < 2:
        return np.asarray(np.linalg.pinv(hessian, rcond=1e-12) @ scores[0])[None]
    moves = [
        np.linalg.pinv(hessian - own, rcond=1e-10, hermitian=True) @ score
        for own, score in zip(information, scores, strict=True)
    ]
    return np.asarray(moves)
