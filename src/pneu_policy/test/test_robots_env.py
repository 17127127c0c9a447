# SPDX-License-Identifier: Apache-2.0
"""Robots as environments: what they see and earn, when they end, that they can be learned."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from pneu_common.errors import InputError

pytest.importorskip("torch")

from pneu_policy.control.robot_policy import RobotPolicy
from pneu_policy.learn.rollout import roll_out
from pneu_policy.learn.settings import NpgSettings, TrainSettings
from pneu_policy.learn.trainer import Trainer
from pneu_policy.task.goals import FLOOR_RAD, Motion, SwingUp, Walk
from pneu_policy.task.make import make_env
from pneu_policy.task.robots import Robots, RobotSettings
from pneu_sim.rig.load import load_rig

RIGS = Path(__file__).parents[3] / "rigs"
CART = {"cart": {"centre": 0.15, "range": 0.15, "speed": 0.5, "span": 0.05}}
FOREARM = {"forearm": {"head_tap": "head_port", "rod_tap": "rod_port", "span_n": 100.0}}


def rail(**changes: Any) -> RobotSettings:
    """A cart after a smooth target."""
    plain: dict[str, Any] = {
        "task": "robot",
        "rig": str(RIGS / "rail.yaml"),
        "dx_m": 0.25,
        "num_envs": 3,
        "horizon": 20,
        "start": {"cart": [0.08, 0.22]},
        "goal": {"kind": "track", "ranges": {"cart": [0.05, 0.25]}, "near": 0.05},
        "recipe": {
            "encoders": CART,
            "tracked": ["cart"],
            "taps": ["head", "rod"],
            "commands": ["head", "rod"],
            "opposed": True,
            "preview_s": [0.0, 0.05],
            "levels": 1,
        },
    }
    return RobotSettings(**{**plain, **changes})


def kokoro(goal: dict[str, Any], **changes: Any) -> RobotSettings:
    """An elbow with the forces of a plan, or forces alone."""
    recipe: dict[str, Any] = {
        "encoders": {"elbow": {"range": 0.8, "speed": 3.0, "span": 0.3}},
        "tracked": ["elbow"],
        "taps": ["head_port", "rod_port"],
        "commands": ["head", "rod"],
        "preview_s": [0.0, 0.04],
        "forces": FOREARM,
        "plan": {},
        "ways": True,
        "levels": 1,
    }
    return RobotSettings(
        task="robot",
        rig=str(RIGS / "kokoro.yaml"),
        dx_m=0.5,
        num_envs=2,
        horizon=10,
        goal=goal,
        recipe={**recipe, **changes},
    )


def test_an_episode_is_what_was_asked_for() -> None:
    env = make_env(rail())
    assert isinstance(env, Robots)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros((3, 1)))
    seen, _ = env.reset(seed=4)
    assert seen.shape == (3, env.recipe.size) and seen.dtype == np.float32
    for k in range(20):
        _, reward, ended, cut, info = env.step(np.full((3, 1), 0.1))
        off = info["target"][:, 0] - info["position"][:, 0]
        np.testing.assert_allclose(info["error"], np.abs(off))
        np.testing.assert_allclose(reward, env.settings.goal.reward.of(off / 0.05))
        assert not ended.any() and cut.all() == (k == 19)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros((3, 1)))


def test_episodes_are_decided_by_their_seed() -> None:
    runs = []
    for seed in (4, 4, 5):
        env = Robots(rail())
        runs.append(roll_out(env, lambda seen: np.full((3, 1), 0.1, np.float32), seed))
    np.testing.assert_array_equal(runs[0].observations, runs[1].observations)
    np.testing.assert_array_equal(runs[0].rewards, runs[1].rewards)
    assert not np.array_equal(runs[0].rewards, runs[2].rewards)


def test_actions_move_the_cart_the_way_they_say() -> None:
    for action in (0.3, -0.3):
        env = Robots(rail(start={"cart": [0.149, 0.151]}))
        env.reset(seed=0)
        for _ in range(20):
            *_, info = env.step(np.full((3, 1), action))
        assert (np.sign(info["position"][:, 0] - 0.15) == np.sign(action)).all()


def test_on_target_a_cart_begins_where_and_as_fast_as_its_target() -> None:
    settings = rail(on_target=True)
    recipe = settings.recipe.model_copy(update={"preview_s": (0.0, 0.01)})
    env = Robots(settings.model_copy(update={"recipe": recipe}))
    env.reset(seed=1)
    position, speed = env.plant.motion()
    targets = env._wanted.targets
    assert targets is not None
    np.testing.assert_allclose(position[:, 0], targets[:, 0, 0], atol=1e-12)
    np.testing.assert_allclose(speed[:, 0], (targets[:, 0, 1] - targets[:, 0, 0]) / 0.01, rtol=1e-9)


def test_the_thin_plate_is_the_same_environment() -> None:
    full, plate = Robots(rail()), Robots(rail(model="thin_plate"))
    assert plate.rig.model == "thin_plate"
    one, other = full.reset(seed=2)[0], plate.reset(seed=2)[0]
    np.testing.assert_allclose(one, other, atol=1e-5)  # at the start nothing differs
    for _ in range(10):
        one = full.step(np.full((3, 1), 0.2))[0]
        other = plate.step(np.full((3, 1), 0.2))[0]
    assert np.isfinite(other).all() and not np.allclose(one, other, atol=1e-4)


def test_who_leaves_the_range_is_out_and_earns_no_more() -> None:
    goal = {
        "kind": "track", "ranges": {"cart": [0.05, 0.25]}, "within": {"cart": [0.13, 0.25]},
        "reward": {"offset": 1.0},
    }  # fmt: skip
    env = Robots(rail(goal=goal, start={"cart": [0.14, 0.2]}, horizon=40, num_envs=6))
    episodes = roll_out(env, lambda seen: np.full((6, 1), -0.15, np.float32), 3)
    assert episodes.alive is not None and episodes.ended is not None and episodes.ended.any()
    last = episodes.alive.sum(axis=0)  # steps that count
    assert 1 <= last.min() < last.max()
    for n, count in enumerate(last):
        assert (episodes.rewards[count:, n] == 0.0).all()
        assert not episodes.alive[count:, n].any()
    assert episodes.samples == last.sum()
    assert episodes.successful is not None


def test_swinging_up_earns_as_the_thesis_has_it() -> None:
    goal = SwingUp(
        cart="cart", pole="pole", rail_m=(-0.5, 0.5), alpha=2.0, beta=0.5, gamma=0.25, delta=0.1
    )
    aim = goal.aim(_recipe(), load_rig(RIGS / "cart_pole.yaml"), 4, 10)
    positions = np.array([[0.0, 0.0], [0.25, math.pi / 2], [0.5, -3.0], [0.0, 2 * math.pi + 0.02]])
    out = aim.judge(1, Motion(positions, np.zeros((4, 2)), np.zeros((4, 0))))
    log = [math.log(x) for x in (FLOOR_RAD, math.pi / 2, 3.0, 0.02)]
    by_hand = [
        2.0 * 1.0 + 0.5 * math.pi - 0.25 * log[0] - 0.1,
        2.0 * 0.25 + 0.5 * math.pi / 2 - 0.25 * log[1] - 0.1,
        0.0 + 0.5 * (math.pi - 3.0) - 0.25 * log[2] - 0.1,
        2.0 * 1.0 + 0.5 * (math.pi - 0.02) - 0.25 * log[3] - 0.1,
    ]
    np.testing.assert_allclose(out.reward, by_hand)
    np.testing.assert_array_equal(out.ended, [False, False, True, False])  # at the rail's end
    np.testing.assert_array_equal(out.success, [True, False, False, True])
    fast = aim.judge(1, Motion(positions, np.full((4, 2), 3.0), np.zeros((4, 0))))
    assert not fast.success.any()


def _recipe() -> Any:
    from pneu_policy.control.robot_recipe import RobotRecipe

    return RobotRecipe(encoders={"cart": {}, "pole": {"turns": True}}, commands=["cart"])


def test_walking_earns_the_way() -> None:
    goal = Walk(forward="cart", within={"pole": (-1.0, 1.0)}, fast_m_s=0.5)
    aim = goal.aim(_recipe(), load_rig(RIGS / "cart_pole.yaml"), 2, 10)
    aim.begin(np.random.default_rng(0))
    still = np.zeros((2, 2))
    aim.judge(1, Motion(np.array([[0.0, 0.0], [0.0, 0.0]]), still, np.zeros((2, 0))))
    out = aim.judge(2, Motion(np.array([[0.01, 0.0], [-0.002, 2.0]]), still, np.zeros((2, 0))))
    np.testing.assert_allclose(out.reward, [1.0, -0.2])  # over a period of 10 ms
    np.testing.assert_array_equal(out.ended, [False, True])
    np.testing.assert_array_equal(out.success, [True, False])


def test_led_pistons_go_their_way_whatever_pushes() -> None:
    settings = kokoro(
        {"kind": "push", "forces_n": {"forearm": [-100.0, 100.0]}, "way_kinds": ["smooth"]},
        see_motion=False,
        see_target=False,
    )
    env = Robots(settings)
    env.reset(seed=0)
    for k in range(10):
        *_, info = env.step(np.full((2, 2), 0.6 if k % 2 else -0.6))
        ways = env._aim.ways(k + 1)
        assert ways is not None
        stands = env.plant._plant.solver.tiles[0][0].cylinder_state[0, 0]
        np.testing.assert_allclose(stands, ways[:, 0] * 0.06, atol=1e-9)
        assert info["wanted_n"].shape == (2, 1)
    np.testing.assert_allclose(
        info["error"], np.abs(env._aim._forces[10, :, 0, 0] - info["force_n"][:, 0])
    )


def test_a_hybrid_behind_its_plan_earns_by_forces() -> None:
    goal = {
        "kind": "track", "ranges": {"elbow": [-0.7, 0.7]}, "reward": None,
        "force_reward": {"beta": 0.0}, "unit": ["degrees", math.pi / 180],
    }  # fmt: skip
    env = Robots(kokoro(goal, see_motion=False, see_target=False))
    env.reset(seed=0)
    assert not any("elbow" in name for name in env.recipe.names())
    planned = env._aim._planned.copy()
    _, reward, *_, info = env.step(np.zeros((2, 2)))
    np.testing.assert_allclose(reward, -np.abs(planned[:, 0] - info["force_n"][:, 0]) / 100.0)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"start": {"leg": [0.0, 1.0]}}, "start: found 'leg', rig 'rail' has joints cart"),
        ({"goal": {"kind": "track", "ranges": {}}}, "goal.ranges: found none for 'cart'"),
        (
            {"goal": {"kind": "walk", "forward": "torso"}},
            "recipe.tracked: found cart, goal walk has none",
        ),
        (
            {"goal": {"kind": "track", "ranges": {"cart": [0, 1]}, "within": {"x": [0, 1]}}},
            "goal.within: found 'x', recipe.encoders has cart",
        ),
        (
            {"goal": {"kind": "track", "ranges": {"cart": [0, 1]}, "force_reward": {}}},
            "goal.force_reward: found one, recipe.forces has no cylinder",
        ),
        ({"rig": str(RIGS / "kokoro.yaml")}, "recipe.taps: found 'head', rig 'kokoro' has"),
    ],
)
def test_what_does_not_fit_is_said(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Robots(rail(**changes))


def test_a_trained_policy_is_a_file_for_that_robot_alone(tmp_path: Path) -> None:
    settings = TrainSettings(env=rail().plain(), iterations=2, npg=NpgSettings(value_steps=5))
    history = Trainer(settings).run(tmp_path)
    assert history.rows[-1]["eval_success"] is not None
    policy = RobotPolicy.load(tmp_path / "policy.npz")
    rig = load_rig(RIGS / "rail.yaml")
    policy.check_rig(rig)
    policy.check_rig(rig.model_copy(update={"model": "thin_plate"}))
    with pytest.raises(InputError, match="trained for rig 'rail', found rig 'kokoro'"):
        policy.check_rig(load_rig(RIGS / "kokoro.yaml"))
    cart = rig.cylinders["cart"].model_copy(update={"bore_m": 0.02})
    wider = rig.model_copy(update={"cylinders": {"cart": cart}})
    with pytest.raises(InputError, match="cylinder 'cart' is 20 x 6 x 300 mm, not 16 x 6 x 300 mm"):
        policy.check_rig(wider)


@pytest.mark.long
def test_a_cart_is_learned_to_follow() -> None:
    """A few updates bring the error to a fraction of that of doing nothing."""
    settings = rail(
        num_envs=32, horizon=60, on_target=True,
        goal={"kind": "track", "ranges": {"cart": [0.05, 0.25]}, "target_period_s": [0.4, 0.4],
              "reward": {"floor": 0.01}},
    )  # fmt: skip
    trainer = Trainer(
        TrainSettings(
            env=settings.plain(), iterations=15, evaluate_every=15, npg=NpgSettings(value_steps=100)
        )
    )
    still = roll_out(trainer.env, lambda seen: np.zeros((32, 1), np.float32), 20_000).rmse
    for _ in range(15):
        row = trainer.iterate()
    assert row["eval_rmse"] < 0.35 * still
