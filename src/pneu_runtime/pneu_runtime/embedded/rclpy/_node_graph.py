# SPDX-License-Identifier: Apache-2.0
"""What a node can ask the graph."""

import time
from typing import TYPE_CHECKING, Any

from pneu_runtime import transport
from rclpy._names import NodeNames
from rclpy._rclpy_pybind11 import NodeNameNonExistentError
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.names_and_types import NamesAndTypes
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.topic_endpoint_info import TopicEndpointInfo, TopicEndpointTypeEnum, TypeHash


class GraphMixin:
    """Part of `Node`; needs its names and its participant."""

    if TYPE_CHECKING:
        _context: Context
        _names: NodeNames
        _session: Any

        def _check(self) -> None:
            """Raise where the node was destroyed, which `Node` provides."""

    def get_node_names(self) -> list[str]:
        """List the names of all nodes.

        Returns:
            list[str]: Names, without namespaces.
        """
        self._check()
        return [name for name, _, _ in self._session.node_names()]

    def get_fully_qualified_node_names(self) -> list[str]:
        """List the names of all nodes with their namespaces.

        Returns:
            list[str]: Full names.
        """
        self._check()
        return [
            f"{namespace.rstrip('/')}/{name}" for name, namespace, _ in self._session.node_names()
        ]

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        """List the names of all nodes and their namespaces.

        Returns:
            list[tuple[str, str]]: Name and namespace.
        """
        self._check()
        return [(name, namespace) for name, namespace, _ in self._session.node_names()]

    def get_node_names_and_namespaces_with_enclaves(self) -> list[tuple[str, str, str]]:
        """List the names of all nodes, their namespaces and enclaves.

        Returns:
            list[tuple[str, str, str]]: Name, namespace and enclave.
        """
        self._check()
        return list(self._session.node_names())

    def wait_for_node(self, fully_qualified_node_name: str, timeout: float) -> bool:
        """Wait until a node is in the graph.

        Args:
            fully_qualified_node_name: Name of the node with its namespace.
            timeout: How long to wait at most [s].

        Returns:
            bool: Whether it is there.
        """
        self._check()
        deadline_s = time.monotonic() + timeout
        source = self._session.create_graph_source()
        waiter = transport.Waiter()
        self._context._add_waker(waiter.wake)
        try:
            waiter.attach(source)
            while self._context.ok():
                source.take()
                if fully_qualified_node_name in self.get_fully_qualified_node_names():
                    return True
                remaining_s = deadline_s - time.monotonic()
                if remaining_s <= 0:
                    break
                waiter.wait(remaining_s)
            return False
        finally:
            self._context._remove_waker(waiter.wake)
            waiter.close()
            source.close()

    def get_topic_names_and_types(self, no_demangle: bool = False) -> NamesAndTypes:
        """List all topics.

        Args:
            no_demangle: Whether DDS's own names are returned.

        Returns:
            list[tuple[str, list[str]]]: Name and types of each topic.
        """
        self._check()
        return _lists(self._session.topic_names_and_types(no_demangle))

    def get_service_names_and_types(self) -> NamesAndTypes:
        """List all services.

        Returns:
            list[tuple[str, list[str]]]: Name and types of each service.
        """
        self._check()
        return _lists(self._session.service_names_and_types())

    def _by_node(self, method: str, name: str, namespace: str, *args: Any) -> NamesAndTypes:
        self._check()
        if not any(
            (name, namespace) == (known, space) for known, space, _ in self._session.node_names()
        ):
            raise NodeNameNonExistentError(
                f"Cannot get names and types for nonexistent node: '{name}' in '{namespace}'"
            )
        return _lists(getattr(self._session, method)(name, namespace, *args))

    def get_publisher_names_and_types_by_node(
        self, node_name: str, node_namespace: str, no_demangle: bool = False
    ) -> NamesAndTypes:
        """List the topics that a node publishes.

        Args:
            node_name: Name of the node.
            node_namespace: Namespace of the node.
            no_demangle: Whether DDS's own names are returned.

        Returns:
            list[tuple[str, list[str]]]: Name and types of each topic.
        """
        return self._by_node(
            "publisher_names_and_types_by_node", node_name, node_namespace, no_demangle
        )

    def get_subscriber_names_and_types_by_node(
        self, node_name: str, node_namespace: str, no_demangle: bool = False
    ) -> NamesAndTypes:
        """List the topics that a node subscribes to.

        Args:
            node_name: Name of the node.
            node_namespace: Namespace of the node.
            no_demangle: Whether DDS's own names are returned.

        Returns:
            list[tuple[str, list[str]]]: Name and types of each topic.
        """
        return self._by_node(
            "subscriber_names_and_types_by_node", node_name, node_namespace, no_demangle
        )

    def get_service_names_and_types_by_node(
        self, node_name: str, node_namespace: str
    ) -> NamesAndTypes:
        """List the services that a node offers.

        Args:
            node_name: Name of the node.
            node_namespace: Namespace of the node.

        Returns:
            list[tuple[str, list[str]]]: Name and types of each service.
        """
        return self._by_node("service_names_and_types_by_node", node_name, node_namespace)

    def get_client_names_and_types_by_node(
        self, node_name: str, node_namespace: str
    ) -> NamesAndTypes:
        """List the services that a node calls.

        Args:
            node_name: Name of the node.
            node_namespace: Namespace of the node.

        Returns:
            list[tuple[str, list[str]]]: Name and types of each service.
        """
        return self._by_node("client_names_and_types_by_node", node_name, node_namespace)

    def count_publishers(self, topic_name: str) -> int:
        """Count the publishers of a topic.

        Args:
            topic_name: The topic; it is expanded, and not remapped.

        Returns:
            int: How many.
        """
        self._check()
        return self._session.count_publishers(self._names.expand(topic_name))

    def count_subscribers(self, topic_name: str) -> int:
        """Count the subscriptions to a topic.

        Args:
            topic_name: The topic; it is expanded, and not remapped.

        Returns:
            int: How many.
        """
        self._check()
        return self._session.count_subscribers(self._names.expand(topic_name))

    def count_clients(self, service_name: str) -> int:
        """Count the clients of a service.

        Args:
            service_name: The service; it is expanded, and not remapped.

        Returns:
            int: How many.
        """
        self._check()
        return self._session.count_clients(self._names.expand(service_name, is_service=True))

    def count_services(self, service_name: str) -> int:
        """Count the servers of a service.

        Args:
            service_name: The service; it is expanded, and not remapped.

        Returns:
            int: How many.
        """
        self._check()
        return self._session.count_services(self._names.expand(service_name, is_service=True))

    def get_publishers_info_by_topic(
        self, topic_name: str, no_mangle: bool = False
    ) -> list[TopicEndpointInfo]:
        """List the publishers of a topic.

        Args:
            topic_name: The topic; it is expanded and remapped.
            no_mangle: Whether it is a name of DDS's own, which this runtime cannot look up.

        Returns:
            list[TopicEndpointInfo]: What is known about each.
        """
        infos = self._session.publishers_info(self._info_name(topic_name, no_mangle))
        return [_endpoint_info(info, TopicEndpointTypeEnum.PUBLISHER) for info in infos]

    def get_subscriptions_info_by_topic(
        self, topic_name: str, no_mangle: bool = False
    ) -> list[TopicEndpointInfo]:
        """List the subscriptions to a topic.

        Args:
            topic_name: The topic; it is expanded and remapped.
            no_mangle: Whether it is a name of DDS's own, which this runtime cannot look up.

        Returns:
            list[TopicEndpointInfo]: What is known about each.
        """
        infos = self._session.subscriptions_info(self._info_name(topic_name, no_mangle))
        return [_endpoint_info(info, TopicEndpointTypeEnum.SUBSCRIPTION) for info in infos]

    def _info_name(self, topic_name: str, no_mangle: bool) -> str:
        self._check()
        if no_mangle:
            raise NotImplementedError(
                "the embedded runtime has no get_publishers_info_by_topic or "
                "get_subscriptions_info_by_topic with no_mangle"
            )
        return self._names.resolve(topic_name)


