# SPDX-License-Identifier: Apache-2.0
"""An experiment designed: pieces drawn, what each tells, the best chosen, and played whole.

Parameters: D-optimal, the volume of what is possible of them is made small (Fedorov 1972), on
average over rigs as they may be (`possible`).
Candidates: T-optimal, each stays as far as it can from what any other can make of it (Atkinson and
Fedorov 1975, Biometrika 62(1), 57), pairs that are told apart counting.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from pneu_common.errors import InputError
from pneu_common.installed import version
from pneu_sim.models import kind_of
from pneu_sim.rig.schema import FitParameter, Rig
from pneu_sysid.curves import Mirrors, mirrors_of
from pneu_sysid.design.choose import Worth, choose
from pneu_sysid.design.foreseen import Foreseen, foresee, lasting_share, with_known_noise
from pneu_sysid.design.hypotheses import Hypothesis
from pneu_sysid.design.information import Information, information_of
from pneu_sysid.design.limits import Limits
from pneu_sysid.design.plan import Bounds, Plan, thinned
from pneu_sysid.design.possible import possible_rigs
from pneu_sysid.design.promise import Promise, expected_of, pairs_of, separation_of
from pneu_sysid.design.tracking import track
from pneu_sysid.design.waves import KINDS, STEP_S, Choice, draw_piece, joined, shut
from pneu_sysid.fit import as_fitted
from pneu_sysid.problem import make_problem
from pneu_sysid.slopes import LOOKS
from pneu_sysid.thresholds import Thresholds

Floats = NDArray[np.float64]
Progress = Callable[[str, float], None]
Ran = Callable[[float], None]
"""Told the fraction done."""

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
AVERAGED = 3
"""Rigs as they may be, by which plans for parameters are chosen; one that is behind the best plan
so far by the first of them is not run by the others."""
PROMISED = 5
"""Others, by which the plan that was chosen is judged."""
TRIED_LOOKS = 1
"""What a plan hardly shows is looked along so often where plans for parameters are tried: a third
of what a joint's were chosen by was errors of differences. What parts candidates is well shown."""
LEAVES = 1e6
"""A rig in which a plan would leave its limits counts against it by more than all it tells."""
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
class _Model:
    """A rig, and how what is played on it is foreseen.

    Attributes:
        rig: The rig.
        asked: What a plan is to be, its parameters as they are known of this rig.
        lasting: Per sensor the share of what its calibration left that lasts.
        mirrors: Opening curves that are about the mirrors of others.
    """

    rig: Rig
    asked: Asked
    lasting: Mapping[str, float]
    mirrors: Mirrors

    def foresee(self, volts: Mapping[str, Floats], progress: Ran | None = None) -> Foreseen:
        """What happens along commands."""
        return foresee(self.rig, volts, self.asked.rate_hz, self.asked.workers, progress)

    def tells(
        self,
        seen: Foreseen,
        edges: Floats | None = None,
        progress: Ran | None = None,
        looks: int = 0,
    ) -> Information:
        """What the pieces between edges tell; without edges, each stretch that a fit has of it."""
        problem = make_problem(self.rig, seen.recording, workers=self.asked.workers)
        if kind_of(self.rig).along_lines:
            problem = problem.coarsened(self.rig, LONGER_CELLS)
        return information_of(
            problem, self.rig, self.asked.hypotheses, self.asked.parameters, edges, self.lasting,
            self.mirrors, progress, looks,
        )  # fmt: skip


@dataclass(frozen=True)
class _Played:
    """A choice of pieces, played whole.

    Attributes:
        chosen: The pieces.
        volts: Per command volts every ``STEP_S``.
        values: What it is worth by each rig that it is chosen by.
    """

    chosen: list[int]
    volts: dict[str, Floats]
    values: list[float]


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
    model = _model(rig, asked)
    rng = np.random.default_rng([asked.seed, 23])
    pool = _drawn(model, rng, tell)
    known = None
    if asked.kind is None:
        known = model.tells(pool.seen, pool.edges_s(POOL), partial(tell, "what each piece tells"))
    others = _others(model, pool, AVERAGED + PROMISED)
    chosen_by, judges = others[:AVERAGED] or [model], others[AVERAGED:] or [model]
    best = _played(model, chosen_by, pool, known, rng, tell)
    promises = [
        Promise(seen, m.tells(seen, looks=LOOKS))
        for m in judges
        for seen in [m.foresee(best.volts)]
    ]
    labels = [one.label for one in asked.hypotheses]
    separations, most = [], []
    promised = promises[0].told
    gram = promised.grams.sum(axis=0)
    for a, b in pairs_of(asked.hypotheses):
        lead = promised.lead(gram, a, b)
        most.append(max(lead, 0.0 if known is None else _alone(known, pool, a, b)))
        separations.append(separation_of(labels[a], labels[b], lead, most[-1]))
    seconds = float(pool.edges_s(pool.count)[-1])
    learnt = [] if asked.hypotheses else asked.parameters
    return Plan(
        pneu_version=version(),
        rig=rig.name,
        kind=asked.kind or ("separate" if asked.hypotheses else "parameters"),
        seconds=seconds,
        seed=asked.seed,
        commands={name: thinned(series, STEP_S) for name, series in best.volts.items()},
        limits=_bounds(asked.limits),
        expected=expected_of(promises, asked.limits, separations, most, learnt, seconds),
    )


