# SPDX-License-Identifier: Apache-2.0
"""Verify an effect on a rig: the properties that every effect must have, and its reference results.

Each check returns a deviation and its limit. The property checks need only the effect and a rig
that has a place for it, so they apply to an effect from a user's file as to those of the catalogue.
An effect may add experiments with a known result, from a closed form or an independent model
(`Effect.comparisons`).
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
from pneu_sim.rig.model import Model, OwnTerm
from pneu_sim.rig.plan import Plan, plan_grid
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sim.signals import Signal
from pneu_sim.simulate import Course, InitialField, rest
from pneu_sim.simulator import Simulator
from pneu_sim.valve import duty, voltage_limits

Floats = NDArray[np.float64]

ROUND_OFF = 1e-8
"""Largest relative difference between two ways to compute the same number."""
SLOPE = 0.05
"""Largest relative deviation from proportionality below a difference step, unless curved."""
FINITE = 4.0
"""The same limit for a curved effect, whose slope at zero need only be finite."""
GRID = 0.1
"""Largest relative change of a response when cells or time steps are halved. With 50 mm cells the
least accurate effect, an advected temperature change, changes by 0.07."""
TURNED = 1e-4
"""Largest relative change of a response when its pipe is reversed. Iterations stop at 1e-9 of a
pressure, of which a response is a small part."""
KEPT = 1e-9
"""Largest relative change of the mass or energy of a closed rig."""
IDENTICAL = 1e-6
"""Relative difference of two responses below which their effects are indistinguishable."""
SAMPLE_S = 0.002
SPACING_M = 0.5
"""Distance between the positions tried along a pipe, m."""

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
"""A closed rig: a full and an empty chamber, joined by lines with adiabatic walls."""


@dataclass(frozen=True)
class Finding:
    """The result of one check.

    Attributes:
        check: Name of the check.
        deviation: Measured deviation, dimensionless.
        allowed: Its limit.
        about: Details, such as the other effect or the strength.
    """

    check: str
    deviation: float
    allowed: float
    about: str = ""

    @property
    def holds(self) -> bool:
        """Whether the deviation is within its limit; NaN is not."""
        return self.deviation <= self.allowed


@dataclass(frozen=True)
class Experiment:
    """A rig and the valve commands that it is run with from rest.

    Attributes:
        rig: The rig, without the effect in question.
        commands: Per command its (T,) volts.
        sample_s: Interval of commands and readings, s.
    """

    rig: Rig
    commands: Mapping[str, Floats] = field(default_factory=dict)
    sample_s: float = SAMPLE_S

    def readings(self, rigs: Sequence[Rig]) -> Floats:
        """Return the (rigs, T, sensors) readings, divided by the noise of each sensor.

        Sensors without declared noise are in Pa, rad or m.

        Args:
            rigs: Variants of the rig with one grid and one kind of model.
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
    """An initial field that no reading corrects."""
    return InitialField(
        np.zeros((plan.slots, len(rig.taps))),
        np.zeros(plan.slots),
        np.zeros((len(plan.chambers), len(rig.taps))),
        np.zeros(len(plan.chambers)),
    )


def experiment_of(rig: Rig, seconds: float = 1.0, reach: float = 1.0, seed: int = 0) -> Experiment:
    """Return a rig with random steps of every valve command.

    Args:
        rig: The rig, at rest at the start.
        seconds: Duration, s.
        reach: Largest amplitude, as a share of the command range on either side of null.
        seed: Random seed.
    """
    rng = np.random.default_rng(seed)
    count = round(seconds / SAMPLE_S)
    nulls = {
        valve.command: 0.0 if duty(valve) else valve.spool.null_v for valve in rig.valves.values()
    }
    commands = {}
    for name, (low, high) in voltage_limits(rig).items():
        pieces: list[Floats] = []
        while sum(map(len, pieces)) < count:
            # From the middle of a valve's way to its ends, near null, and closed.
            share = rng.choice([1.0, 0.5, 0.1, 0.0], p=[0.3, 0.3, 0.3, 0.1]) * rng.uniform(0.5, 1)
            end = high if rng.random() < 0.5 else low
            volts = nulls[name] + reach * share * (end - nulls[name])
            pieces.append(np.full(rng.integers(10, 60), volts))
        commands[name] = np.concatenate(pieces)[:count]
    return Experiment(rig, commands)


def attached(rig: Rig, effect: str, place: str, values: Mapping[str, float]) -> Rig:
    """Return a copy of a rig with one more effect attached.

    Args:
        rig: The rig, which stays as it is.
        effect: Name of the effect.
        place: Its place, one of `Effect.available_places`.
        values: Its parameters, in their units.
    """
    one = AttachedEffect(effect=effect, place=place, parameters=dict(values))
    return rig.model_copy(update={"effects": [*rig.effects, one]})


