# SPDX-License-Identifier: Apache-2.0
"""How residuals change with each variable of an estimation, and along what they hardly show."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

Floats = NDArray[np.float64]
Residuals = Callable[[Sequence[Floats]], Floats]
"""Maps K parameter vectors to (K, n_clusters, m) residuals in one batched call."""

CANCELS = 0.15
"""Columns of a Jacobian are wrong by some hundredths, beside kinks by more: a combination of
variables whose columns cancel to less than this share tells more of those errors than of itself,
..."""
MOST_ALONG = 32
"""... and so many of them, the weakest, are looked along for themselves. Of a joint's 96 parameters
there are 32; with 16, or with 0.05 above, its size was told five times too well after four looks,
and is told right to a tenth after one, to a hundredth after two."""
LOOKS = 5
"""So often at most at one place: what is weakest is seen better once that is better known. Where
columns are wrong by 0.1, three tell the width of a valley right, two up to three times too small;
five take a fifth fewer evaluations than three."""
SEEN = 0.1
"""A look is the last that changes what is known of every combination by no more than this share."""
KINK = 0.5
"""A slope to one side that is less than so much of the mean of both is one beside a kink."""


@dataclass(frozen=True)
class Variable:
    """A quantity to estimate.

    Attributes:
        name: Its name.
        value: Start value.
        lower: Lower bound.
        upper: Upper bound.
        step: Difference step.
        std: Standard deviation of the prior; inf for none.
        centre: Centre of the prior; None is the start value.
    """

    name: str
    value: float
    lower: float
    upper: float
    step: float
    std: float = np.inf
    centre: float | None = None

    @property
    def known_std(self) -> float:
        """How well it is known beforehand: the prior's deviation, the range where that is less."""
        return min(self.std, self.upper - self.lower)


def jacobian(
    residuals: Residuals,
    x: Floats,
    variables: Sequence[Variable],
    known: Floats | None = None,
    both: bool = False,
) -> tuple[Floats, Floats]:
    """Residuals and their Jacobian by differences, in one batched call.

    Args:
        residuals: Batched residual function.
        x: (P,) point.
        variables: Steps and bounds; a step that would leave the bounds is taken the other way.
        known: (n_clusters, m) residuals at the point, where they were computed before.
        both: Whether both sides are looked at (`slope_of_both`), of what is not at a bound.

    Returns:
        (n_clusters, m) residuals and (n_clusters, m, P) Jacobian.
    """
    points = [] if known is not None else [x]
    sides: list[list[tuple[int, float]]] = []  # of each variable: which point, how far
    for k, v in enumerate(variables):
        steps = [h for h in (v.step, -v.step) if v.lower <= x[k] + h <= v.upper] or [v.step]
        sides.append([])
        for h in steps if both else steps[:1]:
            y = x.copy()
            y[k] += h
            sides[k].append((len(points), h))
            points.append(y)
    r = residuals(points)
    here = r[0] if known is None else known
    slopes = [[(r[k] - here) / h for k, h in of] for of in sides]
    return here, np.stack([slope_of_both(*of) for of in slopes], axis=-1)


def slope_of_both(one: Floats, other: Floats | None = None) -> Floats:
    """A slope by those to either side.

    Their mean; at a kink, such as a piston that comes to its cover, the lesser. The greater one
    tells nothing of the way back, along which what it seems to show is not shown.

    Args:
        one: Slope to one side, of any shape.
        other: To the other; None where there is none.
    """
    if other is None:
        return one
    mean = 0.5 * (one + other)
    lesser = min((one, other), key=lambda side: float(np.linalg.norm(side)))
    return lesser if np.linalg.norm(lesser) < KINK * np.linalg.norm(mean) else mean


def looked_along(
    residuals: Residuals,
    x: Floats,
    here: Floats,
    j: Floats,
    variables: Sequence[Variable],
    looks: int = LOOKS,
) -> Floats:
    """A Jacobian that is right along the combinations of variables that residuals hardly show.

    Where a rig that is larger as a whole has the same pressures, the columns of all its sizes
    cancel but for their own errors: differences over a finite step, secants. That looks like
    information, a hundred times what there is: the prior no longer holds such a combination, and
    its standard error is told far too small. So differences to both sides are taken along these.

    Args:
        residuals: Batched residual function.
        x: (P,) point.
        here: (n_clusters, m) residuals there.
        j: (n_clusters, m, P) Jacobian there.
        variables: What is known beforehand, bounds and steps.
        looks: How often at most.
    """
    known = np.array([v.known_std for v in variables])
    step = np.array([v.step for v in variables])
    room = np.array([min(v.upper - a, a - v.lower) for v, a in zip(variables, x, strict=True)])
    free = np.flatnonzero(room >= step)
    for _ in range(looks):
        weak = _weak(j.reshape(-1, x.size)[:, free] * known[free])
        if not weak.size:
            break
        moves = np.zeros((weak.shape[1], x.size))
        moves[:, free] = weak.T
        # no variable farther than in a difference of its own
        lengths = np.min(step / np.maximum(np.abs(moves) * known, 1e-300), axis=1)
        ends = [
            x + sign * length * move * known
            for move, length in zip(moves, lengths, strict=True)
            for sign in (1.0, -1.0)
        ]
        found = residuals(ends)
        changes = np.stack(
            [
                slope_of_both((ahead - here) / length, (here - behind) / length)
                for ahead, behind, length in zip(found[::2], found[1::2], lengths, strict=True)
            ]
        )
        missed = changes - np.einsum("smp,kp->ksm", j, moves * known)
        before = j
        j = j + np.einsum("ksm,kp->smp", missed, moves / known)
        if _changed(before * known, j * known) < SEEN:
            break
    return j


def _changed(before: Floats, after: Floats) -> float:
    """Largest change of what is known of any combination, of its variance as a logarithm.

    Args:
        before: (n_clusters, m, P) columns in units of what is known beforehand.
        after: The same then.
    """
    count = before.shape[-1]
    one, other = (
        np.eye(count) + flat.T @ flat
        for flat in (before.reshape(-1, count), after.reshape(-1, count))
    )
    return float(np.max(np.abs(np.log(eigh(other, one, eigvals_only=True)))))


def _weak(columns: Floats) -> Floats:
    """(P, K) orthonormal combinations of columns that nearly cancel, the weakest first."""
    if columns.shape[1] < 2:
        return np.zeros((columns.shape[1], 0))
    squares, ways = np.linalg.eigh(columns.T @ columns)
    alone = np.linalg.norm(np.linalg.norm(columns, axis=0)[:, None] * ways, axis=0)
    cancel = np.sqrt(np.maximum(squares, 0.0)) < CANCELS * alone
    return np.asarray(ways[:, np.flatnonzero(cancel)[:MOST_ALONG]])
