# SPDX-License-Identifier: Apache-2.0
"""Names of axes, and of what effects add to an MJCF."""

AXES = "xyz"
ADDED = "pneu "
"""What names begin with of joints, sites, sensors and frames that the MJCF lacks."""


def load_name(joint: str) -> str:
    """Name of the site and the sensor that feel what goes through a joint.

    Args:
        joint: Its name.
    """
    return f"{ADDED}load {joint}"
