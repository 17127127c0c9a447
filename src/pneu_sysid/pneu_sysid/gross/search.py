# SPDX-License-Identifier: Apache-2.0
"""The search for gross errors: every guess is given an ordinary fit before it is compared."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.models import kind_of
from pneu_sim.rig.parameters import get_parameter
from pneu_sim.rig.schema import Rig
from pneu_sysid.gross.findings import GrossError
from pneu_sysid.gross.guesses import Guess, moved_taps, possible, resized, sizes, wirings
from pneu_sysid.gross.ordinary import NOISE_FLOOR, PULL_S, Bench, Settled, knobs_of, settle, turned
from pneu_sysid.gross.reservoirs import wrong_reservoirs
from pneu_sysid.problem import Problem, make_problem
from pneu_sysid.records import Recording

COARSER = 4.0
"""Cells on which errors are looked for are this much longer than the rig's."""
USED_S = 6.0
"""Of all recordings together so much does, where the commands move most."""
CLEAN = 0.1
"""Where the fitted datasheet leaves less of the spread at every tap, nothing else is looked for."""
FAR = 0.9
"""... unless it needed a change of so much of what an ordinary fit may."""
GAIN = 1.3
"""By how much the logarithms of the taps' errors must fall together before anybody is accused.

Of 32 ordinary datasheets none gained more than 0.94 (a spool whose speed is limited, which no
datasheet says); a wrong size gained 1.6 to 8, wrong wiring and places 3 to 11."""
ALIKE = 0.25
"""Explanations whose gains are no further apart are both told."""
DECADES = (1.0, -1.0)
FURTHER = (2.0, 3.0)
TRIED_S = 2.5
"""Guesses are first tried on so much."""
STEPS = 2
MORE_STEPS = 4
MOST = 2
"""Errors looked for one after the other, each with those before made good."""
BEST = 3
"""... and of those so many are given more."""
KEPT = {"size": 3, "wiring": 2, "tap": 2}
"""Guesses of each kind that are given Gauss-Newton steps; the others explain less as they stand."""


def refuse_gross_errors(
    rig: Rig, recordings: Sequence[Recording], workers: int | None = None
) -> None:
    """Refuses a rig with which no fit would mean anything.

    Args:
        rig: The rig as its file says.
        recordings: Its recordings.
        workers: Threads of a batch.

    Raises:
        InputError: Something in the rig is wrong beyond what a fit makes good.
    """
    if not kind_of(rig).along_lines:
        return
    problem = make_problem(
        rig, recordings, dx_m=COARSER * rig.grid.dx_m, pull_s=PULL_S, workers=workers
    )
    found = gross_errors(rig, problem)
    if found:
        raise InputError("; besides, ".join(error.sentence for error in found))


def gross_errors(rig: Rig, problem: Problem) -> list[GrossError]:
    """What in a rig file is wrong beyond what an ordinary fit makes good; mostly nothing.

    A rig whose ordinary errors are small after a fit of a few steps costs some 30 coarse runs; only
    where that leaves much are sizes, wiring and places changed one by one. Lumped models have
    neither places nor sizes and are not asked.

    Args:
        rig: The rig as its file says.
        problem: It and its recordings, on coarse cells.

    Returns:
        The errors, the worst first.
    """
    if not kind_of(rig).along_lines:
        return []
    recordings = [_liveliest(r, USED_S / len(problem.recordings)) for r in problem.recordings]
    errors, corrected = wrong_reservoirs(rig, problem)
    # one stretch, from the first readings on: no beginning is looked for
    corrected.fit = corrected.fit.model_copy(update={"horizon_s": None})
    base = Guess("none", "", "", corrected, recordings)
    for _ in range(MOST):
        nominal = settle(_begin(Bench(base.rig, base.recordings, problem), base), STEPS)
        if _fits(nominal):
            break
        nominal = settle(nominal, MORE_STEPS - STEPS)
        if _fits(nominal):
            break
        found = _accused(nominal, problem)
        if found is None:
            break
        error, base = found
        errors.append(error)
    return errors


def _liveliest(recording: Recording, seconds: float) -> Recording:
    """The part of a recording in which its commands move most."""
    first = recording.start_s
    begins = np.arange(first, max(recording.end_s - seconds, first) + 1e-9, 0.5 * seconds)

    def motion(begin: float) -> float:
        signals = [s.within(begin, begin + seconds) for s in recording.commands.values()]
        return sum(float(np.sum(np.abs(np.diff(s.values)))) for s in signals)

    begin = max(begins, key=motion)
    pressures, encoders = (
        {
            name: part
            for name, s in signals.items()
            if len(part := s.within(begin, begin + seconds)) > 1
        }
        for signals in (recording.pressures, recording.encoders)
    )
    return replace(recording, pressures=pressures, encoders=encoders)


def _begin(bench: Bench, guess: Guess) -> Settled:
    rig = guess.rig
    left = bench.left([rig])[0]
    return Settled(guess, bench, np.zeros(len(knobs_of(rig))), left, float(bench.score(left)))


