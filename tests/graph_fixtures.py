# SPDX-License-Identifier: Apache-2.0
"""Fixtures for tests of nodes: each file on a domain of its own, each test on a graph of its own.

They count for the file that imports them, and names them in ``__all__``.
"""

import contextlib
import threading

import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from tests.live_graph import own_domain, running_graph


@pytest.fixture(scope="module", autouse=True)
def domain():
    """A domain that other tests do not use."""
    with own_domain():
        yield


@pytest.fixture
def graph():
    """A probe, and whatever nodes a test adds."""
    with running_graph() as graph:
        yield graph


@contextlib.contextmanager
def spinning(executor_class=SingleThreadedExecutor):
    """A context beside the default one, and an executor of it that spins in a thread."""
    context = rclpy.context.Context()
    rclpy.init(args=[], context=context)
    executor = executor_class(context=context)
    thread = threading.Thread(target=executor.spin, daemon=True)
    thread.start()
    yield context, executor
    executor.shutdown()
    thread.join(10.0)
    context.try_shutdown()


@pytest.fixture
def outside():
    """A node in a context beside the default one, which a command has for itself."""
    with spinning() as (context, executor):
        node = rclpy.create_node("outside", context=context)
        executor.add_node(node)
        yield node
        executor.remove_node(node)
        node.destroy_node()
