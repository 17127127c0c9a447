# SPDX-License-Identifier: Apache-2.0
"""A learned policy that pushes a thing, as one small file: weights, recipe, arms and training."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_policy.control.push import PushRecipe
from pneu_policy.control.weights import Network, Single, read_weights, write_weights

KEY = "pneu_push_policy"
VERSION = 1

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PushPolicy:
    """A policy and where it comes from.

    Attributes:
        weights: Per layer the (outputs, inputs) matrix and the (outputs,) bias.
        recipe: What it sees and does.
        arms: Names of the arms, in order.
        training: How it was trained, plain data.
        log_std: Logarithm of the standard deviation of the actions in training.
        path: File that it was read from.
    """

    weights: list[tuple[Single, Single]]
    recipe: PushRecipe
    arms: list[str]
    training: dict[str, Any]
    log_std: float = 0.0
    path: Path | None = None
    _network: Network = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Raises InputError where the parts do not fit together."""
        count = len(self.arms)
        network = Network(self.weights, self.recipe.size(count), 2 * count)
        if not np.isfinite(self.log_std):
            raise InputError(f"log_std: found {self.log_std}, it must be finite")
        object.__setattr__(self, "_network", network)

    def act(self, features: Floats) -> Floats:
        """(2 arms,) actions, without exploration.

        Args:
            features: (size,), as a `PushObserver` of the recipe makes them.
        """
        return self._network.act(features)

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
            "arms": self.arms,
            "training": self.training,
        }
        write_weights(path, self.weights, self.log_std, about)

    @classmethod
    def load(cls, path: str | Path) -> "PushPolicy":
        """Reads and checks a file.

        Args:
            path: The file.

        Raises:
            InputError: It is missing, damaged, or no policy that pushes.
        """
        path = Path(path)
        weights, log_std, about = read_weights(path, KEY, VERSION)
        recipe, arms, training = (about.get(name) for name in ("recipe", "arms", "training"))
        if not (
            isinstance(recipe, dict)
            and isinstance(arms, list)
            and all(isinstance(arm, str) for arm in arms)
            and isinstance(training, dict)
        ):
            raise InputError(
                f"{path}: is no policy file (recipe and training are mappings, arms a list)"
            )
        try:
            return cls(weights, PushRecipe(**recipe), arms, training, log_std, path)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
