# SPDX-License-Identifier: Apache-2.0
"""The rules for names of parameters."""

from rclpy.exceptions import InvalidParameterException


def validate_parameter_name(name: str) -> bool:
    """Check the name of a parameter.

    Args:
        name: The name.

    Returns:
        bool: True; an empty name raises InvalidParameterException.
    """
    if not name:
        raise InvalidParameterException(name)
    return True
