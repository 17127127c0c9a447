# SPDX-License-Identifier: Apache-2.0
"""The bodies of a rig as links with one joint each, out of their MJCF, and where links are.

A body of several joints has links without mass between them. Bodies of one rig, whose places in the
room no rig file says, stand side by side.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.bodies.base import Body, Joint
from pneu_sim.rig.schema import Rig, joint_names

Floats = NDArray[np.float64]

ROOT = "world"
"""The frame that all stand in."""
APART_M = 0.5
"""From one body to the next."""


@dataclass(frozen=True)
class Shape:
    """What of a link is seen: a box, or a cylinder between two points.

    Attributes:
        size_m: Edges of a box; of a cylinder its radius alone.
        ends: (2, 3) ends of a cylinder, m; None is a box about the link's origin.
    """

    size_m: tuple[float, ...]
    ends: tuple[tuple[float, ...], tuple[float, ...]] | None = None


@dataclass(frozen=True)
class Link:
    """A link, its joint's axis through its origin.

    Attributes:
        name: Its frame.
        parent: The frame of the link before.
        place_m: Where its joint is in that.
        joint: Name of the joint in the rig file.
        told: Name by which a JointState tells of it: that of an encoder, or the joint's own.
        limits: What the rig file says of the joint.
        slides: Whether it is a translation.
        axis: Its direction.
        mass_kg: Of the link.
        centre_m: Its centre of mass.
        inertia_kg_m2: About that, along the link's axes.
        shapes: What is seen of it.
    """

    name: str
    parent: str
    place_m: tuple[float, ...]
    joint: str
    told: str
    limits: Joint
    slides: bool
    axis: tuple[float, ...]
    mass_kg: float = 0.0
    centre_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    inertia_kg_m2: tuple[float, ...] = (0.0, 0.0, 0.0)
    shapes: tuple[Shape, ...] = ()

    def pose(self, position: float) -> tuple[Floats, Floats]:
        """Where it is in its parent: (3,) m, and (4,) quaternion x, y, z, w.

        Args:
            position: Of its joint, rad or m.
        """
        place, axis = np.array(self.place_m), np.array(self.axis)
        if self.slides:
            return place + position * axis, np.array([0.0, 0.0, 0.0, 1.0])
        half = 0.5 * position
        return place, np.array([*(np.sin(half) * axis), np.cos(half)])


def tree_of(rig: Rig) -> list[Link]:
    """The links of a rig's bodies, each after its parent.

    Args:
        rig: The rig.

    Raises:
        InputError: It has no bodies, or is moved in an MJCF of its own.
    """
    if not rig.bodies:
        why = "mechanism: its MJCF is shown by MuJoCo's own viewer" if rig.mechanism else "bodies"
        raise InputError(f"rig {rig.name!r}: found no bodies to show ({why})")
    called = dict(encoder_names(rig))
    names = iter(joint_names(rig))
    links: list[Link] = []
    for k, (name, body) in enumerate(rig.bodies.items()):
        joints = {field: (next(names), getattr(body, field)) for field in body.joint_fields}
        links += _links(name, body, joints, called, k * APART_M)
    return links


def encoder_names(rig: Rig) -> Iterator[tuple[str, str]]:
    """Joints with an encoder, and its name; the first of several.

    Args:
        rig: The rig.
    """
    seen = set()
    for name, encoder in rig.encoders.items():
        joint = encoder.on(name)
        if encoder.cylinder is None and joint not in seen:
            seen.add(joint)
            yield joint, name


def places(links: list[Link], positions: Mapping[str, float]) -> dict[str, tuple[Floats, Floats]]:
    """Where every link is in its parent, by frame; see `Link.pose`.

    Args:
        links: The links.
        positions: Per name that a JointState tells of, rad or m; what is not told is at its start.
    """
    return {
        one.name: one.pose(positions.get(one.told, one.limits.start))
        if not one.limits.held
        else one.pose(one.limits.start)
        for one in links
    }


def _links(
    name: str,
    body: Body,
    joints: Mapping[str, tuple[str, Joint]],
    called: Mapping[str, str],
    aside_m: float,
) -> Iterator[Link]:
    world = ElementTree.fromstring(body.mjcf()).find("worldbody")
    assert world is not None
    waiting = [(ROOT, part, (0.0, aside_m, 0.0)) for part in world.findall("body")]
    while waiting:
        parent, part, aside = waiting.pop(0)
        frame = f"{name}_{part.get('name')}"
        place = tuple(a + b for a, b in zip(_numbers(part.get("pos")), aside, strict=True))
        found = part.findall("joint")
        for n, joint in enumerate(found):
            joint_name, limits = joints[joint.attrib["name"]]
            last = n + 1 == len(found)
            link = Link(
                name=frame if last else f"{frame}_{joint.attrib['name']}",
                parent=parent,
                place_m=place,
                joint=joint_name,
                told=called.get(joint_name, joint_name),
                limits=limits,
                slides=joint.get("type") == "slide",
                axis=_numbers(joint.get("axis")),
            )
            yield _filled(link, part) if last else link
            parent, place = link.name, (0.0, 0.0, 0.0)
        waiting += [(frame, inner, (0.0, 0.0, 0.0)) for inner in part.findall("body")]


def _filled(link: Link, part: ElementTree.Element) -> Link:
    """A link with mass and shapes."""
    shapes = []
    for geom in part.findall("geom"):
        size = _numbers(geom.get("size"), 1)
        if geom.get("type") == "box":
            shapes.append(Shape(tuple(2.0 * half for half in size)))
        elif geom.get("fromto"):
            six = _numbers(geom.get("fromto"), 6)
            shapes.append(Shape(size[:1], (six[:3], six[3:])))
    inertial = part.find("inertial")
    if inertial is not None:
        three = _numbers(inertial.get("diaginertia"))
        return replace(
            link,
            mass_kg=float(inertial.attrib["mass"]),
            centre_m=_numbers(inertial.get("pos")),
            inertia_kg_m2=three,
            shapes=tuple(shapes),
        )
    mass = sum(float(geom.get("mass", 0.0)) for geom in part.findall("geom"))
    x, y, z = shapes[0].size_m  # (a cart: a box of even density)
    about = (y * y + z * z, x * x + z * z, x * x + y * y)
    inertia = tuple(mass * one / 12.0 for one in about)
    return replace(link, mass_kg=mass, inertia_kg_m2=inertia, shapes=tuple(shapes))


def _numbers(text: str | None, least: int = 3) -> tuple[float, ...]:
    return tuple(float(word) for word in text.split()) if text else (0.0,) * least
