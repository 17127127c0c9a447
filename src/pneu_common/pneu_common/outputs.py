# SPDX-License-Identifier: Apache-2.0
"""What a command may write to: nothing that is not its own is replaced unasked.

A file that exists is replaced only where it is a result that `pneu` made: a JSON result, a report,
or what lies beside one in the folder of results. Everything else, a rig file above all, may hold
somebody's work; ``--force`` replaces it all the same.
"""

import contextlib
import os
from collections.abc import Sequence
from pathlib import Path

from pneu_common.errors import InputError
from pneu_common.files import new_beside

REPORT_MARK = '<meta name="generator" content="pneu">'
"""What a report of ours has in its head."""

_MARKS = (b'"schema": "pneu.', b'"pneu_evaluation"', REPORT_MARK.encode())
_MARKED_BYTES = 2000


def check_output(path: Path | None, force: bool = False) -> None:
    """Refuses an output that cannot be written or is not ours, before the work rather than after.

    Args:
        path: The file; None asks for none.
        force: Whether a file that exists may be replaced, whatever it is.

    Raises:
        InputError: Its folder is missing or locked, or it exists and is not to be replaced.
    """
    if path is None:
        return
    folder = path.parent
    try:
        if not folder.is_dir():
            raise InputError(f"{path}: folder {folder} does not exist")
        if path.is_dir():
            raise InputError(f"{path}: is a folder, a file is needed")
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is a device or a pipe, a file is needed")
        if path.exists() and not force and not is_result(path):
            raise InputError(
                f"{path}: exists already and is no result of pneu; --force replaces it"
            )
        with contextlib.suppress(FileNotFoundError):
            os.lstat(path)  # raises where no file can have the name
        new_beside(path).unlink()
    except (OSError, ValueError) as error:  # also a name that no file can have
        if isinstance(error, InputError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be written ({reason})") from None


def check_folder(folder: Path, mark: str, others: Sequence[str], force: bool = False) -> None:
    """Refuses an output folder in which files of somebody else would be replaced.

    Args:
        folder: The folder; it need not exist.
        mark: Name of the result that tells a folder of ours.
        others: Names, or patterns of names, of what is written beside it.
        force: Whether files that exist may be replaced, whatever they are.

    Raises:
        InputError: A file would be replaced, and the result that should lie beside it does not.
    """
    if force or is_result(folder / mark):
        return
    there = [path for name in (mark, *others) for path in sorted(folder.glob(name))]
    if there:
        raise InputError(
            f"{there[0]}: exists already and would be replaced, but {folder} has no {mark} of pneu;"
            " --force replaces it"
        )


def is_result(path: Path) -> bool:
    """Whether a file is a JSON result or a report that `pneu` wrote.

    Args:
        path: The file.
    """
    try:
        with path.open("rb") as stream:
            begin = stream.read(_MARKED_BYTES)
    except OSError:
        return False
    return any(mark in begin for mark in _MARKS)