def _fits(settled: Settled) -> bool:
    """Whether an ordinary fit explains a recording without changing a size by much."""
    bench = settled.bench
    share = np.sqrt(settled.mean_pa2 / (bench.spread_pa**2 + (NOISE_FLOOR * bench.noise_pa) ** 2))
    return bool((share < CLEAN).all() and not _bound(settled).any())


def _bound(settled: Settled) -> NDArray[np.bool_]:
    """(n_knobs,) which of them an ordinary fit would turn about as far as it may."""
    reach = np.array([knob.reach for knob in knobs_of(settled.guess.rig)])
    return np.asarray(np.abs(settled.x) > FAR * reach)


def _accused(nominal: Settled, like: Problem) -> tuple[GrossError, Guess] | None:
    """The guess that explains far more than the file does, if there is one."""
    base = nominal.guess
    # what explains least is told by a short part of the recordings
    parts = [_liveliest(r, TRIED_S / len(base.recordings)) for r in base.recordings]
    short = replace(base, recordings=parts)
    bench = Bench(short.rig, parts, like)
    start = float(bench.score(bench.left([base.rig])[0]))
    cases = [(what, paths, d) for what, paths in sizes(base.rig) for d in DECADES]
    costs = _tried([resized(short, *case) for case in possible(base.rig, cases)], bench, like)
    full = [resized(base, *case) for case in possible(base.rig, cases)]
    cases = [
        (guess.what, guess.paths, further * guess.decades)
        for guess, cost in zip(full, costs, strict=True)
        if cost < start
        for further in FURTHER
    ]
    full += [resized(base, *case) for case in possible(base.rig, cases)]
    costs += _tried([resized(short, *case) for case in possible(base.rig, cases)], bench, like)
    full += [*wirings(base), *moved_taps(base)]
    costs += _tried([*wirings(short), *moved_taps(short)], bench, like)
    # what an ordinary fit wants to turn further than it may is asked for in any case
    wanted = {
        (path, float(np.sign(x)))
        for knob, x, far in zip(knobs_of(base.rig), nominal.x, _bound(nominal), strict=True)
        for path in knob.paths
        if far
    }
    chosen = [
        g
        for g in full
        if len(g.paths) == 1 and abs(g.decades) == 1.0 and (g.paths[0], g.decades) in wanted
    ]
    for kind, most in KEPT.items():
        ranked = sorted((cost, k) for k, cost in enumerate(costs) if full[k].kind == kind)
        of_kind: dict[str, Guess] = {}
        for _, k in ranked:
            of_kind.setdefault(full[k].what, full[k])  # the best of each part
        chosen += [g for g in list(of_kind.values())[:most] if g not in chosen]
    begun = [
        _begin(Bench(g.rig, g.recordings, like) if g.own_grid else nominal.bench, g) for g in chosen
    ]
    settled = sorted((settle(t, 1) for t in begun), key=lambda t: t.cost)
    settled = [settle(t, STEPS) for t in settled[:BEST]]
    settled.sort(key=lambda t: t.cost)
    best = settled[0]
    if nominal.cost - best.cost < GAIN:
        return None
    words = best.guess.words or _size_words(best)
    others = {t.guess.what: t for t in settled[1:] if t.cost < best.cost + ALIKE}
    others.pop(best.guess.what, None)
    if others:
        words += f"; {' or '.join(others)} would explain nearly as much"
    sentence = (
        f"{best.guess.what}: {words} (errors fall from {nominal.times_noise:.3g} to"
        f" {best.times_noise:.3g} times the noise)"
    )
    error = GrossError(best.guess.what, sentence, nominal.times_noise, best.times_noise)
    return error, best.guess


def _tried(guesses: list[Guess], bench: Bench, like: Problem) -> list[float]:
    """Costs of guesses as they stand: those that share the structure in one batch."""
    shared = [g.rig for g in guesses if not g.own_grid]
    costs = iter(bench.score(bench.left(shared)) if shared else ())
    return [
        _begin(Bench(g.rig, g.recordings, like), g).cost if g.own_grid else float(next(costs))
        for g in guesses
    ]


def _size_words(settled: Settled) -> str:
    """What a size was, and what would fit."""
    guess = settled.guess
    rig = turned(guess.rig, knobs_of(guess.rig), settled.x)
    factor = 10.0**-guess.decades
    now = [get_parameter(rig, path) for path in guess.paths]
    was = [get_parameter(guess.rig, path) * factor for path in guess.paths]
    ratio = math.exp(float(np.mean(np.log(np.array(now) / np.array(was)))))
    change = f"{ratio:.2g} times as much" if ratio > 1.0 else f"{1.0 / ratio:.2g} times less"
    found = " and ".join(f"{v:.3g}" for v in was)
    fits = " and ".join(f"{v:.3g}" for v in now)
    return f"found {found}, but about {change} fits the recording (near {fits}); is its unit right?"
