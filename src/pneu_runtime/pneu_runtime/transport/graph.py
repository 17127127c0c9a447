# SPDX-License-Identifier: Apache-2.0
"""What is known of the ROS graph: participants, their nodes, and their endpoints.

Endpoints come from DDS discovery, nodes from the topic `ros_discovery_info`, on which every
participant publishes which of its endpoints belong to which node (ros2/rmw_dds_common, branch
jazzy, graph_cache.cpp).
"""

from __future__ import annotations

import threading
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from pneu_runtime.transport import naming
from pneu_runtime.transport.errors import UnknownNodeError
from pneu_runtime.transport.qos import EndpointQos, read_qos, read_user_data

NamesAndTypes = list[tuple[str, list[str]]]
UNKNOWN_NODE = ("_NODE_NAME_UNKNOWN_", "_NODE_NAMESPACE_UNKNOWN_")


@dataclass(frozen=True)
class Peer:
    """An endpoint somewhere on the network.

    Attributes:
        gid: 16 bytes that identify it.
        participant: 16 bytes that identify its participant.
        writer: Whether it is a writer.
        topic: Name of its DDS topic.
        dds_type: Name of its DDS type.
        qos: Its quality of service.
        type_hash: Its RIHS01 hash; empty where it tells none.
        service_id: Key of the server it belongs to, else empty.
        client_id: Key of the client it belongs to, else empty.
    """

    gid: bytes
    participant: bytes
    writer: bool
    topic: str
    dds_type: str
    qos: EndpointQos
    type_hash: str = ""
    service_id: str = ""
    client_id: str = ""


@dataclass(frozen=True)
class EndpointInfo:
    """An endpoint as `get_publishers_info_by_topic` shows it.

    Attributes:
        node_name: Name of its node.
        node_namespace: Namespace of its node.
        topic_type: Full name of the message.
        topic_type_hash: RIHS01 hash; empty where it tells none.
        gid: 16 bytes that identify it.
        qos: Its quality of service.
        writer: Whether it is a publisher.
    """

    node_name: str
    node_namespace: str
    topic_type: str
    topic_type_hash: str
    gid: bytes
    qos: EndpointQos
    writer: bool


@dataclass
class NodeEntry:
    """A node and its endpoints.

    Attributes:
        namespace: Its namespace, such as `/rig`.
        name: Its name.
        readers: Identities of its readers.
        writers: Identities of its writers.
    """

    namespace: str
    name: str
    readers: list[bytes]
    writers: list[bytes]


def construct_peer(
    gid: bytes,
    participant: bytes,
    _handle: int,
    topic: str | None,
    type_name: str | None,
    policies: tuple[bytes, EndpointQos] | None,
    info: Any,
    _type_id: Any,
) -> tuple[Peer | None, bytes, Any]:
    """Makes a peer of what the library tells of an endpoint; its arguments are the library's.

    Args:
        gid: Identity of the endpoint.
        participant: Identity of its participant.
        topic: Name of its DDS topic; None for one that is gone.
        type_name: Name of its DDS type.
        policies: What `convert_policies` returned.
        info: State of the sample.

    Returns:
        tuple: the peer, or None for one that is gone; its identity; the state of the sample.
    """
    if topic is None or type_name is None or policies is None:
        return None, gid, info
    values = naming.parse_user_data(policies[0])
    peer = Peer(
        gid,
        participant,
        gid[15] & 0x07 in (0x02, 0x03),  # entity kinds of writers, RTPS 2.5 table 9.1
        topic,
        type_name,
        policies[1],
        values.get("typehash", ""),
        values.get("serviceid", ""),
        values.get("clientid", ""),
    )
    return peer, gid, info


def convert_policies(pointer: int) -> tuple[bytes, EndpointQos]:
    """Reads USER_DATA and quality of service, while the library holds them.

    Args:
        pointer: Pointer to the policies.
    """
    return read_user_data(pointer), read_qos(pointer)


