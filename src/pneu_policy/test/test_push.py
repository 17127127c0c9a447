# SPDX-License-Identifier: Apache-2.0
"""Arms that push a thing along a path: what a policy sees, plants, its file, how it is judged."""

import math
from pathlib import Path

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")
mujoco = pytest.importorskip("mujoco")

from pneu_common.errors import InputError  # noqa: E402
from pneu_policy.control.policy_file import PolicyFile  # noqa: E402
from pneu_policy.control.push import PushObserver, PushRecipe  # noqa: E402
from pneu_policy.control.push_policy import PushPolicy  # noqa: E402
from pneu_policy.control.pusher import Pusher  # noqa: E402
from pneu_policy.judge.pushed import push_plant  # noqa: E402
from pneu_policy.task.push_paths import PATH_KINDS, PushPath  # noqa: E402
from pneu_policy.task.pushing import Pushing, PushSettings  # noqa: E402
from pneu_sim.hand.loading import Hand  # noqa: E402
from pneu_sim.hand.truth import Change, Truth  # noqa: E402

ROOT = Path(__file__).parents[3]
HAND = ROOT / "scenes/phantom/pushing.yaml"
ARMS = ["one", "two", "three"]
RECIPE = PushRecipe()
PLAIN = {"hand": str(HAND), "num_envs": 3, "horizon": 10, "threads": 1}


@pytest.fixture(scope="module")
def hand():
    return Hand(HAND)


def make_policy(seed=0, scale=1.0):
    rng = np.random.default_rng(seed)
    size = RECIPE.size(3)
    weights = [
        (rng.normal(size=(8, size)).astype("f4") / 6, np.zeros(8, "f4")),
        ((scale * rng.normal(size=(6, 8))).astype("f4"), np.zeros(6, "f4")),
    ]
    return PushPolicy(weights, RECIPE, ARMS, {"seed": seed})


@pytest.mark.parametrize("kind", PATH_KINDS)
def test_a_path_begins_at_rest_and_stays_within_its_reach(kind):
    path = PushPath(kind, 0.03, 4.0, seed=5)
    time_s = np.linspace(0.0, 40.0, 40_001)
    at = path.at(time_s)
    assert np.allclose(at[:3], 0.0, atol=1e-9)
    far = np.linalg.norm(at, axis=1)
    assert 0.97 * 0.03 < far.max() < 1.005 * 0.03
    assert np.linalg.norm(np.diff(at, axis=0), axis=1).max() / 1e-3 < 3.5 * 0.03 * 2.0 * math.pi / 4
    same, other = PushPath(kind, 0.03, 4.0, seed=5), PushPath(kind, 0.03, 4.0, seed=6)
    assert np.array_equal(same.at(time_s), at) and not np.array_equal(other.at(time_s), at)
    if kind == "circle":
        assert np.allclose(far[2600:], 0.03, rtol=1e-3)
        assert np.allclose(at[10_000], at[14_000], atol=1e-9)


def test_forces_push_lift_and_fence():
    home = np.array([[0.06, 0.0, 0.04], [-0.03, 0.05, 0.04]])
    tips = np.array([[[0.06, 0.0, 0.03], [-0.03, 0.05 + 0.10, 0.04]]])
    force = RECIPE.forces(np.array([[0.5, -2.0, 0.0, 0.0]]), tips, home)
    assert np.allclose(force[0, 0], [0.8, -1.6, 40.0 * 0.01])  # cut off at one
    assert np.allclose(force[0, 1], [0.0, -60.0 * (0.10 - RECIPE.roam_m), 0.0])


def test_features_are_what_they_say():
    see = PushObserver(RECIPE, 3)
    tips = np.arange(9.0).reshape(1, 3, 3) / 100.0
    path = np.tile([0.01, 0.0], (1, 4, 1))
    first = see.observe(tips, np.zeros((1, 3, 3)), np.zeros((1, 2)), path)
    assert first.shape == (1, RECIPE.size(3)) == (1, 35)
    assert np.allclose(first[0, :6], tips[0, :, :2].ravel() / 0.05)
    assert np.allclose(first[0, 17:19], 0.0)  # nothing moved yet
    assert np.allclose(first[0, 19:27], [0.5, 0.0] * 4)
    see.acted(np.full((1, 6), 3.0))
    moved = see.observe(tips, np.zeros((1, 3, 3)), np.array([[0.004, 0.0]]), path)
    assert np.allclose(moved[0, 17:19], [0.2 / 0.2, 0.0])
    assert np.allclose(moved[0, -6:], 1.0)
    off, share = 0.0, math.exp(-0.02 / 0.5)
    for error in (0.01, 0.006):
        off = share * off + (1.0 - share) * error
    assert moved[0, 27] == pytest.approx(off / 0.02)
    see.reset()
    again = see.observe(tips, np.zeros((1, 3, 3)), np.zeros((1, 2)), path)
    assert np.array_equal(again, first)
    with pytest.raises(ValueError, match="thing"):
        see.observe(tips, np.zeros((1, 3, 3)), np.array([[math.nan, 0.0]]), path)


