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
    "rclpy",
    "rclpy.action.client",
    "rclpy.action.server",
    "rclpy.callback_groups",
    "rclpy.client",
    "rclpy.clock",
    "rclpy.context",
    "rclpy.duration",
    "rclpy.event_handler",
    "rclpy.executors",
    "rclpy.expand_topic_name",
    "rclpy.guard_condition",
    "rclpy.impl.rcutils_logger",
    "rclpy.lifecycle",
    "rclpy.logging",
    "rclpy.node",
    "rclpy.parameter",
    "rclpy.parameter_client",
    "rclpy.publisher",
    "rclpy.qos",
    "rclpy.serialization",
    "rclpy.service",
    "rclpy.signals",
    "rclpy.subscription",
    "rclpy.task",
    "rclpy.time",
    "rclpy.time_source",
    "rclpy.timer",
    "rclpy.topic_or_service_is_hidden",
    "rclpy.utilities",
    "rclpy.validate_full_topic_name",
    "rclpy.validate_namespace",
    "rclpy.validate_node_name",
    "rclpy.validate_topic_name",
    "rclpy.wait_for_message",
)
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
    for name in MODULES:
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
