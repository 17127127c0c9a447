# SPDX-License-Identifier: Apache-2.0
"""What holds for all tests: an interrupt reaches the processes they start.

A shell starts background jobs with SIGINT ignored, and children inherit that; tests that interrupt
a node would then wait for it for ever.
"""

import signal
from pathlib import Path

import pytest

ROOT = Path(__file__).parent
REALTIME = (
    "src/pneu_hw_bridge/test/",
    "src/pneu_policy/test/test_policy_nodes",
    "src/pneu_runtime/test/test_recorder",
    "src/pneu_sim/test/test_simulator_node",
    "src/pneu_sysid/test/test_identify_node",
    "src/pneu_sysid/test/test_replay_node",
    "tests/conformance/test_executors",
    "tests/conformance/test_timers",
    "tests/test_faults",
    "tests/test_graph",
    "tests/test_pressure_study",
)
"""Beginnings of the paths of tests that run against the clock."""

LONGEST = (
    "tests/test_hidden_effects",
    "tests/test_real_data",
    "tests/test_several_recordings",
    "src/pneu_sysid/test/test_exact",
    "src/pneu_sysid/test/",
    "src/pneu_runtime/test/test_tools",
)
"""Beginnings of the paths of tests that take longest: they begin first, so that no worker is left
alone with one of them at the end. Wants `--no-loadscope-reorder`."""

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _name(item):
    """Returns the path of an item's file, from here."""
    path = item.path.resolve()
    return str(path.relative_to(ROOT)) if path.is_relative_to(ROOT) else ""


def pytest_collection_modifyitems(items):
    """Marks what runs against the clock, and lets the longest begin first."""
    for item in items:
        if _name(item).startswith(REALTIME):
            item.add_marker(pytest.mark.realtime)
    beginnings = (*LONGEST, "")
    items.sort(key=lambda item: [_name(item).startswith(b) for b in beginnings].index(True))
