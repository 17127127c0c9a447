# SPDX-License-Identifier: Apache-2.0
"""Views of flat memory whose shapes the compiler knows.

An array of Numba is a pointer with lengths and strides; a rig has a hundred of them, more than a
thread has registers for. Lengths that are constants cost none.
"""

import functools
import importlib
import math
from collections.abc import Callable
from typing import Any

import numba.core.config

config: Any = numba.core.config


@functools.lru_cache(maxsize=1024)
def viewing(shape: tuple[int, ...]) -> Callable[[Any, Any], Any]:
    """A function that takes a part of flat memory as an array of some shape.

    Args:
        shape: The shape.

    Returns:
        A function of kernels: of the memory, (n,), and where in it the array begins.
    """
    return _simulated(shape) if config.ENABLE_CUDASIM else _compiled(shape)


def _simulated(shape: tuple[int, ...]) -> Callable[[Any, Any], Any]:
    count = math.prod(shape)

    def view(memory: Any, begin: int) -> Any:
        return memory[begin : begin + count].reshape(shape)

    return view


def _compiled(shape: tuple[int, ...]) -> Callable[[Any, Any], Any]:
    from numba.cuda.extending import intrinsic
    from numba.cuda.np.arrayobj import make_array, populate_array

    types: Any = importlib.import_module("numba.cuda.types")

    def view(typing: Any, memory: Any, begin: Any) -> Any:
        made = types.Array(memory.dtype, len(shape), "C")

        def lower(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            whole = make_array(memory)(context, builder, values[0])
            size = context.get_abi_sizeof(context.get_data_type(memory.dtype))
            word = context.get_value_type(types.intp)
            strides = [size * math.prod(shape[k + 1 :]) for k in range(len(shape))]
            array = make_array(made)(context, builder)
            populate_array(
                array,
                data=builder.gep(whole.data, [values[1]]),
                shape=[word(n) for n in shape],
                strides=[word(n) for n in strides],
                itemsize=size,
                meminfo=None,
            )
            return array._getvalue()

        return made(memory, begin), lower

    made: Any = intrinsic(view)
    return made
