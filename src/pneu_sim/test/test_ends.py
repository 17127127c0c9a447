# SPDX-License-Identifier: Apache-2.0
"""States at the ends of pipes and at steps of their area, and the powers that these are made of."""

import numpy as np
import pytest
from scipy.optimize import brentq
from tests.references.nozzle import area_ratio, pressure_ratio, temperature_ratio

from pneu_sim.kernel.ends import vessel_state
from pneu_sim.kernel.faces import _passed, _widened, at_face
from pneu_sim.kernel.waves import NEAR, leaving, power, wave_state
from pneu_sim.riemann import solve

GAMMA, R = 1.4, 287.0


@pytest.mark.parametrize("a", [0.5, 1.0 / 1.4, 1.0 / 1.1, 2.5, 3.5, 11.0])
def test_powers_are_those_of_logarithms(a: float) -> None:
    near = 1.0 + NEAR * np.linspace(-1.0, 1.0, 201)
    far = np.array([0.05, 0.5, 0.9, 1.1, 3.0])
    for x in (*near, *far):
        assert power(x, a) == pytest.approx(x**a, rel=1e-14 if x in near else 1e-13)


@pytest.mark.parametrize("pressure_pa", [5.999e5, 5.9e5, 5.5e5, 4.8e5])
@pytest.mark.parametrize("loss", [0.0, 0.5])
@pytest.mark.parametrize("guess", [0.0, -3.0, -150.0, -900.0])
def test_gas_from_a_vessel_keeps_its_enthalpy_and_what_arrives(
    pressure_pa: float, loss: float, guess: float
) -> None:
    """Against a root of Bernoulli's law along the wave from the pipe."""
    p0, t0 = 6e5, 293.0
    density = pressure_pa / (R * t0)
    d, v, p = vessel_state(density, 0.0, pressure_pa, p0, t0, loss, guess, GAMMA, R)
    cp = GAMMA * R / (GAMMA - 1.0)

    def behind_a_shock(w: float) -> float:
        """Of gas at rest that is pushed back (Anderson 2003, eq. 7.16, solved for the pressure)."""
        k = 0.25 * (GAMMA + 1.0) * w
        return pressure_pa + density * w * float(k + np.sqrt(k * k + GAMMA * R * t0))

    def over(w: float) -> float:
        stagnation = p0 * (1.0 - (1.0 + loss) * w * w / (2.0 * cp * t0)) ** (GAMMA / (GAMMA - 1.0))
        return stagnation - behind_a_shock(w)

    w = brentq(over, 0.0, 200.0, xtol=1e-13, rtol=1e-14)
    assert -v == pytest.approx(w, abs=1e-9 * p0 / (density * float(np.sqrt(GAMMA * R * t0))))
    assert p == pytest.approx(behind_a_shock(w), abs=1e-9 * p0)
    assert cp * p / (R * d) + 0.5 * v * v == pytest.approx(cp * t0, rel=1e-12)


