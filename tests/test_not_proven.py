# SPDX-License-Identifier: Apache-2.0
"""What a busy machine does to tests against the clock counts as not proven, wherever it shows."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.measured import Stalls

pytestmark = pytest.mark.realtime

ROOT = Path(__file__).parents[1]

TESTS = """
import subprocess
import pytest
from pneu_common.errors import InputError
from tests.bridges import wait_until
from tests.measured import MachineStalledError

STALL = "kill -STOP $PPID; sleep 0.4; kill -CONT $PPID"

def failing(stalled, error):
    if stalled:  # a process that is stopped is kept from running
        subprocess.run(STALL, shell=True)
    if error:
        raise error

@pytest.fixture
def late():
    failing(True, TimeoutError("not within 60 s"))

@pytest.fixture
def slow():
    failing(True, AssertionError("runs at 0.5 times real time here"))

@pytest.fixture
def unanswered():
    failing(True, InputError("does not answer"))

@pytest.fixture
def wrong():
    failing(True, KeyError("not a matter of time"))

@pytest.fixture
def broken():
    failing(False, TimeoutError("not within 60 s"))

@pytest.fixture
def told():
    failing(False, MachineStalledError("a lab stalled"))

@pytest.mark.realtime
def test_late(late): pass
@pytest.mark.realtime
def test_slow(slow): pass
@pytest.mark.realtime
def test_unanswered(unanswered): pass
@pytest.mark.realtime
def test_told(told): pass
@pytest.mark.realtime
def test_called(): failing(False, MachineStalledError("a lab stalled"))
@pytest.mark.realtime
def test_wrong(wrong): pass
@pytest.mark.realtime
def test_broken(broken): pass
def test_without_clock(late): pass
def test_dead():
    with pytest.raises(AssertionError, match="has ended"):
        wait_until(lambda: False, alive=lambda: False)
"""


def test_a_fixture_that_fails_as_the_machine_stalls_proves_nothing(tmp_path):
    (tmp_path / "test_some.py").write_text(TESTS)
    words = ["-p", "conftest", "-p", "no:cacheprovider", "-rA", "--no-header", "--tb=no"]
    words += ["-c", str(ROOT / "pyproject.toml"), "--rootdir", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *words, str(tmp_path / "test_some.py")],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60.0,
        check=False,
    )
    lines = done.stdout.splitlines()
    skipped = [line for line in lines if line.startswith("SKIPPED")]
    assert sum("not proven: " in line for line in skipped) == len(skipped)
    found = "\n".join(skipped)
    for text in ("not within 60 s", "0.5 times real time", "does not answer", "a lab stalled"):
        assert text in found, done.stdout
    assert "5 skipped" in lines[-1], done.stdout
    assert "1 passed" in lines[-1] and "3 errors" in lines[-1], done.stdout
    failed = sorted(line.split("::")[1].split(" ")[0] for line in lines if line.startswith("ERROR"))
    assert failed == ["test_broken", "test_without_clock", "test_wrong"]


def test_a_process_that_computes_is_not_withheld_a_processor():
    """Its other threads wait for the lock of the interpreter, which is no excuse."""
    stalls = Stalls(0.005)
    begun_s, ran_s = time.monotonic(), time.process_time()
    sum(range(20_000_000))
    took_s, ran_s = time.monotonic() - begun_s, time.process_time() - ran_s
    stalls.close()
    assert stalls.total_s <= took_s - ran_s + 0.05
