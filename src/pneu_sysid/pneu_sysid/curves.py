# SPDX-License-Identifier: Apache-2.0
"""Opening curves as they are fitted: points of their own for each port, and ties between them."""

from collections.abc import Collection, Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.opening import opening_at
from pneu_sim.rig.schema import FitParameter, Opening, Port, Rig, Spool, Valve

SLOPE_CHANGE = 0.2
"""Expected change of an opening curve's slope between neighbouring intervals, of its mean slope."""

EXPONENT_CHANGE = 0.1
"""Expected change of a power-law curve's local exponent between neighbouring intervals."""
EXPONENT_APART = 0.15
"""Expected difference of the local exponents of two curves that the file calls mirrors."""
WIDEST = 2.0
"""Points of a power-law curve are no further apart than this factor of the distance from null."""
WIDEST_UNSEEN = 1.5
"""... and than this where the recordings never open a port wide: a curve bends between its points
by where the next one is, and by a far one what was seen would decide of what was not."""
NEAREST = 0.02
"""... down to this part of the stroke; nearer to null the power law goes on."""
LEAST_OPENING = 1e-4
"""A port that is shut counts as open by so much, where the logarithm is taken."""


def with_own_curves(rig: Rig, never_wide: Collection[str] = ()) -> Rig:
    """The rig with an opening curve of its own for each port, with points close enough to fit.

    A mirrored curve becomes one of its own, so that filling and exhausting may differ; a curve on
    one side of null becomes a power law between its points.

    Args:
        rig: The rig; left as it is.
        never_wide: Ports, as ``valve.port``, that the recordings never open wide.
    """
    copy = rig.model_copy(deep=True)
    for v, valve in copy.valves.items():
        curves = {}
        if valve.switch is not None or valve.regulator is not None:
            continue  # of what is open or shut, or is a set-point, points between tell nothing
        for name, port in valve.ports.items():
            opening, null = port.opening, valve.spool.null_v
            if opening.mirror is not None:
                source = valve.ports[opening.mirror].opening
                opening = Opening(
                    voltage_v=[2.0 * null - v for v in reversed(source.voltage_v)],
                    fraction=list(reversed(source.fraction)),
                    interpolation=source.interpolation,
                )
            widest = WIDEST_UNSEEN if f"{v}.{name}" in never_wide else WIDEST
            curves[name] = _finer(opening, valve.spool, widest)
        for name, opening in curves.items():
            valve.ports[name].opening = opening
    return copy


def _finer(opening: Opening, spool: Spool, widest: float) -> Opening:
    """A curve as a power law with points no further apart than a factor; others as they are."""
    s = np.array(opening.voltage_v) - spool.null_v
    if np.any(s > 0.0) and np.any(s < 0.0):
        return opening
    if np.argmin(np.abs(s)) == np.argmax(opening.fraction):
        return opening  # open at null, and no power law of the distance from there
    side = 1.0 if s[-1] > 0.0 else -1.0
    given = np.sort(np.abs(s[s != 0.0]))
    low = NEAREST * float(given[-1])
    if opening.interpolation == "power":
        low = max(low, float(given[0]))
    wanted: list[float] = []
    points = [low, *(float(x) for x in given if x > low * 1.001)]
    for a, b in pairwise(points):
        count = int(np.ceil(np.log(b / a) / np.log(widest) - 1e-9))
        wanted += [a * (b / a) ** (k / count) for k in range(count)]
    at = np.array([*wanted, points[-1]])
    volts = spool.null_v + side * at
    value = np.maximum(opening_at(opening, spool.null_v, volts), LEAST_OPENING)
    if side < 0.0:
        volts, value = volts[::-1], value[::-1]
    return Opening(
        voltage_v=[round(float(x), 6) for x in volts],
        fraction=[float(x) for x in value],
        interpolation="power",
    )


Mirrors = dict[tuple[str, str], str]
"""Ports, by valve and name, whose file says that they open as the mirror of another."""


def mirrors_of(rig: Rig) -> Mirrors:
    """Which ports of a rig open as the mirrors of which.

    Args:
        rig: The rig as its file says, before its ports get curves of their own.
    """
    return {
        (v, p): port.opening.mirror
        for v, valve in rig.valves.items()
        for p, port in valve.ports.items()
        if port.opening.mirror is not None
    }


class Bends(NamedTuple):
    """How much curves are expected to bend, as shares of what is expected beforehand.

    Attributes:
        change: Of slopes and exponents between neighbouring intervals.
        apart: Of the exponents of curves that the file calls mirrors.
    """

    change: float = 1.0
    apart: float = 1.0


