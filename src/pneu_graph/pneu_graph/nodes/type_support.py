# SPDX-License-Identifier: Apache-2.0
"""Message classes, definitions and hashes by type name, on real and on embedded rclpy."""

import importlib
from typing import Any

from pneu_common.errors import InputError
from pneu_common.interfaces import has_interfaces
from pneu_runtime import hook

KINDS = ("msg", "srv", "action")


def interface_class(type_name: str, kind: str = "msg") -> Any:
    """Returns the Python class of an interface.

    Args:
        type_name: Such as ``std_msgs/msg/String``; ``std_msgs/String`` is understood too.
        kind: ``msg``, ``srv`` or ``action``.

    Raises:
        InputError: There is no such type here.
    """
    hook.install()
    parts = type_name.split("/")
    if len(parts) == 2:
        parts.insert(1, kind)
    if len(parts) != 3 or parts[1] != kind or not all(part.isidentifier() for part in parts):
        raise InputError(f"type {type_name!r}: is written package/{kind}/Name")
    try:
        if not has_interfaces(parts[0], kind):
            raise ImportError
        return getattr(importlib.import_module(f"{parts[0]}.{kind}"), parts[2])
    except (ImportError, AttributeError):
        raise InputError(
            f"type {type_name!r}: not known here; `pneu interface list` shows those that are"
        ) from None


def definition_text(type_name: str) -> str:
    """Returns the definition of a message type with those of the types in it; empty if unknown.

    Args:
        type_name: Such as ``std_msgs/msg/String``.
    """
    from pneu_runtime import interfaces

    try:
        return interfaces.full_text(type_name)
    except InputError:
        return ""


def type_hash(type_name: str) -> str:
    """Returns the ``RIHS01_`` hash of an interface; empty if it is unknown.

    Args:
        type_name: Such as ``std_msgs/msg/String``.
    """
    from pneu_runtime import interfaces

    try:
        return interfaces.type_hash(type_name)
    except InputError:
        return ""
