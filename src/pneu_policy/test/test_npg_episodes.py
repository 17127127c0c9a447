# SPDX-License-Identifier: Apache-2.0
"""One update of the natural policy gradient against sums, closed forms and dense linear algebra.

Episodes have distinct lengths. Some terminate, at steps that are neither the first nor the last;
others are truncated at the horizon. Only a truncated episode may be bootstrapped.
"""

import copy
import math
from itertools import pairwise
from typing import Any

import gymnasium
import numpy as np
import pytest

torch = pytest.importorskip("torch")

from pneu_policy.learn import npg, trainer  # noqa: E402
from pneu_policy.learn.networks import GaussianPolicy, ValueNetwork  # noqa: E402
from pneu_policy.learn.rollout import roll_out  # noqa: E402
from pneu_policy.learn.settings import NpgSettings, TrainSettings  # noqa: E402
from pneu_policy.task.task_env import TaskEnv  # noqa: E402

HORIZON = 12
LENGTHS = (12, 5, 12, 2, 8, 12)
TERMINATED = (False, True, True, True, True, False)
INPUTS, ACTIONS = 3, 2


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


class Lengths(TaskEnv):
    """Six plants with random observations and rewards, of which four terminate by themselves.

    What is seen after an end is far from everything before it.
    """

    unit = ("cm", 0.01)
    mark = 1.0
    period_s = 0.25

    def __init__(self, lengths=LENGTHS, horizon=HORIZON):
        self.lengths, self.horizon = np.array(lengths), horizon
        self.terminating = np.array(TERMINATED[: len(lengths)])
        self.num_envs = len(lengths)
        self.runs = []
        self.single_observation_space = gymnasium.spaces.Box(-99, 99, (INPUTS,), np.float32)
        self.single_action_space = gymnasium.spaces.Box(-1, 1, (ACTIONS,), np.float32)
        self.observation_space = gymnasium.vector.utils.batch_space(
            self.single_observation_space, self.num_envs
        )
        self.action_space = gymnasium.vector.utils.batch_space(
            self.single_action_space, self.num_envs
        )

    def reset(self, *, seed=None, options=None):
        self._rng = np.random.default_rng(seed)
        self._step = 0
        self.seen, self.acted, self.earned, self.off = [self._see()], [], [], []
        self.runs.append((self.seen, self.acted, self.earned))
        return self.seen[0], {}

    def _see(self):
        seen = self._rng.normal(0.0, 1.5, (self.num_envs, INPUTS)).astype(np.float32)
        seen[(self._step > self.lengths)] += 50.0
        return seen

    def step(self, actions):
        self._step += 1
        alive = self._step <= self.lengths
        reward = np.where(alive, self._rng.normal(0.4, 1.0, self.num_envs), 0.0)
        error = self._rng.normal(0.0, 0.02, self.num_envs) + 9.0 * ~alive
        self.acted.append(np.array(actions))
        self.earned.append(reward.astype(np.float32))
        self.off.append(error)
        self.seen.append(self._see())
        over = self.terminating & (self._step >= self.lengths)
        cut = np.full(self.num_envs, self._step == self.horizon)
        info = {"error": error, "success": (error > 0.0) & alive}
        return self.seen[-1], reward, over, cut, info


def networks(bootstrap=True, **changes):
    """Networks in double precision whose every part matters, with settings."""
    settings = NpgSettings(
        gamma=0.9, gae_lambda=0.7, value_steps=3, value_batch=1000, bootstrap=bootstrap,
        hidden=(4,), value_hidden=(6,), damping=0.01, **changes,
    )  # fmt: skip
    rng = np.random.default_rng(3)
    policy = GaussianPolicy(INPUTS, ACTIONS, settings.hidden, -0.4, -3.0, rng).double()
    values = ValueNetwork(INPUTS, settings.value_hidden, rng).double()
    with torch.no_grad():
        policy.layers[-1].weight.mul_(80.0)
        policy.log_std[1] = 0.3
        values.layers[-1].weight.mul_(3.0)
        values.offset.fill_(0.7)
        values.scale.fill_(2.5)
    return policy, values, settings


