# SPDX-License-Identifier: Apache-2.0
"""A trained policy as a file that runs without PyTorch, with where it comes from."""

import importlib.metadata
import platform
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_policy.control.identity import rig_identity, robot_identity
from pneu_policy.control.policy_file import PolicyFile
from pneu_policy.control.push_policy import PushPolicy
from pneu_policy.control.robot_policy import RobotPolicy
from pneu_policy.learn.history import Row
from pneu_policy.learn.settings import TrainSettings
from pneu_policy.task.pushing import Pushing
from pneu_policy.task.robots import Robots
from pneu_policy.task.task_env import TaskEnv
from pneu_policy.task.tracking import PressureTracking

_VERSIONS_OF = ("pneu", "torch", "numpy", "gymnasium")


@dataclass(frozen=True)
class Trained:
    """What a training leaves.

    Attributes:
        env: The environment it was done in.
        settings: What it was set to.
        last: Its last row.
        done: Iterations.
        file_sha256: Digest of the rig or hand file.
        weights: Layers of the last iterate, or of the average that the settings declare.
        log_std: Logarithm of the exploration that is left.
    """

    env: TaskEnv
    settings: TrainSettings
    last: Row
    done: int
    file_sha256: str
    weights: list[tuple[NDArray[np.float32], NDArray[np.float32]]]
    log_std: float


def export_policy(trained: Trained, path: str | Path) -> PolicyFile | PushPolicy | RobotPolicy:
    """Writes what was trained.

    Args:
        trained: What a training of an iteration at least has left.
        path: The file; its folder must exist.

    Returns:
        What was written.

    Raises:
        InputError: The file cannot be written, or policies of the environment have none.
    """
    env = trained.env
    if isinstance(env, PressureTracking):
        file: PolicyFile | PushPolicy | RobotPolicy = _of_a_rig(trained, env)
    elif isinstance(env, Robots):
        file = RobotPolicy(
            weights=trained.weights,
            recipe=env.recipe,
            rig=robot_identity(env.rig),
            training=_training(trained, {"model": env.rig.model, "rig": _source(trained)}),
            log_std=trained.log_std,
        )
    elif isinstance(env, Pushing):
        file = PushPolicy(
            weights=trained.weights,
            recipe=env.settings.recipe,
            arms=list(env.hand.settings.arms),
            training=_training(trained, {"hand": _source(trained)}),
            log_std=trained.log_std,
        )
    else:
        raise InputError(
            f"{path}: a policy file is of a rig, a robot or a hand, found {type(env).__name__}"
        )
    file.save(path)
    return file


def _of_a_rig(trained: Trained, env: PressureTracking) -> PolicyFile:
    training = _training(trained, {"model": env.rig.model, "rig": _source(trained)})
    error = trained.last["eval_rmse"]
    training["rmse_pa"] = None if error is None else error * env.unit[1]
    return PolicyFile(
        weights=trained.weights,
        recipe=env.settings.recipe,
        rig=rig_identity(env.rig),
        training=training,
        log_std=trained.log_std,
    )


def _source(trained: Trained) -> dict[str, str]:
    return {"file": Path(trained.settings.env.file).name, "sha256": trained.file_sha256}


def _training(trained: Trained, of: dict[str, Any]) -> dict[str, Any]:
    """How it was trained.

    Args:
        trained: What the training has left.
        of: What it was trained for.
    """
    last = trained.last
    return {
        "algorithm": "npg",
        "seed": trained.settings.seed,
        "iterations": trained.done,
        "samples": last["samples"],
        "simulated_s": last["simulated_s"],
        "wall_s": round(last["wall_s"], 1),
        **of,
        "score": last["eval_score"],
        "rmse": last["eval_rmse"],
        "unit": trained.env.unit[0],
        "versions": _versions(),
        "settings": trained.settings.plain(),
    }


def _versions() -> dict[str, Any]:
    found: dict[str, Any] = {"python": platform.python_version()}
    for name in _VERSIONS_OF:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = None  # such as pneu built by colcon
    return found
