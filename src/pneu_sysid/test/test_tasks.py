# SPDX-License-Identifier: Apache-2.0
"""Tasks of the identification node as processes: results in one go, progress, and a real end."""

import json
import os
import threading
import time
from pathlib import Path

import pytest

from pneu_common.errors import InputError
from pneu_sim.rig import load_rig
from pneu_sysid.tasks import perform
from pneu_sysid.tasks.process import TaskProcess
from pneu_sysid.tasks.request import FOLDERS, TASKS, Outcome, Request, check

ROOT = Path(__file__).parents[3]
BAG = str(ROOT / "data/bags/a_healthy_2")
RIG = str(ROOT / "rigs/rig_a_fitted.yaml")


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


def request(tmp_path: Path, task: str, output: str) -> Request:
    return Request(task, BAG, RIG, str(tmp_path / output), str(tmp_path / ".aside.part"), 2)


def test_compare_writes_report_and_result_and_tells_how_far_it_is(tmp_path):
    follower = Follower()
    process = follower.start(request(tmp_path, "compare", "report.html"))
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
