# SPDX-License-Identifier: Apache-2.0
"""Kernels as plain Python, so that tests of small ones compile nothing."""

from types import FunctionType


def plain(kernel, made=None):
    """Return a kernel as a Python function that calls other kernels as Python functions, too.

    Args:
        kernel: The kernel, compiled or not.
        made: Functions that have been copied already, by their originals.
    """
    made = {} if made is None else made
    own = getattr(kernel, "py_func", kernel)  # with NUMBA_DISABLE_JIT a kernel is its own source
    if own not in made:
        scope = dict(own.__globals__)
        made[own] = FunctionType(own.__code__, scope, own.__name__, own.__defaults__)
        for name in own.__code__.co_names:
            if hasattr(scope.get(name), "py_func"):
                scope[name] = plain(scope[name], made)
    return made[own]
