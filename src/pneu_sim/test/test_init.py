# SPDX-License-Identifier: Apache-2.0
"""`pneu init`: its rig files are sound as they are written and say what to change; its examples."""

from __future__ import annotations

import importlib.metadata
import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML
from typer.testing import CliRunner

import pneu_sim.init
from pneu_common.cli import COMMANDS_GROUP, build_app
from pneu_sim.init import TEMPLATES, kinds
from pneu_sim.rig.load import load_rig
from pneu_sim.simulator import Simulator

ROOT = Path(__file__).parents[3]
KINDS = sorted(path.stem for path in TEMPLATES.glob("*.yaml"))

Run = Callable[..., Any]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Runs `pneu` in an empty folder."""
    monkeypatch.chdir(tmp_path)
    entry = importlib.metadata.EntryPoint("sim", "pneu_sim.commands:register", COMMANDS_GROUP)
    return lambda *words: CliRunner().invoke(build_app([entry]), words, prog_name="pneu")


def refusal(result: Any) -> str:
    """The one line in which a command refused."""
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith("pneu: ") and result.stderr.count("\n") == 1
    return str(result.stderr)


def test_there_are_a_line_a_tee_and_a_cylinder() -> None:
    assert {"line", "tee", "cylinder"} <= set(KINDS) == set(kinds())
    assert all(len(what) > 20 and what.endswith(".") for what in kinds().values())


@pytest.mark.parametrize("kind", KINDS)
def test_what_it_writes_passes_the_steps_it_names(run: Run, kind: str, tmp_path: Path) -> None:
    result = run("init", "my rig", "--kind", kind)
    assert result.exit_code == 0, result.stderr
    assert load_rig("my rig.yaml").name == "my rig"
    told = [shlex.split(line)[1:] for line in result.stdout.splitlines() if line[:7] == "  pneu "]
    assert [words[0] for words in told] == ["check", "simulate", "fit", "compare"]
    check, simulate, *_ = told
    for words in (check, simulate, ["effects", "--rig", "my rig.yaml"]):
        done = run(*words)
        assert (done.exit_code, done.stderr) == (0, "")
    simulated = np.genfromtxt(tmp_path / simulate[-1], delimiter=",", names=True)
    rig = load_rig("my rig.yaml")
    room, supply = rig.reservoirs["room"].pressure_pa, rig.reservoirs["supply"].pressure_pa
    emptied = {"rod"} if kind == "cylinder" else set()
    for tap in rig.taps:  # the others are filled by the steps
        assert simulated[tap][0] == pytest.approx(room)
        assert simulated[tap][-1] == pytest.approx(room if tap in emptied else supply, rel=0.1)
    if kind == "cylinder":  # driven out to its end
        start, stroke = 0.01, rig.cylinders["cylinder"].stroke
        assert simulated["load_slide"][0] == start
        assert simulated["load_slide"][-1] == pytest.approx(stroke, abs=1e-3)
        way = np.trapezoid(simulated["load_slide_velocity"], simulated["time_s"])
        assert way == pytest.approx(stroke - start, rel=0.1)


@pytest.mark.parametrize("kind", KINDS)
def test_mass_is_conserved(run: Run, kind: str) -> None:
    """Shut in, it stays whatever flows inside; else it is what passes the ports."""
    run("init", "--kind", kind)
    rig = load_rig("rig.yaml")
    simulator = Simulator(rig)
    parts = [*rig.pipes, *rig.chambers]
    simulator.reset({name: 1.5e5 + 1e5 * k for k, name in enumerate(parts)})
    before = float(simulator.mass_kg())
    shut = simulator.run(0.02, {"voltage": 5.0})
    assert all(np.isfinite(series).all() for series in shut.pressures.values())
    assert float(simulator.mass_kg()) == pytest.approx(before, rel=1e-12)

    begun = float(simulator.mass_kg())
    readings = simulator.run(0.02, {"voltage": 10.0}, sample_s=5e-5)
    gained = float(simulator.mass_kg()) - begun
    inflow = [  # of every port: it fills from a reservoir, or empties into one
        readings.flows[f"valve.{name}"] * (1.0 if port.from_node in rig.reservoirs else -1.0)
        for name, port in rig.valves["valve"].ports.items()
    ]
    passed = [float(np.trapezoid(flow, readings.time_s)) for flow in inflow]
    assert max(passed) > 0.02 * before
    assert gained == pytest.approx(sum(passed), abs=2e-3 * max(passed))
    assert all((series > 0.0).all() for series in readings.pressures.values())


def entries(text: str) -> Iterator[tuple[str, str, Any]]:
    """Comment, key and value of every line of a rig file that has a value."""
    comment: list[str] = []
    for line in text.splitlines():
        stripped = line.strip()
        if stripped.startswith("#"):
            comment.append(stripped.removeprefix("#").strip())
            continue
        key, _, value = stripped.partition(":")
        if value.strip():
            yield " ".join(comment), key, YAML(typ="safe").load(value)
        comment = []


@pytest.mark.parametrize("kind", KINDS)
def test_every_number_says_what_it_is_and_lies_in_the_range_it_names(kind: str) -> None:
    text = (TEMPLATES / f"{kind}.yaml").read_text(encoding="utf-8")
    units = re.compile(
        r", (Pa|K|m|m2|m3|Hz|V|W/K|m3/\(s Pa\)|kg|N|N s/m|rad)[ .:,]|ratio|share|per recorded unit"
        r"|as"
    )
    numbers = 0
    for comment, key, value in entries(text):
        values = value if isinstance(value, list) else [value]
        if key == "pneu_rig" or not all(isinstance(v, int | float) for v in values):
            continue
        numbers += 1
        assert comment.startswith("CHANGE"), key
        assert units.search(comment), comment
        low, high = map(float, re.findall(r"Usual: (\S+) to (\S+)\.$", comment)[0])
        assert all(low <= v <= high for v in values), (key, value)
    assert numbers >= 15


@pytest.mark.parametrize("kind", KINDS)
def test_every_topic_says_that_it_is_to_be_changed(kind: str) -> None:
    text = (TEMPLATES / f"{kind}.yaml").read_text(encoding="utf-8")
    topics = [comment for comment, key, _ in entries(text) if key == "topic"]
    rig = load_rig(TEMPLATES / f"{kind}.yaml")
    assert len(topics) == len(rig.taps) + len(rig.commands)
    assert all(comment.startswith("CHANGE") and "Yours: " in comment for comment in topics)


@pytest.mark.parametrize(
    ("words", "path"),
    [
        ([], "rig.yaml"),
        (["bench"], "bench.yaml"),
        (["bench.yml"], "bench.yml"),
        (["folder"], "folder/rig.yaml"),
        (["folder/bench"], "folder/bench.yaml"),
    ],
)
def test_where_it_is_written(run: Run, tmp_path: Path, words: list[str], path: str) -> None:
    (tmp_path / "folder").mkdir()
    assert run("init", *words).stdout.startswith(f"{path}: a rig of kind line.")
    assert [p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*.y*ml")] == [path]
    assert load_rig(path).name == Path(path).stem


@pytest.mark.parametrize("name", ["true", "12", 'a "quoted" rig', "a: b", "größe", r"back\1slash"])
def test_any_name_stays_a_name(run: Run, name: str) -> None:
    assert run("init", name).exit_code == 0
    assert load_rig(f"{name}.yaml").name == name


def test_nothing_is_overwritten(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    path.write_text("mine")
    assert "bench.yaml: exists already" in refusal(run("init", "bench"))
    assert path.read_text() == "mine"
    path.unlink()
    path.symlink_to("nowhere")
    assert "bench.yaml: exists already" in refusal(run("init", "bench"))
    assert path.is_symlink() and list(tmp_path.iterdir()) == [path]
    (tmp_path / "example").mkdir()
    assert "example: exists already" in refusal(run("init", "--example", "example"))
    assert not list((tmp_path / "example").iterdir())


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--kind", "tree"], "--kind: found 'tree', allowed are cylinder ("),
        (["bench.txt"], "bench.txt: found suffix '.txt', allowed are .yaml, .yml, none"),
        (["no/bench"], "no/bench.yaml: there is no folder 'no'"),
        (["--example", "no/x"], "no/x: there is no folder 'no'"),
        (["bench", "--example", "x"], "--example: found bench beside it"),
        (["--kind", "tee", "--example", "x"], "--example: found --kind beside it"),
    ],
)
def test_refusals(run: Run, tmp_path: Path, words: list[str], told: str) -> None:
    line = refusal(run("init", *words))
    assert told in line
    assert "tree" not in line or all(f"{kind} (" in line for kind in KINDS)
    assert not list(tmp_path.iterdir())


def test_help_names_every_kind(run: Run) -> None:
    text = " ".join(run("init", "--help").stdout.split())
    assert all(f"{kind} ({what.rstrip('.')})" in text for kind, what in kinds().items())


def test_examples_are_those_of_the_checkout(run: Run, tmp_path: Path) -> None:
    result = run("init", "--example", "try it")
    assert result.exit_code == 0, result.stderr
    folder = tmp_path / "try it"
    copied = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    rigs = {f"rigs/{p.name}" for p in ROOT.glob("rigs/*.yaml")}
    bags = {f"data/bags/{bag}/{bag}.mcap" for bag in ("a_leak", "a_healthy_2")}
    assert rigs | bags | {"LICENSE", "rigs/README.md", "data/bags/README.md"} <= copied
    assert all((folder / name).read_bytes() == (ROOT / name).read_bytes() for name in copied)
    assert [p.name for p in tmp_path.iterdir()] == ["try it"]
    assert folder.stat().st_mode & 0o777 == (folder / "rigs").stat().st_mode & 0o777
    # every file that the printed commands and the page of the rigs read is there
    page = (folder / "rigs" / "README.md").read_text(encoding="utf-8")
    told = [line for line in (result.stdout + page).splitlines() if line.strip()[:5] == "pneu "]
    named = {word for line in told for word in line.split() if word.startswith(("rigs/", "data/"))}
    assert len(named) == 4
    assert all((folder / name).exists() for name in named)


def test_examples_that_are_not_there(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pneu_sim.init, "example_files", lambda: None)
    assert "did not come with this installation" in refusal(run("init", "--example", "x"))
    assert not list(tmp_path.iterdir())
