# SPDX-License-Identifier: Apache-2.0
"""A trained policy as a file that runs without PyTorch, with where it comes from."""

import importlib.metadata
import platform
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pneu_policy.learn.history import ATM_PA
from pneu_policy.policy_file import PolicyFile, rig_identity
from pneu_policy.tracking import PressureTracking
from pneu_sim.errors import InputError

if TYPE_CHECKING:
    from pneu_policy.learn.trainer import Trainer

_VERSIONS_OF = ("pneu", "torch", "numpy", "gymnasium")


def export_policy(trainer: "Trainer", path: str | Path) -> PolicyFile:
    """Writes what was trained: the last iterate, or the average that the settings declare.

    Args:
        trainer: The training; it has done an iteration at least.
        path: The file; its folder must exist.

    Returns:
        What was written.

    Raises:
        InputError: The file cannot be written, or the environment is not one of a rig.
    """
    if not isinstance(trainer.env, PressureTracking):
        raise InputError(f"{path}: a policy file is of a rig, found {type(trainer.env).__name__}")
    last = trainer.rows[-1]
    rig = trainer.env.rig
    training = {
        "algorithm": "npg",
        "seed": trainer.settings.seed,
        "iterations": trainer.done,
        "samples": last["samples"],
        "simulated_s": last["simulated_s"],
        "wall_s": round(last["wall_s"], 1),
        "model": rig.model,
        "rig": {
            "file": Path(trainer.settings.env.rig).name,
            "sha256": trainer.rig_sha256,
        },
        "score": last["eval_score"],
        "rmse_pa": None if last["eval_rmse_atm"] is None else last["eval_rmse_atm"] * ATM_PA,
        "versions": _versions(),
        "settings": trainer.settings.to_dict(),
    }
    file = PolicyFile(
        weights=trainer.weights(),
        recipe=trainer.settings.env.recipe,
        rig=rig_identity(rig),
        training=training,
        log_std=float(trainer.policy.log_std.detach().cpu()[0]),
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
