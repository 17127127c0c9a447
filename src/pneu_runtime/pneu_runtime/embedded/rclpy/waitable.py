# SPDX-License-Identifier: Apache-2.0
"""Things an executor waits for that are more than one endpoint: actions, QoS events, own ones."""

import weakref
from types import TracebackType
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.task import Future


class NumberOfEntities:
    """How many of each kind a waitable adds to a wait set. Kept for code that counts them.

    Args:
        num_subs: Subscriptions.
        num_gcs: Guard conditions.
        num_timers: Timers.
        num_clients: Clients.
        num_services: Services.
        num_events: Events.
    """

    __slots__ = (
        "num_clients",
        "num_events",
        "num_guard_conditions",
        "num_services",
        "num_subscriptions",
        "num_timers",
    )

    def __init__(
        self,
        num_subs: int = 0,
        num_gcs: int = 0,
        num_timers: int = 0,
        num_clients: int = 0,
        num_services: int = 0,
        num_events: int = 0,
    ) -> None:
        self.num_subscriptions = num_subs
        self.num_guard_conditions = num_gcs
        self.num_timers = num_timers
        self.num_clients = num_clients
        self.num_services = num_services
        self.num_events = num_events

    def _counts(self) -> tuple[int, ...]:
        return tuple(getattr(self, name) for name in self.__slots__)

    def __add__(self, other: "NumberOfEntities") -> "NumberOfEntities":
        total = NumberOfEntities()
        total += self
        total += other
        return total

    def __iadd__(self, other: "NumberOfEntities") -> "NumberOfEntities":
        for name in self.__slots__:
            setattr(self, name, getattr(self, name) + getattr(other, name))
        return self

    def __repr__(self) -> str:
        return f"NumberOfEntities{self._counts()}"


class WaitSet:
    """What a waitable waits for, collected before a wait and asked after it.

    The indices are counted per kind, as in rclpy. ``add_source`` takes an endpoint of the
    transport or whatever else a waiter of the transport takes.
    """

    def __init__(self) -> None:
        self.entities: dict[str, list[Any]] = {}
        self.ready: set[int] = set()

    def _add(self, kind: str, entity: Any) -> int:
        of_kind = self.entities.setdefault(kind, [])
        of_kind.append(entity)
        return len(of_kind) - 1

    def add_source(self, source: Any) -> int:
        """Wait for an endpoint of the transport.

        Args:
            source: What a waiter of the transport can attach.

        Returns:
            int: Its index for `is_ready`, kind "source".
        """
        return self._add("source", source)

    def add_subscription(self, subscription: Any) -> int:
        """Wait for a message.

        Args:
            subscription: A subscription or its handle.

        Returns:
            int: Its index for `is_ready`, kind "subscription".
        """
        return self._add("subscription", subscription)

    def add_client(self, client: Any) -> int:
        """Wait for a reply.

        Args:
            client: A client or its handle.

        Returns:
            int: Its index for `is_ready`, kind "client".
        """
        return self._add("client", client)

    def add_service(self, service: Any) -> int:
        """Wait for a request.

        Args:
            service: A service or its handle.

        Returns:
            int: Its index for `is_ready`, kind "service".
        """
        return self._add("service", service)

    def add_timer(self, timer: Any) -> int:
        """Wait for a timer.

        Args:
            timer: A timer or its handle.

        Returns:
            int: Its index for `is_ready`, kind "timer".
        """
        return self._add("timer", timer)

    def add_guard_condition(self, guard: Any) -> int:
        """Wait for a guard condition.

        Args:
            guard: A guard condition or its handle.

        Returns:
            int: Its index for `is_ready`, kind "guard_condition".
        """
        return self._add("guard_condition", guard)

    def is_ready(self, kind: str, index: int) -> bool:
        """Say whether an entity became ready in the last wait.

        Args:
            kind: "source", "subscription", "client", "service", "timer" or "guard_condition".
            index: What the call that added it returned.

        Returns:
            bool: Whether it is ready.
        """
        return id(self.entities[kind][index]) in self.ready


class Waitable:
    """Base of what an executor can wait for.

    A waitable of the runtime itself names its endpoints once, in ``_sources``; they stay attached
    to the executor, and the waitable counts as ready when one of them does. Any other waitable
    fills a `WaitSet` before every wait, as in rclpy.

    Args:
        callback_group: The callback group it runs in.
    """

    # Endpoints of the transport that never change, or None: ask `add_to_wait_set` every time.
    _sources: tuple[Any, ...] | None = None

    def __init__(self, callback_group: CallbackGroup) -> None:
        self.callback_group = callback_group
        self.callback_group.add_entity(self)
        # True when it is ready but has not been taken by an executor
        self._executor_event = False
        self._futures: list[Future] = []
        # Executors that wait for the endpoints.
        self._holders: weakref.WeakSet[Any] = weakref.WeakSet()

    def __enter__(self) -> None:
        """Mark the waitable as in use."""

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc_val: BaseException | None,
        exc_tb: TracebackType | None,
    ) -> None:
        """Mark the waitable as no longer in use."""

    def _receive(self) -> tuple[Any] | None:
        """Take what is there, in a tuple, or None."""
        if self._sources is not None and not self.is_ready(None):
            return None
        return (self.take_data(),)

    def _call(self, received: tuple[Any], executor: Any) -> Any:
        """Return the coroutine that handles what was taken."""
        for future in self._futures:
            future._set_executor(executor)
        return self.execute(received[0])

    def add_future(self, future: Future) -> None:
        """Have the executor that runs this waitable run the callbacks of a future.

        Args:
            future: The future.
        """
        self._futures.append(future)

    def remove_future(self, future: Future) -> None:
        """Take back `add_future`.

        Args:
            future: The future.
        """
        self._futures.remove(future)

    def is_ready(self, wait_set: Any) -> bool:
        """Say whether there is something to take.

        Args:
            wait_set: The set this waitable added itself to.

        Returns:
            bool: Whether `take_data` has something to return.
        """
        raise NotImplementedError("Must be implemented by subclass")

    def take_data(self) -> Any:
        """Take what is there, without handling it yet.

        Returns:
            object: Handed to `execute`.
        """
        raise NotImplementedError("Must be implemented by subclass")

    async def execute(self, taken_data: Any) -> None:
        """Handle what was taken.

        Args:
            taken_data: What `take_data` returned.
        """
        raise NotImplementedError("Must be implemented by subclass")

    def get_num_entities(self) -> NumberOfEntities:
        """Count what this waitable adds to a wait set.

        Returns:
            NumberOfEntities: The counts.
        """
        raise NotImplementedError("Must be implemented by subclass")

    def add_to_wait_set(self, wait_set: Any) -> None:
        """Add what this waitable waits for.

        Args:
            wait_set: The set to add to.
        """
        raise NotImplementedError("Must be implemented by subclass")
