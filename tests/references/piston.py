# SPDX-License-Identifier: Apache-2.0
"""Pistons in gas, in closed form: free piston, impulsive piston, gas spring.

Free piston: driven by a half-infinite column of gas at rest, vacuum in front. The simple wave
behind the piston makes ``2 a / (gamma - 1) + u`` constant, so the piston's equation of motion
separates (AGARDograph 138, Ballistic Range Technology, 1970).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class PistonState:
    """Where the piston is (m), how fast (m/s), and the gas pressure on it (Pa)."""

    position: float
    velocity: float
    pressure: float


def free_piston(
    time_s: float, p0: float, rho0: float, area: float, mass: float, gamma: float = 1.4
) -> PistonState:
    """Returns the state of a piston released at rest at time 0 from gas at (p0, rho0)."""
    a0 = float(np.sqrt(gamma * p0 / rho0))
    k = 0.5 * (gamma + 1.0) * p0 * area / (mass * a0)
    growth = 1.0 + k * time_s
    y = growth ** (-(gamma - 1.0) / (gamma + 1.0))
    escape = 2.0 * a0 / (gamma - 1.0)
    lag = (gamma + 1.0) / (2.0 * k) * (growth ** (2.0 / (gamma + 1.0)) - 1.0)
    return PistonState(
        position=escape * (time_s - lag),
        velocity=escape * (1.0 - y),
        pressure=p0 * y ** (2.0 * gamma / (gamma - 1.0)),
    )


def withdrawal_pressure_ratio(mach: float, gamma: float = 1.4) -> float:
    """Returns p / p0 on a piston suddenly withdrawn at ``mach`` times the sound speed."""
    base = 1.0 - 0.5 * (gamma - 1.0) * mach
    return float(max(base, 0.0) ** (2.0 * gamma / (gamma - 1.0)))


def advance_pressure_ratio(mach: float, gamma: float = 1.4) -> float:
    """Returns p / p0 on a piston suddenly advanced at ``mach`` times the sound speed."""
    quarter = 0.25 * (gamma + 1.0) * mach
    return float(1.0 + gamma * mach * (quarter + np.sqrt(1.0 + quarter**2)))


def gas_spring_frequency(
    area: float, p1: float, v1: float, p2: float, v2: float, mass: float, polytropic: float
) -> float:
    """Returns the frequency, Hz, of a mass between two chambers (Pa, m3); 1.4 adiabatic, 1 slow."""
    stiffness = polytropic * area**2 * (p1 / v1 + p2 / v2)
    return float(np.sqrt(stiffness / mass) / (2.0 * np.pi))
