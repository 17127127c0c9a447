# SPDX-License-Identifier: Apache-2.0
"""States at the ends of pipes and at steps of their area, and the powers that these are made of."""

import numpy as np
import pytest
from scipy.optimize import brentq
from tests.references.nozzle import area_ratio, pressure_ratio, temperature_ratio

from pneu_sim.kernel.ends import NEAR, power, vessel_state
from pneu_sim.kernel.faces import at_face

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


def flowing(mach: float, p0: float, t0: float) -> tuple[float, float, float]:
    """Density, velocity and pressure of gas that came from rest without loss."""
    t, p = t0 * temperature_ratio(mach), p0 * pressure_ratio(mach)
    return p / (R * t), mach * float(np.sqrt(GAMMA * R * t)), p


@pytest.mark.parametrize("mach", [0.2, 0.5, 0.63, 0.7, 0.8, 0.95])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_gas_contracts_towards_a_face_without_loss(mach: float, sign: float) -> None:
    """Against the isentropic nozzle, from slow flow up to nearly that of sound."""
    area = 9e-6
    face = area * area_ratio(mach) / area_ratio(0.5 * mach)
    d, u, p = flowing(0.5 * mach, 6e5, 290.0)
    found = at_face(d, sign * u, p, area, face, False, GAMMA)
    wanted = flowing(mach, 6e5, 290.0)
    assert found == pytest.approx((wanted[0], sign * wanted[1], wanted[2]), rel=2e-3)
    assert found[0] * found[1] * face == pytest.approx(sign * d * u * area, rel=1e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_gas_that_a_face_cannot_pass_is_sonic_there(sign: float) -> None:
    d, u, p = flowing(0.6, 6e5, 290.0)
    found = at_face(d, sign * u, p, 9e-6, 0.7 * 9e-6, False, GAMMA)  # sonic at 1 / 1.188
    wanted = flowing(1.0, 6e5, 290.0)
    assert found == pytest.approx((wanted[0], sign * wanted[1], wanted[2]), rel=1e-9)


@pytest.mark.parametrize("share", [0.4, 0.8])
def test_gas_spreads_behind_a_face_as_a_jet(share: float) -> None:
    """Against the balances of mass, momentum and energy, the wall bearing the jet's pressure."""
    area = 9e-6
    d1, v1, p1 = flowing(0.7, 6e5, 290.0)
    mass = share * d1 * v1
    push = p1 + share * d1 * v1 * v1
    heat = GAMMA / (GAMMA - 1.0) * p1 / d1 + 0.5 * v1 * v1

    def off(u: float) -> float:
        p = push - mass * u
        return GAMMA / (GAMMA - 1.0) * p * u / mass + 0.5 * u * u - heat

    u = brentq(off, 1.0, 0.9 * v1, xtol=1e-13, rtol=1e-14)
    found = at_face(mass / u, u, push - mass * u, area, share * area, True, GAMMA)
    assert found == pytest.approx((d1, v1, p1), rel=1e-9)
