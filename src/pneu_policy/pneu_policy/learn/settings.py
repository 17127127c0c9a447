# SPDX-License-Identifier: Apache-2.0
"""What a training is set to: the environment, the hyperparameters of table 7.1, seeds and budget.

A settings file is YAML with the fields of `TrainSettings`. An entry `sweep` makes it many runs: it
maps dotted fields to lists of values, and all combinations are trained.
"""

import dataclasses
import difflib
import math
import types
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from pneu_common.documents import read_yaml
from pneu_common.errors import InputError
from pneu_policy.tracking import EnvSettings

T = TypeVar("T")


@dataclass(frozen=True)
class NpgSettings:
    """Hyperparameters; the defaults are those of table 7.1 and, where it is silent, of mjrl.

    Attributes:
        gamma: Discount factor.
        gae_lambda: GAE exponent.
        delta: Squared length of a step in the metric of the Fisher matrix, twice the KL divergence.
        cg_iterations: Iterations of the conjugate gradient.
        cg_tolerance: Squared residual at which it ends earlier.
        damping: Added to the diagonal of the Fisher matrix.
        kl_limit: A step whose measured KL divergence is over this many times delta / 2 is halved
            until it is not; 0 takes every step as it is, as the thesis does. Without it single
            steps reach divergences of several, and what was learned is lost.
        hidden: Units of the policy's hidden layers.
        log_std_init: First logarithm of the policy's standard deviation.
        log_std_floor: Lowest value of it.
        value_hidden: Units of the value function's hidden layers.
        value_learning_rate: Rate of Adam in the value function's fit.
        value_steps: Gradient steps of that fit per iteration.
        value_batch: Samples per gradient step.
        rescale_values: Whether the value function works in units of the returns' spread.
        bootstrap: Whether advantages count what the value function says after the last step, as
            mjrl does. It sees the time and is fitted to returns that end there, so this is little.
    """

    gamma: float = 0.995
    gae_lambda: float = 0.97
    delta: float = 0.1
    cg_iterations: int = 10
    cg_tolerance: float = 1e-10
    damping: float = 1e-4
    kl_limit: float = 1.5
    hidden: tuple[int, ...] = (32, 32)
    log_std_init: float = -0.5
    log_std_floor: float = -3.0
    value_hidden: tuple[int, ...] = (128, 128)
    value_learning_rate: float = 1e-3
    value_steps: int = 500
    value_batch: int = 256
    rescale_values: bool = True
    bootstrap: bool = True

    def __post_init__(self) -> None:
        """Raises InputError where a number is out of range."""
        for name in ("gamma", "gae_lambda"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise InputError(f"{name}: found {getattr(self, name):g}, allowed is 0 < x <= 1")
        for name in ("delta", "damping", "value_learning_rate"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"{name}: found {getattr(self, name):g}, it must be positive")
        for name in ("cg_iterations", "value_batch"):
            if getattr(self, name) < 1:
                raise InputError(f"{name}: found {getattr(self, name)}, allowed is 1 or more")
        if self.value_steps < 0 or self.cg_tolerance < 0.0:
            raise InputError("value_steps, cg_tolerance: neither may be negative")
        if not self.kl_limit >= 0.0:
            raise InputError(f"kl_limit: found {self.kl_limit:g}, it must not be negative")
        if min((1, *self.hidden, *self.value_hidden)) < 1:
            raise InputError("hidden, value_hidden: a layer has 1 unit or more")
        if self.log_std_init < self.log_std_floor:
            raise InputError(
                f"log_std_init: found {self.log_std_init:g}, it must not be below log_std_floor"
                f" ({self.log_std_floor:g})"
            )


@dataclass(frozen=True)
class TrainSettings:
    """One training run.

    Attributes:
        env: The environment.
        npg: Hyperparameters.
        iterations: Updates; each takes one episode of each of the environment's plants.
        seed: Seed of all randomness: first weights, episodes, exploration.
        device: Where PyTorch computes, ``cpu`` or ``cuda``.
        threads: Threads of PyTorch.
        evaluate_every: Iterations between evaluations without exploration.
        evaluation_seed: Seed of the episodes of these; the same for all runs that are compared.
        checkpoint_every: Iterations between checkpoints.
        average_decay: Weight that the average of past iterates keeps at each iteration; the
            average is what is evaluated and exported. 0 takes the latest iterate itself.
    """

    env: EnvSettings
    npg: NpgSettings = field(default_factory=NpgSettings)
    iterations: int = 200
    seed: int = 0
    device: str = "cpu"
    threads: int = 1
    evaluate_every: int = 5
    evaluation_seed: int = 20_000
    checkpoint_every: int = 20
    average_decay: float = 0.0

    def __post_init__(self) -> None:
        """Raises InputError where a number is out of range."""
        for name in ("iterations", "threads", "evaluate_every", "checkpoint_every"):
            if getattr(self, name) < 1:
                raise InputError(f"{name}: found {getattr(self, name)}, allowed is 1 or more")
        for name in ("seed", "evaluation_seed"):
            if getattr(self, name) < 0:
                raise InputError(f"{name}: found {getattr(self, name)}, it must not be negative")
        if not 0.0 <= self.average_decay < 1.0:
            raise InputError(f"average_decay: found {self.average_decay:g}, allowed is 0 <= x < 1")
        if self.device.partition(":")[0] not in ("cpu", "cuda"):
            raise InputError(f"device: found {self.device!r}, allowed are cpu and cuda")

    def to_dict(self) -> dict[str, Any]:
        """The same as plain values, as they go into YAML and into provenance."""
        plain = {
            f.name: getattr(self, f.name)
            for f in dataclasses.fields(self)
            if f.name not in ("env", "npg")
        }
        npg = {key: _plain(value) for key, value in dataclasses.asdict(self.npg).items()}
        return {"env": self.env.to_dict(), "npg": npg, **plain}

    @classmethod
    def from_dict(cls, mapping: Mapping[str, Any]) -> "TrainSettings":
        """Reads plain values.

        Args:
            mapping: Values by field; what is left out keeps its default.

        Raises:
            InputError: A field is unknown, of a wrong type or out of range; the message names it.
        """
        values = dict(_mapping(mapping, "settings"))
        if "env" not in values:
            raise InputError("env: is missing; it describes the environment")
        env = EnvSettings.from_dict(_mapping(values.pop("env"), "env"))
        npg = _under("npg", _npg_from_dict, _mapping(values.pop("npg", {}), "npg"))
        known = [f.name for f in dataclasses.fields(cls)]
        return cls(env=env, npg=npg, **_typed(cls, values, known))


def load_document(path: str | Path) -> dict[str, Any]:
    """Reads a YAML file that is a mapping.

    Args:
        path: The file.

    Raises:
        InputError: It is missing, is not YAML or is not a mapping.
    """
    data = read_yaml(path, "settings file")
    if not isinstance(data, dict):
        raise InputError(f"{path}: settings are a mapping, found {type(data).__name__}")
    return data


def load_settings(path: str | Path) -> TrainSettings:
    """Reads the settings of one run.

    Args:
        path: The YAML file.

    Raises:
        InputError: It cannot be read or a field is wrong; the message names file and field.
    """
    document = load_document(path)
    return _under(str(path), TrainSettings.from_dict, document)


def _npg_from_dict(mapping: Mapping[str, Any]) -> NpgSettings:
    known = [f.name for f in dataclasses.fields(NpgSettings)]
    return NpgSettings(**_typed(NpgSettings, mapping, known))


def _under(where: str, read: Any, mapping: Mapping[str, Any]) -> Any:
    """Puts where a fault is before its message."""
    try:
        return read(mapping)
    except InputError as error:
        separator = ": " if where.endswith((".yaml", ".yml")) or "/" in where else "."
        raise InputError(f"{where}{separator}{error}") from None


def _mapping(value: Any, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"{where}: found {value!r}, a mapping is needed")
    return value


def _typed(cls: type, values: Mapping[str, Any], known: list[str]) -> dict[str, Any]:
    """Values checked against the types of a dataclass' fields."""
    hints = get_type_hints(cls)
    out = {}
    for name, value in values.items():
        if name not in known:
            near = difflib.get_close_matches(str(name), known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(known)}"
            raise InputError(f"{name}: is not a setting; {hint}")
        out[name] = _as(hints[name], value, name)
    return out


def _as(hint: Any, value: Any, name: str) -> Any:
    if get_origin(hint) is tuple:
        if not isinstance(value, list | tuple):
            raise InputError(f"{name}: found {value!r}, a list is needed")
        return tuple(_as(get_args(hint)[0], one, name) for one in value)
    if get_origin(hint) in (Union, types.UnionType):
        if value is None:
            return None
        hint = next(one for one in get_args(hint) if one is not type(None))
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not hint:
        raise InputError(f"{name}: found {value!r}, needed is a value of type {hint.__name__}")
    if hint is float and not math.isfinite(value):
        raise InputError(f"{name}: found {value}, it must be finite")
    return value


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
