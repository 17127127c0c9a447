# SPDX-License-Identifier: Apache-2.0
"""Filling and emptying a rigid chamber through an ISO 6358 port, in closed form.

ISO 6358-1: ``mdot = C rho_ANR p_up sqrt(T_ANR / T_up)``, times
``sqrt(1 - ((p_down/p_up - b) / (1 - b))^2)`` when the pressure ratio is above b. Upstream
temperature is that of the reference atmosphere, 293.15 K, unless a formula says otherwise.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import quad

DENSITY_ANR = 1.185
TEMPERATURE_ANR = 293.15
PRESSURE_ANR = 1.0e5


def time_constant(volume: float, conductance: float) -> float:
    """Returns ``tau = V / (C p_ANR)``, s, for V in m3 and C in m3/(s Pa).

    The chamber at 293.15 K needs tau to fill, choked and isothermal, by one supply pressure. The
    standard's density is taken to fit the gas: ``rho_ANR R T_ANR = p_ANR``.
    """
    return volume / (conductance * PRESSURE_ANR)


def mass_flow(conductance: float, b: float, p_up: float, t_up: float, p_down: float) -> float:
    """Returns the mass flow, kg/s; C in m3/(s Pa), pressures Pa, temperature K."""
    excess = min(max((p_down / p_up - b) / (1.0 - b), 0.0), 1.0)
    choked = conductance * DENSITY_ANR * p_up * np.sqrt(TEMPERATURE_ANR / t_up)
    return float(choked * np.sqrt(1.0 - excess * excess))


def fill_time(x_start: float, x_end: float, b: float, gamma: float = 1.0) -> float:
    """Returns ``t / tau`` to fill from pressure ``x_start`` to ``x_end``, as shares of supply.

    ``gamma`` 1 is the isothermal chamber; the adiabatic one (supply gas at T_ANR) is gamma times
    faster, because the filling enthalpy alone sets dp/dt.
    """

    def elapsed(x: float) -> float:
        if x <= b:
            return x
        return b + (1.0 - b) * float(np.arcsin((x - b) / (1.0 - b)))

    return (elapsed(x_end) - elapsed(x_start)) / gamma


def isothermal_discharge_time(pressure_ratio: float) -> float:
    """Returns ``t / tau`` for the pressure to fall to this share, choked and isothermal."""
    return float(-np.log(pressure_ratio))


def adiabatic_discharge_time(pressure_ratio: float, gamma: float = 1.4) -> float:
    """Returns ``t / tau`` for the pressure to fall to this share, choked and adiabatic."""
    return float(2.0 / (gamma - 1.0) * (pressure_ratio ** (-(gamma - 1.0) / (2.0 * gamma)) - 1.0))


def adiabatic_discharge_pressure(time_over_tau: float, gamma: float = 1.4) -> float:
    """Returns the share of the initial pressure left after ``t / tau``, choked and adiabatic."""
    base = 1.0 + 0.5 * (gamma - 1.0) * time_over_tau
    return float(base ** (-2.0 * gamma / (gamma - 1.0)))


def adiabatic_discharge_temperature(pressure_ratio: float, t_start: float, gamma: float) -> float:
    """Returns the temperature, K, of the gas that stays, after adiabatic discharge."""
    return float(t_start * pressure_ratio ** ((gamma - 1.0) / gamma))


def adiabatic_fill_temperature(
    p_start: float, p_end: float, t_start: float, t_supply: float, gamma: float = 1.4
) -> float:
    """Returns the mean temperature, K, after an adiabatic fill from a supply at ``t_supply``."""
    hot = gamma * t_supply
    return hot / (1.0 + p_start / p_end * (hot / t_start - 1.0))


def isentropic_fill_integral(gamma: float = 1.4) -> float:
    """Returns ``t / tau`` of an ideal orifice filling from its critical ratio to balance.

    The ellipse of ISO 6358 with the same b gives ``(1 - b) pi / 2``.
    """
    b = (2.0 / (gamma + 1.0)) ** (gamma / (gamma - 1.0))

    def flow(x: float) -> float:
        return float(np.sqrt(x ** (2.0 / gamma) - x ** ((gamma + 1.0) / gamma)))

    # s = sqrt(1 - x) removes the root singularity at balance.
    value, _ = quad(
        lambda s: 2.0 * s * flow(b) / flow(1.0 - s * s), 0.0, np.sqrt(1.0 - b), epsabs=1e-12
    )
    return float(value)
