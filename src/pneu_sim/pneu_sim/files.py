# SPDX-License-Identifier: Apache-2.0
"""Files that are written whole or not at all."""

import os
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
