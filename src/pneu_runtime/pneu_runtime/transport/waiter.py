# SPDX-License-Identifier: Apache-2.0
"""Waiting for data in the thread that will handle it.

A DDS waitset is woken by the library's receive thread and returns in the waiting thread: one switch
of threads, and no Python code on a thread of the library. It stays woken as long as there is
something to take, so that nothing is lost between two waits.
"""

import ctypes as ct
import threading
import time
from typing import Protocol

from pneu_runtime.transport import dds

# Python runs the handlers of signals only between its own instructions, and only in its main
# thread; this is how long the main thread may stay inside the library.
_MAIN_THREAD_SLICE_NS = 50_000_000


class Source(Protocol):
    """Something that a `Waiter` waits for."""

    @property
    def wait_entity(self) -> int:
        """The DDS entity that is triggered; 0 once it is closed."""
        ...

    def is_ready(self) -> bool:
        """Returns whether there is something to take, when the entity is triggered."""
        ...


class Waiter:
    """Waits for several sources at a time. Any thread may call any method."""

    def __init__(self) -> None:
        self._set = dds.checked(dds.create_waitset(dds.LIBRARY), "a waitset")
        self._guard = dds.checked(dds.create_guard(dds.LIBRARY), "a guard condition")
        dds.checked(dds.waitset_attach(self._set, self._guard, 0), "to attach a guard condition")
        self._lock = threading.Lock()
        self._sources: dict[int, list[Source]] = {}
        self._waiting = 0
        self._closed = False

    def attach(self, source: Source) -> None:
        """Starts to wait for a source; does nothing where it already does.

        Args:
            source: A subscription, client, server, event source or graph source.
        """
        entity = source.wait_entity
        with self._lock:
            if self._closed or not entity:
                return
            present = self._sources.setdefault(entity, [])
            if source in present:
                return
            if not present:
                code = dds.waitset_attach(self._set, entity, entity)
                if code < 0:
                    del self._sources[entity]
                    if code == dds.RETCODE_BAD_PARAMETER:  # closed meanwhile
                        return
                    dds.checked(code, "to attach a source to a waitset")
            # a new list, because `wait` walks over the old one without the lock
            self._sources[entity] = [*present, source]

    def detach(self, source: Source) -> None:
        """Stops to wait for a source; does nothing where it does not.

        Args:
            source: The source.
        """
        with self._lock:
            for entity, present in list(self._sources.items()):
                if source not in present:
                    continue
                rest = [one for one in present if one is not source]
                if rest:
                    self._sources[entity] = rest
                else:
                    del self._sources[entity]
                    if not self._closed:
                        # fails where the entity was deleted before, which detached it
                        dds.waitset_detach(self._set, entity)

    def wait(self, timeout_s: float | None = None) -> list[Source]:
        """Waits until a source has something, `wake` is called, or time is up.

        Args:
            timeout_s: Longest time to wait [s]; None for ever, 0 only to look.

        Returns:
            list: the sources that have something to take; may be empty.
        """
        with self._lock:
            if self._closed:
                return []
            self._waiting += 1
            room = len(self._sources) + 1
        try:
            return self._wait(timeout_s, room)
        finally:
            with self._lock:
                self._waiting -= 1

    def _wait(self, timeout_s: float | None, room: int) -> list[Source]:
        left_ns = dds.INFINITY_NS
        if timeout_s is not None:
            left_ns = min(max(int(timeout_s * 1e9), 0), dds.INFINITY_NS)
        slice_ns = left_ns
        if threading.current_thread() is threading.main_thread():
            slice_ns = _MAIN_THREAD_SLICE_NS
        triggered = (ct.c_ssize_t * room)()
        while True:
            started = time.monotonic_ns()
            count = dds.waitset_wait(self._set, triggered, room, min(left_ns, slice_ns))
            if count < 0:
                if self._closed:
                    return []
                dds.checked(count, "to wait")
            if count > 0:
                return self._ready(triggered[: min(count, room)])
            if left_ns != dds.INFINITY_NS:
                left_ns -= time.monotonic_ns() - started
                if left_ns <= 0:
                    return []

    def _ready(self, entities: list[int]) -> list[Source]:
        ready: list[Source] = []
        for entity in entities:
            if entity == 0:
                dds.set_guard(self._guard, False)
                continue
            present = self._sources.get(entity, ())
            if len(present) == 1 and not hasattr(present[0], "status_mask"):
                ready.append(present[0])
            else:
                ready += [source for source in present if source.is_ready()]
        return ready

    def wake(self) -> None:
        """Makes one `wait`, of now or the next, return. May be called from a signal handler."""
        dds.set_guard(self._guard, True)  # of a closed waiter: refused by the library, no harm

    def close(self) -> None:
        """Ends all waiting, and frees what it took."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            self._sources.clear()
        while self._waiting:
            self.wake()
            time.sleep(0.001)
        dds.delete(self._set)
        dds.delete(self._guard)
