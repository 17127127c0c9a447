# SPDX-License-Identifier: Apache-2.0
"""The references themselves: held against published tables, limits and numerical integration."""

from __future__ import annotations

import ast
import re
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.references import (
    bergh_curves,
    bergh_tijdeman,
    fanno,
    iso6358,
    modes,
    nozzle,
    pipe_flow,
    piston,
)

# -- Bergh and Tijdeman -----------------------------------------------------------------------

# radius m, then frequency Hz, amplitude, phase deg (None: not tabulated); L = 1 m, V = 300 mm3
LINE_TABLE = {
    0.75e-3: (
        (1, 1.0003, -0.6), (5, 1.0079, -2.9), (10, 1.0318, -5.9), (20, 1.1333, -12.9),
        (30, 1.3253, -22.6), (40, 1.6382, -37.3), (50, 2.0232, -61.0), (56.8, 2.1475, -82.6),
        (60, 2.1171, -93.2), (80, 1.3737, -140.2), (100, 0.9507, -161.4), (125, 0.7903, -178.9),
        (150, 0.8386, -198.0), (175, 1.0573, -229.2), (190, 1.1583, -258.3), (200, 1.1147, -279.6),
        (225, 0.8081, -320.4), (250, 0.6218, -345.0), (300, 0.6091, -388.1),
    ),
    1.25e-3: (
        (20, 1.1189, -4.6), (40, 1.5950, -14.1), (60, 3.2416, -45.6), (69.2, 4.1603, None),
        (80, 3.0288, -130.8), (100, 1.5267, -159.5), (150, 0.9369, -181.6), (200, 1.6625, -216.0),
        (225, 2.3583, -277.7), (300, 0.8558, -359.8),
    ),
    0.5e-3: (
        (20, 1.0562, -34.2), (32.15, 1.0910, None), (50, 0.9716, -100.5), (100, 0.5310, -172.1),
        (200, 0.3577, -315.4), (300, 0.2446, -434.7),
    ),
}  # fmt: skip


@pytest.mark.parametrize("radius", LINE_TABLE)
def test_line_response_table(radius: float) -> None:
    rows = LINE_TABLE[radius]
    dense = np.linspace(0.05, 300.0, 6000)
    response = bergh_tijdeman.tube_and_volume(radius, 1.0, 300e-9, dense)
    phase = np.degrees(np.unwrap(np.angle(response)))
    for frequency, amplitude, degrees in rows:
        at = bergh_tijdeman.tube_and_volume(radius, 1.0, 300e-9, frequency)[0]
        assert abs(at) == pytest.approx(amplitude, abs=6e-5)
        if degrees is not None:
            assert np.interp(frequency, dense, phase) == pytest.approx(degrees, abs=0.06)


def test_line_response_robot_size_grows_sharper_with_mean_pressure() -> None:
    frequency = np.linspace(15.0, 35.0, 20001)
    for pressure, peak_hz, peak in ((101325.0, 22.05, 3.957), (701325.0, 24.25, 11.36)):
        temperature = 288.15 if pressure < 2e5 else 293.15
        gas = bergh_tijdeman.LineGas(pressure=pressure, temperature=temperature)
        amplitude = np.abs(bergh_tijdeman.tube_and_volume(2e-3, 2.0, 20e-6, frequency, gas))
        assert amplitude.max() == pytest.approx(peak, rel=1e-3)
        assert frequency[amplitude.argmax()] == pytest.approx(peak_hz, abs=0.06)


@pytest.mark.parametrize("curve", bergh_curves.load(), ids=lambda c: c.name)
def test_line_response_published_curves(curve: bergh_curves.Curve) -> None:
    gas = bergh_tijdeman.LineGas(pressure=curve.pressure)
    frequency, amplitude = curve.amplitude.T
    model = bergh_tijdeman.tube_and_volume(curve.radius, curve.length, curve.volume, frequency, gas)
    assert np.sqrt(np.mean((np.abs(model) - amplitude) ** 2)) < 0.07
    assert np.abs(model).max() == pytest.approx(amplitude.max(), rel=0.025)
    dense = np.linspace(0.5, 400.0, 8000)
    whole = bergh_tijdeman.tube_and_volume(curve.radius, curve.length, curve.volume, dense, gas)
    phase = np.interp(curve.phase[:, 0], dense, np.degrees(np.unwrap(np.angle(whole))))
    assert np.sqrt(np.mean((phase - curve.phase[:, 1]) ** 2)) < 4.0


