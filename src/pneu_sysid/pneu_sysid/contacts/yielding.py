# SPDX-License-Identifier: Apache-2.0
"""What a body that yields would change, where the model has it stiff."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pneu_sysid.contacts.bearings import bearings_of
from pneu_sysid.contacts.chain import Chain, Outputs
from pneu_sysid.contacts.effects.base import SceneEffect, Setup
from pneu_sysid.contacts.manifold import manifold_of
from pneu_sysid.contacts.physics import Motion, Physics
from pneu_sysid.contacts.springs import joint_name, place_of

Floats = NDArray[np.float64]

SEEN = 1e-6
"""Most that a body is moved by to see what its yielding changes, m or rad."""


def yielding_column(
    chain: Chain,
    q: Floats,
    setup: Setup,
    effect: SceneEffect,
    place: str,
    physics: Physics,
) -> tuple[Floats, Floats]:
    """What residuals change by per unit of a compliance that is not there.

    A spring that is nearly stiff lets its body go by compliance times what it carries, which
    inverse dynamics tells without it; what that motion changes is a difference.

    Args:
        chain: A recording.
        q: (n, nq) its trajectory.
        setup: The scene, without the joint.
        effect: The effect that adds it.
        place: Where.
        physics: What evaluates models.

    Returns:
        (n, nv) change of forces and (n, R) of sensors, as `Chain.rows`.
    """
    wider = replace(setup, spec=setup.spec.copy())
    effect.put(wider, place, effect.typical)
    joint = wider.spec.joint(joint_name(effect.name, *place_of(place)))
    joint.stiffness = joint.damping = [0.0, 0.0, 0.0]
    model = wider.spec.compile()
    number = model.joint(joint.name).id
    at, along = int(model.jnt_qposadr[number]), int(model.jnt_dofadr[number])
    moving = replace(chain, manifold=manifold_of(model))
    resting = np.insert(q, at, 0.0, axis=1)
    bearings = bearings_of(model, setup.loaded)
    carried = physics.evaluate(model, moving.motion(resting, setup), bearings)[0][:, along]
    carried[[0, -1]] = carried[[1, -2]]  # the ends have no accelerations
    size = SEEN / max(float(np.max(np.abs(carried))), 1e-12)
    rows = []
    for way in (size, -size):
        bent = resting.copy()
        bent[:, at] = -way * carried
        motion = moving.motion(bent, setup)
        force, sensors = physics.evaluate(model, motion, bearings)
        v, a = np.delete(motion.v, along, 1), np.delete(motion.a, along, 1)
        there = Motion(q, v, a, motion.control)
        rows.append(chain.rows(Outputs(np.delete(force, along, 1), sensors, there), setup))
    return (rows[0][0] - rows[1][0]) / (2 * size), (rows[0][1] - rows[1][1]) / (2 * size)
