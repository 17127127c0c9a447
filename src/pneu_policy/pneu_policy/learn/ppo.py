# SPDX-License-Identifier: Apache-2.0
"""The same task through stable-baselines3's PPO, as a yardstick for the natural policy gradient.

Episodes, evaluation and history are those of the trainer; networks have the same sizes.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_policy.learn.history import History, Row
from pneu_policy.learn.rollout import roll_out
from pneu_policy.learn.settings import TrainSettings
from pneu_policy.task.make import make_env
from pneu_policy.task.task_env import TaskEnv

try:
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.logger import Logger
    from stable_baselines3.common.vec_env import VecEnv, VecNormalize
except ModuleNotFoundError as error:
    raise InputError(
        f"PPO needs stable-baselines3, which is not installed ({error}):"
        " `pip install '.[study]'` in a checkout of pneu, or 'FILE.whl[study]' for a wheel of it"
    ) from None


class Adapter(VecEnv):
    """A gymnasium vector environment as stable-baselines3 wants one.

    Attributes:
        env: The environment; its episodes end together.
        errors: Tracking errors of the steps since they were last taken away.
    """

    def __init__(self, env: TaskEnv, seed: int) -> None:
        """Wraps an environment.

        Args:
            env: The environment.
            seed: Decides the episodes, one after the other.
        """
        self.env = env
        self.errors: list[NDArray[np.float64]] = []
        self._episodes = np.random.default_rng([seed, 1])
        self._actions: NDArray[Any] = np.zeros(0)
        self.render_mode = None
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> NDArray[np.float32]:
        """Begins the next episodes."""
        observation, _ = self.env.reset(seed=int(self._episodes.integers(2**31)))
        return np.array(observation)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Notes the actions.

        Args:
            actions: One row per rig.
        """
        self._actions = actions

    def step_wait(self) -> Any:
        """Does the step; where the episodes end, begins the next ones.

        Returns:
            Observations, rewards, ends, and a dict per rig.

        Raises:
            InputError: An episode ended before the others, which go on with it.
        """
        observation, reward, terminated, truncated, info = self.env.step(self._actions)
        if terminated.any() and not (terminated | truncated).all():
            raise InputError(
                "ppo: found an episode that ended before the others; the yardstick takes tasks"
                " whose episodes last as long as the horizon"
            )
        self.errors.append(np.array(info["error"]))
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        observation = np.array(observation)
        if done.any():
            for n in range(self.num_envs):
                infos[n] = {
                    "terminal_observation": observation[n],
                    "TimeLimit.truncated": bool(truncated[n] and not terminated[n]),
                }
            observation = self.reset()
        return observation, np.array(reward, np.float32), done, infos

    def close(self) -> None:
        """Closes the environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The same attribute of the environment for each rig.

        Args:
            attr_name: Which.
            indices: Which rigs.
        """
        return [getattr(self.env, attr_name, None) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: the rigs share one environment.

        Args:
            attr_name: Which.
            value: What to.
            indices: Which rigs.
        """
        raise NotImplementedError("rigs of one environment have no attributes of their own")

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Refused: the rigs share one environment.

        Args:
            method_name: Which.
            method_args: Its arguments.
            indices: Which rigs.
            method_kwargs: Its arguments by name.
        """
        raise NotImplementedError("rigs of one environment have no methods of their own")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Whether each rig is wrapped: none is.

        Args:
            wrapper_class: In what.
            indices: Which rigs.
        """
        return [False for _ in self._get_indices(indices)]


class _Watch(BaseCallback):
    """Writes the history; one row per collection of episodes, after the update before it."""

    def __init__(
        self,
        settings: TrainSettings,
        adapter: Adapter,
        judge: TaskEnv,
        report: Callable[[Row], None] | None,
    ) -> None:
        super().__init__()
        self.rows: list[Row] = []
        self._settings, self._adapter, self._judge = settings, adapter, judge
        self._report = report
        self._rewards = 0.0
        self._started, self._busy = time.perf_counter(), time.process_time()

    def _on_step(self) -> bool:
        rewards = self.training_env.get_original_reward()
        self._rewards += float(np.mean(rewards))
        return True

    def _on_rollout_start(self) -> None:
        # Only now is the update on the collection before done; the last row is added at the end.
        if self._adapter.errors:
            self.add_row()

    def add_row(self) -> None:
        """Adds the row of the latest collection, judged after its update."""
        s, k = self._settings, len(self.rows)
        errors = np.concatenate(self._adapter.errors)
        score = self._rewards
        self._adapter.errors.clear()
        self._rewards = 0.0
        due = (k + 1) % s.evaluate_every == 0 or k + 1 == s.iterations or k == 0
        judged = None
        if due:
            model = self.model

            def act(seen: NDArray[np.float32]) -> NDArray[np.float32]:
                return np.asarray(model.predict(seen, deterministic=True)[0], np.float32)

            judged = roll_out(self._judge, act, s.evaluation_seed)
        samples = (k + 1) * self._adapter.num_envs * s.env.horizon
        row = {
            "iteration": k + 1,
            "samples": samples,
            "simulated_s": samples * self._adapter.env.period_s,
            "wall_s": time.perf_counter() - self._started,
            "cpu_s": time.process_time() - self._busy,
            "score": score,
            "rmse": float(np.sqrt(np.mean(errors**2)) / self._adapter.env.unit[1]),
            "eval_score": judged.score if judged else None,
            "eval_rmse": judged.rmse if judged else None,
            "std": float(self.model.policy.log_std.detach().exp().mean()),
        }
        self.rows.append(row)
        if self._report:
            self._report(row)


def train_ppo(
    settings: TrainSettings,
    env: TaskEnv | None = None,
    judge: TaskEnv | None = None,
    report: Callable[[Row], None] | None = None,
    **hyperparameters: Any,
) -> History:
    """Trains by PPO on as many episodes as the settings give the natural policy gradient.

    Args:
        settings: Environment, budget, seeds, sizes of networks, discount and GAE exponent.
        env: Environment in place of the one in the settings.
        judge: Another of the same kind, for the evaluations.
        report: Called with each row of the history.
        hyperparameters: Of stable-baselines3's PPO, in place of its own defaults.

    Returns:
        The history.
    """
    torch.set_num_threads(settings.threads)
    n = settings.npg
    adapter = Adapter(make_env(settings.env) if env is None else env, settings.seed)
    judge = make_env(settings.env) if judge is None else judge
    asked = {
        "n_steps": settings.env.horizon,
        "batch_size": n.value_batch,
        "gamma": n.gamma,
        "gae_lambda": n.gae_lambda,
        "policy_kwargs": {
            "net_arch": {"pi": list(n.hidden), "vf": list(n.value_hidden)},
            "activation_fn": torch.nn.Tanh,
            "log_std_init": n.log_std_init,
        },
        **hyperparameters,
    }
    # its value function needs rewards of unit size; observations are scaled by the recipe already
    normalised = VecNormalize(adapter, norm_obs=False, norm_reward=True, gamma=n.gamma)
    model = PPO("MlpPolicy", normalised, seed=settings.seed, device=settings.device, **asked)
    model.set_logger(Logger(None, []))  # its own leaves a folder among the temporary files
    watch = _Watch(settings, adapter, judge, report)
    model.learn(settings.iterations * adapter.num_envs * settings.env.horizon, callback=watch)
    watch.add_row()
    shown = {**settings.plain(), "ppo": {k: repr(v) for k, v in hyperparameters.items()}}
    return History("ppo", shown, watch.rows, True, judge.unit[0], judge.mark)
