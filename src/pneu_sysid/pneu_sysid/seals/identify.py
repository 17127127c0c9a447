# SPDX-License-Identifier: Apache-2.0
"""From drag tests to a verdict: how a cylinder without friction fails, and which friction it lacks.

Every law that the strokes can judge is fitted; terms must earn their place. Errors are those on
strokes kept aside: cycles to and fro are dealt into three heaps, and each is predicted from the
other two.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.cylinder import Friction
from pneu_sim.rig.schema import Rig
from pneu_sysid.results.base import Verdict
from pneu_sysid.seals.cells import Pieces, pieces_of
from pneu_sysid.seals.estimate import (
    ALONG,
    Estimate,
    Scatter,
    Whitened,
    predicted,
    scatter_of,
    smooth,
)
from pneu_sysid.seals.laws import (
    FIELDS,
    Range,
    Term,
    combinations_of,
    range_of,
    stribeck_speeds,
)
from pneu_sysid.seals.reading import DragTest
from pneu_sysid.thresholds import Thresholds

Floats = NDArray[np.float64]

HEAPS = 3
"""Cycles are dealt into so many heaps; each is predicted from the others."""
EARNED = 12.0
"""A term is worth adding if the weighted squares fall by so much: three and a half standard errors,
for recordings are few and their friction's scatter is known from few."""
OF_SPEED = 6.0
"""... and by so much more for breakaway, whose speed is chosen to suit it."""
WORTH = 0.04
"""A term has to change the friction by this share of it over what the strokes go through: bore and
seal do as much by themselves."""
TIED = 6.0
"""Laws whose weighted squares, with what terms must earn, differ by less are equally good."""
AS_GOOD = 1.05
"""A rig's own friction is as good as what would be fitted up to so many times its error."""
UNEXPLAINED = 2.0
"""Down to so many times the noise nothing more is said to be missing."""


@dataclass(frozen=True)
class Errors:
    """Error of a law, root mean square of the readings while the piston slides, N.

    Attributes:
        law: Its terms.
        rmse_n: On the strokes that it was fitted to.
        held_out_n: On strokes kept aside; None where there are too few.
        by_level: (levels, 2) the first, as the rod is pressed in and as it is drawn out.
    """

    law: tuple[Term, ...]
    rmse_n: float
    held_out_n: float | None
    by_level: Floats

    @property
    def judged_n(self) -> float:
        """The error that decides: that on strokes kept aside, where there is one."""
        return self.rmse_n if self.held_out_n is None else self.held_out_n


@dataclass(frozen=True)
class Identified:
    """What drag tests say of a cylinder's friction.

    Attributes:
        pieces: The strokes.
        spans: What they went through.
        scatter: What varies by chance.
        laws: Every law that was fitted, the best first.
        best: The law that is named.
        alike: Laws that are as good.
        steps: Errors as its terms are added, the one that helps most first.
        own: Error of the rig file's own friction; None where it has none.
        noise_n: White noise of one reading, of all levels, N.
        explained: Share of the squared error without friction that the law takes away, on strokes
            kept aside.
        verdict: The verdict.
        left_n: What varies beside the law, by what it varies with, N; the largest first.
    """

    pieces: Pieces
    spans: Range
    scatter: Scatter
    laws: list[Estimate]
    best: Estimate
    alike: list[Estimate]
    steps: list[Errors]
    own: float | None
    noise_n: float
    explained: float
    verdict: Verdict
    left_n: dict[str, float]

    @property
    def times_noise(self) -> float:
        """Error that the law leaves, in noise deviations."""
        return self.steps[-1].judged_n / max(self.noise_n, 1e-12)


def identify(rig: Rig, tests: Sequence[DragTest]) -> Identified:
    """Names the friction of a cylinder.

    Args:
        rig: The rig, with the section ``drag``.
        tests: Drag tests of its cylinder.

    Raises:
        InputError: The strokes cannot tell friction at all.
    """
    assert rig.drag is not None
    pieces = pieces_of(tests)
    spans = range_of(pieces)
    laws = combinations_of(spans)
    speeds = stribeck_speeds(spans)
    fullest: tuple[Term, ...] = max(laws, key=len)
    # Which Stribeck speed suits is not known yet, and what varies by chance depends on it.
    tried = speeds[1::4] if "breakaway" in fullest else speeds[:1]
    scatter, _ = min(
        (scatter_of(pieces, fullest, float(v)) for v in tried), key=lambda found: found[1]
    )
    whitened = Whitened(pieces, scatter)
    fitted = [whitened.best(law, speeds) for law in laws]
    best, alike, ranked = _choose(pieces, fitted)
    by_law = {e.law: e for e in fitted}
    # What the fullest law could still explain, by terms that were not worth it, is scatter now.
    scatter, _ = scatter_of(pieces, best.law, best.stribeck_m_s)
    named = Whitened(pieces, scatter).fit(best.law, best.stribeck_m_s)
    order = _order(best.law, by_law)
    steps = [
        _errors(pieces, scatter, by_law[_in_order(order[:k], laws)]) for k in range(len(order))
    ]
    steps.append(_errors(pieces, scatter, named))
    noise = _noise(pieces)
    own = _own_error(rig.cylinders[rig.drag.cylinder].friction, pieces)
    before, after = steps[0].judged_n, steps[-1].judged_n
    explained = 1.0 - (after / before) ** 2 if before > 0.0 else 0.0
    verdict = _verdict(named, alike, steps, own, noise, explained)
    return Identified(
        pieces,
        spans,
        scatter,
        ranked,
        named,
        alike,
        steps,
        own,
        noise,
        explained,
        verdict,
        _left(pieces, scatter),
    )


