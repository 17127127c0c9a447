# SPDX-License-Identifier: Apache-2.0
"""Adiabatic flow with wall friction in a constant-area duct (Fanno flow).

A. H. Shapiro, The Dynamics and Thermodynamics of Compressible Fluid Flow, vol. 1, chapter 6.
The friction factor is Darcy's throughout.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from . import nozzle, pipe_flow


def friction_length(mach: float, gamma: float = 1.4) -> float:
    """Returns ``f L* / D`` from this Mach number to the sonic end."""
    square = mach * mach
    bracket = (gamma + 1.0) * square / (2.0 + (gamma - 1.0) * square)
    return float(
        (1.0 - square) / (gamma * square) + (gamma + 1.0) / (2.0 * gamma) * np.log(bracket)
    )


def temperature_ratio(mach: float, gamma: float = 1.4) -> float:
    """Returns ``T / T*``."""
    return (gamma + 1.0) / (2.0 + (gamma - 1.0) * mach * mach)


def pressure_ratio(mach: float, gamma: float = 1.4) -> float:
    """Returns ``p / p*``."""
    return float(np.sqrt(temperature_ratio(mach, gamma)) / mach)


def stagnation_pressure_ratio(mach: float, gamma: float = 1.4) -> float:
    """Returns ``p0 / p0*``."""
    exponent = (gamma + 1.0) / (2.0 * (gamma - 1.0))
    return float(temperature_ratio(mach, gamma) ** (-exponent) / mach)


def subsonic_mach(length: float, gamma: float = 1.4) -> float:
    """Returns the subsonic Mach number whose ``f L* / D`` equals ``length``."""
    return float(brentq(lambda m: friction_length(m, gamma) - length, 1e-6, 1.0, xtol=1e-15))


@dataclass(frozen=True)
class ChokedTube:
    """Flow through a tube that is sonic at its end."""

    mass_flow: float
    """kg/s."""
    mach_in: float
    exit_pressure_ratio: float
    """Static pressure at the sonic end over the supply's stagnation pressure."""
    friction_factor: float


def choked_tube(
    diameter: float,
    length: float,
    p_supply: float,
    t_supply: float,
    inlet_loss: float,
    gamma: float = 1.4,
    r_specific: float = 287.05,
    friction_law: Callable[[float, float], float] = pipe_flow.haaland,
) -> ChokedTube:
    """Returns the choked flow of air through a smooth adiabatic tube fed from a large vessel.

    The entrance loss, in dynamic pressures, is spread over the tube: it adds to ``f L / D``. The
    friction factor holds for the Reynolds number at the inlet's static temperature.
    """
    area = np.pi * diameter**2 / 4.0
    friction = 0.02
    for _ in range(100):
        mach = subsonic_mach(friction * length / diameter + inlet_loss, gamma)
        cooling = nozzle.temperature_ratio(mach, gamma)
        exponent = (gamma + 1.0) / (2.0 * (gamma - 1.0))
        flow = area * p_supply * np.sqrt(gamma / (r_specific * t_supply)) * mach
        flow = float(flow * cooling**exponent)
        viscosity = air_viscosity(t_supply * cooling)
        reynolds = 4.0 * flow / (np.pi * diameter * viscosity)
        friction, before = friction_law(reynolds, 0.0), friction
        if abs(friction - before) < 1e-14:
            break
    p_exit = nozzle.pressure_ratio(mach, gamma) / pressure_ratio(mach, gamma)
    return ChokedTube(flow, mach, p_exit, friction)


def air_viscosity(temperature: float) -> float:
    """Returns the viscosity of air, Pa s (U.S. Standard Atmosphere 1976, eq. 51)."""
    return float(1.458e-6 * temperature**1.5 / (temperature + 110.4))


def mass_flux(
    p0: float, t0: float, back: float, heads: float, gamma: float = 1.4, r_specific: float = 287.05
) -> float:
    """Returns the mass flux from rest, through velocity heads of loss, to a pressure behind.

    In kg/(m^2 s); choked behind the loss where the pressure there would be higher.
    """

    def behind(mach: float) -> float:
        """Pressure behind the loss, from the Mach number before it."""
        after = subsonic_mach(friction_length(mach, gamma) - heads, gamma)
        before = p0 * nozzle.pressure_ratio(mach, gamma)
        return before * pressure_ratio(after, gamma) / pressure_ratio(mach, gamma)

    mach = subsonic_mach(heads, gamma) * (1.0 - 1e-9)
    if behind(mach) < back:
        mach = float(brentq(lambda m: behind(m) - back, 1e-3, mach))
    t = t0 * nozzle.temperature_ratio(mach, gamma)
    p = p0 * nozzle.pressure_ratio(mach, gamma)
    return float(mach * p * np.sqrt(gamma / (r_specific * t)))
