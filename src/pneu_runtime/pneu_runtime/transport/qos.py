# SPDX-License-Identifier: Apache-2.0
"""Quality of service: from rclpy's profiles to DDS policies, and back from what peers announce.

Numbers are those of rmw/types.h; the translation follows `create_readwrite_qos` of
ros2/rmw_cyclonedds, branch jazzy, rmw_node.cpp.
"""

import ctypes as ct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from pneu_runtime.transport import dds


class History(IntEnum):
    """rmw_qos_history_policy_t."""

    SYSTEM_DEFAULT = 0
    KEEP_LAST = 1
    KEEP_ALL = 2
    UNKNOWN = 3


class Reliability(IntEnum):
    """rmw_qos_reliability_policy_t."""

    SYSTEM_DEFAULT = 0
    RELIABLE = 1
    BEST_EFFORT = 2
    UNKNOWN = 3
    BEST_AVAILABLE = 4


class Durability(IntEnum):
    """rmw_qos_durability_policy_t."""

    SYSTEM_DEFAULT = 0
    TRANSIENT_LOCAL = 1
    VOLATILE = 2
    UNKNOWN = 3
    BEST_AVAILABLE = 4


class Liveliness(IntEnum):
    """rmw_qos_liveliness_policy_t."""

    SYSTEM_DEFAULT = 0
    AUTOMATIC = 1
    MANUAL_BY_TOPIC = 3
    UNKNOWN = 4
    BEST_AVAILABLE = 5


# dds_durability_kind_t and dds_liveliness_kind_t; others have no word in ROS.
_DURABILITY = {0: Durability.VOLATILE, 1: Durability.TRANSIENT_LOCAL}
_LIVELINESS = {0: Liveliness.AUTOMATIC, 2: Liveliness.MANUAL_BY_TOPIC}

# dds_qos_policy_id_t -> rmw_qos_policy_kind_t
POLICY_KIND = {2: 1 << 1, 4: 1 << 2, 8: 1 << 3, 11: 1 << 4, 13: 1 << 5, 14: 1 << 6}


@dataclass(frozen=True)
class EndpointQos:
    """Quality of service in plain numbers.

    Attributes:
        history: A `History`.
        depth: Samples kept, where the history is KEEP_LAST.
        reliability: A `Reliability`.
        durability: A `Durability`.
        lifespan_ns: How long a sample stays of use [ns]; `INFINITY_NS` for ever.
        deadline_ns: Longest time between samples [ns].
        liveliness: A `Liveliness`.
        liveliness_lease_duration_ns: Time after which a silent publisher counts as lost [ns].
        avoid_ros_namespace_conventions: Whether the topic has ROS's prefix on the wire.
    """

    history: int = History.KEEP_LAST
    depth: int = 10
    reliability: int = Reliability.RELIABLE
    durability: int = Durability.VOLATILE
    lifespan_ns: int = dds.INFINITY_NS
    deadline_ns: int = dds.INFINITY_NS
    liveliness: int = Liveliness.AUTOMATIC
    liveliness_lease_duration_ns: int = dds.INFINITY_NS
    avoid_ros_namespace_conventions: bool = False


def resolve(profile: Any) -> EndpointQos:
    """Returns a profile with ROS's defaults filled in.

    Args:
        profile: An `EndpointQos`, or any object with the attributes of `rclpy.qos.QoSProfile`.
    """
    if isinstance(profile, EndpointQos):
        return profile
    history = int(getattr(profile, "history", 0)) or History.KEEP_LAST
    depth = int(getattr(profile, "depth", 0) or 0)
    reliability = int(getattr(profile, "reliability", 0))
    durability = int(getattr(profile, "durability", 0))
    liveliness = int(getattr(profile, "liveliness", 0))
    if reliability not in (Reliability.BEST_EFFORT, Reliability.BEST_AVAILABLE):
        reliability = Reliability.RELIABLE
    if durability not in (Durability.TRANSIENT_LOCAL, Durability.BEST_AVAILABLE):
        durability = Durability.VOLATILE
    if liveliness != Liveliness.MANUAL_BY_TOPIC:
        liveliness = Liveliness.AUTOMATIC
    return EndpointQos(
        history=history,
        depth=max(depth, 1) if history == History.KEEP_LAST else 0,
        reliability=reliability,
        durability=durability,
        lifespan_ns=_nanoseconds(getattr(profile, "lifespan", None)),
        deadline_ns=_nanoseconds(getattr(profile, "deadline", None)),
        liveliness=liveliness,
        liveliness_lease_duration_ns=_nanoseconds(
            getattr(profile, "liveliness_lease_duration", None)
        ),
        avoid_ros_namespace_conventions=bool(
            getattr(profile, "avoid_ros_namespace_conventions", False)
        ),
    )


