# SPDX-License-Identifier: Apache-2.0
"""A trained policy as a file that runs without PyTorch, with where it comes from."""

import importlib.metadata
import platform
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_policy.control.policy_file import PolicyFile, rig_identity
from pneu_policy.learn.history import ATM_PA, Row
from pneu_policy.learn.settings import TrainSettings
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
        rig_sha256: Digest of the rig file.
        weights: Layers of the last iterate, or of the average that the settings declare.
        log_std: Logarithm of the exploration that is left.
    """

    env: gymnasium.vector.VectorEnv
    settings: TrainSettings
    last: Row
    done: int
    rig_sha256: str
    weights: list[tuple[NDArray[np.float32], NDArray[np.float32]]]
    log_std: float


def export_policy(trained: Trained, path: str | Path) -> PolicyFile:
    """Writes what was trained.

    Args:
        trained: What a training of an iteration at least has left.
        path: The file; its folder must exist.

    Returns:
        What was written.

    Raises:
        InputError: The file cannot be written, or the environment is not one of a rig.
    """
    if not isinstance(trained.env, PressureTracking):
        raise InputError(f"{path}: a policy file is of a rig, found {type(trained.env).__name__}")
    last = trained.last
    rig = trained.env.rig
    training = {
        "algorithm": "npg",
        "seed": trained.settings.seed,
        "iterations": trained.done,
        "samples": last["samples"],
        "simulated_s": last["simulated_s"],
        "wall_s": round(last["wall_s"], 1),
        "model": rig.model,
        "rig": {
            "file": Path(trained.settings.env.rig).name,
            "sha256": trained.rig_sha256,
        },
        "score": last["eval_score"],
        "rmse_pa": None if last["eval_rmse_atm"] is None else last["eval_rmse_atm"] * ATM_PA,
        "versions": _versions(),
        "settings": trained.settings.plain(),
    }
    file = PolicyFile(
        weights=trained.weights,
        recipe=trained.settings.env.recipe,
        rig=rig_identity(rig),
        training=training,
        log_std=trained.log_std,
    )
    file.save(path)
    return file


def _versions() -> dict[str, Any]:
    found: dict[str, Any] = {"python": platform.python_version()}
    for name in _VERSIONS_OF:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = None  # such as pneu built by colcon
    return found
