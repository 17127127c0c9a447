# SPDX-License-Identifier: Apache-2.0
"""The rules for names of nodes."""

import re

from rclpy.exceptions import InvalidNodeNameException

_LONGEST = 255


def validate_node_name(node_name: str) -> bool:
    """Check the name of a node.

    Args:
        node_name: The name.

    Returns:
        bool: True; an invalid one raises InvalidNodeNameException.
    """
    fault = _fault(node_name)
    if fault is not None:
        raise InvalidNodeNameException(node_name, *fault)
    return True


def _fault(name: str) -> tuple[str, int] | None:
    """What is wrong with a name, and where."""
    if not name:
        return "node name must not be empty", 0
    bad = re.search(r"[^A-Za-z0-9_]", name)
    if bad:
        return "node name must not contain characters other than alphanumerics or '_'", bad.start()
    if name[0].isdigit():
        return "node name must not start with a number", 0
    if len(name) > _LONGEST:
        return f"node name must not be longer than {_LONGEST} characters", _LONGEST
    return None
