# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels that are kept on disk are those of the sources as they are."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from numba.types import UniTuple, boolean, float64, int64

import pneu_common
import pneu_sim
from pneu_sim.compiling import vectorised
from pneu_sim.kernel import faces, lines, walls

LEAK = (
    "from pneu_sim.kernel.leaks import leak_flow;"
    "print(repr(leak_flow(0, 1e-6, 0.0, 1.0, 3e5, 293.0, 1e5, 293.0, 1.4, 287.0)),"
    " sum(leak_flow.stats.cache_hits.values()))"
)

ROW, NUMBER = float64[::1], float64


def rows(count: int) -> UniTuple:
    return UniTuple(ROW, count)


@pytest.mark.parametrize(
    ("kernel", "arguments"),
    [
        (lines._primitive, (NUMBER, NUMBER, *[ROW] * 7)),
        (lines._balance, (NUMBER, int64, *[ROW] * 10)),
        (
            faces._slopes,
            (NUMBER, boolean, NUMBER, int64, rows(3), rows(5), rows(4), rows(4)),
        ),
        (walls._drag, (NUMBER, rows(4), rows(4), rows(3), ROW, rows(6))),
    ],
    ids=lambda given: getattr(given, "__name__", ""),
)
def test_a_pass_does_several_slots_at_once_and_compares_no_rows_first(
    kernel: Any, arguments: tuple[Any, ...]
) -> None:
    """In a short line the comparing took longest, and with many rows nothing was vectorised."""
    own = vectorised(kernel.py_func)
    own._cache.disable()  # what is kept on disk has no code that can be read
    own.compile(arguments)
    (code,) = own.inspect_llvm().values()
    assert re.search(r"f(mul|add|sub)[a-z ]* <\d+ x double>", code)
    assert "vector.memcheck" not in code


def test_of_processes_that_start_together_one_compiles_and_the_others_wait(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", LEAK]
    together = [
        subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    told = [process.communicate()[0].split() for process in together]
    assert len({flow for flow, _ in told}) == 1
    assert sorted(int(hits) for _, hits in told) == [0, 1, 1]


HOLD = (
    "from pneu_sim.compiled_once import held; from pneu_sim.kernel.leaks import leak_flow\n"
    "with held(leak_flow): print('held', flush=True); input()"
)


def test_one_that_is_killed_while_it_compiles_holds_nobody_up(tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}

    def start(code: str) -> subprocess.Popen[str]:
        command, pipe = [sys.executable, "-c", code], subprocess.PIPE
        return subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, text=True)

    with start(HOLD) as one:
        try:
            assert one.stdout is not None and one.stdout.readline() == "held\n"
            other = start(LEAK)
            with pytest.raises(subprocess.TimeoutExpired):
                other.wait(3.0)  # it waits, however long
        finally:
            one.kill()
    flow, hits = other.communicate()[0].split()
    assert float(flow) > 0.0 and hits == "0"


@pytest.mark.long
def test_a_change_in_a_file_that_a_kernel_calls_into_is_compiled(tmp_path: Path) -> None:
    for package in (pneu_sim, pneu_common):
        source = Path(package.__file__).parent
        ignore = shutil.ignore_patterns("__pycache__")
        shutil.copytree(source, tmp_path / source.name, ignore=ignore)
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": ""}

    def leaks() -> tuple[float, int]:
        command = [sys.executable, "-c", LEAK]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        )
        flow, hits = done.stdout.split()
        return float(flow), int(hits)

    before, hits = leaks()
    assert before > 0.0 and hits == 0
    assert leaks() == (before, 1)
    # what another version has kept may be of no use to this one, and not even readable
    for index in (tmp_path / "pneu_sim" / "kernel" / "__pycache__").glob("*.nbi"):
        whole = index.read_bytes()
        index.write_bytes(whole[: len(whole) // 2])
    callee = tmp_path / "pneu_sim" / "kernel" / "orifices.py"
    text = callee.read_text()
    assert "area * p_a" in text
    callee.write_text(text.replace("area * p_a", "2.0 * area * p_a"))
    assert leaks() == (2.0 * before, 0)
