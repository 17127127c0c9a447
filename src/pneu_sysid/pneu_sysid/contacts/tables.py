# SPDX-License-Identifier: Apache-2.0
"""The tables of thesis chapter 2 for any scene: how far an estimate is to be trusted.

Parameters of one recording on another (table 2.3), a sensor left out and foretold (2.7.1), many
starts (table 2.4), and contacts that begin at a distance which shrinks (2.5.1, fig. 2.2).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sysid.contacts.chain import Chain
from pneu_sysid.contacts.effects.base import ALL
from pneu_sysid.contacts.estimate import (
    Problem,
    State,
    Tell,
    estimate,
    parameters_of,
)
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.scene import Loaded, Value
from pneu_sysid.contacts.track import Track
from pneu_sysid.contacts.trajectories import begun

Floats = NDArray[np.float64]

ITERATIONS = 50
ENOUGH = 1e-5
UNFELT = 1e-12
"""What the weight of a sensor that is left out is multiplied by."""


@dataclass(frozen=True)
class Cross:
    """Parameters of each recording on every one.

    Attributes:
        names: Of the recordings.
        labels: Of the parameters.
        values: (recordings, parameters) found of each alone.
        manual: (recordings,) cost with the scene's own parameters.
        costs: (recordings, recordings) of the first with parameters of the second.
    """

    names: list[str]
    labels: list[str]
    values: Floats
    manual: Floats
    costs: Floats

    @property
    def worst(self) -> float:
        """Largest cost over that with a recording's own parameters."""
        return float(np.max(self.costs / np.diag(self.costs)[:, None]))

    @property
    def gain(self) -> float:
        """Least cost with the scene's own parameters over that with a recording's."""
        return float(np.min(self.manual / np.diag(self.costs)))


def cross(
    loaded: Loaded, tracks: Sequence[Track], physics: Physics, tell: Tell | None = None
) -> Cross:
    """Identifies on each recording alone, and estimates every one with the parameters of each.

    Args:
        loaded: The scene.
        tracks: The recordings.
        physics: What evaluates models.
        tell: Called with a note and the fraction done.
    """
    said = tell or (lambda note, done: None)
    values = loaded.scene.values
    parameters = parameters_of(loaded, values)
    if not parameters:
        raise InputError("values: nothing is fitted; cross-validation needs parameters")
    n = len(tracks)
    chains, starts = begun(loaded, tracks, values, physics)
    rows, found, manual, costs = [], [], np.empty(n), np.empty((n, n))
    for k, chain in enumerate(chains):
        said(f"identified on {chain.name}", 0.5 * k / n)
        problem = Problem(loaded, [chain], values, parameters, physics)
        one = estimate(problem, State((starts[k],), problem.start()), ITERATIONS, enough=ENOUGH)
        found.append(one)
        rows.append([p.value(float(x)) for p, x in zip(parameters, one.state.x, strict=True)])
        manual[k] = _trajectory(loaded, chain, values, starts[k], physics)
    for k, chain in enumerate(chains):
        for j, other in enumerate(found):
            said(
                f"{chain.name} with parameters of {chains[j].name}", 0.5 + 0.5 * (k * n + j) / n**2
            )
            at = found[k].state.q[0]
            costs[k, j] = _trajectory(loaded, chain, other.values, at, physics)
    labels = [p.label for p in parameters]
    return Cross([c.name for c in chains], labels, np.array(rows), manual, costs)


def _trajectory(
    loaded: Loaded, chain: Chain, values: tuple[Value, ...], q: Floats, physics: Physics
) -> float:
    problem = Problem(loaded, [chain], values, [], physics)
    return estimate(problem, State((q,), problem.start()), ITERATIONS, enough=ENOUGH).cost


@dataclass(frozen=True)
class LeftOut:
    """A sensor that was left out and foretold.

    Attributes:
        sensor: Its name.
        rmse: Root mean square of what was foretold less what it read.
        span: Range of what it read.
        with_it: The same error where it is not left out.
    """

    sensor: str
    rmse: float
    span: float
    with_it: float


