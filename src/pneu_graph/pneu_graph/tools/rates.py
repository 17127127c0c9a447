# SPDX-License-Identifier: Apache-2.0
"""The figures of `topic hz` and `topic bw`."""

import collections
import itertools
import math


class Rate:
    """How often messages come.

    Args:
        window: Messages to average over.
    """

    def __init__(self, window: int) -> None:
        self._times: collections.deque[float] = collections.deque(maxlen=window + 1)
        self._new = False

    def add(self, time_s: float, size: int) -> None:
        """Counts a message.

        Args:
            time_s: When it came, s.
            size: Its size, bytes.
        """
        self._times.append(time_s)
        self._new = True

    def text(self) -> str:
        """Returns the figures; empty where nothing new has come."""
        if not self._new or len(self._times) < 2:
            return ""
        self._new = False
        times = list(self._times)
        periods = [b - a for a, b in itertools.pairwise(times)]
        mean = sum(periods) / len(periods)
        deviation = math.sqrt(sum((p - mean) ** 2 for p in periods) / len(periods))
        rate = 1.0 / mean if mean > 0.0 else math.inf
        return (
            f"average rate: {rate:.3f}\n\tmin: {min(periods):.3f}s max: {max(periods):.3f}s"
            f" std dev: {deviation:.5f}s window: {len(periods)}"
        )


class Bandwidth:
    """How many bytes come.

    Args:
        window: Messages to average over.
    """

    def __init__(self, window: int) -> None:
        self._messages: collections.deque[tuple[float, int]] = collections.deque(maxlen=window)

    def add(self, time_s: float, size: int) -> None:
        """Counts a message.

        Args:
            time_s: When it came, s.
            size: Its size, bytes.
        """
        self._messages.append((time_s, size))

    def text(self) -> str:
        """Returns the figures; empty where too little has come."""
        if len(self._messages) < 2:
            return ""
        sizes = [size for _, size in self._messages]
        span = self._messages[-1][0] - self._messages[0][0]
        # the first message marks the beginning; its bytes came before
        rate = sum(sizes[1:]) / span if span > 0.0 else math.inf
        return (
            f"{_bytes(rate)}/s from {len(sizes)} messages\n"
            f"\tMessage size mean: {_bytes(sum(sizes) / len(sizes))}"
            f" min: {_bytes(min(sizes))} max: {_bytes(max(sizes))}"
        )


def _bytes(count: float) -> str:
    for unit in ("B", "KB"):
        if count < 1000.0:
            return f"{count:.0f} B" if unit == "B" else f"{count:.2f} KB"
        count /= 1000.0
    return f"{count:.2f} MB"
