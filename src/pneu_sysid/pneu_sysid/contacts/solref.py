# SPDX-License-Identifier: Apache-2.0
"""Stiffness and damping of a geom's contacts, however its MJCF says them."""

from typing import Any


def direct(geom: Any) -> tuple[float, float]:
    """Stiffness, 1/s^2, and damping, 1/s, of a geom's contacts.

    Args:
        geom: A geom of an ``MjSpec``: two negative numbers are they; else a time constant and a
            damping ratio (MuJoCo, modeling: solver parameters).
    """
    first, second = (float(x) for x in geom.solref)
    if first < 0.0:
        return -first, -second
    return 1.0 / (first * second) ** 2, 2.0 / first
