# SPDX-License-Identifier: Apache-2.0
"""Publications and subscriptions: CDR bytes to and from a topic."""

from __future__ import annotations

import ctypes as ct
import threading
import time
from typing import Any

from pneu_runtime.transport import dds
from pneu_runtime.transport.errors import TransportError
from pneu_runtime.transport.events import EventKind, EventSource
from pneu_runtime.transport.idl import topic_type
from pneu_runtime.transport.owner import NodeHandle, Owner
from pneu_runtime.transport.qos import EndpointQos, dds_qos

_PADS = (b"", b"\0\0\0", b"\0\0", b"\0")


class Sample:
    """A received message.

    Attributes:
        data: Its CDR bytes, with header.
        source_timestamp_ns: When it was published, by the publisher's clock [ns since 1970].
        received_timestamp_ns: When it was taken here [ns since 1970].
        publication_handle: Local number of the publisher.

    Args:
        data: Its CDR bytes, with header.
        info: What the library tells of it.
        reader: The reader that took it.
    """

    __slots__ = (
        "_reader",
        "data",
        "publication_handle",
        "received_timestamp_ns",
        "source_timestamp_ns",
    )

    def __init__(self, data: bytes, info: Any, reader: Reader) -> None:
        self.data = data
        self.source_timestamp_ns: int = info.source_timestamp
        self.received_timestamp_ns = time.time_ns()
        self.publication_handle: int = info.publication_handle
        self._reader = reader

    @property
    def publisher_gid(self) -> bytes:
        """16 bytes that identify the publisher; zeros if it is gone and was never asked for."""
        peer = self._reader.session.matched_writer(self._reader.entity, self.publication_handle)
        return peer.gid if peer else bytes(16)


class _Endpoint:
    """A DDS topic with a writer or a reader on it.

    Args:
        session: The session it belongs to.
        node: The node it belongs to; None for one that no node shows.
        topic: Name of the DDS topic.
        type_name: Full name of the message.
        qos: What is asked for.
        user_data: USER_DATA of the writer or reader.
        service_header: Whether rmw_cyclonedds' service header stands before the message.
        ignore_local: Whether what this process sends is left out.
    """

    _is_writer: bool

    def __init__(
        self,
        session: Owner,
        node: NodeHandle | None,
        topic: str,
        type_name: str,
        qos: EndpointQos,
        user_data: bytes,
        service_header: bool = False,
        ignore_local: bool = False,
    ) -> None:
        self.session = session
        self.type_name = type_name
        self.qos = qos
        self._node = node
        self._lock = threading.Lock()
        described = topic_type(type_name, service_header)
        described.__idl__.populate()
        described.__idl__.fill_type_data()
        participant = session.participant
        self._topic = dds.checked(
            dds.create_topic(participant, topic, described, None, None),
            f"topic '{topic}' of type {type_name}",
        )
        create = dds.create_writer if self._is_writer else dds.create_reader
        with dds_qos(qos, user_data, writer=self._is_writer, ignore_local=ignore_local) as policies:
            entity = create(participant, self._topic, policies, None)
        if entity < 0:
            dds.delete(self._topic)
            dds.checked(entity, f"an endpoint on topic '{topic}'")
        self._entity: int = entity
        self._mask = 0
        self.gid = dds.guid_of(entity)
        self._after_create()
        if node is not None:
            session.entity_added(node, self.gid, writer=self._is_writer)

    @property
    def entity(self) -> int:
        """The DDS writer or reader; 0 once it is closed."""
        return self._entity

    def event_source(self, kind: EventKind) -> EventSource:
        """Returns a source for a `Waiter` that becomes ready on an event.

        Args:
            kind: Which event.
        """
        source = EventSource(self, kind, writer=self._is_writer)
        with self._lock:
            self._mask |= source.status_mask
            if self._entity:
                dds.checked(dds.set_status_mask(self._entity, self._mask), "to watch a status")
        return source

    def event_status(self, kind: EventKind) -> dict[str, int]:
        """Reads a status, see `EventSource.take`.

        Args:
            kind: Which event.
        """
        return EventSource(self, kind, writer=self._is_writer).take()

    def close(self) -> None:
        """Removes it from the network. Further calls do nothing."""
        with self._lock:
            entity, self._entity = self._entity, 0
        if not entity:
            return
        self._before_delete()
        dds.delete(entity)
        dds.delete(self._topic)
        if self._node is not None:
            self.session.entity_removed(self._node, self.gid, writer=self._is_writer)

    def _after_create(self) -> None:
        """Makes what hangs on the entity."""

    def _before_delete(self) -> None:
        """Removes what hangs on the entity."""


