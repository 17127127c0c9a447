# SPDX-License-Identifier: Apache-2.0
"""Tasks of the identification node as processes: results in one go, progress, and a real end."""

import json
import os
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.coarse import coarsened
from tests.short_bags import shorten

from pneu_common.errors import InputError
from pneu_sim.rig import load_rig
from pneu_sysid.tasks import perform
from pneu_sysid.tasks.process import TaskProcess
from pneu_sysid.tasks.regime_masks import REGIMES, load_regimes
from pneu_sysid.tasks.request import FOLDERS, TASKS, Outcome, Request, check
from pneu_sysid.tasks.signals import SIGNALS, load_signals

ROOT = Path(__file__).parents[3]
BAG = str(ROOT / "data/bags/a_healthy_2")
RIG = str(ROOT / "rigs/rig_a_fitted.yaml")
SECONDS = 7.0
"""How much of the recording is used where regimes do not matter, s."""


class Follower:
    """Collects what a task tells."""

    def __init__(self) -> None:
        self.stages: list[tuple[str, float]] = []
        self.outcomes: list[Outcome] = []
        self.begun = threading.Event()

    def tell(self, stage: str, done: float) -> None:
        self.stages.append((stage, done))
        self.begun.set()

    def start(self, request: Request) -> TaskProcess:
        return TaskProcess(request, self.tell, self.outcomes.append)


@pytest.fixture(scope="module")
def cheap(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The beginning of the recording, and the rig on coarse cells."""
    folder = tmp_path_factory.mktemp("cheap")
    bag, rig = folder / "a_healthy_2.mcap", folder / "rig_a_fitted.yaml"
    shorten(Path(BAG) / "a_healthy_2.mcap", bag, SECONDS)
    return {"bag": str(bag), "rig": str(coarsened(Path(RIG), rig, dx_m=0.125, memory=False))}


def request(tmp_path: Path, task: str, output: str) -> Request:
    return Request(task, BAG, RIG, str(tmp_path / output), str(tmp_path / ".aside.part"), 2)


def test_what_was_measured_is_told_before_the_model_has_run(tmp_path, cheap):
    """And afterwards which readings belong to which regime: each to one of pressures."""
    early = []

    def measured(folder):
        for trace in load_signals(folder / SIGNALS).sensors.values():
            early.append((np.isfinite(trace.measured).all(), np.isnan(trace.model).all()))

    asked = replace(request(tmp_path, "look", "looked"), rig=cheap["rig"])
    outcome = perform.perform(asked, lambda stage, done: None, early=measured)
    assert outcome.success
    signals = load_signals(tmp_path / "looked" / SIGNALS)
    assert early == [(True, True)] * len(signals.sensors)
    regimes = load_regimes(tmp_path / "looked" / REGIMES)
    assert list(regimes.sensors) == list(signals.sensors)
    for name, trace in signals.sensors.items():
        assert np.isfinite(trace.model).all()
        masks = [mask for key, mask in regimes.sensors[name].items() if key[0] == "pressure"]
        assert masks or name == "exhaust"  # which has one level
        assert not masks or np.sum(masks, axis=0).tolist() == [1] * trace.time_s.size
        for (kind, _, label), mask in regimes.sensors[name].items():
            if kind == "pressure":  # the label says which readings are meant
                low, high = (float(bar) * 1e5 for bar in label.removesuffix(" bar").split("-"))
                assert low - 600.0 <= np.median(trace.measured[mask]) <= high + 600.0


def test_what_is_kept_aside_by_hand_is_judged_by(tmp_path, cheap):
    look = replace(request(tmp_path, "look", "looked"), **cheap)
    asked = replace(look, kept_aside=((1.0, 2.0), (5.0, 6.0)))
    perform.perform(asked, lambda stage, done: None)
    segments = load_signals(tmp_path / "looked" / SIGNALS).about.segments
    assert {held for _, _, held in segments} == {True, False}
    for begin, end, held in segments:
        middle = 0.5 * (begin + end)
        assert held == (1.0 <= middle <= 2.0 or 5.0 <= middle <= 6.0)
    none = replace(look, output=str(tmp_path / "none"), kept_aside=((-5.0, -4.0),))
    with pytest.raises(InputError, match=r"kept aside: found -5 to -4 s, which is none of the"):
        perform.perform(none, lambda stage, done: None)
    every = replace(look, output=str(tmp_path / "every"), kept_aside=((-5.0, 1e6),))
    with pytest.raises(InputError, match=r"which is all of the"):
        perform.perform(every, lambda stage, done: None)
    assert not (tmp_path / ".aside.part").exists()


def test_compare_writes_report_and_result_and_tells_how_far_it_is(tmp_path, cheap):
    follower = Follower()
    process = follower.start(replace(request(tmp_path, "compare", "report.html"), **cheap))
    process.wait()
    (outcome,) = follower.outcomes
    assert outcome == Outcome(True, result_file=str(tmp_path / "report.json"))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["report.html", "report.json"]
    assert json.loads((tmp_path / "report.json").read_text())["recording"] == "a_healthy_2"
    done = [fraction for stage, fraction in follower.stages if stage == "comparing"]
    assert done[-1] == 1.0 and done == sorted(done) and len(done) > 2


@pytest.mark.long
def test_a_cancelled_task_is_gone_and_leaves_nothing(tmp_path):
    follower = Follower()
    process = follower.start(request(tmp_path, "learn", "learned"))
    assert follower.begun.wait(30.0)
    assert (tmp_path / ".aside.part").is_dir()
    began = time.monotonic()
    process.end()
    process.wait()
    assert time.monotonic() - began < 2.5
    assert [o.success for o in follower.outcomes] == [False]
    assert follower.outcomes[0].message == "cancelled"
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ProcessLookupError):
        os.kill(process.pid, 0)


@pytest.mark.long
def test_bad_input_comes_back_as_its_sentence(tmp_path):
    broken = tmp_path / "rig.yaml"
    broken.write_text("pneu_rig: 1\nname: x\npipes: {}\n")
    follower = Follower()
    bad = Request("fit", BAG, str(broken), str(tmp_path / "out.yaml"), str(tmp_path / ".part"))
    follower.start(bad).wait()
    (outcome,) = follower.outcomes
    assert not outcome.success
    assert str(broken) in outcome.message
    assert sorted(p.name for p in tmp_path.iterdir()) == ["rig.yaml"]


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"task": "guess"}, "allowed are fit, compare, diagnose, learn"),
        ({"bag": "nowhere"}, "bag: found 'nowhere'"),
        ({"rig": "nowhere.yaml"}, "rig: found 'nowhere.yaml'"),
        ({"output": ""}, "output"),
        ({"output": "no/such/folder/x.html"}, "does not exist"),
        ({"task": "learn", "output": str(ROOT)}, "exists already"),
        ({"output": str(ROOT)}, "is a folder"),
    ],
)
def test_what_must_fail_is_refused_beforehand(tmp_path, changed, told):
    values = {**vars(request(tmp_path, "compare", "report.html")), **changed}
    with pytest.raises(InputError, match=told):
        check(Request(**values))


def test_the_rig_of_the_tasks_is_one_that_is_read():
    assert load_rig(RIG).name == "rig_a"


def test_every_task_that_may_be_asked_for_is_done():
    assert set(perform.TASKS) == set(TASKS)
    assert {name for name, (_, inside) in perform.TASKS.items() if inside} == set(FOLDERS)