def value_of(values, observation, step):
    """The value function written out: step over horizon, its powers, ReLU, offset and scale."""
    h = np.concatenate(
        [np.clip(observation, -10, 10) / 10, [(step / HORIZON) ** n for n in (1, 2, 3, 4)]]
    )
    *hidden, last = [
        (layer.weight.detach().numpy(), layer.bias.detach().numpy()) for layer in values.layers
    ]
    for weight, bias in hidden:
        h = np.maximum(weight @ h + bias, 0.0)
    return float(values.offset + values.scale * float((last[0] @ h + last[1])[0]))


def estimates(values, settings, seen, earned):
    """Rows of (step, episode, advantage, return, value), each a sum over the steps after it."""
    rows = []
    for episode, (count, terminated) in enumerate(zip(LENGTHS, TERMINATED, strict=True)):
        value = [value_of(values, seen[t][episode], t) for t in range(count + 1)]
        if terminated or not settings.bootstrap:
            value[count] = 0.0
        reward = [float(earned[t][episode]) for t in range(count)]
        for t in range(count):
            advantage = sum(
                (settings.gamma * settings.gae_lambda) ** (k - t)
                * (reward[k] + settings.gamma * value[k + 1] - value[k])
                for k in range(t, count)
            )
            gain = sum(settings.gamma ** (k - t) * reward[k] for k in range(t, count))
            rows.append((t, episode, advantage, gain, value[t]))
    return rows


def reference(policy, values, settings, seen, acted, earned):
    """Policy, value function and Update that episodes, one after the other, lead to."""
    policy, values = copy.deepcopy(policy), copy.deepcopy(values)
    rows = estimates(values, settings, seen, earned)
    kind = policy.log_std.dtype

    def table(values_of_rows):
        return torch.tensor(np.array(values_of_rows), dtype=kind)

    observations = table([seen[t][e] for t, e, *_ in rows])
    kl, step = npg.improve_policy(
        policy,
        observations,
        table([acted[t][e] for t, e, *_ in rows]),
        table([row[2] for row in rows]),
        settings,
    )
    features = table(
        [
            [*np.clip(seen[t][e], -10, 10) / 10, *(t / HORIZON) ** np.arange(1, 5)]
            for t, e, *_ in rows
        ]
    )
    optimiser = torch.optim.Adam(values.parameters(), settings.value_learning_rate)
    returns = table([row[3] for row in rows])
    npg.fit_values(values, optimiser, features, returns, settings, np.random.default_rng(0))
    gain, known = np.array([row[3] for row in rows]), np.array([row[4] for row in rows])
    return policy, values, npg.Update(kl, step, 1.0 - np.var(gain - known) / np.var(gain))


def flat(network):
    return torch.cat([p.detach().reshape(-1) for p in network.parameters()]).numpy()


@pytest.mark.parametrize("bootstrap", [True, False])
@pytest.mark.parametrize("rescale", [True, False])
def test_an_update_follows_sums_over_each_episode(bootstrap, rescale):
    env = Lengths()
    rng = np.random.default_rng(5)
    episodes = roll_out(env, lambda seen: rng.normal(0.3, 1.2, (6, ACTIONS)), seed=8)
    policy, values, settings = networks(bootstrap, rescale_values=rescale)
    wanted = reference(policy, values, settings, env.seen, env.acted, env.earned)
    start, fitted = flat(policy), flat(values)
    double = [np.asarray(a, np.float64) for a in (env.seen, env.acted, env.earned)]
    batch = npg.Batch(*double, episodes.alive, episodes.ended)
    optimiser = torch.optim.Adam(values.parameters(), settings.value_learning_rate)
    done = npg.update(policy, values, optimiser, batch, settings, np.random.default_rng(0))
    assert flat(policy) == pytest.approx(flat(wanted[0]), abs=1e-7)
    assert flat(values) == pytest.approx(flat(wanted[1]), abs=1e-6)
    assert [done.kl, done.step, done.explained] == pytest.approx(
        [wanted[2].kl, wanted[2].step, wanted[2].explained], rel=1e-5
    )
    assert np.abs(flat(policy) - start).max() > 0.01 and np.abs(flat(values) - fitted).max() > 0.002


