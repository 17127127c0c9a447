# SPDX-License-Identifier: Apache-2.0
"""A rig's bodies as URDF, the form in which ROS tools and viewers know robots.

Joints have the names by which a JointState tells of them; one that is held is fixed. What turns or
slides without stops is continuous, or has limits that it will not reach.
"""

import math
import xml.etree.ElementTree as ElementTree

import numpy as np

from pneu_sim.rig.schema import Rig
from pneu_sim.view.tree import ROOT, Link, Shape, tree_of

FAR_M = 1e3
"""Limit of what slides without stops."""
COLOURS = ("0.85 0.47 0.16 1", "0.25 0.45 0.70 1", "0.35 0.60 0.35 1")


def urdf_of(rig: Rig) -> str:
    """A rig's bodies as URDF.

    Args:
        rig: The rig.

    Raises:
        InputError: It has no bodies.
    """
    robot = ElementTree.Element("robot", name=rig.name)
    ElementTree.SubElement(robot, "link", name=ROOT)
    for k, link in enumerate(tree_of(rig)):
        _add_link(robot, link, COLOURS[k % len(COLOURS)])
        _add_joint(robot, link)
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def _add_link(robot: ElementTree.Element, link: Link, colour: str) -> None:
    part = ElementTree.SubElement(robot, "link", name=link.name)
    if link.mass_kg > 0.0:
        inertial = ElementTree.SubElement(part, "inertial")
        ElementTree.SubElement(inertial, "origin", xyz=_text(link.centre_m))
        ElementTree.SubElement(inertial, "mass", value=repr(link.mass_kg))
        three = dict(zip(("ixx", "iyy", "izz"), map(repr, link.inertia_kg_m2), strict=True))
        three |= dict.fromkeys(("ixy", "ixz", "iyz"), "0")
        ElementTree.SubElement(inertial, "inertia", three)
    for shape in link.shapes:
        visual = ElementTree.SubElement(part, "visual")
        xyz, rpy = _lies(shape)
        ElementTree.SubElement(visual, "origin", xyz=xyz, rpy=rpy)
        geometry = ElementTree.SubElement(visual, "geometry")
        if shape.ends is None:
            ElementTree.SubElement(geometry, "box", size=_text(shape.size_m))
        else:
            long = math.dist(*shape.ends)
            ElementTree.SubElement(
                geometry, "cylinder", radius=repr(shape.size_m[0]), length=repr(long)
            )
        material = ElementTree.SubElement(visual, "material", name=f"{link.name}_colour")
        ElementTree.SubElement(material, "color", rgba=colour)


def _add_joint(robot: ElementTree.Element, link: Link) -> None:
    limits = link.limits
    low, high = limits.lower, limits.upper
    kind = "prismatic" if link.slides else "revolute"
    if limits.held:
        kind = "fixed"
    elif not link.slides and (low is None or high is None):
        kind = "continuous"
    joint = ElementTree.SubElement(robot, "joint", name=link.told, type=kind)
    ElementTree.SubElement(joint, "parent", link=link.parent)
    ElementTree.SubElement(joint, "child", link=link.name)
    place, turn = link.pose(limits.start if limits.held else 0.0)
    ElementTree.SubElement(joint, "origin", xyz=_text(place), rpy=_text(_rpy(turn)))
    if limits.held:
        return
    ElementTree.SubElement(joint, "axis", xyz=_text(link.axis))
    if kind != "continuous":
        ends = (-FAR_M if low is None else low, FAR_M if high is None else high)
        lower, upper = map(repr, ends)
        ElementTree.SubElement(
            joint, "limit", lower=lower, upper=upper, effort="1000", velocity="100"
        )


def _lies(shape: Shape) -> tuple[str, str]:
    """Place and attitude of a shape; a cylinder of URDF lies along z."""
    if shape.ends is None:
        return "0 0 0", "0 0 0"
    first, last = np.array(shape.ends[0]), np.array(shape.ends[1])
    x, y, z = last - first
    pitch, yaw = math.atan2(math.hypot(x, y), z), math.atan2(y, x)
    return _text(0.5 * (first + last)), _text((0.0, pitch, yaw))


def _rpy(turn: "np.typing.ArrayLike") -> tuple[float, float, float]:
    """Roll, pitch and yaw of a quaternion x, y, z, w."""
    x, y, z, w = np.asarray(turn, dtype=float)
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0))
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return roll, pitch, yaw


def _text(values: "np.typing.ArrayLike") -> str:
    return " ".join(repr(float(value)) for value in np.asarray(values, dtype=float))
