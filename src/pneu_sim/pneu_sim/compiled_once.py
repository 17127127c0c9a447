# SPDX-License-Identifier: Apache-2.0
"""Of processes that need the same kernel at the same time one compiles it, the others wait for it.

A graph is several processes that start together: on a new machine each would else compile all of
what they share, on few cores one in the way of the other.
"""

import functools
import gc
import logging
import os
import sys
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numba.core.compiler_lock import global_compiler_lock

from pneu_common.log import LOG

if sys.platform != "win32":  # there each compiles for itself
    import fcntl

KERNELS = 1 << 30
"""Places in a lock file, one for each kernel by its name; two on one place wait for each other."""


def compiles_once(kernel: Any) -> Any:
    """A kernel that is compiled while no other process compiles it.

    Kernels call one another in no circle, so none waits for one that waits for it.

    Args:
        kernel: Dispatcher with a cache on disk.
    """
    alone: Callable[[Any], Any] = kernel.compile

    def compile_once(signature: Any) -> Any:
        # the compiler first: or one thread here had the kernel and another the compiler
        with global_compiler_lock, held(kernel), _nothing_collected():
            return alone(signature)

    kernel.compile = compile_once
    return kernel


@contextmanager
def _nothing_collected() -> Iterator[None]:
    """Suspends the garbage collector, which takes a tenth of the compile time and finds nothing."""
    if not gc.isenabled():  # also of a kernel that is compiled for another
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


@contextmanager
def held(kernel: Any) -> Iterator[None]:
    """Keeps other processes from compiling a kernel; not where there is no file to lock.

    Args:
        kernel: Dispatcher with a cache on disk.
    """
    file = _lock_file(Path(kernel._cache.cache_path))
    place = zlib.crc32(kernel._cache._impl.filename_base.encode()) % KERNELS
    if file is None or not _locked(file, place):
        yield
        return
    try:
        yield
    finally:
        fcntl.lockf(file, fcntl.LOCK_UN, 1, place)


def _locked(file: int, place: int) -> bool:
    """Whether a place is this process's now, after the others that had it."""
    try:
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, place)
        except (BlockingIOError, PermissionError):  # another process has it
            _tell()
            fcntl.lockf(file, fcntl.LOCK_EX, 1, place)
    except OSError:  # of a disk without locks
        return False
    return True


@functools.cache
def _tell() -> None:
    logging.getLogger(LOG).info("another process compiles the numerical kernels; waiting for it")


@functools.cache
def _lock_file(folder: Path) -> int | None:
    """Descriptor of a folder's lock file, kept open: whatever is closed gives up all its places."""
    if sys.platform == "win32":
        return None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return os.open(folder / "compiling.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError:
        return None
