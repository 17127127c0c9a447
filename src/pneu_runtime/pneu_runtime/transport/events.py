# SPDX-License-Identifier: Apache-2.0
"""QoS events: what the middleware notices about a publication or a subscription."""

import ctypes as ct
from dataclasses import dataclass
from enum import Enum
from typing import Any, Protocol

from cyclonedds.internal import dds_c_t

from pneu_runtime.transport import dds
from pneu_runtime.transport.qos import POLICY_KIND


class EventKind(Enum):
    """What is noticed."""

    DEADLINE_MISSED = "deadline_missed"
    LIVELINESS = "liveliness"  # lost, of a publication; changed, of a subscription
    INCOMPATIBLE_QOS = "incompatible_qos"
    MATCHED = "matched"
    MESSAGE_LOST = "message_lost"  # of a subscription only


@dataclass(frozen=True)
class _Status:
    """One status of the library: its bit, the function that reads it, what that fills."""

    bit: int
    function: Any
    structure: type[ct.Structure]


def _status(number: int, name: str) -> _Status:
    structure = getattr(dds_c_t, f"{name}_status")
    function = dds.status_function(f"dds_get_{name}_status", structure)
    return _Status(1 << number, function, structure)


_OF_WRITER = {
    EventKind.DEADLINE_MISSED: _status(1, "offered_deadline_missed"),
    EventKind.LIVELINESS: _status(9, "liveliness_lost"),
    EventKind.INCOMPATIBLE_QOS: _status(3, "offered_incompatible_qos"),
    EventKind.MATCHED: _status(11, "publication_matched"),
}
_OF_READER = {
    EventKind.DEADLINE_MISSED: _status(2, "requested_deadline_missed"),
    EventKind.LIVELINESS: _status(10, "liveliness_changed"),
    EventKind.INCOMPATIBLE_QOS: _status(4, "requested_incompatible_qos"),
    EventKind.MATCHED: _status(12, "subscription_matched"),
    EventKind.MESSAGE_LOST: _status(5, "sample_lost"),
}


class Endpoint(Protocol):
    """A publication or a subscription, as far as its events are concerned."""

    @property
    def entity(self) -> int:
        """The DDS writer or reader; 0 once it is closed."""
        ...


class EventSource:
    """Becomes ready when a status of an endpoint changes; reading the status makes it unready.

    Args:
        endpoint: The publication or subscription.
        kind: What is looked at.
        writer: Whether the endpoint is a publication.
    """

    def __init__(self, endpoint: Endpoint, kind: EventKind, *, writer: bool) -> None:
        statuses = _OF_WRITER if writer else _OF_READER
        if kind not in statuses:
            raise ValueError(f"a publication has no event '{kind.value}'")
        self._endpoint = endpoint
        self._status = statuses[kind]
        self.kind = kind

    @property
    def status_mask(self) -> int:
        """The bit of the status in the library's masks."""
        return self._status.bit

    @property
    def wait_entity(self) -> int:
        """The DDS entity that is triggered; 0 once it is closed."""
        return self._endpoint.entity

    def is_ready(self) -> bool:
        """Returns whether the status has changed since it was last read."""
        changes = ct.c_uint32()
        entity = self._endpoint.entity
        if not entity or dds.status_changes(entity, ct.byref(changes)) < 0:
            return False
        return bool(changes.value & self._status.bit)

    def take(self) -> dict[str, int]:
        """Reads the status.

        Returns:
            dict: counts by name, as in rclpy's event information: `total_count` and
            `total_count_change`; of LIVELINESS at a subscription `alive_count`, `not_alive_count`
            and their changes; of MATCHED also `current_count` and its change; of INCOMPATIBLE_QOS
            also `last_policy_kind`, a number of rmw_qos_policy_kind_t. Empty once it is closed.
        """
        entity = self._endpoint.entity
        status = self._status.structure()
        if not entity or self._status.function(entity, ct.byref(status)) < 0:
            return {}
        values = {
            name: int(getattr(status, name))
            for name, *_ in self._status.structure._fields_
            if not name.endswith("_handle")
        }
        if "last_policy_id" in values:
            values["last_policy_kind"] = POLICY_KIND.get(values.pop("last_policy_id"), 1)
        return values
