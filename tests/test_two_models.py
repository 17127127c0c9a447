# SPDX-License-Identifier: Apache-2.0
"""Studies of robots that learn in two models: what they change, draw, match, train and judge."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from studies import ablations, cell_sizes, configurations, two_models

from pneu_common.errors import InputError
from pneu_policy.learn.settings import TrainSettings
from pneu_policy.learn.sweep import Workers
from pneu_sim.bodies.arm import Arm
from pneu_sim.bodies.cart_pole import CartPole
from pneu_sim.rig.load import load_rig, save_rig
from pneu_sim.rig.schema import Rig

ROOT = Path(__file__).resolve().parents[1]
RAIL = ROOT / "rigs" / "rail.yaml"


@pytest.mark.parametrize("name", ["area", "stroke", "force", "line"])
def test_an_ablation_changes_one_size_alone(name: str, tmp_path: Path) -> None:
    base = load_rig(RAIL)
    one = ablations.ablations(base)[name]
    read = {
        "area": lambda rig: 1e6 * rig.cylinders["cart"].areas[0],
        "stroke": lambda rig: rig.cylinders["cart"].stroke,
        "force": lambda rig: (7e5 - 101325.0) * rig.cylinders["cart"].areas[0]
        / (rig.bodies["cart"].mass_kg * 9.80665),
        "line": lambda rig: rig.pipes["rod_line"].length_m,
    }  # fmt: skip
    assert read[name](base) == pytest.approx(one.now)
    for value in one.values(6):
        rig = one.change(base, value)
        assert read[name](rig) == pytest.approx(value)
        others = {n: of(rig) / of(base) for n, of in read.items() if n != name}
        if name == "area":  # the mass stays, and with a wider piston the force is larger
            assert others.pop("force") == pytest.approx(value / one.now)
        assert others == pytest.approx(dict.fromkeys(others, 1.0))
        save_rig(rig, tmp_path / "rig.yaml")
        again = load_rig(tmp_path / "rig.yaml")  # valid, and starts in the middle
        settings = TrainSettings(**ablations.document_of(again, 1)).env
        low, high = settings.goal.ranges["cart"]  # type: ignore[union-attr]
        assert 0.0 < low < again.cylinders["cart"].stroke / 2.0 < high
        assert high < again.cylinders["cart"].stroke


def test_sizes_drawn_are_the_thesis_ranges(tmp_path: Path) -> None:
    cart, arm = (load_rig(ROOT / "rigs" / f"{name}.yaml") for name in ("cart_pole", "arm"))
    tracks, areas = [], []
    for number in range(30):
        rig = configurations.drawn_cart(cart, number)
        body = rig.bodies["cart_pole"]
        assert isinstance(body, CartPole)
        assert body.cart_kg + body.rod.tip_kg == pytest.approx(2.0)
        assert 0.2 <= body.rod.tip_kg / body.cart_kg <= 5.0
        assert 0.1 <= body.rod.length_m <= 1.0
        tracks.append(rig.cylinders["cart"].stroke)
        strong = configurations.drawn_arm(arm, number).bodies["arm"]
        assert isinstance(strong, Arm)
        assert all(0.15 <= link.length_m <= 0.4 for link in (strong.upper_arm, strong.forearm))
        areas.append(1e6 * rig.cylinders["cart"].areas[0])
    assert 0.6 <= min(tracks) < 1.0 < 2.5 < max(tracks) <= 4.0
    assert 50.0 <= min(areas) < 100.0 < 300.0 < max(areas) <= 500.0
    rig = configurations.drawn_cart(cart, 3)
    save_rig(rig, tmp_path / "rig.yaml")
    assert load_rig(tmp_path / "rig.yaml").cylinders["cart"].stroke == pytest.approx(tracks[3])


def test_a_table_of_cells_is_percent_of_its_diagonal() -> None:
    errors = np.array(
        [[[1.0, 1.5], [3.0, 3.5]], [[4.4, 4.0], [3.6, 4.0]]]
    )  # trained, seeds, tested
    np.testing.assert_allclose(cell_sizes.table(errors), [[0.0, 25.0], [0.0, 0.0]])
    assert cell_sizes.agreeing(np.array([[0.0, 25.0], [0.0, 0.0]])) == 0
    assert cell_sizes.agreeing(np.array([[0.0, 90.0, 0.0], [9.0, 0.0, 1.0], [1.0, 2.0, 0.0]])) == 1


def _case(folder: Path, rig: Rig) -> two_models.Case:
    document = ablations.document_of(rig, 2)
    document |= {"keep_every": 1, "evaluate_every": 1}
    document["env"] |= {"num_envs": 3, "horizon": 12}
    document["npg"] = {"value_steps": 5}
    return two_models.Case(
        "tiny", folder, two_models.written(rig, folder / "rig.yaml"), folder / "plate.yaml",
        document, {"pde": (0,), "plate": (0, 1)},
    )  # fmt: skip


@pytest.mark.long
def test_a_case_is_matched_trained_and_judged_once(tmp_path: Path) -> None:
    one = _case(tmp_path / "case", load_rig(RAIL))
    two_models.match([one], levels=1)
    assert load_rig(one.plate).model == "thin_plate"
    with pytest.raises(InputError, match=r"judge\.json: is missing; the stage judge makes it"):
        _ = one.rows
    two_models.train([one], Workers("loky", 1))
    two_models.judge([one], 1)
    rows = one.rows
    # the full model's policy on the full one, the simple model's on both, after each iteration
    assert len(rows) == 2 * 1 + 2 * 2 * 2
    assert all(math.isfinite(row["mean"]) for row in rows)
    assert len(two_models.last(rows, "plate", "pde")) == 2
    for ends, least in zip(
        two_models.last(rows, "plate", "pde"), two_models.best(rows, "plate", "pde"), strict=True
    ):
        assert least <= ends
    before = {path: path.stat().st_mtime_ns for path in one.folder.rglob("*") if path.is_file()}
    two_models.match([one], levels=1)
    two_models.train([one], Workers("loky", 1))
    two_models.judge([one], 1)
    assert before == {path: path.stat().st_mtime_ns for path in before}
    # a rig that changed makes all of it anew
    heavier = ablations.lighter_load(load_rig(RAIL), 5.0)
    two_models.written(heavier, one.rig)
    told = json.loads((one.folder / "match.json").read_text(encoding="utf-8"))
    two_models.match([one], levels=1)
    again = json.loads((one.folder / "match.json").read_text(encoding="utf-8"))
    assert told["rig"] != again["rig"]
