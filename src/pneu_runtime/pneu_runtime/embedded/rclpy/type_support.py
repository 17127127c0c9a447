# SPDX-License-Identifier: Apache-2.0
"""Checks that a class is one of a message, service or action."""

from typing import Any


def check_for_type_support(msg_or_srv_type: Any) -> None:
    """Raise AttributeError where a class is not one of an interface.

    Args:
        msg_or_srv_type: The class.
    """
    module = getattr(msg_or_srv_type, "__module__", "")
    if not isinstance(msg_or_srv_type, type) or not any(
        f".{kind}" in module for kind in ("msg", "srv", "action")
    ):
        raise AttributeError(
            f"{msg_or_srv_type!r} has no type support. It should be the class of a ROS 2 message, "
            "service or action."
        )


def check_is_valid_msg_type(msg_type: Any) -> None:
    """Raise where a class is not one of a message.

    Args:
        msg_type: The class.
    """
    check_for_type_support(msg_type)
    if not hasattr(msg_type, "get_fields_and_field_types"):
        raise RuntimeError(
            f"invalid message type, '{msg_type}' doesn't satisfy the requirements of the class "
            "of a message"
        )


def check_is_valid_srv_type(srv_type: Any) -> None:
    """Raise where a class is not one of a service.

    Args:
        srv_type: The class.
    """
    check_for_type_support(srv_type)
    for part in ("Request", "Response"):
        if not hasattr(srv_type, part):
            raise RuntimeError(f"invalid service type, '{srv_type}' has no attribute '{part}'")
