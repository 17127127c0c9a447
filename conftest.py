# SPDX-License-Identifier: Apache-2.0
"""What holds for all tests: their order, and what a run reports at its end.

An interrupt reaches the processes they start, and so does the end of a terminal: a shell starts
background jobs with SIGINT ignored, nohup others with SIGHUP, and children inherit that; tests that
interrupt a node would then wait for it for ever.
"""

import atexit
import contextlib
import gc
import json
import os
import shutil
import signal
import tempfile
from pathlib import Path

import hypothesis
import pytest
from tests import measured

from pneu_common.errors import InputError
from pneu_runtime import hook

hook.install()  # before any test imports rclpy

# The same examples each time, and no database of earlier ones.
hypothesis.settings.register_profile("same", derandomize=True, deadline=None, database=None)
hypothesis.settings.load_profile("same")
# Bridges of tests do not meet those of their user, nor those of other workers.
_BRIDGES = tempfile.mkdtemp(prefix="pneu-test-")
atexit.register(shutil.rmtree, _BRIDGES, ignore_errors=True)
os.environ.update(PNEU_STATE_DIR=f"{_BRIDGES}/state", PNEU_RUN_DIR=f"{_BRIDGES}/run")
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:  # under nohup
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Collects tests without the garbage collector, which takes a quarter of that time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items):
    """Begin with files that need no kernels, which may have to be compiled, then with the longest.

    No worker is left alone with a long one at the end.
    """

    def turn(item):
        mark = item.get_closest_marker("takes")
        return item.get_closest_marker("kernel_free") is None, -mark.args[0] if mark else 0.0

    files = {}
    for item in items:
        files[item.path] = min(files.get(item.path, (True, 0.0)), turn(item))
    items.sort(key=lambda item: files[item.path])


def pytest_addoption(parser):
    """Adds the option for `tools/run_tests.py`."""
    parser.addoption("--outcome", type=Path, help="write what became of the tests as JSON")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item):
    """Blames the machine where a fixture of a test against the clock failed as it stalled.

    Fixtures start labs and nodes and wait for them; on a busy machine these may be refused as too
    slow, or not be ready in time. That proves as little as a time that was missed in a test.
    """
    if item.get_closest_marker("realtime") is None:
        return (yield)
    with contextlib.closing(measured.Stalls(0.005)) as stalls:
        try:
            return (yield)
        except (AssertionError, TimeoutError, InputError) as error:
            stalls.blame(error)
            raise


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """Lets a test note the times that it proves."""
    token = measured.properties.set(item.user_properties)
    try:
        return (yield)
    finally:
        measured.properties.reset(token)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """A time for which the machine was too busy at the last try counts as not proven."""
    report = yield
    stalled = call.excinfo is not None and call.excinfo.errisinstance(measured.MachineStalledError)
    reruns = getattr(item.config.option, "reruns", None) or 0
    if stalled and getattr(item, "execution_count", 1) > reruns:
        report.outcome = "skipped"
        reason = f"{measured.NOT_PROVEN}: {call.excinfo.value}"
        report.longrepr = (str(item.path), item.location[1] or 0, reason)
    return report


def _cause(report):
    """The first line of why a test failed."""
    crash = getattr(report.longrepr, "reprcrash", None)
    return (crash.message if crash else str(report.longrepr)).partition("\n")[0]


def pytest_terminal_summary(terminalreporter, config):
    """Writes what became of the tests, for the lines at the very end."""
    path = config.getoption("--outcome")
    if path is None:
        return
    stats = terminalreporter.stats
    skipped = [
        {"test": report.nodeid, "reason": report.longrepr[2].removeprefix("Skipped: ")}
        for report in stats.get("skipped", [])
    ]
    times: dict[str, float] = {}  # of a test that measures several, the longest
    for report in stats.get("passed", []):
        for name, seconds in report.user_properties:
            if name == measured.PROPERTY:
                times[report.nodeid] = max(seconds, times.get(report.nodeid, 0.0))
    outcome = {
        "counts": {
            kind: len(stats.get(kind, [])) for kind in ("passed", "failed", "error", "skipped")
        },
        "failed": [r.nodeid for kind in ("failed", "error") for r in stats.get(kind, [])],
        "skipped": skipped,
        "repeated": sorted({f"{r.nodeid}: {_cause(r)}" for r in stats.get("rerun", [])}),
        "safe_after_s": times,
    }
    path.write_text(json.dumps(outcome, indent=2), encoding="utf-8")
