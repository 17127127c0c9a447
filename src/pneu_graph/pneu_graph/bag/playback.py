# SPDX-License-Identifier: Apache-2.0
"""When a recorded message is due: rate, pause, stepping, and the time that goes with it."""

import threading
import time


class Pacer:
    """Turns recorded time into waiting. Pause, resume and step may come from another thread.

    Args:
        rate: Recorded seconds per second, > 0.
        paused: Begin paused.
    """

    def __init__(self, rate: float, paused: bool = False) -> None:
        self._rate = rate
        self._changed = threading.Condition()
        self._paused = paused
        self._steps = 0
        self._stopped = False
        self._recorded_ns = 0
        self._wall_s = time.monotonic()

    @property
    def paused(self) -> bool:
        """Whether it stands."""
        return self._paused

    def begin(self, recorded_ns: int) -> None:
        """Sets where in the recording we are now.

        Args:
            recorded_ns: Recorded time, ns.
        """
        with self._changed:
            self._recorded_ns, self._wall_s = recorded_ns, time.monotonic()

    def now_ns(self) -> int:
        """Returns the recorded time that is now, ns."""
        with self._changed:
            return self._now_ns()

    def pause(self) -> None:
        """Stops the time."""
        with self._changed:
            self.begin_here()
            self._paused = True

    def resume(self) -> None:
        """Lets the time go on."""
        with self._changed:
            if self._paused:
                self._paused = False
                self._wall_s = time.monotonic()
                self._changed.notify_all()

    def step(self) -> bool:
        """Lets one message through while paused.

        Returns:
            Whether it is paused.
        """
        with self._changed:
            self._steps += self._paused
            self._changed.notify_all()
            return self._paused

    def stop(self) -> None:
        """Ends all waiting."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def set_rate(self, rate: float) -> None:
        """Changes the rate from now on.

        Args:
            rate: Recorded seconds per second, > 0.
        """
        with self._changed:
            self.begin_here()
            self._rate = rate
            self._changed.notify_all()

    def begin_here(self) -> None:
        """Makes now the place from which time is counted. For holders of the lock."""
        self._recorded_ns, self._wall_s = self._now_ns(), time.monotonic()

    def wait_until(self, recorded_ns: int, steppable: bool = True) -> bool:
        """Waits until a recorded time is due.

        Args:
            recorded_ns: Recorded time, ns.
            steppable: Whether a step lets it through while paused; false for clock ticks.

        Returns:
            Whether it is due; false where playing has been stopped, or where it is no longer
            worth waiting because a step has moved the time on.
        """
        with self._changed:
            while not self._stopped:
                if self._paused:
                    if steppable and self._steps:
                        self._steps -= 1
                        self._recorded_ns = recorded_ns
                        return True
                    if not steppable and self._steps:
                        return False
                    self._changed.wait()
                    continue
                rest_s = (recorded_ns - self._now_ns()) / 1e9 / self._rate
                if rest_s <= 0.0:
                    return True
                self._changed.wait(rest_s)
            return False

    def _now_ns(self) -> int:
        if self._paused:
            return self._recorded_ns
        return self._recorded_ns + round((time.monotonic() - self._wall_s) * 1e9 * self._rate)
