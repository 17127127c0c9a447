# SPDX-License-Identifier: Apache-2.0
"""Candidates of friction laws: the terms of the simulator's own law, alone and together.

The law is that of `pneu_sim.rig.cylinder.Friction` while it slides: ``coulomb_n + coulomb_n_per_pa
* mean gauge pressure of both sides + breakaway_n exp(-(v / stribeck_m_s)^2) + viscous_n_s_m v``.
"""

from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pneu_sysid.seals.cells import Pieces

Floats = NDArray[np.float64]
Term = Literal["constant", "pressure", "viscous", "breakaway"]

TITLES: dict[Term, str] = {
    "constant": "constant friction (Coulomb)",
    "pressure": "friction that grows with pressure",
    "viscous": "viscous friction",
    "breakaway": "breakaway friction that vanishes with speed (Stribeck)",
}
SHORT: dict[Term, str] = {
    "constant": "constant",
    "pressure": "growing with pressure",
    "viscous": "viscous",
    "breakaway": "breakaway",
}
FIELDS: dict[Term, str] = {
    "constant": "coulomb_n",
    "pressure": "coulomb_n_per_pa",
    "viscous": "viscous_n_s_m",
    "breakaway": "breakaway_n",
}
UNITS: dict[Term, str] = {"constant": "N", "pressure": "N/Pa", "viscous": "N s/m", "breakaway": "N"}

MOST_BREAKAWAY = 2.0
"""A seal is taken to hold at most so many times its constant friction more at rest. Machines slow
down as pressure holds against them: without a bound, breakaway passes for growth with pressure."""
LEAST_SPEEDS = 1.5
"""Speeds one way whose 95 % point is less than so many times their 5 % point cannot tell speed's
terms; what ways in and out differ by, the force's zero may make as well."""
LEAST_PRESSURES = 1.25
"""Likewise of pressures, the greatest of all levels to the least ..."""
LEAST_SPAN_PA = 1e4
"""... and their least span, of the mean of both sides."""


@dataclass(frozen=True)
class Range:
    """What the strokes went through.

    Attributes:
        speed_m_s: 5 and 95 % point of the speeds.
        pressure_pa: Least and greatest mean gauge pressure of the levels, of both sides, Pa.
        speeds: Whether the speeds can tell terms that depend on speed.
        pressures: Whether the pressures can tell a term that depends on pressure.
    """

    speed_m_s: tuple[float, float]
    pressure_pa: tuple[float, float]
    speeds: bool
    pressures: bool


def range_of(pieces: Pieces) -> Range:
    """What the strokes went through.

    Args:
        pieces: Pieces of the strokes.
    """
    speed, way = pieces.readings.speed_m_s, pieces.way[pieces.readings.piece]
    slow, fast = np.quantile(speed, [0.05, 0.95])
    ways = [np.quantile(speed[way == w], [0.05, 0.95]) for w in (1.0, -1.0)]
    mean = [level.mean_gauge_pa for level in pieces.levels]
    least, most = min(mean), max(mean)
    return Range(
        (float(slow), float(fast)),
        (least, most),
        any(bool(high >= LEAST_SPEEDS * low) for low, high in ways),
        most - least >= LEAST_SPAN_PA and most >= LEAST_PRESSURES * least,
    )


def combinations_of(spans: Range) -> list[tuple[Term, ...]]:
    """Every law that these strokes can judge, the one without friction first.

    Args:
        spans: What the strokes went through.
    """
    terms: list[Term] = ["constant"]
    if spans.pressures:
        terms.append("pressure")
    if spans.speeds:
        terms += ["viscous", "breakaway"]
    laws: list[tuple[Term, ...]] = []
    for count in range(len(terms) + 1):
        laws += [c for c in combinations(terms, count) if "breakaway" not in c or "constant" in c]
    return laws


def stribeck_speeds(spans: Range) -> Floats:
    """Speeds over which breakaway may vanish that these strokes can judge, m/s.

    Args:
        spans: What the strokes went through.
    """
    return np.geomspace(max(0.5 * spans.speed_m_s[0], 1e-5), 0.7 * spans.speed_m_s[1], 16)


def column(pieces: Pieces, term: Term, stribeck_m_s: float) -> Floats:
    """What a term adds to the force per unit of its strength, at every reading.

    Args:
        pieces: Pieces of the strokes.
        term: The term.
        stribeck_m_s: Speed over which breakaway vanishes.

    Returns:
        (m,) column of the readings; breakaway's has the constant with it, see `MOST_BREAKAWAY`.
    """
    r = pieces.readings
    way = pieces.way[r.piece]
    if term == "constant":
        return way
    if term == "pressure":
        return way * r.pressure_pa
    if term == "viscous":
        return way * r.speed_m_s
    return way * (1.0 + MOST_BREAKAWAY * np.exp(-((r.speed_m_s / stribeck_m_s) ** 2)))
