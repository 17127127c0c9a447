# SPDX-License-Identifier: Apache-2.0
"""The live graph between processes on this machine: latency, rates, a control loop, the bridge.

Where the rclpy of ROS can be imported, the same ends run on it beside ours.
"""

from __future__ import annotations

import os

from benchmarks.graph import bridge, exchange, loops
from benchmarks.report import Table


def measure(quick: bool = False) -> list[Table]:
    """Measures everything; `quick` takes a fraction of the time, and says less of rare stalls."""
    load = os.getloadavg()[0]
    tables = [
        exchange.latency(quick),
        exchange.rate(quick),
        loops.measure(quick),
        bridge.latencies(quick),
        bridge.shares(quick),
    ]
    if load > 0.5 * (os.cpu_count() or 1):
        for table in tables:
            table.notes.append(f"Other work was running: a load of {load:.1f} when it began.")
    return tables
