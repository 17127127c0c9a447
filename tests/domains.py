# SPDX-License-Identifier: Apache-2.0
"""Domains for tests that put nodes on the network: those that run side by side never share one."""

import os
import random


def own_domain_id():
    """A domain at random, out of the share of this worker of pytest-xdist."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    return 1 + 25 * (worker % 4) + random.SystemRandom().randrange(25)
