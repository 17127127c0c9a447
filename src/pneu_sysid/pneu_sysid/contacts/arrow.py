# SPDX-License-Identifier: Apache-2.0
"""Linear systems of one trajectory and the parameters that all its knots share.

A knot's residuals know three knots, so that the Hessian of a trajectory is a band of blocks, two
off the diagonal; parameters add dense rows and columns to it, an arrow (thesis 2.4). The band is
factored by LAPACK's banded Cholesky; what is left of the parameters is a small dense system.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpbtrf, dpbtrs

Floats = NDArray[np.float64]


LEAST_SEEN = 1e-9
"""Share of what a recording tells of its own zeros that is always taken to be left: one that never
touches anything tells nothing of its height."""


@dataclass(frozen=True)
class Zeros:
    """Zeros of sensors that are one recording's own, beside the parameters that all share.

    They stand where they explain readings best, so that the cost has no slope along them.

    Attributes:
        shaft: (n, k, z) knots by zeros.
        cross: (c, z) parameters by zeros.
        tip: (z, z) zeros.
    """

    shaft: Floats
    cross: Floats
    tip: Floats


@dataclass(frozen=True)
class Arrow:
    """Gradient and Gauss-Newton Hessian of one trajectory's cost.

    Attributes:
        diagonal: (n, k, k) blocks on the diagonal.
        next: (n - 1, k, k) blocks below: rows of knot ``i + 1``, columns of knot ``i``.
        after: (n - 2, k, k) blocks two below.
        shaft: (n, k, c) knots by parameters.
        tip: (c, c) parameters.
        slope: (n, k) gradient by knots.
        tip_slope: (c,) gradient by parameters.
        cost: The cost.
        zeros: The recording's own; None where all are known.
    """

    diagonal: Floats
    next: Floats
    after: Floats
    shaft: Floats
    tip: Floats
    slope: Floats
    tip_slope: Floats
    cost: float
    zeros: Zeros | None = None

    def held(self) -> Floats:
        """(c, c) what is left of the parameters where the trajectory is held."""
        if self.zeros is None:
            return self.tip
        lever = np.linalg.solve(_seen(self.zeros.tip, self.zeros.tip), self.zeros.cross.T)
        return np.asarray(self.tip - self.zeros.cross @ lever)

    def dense(self) -> Floats:
        """The whole Hessian, (n k + c) square, zeros held: for tests and small problems."""
        n, k, c = self.shaft.shape
        out = np.zeros((n * k + c, n * k + c))
        for off, blocks in enumerate((self.diagonal, self.next, self.after)):
            for i, block in enumerate(blocks):
                rows = slice((i + off) * k, (i + off + 1) * k)
                columns = slice(i * k, (i + 1) * k)
                out[rows, columns] = block
                out[columns, rows] = block.T
        out[: n * k, n * k :] = self.shaft.reshape(n * k, c)
        out[n * k :, : n * k] = self.shaft.reshape(n * k, c).T
        out[n * k :, n * k :] = self.tip
        return out

    def gradient(self) -> Floats:
        """(n k + c,) the whole gradient."""
        return np.concatenate([self.slope.ravel(), self.tip_slope])


@dataclass(frozen=True)
class Eliminated:
    """A trajectory taken out of its arrow: what is left is of the parameters alone.

    Attributes:
        hessian: (c, c) Schur complement.
        slope: (c,) its gradient.
        step: (n, k) step of the trajectory with the parameters held.
        lever: (n, k, c) what that step changes by per unit of the parameters' step.
    """

    hessian: Floats
    slope: Floats
    step: Floats
    lever: Floats


def band_of(arrow: Arrow, damping: float) -> Floats:
    """The band of a trajectory's Hessian as LAPACK stores its lower half.

    Args:
        arrow: The Hessian.
        damping: What is added to the diagonal, as a share of it (Levenberg and Marquardt).

    Returns:
        (3 k, n k), one row per diagonal, columns first in memory.
    """
    n, k, _ = arrow.shaft.shape
    band = np.zeros((3 * k, n * k), order="F")
    for off, blocks in enumerate((arrow.diagonal, arrow.next, arrow.after)):
        for row in range(k):
            for column in range(row + 1 if off == 0 else k):
                below = off * k + row - column
                band[below, column : (n - off) * k : k] = blocks[:, row, column]
    # What nothing sees would stand still; a share of the largest keeps it so.
    least = 1e-14 * float(band[0].max(initial=1e-300))
    band[0] = np.maximum(band[0] * (1.0 + damping), least)
    return band


def eliminate(arrow: Arrow, damping: float = 0.0) -> Eliminated | None:
    """Takes a trajectory out of its arrow.

    Args:
        arrow: Gradient and Hessian.
        damping: See `band_of`.

    Returns:
        What is left; None where the Hessian is not positive definite in floating point, which
        more damping mends.
    """
    n, k, c = arrow.shaft.shape
    factor, failed = dpbtrf(band_of(arrow, damping), lower=1, overwrite_ab=1)
    if failed:
        return None
    shaft, tip, tip_slope = arrow.shaft, arrow.tip, arrow.tip_slope
    if arrow.zeros is not None:
        own = arrow.zeros
        shaft = np.concatenate([shaft, own.shaft], axis=2)
        tip = np.block([[tip, own.cross], [own.cross.T, own.tip]])
        tip_slope = np.append(tip_slope, np.zeros(len(own.tip)))
    flat = shaft.reshape(n * k, -1)
    right = np.empty((n * k, 1 + flat.shape[1]), order="F")
    right[:, 0] = -arrow.slope.ravel()
    right[:, 1:] = -flat
    solved, failed = dpbtrs(factor, right, lower=1)
    if failed or not np.all(np.isfinite(solved)):
        return None
    step, lever = solved[:, 0], solved[:, 1:]
    hessian = tip + flat.T @ lever
    slope = tip_slope + flat.T @ step
    if arrow.zeros is not None:
        seen = _seen(hessian[c:, c:], tip[c:, c:])
        along = -np.linalg.solve(seen, np.column_stack([slope[c:], hessian[c:, :c]]))
        step = step + lever[:, c:] @ along[:, 0]
        lever = lever[:, :c] + lever[:, c:] @ along[:, 1:]
        slope = slope[:c] + hessian[:c, c:] @ along[:, 0]
        hessian = hessian[:c, :c] + hessian[:c, c:] @ along[:, 1:]
    return Eliminated(hessian, slope, step.reshape(n, k), lever.reshape(n, k, c))


def _seen(left: Floats, told: Floats) -> Floats:
    """A Hessian of zeros that can be inverted."""
    return np.asarray(left + LEAST_SEEN * np.diag(np.diag(told)))


def inverse(matrix: Floats) -> Floats:
    """Inverse of a Hessian whose columns differ by orders; of what is seen.

    Args:
        matrix: (c, c).
    """
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.asarray(
        np.linalg.pinv(matrix / np.outer(scale, scale), 1e-10) / np.outer(scale, scale)
    )


def jackknife(
    hessians: Floats, slopes: Floats, known: Floats | None = None, pull: Floats | None = None
) -> Floats:
    """Standard errors of parameters, by leaving out one recording after another, to first order.

    Args:
        hessians: (n, c, c) of each recording, its trajectory taken out.
        slopes: (n, c).
        known: (c, c) Hessian of what is known of them beforehand.
        pull: (c,) its slope.

    Returns:
        (c,); of one recording what the curvature tells, were the norms what they say.
    """
    n, c = slopes.shape
    whole = hessians.sum(axis=0) + (0.0 if known is None else known)
    slope = slopes.sum(axis=0) + (0.0 if pull is None else pull)
    if not c:
        return np.zeros(0)
    if n < 2:
        return np.sqrt(np.maximum(np.diag(inverse(whole)), 0.0))
    left = np.array(
        [-inverse(whole - h) @ (slope - g) for h, g in zip(hessians, slopes, strict=True)]
    )
    return np.asarray(np.sqrt((n - 1) / n * np.sum((left - left.mean(axis=0)) ** 2, axis=0)))
