# SPDX-License-Identifier: Apache-2.0
"""Services as rmw_cyclonedds puts them on the wire: two topics, and a header that tells requests.

Before the message stand the client's number (64 bits) and the number of the request (64 bits); the
server sends both back, and a client drops replies with another number than its own. Servers and
clients are told by a key in their USER_DATA. Other vendors use another protocol with the same topic
names; they are refused by that missing key, because answering or asking them does harm
(ros2/rmw_cyclonedds issue 577). Source: that repository, branch jazzy, serdata.hpp and
rmw_node.cpp.
"""

from __future__ import annotations

import itertools
import struct
import time
from typing import NamedTuple

from pneu_runtime.interfaces import type_hash
from pneu_runtime.transport import dds
from pneu_runtime.transport.endpoints import Reader, Sample, Writer
from pneu_runtime.transport.errors import ForeignServiceError
from pneu_runtime.transport.naming import reply_to_dds, request_to_dds, user_data
from pneu_runtime.transport.owner import NodeHandle, Owner
from pneu_runtime.transport.qos import EndpointQos

_HEADER = {0: struct.Struct(">Qq"), 1: struct.Struct("<Qq")}
_BODY = 20  # after 4 bytes of encapsulation and 16 of header
_REPLY_WAIT_S = 0.1


class RequestId(NamedTuple):
    """Tells a request from all others.

    Attributes:
        client: Number of the client.
        sequence: Number of the request at the client.
        publication_handle: Local number of the writer that sent it.
    """

    client: int
    sequence: int
    publication_handle: int


class _ServicePart:
    """The two topics of one service, seen from the client or from the server."""

    def __init__(
        self,
        session: Owner,
        node: NodeHandle,
        service: str,
        type_name: str,
        qos: EndpointQos,
        role: str,
    ) -> None:
        self.session = session
        self.service = service
        self.type_name = type_name
        self.id = session.next_endpoint_id()
        request, reply = f"{type_name}_Request", f"{type_name}_Response"
        own, other = (reply, request) if role == "serviceid" else (request, reply)
        topics = {request: request_to_dds(service), reply: reply_to_dds(service)}

        def data(name: str) -> bytes:
            return user_data(**{role: self.id, "typehash": type_hash(name)})

        self._reader = Reader(session, node, topics[other], other, qos, data(other), True)
        try:
            self._writer = Writer(session, node, topics[own], own, qos, data(own), True)
        except BaseException:
            self._reader.close()
            raise

    @property
    def wait_entity(self) -> int:
        """The DDS entity that is triggered; 0 once it is closed."""
        return self._reader.wait_entity

    def is_ready(self) -> bool:
        """Returns whether there may be something to take."""
        return self._reader.is_ready()

    @property
    def gid(self) -> bytes:
        """16 bytes that identify the sending end."""
        return self._writer.gid

    @property
    def request_qos(self) -> EndpointQos:
        """Quality of service of both topics."""
        return self._writer.qos

    def close(self) -> None:
        """Removes it from the network. Further calls do nothing."""
        self._reader.close()
        self._writer.close()

    def _send(self, data: bytes, client: int, sequence: int) -> None:
        header = _HEADER[data[1] & 1].pack(client, sequence)
        self._writer.publish(b"".join((data[:4], header, data[4:])))

    @staticmethod
    def _split(data: bytes) -> tuple[int, int, bytes] | None:
        """Client, sequence number and message; None where it is too short to be one."""
        if len(data) <= _BODY:
            return None
        client, sequence = _HEADER[data[1] & 1].unpack_from(data, 4)
        return client, sequence, data[:4] + data[_BODY:]


