# SPDX-License-Identifier: Apache-2.0
"""Gross errors of a rig file, told by a recording: sizes, wiring and places that a fit hides.

A datasheet is off by tens of percent everywhere, and leaves many times the noise before a fit. So
no two models are compared as they stand: each is first given what an ordinary fit would change
(flows, opening curves, spools, volumes and supplies within their usual uncertainty, by a few
Gauss-Newton steps on coarse cells), and what it leaves then is compared.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_sim.errors import InputError
from pneu_sim.rig.parameters import get_parameter, with_parameters
from pneu_sim.rig.plausible import RANGES
from pneu_sim.rig.schema import CLOSED, Rig
from pneu_sim.signals import Signal
from pneu_sysid.problem import Problem, make_problem
from pneu_sysid.records import Recording
from pneu_sysid.volumes import volume_of_tap, volumes_of

Floats = NDArray[np.float64]

COARSER = 4.0
"""Cells on which errors are looked for are this much longer than the rig's."""
PULL_S = 0.3
"""Long enough for a wrong part to show, short enough for two Gauss-Newton steps to converge."""
LEAD_S = 0.4
"""How a recording begins is not looked for: what follows of it is forgotten after a pull."""
USED_S = 6.0
"""Of all recordings together so much does, where the commands move most."""
STEP = 0.02
DAMPINGS = (1e-3, 1e-1, 1e1)
PRIOR = 0.05
"""Weight of a knob's prior, in the logarithm of the error: three sigmas cost a fifth."""
NOISE_FLOOR = 3.0
SPREAD_FLOOR = 0.02
"""Errors below three times the noise, or 2 % of how far the pressures spread, are not gross."""
LOST = 10.0
"""What cannot be simulated counts as so many times the spread."""
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
DELAY_S = 2e-3
"""Limits of a spool's speed and delays that no datasheet has, one sigma."""
NEAR_M = 0.3
"""A tap of a chamber is not told from one so near on a pipe to it."""
SHORTEST_M = 0.05
"""No pipe is tried that is shorter: its cells would need very many steps."""
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
GAUGE = (0.75, 1.25)
"""A reservoir given above the room's pressure is off by this much of it."""
RESERVOIR = 0.15
"""A reservoir further from what its taps read is not meant; the fit's own range is 10 %."""

STEADY = 0.25
"""A tap in a reservoir's own pipe moves by no more of its reading."""


@dataclass(frozen=True)
class GrossError:
    """Something in a rig file that no fit makes good.

    Attributes:
        what: Path of the part that is wrong.
        sentence: What was found, and what would fit.
        error_before: What the datasheet leaves after an ordinary fit, in times the noise.
        error_after: What the corrected one leaves.
    """

    what: str
    sentence: str
    error_before: float
    error_after: float


@dataclass(frozen=True, eq=False)
class _Guess:
    """One way in which the file may be wrong: the rig and the recordings as they would be then."""

    kind: str
    what: str
    words: str
    rig: Rig
    recordings: list[Recording]
    own_grid: bool = True
    paths: tuple[str, ...] = ()
    decades: float = 0.0


@dataclass(frozen=True)
class _Knob:
    """What an ordinary fit may change: by its standard deviation, and at most by its reach.

    Its paths are scaled by the exponential of how far it is turned.
    """

    paths: tuple[str, ...]
    std: float
    reach: float
    curve_of: str = ""
    delay_of: str = ""

    def bend(self, rig: Rig, x: float) -> None:
        """Bends a valve's opening curves by the exponent x, or delays it; the rig is changed."""
        if self.delay_of:
            rig.valves[self.delay_of].spool.delay_s += DELAY_S * max(x, 0.0)
        if not self.curve_of:
            return
        valve = rig.valves[self.curve_of]
        for port in valve.ports.values():
            curve = port.opening
            if curve.mirror is None:
                away = np.abs(np.array(curve.voltage_v) - valve.spool.null_v)
                share = np.maximum(away / away.max(), 1e-3)
                curve.fraction = [float(v) for v in np.array(curve.fraction) * share**x]


