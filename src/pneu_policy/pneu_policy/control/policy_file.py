# SPDX-License-Identifier: Apache-2.0
"""A learned controller of a pressure as one small file: weights, recipe, rig and training."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_policy.control.identity import OF_LINES, check_identity, check_same, rig_identity
from pneu_policy.control.observations import Recipe
from pneu_policy.control.weights import Network, Single, read_weights, write_weights
from pneu_sim.rig.schema import Rig

VERSION = 1
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PolicyFile:
    """A learned controller and where it comes from.

    Attributes:
        weights: Per layer the (outputs, inputs) matrix and the (outputs,) bias; tanh between, the
            last layer is linear and has one output, the action.
        recipe: How its features are made.
        rig: What it was trained for, from `rig_identity`.
        training: How it was trained: algorithm, seed, iterations, samples, model, rig file and its
            digest, score, rmse_pa, versions, settings; plain data.
        log_std: Logarithm of the standard deviation of the actions in training.
        path: File that it was read from.
    """

    weights: list[tuple[Single, Single]]
    recipe: Recipe
    rig: dict[str, Any]
    training: dict[str, Any]
    log_std: float = 0.0
    path: Path | None = None
    _network: Network = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Raises InputError where the parts do not fit together."""
        network = Network(self.weights, self.recipe.size, 1)
        if not np.isfinite(self.log_std):
            raise InputError(f"log_std: found {self.log_std}, it must be finite")
        check_identity(self.rig, OF_LINES, self.recipe.taps)
        object.__setattr__(self, "_network", network)

    def act(self, features: Floats) -> float:
        """Action for some features, without exploration.

        Args:
            features: (size,) features, as an `Observer` of the recipe makes them.
        """
        return float(self._network.act(features)[0])

    def check_rig(self, rig: Rig) -> None:
        """Refuses a rig that the policy was not trained for.

        Args:
            rig: The rig it shall run on.

        Raises:
            InputError: It has other commands, taps or pipes.
        """
        who = str(self.path or "policy")
        check_same(self.rig, rig_identity(rig), OF_LINES, who)

    def save(self, path: str | Path) -> None:
        """Writes the file, whole or not at all.

        Args:
            path: Where; its folder must exist.

        Raises:
            InputError: It cannot be written.
        """
        about = {
            "pneu_policy": VERSION,
            "recipe": self.recipe.plain(),
            "rig": self.rig,
            "training": self.training,
        }
        write_weights(path, self.weights, self.log_std, about)

    @classmethod
    def load(cls, path: str | Path) -> "PolicyFile":
        """Reads and checks a file.

        Args:
            path: The file.

        Raises:
            InputError: It is missing, damaged, or no policy.
        """
        path = Path(path)
        weights, log_std, about = read_weights(path, "pneu_policy", VERSION)
        recipe, rig, training = about.get("recipe"), about.get("rig"), about.get("training")
        if not (isinstance(recipe, dict) and isinstance(rig, dict) and isinstance(training, dict)):
            raise InputError(f"{path}: is no policy file (recipe, rig and training are mappings)")
        try:
            return cls(weights, Recipe(**recipe), rig, training, log_std, path)
        except (InputError, OverflowError) as error:  # a recipe with an infinite whole number
            raise InputError(f"{path}: {error}") from None
