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
    "tests/test_faults",
    "tests/test_graph",
    "tests/test_pressure_study",
)
"""Beginnings of the paths of tests that run against the clock."""

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items):
    """Marks what runs against the clock."""
    for item in items:
        path = item.path.resolve()
        if path.is_relative_to(ROOT) and str(path.relative_to(ROOT)).startswith(REALTIME):
            item.add_marker(pytest.mark.realtime)