def test_all_line_curves_are_shipped() -> None:
    assert len(bergh_curves.load()) == 12


def test_line_recursion_does_not_see_a_cut() -> None:
    """Cutting a tube in three, without volumes at the cuts, must change nothing."""
    frequency = np.array([5.0, 40.0, 90.0, 180.0])
    whole = bergh_tijdeman.tube_and_volume(1e-3, 1.0, 300e-9, frequency)
    lengths = (0.2, 0.5, 0.3)
    sections = [
        bergh_tijdeman.Section(1e-3, length, volume)
        for length, volume in zip(lengths, (0.0, 0.0, 300e-9), strict=True)
    ]
    cut = bergh_tijdeman.response(sections, frequency)
    np.testing.assert_allclose(cut[-1], whole, rtol=1e-12)


def test_line_response_tends_to_loss_free_modes() -> None:
    """In a very wide tube the peaks lie at the roots of x tan x = AL/V."""
    radius, length, volume = 0.05, 1.0, 4e-3
    gas = bergh_tijdeman.LineGas()
    expected = modes.tube_volume_frequencies(np.pi * radius**2, length, volume, gas.sound_speed, 2)
    for peak in expected:
        frequency = np.linspace(0.9 * peak, 1.1 * peak, 20001)
        amplitude = np.abs(bergh_tijdeman.tube_and_volume(radius, length, volume, frequency, gas))
        assert frequency[amplitude.argmax()] == pytest.approx(peak, rel=0.01)


@pytest.mark.parametrize(
    ("radius", "length", "volume", "polytropic", "drag", "peak", "peak_hz"),
    [
        (0.75e-3, 1.0, 300e-9, 1.4, 8.0, 2.722, 70.7),
        (0.75e-3, 1.0, 300e-9, 1.0, 8.0, 2.420, 61.7),
        (0.75e-3, 1.0, 300e-9, 1.4, 4.0, 5.416, 72.4),
        (1.25e-3, 1.0, 300e-9, 1.4, 8.0, 8.406, 80.0),
        (2e-3, 2.0, 20e-6, 1.4, 8.0, 6.091, 25.1),
        (2e-3, 2.0, 20e-6, 1.0, 8.0, 5.876, 23.6),
    ],
)
def test_quasi_steady_line_table(
    radius: float,
    length: float,
    volume: float,
    polytropic: float,
    drag: float,
    peak: float,
    peak_hz: float,
) -> None:
    frequency = np.linspace(5.0, 120.0, 23001)
    amplitude = np.abs(
        bergh_tijdeman.quasi_steady_tube_and_volume(
            radius, length, volume, frequency, None, polytropic, drag
        )
    )
    assert amplitude.max() == pytest.approx(peak, abs=6e-4)
    assert frequency[amplitude.argmax()] == pytest.approx(peak_hz, abs=0.06)


# -- Steady compressible flow -----------------------------------------------------------------

# Mach, f L*/D, p/p*, T/T*, p0/p0*
FANNO_TABLE = (
    (0.05, 280.02031, 21.90343, 1.19940, 11.59144),
    (0.1, 66.92156, 10.94351, 1.19760, 5.82183),
    (0.2, 14.53327, 5.45545, 1.19048, 2.96352),
    (0.3, 5.29925, 3.61906, 1.17878, 2.03507),
    (0.4, 2.30849, 2.69582, 1.16279, 1.59014),
    (0.5, 1.06906, 2.13809, 1.14286, 1.33984),
    (0.6, 0.49082, 1.76336, 1.11940, 1.18820),
    (0.7, 0.20814, 1.49345, 1.09290, 1.09437),
    (0.8, 0.07229, 1.28928, 1.06383, 1.03823),
    (0.9, 0.01451, 1.12913, 1.03270, 1.00886),
    (2.0, 0.30500, 0.40825, 0.66667, 1.6875),
)


