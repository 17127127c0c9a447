# SPDX-License-Identifier: Apache-2.0
"""A participant of the ROS graph: the one object per context through which all else is made."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pneu_runtime import interfaces
from pneu_runtime.transport import dds, naming
from pneu_runtime.transport.announcement import (
    ANNOUNCEMENT_TYPE,
    decode_nodes,
    encode_nodes,
)
from pneu_runtime.transport.domain import DOMAINS, domain_id_from
from pneu_runtime.transport.endpoints import Publication, Reader, Subscription, Writer
from pneu_runtime.transport.errors import TransportError
from pneu_runtime.transport.graph import (
    Graph,
    NodeEntry,
    Peer,
    construct_peer,
    convert_policies,
)
from pneu_runtime.transport.owner import NodeHandle
from pneu_runtime.transport.qos import (
    Durability,
    EndpointQos,
    History,
    Reliability,
    read_user_data,
    resolve,
)
from pneu_runtime.transport.sent import TOPIC as SENT_TOPIC
from pneu_runtime.transport.sent import Teller
from pneu_runtime.transport.services import ClientEnd, ServerEnd
from pneu_runtime.transport.waiter import Waiter

_log = logging.getLogger(__name__)

_DISCOVERY_TOPIC = "ros_discovery_info"
_KNOWN_PEERS = 4096
_BATCH = 64


class GraphSource:
    """Becomes ready when the graph changes; `take` makes it unready. A source for a `Waiter`."""

    def __init__(self) -> None:
        self._guard = dds.checked(dds.create_guard(dds.LIBRARY), "a guard condition")

    @property
    def wait_entity(self) -> int:
        """The DDS entity that is triggered; 0 once it is closed."""
        return self._guard

    def is_ready(self) -> bool:
        """Returns whether there may be something to take."""
        return bool(self._guard)

    def trigger(self) -> None:
        """Makes it ready."""
        if self._guard:
            dds.set_guard(self._guard, True)

    def take(self) -> None:
        """Makes it unready; to be called before the graph is looked at."""
        if self._guard:
            dds.set_guard(self._guard, False)

    def close(self) -> None:
        """Frees it."""
        guard, self._guard = self._guard, 0
        if guard:
            dds.delete(guard)


class _Condition:
    """A read condition of one of the library's own readers, as a source."""

    def __init__(self, entity: int) -> None:
        self.wait_entity = entity

    def is_ready(self) -> bool:
        return True


