# SPDX-License-Identifier: Apache-2.0
"""The live graph between processes on this machine: latency, rates, a control loop, the bridge.

Where the rclpy of ROS can be imported, the same ends run on it beside ours.
"""

from __future__ import annotations

import os
import resource
import time
from pathlib import Path

from benchmarks.graph import bridge, exchange, loops
from benchmarks.report import Table

BUSY = (0, 1, 2, 5, 6, 7)
"""Columns of /proc/stat: user, nice, system, interrupts, and what a host took away."""
NOTABLE = 0.05


def measure(quick: bool = False) -> list[Table]:
    """Measures everything; `quick` takes a fraction of the time, and says less of rare stalls."""
    tables = []
    for part in (exchange.latency, exchange.rate, loops.measure, bridge.latencies, bridge.shares):
        begin_s, others_s = time.monotonic(), _others_s()
        table = part(quick)
        cores_s = (time.monotonic() - begin_s) * (os.cpu_count() or 1)
        share = (_others_s() - others_s) / cores_s
        if share > NOTABLE:
            table.notes.append(f"Other work took {100 * share:.0f} % of the machine meanwhile.")
        tables.append(table)
    return tables


def _others_s() -> float:
    """Processor time of all cores that was not this benchmark's, s; 0 where it is not known."""
    stat = Path("/proc/stat")
    if not stat.exists():
        return 0.0
    ticks = stat.read_text(encoding="utf-8").split("\n", 1)[0].split()[1:]
    busy_s = sum(int(ticks[column]) for column in BUSY) / os.sysconf("SC_CLK_TCK")
    for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN):
        usage = resource.getrusage(who)
        busy_s -= usage.ru_utime + usage.ru_stime
    return busy_s