@pytest.mark.parametrize(("mach", "length", "p", "t", "p0"), FANNO_TABLE)
def test_fanno_table(mach: float, length: float, p: float, t: float, p0: float) -> None:
    assert fanno.friction_length(mach) == pytest.approx(length, abs=6e-6)
    assert fanno.pressure_ratio(mach) == pytest.approx(p, abs=6e-6)
    assert fanno.temperature_ratio(mach) == pytest.approx(t, abs=6e-6)
    assert fanno.stagnation_pressure_ratio(mach) == pytest.approx(p0, abs=6e-6)
    if mach < 1.0:
        assert fanno.subsonic_mach(fanno.friction_length(mach)) == pytest.approx(mach, rel=1e-9)


# bore mm, length m, mass flow g/s, inlet Mach, p*/p0; 7.01325 bar, 293.15 K, entrance loss 0.5
CHOKED_TUBES = (
    (2, 1.0, 2.029, 0.2332, 0.2061),
    (4, 0.5, 12.975, 0.3960, 0.3295),
    (4, 1.0, 10.858, 0.3211, 0.2757),
    (4, 2.0, 8.5815, 0.2476, 0.2179),
    (4, 5.0, 5.8253, 0.1647, 0.1479),
    (6, 2.0, 22.888, 0.2984, 0.2583),
    (8, 2.0, 45.113, 0.3354, 0.2864),
)


@pytest.mark.parametrize(("bore_mm", "length", "grams", "mach", "exit_ratio"), CHOKED_TUBES)
def test_choked_tube_table(
    bore_mm: float, length: float, grams: float, mach: float, exit_ratio: float
) -> None:
    tube = fanno.choked_tube(bore_mm * 1e-3, length, 701325.0, 293.15, 0.5)
    # The table's viscosity is not printed; 0.5 % of viscosity moves the flow by 0.03 %.
    assert tube.mass_flow * 1e3 == pytest.approx(grams, rel=5e-4)
    assert tube.mach_in == pytest.approx(mach, rel=8e-4)
    assert tube.exit_pressure_ratio == pytest.approx(exit_ratio, rel=8e-4)


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
def test_nozzle_table(mach: float, area: float, p: float, t: float) -> None:
    assert nozzle.area_ratio(mach) == pytest.approx(area, abs=6e-6)
    assert nozzle.pressure_ratio(mach) == pytest.approx(p, abs=6e-6)
    assert nozzle.temperature_ratio(mach) == pytest.approx(t, abs=6e-6)
    if mach != 1.0:
        back = nozzle.mach_from_area(nozzle.area_ratio(mach), supersonic=mach > 1.0)
        assert back == pytest.approx(mach, rel=1e-9)


# -- Ports and chambers -----------------------------------------------------------------------


@pytest.mark.parametrize(("b", "share"), [(0.2, 1.31216), (0.3, 1.25508), (0.528, 1.12477)])
def test_iso_fill_table(b: float, share: float) -> None:
    # 0.528 stands for the isentropic critical ratio; the table cuts its last digit.
    b = 0.5282818 if b == 0.528 else b
    start = 1.01325 / 7.01325
    assert iso6358.fill_time(start, 1.0, b) == pytest.approx(share, abs=1e-5)
    assert iso6358.fill_time(start, 1.0, b, gamma=1.4) == pytest.approx(share / 1.4, abs=1e-5)


def test_iso_fill_time_against_integration() -> None:
    """The chamber's own mass balance, integrated step by step, takes the same time."""
    volume, conductance, b, supply = 1e-4, 1e-8, 0.3, 701325.0
    r = iso6358.PRESSURE_ANR / (iso6358.DENSITY_ANR * iso6358.TEMPERATURE_ANR)

    def rate(_: float, p: np.ndarray) -> list[float]:
        flow = iso6358.mass_flow(conductance, b, supply, 293.15, float(p[0]))
        return [flow * r * 293.15 / volume]

    end = iso6358.fill_time(101325.0 / supply, 0.95, b) * iso6358.time_constant(volume, conductance)
    run = solve_ivp(rate, (0.0, end), [101325.0], rtol=1e-10, atol=1e-6)
    assert run.y[0, -1] / supply == pytest.approx(0.95, rel=1e-8)


def test_iso_discharge_table() -> None:
    for target, isothermal, adiabatic in ((3.5, 0.69504, 0.52194), (1.918, 1.29652, 1.01740)):
        ratio = target / 7.013
        assert iso6358.isothermal_discharge_time(ratio) == pytest.approx(isothermal, abs=3e-4)
        assert iso6358.adiabatic_discharge_time(ratio) == pytest.approx(adiabatic, abs=3e-4)
        there = iso6358.adiabatic_discharge_time(ratio)
        assert iso6358.adiabatic_discharge_pressure(there) == pytest.approx(ratio, rel=1e-12)
    cold = iso6358.adiabatic_discharge_temperature(3.5 / 7.01325, 293.15, 1.4)
    assert cold == pytest.approx(240.4, abs=0.06)


