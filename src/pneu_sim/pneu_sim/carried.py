# SPDX-License-Identifier: Apache-2.0
"""The example rigs and recordings that come with Pneu: where they lie, and which files they are.

The `data-files` of `pyproject.toml` name the same files as `EXAMPLES`; a test keeps the two equal.
"""

from pathlib import Path

from pneu_common.installed import own_tree

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
    """Find the examples.

    Returns:
        The folder that holds them and the files' names relative to it; None where this installation
        came without them.
    """
    folder = own_tree()
    found = [sorted(folder.glob(pattern)) for pattern in EXAMPLES] if folder else []
    if folder is None or not all(found):
        return None
    return folder, [p.relative_to(folder).as_posix() for paths in found for p in paths]
