# SPDX-License-Identifier: Apache-2.0
"""Names as a node sees them: expansion to full names, then the first remapping that fits."""

from dataclasses import dataclass

from rclpy._arguments import RemapRule
from rclpy.expand_topic_name import expand_topic_name
from rclpy.validate_full_topic_name import validate_full_topic_name
from rclpy.validate_namespace import validate_namespace
from rclpy.validate_node_name import validate_node_name


@dataclass(frozen=True)
class NodeNames:
    """Name and namespace of a node, and the remappings that hold for it.

    Attributes:
        name: Name, after remapping.
        namespace: Namespace, after remapping, absolute.
        given_name: Name that the code gave; remappings for one node are matched with it.
        rules: Remappings in the order of their precedence.
    """

    name: str
    namespace: str
    given_name: str
    rules: tuple[RemapRule, ...]

    @property
    def full_name(self) -> str:
        """Name with its namespace."""
        return f"{self.namespace.rstrip('/')}/{self.name}"

    @property
    def logger_name(self) -> str:
        """Name of the node's logger."""
        return self.full_name.strip("/").replace("/", ".")

    def expand(self, name: str, *, is_service: bool = False) -> str:
        """Return the full name of a topic or service, without remapping.

        Args:
            name: The name as given.
            is_service: Whether it is one of a service.

        Returns:
            str: The full name.
        """
        full = expand_topic_name(name, self.name, self.namespace, is_service=is_service)
        validate_full_topic_name(full, is_service=is_service)
        return full

    def resolve(self, name: str, *, is_service: bool = False, only_expand: bool = False) -> str:
        """Return the full name of a topic or service, remapped.

        Args:
            name: The name as given.
            is_service: Whether it is one of a service.
            only_expand: Whether the remappings are left out.

        Returns:
            str: The full name.
        """
        full = self.expand(name, is_service=is_service)
        if only_expand:
            return full
        kinds = ("any", "service") if is_service else ("any", "topic")
        for rule in self.rules:
            if rule.kind not in kinds or rule.node not in (None, self.given_name):
                continue
            if self.expand(rule.match, is_service=is_service) == full:
                return self.expand(rule.replacement, is_service=is_service)
        return full


def node_names(name: str, namespace: str, rules: tuple[RemapRule, ...]) -> NodeNames:
    """Apply the remappings of node name and namespace.

    Args:
        name: Name that the code gives.
        namespace: Namespace that the code gives, may be empty or relative.
        rules: Remappings in the order of their precedence.

    Returns:
        NodeNames: The names.
    """
    validate_node_name(name)
    namespace = namespace if namespace.startswith("/") else f"/{namespace}"
    validate_namespace(namespace)

    def remapped(kind: str, otherwise: str) -> str:
        for rule in rules:
            if rule.kind == kind and rule.node in (None, name):
                return rule.replacement
        return otherwise

    return NodeNames(remapped("name", name), remapped("namespace", namespace), name, rules)