class Writer(_Endpoint):
    """Sends CDR bytes."""

    _is_writer = True

    def publish(self, data: bytes) -> None:
        """Sends a message. May be called from any thread.

        Waits where the reliability and history asked for leave no other way, without holding up
        other threads.

        Args:
            data: CDR bytes with header.

        Raises:
            TransportError: It is closed, or the bytes are not of the type.
        """
        data += _PADS[len(data) & 3]
        code = self._write(dds.Blob(data, len(data)))
        if code < 0:
            if not self._entity:
                raise TransportError("The publication is closed.")
            dds.checked(code, f"a message of type {self.type_name}")

    def _write(self, blob: dds.Blob) -> int:
        return dds.write(self._entity, ct.byref(blob))

    def matched_count(self) -> int:
        """Returns how many subscriptions receive what is published."""
        return max(dds.matched_readers(self._entity, None, 0), 0) if self._entity else 0

    def assert_liveliness(self) -> None:
        """Tells subscriptions that the publisher is alive, for MANUAL_BY_TOPIC."""
        dds.checked(dds.assert_liveliness(self._entity), "to assert liveliness")

    def wait_for_all_acked(self, timeout_s: float | None = None) -> bool:
        """Waits until all reliable subscriptions have confirmed all messages.

        Args:
            timeout_s: Longest time to wait [s]; None for ever.

        Returns:
            bool: whether they have.
        """
        timeout_ns = dds.INFINITY_NS if timeout_s is None else int(max(timeout_s, 0) * 1e9)
        code = dds.wait_for_acks(self._entity, timeout_ns)
        if code == dds.RETCODE_TIMEOUT:
            return False
        dds.checked(code, "to wait for acknowledgements")
        return True


class Reader(_Endpoint):
    """Receives CDR bytes. A source for a `Waiter`."""

    _is_writer = False

    def _after_create(self) -> None:
        self._condition = dds.checked(
            dds.create_read_condition(self._entity, dds.ANY_STATE), "a read condition"
        )

    @property
    def wait_entity(self) -> int:
        """The DDS entity that is triggered; 0 once it is closed."""
        return self._condition if self._entity else 0

    def is_ready(self) -> bool:
        """Returns whether there may be something to take."""
        return bool(self._entity)

    def take(self) -> Sample | None:
        """Returns the oldest message that was not taken, None where there is none."""
        while True:
            entity = self._entity
            if not entity:
                return None
            taken = dds.take(entity, dds.ANY_STATE, 1)
            if not taken:
                return None
            if isinstance(taken, int):
                if not self._entity:
                    return None
                dds.checked(taken, "to take a message")
            ((data, info),) = taken
            if info.valid_data:  # else it tells only that a writer went
                return Sample(data, info, self)

    def matched_count(self) -> int:
        """Returns how many publications it receives from."""
        return max(dds.matched_writers(self._entity, None, 0), 0) if self._entity else 0

    def _before_delete(self) -> None:
        dds.delete(self._condition)


class Publication(Writer):
    """A publisher's end of a topic. It counts what it sends, so that losses can be told."""

    def _after_create(self) -> None:
        self._count_lock = threading.Lock()
        self._sent = (0, 0)

    @property
    def sent(self) -> tuple[int, int]:
        """How many messages were sent so far, and the source timestamp of the last one, ns."""
        return self._sent

    def _write(self, blob: dds.Blob) -> int:
        with self._count_lock:
            count, before_ns = self._sent
            # Later by more than the wire's resolution, so that none is counted twice or not at all.
            stamp_ns = max(time.time_ns(), before_ns + 2)
            self._sent = (count + 1, stamp_ns)
        return dds.write_at(self._entity, ct.byref(blob), stamp_ns)

    def _before_delete(self) -> None:
        self.session.publication_ends(self)


class Subscription(Reader):
    """A subscriber's end of a topic. A source for a `Waiter`."""