class ClientEnd(_ServicePart):
    """A client of a service. A source for a `Waiter`, ready when a reply came.

    Args:
        session: The session it belongs to.
        node: The node it belongs to.
        service: Fully qualified name.
        type_name: Full name of the type.
        qos: What is asked for.
    """

    def __init__(
        self, session: Owner, node: NodeHandle, service: str, type_name: str, qos: EndpointQos
    ) -> None:
        super().__init__(session, node, service, type_name, qos, "clientid")
        self._number = dds.handle_of(self._writer.entity)
        self._sequence = itertools.count(1)

    def send(self, data: bytes) -> int:
        """Sends a request.

        Args:
            data: CDR bytes of the request, with header.

        Returns:
            int: number of the request, which its reply carries too.

        Raises:
            ForeignServiceError: All servers are of a vendor whose protocol is another.
        """
        servers = self._servers()
        if servers and not any(servers):
            raise ForeignServiceError(
                f"Service '{self.service}' is served by a peer that is not rmw_cyclonedds; services"
                " work only between participants of one DDS vendor. Start that node with"
                " RMW_IMPLEMENTATION=rmw_cyclonedds_cpp."
            )
        sequence = next(self._sequence)
        self._send(data, self._number, sequence)
        return sequence

    def take(self) -> tuple[int, bytes, Sample] | None:
        """Returns number of the request, CDR bytes of the reply and its origin, or None."""
        while (sample := self._reader.take()) is not None:
            parts = self._split(sample.data)
            if parts is not None and parts[0] == self._number:
                return parts[1], parts[2], sample
        return None

    def server_is_ready(self) -> bool:
        """Returns whether a server is there that hears requests and whose replies are heard."""
        replying = {
            peer.service_id
            for handle in dds.matched_handles(dds.matched_writers, self._reader.entity)
            if (peer := self.session.matched_writer(self._reader.entity, handle))
        }
        return any(server and server in replying for server in self._servers())

    def _servers(self) -> list[str]:
        """The service id of each matched reader of requests; empty for one of another vendor."""
        entity = self._writer.entity
        return [
            peer.service_id
            for handle in dds.matched_handles(dds.matched_readers, entity)
            if (peer := self.session.matched_reader(entity, handle))
        ]


class ServerEnd(_ServicePart):
    """A server of a service. A source for a `Waiter`, ready when a request came.

    Args:
        session: The session it belongs to.
        node: The node it belongs to.
        service: Fully qualified name.
        type_name: Full name of the type.
        qos: What is asked for.
    """

    def __init__(
        self, session: Owner, node: NodeHandle, service: str, type_name: str, qos: EndpointQos
    ) -> None:
        super().__init__(session, node, service, type_name, qos, "serviceid")

    def take(self) -> tuple[RequestId, bytes, Sample] | None:
        """Returns the identity of a request, its CDR bytes and its origin, or None."""
        while (sample := self._reader.take()) is not None:
            parts = self._split(sample.data)
            if parts is None:
                continue
            handle = sample.publication_handle
            writer = self.session.matched_writer(self._reader.entity, handle)
            # a client of another vendor, whose request has no header; or one that is gone
            if writer is None or not writer.client_id:
                continue
            return RequestId(parts[0], parts[1], handle), parts[2], sample
        return None

    def respond(self, request_id: RequestId, data: bytes) -> bool:
        """Sends a reply.

        Discovery is not ordered: a client may be heard before its reader of replies is known. Then
        this waits for the reader, at most a tenth of a second, as rmw_cyclonedds does.

        Args:
            request_id: As `take` gave it.
            data: CDR bytes of the reply, with header.

        Returns:
            bool: whether it was sent; False where the client is gone.
        """
        end = time.monotonic() + _REPLY_WAIT_S
        while not self._hears(request_id):
            writers = dds.matched_handles(dds.matched_writers, self._reader.entity)
            if request_id.publication_handle not in writers:
                return False
            if time.monotonic() > end:
                return False
            time.sleep(0.001)
        self._send(data, request_id.client, request_id.sequence)
        return True

    def _hears(self, request_id: RequestId) -> bool:
        """Whether the client's reader of replies is matched."""
        writer = self.session.matched_writer(self._reader.entity, request_id.publication_handle)
        if writer is None:
            return False
        entity = self._writer.entity
        return any(
            (peer := self.session.matched_reader(entity, handle)) is not None
            and peer.client_id == writer.client_id
            for handle in dds.matched_handles(dds.matched_readers, entity)
        )
