# SPDX-License-Identifier: Apache-2.0
"""``pneu observe``: what an observer says of recordings, as tables, files and pictures."""

import csv
import importlib.metadata
from pathlib import Path

import numpy as np
import pytest
from tests.short_bags import shorten
from typer.testing import CliRunner

from pneu_common.cli import COMMANDS_GROUP, build_app
from pneu_sysid.observed.follow import Followed
from pneu_sysid.observed.summary import said_of
from pneu_sysid.results.files import read_json

pytestmark = pytest.mark.takes(10)

HOUSE = Path(__file__).resolve().parents[3]
LAG = HOUSE / "data" / "bags" / "a_tap_lag"
RIG = HOUSE / "rigs" / "rig_a_fitted.yaml"
SEEN = ["valve_out", "end"]


ENTRY = importlib.metadata.EntryPoint("x", "pneu_sysid.commands:register", COMMANDS_GROUP)


def run(*words: str):
    return CliRunner().invoke(build_app([ENTRY]), ["observe", *words])


@pytest.mark.long
def test_a_tap_that_lags_is_named_and_one_never_shown_is_reproduced(tmp_path):
    out, table, picture = (tmp_path / name for name in ("o.json", "o.csv", "o.png"))
    used = [word for tap in ("supply", *SEEN, "exhaust") for word in ("--used", tap)]
    files = ["--json", str(out), "-o", str(table), "--figure", str(picture)]
    bag = tmp_path / "lag.mcap"
    shorten(next(LAG.glob("*.mcap")), bag, 5.0)
    asked = ["--dx", "0.1", "--smooth", "0.02", "--leak", "1e-8", *used, *files]
    done = run(str(bag), "--rig", str(RIG), *asked)
    assert done.exit_code == 0, done.output
    result = read_json(out)
    of = {s.name: s for s in result.observed}
    assert not of["middle"].used and of["middle"].times_noise < 3.0
    assert result.smooth_s == 0.02 and "0.02 s later" in done.output
    named = [s for s in result.said if s.kind == "sensor"]
    assert {s.subject for s in named} == {"end"} and named[0].start_s < 2.0
    assert "late by" in done.output
    drifting = {d.name: d for d in result.drifting}
    leak = drifting["pipes.tube: leak"]
    assert leak.unit == "m^2" and leak.times == pytest.approx(leak.value / 1e-8)
    assert abs(leak.value) < 1e-8 and "pipes.tube: leak" in done.output
    assert "valves.valve: null" in drifting
    with table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    late = [r for r in rows if r["middle.read"] and float(r["time_s"]) >= result.begin_s]
    error = [float(r["middle.read"]) - float(r["middle"]) for r in late]
    found = float(np.sqrt(np.mean(np.square(error))))
    assert found == pytest.approx(of["middle"].rmse, rel=1e-6)
    assert picture.stat().st_size > 10_000


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--used", "nose"], "--used: found 'nose', rig 'rig_a' has supply, valve_out, middle"),
        (["--dx", "-1"], "--dx: found -1 m, it must be positive and below 100"),
        (["--figure", "o.gif"], "found '.gif', allowed are .png, .svg, .pdf"),
    ],
)
def test_bad_input_is_one_sentence(words, said):
    done = run(str(LAG), "--rig", str(RIG), *words)
    assert done.exit_code != 0 and said in done.output + str(done.exception)


def test_what_is_said_again_at_once_is_one():
    time = np.arange(100) * 0.01
    wrong: list[list[str]] = [[] for _ in time]
    matter: list[dict[str, str]] = [{} for _ in time]
    for n in (10, 11, 12, 15, 60):  # taken back for less than 0.1 s, then for longer
        wrong[n] = [f"innovations of end are {n}.5 times as large as expected"]
    for n in range(20, 30):
        matter[n] = {"end": f"late by {n} ms"}
    found = Followed(time, {}, {}, {}, wrong, matter)
    told = [(s.kind, s.start_s, s.end_s, s.words) for s in said_of(found)]
    assert told == [
        ("model", 0.1, 0.15, "innovations of end are 15.5 times as large as expected"),
        ("sensor", 0.2, 0.29, "late by 29 ms"),
        ("model", 0.6, 0.6, "innovations of end are 60.5 times as large as expected"),
    ]