def _lists(pairs: Any) -> NamesAndTypes:
    return [(name, list(types)) for name, types in pairs]


def _endpoint_info(info: Any, endpoint_type: TopicEndpointTypeEnum) -> TopicEndpointInfo:
    return TopicEndpointInfo(
        node_name=info.node_name,
        node_namespace=info.node_namespace,
        topic_type=info.topic_type,
        topic_type_hash=_type_hash(info.topic_type_hash),
        endpoint_type=endpoint_type,
        endpoint_gid=list(info.gid),
        qos_profile=_profile(info.qos),
    )


def _type_hash(text: str | None) -> TypeHash:
    if not text or not text.startswith("RIHS"):
        return TypeHash()
    version, _, digits = text.removeprefix("RIHS").partition("_")
    return TypeHash(int(version), bytes.fromhex(digits))


def _profile(qos: Any) -> QoSProfile:
    """A profile of what the transport found."""
    return QoSProfile(
        history=HistoryPolicy(qos.history),
        depth=qos.depth,
        reliability=ReliabilityPolicy(qos.reliability),
        durability=DurabilityPolicy(qos.durability),
        lifespan=Duration(nanoseconds=qos.lifespan_ns),
        deadline=Duration(nanoseconds=qos.deadline_ns),
        liveliness=LivelinessPolicy(qos.liveliness),
        liveliness_lease_duration=Duration(nanoseconds=qos.liveliness_lease_duration_ns),
    )
