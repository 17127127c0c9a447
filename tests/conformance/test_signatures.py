# SPDX-License-Identifier: Apache-2.0
"""Functions and methods take what those of ROS 2 Jazzy take: names, order, kinds, defaults.

``signatures.json`` was written by this file, run as a program with the genuine rclpy 7.1.6.
"""

import importlib
import inspect
import json
import sys
from pathlib import Path

import pytest

RECORDED = Path(__file__).with_name("signatures.json")
MODULES = (
    "action.client", "action.server", "callback_groups", "client", "clock", "context", "duration",
    "event_handler", "executors", "expand_topic_name", "guard_condition", "impl.rcutils_logger",
    "lifecycle", "logging", "node", "parameter", "parameter_client", "publisher", "qos",
    "serialization", "service", "signals", "subscription", "task", "time", "time_source", "timer",
    "topic_or_service_is_hidden", "utilities", "validate_full_topic_name", "validate_namespace",
    "validate_node_name", "validate_topic_name", "wait_for_message",
)  # fmt: skip
MORE = {
    "rclpy.expand_topic_name.expand_topic_name": ", *, is_service=",
    "rclpy.node.Node.create_subscription": ", content_filter_options=",  # of later releases
}
"""What the embedded one takes besides."""


def parameters(function):
    """Names in their order, those after a star by name alone; "=" marks what has a default."""
    words, starred = [], False
    for p in inspect.signature(function).parameters.values():
        if p.kind is p.KEYWORD_ONLY and not starred:
            words.append("*")
        starred = starred or p.kind in (p.KEYWORD_ONLY, p.VAR_POSITIONAL)
        stars = {p.VAR_POSITIONAL: "*", p.VAR_KEYWORD: "**"}.get(p.kind, "")
        end = "/" if p.kind is p.POSITIONAL_ONLY else "" if p.default is p.empty else "="
        words.append(f"{stars}{p.name}{end}")
    return ", ".join(words)


def signatures():
    """Those of all public functions and methods, by their full names."""
    found = {}
    for name in ("rclpy", *(f"rclpy.{module}" for module in MODULES)):
        for part, one in vars(importlib.import_module(name)).items():
            if part.startswith("_") or getattr(one, "__module__", "") != name:
                continue
            if inspect.isfunction(one):
                found[f"{name}.{part}"] = parameters(one)
            elif inspect.isclass(one):
                for method, function in vars(one).items():
                    function = getattr(function, "__func__", function)  # of classes, and static
                    public = method == "__init__" or not method.startswith("_")
                    if public and inspect.isfunction(function):
                        found[f"{name}.{part}.{method}"] = parameters(function)
    return found


@pytest.mark.kernel_free
def test_signatures_are_those_of_ros():
    recorded = json.loads(RECORDED.read_text(encoding="utf-8"))
    own = signatures()
    assert len(recorded.keys() & own.keys()) > 250  # what only one has is private, or not for users
    for name, wanted in recorded.items():
        if "*args" not in wanted:  # which says nothing
            found = own.get(name, wanted)
            assert found in (wanted, wanted + MORE.get(name, "")), name


if __name__ == "__main__":
    assert "embedded" not in importlib.import_module("rclpy").__file__
    lines = (f"{json.dumps(name)}: {json.dumps(of)}" for name, of in sorted(signatures().items()))
    RECORDED.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    sys.exit()
