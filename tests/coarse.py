# SPDX-License-Identifier: Apache-2.0
"""A rig whose model runs four times as fast, for tests of what is done with it."""

from pathlib import Path


def coarsened(whole: Path, coarse: Path) -> Path:
    """Writes a rig file whose lines have cells of twice the usual length.

    Args:
        whole: A rig file that says nothing of its grid.
        coarse: Where the other is written.

    Returns:
        That place.
    """
    text = whole.read_text(encoding="utf-8")
    assert "\ngrid:" not in text
    coarse.write_text(f"{text}grid: {{dx_m: 0.1}}\n", encoding="utf-8")
    return coarse
