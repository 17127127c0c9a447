# SPDX-License-Identifier: Apache-2.0
"""What commands write: nobody's file is replaced unasked, and a full disk leaves nothing behind."""

import json
import os
import resource
import signal
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from studies.fuzz_cases import good_inputs
from tests.test_bad_input import RIG, check_refusal, recording, run

from pneu_common.errors import InputError
from pneu_common.files import whole, write_whole
from pneu_common.outputs import check_folder, check_output, is_result
from pneu_sim.rig import load_rig

__all__ = ["run"]  # a fixture

SIMULATE = ["simulate", "--rig", "rig.yaml", "--steps", "voltage=6:0.02"]
SHORT = ["--trials", "1", "--candidates", "5", "--generations", "1"]
JUDGE = ["evaluate", "pid.yaml", "--rig", "rig.yaml", "--duration", "1", "--skip", "0.3"]
LEARN = ["learn", "good.mcap", "--rig", "rig.yaml", "-o"]
COMPARE = ["compare", "good.mcap", "--rig", "rig.yaml", "--no-refine"]

# Each writes to the file that comes last.
WRITERS = {
    "mine.csv": [*SIMULATE, "-o", "mine.csv"],
    "mine.mcap": [*SIMULATE, "-o", "mine.mcap"],
    "mine.fit.yaml": ["fit", "good.mcap", "--rig", "rig.yaml", "-o", "mine.fit.yaml"],
    "rig.yaml": ["fit", "good.mcap", "--rig", "rig.yaml", "-o", "rig.yaml"],
    "mine.json": [*COMPARE, "--json", "mine.json"],
    "mine.html": [*COMPARE, "--report", "mine.html"],
    "mine.add.yaml": ["add", "leak@tube", "--rig", "rig.yaml", "--bag", "good.mcap", "-o"],
    "mine.pid.yaml": ["tune", "--rig", "rig.yaml", *SHORT, "-o", "mine.pid.yaml"],
    "mine.sealed": ["lab", "seal", "effects.yaml", "mine.sealed"],
    "out/rig.yaml": [*LEARN, "out"],
    "out/report.html": [*LEARN, "out"],
    "out/table.md": [*JUDGE, "-o", "out"],
    "mine.eval.json": [*JUDGE, "-o", "other", "--json", "mine.eval.json"],
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with sound inputs of all kinds."""
    for name, content in good_inputs().items():
        (tmp_path / name).write_bytes(content)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def pneu(folder, monkeypatch):
    from typer.testing import CliRunner

    from pneu_common.cli import build_app

    monkeypatch.delenv("PNEU_TRACEBACK", raising=False)
    return lambda *words: CliRunner().invoke(build_app(), list(words), prog_name="pneu")


@pytest.mark.parametrize("name", list(WRITERS))
def test_a_file_of_somebody_else_stays(pneu, folder, name):
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    if name != "rig.yaml":
        path.write_bytes(b"mine\n")
    before = path.read_bytes()
    words = WRITERS[name] if WRITERS[name][-1] != "-o" else [*WRITERS[name], name]
    listed = sorted(folder.rglob("*"))
    check_refusal(pneu(*words), name, "exists already", "--force")
    assert path.read_bytes() == before
    assert sorted(folder.rglob("*")) == listed


@pytest.mark.parametrize("name", ["mine.csv", "mine.mcap", "mine.json", "mine.sealed", "rig.yaml"])
def test_it_is_replaced_where_that_is_asked_for(pneu, folder, name):
    if name != "rig.yaml":
        (folder / name).write_bytes(b"mine\n")
    before = (folder / name).read_bytes()
    done = pneu(*WRITERS[name], "--force")
    assert done.exit_code == 0, done.output
    assert (folder / name).read_bytes() != before


@pytest.mark.long
def test_results_are_made_anew_without_asking(pneu, folder):
    """JSON, reports, and the folder of `learn`."""
    for words in ([*COMPARE, "--json", "c.json", "--report", "c.html"], [*LEARN, "out"]):
        for _ in range(2):
            done = pneu(*words)
            assert done.exit_code == 0, done.output
    assert is_result(folder / "c.html") and is_result(folder / "out" / "learn.json")


@pytest.mark.long
def test_a_rig_is_not_replaced_by_what_was_learned_from_it(pneu, folder):
    assert pneu(*LEARN, "out").exit_code == 0
    before = (folder / "out" / "rig.yaml").read_bytes()
    refused = pneu("learn", "good.mcap", "--rig", "out/rig.yaml", "-o", "out")
    check_refusal(refused, "out/rig.yaml", "--force")
    assert (folder / "out" / "rig.yaml").read_bytes() == before


def test_a_folder_of_a_bag_is_never_replaced(pneu, folder):
    (folder / "bag").mkdir()
    check_refusal(pneu(*SIMULATE, "-o", "bag", "--force"), "bag", "exists already")


def test_a_device_is_no_output(tmp_path):
    """By another name, so that a device of the machine is not what is lost if this fails."""
    (tmp_path / "link").symlink_to("/dev/null")
    with pytest.raises(InputError, match="link: is a device"):
        check_output(tmp_path / "link", force=True)
    assert (tmp_path / "link").is_symlink()


@pytest.mark.parametrize("name", ["x" * 300 + ".json", "a\0b"])
def test_a_name_that_no_file_can_have(tmp_path, name):
    with pytest.raises(InputError, match="cannot be written"):
        check_output(tmp_path / name)


def test_a_folder_is_ours_by_its_result(tmp_path):
    (tmp_path / "rig.yaml").write_text("mine")
    with pytest.raises(InputError, match=r"rig\.yaml: exists already.*--force"):
        check_folder(tmp_path, "learn.json", ("rig.yaml",))
    check_folder(tmp_path, "learn.json", ("rig.yaml",), force=True)
    check_folder(tmp_path, "learn.json", ("step_*.yaml",))
    (tmp_path / "learn.json").write_text('{\n  "schema": "pneu.learn/1"\n}')
    check_folder(tmp_path, "learn.json", ("rig.yaml",))


# ---- a full disk --------------------------------------------------------------------------------


@contextmanager
def full_disk(most_bytes=100):
    """The kernel refuses to let any file grow, as it does where a disk is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    # Python would keep the first bytes of compiled modules, and fail to load them ever after.
    kept, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        sys.dont_write_bytecode = kept
        signal.signal(signal.SIGXFSZ, ignored)


def write_policy(path):
    from pneu_policy.control.policy_file import PolicyFile

    policy = PolicyFile.load(Path(__file__).parent.parent / "policies" / "short_pde_0.npz")
    return lambda: policy.save(path)


def write_checkpoint(path):
    torch = pytest.importorskip("torch")
    from pneu_policy.learn.checkpoint import save_checkpoint

    return lambda: save_checkpoint({"weights": torch.zeros(1000)}, path)


def write_history(path):
    return lambda: history().save(path)


def history():
    from pneu_policy.learn.history import History

    row = {"iteration": 1, "samples": 1, "eval_score": 1.0, "eval_rmse": 0.1}
    return History("npg", {}, [{**row, "samples": k} for k in range(20)], True)


def write_curves(path):
    from pneu_policy.learn.curves import learning_curves

    return lambda: learning_curves({"one": [history()]}, path)


def write_figure(path):
    from matplotlib.figure import Figure

    from pneu_policy.judge.figures import _save

    figure = Figure()
    figure.subplots().plot([0, 1])
    return lambda: _save(figure, path)


def write_track(path):
    from pneu_policy.judge.metrics import Track
    from pneu_policy.judge.results import save_track

    names = Track.__dataclass_fields__
    noise = np.random.default_rng(1).normal(size=500)
    return lambda: save_track(Track(**dict.fromkeys(names, noise)), path)


def write_a_report(path):
    from pneu_sysid.report import write_report

    result = {"schema": "pneu.compare/1", "pneu_version": "0", "recording": "r", "rigs": ["a"]}
    return lambda: write_report(path, compare={**result, "taps": [], "findings": []})


def write_metadata(path):
    from pneu_graph.bag.metadata import BagMetadata

    def write():
        try:
            BagMetadata().write(path.parent)
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror})") from None

    return write