def test_adiabatic_fill_signature() -> None:
    assert iso6358.adiabatic_fill_temperature(0.0, 7.0, 293.15, 293.15) == pytest.approx(410.41)
    hot = iso6358.adiabatic_fill_temperature(1.01325, 7.01325, 293.15, 293.15)
    assert hot == pytest.approx(387.99, abs=6e-3)
    assert 7.01325 * 293.15 / hot == pytest.approx(5.299, abs=6e-4)


def test_orifice_and_ellipse_integrals() -> None:
    assert iso6358.isentropic_fill_integral() == pytest.approx(0.739595, abs=6e-7)
    assert (1.0 - 0.5282818) * np.pi / 2.0 == pytest.approx(0.740973, abs=1e-6)


# -- Modes ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("q", "roots"),
    [
        (0.1, (0.311053, 3.173097, 6.299059)),
        (0.5, (0.653271, 3.292310, 6.361620)),
        (1.0, (0.860334, 3.425618, 6.437298)),
        (2.0, (1.076874, 3.643597, 6.578334)),
        (5.0, (1.313838, 4.033568, 6.909596)),
        (10.0, (1.428870, 4.305801, 7.228110)),
        (100.0, (1.555245, 4.665765, 7.776374)),
    ],
)
def test_mode_table(q: float, roots: tuple[float, ...]) -> None:
    found = modes.tube_volume_roots(q, 3)
    np.testing.assert_allclose(found, roots, atol=6e-7)
    np.testing.assert_allclose(found * np.tan(found), q, rtol=1e-10)


def test_mode_limits() -> None:
    """A huge volume gives the Helmholtz resonator, none gives the closed tube."""
    helmholtz = modes.helmholtz_frequency(1e-5, 0.1, 1.0, 343.0)
    assert modes.tube_volume_frequencies(1e-5, 0.1, 1.0, 343.0, 1)[0] == pytest.approx(
        helmholtz, rel=1e-6
    )
    np.testing.assert_allclose(
        modes.tube_volume_frequencies(1e-5, 1.0, 1e-13, 343.0, 3),
        modes.closed_open_frequencies(1.0, 343.0, 3),
        rtol=1e-7,
    )
    np.testing.assert_allclose(
        modes.tube_volume_frequencies(1e-5, 1.0, 1e3, 343.0, 4)[1:],
        modes.closed_closed_frequencies(1.0, 343.0, 3),
        rtol=1e-7,
    )


# -- Wall friction ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("roughness", "reynolds", "colebrook", "haaland", "churchill"),
    [
        (0.0, 4e3, 0.03991, 0.04042, 0.04059),
        (0.0, 1e4, 0.03088, 0.03089, 0.03100),
        (0.0, 1e5, 0.01799, 0.01782, 0.01787),
        (0.0, 1e6, 0.01165, 0.01159, 0.01161),
        (1e-3, 4e3, 0.04091, 0.04122, 0.04173),
        (1e-3, 1e4, 0.03238, 0.03217, 0.03269),
        (1e-3, 1e5, 0.02217, 0.02197, 0.02234),
        (1e-3, 1e6, 0.01994, 0.01994, 0.02002),
        (1e-2, 1e4, 0.04313, 0.04304, 0.04404),
        (1e-2, 1e5, 0.03850, 0.03854, 0.03873),
    ],
)
def test_friction_factor_table(
    roughness: float, reynolds: float, colebrook: float, haaland: float, churchill: float
) -> None:
    assert pipe_flow.colebrook(reynolds, roughness) == pytest.approx(colebrook, abs=6e-6)
    assert pipe_flow.haaland(reynolds, roughness) == pytest.approx(haaland, abs=6e-6)
    assert pipe_flow.churchill(reynolds, roughness) == pytest.approx(churchill, abs=6e-6)


