# SPDX-License-Identifier: Apache-2.0
"""Where a body is, when a recording's own zero is not known: so that it just touches what is fixed.

Motion capture that is set up anew, or whose frame leans, tells heights up to a constant. What rests
on a floor has told it.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_sim.mechanism.loading import mujoco_module

Floats = NDArray[np.float64]

REACH_M = 10.0
"""Distance within which what is fixed is looked for."""
PRESSED = 0.05
"""Share of instants at which a body may be deeper in: impacts, and noise."""
LOOKED_AT = 60
"""Instants that are enough to know."""
STEEP = 0.2
"""Share of a contact's normal that must lie along a direction for the contact to tell of it."""


def touching_down(q: Floats, joint: int, component: int, model: Any) -> float:
    """How far to move a body along an axis so that it just touches what is fixed.

    Args:
        q: (n, nq) configurations.
        joint: The body's free joint.
        component: Axis of the world.
        model: The model.

    Returns:
        The distance, m; 0 where nothing that is fixed is within reach.
    """
    mujoco = mujoco_module()
    wide = mujoco.MjModel.__copy__(model)
    wide.geom_margin[:] += REACH_M
    data = mujoco.MjData(wide)
    fixed = wide.body_weldid[wide.geom_bodyid] == 0
    own = wide.body_rootid[wide.geom_bodyid] == wide.body_rootid[wide.jnt_bodyid[joint]]
    needed = []
    for at in q[:: max(1, len(q) // LOOKED_AT)]:
        data.qpos[:] = at
        mujoco.mj_fwdPosition(wide, data)
        if not data.ncon:
            continue
        first, second = data.contact.geom.T
        # a contact's normal is from its first geom to its second
        up = np.where(fixed[first], 1.0, -1.0) * data.contact.frame[:, component]
        tells = (fixed[first] & own[second]) | (fixed[second] & own[first])
        tells &= np.abs(up) > STEEP
        if np.any(tells):
            needed.append(np.max(-data.contact.dist[tells] / up[tells]))
    if not needed:
        return 0.0
    return float(np.quantile(needed, 1.0 - PRESSED, method="lower"))
