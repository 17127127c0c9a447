# SPDX-License-Identifier: Apache-2.0
"""How long tools look around, by the middleware of the process."""

import types

import pytest

from tests.graph_fixtures import domain, graph  # isort: skip
from tests.live_graph import wait_for  # isort: skip

from rclpy.node import Node

from pneu_graph.nodes import discovery
from pneu_graph.tools import session

__all__ = ["domain", "graph"]  # fixtures

pytestmark = pytest.mark.kernel_free

FAST, CYCLONE = "rmw_fastrtps_cpp", "rmw_cyclonedds_cpp"


@pytest.fixture
def middleware(monkeypatch):
    """Has the process believe that its middleware is another one."""

    def choose(name):
        monkeypatch.setattr(discovery, "get_rmw_implementation_identifier", lambda: name)

    return choose


def test_an_announcement_that_is_repeated_is_waited_for(middleware):
    middleware(CYCLONE)
    assert (discovery.patience_s(), discovery.patience_s(0.4)) == (1.5, 0.4)
    for name in (FAST, "rmw_of_tomorrow_cpp"):
        middleware(name)
        assert 4.0 < discovery.patience_s() < 6.0  # Fast DDS announces every 3 s
        assert 3.0 < discovery.patience_s(0.4) < discovery.patience_s()


class Times:
    """A clock for `settle` that goes on as it waits, with what happens at a time."""

    def __init__(self, monkeypatch):
        self.now_s = 0.0
        self.events = {}
        monkeypatch.setattr(session, "time", types.SimpleNamespace(monotonic=lambda: self.now_s))
        monkeypatch.setattr(session, "spin", self.spin)

    def spin(self, node, seconds):
        self.now_s += seconds
        for at_s in [at_s for at_s in self.events if at_s <= self.now_s]:
            self.events.pop(at_s)()


@pytest.fixture
def times(monkeypatch):
    return Times(monkeypatch)


@pytest.fixture
def looking(graph):
    """The node that looks around, which already sees another one."""
    graph.nodes.append(Node("other"))
    wait_for(lambda: "other" in graph.probe.get_node_names())
    return graph.probe


def test_a_node_that_is_announced_late_is_found(graph, looking, times, middleware):
    middleware(FAST)

    def come():
        graph.nodes.append(Node("late"))
        wait_for(lambda: "late" in looking.get_node_names())

    times.events[2.9] = come
    session.settle(looking)
    assert "late" in looking.get_node_names()
    assert times.now_s > 2.9


def test_a_middleware_that_is_quick_costs_little(looking, times, middleware):
    middleware(CYCLONE)
    session.settle(looking)
    assert times.now_s < 0.6


@pytest.mark.parametrize("name", [FAST, CYCLONE])
def test_what_is_looked_for_ends_the_wait(looking, times, middleware, name):
    middleware(name)
    session.settle(looking, lambda node: node is looking and times.now_s >= 0.2)
    assert 0.2 <= times.now_s < 0.3


def test_who_is_alone_waits_as_long_as_it_takes(graph, times, middleware):
    middleware(FAST)
    session.settle(graph.probe)
    assert times.now_s >= discovery.patience_s()