def test_episodes_without_an_end_are_all_bootstrapped():
    """None in the place of flags means that no episode terminated."""
    rng = np.random.default_rng(1)
    arrays = [rng.normal(size=size) for size in ((13, 4, 3), (12, 4, 2), (12, 4))]
    found = []
    for flags in ((None, None), (np.ones((12, 4), bool), np.zeros(4, bool))):
        policy, values, settings = networks()
        optimiser = torch.optim.Adam(values.parameters(), 1e-3)
        batch = npg.Batch(*arrays, *flags)
        done = npg.update(policy, values, optimiser, batch, settings, np.random.default_rng(0))
        found.append([*flat(policy), *flat(values), done.kl, done.step, done.explained])
    assert found[0] == pytest.approx(found[1], abs=1e-9)


def test_a_training_learns_from_its_own_episodes():
    """Exploration, flags of ends and the horizon get from the environment into the update."""
    env = Lengths()
    settings = TrainSettings(
        env={"rig": "rigs/rig_a_thin_plate.yaml", "recipe": {"tap": "end", "taps": ["end"]}},
        npg=networks()[2].but(damping=3.0), seed=11, evaluate_every=50, iterations=9,
    )  # fmt: skip
    one = trainer.Trainer(settings, env)
    with torch.no_grad():
        one.policy.layers[-1].weight.mul_(80.0)
        one.policy.log_std.copy_(torch.tensor([-0.4, 0.3]))
        one.values.layers[-1].weight.mul_(3.0)
        one.values.offset.fill_(0.7)
    before, values = copy.deepcopy(one.policy), copy.deepcopy(one.values)
    row = one.iterate()
    (seen_then, acted_then, earned_then), evaluated = env.runs
    noise = np.random.default_rng([11, 2, 0])
    for seen, acted in zip(seen_then, acted_then, strict=False):
        mean = before(torch.from_numpy(seen)).detach().numpy()
        drawn = noise.standard_normal(mean.shape, dtype=np.float32)
        assert acted == pytest.approx(mean + drawn * np.exp([-0.4, 0.3]), abs=1e-5)
    wanted = reference(before, values, settings.npg, seen_then, acted_then, earned_then)
    moved = flat(wanted[0]) - flat(before)
    assert flat(one.policy) - flat(before) == pytest.approx(
        moved, abs=2e-3 * float(np.abs(moved).max())
    )
    fitted = flat(wanted[1]) - flat(values)
    tolerance = 0.02 * float(np.abs(fitted).max())
    assert flat(one.values) - flat(values) == pytest.approx(fitted, abs=tolerance)
    assert row["kl"] == pytest.approx(wanted[2].kl, rel=1e-3)
    assert row["step"] == pytest.approx(wanted[2].step, rel=1e-3)
    assert row["explained"] == pytest.approx(wanted[2].explained, rel=1e-3)
    assert row["score"] == pytest.approx(np.sum(earned_then, axis=0).mean(), rel=1e-6)
    assert row["eval_score"] == pytest.approx(np.sum(evaluated[2], axis=0).mean(), rel=1e-6)
    assert row["samples"] == sum(LENGTHS)
    assert row["simulated_s"] == pytest.approx(0.25 * sum(LENGTHS))
    assert row["std"] == pytest.approx(np.exp([-0.4, 0.3]).mean(), rel=1e-6)
    assert one.iterate()["samples"] == 2 * sum(LENGTHS)
    assert not np.array_equal(env.runs[2][0], seen_then)  # each iteration has its own episodes


