# SPDX-License-Identifier: Apache-2.0
"""The task that policies are trained on: a pressure at a tap shall follow a random target.

Many rigs side by side as a gymnasium vector environment. The reward is that of thesis 7.1, its
logarithm floored (thesis 9.2.1): -alpha |e| - beta log(max(|e|, floor)) + offset.
"""

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from pydantic import Field

from pneu_common.errors import InputError
from pneu_common.validation import Settings
from pneu_policy.control.followed import Followed, FollowedSettings
from pneu_policy.control.observations import Observer, Recipe
from pneu_policy.task.ensembles import draw_rigs
from pneu_policy.task.plants import ControlPlant
from pneu_policy.task.ranges import DelayRange, Kinds, Range, Seed
from pneu_policy.task.reward import Reward
from pneu_policy.task.targets import Target
from pneu_policy.task.task_env import TaskEnv
from pneu_sim.rig.load import load_rig
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]

LONGEST_S = 60.0
"""Targets begin within this time of their own start, so that few episodes are alike."""


class EnvSettings(Settings):
    """What is trained on.

    Attributes:
        task: Which task this is.
        rig: Rig file; its ``model`` decides between the full and a lumped one.
        recipe: What the policy sees.
        num_envs: Rigs side by side.
        horizon: Control periods of an episode.
        kinds: Kinds of target; each episode draws one.
        low_pa: Lowest target, Pa.
        high_pa: Highest target, Pa.
        target_period_s: Least and most typical time between a target's extremes, s.
        jitter: Share of that by which corners of jagged targets are moved.
        dx_m: Cell length that replaces the rig's, m; None is the rig's own.
        physics_step_s: Time step that the control period must be a multiple of, s; None takes the
            longest stable one that divides it.
        spread: Rigs are drawn by this many standard errors of the calibration; 0 takes it as is.
        delay_s: Least and most delay of commands, s; each episode draws one.
        noise_pa: Noise of the readings, one sigma, Pa; None is that of the rig's sensors.
        start_error_pa: An episode starts within this of its target, Pa.
        reward: The reward.
        seed: Seed of the drawn rigs.
        virtual: What is seen is what an observer of the rig as its file has it tells, by these taps
            alone: so a policy does that runs with virtual ones. None sees all there is.
        unit: What errors are told in, and how much one of it is.
        mark: Error at which the task is called learned, in that unit.
    """

    unit: ClassVar[tuple[str, float]] = ("atm", 101_325.0)
    mark: ClassVar[float] = 0.1

    task: Literal["pressure"] = "pressure"
    rig: str
    recipe: Recipe
    num_envs: Annotated[int, Field(ge=1, le=100_000)] = 64
    horizon: Annotated[int, Field(ge=1, le=1_000_000)] = 200
    kinds: Kinds = ("smooth", "jagged")
    low_pa: float = 150e3
    high_pa: float = 550e3
    target_period_s: Range = (0.3, 0.3)
    jitter: float = 0.6
    dx_m: float | None = None
    physics_step_s: float | None = None
    spread: float = 1.0
    delay_s: DelayRange = (0.002, 0.01)
    noise_pa: Annotated[float, Field(ge=0.0, lt=1e6)] | None = None
    start_error_pa: Annotated[float, Field(ge=0.0, lt=1e6)] = 20e3
    reward: Reward = Reward()
    seed: Seed = 0
    virtual: FollowedSettings | None = None

    @property
    def file(self) -> str:
        """File of the plant."""
        return self.rig


