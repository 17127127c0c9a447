# SPDX-License-Identifier: Apache-2.0
"""The compiler of the kernels, which says so when it has work: the first time, and once only.

What is compiled is kept on disk (`pneu_sim.kernel_cache`) under a digest of all files with
kernels, since one file's code ends up in another's: whatever changes, nothing old is run. A message
comes at the first start on a machine and after an update; it goes to the log (`pneu_common.log`).
"""

import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit
from numba.core import codegen, event
from numba.core import config as numba_config
from numba.core.registry import cpu_target

from pneu_common.log import LOG
from pneu_sim.compiled_once import compiles_once
from pneu_sim.kernel_cache import KernelCache, places

FAST = {"contract", "nsz", "nnan", "ninf", "arcp"}
"""No reassociation: sums keep their order, so that results do not depend on the batch size."""

_WIDE = "+avx512vbmi2"
"""A feature of processors (Ice Lake, Zen 4 and later) that hardly slow down for wide vectors."""

WORTH_TELLING_S = 5.0


def _use_whole_vectors() -> None:
    """Has code made for vectors of 512 bits where the processor has them at no loss.

    LLVM prefers half of them on Intel's processors, for the sake of the first ones that had them.
    Whoever sets ``NUMBA_CPU_FEATURES``, or has used Numba before, has what was set.
    """
    config: Any = numba_config  # its types know none of its settings
    features = codegen.get_host_cpu_features()
    if config.CPU_FEATURES is None and _WIDE in features.split(","):
        config.CPU_FEATURES = f"{features},-prefer-256-bit"
        try:
            cpu_target.target_context.codegen()  # made once, with what is set then
        finally:
            config.CPU_FEATURES = None


_use_whole_vectors()


def _compile(
    function: Callable[..., Any], variant: str = "", apart: bool = False, **options: Any
) -> Any:
    """A function that is compiled when it is first called, and kept on disk.

    Nobody takes one by its address in C; without that wrapper a tenth less is to be compiled.
    """
    config: Any = numba_config  # its types know none of its settings
    if config.DISABLE_JIT:  # NUMBA_DISABLE_JIT=1, for a debugger or for coverage
        return function
    settings: dict[str, Any] = {"no_cfunc_wrapper": True, **options}  # its types do not know it
    compiled: Any = njit(nogil=True, error_model="numpy", **settings)(function)
    if apart:
        compiler = compiled._compiler
        flags_of = compiler._customize_flags

        def without_alias(flags: Any) -> Any:
            flags = flags_of(flags)
            flags.noalias = True  # Numba has the flag, and no option that sets it
            return flags

        compiler._customize_flags = without_alias
    if not Path(function.__code__.co_filename).is_file():  # from an interactive session
        return compiled
    compiled._cache = KernelCache(function, variant)
    return compiles_once(compiled)


def _for_kernels(function: Callable[..., Any], **options: Any) -> Any:
    """A function that kernels call, compiled without the wrapper by which Python would call it.

    A quarter of the time in which all kernels are compiled goes into such wrappers. Where Python
    calls one all the same, as tests do, it is compiled once more with a wrapper, which the
    dispatcher finds from then on.
    """
    kernel = _compile(function, no_cpython_wrapper=True, **options)
    if kernel is function:
        return kernel
    wrapped: list[Any] = []  # the dispatcher with a wrapper, made when it is needed

    def add_overload(result: Any) -> None:
        # not told to the part of the dispatcher that Python calls, which would find no wrapper
        kernel.overloads[tuple(result.signature.args)] = result

    def compile_for_args(*arguments: Any) -> Any:
        if not wrapped:
            wrapped.append(_compile(function, "called", **options))
        found = wrapped[0]._compile_for_args(*arguments)
        for types, result in wrapped[0].overloads.items():
            if result.entry_point is found:
                kernel._insert([one._code for one in types], found, False)
        return found

    kernel.add_overload, kernel._compile_for_args = add_overload, compile_for_args
    return kernel


