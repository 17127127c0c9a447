# SPDX-License-Identifier: Apache-2.0
"""ROS 2 interfaces: their definitions, Python classes, bytes, hashes and texts.

`message_class("sensor_msgs/msg/FluidPressure")` gives a class that behaves as rclpy's;
`serialize` and `deserialize` turn messages into the bytes of the wire and back.
"""

from pneu_runtime.interfaces.catalogue import (
    action_class,
    deserialize,
    full_text,
    known_types,
    message_class,
    serialize,
    service_class,
    type_description,
    type_hash,
    type_name,
    type_sources,
)
from pneu_runtime.interfaces.classes import Message
from pneu_runtime.interfaces.convert import from_dict, to_dict
from pneu_runtime.interfaces.errors import (
    DecodeError,
    DefinitionError,
    EncodeError,
    UnknownInterfaceError,
)

__all__ = [
    "DecodeError",
    "DefinitionError",
    "EncodeError",
    "Message",
    "UnknownInterfaceError",
    "action_class",
    "deserialize",
    "from_dict",
    "full_text",
    "known_types",
    "message_class",
    "serialize",
    "service_class",
    "to_dict",
    "type_description",
    "type_hash",
    "type_name",
    "type_sources",
]
