# SPDX-License-Identifier: Apache-2.0
"""Files that are written whole or not at all."""

import contextlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pneu_sim.errors import InputError


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
    aside = path.with_name(f".{path.name}.part")
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
        aside.write_text(text, encoding="utf-8", newline="")