def test_laminar_and_blasius_factors() -> None:
    assert pipe_flow.laminar(1e3) == pytest.approx(0.064)
    assert pipe_flow.churchill(1e3, 0.0) == pytest.approx(0.064, abs=6e-6)
    assert pipe_flow.churchill(2e3, 0.0) == pytest.approx(0.03204, abs=6e-6)
    for reynolds, factor in ((4e3, 0.03979), (1e4, 0.03164), (1e5, 0.01779)):
        assert pipe_flow.blasius(reynolds) == pytest.approx(factor, abs=6e-6)


def test_poiseuille_gradient_is_the_laminar_factor() -> None:
    """The drop 128 mu Q / (pi D^4) and f = 64 / Re say the same thing."""
    diameter, viscosity, rho, speed = 4e-3, 1.82e-5, 1.2, 0.7
    flow = speed * np.pi * diameter**2 / 4.0
    reynolds = rho * speed * diameter / viscosity
    darcy = pipe_flow.laminar(reynolds) / diameter * 0.5 * rho * speed**2
    assert pipe_flow.poiseuille_gradient(flow, diameter, viscosity) == pytest.approx(darcy)


def test_zielke_weighting() -> None:
    np.testing.assert_allclose(
        pipe_flow.zielke_rates(6),
        (26.37462, 70.85000, 135.02071, 218.92019, 322.55512, 445.92756),
        atol=6e-6,
    )
    tau = np.array([1e-4, 1e-3, 1e-2, 3e-2, 0.1])
    table = (26.970, 7.7050, 1.68646, 0.59154, 0.07238)
    np.testing.assert_allclose(pipe_flow.zielke(tau), table, rtol=3e-5, atol=6e-6)
    short = np.geomspace(1e-5, 0.02, 30)
    np.testing.assert_allclose(
        pipe_flow.zielke_series(short), pipe_flow.zielke_sum(short), rtol=2e-4
    )


def test_zielke_shear_of_oscillating_flow() -> None:
    """Against the exact shear of Womersley flow, 4 rho nu V / R times its complex factor."""
    radius, nu, rho, omega = 2e-3, 1.5e-5, 1.2, 2.0 * np.pi * 20.0
    time = np.linspace(0.0, 1.0, 8001)
    shear = pipe_flow.zielke_wall_shear(time, np.sin(omega * time), radius, nu, rho)
    last = time > 0.95
    z = 1j**1.5 * radius * np.sqrt(omega / nu)
    ratio = bergh_tijdeman._bessel_2_over_0(np.array([z]))[0]
    # Mean velocity V = -(J2/J0) G / (i omega rho) and wall shear = R/2 (G - i omega rho V).
    factor = radius / 2.0 * 1j * omega * rho * (-1.0 / ratio - 1.0)
    exact = np.imag(factor * np.exp(1j * omega * time[last]))
    np.testing.assert_allclose(shear[last], exact, atol=0.01 * abs(factor))


# -- Pistons ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ms", "x", "u", "p"),
    [
        (10, 0.547039, 102.66139, 0.673636),
        (20, 1.955868, 175.53053, 0.501747),
        (30, 4.001974, 231.49993, 0.396665),
        (40, 6.550091, 276.65284, 0.326224),
    ],
)
def test_free_piston_table(ms: float, x: float, u: float, p: float) -> None:
    state = piston.free_piston(ms * 1e-3, 1e5, 1.0, np.pi * 0.04, 1.0)
    assert state.position == pytest.approx(x, abs=6e-7)
    assert state.velocity == pytest.approx(u, abs=6e-6)
    assert state.pressure / 1e5 == pytest.approx(p, abs=6e-7)


def test_free_piston_obeys_newton() -> None:
    area, mass, step = np.pi * 0.04, 1.0, 1e-5
    before, now, after = (
        piston.free_piston(0.02 + k * step, 1e5, 1.0, area, mass) for k in (-1, 0, 1)
    )
    assert (after.velocity - before.velocity) / (2 * step) == pytest.approx(
        now.pressure * area / mass, rel=1e-6
    )
    assert (after.position - before.position) / (2 * step) == pytest.approx(now.velocity, rel=1e-6)


