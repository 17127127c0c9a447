# SPDX-License-Identifier: Apache-2.0
"""Files that are written whole or not at all."""

import contextlib
import hashlib
import os
import platform
import secrets
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from pneu_common.errors import InputError


def _mark() -> str:
    """Return what the names of files begin with that processes of this machine write aside."""
    return f".pneu-{hashlib.sha256(platform.node().encode()).hexdigest()[:8]}-"


def new_beside(path: Path) -> Path:
    """Make an empty file beside another, which no other writer has or gets.

    Args:
        path: The other file; its folder must exist.

    Raises:
        OSError: It cannot be made.
    """
    while True:
        aside = path.with_name(f"{_mark()}{os.getpid()}-{secrets.token_hex(6)}.part")
        with contextlib.suppress(FileExistsError):
            os.close(os.open(aside, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
            return aside


def remove_abandoned(folder: Path) -> None:
    """Remove what processes of this machine wrote aside in a folder and were killed over.

    Args:
        folder: The folder.
    """
    mark = _mark()
    for left in folder.glob(f"{mark}*.part"):
        process = left.name[len(mark) :].partition("-")[0]
        try:
            os.kill(int(process), 0)
        except ProcessLookupError:
            with contextlib.suppress(OSError):
                left.unlink()
        except (OSError, OverflowError, ValueError):
            continue


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Gives a file beside another to write to, as `whole` does, but leaves an OSError as it is.

    Args:
        path: The file; its folder must exist.

    Yields:
        The file to write to.

    Raises:
        OSError: It cannot be written.
    """
    remove_abandoned(path.parent)
    aside = new_beside(path)
    try:
        yield aside
        os.replace(aside, path)
    except BaseException:
        with contextlib.suppress(OSError):
            aside.unlink()
        raise


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Gives a file beside another to write to; at the end it takes the other's name.

    What was there before stays until then. Where the writing fails nothing is left beside it.

    Args:
        path: The file; its folder must exist.

    Yields:
        The file to write to.

    Raises:
        InputError: It cannot be written.
    """
    try:
        with replacing(path) as aside:
            yield aside
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from None


def write_whole(path: Path, text: str) -> None:
    """Writes a text aside and gives it its name; what was there before stays until then.

    Args:
        path: The file; its folder must exist.
        text: What it is to hold.

    Raises:
        InputError: It cannot be written. Nothing is left beside it.
    """
    with whole(path) as aside:
        # Names of files may hold bytes that are no text; they are written as escapes.
        aside.write_text(text, encoding="utf-8", errors="backslashreplace", newline="")


def check_name_is_text(name: str, holder: str) -> None:
    """Refuse the name of a file where what is to hold it can hold text alone.

    Args:
        name: The name, or the whole path.
        holder: What is to hold it, for the message.

    Raises:
        InputError: The name holds bytes that are no text.
    """
    try:
        name.encode()
    except UnicodeEncodeError:
        raise InputError(
            f"{name}: the name holds bytes that are no text, which {holder} cannot hold;"
            " give another name"
        ) from None


@contextmanager
def scratch_beside(path: Path) -> Iterator[Path]:
    """Gives a new folder beside a path, in which to make what is then renamed to it.

    Args:
        path: The path; its folder must exist.

    Yields:
        The folder, which is gone at the end.

    Raises:
        InputError: The path cannot be written.
    """
    try:
        aside = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
        try:
            yield aside
        finally:
            shutil.rmtree(aside, ignore_errors=True)  # it may have got another name
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from None


def copy_whole(source: Path, names: Iterable[str], folder: Path) -> None:
    """Copies files into a new folder, made aside and given its name when all are there.

    Args:
        source: The folder that they are in.
        names: Their names relative to it, which they keep.
        folder: The new folder; the one that is to hold it must exist.

    Raises:
        InputError: It cannot be written. Nothing is left beside it.
    """
    with scratch_beside(folder) as aside:
        inside = aside / "whole"  # with the permissions that new folders have here
        for name in names:
            target = inside / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source / name, target)
        os.rename(inside, folder)
