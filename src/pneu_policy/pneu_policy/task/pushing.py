# SPDX-License-Identifier: Apache-2.0
"""The task of thesis 2.9: arms push a thing along a path on a plane, many plants side by side.

Each plant is MuJoCo's model of a hand file with values of its own, drawn once (an ensemble), or
all have the same. Motors are damped as by the bridge of real arms; actions take effect late by a
delay of the episode, and the thing is seen with the noise of motion capture.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Annotated, Any, ClassVar, Literal, Self

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from pydantic import Field, model_validator

from pneu_common.errors import InputError
from pneu_common.validation import Listed, Settings
from pneu_policy.control.push import PushObserver, PushRecipe
from pneu_policy.task.push_paths import PATH_KINDS, PathKind, PushPath
from pneu_policy.task.ranges import DelayRange, Range, Seed
from pneu_policy.task.task_env import TaskEnv
from pneu_sim.hand.loading import Hand
from pneu_sim.hand.reach import Reach
from pneu_sim.hand.truth import Change, Truth
from pneu_sim.mechanism.loading import mujoco_module

Floats = NDArray[np.float64]

Positive = Annotated[float, Field(gt=0.0)]
PathKinds = Annotated[tuple[PathKind, ...], Listed, Field(min_length=1)]


class Drawn(Settings):
    """A value of the MJCF that plants differ in.

    Attributes:
        of: Element.
        name: Its name.
        set: Which value.
        times: It is multiplied by something between these, evenly by its logarithm.
    """

    of: Literal["geom", "joint", "tendon"]
    name: str
    set: str
    times: Range

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if self.times[0] <= 0.0:
            raise ValueError(f"times: found {self.times[0]:g}, allowed is more than 0")
        return self


class PushReward(Settings):
    """Reward of a control period.

    Attributes:
        off: Lost for each 20 mm that the thing is off its path.
        log: Lost for each doubling of that, down to `floor_m`.
        floor_m: Smaller errors earn no more.
        near: Lost for each 50 mm between a tip and the thing, in the mean of tips.
        effort: Lost for the mean square of actions.
        offset: Added.
    """

    off: float = 1.0
    log: float = 0.2
    floor_m: Positive = 0.001
    near: float = 0.2
    effort: float = 0.02
    offset: float = 0.0


class PushSettings(Settings):
    """What is trained on.

    Attributes:
        task: Which task this is.
        hand: Hand file.
        thing: Body that is pushed; a pose of the hand file.
        recipe: What the policy sees and does.
        num_envs: Plants side by side.
        horizon: Control periods of an episode.
        kinds: Kinds of path; each episode draws one.
        reach_m: Furthest that paths go.
        path_period_s: Least and most time of a round, or of the quickest sine of what wanders.
        model: Values of the MJCF that are others in all plants, such as identified ones.
        drawn: Values that plants differ in; none for a single model.
        physics_step_s: Step of MuJoCo, which divides the control period.
        delay_s: Least and most delay of actions; each episode draws one.
        start_m: The thing begins within so much of the path's beginning.
        reward: The reward.
        seed: Seed of what is drawn.
        threads: Plants that move at a time; 0 takes as many as there are cores.
        unit: What errors are told in, and how much one of it is.
        mark: Error at which the task is called learned, in that unit.
    """

    unit: ClassVar[tuple[str, float]] = ("mm", 1e-3)
    mark: ClassVar[float] = 5.0

    task: Literal["push"] = "push"
    hand: str
    thing: str = "object"
    recipe: PushRecipe = PushRecipe()
    num_envs: Annotated[int, Field(ge=1, le=100_000)] = 64
    horizon: Annotated[int, Field(ge=1, le=1_000_000)] = 250
    kinds: PathKinds = PATH_KINDS
    reach_m: Positive = 0.03
    path_period_s: Range = (4.0, 8.0)
    model: Annotated[tuple[Change, ...], Listed] = ()
    drawn: Annotated[tuple[Drawn, ...], Listed] = ()
    physics_step_s: Positive = 0.002
    delay_s: DelayRange = (0.0, 0.01)
    start_m: Annotated[float, Field(ge=0.0)] = 0.003
    reward: PushReward = PushReward()
    seed: Seed = 0
    threads: Annotated[int, Field(ge=0, le=256)] = 0

    @property
    def file(self) -> str:
        """File of the plant."""
        return self.hand


class Pushing(TaskEnv):
    """Plants side by side, each with a path of its own; all episodes end together.

    Observations are those of the recipe as (num_envs, size) float32, actions lie within -1 and 1.
    The ``info`` of a step holds ``error`` (num_envs,), how far the thing is off its path, m, at
    the end of the period, and ``thing_m`` and ``path_m``, (num_envs, 2).

    Attributes:
        settings: What it was made of.
        hand: The hand.
        models: MuJoCo's, of each plant.
    """

    unit = PushSettings.unit
    mark = PushSettings.mark

    def __init__(self, settings: PushSettings) -> None:
        """Builds the plants.

        Args:
            settings: What is trained on.

        Raises:
            InputError: A file or a value is wrong.
        """
        s = self.settings = settings
        self.hand = Hand(s.hand)
        if s.thing not in self.hand.settings.poses:
            known = ", ".join(self.hand.settings.poses) or "none"
            raise InputError(f"thing: found {s.thing!r}, poses of {s.hand} are {known}")
        self._mujoco = mujoco_module()
        self._reach = Reach(self.hand)
        steps = s.recipe.period_s / s.physics_step_s
        if abs(steps - round(steps)) > 1e-6 * steps:
            raise InputError(
                f"physics_step_s: found {s.physics_step_s:g}, the control period of"
                f" {s.recipe.period_s:g} s must be a whole multiple of it"
            )
        self._steps = round(steps)
        rng = np.random.default_rng([s.seed, 0x705])
        self.models = [self._model(rng) for _ in range(s.num_envs)] if s.drawn else []
        if not s.drawn:
            self.models = [self._model(rng)] * s.num_envs
        self._plants = [self._mujoco.MjData(model) for model in self.models]
        pose = self.hand.settings.poses[s.thing]
        model = self.models[0]
        self._body = int(model.sensor_objid[model.sensor(pose.position).id])
        if int(model.body_jntnum[self._body]) != 1 or int(
            model.jnt_type[model.body_jntadr[self._body]]
        ) != int(self._mujoco.mjtJoint.mjJNT_FREE):
            raise InputError(f"{self.hand.mjcf}: {s.thing}: what is pushed needs a free joint")
        self._free = int(model.jnt_qposadr[model.body_jntadr[self._body]])
        self._noise_m = pose.noise_m
        arms = list(self.hand.settings.arms.values())
        self._limits = np.array([[j.torque_limit_n_m for j in a.joints.values()] for a in arms])
        count = len(arms)
        self._observer = PushObserver(s.recipe, count, s.num_envs)
        self.num_envs = s.num_envs
        size = s.recipe.size(count)
        self.single_observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32)
        self.single_action_space = gymnasium.spaces.Box(-1.0, 1.0, (2 * count,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, s.num_envs)
        self.action_space = batch_space(self.single_action_space, s.num_envs)
        self.metadata = {"autoreset_mode": AutoresetMode.DISABLED}
        workers = s.threads or os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(workers) if workers > 1 else None
        self._parts: Sequence[NDArray[np.int64]] = np.array_split(np.arange(s.num_envs), workers)
        self._late = np.zeros(s.num_envs, dtype=int)
        self._rng = np.random.default_rng(s.seed)
        self._step = -1
        self._path_m = np.zeros((s.num_envs, s.horizon + 1, len(s.recipe.preview_s), 2))

    @property
    def period_s(self) -> float:
        """Control period, s."""
        return self.settings.recipe.period_s

    def _model(self, rng: np.random.Generator) -> Any:
        """A plant's model, with values of its own and the damping that motors close."""
        s = self.settings
        own = [
            Change(
                of=d.of, name=d.name, set=d.set, times=float(np.exp(rng.uniform(*np.log(d.times))))
            )
            for d in s.drawn
        ]
        spec = self.hand.spec()
        Truth(model=s.model).put(spec, "model")
        Truth(model=tuple(own)).put(spec, "drawn")
        spec.option.timestep = s.physics_step_s
        model = spec.compile()
        joint_kind = int(self._mujoco.mjtTrn.mjTRN_JOINT)
        for arm in self.hand.settings.arms.values():
            for joint in arm.joints.values():
                motor = model.actuator(joint.motor).id
                target = int(model.actuator_trnid[motor, 0])
                by = joint.damping_n_m_s_rad
                if int(model.actuator_trntype[motor]) == joint_kind:
                    model.dof_damping[model.jnt_dofadr[target]] += by
                else:
                    model.tendon_damping[target] += by
        return model

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
        s = self.settings
        if isinstance(seed, list):
            raise InputError("seed: found a list, one seed decides all episodes")
        if seed is not None:
            self._rng = np.random.default_rng([s.seed, int(seed)])
        rng, n = self._rng, s.num_envs
        times = np.arange(s.horizon + 1)[:, None] * self.period_s + np.array(s.recipe.preview_s)
        kinds = rng.integers(len(s.kinds), size=n)
        numbers, periods = rng.integers(2**31, size=n), rng.uniform(*s.path_period_s, n)
        for k in range(n):
            kind = s.kinds[int(kinds[k])]
            path = PushPath(kind, s.reach_m, float(periods[k]), int(numbers[k]))
            self._path_m[k] = path.at(times)
        self._late = np.round(rng.uniform(*s.delay_s, n) / s.physics_step_s).astype(int)
        self._late = np.minimum(self._late, self._steps)
        angles = rng.uniform(-0.1, 0.1, (n, *self._reach.motors.shape))
        begin = rng.uniform(-s.start_m, s.start_m, (n, 2))
        for k, (model, data) in enumerate(zip(self.models, self._plants, strict=True)):
            self._mujoco.mj_resetData(model, data)
            self._reach.put(data, angles[k])
            data.qpos[self._free : self._free + 2] += begin[k]
            self._mujoco.mj_kinematics(model, data)
        self._observer.reset()
        self._step = 0
        return self._observe(), {}

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[NDArray[np.float32], Floats, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Advances all plants by a control period.

        Args:
            actions: (num_envs, 2 arms), cut off at -1 and 1.

        Returns:
            Observations, rewards, terminations (none), truncations (all, at the horizon), ``info``.
        """
        s = self.settings
        if self._step < 0 or self._step >= s.horizon:
            raise gymnasium.error.ResetNeeded("the episodes are over; reset begins new ones")
        action = np.asarray(actions, dtype=np.float64)
        force = s.recipe.forces(action, self._tips, self._reach.home_m)
        torque = np.einsum("paij,pai->paj", self._slope, force)
        torque = np.clip(torque, -self._limits, self._limits)
        self._move(torque)
        self._observer.acted(action)
        self._step += 1
        observation = self._observe()
        path = self._path_m[:, self._step, 0]
        error = np.linalg.norm(path - self._thing, axis=1)
        r = s.reward
        gap = np.linalg.norm(self._tips[..., :2] - self._thing[:, None, :], axis=-1)
        reward = (
            r.offset
            - r.off * error / 0.02
            - r.log * np.log2(np.maximum(error, r.floor_m) / r.floor_m)
            - r.near * np.mean(gap, axis=1) / 0.05
            - r.effort * np.mean(np.clip(action, -1.0, 1.0) ** 2, axis=1)
        )
        done = np.full(s.num_envs, self._step == s.horizon)
        info = {"error": error, "thing_m": self._thing.copy(), "path_m": path.copy()}
        return observation, reward, np.zeros(s.num_envs, dtype=bool), done, info

    def _move(self, torque_n_m: Floats) -> None:
        def some(part: NDArray[np.int64]) -> None:
            for k in part:
                model, data, late = self.models[k], self._plants[k], int(self._late[k])
                if late:
                    self._mujoco.mj_step(model, data, late)
                data.ctrl[self._reach.motors] = torque_n_m[k]
                if late < self._steps:
                    self._mujoco.mj_step(model, data, self._steps - late)
                self._mujoco.mj_kinematics(model, data)

        if self._pool is None:
            some(np.arange(self.num_envs))
        else:
            list(self._pool.map(some, self._parts))

    def _observe(self) -> NDArray[np.float32]:
        self._tips, speed, self._slope = self._reach.tips(self._plants)
        self._thing = np.array([data.xpos[self._body, :2] for data in self._plants])
        seen = self._thing + self._noise_m * self._rng.normal(size=self._thing.shape)
        return self._observer.observe(self._tips, speed, seen, self._path_m[:, self._step]).astype(
            np.float32
        )

    def close(self, **kwargs: Any) -> None:
        """Ends the threads.

        Args:
            **kwargs: Not used.
        """
        if self._pool is not None:
            self._pool.shutdown()
