# SPDX-License-Identifier: Apache-2.0
"""What is at a place along a pipe, as its cells and faces feel it."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.schema import Pipe

Floats = NDArray[np.float64]


def middles(length_m: float, count: int) -> Floats:
    """(count,) middles of a pipe's cells, all alike, m.

    Args:
        length_m: Length of the pipe, m; 1 for shares of it.
        count: How many cells it has.
    """
    return np.asarray((np.arange(count) + 0.5) * length_m / count)


def areas(pipe: Pipe, faces: Floats) -> tuple[Floats, Floats]:
    """Mean area of each cell and area of each face of a pipe, before neighbours are compared.

    Args:
        pipe: The pipe.
        faces: (n + 1,) where its cells end, m.
    """
    n = faces.size - 1
    if pipe.area_profile is None:
        return np.full(n, pipe.area_m2), np.full(n + 1, pipe.area_m2)
    x, a = np.array(pipe.area_profile, dtype=float).T
    # Frustum mean: exact for a radius, close for an area, that varies linearly.
    fine = np.linspace(0.0, 1.0, 9)
    grid = faces[:-1, None] + fine * np.diff(faces)[:, None]
    return np.trapezoid(np.interp(grid, x, a), fine, axis=1), np.interp(faces, x, a)


@dataclass(frozen=True)
class Narrowed:
    """What narrowings make of the cells and faces of a pipe.

    Attributes:
        area: (n,) factor on the area of each cell.
        length: (n,) factor on its length.
        face: (n + 1,) area of each face, relative to the pipe's there.
        viscous: (n,) factor on its laminar drag per volume.
        turbulent: (n,) factor on its turbulent drag per volume.
        heads: (n + 1,) heads of the pipe's own velocity that are lost at each face besides.
    """

    area: Floats
    length: Floats
    face: Floats
    viscous: Floats
    turbulent: Floats
    heads: Floats


def narrowed_by(pipe: Pipe, faces: Floats) -> Narrowed:
    """A narrowing as cells of any length feel it.

    A cell of which a part is narrowed is one of another area and length, whose volume and whose
    inertance, the integrals of A and of 1 / A, are those of the parts: it reflects waves as the
    narrowing does. The faces next to its middle have its own area, at which the flow chokes. The
    jet behind it loses what Borda and Carnot say, whatever the cells: what the steps from cell to
    cell and to those faces do not lose is lost at a face besides. The flow into it loses what a
    sharp edge does (Idelchik 2007, diagram 4-9).

    Args:
        pipe: The pipe with its narrowings.
        faces: (n + 1,) where its cells end, m.
    """
    n = faces.size - 1
    dx = pipe.length_m / n
    # moments of the free share of the area over each cell: what powers of it add up to
    powers = np.array([1.0, -1.0, -2.0, -2.375])
    edges = [
        (k.position_m - 0.5 * k.length_m, k.position_m + 0.5 * k.length_m) for k in pipe.narrowings
    ]
    cuts = np.unique(np.clip([*faces, *(x for pair in edges for x in pair)], 0.0, pipe.length_m))
    middle, width = 0.5 * (cuts[1:] + cuts[:-1]), np.diff(cuts)
    free = np.ones_like(middle)
    for (low, high), narrowing in zip(edges, pipe.narrowings, strict=True):
        free *= np.where((middle > low) & (middle < high), 1.0 - narrowing.fraction, 1.0)
    of = np.clip(np.searchsorted(faces, middle) - 1, 0, n - 1)
    moments = np.ones((4, n))
    for moment, power in zip(moments, powers, strict=True):
        np.add.at(moment, of, width / dx * (free**power - 1.0))
    volume, inertance, laminar, rough = moments
    area, length = np.sqrt(volume / inertance), np.sqrt(volume * inertance)
    # the pressure drop of one mass flow goes with 1 / A^2, by Blasius' law with 1 / A^2.375
    viscous, turbulent = laminar / inertance, rough / inertance * area**0.375

    # Heads of the pipe's velocity that a change of the area loses: of the jet where it widens, of a
    # sharp edge where it narrows; which is which depends on the direction of flow, so the mean.
    wide, narrow = np.maximum(free[1:], free[:-1]), np.minimum(free[1:], free[:-1])
    jet = 0.5 * (1.0 / narrow - 1.0 / wide) ** 2
    edge = 0.5 * 0.5 * (1.0 - narrow / wide) ** 0.75 / narrow**2
    where = np.where(free[1:] < free[:-1], middle[1:], middle[:-1])
    wanted = float(jet.sum())

    slow = 1.0 / area
    # (the pipe's mouths have their own areas, of which a cell may have another mean)
    inside = np.maximum(slow[1:], slow[:-1])
    widest = np.concatenate(([1.0 / free[0]], inside, [1.0 / free[-1]]))
    throat = np.zeros_like(widest)
    for narrowing in pipe.narrowings:
        least = 1.0 / float(np.interp(narrowing.position_m, middle, free))
        at = min(max(narrowing.position_m / dx, 1.0), n - 1.0) if n > 1 else 0.0
        k = min(int(at), n - 2) if n > 2 else 1
        for j, share in ((k, k + 1.0 - at), (k + 1, at - k)) if n > 1 else ():
            if share > 0.0:
                throat[j] = max(throat[j], min(2.0 * share, 1.0) * (least - widest[j]))

    def lost(part: float) -> float:
        """Heads lost behind steps and throats, these opened in part: mean of both directions."""
        inner = (widest + part * throat)[1:-1]
        return float(0.5 * np.sum((inner - slow[1:]) ** 2 + (inner - slow[:-1]) ** 2))

    part = 1.0
    if lost(part) > wanted:
        # what is lost is a quadratic function of the part
        t, w = throat[1:-1], widest[1:-1]
        rise, less = float(np.sum(t * (2.0 * w - slow[1:] - slow[:-1]))), wanted - lost(0.0)
        root = math.sqrt(rise**2 + 4.0 * float(np.sum(t**2)) * max(less, 0.0))
        part = 2.0 * less / (rise + root) if less > 0.0 else 0.0
    missing = max(wanted - lost(part), 0.0) / max(wanted, 1e-300)
    heads = np.zeros(n + 1)
    for x, head in zip(where, edge + missing * jet, strict=True):
        for f, share in faces_near(x, faces) if head > 0.0 else ():
            heads[f] += share * head
    face = 1.0 / (widest + part * throat)
    return Narrowed(area, length, face, viscous, turbulent, heads)


def faces_near(x: float, faces: Floats) -> list[tuple[int, float]]:
    """Shares of a fitting between the two faces around it that lie between cells of its pipe.

    Args:
        x: Where it is, m.
        faces: (n + 1,) where the cells end, m; of a single cell it is the last one.
    """
    inner = faces[1:-1] if faces.size > 2 else faces[1:]
    return [(f + 1, share) for f, share in spread(x, inner)]


def spread(x: float, centres: Floats) -> list[tuple[int, float]]:
    """Shares of a point between the two around it, so that it can move smoothly.

    Args:
        x: Where it is, m.
        centres: (n,) middles of cells, or faces between them, m.
    """
    if centres.size == 1:
        return [(0, 1.0)]
    s = float(np.interp(x, centres, np.arange(centres.size)))
    i = min(int(s), centres.size - 2)
    return [(i, 1.0 - (s - i)), (i + 1, s - i)]
