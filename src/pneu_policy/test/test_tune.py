# SPDX-License-Identifier: Apache-2.0
"""Tuning: the search finds known minima, and PIDs get better on runs that are as they are said."""

from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from pneu_common.errors import InputError
from pneu_policy.control.controllers import FeedForwardPid, PidController, load_controller
from pneu_policy.control.identity import rig_identity
from pneu_policy.control.observations import Recipe
from pneu_policy.control.pid import Gains
from pneu_policy.control.policy_file import PolicyFile
from pneu_policy.tune.command import register_policy, register_tune
from pneu_policy.tune.gains import Trials, tune
from pneu_policy.tune.settings import TuneSettings
from pneu_sim.rig import load_rig

ROOT = Path(__file__).parents[3]
RIG = str(ROOT / "rigs/rig_a_thin_plate.yaml")  # the fast model
SHORT = TuneSettings(
    rig=RIG, kind="pid", trials=2, seconds=0.4, spread=0.0, candidates=8, generations=4
)


def test_candidates_are_run_alone_as_they_are_side_by_side():
    """A candidate's errors do not depend on its neighbours, nor on the lane it has."""
    rig = load_rig(RIG)
    good, wild = PidController(Gains(1e-5)), PidController(Gains(1e-4, kd_v_s_per_pa=1e-5))
    side_by_side = Trials(SHORT.but(candidates=5), rig).run([wild, good, good])
    alone = Trials(SHORT.but(candidates=1 + 4), rig).run([good])
    assert np.allclose(side_by_side[1], alone[0], rtol=1e-9)
    assert np.array_equal(side_by_side[1], side_by_side[2])
    assert side_by_side[0].mean() > 2.0 * side_by_side[1].mean()


def test_a_valve_that_stays_closed_misses_the_target_by_the_target_s_own_spread():
    settings = SHORT.but(trials=1, kinds=("jagged",))
    trials = Trials(settings, load_rig(RIG))
    # So little gain that the valve does not leave its null.
    (square,) = trials.run([PidController(Gains(1e-12))])
    target, begin = trials._targets[0], trials._begins[0]
    wanted = target.at(begin + np.arange(1, trials.steps + 1) * settings.period_s)
    start = float(target.at(begin))
    assert square[0] == pytest.approx(np.mean((wanted - start) ** 2), rel=0.01)


@pytest.mark.parametrize("kind", ["pid", "feed_forward"])
def test_the_same_seed_gives_the_same_gains_and_better_ones(kind):
    settings = SHORT.but(kind=kind)
    told = []
    tuned = tune(settings, lambda generation, rmse_pa: told.append((generation, rmse_pa)))
    again = tune(settings)
    assert tuned.controller.gains == again.controller.gains
    assert tuned.history_pa == again.history_pa == [rmse for _, rmse in told]
    assert [generation for generation, _ in told] == [1, 2, 3, 4]
    assert tuned.rmse_pa < tuned.history_pa[0] and tuned.evaluations == 32
    # What is said of the best is what it does.
    square = Trials(settings, load_rig(RIG)).run([tuned.controller])
    assert np.sqrt(square.mean()) == pytest.approx(tuned.rmse_pa, rel=1e-9)
    assert tuned.of_kind_pa == pytest.approx(
        {"smooth": np.sqrt(square[0, 0]), "jagged": np.sqrt(square[0, 1])}
    )
    other = tune(settings.but(seed=1))
    assert other.controller.gains != tuned.controller.gains


def test_no_term_looks_further_ahead_than_policies_do():
    tuned = tune(SHORT.but(kind="feed_forward", generations=1))
    assert isinstance(tuned.controller, FeedForwardPid)
    assert tuned.controller.preview_s[-1] <= 0.2


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"kind": "fuzzy"}, "kind: Input should be 'pid' or 'feed_forward', found 'fuzzy'"),
        ({"kinds": ("wavy",)}, "kinds.0: Input should be"),
        ({"candidates": 2}, "candidates: .*found 2"),
        ({"noise_pa": -1.0}, "noise_pa"),
        ({"delay_s": (0.1, 0.05)}, "delay_s"),
        ({"seconds": 0.0}, "seconds"),
    ],
)
def test_settings_out_of_range_are_refused(changed, message):
    with pytest.raises(InputError, match=message):
        SHORT.but(**changed)


def test_a_tap_that_the_rig_has_not_is_refused():
    with pytest.raises(InputError, match="found 'nose'"):
        tune(SHORT.but(tap="nose"))


@pytest.fixture(scope="module")
def app():
    app = typer.Typer()
    register_tune(app)
    register_policy(app)
    return app


def test_the_commands_tune_write_and_show(app, tmp_path):
    path = tmp_path / "tuned.yaml"
    words = ["tune", "--rig", str(ROOT / "rigs/rig_a_thin_plate.yaml"), "--kind", "feed_forward"]
    words += ["--trials", "1", "--candidates", "5", "--generations", "1", "-o", str(path)]
    result = CliRunner().invoke(app, words, catch_exceptions=False)
    assert result.exit_code == 0 and "kp_v_per_pa" in result.output and "atm" in result.output
    controller = load_controller(path)
    assert controller.tuned["settings"]["kind"] == "feed_forward"
    assert len(controller.tuned["rig_sha256"]) == 64
    shown = CliRunner().invoke(app, ["policy", str(path)], catch_exceptions=False).output
    assert "feed-forward gain" in shown and "tuned.rmse_pa" in shown


def test_the_command_shows_what_a_policy_is(app, tmp_path):
    recipe = Recipe(tap="end", taps=("end", "middle"))
    layer = (np.zeros((1, recipe.size), np.float32), np.zeros(1, np.float32))
    identity = rig_identity(load_rig(ROOT / "rigs/rig_a_fitted.yaml"))
    path = tmp_path / "one.npz"
    PolicyFile([layer], recipe, identity, {"seed": 17, "settings": {"lambda": 0.97}}).save(path)
    result = CliRunner().invoke(app, ["policy", str(path)], catch_exceptions=False)
    for text in ("end, middle", "rig_a", "tube 2.5 m", "10 ms", "settings.lambda", "17"):
        assert text in result.output
    other = ["policy", str(path), "--rig", str(ROOT / "rigs/rig_b.yaml")]
    error = CliRunner().invoke(app, other).exception
    assert isinstance(error, InputError) and "found rig 'rig_b'" in str(error)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["-o", "pid.txt"], "written as .yaml"),
        (["-o", "no/such/pid.yaml"], "does not exist"),
        (["-o", "pid.yaml", "--kind", "fuzzy"], "found 'fuzzy'"),
        (["-o", "pid.yaml", "--rig", "no.yaml"], "no.yaml: no such rig file"),
    ],
)
def test_bad_words_are_refused(app, words, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    error = CliRunner().invoke(app, ["tune", "--rig", RIG, *words]).exception
    assert isinstance(error, InputError) and message in str(error)
    assert not list(tmp_path.iterdir())