def leave_out(
    loaded: Loaded,
    tracks: Sequence[Track],
    physics: Physics,
    sensors: Sequence[str] = (),
    tell: Tell | None = None,
) -> list[LeftOut]:
    """Estimates trajectories without one sensor after another, and foretells it.

    Args:
        loaded: The scene, its parameters identified.
        tracks: The recordings.
        physics: What evaluates models.
        sensors: Which are left out in turn; all unless given.
        tell: Called with a note and the fraction done.
    """
    said = tell or (lambda note, done: None)
    names = list(sensors) or list(loaded.names)
    for name in names:
        if name not in loaded.names:
            raise InputError(f"sensor {name!r} is none of {', '.join(loaded.names)}")
    chains, starts = begun(loaded, tracks, loaded.scene.values, physics)
    whole = _smooth(loaded, chains, starts, physics)
    out = []
    for k, name in enumerate(names):
        said(f"without {name}", k / len(names))
        less = [
            replace(
                chain,
                channels=tuple(
                    replace(c, norm=replace(c.norm, weight=c.norm.weight * UNFELT))
                    if c.name == name
                    else c
                    for c in chain.channels
                ),
            )
            for chain in chains
        ]
        q = _smooth(loaded, less, starts, physics)
        out.append(_foretold(loaded, chains, name, q, whole, physics))
    return out


def _smooth(
    loaded: Loaded, chains: Sequence[Chain], q: tuple[Floats, ...], physics: Physics
) -> tuple[Floats, ...]:
    problem = Problem(loaded, chains, loaded.scene.values, [], physics)
    return estimate(problem, State(q, problem.start()), ITERATIONS, enough=ENOUGH).state.q


def _foretold(
    loaded: Loaded,
    chains: Sequence[Chain],
    name: str,
    without: tuple[Floats, ...],
    whole: tuple[Floats, ...],
    physics: Physics,
) -> LeftOut:
    setup = loaded.setup(loaded.scene.values)
    model = setup.spec.compile()

    def off(q: tuple[Floats, ...]) -> float:
        parts = []
        for chain, at in zip(chains, q, strict=True):
            channel = next(c for c in chain.channels if c.name == name)
            said = chain.outputs(at, model, setup, physics)
            parts.append(chain.misreadings(channel, said, setup))
        return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))

    read = np.concatenate(
        [next(c for c in chain.channels if c.name == name).series.values for chain in chains]
    )
    return LeftOut(name, off(without), float(np.max(np.ptp(read, axis=0))), off(whole))


@dataclass(frozen=True)
class Spread:
    """Where many starts end.

    Attributes:
        labels: Of the parameters.
        values: (starts, parameters) found from each.
        costs: (starts,) cost of each.
    """

    labels: list[str]
    values: Floats
    costs: Floats

    @property
    def same(self) -> float:
        """Share of starts that end within 2 % of the least cost."""
        return float(np.mean(self.costs <= 1.02 * np.min(self.costs)))


def spread(
    loaded: Loaded,
    tracks: Sequence[Track],
    physics: Physics,
    count: int = 33,
    seed: int = 0,
    remote_m: Sequence[float] = (),
    tell: Tell | None = None,
) -> Spread:
    """Identifies from many starts: each parameter is halved to doubled, at random.

    Args:
        loaded: The scene.
        tracks: The recordings.
        physics: What evaluates models.
        count: How many starts.
        seed: Of them.
        remote_m: Distances at which contacts begin, one estimate after another, each from the last,
            before the one of the scene; none for that one alone.
        tell: Called with a note and the fraction done.
    """
    said = tell or (lambda note, done: None)
    values = loaded.scene.values
    parameters = parameters_of(loaded, values)
    setup = loaded.setup(values)
    rng = np.random.default_rng(seed)
    rows, costs = [], []
    for number in range(count):
        said(f"start {number + 1}", number / count)
        own = {(v.effect, v.at): v for v in values}
        for p in parameters:
            now = p.effect.value(setup, p.place)
            by = float(np.exp(rng.uniform(-np.log(2.0), np.log(2.0))))
            start = float(np.clip(now * by, p.lower, p.upper))
            own[p.effect.name, p.place] = own[p.effect.name, p.place].but(value=start)
        begin = tuple(own.values())
        chains, q = begun(loaded, tracks, begin, physics)
        state: State | None = None
        for distance in (*remote_m, None):
            far = (
                begin
                if distance is None
                else (
                    *(v for v in begin if v.effect != "remote_distance"),
                    Value(effect="remote_distance", at=ALL, value=distance, fit=False),
                )
            )
            problem = Problem(loaded, chains, far, parameters, physics)
            state = state or State(q, problem.start())
            found = estimate(problem, state, ITERATIONS, enough=ENOUGH)
            state = found.state
        rows.append([p.value(float(x)) for p, x in zip(parameters, found.state.x, strict=True)])
        costs.append(found.cost)
    return Spread([p.label for p in parameters], np.array(rows), np.array(costs))
