# SPDX-License-Identifier: Apache-2.0
"""The rules for namespaces."""

import re

from rclpy.exceptions import InvalidNamespaceException

_LONGEST = 245


def validate_namespace(namespace: str) -> bool:
    """Check an absolute namespace.

    Args:
        namespace: The namespace.

    Returns:
        bool: True; an invalid one raises InvalidNamespaceException.
    """
    fault = _fault(namespace)
    if fault is not None:
        raise InvalidNamespaceException(namespace, *fault)
    return True


def _fault(namespace: str) -> tuple[str, int] | None:
    """What is wrong with a namespace, and where."""
    if not namespace:
        return "namespace must not be empty", 0
    if namespace == "/":
        return None
    if namespace[0] != "/":
        return "namespace must be absolute, it must lead with a '/'", 0
    if namespace.endswith("/"):
        return "namespace must not end with a '/', unless only a '/'", len(namespace) - 1
    bad = re.search(r"[^A-Za-z0-9_/]", namespace)
    if bad:
        return (
            "namespace must not contain characters other than alphanumerics, '_', or '/'",
            bad.start(),
        )
    if (double := namespace.find("//")) >= 0:
        return "namespace must not contain a repeated '/'", double + 1
    digit = re.search(r"/[0-9]", namespace)
    if digit:
        return "namespace must not have a token that starts with a number", digit.start() + 1
    if len(namespace) > _LONGEST:
        return f"namespace must not be longer than {_LONGEST} characters", _LONGEST
    return None
