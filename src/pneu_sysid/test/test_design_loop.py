# SPDX-License-Identifier: Apache-2.0
"""Experiment after experiment until a verdict stands; plans are played on a simulated plant.

The same on a graph, with processes for all: tests/test_live_experiments.py.
"""

import itertools
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tests.one_tap import one_tap

from pneu_common.errors import InputError
from pneu_sim.effects.registry import BUILT_IN
from pneu_sim.rig import save_rig
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sim.run import add_noise, run_from_rest
from pneu_sysid.design import design as designing
from pneu_sysid.design import loop
from pneu_sysid.design.limits import limits_of
from pneu_sysid.design.live import LiveRig, play
from pneu_sysid.design.loop import PLAYS, Budget, run
from pneu_sysid.design.plan import Bounds, Expected, Plan
from pneu_sysid.design.plan_file import load_plan
from pneu_sysid.design.played import UntimelyError
from pneu_sysid.design.waves import STEP_S
from pneu_sysid.diagnose import diagnose_apart
from pneu_sysid.records import Recording, even_recording
from pneu_sysid.records.write import write_bag

pytestmark = pytest.mark.takes(15)

RIG = one_tap(0.06)
RATE_HZ = 100.0


class Plant:
    """Plays plans on a rig with what is hidden, and writes bags; the first is broken off once."""

    def __init__(self, rig: Rig, hidden: AttachedEffect) -> None:
        self._rig = rig
        self._plant = rig.model_copy(
            update={
                "effects": [hidden],
                "grid": rig.grid.model_copy(update={"flux": "exact", "dx_m": 0.04}),
            }
        )
        self.played: list[str] = []
        self.broken_off = False

    def recording(self, volts: dict[str, np.ndarray], name: str) -> Recording:
        at = np.arange(len(volts["voltage"])) * STEP_S
        out = run_from_rest(self._plant, volts, STEP_S)
        every = round(1.0 / (RATE_HZ * STEP_S))
        rng = np.random.default_rng([len(self.played), 3])
        taps = add_noise(self._plant, {n: x[::every] for n, x in out.taps.items()}, rng)
        shown = even_recording(name, at[::every], {}, taps)
        shown.commands.update(even_recording(name, at, volts, {}).commands)
        return shown

    def __call__(self, plan, plan_file, rig_file, bag, where, tell) -> None:
        assert load_plan(plan_file) == plan
        if not self.played and not self.broken_off:
            self.broken_off = True
            bag.mkdir()  # what was recorded is kept
            raise UntimelyError("late")
        write_bag(bag, self._rig, self.recording(plan.volts(STEP_S), plan_file.stem))
        self.played.append(plan.kind)


FEW = {"leak", "spool_leakage", "null_offset", "valve_delay", "clock_offset"}
"""Effects that are tried: those that are hidden, and what looks most like them."""


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Few effects to try, and one other rig to judge a plan by: the loop is the same."""
    without = {effect.name for effect in BUILT_IN} - FEW
    monkeypatch.setattr(loop, "diagnose_apart", partial(diagnose_apart, without=without))
    monkeypatch.setattr(designing, "PROMISED", 1)


def outcome(tmp_path: Path, hidden: AttachedEffect, **more):
    save_rig(RIG, tmp_path / "rig.yaml")
    plant = Plant(RIG, hidden)
    limits = limits_of(RIG, **more)
    budget = Budget(3, 4.0, limits, RATE_HZ)
    state = run(RIG, tmp_path / "rig.yaml", [], tmp_path, budget, LiveRig(), None, plant)
    return plant, state


@pytest.mark.long
def test_from_nothing_to_a_name(tmp_path):
    hidden = AttachedEffect(
        effect="leak", place="tube", parameters={"area_m2": 6e-9, "position_m": 1.4}
    )
    plant, state = outcome(tmp_path, hidden)
    assert state.ended == "name"
    assert state.found.finalists[0].site.part == ("leak", "tube")
    assert plant.played[0] == "steps" and set(plant.played[1:]) <= {"separate"}
    assert len(state.bags) == len(plant.played) == len(state.experiments)
    assert state.bags[0].name == "experiment_1_play_2"
    assert state.played_again == ["late"]


def test_a_plan_that_only_time_broke_off_is_played_again(tmp_path, monkeypatch):
    """Four times at most; after what else breaks it off a person has to look."""
    limits = Bounds(low_v={}, high_v={}, slew_v_s=1.0, highest_pa=1.0, lowest_pa=0.0)
    told = Expected(highest_pa={}, lowest_pa={}, fastest_pa_s={}, air_kg=None)
    plan = Plan(
        pneu_version="0", rig="lab", kind="steps", seconds=1.0, seed=0, commands={}, limits=limits,
        expected=told,
    )  # fmt: skip
    monkeypatch.setattr(loop, "design", lambda *asked: plan)
    bags: list[str] = []

    def player(plan, plan_file, rig_file, bag, where, tell) -> None:
        bags.append(bag.name)
        bag.mkdir()  # what was recorded is kept
        raise next(ends)

    def played(folder: str) -> None:
        (tmp_path / folder).mkdir()
        budget = Budget(1, 4.0, limits_of(RIG), RATE_HZ)
        run(RIG, tmp_path / "rig.yaml", [], tmp_path / folder, budget, LiveRig(), None, player)

    save_rig(RIG, tmp_path / "rig.yaml")
    ends = iter([UntimelyError("late"), UntimelyError("late"), InputError("tripped")])
    with pytest.raises(InputError, match="tripped"):
        played("tripped")
    assert bags == ["experiment_1", "experiment_1_play_2", "experiment_1_play_3"]
    bags.clear()
    ends = itertools.repeat(UntimelyError("late"))
    with pytest.raises(UntimelyError, match="late"):
        played("late")
    assert len(bags) == PLAYS


@pytest.mark.long
def test_what_is_inseparable_is_said_and_no_more_is_run(tmp_path):
    """A valve that acts late or the late clock of the only sensor."""
    hidden = AttachedEffect(effect="valve_delay", place="valve", parameters={"delay_s": 6e-3})
    plant, state = outcome(tmp_path, hidden)
    assert state.ended == "inseparable"
    assert plant.played == ["steps"]
    assert "valve_delay@valve" in state.words and "clock_offset@end" in state.words


def test_without_a_calibration_nothing_is_run(tmp_path):
    bare = RIG.model_copy(update={"calibration": None})
    budget = Budget(3, 4.0, limits_of(RIG), RATE_HZ)
    with pytest.raises(InputError, match=r"rig\.yaml: has no calibration; what is missing can be"):
        run(bare, tmp_path / "rig.yaml", [], tmp_path, budget, LiveRig(), None, None)


def test_a_bag_is_never_written_over(tmp_path):
    (tmp_path / "bag").mkdir()
    with pytest.raises(InputError, match="exists already; each experiment is recorded anew"):
        play(
            None, tmp_path / "plan.json", tmp_path / "rig.yaml", tmp_path / "bag", LiveRig(),
            lambda stage, done: None,
        )  # fmt: skip
