# SPDX-License-Identifier: Apache-2.0
"""`pneu stop` on the graph: who is found and does not answer is not taken for stopped."""

import os
import subprocess
import sys

import pytest

from tests.graph_fixtures import domain, graph  # isort: skip

import rclpy
from std_srvs.srv import Trigger

pytestmark = pytest.mark.realtime

__all__ = ["domain", "graph"]  # fixtures


def answer(request, response):
    response.success, response.message = True, "as the test has it"
    return response


def test_a_bridge_whose_service_is_not_reached_is_not_confirmed(graph, tmp_path):
    if "embedded" not in rclpy.__file__:
        pytest.skip("only a service of the embedded runtime can be taken apart")
    graph.probe.create_service(Trigger, "/near/valve_bridge/e_stop", answer)
    far = graph.probe.create_service(Trigger, "/far/valve_bridge/e_stop", answer)
    if not hasattr(far, "_end"):
        pytest.skip("takes a service of the embedded rclpy apart")
    far._end._writer.close()  # as of another vendor: it is listed, and cannot be called
    done = subprocess.run(
        [sys.executable, "-m", "pneu_common.cli", "stop"],
        env=os.environ | {"PNEU_RUN_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.stdout.splitlines() == [
        "/near/valve_bridge: safe, as the test has it",
        "/far/valve_bridge: NOT CONFIRMED, its service is not reached",
    ]
    assert done.returncode == 1
