# SPDX-License-Identifier: Apache-2.0
"""Isentropic quasi-one-dimensional flow: area, pressure and temperature against Mach number.

A. H. Shapiro, The Dynamics and Thermodynamics of Compressible Fluid Flow, vol. 1, chapter 4.
"""

from __future__ import annotations

from scipy.optimize import brentq


def temperature_ratio(mach: float, gamma: float = 1.4) -> float:
    """Returns ``T / T0``."""
    return 1.0 / (1.0 + 0.5 * (gamma - 1.0) * mach * mach)


def pressure_ratio(mach: float, gamma: float = 1.4) -> float:
    """Returns ``p / p0``."""
    return float(temperature_ratio(mach, gamma) ** (gamma / (gamma - 1.0)))


def area_ratio(mach: float, gamma: float = 1.4) -> float:
    """Returns ``A / A*``."""
    exponent = (gamma + 1.0) / (2.0 * (gamma - 1.0))
    bracket = 2.0 / (gamma + 1.0) / temperature_ratio(mach, gamma)
    return float(bracket**exponent / mach)


def mach_from_area(area: float, supersonic: bool = False, gamma: float = 1.4) -> float:
    """Returns the Mach number at ``A / A*`` (1 or more) on the branch asked for."""
    low, high = (1.0, 100.0) if supersonic else (1e-9, 1.0)
    return float(brentq(lambda m: area_ratio(m, gamma) - area, low, high, xtol=1e-15))
