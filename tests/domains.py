# SPDX-License-Identifier: Apache-2.0
"""Domains for tests that put nodes on the network: those that run side by side never share one."""

import os
import random

SHARE = "PNEU_TEST_SHARE"
"""Environment variable with the first share of a part of the tests; tools/run_tests.py sets it."""

SHARES, DOMAINS = 6, 16
"""Shares, and domains of each: those up to 101 keep clear of ephemeral ports."""


def own_domain_id():
    """A domain at random, out of the share of this worker of this part of the tests."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    share = (int(os.environ.get(SHARE, "0")) + worker) % SHARES
    return 1 + DOMAINS * share + random.SystemRandom().randrange(DOMAINS)
