# SPDX-License-Identifier: Apache-2.0
"""What an arm does for a recording that tells parameters: taps, presses that slide, and free moves.

Thesis 2.6.2: the object is tapped, and pressed with a circling tip, so that friction and the tip's
yielding show; in between the arm moves in the air, so that its own friction and inertia do.
"""

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.hand.loading import Hand
from pneu_sim.hand.paths import EVERY_S, Kinematics, Path, through, way
from pneu_sim.mechanism.loading import mujoco_module

Floats = NDArray[np.float64]

AWAY_M = 0.02
"""Between tip and object before each touch."""


def exercise(
    hand: Hand, kinematics: Kinematics, tip: str, thing: str, seconds: float, seed: int
) -> Path:
    """A path that touches a thing in front of an arm, at random.

    Args:
        hand: The hand.
        kinematics: The arm's.
        tip: Geom of its tip, a sphere.
        thing: Geom that is touched, where it stands at first.
        seconds: How long.
        seed: Of what is drawn.

    Raises:
        InputError: There is no such geom, or it cannot be reached.
    """
    spec = hand.spec()
    for name in (tip, thing):
        if spec.geom(name) is None:
            raise InputError(f"{hand.mjcf}: no geom {name!r}")
    mujoco = mujoco_module()
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    centre = np.array(data.geom(thing).xpos)
    reach = float(model.geom(thing).size[0] + model.geom(tip).size[0])
    toward = centre - kinematics.tip(np.zeros(len(kinematics.lower_rad)))
    toward[2] = 0.0
    toward /= np.linalg.norm(toward)
    across = np.array([-toward[1], toward[0], 0.0])
    up = np.array([0.0, 0.0, 1.0])
    rng = np.random.default_rng(seed)

    def place(depth_m: Floats | float, side_m: Floats | float, height_m: Floats | float) -> Floats:
        """Points so deep beyond where the tip would touch, beside and above the middle."""
        parts = np.broadcast_arrays(depth_m, side_m, height_m)
        depth, side, height = (np.atleast_1d(np.asarray(p, dtype=float)) for p in parts)
        curve = reach - np.sqrt(np.maximum(reach**2 - side**2, 0.0))
        return np.asarray(
            centre
            + (depth + curve - reach)[:, None] * toward
            + side[:, None] * across
            + height[:, None] * up
        )

    points = [kinematics.tip(np.zeros(len(kinematics.lower_rad)))[None]]

    def move(end: Floats, duration: float) -> None:
        points.append(way(points[-1][-1], end, duration))

    while EVERY_S * sum(len(p) for p in points) < seconds:
        side, height = rng.uniform(-0.010, 0.010), rng.uniform(-0.025, 0.025)
        move(place(-AWAY_M, side, height)[0], rng.uniform(0.4, 0.8))
        if rng.random() < 0.5:  # a tap
            move(place(rng.uniform(0.004, 0.015), side, height)[0], rng.uniform(0.1, 0.3))
            move(place(-AWAY_M, side, height)[0], rng.uniform(0.15, 0.3))
            continue
        depth = rng.uniform(0.012, 0.025)  # a press with a circling tip
        move(place(depth, side, height)[0], rng.uniform(0.4, 0.8))
        size, rate = rng.uniform(0.003, 0.008), rng.uniform(0.8, 2.0)
        turns = round(rng.uniform(1.5, 2.5) * rate) / rate
        t = np.arange(1, round(turns / EVERY_S) + 1) * EVERY_S
        ramp = np.clip(np.minimum(t, t[-1] - t) / 0.3, 0.0, 1.0)
        angle = 2.0 * np.pi * rate * t
        points.append(
            place(
                depth,
                side + size * ramp * np.sin(angle),
                height + size * ramp * np.cos(angle),
            )
        )
        move(place(-AWAY_M, side, height)[0], rng.uniform(0.4, 0.8))
    path = through(kinematics, np.concatenate(points))
    keep = path.time_s <= seconds
    return Path(path.time_s[keep], path.angles_rad[keep])
