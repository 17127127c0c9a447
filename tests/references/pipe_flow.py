# SPDX-License-Identifier: Apache-2.0
"""Walls of round pipes: steady drop, Darcy factors, Zielke's unsteady weighting, and heat.

All friction factors are Darcy's, ``dp = f (L / D) rho u^2 / 2``; laminar flow has 64 / Re.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq
from scipy.special import jn_zeros

ZIELKE_SERIES_LIMIT = 0.02
"""Dimensionless time below which `zielke_series` is meant to be used."""


def poiseuille_gradient(volume_flow: float, diameter: float, viscosity: float) -> float:
    """Returns the laminar pressure drop per length, Pa/m: ``128 mu Q / (pi D^4)``."""
    return float(128.0 * viscosity * volume_flow / (np.pi * diameter**4))


def isothermal_long_line_mass_flow(
    p_in: float,
    p_out: float,
    area: float,
    friction_length: float,
    temperature: float,
    r_specific: float = 287.05,
) -> float:
    """Returns the mass flow, kg/s, of a long isothermal line with ``friction_length`` = f L / D."""
    loss = friction_length + 2.0 * np.log(p_in / p_out)
    return float(area * np.sqrt((p_in**2 - p_out**2) / (r_specific * temperature * loss)))


def laminar(reynolds: float) -> float:
    """Returns 64 / Re."""
    return 64.0 / reynolds


def blasius(reynolds: float) -> float:
    """Returns Blasius' factor for smooth pipes, Re about 4e3 to 1e5."""
    return float(0.3164 * reynolds**-0.25)


def colebrook(reynolds: float, relative_roughness: float) -> float:
    """Returns the turbulent factor of C. F. Colebrook, J. Inst. Civ. Eng. 11 (1939)."""

    def residual(x: float) -> float:  # x = 1 / sqrt(f)
        return float(x + 2.0 * np.log10(relative_roughness / 3.7 + 2.51 * x / reynolds))

    return float(brentq(residual, 0.1, 100.0, xtol=1e-14) ** -2)


def haaland(reynolds: float, relative_roughness: float) -> float:
    """Returns the turbulent factor of S. E. Haaland, J. Fluids Eng. 105 (1983)."""
    term = (relative_roughness / 3.7) ** 1.11 + 6.9 / reynolds
    return float((-1.8 * np.log10(term)) ** -2)


def churchill(reynolds: float, relative_roughness: float) -> float:
    """Returns the factor for every Reynolds number of S. W. Churchill, Chem. Eng. 84 (1977)."""
    a = (2.457 * np.log(1.0 / ((7.0 / reynolds) ** 0.9 + 0.27 * relative_roughness))) ** 16
    b = (37530.0 / reynolds) ** 16
    return float(8.0 * ((8.0 / reynolds) ** 12 + (a + b) ** -1.5) ** (1.0 / 12.0))


def zielke_rates(count: int) -> NDArray[np.float64]:
    """Returns the decay rates of Zielke's weighting, squares of the zeros of J2, shape (count,)."""
    return np.asarray(jn_zeros(2, count) ** 2, dtype=float)


def zielke_sum(tau: ArrayLike, terms: int = 2000) -> NDArray[np.float64]:
    """Returns the weighting ``W(tau)`` of W. Zielke, J. Basic Eng. 90 (1968), as its exact sum.

    ``tau = nu t / R^2``; the sum has converged for ``tau`` above about 40 / (pi terms)^2.
    """
    t = np.asarray(tau, dtype=float)
    return np.asarray(np.exp(-np.multiply.outer(t, zielke_rates(terms))).sum(axis=-1))


def zielke_series(tau: ArrayLike) -> NDArray[np.float64]:
    """Returns Zielke's short-time series of ``W(tau)``, for ``tau`` below 0.02."""
    root = np.sqrt(np.asarray(tau, dtype=float))
    powers = (0.282095, -1.25, 1.057855, 0.9375, 0.396696, -0.351563)
    return np.asarray(sum(c * root ** (i - 1) for i, c in enumerate(powers)))


def zielke(tau: ArrayLike) -> NDArray[np.float64]:
    """Returns the weighting ``W(tau)`` at any positive dimensionless time."""
    t = np.asarray(tau, dtype=float)
    exact = zielke_sum(np.maximum(t, ZIELKE_SERIES_LIMIT), terms=60)
    return np.where(t < ZIELKE_SERIES_LIMIT, zielke_series(t), exact)


def zielke_wall_shear(
    time_s: NDArray[np.float64], velocity: NDArray[np.float64], radius: float, nu: float, rho: float
) -> NDArray[np.float64]:
    """Returns the laminar wall shear, Pa, of a velocity that is linear between its samples.

    ``tau_w = 4 rho nu V / R + (2 rho nu / R) int dV/dt' W(t - t') dt'``; gas at rest or in steady
    flow before the first sample. The integral of the exact sum over each interval is closed form.

    Args:
        time_s: Sample times, s, increasing, shape (T,).
        velocity: Mean velocity, m/s, shape (T,).
        radius: Pipe radius, m.
        nu: Kinematic viscosity, m2/s.
        rho: Density, kg/m3.
    """
    rates = zielke_rates(4000) * nu / radius**2
    acceleration = np.diff(velocity) / np.diff(time_s)
    memory = np.zeros_like(rates)
    history = np.zeros_like(time_s)
    for i, dt in enumerate(np.diff(time_s)):
        decay = np.exp(-rates * dt)
        memory = memory * decay + acceleration[i] * (1.0 - decay) / rates
        history[i + 1] = memory.sum()
    return 4.0 * rho * nu * velocity / radius + 2.0 * rho * nu / radius * history


def gnielinski(reynolds: float, prandtl: float) -> float:
    """Nusselt number of turbulent flow in a smooth pipe, with Petukhov's friction factor.

    Incropera et al., Fundamentals of Heat and Mass Transfer, 6th ed., eq. 8.21 and 8.62.
    """
    f = (0.79 * np.log(reynolds) - 1.64) ** -2
    top = f / 8.0 * (reynolds - 1000.0) * prandtl
    return float(top / (1.0 + 12.7 * np.sqrt(f / 8.0) * (prandtl ** (2.0 / 3.0) - 1.0)))


def dittus_boelter(reynolds: float, prandtl: float) -> float:
    """Nusselt number of turbulent flow that is cooled; Incropera et al., eq. 8.60."""
    return float(0.023 * reynolds**0.8 * prandtl**0.3)
