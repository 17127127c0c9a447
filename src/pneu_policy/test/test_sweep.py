# SPDX-License-Identifier: Apache-2.0
"""Which runs a settings document asks for, and which of them are done; nothing is trained."""

import dataclasses
import hashlib
import json
from pathlib import Path

import pytest

pytest.importorskip("torch")

from pneu_common.errors import InputError
from pneu_policy.learn import sweep
from pneu_policy.learn.history import History
from pneu_policy.learn.settings import TrainSettings
from pneu_policy.learn.trainer import HISTORY, POLICY

ROOT = Path(__file__).parents[3]
PLAIN = {
    "env": {
        "rig": str(ROOT / "rigs/rig_a_thin_plate.yaml"),
        "recipe": {"tap": "end", "taps": ["end"]},
    },
    "iterations": 4,
    "seed": 3,
}


@pytest.fixture
def run(tmp_path):
    return sweep.Run(tmp_path / "runs" / "one", TrainSettings(**PLAIN))


def trained(run, **changes):
    """What a policy says of its training."""
    digest = hashlib.sha256(Path(PLAIN["env"]["rig"]).read_bytes()).hexdigest()
    return {"settings": run.settings.plain(), "rig": {"sha256": digest}, **changes}


def test_a_policy_that_was_trained_so_is_made(run):
    record = trained(run)
    assert run.made(record)
    assert run.made({"settings": record["settings"], "hand": record["rig"]})
    assert run.made({**record, "hand": {"sha256": "0"}}), "of a rig it is the rig's"
    record["settings"].pop("keep_every")  # came to the settings since
    assert run.made(record)


@pytest.mark.parametrize(
    "change",
    [
        {"settings": None},
        {"settings": 3},
        {"settings": {}},
        {"settings": {**PLAIN, "colour": 1}},
        {"settings": {**PLAIN, "seed": -1}},
        {"settings": {**PLAIN, "seed": 4}},
        {"rig": {"sha256": "0" * 64}},
        {"rig": {}},
        {"rig": None},
    ],
)
def test_any_other_policy_is_not(run, change):
    assert not run.made(trained(run, **change))


def test_a_policy_that_says_nothing_of_its_settings_is_not(run):
    record = trained(run)
    del record["settings"]
    assert not run.made(record) and not run.made({})


def finished(run, rows=(), policy=True, done=True, **changes):
    """A run's folder as a training leaves it."""
    run.folder.mkdir(parents=True, exist_ok=True)
    settings = {**run.settings.plain(), **changes}
    History("npg", settings, list(rows), done).save(run.folder / HISTORY)
    if policy:
        (run.folder / POLICY).write_bytes(b"")


def test_a_finished_run_has_a_history(run):
    assert (run.name, run.history()) == ("one", None)
    finished(run, policy=False)
    assert run.history() is None
    finished(run, done=False)
    assert run.history() is None
    finished(run)
    assert run.history().settings == run.settings.plain()
    finished(run, iterations=3)  # it is to be longer
    assert run.history() is None
    for change, says in (({"iterations": 5}, "iterations: found 5, wanted 4"),
                         ({"seed": 2}, "seed: found 2, wanted 3"),
                         ({"seed": 2, "iterations": 3}, "seed: found 2, wanted 3")):  # fmt: skip
        finished(run, **change)
        with pytest.raises(InputError) as caught:
            run.history()
        path = run.folder / HISTORY
        assert str(caught.value) == f"{path}: holds a run of other settings: {says}"


def test_finished_runs_are_told_and_not_trained(run):
    finished(run)
    (outcome,) = sweep.train_all([run], sweep.Workers())
    assert (outcome.run, outcome.fault, outcome.trace) == (run, None, None)
    assert outcome.history.finished


@pytest.mark.parametrize(("workers", "fits"), [(-2, 0), (-1, 1), (0, 0), (1, 1), (7, 1)])
def test_how_many_workers(workers, fits):
    if fits:
        assert sweep.Workers.from_dict({"workers": workers}) == sweep.Workers("loky", workers)
        return
    with pytest.raises(InputError) as caught:
        sweep.Workers(workers=workers)
    assert str(caught.value) == f"workers: found {workers}, allowed is 1 or more, or -1"