@dataclass(frozen=True)
class Placement:
    """An effect at a place of the rig of an experiment.

    Attributes:
        experiment: The experiment, whose rig lacks the effect.
        effect: The effect.
        place: Its place.
        shape: Its parameters other than the strength.
    """

    experiment: Experiment
    effect: Effect
    place: str
    shape: Mapping[str, float]

    def rig(
        self,
        strength: float,
        base: Rig | None = None,
        shape: Mapping[str, float] = MappingProxyType({}),
    ) -> Rig:
        """Return the rig with the effect attached.

        Args:
            strength: Its strength.
            base: A variant that replaces the rig of the experiment.
            shape: Parameters that replace those of the placement.
        """
        values = {**self.shape, **shape, self.effect.strength.name: strength}
        return attached(base or self.experiment.rig, self.effect.name, self.place, values)

    def responses(
        self,
        strengths: Sequence[float],
        base: Rig | None = None,
        shape: Mapping[str, float] = MappingProxyType({}),
    ) -> Floats:
        """Return the (strengths, T, sensors) change of the readings, divided by the noise.

        Args:
            strengths: Strengths of the effect.
            base: A variant that replaces the rig of the experiment.
            shape: Parameters that replace those of the placement.
        """
        base = base or self.experiment.rig
        none, *runs = self.experiment.readings(
            [base, *(self.rig(s, base, shape) for s in strengths)]
        )
        return np.asarray(runs) - none

    @property
    def typical(self) -> float:
        """The typical strength, clipped to the bounds at this place."""
        strength = self.effect.strength
        low, high = self.effect.limits(strength, self.experiment.rig, self.place)
        return min(max(strength.typical, low), high)


def strongest(experiment: Experiment, effect: Effect) -> Placement | None:
    """Return the placement of an effect with the largest response; None without a place.

    Args:
        experiment: The experiment.
        effect: The effect, tried at its typical strength.
    """
    sites = [
        Placement(experiment, effect, place, shape)
        for place, shape in effect.sites(experiment.rig, SPACING_M)
    ]
    if not sites:
        return None
    none, *runs = experiment.readings([experiment.rig, *(at.rig(at.typical) for at in sites)])
    return sites[int(np.argmax([_size(run - none) for run in runs]))]


def beside(at: Placement, effect: Effect) -> Placement | None:
    """Return a placement of another effect, on the same part if it can be there; None without one.

    Args:
        at: A placement.
        effect: The other effect.
    """
    sites = [
        Placement(at.experiment, effect, place, shape)
        for place, shape in effect.sites(at.experiment.rig, SPACING_M)
    ]
    return next((one for one in sites if one.place == at.place), next(iter(sites), None))


def prove(at: Placement, others: Sequence[Placement] = (), grids: bool = True) -> list[Finding]:
    """Check all properties that every effect must have.

    Args:
        at: The placement.
        others: Placements on the same rig, for the order of attachment.
        grids: Whether to check grid independence, which takes longest.

    Raises:
        InputError: The rig cannot be simulated with the effect.
    """
    found = [vanishes(at), linearity(at), *(grid_independence(at) if grids else [])]
    if at.place in at.experiment.rig.pipes:
        found.append(direction_independence(at))
    return [*found, *in_models(at), commutes(at, others), *conservation(at.effect)]


def vanishes(at: Placement) -> Finding:
    """Check that the effect vanishes at its absent strength.

    Args:
        at: The placement.
    """
    absent, typical = at.responses([at.effect.strength.absent, at.typical])
    return Finding("vanishes", _share(absent, typical), ROUND_OFF)


def linearity(at: Placement) -> Finding:
    """Check that small responses are proportional to the strength, as sensitivities assume.

    Args:
        at: The placement.
    """
    p = at.effect.strength
    more, less = at.responses([p.absent + share * p.step for share in (0.25, 0.125)])
    if at.effect.curved:
        # A limit that is not reached has no response at all.
        off = _share(2.0 * less - more, more) if _size(less) > 0.0 else 0.0
        return Finding("slope finite, declared curved", off, FINITE)
    return Finding("slope", _share(2.0 * less - more, more), SLOPE)


def grid_independence(at: Placement) -> list[Finding]:
    """Check that the response is independent of cell lengths, of all or other pipes, and time step.

    Args:
        at: The placement. A position along a pipe is moved as far as possible from taps and ends,
            because positions are resolved to a cell only.
    """
    rig = at.experiment.rig
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


def direction_independence(at: Placement) -> Finding:
    """Check that the response is independent of the direction in which its pipe is declared.

    Args:
        at: The placement, on a pipe.
    """
    rig, name = at.experiment.rig, at.place
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


def in_models(at: Placement) -> list[Finding]:
    """Check that every kind of model either responds to the effect or refuses it.

    Args:
        at: The placement.
    """
    found = []
    for name in kinds.BUILT_IN:
        rig = at.experiment.rig.model_copy(update={"model": name})
        if rig.moves and name != "pde":
            continue  # only the full model predicts moving pistons along recordings
        there = strongest(dataclasses.replace(at.experiment, rig=rig), at.effect)
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


def commutes(at: Placement, others: Sequence[Placement]) -> Finding:
    """Check that the model is independent of the order of attachment.

    Args:
        at: The placement.
        others: The placements attached with it.
    """
    rest = [one for one in others if one.effect is not at.effect]
    worst, about = _either_order(at, rest), ""
    if worst > ROUND_OFF:  # name the other effect
        each = [(_either_order(at, [one]), one) for one in rest]
        worst, other = max(each, key=lambda one: one[0])
        about = f"with {other.effect.name} on {other.place}"
    return Finding("order of attachment", worst, ROUND_OFF, about)