def _nanoseconds(duration: Any) -> int:
    """Of a Duration; zero and None mean that nothing was asked for."""
    value = int(getattr(duration, "nanoseconds", duration) or 0)
    return dds.INFINITY_NS if value <= 0 else min(value, dds.INFINITY_NS)


@contextmanager
def dds_qos(
    qos: EndpointQos, user_data: bytes, *, writer: bool, ignore_local: bool = False
) -> Iterator[int]:
    """Makes the policies of an endpoint, for as long as the context lasts.

    Args:
        qos: What is asked for.
        user_data: The USER_DATA of the endpoint.
        writer: Whether it is a writer.
        ignore_local: Whether samples of the own participant are left out.

    Yields:
        int: pointer to the policies.
    """
    policies = dds.create_qos()
    try:
        keep_all = qos.history == History.KEEP_ALL
        kind, depth = (1, dds.UNLIMITED) if keep_all else (0, max(qos.depth, 1))
        dds.qset_userdata(policies, user_data, len(user_data))
        dds.qset_history(policies, kind, depth)
        reliable = qos.reliability != Reliability.BEST_EFFORT
        dds.qset_reliability(policies, int(reliable), dds.INFINITY_NS if reliable else 0)
        transient_local = qos.durability == Durability.TRANSIENT_LOCAL
        dds.qset_durability(policies, int(transient_local))
        if writer:
            dds.qset_lifecycle(policies, False)
            dds.qset_lifespan(policies, qos.lifespan_ns)
            if transient_local:
                unlimited = (dds.UNLIMITED,) * 3
                dds.qset_durability_service(policies, 0, kind, depth, *unlimited)
        dds.qset_deadline(policies, qos.deadline_ns)
        manual = qos.liveliness == Liveliness.MANUAL_BY_TOPIC
        dds.qset_liveliness(policies, 2 if manual else 0, qos.liveliness_lease_duration_ns)
        dds.qset_representation(policies, 1, (ct.c_int16 * 1)(0))  # XCDR1
        if ignore_local:
            dds.qset_ignorelocal(policies, 1)
        yield policies
    finally:
        dds.delete_qos(policies)


def read_user_data(policies: int) -> bytes:
    """Returns the USER_DATA among policies.

    Args:
        policies: Pointer to them.
    """
    pointer, size = ct.c_void_p(), ct.c_size_t()
    if not dds.qget_userdata(policies, ct.byref(pointer), ct.byref(size)) or not pointer:
        return b""
    try:
        return ct.string_at(pointer, size.value)
    finally:
        dds.free(pointer)


def read_qos(policies: int) -> EndpointQos:
    """Returns the policies that a peer announced.

    Args:
        policies: Pointer to them.
    """
    kind, count, duration = ct.c_int(), ct.c_int32(), ct.c_int64()
    history, depth = int(History.UNKNOWN), 0
    if dds.qget_history(policies, ct.byref(kind), ct.byref(count)):
        history = History.KEEP_ALL if kind.value else History.KEEP_LAST
        depth = max(count.value, 0)
    reliability = Reliability.BEST_EFFORT
    if dds.qget_reliability(policies, ct.byref(kind), ct.byref(duration)) and kind.value:
        reliability = Reliability.RELIABLE
    durability = Durability.VOLATILE
    if dds.qget_durability(policies, ct.byref(kind)):
        durability = _DURABILITY.get(kind.value, Durability.UNKNOWN)
    liveliness, lease = Liveliness.AUTOMATIC, dds.INFINITY_NS
    if dds.qget_liveliness(policies, ct.byref(kind), ct.byref(duration)):
        liveliness = _LIVELINESS.get(kind.value, Liveliness.UNKNOWN)
        lease = duration.value
    lifespan = deadline = dds.INFINITY_NS
    if dds.qget_lifespan(policies, ct.byref(duration)):
        lifespan = duration.value
    if dds.qget_deadline(policies, ct.byref(duration)):
        deadline = duration.value
    return EndpointQos(
        int(history), depth, reliability, durability, lifespan, deadline, liveliness, lease
    )
