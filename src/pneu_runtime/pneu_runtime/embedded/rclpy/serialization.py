# SPDX-License-Identifier: Apache-2.0
"""Messages to the bytes of the wire and back."""

from typing import Any

from pneu_runtime import interfaces
from rclpy.type_support import check_for_type_support


def serialize_message(message: Any) -> bytes:
    """Return the bytes of a message.

    Args:
        message: The message.

    Returns:
        bytes: CDR with its header of four bytes.
    """
    check_for_type_support(type(message))
    return interfaces.serialize(message)


def deserialize_message(serialized_message: bytes, message_type: type) -> Any:
    """Return the message that bytes hold.

    Args:
        serialized_message: CDR with its header of four bytes.
        message_type: The class of the message.

    Returns:
        object: The message.
    """
    check_for_type_support(message_type)
    return interfaces.deserialize(serialized_message, message_type)
