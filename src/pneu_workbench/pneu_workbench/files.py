# SPDX-License-Identifier: Apache-2.0
"""Recordings and rig files in the chosen folder, and what is dropped onto the page.

Nothing outside the folder is read or named: a path is followed to where it truly leads first.
"""

import re
from collections.abc import Iterator
from pathlib import Path

from pneu_common.errors import InputError

DEEPEST = 5
"""Folders below the chosen one that are looked into."""
MOST = 500
"""Files of a kind that are offered."""
RECORDINGS = (".mcap", ".csv")
RIGS = (".yaml", ".yml")
HEAD = "pneu_rig"
"""Key that a rig file begins with, after its comments."""
LARGEST = 4 * 1024**3
"""Bytes of a file that is dropped."""
LEFT_OUT = {"node_modules", "__pycache__", "build", "install", "log"}


class Folder:
    """The chosen folder."""

    def __init__(self, root: Path) -> None:
        """Chooses it.

        Args:
            root: The folder.

        Raises:
            InputError: It is none.
        """
        self.root = root.resolve()
        if not self.root.is_dir():
            raise InputError(f"{root}: is no folder, one with recordings is needed")

    def path(self, name: str) -> Path:
        """A path within the folder.

        Args:
            name: Its name from there.

        Raises:
            InputError: It leads out of the folder, or there is nothing.
        """
        if "\0" in name:
            raise InputError("path: found a zero byte, a name has none")
        path = (self.root / name).resolve()
        if not path.is_relative_to(self.root):
            raise InputError(f"path: found {name!r}, which leads out of {self.root}")
        if not path.exists():
            raise InputError(f"path: found {name!r}, there is no such file in {self.root}")
        return path

    def recordings(self) -> list[str]:
        """Names of recordings: bags, and files that may be some."""
        found = []
        for path in self._below(self.root, 0):
            if path.is_dir():
                if (path / "metadata.yaml").is_file():
                    found.append(path)
            elif path.suffix.lower() in RECORDINGS and not (path.parent / "metadata.yaml").exists():
                found.append(path)
        return self._named(found)

    def rigs(self) -> list[str]:
        """Names of rig files."""
        files = (p for p in self._below(self.root, 0) if p.suffix.lower() in RIGS and p.is_file())
        return self._named([p for p in files if _is_rig(p)])

    def _named(self, paths: list[Path]) -> list[str]:
        return sorted(str(p.relative_to(self.root)) for p in paths)[:MOST]

    def _below(self, folder: Path, depth: int) -> Iterator[Path]:
        try:
            entries = sorted(folder.iterdir())
        except OSError:
            return
        for path in entries:
            if path.name.startswith(".") or path.name in LEFT_OUT or path.is_symlink():
                continue
            yield path
            if path.is_dir() and depth < DEEPEST:
                yield from self._below(path, depth + 1)


def _is_rig(path: Path) -> bool:
    try:
        with path.open(encoding="utf-8") as file:
            for line in file:
                word = line.partition(":")[0].strip()
                if word and not word.startswith(("#", "---", "%")):
                    return word == HEAD
    except (OSError, UnicodeDecodeError):
        pass
    return False


def dropped_name(given: str, size: int = 0) -> str:
    """A name under which a dropped file is kept.

    Args:
        given: What the browser says it is called.
        size: Bytes of it.

    Raises:
        InputError: It is no recording by its ending, or is too large.
    """
    if size > LARGEST:
        raise InputError(f"file: found {size / 1024**3:.1f} GiB, allowed are {LARGEST >> 30} GiB")
    name = re.sub(r"[^A-Za-z0-9._-]", "_", re.split(r"[/\\]", given)[-1]).lstrip(".")[-120:]
    if not name.lower().endswith(RECORDINGS) or name.lower() in RECORDINGS:
        raise InputError(f"file: found {given!r}, allowed are {', '.join(RECORDINGS)}")
    return name
