# SPDX-License-Identifier: Apache-2.0
"""Steps of a batch on a GPU: one launch for all of a call's steps, one rig in each block."""

import functools
import hashlib
import importlib.util
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numba.core.config
import numba.cuda
import numpy as np
from numba.core import types
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_sim import kernel
from pneu_sim.cuda.batch import MEMORIES, SHARED_BY_ALL, Batch, view_name
from pneu_sim.cuda.translate import WARP, Translation
from pneu_sim.cuda.views import viewing
from pneu_sim.kernel_cache import digest_of_sources, places

cuda: Any = numba.cuda  # its types say nothing of what kernels see
config: Any = numba.core.config
MOST_THREADS = 3 if config.ENABLE_CUDASIM else 128
"""Threads of a block; those of the simulator are Python's own, and slow."""
MOST_REGISTERS = 96
"""Of a thread. Steps wait for memory and for single threads more than they compute: five blocks on
a multiprocessor of 64k registers do more than three that keep all in registers."""
SHARED_BYTES = 55 * 1024
"""What a block may have near, so that four of them find room on a multiprocessor (228 KiB)."""
GIVEN_BYTES = 48 * 1024
"""What a block can have near without asking for more."""


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
        "long_int": types.int64,
        "__name__": "pneu_kernel",
        "advance": _translation(single).device(kernel.advancing(terms)),
    }
    scope |= {view_name(shape): viewing(shape) for shape in shapes}
    kept = None if terms else _kept(source, single)
    exec(compile(source, str(kept or "<kernel>"), "exec"), scope)
    options = {} if config.ENABLE_CUDASIM else {"max_registers": MOST_REGISTERS}
    return cuda.jit(scope["many"], cache=kept is not None, **options)


def _kept(source: str, single: bool) -> Path | None:
    """A file with a kernel's source, beside which Numba keeps what it compiled of it.

    Named by all that the kernel is made of, so that nothing old is run; None where no file can be.
    """
    if config.ENABLE_CUDASIM:
        return None
    told = f"{digest_of_sources()} {single} {MOST_REGISTERS} {source}"
    name = f"many_{hashlib.sha256(told.encode()).hexdigest()[:16]}.py"
    folder = places().written
    if folder is None:
        return None
    try:
        if not (folder / name).is_file():
            write_whole(folder / name, source)
    except InputError:
        return None
    return folder / name


def _source(batch: Batch, rigs: Any, moving: Any, clock: Any, record: Any, shared: bool) -> str:
    """What a kernel does: every block advances its own rig."""
    own = [batch.group(part) for part in (rigs, moving)]
    lanes = batch.array(kernel.Clock, "lanes", clock.lanes)
    own.append(f"Clock(samples, steps, dt, {clock.knots}, {lanes}, watched, closing)")
    own += ["opening[b]", batch.group(record)]
    given = [f"all_{where}" for where in MEMORIES]
    given += ["long", "opening", "samples", "steps", "dt", "watched", "closing"]
    size = batch.size
    begin = {where: f"b * {size[where]}" for where in MEMORIES}
    begin |= dict.fromkeys(SHARED_BY_ALL, "0")
    lines = [f"def many({', '.join(given)}):", "b = cuda.blockIdx.x"]
    copies = []
    if shared:  # a block has copies of its own of what single threads wait for
        lines += ["near = cuda.shared.array(0, real)"]
        copies += [("near", size["near"], f"{begin['near']} + i")]
        if size["tables"] > 0:
            lines += [f"tables = cuda.shared.array({size['tables']}, long_int)"]
            copies += [("tables", size["tables"], "i")]
    here = {name for name, _, _ in copies}
    lines += [f"{where}_begin = {'0' if where in here else begin[where]}" for where in MEMORIES]
    lines += [f"{where} = all_{where}" for where in MEMORIES if where not in here]
    share = "for i in range(cuda.threadIdx.x, {0}, cuda.blockDim.x):"
    for name, n, i in copies:
        lines += [share.format(n), f"    {name}[i] = all_{name}[{i}]"]
    lines += ["cuda.syncthreads()", f"advance({', '.join(own)})", "cuda.syncthreads()"]
    if shared:  # what steps have changed goes back; tables they only read
        lines += [share.format(size["near"]), f"    all_near[{begin['near']} + i] = near[i]"]
    return "\n    ".join(lines)


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


def advance(terms: tuple[Callable[..., Any], ...], single: bool, *told: Any) -> float:
    """Advances a batch as `pneu_sim.kernel.advance` does, on a GPU.

    Args:
        terms: Further terms, see `pneu_sim.kernel.advancing`.
        single: Whether in single precision.
        told: What that is given: rigs, what of them moves, clock, openings, record.

    Returns:
        How long the steps took there, s, without what is copied; NaN under the simulator,
        which tells no times.
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
    if run.shared > GIVEN_BYTES:
        _allow(run, sent)
    begun, done = cuda.event(), cuda.event()
    begun.record()
    run.kernel[run.blocks, run.threads, 0, run.shared](*sent)
    done.record()
    done.synchronize()
    own = {
        k: sent[k].copy_to_host() for k, where in enumerate(MEMORIES) if where not in SHARED_BY_ALL
    }
    long = [part.copy_to_host() for part in sent[len(MEMORIES)]]
    run.batch.take_back({MEMORIES[k]: flat for k, flat in own.items()}, long)
    if config.ENABLE_CUDASIM:
        return math.nan
    return 1e-3 * float(cuda.event_elapsed_time(begun, done))


def _allow(run: Launch, sent: list[Any]) -> None:
    """Asks for more memory that a block shares than any is given; numba-cuda has no word for it."""
    from numba.cuda.cudadrv import driver

    drv: Any = driver
    made = run.kernel.compile(tuple(run.kernel.typeof_pyval(part) for part in sent))
    function = made._codelibrary.get_cufunc()
    most = drv.binding.CUfunction_attribute.CU_FUNC_ATTRIBUTE_MAX_DYNAMIC_SHARED_SIZE_BYTES
    drv.driver.cuKernelSetAttribute(most, run.shared, function.handle, function.device.id)


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
    for hot in (True, False):
        batch = Batch(lanes, hot)
        source = _source(batch, rigs, moving, clock, record, True)
        shared = batch.size["near"] * real().itemsize
        if shared + batch.size["tables"] * 8 <= SHARED_BYTES:
            break
    else:
        source, shared = _source(batch, rigs, moving, clock, record, False), 0
    memory = batch.memory(real)
    given = (
        *(memory[where] for where in MEMORIES),
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
