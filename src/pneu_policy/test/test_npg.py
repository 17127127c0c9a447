# SPDX-License-Identifier: Apache-2.0
"""The natural policy gradient against linear algebra, brute force and an optimal controller."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from scipy.linalg import solve_discrete_are  # noqa: E402

from pneu_policy.learn import npg  # noqa: E402
from pneu_policy.learn.networks import GaussianPolicy, ValueNetwork, mean_action  # noqa: E402
from pneu_policy.learn.settings import NpgSettings  # noqa: E402


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def small_policy(seed=0, inputs=3, actions=2, hidden=(5, 4), scale=100.0):
    """A policy with a last layer that is not small, so that every part of F matters."""
    policy = GaussianPolicy(inputs, actions, hidden, -0.4, -3.0, np.random.default_rng(seed))
    with torch.no_grad():
        policy.layers[-1].weight.mul_(scale)
    return policy.double()


def observations(count=50, inputs=3, seed=1):
    return torch.from_numpy(np.random.default_rng(seed).standard_normal((count, inputs)))


def test_advantages_are_the_discounted_sum_of_temporal_differences():
    rng = np.random.default_rng(0)
    rewards, values = rng.standard_normal((7, 3)), rng.standard_normal((8, 3))
    gamma, exponent = 0.9, 0.7
    expected = np.zeros_like(rewards)
    for episode in range(3):
        for t in range(7):
            for later in range(t, 7):
                delta = (
                    rewards[later, episode]
                    + gamma * values[later + 1, episode]
                    - values[later, episode]
                )
                expected[t, episode] += (gamma * exponent) ** (later - t) * delta
    assert npg.advantages(rewards, values, gamma, exponent) == pytest.approx(expected)


def test_advantages_with_exponent_one_are_returns_less_values():
    rng = np.random.default_rng(0)
    rewards, values = rng.standard_normal((9, 2)), rng.standard_normal((10, 2))
    returns = [
        sum(0.8**n * rewards[t + n] for n in range(9 - t)) + 0.8 ** (9 - t) * values[-1]
        for t in range(9)
    ]
    assert npg.advantages(rewards, values, 0.8, 1.0) == pytest.approx(returns - values[:-1])
    assert npg.discounted(rewards, values[-1], 0.8) == pytest.approx(np.array(returns))


def test_conjugate_gradient_solves_as_numpy_does():
    rng = np.random.default_rng(2)
    root = rng.standard_normal((8, 8))
    matrix, target = root @ root.T + 0.1 * np.eye(8), rng.standard_normal(8)
    as_tensor = torch.from_numpy(matrix)
    found = npg.conjugate_gradient(lambda v: as_tensor @ v, torch.from_numpy(target), 30, 1e-24)
    assert found.numpy() == pytest.approx(np.linalg.solve(matrix, target), rel=1e-6)


def test_conjugate_gradient_with_few_iterations_is_the_best_of_its_krylov_space():
    rng = np.random.default_rng(3)
    root = rng.standard_normal((9, 9))
    matrix, target = root @ root.T + np.eye(9), rng.standard_normal(9)
    as_tensor = torch.from_numpy(matrix)
    found = npg.conjugate_gradient(lambda v: as_tensor @ v, torch.from_numpy(target), 3, 0.0)
    space = np.stack([target, matrix @ target, matrix @ matrix @ target], axis=1)
    best = space @ np.linalg.solve(space.T @ matrix @ space, space.T @ target)
    assert found.numpy() == pytest.approx(best, rel=1e-6)


def kl_hessian(policy, seen):
    """Hessian of the mean KL divergence by automatic differentiation, at the present parameters."""
    shapes = [p.shape for p in policy.ordered()]
    flat = policy.flat()
    layers = range(len(policy.layers))
    names = [f"layers.{n}.{part}" for n in layers for part in ("weight", "bias")] + ["log_std"]
    old_mean, old_log_std = policy(seen).detach(), policy.log_std.detach().clone()

    def divergence(vector):
        parts = torch.split(vector, [shape.numel() for shape in shapes])
        shaped = {n: p.view(s) for n, p, s in zip(names, parts, shapes, strict=True)}
        mean = torch.func.functional_call(policy, shaped, (seen,))
        old = torch.distributions.Normal(old_mean, old_log_std.exp())
        new = torch.distributions.Normal(mean, parts[-1].exp())
        return torch.distributions.kl_divergence(old, new).sum(1).mean()

    return torch.autograd.functional.hessian(divergence, flat)


def test_fisher_product_is_the_hessian_of_the_kl_divergence():
    policy, seen = small_policy(), observations()
    hessian = kl_hessian(policy, seen).numpy()
    sweeps = npg.Sweeps(policy, seen)
    built = [sweeps.fisher(unit, 1e-4).numpy() for unit in torch.eye(len(hessian)).double()]
    assert np.array(built) == pytest.approx(hessian + 1e-4 * np.eye(len(hessian)), abs=1e-10)
    assert np.linalg.norm(hessian) > 0.1


def test_fisher_product_is_the_covariance_of_the_score():
    """Equation 3.12, with many actions drawn per observation."""
    policy, seen = small_policy(hidden=(3,), actions=1), observations(count=8)
    generator = torch.Generator().manual_seed(0)
    total = 0.0
    draws = 4000
    sweeps = npg.Sweeps(policy, seen)
    size = len(policy.flat())
    fisher = torch.stack([sweeps.fisher(unit, 0.0) for unit in torch.eye(size).double()])
    std = policy.log_std.detach().exp()
    for row in range(len(seen)):
        noise = torch.randn(draws, 1, generator=generator, dtype=torch.float64)
        one = npg.Sweeps(policy, seen[row : row + 1])
        mean_part = one.backward(torch.ones(1, 1).double())  # J for one action
        score = torch.cat([noise / std * mean_part, noise**2 - 1.0], dim=1)
        total = total + score.T @ score / (draws * len(seen))
    assert torch.linalg.norm(total - fisher) < 0.05 * torch.linalg.norm(fisher)


def test_gradient_is_that_of_automatic_differentiation():
    policy, seen = small_policy(), observations()
    rng = np.random.default_rng(5)
    actions = torch.from_numpy(rng.standard_normal((50, 2)))
    weights = torch.from_numpy(rng.standard_normal(50))
    likelihood = torch.distributions.Normal(policy(seen), policy.log_std.exp()).log_prob(actions)
    wanted = torch.autograd.grad((likelihood.sum(1) * weights).mean(), list(policy.ordered()))
    found = npg.Sweeps(policy, seen).gradient(actions, weights)
    assert found.numpy() == pytest.approx(
        torch.cat([part.reshape(-1) for part in wanted]).numpy(), abs=1e-12
    )


def test_step_has_the_length_that_was_asked_for():
    """The KL divergence after a small step is delta / 2."""
    policy, seen = small_policy(), observations(count=2000)
    rng = np.random.default_rng(6)
    std = policy.log_std.detach().exp()
    actions = policy(seen).detach() + std * torch.from_numpy(rng.standard_normal((2000, 2)))
    advantage = -((actions[:, 0] - seen[:, 1]) ** 2)
    settings = NpgSettings(delta=1e-5, cg_iterations=60, cg_tolerance=1e-20)
    kl, _ = npg.improve_policy(policy, seen, actions, advantage, settings)
    assert kl == pytest.approx(0.5e-5, rel=0.03)


def step_with(limit, delta=2.0):
    """KL divergence and step size of one step, with a limit of the divergence."""
    policy, seen = small_policy(scale=2000.0), observations(count=2000)
    rng = np.random.default_rng(6)
    std = policy.log_std.detach().exp()
    actions = policy(seen).detach() + std * torch.from_numpy(rng.standard_normal((2000, 2)))
    settings = NpgSettings(delta=delta, kl_limit=limit)
    advantage = -((actions[:, 0] - seen[:, 1]) ** 2)
    return npg.improve_policy(policy, seen, actions, advantage, settings)


@pytest.mark.parametrize("delta", [2.0, 0.5])
def test_a_step_is_halved_until_its_divergence_is_within_the_limit(delta):
    """The limit is a multiple of delta / 2. It is put just above and just below each divergence."""
    kl, step = step_with(0.0, delta)
    for _ in range(3):
        limit = kl / (0.5 * delta)
        assert step_with(limit * (1.0 + 1e-9), delta) == (pytest.approx(kl), pytest.approx(step))
        smaller, half = step_with(limit * (1.0 - 1e-9), delta)
        assert half == pytest.approx(0.5 * step)
        assert 0.0 < smaller < kl
        kl, step = smaller, half


def test_a_step_is_halved_a_limited_number_of_times():
    _, whole = step_with(0.0)
    kl, step = step_with(1e-30)
    assert step == pytest.approx(whole * 0.5**npg.MOST_HALVINGS, rel=0.51)
    assert kl > 0.0


def test_log_std_stays_above_its_floor():
    policy = small_policy()
    vector = policy.flat()
    vector[-2:] = torch.tensor([-9.0, 0.5])
    policy.set_flat(vector)
    assert policy.log_std.tolist() == [-3.0, 0.5]


def test_numpy_forward_is_that_of_torch_and_starts_small():
    policy = GaussianPolicy(6, 1, (32, 32), -0.5, -3.0, np.random.default_rng(0))
    seen = np.random.default_rng(1).standard_normal((9, 6)).astype(np.float32)
    expected = policy(torch.from_numpy(seen)).detach().numpy()
    assert mean_action(policy.weights(), seen) == pytest.approx(expected, abs=1e-6)
    assert np.abs(expected).max() < 0.01


@pytest.mark.long
def test_value_function_is_the_same_after_rescaling_and_fits_large_returns():
    rng = np.random.default_rng(0)
    values = ValueNetwork(2, (128, 128), rng)
    seen = torch.from_numpy(rng.standard_normal((2048, 2)).astype(np.float32))
    time = torch.from_numpy(rng.uniform(0.0, 1.0, 2048).astype(np.float32))
    features = ValueNetwork.features(seen, time)
    assert features.shape == (2048, 6)
    assert features[:, 5].numpy() == pytest.approx(time.numpy() ** 4, rel=1e-5)
    returns = 500.0 + 80.0 * seen[:, 0] - 60.0 * time
    before = values(features).detach().numpy()
    values.rescale(returns)
    assert values(features).detach().numpy() == pytest.approx(before, abs=1e-3)
    optimiser = torch.optim.Adam(values.parameters(), 1e-3, fused=True)
    npg.fit_values(values, optimiser, features, returns, NpgSettings(value_steps=400), rng)
    left = (values(features).detach() - returns).numpy()
    assert np.std(left) < 0.1 * float(returns.std())


class LinearTracking:
    """x' = 0.9 x + 0.3 u + noise shall follow r' = 0.95 r + noise at little effort."""

    A = np.array([[0.9, 0.0], [0.0, 0.95]])
    B = np.array([[0.3], [0.0]])
    Q = np.array([[1.0, -1.0], [-1.0, 1.0]])
    R = np.array([[0.02]])
    NOISE = np.array([0.02, 0.1])

    def run(self, act, seed, steps=80, episodes=32):
        """States before each action and after the last, actions and rewards."""
        rng = np.random.default_rng(seed)
        state = rng.standard_normal((episodes, 2)) * [0.3, 0.3]
        states, actions, rewards = [state], [], []
        for _ in range(steps):
            action = act(state.astype(np.float32))
            cost = np.sum(state @ self.Q * state, axis=1) + self.R[0, 0] * action[:, 0] ** 2
            state = state @ self.A.T + action @ self.B.T
            state = state + self.NOISE * rng.standard_normal(state.shape)
            states.append(state)
            actions.append(action)
            rewards.append(-cost)
        single = [np.stack(part).astype(np.float32) for part in (states, actions, rewards)]
        return npg.Batch(*single)

    def optimal(self):
        """The gain of the linear-quadratic regulator."""
        p = solve_discrete_are(self.A, self.B, self.Q, self.R)
        return np.linalg.solve(self.R + self.B.T @ p @ self.B, self.B.T @ p @ self.A)


@pytest.mark.long
@pytest.mark.parametrize(
    ("hidden", "bootstrap", "share"), [((), True, 0.985), ((), False, 0.985), ((32, 32), True, 0.9)]
)
def test_learns_to_track_almost_as_well_as_the_optimal_controller(hidden, bootstrap, share):
    """A linear policy could be the optimal one; a network has its noise to overcome as well."""
    task = LinearTracking()
    settings = NpgSettings(
        hidden=hidden, value_steps=50, value_hidden=(32,), bootstrap=bootstrap, damping=1e-2
    )
    rng = np.random.default_rng(0)
    policy = GaussianPolicy(2, 1, hidden, -0.5, -3.0, rng)
    values = ValueNetwork(2, settings.value_hidden, rng)
    optimiser = torch.optim.Adam(values.parameters(), 1e-3, fused=True)

    def score(act):
        return task.run(act, seed=99, episodes=64).rewards.mean()

    first = score(lambda seen: mean_action(policy.weights(), seen))
    for iteration in range(60):
        weights, std = policy.weights(), float(policy.log_std.detach().exp())

        def explore(seen, weights=weights, std=std):
            return mean_action(weights, seen) + std * rng.standard_normal((len(seen), 1))

        batch = task.run(explore, seed=1000 + iteration)
        npg.update(policy, values, optimiser, batch, settings, rng)
    learned = score(lambda seen: mean_action(policy.weights(), seen))
    best = score(lambda seen: -seen @ task.optimal().T)
    assert best > 0.4 * first  # costs: the task leaves much to gain
    assert (learned - first) / (best - first) > share
