# SPDX-License-Identifier: Apache-2.0
"""Joints with springs that an MJCF lacks, by how much they yield (thesis 2.5.2).

A body that does not yield has no such joint: a coordinate that nothing can move would only make
everything stiff.
"""

from typing import Any

from pneu_sim.mechanism.loading import mujoco_module
from pneu_sysid.contacts.names import ADDED, AXES

SETTLES_S = 0.002
"""Time constant of what yields: damping over stiffness."""


def place_of(place: str) -> tuple[str, int]:
    """Body and axis of a place.

    Args:
        place: ``body.axis``.
    """
    body, _, axis = place.rpartition(".")
    return body, AXES.index(axis)


def joint_name(effect: str, body: str, axis: int) -> str:
    """Name of an added joint.

    Args:
        effect: Which effect it is of.
        body: Its body.
        axis: Its axis.
    """
    return f"{ADDED}{effect} {body}.{AXES[axis]}"


def compliance(spec: Any, effect: str, place: str) -> float:
    """How much an added joint yields; 0 where there is none.

    Args:
        spec: An ``MjSpec``.
        effect: Which effect it is of.
        place: ``body.axis``.
    """
    joint = spec.joint(joint_name(effect, *place_of(place)))
    return 0.0 if joint is None else 1.0 / float(joint.stiffness[0])


def add_spring(spec: Any, effect: str, body: str, axis: int, value: float, slides: bool) -> None:
    """Makes a body yield against what carries it; where it yields nothing, takes the joint away.

    Args:
        spec: An ``MjSpec``, changed in place.
        effect: Which effect it is of.
        body: Name of the body.
        axis: Axis of its own.
        value: Compliance; 0 for none.
        slides: Whether it slides instead of turning.
    """
    kinds = mujoco_module().mjtJoint
    name = joint_name(effect, body, axis)
    joint = spec.joint(name)
    if value <= 0.0:
        if joint is not None:
            spec.delete(joint)
        return
    if joint is None:
        along = [float(k == axis) for k in range(3)]
        kind = kinds.mjJNT_SLIDE if slides else kinds.mjJNT_HINGE
        joint = spec.body(body).add_joint(name=name, type=kind, axis=along)
    joint.stiffness = [1.0 / value, 0.0, 0.0]
    joint.damping = [SETTLES_S / value, 0.0, 0.0]
