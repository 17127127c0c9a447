# SPDX-License-Identifier: Apache-2.0
"""An installation, a home and a working directory that cannot be written, even by root."""

import ctypes
import os
import shutil
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
_PR_CAPBSET_DROP = 24
_DAC_OVERRIDE = 1


def bound_by_permissions() -> None:
    """To be called in a child before its program: permission bits hold for root, too."""
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(_PR_CAPBSET_DROP, _DAC_OVERRIDE, 0, 0, 0)


def installation(folder: Path, *packages: str) -> Path:
    """Copies packages into a folder, without anything compiled.

    Args:
        folder: The folder, which is made.
        packages: Their names; none: all.
    """
    folder.mkdir()
    for source in (ROOT / "src").glob("*/pneu_*/__init__.py"):
        name = source.parent.name
        if not packages or name in packages:
            ignore = shutil.ignore_patterns("__pycache__")
            shutil.copytree(source.parent, folder / name, ignore=ignore)
    return folder


def lock(folder: Path) -> None:
    """Takes the permission to write from a folder and all that it holds."""
    for path in (folder, *folder.rglob("*")):
        path.chmod(path.stat().st_mode & ~0o222)


def unlock(folder: Path) -> None:
    """Gives it back to the owner, so that the folder can be removed."""
    for path in (folder, *folder.rglob("*")):
        path.chmod(path.stat().st_mode | 0o200)


def environment(installed: Path, home: Path) -> dict[str, str]:
    """Returns the environment variables of a process that runs the copy.

    Args:
        installed: Folder of packages.
        home: Home directory.
    """
    unset = ("NUMBA_CACHE_DIR", "MPLCONFIGDIR", "XDG_", "ROS_", "PNEU_")
    kept = {name: value for name, value in os.environ.items() if not name.startswith(unset)}
    return {**kept, "PYTHONPATH": str(installed), "HOME": str(home)}
