# SPDX-License-Identifier: Apache-2.0
"""A control loop at 500 Hz and 1 kHz: how regular its ticks are, and how many are missed.

Beside each loop, in the same minute, runs a process that only sleeps until each tick: what it
misses the machine has taken, not the runtime. It is this module run as a program.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from benchmarks.graph.processes import (
    OURS,
    REAL,
    environment,
    has_ros,
    orders,
    quantiles,
    reply,
    running,
    without_ros,
)
from benchmarks.report import Table

RATES_HZ = (500.0, 1000.0)
ENDS = "benchmarks.graph.ros_ends"


@dataclass
class Ticks:
    """How regular ticks were.

    Attributes:
        ticks: How many.
        missed: How many more were due.
        p50_us: Median of how far a period is off, us.
        p99_us: Its 99th percentile, us.
        worst_us: Its largest value, us.
    """

    ticks: int
    missed: int
    p50_us: float
    p99_us: float
    worst_us: float

    @classmethod
    def of(cls, times_ns: list[int], period_s: float) -> Ticks:
        """From the times at which ticks began."""
        off_us = np.abs(np.diff(times_ns) * 1e-3 - period_s * 1e6)
        due = round((times_ns[-1] - times_ns[0]) * 1e-9 / period_s) + 1
        p50, p99 = quantiles(off_us)
        return cls(len(times_ns), max(due - len(times_ns), 0), p50, p99, float(off_us.max()))


def sleeper() -> None:
    """Sleeps until each tick; a tick that is over is skipped, as a timer does."""
    for order in orders():
        period_s, times = 1.0 / order["rate_hz"], []
        begin_s = due_s = time.monotonic()
        cpu_s = time.process_time()
        while due_s - begin_s < order["duration_s"]:
            now_s = time.monotonic()
            due_s += period_s * max(1.0, np.ceil((now_s - due_s) / period_s))
            time.sleep(max(due_s - time.monotonic(), 0.0))
            times.append(time.monotonic_ns())
        cpu_s = time.process_time() - cpu_s
        reply(**Ticks.of(times, period_s).__dict__, cpu_s=cpu_s)


def measure(quick: bool) -> Table:
    """Measures the loop on every stack there is."""
    duration_s = 5.0 if quick else 60.0
    table = Table(
        f"Graph: a control loop for {duration_s:g} s",
        "A timer on the steady clock; each tick takes the newest FluidPressure from another process"
        " and sends it a voltage by PID. `Off` is how far a period is from its nominal length. A"
        " process that only sleeps until each tick runs at the same time: what it misses the"
        " machine has taken.",
        {
            "rate_hz": "rate, Hz",
            "stack": "loop",
            "ticks": "ticks",
            "missed": "missed",
            "p50_us": "off p50, us",
            "p99_us": "off p99, us",
            "worst_us": "off at worst, us",
            "cpu": "CPU of a core, %",
        },
    )
    without_ros(table)
    for rate_hz in RATES_HZ:
        order = {"rate_hz": rate_hz, "duration_s": duration_s}
        for stack in (OURS, REAL) if has_ros() else (OURS,):
            variables = environment(stack)
            with (
                running("-m", ENDS, stack, "plant", variables=variables),
                running("-m", ENDS, stack, "controller", variables=variables) as loop,
                running("-m", "benchmarks.graph.loops") as alone,
            ):
                # The first second finds the other end and warms up; it does not count.
                loop.order(rate_hz=rate_hz, duration_s=1.0)
                if loop.answer()["last_pa"] == 300e3:
                    raise RuntimeError("the control loop gets no readings")
                loop.order(**order)
                alone.order(**order)
                for name, program in ((stack, loop), ("sleeps only", alone)):
                    found = program.answer(duration_s + 30.0)
                    found["cpu"] = 100.0 * found.pop("cpu_s") / duration_s
                    table.rows.append({"rate_hz": rate_hz, "stack": name, **found})
    return table


if __name__ == "__main__":
    sleeper()
