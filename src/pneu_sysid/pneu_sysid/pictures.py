# SPDX-License-Identifier: Apache-2.0
"""Whether a picture that a command is asked for can be drawn, before the work."""

import importlib.util
from pathlib import Path

from pneu_common.errors import InputError

SUFFIXES = (".png", ".svg", ".pdf")


def check_figure(path: Path | None) -> None:
    """Refuses a picture that cannot be drawn, before the work.

    Args:
        path: The picture; None asks for none.

    Raises:
        InputError: There is no matplotlib, or it is no kind of picture.
    """
    if path is None:
        return
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: found {path.suffix!r}, allowed are {', '.join(SUFFIXES)}")
    if importlib.util.find_spec("matplotlib") is None:
        raise InputError(f"{path}: a figure needs matplotlib, `pip install matplotlib`")