def promise_of(rig: Rig, asked: Asked, volts: Mapping[str, Floats]) -> Promise:
    """What commands are to be expected to tell of a rig that is as it is given.

    Args:
        rig: The rig.
        asked: Of what, and how it is read; its limits are not kept to.
        volts: Per command volts every ``STEP_S``.
    """
    model = _model(rig, asked)
    seen = model.foresee(volts)
    return Promise(seen, model.tells(seen, looks=LOOKS))


def _model(rig: Rig, asked: Asked) -> _Model:
    """The rig as it is foreseen."""
    # candidates are told apart with the rig that was diagnosed, numbers learnt with one for a fit
    begun = with_known_noise(rig if asked.hypotheses else as_fitted(rig))
    return _Model(begun, asked, lasting_share(rig), mirrors_of(rig))


def _others(model: _Model, pool: _Pool, count: int) -> list[_Model]:
    """Rigs as they may be, of those that can be run; none where candidates are told apart."""
    asked = model.asked
    if asked.hypotheses:
        return []
    volts = joined([pool.rest, *pool.pieces[: pool.count]], asked.limits)
    rng = np.random.default_rng([asked.seed, 59])
    out: list[_Model] = []
    for one in possible_rigs(model.rig, asked.parameters, model.mirrors, 2 * count, rng):
        other = replace(model, rig=one.rig, asked=replace(asked, parameters=one.parameters))
        try:
            other.foresee(volts)
        except InputError:
            continue  # one that cannot be run tells nothing
        out.append(other)
        if len(out) == count:
            break
    return out


def _drawn(model: _Model, rng: np.random.Generator, tell: Progress) -> _Pool:
    """Pieces that keep to the limits, and more."""
    rig, asked = model.rig, model.asked
    limits, seconds = asked.limits, asked.seconds - REST_S
    if asked.kind == "tracking":  # what corrects without end is no piece of something else
        count, piece_s = 1, round(seconds / STEP_S) * STEP_S
        pieces = track(rig, limits, piece_s, TRACKED, rng).pieces
    else:
        count = max(round(seconds / np.clip(seconds / PIECES, *PIECE_S)), 1)
        piece_s = round(seconds / count / STEP_S) * STEP_S
        kinds = [asked.kind] if asked.kind else list(KINDS)
        pieces = [draw_piece(rig, limits, piece_s, kinds[k % len(kinds)], rng) for k in range(POOL)]
    rest = shut(rig, limits, REST_S)
    volts = joined([rest, *pieces], limits)
    seen = model.foresee(volts, partial(tell, "running what may be played"))
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
    model: _Model,
    chosen_by: Sequence[_Model],
    pool: _Pool,
    known: Information | None,
    rng: np.random.Generator,
    tell: Progress,
) -> _Played:
    """The best of several plans; any that keeps to the limits where nothing is chosen.

    What a piece tells depends on what was before it, and begun elsewhere it goes elsewhere. So
    what pieces tell where they were drawn only says where to begin, and plans are judged whole.
    """
    limits = model.asked.limits
    count = pool.count
    begin: list[list[int]] = []
    if known is not None:
        worth = _worth(known, model.asked)
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
        volts = joined([pool.rest, *(pool.pieces[k] for k in chosen)], limits)
        seen = model.foresee(volts)
        if not seen.within(limits):
            continue
        if known is None:
            return _Played(chosen, volts, [])
        values = _values(model, chosen_by, volts, seen, best, turn)
        if values:
            best = _Played(chosen, volts, values)
    if best is None:
        raise InputError(_nothing_left(seen, limits, float(seen.air_kg[-1])))
    return best


def _values(
    model: _Model,
    chosen_by: Sequence[_Model],
    volts: Mapping[str, Floats],
    seen: Foreseen,
    best: _Played | None,
    turn: int,
) -> list[float]:
    """What a plan is worth by each rig; none where it is not better than the best so far.

    The first of them that says so is enough, each in its turn.
    """
    size = len(chosen_by)
    values = [0.0] * size
    ahead = 0.0
    for k in range(turn, turn + size):
        one = chosen_by[k % size]
        try:
            there = seen if one is model else one.foresee(volts)
        except InputError:
            return []  # it cannot be run, and what it tells is not known
        told = one.tells(there, looks=0 if one.asked.hypotheses else TRIED_LOOKS)
        values[k % size] = _worth(told, one.asked)(told.grams.sum(axis=0))
        if not there.within(model.asked.limits):
            values[k % size] -= LEAVES
        if best is not None:
            ahead += values[k % size] - best.values[k % size]
            if ahead <= 0.0:
                return []
    return values


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


def _worth(known: Information, asked: Asked) -> Worth:
    """What a sum of pieces is worth."""
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