@dataclass
class _Settled:
    """A guess after some Gauss-Newton steps."""

    guess: _Guess
    bench: "_Bench"
    x: Floats
    left: Floats
    cost: float
    done: bool = False

    @property
    def mean_pa2(self) -> Floats:
        """(n_taps,) mean square of what is left, Pa^2."""
        return self.bench.mean(self.left)

    @property
    def times_noise(self) -> float:
        """What is left of all taps, in times the noise."""
        return float(np.sqrt(np.mean(self.mean_pa2 / self.bench.noise_pa**2)))


def _knobs(rig: Rig) -> list[_Knob]:
    """What an ordinary fit would change most, with the uncertainty that datasheets have."""
    out = []
    for v, valve in rig.valves.items():
        for p, port in valve.ports.items():
            size = "conductance_m3_s_pa" if port.model == "iso6358" else "area_m2"
            out.append(_Knob((f"valves.{v}.ports.{p}.{size}",), 0.3, 0.7))
        out.append(_Knob((), 0.3, 0.8, curve_of=v))
        out.append(_Knob((), 1.0, 3.0, delay_of=v))
        if valve.spool.bandwidth_hz is not None:
            out.append(_Knob((f"valves.{v}.spool.bandwidth_hz",), 0.3, 1.1))
    out += [_Knob((f"orifices.{o}.conductance_m3_s_pa",), 0.3, 0.7) for o in rig.orifices]
    out += [_Knob((f"chambers.{c}.volume_m3",), 0.2, 0.6) for c in rig.chambers]
    for name, reservoir in rig.reservoirs.items():
        if reservoir.pressure_pa > 1.05 * rig.ambient.pressure_pa:
            out.append(_Knob((f"reservoirs.{name}.pressure_pa",), 0.03, 0.1))
    return out


class _Bench:
    """Recordings and a structure, and what rigs of that structure leave there."""

    def __init__(self, rig: Rig, recordings: list[Recording], like: Problem) -> None:
        self.rig = rig.model_copy(deep=True)
        for t, name in enumerate(like.taps):
            self.rig.taps[name] = self.rig.taps[name].model_copy(
                update={"noise_pa": float(like.noise_pa[t]), "quantum_pa": 0.0}
            )
        self.problem = make_problem(self.rig, recordings, PULL_S, like.dx_m, like.workers)
        self.noise_pa = self.problem.noise_pa
        measured, time = self.problem.measured, self.problem.time_s
        first = np.nanmin(time, axis=(1, 2), keepdims=True)
        self.seen = np.isfinite(measured) & (time > first + LEAD_S)
        self.count = np.maximum(self.seen.sum(axis=(0, 1)), 1)
        values = np.where(self.seen, measured, 0.0)
        mean = values.sum(axis=(0, 1)) / self.count
        spread = np.sqrt(np.sum(np.where(self.seen, values - mean, 0.0) ** 2, axis=(0, 1)))
        spread /= np.sqrt(self.count)
        # (a supply hardly moves: what is a small part of all motion is not looked at more closely)
        self.spread_pa = np.maximum(spread, 0.3 * spread.max())
        self.floor_pa = np.hypot(NOISE_FLOOR * self.noise_pa, SPREAD_FLOOR * self.spread_pa)

    def left(self, rigs: Sequence[Rig]) -> Floats:
        """(n_rigs, n_stretches, horizon, n_taps) measured minus predicted, Pa."""
        y = self.problem.simulate(rigs, strict=False).readings
        left = np.where(self.seen, self.problem.measured - y, 0.0)
        wild = LOST * self.spread_pa
        return np.where(np.abs(left) < wild, left, wild) * self.seen

    def mean(self, left: Floats) -> Floats:
        """(..., n_taps) mean squares, Pa^2."""
        return np.asarray(np.sum(left * left, axis=(-3, -2)) / self.count)

    def score(self, left: Floats) -> Floats:
        """Sum of the logarithms of the taps' errors."""
        return np.asarray(0.5 * np.sum(np.log(self.mean(left) + self.floor_pa**2), axis=-1))


def _turned(rig: Rig, knobs: list[_Knob], x: Floats) -> Rig:
    scaled = {
        path: get_parameter(rig, path) * math.exp(value)
        for knob, value in zip(knobs, x, strict=True)
        for path in knob.paths
    }
    out = with_parameters(rig, scaled)
    for knob, value in zip(knobs, x, strict=True):
        knob.bend(out, float(value))
    return out


