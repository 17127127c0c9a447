# SPDX-License-Identifier: Apache-2.0
"""A rig whose model runs several times as fast, for tests of what is done with it."""

from pathlib import Path


def coarsened(whole: Path, coarse: Path, *, dx_m: float = 0.1, memory: bool = True) -> Path:
    """Writes a rig file whose lines have longer cells, by default twice the usual length.

    Args:
        whole: A rig file that says nothing of its grid.
        coarse: Where the other is written.
        dx_m: Length of a cell, m; the usual length is 0.05.
        memory: Whether wall friction and heat depend on frequency.

    Returns:
        That place.
    """
    text = whole.read_text(encoding="utf-8")
    assert "\ngrid:" not in text
    grid = f"grid: {{dx_m: {dx_m}, memory: {str(memory).lower()}}}\n"
    coarse.write_text(f"{text}{grid}", encoding="utf-8")
    return coarse
