# SPDX-License-Identifier: Apache-2.0
"""Episodes of a policy in a vector environment, all of which begin and are over together."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_policy.task.task_env import TaskEnv

Array = NDArray[np.float32]

LONGEST = 1_000_000
"""Steps after which an environment without a horizon is refused."""


@dataclass(frozen=True)
class Episodes:
    """Episodes of equal length, side by side.

    Attributes:
        observations: Before each action and after the last one: (steps + 1, episodes, size).
        actions: (steps, episodes, size).
        rewards: (steps, episodes).
        error: Tracking error after each step, (steps, episodes), SI.
        unit: How much one is of what errors are told in.
        alive: Whether an episode had not ended before a step, (steps, episodes); None is always.
            What was seen and done after its end does not count.
        success: Whether it was where it should be after each step, (steps, episodes); None where
            the task does not say.
        ended: Whether an episode has ended by itself, (episodes,); None is never.
    """

    observations: Array
    actions: Array
    rewards: Array
    error: NDArray[np.float64]
    unit: float
    alive: NDArray[np.bool_] | None = None
    success: NDArray[np.bool_] | None = None
    ended: NDArray[np.bool_] | None = None

    @property
    def score(self) -> float:
        """Mean sum of rewards of an episode."""
        return float(self.rewards.sum(axis=0, dtype=np.float64).mean())

    @property
    def rmse(self) -> float:
        """RMS tracking error over all episodes while they lasted, in the task's unit."""
        squares = self.error**2 if self.alive is None else self.error[self.alive] ** 2
        return float(np.sqrt(np.mean(squares)) / self.unit)

    @property
    def samples(self) -> int:
        """Steps of all episodes together."""
        return int(self.rewards.size if self.alive is None else self.alive.sum())

    @property
    def successful(self) -> float | None:
        """Share of all steps that were a success, those after an end being none."""
        return None if self.success is None else float(self.success.mean())


def roll_out(env: TaskEnv, act: Callable[[Array], Array], seed: int) -> Episodes:
    """Runs one episode of every rig of an environment.

    Args:
        env: The environment; it decides the length.
        act: Actions for observations, one row per rig.
        seed: Decides the episodes.

    Raises:
        FloatingPointError: The environment returned what is not finite.
        ValueError: Episodes are not cut off together, or do not end at all.
    """
    observation, _ = env.reset(seed=seed)
    observations, actions, rewards, errors = [np.asarray(observation, np.float32)], [], [], []
    successes: list[NDArray[np.bool_]] = []
    over = np.zeros(len(observations[0]), dtype=bool)
    lasted: list[NDArray[np.bool_]] = []
    for step in range(LONGEST):
        action = np.asarray(act(observations[-1]), np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        if not (np.isfinite(observation).all() and np.isfinite(reward).all()):
            raise FloatingPointError(
                f"the environment returned a number that is not finite in step {step} of the"
                f" episodes of seed {seed}"
            )
        # copies: an environment may write its arrays anew at the next step
        observations.append(np.array(observation, np.float32))
        actions.append(action)
        rewards.append(np.array(reward, np.float32))
        errors.append(np.array(info["error"], np.float64))
        if "success" in info:
            successes.append(np.array(info["success"], bool))
        lasted.append(~over)
        over = over | terminated
        if (over | truncated).all():
            break
        if truncated.any():
            cut = int(truncated.sum())
            raise ValueError(f"only {cut} of {len(over)} episodes were cut off after step {step}")
    else:
        raise ValueError(f"episodes did not end within {LONGEST} steps")
    return Episodes(
        np.stack(observations),
        np.stack(actions),
        np.stack(rewards),
        np.stack(errors),
        env.unit[1],
        None if all(one.all() for one in lasted) else np.stack(lasted),
        np.stack(successes) if successes else None,
        over if over.any() else None,
    )