def test_workers_from_a_document():
    assert sweep.Workers.from_dict({}) == sweep.Workers("loky", 1, None)
    given = {"backend": "ray", "workers": 3, "address": "host:1"}
    assert dataclasses.asdict(sweep.Workers.from_dict(given)) == given
    assert sweep.Workers.from_dict({"address": None}).address is None
    for mapping, says in (
        ({"works": 1}, "run.works: is not a setting; known are backend, workers, address"),
        ({"workers": "3"}, "run.workers: found '3', a whole number is needed"),
        ({"workers": 3.0}, "run.workers: found 3.0, a whole number is needed"),
        ({"workers": True}, "run.workers: found True, a whole number is needed"),
        ({"workers": None}, "run.workers: found None, a whole number is needed"),
        ({"address": 7}, "run.address: found 7, text is needed"),
        ({"backend": 1}, "run.backend: found 1, text is needed"),
        ({"backend": "dask"}, "backend: found 'dask', allowed are loky, ray"),
    ):
        with pytest.raises(InputError) as caught:
            sweep.Workers.from_dict(mapping)
        assert str(caught.value) == says


def test_without_a_sweep_it_is_one_run_in_the_folder_itself(tmp_path):
    for axes in ({}, None):
        (run,) = sweep.expand({**PLAIN, "run": {"workers": 2}, "sweep": axes}, tmp_path)
        assert run == sweep.Run(tmp_path, TrainSettings(**PLAIN))


def test_a_sweep_of_files_and_lists(tmp_path):
    rigs = [str(ROOT / f"rigs/{name}.yaml") for name in ("rig_a_fitted", "rig_a_thin_plate")]
    axes = {"env.rig": rigs, "npg.hidden": [[8, 4]], "npg.gamma": [0.5]}
    runs = sweep.expand({**PLAIN, "sweep": axes}, tmp_path)
    assert [run.name for run in runs] == [
        "rig-rig_a_fitted_hidden-8-4_gamma-0.5".replace("rig_a_fitted", "rig-a-fitted"),
        "rig-rig-a-thin-plate_hidden-8-4_gamma-0.5",
    ]
    assert [run.settings.env.rig for run in runs] == rigs
    assert {(run.settings.npg.hidden, run.settings.npg.gamma) for run in runs} == {((8, 4), 0.5)}
    assert all(run.folder.parent == tmp_path for run in runs)


@pytest.mark.parametrize(
    ("axes", "says"),
    [
        ({"seed": 3}, "sweep: found {'seed': 3}, needed are fields with lists of values"),
        ({"seed": []}, "sweep: found {'seed': []}, needed are fields with lists of values"),
        (["seed"], "sweep: found ['seed'], needed are fields with lists of values"),
        ({"seed.x": [1]}, "sweep.seed.x: seed is no group of settings"),
        ({"seed": [1, 2, 1]}, "sweep: two runs would be named 'seed-1'"),
    ],
)
def test_a_sweep_that_makes_no_sense(tmp_path, axes, says):
    with pytest.raises(InputError) as caught:
        sweep.expand({**PLAIN, "sweep": axes}, tmp_path)
    assert str(caught.value) == says


@pytest.mark.parametrize(
    ("value", "word"),
    [
        ("a/b_c.yaml", "b-c"),
        (-0.5, "-0.5".strip("-")),
        (1e-6, "1e-06"),
        (True, "True"),
        (None, "None"),
        ("", "none"),
        ("--", "none"),
        ([1, 2], "1-2"),
        ("x y!z", "x-y-z"),
    ],
)
def test_values_in_the_names_of_folders(value, word):
    assert sweep._word(value) == word


def test_a_failure_is_one_line(run, tmp_path):
    run.folder.parent.mkdir()
    run.folder.write_text("in the way")
    outcome = sweep._attempt(run, True, tmp_path)
    assert outcome.history is None and outcome.fault.startswith("FileExistsError: ")
    assert outcome.trace.startswith("Traceback")
    wrong = json.loads(json.dumps({**PLAIN, "env": {**PLAIN["env"], "rig": "none.yaml"}}))
    outcome = sweep._attempt(sweep.Run(tmp_path / "two", TrainSettings(**wrong)), True, tmp_path)
    assert outcome.fault.startswith("none.yaml: ") and "\n" not in outcome.fault
