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


def drawn(chain: Chain, model: Any, setup: Setup, within_s: float = WITHIN_S) -> Floats:
    """Runs a model along a recording, drawn to the poses that sensors tell.

    Args:
        chain: The recording; ``chain.start`` is what it is drawn to.
        model: The model.
        setup: The scene it is made from.
        within_s: See `WITHIN_S`.

    Returns:
        (n, nq) configurations.
    """
    return rolled(chain, model, setup, chain.start[:2], chain.start, within_s)


def rolled(
    chain: Chain,
    model: Any,
    setup: Setup,
    first: Floats,
    target: Floats | None = None,
    within_s: float = WITHIN_S,
) -> Floats:
    """Runs a model over a chain's knots by the steps that its differences are made of.

    Args:
        chain: The knots.
        model: The model.
        setup: The scene it is made from.
        first: (2, nq) the first two configurations, which say how fast it starts.
        target: (n, nq) what it is drawn to; runs freely without.
        within_s: See `WITHIN_S`.

    Returns:
        (n, nq) configurations; NaN from where it ran away.
    """
    mujoco = mujoco_module()
    man = chain.manifold
    h = np.diff(chain.time_s) * setup.clock
    q = np.full((chain.size, man.nq), np.nan)
    q[:2] = first
    v = man.between(first[:1], first[1:2])[0] / h[0]
    data = mujoco.MjData(model)
    target_v = None
    if target is not None:
        steps = man.between(target[:-1], target[1:]) / h[:, None]
        target_v = np.concatenate([steps[:1], steps])
    drag = np.zeros(man.nv)
    drag[chain.free.ravel()] = setup.drag
    pull = np.empty(man.nv)
    for i in range(1, chain.size - 1):
        data.qpos[:] = q[i]
        data.qvel[:] = v
        if model.nu:
            data.ctrl[:] = chain.control[i]
        data.qfrc_applied[:] = -drag * v
        if target is not None and target_v is not None:
            off = man.between(q[i : i + 1], target[i : i + 1])[0]
            wanted = off / within_s**2 + 2.0 * (target_v[i] - v) / within_s
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_mulM(model, data, pull, wanted)
            data.qfrc_applied += pull
        mujoco.mj_forward(model, data)
        v = v + 0.5 * (h[i] + h[i - 1]) * data.qacc
        if not np.all(np.isfinite(v)) or np.max(np.abs(v)) > 1e6:
            break
        q[i + 1] = man.moved(q[i : i + 1], (h[i] * v)[None])[0]
    return q
