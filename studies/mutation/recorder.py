# SPDX-License-Identifier: Apache-2.0
"""A pytest plugin that records which lines each test runs, in its own and in other processes.

The coverage of a process carries the test as its context. A process that a test starts takes the
test from the environment; one that several tests share has the test that started it.
"""

import json
import os
import signal
from collections.abc import Generator
from pathlib import Path
from typing import Any

import coverage
import pytest

TEST = "PNEU_RECORDED_TEST"
"""Environment variable: the test that runs."""
PROCESS = "process: "
"""What the context of a process that a test starts begins with."""
DURATIONS = "PNEU_RECORDED_DURATIONS"
"""Environment variable: folder for a file per process with the duration of its tests."""

LIMIT = "PNEU_RECORDED_LIMIT_S"
"""Environment variable: time after which each test is ended, s."""

_durations: dict[str, tuple[float, bool]] = {}


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Any:
    """Name the test, to coverage and to the processes that it starts.

    Args:
        item: The test.
    """
    name = item.nodeid.encode("ascii", "backslashreplace").decode()
    os.environ[TEST] = f"{PROCESS}{name}"
    measured = coverage.Coverage.current()
    if measured is not None:
        measured.switch_context(name)
    return (yield)


class _Ended(BaseException):
    """Ends a test; not an Exception, which the test itself may expect."""


def _end(number: int, frame: Any) -> None:
    raise _Ended


def _within_limit() -> Generator[None, Any, Any]:
    """End a test or a fixture that runs for too long: what it reaches, it has reached by then."""
    if limit_s := os.environ.get(LIMIT):
        signal.signal(signal.SIGALRM, _end)
        signal.setitimer(signal.ITIMER_REAL, float(limit_s))
    try:
        return (yield)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        measured = coverage.Coverage.current()
        if limit_s and measured is not None:
            measured.save()  # a test that ends its process takes only itself along


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Any:
    """Prepare a test within the limit."""
    return (yield from _within_limit())


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Any:
    """Run a test within the limit."""
    return (yield from _within_limit())


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Add up how long each test takes.

    Args:
        report: Of a phase of a test.
    """
    so_far = _durations.get(report.nodeid, (0.0, False))
    clock = so_far[1] or "realtime" in report.keywords
    _durations[report.nodeid] = so_far[0] + report.duration, clock


def pytest_unconfigure() -> None:
    """Write the durations."""
    folder = os.environ.get(DURATIONS)
    if folder and _durations:
        text = json.dumps(_durations)
        (Path(folder) / f"{os.getpid()}.json").write_text(text, encoding="utf-8")
