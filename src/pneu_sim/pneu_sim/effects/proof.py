# SPDX-License-Identifier: Apache-2.0
"""What holds for every effect, measured on a rig: no effect is trusted to be what it says it is.

Each check is a number that says how far the effect is from what is required, and the most that is
allowed. They need nothing but the effect and a rig that has a place for it, so they hold one from a
user's file to the same as those of the catalogue. An effect may say more: experiments whose outcome
a closed form, or a model of its own, foretells (`Effect.comparisons`).
"""

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.effects.base import POSITION, Comparison, Effect
from pneu_sim.effects.registry import apply_to_rig, registry
from pneu_sim.models import kind_of
from pneu_sim.rig import kinds
from pneu_sim.rig.build import build
from pneu_sim.rig.model import Model
from pneu_sim.rig.plan import Plan, plan_grid
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sim.signals import Signal
from pneu_sim.simulate import Course, InitialField, rest
from pneu_sim.simulator import Simulator
from pneu_sim.valve import voltage_limits

Floats = NDArray[np.float64]

ROUND_OFF = 1e-8
"""Two ways to compute one number differ by less than this share of it."""
SLOPE = 0.05
"""Half a difference step has half the effect to within this, unless the effect is curved."""
FINITE = 4.0
"""A curved effect may grow over half a step by so much more than half of what a step does."""
GRID = 0.1
"""An effect changes by less than this share of itself where cells, or steps, are half as long: on
cells of 50 mm the least accurate, a change of temperature that is carried along, by 0.07."""
TURNED = 1e-4
"""And by less than this where its pipe is written from the other end: what is found by iteration,
to 1e-9 of a pressure, is found from the other side, and an effect is a small part of a pressure."""
KEPT = 1e-9
"""Share of its mass or energy that a closed rig may lose or gain."""
TWIN = 1e-6
"""What two effects change differs by less than this share of it where they are one by two names."""
SAMPLE_S = 0.002
SPACING_M = 0.5
"""Distance of the places along a pipe at which an effect is looked for."""

CLOSED = Rig.model_validate(
    {
        "name": "closed",
        "grid": {"dx_m": 0.05},
        "chambers": {"full": {"volume_m3": 2e-5}, "empty": {"volume_m3": 3e-5}},
        "pipes": {
            name: {
                "from": begin,
                "to": end,
                "length_m": length_m,
                "area_m2": 6e-6,
                "wall": {"nusselt": 0.0, "heat_turbulent": 0.0, "heat_unsteady": 0.0},
            }
            for name, begin, end, length_m in (
                ("one", "full", "tee", 0.6),
                ("two", "tee", "empty", 0.8),
                ("blind", "tee", "closed", 0.3),
            )
        },
        "taps": {"full": {"chamber": "full"}, "middle": {"pipe": "two", "position_m": 0.4}},
    }
)
"""A full bottle and an empty one, and lines between whose walls take no heat."""


@dataclass(frozen=True)
class Finding:
    """How far an effect is from one of the things required of it.

    Attributes:
        check: What is required, in a few words.
        deviation: How far it is from it.
        allowed: The most that is allowed.
        about: What was compared, and where it is furthest off.
    """

    check: str
    deviation: float
    allowed: float
    about: str = ""

    @property
    def holds(self) -> bool:
        """Whether the deviation is allowed; one that is not a number is not."""
        return self.deviation <= self.allowed


