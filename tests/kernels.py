# SPDX-License-Identifier: Apache-2.0
"""Waiting for kernels that another process compiles, see `tools/run_tests.py`."""

import os
import time
from pathlib import Path

WAITS_FOR = "PNEU_TESTS_WAIT_FOR"
"""Variable with the file that is there once they are compiled; not set where nobody does that."""
LONGEST_S = 600.0


def wait_until_compiled() -> None:
    """Waits for that file, if need be."""
    path = os.environ.get(WAITS_FOR)
    begun_s = time.monotonic()
    while path and not Path(path).exists() and time.monotonic() - begun_s < LONGEST_S:
        time.sleep(0.1)
