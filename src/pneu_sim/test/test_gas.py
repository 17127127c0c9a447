# SPDX-License-Identifier: Apache-2.0
"""Gas relations against published tables and measured properties of air."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_sim import gas
from pneu_sim.gas import AIR, Gas


def test_states_round_trip_and_mean_what_the_table_says() -> None:
    primitive = np.array([[1.2, 8.3], [-30.0, 250.0], [101325.0, 7e5]])
    conserved = AIR.to_conserved(primitive)
    np.testing.assert_allclose(conserved[1], [-36.0, 2075.0])
    energy = [0.5 * 1.2 * 900.0 + 101325.0 / 0.4, 0.5 * 8.3 * 62500.0 + 7e5 / 0.4]
    np.testing.assert_allclose(conserved[2], energy)
    np.testing.assert_allclose(AIR.to_primitive(conserved), primitive, rtol=1e-14)


def test_energy_flux_carries_enthalpy_once() -> None:
    rho, u, p = 1.2, 100.0, 101325.0
    mass, momentum, energy = AIR.flux([rho, u, p])
    assert mass == pytest.approx(120.0)
    assert momentum == pytest.approx(1.2e4 + p)
    stagnation = AIR.cp * p / (rho * AIR.r_specific) + u * u / 2.0
    assert energy == pytest.approx(mass * stagnation, rel=1e-14)


def test_state_with_wrong_first_axis_is_refused() -> None:
    with pytest.raises(InputError, match="first axis must have length 3"):
        AIR.to_conserved([1.0, 2.0])


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"gamma": 1.0}, "gamma"),
        ({"gamma": float("nan")}, "gamma"),
        ({"r_specific": 0.0}, "r_specific"),
        ({"mu_ref": -1.0}, "mu_ref"),
        ({"prandtl": float("inf")}, "prandtl"),
        ({"sutherland_k": -1.0}, "sutherland_k"),
    ],
)
def test_impossible_gas_is_refused_by_field(change: dict[str, float], word: str) -> None:
    with pytest.raises(InputError, match=word):
        Gas(**{**dataclasses.asdict(AIR), **change})


# U.S. Standard Atmosphere 1976: T K, sound speed m/s, viscosity Pa s, conductivity W/(m K).
# Its conductivity follows eq. 53, which no constant Prandtl number matches to better than 2 %.
@pytest.mark.parametrize(
    ("temperature", "speed", "viscosity", "conductivity"),
    [(288.15, 340.29, 1.7894e-5, 2.5326e-2), (255.65, 320.54, 1.6281e-5, 2.2730e-2)],
)
def test_air_against_the_standard_atmosphere(
    temperature: float, speed: float, viscosity: float, conductivity: float
) -> None:
    assert AIR.sound_speed(temperature) == pytest.approx(speed, rel=1e-4)
    assert AIR.viscosity(temperature) == pytest.approx(viscosity, rel=3e-4)
    assert AIR.conductivity(temperature) == pytest.approx(conductivity, rel=0.02)
    assert AIR.temperature(AIR.density(2e5, temperature), 2e5) == pytest.approx(temperature)


def test_air_density_at_standard_conditions() -> None:
    assert AIR.density(101325.0, 288.15) == pytest.approx(1.2250, rel=1e-4)


@pytest.mark.parametrize(
    ("mach", "area", "p", "t"),
    [
        (0.1, 5.82183, 0.99303, 0.99800),
        (0.3, 2.03507, 0.93947, 0.98232),
        (0.5, 1.33984, 0.84302, 0.95238),
        (1.0, 1.0, 0.52828, 0.83333),
        (1.5, 1.17617, 0.27240, 0.68966),
        (2.0, 1.6875, 0.12780, 0.55556),
        (3.0, 4.23457, 0.02722, 0.35714),
    ],
)
def test_isentropic_table(mach: float, area: float, p: float, t: float) -> None:
    assert AIR.isentropic_area_ratio(mach) == pytest.approx(area, abs=6e-6)
    assert AIR.isentropic_pressure_ratio(mach) == pytest.approx(p, abs=6e-6)
    assert AIR.isentropic_temperature_ratio(mach) == pytest.approx(t, abs=6e-6)
    assert AIR.isentropic_density_ratio(mach) == pytest.approx(p / t, abs=2e-5)
    assert AIR.isentropic_mach(AIR.isentropic_pressure_ratio(mach)) == pytest.approx(mach)


def test_choked_orifice_constants() -> None:
    assert AIR.critical_pressure_ratio == pytest.approx(0.5282818, abs=5e-8)
    assert AIR.choked_flow_factor == pytest.approx(0.0404149, abs=5e-8)
    for back in (0.0, 3e5, 0.5282 * 6e5):
        flow = AIR.orifice_mass_flow(2e-6, 6e5, 300.0, back)
        assert flow == pytest.approx(0.0404149 * 2e-6 * 6e5 / np.sqrt(300.0), rel=2e-6)


def test_orifice_is_bernoulli_at_small_drop_and_shut_at_none() -> None:
    flow = AIR.orifice_mass_flow(1e-6, 1e5 + 10.0, 293.15, 1e5)
    rho = 1e5 / (287.05 * 293.15)
    assert flow == pytest.approx(1e-6 * np.sqrt(2.0 * rho * 10.0), rel=1e-3)
    assert AIR.orifice_mass_flow(1e-6, 1e5, 293.15, 1e5) == 0.0


def test_conductance_and_area_describe_the_same_choked_flow() -> None:
    conductance = 3e-8
    area = AIR.area_from_conductance(conductance)
    for p_up, t_up in ((7e5, 293.15), (3e5, 250.0)):
        port = gas.iso6358_mass_flow(conductance, 0.3, p_up, t_up, 0.2 * p_up)
        hole = AIR.orifice_mass_flow(area, p_up, t_up, 0.2 * p_up)
        assert port == pytest.approx(hole, rel=1e-13)


def test_conductance_of_a_square_millimetre() -> None:
    """0.198912 dm3/(s bar) when the gas constant is the one the ANR density implies."""
    anr = Gas(1.4, gas.ANR_PRESSURE_PA / (1.185 * 293.15), AIR.mu_ref, AIR.prandtl)
    assert anr.conductance_from_area(1e-6) * 1e8 == pytest.approx(0.198912, abs=6e-7)
    # Dry air is 0.28 % lighter per kelvin, which enters as a root.
    ratio = np.sqrt(anr.r_specific / AIR.r_specific)
    assert AIR.conductance_from_area(1e-6) * 1e8 == pytest.approx(0.198912 * ratio, abs=6e-7)


def test_ellipse_with_ideal_b_stays_near_the_isentropic_orifice() -> None:
    ratio = np.linspace(0.0, 0.999, 500)
    conductance = AIR.conductance_from_area(1e-6)
    back = 5e5 * ratio
    ellipse = gas.iso6358_mass_flow(conductance, AIR.critical_pressure_ratio, 5e5, 293.15, back)
    orifice = AIR.orifice_mass_flow(1e-6, 5e5, 293.15, back)
    assert np.max(np.abs(ellipse - orifice)) < 0.0016 * orifice[0]


@pytest.mark.parametrize(
    ("b", "litres"), [(0.2, 239.8), (0.3, 254.5), (0.4, 272.3), (0.528, 301.4)]
)
def test_nominal_flow_six_to_five_bar_gauge(b: float, litres: float) -> None:
    """Q_n in l/min ANR of C = 1 dm3/(s bar)."""
    p_up, p_down = 7.01325e5, 6.01325e5
    mass = gas.iso6358_mass_flow(1e-8, b, p_up, gas.ANR_TEMPERATURE_K, p_down)
    assert mass / gas.ANR_DENSITY_KG_M3 * 6e4 == pytest.approx(litres, rel=1e-3)