def _settle(at: _Settled, steps: int) -> _Settled:
    """Gives a guess some damped Gauss-Newton steps of what an ordinary fit would change."""
    bench, rig = at.bench, at.guess.rig
    knobs = _knobs(rig)
    std, reach = np.array([k.std for k in knobs]), np.array([k.reach for k in knobs])
    x, r, cost, done = at.x, at.left, at.cost, at.done
    for _ in range(steps):
        if done or not knobs:
            break
        points = [x + STEP * e for e in np.eye(len(knobs))]
        change = (bench.left([_turned(rig, knobs, p) for p in points]) - r) / STEP
        weight = 1.0 / np.sqrt((bench.mean(r) + bench.floor_pa**2) * bench.count)
        a = (change * weight).reshape(len(knobs), -1)
        hessian = a @ a.T + np.diag(PRIOR / std**2)
        gradient = a @ (r * weight).ravel() + PRIOR * x / std**2
        trials = [
            _bounded(hessian + d * np.diag(np.diag(hessian)), gradient, x, reach) for d in DAMPINGS
        ]
        found = bench.left([_turned(rig, knobs, y) for y in trials])
        costs = bench.score(found) + 0.5 * PRIOR * np.sum((np.array(trials) / std) ** 2, axis=1)
        k = int(np.argmin(costs))
        done = not float(costs[k]) < cost - 0.01
        if costs[k] < cost:
            x, r, cost = trials[k], found[k], float(costs[k])
    return replace(at, x=x, left=r, cost=cost, done=done)


def _bounded(hessian: Floats, gradient: Floats, x: Floats, reach: Floats) -> Floats:
    """Where a Newton step leads within bounds, what meets one being held there."""
    step = np.zeros(x.size)
    free = np.ones(x.size, dtype=bool)
    while free.any():
        rest = gradient + hessian[:, ~free] @ step[~free]
        step[free] = -np.linalg.solve(hessian[np.ix_(free, free)], rest[free])
        beyond = free & (np.abs(x + step) > reach)
        if not beyond.any():
            break
        step[beyond] = np.clip(x + step, -reach, reach)[beyond] - x[beyond]
        free &= ~beyond
    return np.asarray(np.clip(x + step, -reach, reach))


def _sizes(rig: Rig) -> list[tuple[str, tuple[str, ...]]]:
    """What may be given in another unit: its name, and the paths that share it."""
    out: list[tuple[str, tuple[str, ...]]] = []
    for v, valve in rig.valves.items():
        paths = tuple(
            f"valves.{v}.ports.{p}."
            + ("conductance_m3_s_pa" if port.model == "iso6358" else "area_m2")
            for p, port in valve.ports.items()
        )
        if len(paths) > 1:
            out.append((f"valves.{v}.ports", paths))
        out += [(path, (path,)) for path in paths]
        if valve.spool.bandwidth_hz is not None:
            path = f"valves.{v}.spool.bandwidth_hz"
            out.append((path, (path,)))
    singles = [f"orifices.{o}.conductance_m3_s_pa" for o in rig.orifices]
    singles += [f"chambers.{c}.volume_m3" for c in rig.chambers]
    for p in rig.pipes:
        singles += [f"pipes.{p}.area_m2", f"pipes.{p}.length_m"]
    return out + [(path, (path,)) for path in singles]


def _possible(
    rig: Rig, cases: list[tuple[str, tuple[str, ...], float]]
) -> list[tuple[str, tuple[str, ...], float]]:
    """Sizes so changed that are worth a run: very short pipes need very many steps."""
    out = []
    for what, paths, decades in cases:
        known = RANGES[paths[0].rpartition(".")[2]]
        value = get_parameter(rig, paths[0]) * 10.0**decades
        least = max(known.low, SHORTEST_M) if paths[0].endswith("length_m") else known.low
        if least <= value <= known.high:
            out.append((what, paths, decades))
    return out