class PressureTracking(TaskEnv):
    """Rigs side by side, each after a target of its own; all episodes end together.

    Observations are those of the recipe as (num_envs, size) float32, actions lie within -1 and 1.
    The ``info`` of a step holds ``error``, Pa, ``pressure_pa``, ``target_pa`` and ``volts``, each
    (num_envs,), at the end of the period.

    Attributes:
        settings: What it was made of.
        rig: The rig as its file has it.
        plant: The plant.
    """

    unit = EnvSettings.unit
    mark = EnvSettings.mark

    def __init__(self, settings: EnvSettings, rig: Rig | None = None) -> None:
        """Builds the rigs.

        Args:
            settings: What is trained on.
            rig: The rig itself, where it is at hand; None reads the file.

        Raises:
            InputError: The rig does not fit the recipe, or the control period the physics step.
        """
        s, r = settings, settings.recipe
        self.settings = s
        self.rig = load_rig(Path(s.rig)) if rig is None else rig
        missing = [tap for tap in r.taps if tap not in self.rig.taps]
        if missing:
            raise InputError(
                f"recipe.taps: found {missing[0]!r}, rig {self.rig.name!r} has"
                f" {', '.join(self.rig.taps)}"
            )
        rigs = draw_rigs(self.rig, s.num_envs, s.seed, s.spread)
        self.plant = ControlPlant(rigs, r.period_s, s.dx_m)
        _check_step(s, self.plant)
        if r.line:
            self.plant.reset(s.low_pa)
            self.plant.line(r.line)  # raises where there is no such line
        self._seen = [self.plant.taps.index(tap) for tap in r.taps]
        self._controlled = self.plant.taps.index(r.tap)
        taps = [self.rig.taps[tap] for tap in r.taps]
        self._noise = np.array([t.noise_pa if s.noise_pa is None else s.noise_pa for t in taps])
        self._observer = Observer(r, s.num_envs)
        self._followed: list[Followed] = []
        if s.virtual is not None:
            unseen = [tap for tap in s.virtual.taps if tap not in r.taps]
            if unseen:
                raise InputError(
                    f"virtual.taps: found {unseen[0]!r}, the recipe has {', '.join(r.taps)}"
                )
            each = [s.virtual.seeded(n) for n in range(s.num_envs)]
            self._followed = [Followed(self.rig, one, r.period_s) for one in each]
        self.num_envs = s.num_envs
        self.single_observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (r.size,), np.float32)
        self.single_action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, s.num_envs)
        self.action_space = batch_space(self.single_action_space, s.num_envs)
        self.metadata = {"autoreset_mode": AutoresetMode.DISABLED}
        self._step = 0
        self._targets = np.zeros((s.horizon + 1, s.num_envs, len(r.preview_s)))
        self._rng = np.random.default_rng(s.seed)
        self._started = False

    @property
    def period_s(self) -> float:
        """Control period, s."""
        return self.settings.recipe.period_s

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begins new episodes.

        Args:
            seed: Decides all that is drawn; None goes on from the last.
            options: Not used.

        Returns:
            Observations and an empty ``info``.
        """
        s, r = self.settings, self.settings.recipe
        if isinstance(seed, list):
            raise InputError("seed: found a list, one seed decides all episodes")
        if seed is not None:
            self._rng = np.random.default_rng([s.seed, int(seed)])
        rng, n = self._rng, s.num_envs
        kinds = rng.integers(len(s.kinds), size=n)
        periods = rng.uniform(*s.target_period_s, n)
        seeds = rng.integers(2**31, size=n)
        begins = rng.uniform(0.0, LONGEST_S, n)
        times = np.arange(s.horizon + 1)[:, None] * r.period_s + np.array(r.preview_s)
        for j in range(n):
            target = Target(
                s.kinds[int(kinds[j])], s.low_pa, s.high_pa, float(periods[j]), int(seeds[j]),
                jitter=s.jitter,
            )  # fmt: skip
            self._targets[:, j] = target.at(begins[j] + times)
        self.plant.set_delay(rng.uniform(*s.delay_s, n))
        away = rng.uniform(-s.start_error_pa, s.start_error_pa, n)
        self.plant.reset(np.clip(self._targets[0, :, 0] + away, s.low_pa, s.high_pa))
        self._observer.reset()
        for one in self._followed:
            one.reset()
        self._step = 0
        self._started = True
        return self._observe(), {}

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[NDArray[np.float32], Floats, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Advances all rigs by a control period.

        Args:
            actions: (num_envs, 1), cut off at -1 and 1.

        Returns:
            Observations, rewards, terminations (none), truncations (all, at the horizon), ``info``.
        """
        if not self._started:
            raise gymnasium.error.ResetNeeded("step was called before reset")
        if self._step >= self.settings.horizon:
            raise gymnasium.error.ResetNeeded("the episodes are over; reset begins new ones")
        r = self.settings.recipe
        volts = r.volts(np.asarray(actions, dtype=np.float64).reshape(self.num_envs))
        self.plant.step(volts)
        self._observer.acted(volts)
        for one, v in zip(self._followed, volts.tolist(), strict=False):
            one.acted(v)
        self._step += 1
        observation = self._observe()
        pressure = self._readings[:, self._controlled]
        target = self._targets[self._step, :, 0]
        error = target - pressure
        done = np.full(self.num_envs, self._step == self.settings.horizon)
        info = {
            "error": error,
            "pressure_pa": pressure,
            "target_pa": target.copy(),
            "volts": volts,
        }
        reward = self.settings.reward.of(error / r.span_pa)
        return observation, reward, np.zeros(self.num_envs, dtype=bool), done, info

    def _observe(self) -> NDArray[np.float32]:
        r = self.settings.recipe
        self._readings = self.plant.readings()
        seen = self._readings[:, self._seen]
        seen = seen + self._noise * self._rng.normal(size=seen.shape)
        line = None
        if self._followed:
            seen, line = self._through_observers(seen)
        elif r.line:
            line = self.plant.line(r.line)
        return self._observer.observe(seen, self._targets[self._step], line).astype(np.float32)

    def _through_observers(self, seen: Floats) -> tuple[Floats, Floats | None]:
        """What observers make of readings: all taps, and the gas of the lines where it is seen."""
        r = self.settings.recipe
        told = np.empty_like(seen)
        for n, one in enumerate(self._followed):
            shown = one.look(dict(zip(r.taps, seen[n].tolist(), strict=True)))
            told[n] = [shown[tap] for tap in r.taps]
        if not r.line:
            return told, None
        return told, np.concatenate([one.line(r.line) for one in self._followed])


def _check_step(settings: EnvSettings, plant: ControlPlant) -> None:
    """Raises InputError unless the control period is a whole number of physics steps."""
    asked = settings.physics_step_s
    if asked is None:
        return
    period_s = settings.recipe.period_s
    ratio = period_s / asked
    if abs(ratio - round(ratio)) > 1e-6 * ratio or round(ratio) < 1:
        raise InputError(
            f"physics_step_s: found {asked:g}, the control period of {period_s:g} s must be a whole"
            " multiple of it"
        )
    longest = plant.step_s
    if asked > longest * (1.0 + 1e-9):
        raise InputError(
            f"physics_step_s: found {asked:g}, stable is up to {longest:.3g} s with these cells"
        )
    plant.set_step(asked)
