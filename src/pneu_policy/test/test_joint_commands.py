# SPDX-License-Identifier: Apache-2.0
"""Tuning and judging controllers of a joint, and their commands."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import typer
from ruamel.yaml import YAML
from typer.testing import CliRunner

from pneu_policy import commands
from pneu_policy.control.plan_settings import PlanSettings
from pneu_policy.control.robot_controllers import (
    ComputedTorque,
    Drive,
    TorqueGains,
    load_robot_controller,
    save_robot_controller,
)
from pneu_policy.judge.latency import latency
from pneu_policy.judge.robot import JointTasks, judge_joint
from pneu_policy.tune.joint_gains import JointTuneSettings, tune_joint
from pneu_sim.rig.load import load_rig

ROOT = Path(__file__).parents[3]
KOKORO = ROOT / "rigs" / "kokoro.yaml"
TAPS = ("head_port", "rod_port")


@pytest.fixture
def app() -> typer.Typer:
    made = typer.Typer()
    commands.register(made)
    return made


def settings(**changes: object) -> JointTuneSettings:
    """A short tuning on few cells."""
    plain: dict[str, object] = {
        "rig": str(KOKORO),
        "encoder": "elbow",
        "cylinder": "forearm",
        "taps": TAPS,
        "low": -0.5,
        "high": 0.5,
        "target_period_s": (1.0, 1.0),
        "period_s": 0.01,
        "trials": 2,
        "seconds": 1.5,
        "settle_s": 0.5,
        "spread": 0.0,
        "dx_m": 0.5,
        "candidates": 8,
        "generations": 3,
    }
    return JointTuneSettings(**{**plain, **changes})


@pytest.mark.parametrize(
    "kind", ["joint_pid", pytest.param("computed_torque", marks=pytest.mark.long)]
)
def test_tuning_finds_the_same_gains_again(kind: str, tmp_path: Path) -> None:
    found = tune_joint(settings(kind=kind))
    assert found.history == sorted(found.history, reverse=True)
    again = tune_joint(settings(kind=kind))
    assert again.controller.gains == found.controller.gains
    save_robot_controller(found.controller, tmp_path / "c.yaml", found.provenance())
    back = load_robot_controller(tmp_path / "c.yaml", load_rig(KOKORO))
    assert back.gains == found.controller.gains  # type: ignore[attr-defined]


def test_tuning_finds_better_gains() -> None:
    found = tune_joint(settings())
    assert found.rmse == found.history[-1] < found.history[0]


def test_a_plan_follows_better_than_a_pid_of_the_present(tmp_path: Path) -> None:
    rig = load_rig(KOKORO)
    pid = tune_joint(settings()).controller
    save_robot_controller(pid, tmp_path / "pid.yaml", {})
    drive = Drive.of_rig(rig, "elbow", "forearm", TAPS)
    plan = ComputedTorque([drive], [TorqueGains(0.04, 0.2, lead_s=0.03)], PlanSettings(), rig, 0.01)
    save_robot_controller(plan, tmp_path / "plan.yaml", {})
    tasks = JointTasks("elbow", -0.5, 0.5, (1.0,), kinds=("smooth",), runs=3, seconds=3.0)
    errors = []
    for name in ("pid", "plan"):
        runs = judge_joint(tmp_path / f"{name}.yaml", rig, rig, tasks, 0.25)
        assert [run.run for run in runs] == [0, 1, 2]
        for run in runs:
            off = run.position - run.target
            assert run.rmse == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.02)
            assert run.adjusted_rmse <= run.rmse + 1e-9
        errors.append(np.sqrt(np.mean([run.rmse**2 for run in runs])))
    assert errors[1] < 0.7 * errors[0]


def test_the_latency_is_the_shift_of_a_delayed_course() -> None:
    time = np.arange(0.0, 6.0, 0.01)
    course = np.sin(3.0 * time) + 0.5 * np.sin(7.1 * time)
    late = np.interp(time - 0.0637, time, course)
    inside = (time > 1.0) & (time < 5.0)
    found, left = latency(time[inside], 1.1 * late[inside], time, course)
    assert found == pytest.approx(0.0637, abs=1e-3)
    assert left == pytest.approx(0.1 * np.sqrt(np.mean(late[inside] ** 2)), rel=0.02)
    still, _ = latency(time[inside], late[inside], time, np.zeros_like(time))
    assert math.isnan(still)


def test_the_commands_tune_and_judge(app: typer.Typer, tmp_path: Path) -> None:
    runner = CliRunner()
    asked, file = tmp_path / "tune.yaml", tmp_path / "pid.yaml"
    with asked.open("w", encoding="utf-8") as stream:
        YAML(typ="safe").dump({**settings().plain(), "generations": 1}, stream)
    done = runner.invoke(app, ["tune-joint", str(asked), "-o", str(file)])
    assert done.exit_code == 0, done.output
    words = ["evaluate-joint", str(file), "--rig", str(KOKORO), "--joint", "elbow"]
    words += ["--low", "-0.5", "--high", "0.5", "--runs", "1", "--seconds", "1", "--dx", "0.5"]
    words += ["--json", str(tmp_path / "e.json")]
    done = runner.invoke(app, words)
    assert done.exit_code == 0, done.output
    document = json.loads((tmp_path / "e.json").read_text())
    assert {run["kind"] for run in document["runs"]} == {"smooth", "jagged"}
    shown = runner.invoke(app, ["policy", str(file)])
    assert shown.exit_code != 0  # it is no controller of a pressure, and says so


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (("--joint", "knee"), "--joint: found 'knee', --rig has elbow"),
        (("--low", "0.9"), "--low: found 0.9, allowed is below --high, 0.5"),
        (("--periods", "fast"), "--periods: found 'fast', needed are two such as 0.6,0.2"),
        (("--dx", "9"), "--dx: found 9"),
    ],
)
def test_what_cannot_be_judged_is_said(
    changed: tuple[str, str], said: str, app: typer.Typer, tmp_path: Path
) -> None:
    options = {"--rig": str(KOKORO), "--joint": "elbow", "--low": "-0.5", "--high": "0.5"}
    options[changed[0]] = changed[1]
    words = [word for pair in options.items() for word in pair]
    result = CliRunner().invoke(app, ["evaluate-joint", str(tmp_path / "none.yaml"), *words])
    assert said in str(result.exception) + result.output
