# SPDX-License-Identifier: Apache-2.0
"""Full names of topics and services from those that code gives."""

from rclpy.validate_topic_name import validate_topic_name


def expand_topic_name(
    topic_name: str, node_name: str, node_namespace: str, *, is_service: bool = False
) -> str:
    """Return the full name of a topic or service.

    Args:
        topic_name: The name: absolute, relative, private (``~``), with ``{node}``, ``{ns}`` or
            ``{namespace}``.
        node_name: Name of the node.
        node_namespace: Namespace of the node, absolute.
        is_service: Whether the name is one of a service, for the text of an error.

    Returns:
        str: The full name.
    """
    validate_topic_name(topic_name, is_service=is_service)
    namespace = node_namespace.rstrip("/")
    name = topic_name
    for key, value in (
        ("{node}", node_name),
        ("{ns}", node_namespace),
        ("{namespace}", node_namespace),
    ):
        name = name.replace(key, value)
    if "{" in name:
        raise ValueError(f"unknown substitution in the name '{topic_name}'")
    if name.startswith("~"):
        return f"{namespace}/{node_name}{name[1:]}"
    return name if name.startswith("/") else f"{namespace}/{name}"
