# SPDX-License-Identifier: Apache-2.0
"""An experiment designed: pieces drawn, what each tells, the best chosen, and what they promise.

Parameters: D-optimal, the volume of what is possible of them is made small (Fedorov 1972).
Candidates: T-optimal, each stays as far as it can from what any other can make of it (Atkinson and
Fedorov 1975, Biometrika 62(1), 57), the nearest two counting.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.models import kind_of
from pneu_sim.rig.schema import FitParameter, Rig
from pneu_sysid.design.choose import choose
from pneu_sysid.design.foreseen import Foreseen, fastest_pa_s, foresee, with_known_noise
from pneu_sysid.design.limits import Limits
from pneu_sysid.design.plan import Bounds, Expected, Plan, Separation, thinned
from pneu_sysid.design.told import Hypothesis, Told, told_by
from pneu_sysid.design.waves import KINDS, STEP_S, Kind, draw_piece, joined
from pneu_sysid.problem import make_problem
from pneu_sysid.results import pneu_version
from pneu_sysid.thresholds import Thresholds

Floats = NDArray[np.float64]
Progress = Callable[[str, float], None]

POOL = 60
"""Pieces that are drawn to choose from."""
PIECES = 8
"""Of a plan, unless they would be shorter or longer than ..."""
PIECE_S = (0.8, 2.5)
"""... so many seconds: some horizons, few enough for a choice."""
LONGER_CELLS = 2.0
"""Changes of the prediction are taken on cells so many times as long."""
TRIES = 4
"""Ways of playing that are tried whole: the best pieces in some orders, without those that leave
the limits, and the best that follow one another as they were drawn."""
AMPLE = 4.0
"""A lead of so many times what is needed is worth no more if it grows."""
MUCH_LONGER = 25.0
"""Candidates that so many times the length would not tell apart are said to be alike."""
LITTLE = 0.8
"""A standard error above this share of what was known before: the recording tells little of it."""


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
    kind: Kind | None = None
    rate_hz: float = 500.0
    seed: int = 0
    workers: int | None = None


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
    model = with_known_noise(rig)
    rng = np.random.default_rng([asked.seed, 23])
    piece_s = float(np.clip(asked.seconds / PIECES, *PIECE_S))
    count = max(round(asked.seconds / piece_s), 1)
    piece_s = round(asked.seconds / count / STEP_S) * STEP_S
    kinds = [asked.kind] if asked.kind else list(KINDS)
    pool = [draw_piece(rig, asked.limits, piece_s, kinds[k % len(kinds)], rng) for k in range(POOL)]
    tell("running what may be played", 0.0)
    volts = joined(pool, asked.limits)
    seen = foresee(
        model, volts, asked.rate_hz, asked.workers,
        lambda f: tell("running what may be played", f),
    )  # fmt: skip
    edges: Floats = np.arange(POOL + 1, dtype=np.float64) * piece_s
    spent = [seen.taken_kg(*edges[k : k + 2]) for k in range(POOL)]
    allowed = [
        k
        for k in range(POOL)
        if seen.keeps(asked.limits, *edges[k : k + 2]) and spent[k] * count <= asked.limits.air_kg
    ]
    if not allowed:
        raise InputError(_nothing_left(seen, asked.limits, min(spent) * count))
    told = None
    if asked.kind is None:
        told = _told(model, seen, asked, edges, "what each piece tells", tell)
        worth = _worth(told, asked, allowed, count)
        tell("choosing", 0.0)
    best: tuple[float, dict[str, Floats], Foreseen, Told] | None = None
    final, ends = seen, np.arange(count + 1, dtype=np.float64) * piece_s
    for turn in range(TRIES):
        # what a piece tells depends on what was before it: several ways of playing are tried whole
        if told is None:
            chosen = [int(k) for k in rng.choice(allowed, count)]
        elif turn == TRIES - 1 and (window := _window(told, allowed, count, worth)):
            chosen = window
        else:
            chosen = choose(told.of_pieces, count, allowed, worth)
            chosen = [chosen[k] for k in rng.permutation(count)]
        volts = joined([pool[k] for k in chosen], asked.limits)
        final = foresee(model, volts, asked.rate_hz, asked.workers)
        bad = {chosen[k] for k in range(count) if not final.keeps(asked.limits, *ends[k : k + 2])}
        if bad or final.air_kg[-1] > asked.limits.air_kg:
            # begun elsewhere they go elsewhere
            allowed = [k for k in allowed if k not in bad] or allowed
            continue
        stage = "what the plan tells"
        promised = _told(model, final, asked, np.array([0.0, ends[-1]]), stage, tell)
        value = worth(promised.of_pieces.sum(axis=0)) if told is not None else 0.0
        if best is None or value > best[0]:
            best = value, volts, final, promised
        if told is None:
            break
    if best is None:
        raise InputError(_nothing_left(final, asked.limits, float(final.air_kg[-1])))
    _, volts, final, promised = best
    return Plan(
        pneu_version=pneu_version(),
        rig=rig.name,
        kind=asked.kind or ("separate" if asked.hypotheses else "parameters"),
        seconds=float(ends[-1]),
        seed=asked.seed,
        commands={name: thinned(series, STEP_S) for name, series in volts.items()},
        limits=Bounds(
            low_v=dict(asked.limits.low_v),
            high_v=dict(asked.limits.high_v),
            slew_v_s=asked.limits.slew_v_s,
            highest_pa=asked.limits.highest_pa,
            lowest_pa=asked.limits.lowest_pa,
            joints={name: list(of) for name, of in asked.limits.joints.items()},
            air_kg=asked.limits.air_kg,
        ),
        expected=_expected(final, promised, told, asked, allowed, count),
    )


def _told(
    model: Rig, seen: Foreseen, asked: Asked, edges: Floats, stage: str, tell: Progress
) -> Told:
    problem = make_problem(model, seen.recording, workers=asked.workers)
    if kind_of(model).along_lines:
        problem = problem.coarsened(model, LONGER_CELLS)
    return told_by(
        problem, model, asked.hypotheses, asked.parameters, edges, lambda f: tell(stage, f)
    )


def _worth(
    told: Told, asked: Asked, allowed: Sequence[int], count: int
) -> Callable[[Floats], float]:
    if not asked.hypotheses:
        return told.information
    pairs, needed = _pairs(asked), Thresholds().tied
    # two that nothing parts must not keep the others from being parted
    parted = [
        (a, b)
        for a, b in pairs
        if _best(told, a, b, allowed, count) * math.sqrt(MUCH_LONGER) >= needed
    ]

    def nearest(gram: Floats) -> float:
        leads = [min(told.lead(gram, a, b), AMPLE * needed) for a, b in parted or pairs]
        return min(leads) + 1e-2 * float(np.mean(leads))

    return nearest


def _window(
    told: Told, allowed: Sequence[int], count: int, worth: Callable[[Floats], float]
) -> list[int]:
    """The best pieces that follow one another in the pool; empty where limits leave none."""
    runs = [
        list(range(k, k + count))
        for k in range(len(told.of_pieces) - count + 1)
        if set(range(k, k + count)) <= set(allowed)
    ]
    return max(runs, key=lambda run: worth(told.of_pieces[run].sum(axis=0)), default=[])


def _best(told: Told, a: int, b: int, allowed: Sequence[int], count: int) -> float:
    """Lead of two by the piece that parts them best, played over and over.

    Leads grow with the root of time.
    """
    return math.sqrt(count) * max(told.lead(told.of_pieces[k], a, b) for k in allowed)


def _pairs(asked: Asked) -> list[tuple[int, int]]:
    n = len(asked.hypotheses)
    return [(a, b) for a in range(n) for b in range(a + 1, n)]


def _expected(
    seen: Foreseen,
    promised: Told,
    pool: Told | None,
    asked: Asked,
    allowed: Sequence[int],
    count: int,
) -> Expected:
    gram = promised.of_pieces.sum(axis=0)
    needed = Thresholds().tied
    separations, words = [], []
    for a, b in _pairs(asked):
        lead = promised.lead(gram, a, b)
        one, other = asked.hypotheses[a].label, asked.hypotheses[b].label
        best = lead
        if pool is not None:
            best = max(best, _best(pool, a, b, allowed, count))
        separations.append(
            Separation(
                one=one, other=other, standard_errors=lead, needed=needed,
                told_apart=lead >= needed,
                inseparable=best * math.sqrt(MUCH_LONGER) < needed,
            )
        )  # fmt: skip
        if lead < needed:
            words.append(_short(separations[-1], best, asked.seconds))
    errors: dict[str, float | None] = {}
    if not asked.hypotheses:
        share = np.sqrt(np.diag(promised.covariance(gram)))
        for v, part, std in zip(promised.variables, share, promised.known_std, strict=True):
            scale = math.exp(v.value) if _is_log(asked, v.name) else 1.0
            errors[v.name] = float(part * std * scale)
        little = [v.name for v, s in zip(promised.variables, share, strict=True) if s > LITTLE]
        if little:
            words.append(
                f"It tells little of {', '.join(little)}: what was known of"
                f" {'them' if len(little) > 1 else 'it'} before stays nearly as it was."
            )
    room = [seen.recording.pressures[name] for name in seen.recording.pressures]
    names = list(seen.recording.pressures)
    return Expected(
        highest_pa={n: float(s.values.max()) for n, s in zip(names, room, strict=True)},
        lowest_pa={n: float(s.values.min()) for n, s in zip(names, room, strict=True)},
        fastest_pa_s=dict(fastest_pa_s(seen.recording)),
        joints={n: [float(q.min()), float(q.max())] for n, q in seen.joints.items()},
        air_kg=float(seen.air_kg[-1]),
        std_errors=errors,
        separations=separations,
        words=words,
    )


def _is_log(asked: Asked, path: str) -> bool:
    return any(p.path == path and p.log for p in asked.parameters)


def _short(of: Separation, lead: float, seconds: float) -> str:
    """What is said of two that are not expected to be told apart; lead is the best there is."""
    one, other, needed = of.one, of.other, of.needed
    if of.inseparable:
        return (
            f"No experiment within these limits can tell {one} from {other}: what either changes"
            f" the other does too, but for {lead:.2g} standard errors of the {needed:g} that are"
            f" needed, and {MUCH_LONGER:g} times the length would not tell them."
        )
    if lead >= needed:
        return (
            f"This plan tells {one} from {other} by {of.standard_errors or 0.0:.2g} standard errors"
            f" of the {needed:g} that are needed; one for these two alone, by {lead:.2g}."
        )
    longer = seconds * (needed / lead) ** 2
    return (
        f"{seconds:g} s cannot tell {one} from {other}: {lead:.2g} standard errors are to be"
        f" expected of the {needed:g} that are needed; about {1.2 * longer:.0f} s could."
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