class Session:
    """A participant. Any thread may call any method.

    Args:
        domain_id: The DDS domain; that of `ROS_DOMAIN_ID` where None.
        enclave: The security enclave it names to others.
        environment: Variables that set discovery; those of the process where None.

    Raises:
        EnvironmentVariableError: A variable cannot be used.
        TransportError: The participant cannot be made, for instance because the machine already
            has as many as discovery on the local host allows (33).
    """

    def __init__(
        self,
        domain_id: int | None = None,
        enclave: str = "/",
        environment: Mapping[str, str] | None = None,
    ) -> None:
        environment = os.environ if environment is None else environment
        self.domain_id = domain_id_from(environment) if domain_id is None else domain_id
        self.enclave = enclave
        DOMAINS.acquire(self.domain_id, environment)
        try:
            self.participant = self._create_participant(enclave)
        except BaseException:
            DOMAINS.release(self.domain_id)
            raise
        self.gid = dds.guid_of(self.participant)
        self._lock = threading.RLock()
        self._closed = False
        self._teller = Teller(self)
        self._nodes: list[NodeHandle] = []
        self._endpoint_count = 0
        self._known_peers: dict[int, Peer] = {}
        self._graph = Graph()
        self._graph_sources: list[GraphSource] = []
        self.graph_source = self.create_graph_source()
        self._builtin = {
            topic: dds.checked(
                dds.create_reader(self.participant, topic, None, None), "a discovery reader"
            )
            for topic in (dds.TOPIC_PARTICIPANTS, dds.TOPIC_PUBLICATIONS, dds.TOPIC_SUBSCRIPTIONS)
        }
        hash_data = naming.user_data(typehash=interfaces.type_hash(ANNOUNCEMENT_TYPE))
        told = EndpointQos(depth=1, durability=Durability.TRANSIENT_LOCAL)
        heard = replace(told, history=History.KEEP_ALL)
        common = (self, None, _DISCOVERY_TOPIC, ANNOUNCEMENT_TYPE)
        self._discovery_reader = Reader(*common, heard, hash_data, ignore_local=True)
        self._discovery_writer = Writer(*common, told, hash_data)
        self._waiter = Waiter()
        for entity in self._builtin.values():
            condition = dds.create_read_condition(entity, dds.ANY_STATE)
            self._waiter.attach(_Condition(dds.checked(condition, "a read condition")))
        self._waiter.attach(self._discovery_reader)
        self._update_graph()
        self._thread = threading.Thread(target=self._follow_graph, name="pneu-graph", daemon=True)
        self._thread.start()

    def _create_participant(self, enclave: str) -> int:
        data = naming.user_data(enclave=enclave)
        policies = dds.create_qos()
        dds.qset_userdata(policies, data, len(data))
        try:
            entity = dds.create_participant(self.domain_id, policies, None)
        finally:
            dds.delete_qos(policies)
        return dds.checked(
            entity,
            f"a participant in domain {self.domain_id}; the machine may have no free one left, or"
            " no network interface",
        )

    # Nodes and their endpoints.

    def add_node(self, namespace: str, name: str) -> NodeHandle:
        """Makes a node that others see.

        Args:
            namespace: Its namespace, such as `/` or `/rig`.
            name: Its name.

        Returns:
            NodeHandle: what the endpoints of the node are made with.
        """
        node = NodeHandle(namespace, name)
        with self._lock:
            self._check_open()
            self._nodes.append(node)
            self._tell_nodes()
        return node

    def remove_node(self, node: NodeHandle) -> None:
        """Removes a node from the graph; its endpoints are closed by who made them.

        Args:
            node: The node.
        """
        with self._lock:
            if node in self._nodes:
                self._nodes.remove(node)
                self._tell_nodes()

    def create_publication(
        self, node: NodeHandle, topic: str, type_name: str, qos: Any
    ) -> Publication:
        """Makes a publisher's end of a topic.

        Args:
            node: The node it belongs to.
            topic: Fully qualified name.
            type_name: Full name of the message.
            qos: An `EndpointQos` or an object with the attributes of `rclpy.qos.QoSProfile`.
        """
        made = Publication(self, node, *self._topic(topic, type_name, qos, writer=True))
        self._teller.begins(made)
        return made

    def publication_ends(self, publication: Publication) -> None:
        """Takes note of a publication that is closed.

        Args:
            publication: It.
        """
        self._teller.ends(publication)

    def create_subscription(
        self,
        node: NodeHandle,
        topic: str,
        type_name: str,
        qos: Any,
        ignore_local_publications: bool = False,
    ) -> Subscription:
        """Makes a subscriber's end of a topic.

        Args:
            node: The node it belongs to.
            topic: Fully qualified name.
            type_name: Full name of the message.
            qos: An `EndpointQos` or an object with the attributes of `rclpy.qos.QoSProfile`.
            ignore_local_publications: Whether what this session publishes is left out.
        """
        return Subscription(
            self,
            node,
            *self._topic(topic, type_name, qos, writer=False),
            ignore_local=ignore_local_publications,
        )

    def create_client(self, node: NodeHandle, service: str, type_name: str, qos: Any) -> ClientEnd:
        """Makes a client of a service.

        Args:
            node: The node it belongs to.
            service: Fully qualified name.
            type_name: Full name of the type, such as `std_srvs/srv/Trigger`.
            qos: An `EndpointQos` or an object with the attributes of `rclpy.qos.QoSProfile`.
        """
        self._check_open()
        return ClientEnd(self, node, service, type_name, resolve(qos))

    def create_server(self, node: NodeHandle, service: str, type_name: str, qos: Any) -> ServerEnd:
        """Makes a server of a service.

        Args:
            node: The node it belongs to.
            service: Fully qualified name.
            type_name: Full name of the type, such as `std_srvs/srv/Trigger`.
            qos: An `EndpointQos` or an object with the attributes of `rclpy.qos.QoSProfile`.
        """
        self._check_open()
        return ServerEnd(self, node, service, type_name, resolve(qos))

    def _topic(
        self, topic: str, type_name: str, qos: Any, *, writer: bool
    ) -> tuple[str, str, EndpointQos, bytes]:
        self._check_open()
        resolved = self._best_available(topic, resolve(qos), writer=writer)
        name = naming.topic_to_dds(topic, resolved.avoid_ros_namespace_conventions)
        data = naming.user_data(typehash=interfaces.type_hash(type_name))
        return name, type_name, resolved, data

    def _best_available(self, topic: str, qos: EndpointQos, *, writer: bool) -> EndpointQos:
        """Replaces BEST_AVAILABLE by the most that matches all endpoints on the topic."""
        wanted = (qos.reliability, qos.durability)
        if Reliability.BEST_AVAILABLE not in wanted and Durability.BEST_AVAILABLE not in wanted:
            return qos
        offered = [] if writer else self.publishers_info(topic)
        reliable = all(one.qos.reliability == Reliability.RELIABLE for one in offered)
        kept = all(one.qos.durability == Durability.TRANSIENT_LOCAL for one in offered)
        reliability, durability = wanted
        if reliability == Reliability.BEST_AVAILABLE:
            reliability = Reliability.RELIABLE if reliable else Reliability.BEST_EFFORT
        if durability == Durability.BEST_AVAILABLE:
            durability = Durability.TRANSIENT_LOCAL if kept else Durability.VOLATILE
        return replace(qos, reliability=reliability, durability=durability)

    def next_endpoint_id(self) -> str:
        """Returns a new identity of a client or server, as USER_DATA carries it."""
        with self._lock:
            self._endpoint_count += 1
            return naming.endpoint_id(self.gid[:12] + self._endpoint_count.to_bytes(4, "big"))

    def entity_added(self, node: NodeHandle, gid: bytes, *, writer: bool) -> None:
        """Notes an endpoint of a node, and tells others.

        Args:
            node: The node.
            gid: Identity of the endpoint.
            writer: Whether it is a writer.
        """
        with self._lock:
            (node.writers if writer else node.readers).append(gid)
            self._tell_nodes()

    def entity_removed(self, node: NodeHandle, gid: bytes, *, writer: bool) -> None:
        """Forgets an endpoint of a node, and tells others.

        Args:
            node: The node.
            gid: Identity of the endpoint.
            writer: Whether it was a writer.
        """
        with self._lock:
            known = node.writers if writer else node.readers
            if gid in known:
                known.remove(gid)
                self._tell_nodes()

    def _tell_nodes(self) -> None:
        if self._closed:
            return
        entries = [
            NodeEntry(node.namespace, node.name, list(node.readers), list(node.writers))
            for node in self._nodes
        ]
        self._graph.nodes_told(self.gid, entries)
        self._discovery_writer.publish(encode_nodes(self.gid, entries))
        self._trigger_graph_sources()

    # Peers.

    def matched_writer(self, reader: int, handle: int) -> Peer | None:
        """Returns the writer that a reader receives from.

        Args:
            reader: The DDS reader.
            handle: Local number of the writer.

        Returns:
            Peer: the writer; None where it is not matched, and was not looked up before.
        """
        return self._matched(dds.matched_writer_data, reader, handle)

    def matched_reader(self, writer: int, handle: int) -> Peer | None:
        """Returns a reader that a writer sends to.

        Args:
            writer: The DDS writer.
            handle: Local number of the reader.

        Returns:
            Peer: the reader; None where it is not matched, and was not looked up before.
        """
        return self._matched(dds.matched_reader_data, writer, handle)

    def _matched(self, function: Any, entity: int, handle: int) -> Peer | None:
        found = self._known_peers.get(handle)
        if found is None:
            answer = function(entity, handle, construct_peer, convert_policies)
            if answer is None or answer[0] is None:
                return None
            if len(self._known_peers) >= _KNOWN_PEERS:  # handles are never used twice
                self._known_peers.clear()
            found = self._known_peers[handle] = answer[0]
        return found

    # The graph.

    @property
    def graph(self) -> Graph:
        """What is known of the graph at this moment."""
        self._update_graph()
        return self._graph

    def create_graph_source(self) -> GraphSource:
        """Returns a further source that becomes ready when the graph has changed."""
        source = GraphSource()
        with self._lock:
            # those that their owners have closed since go at this occasion
            open_ones = [one for one in self._graph_sources if one.wait_entity]
            self._graph_sources = [*open_ones, source]
        return source

    def graph_version(self) -> int:
        """Returns a number that grows when the graph changes."""
        return self.graph.version

    def _trigger_graph_sources(self) -> None:
        for source in list(self._graph_sources):
            source.trigger()

    def _follow_graph(self) -> None:
        while not self._closed:
            self._waiter.wait()
            try:
                self._update_graph()
            except TransportError:
                if not self._closed:
                    _log.exception("Discovery stopped")
                    raise

    def _update_graph(self) -> None:
        """Takes what discovery has found. Called also by who asks, so that the answer is new."""
        with self._lock:
            if self._closed:
                return
            before = self._graph.version
            self._take_participants(self._builtin[dds.TOPIC_PARTICIPANTS])
            self._take_endpoints(self._builtin[dds.TOPIC_PUBLICATIONS])
            self._take_endpoints(self._builtin[dds.TOPIC_SUBSCRIPTIONS])
            while (sample := self._discovery_reader.take()) is not None:
                self._hear_nodes(sample.data)
            changed = self._graph.version != before
            listeners = self._graph.count_subscribers(SENT_TOPIC) if changed else 0
        if changed:
            self._teller.heard_of_listeners(listeners)
            self._trigger_graph_sources()

    def _take_participants(self, reader: int) -> None:
        def construct(gid: bytes, data: bytes, info: Any) -> tuple[bytes, bytes, Any]:
            return gid, data, info

        while taken := dds.take_participants(reader, _BATCH, construct, _participant_data):
            for gid, data, info in _list(taken):
                if info.instance_state == dds.ALIVE and info.valid_data:
                    values = naming.parse_user_data(data)
                    self._graph.participant_found(gid, values.get("enclave", ""))
                else:
                    self._graph.participant_lost(gid)

    def _take_endpoints(self, reader: int) -> None:
        while taken := dds.take_endpoints(reader, _BATCH, construct_peer, convert_policies):
            for peer, gid, info in _list(taken):
                if peer is None or info.instance_state != dds.ALIVE:
                    self._graph.endpoint_lost(gid)
                elif not peer.topic.startswith("DCPS"):  # the library's own
                    self._graph.endpoint_found(peer)

    def _hear_nodes(self, data: bytes) -> None:
        try:
            participant, entries = decode_nodes(data)
        except interfaces.DecodeError as error:
            _log.warning("Ignored a malformed announcement of nodes: %s", error)
            return
        self._graph.nodes_told(participant, entries)

    def __getattr__(self, name: str) -> Any:
        # the questions to the graph: node_names, count_publishers, publishers_info, ...
        if not name.startswith("_") and callable(getattr(Graph, name, None)):
            return getattr(self.graph, name)
        raise AttributeError(f"'Session' object has no attribute '{name}'")

    # The end.

    def _check_open(self) -> None:
        if self._closed:
            raise TransportError("The session is closed.")

    def close(self) -> None:
        """Leaves the graph; closes what was made with it. Further calls do nothing."""
        if not self._closed:
            self._teller.close()
        with self._lock:
            if self._closed:
                return
            self._closed = True
        self._waiter.wake()
        if threading.current_thread() is not self._thread:
            self._thread.join()
        self._waiter.close()
        for source in self._graph_sources:
            source.close()
        dds.delete(self.participant)  # and all below it
        DOMAINS.release(self.domain_id)


def _participant_data(pointer: int) -> bytes:
    return read_user_data(pointer)


def _list(taken: Any) -> Any:
    if isinstance(taken, int):
        dds.checked(taken, "to take what discovery found")
    return taken
