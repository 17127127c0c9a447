# SPDX-License-Identifier: Apache-2.0
"""A device's clock in terms of this machine's: when, by ours, a device took what it stamps by its.

Each reading arrives later than it was taken, by the way over the bus and by whatever the machine
was busy with meanwhile. That delay is never less than the way itself, so the smallest difference
of arrival and device time over many readings is the offset of the clocks, and all that is above it
was lateness. Differences of stamps are then those of the device's clock, however late the machine
was. The offset is followed slowly where clocks drift apart, and never in a jump; only a clock that
was set or began anew is mapped anew, and that is told.
"""

import math
from collections import deque

SETTLE_S = 0.2
"""For how long delays are watched before the first stamp, and again after a reconnection: device
time, s."""

SETTLE_READS = 20
"""How many new samples must have come by then."""

JUMP_S = 0.02
"""A sample from so far ahead of the present, or clocks apart by more, is no drift: one was set."""

STILL_S = 1e-3
"""Below this an offset is left alone: it is the scatter of the quickest ways, s."""

WINDOW_S = 10.0
"""The quickest way is looked for over one to two of these, s: long, since what looks like drift for
a short time is lateness, and stamps that followed it would be bent."""

CATCH_UP_S = 30.0
"""Over about this time an offset is taken up, s."""

MOST_DRIFT = 200e-6
"""Most by which stamps may run faster or slower than the device's clock: two quartz clocks differ
by less. A device that loses more has stood still, which is told but not made up for: stamps that
did would falsify the delays and rates in a recording."""


class DeviceClock:
    """The mapping, and how it came about. Times are integers of ns, but for the steady clock's.

    Attributes:
        restarts: How often the clocks were mapped anew.
        behind_s: For how long the device's clock has stood still, as far as the quickest ways tell,
            since the clocks were mapped, s.
        drift: By how much stamps run faster than the device's clock at present, 1.
        told: What happened, for people; whoever tells it takes it out.
    """

    def __init__(self) -> None:
        """Knows nothing yet."""
        self.restarts = 0
        self.behind_s = 0.0
        self.told: deque[str] = deque(maxlen=8)
        self._anchor: tuple[int, int] | None = None  # device, ours
        self.drift = 0.0
        self._ours_less_steady_ns: int | None = None
        self._window_s = self._least_s = 0.0
        self._window_ns = self._before_ns = math.inf
        self._settle()

    @property
    def settled(self) -> bool:
        """Whether there are stamps."""
        return not self._settling

    def stamp(self, device_ns: int) -> int | None:
        """Returns a device time by our clock, ns; None while the clocks are being compared.

        Args:
            device_ns: Device time, ns.
        """
        return None if self._settling else self._ours(device_ns)

    def observe(self, device_ns: int, received_ns: int, steady_s: float) -> None:
        """Takes note of a new sample.

        Args:
            device_ns: Device time of the newest sample in an answer, ns.
            received_ns: When the answer was there by our clock, ns.
            steady_s: The same moment by the steady clock, which nobody sets, s.
        """
        less_ns = received_ns - round(1e9 * steady_s)
        before_ns, self._ours_less_steady_ns = self._ours_less_steady_ns, less_ns
        if before_ns is not None and abs(less_ns - before_ns) > 1e9 * JUMP_S:
            self.restart(f"this machine's clock was set by {1e-9 * (less_ns - before_ns):.3f} s")
        if self._settling:
            self._compare(device_ns, received_ns, steady_s)
            return
        late_ns = received_ns - self._ours(device_ns)
        if late_ns < -1e9 * JUMP_S:
            self.restart(f"the device's clock leapt ahead by {-1e-9 * late_ns:.3f} s")
            self._compare(device_ns, received_ns, steady_s)
            return
        self._follow(device_ns, late_ns, steady_s)

    def restart(self, why: str) -> None:
        """Forgets how the clocks compare.

        Args:
            why: For people.
        """
        self.restarts += 1
        self.told.append(why)
        self._anchor = None
        self._settle()

    def doubt(self) -> None:
        """Compares the clocks again, as after a connection was lost; what agrees is kept."""
        self._settle()

    def _settle(self) -> None:
        self._settling = True
        self._since_ns = 0
        self._seen_s = -math.inf
        self._reads = 0
        self._least_ns = math.inf  # arrival less device time

    def _compare(self, device_ns: int, received_ns: int, steady_s: float) -> None:
        """Looks for the quickest way, and maps the clocks when there was time to find one."""
        if steady_s - self._seen_s > SETTLE_S:
            # A device that stood still meanwhile is compared from when it goes on.
            self._settle()
            self._since_ns = device_ns
        self._seen_s = steady_s
        self._reads += 1
        self._least_ns = min(self._least_ns, received_ns - device_ns)
        if self._reads < SETTLE_READS or device_ns - self._since_ns < 1e9 * SETTLE_S:
            return
        compared_ns = device_ns + round(self._least_ns)
        if self._anchor is not None:
            apart_s = 1e-9 * (compared_ns - self._ours(device_ns)) - self.behind_s
            if abs(apart_s) > JUMP_S:
                self.restarts += 1
                self.told.append(f"the device's clock was set by {-apart_s:.3f} s meanwhile")
                self._anchor = None
        if self._anchor is None:
            self._anchor = device_ns, compared_ns
            self.drift = self.behind_s = self._least_s = 0.0
        self._settling = False
        self._window_s = steady_s
        self._window_ns = self._before_ns = math.inf

    def _follow(self, device_ns: int, late_ns: int, steady_s: float) -> None:
        """Takes up what the clocks have drifted apart, slowly."""
        self._window_ns = min(self._window_ns, late_ns)
        if steady_s - self._window_s < WINDOW_S:
            return
        least_s = 1e-9 * min(self._window_ns, self._before_ns)
        drifted_s = STILL_S + MOST_DRIFT * (steady_s - self._window_s)
        self._window_s, self._before_ns, self._window_ns = steady_s, self._window_ns, math.inf
        if abs(least_s - self._least_s) > drifted_s:
            self.behind_s = max(self.behind_s + least_s - self._least_s, 0.0)
        self._least_s = least_s
        apart_s = least_s - self.behind_s
        wanted = 0.0 if abs(apart_s) < STILL_S else apart_s / CATCH_UP_S
        # From here on at another pace, so that no stamp jumps.
        self._anchor = device_ns, self._ours(device_ns)
        self.drift = min(max(wanted, -MOST_DRIFT), MOST_DRIFT)

    def _ours(self, device_ns: int) -> int:
        assert self._anchor is not None
        since_ns = device_ns - self._anchor[0]
        return self._anchor[1] + since_ns + round(self.drift * since_ns)