@dataclass(frozen=True)
class Bench:
    """A rig, and what is done with it: it starts from rest and its valves are moved.

    Attributes:
        rig: The rig, without the effect in question.
        commands: Per command its (T,) volts.
        sample_s: Interval of commands and readings, s.
    """

    rig: Rig
    commands: Mapping[str, Floats] = field(default_factory=dict)
    sample_s: float = SAMPLE_S

    def readings(self, rigs: Sequence[Rig]) -> Floats:
        """(rigs, T, sensors) readings in deviations of each sensor's noise.

        Args:
            rigs: Variants of the rig on one grid, by one kind of model.
        """
        kind, plan = kind_of(rigs[0]), plan_grid(apply_to_rig(rigs[0]))
        count = len(next(iter(self.commands.values()), np.zeros(500)))
        sensors = [*self.rig.taps.values(), *self.rig.encoders.values()]
        time = self.sample_s * np.arange(count, dtype=np.float64)
        nothing = np.full((len(sensors), count), np.nan)
        course = Course(
            {name: Signal(time, volts) for name, volts in self.commands.items()},
            0.0,
            float(time[-1]),
            np.tile(time, (len(sensors), 1)),
            nothing,
            np.zeros_like(nothing),
            rest(rigs[0], plan),
        )
        out = kind.predict([list(rigs)], plan, [course], _nowhere(self.rig, plan))[0]
        noise = [t.noise_pa or 1.0 for t in self.rig.taps.values()]
        noise += [e.noise or 1.0 for e in self.rig.encoders.values()]
        return np.moveaxis(out.readings, 1, 2) / np.asarray(noise)


def _nowhere(rig: Rig, plan: Plan) -> InitialField:
    """No reading draws the gas."""
    return InitialField(
        np.zeros((plan.slots, len(rig.taps))),
        np.zeros(plan.slots),
        np.zeros((len(plan.chambers), len(rig.taps))),
        np.zeros(len(plan.chambers)),
    )


def bench_of(rig: Rig, seconds: float = 1.0, reach: float = 1.0, seed: int = 0) -> Bench:
    """A rig whose valves are moved at random between holds, and are closed now and then.

    Args:
        rig: The rig.
        seconds: How long.
        reach: Share of the way from null to the ends of the opening curves.
        seed: Seed of the random draws.
    """
    rng = np.random.default_rng(seed)
    count = round(seconds / SAMPLE_S)
    nulls = {valve.command: valve.spool.null_v for valve in rig.valves.values()}
    limits = voltage_limits(rig)
    for valve in rig.valves.values():
        if valve.switch is not None and valve.switch.pwm_hz is not None:
            nulls[valve.command], limits[valve.command] = 0.0, (0.0, 1.0)  # a duty
    commands = {}
    for name, (low, high) in limits.items():
        pieces: list[Floats] = []
        while sum(map(len, pieces)) < count:
            # From the middle of a valve's way to its ends, near null, and closed.
            share = rng.choice([1.0, 0.5, 0.1, 0.0], p=[0.3, 0.3, 0.3, 0.1]) * rng.uniform(0.5, 1)
            end = high if rng.random() < 0.5 else low
            volts = nulls[name] + reach * share * (end - nulls[name])
            pieces.append(np.full(rng.integers(10, 60), volts))
        commands[name] = np.concatenate(pieces)[:count]
    return Bench(rig, commands)


def attached(rig: Rig, effect: str, place: str, values: Mapping[str, float]) -> Rig:
    """A copy of a rig with one more effect.

    Args:
        rig: The rig.
        effect: Name of the effect.
        place: Where.
        values: Its parameters.
    """
    one = AttachedEffect(effect=effect, place=place, parameters=dict(values))
    return rig.model_copy(update={"effects": [*rig.effects, one]})


@dataclass(frozen=True)
class At:
    """An effect at a place of a bench.

    Attributes:
        bench: The bench.
        effect: The effect.
        place: Where.
        shape: Its further parameters.
    """

    bench: Bench
    effect: Effect
    place: str
    shape: Mapping[str, float]

    def rig(
        self,
        strength: float,
        base: Rig | None = None,
        shape: Mapping[str, float] = MappingProxyType({}),
    ) -> Rig:
        """The rig with the effect.

        Args:
            strength: How much of it.
            base: Another rig of the same parts.
            shape: Further parameters that differ.
        """
        values = {**self.shape, **shape, self.effect.strength.name: strength}
        return attached(base or self.bench.rig, self.effect.name, self.place, values)

    def responses(
        self,
        strengths: Sequence[float],
        base: Rig | None = None,
        shape: Mapping[str, float] = MappingProxyType({}),
    ) -> Floats:
        """(strengths, T, sensors) what the effect changes, in deviations of the noise.

        Args:
            strengths: How much of it, each.
            base: Another rig of the same parts.
            shape: Further parameters that differ.
        """
        base = base or self.bench.rig
        none, *runs = self.bench.readings([base, *(self.rig(s, base, shape) for s in strengths)])
        return np.asarray(runs) - none

    @property
    def typical(self) -> float:
        """A strength that is clearly felt and allowed here."""
        strength = self.effect.strength
        low, high = self.effect.limits(strength, self.bench.rig, self.place)
        return min(max(strength.typical, low), high)