def test_episodes_are_counted_up_to_their_ends():
    env = Lengths()
    found = roll_out(env, lambda seen: np.full((6, ACTIONS), 0.1), seed=2)
    step = np.arange(HORIZON)[:, None]
    assert np.array_equal(found.alive, step < np.array(LENGTHS))
    assert found.ended.tolist() == list(TERMINATED)
    assert found.samples == sum(LENGTHS)
    errors = [env.off[t][e] for e, count in enumerate(LENGTHS) for t in range(count)]
    assert found.rmse == pytest.approx(np.sqrt(np.mean(np.square(errors))) / 0.01)
    assert found.successful == pytest.approx(sum(np.array(errors) > 0.0) / (6 * HORIZON))
    assert found.observations == pytest.approx(np.array(env.seen))
    assert found.score == pytest.approx(np.sum(env.earned, dtype=float) / 6)


def test_a_roll_out_ends_with_its_last_episode():
    early = Lengths((12, 5, 9, 2, 8)[1:])
    early.terminating[:] = True
    found = roll_out(early, lambda seen: np.zeros((4, ACTIONS)), seed=0)
    assert len(found.rewards) == 9 and found.ended.all()
    together = Lengths((7, 7, 7), horizon=7)
    together.terminating[:] = False
    found = roll_out(together, lambda seen: np.zeros((3, ACTIONS)), seed=0)
    assert found.alive is None and found.ended is None and found.samples == 21
    env = Lengths()
    step = env.step

    def cut_one(actions):
        seen, reward, over, cut, info = step(actions)
        cut[2] |= env._step == 4
        return seen, reward, over, cut, info

    env.step = cut_one
    with pytest.raises(ValueError, match="only 1 of 6 episodes were cut off after step 3"):
        roll_out(env, lambda seen: np.zeros((6, ACTIONS)), seed=0)


# -- The step of the policy ------------------------------------------------------------------------


def linear_case(log_std_floor=-3.0):
    """A linear Gaussian policy, and what it is improved by."""
    rng = np.random.default_rng(17)
    policy = GaussianPolicy(INPUTS, ACTIONS, (), -0.4, log_std_floor, rng).double()
    with torch.no_grad():
        policy.layers[0].weight.copy_(torch.from_numpy(rng.normal(size=(2, 3))))
        policy.layers[0].bias.copy_(torch.from_numpy(rng.normal(size=2)))
        policy.log_std[1] = 0.3
    seen = rng.normal([0.3, -0.5, 1.0], [1.0, 2.0, 0.6], (40, INPUTS))
    mean = policy(torch.from_numpy(seen)).detach().numpy()
    actions = mean + np.exp([-0.4, 0.3]) * rng.normal(size=(40, 2))
    advantage = 3.0 - (actions[:, 0] - seen[:, 1]) ** 2 + 0.7 * actions[:, 1]
    return policy, seen, actions, advantage


def dense_step(policy, seen, actions, advantage, settings):
    """Step size and direction by gradient and Fisher matrix written out sample by sample."""
    std = policy.log_std.detach().exp().numpy()
    mean = policy(torch.from_numpy(seen)).detach().numpy()
    white = (advantage - np.mean(advantage)) / (np.std(advantage) + 1e-6)
    gradient, fisher = np.zeros(10), np.zeros((10, 10))
    for x, a, m, weight in zip(seen, actions, mean, white, strict=True):
        # derivatives of the two mean actions by weights (row by row), biases, log_std
        slope = np.zeros((2, 10))
        slope[0, :3] = slope[1, 3:6] = x
        slope[0, 6] = slope[1, 7] = 1.0
        away = (a - m) / std
        score = slope.T @ (away / std)
        score[8:] = away**2 - 1.0
        gradient += weight * score / len(seen)
        fisher += slope.T @ np.diag(std**-2) @ slope / len(seen)
    fisher[8:, 8:] = 2.0 * np.eye(2)
    natural = np.linalg.solve(fisher + settings.damping * np.eye(10), gradient)
    return math.sqrt(settings.delta / (gradient @ natural)), natural


