# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels that are kept on disk are those of the sources as they are."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from numba.types import UniTuple, boolean, float64, int64
from tests import read_only

import pneu_common
import pneu_sim
from pneu_sim.compiling import vectorised
from pneu_sim.kernel import faces, lines, walls
from pneu_sim.kernel_cache import MOST_VERSIONS

pytestmark = pytest.mark.takes(20)

LEAK = """
from numba.core.event import install_recorder
from pneu_sim.kernel.leaks import leak_flow
with install_recorder("numba:compile") as compiling:
    flow = leak_flow(0, 1e-6, 0.0, 1.0, 3e5, 293.0, 1e5, 293.0, 1.4, 287.0)
print(repr(flow), int(not compiling.buffer))
"""

ROW, NUMBER = float64[::1], float64


def rows(count: int) -> UniTuple:
    return UniTuple(ROW, count)


@pytest.mark.parametrize(
    ("kernel", "arguments"),
    [
        (lines._primitive, (NUMBER, NUMBER, *[ROW] * 7)),
        (lines._balance, (NUMBER, int64, *[ROW] * 11)),
        (
            faces._slopes,
            (NUMBER, boolean, NUMBER, int64, rows(3), rows(5), rows(4), rows(4)),
        ),
        (walls._drag, (NUMBER, rows(6), rows(3), rows(3), ROW, rows(6))),
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
    "from pneu_sim.compiled_once import held; from pneu_sim.kernel.orifices import orifice_flow\n"
    "with held(orifice_flow): print('held', flush=True); input()"
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


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A folder with copies of the packages and no compiled kernels; it is bound by permissions."""
    return read_only.installation(tmp_path / "copy", "pneu_sim", "pneu_common")


def leaks(installed: Path, home: Path, **variables: str) -> tuple[float, int, list[str]]:
    """Returns the flow, the kernels that were loaded instead of compiled, and what was logged."""
    done = subprocess.run(
        [sys.executable, "-c", f"from pneu_common.cli import show_log; show_log()\n{LEAK}"],
        cwd=installed,
        env={**read_only.environment(installed, home), **variables},
        capture_output=True,
        text=True,
        check=True,
        preexec_fn=read_only.bound_by_permissions,
    )
    flow, hits = done.stdout.split()
    return float(flow), int(hits), done.stderr.splitlines()


def folders(parent: Path) -> list[Path]:
    return sorted(parent.glob("pneu-kernels-*"))


@pytest.mark.long
def test_a_change_in_a_file_that_a_kernel_calls_into_is_compiled(
    copy: Path, tmp_path: Path
) -> None:
    before, hits, log = leaks(copy, tmp_path)
    assert before > 0.0 and hits == 0 and "they are kept" in log[0]
    assert leaks(copy, tmp_path) == (before, 1, [])
    (folder,) = folders(tmp_path / ".cache" / "pneu")
    assert not folders(copy / "pneu_sim" / "__pycache__"), "removing the copy leaves none of it"
    # a file that is damaged is as one that is missing
    for index in folder.glob("*.nbi"):
        index.write_bytes(b"")
    assert leaks(copy, tmp_path)[:2] == (before, 0)
    callee = copy / "pneu_sim" / "kernel" / "orifices.py"
    text = callee.read_text()
    assert "area * p_a" in text
    callee.write_text(text.replace("area * p_a", "2.0 * area * p_a"))
    assert leaks(copy, tmp_path)[:2] == (2.0 * before, 0)


def test_copies_of_one_content_share_what_is_compiled(copy: Path, tmp_path: Path) -> None:
    checkout = Path(pneu_sim.__file__).parent.parent
    path = f"{checkout}{os.pathsep}{Path(pneu_common.__file__).parent.parent}"
    kept = {"NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    flow, hits, _ = leaks(checkout, tmp_path, PYTHONPATH=path, **kept)
    assert hits == 0
    assert leaks(copy, tmp_path, **kept) == (flow, 1, [])
    assert len(folders(tmp_path / "kept")) == 1
    assert not folders(copy / "pneu_sim" / "__pycache__")
    # Under a debugger kernels are plain Python: nothing is compiled or kept, and no hit is counted.
    plain, _, log = leaks(
        copy, tmp_path, NUMBA_DISABLE_JIT="1", NUMBA_CACHE_DIR=str(tmp_path / "n")
    )
    assert plain == pytest.approx(flow, rel=1e-14) and log == []
    assert not folders(tmp_path / "n")


def test_kernels_go_to_the_cache_of_the_user_where_the_installation_is_read_only(
    copy: Path, tmp_path: Path
) -> None:
    """Where there are as many folders as are kept, old versions make room."""
    cache = tmp_path / ".cache" / "pneu"
    long_ago = time.time() - 86400.0
    for k in range(10):
        (cache / f"pneu-kernels-{k}").mkdir(parents=True)
        (cache / f"pneu-kernels-{k}" / "a.nbc").touch()
        if k < 9:
            os.utime(cache / f"pneu-kernels-{k}", (long_ago + k, long_ago + k))
    read_only.lock(copy)
    try:
        flow, hits, _ = leaks(copy, tmp_path)
        left = {folder.name for folder in folders(cache)}
        assert hits == 0 and len(left) == MOST_VERSIONS
        assert {f"pneu-kernels-{k}" for k in (6, 7, 8, 9)} < left
        assert leaks(copy, tmp_path) == (flow, 1, [])
        elsewhere = {"XDG_CACHE_HOME": str(tmp_path / "xdg")}
        assert leaks(copy, tmp_path, **elsewhere)[:2] == (flow, 0)
        assert folders(tmp_path / "xdg" / "pneu")
    finally:
        read_only.unlock(copy)


def test_where_nothing_can_be_written_one_line_says_so_and_kernels_that_are_there_are_read(
    copy: Path, tmp_path: Path
) -> None:
    home = tmp_path / "home"
    home.mkdir()
    read_only.lock(home)
    read_only.lock(copy)
    try:
        flow, hits, log = leaks(copy, home)
        assert flow > 0.0 and hits == 0
        (line,) = log
        for part in ("at every start", "__pycache__ (", ".cache/pneu (", "NUMBA_CACHE_DIR names"):
            assert part in line
        read_only.unlock(copy)
        assert leaks(copy, home)[1] == 0
        read_only.lock(copy)
        assert leaks(copy, home) == (flow, 1, [])
    finally:
        read_only.unlock(copy)


def test_a_full_disk_is_told_once(copy: Path, tmp_path: Path) -> None:
    code = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))\n{LEAK}"
    code = f"import signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); {code}"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**read_only.environment(copy, tmp_path), "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    (line,) = done.stderr.splitlines()
    assert re.fullmatch(r"compiled kernels cannot be kept in .* \(File too large\)", line)


def test_a_kernel_of_another_package_follows_its_own_file(tmp_path: Path) -> None:
    """Its machine code depends on constants, which Numba does not compare."""
    own = tmp_path / "own_kernel.py"
    code = "from own_kernel import own; print(own(1.0), sum(own.stats.cache_hits.values()))"

    def run() -> str:
        return subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()

    text = "from pneu_sim.compiling import compiled\n@compiled\ndef own(x):\n    return 2.0 * x\n"
    own.write_text(text)
    assert [run(), run()] == ["2.0 0", "2.0 1"]
    own.write_text(text.replace("2.0", "3.0"))
    assert run() == "3.0 0"
