# SPDX-License-Identifier: Apache-2.0
"""Timing, and a description of the machine that names its kind only."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np


def best_s(
    run: Callable[[], object],
    prepare: Callable[[], object] | None = None,
    budget_s: float = 1.0,
    least: int = 3,
) -> float:
    """Shortest wall time of many runs, s: what other work on the machine disturbs least.

    Args:
        run: What is timed; its first call, which may compile, does not count.
        prepare: Called before each run, outside the clock.
        budget_s: Time to spend.
        least: Runs to make at least.
    """
    best, count, end = np.inf, -1, 0.0
    while count < least or time.perf_counter() < end:
        if prepare is not None:
            prepare()
        started = time.perf_counter()
        run()
        taken = time.perf_counter() - started
        if count < 0:
            end = time.perf_counter() + budget_s
        else:
            best = min(best, taken)
        count += 1
    return float(best)


def machine() -> dict[str, Any]:
    """Kind of processor and versions that decide the figures."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    fields = dict(line.split(":", 1) for line in lines if ":" in line)
    fields = {key.strip(): value.strip() for key, value in fields.items()}
    flags = fields.get("flags", "").split()
    widest = next((f for f in ("avx512f", "avx2", "avx") if f in flags), None)
    return {
        "processor": fields.get("model name") or platform.machine(),
        "cores": os.cpu_count(),
        "vectors": {"avx512f": "AVX-512", "avx2": "AVX2", "avx": "AVX", None: "?"}[widest],
        "Python": platform.python_version(),
        "NumPy": np.__version__,
        "Numba": numba.__version__,
    }
