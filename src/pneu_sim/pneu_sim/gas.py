# SPDX-License-Identifier: Apache-2.0
"""Ideal-gas relations: states, transport properties, isentropic flow and ISO 6358 constants.

Everything here is a pure function of SI quantities (kg, m, s, K, absolute Pa) and works on
floats or NumPy arrays alike. Three variables describe the gas in a cell, in either of two forms
(thesis table 4.1):

* primitive: density ``rho`` (kg/m3), velocity ``u`` (m/s), absolute pressure ``p`` (Pa);
* conserved, per volume: mass ``rho`` (kg/m3), momentum ``rho u`` (kg/(m2 s)), total energy
  ``E = rho u^2 / 2 + p / (gamma - 1)`` (J/m3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pneu_common.errors import InputError

FloatArray = NDArray[np.float64]

ANR_TEMPERATURE_K: Final = 293.15
"""Temperature of the ISO 8778 reference atmosphere (ANR), K."""

ANR_PRESSURE_PA: Final = 1.0e5
"""Pressure of the ISO 8778 reference atmosphere (ANR), Pa."""

ANR_DENSITY_KG_M3: Final = 1.185
"""Density of air at ANR, 65 % relative humidity, kg/m3 (ISO 8778; used by ISO 6358)."""


@dataclass(frozen=True, slots=True)
class Gas:
    """A calorically perfect gas with Sutherland viscosity and a constant Prandtl number.

    Attributes:
        gamma: Ratio of specific heats, above 1.
        r_specific: Specific gas constant, J/(kg K).
        mu_ref: Dynamic viscosity at ``t_ref``, Pa s.
        t_ref: Temperature at which ``mu_ref`` holds, K.
        sutherland_k: Sutherland temperature, K; 0 makes viscosity grow as the root of T.
        prandtl: Prandtl number, ``mu c_p / lambda``.
        name: What to call the gas in messages and reports.

    Raises:
        InputError: A property is not finite or outside its physical range.
    """

    gamma: float
    r_specific: float
    mu_ref: float
    prandtl: float
    t_ref: float = 288.15
    sutherland_k: float = 110.4
    name: str = "gas"

    def __post_init__(self) -> None:
        """Rejects values that no gas can have."""
        if not (math.isfinite(self.gamma) and self.gamma > 1.0):
            raise InputError(f"gas '{self.name}': gamma is {self.gamma}, it must be above 1")
        for field in ("r_specific", "mu_ref", "prandtl", "t_ref"):
            value = getattr(self, field)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"gas '{self.name}': {field} is {value}, it must be positive")
        if not (math.isfinite(self.sutherland_k) and self.sutherland_k >= 0.0):
            raise InputError(
                f"gas '{self.name}': sutherland_k is {self.sutherland_k}, it must not be negative"
            )

    @property
    def cp(self) -> float:
        """Specific heat at constant pressure, J/(kg K)."""
        return self.gamma * self.cv

    @property
    def cv(self) -> float:
        """Specific heat at constant volume, J/(kg K)."""
        return self.r_specific / (self.gamma - 1.0)

    @property
    def critical_pressure_ratio(self) -> float:
        """Throat-to-stagnation pressure ratio at which isentropic flow chokes."""
        return (2.0 / (self.gamma + 1.0)) ** (self.gamma / (self.gamma - 1.0))

    @property
    def choked_flow_factor(self) -> float:
        """Factor ``k`` of choked isentropic flow, ``mdot = k A p0 / sqrt(T0)``, s sqrt(K)/m.

        0.0404149 for ``AIR``.
        """
        exponent = (self.gamma + 1.0) / (2.0 * (self.gamma - 1.0))
        return math.sqrt(self.gamma / self.r_specific) * (2.0 / (self.gamma + 1.0)) ** exponent

    # -- states (thesis table 4.1) ----------------------------------------------------------

    def density(self, p: ArrayLike, temperature_k: ArrayLike) -> FloatArray:
        """Returns the density (kg/m3) at pressure ``p`` (Pa) and temperature (K).

        Args:
            p: Absolute pressure, Pa.
            temperature_k: Temperature, K.
        """
        return np.asarray(p, dtype=float) / (self.r_specific * np.asarray(temperature_k))

    def temperature(self, rho: ArrayLike, p: ArrayLike) -> FloatArray:
        """Returns the temperature (K) at density ``rho`` (kg/m3) and pressure ``p`` (Pa).

        Args:
            rho: Density, kg/m3.
            p: Absolute pressure, Pa.
        """
        return np.asarray(p, dtype=float) / (self.r_specific * np.asarray(rho))

    def sound_speed(self, temperature_k: ArrayLike) -> FloatArray:
        """Returns the isentropic speed of sound (m/s) at a temperature (K).

        Args:
            temperature_k: Temperature, K.
        """
        return np.sqrt(self.gamma * self.r_specific * np.asarray(temperature_k, dtype=float))

    def to_conserved(self, primitive: ArrayLike) -> FloatArray:
        """Converts (rho, u, p) to (rho, rho u, E), thesis table 4.1.

        Args:
            primitive: Density, velocity and pressure along the first axis, shape (3, ...).

        Returns:
            Mass, momentum and total energy per volume, same shape.
        """
        rho, u, p = _three_rows(primitive)
        return np.stack([rho, rho * u, 0.5 * rho * u * u + p / (self.gamma - 1.0)])

    def to_primitive(self, conserved: ArrayLike) -> FloatArray:
        """Converts (rho, rho u, E) to (rho, u, p), thesis table 4.1.

        Args:
            conserved: Mass, momentum and total energy per volume along the first axis,
                shape (3, ...).

        Returns:
            Density, velocity and pressure, same shape.
        """
        rho, momentum, energy = _three_rows(conserved)
        u = momentum / rho
        return np.stack([rho, u, (self.gamma - 1.0) * (energy - 0.5 * momentum * u)])

    def flux(self, primitive: ArrayLike) -> FloatArray:
        """Returns the flux of mass, momentum and energy per area (thesis eq. 4.22, corrected).

        The energy flux is ``u (E + p)``; the printed equation counts the pressure work twice.

        Args:
            primitive: Density, velocity and pressure along the first axis, shape (3, ...).

        Returns:
            Fluxes in kg/(m2 s), Pa and W/m2, same shape.
        """
        rho, u, p = _three_rows(primitive)
        enthalpy = 0.5 * rho * u * u + p * self.gamma / (self.gamma - 1.0)
        return np.stack([rho * u, rho * u * u + p, u * enthalpy])

    # -- transport properties ---------------------------------------------------------------

    def viscosity(self, temperature_k: ArrayLike) -> FloatArray:
        """Returns the dynamic viscosity (Pa s) by Sutherland's law.

        ``mu = mu_ref (T / t_ref)^1.5 (t_ref + S) / (T + S)``: Sutherland, Phil. Mag. 36 (1893).

        Args:
            temperature_k: Temperature, K.
        """
        t = np.asarray(temperature_k, dtype=float)
        scale = (self.t_ref + self.sutherland_k) / (t + self.sutherland_k)
        return self.mu_ref * (t / self.t_ref) ** 1.5 * scale

    def conductivity(self, temperature_k: ArrayLike) -> FloatArray:
        """Returns the thermal conductivity (W/(m K)), ``mu c_p / Pr``.

        Args:
            temperature_k: Temperature, K.
        """
        return self.viscosity(temperature_k) * self.cp / self.prandtl

    # -- isentropic flow --------------------------------------------------------------------

    def isentropic_temperature_ratio(self, mach: ArrayLike) -> FloatArray:
        """Returns static over stagnation temperature, ``T / T0``.

        Args:
            mach: Mach number.
        """
        m = np.asarray(mach, dtype=float)
        return 1.0 / (1.0 + 0.5 * (self.gamma - 1.0) * m * m)

    def isentropic_pressure_ratio(self, mach: ArrayLike) -> FloatArray:
        """Returns static over stagnation pressure, ``p / p0``.

        Args:
            mach: Mach number.
        """
        return self.isentropic_temperature_ratio(mach) ** (self.gamma / (self.gamma - 1.0))

    def isentropic_density_ratio(self, mach: ArrayLike) -> FloatArray:
        """Returns static over stagnation density, ``rho / rho0``.

        Args:
            mach: Mach number.
        """
        return self.isentropic_temperature_ratio(mach) ** (1.0 / (self.gamma - 1.0))

    def isentropic_area_ratio(self, mach: ArrayLike) -> FloatArray:
        """Returns the duct area over the sonic throat area, ``A / A*``, at a Mach number > 0.

        Args:
            mach: Mach number.
        """
        m = np.asarray(mach, dtype=float)
        exponent = (self.gamma + 1.0) / (2.0 * (self.gamma - 1.0))
        base = 2.0 / ((self.gamma + 1.0) * self.isentropic_temperature_ratio(m))
        return base**exponent / m

    def isentropic_mach(self, pressure_ratio: ArrayLike) -> FloatArray:
        """Returns the Mach number at a static-to-stagnation pressure ratio ``p / p0`` in (0, 1].

        Args:
            pressure_ratio: Static over stagnation pressure, above 0 and at most 1.
        """
        ratio = np.asarray(pressure_ratio, dtype=float)
        power = ratio ** (-(self.gamma - 1.0) / self.gamma)
        return np.sqrt(2.0 / (self.gamma - 1.0) * (power - 1.0))

    def orifice_mass_flow(
        self, area_m2: ArrayLike, p_up: ArrayLike, t_up: ArrayLike, p_down: ArrayLike
    ) -> FloatArray:
        """Returns the isentropic mass flow (kg/s) through an effective area, choked or not.

        Args:
            area_m2: Effective (vena contracta) area, m2.
            p_up: Upstream stagnation pressure, Pa.
            t_up: Upstream stagnation temperature, K.
            p_down: Downstream pressure, Pa, at most ``p_up``; all broadcast together.
        """
        p_up, t_up = np.asarray(p_up, dtype=float), np.asarray(t_up, dtype=float)
        ratio = np.clip(np.asarray(p_down) / p_up, self.critical_pressure_ratio, 1.0)
        mach = self.isentropic_mach(ratio)
        rho = self.density(p_up, t_up) * self.isentropic_density_ratio(mach)
        a = self.sound_speed(t_up) * np.sqrt(self.isentropic_temperature_ratio(mach))
        return np.asarray(area_m2, dtype=float) * rho * mach * a

    # -- ISO 6358 ---------------------------------------------------------------------------

    def conductance_from_area(self, area_m2: ArrayLike) -> FloatArray:
        """Returns the sonic conductance C (m3 ANR/(s Pa)) of an ideal effective area (m2).

        Both sides describe the same choked mass flow: ``C rho_ANR p0 sqrt(T_ANR / T0)``
        (ISO 6358-1) and ``choked_flow_factor A p0 / sqrt(T0)``. Multiply by 1e8 for
        dm3/(s bar). Because the standard's density is that of humid air, the factor depends on
        the gas constant: 0.199195 dm3/(s bar) per mm2 for dry ``AIR``, 0.198912 for the
        constant ``p_ANR / (rho_ANR T_ANR)`` = 287.87 J/(kg K) that the standard's own density
        implies.

        Args:
            area_m2: Effective area, m2.
        """
        factor = self.choked_flow_factor / (ANR_DENSITY_KG_M3 * math.sqrt(ANR_TEMPERATURE_K))
        return np.asarray(area_m2, dtype=float) * factor

    def area_from_conductance(self, conductance: ArrayLike) -> FloatArray:
        """Returns the ideal effective area (m2) of a sonic conductance C (m3 ANR/(s Pa)).

        Inverse of `conductance_from_area`; multiply dm3/(s bar) by 1e-8 first.

        Args:
            conductance: Sonic conductance C, m3/(s Pa) at ANR.
        """
        return np.asarray(conductance, dtype=float) / self.conductance_from_area(1.0)


def iso6358_mass_flow(
    conductance: ArrayLike,
    b: ArrayLike,
    p_up: ArrayLike,
    t_up: ArrayLike,
    p_down: ArrayLike,
    m: ArrayLike = 0.5,
) -> FloatArray:
    """Returns the mass flow (kg/s) through an ISO 6358-1 component.

    Args:
        conductance: Sonic conductance C, m3 ANR/(s Pa) (1 dm3/(s bar) = 1e-8).
        b: Critical back-pressure ratio, in [0, 1).
        p_up: Upstream stagnation pressure, Pa.
        t_up: Upstream stagnation temperature, K.
        p_down: Downstream pressure, Pa, at most ``p_up``; all broadcast together.
        m: Subsonic index; 0.5 is the ellipse of ISO 6358:1989.
    """
    p_up, t_up = np.asarray(p_up, dtype=float), np.asarray(t_up, dtype=float)
    b = np.asarray(b, dtype=float)
    excess = np.clip((np.asarray(p_down) / p_up - b) / (1.0 - b), 0.0, 1.0)
    choked = np.asarray(conductance) * ANR_DENSITY_KG_M3 * p_up
    choked = choked * np.sqrt(ANR_TEMPERATURE_K / t_up)
    return choked * (1.0 - excess * excess) ** np.asarray(m)


def _three_rows(state: ArrayLike) -> FloatArray:
    """Returns `state` as floats after checking that its first axis holds three variables."""
    array = np.asarray(state, dtype=float)
    if array.ndim == 0 or array.shape[0] != 3:
        raise InputError(f"gas state: shape is {array.shape}, the first axis must have length 3")
    return array


AIR: Final = Gas(
    gamma=1.4,
    r_specific=287.05,
    mu_ref=1.7894e-5,
    prandtl=0.707,
    t_ref=288.15,
    sutherland_k=110.4,
    name="air",
)
"""Dry air: viscosity and Sutherland constant of the U.S. Standard Atmosphere, 1976."""
