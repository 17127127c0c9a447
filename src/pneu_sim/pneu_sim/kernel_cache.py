# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels on disk: one folder for each version of everything that machine code depends on.

The name of the folder is a digest of the sources of the kernels, the versions of Python, Numba,
LLVM and NumPy, and the processor. Where the sources are stored does not matter, so a checkout and
an installed copy can share a folder. A folder that cannot be written, as in the image of a
container, is read all the same.
"""

import contextlib
import functools
import hashlib
import os
import pickle
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from logging import getLogger
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite
import llvmlite.binding
import numba
import numpy as np
from numba.core import config as numba_config
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile

from pneu_common.log import LOG

FOLDER = "pneu-kernels-"
"""Name of a folder, before its digest."""
MOST_VERSIONS = 6
"""Folders beside each other; older ones are removed unless they were used within an hour."""
SPARED_S = 3600.0

_PACKAGE = Path(__file__).parent
_NEED = "from pneu_sim.compiling import"


@functools.cache
def digest_of_sources() -> str:
    """Digest of every file with kernels, and of those whose constants they may hold."""
    texts = {path: path.read_text(encoding="utf-8") for path in _PACKAGE.rglob("*.py")}
    digest = hashlib.sha256()
    told = {path for path, text in texts.items() if _NEED in text}
    for path in list(told):
        for module in re.findall(r"^from pneu_sim\.?([\w.]*) import (.+)", texts[path], re.M):
            parts = module[0].split(".") if module[0] else [module[1].split()[0]]
            told.add(_PACKAGE.joinpath(*parts).with_suffix(".py"))
    for path in sorted(told & texts.keys()):
        digest.update(texts[path].encode())
    return digest.hexdigest()


class Places(NamedTuple):
    """Folders of compiled kernels.

    Attributes:
        read: Folders in which kernels are looked for, `written` among them; none need exist.
        written: Folder in which new ones are kept; None where none can be written.
        faults: Why those before it cannot be written, as a list in words.
    """

    read: tuple[Path, ...]
    written: Path | None
    faults: str


@functools.cache
def places() -> Places:
    """Return the folders for this process; the one that is written is the last that is read.

    They are in NUMBA_CACHE_DIR where that is set, in the user's cache, and beside the sources:
    there first in a checkout, and last in an installation, whose removal would leave them.
    """
    code = (sys.implementation.cache_tag, numba.__version__, llvmlite.__version__, np.__version__)
    machine = (llvmlite.binding.get_host_cpu_name(), _features())
    told = repr((digest_of_sources(), code, sys.platform, machine))
    name = FOLDER + hashlib.sha256(told.encode()).hexdigest()[:16]
    config: Any = numba_config  # its types know none of its settings
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    parents = [_PACKAGE / "__pycache__"]
    if os.path.isabs(home):
        parents.insert(len(parents) if in_checkout() else 0, Path(home, "pneu"))
    if config.CACHE_DIR:
        parents.insert(0, Path(config.CACHE_DIR))
    faults = []
    for parent in parents:
        folder = parent / name
        try:
            is_new = not folder.is_dir()
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
            os.utime(folder)  # for what is removed first
        except OSError as error:
            faults.append(f"{parent} ({error.strerror})")
            continue
        if is_new:
            _remove_old(parent)
        # A folder that was asked for is the only one; else those of an image are read as well.
        asked_for = bool(config.CACHE_DIR) and parent == parents[0]
        others = [one / name for one in parents if one != parent and (one / name).is_dir()]
        others = [] if asked_for else others
        return Places((*others, folder), folder, ", ".join(faults))
    return Places(tuple(parent / name for parent in parents), None, ", ".join(faults))


def in_checkout() -> bool:
    """Return whether the sources are those of a checkout, and not of an installation."""
    return _PACKAGE.parents[1].name == "src"


def _features() -> list[str]:
    found = llvmlite.binding.get_host_cpu_features()
    return sorted(name for name, there in found.items() if there)


def _remove_old(parent: Path) -> None:
    """Removes the folders of versions that were not used for longest."""
    used = []
    for folder in parent.glob(f"{FOLDER}*"):
        with contextlib.suppress(OSError):  # another process removes it
            used.append((folder.stat().st_mtime, folder))
    for when, folder in sorted(used)[:-MOST_VERSIONS]:
        if time.time() - when > SPARED_S:
            shutil.rmtree(folder, ignore_errors=True)


@functools.cache
def _tell_not_kept(where: Path, why: str) -> None:
    getLogger(LOG).warning(f"compiled kernels cannot be kept in {where} ({why})")


class _Locator:
    """What Numba asks of the place of a cache."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._py_file = function.__code__.co_filename

    def ensure_cache_path(self) -> None:
        """Makes the folder, which another process may have removed."""
        written = places().written
        assert written is not None
        written.mkdir(parents=True, exist_ok=True)


class _Entry(CompileResultCacheImpl):
    """Name of a kernel's files, and what of a kernel is stored, which is up to Numba."""

    def __init__(self, function: Callable[..., Any], variant: str) -> None:
        # Numba's own constructor looks for a folder, and raises an exception where it finds none.
        path, line = Path(function.__code__.co_filename), function.__code__.co_firstlineno
        if path.is_relative_to(_PACKAGE):
            self.stamp, module = "", ".".join(path.relative_to(_PACKAGE).with_suffix("").parts)
        else:  # of another package, which the digest of our sources does not cover
            self.stamp = hashlib.sha256(path.read_bytes()).hexdigest()
            place = hashlib.sha256(os.fsencode(path.absolute())).hexdigest()
            module = f"{path.stem}-{place[:8]}"
        self._locator, self._lineno = _Locator(function), line
        name = function.__qualname__.replace("<", "").replace(">", "")
        self._filename_base = f"{module}.{name}-{line}{variant}"


class KernelCache(FunctionCache):
    """The cache of one kernel. A folder that cannot be used is as one without kernels."""

    def __init__(self, function: Callable[..., Any], variant: str) -> None:
        """Finds its files.

        Args:
            function: The kernel, of a file that exists.
            variant: What its files are named after besides, where it is compiled in two ways.
        """
        self._name, self._py_func = repr(function), function
        self._impl = entry = _Entry(function, variant)
        self._files = [
            IndexDataCacheFile(str(folder), entry.filename_base, entry.stamp)
            for folder in places().read
        ]
        self._cache_file, self._cache_path = self._files[-1], str(places().read[-1])
        self.enable()

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Loads a kernel.

        Args:
            sig: Its signature.
            target_context: Of the processor.

        Returns:
            What was compiled; None where it is in none of the folders.
        """
        try:
            for file in self._files:
                self._cache_file = file
                with contextlib.suppress(OSError, EOFError, pickle.UnpicklingError):
                    found = super().load_overload(sig, target_context)
                    if found is not None:
                        return found
        finally:
            self._cache_file = self._files[-1]
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keeps a kernel, where that is possible.

        Args:
            sig: Its signature.
            data: What was compiled.
        """
        written = places().written
        if written is not None:
            try:
                try:
                    super().save_overload(sig, data)
                except (EOFError, pickle.UnpicklingError):  # a damaged index
                    self._cache_file.flush()
                    super().save_overload(sig, data)
            except OSError as error:
                _tell_not_kept(written, error.strerror or str(error))
