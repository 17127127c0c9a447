# SPDX-License-Identifier: Apache-2.0
"""Long work tells how far it is where nobody watches a terminal, and the compiler that it works."""

import os
import re
import subprocess
import sys

import pytest

from pneu_common import progress

pytestmark = pytest.mark.kernel_free

WORK = """
import time
from pneu_common import progress
progress.FIRST_AFTER_S, progress.EVERY_S = 0.2, 0.3
with progress.progress("reading") as tell:
    time.sleep(0.3)
    for k in range(10):
        tell("fitting", k / 10, f"cost {10 - k}")
        time.sleep(0.12)
    {end}
"""

COMPILE = """
from pneu_common.cli import show_log
show_log()
from pneu_sim.riemann import solve
solve((1.0, 0.0, 1e5), (0.125, 0.0, 1e4), 1.4)
"""


def run(code, **environment):
    """What a program writes to standard error, which is no terminal here, and its status."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=120.0,
        env={**os.environ, **environment},
        check=False,
    )
    return done.stderr.splitlines(), done.returncode


def test_lines_say_stage_share_and_what_is_left():
    lines, status = run(WORK.replace("{end}", ""))
    assert status == 0
    assert re.fullmatch(r"reading: 0:0\d so far", lines[0])
    assert any(
        re.fullmatch(r"fitting: 0:0\d so far, \d0 % done, about 0:0\d left of this, cost \d+", line)
        for line in lines
    ), lines
    assert re.fullmatch(r"done after 0:0\d", lines[-1])


def test_work_that_fails_is_not_done():
    lines, status = run(WORK.replace("{end}", "raise KeyError"))
    assert status == 1
    assert any(line.startswith("fitting") for line in lines)
    assert not any(line.startswith("done") for line in lines)


def test_short_work_says_nothing(capfd):
    with progress.progress("comparing") as tell:
        tell("comparing", 0.5)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.4, "0:00"), (61.0, "1:01"), (3599.6, "1:00:00"), (7325.0, "2:02:05")]
)
def test_lengths_of_time(seconds, text):
    assert progress.clock(seconds) == text


@pytest.mark.long
def test_compiling_is_told_when_it_happens_and_not_again(tmp_path):
    first, status = run(COMPILE, NUMBA_CACHE_DIR=str(tmp_path))
    assert status == 0, first
    assert len([line for line in first if "compiling the numerical kernels" in line]) == 1
    second, status = run(COMPILE, NUMBA_CACHE_DIR=str(tmp_path))
    assert (second, status) == ([], 0)