def test_seeds_decide_episodes_and_plants():
    def run(seed, **changes):
        env = Pushing(PushSettings(**(PLAIN | changes)))
        seen, _ = env.reset(seed=seed)
        out = [seen]
        rng = np.random.default_rng(0)
        for _ in range(10):
            seen, reward, _, done, info = env.step(rng.normal(size=(3, 6)))
            out.append(seen)
        assert done.all() and info["error"].shape == (3,)
        off = np.linalg.norm(info["thing_m"] - info["path_m"], axis=1)
        assert np.allclose(info["error"], off) and np.isfinite(reward).all()
        return np.array(out)

    first = run(3)
    assert np.array_equal(first, run(3)) and not np.array_equal(first, run(4))
    assert np.array_equal(first, run(3, threads=2))
    drawn = [{"of": "geom", "name": "object", "set": "mass", "times": [0.5, 2.0]}]
    env = Pushing(PushSettings(**(PLAIN | {"drawn": drawn, "num_envs": 20})))
    masses = [float(m.body("object").mass[0]) for m in env.models]
    assert 0.075 <= min(masses) < 0.12 < 0.18 < max(masses) <= 0.3


@pytest.mark.parametrize("kept", ["all", "off", "log", "near", "effort", "offset"])
def test_the_reward_is_what_it_says(kept):
    """By hand from where things are; each term alone, and all of them."""
    weights = {"off": 3.0, "log": 0.7, "near": 0.9, "effort": 0.4, "offset": 1.25}
    if kept != "all":
        weights = {name: weights[name] if name == kept else 0.0 for name in weights}
    env = Pushing(PushSettings(**(PLAIN | {"reward": weights | {"floor_m": 0.002}})))
    env.reset(seed=1)
    floored = set()
    for _ in range(4):
        action = np.random.default_rng(5).uniform(-1.5, 1.5, (3, 6))
        _, reward, ended, done, info = env.step(action)
        assert not ended.any() and not done.any()
        for k in range(3):
            error = math.dist(info["thing_m"][k], info["path_m"][k])
            gaps = [math.dist(tip[:2], info["thing_m"][k]) for tip in env._tips[k]]
            cut = [min(max(x, -1.0), 1.0) for x in action[k]]
            expected = weights["offset"] - weights["off"] * error / 0.02
            expected -= weights["log"] * math.log2(max(error / 0.002, 1.0))
            expected -= weights["near"] * sum(gaps) / 3 / 0.05
            expected -= weights["effort"] * sum(x * x for x in cut) / 6
            assert reward[k] == pytest.approx(expected, rel=1e-9, abs=1e-12)
            assert info["error"][k] == pytest.approx(error)
            floored.add(error < 0.002)
    assert floored == {True, False}
    env.close()


def test_an_episode_ends_at_its_horizon():
    env = Pushing(PushSettings(**(PLAIN | {"horizon": 2})))
    still = np.zeros((3, 6))
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(still)
    env.reset(seed=1)
    assert not env.step(still)[3].any()
    assert env.step(still)[3].all()
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"the episodes are over; reset begins"):
        env.step(still)
    with pytest.raises(InputError, match=r"^seed: found a list, one seed decides all episodes"):
        env.reset(seed=[1, 2, 3])


def test_delays_and_places_are_drawn_within_their_ranges():
    env = Pushing(PushSettings(**(PLAIN | {"num_envs": 40, "delay_s": (0.003, 0.009)})))
    env.reset(seed=2)
    assert set(env._late.tolist()) == {2, 3, 4}  # steps of 2 ms, the nearest
    off = env._thing - np.array([data.body("object").xpos[:2] for data in env._plants])
    assert np.allclose(off, 0.0)
    home = env.hand.spec().compile().body("object").pos[:2]
    begun = env._thing - home
    assert 0.0025 < np.abs(begun).max() <= 0.003 and np.abs(begun).min() < 0.001
    assert np.abs(begun.mean(axis=0)).max() < 0.001
    late = Pushing(PushSettings(**(PLAIN | {"delay_s": (0.1, 0.2)})))
    late.reset(seed=2)
    assert set(late._late.tolist()) == {late._steps}, "no later than the next period"


@pytest.mark.parametrize(("share", "fits"), [(1.0 + 1e-7, True), (1.0 - 1e-7, True), (1.01, False)])
def test_a_period_is_a_whole_number_of_steps(share, fits):
    given = PLAIN | {"physics_step_s": RECIPE.period_s / 10.0 * share, "num_envs": 1}
    if fits:
        assert Pushing(PushSettings(**given))._steps == 10
        return
    with pytest.raises(InputError, match=r"the control period of 0\.02 s must be a whole multiple"):
        Pushing(PushSettings(**given))


