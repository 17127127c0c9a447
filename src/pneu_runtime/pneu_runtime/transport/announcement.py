# SPDX-License-Identifier: Apache-2.0
"""The message on `ros_discovery_info`: which endpoints of a participant belong to which node."""

from typing import Any

import numpy as np

from pneu_runtime import interfaces
from pneu_runtime.transport.graph import NodeEntry

ANNOUNCEMENT_TYPE = "rmw_dds_common/msg/ParticipantEntitiesInfo"


def encode_nodes(participant: bytes, entries: list[NodeEntry]) -> bytes:
    """Returns the CDR bytes by which a participant tells its nodes.

    Args:
        participant: Its identity.
        entries: All its nodes.
    """
    gid = interfaces.message_class("rmw_dds_common/msg/Gid")
    node = interfaces.message_class("rmw_dds_common/msg/NodeEntitiesInfo")
    whole = interfaces.message_class(ANNOUNCEMENT_TYPE)

    def make(data: bytes) -> Any:
        return gid(data=np.frombuffer(data, np.uint8))

    nodes = [
        node(
            node_namespace=entry.namespace,
            node_name=entry.name,
            reader_gid_seq=[make(one) for one in entry.readers],
            writer_gid_seq=[make(one) for one in entry.writers],
        )
        for entry in entries
    ]
    return interfaces.serialize(whole(gid=make(participant), node_entities_info_seq=nodes))


def decode_nodes(data: bytes) -> tuple[bytes, list[NodeEntry]]:
    """Reads what a participant tells of its nodes.

    Args:
        data: CDR bytes.

    Returns:
        tuple: identity of the participant, and its nodes.

    Raises:
        DecodeError: The bytes are no such announcement.
    """
    message: Any = interfaces.deserialize(data, interfaces.message_class(ANNOUNCEMENT_TYPE))
    entries = [
        NodeEntry(
            node.node_namespace,
            node.node_name,
            [one.data.tobytes() for one in node.reader_gid_seq],
            [one.data.tobytes() for one in node.writer_gid_seq],
        )
        for node in message.node_entities_info_seq
    ]
    return message.gid.data.tobytes(), entries
