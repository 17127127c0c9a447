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
    for at in q:
        data.qpos[:] = at
        mujoco.mj_fwdPosition(wide, data)
        most = -np.inf
        for contact in data.contact:
            first, second = (int(g) for g in contact.geom)
            if fixed[first] and own[second]:
                up = float(contact.frame[component])  # the normal is from the first to the second
            elif fixed[second] and own[first]:
                up = -float(contact.frame[component])
            else:
                continue
            if abs(up) > STEEP:
                most = max(most, -float(contact.dist) / up)
        if np.isfinite(most):
            needed.append(most)
    if not needed:
        return 0.0
    return float(np.quantile(needed, 1.0 - PRESSED, method="lower"))
