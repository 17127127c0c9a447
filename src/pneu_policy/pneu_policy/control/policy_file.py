# SPDX-License-Identifier: Apache-2.0
"""A learned controller of a pressure as one small file: weights, recipe, rig and training."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_policy.control.observations import Recipe
from pneu_policy.control.weights import Network, Single, read_weights, write_weights
from pneu_sim.rig.schema import Rig

VERSION = 1
Floats = NDArray[np.float64]


def rig_identity(rig: Rig) -> dict[str, Any]:
    """What a rig must have in common with the one a policy was trained for.

    Valve commands, the pipe of each tap and the lengths of pipes; not what a calibration finds,
    such as areas, friction, or the exact places of taps, and not how the gas is modelled.

    Args:
        rig: The rig.

    Returns:
        ``name``, ``commands``, ``taps`` (name to pipe or chamber), ``pipes`` (name to length, m, to
        the millimetre) and ``sha256`` of the latter three.
    """
    matters: dict[str, Any] = {
        "commands": sorted(rig.commands),
        "taps": {name: tap.pipe or tap.chamber for name, tap in sorted(rig.taps.items())},
        "pipes": {name: round(pipe.length_m, 3) for name, pipe in sorted(rig.pipes.items())},
    }
    return {"name": rig.name, **matters, "sha256": _digest(matters)}


def _digest(matters: Mapping[str, Any]) -> str:
    text = json.dumps({k: matters[k] for k in ("commands", "taps", "pipes")}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


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
        try:
            true = _digest(self.rig)
            taps, name = self.rig["taps"], self.rig["name"]
        except (KeyError, TypeError):
            raise InputError("rig: found none that names commands, taps and pipes") from None
        if self.rig.get("sha256") != true:
            raise InputError(f"rig: the digest of rig {name!r} does not belong to it")
        for tap in self.recipe.taps:
            if tap not in taps:
                raise InputError(f"taps: found {tap!r}, rig {name!r} has {', '.join(taps)}")
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
        found = rig_identity(rig)
        if found["sha256"] == self.rig["sha256"]:
            return
        raise InputError(
            f"{self.path or 'policy'}: trained for rig {self.rig['name']!r}, found rig"
            f" {rig.name!r}: {_difference(self.rig, found)}"
        )

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


def _difference(trained: Mapping[str, Any], found: Mapping[str, Any]) -> str:
    """The first thing in which two rigs differ, in words."""
    for what, one in (("commands", "command"), ("taps", "tap"), ("pipes", "pipe")):
        before, now = trained[what], found[what]
        missing = [name for name in before if name not in now]
        if missing:
            return f"it has no {one} {missing[0]!r} ({', '.join(now)})"
        more = [name for name in now if name not in before]
        if more:
            return f"its {one} {more[0]!r} was not there"
        for name in before:
            if what == "taps" and before[name] != now[name]:
                return f"tap {name!r} is on {now[name]!r}, not on {before[name]!r}"
            if what == "pipes" and before[name] != now[name]:
                return f"pipe {name!r} is {now[name]:g} m long, not {before[name]:g} m"
    return "they differ in their digests"
