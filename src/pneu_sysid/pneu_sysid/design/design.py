# SPDX-License-Identifier: Apache-2.0
"""An experiment designed: pieces drawn, what each tells, the best chosen, and played whole.

Parameters: D-optimal, the volume of what is possible of them is made small (Fedorov 1972).
Candidates: T-optimal, each stays as far as it can from what any other can make of it (Atkinson and
Fedorov 1975, Biometrika 62(1), 57), the nearest two counting.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from pneu_common.errors import InputError
from pneu_sim.models import kind_of
from pneu_sim.rig.schema import FitParameter, Rig
from pneu_sysid.curves import Mirrors, mirrors_of
from pneu_sysid.design.choose import Worth, choose
from pneu_sysid.design.foreseen import Foreseen, foresee, lasting_share, with_known_noise
from pneu_sysid.design.hypotheses import Hypothesis
from pneu_sysid.design.information import Information, information_of
from pneu_sysid.design.limits import Limits
from pneu_sysid.design.plan import Bounds, Plan, thinned
from pneu_sysid.design.promise import expected_of, pairs_of, separation_of
from pneu_sysid.design.tracking import track
from pneu_sysid.design.waves import KINDS, STEP_S, Choice, draw_piece, joined, shut
from pneu_sysid.fit import as_fitted
from pneu_sysid.problem import make_problem
from pneu_sysid.results import pneu_version
from pneu_sysid.thresholds import Thresholds

Floats = NDArray[np.float64]
Progress = Callable[[str, float], None]
Tells = Callable[..., Information]
"""What pieces tell: of what is foreseen, of when they begin and end, and who is told of it."""

POOL = 120
"""Pieces that are drawn to choose from."""
TRACKED = 8
"""Plans that are drawn where pressures are to follow targets."""
PIECES = 8
"""Of a plan, unless they would be shorter or longer than ..."""
PIECE_S = (0.8, 2.5)
"""... so many seconds: some horizons, few enough for a choice."""
REST_S = 0.1
"""Valves are shut so long before the first piece: a rig that is moved from the first reading on is
in a state that every model has to guess, and what they guess is no difference of theirs."""
LONGER_CELLS = 2.0
"""Changes of the prediction are taken on cells so many times as long."""
AS_LONG = 2.0
"""Plans that are run as a whole take together so many times as long as all pieces: the best pieces
by what each tells where it was drawn, ..."""
MOST_TRIES = 40
"""... (no more than so many plans in all) ..."""
WINDOWS = 5
"""... the best that follow one another there, so many, and from then on the best plan so far with
some pieces exchanged for others that follow one another there."""
SCATTER = 0.5
"""By so much of what is needed the lead that is found is other than promised: by one standard
error, as it is counted in those, and by what the model got wrong of it."""
FARTHER = 1e-3
"""What a lead of as much as is needed counts beside a pair that is told apart: of plans that tell
the same pairs apart for sure, or none, the one with wider leads is better."""


@dataclass(frozen=True)
class Asked:
    """What a plan is to be.

    Attributes:
        seconds: How long, s.
        limits: What is kept to.
        hypotheses: What is to be told apart; none to learn parameters.
        parameters: Numbers of the rig: those to be learnt, or those that may hide what is missing.
        kind: One kind of waves drawn at random; None chooses among all.
        rate_hz: Readings of each sensor per second.
        seed: Of the draws.
        workers: Threads; None is all cores.
    """

    seconds: float
    limits: Limits
    hypotheses: Sequence[Hypothesis]
    parameters: Sequence[FitParameter]
    kind: Choice | None = None
    rate_hz: float = 500.0
    seed: int = 0
    workers: int | None = None


@dataclass(frozen=True)
class _Pool:
    """Pieces to choose from.

    Attributes:
        rest: What comes before all: per command volts every ``STEP_S``.
        pieces: Likewise.
        piece_s: How long each lasts, s.
        count: How many a plan has.
        seen: What happens where they are played one after the other.
        allowed: Those that keep to the limits there.
    """

    rest: dict[str, Floats]
    pieces: list[dict[str, Floats]]
    piece_s: float
    count: int
    seen: Foreseen
    allowed: list[int]

    def edges_s(self, count: int) -> Floats:
        """(count + 1,) where so many pieces begin and end, s."""
        return REST_S + np.arange(count + 1, dtype=np.float64) * self.piece_s


@dataclass(frozen=True)
class _Played:
    """A choice of pieces, played whole.

    Attributes:
        chosen: The pieces.
        volts: Per command volts every ``STEP_S``.
        seen: What happens.
        promised: What it tells, as one piece.
        value: What that is worth.
    """

    chosen: list[int]
    volts: dict[str, Floats]
    seen: Foreseen
    promised: Information
    value: float


def design(rig: Rig, asked: Asked, progress: Progress | None = None) -> Plan:
    """Designs an experiment.

    Args:
        rig: The rig, as its calibration left it; without the hypotheses.
        asked: What is asked for.
        progress: Called with a stage's name and the fraction done.

    Raises:
        InputError: Nothing that was drawn keeps to the limits, or there is nothing to learn.
    """
    tell = progress or (lambda stage, done: None)
    if not asked.hypotheses and not asked.parameters:
        raise InputError(f"rig {rig.name!r}: found no parameters to learn, and no candidates")
    # candidates are told apart with the rig that was diagnosed, numbers learnt with one for a fit
    model = with_known_noise(rig if asked.hypotheses else as_fitted(rig))
    tells = partial(_information, model, asked, lasting_share(rig), mirrors_of(rig))
    rng = np.random.default_rng([asked.seed, 23])
    pool = _drawn(model, asked, rng, tell)
    known = None
    if asked.kind is None:
        edges = pool.edges_s(POOL)
        known = tells(pool.seen, edges, partial(tell, "what each piece tells"))
    best = _played(model, asked, pool, known, tells, rng, tell)
    gram = best.promised.grams.sum(axis=0)
    labels = [one.label for one in asked.hypotheses]
    separations, most = [], []
    for a, b in pairs_of(asked.hypotheses):
        lead = best.promised.lead(gram, a, b)
        most.append(max(lead, 0.0 if known is None else _alone(known, pool, a, b)))
        separations.append(separation_of(labels[a], labels[b], lead, most[-1]))
    seconds = float(pool.edges_s(pool.count)[-1])
    learnt = [] if asked.hypotheses else asked.parameters
    return Plan(
        pneu_version=pneu_version(),
        rig=rig.name,
        kind=asked.kind or ("separate" if asked.hypotheses else "parameters"),
        seconds=seconds,
        seed=asked.seed,
        commands={name: thinned(series, STEP_S) for name, series in best.volts.items()},
        limits=_bounds(asked.limits),
        expected=expected_of(best.seen, best.promised, separations, most, learnt, seconds),
    )


def _drawn(model: Rig, asked: Asked, rng: np.random.Generator, tell: Progress) -> _Pool:
    """Pieces that keep to the limits, and more."""
    limits, seconds = asked.limits, asked.seconds - REST_S
    if asked.kind == "tracking":  # what corrects without end is no piece of something else
        count, piece_s = 1, round(seconds / STEP_S) * STEP_S
        pieces = track(model, limits, piece_s, TRACKED, rng).pieces
    else:
        count = max(round(seconds / np.clip(seconds / PIECES, *PIECE_S)), 1)
        piece_s = round(seconds / count / STEP_S) * STEP_S
        kinds = [asked.kind] if asked.kind else list(KINDS)
        pieces = [
            draw_piece(model, limits, piece_s, kinds[k % len(kinds)], rng) for k in range(POOL)
        ]
    rest = shut(model, limits, REST_S)
    volts = joined([rest, *pieces], limits)
    ran = partial(tell, "running what may be played")
    seen = foresee(model, volts, asked.rate_hz, asked.workers, ran)
    edges = REST_S + np.arange(len(pieces) + 1) * piece_s
    spent = [count * seen.taken_kg(*edges[k : k + 2]) for k in range(len(pieces))]
    allowed = [
        k
        for k in range(len(pieces))
        if seen.keeps(limits, *edges[k : k + 2]) and spent[k] <= limits.air_kg
    ]
    if not allowed:
        raise InputError(_nothing_left(seen, limits, min(spent)))
    return _Pool(rest, pieces, piece_s, count, seen, allowed)


def _played(
    model: Rig,
    asked: Asked,
    pool: _Pool,
    known: Information | None,
    tells: Tells,
    rng: np.random.Generator,
    tell: Progress,
) -> _Played:
    """The best of several plans; any that keeps to the limits where nothing is chosen.

    What a piece tells depends on what was before it, and begun elsewhere it goes elsewhere. So
    what pieces tell where they were drawn only says where to begin, and plans are judged whole.
    """
    worth = _worth(known, asked)
    count = pool.count
    edges = pool.edges_s(count)
    begin: list[list[int]] = []
    if known is not None:
        begin = _windows(known, pool.allowed, count, worth)
        begin.append(choose(known.grams, count, pool.allowed, worth))
    best: _Played | None = None
    tried: set[tuple[int, ...]] = set()
    tries = min(round(AS_LONG * POOL / count), MOST_TRIES)
    for turn in range(tries):
        if turn < len(begin):
            chosen = begin[turn]
        elif best is None:
            chosen = [int(k) for k in rng.choice(pool.allowed, count)]
        else:
            chosen = _exchanged(best.chosen, pool.allowed, rng)
        if tuple(chosen) in tried:
            continue
        tried.add(tuple(chosen))
        tell("trying plans", turn / tries)
        volts = joined([pool.rest, *(pool.pieces[k] for k in chosen)], asked.limits)
        seen = foresee(model, volts, asked.rate_hz, asked.workers)
        inside = all(seen.keeps(asked.limits, *edges[k : k + 2]) for k in range(count))
        if not inside or seen.air_kg[-1] > asked.limits.air_kg:
            continue
        promised = tells(seen, np.array([0.0, edges[-1]]))
        value = worth(promised.grams.sum(axis=0))
        if best is None or value > best.value:
            best = _Played(chosen, volts, seen, promised, value)
        if known is None:
            break
    if best is None:
        raise InputError(_nothing_left(seen, asked.limits, float(seen.air_kg[-1])))
    return best


def _windows(
    known: Information, allowed: Sequence[int], count: int, worth: Worth
) -> list[list[int]]:
    """The best pieces that follow one another in the pool, no piece twice."""
    runs = [
        list(range(k, k + count))
        for k in range(len(known.grams) - count + 1)
        if set(range(k, k + count)) <= set(allowed)
    ]
    runs.sort(key=lambda run: worth(known.grams[run].sum(axis=0)), reverse=True)
    out: list[list[int]] = []
    for run in runs:
        if len(out) < WINDOWS and all(set(run).isdisjoint(other) for other in out):
            out.append(run)
    return out


def _exchanged(
    chosen: Sequence[int], allowed: Sequence[int], rng: np.random.Generator
) -> list[int]:
    """Pieces, some of which are exchanged for others that follow one another in the pool."""
    out = list(chosen)
    length = int(rng.integers(1, max(len(out) // 2, 1) + 1))
    at = int(rng.integers(0, len(out) - length + 1))
    begin = int(rng.choice(allowed))
    inside = set(allowed)
    new = [k for k in range(begin, begin + length) if k in inside]
    out[at : at + len(new)] = new
    return out


def _information(
    model: Rig,
    asked: Asked,
    lasting: Mapping[str, float],
    mirrors: Mirrors,
    seen: Foreseen,
    edges: Floats,
    progress: Callable[[float], None] | None = None,
) -> Information:
    problem = make_problem(model, seen.recording, workers=asked.workers)
    if kind_of(model).along_lines:
        problem = problem.coarsened(model, LONGER_CELLS)
    return information_of(
        problem, model, asked.hypotheses, asked.parameters, edges, lasting,
        mirrors, progress,
    )  # fmt: skip


def _worth(known: Information | None, asked: Asked) -> Worth:
    """What a sum of pieces is worth; nothing where none are chosen."""
    if known is None:
        return lambda gram: 0.0
    if not asked.hypotheses:
        return known.log_determinant
    pairs, needed = pairs_of(asked.hypotheses), Thresholds().tied

    def told_apart(gram: Floats) -> float:
        """How many pairs are to be expected to be told apart, as a share.

        Two that little parts so do not keep the others from being parted, as they would if the
        nearest were all that counts.
        """
        leads = np.array([known.lead(gram, a, b) for a, b in pairs]) / needed
        return float(np.mean(ndtr((leads - 1.0) / SCATTER) + FARTHER * np.sqrt(leads)))

    return told_apart


def _alone(known: Information, pool: _Pool, a: int, b: int) -> float:
    """Lead of two by the piece that parts them best, played over and over.

    Leads grow with the root of time.
    """
    return math.sqrt(pool.count) * max(known.lead(known.grams[k], a, b) for k in pool.allowed)


def _bounds(limits: Limits) -> Bounds:
    return Bounds(
        low_v=dict(limits.low_v),
        high_v=dict(limits.high_v),
        slew_v_s=limits.slew_v_s,
        highest_pa=limits.highest_pa,
        lowest_pa=limits.lowest_pa,
        joints={name: list(of) for name, of in limits.joints.items()},
        air_kg=limits.air_kg,
    )


def _nothing_left(seen: Foreseen, limits: Limits, air_kg: float) -> str:
    p = seen.pressures_pa
    text = (
        f"limits: nothing that was drawn keeps to them; pressures would go from {p.min():.6g} to"
        f" {p.max():.6g} Pa, allowed are {limits.lowest_pa:.6g} to {limits.highest_pa:.6g}"
    )
    for name, (low, high) in limits.joints.items():
        q = seen.joints[name]
        text += f"; {name} from {q.min():.4g} to {q.max():.4g}, allowed {low:g} to {high:g}"
    if math.isfinite(limits.air_kg):
        text += f"; the least air is {air_kg:.3g} kg, allowed {limits.air_kg:.3g}"
    return text + "; wider limits, or a shorter plan, leave something"
