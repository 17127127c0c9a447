# SPDX-License-Identifier: Apache-2.0
"""Files that are written whole or not at all."""

import os
import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path

from pneu_sim.errors import InputError


def write_whole(path: Path, text: str) -> None:
    """Writes a text aside and gives it its name; what was there before stays until then.

    Args:
        path: The file; its folder must exist.
        text: What it is to hold.

    Raises:
        InputError: It cannot be written. Nothing is left beside it.
    """
    aside = path.with_name(f".{path.name}.part")
    try:
        try:
            aside.write_text(text, encoding="utf-8", newline="")
            os.replace(aside, path)
        except BaseException:
            aside.unlink(missing_ok=True)
            raise
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
    aside: Path | None = None
    try:
        aside = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        whole = aside / "whole"  # with the permissions that new folders have here
        for name in names:
            target = whole / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source / name, target)
        os.rename(whole, folder)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror or error})") from None
    finally:
        if aside is not None:
            shutil.rmtree(aside, ignore_errors=True)
