# SPDX-License-Identifier: Apache-2.0
"""Parameter values in YAML, from files and from the command line, and whom they are meant for.

Plain scalars are read by the rules of ROS's own parser: ``yes`` and ``on`` are booleans, ``1e3``
is a number, and a quoted word is always a string.
"""

import math
import re
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

_TRUE = {"y", "Y", "yes", "Yes", "YES", "true", "True", "TRUE", "on", "On", "ON"}
_FALSE = {"n", "N", "no", "No", "NO", "false", "False", "FALSE", "off", "Off", "OFF"}
_INTEGER = re.compile(r"[-+]?(0[xX][0-9a-fA-F]+|[0-9]+)")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_SPECIAL = {".nan": math.nan, ".inf": math.inf, "+.inf": math.inf, "-.inf": -math.inf}


def parameter_value(text: str) -> Any:
    """Read one value, as after ``:=`` on the command line.

    Args:
        text: The value in YAML.

    Returns:
        object: A bool, int, float, str, or a list of these. ValueError where it is none.
    """
    try:
        node = YAML().compose(text)
    except YAMLError as error:
        raise ValueError(f"not YAML: {error}") from error
    if node is None:
        raise ValueError("the value is empty")
    return _value(node, text)


def parameters_of_file(path: str) -> list[tuple[str, str, Any]]:
    """Read a parameter file.

    Args:
        path: The file: node name or pattern, ``ros__parameters``, then the parameters.

    Returns:
        list[tuple[str, str, object]]: Pattern of the node, full name and value of each parameter,
        in the order of the file.
    """
    try:
        root = YAML().compose(Path(path))
    except OSError as error:
        raise ValueError(f"cannot read the file: {error.strerror}") from error
    except YAMLError as error:
        raise ValueError(f"{path} is not YAML: {error}") from error
    if root is None:
        return []
    found: list[tuple[str, str, Any]] = []
    _walk_nodes(_mapping(root, path, "the file"), "", path, found)
    return found


def matches(pattern: str, node: str) -> bool:
    """Say whether the pattern of a parameter file means a node.

    Args:
        pattern: Name with its namespace; ``*`` is one part of it, ``**`` any number of parts.
        node: Fully qualified name of a node.

    Returns:
        bool: Whether it does.
    """
    expression = ""
    for part in pattern.strip("/").split("/"):
        if part == "**":
            expression += r"(/[^/]+)*"
        elif part == "*":
            expression += r"/[^/]+"
        else:
            expression += "/" + re.escape(part)
    return re.fullmatch(expression, node) is not None


def parameters_for(given: list[tuple[str, str, Any]], node: str) -> dict[str, Any]:
    """Collect the parameters that are meant for a node.

    Args:
        given: Pattern, name and value of parameters; later ones win over earlier ones, and exact
            names over patterns.
        node: Fully qualified name of the node.

    Returns:
        dict[str, object]: Values by name.
    """
    fitting = [entry for entry in given if matches(entry[0], node)]
    exact = [entry for entry in fitting if "*" not in entry[0]]
    patterns = [entry for entry in fitting if "*" in entry[0]]
    return {name: value for _, name, value in patterns + exact}


def _walk_nodes(
    node: MappingNode, prefix: str, path: str, found: list[tuple[str, str, Any]]
) -> None:
    """Go down the names of nodes to their parameters."""
    for key, value in node.value:
        name = str(key.value)
        if name == "ros__parameters":
            if not prefix:
                raise ValueError(f"{path}: 'ros__parameters' stands outside of a node name")
            _walk_parameters(value, "", prefix, path, found)
        else:
            below = f"{prefix}/{name.strip('/')}"
            _walk_nodes(_mapping(value, path, f"'{name}'"), below, path, found)


def _walk_parameters(
    node: Node, prefix: str, pattern: str, path: str, found: list[tuple[str, str, Any]]
) -> None:
    """Go down the groups of parameters to their values."""
    if isinstance(node, ScalarNode) and node.value in ("", "null", "~"):
        return
    for key, value in _mapping(node, path, "'ros__parameters'").value:
        name = f"{prefix}{key.value}"
        if isinstance(value, MappingNode):
            _walk_parameters(value, f"{name}.", pattern, path, found)
        else:
            try:
                found.append((pattern, name, _value(value, name)))
            except ValueError as error:
                raise ValueError(f"{path}: parameter '{name}': {error}") from error


def _mapping(node: Node, path: str, what: str) -> MappingNode:
    if not isinstance(node, MappingNode):
        raise ValueError(f"{path}: {what} must be a mapping")
    return node


def _value(node: Node, text: str) -> Any:
    if isinstance(node, ScalarNode):
        return _scalar(node)
    if not isinstance(node, SequenceNode):
        raise ValueError(f"'{text}' is neither a value nor a list of values")
    values = [_value(entry, text) for entry in node.value]
    kinds = {type(value) for value in values}
    if kinds == {int, float}:
        return [float(value) for value in values]
    if len(kinds) > 1 or kinds & {list, type(None)}:
        raise ValueError("the values of a list must all be of one type")
    return values


def _scalar(node: ScalarNode) -> Any:
    text = node.value
    if node.style is not None or node.tag == "!!str":
        return text
    if text in _TRUE:
        return True
    if text in _FALSE:
        return False
    if _INTEGER.fullmatch(text):
        value = int(text, 16) if "x" in text.lower() else int(text)
        return value if -(2**63) <= value < 2**63 else float(value)
    if _FLOAT.fullmatch(text):
        return float(text)
    return _SPECIAL.get(text.lower(), text)
