# SPDX-License-Identifier: Apache-2.0
"""The viewers' layouts: every panel is on the screen, every curve is a field of a topic we have."""

import json
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from pneu_runtime import interfaces
from pneu_sim import topics
from pneu_sim.rig import load_rig

WORKSPACE = Path(__file__).parents[1] / "ros_ws"
LAYOUTS = WORKSPACE / "src" / "pneu_bringup" / "layouts"
NAMESPACE = "/lab/"


def types() -> dict[str, str]:
    """Message type by topic, as the README's table has them; taps and lines are patterns there."""
    text = (WORKSPACE / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([\w/<>]+)` \| `(\w+)/(\w+)`", text, flags=re.MULTILINE)
    return {topic: f"{package}/msg/{name}" for topic, package, name in rows}


def type_of(topic: str) -> str:
    found = [
        kind
        for name, kind in types().items()
        if re.fullmatch(re.sub(r"<\w+>", r"\\w+", name), topic)
    ]
    assert len(found) == 1, topic
    return found[0]


def fields(kind: str) -> dict[str, str]:
    return dict(interfaces.message_class(kind)().get_fields_and_field_types())


def foxglove_curves() -> list[tuple[str, str]]:
    """Topic and field of every curve, an index as it stands."""
    panels = json.loads((LAYOUTS / "foxglove.json").read_text())["configById"]
    values = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    return [(topic, field) for topic, _, field in (value.partition(".") for value in values)]


@pytest.mark.parametrize(
    ("layout", "some"),
    [
        ("foxglove.json", {"Plot!joints", "Plot!speeds"}),
        ("foxglove_kokoro.json", {"3D!robot", "Plot!position"}),
    ],
)
def test_every_panel_is_in_the_layout(layout: str, some: set[str]) -> None:
    saved = json.loads((LAYOUTS / layout).read_text())

    def shown(part: str | dict) -> list[str]:
        return [part] if isinstance(part, str) else shown(part["first"]) + shown(part["second"])

    names = shown(saved["layout"])
    assert sorted(names) == sorted(saved["configById"])
    assert some <= set(names)


@pytest.mark.parametrize(("topic", "field"), foxglove_curves())
def test_curves_are_numbers_of_topics_that_there_are(topic: str, field: str) -> None:
    assert topic.startswith(NAMESPACE)
    name, index = re.fullmatch(r"(\w+)(\[\d+\])?", field).groups()
    kind = fields(type_of(topic.removeprefix(NAMESPACE)))[name]
    assert kind == ("double" if index is None else "sequence<double>")


def test_a_robot_is_shown_with_the_topics_of_its_rig_file() -> None:
    rig = load_rig(WORKSPACE.parent / "rigs" / "kokoro.yaml")
    there = {
        topic.name if topic.name.startswith("/") else f"{NAMESPACE}{topic.name}": fields(topic.type)
        for of in (topics.command_topics, topics.tap_topics, topics.encoder_topics)
        for topic in of(rig)
    }
    panels = json.loads((LAYOUTS / "foxglove_kokoro.json").read_text())["configById"]
    paths = [path["value"] for panel in panels.values() for path in panel.get("paths", [])]
    assert len(paths) == len(rig.commands) + len(rig.taps) + len(rig.encoders)
    for path in paths:
        topic, _, field = path.partition(".")
        assert field.partition("[")[0] in there[topic], path
    layers = panels["3D!robot"]["layers"].values()
    assert f"{NAMESPACE}robot_description" in [layer.get("topic") for layer in layers]


def test_plotjuggler_shows_the_same_topics() -> None:
    root = ElementTree.parse(LAYOUTS / "plotjuggler.xml").getroot()
    curves = [curve.attrib["name"] for curve in root.iter("curve")]
    topics = {topic for topic, _ in foxglove_curves()}
    assert all(any(name.startswith(f"{topic}/") for topic in topics) for name in curves)
    assert all(any(name.startswith(f"{topic}/") for name in curves) for topic in topics)
    for splitter in root.iter("DockSplitter"):
        sizes = [float(size) for size in splitter.attrib["sizes"].split(";")]
        assert len(sizes) == int(splitter.attrib["count"]) == len(splitter)
        assert sum(sizes) == pytest.approx(1.0)
