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
        face: (n + 1,) factor on the area of each face.
        volume: (n,) factor on the volume of each cell.
        viscous: (n,) factor on its laminar drag.
        turbulent: (n,) factor on its turbulent drag.
        heads: (n,) velocity heads lost besides.
    """

    face: Floats
    volume: Floats
    viscous: Floats
    turbulent: Floats
    heads: Floats


def narrowed_by(pipe: Pipe, faces: Floats) -> Narrowed:
    """A narrowing as cells of any length feel it.

    Its volume and the friction along it are shared by the cells that it covers. The jet behind it
    loses what Borda and Carnot say, whatever the cells: the narrowing is at the faces next to its
    middle, and where it lies between two each has the part of the loss that is its own. The flow
    into it loses what a sharp edge does (Idelchik 2007, diagram 4-9).

    Args:
        pipe: The pipe with its narrowings.
        faces: (n + 1,) where its cells end, m.
    """
    centres = 0.5 * (faces[1:] + faces[:-1])
    n = faces.size - 1
    dx = pipe.length_m / n
    face, volume = np.ones(n + 1), np.ones(n)
    viscous, turbulent, heads = np.ones(n), np.ones(n), np.zeros(n)
    for narrowing in pipe.narrowings:
        left = 1.0 - narrowing.fraction
        low = narrowing.position_m - 0.5 * narrowing.length_m
        high = narrowing.position_m + 0.5 * narrowing.length_m
        covered = np.clip(np.minimum(faces[1:], high) - np.maximum(faces[:-1], low), 0.0, None)
        covered /= dx
        volume *= 1.0 - narrowing.fraction * covered
        # pressure drop at one mass flow: 1 / A^2, and with Blasius' law 1 / A^2.375
        viscous *= 1.0 + covered * (left**-2.0 - 1.0)
        turbulent *= 1.0 + covered * (left**-2.375 - 1.0)
        loss = (1.0 / left - 1.0) ** 2
        entrance = 0.5 * narrowing.fraction**0.75 / left**2
        for i, part in spread(narrowing.position_m, centres):
            heads[i] += part * (entrance + (loss if n == 1 else 0.0))
        if n == 1:
            continue
        at = float(np.clip(narrowing.position_m / dx, 1.0, n - 1.0))
        k = min(int(at), n - 2) if n > 2 else 1
        share = at - k
        face[k] /= 1.0 + math.sqrt((1.0 - share) * loss)
        if share > 0.0:
            face[k + 1] /= 1.0 + math.sqrt(share * loss)
    return Narrowed(face, volume, viscous, turbulent, heads)


def spread(x: float, centres: Floats) -> list[tuple[int, float]]:
    """Shares of a point between the two cells around it, so that it can move smoothly.

    Args:
        x: Where it is, m.
        centres: (n,) middles of the cells, m.
    """
    if centres.size == 1:
        return [(0, 1.0)]
    s = float(np.interp(x, centres, np.arange(centres.size)))
    i = min(int(s), centres.size - 2)
    return [(i, 1.0 - (s - i)), (i + 1, s - i)]
