# SPDX-License-Identifier: Apache-2.0
"""The networks that are trained: a Gaussian policy and a value function (thesis 7.1, table 7.1).

Sizes, scales of the first weights and the features of the value function are those of mjrl, the
implementation the thesis builds on (Rajeswaran et al., NIPS 2017).
"""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

Array = NDArray[np.float32]

LAST_LAYER_SCALE = 1e-2
"""The policy's last layer starts this much smaller, so that its first actions are near zero."""

TIME_POWERS = 4
"""Powers of the time in the episode that the value function sees."""


def linear_layers(sizes: Sequence[int], rng: np.random.Generator) -> nn.ModuleList:
    """Layers with first weights and biases from U(-1/sqrt(n), 1/sqrt(n)), as PyTorch's own.

    They are drawn here because PyTorch would take them from a global generator.

    Args:
        sizes: Number of inputs, of each hidden layer's units, and of outputs.
        rng: Where the weights come from.

    Returns:
        The layers, in single precision on the CPU.
    """
    layers = []
    for inputs, outputs in pairwise(sizes):
        layer = nn.Linear(inputs, outputs)
        bound = 1.0 / math.sqrt(inputs)
        with torch.no_grad():
            for parameter in (layer.weight, layer.bias):
                drawn = rng.uniform(-bound, bound, tuple(parameter.shape)).astype(np.float32)
                parameter.copy_(torch.from_numpy(drawn))
        layers.append(layer)
    return nn.ModuleList(layers)


class GaussianPolicy(nn.Module):
    """Actions from N(mean(observation), diag(std^2)) with a tanh network and a free std.

    Attributes:
        layers: Layers of the mean; tanh between them, the last one linear.
        log_std: Logarithm of the standard deviation, one per action.
        log_std_floor: Lowest value of it.
    """

    log_std: nn.Parameter

    def __init__(
        self,
        inputs: int,
        actions: int,
        hidden: Sequence[int],
        log_std_init: float,
        log_std_floor: float,
        rng: np.random.Generator,
    ) -> None:
        """Makes a policy at random.

        Args:
            inputs: Size of the observation.
            actions: Size of the action.
            hidden: Units of each hidden layer.
            log_std_init: First logarithm of the standard deviation.
            log_std_floor: Lowest value of it.
            rng: Where the first weights come from.
        """
        super().__init__()
        self.layers = linear_layers([inputs, *hidden, actions], rng)
        with torch.no_grad():
            for parameter in self.layers[-1].parameters():
                parameter.mul_(LAST_LAYER_SCALE)
        self.log_std = nn.Parameter(torch.full((actions,), float(log_std_init)))
        self.log_std_floor = log_std_floor

    def forward(self, observations: Tensor) -> Tensor:
        """Mean actions.

        Args:
            observations: One per row.
        """
        *hidden, last = self.linear()
        h = observations
        for layer in hidden:
            h = torch.tanh(layer(h))
        return cast(Tensor, last(h))

    def linear(self) -> list[nn.Linear]:
        """The layers, with their type."""
        return [cast(nn.Linear, layer) for layer in self.layers]

    def flat(self) -> Tensor:
        """All parameters in one vector, layer by layer (weights by rows, bias), log_std last."""
        return torch.cat([p.detach().reshape(-1) for p in self.ordered()])

    def ordered(self) -> Iterator[nn.Parameter]:
        """The parameters in the order of the flat vector."""
        for layer in self.linear():
            yield cast(nn.Parameter, layer.weight)
            yield layer.bias
        yield self.log_std

    def set_flat(self, vector: Tensor) -> None:
        """Takes all parameters from one vector and holds log_std above its floor.

        Args:
            vector: In the order of `flat`.
        """
        start = 0
        with torch.no_grad():
            for parameter in self.ordered():
                size = parameter.numel()
                parameter.copy_(vector[start : start + size].view_as(parameter))
                start += size
            self.log_std.clamp_(min=self.log_std_floor)

    def weights(self) -> list[tuple[Array, Array]]:
        """Copies of weights (out, in) and biases, layer by layer."""
        return [(_array(layer.weight), _array(layer.bias)) for layer in self.linear()]


def mean_action(weights: Sequence[tuple[Array, Array]], observations: Array) -> Array:
    """The mean of a policy in NumPy, for roll-outs: PyTorch's overhead is larger than the work.

    Args:
        weights: As `GaussianPolicy.weights` gives them.
        observations: One per row, single precision.

    Returns:
        One action per row.
    """
    h = observations
    for weight, bias in weights[:-1]:
        h = np.tanh(h @ weight.T + bias)
    weight, bias = weights[-1]
    return np.asarray(h @ weight.T + bias, dtype=np.float32)


class ValueNetwork(nn.Module):
    """The return to expect from an observation and the time in the episode (thesis 7.1).

    The output is kept in units of `scale` about `offset`; `rescale` moves both to the returns that
    are being fitted without changing what the network says (van Hasselt et al. 2016), because Adam
    at its usual rate takes long to reach returns in the hundreds.

    Attributes:
        layers: Layers; ReLU between them, the last one linear.
        offset: Mean of the returns, a number.
        scale: Standard deviation of the returns, a number.
    """

    offset: Tensor
    scale: Tensor

    def __init__(self, inputs: int, hidden: Sequence[int], rng: np.random.Generator) -> None:
        """Makes a value function at random.

        Args:
            inputs: Size of the observation.
            hidden: Units of each hidden layer.
            rng: Where the first weights come from.
        """
        super().__init__()
        self.layers = linear_layers([inputs + TIME_POWERS, *hidden, 1], rng)
        self.register_buffer("offset", torch.zeros(()))
        self.register_buffer("scale", torch.ones(()))

    @staticmethod
    def features(observations: Tensor, time: Tensor) -> Tensor:
        """What the network is fed with.

        Args:
            observations: One per row.
            time: Step of the episode over a reference number of steps, one per row.
        """
        powers = [time[:, None] ** n for n in range(1, TIME_POWERS + 1)]
        return torch.cat([observations.clamp(-10.0, 10.0) / 10.0, *powers], dim=1)

    def normalised(self, features: Tensor) -> Tensor:
        """Values in units of `scale` about `offset`.

        Args:
            features: One per row.
        """
        *hidden, last = self.layers
        h = features
        for layer in hidden:
            h = torch.relu(layer(h))
        return cast(Tensor, last(h))[:, 0]

    def forward(self, features: Tensor) -> Tensor:
        """Values.

        Args:
            features: One per row.
        """
        return self.offset + self.scale * self.normalised(features)

    def rescale(self, returns: Tensor) -> None:
        """Moves offset and scale to some returns; the function stays the same.

        Args:
            returns: What will be fitted.
        """
        offset, scale = returns.mean(), returns.std().clamp(min=1e-6)
        last = cast(nn.Linear, self.layers[-1])
        with torch.no_grad():
            last.weight.mul_(self.scale / scale)
            last.bias.copy_((self.scale * last.bias + self.offset - offset) / scale)
            self.offset.copy_(offset)
            self.scale.copy_(scale)


def _array(parameter: Tensor) -> Array:
    return parameter.detach().cpu().numpy().astype(np.float32, copy=True)
