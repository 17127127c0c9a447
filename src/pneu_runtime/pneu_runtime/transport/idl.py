# SPDX-License-Identifier: Apache-2.0
"""Type descriptions for DDS discovery, made from ROS definitions.

Cyclone DDS wants to know the types of topics. ROS peers announce none and match by name; programs
written with DDS alone do announce theirs, and match if ours is the same structure. Samples are
never encoded by these classes; the library does check received bytes against them.
"""

import functools
from typing import Any

from cyclonedds.idl import make_idl_struct
from cyclonedds.idl import types as idl_types

from pneu_runtime.interfaces.catalogue import registry
from pneu_runtime.interfaces.model import FieldType

types: Any = idl_types  # its generic types are not declared as such

_PRIMITIVES: dict[str, Any] = {"bool": bool, "byte": types.byte} | {
    name: getattr(types, name)
    for name in (
        *("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"),
        *("float32", "float64"),
    )
}


@functools.cache
def topic_type(name: str, service_header: bool = False) -> Any:
    """Returns the class that describes a type to the library.

    Args:
        name: Full name of the message.
        service_header: Whether the identity of the request stands before the message, as it does
            in the requests and replies of rmw_cyclonedds.
    """
    package, kind, short = name.split("/")
    fields = {"client_guid": types.uint64, "sequence_number": types.int64} if service_header else {}
    for field in registry().structure(name).wire_fields:
        fields[field.name] = _field_type(field.type)
    return make_idl_struct(
        f"{short}_", f"{package}.{kind}.dds_.{short}_", fields, dataclassify=False
    )


def _field_type(field: FieldType) -> Any:
    if field.is_message:
        base = topic_type(field.base)
    elif field.base == "string":
        base = types.bounded_str[field.string_bound] if field.string_bound else str
    else:
        base = _PRIMITIVES[field.base]
    if field.kind == "array":
        return types.array[base, field.count]
    if field.kind == "bounded":
        return types.sequence[base, field.count]
    return types.sequence[base] if field.kind == "sequence" else base