def write_recording(path):
    from pneu_sysid.records.write import write_bag

    return lambda: write_bag(path, load_rig(RIG), recording(60))


FILES = {
    "policy.npz": write_policy,
    "checkpoint.pt": write_checkpoint,
    "history.json": write_history,
    "curves.png": write_curves,
    "runs.png": write_figure,
    "track.npz": write_track,
    "report.html": write_a_report,
    "metadata.yaml": write_metadata,
    "run.mcap": write_recording,
    "bag": write_recording,
}


@pytest.mark.parametrize("name", list(FILES))
def test_a_full_disk_leaves_what_was_there_and_nothing_else(tmp_path, name):
    path = tmp_path / name
    write = FILES[name](path)
    if name not in ("run.mcap", "bag"):  # a recording goes to a new path
        path.write_text("old")
    with full_disk(), pytest.raises(InputError, match="cannot be written"):
        write()
    if name in ("run.mcap", "bag"):
        assert not list(tmp_path.iterdir())
    else:
        assert path.read_text() == "old"
        assert list(tmp_path.iterdir()) == [path]
    path.unlink(missing_ok=True)
    write()  # and with room it is written
    assert path.exists() and list(tmp_path.iterdir()) == [path]


def test_whatever_goes_wrong_nothing_is_left(tmp_path):
    path = tmp_path / "a"
    with pytest.raises(ZeroDivisionError), whole(path) as aside:
        aside.write_text("half")
        raise ZeroDivisionError
    with pytest.raises(InputError, match="cannot be written"):
        write_whole(tmp_path / ("x" * 300), "new")
    assert not list(tmp_path.iterdir())


def test_a_lab_that_does_not_start_leaves_a_ready_file_alone(pneu, folder):
    """Neither another lab's, nor a file that is none."""
    words = ["lab", "--rig", "rig.yaml", "--registers", "registers.yaml", "--ready-file", "a.json"]
    (folder / "a.json").write_text("mine")
    check_refusal(pneu(*words, "--port", "0", "--control-port", "0"), "a.json", "no ready file")
    assert (folder / "a.json").read_text() == "mine"
    other = json.dumps({"modbus_port": 1, "control_port": 2, "pid": os.getpid()})
    (folder / "a.json").write_text(other)
    import socket

    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        done = pneu(*words, "--port", port, "--control-port", "0", "--allow-slow")
    check_refusal(done, port)
    assert (folder / "a.json").read_text() == other