def _resized(base: _Guess, what: str, paths: tuple[str, ...], decades: float) -> _Guess:
    rig = with_parameters(
        base.rig, {path: get_parameter(base.rig, path) * 10.0**decades for path in paths}
    )
    length = paths[0].endswith("length_m")
    if length:
        pipe = paths[0].split(".")[1]
        for name, tap in rig.taps.items():
            if tap.pipe == pipe:
                position = min(tap.position_m, rig.pipes[pipe].length_m)
                rig.taps[name] = tap.model_copy(update={"position_m": position})
    return _Guess("size", what, "", rig, base.recordings, length, paths, decades)


def _wirings(base: _Guess) -> list[_Guess]:
    """Valves with their ends exchanged, and pairs of valves with each other's commands."""
    rig, out = base.rig, []

    def commanded(what: str, words: str, change: Callable[[Recording], dict[str, Signal]]) -> None:
        recordings = [replace(r, commands={**r.commands, **change(r)}) for r in base.recordings]
        out.append(_Guess("wiring", what, words, rig, recordings))

    for v, valve in rig.valves.items():
        name, null = valve.command, valve.spool.null_v

        def mirrored(r: Recording, name: str = name, null: float = null) -> dict[str, Signal]:
            signal = r.commands[name]
            return {name: Signal(signal.time_s, 2.0 * null - signal.values)}

        commanded(
            f"valves.{v}",
            f"the pressures rise where they should fall; either its ports"
            f" ({', '.join(valve.ports)}) are exchanged, or its command {name!r} is mirrored about"
            f" {null:g} V",
            mirrored,
        )
    for (v, one), (w, two) in combinations(rig.valves.items(), 2):
        a, b = one.command, two.command
        if a == b:
            continue

        def exchanged(r: Recording, a: str = a, b: str = b) -> dict[str, Signal]:
            return {a: r.commands[b], b: r.commands[a]}

        commanded(
            f"valves.{v}.command",
            f"the valves {v!r} and {w!r} follow each other's commands: {a!r} and {b!r} seem to be"
            " exchanged, in the file or in their channels",
            exchanged,
        )
    return out


def _places(rig: Rig) -> dict[str, dict[str, Any]]:
    """Where else a tap may sit: chambers, and the ends of pipes, one of each node."""
    out: dict[str, dict[str, Any]] = {
        f"chamber {name!r}": {"chamber": name, "pipe": None, "position_m": 0.0}
        for name in rig.chambers
    }
    nodes = set(rig.chambers)
    for name, pipe in rig.pipes.items():
        for node, x in ((pipe.from_node, 0.0), (pipe.to_node, pipe.length_m)):
            if node in nodes:
                continue
            if node != CLOSED:
                nodes.add(node)
            side = "from" if x == 0.0 else "to"
            place = {"pipe": name, "position_m": x, "chamber": None}
            out[f"the {side!r} end of pipe {name!r}"] = place
    return out


