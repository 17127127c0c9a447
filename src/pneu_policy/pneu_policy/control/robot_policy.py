# SPDX-License-Identifier: Apache-2.0
"""A learned controller of a robot as one small file: weights, recipe, rig and training."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_policy.control.identity import OF_ROBOTS, check_identity, check_same, robot_identity
from pneu_policy.control.robot_recipe import RobotRecipe
from pneu_policy.control.weights import Network, Single, read_weights, write_weights
from pneu_sim.rig.schema import Rig

KEY = "pneu_robot_policy"
VERSION = 1

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RobotPolicy:
    """A policy and where it comes from.

    Attributes:
        weights: Per layer the (outputs, inputs) matrix and the (outputs,) bias.
        recipe: What it sees and does.
        rig: What it was trained for, from `robot_identity`.
        training: How it was trained, plain data.
        log_std: Logarithm of the standard deviation of the actions in training.
        path: File that it was read from.
    """

    weights: list[tuple[Single, Single]]
    recipe: RobotRecipe
    rig: dict[str, Any]
    training: dict[str, Any]
    log_std: float = 0.0
    path: Path | None = None
    _network: Network = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Raises InputError where the parts do not fit together."""
        network = Network(self.weights, self.recipe.size, self.recipe.actions)
        if not np.isfinite(self.log_std):
            raise InputError(f"log_std: found {self.log_std}, it must be finite")
        check_identity(self.rig, OF_ROBOTS, self.recipe.taps)
        object.__setattr__(self, "_network", network)

    def act(self, features: Floats) -> Floats:
        """(actions,) actions, without exploration.

        Args:
            features: (size,), as a `RobotObserver` of the recipe makes them.
        """
        return self._network.act(features)

    def check_rig(self, rig: Rig) -> None:
        """Refuses a rig that the policy was not trained for.

        Args:
            rig: The rig it shall run on.

        Raises:
            InputError: It has other commands, taps, pipes, cylinders or encoders.
        """
        who = str(self.path or "policy")
        check_same(self.rig, robot_identity(rig), OF_ROBOTS, who)

    def save(self, path: str | Path) -> None:
        """Writes the file, whole or not at all.

        Args:
            path: Where; its folder must exist.

        Raises:
            InputError: It cannot be written.
        """
        about = {
            KEY: VERSION,
            "recipe": self.recipe.plain(),
            "rig": self.rig,
            "training": self.training,
        }
        write_weights(path, self.weights, self.log_std, about)

    @classmethod
    def load(cls, path: str | Path) -> "RobotPolicy":
        """Reads and checks a file.

        Args:
            path: The file.

        Raises:
            InputError: It is missing, damaged, or no policy of a robot.
        """
        path = Path(path)
        weights, log_std, about = read_weights(path, KEY, VERSION)
        recipe, rig, training = (about.get(name) for name in ("recipe", "rig", "training"))
        if not (isinstance(recipe, dict) and isinstance(rig, dict) and isinstance(training, dict)):
            raise InputError(f"{path}: is no policy file (recipe, rig and training are mappings)")
        try:
            return cls(weights, RobotRecipe(**recipe), rig, training, log_std, path)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
