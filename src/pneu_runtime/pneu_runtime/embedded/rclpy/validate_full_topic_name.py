# SPDX-License-Identifier: Apache-2.0
"""The rules for full names of topics and services."""

import re

from rclpy.exceptions import InvalidServiceNameException, InvalidTopicNameException

# DDS allows 256 characters, of which ROS keeps some for its prefixes and suffixes.
_LONGEST = 247


def validate_full_topic_name(name: str, *, is_service: bool = False) -> bool:
    """Check the full name of a topic or service.

    Args:
        name: The name.
        is_service: Whether it is one of a service, for the exception.

    Returns:
        bool: True; an invalid name raises InvalidTopicNameException or
        InvalidServiceNameException.
    """
    fault = _fault(name)
    if fault is not None:
        if is_service:
            raise InvalidServiceNameException(name, *fault)
        raise InvalidTopicNameException(name, *fault)
    return True


def _fault(name: str) -> tuple[str, int] | None:
    """What is wrong with a name, and where."""
    if not name:
        return "topic name must not be empty", 0
    if name[0] != "/":
        return "topic name must be absolute, it must lead with a '/'", 0
    if name.endswith("/"):
        return "topic name must not end with a '/'", len(name) - 1
    bad = re.search(r"[^A-Za-z0-9_/]", name)
    if bad:
        return (
            "topic name must not contain characters other than alphanumerics, '_', or '/'",
            bad.start(),
        )
    if (double := name.find("//")) >= 0:
        return "topic name must not contain a repeated '/'", double + 1
    digit = re.search(r"/[0-9]", name)
    if digit:
        return "topic name must not have a token that starts with a number", digit.start() + 1
    if len(name) > _LONGEST:
        return f"topic name must not be longer than {_LONGEST} characters", _LONGEST
    return None
