# SPDX-License-Identifier: Apache-2.0
"""Checks of output files and folders: exact refusals, and the marks of results."""

import re
from pathlib import Path

import pytest

from pneu_common.errors import InputError
from pneu_common.outputs import REPORT_MARK, check_folder, check_output, is_result

pytestmark = pytest.mark.kernel_free

MARKS = ['"schema": "pneu.compare/1"', '"pneu_evaluation"', REPORT_MARK]


def refusal(*arguments: object, **options: bool) -> str:
    check = check_output if len(arguments) == 1 else check_folder
    with pytest.raises(InputError) as caught:
        check(*arguments, **options)  # type: ignore[operator]
    return str(caught.value)


@pytest.mark.parametrize("mark", MARKS)
def test_results_have_a_mark_at_their_beginning(tmp_path: Path, mark: str) -> None:
    path = tmp_path / "a"
    assert not is_result(path)
    path.write_text(" " * (2000 - len('"schema": "pneu.')) + '"schema": "pneu.')
    assert is_result(path)
    path.write_text(" " * (2001 - len('"schema": "pneu.')) + '"schema": "pneu.')
    assert not is_result(path)
    path.write_text(f"{{{mark}}}")
    assert is_result(path)
    check_output(path)
    path.write_text(f"{{{mark[1:]}}}")
    assert not is_result(path)
    assert not is_result(tmp_path)  # a folder


def test_an_output_that_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    missing = tmp_path / "no" / "a.json"
    assert refusal(missing) == f"{missing}: folder {missing.parent} does not exist"
    for force in (False, True):
        assert refusal(tmp_path, force=force) == f"{tmp_path}: is a folder, a file is needed"
    said = "/dev/null: is a device or a pipe, a file is needed"
    assert refusal(Path("/dev/null"), force=True) == said
    path.write_text("mine")
    said = f"{path}: exists already and is no result of pneu; --force replaces it"
    assert refusal(path) == refusal(path, force=False) == said
    long = tmp_path / ("x" * 300)
    assert refusal(long) == f"{long}: cannot be written (File name too long)"
    odd = tmp_path / "a\0b"
    assert re.fullmatch(r".*a\0b: cannot be written \(.*null.*\)", refusal(odd))
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"] and path.read_text() == "mine"


def test_an_output_that_is_allowed(tmp_path: Path) -> None:
    """Nothing is left of the attempt to write beside it."""
    check_output(None)
    path = tmp_path / "a.json"
    check_output(path)
    assert not list(tmp_path.iterdir())
    path.write_text("mine")
    check_output(path, force=True)
    assert list(tmp_path.iterdir()) == [path] and path.read_text() == "mine"


def test_a_folder_of_outputs(tmp_path: Path) -> None:
    """Refused where a file of the same name lies there, and not the mark of our results."""
    folder = tmp_path / "out"
    check_folder(folder, "learn.json", ["rig.yaml"])  # there is none yet
    folder.mkdir()
    (folder / "other.txt").write_text("mine")
    names = ["step_*.yaml", "rig.yaml"]
    check_folder(folder, "learn.json", names)

    def told(name: str) -> str:
        return (
            f"{folder / name}: exists already and would be replaced, but {folder} has no learn.json"
            " of pneu; --force replaces it"
        )

    for name in ("rig.yaml", "step_3.yaml", "step_2.yaml", "learn.json"):  # the first is named
        (folder / name).write_text("mine")
        assert refusal(folder, "learn.json", names) == told(name)
        check_folder(folder, "learn.json", names, force=True)
    (folder / "learn.json").write_text('{"schema": "pneu.learn/1"}')
    check_folder(folder, "learn.json", names)
