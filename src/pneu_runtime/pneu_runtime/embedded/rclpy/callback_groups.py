# SPDX-License-Identifier: Apache-2.0
"""Which callbacks may run at the same time."""

import weakref
from threading import Lock
from typing import Any


class CallbackGroup:
    """Base of the callback groups. A group says whether one more callback of it may start."""

    def __init__(self) -> None:
        self.entities: set[weakref.ref[Any]] = set()

    def add_entity(self, entity: Any) -> None:
        """Put an entity into the group.

        Args:
            entity: A timer, subscription, service, client, guard condition or waitable.
        """
        # the references discard themselves, or entities made in passing would pile up
        self.entities.add(weakref.ref(entity, self.entities.discard))

    def has_entity(self, entity: Any) -> bool:
        """Say whether an entity is in the group.

        Args:
            entity: The entity.

        Returns:
            bool: Whether it is.
        """
        return weakref.ref(entity) in self.entities

    def can_execute(self, entity: Any) -> bool:
        """Say whether a callback of an entity may start now.

        Args:
            entity: The entity.

        Returns:
            bool: Whether it may.
        """
        raise NotImplementedError

    def beginning_execution(self, entity: Any) -> bool:
        """Ask to start a callback of an entity.

        Args:
            entity: The entity.

        Returns:
            bool: Whether it may start; then `ending_execution` must follow.
        """
        raise NotImplementedError

    def ending_execution(self, entity: Any) -> None:
        """Say that a callback of an entity has ended.

        Args:
            entity: The entity.
        """
        raise NotImplementedError


class ReentrantCallbackGroup(CallbackGroup):
    """All callbacks of the group may run at the same time, also several of one entity."""

    def can_execute(self, entity: Any) -> bool:
        """Say whether a callback may start now.

        Args:
            entity: The entity.

        Returns:
            bool: True.
        """
        return True

    def beginning_execution(self, entity: Any) -> bool:
        """Ask to start a callback.

        Args:
            entity: The entity.

        Returns:
            bool: True.
        """
        return True

    def ending_execution(self, entity: Any) -> None:
        """Say that a callback has ended.

        Args:
            entity: The entity.
        """


class MutuallyExclusiveCallbackGroup(CallbackGroup):
    """One callback of the group runs at a time."""

    def __init__(self) -> None:
        super().__init__()
        self._active_entity: Any = None
        self._lock = Lock()

    def can_execute(self, entity: Any) -> bool:
        """Say whether a callback may start now.

        Args:
            entity: The entity.

        Returns:
            bool: Whether no other callback of the group runs.
        """
        return self._active_entity is None

    def beginning_execution(self, entity: Any) -> bool:
        """Ask to start a callback.

        Args:
            entity: The entity.

        Returns:
            bool: Whether no other callback of the group runs.
        """
        with self._lock:
            if self._active_entity is None:
                self._active_entity = entity
                return True
            return False

    def ending_execution(self, entity: Any) -> None:
        """Say that a callback has ended.

        Args:
            entity: The entity whose callback it was.
        """
        with self._lock:
            if self._active_entity is not entity:
                raise RuntimeError("a callback ended that its callback group had not let start")
            self._active_entity = None
