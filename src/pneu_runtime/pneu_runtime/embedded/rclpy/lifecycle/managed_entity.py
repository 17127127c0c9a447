# SPDX-License-Identifier: Apache-2.0
"""What follows the transitions of a managed node."""

import functools
from collections.abc import Callable
from typing import Any

from rclpy.lifecycle.state_machine import LifecycleState, TransitionCallbackReturn


class ManagedEntity:
    """Something that a managed node takes along through its transitions; all succeed here."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Configure.

        Args:
            state: State the node comes from.
        """
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Undo the configuration.

        Args:
            state: State the node comes from.
        """
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End.

        Args:
            state: State the node comes from.
        """
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start to work.

        Args:
            state: State the node comes from.
        """
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop working.

        Args:
            state: State the node comes from.
        """
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Recover from an error; what does not succeed ends the node's life.

        Args:
            state: State the node comes from.
        """
        return TransitionCallbackReturn.SUCCESS


class SimpleManagedEntity(ManagedEntity):
    """An entity that is either enabled (the node is active) or not."""

    def __init__(self) -> None:
        self._enabled = False

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Enable.

        Args:
            state: State the node comes from.
        """
        self._enabled = True
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Disable.

        Args:
            state: State the node comes from.
        """
        self._enabled = False
        return TransitionCallbackReturn.SUCCESS

    @property
    def is_activated(self) -> bool:
        """Whether the entity is enabled."""
        return self._enabled

    @staticmethod
    def when_enabled(
        wrapped: Callable[..., Any] | None = None,
        *,
        when_not_enabled: Callable[[], Any] | None = None,
    ) -> Any:
        """Decorate a method so that it does nothing while the entity is not enabled.

        Args:
            wrapped: The method.
            when_not_enabled: Called instead, without arguments.
        """

        def decorator(method: Callable[..., Any]) -> Callable[..., Any]:
            @functools.wraps(method)
            def guarded(self: "SimpleManagedEntity", *args: Any, **kwargs: Any) -> Any:
                if self._enabled:
                    return method(self, *args, **kwargs)
                if when_not_enabled is not None:
                    when_not_enabled()
                return None

            return guarded

        return decorator if wrapped is None else decorator(wrapped)
