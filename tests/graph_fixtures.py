# SPDX-License-Identifier: Apache-2.0
"""Fixtures for tests of nodes: each file on a domain of its own, each test on a graph of its own.

They count for the file that imports both, and names them in ``__all__``.
"""

import pytest
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
