# SPDX-License-Identifier: Apache-2.0
"""Robots that cylinders move as environments: one for every rig file (thesis chapter 7).

Many side by side as a gymnasium vector environment. Where an episode ends before the horizon, its
robot earns nothing from then on and is flagged as terminated; all begin anew together.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from pydantic import Field

from pneu_common.errors import InputError
from pneu_common.validation import Settings
from pneu_policy.control.robot_recipe import Moment, RobotObserver, RobotRecipe
from pneu_policy.task.ensembles import draw_rigs
from pneu_policy.task.goals import Goal, Motion, Span, Wanted
from pneu_policy.task.plants import RobotPlant
from pneu_policy.task.ranges import DelayRange, Range, Seed
from pneu_policy.task.task_env import TaskEnv
from pneu_sim.rig.load import load_rig
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]


class RobotSettings(Settings):
    """What is trained on.

    Attributes:
        task: Which task this is.
        rig: Rig file.
        model: Kind of model in place of the file's, such as ``thin_plate``.
        recipe: What the policy sees and does.
        goal: What it is to do.
        num_envs: Robots side by side.
        horizon: Control periods of an episode at most.
        dx_m: Cell length that replaces the rig's, m; None is the rig's own.
        spread: Rigs are drawn by this many standard errors of the calibration; 0 takes it as is.
        delay_s: Least and most delay of commands, s; each episode draws one.
        noise_pa: Noise of pressures, one sigma, Pa; None is that of the rig's sensors.
        noise_position: Noise of encoders, one sigma, rad or m; None is that of the rig's sensors.
        start: Lowest and highest position by joint at the start; others stand where the rig says.
        start_speed: Lowest and highest velocity by joint likewise; others rest.
        on_target: Whether what is tracked starts on its target and moves with it.
        start_pa: Least and most pressure behind the valves at the start, Pa.
        seed: Seed of the drawn rigs.
    """

    task: Literal["robot"]
    rig: str
    model: str | None = None
    recipe: RobotRecipe
    goal: Goal
    num_envs: Annotated[int, Field(ge=1, le=100_000)] = 64
    horizon: Annotated[int, Field(ge=1, le=1_000_000)] = 200
    dx_m: float | None = None
    spread: float = 0.0
    delay_s: DelayRange = (0.0, 0.0)
    noise_pa: Annotated[float, Field(ge=0.0)] | None = None
    noise_position: Annotated[float, Field(ge=0.0)] | None = None
    start: dict[str, Span] = Field(default_factory=dict)
    start_speed: dict[str, Span] = Field(default_factory=dict)
    on_target: bool = False
    start_pa: Range = (3.0e5, 4.0e5)
    seed: Seed = 0

    @property
    def unit(self) -> tuple[str, float]:
        """What errors are told in, and how much one of it is."""
        return self.goal.unit

    @property
    def mark(self) -> float:
        """Error at which the task is called learned, in that unit."""
        return self.goal.mark

    @property
    def file(self) -> str:
        """File of the plant."""
        return self.rig


class Robots(TaskEnv):
    """Robots side by side, each after a goal of its own.

    Observations are those of the recipe as (num_envs, size) float32, actions lie within -1 and 1.
    The ``info`` of a step holds ``error``, SI, ``success``, ``position`` (num_envs, encoders) and,
    where there are any, ``target`` (num_envs, tracked).

    Attributes:
        settings: What it was made of.
        rig: The rig as its file has it, by the model that was asked for.
        recipe: What policies see, with what the rig says of its cylinders.
        plant: The plant.
    """

    def __init__(self, settings: RobotSettings, rig: Rig | None = None) -> None:
        """Builds the rigs.

        Args:
            settings: What is trained on.
            rig: The rig itself, where it is at hand; None reads the file.

        Raises:
            InputError: The rig does not fit the recipe, or the recipe the goal.
        """
        s, r = settings, settings.recipe
        self.settings = s
        self.unit, self.mark = s.unit, s.mark
        rig = load_rig(Path(s.rig)) if rig is None else rig
        self.rig = rig if s.model is None else rig.model_copy(update={"model": s.model})
        objection = s.goal.needs(r) or _misfit(self.rig, r)
        if objection:
            raise InputError(objection)
        r = self.recipe = r.of_rig(self.rig)
        rigs = draw_rigs(self.rig, s.num_envs, s.seed, s.spread)
        self._leads = s.goal.kind == "push"
        if self._leads:
            rigs = [_led(one) for one in rigs]
        self.plant = RobotPlant(rigs, r.period_s, s.dx_m)
        for name in (*s.start, *s.start_speed):
            if name not in self.plant.joints:
                raise InputError(
                    f"start: found {name!r}, rig {self.rig.name!r} has joints"
                    f" {', '.join(self.plant.joints) or 'none'}"
                )
        if r.line:
            self.plant.reset(s.start_pa[0])
            self.plant.line(r.line)  # raises where there is no such line
        self._taps = [self.plant.taps.index(tap) for tap in r.taps]
        measured = () if self._leads else r.measured
        self._encoders = [self.plant.encoders.index(name) for name in measured]
        self._valves = [self.plant.commands.index(name) for name in r.commands]
        taps = [self.rig.taps[tap] for tap in r.taps]
        encoders = [self.rig.encoders[name] for name in measured]
        self._tap_noise = np.array([t.noise_pa if s.noise_pa is None else s.noise_pa for t in taps])
        given = s.noise_position
        self._noise = np.array([e.noise if given is None else given for e in encoders])
        self._quantum = np.array([encoder.quantum for encoder in encoders])
        self._observer = RobotObserver(r, s.num_envs)
        self._aim = s.goal.aim(r, self.rig, s.num_envs, s.horizon)
        self._pushed = [self.plant.cylinders.index(name) for name in r.forces]
        self._strokes = np.array([self.rig.cylinders[name].stroke for name in r.forces])
        self.num_envs = s.num_envs
        self.single_observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (r.size,), np.float32)
        self.single_action_space = gymnasium.spaces.Box(-1.0, 1.0, (r.actions,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, s.num_envs)
        self.action_space = batch_space(self.single_action_space, s.num_envs)
        self.metadata = {"autoreset_mode": AutoresetMode.DISABLED}
        self._rng = np.random.default_rng(s.seed)
        self._step = -1
        self._over = np.zeros(s.num_envs, dtype=bool)
        self._wanted = Wanted()
        self._extensions = np.zeros((s.num_envs, len(self.plant.cylinders)))

    @property
    def period_s(self) -> float:
        """Control period, s."""
        return self.recipe.period_s

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
        self.plant.set_delay(rng.uniform(*s.delay_s, n))
        self._aim.begin(rng)
        places = {name: rng.uniform(*span, n) for name, span in s.start.items()}
        speeds = {name: rng.uniform(*span, n) for name, span in s.start_speed.items()}
        if s.on_target:
            for name, (place, speed) in self._aim.beginnings().items():
                joint = self.rig.encoders[name].on(name)
                places[joint], speeds[joint] = place, speed
        self._lead(0)
        self.plant.reset(rng.uniform(*s.start_pa, n), places, speeds)
        self._observer.reset()
        self._step = 0
        self._over[:] = False
        return self._observe(), {}

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[NDArray[np.float32], Floats, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Advances all robots by a control period.

        Args:
            actions: (num_envs, actions), cut off at -1 and 1.

        Returns:
            Observations, rewards, terminations (that stay), truncations (all, at the horizon),
            ``info``.
        """
        s, r = self.settings, self.recipe
        if self._step < 0:
            raise gymnasium.error.ResetNeeded("step was called before reset")
        if self._step >= s.horizon:
            raise gymnasium.error.ResetNeeded("the episodes are over; reset begins new ones")
        actions = np.asarray(actions, dtype=np.float64).reshape(s.num_envs, r.actions)
        volts = np.full((s.num_envs, len(self.plant.commands)), r.null_v)
        volts[:, self._valves] = r.volts(actions)
        self._lead(self._step + 1)
        self.plant.step(volts)
        self._observer.acted(actions)
        self._step += 1
        now = self._motion()
        outcome = self._aim.judge(self._step, now)
        reward = np.where(self._over, 0.0, outcome.reward)
        success = outcome.success & ~self._over
        self._over |= outcome.ended
        seen = self._observe()
        info = {
            "error": outcome.error,
            "success": success,
            "position": now.positions,
            "force_n": now.forces_n,
            "volts": volts,
        }
        if self._wanted.targets is not None:
            info["target"] = self._wanted.targets[:, :, 0].copy()
        if self._wanted.forces_n is not None:
            info["wanted_n"] = self._wanted.forces_n[:, :, 0].copy()
        done = np.full(s.num_envs, self._step == s.horizon)
        return seen, reward, self._over.copy(), done, info

    def _lead(self, step: int) -> None:
        """Leads pistons to where the aim has them, at step 0 before a reset."""
        ways = self._aim.ways(step)
        if ways is None:
            return
        each = np.zeros((self.num_envs, len(self.plant.cylinders)))
        each[:, self._pushed] = ways * self._strokes
        if step == 0:
            self.plant.start_pistons(each)
        else:
            self.plant.drive((each - self._extensions) / self.period_s)
        self._extensions = each

    def _motion(self) -> Motion:
        """What robots truly do, of what the recipe asks for."""
        r = self.recipe
        forces = self.plant.forces()[:, self._pushed]
        if self._leads:
            nothing = np.zeros((self.num_envs, 0))
            return Motion(nothing, nothing, forces)
        joints, speeds = self.plant.motion()
        of = [self.plant.joints.index(self.rig.encoders[name].on(name)) for name in r.measured]
        position, speed = joints[:, of], speeds[:, of]
        if r.chain is None:
            return Motion(position, speed, forces)
        whole = r.positions(position)
        every = np.zeros_like(whole)  # of computed places no goal asks for the speed
        every[:, [list(r.encoders).index(name) for name in r.measured]] = speed
        return Motion(whole, every, forces)

    def _observe(self) -> NDArray[np.float32]:
        r, rng = self.recipe, self._rng
        taps, encoders = self.plant.seen()
        taps, encoders = taps[:, self._taps], encoders[:, self._encoders]
        taps = taps + self._tap_noise * rng.normal(size=taps.shape)
        encoders = encoders + self._noise * rng.normal(size=encoders.shape)
        coarse = self._quantum > 0.0
        q = self._quantum[coarse]
        encoders[:, coarse] = np.round(encoders[:, coarse] / q) * q
        spools = None
        if r.spools:
            spools = self.plant.spools()
            k = len(self.plant.commands)
            spools = spools[:, [*self._valves, *(k + v for v in self._valves)]]
        positions = encoders if self._leads else r.positions(encoders)
        wanted = self._wanted = self._aim.wanted(self._step, positions)
        now = Moment(
            positions=positions,
            taps_pa=taps,
            targets=wanted.targets,
            forces_n=wanted.forces_n,
            ways=wanted.ways,
            spools_v=spools,
            line=self.plant.line(r.line) if r.line else None,
        )
        return self._observer.observe(now).astype(np.float32)


