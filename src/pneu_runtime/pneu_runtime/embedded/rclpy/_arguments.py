# SPDX-License-Identifier: Apache-2.0
"""The part of a command line that is meant for ROS: ``--ros-args ... --``."""

import re
import sys
from dataclasses import dataclass, field
from typing import Any

from rclpy._parameter_files import parameter_value, parameters_of_file
from rclpy._rclpy_pybind11 import RCLInvalidROSArgsError, UnknownROSArgsError
from rclpy.impl.logging_severity import LoggingSeverity

START = "--ros-args"
END = "--"

# flag -> whether it is on, per switch
_SWITCHES = {
    f"--{word}-{switch}": (attribute, word == "enable")
    for word in ("enable", "disable")
    for switch, attribute in (
        ("rosout-logs", "rosout_logs"),
        ("stdout-logs", "stdout_logs"),
        ("external-lib-logs", "external_lib_logs"),
    )
}
_OPTIONS = {
    "-p": "--param",
    "-r": "--remap",
    "-e": "--enclave",
    **{
        name: name
        for name in (
            "--param",
            "--params-file",
            "--remap",
            "--enclave",
            "--log-level",
            "--log-config-file",
            "--log-file-name",
        )
    },
}
_NODE_PREFIX = re.compile(r"([A-Za-z_][A-Za-z0-9_]*):(?!=|//)")


@dataclass(frozen=True)
class RemapRule:
    """One remapping.

    Attributes:
        kind: "name" for the node's name, "namespace", "topic", "service", or "any" of these two.
        node: Name of the node it is meant for; None for every node.
        match: What is replaced; empty for names of nodes and namespaces.
        replacement: By what.
    """

    kind: str
    node: str | None
    match: str
    replacement: str


@dataclass
class RosArguments:
    """What the arguments say.

    Attributes:
        remaps: Remappings, the first that fits holds.
        parameters: Per node name or pattern, name and value of a parameter, the last holds.
        enclave: Security enclave.
        default_log_level: Level of all loggers that are given none.
        log_levels: Levels by logger name.
        rosout_logs: Whether log messages are published.
        stdout_logs: Whether they are printed.
        external_lib_logs: Whether they are written to files; accepted, and nothing is written.
    """

    remaps: list[RemapRule] = field(default_factory=list)
    parameters: list[tuple[str, str, Any]] = field(default_factory=list)
    enclave: str = "/"
    default_log_level: LoggingSeverity | None = None
    log_levels: dict[str, LoggingSeverity] = field(default_factory=dict)
    rosout_logs: bool = True
    stdout_logs: bool = True
    external_lib_logs: bool = True


def without_ros_arguments(args: list[str]) -> list[str]:
    """Return a command line without what is meant for ROS.

    Args:
        args: The command line.

    Returns:
        list[str]: What remains, in order.
    """
    kept, inside = [], False
    for word in args:
        if word == START:
            inside = True
        elif inside and word == END:
            inside = False
        elif not inside:
            kept.append(word)
    return kept


def parse_arguments(args: list[str] | None) -> RosArguments:
    """Read the part of a command line that is meant for ROS.

    Args:
        args: The command line; that of the process where None.

    Returns:
        RosArguments: What it says.
    """
    words = list(sys.argv if args is None else args)
    found = RosArguments()
    unknown = []
    inside = False
    position = 0
    while position < len(words):
        word = words[position]
        position += 1
        if word == START:
            inside = True
            continue
        if not inside:
            continue
        if word == END:
            inside = False
            continue
        if word in _SWITCHES:
            attribute, value = _SWITCHES[word]
            setattr(found, attribute, value)
            continue
        option, assigned, value_text = word.partition(":=")
        if assigned and option in ("--log-level", "--enclave", "--log-config-file"):
            _apply(found, option, value_text)
            continue
        if word not in _OPTIONS:
            unknown.append(word)
            continue
        if position >= len(words):
            raise RCLInvalidROSArgsError(
                f"Failed to parse ROS arguments: '{word}' found no trailing value"
            )
        _apply(found, _OPTIONS[word], words[position])
        position += 1
    if unknown:
        raise UnknownROSArgsError(f"Found unknown ROS arguments: {unknown}")
    return found


def _apply(found: RosArguments, option: str, text: str) -> None:
    """Enter one option with its value."""
    try:
        if option == "--remap":
            found.remaps.append(_remap_rule(text))
        elif option == "--param":
            found.parameters.append(_parameter(text))
        elif option == "--params-file":
            found.parameters.extend(parameters_of_file(text))
        elif option == "--enclave":
            found.enclave = _enclave(text)
        elif option == "--log-level":
            _set_log_level(found, text)
        else:
            raise NotImplementedError(f"the embedded runtime has no {option}")
    except ValueError as error:
        raise RCLInvalidROSArgsError(
            f"Failed to parse ROS arguments: '{option} {text}': {error}"
        ) from error


def _split_rule(text: str) -> tuple[str, str]:
    left, assigned, right = text.partition(":=")
    if not assigned or not left:
        raise ValueError("expected the form NAME:=VALUE")
    return left, right


def _split_node(left: str) -> tuple[str | None, str]:
    prefix = _NODE_PREFIX.match(left)
    if prefix and not left.startswith(("rostopic://", "rosservice://")):
        return prefix.group(1), left[prefix.end() :]
    return None, left


def _remap_rule(text: str) -> RemapRule:
    left, replacement = _split_rule(text)
    node, match = _split_node(left)
    if not replacement:
        raise ValueError("nothing stands after ':='")
    if match in ("__node", "__name"):
        if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", replacement):
            raise ValueError(f"'{replacement}' is not a node name")
        return RemapRule("name", node, "", replacement)
    if match == "__ns":
        if not re.fullmatch(r"/|(/[A-Za-z_][A-Za-z0-9_]*)+", replacement):
            raise ValueError(f"'{replacement}' is not an absolute namespace")
        return RemapRule("namespace", node, "", replacement)
    kind = "any"
    for scheme, of_kind in (("rostopic://", "topic"), ("rosservice://", "service")):
        if match.startswith(scheme):
            kind, match = of_kind, match.removeprefix(scheme)
        replacement = replacement.removeprefix(scheme)
    for name in (match, replacement):
        if not re.fullmatch(r"(~|~?/)?[A-Za-z0-9_/{}]*", name) or "//" in name or not name:
            raise ValueError(f"'{name}' is not a topic or service name")
    return RemapRule(kind, node, match, replacement)


def _parameter(text: str) -> tuple[str, str, Any]:
    left, value = _split_rule(text)
    prefix = re.match(r"([A-Za-z0-9_/*]+):(?!=)", left)
    node, name = (prefix.group(1), left[prefix.end() :]) if prefix else ("/**", left)
    if not node.startswith("/"):
        node = f"/{node}" if node.startswith("*") else f"/**/{node}"
    if not name:
        raise ValueError("the name of the parameter is missing")
    return node, name, parameter_value(value)


def _enclave(text: str) -> str:
    if not text.startswith("/"):
        raise ValueError("an enclave starts with '/'")
    return text


def _set_log_level(found: RosArguments, text: str) -> None:
    name, assigned, level = text.rpartition(":=")
    try:
        severity = LoggingSeverity[level.upper()]
    except KeyError:
        known = ", ".join(one.name for one in LoggingSeverity)
        raise ValueError(f"'{level}' is no log level; known are {known}") from None
    if assigned:
        found.log_levels[name] = severity
    else:
        found.default_log_level = severity
