# SPDX-License-Identifier: Apache-2.0
"""Long work tells how far it is where nobody watches a terminal, and the compiler that it works."""

import contextlib
import os
import pty
import re
import subprocess
import sys
import threading
import time

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


@pytest.mark.parametrize(
    ("fraction", "note", "text"),
    [
        (None, "", ""),
        (None, "cost 7", ", cost 7"),
        (0.0, "", ", 0 % done"),
        (0.02, "", ", 2 % done"),  # too early for an estimate
        (0.04, "cost 7", ", 4 % done, about 24:00 left of this, cost 7"),
        (0.75, "", ", 75 % done, about 0:20 left of this"),
        (1.0, "", ", 100 % done"),
    ],
)
def test_time_left_is_told_of_a_stage_that_has_begun_and_not_ended(fraction, note, text):
    """It is that of the stage, while the time so far is that of all stages."""
    lines = progress._Lines("reading")
    lines._begun_s = 100.0
    assert lines._text(161.0) == "reading: 1:01 so far"
    lines.tell("fitting", 0.5, "before")
    lines._stage_s = 130.0
    lines.tell("fitting", fraction, note)
    assert lines._text(190.0) == f"fitting: 1:30 so far{text}"
    lines.tell("comparing")  # from now on
    assert lines._text(190.0) == "comparing: 1:30 so far"
    assert 0.0 <= time.monotonic() - lines._stage_s < 60.0


def test_lines_are_few(monkeypatch, capfd):
    """The first after a while, the next much later; the end does not wait for it."""
    assert (progress.FIRST_AFTER_S, progress.EVERY_S, progress.SETTLED) == (2.0, 10.0, 0.02)
    monkeypatch.setattr(progress, "FIRST_AFTER_S", 0.01)
    monkeypatch.setattr(progress, "EVERY_S", 1000.0)
    said, end_s = "", time.monotonic() + 20.0
    with progress.progress("reading"):
        while not said.endswith("\n") and time.monotonic() < end_s:
            time.sleep(0.01)
            said += capfd.readouterr().err
        time.sleep(0.05)
    assert said == "reading: 0:00 so far\n"
    assert capfd.readouterr().err == "done after 0:00\n"


@contextlib.contextmanager
def terminal(monkeypatch):
    """Makes standard error a terminal; yields a list, which holds all that it got at the end."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("NO_COLOR", "1")  # of a bar only what is done is drawn then
    for name in ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)
    master, slave = pty.openpty()
    parts, got = [b""], []

    def read():
        while b"\0" not in parts[-1]:
            parts.append(os.read(master, 1000))

    reader = threading.Thread(target=read)
    reader.start()
    with os.fdopen(slave, "w", encoding="utf-8") as stream, monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", stream)
        yield got
        stream.write("\0")
        stream.flush()
        reader.join(20.0)
    os.close(master)
    got.append(b"".join(parts).decode())


def test_a_bar_for_each_stage_on_a_terminal(monkeypatch):
    """What comes first is gone when a stage is told; at the end all is."""
    with terminal(monkeypatch) as got, progress.progress("reading [bags]") as tell:
        tell("fit [a]", 0.25, "cost [7]")
        tell("fit [b]", 0.75, "cost [8]")
        tell("fit [a]", 0.5)
        tell("fit [b]", None, "cost [red]")
    shown = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", got[0])
    assert shown.rindex("reading [bags]") < shown.index("fit [a]")
    last = {name: shown[shown.rindex(name) :].splitlines()[0] for name in ("fit [a]", "fit [b]")}
    # A bar has 40 characters.
    assert re.fullmatch(r"fit \[a\] ━{20} +0:00:\d\d [-0-9:]+ *", last["fit [a]"])
    assert re.fullmatch(r"fit \[b\] ━{30} +0:00:\d\d [-0-9:]+ cost \[red\] *", last["fit [b]"])
    assert got[0].rindex("\x1b[2K") > got[0].rindex("cost [red]")


@pytest.mark.long
def test_compiling_is_told_when_it_happens_and_not_again(tmp_path):
    first, status = run(COMPILE, NUMBA_CACHE_DIR=str(tmp_path))
    assert status == 0, first
    assert len([line for line in first if "compiling the numerical kernels" in line]) == 1
    second, status = run(COMPILE, NUMBA_CACHE_DIR=str(tmp_path))
    assert (second, status) == ([], 0)