def divergence(policy, vector, seen, floor):
    """Mean KL divergence from a policy to the one of another vector, by torch's distributions."""
    mean = policy(torch.from_numpy(seen)).detach()
    new = seen @ vector[:6].reshape(2, 3).T + vector[6:8]
    old = torch.distributions.Normal(mean, policy.log_std.detach().exp())
    other = torch.distributions.Normal(
        torch.from_numpy(new), torch.from_numpy(np.exp(np.maximum(vector[8:], floor)))
    )
    return float(torch.distributions.kl_divergence(old, other).sum(1).mean())


EXACT: dict[str, Any] = {"cg_iterations": 200, "cg_tolerance": 1e-30, "damping": 0.03}


def improved(settings, floor):
    """Policy before, vector after, reported KL and step."""
    policy, *rest = linear_case(floor)
    before = copy.deepcopy(policy)
    kl, step = npg.improve_policy(policy, *map(torch.from_numpy, rest), settings)
    return before, rest, policy.flat().numpy(), kl, step


@pytest.mark.parametrize("floor", [-3.0, -0.41])
def test_the_step_of_a_linear_policy_is_that_of_dense_algebra(floor):
    settings = NpgSettings(delta=0.02, kl_limit=0.0, **EXACT)
    before, rest, after, kl, step = improved(settings, floor)
    size, natural = dense_step(before, *rest, settings)
    wanted = before.flat().numpy() + size * natural
    assert (wanted[8] < -0.41) and wanted[9] > -0.41  # the first action meets the higher floor
    wanted[8:] = np.maximum(wanted[8:], floor)
    assert after == pytest.approx(wanted, abs=1e-9)
    assert step == pytest.approx(size, rel=1e-8)
    assert kl == pytest.approx(divergence(before, wanted, rest[0], floor), rel=1e-8)


@pytest.mark.parametrize(("halvings", "more"), [(0, 1.001), (1, 1.001), (2, 0.999), (4, 1.001)])
def test_a_step_is_halved_until_its_divergence_is_within_the_limit(halvings, more):
    settings = NpgSettings(delta=6.0, kl_limit=0.0, **EXACT)
    before, rest, *_ = improved(settings, -3.0)
    size, natural = dense_step(before, *rest, settings)
    tried = [before.flat().numpy() + size * 0.5**k * natural for k in range(8)]
    kl = [divergence(before, one, rest[0], -3.0) for one in tried]
    assert all(a > 1.5 * b for a, b in pairwise(kl))
    limit = more * kl[halvings] / (0.5 * settings.delta)
    wanted = halvings if more > 1.0 else halvings + 1
    *_, after, found, step = improved(settings.but(kl_limit=limit), -3.0)
    assert after == pytest.approx(tried[wanted], abs=1e-8)
    assert found == pytest.approx(kl[wanted], rel=1e-7)
    assert step == pytest.approx(size * 0.5**wanted, rel=1e-8)


def test_the_reported_step_is_the_one_taken_where_no_halving_is_enough():
    settings = NpgSettings(delta=6.0, kl_limit=1e-12, **EXACT)
    before, rest, after, kl, step = improved(settings, -3.0)
    size, natural = dense_step(before, *rest, settings)
    assert step == pytest.approx(size * 0.5**npg.MOST_HALVINGS, rel=1e-8)
    assert after == pytest.approx(before.flat().numpy() + step * natural, abs=1e-9)
    assert kl == pytest.approx(divergence(before, after, rest[0], -3.0), rel=1e-4)


def test_conjugate_gradient_ends_at_its_tolerance():
    """Squared residuals of a diagonal problem are known: one product leaves that of one step."""
    diagonal, target = np.array([1.0, 2.0, 7.0]), np.array([3.0, -1.0, 0.5])
    length = target @ target / (target @ (diagonal * target))
    left = float(np.sum((target - length * diagonal * target) ** 2))
    for tolerance, count in ((1.01 * target @ target, 0), (1.01 * left, 1), (0.99 * left, 2)):
        products = []

        def product(v, products=products):
            products.append(v)
            return torch.from_numpy(diagonal) * v

        npg.conjugate_gradient(product, torch.from_numpy(target), 2, tolerance)
        assert len(products) == count


# -- The value function ----------------------------------------------------------------------------


