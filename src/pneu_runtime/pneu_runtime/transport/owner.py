# SPDX-License-Identifier: Apache-2.0
"""What the ends of topics and services ask of the session that they belong to."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

from pneu_runtime.transport.graph import Peer


@dataclass(eq=False)
class NodeHandle:
    """A node of this session.

    Attributes:
        namespace: Its namespace, such as `/` or `/rig`.
        name: Its name.
        readers: Identities of its readers.
        writers: Identities of its writers.
    """

    namespace: str
    name: str
    readers: list[bytes] = field(default_factory=list)
    writers: list[bytes] = field(default_factory=list)


class Owner(Protocol):
    """The session, as its endpoints see it.

    Attributes:
        participant: Its DDS participant.
    """

    participant: int

    def next_endpoint_id(self) -> str:
        """Returns an identity for a client or a server."""

    def entity_added(self, node: NodeHandle, gid: bytes, *, writer: bool) -> None:
        """Takes note of a reader or writer of a node.

        Args:
            node: The node.
            gid: Identity of the endpoint.
            writer: Whether it writes, else it reads.
        """

    def entity_removed(self, node: NodeHandle, gid: bytes, *, writer: bool) -> None:
        """Takes note that one is closed.

        Args:
            node: The node.
            gid: Identity of the endpoint.
            writer: Whether it writes, else it reads.
        """

    def matched_writer(self, reader: int, handle: int) -> Peer | None:
        """Returns who writes to a reader by a handle.

        Args:
            reader: The reader.
            handle: The other's handle.
        """

    def matched_reader(self, writer: int, handle: int) -> Peer | None:
        """Returns who reads of a writer by a handle.

        Args:
            writer: The writer.
            handle: The other's handle.
        """

    def publication_ends(self, publication: Any) -> None:
        """Takes note that a publication is closed.

        Args:
            publication: The publication.
        """
