# SPDX-License-Identifier: Apache-2.0
"""Two processes that exchange messages: latency, round trip, messages per second.

Stacks take turns in short rounds of one run, so that what else the machine does falls on all.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from benchmarks.graph.processes import (
    OURS,
    RAW,
    REAL,
    Program,
    environment,
    has_ros,
    quantiles,
    running,
    without_ros,
)
from benchmarks.report import Table

KINDS = {"FluidPressure": "FluidPressure", "JointState": "JointState, 7 joints"}
NAMES = {RAW: "raw Cyclone", OURS: "pneu", REAL: "rclpy"}
ENDS = {
    RAW: "benchmarks.graph.raw_ends",
    OURS: "benchmarks.graph.ros_ends",
    REAL: "benchmarks.graph.ros_ends",
}


def stacks() -> tuple[str, ...]:
    """Stacks that can be measured here."""
    return (RAW, OURS, REAL) if has_ros() else (RAW, OURS)


@contextlib.contextmanager
def pairs(kind: str, *roles: str) -> Iterator[dict[str, tuple[Program, ...]]]:
    """Both ends of every stack, each pair in a domain of its own; idle until they are asked."""
    with contextlib.ExitStack() as stack:
        found: dict[str, tuple[Program, ...]] = {}
        for name in stacks():
            variables = environment(name)
            found[name] = tuple(
                stack.enter_context(running("-m", ENDS[name], name, r, kind, variables=variables))
                for r in roles
            )
        yield found


def latency(quick: bool) -> Table:
    """Publish to callback, and round trip."""
    rounds, count = (2, 500) if quick else (6, 2000)
    table = Table(
        "Graph: latency between two processes",
        "One process publishes, the callback of the other publishes the message back, and the"
        " next one follows. Reliable, depth 10, a single-threaded executor on either side;"
        f" {rounds} rounds of {count} trips of every stack in turn. `pneu` is the embedded rclpy,"
        " `raw Cyclone` the Python package it is built on, without nodes and executor. The mark"
        " is half the round trip of the rclpy of ROS, which measured 970 us beside 243 us of raw"
        " Cyclone: twice that of raw Cyclone.",
        {
            "message": "message",
            "stack": "stack",
            "forth_p50": "to callback p50, us",
            "forth_p99": "p99, us",
            "round_p50": "round trip p50, us",
            "round_p99": "p99, us",
            "ratio": "round trip p50 / raw",
        },
    )
    without_ros(table)
    for kind, message in KINDS.items():
        with pairs(kind, "echo", "ping") as ends:
            forth: dict[str, list[float]] = {name: [] for name in ends}
            whole: dict[str, list[float]] = {name: [] for name in ends}
            for number in range(rounds + 1):
                for name, (_, ping) in ends.items():
                    ping.order(count=count)
                    trips = ping.answer(90.0)
                    if number:  # the first round warms up
                        forth[name] += trips["forth_ns"]
                        whole[name] += trips["round_ns"]
        for name in forth:
            (f50, f99), (r50, r99) = quantiles(forth[name]), quantiles(whole[name])
            row = {"forth_p50": f50, "forth_p99": f99, "round_p50": r50, "round_p99": r99}
            row = {key: 1e-3 * value for key, value in row.items()}
            row["ratio"] = r50 / quantiles(whole[RAW])[0]
            table.rows.append({"message": message, "stack": NAMES[name], **row})
    return table


def rate(quick: bool) -> Table:
    """Messages per second."""
    rounds, count = (1, 3000) if quick else (3, 20_000)
    table = Table(
        "Graph: messages per second between two processes",
        "One process publishes as fast as it can, reliable with all history kept, so that none is"
        " lost; from the first publish to the last callback. The best of"
        f" {rounds} rounds of {count} messages.",
        {
            "message": "message",
            "stack": "stack",
            "rate": "messages / s",
            "publish_us": "one publish, us",
            "ratio": "rate / raw",
        },
    )
    without_ros(table)
    for kind, message in KINDS.items():
        best: dict[str, tuple[float, float]] = {}
        with pairs(kind, "sink", "source") as ends:
            for number in range(rounds + 1):
                for name, (sink, source) in ends.items():
                    amount = count if number else 1000
                    sink.order(count=amount)
                    source.order(count=amount)
                    sent, got = source.answer(90.0), sink.answer(90.0)
                    found = (
                        1e9 * amount / (got["end_ns"] - sent["begin_ns"]),
                        1e-3 * sent["publish_ns"] / amount,
                    )
                    if number:  # the first round warms up
                        best[name] = max(best.get(name, found), found)
        for name, (per_s, publish_us) in best.items():
            row = {"rate": per_s, "publish_us": publish_us, "ratio": per_s / best[RAW][0]}
            table.rows.append({"message": message, "stack": NAMES[name], **row})
    return table
