# SPDX-License-Identifier: Apache-2.0
"""`pneu evaluate` writes results, tables and figures, and tells bad input in a sentence."""

import json
import sys
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from pneu_common.errors import InputError
from pneu_policy.control.controllers import PidController, save_pid
from pneu_policy.control.pid import Gains
from pneu_policy.judge.command import register_evaluate

ROOT = Path(__file__).parents[3]
RIG = ROOT / "rigs" / "rig_a_fitted.yaml"
LONG = ROOT / "rigs" / "rig_b_fitted.yaml"
PLANT = ROOT / "rigs" / "plants" / "short.sealed.json"
QUICK = ["--dx", "0.25", "--duration", "2", "--skip", "0.5", "--period", "1", "--seeds", "0-1"]


@pytest.fixture
def files(tmp_path):
    made = [tmp_path / "calm.yaml", tmp_path / "keen.yaml"]
    for path, gain in zip(made, (5e-6, 1.5e-5), strict=True):
        save_pid(PidController(Gains(kp_v_per_pa=gain, ki_v_per_pa_s=2e-5)), {}, path)
    return made


def run(*words):
    app = typer.Typer()
    register_evaluate(app)
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.mark.long
def test_results_tables_and_figures(files, tmp_path):
    calm, keen = files
    out, copy = tmp_path / "out", tmp_path / "copy.json"
    plant = ["--rig", f"short={RIG}", "--sealed", PLANT]
    done = run(calm, keen, *plant, *QUICK, "--targets", "smooth", "-o", out, "--json", copy)
    assert done.exit_code == 0, done.output
    found = json.loads((out / "evaluation.json").read_text())
    assert found == json.loads(copy.read_text())
    errors = {(run["controller"], run["seed"]): run["metrics"]["rmse_atm"] for run in found["runs"]}
    assert len(errors) == 4 and errors["keen", 0] < errors["calm", 0]
    text = (out / "table.md").read_text()
    assert "| short, smooth |" in text and "±" in text and "RMSE [atm]" in done.output
    pictures = ["errors.png", "runs-short.png"]
    assert all((out / name).read_bytes().startswith(b"\x89PNG") for name in pictures)
    assert all((out / name).stat().st_size > 10_000 for name in pictures)
    # What there is stays, what is asked for besides is added: here the files take turns.
    more = run(f"both={calm},{keen}", *plant, *QUICK, "--targets", "smooth", "-o", out)
    assert more.exit_code == 0, more.output
    runs = json.loads((out / "evaluation.json").read_text())["runs"]
    added = {run["seed"]: run["metrics"]["rmse_atm"] for run in runs if run["controller"] == "both"}
    assert added == {0: errors["calm", 0], 1: errors["keen", 1]}


def test_without_matplotlib_there_are_tables_and_no_figures(files, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    words = ["--rig", f"short={RIG}", *QUICK, "--targets", "smooth", "-o", tmp_path]
    done = run(files[0], *words)
    assert done.exit_code == 0, done.output
    assert "no figures: they need matplotlib" in done.output
    assert (tmp_path / "table.md").exists() and not list(tmp_path.glob("*.png"))


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--seeds", "4-0"], "--seeds: found '4-0', allowed are such as 0-4"),
        (["--targets", "wavy"], "targets: found 'wavy'"),
        (["--sealed", PLANT, "--sealed", PLANT], "--sealed: found 2 files for 1 rigs"),
        (["--rig", f"long={LONG}", "--rig", f"long={RIG}"], "names are letters and digits, each"),
        (["--live", "--noise", "0"], "without noise count as frozen"),
        (["--delay", "3"], "--delay: found 3, allowed are 0 to 0.2 s"),
        (["--dx", "0"], "--dx: found 0"),
    ],
)
def test_bad_input_is_a_sentence(files, tmp_path, words, told):
    failed = run(files[0], "--rig", f"short={RIG}", *words, "-o", tmp_path / "out")
    assert isinstance(failed.exception, InputError)
    assert told in str(failed.exception) and "\n" not in str(failed.exception)
    assert not (tmp_path / "out").exists()


def test_results_of_other_tasks_are_not_mixed(files, tmp_path):
    words = [files[0], "--rig", f"short={RIG}", "-o", tmp_path, "--targets", "smooth"]
    assert run(*words, *QUICK).exit_code == 0
    failed = run(*words, *QUICK, "--period", "2")
    assert "was made with other settings (period_s); choose another folder" in str(failed.exception)
    failed = run(*words, *QUICK, "--noise", "100")
    assert "was made with other settings (conditions)" in str(failed.exception)