def strongest(bench: Bench, effect: Effect) -> At | None:
    """Where on a rig a typical strength of an effect is felt most; None where it has no place.

    Args:
        bench: The rig.
        effect: The effect.
    """
    sites = [At(bench, effect, place, shape) for place, shape in effect.sites(bench.rig, SPACING_M)]
    if not sites:
        return None
    none, *runs = bench.readings([bench.rig, *(at.rig(at.typical) for at in sites)])
    return sites[int(np.argmax([_size(run - none) for run in runs]))]


def prove(at: At, others: Sequence[At] = (), grids: bool = True) -> list[Finding]:
    """Everything that holds for every effect, at one place of one rig.

    Args:
        at: The effect and where it sits.
        others: Effects of the same rig, with which it is attached in either order.
        grids: Whether on other cells and steps too, which takes longest.

    Raises:
        InputError: The rig cannot be simulated with the effect.
    """
    found = [vanishes(at), small(at), *(refines(at) if grids else [])]
    if at.place in at.bench.rig.pipes:
        found.append(turned(at))
    return [*found, *by_models(at), commutes(at, others), *keeps(at.effect)]


def vanishes(at: At) -> Finding:
    """Where there is none of it the rig behaves as if it were not there.

    Args:
        at: The effect and where it sits.
    """
    absent, typical = at.responses([at.effect.strength.absent, at.typical])
    return Finding("vanishes", _share(absent, typical), ROUND_OFF)


def small(at: At) -> Finding:
    """A small one acts in proportion, on which its first estimate rests; else it says so.

    Args:
        at: The effect and where it sits.
    """
    p = at.effect.strength
    more, less = at.responses([p.absent + share * p.step for share in (0.25, 0.125)])
    if at.effect.curved:
        # (before a limit is reached it is as if there were none)
        off = _share(2.0 * less - more, more) if _size(less) > 0.0 else 0.0
        return Finding("slope finite, declared curved", off, FINITE)
    return Finding("slope", _share(2.0 * less - more, more), SLOPE)


def refines(at: At) -> list[Finding]:
    """Its size does not hang on cells, on time steps, or on how other pipes are cut.

    Args:
        at: The effect and where it sits; on a pipe it is looked at between taps and ends, from
            which a place is told apart by whole cells.
    """
    rig = at.bench.rig
    if not kind_of(rig).along_lines or not rig.pipes:
        return []
    shape = {}
    if POSITION in at.shape:
        length = rig.pipes[at.place].length_m
        taken = [0.0, length]
        taken += [t.position_m or 0.0 for t in rig.taps.values() if t.pipe == at.place]
        free = length * np.linspace(0.1, 0.9, 17)
        far = np.min(np.abs(free[:, None] - np.array(taken)), axis=1)
        shape[POSITION] = float(free[np.argmax(far)])
    fine = rig.grid.model_copy(update={"dx_m": 0.5 * rig.grid.dx_m})
    slow = rig.grid.model_copy(update={"cfl": 0.5 * rig.grid.cfl})
    pipes = {
        name: pipe if name == at.place else pipe.model_copy(update={"dx_m": fine.dx_m})
        for name, pipe in rig.pipes.items()
    }
    variants: dict[str, dict[str, Any]] = {
        "cells half as long": {"grid": fine},
        "steps half as long": {"grid": slow},
        "other cells half as long": {"pipes": pipes},
    }
    (coarse,) = at.responses([at.typical], shape=shape)
    found = []
    for name, changed in variants.items():
        (other,) = at.responses([at.typical], rig.model_copy(update=changed), shape)
        found.append(Finding(name, _share(coarse - other, other), GRID))
    return found


