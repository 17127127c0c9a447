# SPDX-License-Identifier: Apache-2.0
"""What policies of robots see: features by name, against what they are told to be."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_policy.control.robot_recipe import Moment, RobotObserver, RobotRecipe
from pneu_sim.rig.load import load_rig

RIGS = Path(__file__).parents[3] / "rigs"
PLAIN: dict[str, Any] = {
    "encoders": {
        "cart": {"centre": 0.15, "range": 0.15, "speed": 0.5, "span": 0.05},
        "pole": {"turns": True, "speed": 5.0},
    },
    "tracked": ["cart"],
    "taps": ["head", "rod"],
    "commands": ["valve"],
    "preview_s": [0.0, 0.05],
    "base": 3.0,
    "levels": 2,
    "past": 2,
    "period_s": 0.01,
}


def features(recipe: RobotRecipe, seen: np.ndarray) -> dict[str, float]:
    """Features of the first robot by their names."""
    names = recipe.names()
    assert len(names) == len(set(names)) == recipe.size == seen.shape[1]
    return dict(zip(names, seen[0].tolist(), strict=True))


def test_every_feature_is_what_its_name_says() -> None:
    recipe = RobotRecipe(**PLAIN)
    observer = RobotObserver(recipe, 2)
    first = Moment(np.array([[0.1, 3.1]] * 2), np.full((2, 2), 350e3), np.zeros((2, 1, 2)))
    observer.observe(first)
    observer.acted(np.array([[0.25], [3.0]]))
    now = Moment(
        np.array([[0.12, -3.1]] * 2), np.array([[450e3, 250e3]] * 2), np.array([[[0.14, 0.2]]] * 2)
    )
    seen = observer.observe(now)
    told = features(recipe, seen)
    error = (0.2 - 0.12) / 0.05
    assert told["cart off its target at 0.05 s"] == pytest.approx(error)
    assert told["sin 1 of cart off its target at 0.05 s"] == pytest.approx(math.sin(3.0 * error))
    assert told["cos 0 of cart off its target at 0.05 s"] == pytest.approx(math.cos(error))
    assert told["position cart"] == pytest.approx((0.12 - 0.15) / 0.15)
    assert told["sin pole"] == pytest.approx(math.sin(-3.1))
    assert told["cos pole"] == pytest.approx(math.cos(-3.1))
    assert told["speed cart"] == pytest.approx(0.02 / 0.01 / 0.5)
    # past half a turn it went on by 2 pi - 6.2, and not back by 6.2
    assert told["speed pole"] == pytest.approx((2.0 * math.pi - 6.2) / 0.01 / 5.0)
    assert told["pressure head"] == pytest.approx(0.5)
    assert told["valve 1 back"] == 0.25
    assert told["valve 2 back"] == 0.0
    assert seen[1, recipe.names().index("valve 1 back")] == 1.0  # cut off as the voltage is


def test_all_features_of_robots_side_by_side() -> None:
    """What turns and what is hidden come first, the tracked ones in another order than encoders."""
    recipe = RobotRecipe(
        encoders={
            "pole": {"turns": True, "speed": 7.0, "span": 0.4},
            "foot": {"hidden": True, "speed": 1.5, "centre": 9.0},
            "elbow": {"centre": 0.2, "range": 0.9, "speed": 3.0, "span": 0.3},
            "wheel": {"turns": True, "speed": 11.0},
            "cart": {"centre": 0.15, "range": 0.12, "speed": 0.5, "span": 0.05},
        },
        tracked=["cart", "pole"],
        taps=["room", "head", "rod"],
        commands=["left", "right"],
        preview_s=[0.0, 0.05, 0.2],
        forces={
            "single": {
                "head_tap": None, "rod_tap": "rod", "head_m2": 1e-4, "rod_m2": 3e-4,
                "room_pa": 99e3, "span_n": 40.0,
            },
            "double": {
                "head_tap": "head", "rod_tap": "rod", "head_m2": 5e-4, "rod_m2": 4e-4,
                "room_pa": 101e3, "span_n": 70.0,
            },
        },
        ways=True,
        past=2, spools=True, line=[["tube", 2]], base=3.0, levels=2, period_s=0.02,
        centre_pa=310e3, range_pa=170e3, null_v=4.4, half_v=2.5,
    )  # fmt: skip
    names, spans = list(recipe.encoders), {"cart": 0.05, "pole": 0.4}
    speeds = {"pole": 7.0, "foot": 1.5, "elbow": 3.0, "wheel": 11.0, "cart": 0.5}
    rng, observer = np.random.default_rng(6), RobotObserver(recipe, 2)
    for _ in range(2):
        before, acted = None, [np.zeros((2, 2))] * 2
        for _ in range(4):
            now = Moment(
                rng.uniform(-3.0, 3.0, (2, 5)), rng.uniform(1e5, 6e5, (2, 3)),
                rng.uniform(-3.0, 3.0, (2, 2, 3)), rng.normal(0.0, 80.0, (2, 2, 3)),
                rng.uniform(0.0, 1.0, (2, 2, 3)), rng.uniform(0.0, 10.0, (2, 4)),
                rng.uniform(1.0, 9.0, (2, 6)),
            )  # fmt: skip
            assert now.targets is not None and now.forces_n is not None and now.ways is not None
            assert now.spools_v is not None and now.line is not None
            seen = observer.observe(now)
            for n in range(2):
                place = dict(zip(names, now.positions[n], strict=True))
                _, head, rod = now.taps_pa[n]
                push = [
                    -3e-4 * (rod - 99e3),
                    5e-4 * (head - 101e3) - 4e-4 * (rod - 101e3),
                ]
                wanted = {}
                for k, ahead in enumerate(("0", "0.05", "0.2")):
                    off = {
                        f"{name} off its target at {ahead} s": (now.targets[n, t, k] - place[name])
                        / spans[name]
                        for t, name in enumerate(recipe.tracked)
                    }
                    for c, (name, span) in enumerate({"single": 40.0, "double": 70.0}.items()):
                        of = f"force {name} off its target at {ahead} s"
                        off[of] = (now.forces_n[n, c, k] - push[c]) / span
                        wanted[f"force {name}"] = push[c] / span
                        wanted[f"way {name} at {ahead} s"] = 2.0 * now.ways[n, c, k] - 1.0
                    for what, error in off.items():
                        wanted[what] = error
                        for level in (0, 1):
                            wanted[f"sin {level} of {what}"] = math.sin(3.0**level * error)
                            wanted[f"cos {level} of {what}"] = math.cos(3.0**level * error)
                wanted["position elbow"] = (place["elbow"] - 0.2) / 0.9
                wanted["position cart"] = (place["cart"] - 0.15) / 0.12
                for name in ("pole", "wheel"):
                    wanted[f"sin {name}"] = math.sin(place[name])
                    wanted[f"cos {name}"] = math.cos(place[name])
                for e, name in enumerate(names):
                    moved = 0.0 if before is None else now.positions[n, e] - before[n, e]
                    if name in ("pole", "wheel"):  # the shorter way round
                        moved = math.remainder(moved, 2.0 * math.pi)
                    wanted[f"speed {name}"] = moved / 0.02 / speeds[name]
                for t, tap in enumerate(recipe.taps):
                    wanted[f"pressure {tap}"] = (now.taps_pa[n, t] - 310e3) / 170e3
                for c, name in enumerate(recipe.commands):
                    wanted[f"{name} 1 back"] = acted[-1][n, c]
                    wanted[f"{name} 2 back"] = acted[-2][n, c]
                    wanted[f"spool {name}"] = (now.spools_v[n, c] - 4.4) / 2.5
                    wanted[f"its speed {name}"] = now.spools_v[n, 2 + c] / 500.0
                for k, (what, less, unit) in enumerate(
                    (("density", 0.0, 1.2), ("velocity", 0.0, 100.0), ("pressure", 310e3, 170e3))
                ):
                    for p in (0, 1):
                        wanted[f"{what} tube {p}"] = (now.line[n, 2 * k + p] - less) / unit
                told = dict(zip(recipe.names(), seen[n].tolist(), strict=True))
                assert told == pytest.approx(wanted)
            actions = rng.uniform(-1.5, 1.5, (2, 2))
            observer.acted(actions)
            acted.append(np.clip(actions, -1.0, 1.0))
            before = now.positions
        observer.reset()


def test_actions_become_voltages_in_pairs_or_one_by_one() -> None:
    plain = {**PLAIN, "null_v": 4.4, "half_v": 2.5, "commands": ["a", "b", "c", "d"]}
    alone, opposed = RobotRecipe(**plain), RobotRecipe(**plain, opposed=True)
    actions = np.array([[0.2, -0.4, 3.0, 0.0], [-1.0, -2.0, 0.6, 1.0]])
    wanted = [[4.9, 3.4, 6.9, 4.4], [1.9, 1.9, 5.9, 6.9]]
    np.testing.assert_allclose(alone.volts(actions), wanted)
    wanted = [[4.9, 3.9, 3.4, 5.4], [1.9, 6.9, 1.9, 6.9]]
    np.testing.assert_allclose(opposed.volts(actions[:, :2]), wanted)


def test_a_hand_is_told_like_an_encoder() -> None:
    recipe = RobotRecipe(
        encoders={name: {} for name in ("a", "b", "hand_x", "hand_y")},
        chain={"joints": ["a", "b"], "lengths_m": [0.3, 0.25]},
        tracked=["hand_x", "hand_y"],
        commands=["valve"],
        levels=0,
    )
    assert recipe.measured == ("a", "b")
    there = recipe.positions(np.array([[0.4, 0.5]]))[0]
    assert there[2] == pytest.approx(0.3 * math.cos(0.4) + 0.25 * math.cos(0.9))
    assert there[3] == pytest.approx(0.3 * math.sin(0.4) + 0.25 * math.sin(0.9))


def test_forces_are_those_of_the_gas_on_the_piston() -> None:
    rig = load_rig(RIGS / "kokoro.yaml")
    recipe = RobotRecipe(
        encoders={"elbow": {}},
        tracked=["elbow"],
        taps=["head_port", "rod_port"],
        commands=["head", "rod"],
        opposed=True,
        forces={"forearm": {"head_tap": "head_port", "rod_tap": "rod_port", "span_n": 50.0}},
        plan={},
        ways=True,
        levels=0,
        past=0,
    )
    with pytest.raises(ValueError, match="take them from a rig"):
        RobotObserver(recipe).forces(np.array([[3e5, 2e5]]))
    filled = recipe.of_rig(rig)
    observer = RobotObserver(filled)
    head, rod = math.pi / 4 * 0.025**2, math.pi / 4 * (0.025**2 - 0.01**2)
    force = (3e5 - 101e3) * head - (2e5 - 101e3) * rod
    assert observer.forces(np.array([[3e5, 2e5]]))[0, 0] == pytest.approx(force)
    now = Moment(
        np.zeros((1, 1)), np.array([[3e5, 2e5]]), np.zeros((1, 1, 1)),
        np.full((1, 1, 1), force + 25.0), np.full((1, 1, 1), 0.75),
    )  # fmt: skip
    told = features(filled, observer.observe(now))
    assert told["force forearm off its target at 0 s"] == pytest.approx(0.5)
    assert told["way forearm at 0 s"] == pytest.approx(0.5)
    np.testing.assert_allclose(filled.volts([[0.4]]), [[7.0, 3.0]])
    assert filled.actions == 1


def test_what_is_not_to_be_seen_is_not_told() -> None:
    blind = RobotRecipe(**{**PLAIN, "see_motion": False, "see_target": False})
    names = blind.names()
    assert not any("cart" in name or "pole" in name for name in names)
    observer = RobotObserver(blind)
    both = [
        observer.observe(Moment(np.full((1, 2), at), np.full((1, 2), 3e5), np.full((1, 1, 2), at)))
        for at in (0.0, 1.0)
    ]
    np.testing.assert_array_equal(*both)


def test_what_a_model_alone_tells_is_for_no_hardware() -> None:
    assert RobotRecipe(**PLAIN).hardware
    assert not RobotRecipe(**{**PLAIN, "spools": True}).hardware
    assert not RobotRecipe(**{**PLAIN, "line": [["tube", 3]]}).hardware
    with pytest.raises(ValueError, match="wants spools, found none"):
        recipe = RobotRecipe(**{**PLAIN, "spools": True})
        RobotObserver(recipe).observe(
            Moment(np.zeros((1, 2)), np.full((1, 2), 3e5), np.zeros((1, 1, 2)))
        )


@pytest.mark.parametrize("what", ["positions", "taps_pa", "targets"])
def test_what_is_not_finite_is_refused(what: str) -> None:
    parts = {
        "positions": np.zeros((1, 2)),
        "taps_pa": np.full((1, 2), 3e5),
        "targets": np.zeros((1, 1, 2)),
    }
    parts[what][..., 0] = math.nan
    with pytest.raises(ValueError, match="must be finite"):
        RobotObserver(RobotRecipe(**PLAIN)).observe(Moment(**parts))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"tracked": ["elbow"]}, "tracked: found 'elbow', encoders has cart, pole"),
        ({"preview_s": [0.1]}, "needed are rising times from 0"),
        ({"taps": ["head", "head"]}, "taps: found head, head"),
        ({"commands": []}, "commands: found none"),
        ({"opposed": True}, "commands: found 1, opposed ones go in pairs"),
        ({"ways": True}, "ways: found true, of which cylinders is said by forces"),
        ({"forces": {"c": {"head_tap": "x", "rod_tap": None}}}, "forces.c: found tap 'x'"),
        ({"chain": {"joints": ["cart"], "lengths_m": [1, 2]}}, "found 1 joints, 2 lengths"),
        ({"chain": {"joints": ["cart"], "lengths_m": [1]}}, "found 'hand_x', which encoders"),
    ],
)
def test_a_recipe_that_makes_no_sense_is_refused(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        RobotRecipe(**{**PLAIN, **changes})
