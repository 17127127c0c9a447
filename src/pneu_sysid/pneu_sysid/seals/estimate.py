# SPDX-License-Identifier: Apache-2.0
"""Generalised least squares of friction laws, for pieces of strokes that vary together.

A piece's force beyond gas and spring is the law's friction in the direction of motion, the zero of
the force cell, a share of the load (the area, the force's or the pressure's gain is never exact),
and what varies by chance: the friction and the zero of a recording, a stroke as a whole, a place
along the bore that repeats from stroke to stroke, the piece itself. Variances are found by
restricted maximum likelihood (Patterson and Thompson 1971); two have a prior, for there are few
recordings: their friction scatters at least about as it does from stroke to stroke.
Strengths are not negative (Lawson and Hanson's non-negative least squares).
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular
from scipy.optimize import minimize, nnls

from pneu_sysid.seals.cells import Pieces
from pneu_sysid.seals.laws import MOST_BREAKAWAY, Term, column

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

GAIN_ERROR = 0.02
"""Share by which area, pressure and force together may be off, one sigma."""
REPEATABLE = 0.01
"""The friction of recordings scatters by at least this share of it, one sigma; strengths are known
no better."""
MOST_SCATTER = 3.0
"""The friction of recordings scatters by no more than so many times what it is expected to, else
every dependence could be chance."""
ALONG = 0.15
"""What varies along the bore hangs together over this share of the stroke."""
DRIFT = 1.0
"""What drifts from stroke to stroke hangs together over this share of the recording."""
ROUNDING = 1e-10
"""Share of all variances that every piece has of its own, so that the sums can be solved."""
PRIOR_WEIGHT = 3.0
"""Recordings that the prior of their friction's scatter counts for; that of their zeros counts
for one."""


@dataclass(frozen=True)
class Scatter:
    """Standard deviations of what varies by chance, N.

    Attributes:
        friction: Friction, from recording to recording.
        zero: The force's zero, from recording to recording.
        drift: Friction, slowly from stroke to stroke of one recording.
        stroke: From stroke to stroke.
        bore: Friction along the bore, alike both ways and in all recordings.
        way: Along the bore one way, alike in all recordings.
        place: Along the bore, repeating from stroke to stroke of one recording.
        piece: From piece to piece.
    """

    friction: float
    zero: float
    drift: float
    stroke: float
    bore: float
    way: float
    place: float
    piece: float


@dataclass(frozen=True)
class Estimate:
    """A friction law fitted to pieces of strokes.

    Attributes:
        law: Its terms.
        strength: Of each term, SI.
        std_error: Of each strength.
        stribeck_m_s: Speed over which breakaway vanishes.
        zero_n: Zero of the force, N.
        gain: Share of the load that is too much in the force.
        gain_error: Its standard error.
        cost: Weighted squares that are left.
        covariance: (terms, terms) of the strengths.
    """

    law: tuple[Term, ...]
    strength: dict[Term, float]
    std_error: dict[Term, float]
    stribeck_m_s: float
    zero_n: float
    gain: float
    gain_error: float
    cost: float
    covariance: Floats


class Whitened:
    """Pieces made independent by what varies together; laws are fitted to them at once."""

    def __init__(self, pieces: Pieces, scatter: Scatter, use: NDArray[np.bool_] | None = None):
        """Prepares.

        Args:
            pieces: The pieces.
            scatter: What varies by chance.
            use: (n,) pieces that are used; None is all.
        """
        self.pieces = pieces
        n = pieces.level.size
        self.use = np.arange(n) if use is None else np.flatnonzero(use)
        shared = _shared(pieces, self.use)
        variances = [s**2 for s in dataclasses.astuple(scatter)]
        total = sum(v * s for v, s in zip(variances, shared, strict=True))
        self._factor = np.linalg.cholesky(np.asarray(total))
        load = pieces.mean(pieces.readings.load_n)
        fixed = np.column_stack([np.ones(n), load])
        # The gain's prior is one more reading, of nothing; so the two fixed columns are known.
        self.fixed = self._white(fixed, np.array([0.0, 1.0 / GAIN_ERROR]))
        self.rest = self._white(pieces.mean(pieces.readings.rest_n)[:, None], np.zeros(1))[:, 0]
        self._basis = np.linalg.qr(self.fixed)[0]

    def _white(self, columns: Floats, last: Floats) -> Floats:
        out = solve_triangular(self._factor, columns[self.use], lower=True)
        return np.vstack([out, last[None, :]])

    def columns(self, law: Sequence[Term], stribeck_m_s: float) -> Floats:
        """(n, terms) whitened columns of a law.

        Args:
            law: Its terms.
            stribeck_m_s: Speed over which breakaway vanishes.
        """
        own = [self.pieces.mean(column(self.pieces, t, stribeck_m_s)) for t in law]
        return self._white(np.column_stack(own), np.zeros(len(law)))

    def free(self, values: Floats) -> Floats:
        """Whitened columns without what zero and gain could make.

        Args:
            values: (n,) or (n, columns).
        """
        out: Floats = values - self._basis @ (self._basis.T @ values)
        return out

    def fit(self, law: tuple[Term, ...], stribeck_m_s: float) -> Estimate:
        """Fits a law.

        Args:
            law: Its terms.
            stribeck_m_s: Speed over which breakaway vanishes.
        """
        target = self.free(self.rest)
        raw = np.zeros(len(law))
        covariance = np.zeros((len(law), len(law)))
        rest = self.rest
        others = self.fixed[:, :1]
        cost = float(target @ target)
        if law:
            white = self.columns(law, stribeck_m_s)
            columns = self.free(white)
            size = np.linalg.norm(columns, axis=0)
            size[size == 0.0] = 1.0
            solved, norm = nnls(columns / size, target)
            cost = float(norm) ** 2
            raw = solved / size
            rest = rest - white @ raw
            inside = solved > 0.0
            scaled = columns[:, inside] / size[inside]
            inverse = np.linalg.pinv(scaled.T @ scaled, hermitian=True)
            inverse /= np.outer(size[inside], size[inside])
            covariance[np.ix_(inside, inside)] = inverse
            others = np.column_stack([others, white[:, inside] / size[inside]])
        own = np.linalg.lstsq(self.fixed, rest, rcond=None)[0]
        # The gain is known by what of its column the zero and the law cannot make.
        made = others @ np.linalg.lstsq(others, self.fixed[:, 1], rcond=None)[0]
        gain_error = 1.0 / float(np.linalg.norm(self.fixed[:, 1] - made))
        to_own = _unbound(law)
        value = to_own @ raw
        # The force's own scale is no better known than it repeats.
        covariance = to_own @ covariance @ to_own.T + REPEATABLE**2 * np.outer(value, value)
        return Estimate(
            law,
            {t: float(v) for t, v in zip(law, value, strict=True)},
            {t: float(np.sqrt(max(covariance[k, k], 0.0))) for k, t in enumerate(law)},
            stribeck_m_s,
            float(own[0]),
            float(own[1]),
            gain_error,
            cost,
            covariance,
        )

    def best(self, law: tuple[Term, ...], speeds: Floats) -> Estimate:
        """Fits a law at whichever Stribeck speed suits it best.

        Args:
            law: Its terms.
            speeds: (n,) speeds to try, m/s.
        """
        tried = speeds if "breakaway" in law else speeds[:1]
        return min((self.fit(law, float(v)) for v in tried), key=lambda e: e.cost)


def _unbound(law: Sequence[Term]) -> Floats:
    """From what is fitted to the law's own strengths: breakaway's column has the constant in it."""
    out = np.eye(len(law))
    if "breakaway" in law:
        k = list(law).index("breakaway")
        out[list(law).index("constant"), k] = 1.0
        out[k, k] = MOST_BREAKAWAY
    return out


def predicted(pieces: Pieces, estimate: Estimate) -> Floats:
    """(m,) friction that a law has at every reading, with its sign, N.

    Args:
        pieces: The pieces.
        estimate: The law.
    """
    total = np.zeros(pieces.readings.rest_n.size)
    raw = np.linalg.solve(
        _unbound(estimate.law), np.array([estimate.strength[t] for t in estimate.law])
    )
    for term, value in zip(estimate.law, raw, strict=True):
        total += value * column(pieces, term, estimate.stribeck_m_s)
    return total


def _shared(pieces: Pieces, of: NDArray[np.intp]) -> list[Floats]:
    """Which pieces vary together, in the order of `Scatter`."""
    level, way, stroke = pieces.level[of], pieces.way[of], pieces.stroke[of]
    bore = smooth(pieces.bin, ALONG)[np.ix_(pieces.bin[of], pieces.bin[of])]
    same_way = np.equal.outer(way, way).astype(float)
    same_level = np.equal.outer(level, level).astype(float)
    friction = same_level * np.outer(way, way)
    drift = np.zeros((of.size, of.size))
    for k in np.unique(level):
        at = np.flatnonzero(level == k)
        own = smooth(pieces.cycle[pieces.level == k], DRIFT)
        drift[np.ix_(at, at)] = own[np.ix_(pieces.cycle[of][at], pieces.cycle[of][at])]
    return [
        friction,
        same_level,
        friction * drift,
        np.equal.outer(stroke, stroke).astype(float),
        bore * np.outer(way, way),
        bore * same_way,
        bore * same_way * same_level,
        np.eye(of.size),
    ]


def smooth(places: Ints, length: float) -> Floats:
    """Covariance of what varies smoothly over counted places, without a mean.

    A mean along the bore or over strokes would be friction, or a zero.

    Args:
        places: (n,) places, counted from 0.
        length: Over which share of them it hangs together.

    Returns:
        (count, count) covariance of the places.
    """
    count = int(places.max()) + 1
    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count))) / count
    centre = np.eye(count) - 1.0 / count
    out: Floats = centre @ np.exp(-apart / length) @ centre
    return out


def scatter_of(pieces: Pieces, law: tuple[Term, ...], stribeck_m_s: float) -> tuple[Scatter, float]:
    """What varies by chance beside a law, by restricted maximum likelihood with two priors.

    Args:
        pieces: The pieces.
        law: The fullest law that is to be judged.
        stribeck_m_s: Speed over which breakaway vanishes.

    Returns:
        The standard deviations, and the negative logarithm of the likelihood with them.
    """
    rest = pieces.mean(pieces.readings.rest_n)
    load = pieces.mean(pieces.readings.load_n)
    own = [pieces.mean(column(pieces, t, stribeck_m_s)) for t in law]
    design = np.column_stack([np.ones(rest.size), load, *own])
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    design = design / size
    scale = max(float(np.std(rest)), 1e-9)
    usual = _usual_variance(pieces, scale)
    shared = _shared(pieces, np.arange(rest.size))
    floor = (1e-4 * scale) ** 2
    weight = np.zeros(len(shared))
    weight[:2] = PRIOR_WEIGHT, 1.0
    centre = np.zeros(len(shared))
    centre[:2] = usual, max(scale**2, usual)
    prior = np.zeros(design.shape[1])
    prior[1] = 1.0 / (GAIN_ERROR * size[1]) ** 2

    def cost(logs: Floats) -> tuple[float, Floats]:
        """Twice the negative logarithm of the restricted likelihood, halved, and its slope."""
        own = np.exp(np.clip(logs, -60.0, 60.0))
        v = own.copy()
        v[-1] += floor + ROUNDING * float(v.sum())
        total = np.asarray(sum(a * s for a, s in zip(v, shared, strict=True)))
        factor = np.linalg.cholesky(total)
        inverse = np.asarray(cho_solve((factor, True), np.eye(rest.size)))
        weighted = inverse @ design
        information = design.T @ weighted + np.diag(prior + 1e-12)
        projector = inverse - weighted @ np.linalg.solve(information, weighted.T)
        left = projector @ rest
        value = 2.0 * float(np.sum(np.log(np.diag(factor)))) + float(rest @ left)
        value += float(np.linalg.slogdet(information)[1])
        value += float(np.sum(weight * (np.log(v) + centre / v)))
        slope = np.array([float(np.sum(projector * s) - left @ s @ left) for s in shared])
        slope += weight * (1.0 / v - centre / v**2)
        return 0.5 * value, 0.5 * slope * own

    begin = np.log([usual, 0.1 * centre[1], *([usual + floor] * 6)])
    options = {"maxiter": 80}
    bounds = [(None, float(np.log(MOST_SCATTER**2 * usual))), *([(None, None)] * (len(begin) - 1))]
    found = minimize(cost, begin, jac=True, method="L-BFGS-B", options=options, bounds=bounds)
    v = np.exp(np.clip(found.x, -60.0, 60.0))
    v[-1] += floor + ROUNDING * float(v.sum())
    return Scatter(*(float(s) for s in np.sqrt(v))), float(found.fun)


def _usual_variance(pieces: Pieces, scale: float) -> float:
    """What the friction of recordings may be expected to vary by, N^2."""
    halves = [h for h in pieces.cycle_friction() if h.size]
    within = [float(np.var(h, ddof=1)) for h in halves if h.size > 1]
    typical = float(np.mean([np.mean(h) for h in halves])) if halves else 0.0
    return max(
        float(np.median(within)) if within else 0.0,
        (REPEATABLE * typical) ** 2,
        (1e-4 * scale) ** 2,
    )
