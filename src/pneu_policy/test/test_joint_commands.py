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
from pneu_policy.judge import joint_command
from pneu_policy.judge.latency import latency
from pneu_policy.judge.robot import JointRun, JointTasks, judge_joint
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


def test_a_tuned_pid_and_a_plan_that_is_not_tuned_both_follow(tmp_path: Path) -> None:
    rig = load_rig(KOKORO)
    pid = tune_joint(settings(seed=3)).controller  # so few tries do not always find good gains
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
    assert max(errors) < 0.1 < 0.25 * np.ptp(runs[0].target)  # rad


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
        (("--periods", "1"), "--periods: found '1', needed are two such as 0.6,0.2"),
        (("--periods", "1,2,3"), "--periods: found '1,2,3', needed are two such as 0.6,0.2"),
        (("--periods", "0.6,0.0099"), "--periods: found '0.6,0.0099', allowed are 0.01 to 100 s"),
        (("--periods", "100.1,0.2"), "--periods: found '100.1,0.2', allowed are 0.01 to 100 s"),
        (("--periods", "nan,0.2"), "--periods: found 'nan,0.2', allowed are 0.01 to 100 s"),
        (("--low", "0.5"), "--low: found 0.5, allowed is below --high, 0.5"),
        (("--low", "nan"), "--low: found nan, allowed is below --high, 0.5"),
        (("--dx", "9"), "--dx: found 9, allowed are 0.0001 to 1 m"),
        (("--dx", "1.01"), "--dx: found 1.01, allowed are 0.0001 to 1 m"),
        (("--dx", "0.00009"), "--dx: found 9e-05, allowed are 0.0001 to 1 m"),
        (("--plant", str(ROOT / "rigs/lab.yaml")), "found 'elbow', --plant has no encoders"),
        (("--runs", "0"), "should be greater than or equal to 1 "),
        (("--runs", "1001"), "should be less than or equal to 1000 "),
        (("--seconds", "0.9"), "should be greater than or equal to 1 "),
        (("--seconds", "3601"), "should be less than or equal to 3600 "),
        (("--seed", "-1"), "should be greater than or equal to 0 "),
        (("--seed", "2147483648"), "should be less than or equal to 2147483647 "),
        *(  # what is allowed is asked for the controller next
            (pair, "none.yaml: no such")
            for pair in (
                ("--runs", "1"),
                ("--runs", "1000"),
                ("--seconds", "1"),
                ("--seconds", "3600"),
                ("--dx", "1"),
                ("--dx", "0.0001"),
                ("--seed", "0"),
                ("--seed", "2147483647"),
                ("--periods", "0.01,100"),
                ("--periods", "100,0.01"),
            )
        ),
    ],
)
def test_what_cannot_be_judged_is_said(
    changed: tuple[str, str], said: str, app: typer.Typer, tmp_path: Path
) -> None:
    options = {"--rig": str(KOKORO), "--joint": "elbow", "--low": "-0.5", "--high": "0.5"}
    options[changed[0]] = changed[1]
    words = [word for pair in options.items() for word in pair]
    result = CliRunner().invoke(app, ["evaluate-joint", str(tmp_path / "none.yaml"), *words])
    assert said in f"{result.exception} {' '.join(result.output.replace('│', ' ').split())}"


def test_periods_are_smooth_then_jagged() -> None:
    assert joint_command._periods("0.6,0.2") == (0.6, 0.2)
    assert joint_command._periods("0.01, 100") == (0.01, 100.0)


def run_of(kind: str, number: int, *values: float) -> JointRun:
    none = np.zeros(0)
    return JointRun(kind, number, *values, none, none, none, none)


def test_the_table_tells_means_over_the_runs_of_a_kind() -> None:
    runs = [
        run_of("smooth", 0, 0.03, 0.010, 0.01, 1.0),
        run_of("jagged", 0, 0.5, 0.2, 0.4, 3.0),
        run_of("smooth", 1, 0.04, -0.004, 0.02, 1.5),
    ]
    table = joint_command._table({"some/pid.yaml": runs, "b.npz": runs[1:]}, ("smooth", "jagged"))
    assert [(column.heading, column.kind) for column in table.columns] == [
        ("controller", "name"), ("target", "name"), ("RMSE, rad or m", "number"),
        ("latency, ms", "number"), ("adjusted RMSE", "number"), ("effort, V", "number"),
    ]  # fmt: skip
    assert table.rows == [
        ("pid.yaml", "smooth", "0.0354", "3", "0.0158", "1.25"),
        ("pid.yaml", "jagged", "0.5000", "200", "0.4000", "3.00"),
        ("b.npz", "smooth", "0.0400", "-4", "0.0200", "1.50"),
        ("b.npz", "jagged", "0.5000", "200", "0.4000", "3.00"),
    ]
    assert table.title == "means over runs; errors as root mean squares"
    assert joint_command._plain("f", runs[2]) == {
        "controller": "f", "kind": "smooth", "run": 1, "rmse": 0.04, "latency_s": -0.004,
        "adjusted_rmse": 0.02, "effort_v": 1.5,
    }  # fmt: skip
