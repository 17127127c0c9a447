# SPDX-License-Identifier: Apache-2.0
"""Type descriptions and the RIHS01 hash of them.

The description is that of type_description_interfaces/msg/TypeDescription; the hash is the SHA-256
of its JSON without default values, as in rosidl_generator_type_description of ros2/rosidl (the
proposal is ros-infrastructure/rep pull request 381).
"""

import hashlib
import json
from typing import Any

from pneu_runtime.interfaces.model import Field
from pneu_runtime.interfaces.registry import Registry

_TYPE_ID = {
    "": 1,
    "int8": 2,
    "uint8": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "bool": 15,
    "byte": 16,
    "string": 17,
    "bounded string": 21,
}
_KIND_OFFSET = {"one": 0, "array": 48, "bounded": 96, "sequence": 144}


def type_description(registry: Registry, name: str) -> dict[str, Any]:
    """Describes a type and all that it is made of.

    Args:
        registry: Where definitions are found.
        name: Full name of a message, service or action.

    Returns:
        dict: keys `type_description` and `referenced_type_descriptions`, sorted by name.
    """
    described: dict[str, dict[str, Any]] = {}
    waiting = [name]
    while waiting:
        current = waiting.pop()
        if current in described:
            continue
        fields = registry.structure(current).wire_fields
        described[current] = {
            "type_name": current,
            "fields": [_describe(field) for field in fields],
        }
        waiting += [field.type.base for field in fields if field.type.is_message]
    own = described.pop(name)
    return {
        "type_description": own,
        "referenced_type_descriptions": [described[one] for one in sorted(described)],
    }


def rihs01(registry: Registry, name: str) -> str:
    """Computes the hash by which ROS 2 tells versions of a type apart.

    Args:
        registry: Where definitions are found.
        name: Full name of a message, service or action.

    Returns:
        str: `RIHS01_` and 64 hexadecimal digits.
    """
    text = json.dumps(type_description(registry, name))
    return "RIHS01_" + hashlib.sha256(text.encode()).hexdigest()


def _describe(field: Field) -> dict[str, Any]:
    base = "" if field.type.is_message else field.type.base
    if field.type.string_bound:
        base = "bounded string"
    return {
        "name": field.name,
        "type": {
            "type_id": _TYPE_ID[base] + _KIND_OFFSET[field.type.kind],
            "capacity": field.type.count,
            "string_capacity": field.type.string_bound,
            "nested_type_name": field.type.base if field.type.is_message else "",
        },
    }
