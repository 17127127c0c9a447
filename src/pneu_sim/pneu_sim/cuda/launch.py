# SPDX-License-Identifier: Apache-2.0
"""Steps of a batch on a GPU: one launch for all of a call's steps, one rig in each block."""

import functools
import importlib.util
from collections.abc import Callable
from typing import Any, NamedTuple

import numba.core.config
import numba.cuda
import numpy as np
from numba.core import types
from numpy.typing import NDArray

from pneu_sim import kernel
from pneu_sim.cuda.batch import HOT, Batch, view_name
from pneu_sim.cuda.translate import Translation
from pneu_sim.cuda.views import viewing

cuda: Any = numba.cuda  # its types say nothing of what kernels see
config: Any = numba.core.config
WARP = 1 if config.ENABLE_CUDASIM else 32
MOST_THREADS = 3 if config.ENABLE_CUDASIM else 256
"""Threads of a block; those of the simulator are Python's own, and slow."""
SHARED_BYTES = 47 * 1024
"""Memory that a block of any GPU can share, 48 KiB, less what answers of passes take."""


def missing() -> str:
    """Why there is no GPU to run on; empty where there is one."""
    if not config.ENABLE_CUDASIM and importlib.util.find_spec("numba_cuda") is None:
        return "numba-cuda is not installed (pip install 'pneu[gpu]')"
    try:
        return "" if cuda.is_available() else "no CUDA device was found"
    except Exception as problem:  # a broken driver says so in many ways
        return f"CUDA cannot be used: {problem}"


@functools.lru_cache(maxsize=2)
def _translation(single: bool) -> Translation:
    return Translation(single)


@functools.lru_cache(maxsize=32)
def _kernel(
    source: str,
    shapes: frozenset[tuple[int, ...]],
    terms: tuple[Callable[..., Any], ...],
    single: bool,
) -> Any:
    """The kernel that a source tells, for rigs with some terms."""
    groups = {kind.__name__: kind for kind in vars(kernel).values() if isinstance(kind, type)}
    scope: dict[str, Any] = {
        **groups,
        "cuda": cuda,
        "real": types.float32 if single else types.float64,
        "advance": _translation(single).device(kernel.advancing(terms)),
    }
    scope |= {view_name(shape): viewing(shape) for shape in shapes}
    exec(source, scope)
    return cuda.jit(scope["many"])


def _source(batch: Batch, rigs: Any, moving: Any, clock: Any, record: Any, shared: bool) -> str:
    """What a kernel does: every block advances its own rig."""
    own = [batch.group(part) for part in (rigs, moving)]
    lanes = batch.array(kernel.Clock, "lanes", clock.lanes)
    own.append(f"Clock(samples, steps, dt, {clock.knots}, {lanes}, watched, closing)")
    own += ["opening[b]", batch.group(record)]
    lines = [
        "def many(floats, ints, numbers, tables, long, opening, samples, steps, dt, watched,"
        " closing):",
        "    b = cuda.blockIdx.x",
        f"    floats_size, ints_size = {batch.size['floats']}, {batch.size['ints']}",
    ]
    copy = "    for i in range(cuda.threadIdx.x, {0}, cuda.blockDim.x):\n        {1}"
    away = f"floats[b * floats_size + i] = hot[i]\n{'':4}cuda.syncthreads()"
    here = f"hot[i] = floats[b * floats_size + i]\n{'':4}cuda.syncthreads()"
    if shared:
        lines += ["    hot_begin = 0", "    hot = cuda.shared.array(0, real)"]
        lines.append(copy.format(batch.hot, here))
    else:
        lines += ["    hot_begin = b * floats_size", "    hot = floats"]
    lines.append(f"    advance({', '.join(own)})")
    if shared:
        lines.append(copy.format(batch.hot, away))
    return "\n".join(lines)


class Launch(NamedTuple):
    """A launch that is yet to be done.

    Attributes:
        kernel: What runs.
        given: What it is given: memory, arrays as long as a recording, openings, numbers.
        batch: How the memory is laid out.
        blocks: Rigs.
        threads: Of each.
        shared: Bytes that a block shares.
    """

    kernel: Any
    given: tuple[Any, ...]
    batch: Batch
    blocks: int
    threads: int
    shared: int


def advance(terms: tuple[Callable[..., Any], ...], single: bool, *told: Any) -> None:
    """Advances a batch as `pneu_sim.kernel.advance` does, on a GPU.

    Args:
        terms: Further terms, see `pneu_sim.kernel.advancing`.
        single: Whether in single precision.
        told: What that is given: rigs, what of them moves, clock, openings, record.
    """
    run = prepared(terms, single, *told)
    sent: list[Any] = [
        tuple(cuda.to_device(part) for part in one)
        if isinstance(one, tuple)
        else cuda.to_device(one)
        if isinstance(one, np.ndarray)
        else one
        for one in run.given
    ]
    run.kernel[run.blocks, run.threads, 0, run.shared](*sent)
    cuda.synchronize()
    long = [part.copy_to_host() for part in sent[4]]
    run.batch.take_back(sent[0].copy_to_host(), sent[1].copy_to_host(), long)


def prepared(
    terms: tuple[Callable[..., Any], ...],
    single: bool,
    rigs: kernel.Rigs,
    moving: kernel.Moving | None,
    clock: kernel.Clock,
    opening: NDArray[np.float64],
    record: kernel.Record,
) -> Launch:
    """The launch that advances a batch.

    Args:
        terms: Further terms, see `pneu_sim.kernel.advancing`.
        single: Whether in single precision.
        rigs: The batch.
        moving: What of it moves, or None.
        clock: How many steps of what length.
        opening: ((samples - 1) * (knots + 1), n_ports, lanes).
        record: What is written down.
    """
    real = np.float32 if single else np.float64
    lanes = rigs.cells.lanes
    slots = rigs.cells.par.shape[1] // lanes
    batch = Batch(lanes)
    for name in HOT[kernel.Cells]:  # comes first in memory
        batch.array(kernel.Cells, name, getattr(rigs.cells, name))
    shared = batch.hot * real().itemsize
    shared = shared if shared <= SHARED_BYTES else 0
    source = _source(batch, rigs, moving, clock, record, shared > 0)
    memory = batch.memory(real)
    given = (
        *memory.values(),
        tuple(batch.long(real)),
        np.ascontiguousarray(np.moveaxis(opening, -1, 0)[..., None], dtype=real),
        clock.samples,
        clock.steps,
        real(clock.dt),
        clock.watched,
        clock.closing,
    )
    threads = min(-(-slots // WARP) * WARP, MOST_THREADS)
    run = _kernel(source, frozenset(batch.shapes), terms, single)
    return Launch(run, given, batch, lanes, threads, shared)
