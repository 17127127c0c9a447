# SPDX-License-Identifier: Apache-2.0
"""Files are whole or not there, and nothing is left beside them."""

import resource
import signal
from pathlib import Path

import pytest

from pneu_common.errors import InputError
from pneu_common.files import copy_whole, write_whole

pytestmark = pytest.mark.kernel_free


def test_what_was_there_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text("old")
    write_whole(path, "new")
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_in_its_place(tmp_path: Path) -> None:
    (tmp_path / "a.json").mkdir()
    with pytest.raises(InputError, match=r"a\.json: cannot be written"):
        write_whole(tmp_path / "a.json", "new")
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_no_room_for_it(tmp_path: Path) -> None:
    """The kernel refuses to let a file grow, as it does where a disk is full."""
    path = tmp_path / "a.json"
    path.write_text("old")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
        with pytest.raises(InputError, match="cannot be written"):
            write_whole(path, "new" * 1000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_is_copied(tmp_path: Path) -> None:
    source = tmp_path / "source"
    (source / "deep" / "er").mkdir(parents=True)
    for name in ("a", "deep/er/b", "deep/not"):
        (source / name).write_text(name)
    copy_whole(source, ["a", "deep/er/b"], tmp_path / "copy")
    copied = {p.relative_to(tmp_path / "copy").as_posix() for p in (tmp_path / "copy").rglob("*")}
    assert copied == {"a", "deep", "deep/er", "deep/er/b"}
    assert (tmp_path / "copy" / "deep" / "er" / "b").read_text() == "deep/er/b"
    assert {p.name for p in tmp_path.iterdir()} == {"source", "copy"}


def test_a_folder_that_cannot_be_copied_whole(tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    (source / "a").write_text("a")
    with pytest.raises(InputError, match=r"copy: cannot be written \(No such file"):
        copy_whole(source, ["a", "gone"], tmp_path / "copy")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").write_text("mine")
    with pytest.raises(InputError, match="full: cannot be written"):
        copy_whole(source, ["a"], tmp_path / "full")
    assert {p.name for p in tmp_path.iterdir()} == {"source", "full"}
    assert [p.name for p in (tmp_path / "full").iterdir()] == ["mine"]