def test_impulsive_piston_limits() -> None:
    assert piston.withdrawal_pressure_ratio(5.0) == pytest.approx(0.0, abs=1e-30)
    assert piston.withdrawal_pressure_ratio(6.0) == 0.0
    small = 1e-6  # both meet the acoustic limit p/p0 = 1 +- gamma M
    assert piston.advance_pressure_ratio(small) - 1.0 == pytest.approx(1.4 * small, rel=1e-5)
    assert 1.0 - piston.withdrawal_pressure_ratio(small) == pytest.approx(1.4 * small, rel=1e-5)
    # A shock that brings the gas to 83.34335 m/s (2 bar into 1 atm, 293.15 K shock tube).
    mach = 83.34335 / np.sqrt(1.4 * 287.05 * 293.15)
    assert piston.advance_pressure_ratio(mach) == pytest.approx(141152.148 / 101325.0, rel=1e-7)


@pytest.mark.parametrize(
    ("bore", "stroke", "bar", "mass", "adiabatic", "isothermal"),
    [
        (25e-3, 100e-3, 4.0, 1.0, 16.689, 14.105),
        (16e-3, 50e-3, 5.0, 0.3, 30.833, 26.059),
        (10e-3, 50e-3, 4.0, 0.1, 29.854, 25.231),
    ],
)
def test_gas_spring_table(
    bore: float, stroke: float, bar: float, mass: float, adiabatic: float, isothermal: float
) -> None:
    area = np.pi * bore**2 / 4.0
    chamber = (bar * 1e5, area * stroke / 2.0)
    for n, expected in ((1.4, adiabatic), (1.0, isothermal)):
        found = piston.gas_spring_frequency(area, *chamber, *chamber, mass, n)
        assert found == pytest.approx(expected, abs=6e-4)


# -- Which module is compared with what -----------------------------------------------------------

ROOT = Path(__file__).parents[1]
PACKAGES = ("pneu_sim", "pneu_sysid", "pneu_policy", "pneu_hw_bridge")
LISTS = ("Compared", "None yet", "Neither physics nor estimates")


def listed() -> dict[str, list[tuple[list[str], str]]]:
    """By list its rows: patterns of modules, and the rest of the row."""
    text = (ROOT / "tests/references/README.md").read_text(encoding="utf-8")
    found: dict[str, list[tuple[list[str], str]]] = {}
    for part in text.split("\n## ")[1:]:
        title, _, body = part.partition("\n")
        rows = found.setdefault(title, [])
        for line in body.splitlines():
            first, _, rest = line.strip("|- ").partition(" | ")
            patterns = re.findall(r"`(pneu_[^`]+)`", first)
            if patterns:
                rows.append((patterns, rest))
    return found


def modules() -> list[str]:
    """All modules of the packages that compute, such as ``pneu_sim/kernel/bodies``."""
    return [
        str(path.relative_to(ROOT / "src" / package).with_suffix(""))
        for package in PACKAGES
        for path in sorted((ROOT / "src" / package / package).rglob("*.py"))
        if path.stem not in ("__init__", "__main__")
    ]


def matching(module: str, rows: list[tuple[list[str], str]]) -> list[str]:
    """Patterns that match a module; an exact name is preferred to one with an asterisk."""
    patterns = [p for row, _ in rows for p in row if fnmatchcase(module, p)]
    return [p for p in patterns if p == module] or patterns


def test_every_module_is_listed_once_as_compared_or_not() -> None:
    """Lists contradict each other unless one names a module and the other has it by a pattern."""
    lists, everything = listed(), modules()
    assert tuple(lists) == LISTS and len(everything) > 400
    wrong = []
    for module in everything:
        of = {title: matching(module, rows) for title, rows in lists.items()}
        named = [title for title, patterns in of.items() if module in patterns]
        places = named or [title for title, patterns in of.items() if patterns]
        if len(named) > 1 or not places:
            wrong.append((module, places))
        elif not named and len(places) > 1:
            # the effects that are compared are also among all effects
            assert places == ["Compared", "None yet"], module
    assert not wrong
    for rows in lists.values():
        for patterns, _ in rows:
            for pattern in patterns:
                assert any(fnmatchcase(module, pattern) for module in everything), pattern


def test_every_reference_has_its_test() -> None:
    known: dict[str, set[str]] = {}
    for _, rest in listed()["Compared"]:
        reference, _, test = rest.partition(" | ")
        path, _, name = test.strip(" `|").partition("::")
        if path not in known:
            tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
            known[path] = {one.name for one in tree.body if isinstance(one, ast.FunctionDef)}
        assert name in known[path], test
        assert reference.strip(), test
