# SPDX-License-Identifier: Apache-2.0
"""A condition that any thread triggers and an executor answers."""

from collections.abc import Callable
from types import TracebackType
from typing import Any

from rclpy._rclpy_pybind11 import InvalidHandle
from rclpy._wake import Wakeable
from rclpy.callback_groups import CallbackGroup
from rclpy.context import Context
from rclpy.utilities import get_default_context


class GuardCondition(Wakeable):
    """Wakes an executor, which runs the callback. Made by `Node.create_guard_condition`.

    Args:
        callback: Called without arguments after a trigger; may be a coroutine function.
        callback_group: The callback group it runs in.
        context: The context it belongs to; the default one where not given.
    """

    def __init__(
        self,
        callback: Callable[[], Any] | None,
        callback_group: CallbackGroup | None,
        context: Context | None = None,
    ) -> None:
        super().__init__()
        self._context = get_default_context() if context is None else context
        self.callback = callback
        self.callback_group = callback_group
        self._executor_event = False
        self._triggered = False
        self._destroyed = False

    @property
    def handle(self) -> "GuardCondition":
        """What a wait set takes."""
        return self

    def trigger(self) -> None:
        """Let the callback run once. Triggers that come before it ran count as one."""
        if self._destroyed:
            raise InvalidHandle("cannot use Destroyable because destruction was requested")
        self._triggered = True
        self._wake()

    def _receive(self) -> bool | None:
        """Whether it was triggered; asking clears it."""
        triggered, self._triggered = self._triggered, False
        return True if triggered and not self._destroyed else None

    def _call(self, received: bool, executor: Any) -> Any:
        """Call the callback; what it returns."""
        return None if self.callback is None else self.callback()

    def destroy(self) -> None:
        """Make the condition unusable. Users call `Node.destroy_guard_condition`."""
        self._destroyed = True

    def __enter__(self) -> "GuardCondition":
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc_val: BaseException | None,
        exc_tb: TracebackType | None,
    ) -> None:
        self.destroy()
