# SPDX-License-Identifier: Apache-2.0
"""Files are whole or not there, and nothing is left beside them."""

import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from pneu_common.errors import InputError
from pneu_common.files import (
    check_name_is_text,
    copy_whole,
    replacing,
    scratch_beside,
    whole,
    write_whole,
)
from pneu_common.outputs import check_output

pytestmark = pytest.mark.kernel_free


def test_what_was_there_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text("old")
    write_whole(path, "new")
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_text_is_written_as_it_is(tmp_path: Path) -> None:
    write_whole(tmp_path / "a", "α\n\r\nb\r")
    assert (tmp_path / "a").read_bytes() == "α\n\r\nb\r".encode()


def test_a_folder_in_its_place(tmp_path: Path) -> None:
    (tmp_path / "a.json").mkdir()
    with pytest.raises(InputError) as caught:
        write_whole(tmp_path / "a.json", "new")
    assert str(caught.value) == f"{tmp_path / 'a.json'}: cannot be written (Is a directory)"
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def asides(folder: Path) -> list[Path]:
    return sorted(folder.glob(".*.part"))


def test_it_is_written_aside(tmp_path: Path) -> None:
    """What a process that was killed has left is gone; the file stays as it was until the end."""
    path = tmp_path / "a.json"
    path.write_text("old")
    code = "import sys; from pathlib import Path; from pneu_common.files import new_beside;"
    code += "new_beside(Path(sys.argv[1])).write_text('killed')"
    subprocess.run([sys.executable, "-c", code, str(path)], check=True)
    (killed,) = asides(tmp_path)
    others = [tmp_path / ".pneu-0-1-2.part", killed.with_name(killed.name.replace("pneu", "own"))]
    for other in others:
        other.write_text("of another machine, or of nobody we know")
    with replacing(path) as aside:
        assert asides(tmp_path) == sorted([aside, *others])
        assert aside.stat().st_mode == path.stat().st_mode
        aside.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new" and asides(tmp_path) == sorted(others)


@pytest.mark.parametrize("written", [False, True])
def test_what_fails_leaves_nothing_aside(tmp_path: Path, written: bool) -> None:
    path = tmp_path / "a.json"
    path.write_text("old")
    for cause, keeper in ((OSError("odd"), replacing), (KeyError("x"), replacing),
                          (KeyError("x"), whole)):  # fmt: skip
        with pytest.raises(type(cause)) as caught, keeper(path) as aside:
            if written:
                aside.write_text("half")
            raise cause
        assert caught.value is cause
        assert path.read_text() == "old" and not asides(tmp_path)
    for cause, reason in ((OSError("odd"), "odd"), (OSError(28, "No space left"), "No space left")):
        with pytest.raises(InputError) as refused, whole(path):
            raise cause
        assert str(refused.value) == f"{path}: cannot be written ({reason})"


def test_two_writers_of_one_file_do_not_share_what_they_write_aside(tmp_path: Path) -> None:
    """Nor does a command that only looks whether it may write there disturb one that writes."""
    path = tmp_path / "a.json"
    with replacing(path) as first, replacing(path) as second:
        first.write_text("the first, complete")
        held = second.open("w")
        held.write("the sec")
        held.flush()
        check_output(path, force=True)
        with replacing(path) as third:
            third.write_text("the third")
        assert path.read_text() == "the third"
        held.write("ond, complete")
        held.close()
    assert path.read_text() == "the first, complete" and not asides(tmp_path)


def test_names_that_are_text() -> None:
    check_name_is_text("café/a.yaml", "metadata.yaml")
    with pytest.raises(InputError) as caught:
        check_name_is_text("caf\udce9", "metadata.yaml")
    assert str(caught.value) == (
        "caf\udce9: the name holds bytes that are no text, which metadata.yaml cannot hold; give"
        " another name"
    )


def test_a_folder_to_work_in(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with pytest.raises(KeyError), scratch_beside(path) as aside:
        assert aside.parent == tmp_path and aside.name.startswith(".bag.")
        (aside / "a").write_text("a")
        raise KeyError
    assert not list(tmp_path.iterdir())
    with scratch_beside(path) as aside:
        (aside / "a").write_text("a")
        (aside / "a").rename(path)
    assert list(tmp_path.iterdir()) == [path]
    with scratch_beside(path) as aside:
        aside.rename(tmp_path / "bags")
    (tmp_path / "bags").rmdir()
    for place, cause, reason in (
        (tmp_path / "no" / "bag", None, "No such file or directory"),
        (path, OSError("odd"), "odd"),
    ):
        with pytest.raises(InputError) as caught, scratch_beside(place):
            raise cause or AssertionError
        assert str(caught.value) == f"{place}: cannot be written ({reason})"
    assert list(tmp_path.iterdir()) == [path]


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
    (tmp_path / "new").mkdir()  # and can be read by whoever can read new folders
    assert (tmp_path / "copy").stat().st_mode == (tmp_path / "new").stat().st_mode


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