@pytest.mark.parametrize(("v", "pressure_pa"), [(2.0, 6e5), (0.0, 6.4e5), (150.0, 5e5), (0.0, 2e6)])
def test_what_leaves_does_not_depend_on_inflow_that_was_expected(
    v: float, pressure_pa: float
) -> None:
    density = pressure_pa / (R * 293.0)
    wanted = vessel_state(density, v, pressure_pa, 6e5, 293.0, 0.0, 0.0, GAMMA, R)
    assert wanted[1] > 0.0
    for guess in (-1e-6, -3.0, -300.0):
        found = vessel_state(density, v, pressure_pa, 6e5, 293.0, 0.0, guess, GAMMA, R)
        assert found == pytest.approx(wanted, rel=1e-14)


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
    found = at_face(d, sign * u, p, area, face, GAMMA)
    wanted = flowing(mach, 6e5, 290.0)
    assert found == pytest.approx((wanted[0], sign * wanted[1], wanted[2]), rel=2e-3)
    assert found[0] * found[1] * face == pytest.approx(sign * d * u * area, rel=1e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_gas_that_a_face_cannot_pass_is_sonic_there(sign: float) -> None:
    d, u, p = flowing(0.6, 6e5, 290.0)
    found = at_face(d, sign * u, p, 9e-6, 0.7 * 9e-6, GAMMA)  # sonic at 1 / 1.188
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
    found = _widened(d1, v1, p1, share * area, area, heat, GAMMA)
    assert found == pytest.approx((mass / u, u, push - mass * u), rel=1e-9)


@pytest.mark.parametrize("out", [-150.0, -20.0, 0.0, 3.0, 60.0, 220.0])
@pytest.mark.parametrize("v", [-40.0, 0.0, 90.0])
def test_the_wave_that_an_end_sends_is_that_of_a_piston(out: float, v: float) -> None:
    """Half the exact Riemann problem of two equal gases that meet at the piston's speed."""
    d, p = 3.0, 2.5e5
    _, pressure, slope = wave_state(d, v, p, out, GAMMA)
    star, velocity = mirrored(d, v - out, p)
    assert pressure == pytest.approx(star, rel=1e-9) and abs(velocity) < 1e-6
    step = 1e-3
    above, below = (wave_state(d, v, p, out + s, GAMMA)[1] for s in (step, -step))
    assert slope == pytest.approx((below - above) / (2.0 * step), rel=1e-6)
    back, _ = leaving(d, v, p, pressure, GAMMA)
    assert back == pytest.approx(out, abs=1e-8)


def mirrored(d: float, v: float, p: float) -> tuple[float, float]:
    """Pressure and velocity between a gas and its mirror image (`pneu_sim.riemann.solve`)."""
    _, velocity, pressure = solve((d, v, p), (d, -v, p), [0.0], GAMMA)
    return float(pressure[0]), float(velocity[0])


@pytest.mark.parametrize(("wide", "narrow"), [(6e-6, 6e-7), (9e-6, 6e-6)])
def test_steady_flow_over_a_step_of_area_stays(wide: float, narrow: float) -> None:
    """What the nozzle and the jet give is what flows, and sends no wave."""
    d1, v1, p1 = flowing(0.05, 4e5, 293.0)
    d2, v2, p2 = at_face(d1, v1, p1, wide, narrow, GAMMA)
    heat = GAMMA / (GAMMA - 1.0) * p1 / d1 + 0.5 * v1 * v1
    mass = d1 * v1 * wide
    m, h, before, _, behind = _passed(
        d1, v1, p1, wide, d2, -v2, p2, narrow, narrow, 0.0, 0.0, GAMMA
    )
    assert (m, h) == pytest.approx((mass, heat), rel=1e-7)
    assert (before, behind) == pytest.approx((p1 + d1 * v1**2, p2 + d2 * v2**2), rel=1e-7)
    d3, v3, p3 = _widened(d2, v2, p2, narrow, wide, heat, GAMMA)
    m, h, before, _, behind = _passed(
        d2, v2, p2, narrow, d3, -v3, p3, wide, narrow, 0.0, 0.0, GAMMA
    )
    assert (m, h) == pytest.approx((mass, heat), rel=1e-7)
    assert (before, behind) == pytest.approx((p2 + d2 * v2**2, p3 + d3 * v3**2), rel=1e-7)


def test_a_step_that_chokes_passes_what_its_face_does() -> None:
    """A wide line at 7 bar into a tenth of its area: sonic flow from rest but for the wave."""
    d, p = 7e5 / (R * 293.0), 7e5
    m, h, *_ = _passed(d, 0.0, p, 6e-6, 1e5 / (R * 293.0), 0.0, 1e5, 6e-7, 6e-7, 0.0, 0.0, GAMMA)
    assert h < GAMMA * R * 293.0 / (GAMMA - 1.0)  # expanded by the wave

    def over(out: float) -> float:
        _, q, _ = wave_state(d, 0.0, p, out, GAMMA)
        _, df = leaving(d, 0.0, p, q, GAMMA)
        mach = out / np.sqrt(GAMMA * q / df)
        return float(area_ratio(mach)) - 10.0

    out = brentq(over, 1.0, 100.0, xtol=1e-12)
    _, q, _ = wave_state(d, 0.0, p, out, GAMMA)
    _, df = leaving(d, 0.0, p, q, GAMMA)
    assert m == pytest.approx(df * out * 6e-6, rel=1e-5)