def turned(at: At) -> Finding:
    """A pipe that is written from its other end is the same pipe.

    Args:
        at: The effect and where it sits, on a pipe.
    """
    rig, name = at.bench.rig, at.place
    pipe, other = rig.pipes[name], rig.model_copy(deep=True)
    flipped = other.pipes[name]
    for one, another in (
        ("from_node", "to_node"),
        ("loss_from", "loss_to"),
        ("volume_from_m3", "volume_to_m3"),
    ):
        setattr(flipped, one, getattr(pipe, another))
        setattr(flipped, another, getattr(pipe, one))
    if pipe.area_profile is not None:
        corners = [(pipe.length_m - x, area) for x, area in pipe.area_profile]
        flipped.area_profile = corners[::-1]
    taps = [tap for tap in other.taps.values() if tap.pipe == name]
    parts: list[Any] = [*flipped.losses, *flipped.leaks, *flipped.reliefs, *flipped.volumes]
    for part in [*parts, *flipped.narrowings, *taps]:
        part.position_m = pipe.length_m - part.position_m
    for own in other.effects:
        if own.place == name and POSITION in own.parameters:
            own.parameters[POSITION] = pipe.length_m - own.parameters[POSITION]
    shape: dict[str, float] = {}
    if POSITION in at.shape:
        shape[POSITION] = pipe.length_m - at.shape[POSITION]
    (here,) = at.responses([at.typical])
    (there,) = at.responses([at.typical], other, shape)
    return Finding("pipe written from its other end", _share(here - there, here), TURNED)


def by_models(at: At) -> list[Finding]:
    """Every kind of model has it somewhere on the rig, or refuses it.

    Args:
        at: The effect and where it sits.
    """
    found = []
    for name in kinds.BUILT_IN:
        rig = at.bench.rig.model_copy(update={"model": name})
        if rig.moves and name != "pde":
            continue  # pistons are moved along recordings by the full model alone
        there = strongest(dataclasses.replace(at.bench, rig=rig), at.effect)
        if there is not None:
            (felt,) = there.responses([there.typical])
            found.append(Finding(f"acts in {name}", 0.0 if _size(felt) > 0.0 else 1.0, 0.0))
            continue
        try:
            apply_to_rig(at.rig(at.typical, rig))
        except InputError as error:
            found.append(Finding(f"refused by {name}", 0.0, 0.0, str(error)))
        else:
            found.append(Finding(f"refused by {name}", 1.0, 0.0))
    return found


def commutes(at: At, others: Sequence[At]) -> Finding:
    """Attached before all others or after them, it is the same rig.

    Args:
        at: The effect and where it sits.
        others: The others.
    """
    rest = [one for one in others if one.effect is not at.effect]
    worst, about = _either_order(at, rest), ""
    if worst > ROUND_OFF:  # with which of them?
        each = [(_either_order(at, [one]), one) for one in rest]
        worst, other = max(each, key=lambda one: one[0])
        about = f"with {other.effect.name} on {other.place}"
    return Finding("order of attachment", worst, ROUND_OFF, about)


def _either_order(at: At, others: Sequence[At]) -> float:
    """How far models are apart to which an effect was attached before others and after them."""
    before, after = at.rig(at.typical), at.bench.rig
    for one in others:
        before, after = one.rig(one.typical, before), one.rig(one.typical, after)
    return _apart(build(before), build(at.rig(at.typical, after)))


def keeps(effect: Effect) -> list[Finding]:
    """What is shut in keeps its mass, and behind walls without heat its energy.

    Args:
        effect: The effect; of one that lets gas or heat through, only what it leaves alone.
    """
    found = []
    for place in effect.places_in(CLOSED):
        shape = {p.name: p.typical for p in effect.parameters[1:]}
        if POSITION in shape:
            shape[POSITION] = 0.4 * CLOSED.pipes[place].length_m
        at = At(Bench(CLOSED), effect, place, shape)
        simulator = Simulator(at.rig(at.typical))
        simulator.reset({"full": 6e5})
        before = np.array([simulator.mass_kg(), simulator.energy_j()])
        simulator.run(0.3)
        after = np.array([simulator.mass_kg(), simulator.energy_j()])
        lost = np.abs(after / before - 1.0)
        if "gas" not in effect.lets_through:
            found.append(Finding("keeps its mass", float(lost[0]), KEPT, f"on {place}"))
            if "heat" not in effect.lets_through:
                found.append(Finding("keeps its energy", float(lost[1]), KEPT, f"on {place}"))
    return found


