# SPDX-License-Identifier: Apache-2.0
"""Configurations of a MuJoCo model on their manifold: steps, differences and what these change by.

A configuration ``q`` has ``nq`` numbers and ``nv`` directions to move in: a quaternion has four
numbers and three directions, a rotation vector in the frame of its body, as MuJoCo has it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SMALL = 1e-4
"""Angles below, rad, are treated by series: rounding of what is divided would show above 1e-9."""


def product(a: Floats, b: Floats) -> Floats:
    """Product of quaternions.

    Args:
        a: (..., 4), scalar first.
        b: (..., 4).

    Returns:
        (..., 4).
    """
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def conjugate(a: Floats) -> Floats:
    """Inverse of unit quaternions.

    Args:
        a: (..., 4), scalar first.
    """
    return a * np.array([1.0, -1.0, -1.0, -1.0])


def exponential(phi: Floats) -> Floats:
    """Unit quaternion of a rotation vector.

    Args:
        phi: (..., 3), rad.

    Returns:
        (..., 4), scalar first.
    """
    angle = np.linalg.norm(phi, axis=-1, keepdims=True)
    half = 0.5 * angle
    small = angle < SMALL
    by = np.where(small, 0.5 - angle**2 / 48.0, np.sin(half) / np.where(small, 1.0, angle))
    return np.concatenate([np.cos(half), by * phi], axis=-1)


def logarithm(a: Floats) -> Floats:
    """Rotation vector of a unit quaternion, the shorter way round.

    Args:
        a: (..., 4), scalar first.

    Returns:
        (..., 3), rad.
    """
    a = np.where(a[..., :1] < 0.0, -a, a)
    sine = np.linalg.norm(a[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, a[..., :1])
    small = sine < SMALL
    by = np.where(small, 2.0 + sine**2 / 3.0, angle / np.where(small, 1.0, sine))
    return np.asarray(by * a[..., 1:])


def cross_matrix(phi: Floats) -> Floats:
    """Matrix of the cross product with a vector.

    Args:
        phi: (..., 3).

    Returns:
        (..., 3, 3).
    """
    x, y, z = np.moveaxis(phi, -1, 0)
    o = np.zeros_like(x)
    rows = [np.stack(r, axis=-1) for r in ((o, -z, y), (z, o, -x), (-y, x, o))]
    return np.stack(rows, axis=-2)


def turned_by(phi: Floats) -> Floats:
    """How a rotation vector changes as its rotation is turned further, in the turned frame.

    The inverse of the right Jacobian of SO(3): ``log(exp(phi) exp(d)) = phi + turned_by(phi) d``.

    Args:
        phi: (..., 3), rad.

    Returns:
        (..., 3, 3).
    """
    angle = np.linalg.norm(phi, axis=-1)[..., None, None]
    k = cross_matrix(phi)
    small = angle < 1e-2  # where 1 - x/tan x cancels; the series' next term is 1e-13
    safe = np.where(small, 1.0, angle)
    by = np.where(
        small,
        1.0 / 12.0 + angle**2 / 720.0 + angle**4 / 30240.0,
        (1.0 - 0.5 * safe / np.tan(0.5 * safe)) / safe**2,
    )
    return np.asarray(np.eye(3) + 0.5 * k + by * (k @ k))


@dataclass(frozen=True)
class Manifold:
    """Where plain numbers and quaternions stand.

    Attributes:
        nq: Numbers of a configuration.
        nv: Directions that it moves in.
        plain_q: (P,) where plain coordinates stand in ``q``.
        plain_v: (P,) where they stand in ``v``.
        turns_q: (R, 4) where quaternions stand in ``q``.
        turns_v: (R, 3) where their rotation vectors stand in ``v``.
    """

    nq: int
    nv: int
    plain_q: Ints
    plain_v: Ints
    turns_q: Ints
    turns_v: Ints

    def moved(self, q: Floats, step: Floats) -> Floats:
        """Configurations after a step.

        Args:
            q: (n, nq).
            step: (n, nv).

        Returns:
            (n, nq), quaternions of unit length.
        """
        out = np.array(q, dtype=float)
        out[:, self.plain_q] += step[:, self.plain_v]
        for at, by in zip(self.turns_q, self.turns_v, strict=True):
            turned = product(q[:, at], exponential(step[:, by]))
            out[:, at] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
        return out

    def between(self, start: Floats, end: Floats) -> Floats:
        """The step from one configuration to another.

        Args:
            start: (n, nq).
            end: (n, nq).

        Returns:
            (n, nv).
        """
        out = np.empty((len(start), self.nv))
        out[:, self.plain_v] = end[:, self.plain_q] - start[:, self.plain_q]
        for at, by in zip(self.turns_q, self.turns_v, strict=True):
            out[:, by] = logarithm(product(conjugate(start[:, at]), end[:, at]))
        return out

    def between_by(self, step: Floats) -> tuple[Floats, Floats]:
        """How the step between two configurations changes as they are moved.

        Args:
            step: (n, nv) `between` them.

        Returns:
            (n, nv, nv) by the start's move, and (n, nv, nv) by the end's.
        """
        end = np.zeros((len(step), self.nv, self.nv))
        end[:, self.plain_v, self.plain_v] = 1.0
        start = -end
        for by in self.turns_v:
            at = np.ix_(np.arange(len(step)), by, by)
            turned = turned_by(step[:, by])
            end[at] = turned
            start[at] = -np.swapaxes(turned, 1, 2)
        return start, end


def manifold_of(model: Any) -> Manifold:
    """The manifold of a MuJoCo model's configurations.

    Args:
        model: An ``MjModel``.
    """
    plain_q: list[int] = []
    plain_v: list[int] = []
    turns_q: list[range] = []
    turns_v: list[range] = []
    for j in range(model.njnt):
        at, by, kind = int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j]), int(model.jnt_type[j])
        if kind == 0:  # mjJNT_FREE
            plain_q += range(at, at + 3)
            plain_v += range(by, by + 3)
            turns_q.append(range(at + 3, at + 7))
            turns_v.append(range(by + 3, by + 6))
        elif kind == 1:  # mjJNT_BALL
            turns_q.append(range(at, at + 4))
            turns_v.append(range(by, by + 3))
        else:
            plain_q.append(at)
            plain_v.append(by)
    return Manifold(
        int(model.nq),
        int(model.nv),
        np.array(plain_q, dtype=np.int64),
        np.array(plain_v, dtype=np.int64),
        np.array(turns_q, dtype=np.int64).reshape(-1, 4),
        np.array(turns_v, dtype=np.int64).reshape(-1, 3),
    )