def _moved_taps(base: _Guess) -> list[_Guess]:
    """Pairs of taps in each other's places, and taps in places of other volumes and pipes."""
    rig, out = base.rig, []

    def placed(places: dict[str, dict[str, Any]]) -> Rig:
        taps = {name: tap.model_copy(update=places.get(name, {})) for name, tap in rig.taps.items()}
        return rig.model_copy(update={"taps": taps})

    own = {
        name: {"pipe": t.pipe, "position_m": t.position_m, "chamber": t.chamber}
        for name, t in rig.taps.items()
    }
    for a, b in combinations(rig.taps, 2):
        words = (
            f"the readings of {a!r} and {b!r} fit each other's places; their channels, or their"
            " places in the file, seem to be exchanged"
        )
        out.append(
            _Guess("tap", f"taps.{a}", words, placed({a: own[b], b: own[a]}), base.recordings)
        )
    for name, tap in rig.taps.items():
        for words, place in _places(rig).items():
            if place["pipe"] is not None and place["pipe"] == tap.pipe:
                apart = abs(place["position_m"] - tap.position_m)
                if apart < 0.5 * rig.pipes[place["pipe"]].length_m:
                    continue
            if place["chamber"] is not None and place["chamber"] == tap.chamber:
                continue
            if tap.chamber is not None and place["pipe"] is not None:
                pipe = rig.pipes[place["pipe"]]
                if tap.chamber in (pipe.from_node, pipe.to_node) and pipe.length_m < NEAR_M:
                    continue
            where = f"pipe {tap.pipe!r}" if tap.pipe is not None else f"chamber {tap.chamber!r}"
            text = f"its readings are not those of {where}, but fit {words}"
            out.append(_Guess("tap", f"taps.{name}", text, placed({name: place}), base.recordings))
    return out


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
    if rig.model != "pde":
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
    if rig.model != "pde":
        return []
    recordings = [_liveliest(r, USED_S / len(problem.recordings)) for r in problem.recordings]
    errors, corrected = _reservoirs(rig, problem)
    # one stretch, from the first readings on: no beginning is looked for
    corrected.fit = corrected.fit.model_copy(update={"horizon_s": None})
    base = _Guess("none", "", "", corrected, recordings)
    for _ in range(MOST):
        nominal = _settle(_begin(_Bench(base.rig, base.recordings, problem), base), STEPS)
        if _fits(nominal):
            break
        nominal = _settle(nominal, MORE_STEPS - STEPS)
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
    first = min(float(s.time_s[0]) for s in recording.pressures.values() if len(s))
    begins = np.arange(first, max(recording.end_s - seconds, first) + 1e-9, 0.5 * seconds)

    def motion(begin: float) -> float:
        signals = [s.within(begin, begin + seconds) for s in recording.commands.values()]
        return sum(float(np.sum(np.abs(np.diff(s.values)))) for s in signals)

    begin = max(begins, key=motion)
    pressures = {
        name: part
        for name, s in recording.pressures.items()
        if len(part := s.within(begin, begin + seconds)) > 1
    }
    return replace(recording, pressures=pressures)


def _begin(bench: _Bench, guess: _Guess) -> _Settled:
    rig = guess.rig
    left = bench.left([rig])[0]
    return _Settled(guess, bench, np.zeros(len(_knobs(rig))), left, float(bench.score(left)))


def _fits(settled: _Settled) -> bool:
    """Whether an ordinary fit explains a recording without changing a size by much."""
    bench = settled.bench
    share = np.sqrt(settled.mean_pa2 / (bench.spread_pa**2 + (NOISE_FLOOR * bench.noise_pa) ** 2))
    return bool((share < CLEAN).all() and not _bound(settled).any())


def _bound(settled: _Settled) -> NDArray[np.bool_]:
    """(n_knobs,) which of them an ordinary fit would turn about as far as it may."""
    reach = np.array([knob.reach for knob in _knobs(settled.guess.rig)])
    return np.asarray(np.abs(settled.x) > FAR * reach)


