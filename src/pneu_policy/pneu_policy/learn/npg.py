# SPDX-License-Identifier: Apache-2.0
"""The natural policy gradient (thesis 3.1, algorithm 1; Rajeswaran et al., NIPS 2017).

One update takes a batch of episodes of equal length, estimates advantages (GAE, Schulman et al.
2016), follows F^-1 g with a step normalised in the metric of F, and then fits the value function.

The product with the Fisher matrix F, the Hessian of the mean KL divergence from the old policy, is
taken by one forward and one backward sweep through the network in place of double back-propagation.
At the old parameters the two are the same matrix: the divergence of two Gaussians has a zero first
derivative there, which leaves only J^T diag(1/std^2) J for the mean and 2 I for log_std. The sweeps
share the activations of all products of an update, which makes them several times faster.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from pneu_policy.learn.networks import GaussianPolicy, ValueNetwork
from pneu_policy.learn.settings import NpgSettings

Array = NDArray[np.float32]

MOST_HALVINGS = 10
"""Of a step whose measured divergence is over its limit."""


@dataclass(frozen=True)
class Batch:
    """Episodes side by side; the horizon cuts all of them off that have not ended by themselves.

    Attributes:
        observations: Before each action and after the last one: (steps + 1, episodes, size).
        actions: (steps, episodes, size).
        rewards: (steps, episodes), zero after an end.
        alive: Whether an episode had not ended before a step, (steps, episodes); None is always.
        ended: Whether it has ended by itself, (episodes,); None is never.
    """

    observations: Array
    actions: Array
    rewards: Array
    alive: NDArray[np.bool_] | None = None
    ended: NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class Update:
    """What one update did.

    Attributes:
        kl: Mean KL divergence from the old to the new policy.
        step: Step size alpha along F^-1 g.
        explained: Share of the variance of the returns that the value function knew before its fit.
    """

    kl: float
    step: float
    explained: float


def discounted(rewards: Array, last: Array, gamma: float) -> Array:
    """Discounted returns from every step on.

    Args:
        rewards: (steps, episodes).
        last: Value after the last step, (episodes,).
        gamma: Discount factor.

    Returns:
        (steps, episodes).
    """
    returns = np.empty_like(rewards)
    ahead = last
    for step in range(len(rewards) - 1, -1, -1):
        ahead = rewards[step] + gamma * ahead
        returns[step] = ahead
    return returns


def advantages(rewards: Array, values: Array, gamma: float, gae_lambda: float) -> Array:
    """Generalised advantage estimates (Schulman et al. 2016, equation 16).

    Args:
        rewards: (steps, episodes).
        values: Value before every step and after the last one, (steps + 1, episodes).
        gamma: Discount factor.
        gae_lambda: GAE exponent.

    Returns:
        (steps, episodes).
    """
    deltas = rewards + gamma * values[1:] - values[:-1]
    return discounted(deltas, np.zeros_like(values[0]), gamma * gae_lambda)


def conjugate_gradient(
    product: Callable[[Tensor], Tensor], target: Tensor, iterations: int, tolerance: float
) -> Tensor:
    """Solves A x = b from x = 0.

    Args:
        product: A times a vector; symmetric and positive.
        target: b.
        iterations: Most products taken.
        tolerance: Ends once the squared residual is below it.

    Returns:
        x.
    """
    x = torch.zeros_like(target)
    residual = target.clone()
    direction = residual.clone()
    squared = residual.dot(residual)
    for _ in range(iterations):
        if squared < tolerance:
            break
        through = product(direction)
        step = squared / direction.dot(through)
        x += step * direction
        residual -= step * through
        before, squared = squared, residual.dot(residual)
        direction = residual + (squared / before) * direction
    return x


class Sweeps:
    """Forward and backward sweeps through a policy's network at fixed observations.

    Attributes:
        policy: The policy.
        inputs: What each layer is fed with, one row per observation.
        mean: Mean actions.
    """

    def __init__(self, policy: GaussianPolicy, observations: Tensor) -> None:
        """Runs the network once.

        Args:
            policy: The policy; its parameters must stay while the sweeps are used.
            observations: One per row.
        """
        self.policy = policy
        *hidden, last = policy.linear()
        self._weights = [layer.weight.detach() for layer in (*hidden, last)]
        self.inputs = [observations]
        for layer in hidden:
            self.inputs.append(torch.tanh(layer(self.inputs[-1])).detach())
        self.mean: Tensor = last(self.inputs[-1]).detach()
        self._slopes = [1.0 - h * h for h in self.inputs[1:]]

    def forward(self, vector: Tensor) -> Tensor:
        """J v: the change of the mean actions along a direction of the parameters.

        Args:
            vector: Direction, in the order of the policy's flat vector.
        """
        start = 0
        change: Tensor | None = None
        for index, weight in enumerate(self._weights):
            outputs, size = weight.shape[0], weight.numel()
            turn = vector[start : start + size].view_as(weight)
            shift = vector[start + size : start + size + outputs]
            start += size + outputs
            through = torch.addmm(shift, self.inputs[index], turn.T)
            if change is not None:
                through.addmm_(change, weight.T)
            last = index == len(self._weights) - 1
            change = through if last else through.mul_(self._slopes[index])
        assert change is not None  # a policy has at least one layer
        return change

    def backward(self, pull: Tensor) -> Tensor:
        """J^T u, without the place of log_std.

        Args:
            pull: u, one row per observation.
        """
        parts: list[Tensor] = []
        for index in range(len(self._weights) - 1, -1, -1):
            parts = [(pull.T @ self.inputs[index]).reshape(-1), pull.sum(0), *parts]
            if index > 0:
                pull = (pull @ self._weights[index]).mul_(self._slopes[index - 1])
        return torch.cat(parts)

    def fisher(self, vector: Tensor, damping: float) -> Tensor:
        """(F + damping I) v.

        Args:
            vector: v, in the order of the policy's flat vector.
            damping: Added to the diagonal.
        """
        log_std = self.policy.log_std.detach()
        split = len(vector) - len(log_std)
        pull = self.forward(vector[:split]) * (torch.exp(-2.0 * log_std) / len(self.mean))
        return torch.cat([self.backward(pull), 2.0 * vector[split:]]) + damping * vector

    def gradient(self, actions: Tensor, weights: Tensor) -> Tensor:
        """The mean of weight times the gradient of log pi(action).

        Args:
            actions: One per row.
            weights: One per row; advantages make it the policy gradient.
        """
        log_std = self.policy.log_std.detach()
        away = (actions - self.mean) * torch.exp(-log_std)
        share = weights[:, None] / len(weights)
        of_std = (share * (away * away - 1.0)).sum(0)
        return torch.cat([self.backward(share * away * torch.exp(-log_std)), of_std])


def mean_kl(mean: Tensor, log_std: Tensor, new_mean: Tensor, new_log_std: Tensor) -> float:
    """Mean KL divergence from one Gaussian policy to another.

    Args:
        mean: Old mean actions, one per row.
        log_std: Old logarithm of the standard deviation.
        new_mean: New mean actions.
        new_log_std: New logarithm of the standard deviation.
    """
    variance = torch.exp(2.0 * log_std)
    spread = (variance + (mean - new_mean) ** 2) / (2.0 * torch.exp(2.0 * new_log_std))
    return float((spread - 0.5 + new_log_std - log_std).sum(1).mean())


def improve_policy(
    policy: GaussianPolicy,
    observations: Tensor,
    actions: Tensor,
    advantage: Tensor,
    settings: NpgSettings,
) -> tuple[float, float]:
    """One normalised step along the natural gradient (equation 3.14).

    The step has length delta in the metric of F, so the KL divergence is about delta / 2.

    Args:
        policy: The policy; changed.
        observations: One per row.
        actions: What was done, one per row.
        advantage: How much better than expected that was, one per row; whitened here.
        settings: Hyperparameters.

    Returns:
        The KL divergence and the step size alpha.
    """
    white = (advantage - advantage.mean()) / (advantage.std(correction=0) + 1e-6)
    with torch.no_grad():
        sweeps = Sweeps(policy, observations)
        gradient = sweeps.gradient(actions, white)
        natural = conjugate_gradient(
            lambda v: sweeps.fisher(v, settings.damping),
            gradient,
            settings.cg_iterations,
            settings.cg_tolerance,
        )
        length = float(gradient.dot(natural))
        step = math.sqrt(abs(settings.delta / (length + 1e-20)))
        log_std = policy.log_std.detach().clone()
        start = policy.flat()
        for halvings in range(MOST_HALVINGS + 1):
            if halvings:
                step *= 0.5
            policy.set_flat(start + step * natural)
            kl = mean_kl(sweeps.mean, log_std, policy(observations), policy.log_std)
            if settings.kl_limit == 0.0 or kl <= settings.kl_limit * 0.5 * settings.delta:
                break
    return kl, step


def fit_values(
    values: ValueNetwork,
    optimiser: torch.optim.Optimizer,
    features: Tensor,
    returns: Tensor,
    settings: NpgSettings,
    rng: np.random.Generator,
) -> None:
    """Fits the value function to returns by gradient steps on random parts of the batch.

    Args:
        values: The value function; changed.
        optimiser: The optimiser of its parameters.
        features: One per row.
        returns: One per row.
        settings: Hyperparameters.
        rng: Where the order comes from.
    """
    if settings.rescale_values:
        values.rescale(returns)
    targets = (returns - values.offset) / values.scale
    size = min(settings.value_batch, len(returns))
    per_pass = len(returns) // size
    for step in range(settings.value_steps):
        if step % per_pass == 0:
            order = torch.from_numpy(rng.permutation(len(returns))).to(returns.device)
        chosen = order[(step % per_pass) * size : (step % per_pass + 1) * size]
        loss = torch.nn.functional.mse_loss(values.normalised(features[chosen]), targets[chosen])
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()


def update(
    policy: GaussianPolicy,
    values: ValueNetwork,
    optimiser: torch.optim.Optimizer,
    batch: Batch,
    settings: NpgSettings,
    rng: np.random.Generator,
) -> Update:
    """One iteration of algorithm 1 on a batch of episodes.

    Args:
        policy: The policy; changed.
        values: The value function; changed.
        optimiser: The optimiser of the value function; changed.
        batch: The episodes, made by this policy.
        settings: Hyperparameters.
        rng: Where the order of the value function's steps comes from.

    Returns:
        What was done.
    """
    device = policy.log_std.device
    steps, episodes = batch.rewards.shape
    observations = torch.from_numpy(batch.observations).to(device).flatten(0, 1)
    # `steps` is the reference, so that the powers of time stay within 0 and 1
    time = torch.arange(steps + 1, device=device, dtype=torch.float32) / steps
    features = ValueNetwork.features(observations, time.repeat_interleave(episodes))
    with torch.no_grad():
        known = values(features).cpu().numpy().reshape(steps + 1, episodes)
    if not settings.bootstrap:
        known[-1] = 0.0
    if batch.alive is not None:  # after an end there is nothing to earn
        known[:-1] *= batch.alive
    if batch.ended is not None:
        known[-1] *= ~batch.ended
    advantage = advantages(batch.rewards, known, settings.gamma, settings.gae_lambda)
    # Returns end at the horizon: fitted to its own value there, the network drifts away.
    returns = discounted(batch.rewards, np.zeros_like(known[-1]), settings.gamma)

    count = steps * episodes
    counted: slice | Tensor = slice(None)
    if batch.alive is not None:
        counted = torch.from_numpy(np.flatnonzero(batch.alive)).to(device)
    kl, step = improve_policy(
        policy,
        observations[:count][counted],
        torch.from_numpy(batch.actions).to(device).flatten(0, 1)[counted],
        torch.from_numpy(advantage).to(device).flatten()[counted],
        settings,
    )
    fit_values(
        values,
        optimiser,
        features[:count][counted],
        torch.from_numpy(returns).to(device).flatten()[counted],
        settings,
        rng,
    )
    took = np.ones_like(returns, dtype=bool) if batch.alive is None else batch.alive
    left = float(np.var((returns - known[:-1])[took]))
    spread = max(float(np.var(returns[took])), 1e-12)
    return Update(kl=kl, step=step, explained=1.0 - left / spread)
