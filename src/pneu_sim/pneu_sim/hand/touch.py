# SPDX-License-Identifier: Apache-2.0
"""The force of an arm on whatever it touches, as MuJoCo's contacts have it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_sim.mechanism.loading import mujoco_module

Floats = NDArray[np.float64]


def geoms_with(model: Any, body: int) -> frozenset[int]:
    """Geoms of the tree that a body is of.

    Args:
        model: An ``MjModel``.
        body: Number of the body.
    """
    root = int(model.body_rootid[body])
    return frozenset(
        g for g in range(model.ngeom) if int(model.body_rootid[model.geom_bodyid[g]]) == root
    )


def driven_by(model: Any, motor: str) -> int:
    """Number of a body that a motor moves.

    Args:
        model: An ``MjModel``.
        motor: Actuator on a joint, or on a tendon of joints.
    """
    number = model.actuator(motor).id
    target = int(model.actuator_trnid[number, 0])
    if int(model.actuator_trntype[number]) == int(mujoco_module().mjtTrn.mjTRN_TENDON):
        target = int(model.wrap_objid[int(model.tendon_adr[target])])
    return int(model.jnt_bodyid[target])


def touch_of(model: Any, data: Any, own: frozenset[int]) -> Floats:
    """(6,) force and moment about the origin of some geoms on others, in the world's frame.

    Args:
        model: An ``MjModel``.
        data: Its ``MjData``, contacts and their forces computed, forwards or inversely.
        own: Numbers of the geoms.
    """
    mujoco = mujoco_module()
    total, wrench = np.zeros(6), np.zeros(6)
    for number in range(data.ncon):
        contact = data.contact[number]
        first, second = (int(g) in own for g in contact.geom)
        if first == second:
            continue
        mujoco.mj_contactForce(model, data, number, wrench)
        force = contact.frame.reshape(3, 3).T @ wrench[:3]  # on the second geom
        if second:
            force = -force
        total[:3] += force
        total[3:] += np.cross(contact.pos, force)
    return total
