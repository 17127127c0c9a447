# SPDX-License-Identifier: Apache-2.0
"""A trajectory to start from: the model run forwards, drawn to what sensors tell of its pose.

Poses from sensors alone put bodies a hair into each other or apart, and the forces of such contacts
are wild. A roll-out that is drawn along instead touches as its own contacts have it, and the forces
that nobody applied are those that draw it, small where the model is good.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_sim.mechanism.loading import mujoco_module
from pneu_sysid.contacts.chain import Chain
from pneu_sysid.contacts.effects.base import Setup

Floats = NDArray[np.float64]

WITHIN_S = 0.02
"""Time constant of what draws: what is off is made good in a few of them, critically damped."""
FASTEST = 1e6
"""A velocity beyond is none, in m/s or rad/s."""


def drawn(chain: Chain, model: Any, setup: Setup, within_s: float = WITHIN_S) -> Floats:
    """Runs a model along a recording, drawn to the poses that sensors tell.

    Args:
        chain: The recording; ``chain.start`` is what it is drawn to, and where it begins.
        model: The model.
        setup: The scene it is made from.
        within_s: See `WITHIN_S`.

    Returns:
        (n, nq) configurations; NaN from where it ran away.
    """
    mujoco = mujoco_module()
    man, target = chain.manifold, chain.start
    h = np.diff(chain.time_s) * setup.clock
    q = np.full((chain.size, man.nq), np.nan)
    q[:2] = target[:2]
    steps = man.between(target[:-1], target[1:]) / h[:, None]
    v = steps[0]
    data = mujoco.MjData(model)
    drag = np.zeros(man.nv)
    drag[chain.free.ravel()] = setup.drag
    pull = np.empty(man.nv)
    for i in range(1, chain.size - 1):
        data.qpos[:] = q[i]
        data.qvel[:] = v
        if model.nu:
            data.ctrl[:] = chain.control[i]
        off = man.between(q[i : i + 1], target[i : i + 1])[0]
        wanted = off / within_s**2 + 2.0 * (steps[i - 1] - v) / within_s
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_mulM(model, data, pull, wanted)
        data.qfrc_applied[:] = pull - drag * v
        mujoco.mj_forward(model, data)
        v = v + 0.5 * (h[i] + h[i - 1]) * data.qacc
        if not np.all(np.isfinite(v)) or np.max(np.abs(v)) > FASTEST:
            break
        q[i + 1] = man.moved(q[i : i + 1], (h[i] * v)[None])[0]
    return q
