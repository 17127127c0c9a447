# SPDX-License-Identifier: Apache-2.0
"""`pneu effects`, `pneu check` and `pneu simulate` from the command line."""

from __future__ import annotations

import csv
import importlib.metadata
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from pneu_common.cli import COMMANDS_GROUP, build_app
from pneu_sim.effects import registry

RIGS = Path(__file__).parents[3] / "rigs"
RIG_A = str(RIGS / "rig_a.yaml")

USER_EFFECT = '''
from pneu_sim.effects import Effect, EffectParameter

class Draught(Effect):
    """A draught."""
    name = "draught"
    title = "window open"
    formula = "t = t - x"
    source = "none"
    parameters = (EffectParameter("cooling_k", "K", 0.0, 0.0, 9.0, 3.0, 0.1),)
    next_experiment = "Close it."

    def places(self, rig):
        return ["room"]

    def on_rig(self, rig, place, values):
        rig.ambient.temperature_k -= values["cooling_k"]
'''

Run = Callable[..., Any]


@pytest.fixture
def run() -> Run:
    entry = importlib.metadata.EntryPoint("sim", "pneu_sim.commands:register", COMMANDS_GROUP)
    return lambda *words: CliRunner().invoke(build_app([entry]), words, prog_name="pneu")


def table(path: Path) -> dict[str, np.ndarray]:
    rows = list(csv.reader(path.open()))
    return dict(zip(rows[0], np.array(rows[1:], dtype=float).T, strict=True))


def test_effects_lists_every_effect_and_those_of_a_file(run: Run, tmp_path: Path) -> None:
    known = set(registry())
    out = run("effects").stdout
    assert known and all(f" {name} " in out for name in known)
    file = tmp_path / "own.py"
    file.write_text(USER_EFFECT)
    assert "window open" in run("effects", "--effects", str(file)).stdout


def test_effects_of_a_rig_names_its_places(run: Run) -> None:
    out = run("effects", "--rig", RIG_A).stdout
    assert "supply_line, tube, exhaust_tube" in out
    assert "valve_out" in out


def test_check_shows_network_cells_and_time_step(run: Run) -> None:
    result = run("check", RIG_A)
    assert result.exit_code == 0
    assert "length [m]" in result.stdout and "time step" in result.stdout
    tube = next(line for line in result.stdout.splitlines() if "│ tube " in line)
    assert " 50 " in tube  # 2.5 m in cells of 5 cm
    assert "closed volumes of the lumped models: tube" in result.stdout


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("length_m: 2.5", "length_m: -2.5", "length_m"),
        ("taps:", "tips: {}\ntaps:", "unknown key 'tips'; did you mean 'taps'?"),
        ("to: closed", "to: nowhere", "unconnected"),
    ],
)
def test_check_refuses_a_wrong_rig_in_one_line(
    run: Run, tmp_path: Path, old: str, new: str, fault: str
) -> None:
    text = Path(RIG_A).read_text()
    assert old in text
    wrong = tmp_path / "rig.yaml"
    wrong.write_text(text.replace(old, new, 1))
    result = run("check", str(wrong))
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1 and fault in result.stderr


@pytest.mark.parametrize("model", ["pde", "thin_plate"])
def test_simulate_fills_the_tube_and_repeats_its_noise(
    run: Run, tmp_path: Path, model: str
) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(Path(RIG_A).read_text() + f"model: {model}\n")
    commands = tmp_path / "volts.csv"
    commands.write_text("time_s,volts\n10.0,5\n10.05,10\n10.15,10\n")
    words = ["simulate", "--rig", str(rig), "--command", f"voltage={commands}"]
    outputs = {}
    for name, more in {
        "clean": [],
        "one": ["--seed", "1", "--noise", "200"],
        "again": ["--seed", "1", "--noise", "200"],
        "two": ["--seed", "2", "--noise", "200"],
    }.items():
        file = tmp_path / f"{name}.csv"
        result = run(*words, *more, "-o", str(file))
        assert result.exit_code == 0, result.stderr
        outputs[name] = table(file)
    clean = outputs["clean"]
    np.testing.assert_allclose(clean["time_s"], np.arange(76) * 0.002, atol=1e-9)
    assert (clean["voltage"] == np.where(clean["time_s"] < 0.0499, 5.0, 10.0)).all()
    np.testing.assert_allclose(clean["end"][:25], 101000.0, rtol=1e-6)
    assert clean["end"][-1] > 2e5
    assert (outputs["one"]["end"] == outputs["again"]["end"]).all()
    assert (outputs["one"]["end"] != outputs["two"]["end"]).any()
    noise = np.concatenate([outputs["one"][tap] - clean[tap] for tap in ("end", "supply")])
    assert noise.std() == pytest.approx(200.0, rel=0.25)


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (["--steps", "volts=5:1"], "found command 'volts', its commands are voltage"),
        ([], "found nothing for command 'voltage'"),
        (["--steps", "voltage=5"], "found '5', each step is VOLTS:SECONDS"),
        (["--steps", "voltage=5:1", "--noise", "3"], "--seed"),
        (["--steps", "voltage=5:1", "--duration", "0"], "--duration: found 0 s"),
        (["--command", "voltage=nofile.csv"], "nofile.csv: command 'voltage' cannot be read"),
    ],
)
def test_simulate_refuses_in_one_line(
    run: Run, tmp_path: Path, words: list[str], fault: str
) -> None:
    output = tmp_path / "out.csv"
    result = run("simulate", "--rig", RIG_A, "-o", str(output), *words)
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1 and fault in result.stderr
    assert list(tmp_path.iterdir()) == []