def score(e: Estimate) -> float:
    """Weighted squares that a law leaves, with what its terms have to earn; less is better.

    Args:
        e: The law.
    """
    return e.cost + EARNED * len(e.law) + (OF_SPEED if "breakaway" in e.law else 0.0)


def _choose(
    pieces: Pieces, fitted: list[Estimate]
) -> tuple[Estimate, list[Estimate], list[Estimate]]:
    """The best law, those that are as good, and all of them, the best first.

    Of laws that are equally good the one with fewest terms is named, and of those the first in the
    order of the terms: constant friction before viscous.
    """
    sound = [e for e in fitted if _is_worth(pieces, e)]
    ranked = sorted(sound, key=score)
    tied = [e for e in ranked if score(e) - score(ranked[0]) < TIED]
    place = {e.law: k for k, e in enumerate(fitted)}
    best = min(tied, key=lambda e: (len(e.law), place[e.law]))
    alike = [
        e
        for e in ranked
        if e is not best
        and score(e) - score(best) < TIED
        and not set(best.law) <= set(e.law)
        and len(e.law) <= len(best.law) + 1
    ]
    return best, alike, [best, *(e for e in ranked if e is not best)]


def _is_worth(pieces: Pieces, e: Estimate) -> bool:
    """Whether every term of a law is there and, beside the constant, changes the friction."""
    if not all(v > 0.0 for v in e.strength.values()):
        return False
    usual = float(np.mean(np.abs(predicted(pieces, e)))) if e.law else 0.0
    r = pieces.readings
    shapes: dict[Term, Floats] = {
        "pressure": r.pressure_pa,
        "viscous": r.speed_m_s,
        "breakaway": np.exp(-((r.speed_m_s / e.stribeck_m_s) ** 2)),
    }
    for term, shape in shapes.items():
        if term in e.strength:
            low, high = np.quantile(shape, [0.05, 0.95])
            if e.strength[term] * (high - low) < WORTH * usual:
                return False
    return True


def _in_order(terms: Sequence[Term], laws: list[tuple[Term, ...]]) -> tuple[Term, ...]:
    return next(law for law in laws if set(law) == set(terms))


def _order(law: tuple[Term, ...], by_law: dict[tuple[Term, ...], Estimate]) -> list[Term]:
    """Terms of a law in the order in which they help most."""
    order: list[Term] = []
    while len(order) < len(law):
        options = [
            e
            for other, e in by_law.items()
            if set(order) < set(other) <= set(law) and len(other) == len(order) + 1
        ]
        order += [t for t in min(options, key=lambda e: e.cost).law if t not in order]
    return order


def _noise(pieces: Pieces) -> float:
    count = np.bincount(pieces.level[pieces.readings.piece], minlength=len(pieces.levels))
    square = np.array([level.noise_n**2 for level in pieces.levels])
    return float(np.sqrt(count @ square / count.sum()))


def _without_zero(pieces: Pieces, values: Floats, known: NDArray[np.bool_] | None = None) -> Floats:
    """Values of the readings without each level's zero: the middle between both ways' means."""
    of = pieces.level[pieces.readings.piece]
    way = pieces.way[pieces.readings.piece]
    known = np.ones(values.size, dtype=bool) if known is None else known
    out = values.copy()
    for k in range(len(pieces.levels)):
        sides = [values[(of == k) & (way == w) & known] for w in (1.0, -1.0)]
        means = [float(side.mean()) for side in sides if side.size]
        out[of == k] -= float(np.mean(means)) if means else 0.0
    return out


def _residual(pieces: Pieces, e: Estimate) -> Floats:
    """What a law leaves of every reading; without friction the gain is taken for exact."""
    r = pieces.readings
    gain = e.gain if e.law else 0.0
    out: Floats = r.rest_n - gain * r.load_n - predicted(pieces, e)
    return out