def _led(rig: Rig) -> Rig:
    """A rig whose pistons move no body, so that they can be led."""
    joints = {name for name, encoder in rig.encoders.items() if encoder.cylinder is None}
    bodies = {*rig.bodies, *joints}
    return rig.model_copy(
        update={
            "bodies": {},
            "mechanism": None,
            "encoders": {n: e for n, e in rig.encoders.items() if n not in joints},
            "effects": [e for e in rig.effects if e.place.split(".")[0] not in bodies],
        }
    )


def _misfit(rig: Rig, recipe: RobotRecipe) -> str:
    """What a recipe asks for and a rig does not have; empty where it has all."""
    asked = (
        ("taps", recipe.taps, rig.taps),
        ("encoders", recipe.measured, rig.encoders),
        ("commands", recipe.commands, rig.commands),
        ("forces", tuple(recipe.forces), rig.cylinders),
    )
    for what, names, known in asked:
        for name in names:
            if name not in known:
                return (
                    f"recipe.{what}: found {name!r}, rig {rig.name!r} has"
                    f" {', '.join(known) or 'none'}"
                )
    for name in recipe.measured:
        if rig.encoders[name].cylinder is not None:
            return f"recipe.encoders: found {name!r}, which is on a cylinder; use one on a joint"
    if not rig.moves:
        return f"rig: found {rig.name!r}, which moves nothing"
    return ""