def test_features_of_the_value_function_are_clipped_and_carry_powers_of_time():
    seen = np.array([[-25.0, 4.0, 0.5], [3.0, 10.5, -7.0]])
    time = np.array([0.25, 0.75])
    found = ValueNetwork.features(torch.from_numpy(seen), torch.from_numpy(time)).numpy()
    wanted = [
        [-1.0, 0.4, 0.05, 0.25, 0.0625, 0.015625, 0.00390625],
        [0.3, 1.0, -0.7, 0.75, 0.5625, 0.421875, 0.31640625],
    ]
    assert found == pytest.approx(np.array(wanted))


def test_rescaling_moves_the_units_and_not_the_function():
    values = networks()[1]
    features = torch.from_numpy(np.random.default_rng(2).normal(size=(9, INPUTS + 4)))
    before = values(features).detach().numpy()
    returns = torch.tensor([3.0, -5.0, 11.0, 40.0]).double()
    values.rescale(returns)
    assert values(features).detach().numpy() == pytest.approx(before, rel=1e-9)
    assert float(values.offset) == pytest.approx(12.25)
    assert float(values.scale) == pytest.approx(np.std([3.0, -5.0, 11.0, 40.0], ddof=1))


@pytest.mark.parametrize("rescale", [True, False])
def test_values_are_fitted_by_gradient_steps_on_parts_of_the_batch(rescale):
    """A linear value function by plain gradient descent: each step is one line of NumPy."""
    rng = np.random.default_rng(4)
    values = ValueNetwork(INPUTS, (), rng).double()
    values.offset.fill_(0.7)
    values.scale.fill_(2.5)
    features, returns = rng.normal(size=(7, INPUTS + 4)), rng.normal(2.0, 3.0, 7)
    if rescale:
        offset, scale = returns.mean(), returns.std(ddof=1)
    else:
        offset, scale = 0.7, 2.5
    weight = values.layers[0].weight.detach().numpy()[0] * 2.5 / scale
    bias = (values.layers[0].bias.item() * 2.5 + 0.7 - offset) / scale
    optimiser = torch.optim.SGD(values.parameters(), 0.05)
    settings = NpgSettings(value_steps=5, value_batch=3, rescale_values=rescale)
    npg.fit_values(
        values,
        optimiser,
        torch.from_numpy(features),
        torch.from_numpy(returns),
        settings,
        np.random.default_rng(6),
    )
    order = np.random.default_rng(6)
    parts = []
    while len(parts) < 5:  # two whole parts of three to a pass; the seventh row waits
        drawn = order.permutation(7)
        parts += [drawn[:3], drawn[3:6]]
    for part in parts[:5]:
        off = features[part] @ weight + bias - (returns[part] - offset) / scale
        weight = weight - 0.05 * 2.0 * np.mean(off[:, None] * features[part], axis=0)
        bias = bias - 0.05 * 2.0 * np.mean(off)
    assert values.layers[0].weight.detach().numpy()[0] == pytest.approx(weight, rel=1e-9)
    assert values.layers[0].bias.item() == pytest.approx(bias, rel=1e-9)


@pytest.mark.parametrize("terminated", [False, True])
def test_the_yardstick_bootstraps_what_was_cut_off_alone(terminated):
    pytest.importorskip("stable_baselines3")
    from pneu_policy.learn.ppo import Adapter

    env = Lengths((3, 3, 3), horizon=3)
    env.terminating[:] = terminated, terminated, False
    adapter = Adapter(env, seed=1)
    adapter.reset()
    for k in range(3):
        last, _, done, infos = adapter.step(np.zeros((3, ACTIONS)))
        if k < 2:
            assert not done.any() and infos == [{}, {}, {}]
    assert done.all()
    cut = [info["TimeLimit.truncated"] for info in infos]
    assert cut == [not terminated, not terminated, True]
    (ended, *_), (begun, *_) = env.runs
    assert len(begun) == 1 and np.array_equal(last, begun[0])  # the next episodes began
    assert np.array_equal([info["terminal_observation"] for info in infos], ended[3])
