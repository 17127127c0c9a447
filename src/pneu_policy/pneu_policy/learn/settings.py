# SPDX-License-Identifier: Apache-2.0
"""What a training is set to: the environment, the hyperparameters of table 7.1, seeds and budget.

A settings file is YAML with the fields of `TrainSettings`. An entry `sweep` makes it many runs: it
maps dotted fields to lists of values, and all combinations are trained.
"""

from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from pneu_common.documents import read_yaml
from pneu_common.errors import InputError
from pneu_common.validation import Listed, Settings
from pneu_policy.task.make import TaskSettings
from pneu_policy.task.ranges import Seed

Layers = Annotated[tuple[Annotated[int, Field(ge=1)], ...], Listed]
"""Units of the hidden layers of a network."""


class NpgSettings(Settings):
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

    gamma: Annotated[float, Field(gt=0.0, le=1.0)] = 0.995
    gae_lambda: Annotated[float, Field(gt=0.0, le=1.0)] = 0.97
    delta: Annotated[float, Field(gt=0.0)] = 0.1
    cg_iterations: Annotated[int, Field(ge=1)] = 10
    cg_tolerance: Annotated[float, Field(ge=0.0)] = 1e-10
    damping: Annotated[float, Field(gt=0.0)] = 1e-4
    kl_limit: Annotated[float, Field(ge=0.0)] = 1.5
    hidden: Layers = (32, 32)
    log_std_init: float = -0.5
    log_std_floor: float = -3.0
    value_hidden: Layers = (128, 128)
    value_learning_rate: Annotated[float, Field(gt=0.0)] = 1e-3
    value_steps: Annotated[int, Field(ge=0)] = 500
    value_batch: Annotated[int, Field(ge=1)] = 256
    rescale_values: bool = True
    bootstrap: bool = True

    @model_validator(mode="after")
    def _begins_above_the_floor(self) -> Self:
        if self.log_std_init < self.log_std_floor:
            raise ValueError(
                f"log_std_init: found {self.log_std_init:g}, it must not be below log_std_floor"
                f" ({self.log_std_floor:g})"
            )
        return self


class TrainSettings(Settings):
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
        keep_every: Iterations between policies that are kept besides the last; 0 keeps none.
        average_decay: Weight that the average of past iterates keeps at each iteration; the
            average is what is evaluated and exported. 0 takes the latest iterate itself.
    """

    env: TaskSettings
    npg: NpgSettings = NpgSettings()
    iterations: Annotated[int, Field(ge=1)] = 200
    seed: Seed = 0
    device: Annotated[str, Field(pattern=r"^(cpu|cuda)(:\d+)?$")] = "cpu"
    threads: Annotated[int, Field(ge=1)] = 1
    evaluate_every: Annotated[int, Field(ge=1)] = 5
    evaluation_seed: Seed = 20_000
    checkpoint_every: Annotated[int, Field(ge=1)] = 20
    keep_every: Annotated[int, Field(ge=0)] = 0
    average_decay: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0


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
    try:
        return TrainSettings(**document)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
