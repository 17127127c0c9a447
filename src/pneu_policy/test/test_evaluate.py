# SPDX-License-Identifier: Apache-2.0
"""Evaluation: runs are repeatable, tables are means over runs, interrupted work goes on."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_policy.control.controllers import PidController, load_controller, save_pid
from pneu_policy.control.pid import Gains
from pneu_policy.judge.evaluate import (
    Conditions,
    Tasks,
    evaluate_simulated,
    names_of,
    simulated_tracks,
)
from pneu_policy.judge.limit import LimitSettings, evaluate_limit
from pneu_policy.judge.metrics import Metrics
from pneu_policy.judge.results import (
    Evaluation,
    Run,
    error_rows,
    load,
    load_track,
    markdown,
    rows,
    save,
)
from pneu_sim.rig import load_rig

ROOT = Path(__file__).parents[3]
RIG = load_rig(ROOT / "rigs" / "rig_a_fitted.yaml")
SHORT = Tasks(kinds=("smooth",), seeds=(0, 1), period_s=2.0, duration_s=2.0, skip_s=0.5)
COARSE = Conditions(dx_m=0.25)


@pytest.fixture
def pid(tmp_path):
    path = tmp_path / "pid.yaml"
    save_pid(PidController(Gains(kp_v_per_pa=1e-5, ki_v_per_pa_s=5e-5), period_s=0.01), {}, path)
    return path


def runs_of(specs, folder, tasks=SHORT, conditions=COARSE):
    evaluation = Evaluation(tasks.to_dict(), folder=folder)
    controllers = {spec.stem: [spec] for spec in specs}
    evaluate_simulated(evaluation, controllers, {"short": RIG}, tasks, conditions)
    return evaluation


def test_a_simulated_run_is_the_loop_of_controller_and_rig(pid):
    target = SHORT.target("smooth", 0)
    quiet = Conditions(noise_pa=0.0, delay_s=0.0, dx_m=0.25)
    (track,) = simulated_tracks(pid, RIG, [target], [0], 1.0, quiet)
    # Every command is what the controller says of the readings and targets of its moment ...
    again = load_controller(pid)
    for k, volts in enumerate(track.volts):
        at = target.at(np.array([track.time_s[k]])).tolist()
        assert again.step({"end": track.pressure_pa[k]}, at) == pytest.approx(volts, abs=1e-12)
    # ... and the readings are the rig's under these commands, simulated in one go.
    from pneu_sim.simulator import Simulator

    simulator = Simulator(RIG, dx_m=0.25)
    taken = simulator.run(1.0, {"voltage": np.repeat(track.volts[:-1], 5)}, 0.002)
    whole = np.asarray(taken.taps["end"])[::5]
    assert abs(whole - track.pressure_pa).max() < 3e3
    assert abs(whole[50:] - track.pressure_pa[50:]).max() < 300.0


def test_runs_are_repeatable_and_their_noise_is_the_seeds(pid, tmp_path):
    one, two = (runs_of([pid], tmp_path / name) for name in "ab")
    assert one.runs == two.runs and len(one.runs) == 2
    assert one.runs[0].metrics != one.runs[1].metrics
    track = load_track(tmp_path / "a" / "tracks" / "short-smooth-0-pid.npz")
    assert SHORT.judge(track) == one.runs[0].metrics
    assert 0.0 < one.runs[0].metrics.rmse_atm < 0.3


def test_an_interrupted_evaluation_goes_on(pid, tmp_path):
    whole = runs_of([pid], tmp_path)
    path = tmp_path / "evaluation.json"
    part = load(path)
    assert part.runs == whole.runs
    mark = Run("pid", "short", "smooth", 0, Metrics(*[9.0] * 8))
    part.runs = [mark]
    evaluate_simulated(part, {"pid": [pid]}, {"short": RIG}, SHORT, COARSE)
    # What was there is taken as it is, what was missing is the same as before.
    assert part.runs == [mark, whole.runs[1]]


def test_the_table_is_means_and_deviations_over_runs():
    evaluation = Evaluation({})
    errors = [0.1, 0.14, 0.06]
    for seed, error in enumerate(errors):
        figures = Metrics(error, math.nan, 0.02, 1.0, 2.0, 0.0, 3.0, 0.5)
        evaluation.add(Run("limit", "long", "jagged", seed, Metrics(*[0.01] * 8)))
        evaluation.add(Run("pde", "long", "jagged", seed, figures))
    evaluation.add(Run("pde", "long", "smooth", 0, None, 3, "late plant"))
    heads, body = rows(evaluation)
    # The standard deviation of 0.10, 0.14, 0.06 is 0.04.
    assert body[0][:5] == ["long", "jagged", "pde", "3", "0.100 ± 0.040"]
    assert body[0][heads.index("latency [ms]")] == "-"
    heads, body = error_rows(evaluation)
    assert heads == ["RMSE [atm]", "pde", "limit"]
    assert body == [["long, jagged", "0.100 ± 0.040", "0.0100 ± 0.0000"]]
    assert markdown(heads, body).splitlines()[2] == (
        "| long, jagged | 0.100 ± 0.040 | 0.0100 ± 0.0000 |"
    )


def test_a_run_is_replaced_by_one_of_the_same_task():
    evaluation = Evaluation({})
    evaluation.add(Run("pde", "long", "smooth", 0, None))
    assert not evaluation.has("long-smooth-0-pde")
    evaluation.add(Run("pde", "long", "smooth", 0, Metrics(*[0.01] * 8), 2))
    assert evaluation.has("long-smooth-0-pde") and len(evaluation.runs) == 1


@pytest.mark.long
def test_the_limit_is_below_any_controller(pid, tmp_path):
    tasks = Tasks(kinds=("smooth",), seeds=(0,), period_s=0.4, duration_s=0.9, skip_s=0.3)
    evaluation = runs_of([pid], tmp_path, tasks)
    settings = LimitSettings(dx_m=0.25, period_s=0.01, knot_s=0.02, horizon_s=0.16)
    evaluate_limit(evaluation, {"short": RIG}, "end", tasks, settings)
    assert evaluation.names() == ["pid", "limit"]
    by_name = {run.controller: run.metrics.rmse_atm for run in evaluation.runs}
    assert by_name["limit"] < 0.2 * by_name["pid"]


def test_controllers_of_one_name_are_told_apart(tmp_path):
    assert list(names_of([Path("a/pde.npz"), Path("b/pde.npz"), Path("pid.yaml")])) == [
        "a-pde",
        "b-pde",
        "pid",
    ]
    with pytest.raises(InputError, match="two controllers are called 'a-pde'"):
        names_of([Path("a/pde.npz"), Path("x/a/pde.npz")])


def test_bad_input_is_told(pid, tmp_path):
    with pytest.raises(InputError, match="targets: found 'wavy', allowed are smooth"):
        Tasks(kinds=("wavy",))
    with pytest.raises(InputError, match="skip_s: found 0"):
        Tasks(skip_s=0.0)
    taps = {name: tap for name, tap in RIG.taps.items() if name != "end"}
    blind = RIG.model_copy(update={"taps": taps})
    with pytest.raises(InputError, match="needs tap 'end', rig 'rig_a' has supply"):
        simulated_tracks(pid, blind, [SHORT.target("smooth", 0)], [0], 1.0, COARSE)
    path = tmp_path / "evaluation.json"
    save(Evaluation({}), path)
    path.write_text(path.read_text().replace('"pneu_evaluation": 1', '"pneu_evaluation": 9'))
    with pytest.raises(InputError, match="pneu_evaluation: found 9, this version reads 1"):
        load(path)
    path.write_text(json.dumps({"pneu_evaluation": 1}))
    with pytest.raises(InputError, match="is no evaluation"):
        load(path)
    path.write_text("{")
    with pytest.raises(InputError, match="is not JSON, line 1"):
        load(path)


def test_another_controller_of_the_same_name_is_run_anew():
    evaluation = Evaluation({})
    for plant in ("short", "long"):
        evaluation.introduce(plant, "pde", {"sha256": f"of {plant}"})
        evaluation.add(Run("pde", plant, "smooth", 0, Metrics(*[0.01] * 8)))
    evaluation.introduce("short", "pde", {"sha256": "of short"})
    assert evaluation.has("short-smooth-0-pde") and evaluation.has("long-smooth-0-pde")
    evaluation.introduce("short", "pde", {"sha256": "trained anew"})
    assert not evaluation.has("short-smooth-0-pde") and evaluation.has("long-smooth-0-pde")