def test_what_motors_close_is_in_the_plants():
    """Joints are damped as by the loop of a bridge, besides what they are by themselves."""
    env = Pushing(PushSettings(**PLAIN))
    model = env.models[0]
    bare = env.hand.spec().compile()
    waist, shoulder = (model.joint(f"two_{j}").dofadr[0] for j in ("waist", "shoulder"))
    assert model.dof_damping[waist] - bare.dof_damping[waist] == pytest.approx(0.12)
    assert model.dof_damping[shoulder] - bare.dof_damping[shoulder] == pytest.approx(0.12)
    tendon = model.tendon("two_linkage").id
    assert model.tendon_damping[tendon] - bare.tendon_damping[tendon] == pytest.approx(0.08)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"thing": "cup"}, "thing: found 'cup', poses of .* are object"),
        ({"physics_step_s": 0.003}, "physics_step_s: found 0.003"),
        ({"model": [{"of": "geom", "name": "cup", "set": "mass", "to": 1.0}]}, "no geom 'cup'"),
        ({"drawn": [{"of": "geom", "name": "plane", "set": "mass", "times": [0.0, 1.0]}]}, "times"),
        ({"hand": "none.yaml"}, "none.yaml"),
        ({"colour": 1}, "unknown key 'colour'"),
    ],
)
def test_settings_that_are_wrong_are_one_sentence(change, says):
    with pytest.raises(InputError, match=says):
        Pushing(PushSettings(**(PLAIN | change)))


def test_a_file_comes_back_as_it_was_and_is_no_other(tmp_path, hand):
    policy = make_policy()
    policy.save(tmp_path / "push.npz")
    again = PushPolicy.load(tmp_path / "push.npz")
    assert again.recipe == RECIPE and again.arms == ARMS and again.training == {"seed": 0}
    features = np.random.default_rng(1).normal(size=(20, 35))
    written = [w for w in policy.weights]
    for f in features:
        by_hand = written[1][0] @ np.tanh(written[0][0] @ f + written[0][1]) + written[1][1]
        assert np.allclose(again.act(f), by_hand, atol=1e-5)
    with pytest.raises(InputError, match="'pneu_policy' is missing"):
        PolicyFile.load(tmp_path / "push.npz")
    with pytest.raises(InputError, match="'pneu_push_policy' is missing"):
        PushPolicy.load(ROOT / "policies/short_pde_0.npz")
    whole = (tmp_path / "push.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"cut\.npz"):
        PushPolicy.load(tmp_path / "cut.npz")
    with pytest.raises(InputError, match="needed are 21 inputs"):
        PushPolicy(policy.weights, RECIPE, ["one"], {})
    other = PushPolicy(policy.weights, RECIPE, ["three", "two", "one"], {})
    with pytest.raises(InputError, match="trained with arms three, two, one"):
        Pusher(other, hand, PushPath("circle", 0.03, 4.0))


def test_on_arms_it_does_what_it_did_in_training(hand):
    """Encoders and motion capture in, torques out: as in the plants that it was trained in."""
    env = Pushing(PushSettings(**(PLAIN | {"num_envs": 1, "delay_s": (0.0, 0.0)})))
    env._noise_m = 0.0
    policy = make_policy(2)
    seen, _ = env.reset(seed=1)
    pusher = Pusher(policy, hand, PushPath("circle", 0.03, 4.0))

    class Same:
        """The path of the episode."""

        def at(self, time_s):
            return env._path_m[0, env._step]

    pusher.path = Same()
    (data,) = env._plants
    model = env.models[0]
    waists = [[f"{arm}_{j}" for j in ("waist", "shoulder", "elbow")] for arm in ARMS]
    for step in range(10):
        q = np.array([[float(data.joint(j).qpos[0]) for j in row] for row in waists])
        v = np.array([[float(data.joint(j).qvel[0]) for j in row] for row in waists])
        q[:, 2] += q[:, 1]  # the linkage tells the forearm's angle to the base
        v[:, 2] += v[:, 1]
        torque = pusher.step(0.02 * step, q, v, data.body("object").xpos[:2].copy())
        seen, *_ = env.step(policy.act(seen[0].astype(float))[None])
        told = [
            [
                float(data.ctrl[model.actuator(f"{a}_{j}").id])
                for j in ("waist", "shoulder", "linkage")
            ]
            for a in ARMS
        ]
        np.testing.assert_allclose(told, torque, atol=1e-6)


def test_a_trained_policy_pushes_a_plant_with_a_hidden_truth(hand):
    policy = PushPolicy.load(ROOT / "policies/push_ensemble_0.npz")
    path = PushPath("circle", 0.03, 4.0, seed=11)
    heavy = Truth(model=(Change(of="geom", name="object", set="mass", times=1.7),))
    pushed = push_plant(hand, heavy, policy, path, 4.0)
    still = push_plant(hand, heavy, make_policy(0, scale=0.0), path, 4.0)
    assert np.allclose(pushed.path_m, path.at(pushed.time_s))
    assert pushed.rms_m < 0.005 < 0.02 < still.rms_m
    assert np.array_equal(push_plant(hand, heavy, policy, path, 0.5).thing_m, pushed.thing_m[:25])