def twins(bench: Bench) -> set[tuple[str, str]]:
    """Effects that change the same at the same strength, so that nothing tells them apart here.

    Args:
        bench: The rig.

    Returns:
        Pairs of names, in order.
    """
    places: dict[str, list[At]] = {}
    for effect in registry().values():
        for place, shape in itertools.islice(effect.sites(bench.rig, SPACING_M), 50):
            places.setdefault(place, []).append(At(bench, effect, place, shape))
    found = set()
    for sites in places.values():
        for at in {one.effect.name: one for one in sites}.values():
            others = [
                one
                for one in sites
                if one.effect.name > at.effect.name
                and one.effect.limits(one.effect.strength, bench.rig, one.place)[1] >= at.typical
            ]
            if not others:
                continue
            none, mine, *runs = bench.readings(
                [bench.rig, at.rig(at.typical), *(one.rig(at.typical) for one in others)]
            )
            for one, run in zip(others, runs, strict=True):
                if _size(run - mine) < TWIN * _size(mine - none):
                    found.add((at.effect.name, one.effect.name))
    return found


def compare(effect: Effect, one: Comparison) -> list[Finding]:
    """What an effect changes in an experiment, beside what is foretold that it changes.

    Args:
        effect: The effect.
        one: The experiment.
    """

    def measured(strength: float) -> Floats:
        values = {**one.shape, effect.strength.name: strength}
        rig = attached(one.rig, effect.name, one.place, values)
        return np.asarray(one.measure(rig), dtype=float)

    absent = effect.strength.absent
    foretold = np.asarray(one.expected(absent), dtype=float)
    before = measured(absent)
    found = []
    for strength in one.strengths:
        expected = np.asarray(one.expected(strength), dtype=float) - foretold
        off = measured(strength) - before - expected
        deviation = float(np.max(np.abs(off)) / np.max(np.abs(expected)))
        about = f"{one.what}, {strength:g} {effect.strength.unit}"
        found.append(Finding("reference", deviation, one.allowed, about))
    return found


def _size(response: Floats) -> float:
    return float(np.linalg.norm(response))


def _share(off: Floats, of: Floats) -> float:
    """How large a difference is beside a response; infinite beside none."""
    return _size(off) / _size(of) if _size(of) > 0.0 else math.inf


def _apart(one: Model, other: Model) -> float:
    """Largest relative difference of any number of two models."""
    worst = 0.0
    for part in dataclasses.fields(Model):
        a, b = getattr(one, part.name), getattr(other, part.name)
        if isinstance(a, np.ndarray):
            scale = np.maximum(np.abs(a), np.abs(b))
            with np.errstate(invalid="ignore", divide="ignore"):
                off = np.where(a == b, 0.0, np.abs(a - b) / scale)
            worst = max(worst, float(np.nanmax(off, initial=0.0)))
        elif isinstance(a, dict) and part.name != "terms":
            worst = max(worst, _unlike(a, b))
    return worst


def _unlike(one: dict[int, object], other: dict[int, object]) -> float:
    if set(one) != set(other):
        return 1.0
    worst = 0.0
    for key, a in one.items():
        left, right = (np.sort(np.asarray(x, dtype=float), axis=0) for x in ([a], [other[key]]))
        left, right = (np.sort(np.ravel(x)) for x in (left, right))
        if left.shape != right.shape:
            return 1.0
        scale = np.maximum(np.maximum(np.abs(left), np.abs(right)), 1e-300)
        worst = max(worst, float(np.max(np.abs(left - right) / scale, initial=0.0)))
    return worst
