# SPDX-License-Identifier: Apache-2.0
"""Small-signal response of tubes with viscous and thermal losses, ending in volumes.

H. Bergh and H. Tijdeman, Theoretical and experimental results for the dynamic response of
pressure measuring systems, NLR-TR F.238, 1965; time dependence exp(+i omega t).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import jve

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class LineGas:
    """Mean state of the gas in the line: pressure Pa, temperature K, viscosity Pa s."""

    pressure: float = 101325.0
    temperature: float = 288.15
    viscosity: float = 1.82e-5
    prandtl: float = 0.707
    gamma: float = 1.4
    r_specific: float = 287.05

    @property
    def density(self) -> float:
        """Mean density, kg/m3."""
        return self.pressure / (self.r_specific * self.temperature)

    @property
    def sound_speed(self) -> float:
        """Isentropic speed of sound, m/s."""
        return float(np.sqrt(self.gamma * self.r_specific * self.temperature))


@dataclass(frozen=True)
class Section:
    """A tube (radius m, length m) that opens into a volume (m3).

    ``sigma`` is the relative volume increase of the transducer, ``k`` the polytropic exponent of
    the volume.
    """

    radius: float
    length: float
    volume: float = 0.0
    sigma: float = 0.0
    k: float = 1.4

    @property
    def tube_volume(self) -> float:
        """Volume of the tube, m3."""
        return float(np.pi * self.radius**2 * self.length)


def _bessel_2_over_0(z: ComplexArray) -> ComplexArray:
    """J2(z) / J0(z); scaled functions, so that wide tubes do not overflow."""
    return np.asarray(jve(2, z) / jve(0, z), dtype=complex)


def propagation(
    radius: float, omega: NDArray[np.float64], gas: LineGas
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Returns propagation constant phi (1/m), polytropic number n and J2/J0 of a tube."""
    alpha = 1j**1.5 * radius * np.sqrt(gas.density * omega / gas.viscosity)
    heat = _bessel_2_over_0(alpha * np.sqrt(gas.prandtl))
    n = 1.0 / (1.0 + (gas.gamma - 1.0) / gas.gamma * heat)
    shear = _bessel_2_over_0(alpha)
    phi = omega / gas.sound_speed * np.sqrt(1.0 / shear) * np.sqrt(gas.gamma / n)
    return np.asarray(phi, dtype=complex), n, shear


def response(
    sections: Sequence[Section], frequency_hz: ArrayLike, gas: LineGas | None = None
) -> ComplexArray:
    """Returns ``p_j / p_0`` for the volume behind each section, shape (sections, frequencies).

    Recursion of Bergh and Tijdeman from the last volume towards the inlet. Frequencies must be
    positive.
    """
    gas = gas or LineGas()
    omega = 2.0 * np.pi * np.atleast_1d(np.asarray(frequency_hz, dtype=float))
    waves = [propagation(s.radius, omega, gas) for s in sections]
    ratios: list[ComplexArray] = []
    for j in range(len(sections) - 1, -1, -1):
        here = sections[j]
        phi, n, shear = waves[j]
        x = phi * here.length
        inverse = np.cosh(x) + here.volume / here.tube_volume * (
            here.sigma + 1.0 / here.k
        ) * n * x * np.sinh(x)
        if j + 1 < len(sections):
            after = sections[j + 1]
            phi_next, _, shear_next = waves[j + 1]
            x_next = phi_next * after.length
            admittance = (after.tube_volume * phi_next * here.length * shear_next) / (
                here.tube_volume * phi * after.length * shear
            )
            inverse += admittance * np.sinh(x) / np.sinh(x_next) * (np.cosh(x_next) - ratios[0])
        ratios.insert(0, 1.0 / inverse)
    return np.asarray(np.cumprod(np.array(ratios), axis=0), dtype=complex)


def tube_and_volume(
    radius: float,
    length: float,
    volume: float,
    frequency_hz: ArrayLike,
    gas: LineGas | None = None,
) -> ComplexArray:
    """Returns ``p_end / p_0`` of one tube that ends in a rigid volume, shape (frequencies,)."""
    return response([Section(radius, length, volume)], frequency_hz, gas)[0]


def quasi_steady_tube_and_volume(
    radius: float,
    length: float,
    volume: float,
    frequency_hz: ArrayLike,
    gas: LineGas | None = None,
    polytropic: float = 1.4,
    drag_coefficient: float = 8.0,
) -> ComplexArray:
    """Returns ``p_end / p_0`` with quasi-steady drag, ``drag_coefficient pi mu u`` per length.

    What a solver without unsteady friction should give: ``polytropic`` 1.4 for an adiabatic
    tube, 1 for a tube at wall temperature; the end volume stays adiabatic.
    """
    gas = gas or LineGas()
    omega = 2.0 * np.pi * np.atleast_1d(np.asarray(frequency_hz, dtype=float))
    resistance = drag_coefficient * gas.viscosity / (gas.density * radius**2)
    phi = (
        1j
        * omega
        / gas.sound_speed
        * np.sqrt((1.0 - 1j * resistance / omega) * gas.gamma / polytropic)
    )
    x = phi * length
    share = volume / (np.pi * radius**2 * length)
    return 1.0 / (np.cosh(x) + share * polytropic / gas.gamma * x * np.sinh(x))
