# SPDX-License-Identifier: Apache-2.0
"""Whether a sensor of vectors tells them in another frame than its site has in the MJCF."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pneu_sysid.contacts.chain import POSITION, Chain, Outputs
from pneu_sysid.contacts.effects.base import Setup

Floats = NDArray[np.float64]

LARGE_RAD = 0.35
"""A turn that no mounting is off by."""
EXPLAINED = 0.3
"""Share of a misreading that may be left once the frame is turned."""
FLAT = 0.05
"""Vectors whose second direction is weaker than this share of the first are all along one."""


def turned_frames(
    chains: Sequence[Chain], said: Sequence[Outputs], setup: Setup
) -> dict[str, tuple[float, Floats]]:
    """Sensors whose readings are those of the model, but for one large turn.

    Args:
        chains: Recordings.
        said: What the model says along them.
        setup: The scene.

    Returns:
        By sensor the angle, rad, and the axis of the turn from the model's frame to the readings'.
    """
    out = {}
    for k, channel in enumerate(chains[0].channels):
        if channel.size != 3 or channel.turns or channel.stage == POSITION:
            continue
        should, read = [], []
        for chain, outputs in zip(chains, said, strict=True):
            here = chain.channels[k]
            at = slice(here.address, here.address + 3)
            should.append(outputs.sensors[here.knots, at])
            read.append(chain.measured(here, setup.readings[here.name]))
        P, M = np.concatenate(should), np.concatenate(read)
        good = np.isfinite(P).all(axis=1) & np.isfinite(M).all(axis=1)
        P, M = P[good], M[good]
        if len(P) < 10 or not np.any(P) or not np.any(M):
            continue
        strength = np.linalg.svd(P, compute_uv=False)
        if strength[1] < FLAT * strength[0]:
            turn, _ = Rotation.align_vectors(M.mean(axis=0)[None], P.mean(axis=0)[None])
        else:
            turn, _ = Rotation.align_vectors(M, P)
        angle = float(turn.magnitude())
        before = float(np.sum((M - P) ** 2))
        after = float(np.sum((M - turn.apply(P)) ** 2))
        if angle > LARGE_RAD and after < EXPLAINED * before and after < np.sum(M**2) / 2:
            out[channel.name] = angle, turn.as_rotvec() / angle
    return out


def words(found: dict[str, tuple[float, Floats]]) -> str:
    """What to say of turned frames.

    Args:
        found: What `turned_frames` found; at least one.
    """
    parts = []
    for name, (angle, axis) in found.items():
        along = ", ".join(f"{x:z.2f}" for x in axis)
        parts.append(
            f"sensor {name!r} tells its vectors turned by {np.degrees(angle):.0f}° about"
            f" ({along}) against the frame that it has in the MJCF"
        )
    return "; ".join(parts) + ": turn its site, or the recording"
