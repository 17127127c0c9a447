# SPDX-License-Identifier: Apache-2.0
"""What robots are to do (thesis 7.1, 9.2.4): follow targets, push, swing a pole up, walk.

A goal says what it needs; begun, it is an aim of robots side by side, which knows their targets and
judges every step: reward, whether the episode ends, how far off, whether that is a success.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from pneu_common.validation import Listed, Settings
from pneu_policy.control.planner import Planner
from pneu_policy.control.robot_recipe import RobotRecipe
from pneu_policy.task.ranges import Kinds, Range
from pneu_policy.task.reward import Reward
from pneu_policy.task.waves import Kind, Wave
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

LONGEST_S = 60.0
"""Targets begin within this time of their own start, so that few episodes are alike."""
FLOOR_RAD = 1e-3
"""Least angle under a logarithm."""


def _rising(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[0] < pair[1]:
        raise ValueError(f"found {pair[0]:g} to {pair[1]:g}, needed is a range that rises")
    return pair


Span = Annotated[tuple[float, float], Listed, AfterValidator(_rising)]
"""Lowest and highest value of something; either may be negative."""


@dataclass(frozen=True)
class Outcome:
    """How a step went, each (count,).

    Attributes:
        reward: Of the step.
        ended: Whether the episode ends by it.
        error: How far off, SI.
        success: Whether that is where it should be.
    """

    reward: Floats
    ended: Flags
    error: Floats
    success: Flags


@dataclass(frozen=True)
class Wanted:
    """What is wanted of robots side by side; None is nothing of the kind.

    Attributes:
        targets: (count, tracked, previews) rad or m.
        forces_n: (count, cylinders, previews) of the gas.
        ways: (count, cylinders, previews) extensions over their strokes.
    """

    targets: Floats | None = None
    forces_n: Floats | None = None
    ways: Floats | None = None


@dataclass(frozen=True)
class Motion:
    """What robots side by side truly do.

    Attributes:
        positions: (count, encoders) in the order of the recipe's encoders.
        speeds: Likewise.
        forces_n: (count, cylinders) of the gas on pistons, in the order of the recipe's forces.
    """

    positions: Floats
    speeds: Floats
    forces_n: Floats


class Aim(ABC):
    """A goal of robots side by side."""

    @abstractmethod
    def begin(self, rng: np.random.Generator) -> None:
        """Draws the goals of new episodes.

        Args:
            rng: Where they come from.
        """

    def wanted(self, step: int, positions: Floats) -> Wanted:
        """What is wanted of robots from a step on.

        Args:
            step: Control periods since the beginning.
            positions: (count, encoders) as they are measured, in the order of the recipe.
        """
        del step, positions
        return Wanted()

    def beginnings(self) -> dict[str, tuple[Floats, Floats]]:
        """Where targets begin and how fast they go, by encoder on a joint; each (count,)."""
        return {}

    def ways(self, step: int) -> Floats | None:
        """(count, cylinders) where pistons are led to, over their strokes; None leads none.

        Args:
            step: Control periods since the beginning.
        """
        del step
        return None

    @abstractmethod
    def judge(self, step: int, now: Motion) -> Outcome:
        """How a step went.

        Args:
            step: Control periods since the beginning.
            now: What robots truly do.
        """


class Track(Settings):
    """Following targets that move at random, with all of the tracked encoders at once.

    Attributes:
        kind: ``track``.
        ranges: Lowest and highest target by tracked encoder; where a hand is tracked, of the joints
            of its chain, whose random motion its targets go by.
        kinds: Kinds of target, ``smooth`` (sums of sines), ``jagged`` (saw-teeth), ``hold``
            (square); each episode draws one. To reach a place is to hold one for the whole episode.
        target_period_s: Least and most typical time between extremes, s.
        periods_s: The same for single kinds.
        jitter: Share of that by which corners of jagged targets are moved.
        reward: The reward of being near.
        force_reward: The reward of pushing as the plan says, of the error in the recipe's span of
            forces; None is none.
        within: Encoders that end an episode where they leave a range (a pole that falls).
        near: Distance from the target that is a success, rad or m.
        upright: Encoders that must be within a range for a success besides.
        unit: What errors are told in, and how much one of it is in SI units.
        mark: Error at which the goal is called learned, in that unit.
    """

    kind: Literal["track"] = "track"
    ranges: dict[str, Span]
    kinds: Kinds = ("smooth",)
    target_period_s: Range = (0.4, 0.8)
    periods_s: dict[Kind, Range] = Field(default_factory=dict)
    jitter: float = 0.6
    reward: Reward | None = Reward()
    force_reward: Reward | None = None
    within: dict[str, Span] = Field(default_factory=dict)
    near: Annotated[float, Field(gt=0.0)] = 0.01
    upright: dict[str, Span] = Field(default_factory=dict)
    unit: Annotated[tuple[str, float], Listed] = ("mm", 1e-3)
    mark: Annotated[float, Field(gt=0.0)] = 1.0

    def needs(self, recipe: RobotRecipe) -> str:
        """An objection to a recipe; empty where there is none.

        Args:
            recipe: The recipe.
        """
        if not recipe.tracked:
            return "recipe.tracked: found none, goal track needs one at least"
        for name in self._led(recipe):
            if name not in self.ranges:
                return f"goal.ranges: found none for {name!r}"
        if recipe.forces and recipe.plan is None:
            return "recipe.plan: found none, which says what forces recipe.forces asks for"
        if self.force_reward is not None and not recipe.forces:
            return "goal.force_reward: found one, recipe.forces has no cylinder"
        return _unknown("within", self.within, recipe) or _unknown("upright", self.upright, recipe)

    def aim(self, recipe: RobotRecipe, rig: Rig, count: int, horizon: int) -> Aim:
        """The goal of robots side by side.

        Args:
            recipe: What policies see.
            rig: The rig, as whoever plans knows it.
            count: How many.
            horizon: Control periods of an episode.
        """
        return _Tracking(self, recipe, rig, count, horizon)

    def _led(self, recipe: RobotRecipe) -> Sequence[str]:
        """Encoders whose targets are drawn; others follow from them."""
        c = recipe.chain
        if c is not None and set(recipe.tracked) & {c.x, c.y}:
            return c.joints
        return recipe.tracked


class _Tracking(Aim):
    def __init__(
        self, goal: Track, recipe: RobotRecipe, rig: Rig, count: int, horizon: int
    ) -> None:
        self._goal, self._recipe, self._count, self._horizon = goal, recipe, count, horizon
        self._led = list(goal._led(recipe))
        names = list(recipe.encoders)
        self._at = [names.index(name) for name in recipe.tracked]
        self._span = np.array([recipe.encoders[name].span for name in recipe.tracked])
        self._within = _bounds(goal.within, names)
        self._upright = _bounds(goal.upright, names)
        self._planner = Planner.of_recipe(recipe, rig) if recipe.forces else None
        self._force_span = np.array([push.span_n for push in recipe.forces.values()])
        self._planned = np.zeros((count, len(recipe.forces)))
        reach = 1 if self._planner is None else self._planner.reach
        h = recipe.period_s
        self._previews = np.arange(horizon + 1)[:, None] * h + np.array(recipe.preview_s)
        self._grid_s = np.arange(horizon + 1 + reach) * h
        self._targets = np.zeros((horizon + 1, count, len(self._at), len(recipe.preview_s)))
        self._grid = np.zeros((count, len(self._at), self._grid_s.size))
        self._starts: dict[str, tuple[Floats, Floats]] = {}

    def begin(self, rng: np.random.Generator) -> None:
        g, n = self._goal, self._count
        kinds = rng.integers(len(g.kinds), size=n)
        shares = rng.uniform(size=(n, len(self._led)))
        seeds = rng.integers(2**31, size=(n, len(self._led)))
        begins = rng.uniform(0.0, LONGEST_S, n)
        if self._planner is not None:
            self._planner.reset()
        starts = np.zeros((len(self._led), 2, n))
        for j in range(n):
            kind = g.kinds[int(kinds[j])]
            short, long = g.periods_s.get(kind, g.target_period_s)
            waves = {
                name: Wave(
                    kind, *g.ranges[name], short + float(shares[j, k]) * (long - short),
                    int(seeds[j, k]), jitter=g.jitter,
                )
                for k, name in enumerate(self._led)
            }  # fmt: skip
            self._targets[:, j] = self._followed(waves, begins[j] + self._previews).swapaxes(0, 1)
            if self._planner is not None:
                self._grid[j] = self._followed(waves, begins[j] + self._grid_s)
            for k, wave in enumerate(waves.values()):
                now, soon = wave.at(begins[j] + self._grid_s[:2])
                starts[k, :, j] = now, (soon - now) / self._recipe.period_s
        self._starts = dict(
            zip(self._led, zip(starts[:, 0], starts[:, 1], strict=True), strict=True)
        )

    def _followed(self, waves: dict[str, Wave], times: Floats) -> Floats:
        """(tracked, *times) targets of what is tracked, from those that are drawn."""
        told = {name: wave.at(times) for name, wave in waves.items()}
        chain = self._recipe.chain
        if chain is not None and set(chain.joints) <= set(told):
            angles = np.stack([told[name] for name in chain.joints], axis=-1)
            told[chain.x], told[chain.y] = chain.place(angles)
        return np.stack([told[name] for name in self._recipe.tracked])

    def beginnings(self) -> dict[str, tuple[Floats, Floats]]:
        return self._starts

    def wanted(self, step: int, positions: Floats) -> Wanted:
        targets = self._targets[step]
        if self._planner is None:
            return Wanted(targets)
        part = self._grid[:, :, step : step + self._planner.reach]
        forces, ways = self._planner.plan(positions[:, self._at], part)
        self._planned = forces[:, :, 1]  # for the end of the period that now begins
        ahead = [round(at / self._recipe.period_s) for at in self._recipe.preview_s]
        return Wanted(targets, forces[:, :, ahead], ways[:, :, ahead])

    def judge(self, step: int, now: Motion) -> Outcome:
        g = self._goal
        off = self._targets[step, :, :, 0] - now.positions[:, self._at]
        error = np.sqrt((off**2).sum(axis=1))
        reward = np.zeros(len(error))
        if g.reward is not None:
            reward += g.reward.of(np.sqrt(((off / self._span) ** 2).sum(axis=1)))
        if g.force_reward is not None:
            missed = (self._planned - now.forces_n) / self._force_span
            reward += g.force_reward.of(missed).sum(axis=1)
        ended = ~_inside(now.positions, self._within)
        success = (error <= g.near) & _inside(now.positions, self._upright) & ~ended
        return Outcome(reward, ended, error, success)


class Push(Settings):
    """Pushing with forces that change at random while pistons are led about at random.

    Neither has anything to do with the other, nor with a robot (thesis 9.2.5, the third way to
    train a hybrid's low level).

    Attributes:
        kind: ``push``.
        forces_n: Lowest and highest force of the gas by cylinder.
        force_kinds: Kinds of its course; each episode draws one.
        force_period_s: Least and most typical time between its extremes, s.
        ways: Lowest and highest extension, over the stroke.
        way_kinds: Kinds of its course.
        way_period_s: Least and most typical time between its extremes, s.
        jitter: Share of periods by which corners of jagged courses are moved.
        reward: The reward, of the error in the recipe's span of forces.
        near: Force error that is a success, N.
        unit: What errors are told in, and how much one of it is.
        mark: Error at which the goal is called learned, in that unit.
    """

    kind: Literal["push"] = "push"
    forces_n: dict[str, Span]
    force_kinds: Kinds = ("smooth", "jagged")
    force_period_s: Range = (0.2, 0.6)
    ways: Span = (0.1, 0.9)
    way_kinds: Kinds = ("smooth", "jagged")
    way_period_s: Range = (0.3, 1.0)
    jitter: float = 0.6
    reward: Reward = Reward()
    near: Annotated[float, Field(gt=0.0)] = 5.0
    unit: Annotated[tuple[str, float], Listed] = ("N", 1.0)
    mark: Annotated[float, Field(gt=0.0)] = 10.0

    def needs(self, recipe: RobotRecipe) -> str:
        """An objection to a recipe; empty where there is none.

        Args:
            recipe: The recipe.
        """
        if recipe.see_motion or (recipe.tracked and recipe.see_target):
            return "recipe.see_motion, see_target: found true, goal push leads pistons, no joints"
        for name in recipe.forces:
            if name not in self.forces_n:
                return f"goal.forces_n: found none for {name!r}"
        return "" if recipe.forces else "recipe.forces: found none, goal push needs one at least"

    def aim(self, recipe: RobotRecipe, rig: Rig, count: int, horizon: int) -> Aim:
        """The goal of robots side by side.

        Args:
            recipe: What policies see.
            rig: The rig, as whoever plans knows it.
            count: How many.
            horizon: Control periods of an episode.
        """
        del rig
        return _Pushing(self, recipe, count, horizon)


class _Pushing(Aim):
    def __init__(self, goal: Push, recipe: RobotRecipe, count: int, horizon: int) -> None:
        self._goal, self._recipe, self._count = goal, recipe, count
        h = recipe.period_s
        self._times = np.arange(horizon + 1)[:, None] * h + np.array(recipe.preview_s)
        shape = (horizon + 1, count, len(recipe.forces), len(recipe.preview_s))
        self._forces, self._ways = np.zeros(shape), np.zeros(shape)
        self._span = np.array([push.span_n for push in recipe.forces.values()])

    def begin(self, rng: np.random.Generator) -> None:
        g, shape = self._goal, (self._count, len(self._recipe.forces), 2)
        kinds = rng.integers(1_000_000, size=shape)
        seeds = rng.integers(2**31, size=shape)
        shares, begins = rng.uniform(size=shape), rng.uniform(0.0, LONGEST_S, shape)
        for c, name in enumerate(self._recipe.forces):
            courses = (
                (self._forces, g.force_kinds, g.force_period_s, g.forces_n[name]),
                (self._ways, g.way_kinds, g.way_period_s, g.ways),
            )
            for k, (into, of, (short, long), span) in enumerate(courses):
                for j in range(self._count):
                    at = (j, c, k)
                    wave = Wave(
                        of[int(kinds[at]) % len(of)], *span,
                        short + float(shares[at]) * (long - short), int(seeds[at]), jitter=g.jitter,
                    )  # fmt: skip
                    into[:, j, c] = wave.at(begins[at] + self._times)

    def wanted(self, step: int, positions: Floats) -> Wanted:
        del positions
        return Wanted(None, self._forces[step], self._ways[step])

    def ways(self, step: int) -> Floats:
        return self._ways[step, :, :, 0]

    def judge(self, step: int, now: Motion) -> Outcome:
        off = self._forces[step, :, :, 0] - now.forces_n
        error = np.sqrt((off**2).mean(axis=1))
        reward = self._goal.reward.of(off / self._span).sum(axis=1)
        return Outcome(reward, np.zeros(len(error), bool), error, error <= self._goal.near)


class SwingUp(Settings):
    """Swinging a pole up and holding it there, the cart in the middle of its rail.

    The reward is the thesis' alpha |1 - x|^2 + beta |pi - theta| - gamma log|e| - delta, with x the
    way from the middle over half of the rail and theta the pole's angle from upright, which is its
    error e; an episode ends where the cart comes to an end of the rail.

    Attributes:
        kind: ``swing_up``.
        cart: Encoder of the cart.
        pole: Encoder of the pole, 0 upright.
        rail_m: Where the rail begins and ends.
        alpha: Weight of the middle.
        beta: Weight of the height.
        gamma: Weight of the logarithm.
        delta: What is taken off.
        near: Angle from upright that is a success, rad.
        slow: Angular speed below which it is one, rad/s.
        unit: What errors are told in, and how much one of it is.
        mark: Error at which the goal is called learned, in that unit.
    """

    kind: Literal["swing_up"] = "swing_up"
    cart: str
    pole: str
    rail_m: Span
    alpha: float = 0.5
    beta: float = 0.5
    gamma: float = 0.25
    delta: float = 0.0
    near: Annotated[float, Field(gt=0.0)] = math.radians(3.0)
    slow: Annotated[float, Field(gt=0.0)] = 0.5
    unit: Annotated[tuple[str, float], Listed] = ("degrees", math.pi / 180.0)
    mark: Annotated[float, Field(gt=0.0)] = 30.0

    def needs(self, recipe: RobotRecipe) -> str:
        """An objection to a recipe; empty where there is none.

        Args:
            recipe: The recipe.
        """
        if recipe.tracked:
            return f"recipe.tracked: found {', '.join(recipe.tracked)}, goal swing_up has none"
        return _unknown("cart, pole", (self.cart, self.pole), recipe)

    def aim(self, recipe: RobotRecipe, rig: Rig, count: int, horizon: int) -> Aim:
        """The goal of robots side by side.

        Args:
            recipe: What policies see.
            rig: The rig, as whoever plans knows it.
            count: How many.
            horizon: Control periods of an episode.
        """
        del rig, count, horizon
        names = list(recipe.encoders)
        return _SwingingUp(self, names.index(self.cart), names.index(self.pole))


class _SwingingUp(Aim):
    def __init__(self, goal: SwingUp, cart: int, pole: int) -> None:
        self._goal, self._cart, self._pole = goal, cart, pole

    def begin(self, rng: np.random.Generator) -> None:
        del rng

    def judge(self, step: int, now: Motion) -> Outcome:
        del step
        g, positions, speeds = self._goal, now.positions, now.speeds
        low, high = g.rail_m
        x = np.abs(positions[:, self._cart] - 0.5 * (low + high)) / (0.5 * (high - low))
        theta = np.abs((positions[:, self._pole] + math.pi) % (2.0 * math.pi) - math.pi)
        reward = (
            g.alpha * (1.0 - np.minimum(x, 1.0)) ** 2
            + g.beta * (math.pi - theta)
            - g.gamma * np.log(np.maximum(theta, FLOOR_RAD))
            - g.delta
        )
        success = (theta <= g.near) & (np.abs(speeds[:, self._pole]) <= g.slow)
        return Outcome(reward, x >= 1.0, theta, success)


class Walk(Settings):
    """Going forward; the reward is the speed.

    Attributes:
        kind: ``walk``.
        forward: Encoder of the way.
        within: Encoders that end an episode where they leave a range (a torso that falls over).
        fast_m_s: Speed that is a success.
        unit: What errors, the speed that is short of that, are told in, and how much one of it is.
        mark: Error at which the goal is called learned, in that unit.
    """

    kind: Literal["walk"] = "walk"
    forward: str
    within: dict[str, Span] = Field(default_factory=dict)
    fast_m_s: Annotated[float, Field(gt=0.0)] = 0.5
    unit: Annotated[tuple[str, float], Listed] = ("m/s", 1.0)
    mark: Annotated[float, Field(gt=0.0)] = 0.1

    def needs(self, recipe: RobotRecipe) -> str:
        """An objection to a recipe; empty where there is none.

        Args:
            recipe: The recipe.
        """
        if recipe.tracked:
            return f"recipe.tracked: found {', '.join(recipe.tracked)}, goal walk has none"
        return _unknown("forward, within", (self.forward, *self.within), recipe)

    def aim(self, recipe: RobotRecipe, rig: Rig, count: int, horizon: int) -> Aim:
        """The goal of robots side by side.

        Args:
            recipe: What policies see.
            rig: The rig, as whoever plans knows it.
            count: How many.
            horizon: Control periods of an episode.
        """
        del rig, count, horizon
        return _Walking(self, list(recipe.encoders), recipe.period_s)


class _Walking(Aim):
    def __init__(self, goal: Walk, names: list[str], period_s: float) -> None:
        self._goal, self._period_s = goal, period_s
        self._forward = names.index(goal.forward)
        self._within = _bounds(goal.within, names)
        self._before: Floats | None = None

    def begin(self, rng: np.random.Generator) -> None:
        del rng
        self._before = None

    def judge(self, step: int, now: Motion) -> Outcome:
        del step
        g = self._goal
        place = now.positions[:, self._forward]
        # Over the whole period: what counts is the way, and that is its sum.
        if self._before is None:
            speed = now.speeds[:, self._forward]
        else:
            speed = (place - self._before) / self._period_s
        self._before = place.copy()
        ended = ~_inside(now.positions, self._within)
        short = np.maximum(g.fast_m_s - speed, 0.0)
        return Outcome(speed, ended, short, (speed >= g.fast_m_s) & ~ended)


Goal = Annotated[Track | Push | SwingUp | Walk, Field(discriminator="kind")]
"""What a robot is to do; ``kind`` tells which."""


def _unknown(what: str, names: Iterable[str], recipe: RobotRecipe) -> str:
    for name in names:
        if name not in recipe.encoders:
            known = ", ".join(recipe.encoders)
            return f"goal.{what}: found {name!r}, recipe.encoders has {known}"
    return ""


def _bounds(ranges: dict[str, Span], names: list[str]) -> list[tuple[int, float, float]]:
    return [(names.index(name), *span) for name, span in ranges.items()]


def _inside(positions: Floats, bounds: list[tuple[int, float, float]]) -> Flags:
    inside = np.ones(len(positions), dtype=bool)
    for at, low, high in bounds:
        inside &= (positions[:, at] >= low) & (positions[:, at] <= high)
    return inside
