# SPDX-License-Identifier: Apache-2.0
"""Times that tests measure against the clock: proven, too late, or the machine would not let them.

A time is proven when it is kept, whatever else the machine does; nothing is subtracted. Where it is
missed, the kernel is asked how long the threads concerned could run and had no CPU, and the lab how
long it stalled. What the machine explains raises `MachineStalledError`, on which the test is tried
again; if it still is so at the last try, the test counts as skipped, and the last line of the run
says that this time was not proven.
"""

import contextlib
import threading
import time
import warnings
from contextvars import ContextVar
from pathlib import Path

SAFE_WITHIN_S = 0.15
PATIENCE_S = 60.0
"""At least so long a test waits for what has to come about: processes may be slow to start on a
busy machine, and how soon is judged by `Watch`, never by patience coming to its end."""
STALLED_S = 0.1
"""A fixture that fails while the machine withholds processors for longer failed because of it."""
STALLED_SHARE = 0.25
"""The same for the share of the time in which the processors were withheld."""
PROPERTY = "safe after"
"""Under this name times go into the report of a test, s."""

NOT_PROVEN = "not proven"
"""How the reason of a test begins that is skipped because the machine was too busy for it."""

properties: ContextVar[list | None] = ContextVar("properties", default=None)
"""Properties of the report of the test that runs; conftest.py sets it."""


class MachineStalledError(Exception):
    """The machine was too busy for what was to be measured."""


def waited_s(pid):
    """How long that thread of a process has waited for a CPU that waited longest; 0 if it ended."""
    longest = 0
    for path in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        with contextlib.suppress(OSError):  # a thread, or the process, that has just ended
            longest = max(longest, int(path.read_text().split()[1]))
    return longest * 1e-9


class Watch:
    """Judges how soon something was done, from when it is made.

    What the machine may be excused for is only what keeps these processes from running.
    """

    def __init__(self, lab, pids):
        """Begins to watch.

        Args:
            lab: The emulated device, which is asked for its stalls.
            pids: The processes that have to run.
        """
        self._lab = lab
        self._waited_s = {pid: waited_s(pid) for pid in pids}

    def judge(self, at_s, begun_s, known_s=None, within_s=SAFE_WITHIN_S):
        """Notes a time that was kept; fails where the machine is no excuse for one that was not.

        Args:
            at_s: Steady time at which it was done.
            begun_s: Steady time before what happened.
            known_s: Steady time after it, where that is known.
            within_s: How soon it must be done, s; beyond `SAFE_WITHIN_S` the time is judged and not
                listed among those.
        """
        took_s = at_s - begun_s
        if took_s <= within_s:
            noted = properties.get()
            if noted is not None and within_s <= SAFE_WITHIN_S:
                noted.append((PROPERTY, took_s))
            return
        stalled_s = self.stalled_s(begun_s, at_s, known_s)
        text = f"safe after {took_s:.3f} s, of which the machine stalled for {stalled_s:.3f} s"
        assert took_s - stalled_s <= within_s, text
        raise MachineStalledError(text)

    def stalled_s(self, begun_s, at_s, known_s=None):
        """How long the machine kept the processes from running.

        Args:
            begun_s: Steady time before what happened.
            at_s: Steady time at which it was done.
            known_s: Steady time after what happened, where that is known.
        """
        stalled_s = sum(max(waited_s(pid) - s, 0.0) for pid, s in self._waited_s.items())
        for stall in self._lab.ask("status")["stalls"]:
            end_s = stall["begun_s"] + stall["seconds"]
            stalled_s += max(min(end_s, at_s) - max(stall["begun_s"], begun_s), 0.0)
        return stalled_s + (known_s or begun_s) - begun_s


class Stalls:
    """How long a thread of this process that wants to run is kept waiting, until it is closed.

    Attributes:
        longest_s: The longest such wait, s.
        withheld_s: The longest that no thread of this process ran meanwhile, s. Other waits are
            for the lock of the interpreter.
        total_s: The sum of these, s.
    """

    PAUSE_S = 0.0005

    def __init__(self, pause_s=PAUSE_S):
        """Begin.

        Args:
            pause_s: Interval at which the thread wants to run, s.
        """
        self.longest_s = self.withheld_s = self.total_s = 0.0
        self._pause_s = pause_s
        self._begun_s = time.monotonic()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()

    def _look(self):
        before_s, ran_s = time.monotonic(), time.process_time()
        while not self._end.wait(self._pause_s):
            late_s = max(time.monotonic() - before_s - self._pause_s, 0.0)
            withheld_s = max(late_s - (time.process_time() - ran_s), 0.0)
            self.longest_s = max(self.longest_s, late_s)
            self.withheld_s = max(self.withheld_s, withheld_s)
            self.total_s += withheld_s
            before_s, ran_s = time.monotonic(), time.process_time()

    def close(self):
        """End."""
        self._end.set()
        self._thread.join()

    def blame(self, error):
        """Raise `MachineStalledError` for an error if the machine explains it.

        Args:
            error: The error of something that had to come about in a time.
        """
        took_s = time.monotonic() - self._begun_s
        if self.withheld_s > STALLED_S or self.total_s > STALLED_SHARE * took_s:
            raise MachineStalledError(
                f"{error}; of {took_s:.2f} s the machine stalled for {self.total_s:.2f} s,"
                f" {self.withheld_s:.3f} s at a time"
            ) from error


class Processor:
    """How much of the machine's processors was free, from when it is made."""

    def __init__(self):
        self._idle, self._total = self._ticks()

    @staticmethod
    def _ticks():
        ticks = [int(n) for n in Path("/proc/stat").read_text().split("\n")[0].split()[1:9]]
        return ticks[3] + ticks[4], sum(ticks)  # idle and waiting for a disk; all

    def free(self):
        """The free share."""
        idle, total = self._ticks()
        return (idle - self._idle) / max(total - self._total, 1)


def in_good_time(attempt, tries=3):
    """Makes an attempt, again where the machine stalled meanwhile."""
    for left in reversed(range(tries)):
        try:
            return attempt()
        except MachineStalledError as error:
            warnings.warn(str(error), stacklevel=2)
            if not left:
                raise
            time.sleep(0.2)
    return None