def compiled(function: Callable[..., Any]) -> Any:
    """Compiles a function that may make arrays of its own.

    Args:
        function: The function.
    """
    return _compile(function)


def uncached(function: Callable[..., Any]) -> Any:
    """Compiles a pass that is put together while the program runs, for this process alone.

    Args:
        function: The pass.
    """
    options: dict[str, Any] = {"_nrt": False}
    return njit(nogil=True, error_model="numpy", **options)(function)


# The passes of a step make none, which the compiler is told, and refuses where they would: it then
# need not count who holds an array, which costs more than most passes.


each = range
"""What a pass over slots, which may go in any order, goes through.

On a processor one after another; on a GPU every thread has its own share (`pneu_sim.cuda`). Nothing
else that such a pass does may depend on how often it is done."""

apart = range
"""What a pass over ends of pipes, which may go in any order, goes through.

On a processor one after another; on a GPU every warp of threads has its own share, since ends of
different kinds take different ways, which threads of one warp would go one after another."""


def sequence(function: Callable[..., Any]) -> Any:
    """Compiles what calls passes in their order, and does nothing itself but choose among them.

    It becomes part of its caller: to hand on a hundred arrays takes as long as the gas of a small
    rig.

    Args:
        function: The sequence.
    """
    made = folded(function)
    made.sequence = True
    return made


def branching(function: Callable[..., Any]) -> Any:
    """Compiles a pass with branches and calls, in exact IEEE arithmetic.

    Args:
        function: The pass.
    """
    return _for_kernels(function, _nrt=False)


def entry(function: Callable[..., Any]) -> Any:
    """Compiles a pass that Python calls, in exact IEEE arithmetic.

    Args:
        function: The pass.
    """
    return _compile(function, _nrt=False)


def folded(function: Callable[..., Any]) -> Any:
    """Compiles a function into the passes that call it, in exact IEEE arithmetic.

    Args:
        function: The function.
    """
    return _for_kernels(function, _nrt=False, forceinline=True)


def vectorised(function: Callable[..., Any]) -> Any:
    """Compiles a pass that is a plain loop over slots, several of which are then done at once.

    It takes each row by itself and is told that what it writes to is nothing else that it takes. It
    would else compare every row with every other when it is called, and do the slots one by one
    where that does not pay: in a short line, or with many rows.

    Args:
        function: The pass; no NaN or infinity comes into it, and no row twice that it writes to.
    """
    return _for_kernels(function, apart=True, _nrt=False, fastmath=FAST)


def inlined(function: Callable[..., Any]) -> Any:
    """Compiles a function into its callers: a loop vectorises only with no call inside.

    Args:
        function: The function; no NaN or infinity comes into it.
    """
    return _for_kernels(function, _nrt=False, fastmath=FAST, forceinline=True)


class _Compilations(event.Listener):
    """Says when compiling begins, for the first time, and how long a kernel that took long took."""

    def __init__(self) -> None:
        self._log = logging.getLogger(LOG)
        self._depth = threading.local()
        self._told = False

    def on_start(self, event: Any) -> None:
        depth = getattr(self._depth, "value", 0)
        self._depth.value = depth + 1
        if depth == 0:
            self._depth.begun_s = time.monotonic()
            if not self._told:
                self._told = True
                self._tell()

    def _tell(self) -> None:
        about = "compiling the numerical kernels for this machine: half a minute to two"
        if places().written is not None:
            self._log.info(f"{about}, once; they are kept")
        else:
            self._log.warning(
                f"{about}, at every start, because no folder to keep them in can be written:"
                f" {places().faults}; NUMBA_CACHE_DIR names another folder"
            )

    def on_end(self, event: Any) -> None:
        self._depth.value -= 1
        took_s = time.monotonic() - self._depth.begun_s
        if self._depth.value == 0 and took_s > WORTH_TELLING_S:
            name = event.data["dispatcher"].py_func.__name__
            self._log.info(f"compiled {name!r} in {took_s:.0f} s")


event.register("numba:compile", _Compilations())