def _either_order(at: Placement, others: Sequence[Placement]) -> float:
    """Return the difference between the models with the effect attached first and last."""
    before, after = at.rig(at.typical), at.experiment.rig
    for one in others:
        before, after = one.rig(one.typical, before), one.rig(one.typical, after)
    return _apart(build(before), build(at.rig(at.typical, after)))


def conservation(effect: Effect) -> list[Finding]:
    """Check that a closed adiabatic rig conserves mass and energy.

    Args:
        effect: The effect; quantities that it `exchanges` with the room are not checked.
    """
    found = []
    for place in effect.available_places(CLOSED):
        shape = {p.name: p.typical for p in effect.parameters[1:]}
        if POSITION in shape:
            shape[POSITION] = 0.4 * CLOSED.pipes[place].length_m
        at = Placement(Experiment(CLOSED), effect, place, shape)
        simulator = Simulator(at.rig(at.typical))
        simulator.reset({"full": 6e5})
        before = np.array([simulator.mass_kg(), simulator.energy_j()])
        simulator.run(0.3)
        after = np.array([simulator.mass_kg(), simulator.energy_j()])
        lost = np.abs(after / before - 1.0)
        if "gas" not in effect.exchanges:
            found.append(Finding("keeps its mass", float(lost[0]), KEPT, f"on {place}"))
            if "heat" not in effect.exchanges:
                found.append(Finding("keeps its energy", float(lost[1]), KEPT, f"on {place}"))
    return found


def indistinguishable_pairs(experiment: Experiment) -> set[tuple[str, str]]:
    """Return the pairs of effects with equal responses at equal strengths.

    Args:
        experiment: The experiment.

    Returns:
        Pairs of names, each in alphabetical order.
    """
    places: dict[str, list[Placement]] = {}
    for effect in registry().values():
        for place, shape in itertools.islice(effect.sites(experiment.rig, SPACING_M), 50):
            places.setdefault(place, []).append(Placement(experiment, effect, place, shape))
    found = set()
    for sites in places.values():
        for at in {one.effect.name: one for one in sites}.values():
            others = [
                one
                for one in sites
                if one.effect.name > at.effect.name
                and one.effect.limits(one.effect.strength, experiment.rig, one.place)[1]
                >= at.typical
            ]
            if not others:
                continue
            none, mine, *runs = experiment.readings(
                [experiment.rig, at.rig(at.typical), *(one.rig(at.typical) for one in others)]
            )
            for one, run in zip(others, runs, strict=True):
                if _size(run - mine) < IDENTICAL * _size(mine - none):
                    found.add((at.effect.name, one.effect.name))
    return found


def compare(effect: Effect, one: Comparison) -> list[Finding]:
    """Compare the change that an effect makes in an experiment with its reference.

    Args:
        effect: The effect.
        one: The experiment and its reference result.
    """

    def measured(strength: float) -> Floats:
        values = {**one.shape, effect.strength.name: strength}
        rig = attached(one.rig, effect.name, one.place, values)
        return np.asarray(one.measure(rig), dtype=float)

    absent = effect.strength.absent
    without = np.asarray(one.expected(absent), dtype=float)
    before = measured(absent)
    found = []
    for strength in one.strengths:
        expected = np.asarray(one.expected(strength), dtype=float) - without
        off = measured(strength) - before - expected
        deviation = float(np.max(np.abs(off)) / np.max(np.abs(expected)))
        about = f"{one.what}, {strength:g} {effect.strength.unit}"
        found.append(Finding("reference", deviation, one.allowed, about))
    return found


def _size(response: Floats) -> float:
    return float(np.linalg.norm(response))


def _share(off: Floats, of: Floats) -> float:
    """Return the norm of a difference relative to that of a response; infinite for no response."""
    return _size(off) / _size(of) if _size(of) > 0.0 else math.inf


def _apart(one: Any, other: Any) -> float:
    """Return the largest relative difference between the numbers of two models or their parts."""
    if isinstance(one, Model | OwnTerm):
        names = [part.name for part in dataclasses.fields(one)]
        return max(_apart(getattr(one, name), getattr(other, name)) for name in names)
    if isinstance(one, dict):
        if set(one) != set(other):
            return 1.0
        return max((_apart(part, other[key]) for key, part in one.items()), default=0.0)
    if isinstance(one, list):  # such as the leaks of a cell, in any order
        one, other = np.sort(np.ravel(one)), np.sort(np.ravel(other))
    elif not isinstance(one, np.ndarray | float):
        return 0.0  # structure
    a, b = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
    if a.shape != b.shape:
        return 1.0
    scale = np.maximum(np.maximum(np.abs(a), np.abs(b)), np.finfo(float).tiny)
    with np.errstate(invalid="ignore"):  # equal infinities
        off = np.where(a == b, 0.0, np.abs(a - b) / scale)
    return float(np.nanmax(off, initial=0.0))