def _errors(pieces: Pieces, scatter: Scatter, e: Estimate) -> Errors:
    """Errors of a law, on what it was fitted to and on cycles kept aside."""
    r = pieces.readings
    left = _without_zero(pieces, _residual(pieces, e))
    of, way = pieces.level[r.piece], pieces.way[r.piece]
    by_level = np.array(
        [
            [_rms(left[(of == k) & (way == w)]) for w in (1.0, -1.0)]
            for k in range(len(pieces.levels))
        ]
    )
    heap = pieces.cycle % HEAPS
    squares, judged = 0.0, 0
    for h in range(HEAPS):
        aside = heap == h
        enough = all((~aside & (pieces.level == k)).any() for k in range(len(pieces.levels)))
        if not aside.any() or not enough:
            continue
        learnt = Whitened(pieces, scatter, ~aside).fit(e.law, e.stribeck_m_s)
        out = aside[r.piece]
        rest = _without_zero(pieces, _residual(pieces, learnt), ~out)[out]
        squares += float(rest @ rest)
        judged += rest.size
    held_out = float(np.sqrt(squares / judged)) if judged else None
    return Errors(e.law, _rms(left), held_out, by_level)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def friction_of(friction: Friction, pieces: Pieces) -> Floats:
    """(m,) friction of a rig file at every reading, with its sign, N.

    Args:
        friction: What the rig file says.
        pieces: The strokes.
    """
    r = pieces.readings
    way = pieces.way[r.piece]
    speed_term = np.exp(-((r.speed_m_s / friction.stribeck_m_s) ** 2))
    out: Floats = way * (
        friction.coulomb_n
        + friction.coulomb_n_per_pa * r.pressure_pa
        + friction.viscous_n_s_m * r.speed_m_s
        + friction.breakaway_n * speed_term
    )
    return out


def _own_error(friction: Friction, pieces: Pieces) -> float | None:
    """Error of the rig file's friction, at its best gain; None where it has none."""
    if not any(getattr(friction, field) > 0.0 for field in FIELDS.values()):
        return None
    rest = _without_zero(pieces, pieces.readings.rest_n - friction_of(friction, pieces))
    load = _without_zero(pieces, pieces.readings.load_n)
    gain = float(rest @ load) / max(float(load @ load), 1e-300)
    return _rms(rest - float(np.clip(gain, -0.04, 0.04)) * load)


def _verdict(
    best: Estimate,
    alike: list[Estimate],
    steps: list[Errors],
    own: float | None,
    noise: float,
    explained: float,
) -> Verdict:
    left = steps[-1].judged_n
    if own is not None and own <= AS_GOOD * max(left, noise):
        return "nothing_missing"
    if not best.law:
        return "nothing_missing" if left <= UNEXPLAINED * noise else "unknown"
    if explained < Thresholds().nearest:
        return "unknown"
    if alike and not common_terms(best, alike):
        return "ambiguous"
    return "effect"


def common_terms(best: Estimate, alike: Sequence[Estimate]) -> list[Term]:
    """Terms that every law has which is as good as the best.

    Args:
        best: The best law.
        alike: Those that are as good.
    """
    return [t for t in best.law if all(t in e.law for e in alike)]


def _left(pieces: Pieces, scatter: Scatter) -> dict[str, float]:
    """What varies beside the law, N, the largest first."""
    along = float(np.mean(np.diag(smooth(pieces.bin, ALONG))))
    found = {
        "along the bore": float(
            np.sqrt(along * (scatter.bore**2 + scatter.way**2 + scatter.place**2))
        ),
        "from recording to recording": scatter.friction if len(pieces.levels) > 1 else 0.0,
        "from stroke to stroke": float(np.hypot(scatter.drift, scatter.stroke)),
        "within a stroke, never twice alike": scatter.piece,
    }
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def with_friction(rig: Rig, found: Identified) -> Rig:
    """The rig with the friction that was named, in place of what it had.

    Args:
        rig: The rig.
        found: What was found.
    """
    assert rig.drag is not None
    strength = found.best.strength
    values = {FIELDS[t]: v for t, v in strength.items()}
    if "breakaway" in strength:
        values["stribeck_m_s"] = found.best.stribeck_m_s
    name = rig.drag.cylinder
    cylinder = rig.cylinders[name].model_copy(update={"friction": Friction(**values)})
    return rig.model_copy(update={"cylinders": {**rig.cylinders, name: cylinder}})


def friction_at(
    found: Identified, mean_gauge_pa: Floats, speed_m_s: float | None = None
) -> tuple[Floats, Floats]:
    """Friction of the named law over pressure, and its standard error, N.

    Args:
        found: What was found.
        mean_gauge_pa: (n,) mean gauge pressures of both sides, Pa.
        speed_m_s: Speed; None is the usual one.

    Returns:
        (n,) friction and (n,) standard errors.
    """
    e = found.best
    usual = float(np.median(found.pieces.readings.speed_m_s))
    speed = usual if speed_m_s is None else speed_m_s
    own: dict[Term, Floats] = {
        "constant": np.ones(mean_gauge_pa.size),
        "pressure": mean_gauge_pa,
        "viscous": np.full(mean_gauge_pa.size, speed),
        "breakaway": np.full(mean_gauge_pa.size, np.exp(-((speed / e.stribeck_m_s) ** 2))),
    }
    if not e.law:
        return np.zeros(mean_gauge_pa.size), np.zeros(mean_gauge_pa.size)
    design = np.column_stack([own[t] for t in e.law])
    value = design @ np.array([e.strength[t] for t in e.law])
    variance = np.einsum("ij,jk,ik->i", design, e.covariance, design)
    return value, np.sqrt(np.maximum(variance, 0.0))
