# SPDX-License-Identifier: Apache-2.0
"""The example rigs and recordings that come with Pneu: where they lie, and which files they are.

A checkout has them at its top, a wheel puts them below `share/pneu` of the environment; the
`data-files` of `pyproject.toml` say the same as `EXAMPLES`, and a test keeps the two equal.
"""

import importlib.metadata
import sysconfig
from collections.abc import Iterator
from pathlib import Path

EXAMPLES = (
    "LICENSE",
    "rigs/README.md",
    "rigs/*.yaml",
    "rigs/mjcf/*.xml",
    "data/bags/README.md",
    "data/bags/a_healthy_2/*",
    "data/bags/a_leak/*",
)
"""Patterns of the files, relative to the folder that holds them."""


def example_files() -> tuple[Path, list[str]] | None:
    """Finds the examples.

    Returns:
        The folder that holds them and the files' names relative to it; None where this installation
        came without them.
    """
    for folder in _folders():
        found = [sorted(folder.glob(pattern)) for pattern in EXAMPLES]
        if all(found):
            return folder, [p.relative_to(folder).as_posix() for paths in found for p in paths]
    return None


def _folders() -> Iterator[Path]:
    """Where the examples may be, the checkout first."""
    yield Path(__file__).resolve().parents[3]  # <checkout>/src/pneu_sim/pneu_sim/carried.py
    try:
        files = importlib.metadata.files("pneu") or []
    except importlib.metadata.PackageNotFoundError:
        files = []
    for file in files:
        if file.parts[-3:] == ("share", "pneu", "LICENSE"):
            yield Path(str(file.locate())).resolve().parent
    # `pip install --target` keeps `share` beside the packages and tells another place
    for prefix in (sysconfig.get_path("data"), Path(__file__).resolve().parents[1]):
        yield Path(prefix, "share", "pneu")
