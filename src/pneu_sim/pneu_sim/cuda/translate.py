# SPDX-License-Identifier: Apache-2.0
"""Device functions from the passes that the processor runs: the same code objects, other callees.

A pass over slots (one that goes through `pneu_sim.compiling.each`) is done by all threads of a
block, each its share; one over ends (`apart`) by one thread of each warp; any other by the first
thread alone, for one rig has few valves and chambers. Before and after what several threads do all
meet. Sequences of passes are run through by all threads alike.
"""

import dis
from collections.abc import Callable
from types import CodeType, FunctionType
from typing import Any

import numba.core.config
import numba.cuda
import numpy as np
from numba.core.dispatcher import Dispatcher

from pneu_sim.kernel.encoders import read_encoders
from pneu_sim.kernel.recording import read

Function = Callable[..., Any]
KEEPING = np.float32(1e-12)
"""What stands for constants that are too small for single precision."""
cuda: Any = numba.cuda  # its types say nothing of what kernels see
config: Any = numba.core.config
WARP = 1 if config.ENABLE_CUDASIM else 32
ANSWERING = (read, read_encoders)
"""Passes whose answer decides which passes follow: all threads are told it."""


@cuda.jit(device=True)
def _share(n):  # type: ignore[no-untyped-def]
    """Every thread's own of ``n``."""
    return range(cuda.threadIdx.x, n, cuda.blockDim.x)


@cuda.jit(device=True)
def _warps_share(n):  # type: ignore[no-untyped-def]
    """Every warp's own of ``n``, for its first thread."""
    first = cuda.threadIdx.x // WARP if cuda.threadIdx.x % WARP == 0 else n
    return range(first, n, cuda.blockDim.x // WARP)


SHARES = {"each": _share, "apart": _warps_share}
"""What stands for the ways in which passes go through something, by their names."""


def _by_all(function: Function) -> Function:
    """A pass over slots: all threads do it, and meet."""

    @cuda.jit(device=True)
    def meeting(*args):  # type: ignore[no-untyped-def]
        cuda.syncthreads()
        function(*args)
        cuda.syncthreads()

    return meeting


def _by_one(function: Function) -> Function:
    """A pass that one thread does; the others go on to where they meet next."""

    @cuda.jit(device=True)
    def alone(*args):  # type: ignore[no-untyped-def]
        if cuda.threadIdx.x == 0:
            function(*args)

    return alone


def _told_by_one(function: Function) -> Function:
    """A pass that one thread does, and tells the others its answer."""

    @cuda.jit(device=True)
    def telling(*args):  # type: ignore[no-untyped-def]
        told = cuda.shared.array(1, np.int32)
        if cuda.threadIdx.x == 0:
            told[0] = 1 if function(*args) else 0
        cuda.syncthreads()
        answer = told[0] != 0
        cuda.syncthreads()
        return answer

    return telling


class Translation:
    """Device functions, each made once.

    Attributes:
        single: Whether numbers in them are single precision.
    """

    def __init__(self, single: bool) -> None:
        """Knows no function yet.

        Args:
            single: Whether numbers in them are single precision.
        """
        self.single = single
        self._made: dict[Any, Function] = {}
        self._staged: dict[Any, Function] = {}

    def device(self, kernel: Any) -> Function:
        """The device function of a compiled one.

        Args:
            kernel: What `pneu_sim.compiling` made.
        """
        if kernel not in self._made:
            own = kernel.py_func
            sequence = getattr(kernel, "sequence", False)
            scope = dict(own.__globals__)
            for name in _names(own.__code__):
                value = scope.get(name)
                if name in SHARES:
                    scope[name] = SHARES[name]
                elif isinstance(value, Dispatcher):
                    scope[name] = self._stage(value) if sequence else self.device(value)
                elif self.single and isinstance(value, float):
                    scope[name] = _single(value)
            code = _singly(own.__code__) if self.single else own.__code__
            self._made[kernel] = cuda.jit(device=True)(FunctionType(code, scope, own.__name__))
        return self._made[kernel]

    def _stage(self, kernel: Any) -> Function:
        """A function as a sequence calls it."""
        if kernel not in self._staged:
            made = self.device(kernel)
            if kernel in ANSWERING:
                made = _told_by_one(made)
            elif SHARES.keys() & _names(kernel.py_func.__code__):
                made = _by_all(made)
            elif not getattr(kernel, "sequence", False):
                made = _by_one(made)
            self._staged[kernel] = made
        return self._staged[kernel]


def _names(code: CodeType) -> set[str]:
    """Names that a function takes from its module."""
    return {str(at.argval) for at in dis.get_instructions(code) if at.opname == "LOAD_GLOBAL"}


def _singly(code: CodeType) -> CodeType:
    """The same code, its constants single precision."""
    constants = tuple(_single(c) if isinstance(c, float) else c for c in code.co_consts)
    return code.replace(co_consts=constants)


def _single(value: float) -> np.float32:
    """A constant in single precision; what keeps from zero still does, and so does its cube."""
    there = np.float32(value)
    return KEEPING if value > 0.0 and there == 0.0 else there