def _accused(nominal: _Settled, like: Problem) -> tuple[GrossError, _Guess] | None:
    """The guess that explains far more than the file does, if there is one."""
    base = nominal.guess
    # what explains least is told by a short part of the recordings
    parts = [_liveliest(r, TRIED_S / len(base.recordings)) for r in base.recordings]
    short = replace(base, recordings=parts)
    bench = _Bench(short.rig, parts, like)
    start = float(bench.score(bench.left([base.rig])[0]))
    cases = [(what, paths, d) for what, paths in _sizes(base.rig) for d in DECADES]
    costs = _tried([_resized(short, *case) for case in _possible(base.rig, cases)], bench, like)
    full = [_resized(base, *case) for case in _possible(base.rig, cases)]
    cases = [
        (guess.what, guess.paths, further * guess.decades)
        for guess, cost in zip(full, costs, strict=True)
        if cost < start
        for further in FURTHER
    ]
    full += [_resized(base, *case) for case in _possible(base.rig, cases)]
    costs += _tried([_resized(short, *case) for case in _possible(base.rig, cases)], bench, like)
    full += [*_wirings(base), *_moved_taps(base)]
    costs += _tried([*_wirings(short), *_moved_taps(short)], bench, like)
    # what an ordinary fit wants to turn further than it may is asked for in any case
    wanted = {
        (path, float(np.sign(x)))
        for knob, x, far in zip(_knobs(base.rig), nominal.x, _bound(nominal), strict=True)
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
        of_kind: dict[str, _Guess] = {}
        for _, k in ranked:
            of_kind.setdefault(full[k].what, full[k])  # the best of each part
        chosen += [g for g in list(of_kind.values())[:most] if g not in chosen]
    begun = [
        _begin(_Bench(g.rig, g.recordings, like) if g.own_grid else nominal.bench, g)
        for g in chosen
    ]
    settled = sorted((_settle(t, 1) for t in begun), key=lambda t: t.cost)
    settled = [_settle(t, STEPS) for t in settled[:BEST]]
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


def _tried(guesses: list[_Guess], bench: _Bench, like: Problem) -> list[float]:
    """Costs of guesses as they stand: those that share the structure in one batch."""
    shared = [g.rig for g in guesses if not g.own_grid]
    costs = iter(bench.score(bench.left(shared)) if shared else ())
    return [
        _begin(_Bench(g.rig, g.recordings, like), g).cost if g.own_grid else float(next(costs))
        for g in guesses
    ]


def _size_words(settled: _Settled) -> str:
    """What a size was, and what would fit."""
    guess = settled.guess
    rig = _turned(guess.rig, _knobs(guess.rig), settled.x)
    factor = 10.0**-guess.decades
    now = [get_parameter(rig, path) for path in guess.paths]
    was = [get_parameter(guess.rig, path) * factor for path in guess.paths]
    ratio = math.exp(float(np.mean(np.log(np.array(now) / np.array(was)))))
    change = f"{ratio:.2g} times as much" if ratio > 1.0 else f"{1.0 / ratio:.2g} times less"
    found = " and ".join(f"{v:.3g}" for v in was)
    fits = " and ".join(f"{v:.3g}" for v in now)
    return f"found {found}, but about {change} fits the recording (near {fits}); is its unit right?"


def _reservoirs(rig: Rig, problem: Problem) -> tuple[list[GrossError], Rig]:
    """Reservoirs whose pressure is not what the taps of their own volume read at rest."""
    volume, _ = volumes_of(rig)
    room = rig.ambient.pressure_pa
    errors, out = [], rig.model_copy(deep=True)
    for name, reservoir in rig.reservoirs.items():
        fed = {
            volume[f"pipe:{p}"]
            for p, pipe in rig.pipes.items()
            if name in (pipe.from_node, pipe.to_node)
        }
        others = {
            volume[f"pipe:{p}"]
            for p, pipe in rig.pipes.items()
            for node in (pipe.from_node, pipe.to_node)
            if node in rig.reservoirs and node != name
        }
        levels = {}
        for tap in problem.taps:
            if volume_of_tap(volume, rig.taps[tap]) not in fed - others:
                continue
            values = np.concatenate([r.pressures[tap].values for r in problem.recordings])
            # friction and sag only take away from a supply, and add to a sink
            level = float(np.median(_resting(values)))
            low, high = np.quantile(values, (0.05, 0.95))
            # what moves more is no volume with a reservoir at its end: the tap is elsewhere
            if high - low < STEADY * level:
                levels[tap] = level
        if not levels:
            continue
        tap, level = max(levels.items(), key=lambda item: item[1])
        file = reservoir.pressure_pa
        apart = level - file
        gauge = GAUGE[0] * room < apart < GAUGE[1] * room
        if not gauge and abs(apart) < RESERVOIR * file:
            continue
        what = f"reservoirs.{name}.pressure_pa"
        meant = (
            f"it seems to be given above the room's pressure instead of absolute; {file + room:.4g}"
            " would fit"
            if gauge
            else f"about {level:.4g} would fit"
        )
        noise = float(problem.noise_pa[problem.taps.index(tap)])
        sentence = f"{what}: found {file:.4g}, where tap {tap!r} reads {level:.4g} at rest; {meant}"
        errors.append(GrossError(what, sentence, abs(apart) / noise, 1.0))
        out.reservoirs[name] = reservoir.model_copy(update={"pressure_pa": level})
    return errors, out


def _resting(values: Floats) -> Floats:
    """The quietest quarter of a signal, by how much it moves within some readings."""
    window = 8
    if values.size < 4 * window:
        return values
    blocks = values[: values.size // window * window].reshape(-1, window)
    span = np.ptp(blocks, axis=1)
    return np.asarray(blocks[span <= np.quantile(span, 0.25)].ravel())
