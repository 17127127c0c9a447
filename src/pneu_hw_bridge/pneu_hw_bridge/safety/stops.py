# SPDX-License-Identifier: Apache-2.0
"""Where the joints and pistons of a rig file end, by the encoders that are on them."""

import math

from pneu_sim.rig.schema import Rig, joint_names


def stops_of(rig: Rig) -> dict[str, tuple[float, float]]:
    """Lowest and highest position that encoders can read, rad or m; infinite where there is no end.

    Args:
        rig: The rig.
    """
    joints = dict(
        zip(joint_names(rig), (j for b in rig.bodies.values() for j in b.joints), strict=True)
    )
    found = {}
    for name, encoder in rig.encoders.items():
        low, high = -math.inf, math.inf
        joint = joints.get(encoder.on(name))
        if encoder.cylinder is not None:
            low, high = 0.0, rig.cylinders[encoder.cylinder].stroke
        elif joint is not None and joint.held:
            low = high = joint.start
        elif joint is not None:
            low = low if joint.lower is None else joint.lower
            high = high if joint.upper is None else joint.upper
        found[name] = low, high
    return found
