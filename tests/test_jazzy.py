# SPDX-License-Identifier: Apache-2.0
"""What has to run on a real ROS 2 Jazzy as well keeps to what is there.

The embedded runtime knows more than rclpy 7.1 does, such as ``with rclpy.init():``, so that running
here does not show it. The names of rclpy 7.1 are in ``jazzy_rclpy.json``, which tells its source.
"""

import ast
import importlib
import inspect
import json
import re
import tomllib
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).parent.parent
JAZZY = json.loads((ROOT / "tests/jazzy_rclpy.json").read_text(encoding="utf-8"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
LAUNCH = ROOT / "ros_ws/src/pneu_bringup/launch/rig.launch.yaml"
BRINGUP = LAUNCH.parent.parent

# Keywords of rclpy 7.1.
KEYWORDS = {
    "create_publisher": {
        *("msg_type", "topic", "qos_profile", "callback_group", "event_callbacks"),
        *("qos_overriding_options", "publisher_class"),
    },
    "create_subscription": {
        *("msg_type", "topic", "callback", "qos_profile", "callback_group", "event_callbacks"),
        *("qos_overriding_options", "raw"),
    },
    "create_timer": {"timer_period_sec", "callback", "callback_group", "clock", "autostart"},
    "create_client": {"srv_type", "srv_name", "qos_profile", "callback_group"},
    "create_service": {"srv_type", "srv_name", "callback", "qos_profile", "callback_group"},
}
# Made by pybind11: each access may give another object, so that they have to be compared by ==.
FOREIGN_ENUMS = {"ClockType", "ClockChange", "TransitionCallbackReturn"}
NO_CONTEXT_MANAGERS = {"init", "create_node", "Context", "Node", "LifecycleNode", *KEYWORDS}


def program_files():
    found = [
        *ROOT.glob("src/*/pneu_*/**/*.py"),
        *ROOT.glob("src/*/test/*.py"),
        *ROOT.glob("tests/**/*.py"),
        *ROOT.glob("examples/**/*.py"),
        *ROOT.glob("benchmarks/**/*.py"),
    ]
    return sorted(
        path
        for path in found
        if "embedded" not in path.parts and "rclpy" in path.read_text(encoding="utf-8")
    )


FILES = [path for path in program_files() if path != Path(__file__)]


def programs(path):
    """The program of a file, and those that it keeps as text to run them elsewhere."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    yield tree
    for node in ast.walk(tree):
        text = node.value if isinstance(node, ast.Constant) else ""
        if isinstance(text, str) and re.search(r"^\s*import rclpy", text, re.MULTILINE):
            yield ast.parse(inspect.cleandoc(text))


def last_name(node):
    return getattr(node, "attr", getattr(node, "id", ""))


def faults(tree):
    """What rclpy 7.1 does not have, or has otherwise."""
    for node in ast.walk(tree):
        line = getattr(node, "lineno", 0)
        if isinstance(node, ast.With | ast.AsyncWith):
            for item in node.items:
                call = item.context_expr
                if isinstance(call, ast.Call) and last_name(call.func) in NO_CONTEXT_MANAGERS:
                    yield line, f"with {ast.unparse(call.func)}(): no context manager in Jazzy"
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "rclpy":
            known = JAZZY["modules"].get(node.module)
            for alias in node.names:
                inside = f"{node.module}.{alias.name}" in JAZZY["modules"]
                if not inside and (known is None or alias.name not in known):
                    yield line, f"Jazzy has no {node.module}.{alias.name}"
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "rclpy" and alias.name not in JAZZY["modules"]:
                    yield line, f"Jazzy has no {alias.name}"
        elif isinstance(node, ast.Compare) and any(
            isinstance(op, ast.Is | ast.IsNot) for op in node.ops
        ):
            for side in (node.left, *node.comparators):
                if isinstance(side, ast.Attribute) and last_name(side.value) in FOREIGN_ENUMS:
                    yield line, f"{ast.unparse(side)} is to be compared by =="
        elif isinstance(node, ast.Call):
            name = last_name(node.func)
            unknown = {word.arg for word in node.keywords} - KEYWORDS.get(name, set()) - {None}
            if name in KEYWORDS and unknown:
                yield line, f"{name}() of Jazzy has no {', '.join(sorted(unknown))}"


def test_there_is_something_to_check():
    names = {path.name for path in FILES}
    assert {"simulator.py", "valve_bridge.py", "recorder.py", "test_context.py"} <= names


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_only_what_jazzy_has_is_used(path):
    found = [f"line {line}: {text}" for tree in programs(path) for line, text in faults(tree)]
    assert not found, "\n" + "\n".join(found)


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("with rclpy.init():\n    pass", True),
        ("with rclpy.create_node('a') as node:\n    pass", True),
        ("with initialised(None):\n    pass", False),
        ("from rclpy.clock import ClockType", False),
        ("from rclpy.endpoint_info import TopicEndpointInfo", True),
        ("import rclpy.experimental.asyncio", True),
        ("clock.clock_type is ClockType.ROS_TIME", True),
        ("clock.clock_type == ClockType.ROS_TIME", False),
        ("node.create_timer(1.0, tick, clock=clock, autostart=False)", False),
        ("node.create_timer(1.0, tick, name='tick')", True),
    ],
)
def test_faults_are_found(text, wrong):
    assert bool(list(faults(ast.parse(text)))) == wrong


def node_classes():
    for path in sorted(ROOT.glob("src/*/pneu_*/nodes/*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            bases = {last_name(base) for base in getattr(node, "bases", [])}
            if isinstance(node, ast.ClassDef) and bases & {"Node", "LifecycleNode"}:
                yield pytest.param(node, id=node.name)


@pytest.mark.parametrize("node", list(node_classes()))
def test_nodes_leave_the_attributes_of_rclpy_alone(node):
    """A node of ours that sets `self._clock` works here and breaks there."""
    methods = {part.name for part in node.body if isinstance(part, ast.FunctionDef)}
    fields = {
        last_name(part)
        for part in ast.walk(node)
        if isinstance(part, ast.Attribute)
        and isinstance(part.ctx, ast.Store)
        and last_name(part.value) == "self"
    }
    fields |= {
        last_name(target)
        for part in node.body
        if isinstance(part, ast.Assign)
        for target in part.targets
    }
    overridden = {"destroy_node", *(n for n in JAZZY["lifecycle_node"] if n.startswith("on_"))}
    taken = {*JAZZY["node"], *JAZZY["lifecycle_node"], *JAZZY["node_private"]}
    assert not (methods - overridden | fields) & taken


def test_the_embedded_runtime_has_the_names_of_jazzy():
    embedded = importlib.import_module("rclpy")
    if "embedded" not in str(embedded.__file__):
        pytest.skip("a real rclpy is installed")
    missing = [
        f"{module}.{name}"
        for module, names in JAZZY["modules"].items()
        for name in names
        if not hasattr(importlib.import_module(module), name)
    ]
    assert not missing
    node = {n for n in dir(importlib.import_module("rclpy.node").Node) if n[0] != "_"}
    assert node == set(JAZZY["node"])
    lifecycle = importlib.import_module("rclpy.lifecycle").LifecycleNode
    assert {n for n in dir(lifecycle) if n[0] != "_"} - node == set(JAZZY["lifecycle_node"])


# The workspace


def test_requirements_are_those_of_the_project():
    lines = (ROOT / "ros_ws/requirements.txt").read_text(encoding="utf-8").splitlines()
    wanted = [one for one in PROJECT["project"]["dependencies"] if "cyclonedds" not in one]
    assert [line for line in lines if not line.startswith("#")] == wanted


def manifests():
    return {path.name: path / "package.xml" for path in sorted((ROOT / "ros_ws/src").iterdir())}


def test_the_workspace_holds_every_package_once():
    names = [ElementTree.parse(path).getroot().findtext("name") for path in manifests().values()]
    assert names == list(manifests())
    of_repository = {path.parent.name for path in ROOT.glob("src/*/package.xml")}
    assert set(names) == of_repository | {"pneu_msgs", "pneu_bringup"}
    versions = {ElementTree.parse(p).getroot().findtext("version") for p in manifests().values()}
    assert versions == {PROJECT["project"]["version"]}


def test_interfaces_depend_on_what_they_use():
    there = [p for kind in ("msg", "srv", "action") for p in ROOT.glob(f"msgs/{kind}/*.{kind}")]
    root = ElementTree.parse(ROOT / "msgs/package.xml").getroot()
    assert root.findtext("member_of_group") == "rosidl_interface_packages"
    depends = {part.text for part in root.iter("depend")}
    used = {
        word.split("/")[0]
        for path in there
        for word in re.findall(r"^(\w+/\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    # a package with actions needs action_msgs
    assert depends == used | {"action_msgs"}


# The launch file, as launch_ros reads it


def nodes_of_the_launch_file():
    document = YAML(typ="safe").load(LAUNCH.read_text(encoding="utf-8"))
    return [action["node"] for action in document["launch"] if "node" in action]


def test_the_nodes_of_the_launch_file_are_installed_by_their_packages():
    for node in nodes_of_the_launch_file():
        setup = (ROOT / "src" / node["pkg"] / "setup.py").read_text(encoding="utf-8")
        assert f'"{node["exec"]} = {node["pkg"]}.nodes.' in setup
        depends = ElementTree.parse(BRINGUP / "package.xml").getroot().iter("exec_depend")
        assert node["pkg"] in {part.text for part in depends}


def test_texts_of_the_launch_file_stay_texts():
    """Without a type a value is read as YAML: nothing at all is an error, and `1e3` a number."""
    untyped = [
        part["name"]
        for node in nodes_of_the_launch_file()
        for part in node["param"]
        if part.get("value") not in ("$(var use_sim_time)", "$(var port)")
        and "from" not in part
        and part.get("type") != "str"
        and not isinstance(part["value"], list)
    ]
    assert not untyped


def test_no_substitution_has_an_empty_argument():
    """launch_ros takes `''` in `$(not-equals ... '')` for an empty list, which equals nothing."""
    conditions = [str(node.get("if", "")) for node in nodes_of_the_launch_file()]
    assert not [text for text in conditions if "''" in text and not text.startswith("$(eval ")]
