# SPDX-License-Identifier: Apache-2.0
"""A trajectory to start from: the model run forwards, drawn to what sensors tell of its pose.

Poses from sensors alone put bodies a hair into each other or apart, and the forces of such contacts
are wild. A roll-out that is drawn along instead touches as its own contacts have it, and the forces
that nobody applied are those that draw it, small where the model is good.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_sim.mechanism.loading import mujoco_module
from pneu_sysid.contacts.bearings import bearings_of
from pneu_sysid.contacts.chain import Chain
from pneu_sysid.contacts.effects.base import Setup

Floats = NDArray[np.float64]

WITHIN_S = 0.02
"""Time constant of what draws: what is off is made good in a few of them, critically damped."""
FASTEST = 1e3
"""A velocity beyond is none, in m/s or rad/s: the step is too long for what is stiff."""
FINER = (1, 2, 4, 8)
"""Steps from knot to knot, one number after the other, until it no longer runs away."""
AGAIN = 3
"""Times that a recording is drawn anew, at most, to find how deep a body lies."""
LEVEL_M = 5e-5
"""A shift of a recording's own zero that is not worth another."""


def settled(chain: Chain, model: Any, setup: Setup) -> tuple[Chain, Floats]:
    """A recording drawn along, its own zeros where the model lies on what is fixed.

    What lies on a floor is a little in it, by its stiffness: a body that was put so that it just
    touches is too high.

    Args:
        chain: The recording.
        model: The model.
        setup: The scene it is made from.

    Returns:
        The chain, ``start`` shifted, and (n, nq) what `drawn` makes of it.
    """
    q = drawn(chain, model, setup)
    own = {c for channel in chain.channels for c in channel.unzeroed}
    free = np.flatnonzero(model.jnt_type == 0)
    if not own or not len(free):
        return chain, q
    first = int(model.jnt_qposadr[free[0]])
    for _ in range(AGAIN):
        start = chain.start.copy()
        for component in own:
            off = (q - start)[chain.near, first + component]
            off = off[np.isfinite(off)]
            start[:, first + component] += np.median(off) if len(off) else 0.0
        shift = float(np.max(np.abs(start - chain.start)))
        chain = replace(chain, start=start)
        q = drawn(chain, model, setup)
        if shift < LEVEL_M:
            break
    return chain, q


def drawn(chain: Chain, model: Any, setup: Setup, within_s: float = WITHIN_S) -> Floats:
    """Runs a model along a recording, drawn to the poses that sensors tell.

    Args:
        chain: The recording; ``chain.start`` is what it is drawn to, and where it begins.
        model: The model.
        setup: The scene it is made from.
        within_s: See `WITHIN_S`.

    Returns:
        (n, nq) configurations; NaN from where it ran away, however fine its steps.
    """
    for parts in FINER:
        q = _drawn(chain, model, setup, within_s, parts)
        if np.isfinite(q).all():
            break
    return q


def _drawn(chain: Chain, model: Any, setup: Setup, within_s: float, parts: int) -> Floats:
    """See `drawn`, in so many steps from knot to knot."""
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
    bearings = bearings_of(model, setup.loaded)
    slowed: Floats | None = None
    pull, off = np.empty(man.nv), np.empty(man.nv)
    for i in range(1, chain.size - 1):
        if model.nu:
            data.ctrl[:] = chain.control[i]
        at = q[i].copy()
        step_s = h[i] / parts
        for part in range(parts):
            data.qpos[:] = at
            data.qvel[:] = v
            mujoco.mj_differentiatePos(model, off, 1.0, at, target[i])
            wanted = off / within_s**2 + 2.0 * (steps[i - 1] - v) / within_s
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_mulM(model, data, pull, wanted)
            data.qfrc_applied[:] = pull - drag * v
            if slowed is not None and bearings is not None:
                data.qfrc_applied[bearings.along] -= slowed
            mujoco.mj_forward(model, data)
            if bearings is not None:  # by what it carried a step before
                slowed = bearings.slowing(model, data, step_s)
            before_s = h[i - 1] / parts if part == 0 else step_s
            v = v + 0.5 * (step_s + before_s) * data.qacc
            if not np.all(np.isfinite(v)) or np.max(np.abs(v)) > FASTEST:
                return q
            mujoco.mj_integratePos(model, at, v, step_s)
        q[i + 1] = at
    return q