class Graph:
    """The known graph. Any thread may call any method."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._enclaves: dict[bytes, str] = {}
        self._peers: dict[bytes, Peer] = {}
        self._nodes: dict[bytes, list[NodeEntry]] = {}
        self.version = 0

    # What discovery tells.

    def participant_found(self, gid: bytes, enclave: str) -> None:
        """Notes a participant.

        Args:
            gid: Its identity.
            enclave: Its enclave.
        """
        with self._lock:
            if self._enclaves.get(gid) != enclave:
                self._enclaves[gid] = enclave
                self.version += 1

    def participant_lost(self, gid: bytes) -> None:
        """Forgets a participant and its nodes.

        Args:
            gid: Its identity.
        """
        with self._lock:
            known = self._enclaves.pop(gid, None) is not None
            if self._nodes.pop(gid, None) is not None or known:
                self.version += 1

    def endpoint_found(self, peer: Peer) -> None:
        """Notes an endpoint.

        Args:
            peer: The endpoint.
        """
        with self._lock:
            if self._peers.get(peer.gid) != peer:
                self._peers[peer.gid] = peer
                self.version += 1

    def endpoint_lost(self, gid: bytes) -> None:
        """Forgets an endpoint.

        Args:
            gid: Its identity.
        """
        with self._lock:
            if self._peers.pop(gid, None) is not None:
                self.version += 1

    def nodes_told(self, participant: bytes, nodes: list[NodeEntry]) -> None:
        """Notes the nodes of a participant.

        Args:
            participant: Its identity.
            nodes: All its nodes.
        """
        with self._lock:
            if self._nodes.get(participant) != nodes:
                self._nodes[participant] = nodes
                self.version += 1

    # What users ask.

    def node_names(self) -> list[tuple[str, str, str]]:
        """Returns name, namespace and enclave of all nodes."""
        with self._lock:
            return [
                (node.name, node.namespace, self._enclaves.get(participant, ""))
                for participant, nodes in self._nodes.items()
                for node in nodes
            ]

    def topic_names_and_types(self, no_demangle: bool = False) -> NamesAndTypes:
        """Returns all topics with the types on them, sorted.

        Args:
            no_demangle: Whether names are those of DDS, of every DDS topic.
        """
        return _collect(self._topics(self._all(), no_demangle))

    def service_names_and_types(self) -> NamesAndTypes:
        """Returns all services that have a server or a client, with their types, sorted."""
        return _collect(_services(self._all()))

    def publisher_names_and_types_by_node(
        self, name: str, namespace: str, no_demangle: bool = False
    ) -> NamesAndTypes:
        """Returns the topics a node publishes on.

        Args:
            name: Name of the node.
            namespace: Its namespace.
            no_demangle: Whether names are those of DDS.

        Raises:
            UnknownNodeError: There is no such node.
        """
        peers = [peer for peer in self._of_node(name, namespace) if peer.writer]
        return _collect(self._topics(peers, no_demangle))

    def subscriber_names_and_types_by_node(
        self, name: str, namespace: str, no_demangle: bool = False
    ) -> NamesAndTypes:
        """Returns the topics a node subscribes to.

        Args:
            name: Name of the node.
            namespace: Its namespace.
            no_demangle: Whether names are those of DDS.

        Raises:
            UnknownNodeError: There is no such node.
        """
        peers = [peer for peer in self._of_node(name, namespace) if not peer.writer]
        return _collect(self._topics(peers, no_demangle))

    def service_names_and_types_by_node(self, name: str, namespace: str) -> NamesAndTypes:
        """Returns the services a node serves.

        Args:
            name: Name of the node.
            namespace: Its namespace.

        Raises:
            UnknownNodeError: There is no such node.
        """
        peers = [peer for peer in self._of_node(name, namespace) if not peer.writer]
        return _collect(_services(peer for peer in peers if peer.topic.startswith("rq/")))

    def client_names_and_types_by_node(self, name: str, namespace: str) -> NamesAndTypes:
        """Returns the services a node is a client of.

        Args:
            name: Name of the node.
            namespace: Its namespace.

        Raises:
            UnknownNodeError: There is no such node.
        """
        peers = [peer for peer in self._of_node(name, namespace) if not peer.writer]
        return _collect(_services(peer for peer in peers if peer.topic.startswith("rr/")))

    def publishers_info(self, topic: str, no_mangle: bool = False) -> list[EndpointInfo]:
        """Returns what is known of the publishers on a topic.

        Args:
            topic: Fully qualified name.
            no_mangle: Whether the name is that of the DDS topic.
        """
        return self._infos(topic if no_mangle else naming.topic_to_dds(topic), writer=True)

    def subscriptions_info(self, topic: str, no_mangle: bool = False) -> list[EndpointInfo]:
        """Returns what is known of the subscriptions to a topic.

        Args:
            topic: Fully qualified name.
            no_mangle: Whether the name is that of the DDS topic.
        """
        return self._infos(topic if no_mangle else naming.topic_to_dds(topic), writer=False)

    def count_publishers(self, topic: str) -> int:
        """Returns how many publishers a topic has.

        Args:
            topic: Fully qualified name.
        """
        return self._count(naming.topic_to_dds(topic), writer=True)

    def count_subscribers(self, topic: str) -> int:
        """Returns how many subscriptions a topic has.

        Args:
            topic: Fully qualified name.
        """
        return self._count(naming.topic_to_dds(topic), writer=False)

    def count_services(self, service: str) -> int:
        """Returns how many servers a service has.

        Args:
            service: Fully qualified name.
        """
        return self._count(naming.request_to_dds(service), writer=False)

    def count_clients(self, service: str) -> int:
        """Returns how many clients a service has.

        Args:
            service: Fully qualified name.
        """
        return self._count(naming.reply_to_dds(service), writer=False)

    def _all(self) -> list[Peer]:
        with self._lock:
            return list(self._peers.values())

    def _of_node(self, name: str, namespace: str) -> list[Peer]:
        with self._lock:
            entries = [
                node
                for nodes in self._nodes.values()
                for node in nodes
                if (node.name, node.namespace) == (name, namespace)
            ]
            if not entries:
                raise UnknownNodeError(f"There is no node '{name}' in namespace '{namespace}'.")
            gids = [gid for node in entries for gid in (*node.readers, *node.writers)]
            return [self._peers[gid] for gid in gids if gid in self._peers]

    def _infos(self, topic: str, *, writer: bool) -> list[EndpointInfo]:
        with self._lock:
            owners = {
                gid: (node.name, node.namespace)
                for nodes in self._nodes.values()
                for node in nodes
                for gid in (*node.readers, *node.writers)
            }
            return [
                EndpointInfo(
                    *owners.get(peer.gid, UNKNOWN_NODE),
                    naming.type_from_dds(peer.dds_type),
                    peer.type_hash,
                    peer.gid,
                    peer.qos,
                    writer,
                )
                for peer in self._peers.values()
                if peer.topic == topic and peer.writer == writer
            ]

    def _count(self, topic: str, *, writer: bool) -> int:
        return sum(peer.topic == topic and peer.writer == writer for peer in self._all())

    @staticmethod
    def _topics(peers: Iterable[Peer], no_demangle: bool) -> Iterable[tuple[str, str]]:
        for peer in peers:
            if no_demangle:
                yield peer.topic, peer.dds_type
            elif (name := naming.topic_from_dds(peer.topic)) is not None:
                yield name, naming.type_from_dds(peer.dds_type)


def _services(peers: Iterable[Peer]) -> Iterable[tuple[str, str]]:
    for peer in peers:
        if (name := naming.service_from_dds(peer.topic)) is not None:
            yield name, naming.service_type_from_dds(peer.dds_type)


def _collect(pairs: Iterable[tuple[str, str]]) -> NamesAndTypes:
    found: dict[str, set[str]] = {}
    for name, type_name in pairs:
        found.setdefault(name, set()).add(type_name)
    return [(name, sorted(types)) for name, types in sorted(found.items())]
