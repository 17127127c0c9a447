# SPDX-License-Identifier: Apache-2.0
"""`pneu workbench`: which session, folder and port it opens, and what it refuses."""

import importlib.util
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from pneu_common.errors import InputError
from pneu_workbench import command, packed
from pneu_workbench.work import Work

Served = list[tuple[Work, Path, int | None]]


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Served:
    """What a server would be given; none is started, and NiceGUI need not be there."""
    asked: Served = []
    server = SimpleNamespace(serve=lambda work, folder, port, _: asked.append((work, folder, port)))
    monkeypatch.setitem(sys.modules, "pneu_workbench.server", server)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: name == "nicegui" or None)
    monkeypatch.chdir(tmp_path)
    return asked


def run(*words: object) -> Any:
    app = typer.Typer()
    command.register(app)
    app.command("other")(lambda: None)  # with one command alone its name is left out
    return CliRunner().invoke(app, ["workbench", *map(str, words)])


def test_without_words_it_opens_a_session_named_by_the_time(served: Served, tmp_path: Path) -> None:
    assert run().exit_code == 0
    ((work, folder, port),) = served
    assert work.folder.parent == tmp_path / "out" / "workbench" and work.folder.is_dir()
    assert re.fullmatch(r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d", work.folder.name)
    assert (folder, port, work._workers, work.bags) == (Path(), None, 0, [])


def test_it_opens_what_it_is_told(
    served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[Any] = []
    monkeypatch.setattr(Work, "open", lambda self, bags, rig: opened.append((bags, rig)))
    for name in ("a.mcap", "b.mcap", "rig.yaml"):
        (tmp_path / name).write_text("")
    words = ["a.mcap", "b.mcap", "--rig", "rig.yaml", "--session", "here", "--folder", "data"]
    assert run(*words, "--port", 65535, "--workers", 3).exit_code == 0
    ((work, folder, port),) = served
    assert (work.folder, folder, port) == (tmp_path / "here", Path("data"), 65535)
    assert work._workers == 3
    bags = [str(tmp_path / "a.mcap"), str(tmp_path / "b.mcap")]
    assert opened == [(bags, str(tmp_path / "rig.yaml"))]


def test_a_file_that_was_kept_is_unpacked_beside_it(
    served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    unpacked: list[Any] = []
    monkeypatch.setattr(packed, "unpack", lambda *paths: unpacked.append(paths))
    assert run("--session", "kept.zip").exit_code == 0
    assert unpacked == [(Path("kept.zip"), Path("kept"))]
    assert served[0][0].folder == tmp_path / "kept"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["a.mcap"], "--rig: a recording and a rig file are opened together, found one of them"),
        (
            ["--rig", "r"],
            "--rig: a recording and a rig file are opened together, found one of them",
        ),
        (["a.mcap", "--rig", "no.yaml"], "no.yaml: there is no such file"),
        (["a.mcap", "no.mcap", "--rig", "r"], "no.mcap: there is no such file"),
        (["--session", "r"], "r: cannot be made a folder (File exists)"),
    ],
)
def test_what_cannot_be_opened_is_said(
    served: Served, tmp_path: Path, words: list[str], says: str
) -> None:
    for name in ("a.mcap", "r"):
        (tmp_path / name).write_text("")
    result = run(*words)
    assert isinstance(result.exception, InputError) and str(result.exception) == says
    assert not served and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["--port", "0"], 2),
        (["--port", "1"], 0),
        (["--port", "65536"], 2),
        (["--workers", "-1"], 2),
        (["--workers", "0"], 0),
    ],
)
def test_limits_of_numbers(served: Served, words: list[str], code: int) -> None:
    assert run(*words).exit_code == code
    assert len(served) == (code == 0)


def test_without_nicegui_it_says_what_to_install(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    result = run()
    assert isinstance(result.exception, InputError) and not served
    assert str(result.exception) == (
        "the workbench needs NiceGUI, which is not installed: `pip install '.[workbench]'` in a"
        " checkout of pneu, or 'FILE.whl[workbench]' for a wheel of it"
    )
