# SPDX-License-Identifier: Apache-2.0
"""Pieces of MJCF that the bodies are written with.

A body in a plane has its x to the right and its y up, which are x and z of MJCF; an angle that
grows counter-clockwise there turns about ``COUNTER_CLOCKWISE``.
"""

from collections.abc import Sequence

from pneu_sim.bodies.crank import Linkage
from pneu_sim.bodies.link import Link

COUNTER_CLOCKWISE = "0 -1 0"
LEAST_INERTIA = 1e-14
"""MuJoCo refuses less, and a point mass has none."""


def numbers(*values: float) -> str:
    """Numbers of an attribute, with all their digits.

    Args:
        *values: The numbers.
    """
    return " ".join(repr(float(value)) for value in values)


def planar(x: float, y: float) -> str:
    """A point of the plane as a position.

    Args:
        x: To the right, m.
        y: Up, m.
    """
    return numbers(x, 0.0, y)


def inertial(mass_kg: float, at: str, *inertia_kg_m2: float) -> str:
    """An ``inertial`` element.

    Args:
        mass_kg: Mass.
        at: Position of the centre of mass.
        *inertia_kg_m2: About it: one for all axes, or three.
    """
    three = inertia_kg_m2 * (3 // len(inertia_kg_m2))
    least = numbers(*(max(one, LEAST_INERTIA) for one in three))
    return f'<inertial pos="{at}" mass="{mass_kg!r}" diaginertia="{least}"/>'


def link(one: Link, x: float, y: float) -> str:
    """Mass and shape of a link whose joint is the origin of its body.

    Args:
        one: The link.
        x: Direction from its joint to its end in the plane, to the right.
        y: Up.
    """
    away_m = one.first_moment_kg_m / one.total_kg
    about_centre = one.second_moment_kg_m2 - one.first_moment_kg_m * away_m
    end = planar(x * one.length_m, y * one.length_m)
    return (
        inertial(one.total_kg, planar(x * away_m, y * away_m), about_centre)
        + f'<geom type="capsule" fromto="0 0 0 {end}" size="0.01" contype="0" conaffinity="0"/>'
    )


def site(name: str, at: str) -> str:
    """A ``site`` element.

    Args:
        name: Its name.
        at: Its position.
    """
    return f'<site name="{name}" pos="{at}" size="0.005"/>'


def pivot(name: str, linkage: Linkage, x: float = 0.0, y: float = 0.0) -> str:
    """The site of a cylinder's end on the parent.

    Args:
        name: Name of the cylinder's place.
        linkage: How it is pinned.
        x: Where the joint is in the parent, to the right, m.
        y: Up, m.
    """
    px, py = linkage.ends[0]
    return site(f"{name}_pivot", planar(x + px, y + py))


def pin(name: str, linkage: Linkage) -> str:
    """The site of a cylinder's end on the driven link, whose joint is the origin of its body.

    Args:
        name: Name of the cylinder's place.
        linkage: How it is pinned.
    """
    return site(f"{name}_pin", planar(*linkage.ends[1]))


def between_sites(name: str) -> str:
    """The tendon of a cylinder: as long as its extension and its closed length together.

    Args:
        name: Name of the cylinder's place.
    """
    return f'<spatial name="{name}"><site site="{name}_pivot"/><site site="{name}_pin"/></spatial>'


def along_joint(name: str, joint: str) -> str:
    """The tendon of a cylinder whose extension is a joint's coordinate.

    Args:
        name: Name of the cylinder's place.
        joint: Name of the joint.
    """
    return f'<fixed name="{name}"><joint joint="{joint}" coef="1"/></fixed>'


def document(model: str, gravity_m_s2: float, world: str, tendons: Sequence[str]) -> str:
    """A whole model.

    Args:
        model: Its name.
        gravity_m_s2: Gravity, downwards.
        world: What is in the world.
        tendons: Its tendons, one for each cylinder.
    """
    return f"""<mujoco model="{model}">
  <compiler angle="radian"/>
  <option gravity="0 0 {-gravity_m_s2!r}"/>
  <worldbody>
{world.strip(chr(10))}
  </worldbody>
  <tendon>{"".join(tendons)}</tendon>
</mujoco>
"""
