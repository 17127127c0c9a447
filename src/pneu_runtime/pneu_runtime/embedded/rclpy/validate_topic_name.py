# SPDX-License-Identifier: Apache-2.0
"""The rules for names of topics and services, as code may write them."""

import re

from rclpy.exceptions import InvalidServiceNameException, InvalidTopicNameException

TOPIC_SEPARATOR_STRING = "/"


def validate_topic_name(name: str, *, is_service: bool = False) -> bool:
    """Check the name of a topic or service; it may be relative and hold substitutions.

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
    if name[0].isdigit():
        return "topic name token must not start with a number", 0
    if name.endswith("/"):
        return "topic name must not end with a forward slash", len(name) - 1
    bad = re.search(r"[^A-Za-z0-9_/{}~]", name)
    if bad:
        return (
            "topic name must not contain characters other than alphanumerics, '_', '~', '{' or '}'",
            bad.start(),
        )
    tilde = name.rfind("~")
    if tilde > 0:
        return "topic name must not have tilde '~' unless it is the first character", tilde
    # rcl looks at the second character of longer names only
    if name[0] == "~" and len(name) > 2 and name[1] != "/":
        return "topic name has a tilde '~' that is not followed by a forward slash", 1
    digit = re.search(r"/[0-9]", name)
    if digit:
        return "topic name token must not start with a number", digit.start() + 1
    return _brace_fault(name)


def _brace_fault(name: str) -> tuple[str, int] | None:
    outside = re.sub(r"\{[^{}]*\}", lambda match: "_" * len(match.group()), name)
    brace = re.search(r"[{}]", outside)
    if brace:
        return "topic name has unbalanced curly braces, '{' and '}'", brace.start()
    for match in re.finditer(r"\{([^{}]*)\}", name):
        if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", match.group(1)):
            return "topic name has a substitution with invalid characters", match.start(1)
    return None