class Ties(NamedTuple):
    """Prior relations between the points of curves, in units of their standard deviations.

    Attributes:
        matrix: (K, P).
        right: (K,) right side.
        group: (K,) which of `Bends` each belongs to.
    """

    matrix: NDArray[np.float64]
    right: NDArray[np.float64]
    group: NDArray[np.int64]


def curve_ties(
    rig: Rig,
    parameters: list[FitParameter],
    mirrors: Mirrors | None = None,
    bends: Bends | None = None,
) -> Ties:
    """Smoothness of the opening curves as prior relations between their points.

    The slope of a curve may change from one interval to the next by about ``SLOPE_CHANGE`` of its
    mean slope, so that a voltage the recording never dwelt on follows its neighbours. A curve that
    the file calls the mirror of another follows that one where the recording does not show it.

    Args:
        rig: The rig.
        parameters: What is estimated.
        mirrors: Which curves are about the mirrors of which.
        bends: How much they bend, where that is known better (`bends.bends_told`).

    Returns:
        The ties; the first two for ``gauss_newton.minimise``.
    """
    index = {p.path: k for k, p in enumerate(parameters)}
    ties = [
        (0, tie)
        for v, valve in rig.valves.items()
        for p, port in valve.ports.items()
        if port.opening.mirror is None
        for tie in _smooth(valve, f"valves.{v}.ports.{p}", port)
    ]
    for (v, p), source in (mirrors or {}).items():
        ties += [(1, tie) for tie in _alike(rig.valves[v], f"valves.{v}.ports", p, source)]
    rows, sides, groups = [], [], []
    for group, tie in ties:
        row, side = np.zeros(len(parameters)), 0.0
        narrower = 1.0 / (bends or Bends())[group]
        for path, weight, value in tie:
            if path in index:
                row[index[path]] += narrower * weight
            else:
                side -= narrower * weight * value
        if row.any():
            rows.append(row)
            sides.append(side)
            groups.append(group)
    matrix = np.array(rows).reshape(len(rows), len(parameters))
    return Ties(matrix, np.array(sides), np.array(groups, dtype=np.int64))


Tie = list[tuple[str, float, float]]
"""A sum that should vanish: of each point its path, its weight, and its value where it is known."""


def _smooth(valve: Valve, base: str, port: Port) -> Iterator[Tie]:
    """Changes of a curve's slope from one interval to the next."""
    curve, null = port.opening, valve.spool.null_v
    x, y = np.array(curve.voltage_v), np.array(curve.fraction)
    if curve.interpolation == "power":
        # in the logarithms a slope is the exponent of the local power law
        x, y = np.log(np.abs(x - null)), np.log(y)
        change = EXPONENT_CHANGE
    else:
        reach = abs(x[np.argmax(y)] - null) or float(np.ptp(x))  # it may be open at null
        change = SLOPE_CHANGE / reach
    for k in range(1, x.size - 1):
        left, right = 1.0 / (x[k] - x[k - 1]), 1.0 / (x[k + 1] - x[k])
        weights = (left / change, (-left - right) / change, right / change)
        points = range(k - 1, k + 2)
        yield [
            (f"{base}.opening.fraction.{i}", w, y[i]) for i, w in zip(points, weights, strict=True)
        ]


def _alike(valve: Valve, base: str, port: str, source: str) -> Iterator[Tie]:
    """Differences of a curve's exponents from those of its twin at the same distance from null."""
    null = valve.spool.null_v
    curve, twin = valve.ports[port].opening, valve.ports[source].opening
    if curve.interpolation != "power" or twin.interpolation != "power":
        return
    x, y = np.log(np.abs(np.array(curve.voltage_v) - null)), np.log(curve.fraction)
    z, w = np.log(np.abs(np.array(twin.voltage_v) - null)), np.log(twin.fraction)
    for k in range(x.size - 1):
        middle = 0.5 * (x[k] + x[k + 1])
        holds = np.flatnonzero((z[:-1] - middle) * (z[1:] - middle) <= 0.0)
        if holds.size == 0:
            continue  # the twin does not reach so far
        j = int(holds[0])
        own = 1.0 / (EXPONENT_APART * (x[k + 1] - x[k]))
        its = 1.0 / (EXPONENT_APART * (z[j + 1] - z[j]))
        yield [
            (f"{base}.{port}.opening.fraction.{k + 1}", own, y[k + 1]),
            (f"{base}.{port}.opening.fraction.{k}", -own, y[k]),
            (f"{base}.{source}.opening.fraction.{j + 1}", -its, w[j + 1]),
            (f"{base}.{source}.opening.fraction.{j}", its, w[j]),
        ]
