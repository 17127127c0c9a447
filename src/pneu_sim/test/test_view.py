# SPDX-License-Identifier: Apache-2.0
"""Robots for viewers: frames and URDF, beside what MuJoCo makes of the same body."""

import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tests.graph_fixtures import domain, graph
from tests.live_graph import wait_for
from tf2_msgs.msg import TFMessage
from typer.testing import CliRunner

from pneu_common.cli import build_app
from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_sim.nodes.robot_view import LATCHED_QOS, RobotView
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import joint_names
from pneu_sim.view.tree import ROOT, places, tree_of
from pneu_sim.view.urdf import urdf_of

pytestmark = pytest.mark.realtime

__all__ = ["domain", "graph"]  # fixtures

RIGS = Path(__file__).parents[3] / "rigs"
ROBOTS = ("kokoro", "arm", "cart_pole", "dog")


def drawn(rig, seed):
    """Positions at random by the joint's name in the rig's MJCF, and as a JointState tells them."""
    rng = np.random.default_rng(seed)
    links = tree_of(rig)
    ((_, body),) = rig.bodies.items()
    field_of = dict(zip(joint_names(rig), body.joint_fields, strict=True))
    by_field, told = {}, {}
    for link in links:
        start = link.limits.start
        place = start if link.limits.held else float(rng.uniform(-0.8, 0.8))
        by_field[field_of[link.joint]] = told[link.told] = place
    return links, by_field, told


def turned(q):
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def in_world(links, found):
    """Place and attitude of every link in the room."""
    out = {ROOT: (np.zeros(3), np.eye(3))}
    for link in links:
        at, attitude = out[link.parent]
        place, turn = found[link.name]
        out[link.name] = at + attitude @ place, attitude @ turned(turn)
    return out


@pytest.mark.parametrize("name", ROBOTS)
def test_links_are_where_mujoco_has_them(name):
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is an extra of the package")
    rig = load_rig(RIGS / f"{name}.yaml")
    ((body_name, body),) = rig.bodies.items()
    model = mujoco.MjModel.from_xml_string(body.mjcf())
    data = mujoco.MjData(model)
    for seed in range(5):
        links, by_field, told = drawn(rig, seed)
        for field, value in by_field.items():
            data.qpos[model.joint(field).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        world = in_world(links, places(links, told))
        for k in range(1, model.nbody):
            place, attitude = world[f"{body_name}_{model.body(k).name}"]
            np.testing.assert_allclose(place, data.xpos[k], atol=1e-12)
            np.testing.assert_allclose(attitude.ravel(), data.xmat[k], atol=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_urdf_is_the_same_robot_to_another_reader(name):
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is an extra of the package")
    rig = load_rig(RIGS / f"{name}.yaml")
    ((_, body),) = rig.bodies.items()
    robot = ElementTree.fromstring(urdf_of(rig))
    compiler = ElementTree.SubElement(robot, "mujoco")
    ElementTree.SubElement(compiler, "compiler", fusestatic="false", balanceinertia="true")
    for link in robot.findall("link"):
        # MuJoCo refuses links that move and have no mass; who shows them only does not mind.
        if link.find("inertial") is None and link.get("name") != ROOT:
            inertial = ElementTree.SubElement(link, "inertial")
            ElementTree.SubElement(inertial, "mass", value="1e-6")
            about = dict.fromkeys(("ixx", "iyy", "izz"), "1e-9")
            about |= dict.fromkeys(("ixy", "ixz", "iyz"), "0")
            ElementTree.SubElement(inertial, "inertia", about)
    text = ElementTree.tostring(robot, encoding="unicode")
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    links, _, told = drawn(rig, 1)
    for link in links:
        if not link.limits.held:
            data.qpos[model.joint(link.told).qposadr[0]] = told[link.told]
    mujoco.mj_kinematics(model, data)
    world = in_world(links, places(links, told))
    for link in links:
        k = model.body(link.name).id
        np.testing.assert_allclose(data.xpos[k], world[link.name][0], atol=1e-9)
        np.testing.assert_allclose(data.xmat[k], world[link.name][1].ravel(), atol=1e-9)
    assert body.joint_fields


def test_a_joint_has_the_name_that_its_encoder_says_and_one_that_is_held_is_fixed(tmp_path):
    data = YAML(typ="safe").load(RIGS / "kokoro.yaml")
    data["encoders"] = {"angle": {"joint": "elbow"}}
    data["bodies"]["arm"]["alpha"]["start"] = 0.4
    file, urdf = tmp_path / "rig.yaml", tmp_path / "robot.urdf"
    YAML(typ="safe").dump(data, file)
    result = CliRunner().invoke(build_app(), ["urdf", str(file), "-o", str(urdf)])
    assert result.exit_code == 0, result.output
    text = urdf.read_text()
    assert '<joint name="angle" type="revolute">' in text
    assert '<joint name="shoulder" type="fixed">' in text
    assert 'lower="-0.85" upper="0.85"' in text
    shoulder = ElementTree.fromstring(text).find("joint[@name='shoulder']/origin")
    assert [float(x) for x in shoulder.get("rpy").split()] == pytest.approx([0.4, 0.0, 0.0])


def test_a_rig_without_bodies_is_refused():
    with pytest.raises(InputError, match="found no bodies to show"):
        tree_of(load_rig(RIGS / "lab.yaml"))


def test_the_node_says_frames_as_the_joint_moves(graph):
    graph.add(RobotView, rig=str(RIGS / "kokoro.yaml"), rate_hz=50.0)
    frames = graph.listen(TFMessage, "/tf", 100)
    fixed = graph.listen(TFMessage, "/tf_static", LATCHED_QOS)
    described = graph.listen(String, "robot_description", LATCHED_QOS)
    publisher = graph.probe.create_publisher(JointState, "/joint_states", common.READINGS_QOS)
    wait_for(lambda: publisher.get_subscription_count() == 1)
    wait_for(lambda: described and fixed)
    assert described[0].data == urdf_of(load_rig(RIGS / "kokoro.yaml"))
    assert [t.child_frame_id for t in fixed[0].transforms] == ["arm_stage"]
    message = JointState(name=["other", "elbow"], position=[9.0, 0.6])
    for k in range(20):  # 2 ms apart: no more than 50 frames a second
        message.header.stamp = common.to_stamp(10**9 + 2_000_000 * k)
        publisher.publish(message)
        wait_for(lambda: frames)
    message.header.stamp = common.to_stamp(2 * 10**9)
    publisher.publish(message)
    wait_for(lambda: common.from_stamp(frames[-1].transforms[0].header.stamp) == 2 * 10**9)
    (elbow,) = frames[-1].transforms
    assert (elbow.header.frame_id, elbow.child_frame_id) == ("arm_stage", "arm_link")
    assert elbow.transform.rotation.y == pytest.approx(math.sin(0.3))
    assert elbow.transform.rotation.w == pytest.approx(math.cos(0.3))
    stamps = [common.from_stamp(m.transforms[0].header.stamp) for m in frames]
    assert min(np.diff(stamps)) >= 20_000_000
