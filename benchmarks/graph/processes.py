# SPDX-License-Identifier: Apache-2.0
"""The processes of a graph benchmark: started in a domain of their own, asked, timed and ended.

An end (`ros_ends`, `raw_ends`, `bridge_probe`) takes one JSON object per line and answers each with
one; it ends when its standard input does.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import random
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.report import ROOT, Table

OURS, REAL, RAW = "pneu", "rclpy", "raw"
"""Stacks: our embedded runtime, the rclpy of ROS, and Cyclone DDS as pip brings it."""


def has_ros() -> bool:
    """Whether the rclpy of ROS can be imported here."""
    spec = importlib.util.find_spec("rclpy")
    return spec is not None and spec.origin is not None


def without_ros(table: Table) -> None:
    """Says in a table that the rclpy of ROS is not beside ours, where that is so."""
    if not has_ros():
        table.notes.append("The rclpy of ROS is not installed here: left out.")


def environment(stack: str = OURS) -> dict[str, str]:
    """Variables for processes that shall meet each other, on loopback, and nobody else."""
    return {
        **os.environ,
        "ROS_DOMAIN_ID": str(random.SystemRandom().randrange(1, 101)),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "PNEU_RCLPY": "ros" if stack == REAL else "embedded",
    }


class Program:
    """A running program."""

    def __init__(self, words: Sequence[str], variables: dict[str, str], asked: bool) -> None:
        self.name = " ".join(word for word in words if not word.startswith("-"))
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  closed with the program
        self._rest = b""
        self._process = subprocess.Popen(
            [sys.executable, *words],
            cwd=ROOT,
            env=variables,
            stdin=subprocess.PIPE if asked else subprocess.DEVNULL,
            stdout=subprocess.PIPE if asked else self._said,
            stderr=self._said,
        )

    def order(self, **order: Any) -> None:
        """Sends an order."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(order).encode() + b"\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            raise RuntimeError(f"{self.name} ended: {self.last_words()}") from None

    def answer(self, timeout_s: float = 60.0) -> dict[str, Any]:
        """Waits for the answer to an order."""
        assert self._process.stdout is not None
        end = time.monotonic() + timeout_s
        while b"\n" not in self._rest:
            left = end - time.monotonic()
            if left <= 0.0 or not select.select([self._process.stdout], [], [], left)[0]:
                raise RuntimeError(f"{self.name}: no answer within {timeout_s:g} s")
            part = os.read(self._process.stdout.fileno(), 1 << 16)
            if not part:
                raise RuntimeError(f"{self.name} ended: {self.last_words()}")
            self._rest += part
        line, _, self._rest = self._rest.partition(b"\n")
        return dict(json.loads(line))

    def wait(self, condition: Callable[[], bool], timeout_s: float = 60.0) -> None:
        """Waits for something that this program brings about."""
        end = time.monotonic() + timeout_s
        while not condition():
            if self._process.poll() is not None:
                raise RuntimeError(f"{self.name} ended: {self.last_words()}")
            if time.monotonic() > end:
                raise RuntimeError(f"{self.name}: not ready within {timeout_s:g} s")
            time.sleep(0.02)

    def cpu_s(self, with_children: bool = False) -> float:
        """Processor time so far, all threads, s; if asked, with that of all processes it started.

        Args:
            with_children: Whether to count those that it started and that still run.
        """
        pids = _family(self._process.pid) if with_children else (self._process.pid,)
        ticks = 0
        for pid in pids:
            stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
            fields = stat.rpartition(")")[2].split()
            ticks += int(fields[11]) + int(fields[12])
        return ticks / os.sysconf("SC_CLK_TCK")

    def last_words(self) -> str:
        """End of what it wrote."""
        self._process.wait(5.0)
        self._said.seek(0)
        return " ".join(self._said.read().decode(errors="replace").strip().splitlines()[-2:])

    def close(self) -> None:
        """Ends it."""
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(5.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._said):
            if stream is not None:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()


def _family(pid: int) -> Iterator[int]:
    """A process and all that it started, directly or not."""
    yield pid
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in path.read_text(encoding="utf-8").split():
            yield from _family(int(child))


@contextlib.contextmanager
def running(
    *words: str, variables: dict[str, str] | None = None, asked: bool = True
) -> Iterator[Program]:
    """Runs Python with these words; with `asked`, it takes orders and answers."""
    program = Program(words, variables or environment(), asked)
    try:
        yield program
    finally:
        program.close()


def orders() -> Iterator[dict[str, Any]]:
    """In an end: the orders as they come in."""
    for line in sys.stdin:
        yield json.loads(line)


def reply(**answer: Any) -> None:
    """In an end: answers an order."""
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


def quantiles(values: Sequence[float]) -> tuple[float, float]:
    """Median and 99th percentile."""
    p50, p99 = np.percentile(np.asarray(values), (50.0, 99.0))
    return float(p50), float(p99)
