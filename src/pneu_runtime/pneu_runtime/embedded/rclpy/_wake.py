# SPDX-License-Identifier: Apache-2.0
"""How an entity without an endpoint of its own tells those who wait for it."""

from collections.abc import Callable


class Wakeable:
    """Base of guard conditions and timers: knows the waiting executors' wake functions."""

    def __init__(self) -> None:
        # replaced, never changed in place: read without a lock by whoever triggers
        self._wakers: tuple[Callable[[], None], ...] = ()

    def _add_waker(self, waker: Callable[[], None]) -> None:
        self._wakers = (*self._wakers, waker)

    def _remove_waker(self, waker: Callable[[], None]) -> None:
        self._wakers = tuple(one for one in self._wakers if one != waker)

    def _wake(self) -> None:
        for waker in self._wakers:
            waker()
