# SPDX-License-Identifier: Apache-2.0
"""What the graph knows about one publisher or subscription of a topic."""

from enum import IntEnum
from typing import Any

from rclpy.qos import QoSProfile


class TopicEndpointTypeEnum(IntEnum):
    """Which side of a topic it is."""

    INVALID = 0
    PUBLISHER = 1
    SUBSCRIPTION = 2


class TypeHash:
    """The hash of a type's description.

    Args:
        version: Version of the way it is made; -1 where unknown.
        value: The hash, 32 bytes.
    """

    __slots__ = ("value", "version")

    def __init__(self, version: int = -1, value: bytes = bytes(32)) -> None:
        self.version = version
        self.value = value

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, TypeHash):
            return False
        return (self.version, self.value) == (other.version, other.value)

    __hash__ = None  # type: ignore[assignment]  # as in rclpy

    def __str__(self) -> str:
        if self.version <= 0 or len(self.value) != 32:
            return "INVALID"
        return f"RIHS{self.version:02}_{self.value.hex()}"


class TopicEndpointInfo:
    """What the graph knows about a publisher or subscription.

    Args:
        node_name: Name of its node.
        node_namespace: Namespace of its node.
        topic_type: Type, such as "std_msgs/msg/String".
        topic_type_hash: Hash of the type.
        endpoint_type: Which side it is.
        endpoint_gid: Its identity, a list of 16 integers.
        qos_profile: Its quality of service.
    """

    __slots__ = (
        "endpoint_gid",
        "endpoint_type",
        "node_name",
        "node_namespace",
        "qos_profile",
        "topic_type",
        "topic_type_hash",
    )

    def __init__(
        self,
        *,
        node_name: str = "",
        node_namespace: str = "",
        topic_type: str = "",
        topic_type_hash: TypeHash | None = None,
        endpoint_type: TopicEndpointTypeEnum = TopicEndpointTypeEnum.INVALID,
        endpoint_gid: list[int] | None = None,
        qos_profile: Any = None,
    ) -> None:
        self.node_name = node_name
        self.node_namespace = node_namespace
        self.topic_type = topic_type
        self.topic_type_hash = TypeHash() if topic_type_hash is None else topic_type_hash
        self.endpoint_type = endpoint_type
        self.endpoint_gid = [] if endpoint_gid is None else endpoint_gid
        self.qos_profile: QoSProfile | None = qos_profile

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, TopicEndpointInfo):
            return False
        return all(getattr(self, name) == getattr(other, name) for name in self.__slots__)

    __hash__ = None  # type: ignore[assignment]  # as in rclpy

    def __str__(self) -> str:
        lines = [
            f"Node name: {self.node_name}",
            f"Node namespace: {self.node_namespace}",
            f"Topic type: {self.topic_type}",
            f"Topic type hash: {self.topic_type_hash}",
            f"Endpoint type: {self.endpoint_type.name}",
            f"GID: {'.'.join(format(byte, '02x') for byte in self.endpoint_gid)}",
        ]
        profile = self.qos_profile
        if profile is not None:
            depth = f" ({profile.depth})" if profile.history.name == "KEEP_LAST" else ""
            lines += [
                "QoS profile:",
                f"  Reliability: {profile.reliability.name}",
                f"  History (Depth): {profile.history.name}{depth}",
                f"  Durability: {profile.durability.name}",
                f"  Lifespan: {profile.lifespan}",
                f"  Deadline: {profile.deadline}",
                f"  Liveliness: {profile.liveliness.name}",
                f"  Liveliness lease duration: {profile.liveliness_lease_duration}",
            ]
        return "\n".join(lines)
