# SPDX-License-Identifier: Apache-2.0
"""States at the ends of pipes, and the powers that they are made of."""

import numpy as np
import pytest
from scipy.optimize import brentq

from pneu_sim.kernel.ends import NEAR, power, vessel_state

GAMMA, R = 1.4, 287.0


@pytest.mark.parametrize("a", [0.5, 1.0 / 1.4, 1.0 / 1.1, 2.5, 3.5, 11.0])
def test_powers_are_those_of_logarithms(a: float) -> None:
    near = 1.0 + NEAR * np.linspace(-1.0, 1.0, 201)
    far = np.array([0.05, 0.5, 0.9, 1.1, 3.0])
    for x in (*near, *far):
        assert power(x, a) == pytest.approx(x**a, rel=1e-14 if x in near else 1e-13)


@pytest.mark.parametrize("pressure_pa", [5.999e5, 5.9e5, 5.5e5, 4.8e5])
@pytest.mark.parametrize("loss", [0.0, 0.5])
def test_gas_from_a_vessel_keeps_its_enthalpy_and_what_arrives(
    pressure_pa: float, loss: float
) -> None:
    """Against a root of Bernoulli's law along the wave from the pipe."""
    p0, t0 = 6e5, 293.0
    density = pressure_pa / (R * t0)
    d, v, p = vessel_state(density, 0.0, pressure_pa, p0, t0, loss, GAMMA, R)
    z = np.sqrt(GAMMA * pressure_pa * density)
    cp = GAMMA * R / (GAMMA - 1.0)

    def over(w: float) -> float:
        stagnation = p0 * (1.0 - (1.0 + loss) * w * w / (2.0 * cp * t0)) ** (GAMMA / (GAMMA - 1.0))
        return stagnation - (pressure_pa + z * w)

    w = brentq(over, 0.0, 200.0, xtol=1e-13, rtol=1e-14)
    assert -v == pytest.approx(w, rel=1e-9)
    assert p == pytest.approx(pressure_pa + z * w, rel=1e-11)
    assert cp * p / (R * d) + 0.5 * v * v == pytest.approx(cp * t0, rel=1e-12)
