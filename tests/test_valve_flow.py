# SPDX-License-Identifier: Apache-2.0
"""Thesis 6.3: where thin plate and Riemann problem differ, and what the plate cannot fit."""

import functools
import math

import numpy as np
import pytest
from examples.valve_flow import Filling, fill, riemann_flux, thin_plate_flux

from pneu_sim.gas import AIR

SUPPLY_PA, ROOM_K = 6.35e5, 293.15


@functools.cache
def filled(area_m2: float) -> Filling:
    """The cylinder filled through an opening, once for all tests."""
    return fill(area_m2)


def ratio_of(x: list[float]) -> np.ndarray:
    """Thin plate's flow over the Riemann problem's."""
    return thin_plate_flux(x, SUPPLY_PA, ROOM_K) / riemann_flux(x, SUPPLY_PA, ROOM_K)


def test_flows_are_those_of_textbooks() -> None:
    choked = AIR.orifice_mass_flow(1.0, SUPPLY_PA, ROOM_K, 0.3 * SUPPLY_PA)
    assert thin_plate_flux(0.3, SUPPLY_PA, ROOM_K)[0] == pytest.approx(float(choked), rel=1e-9)
    sonic = 3.0 / 3.6  # Mach number 1 at the end of a rarefaction from rest: c / c0 = 2 / (g + 1)
    density, speed = SUPPLY_PA / (AIR.r_specific * ROOM_K), float(AIR.sound_speed(ROOM_K))
    expected = density * sonic**5 * sonic * speed
    assert riemann_flux(0.02, SUPPLY_PA, ROOM_K)[0] == pytest.approx(expected, rel=1e-9)


def test_both_choked_the_ratio_is_constant() -> None:
    """A nozzle is choked from its total pressure, a rarefaction at the sonic speed behind it."""
    assert ratio_of([0.005, 0.02, 0.05]) == pytest.approx(np.full(3, 1.2**3), rel=1e-9)


def test_where_pressures_meet_the_models_diverge() -> None:
    """The plate's flow goes with the root of the pressure drop, a wave's with the drop."""
    near = np.array([0.9, 0.99, 0.999, 0.9999])
    found = ratio_of(near.tolist())
    assert found[-1] > 300.0
    assert found[1:] == pytest.approx(np.sqrt(8.0 * AIR.gamma / (1.0 - near[1:])), rel=0.01)
    whole = ratio_of(np.linspace(0.15, 0.999, 200).tolist())
    assert np.all(np.diff(whole) > 0.0)


def test_choking_ends_where_theory_says() -> None:
    critical = AIR.critical_pressure_ratio
    thin = thin_plate_flux([0.1, critical - 1e-3, critical + 0.05], SUPPLY_PA, ROOM_K)
    assert thin[1] == thin[0]
    assert thin[2] < thin[0]
    # Behind the opening a shock runs into the gas at rest: choked until it is as fast as the
    # sonic rarefaction, u = 2 c / (g + 1) at p = (2 / (g + 1))^(2 g / (g - 1)) p0.
    behind, speed = (2.0 / 2.4) ** 7, 2.0 / 2.4

    def shock_speed(x: float) -> float:
        return (behind - x) * math.sqrt(2.0 / (1.4 * x * (2.4 * behind + 0.4 * x)))

    low, high = 0.01, behind
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if shock_speed(middle) > speed else (low, middle)
    flows = riemann_flux([0.5 * low, 0.99 * low, 1.05 * low], SUPPLY_PA, ROOM_K)
    assert flows[1] == pytest.approx(flows[0], rel=1e-9)
    assert flows[2] < (1.0 - 1e-4) * flows[0]


@pytest.mark.long
def test_a_plate_fitted_to_one_part_misses_the_other() -> None:
    filling = filled(1e-6)
    early, late = filling.fit("thin_plate", "early"), filling.fit("thin_plate", "late")
    rise = filling.true_pa[-1] - filling.true_pa[0]
    assert early.early_pa < 0.02 * rise
    assert early.late_pa > 5.0 * early.early_pa
    assert late.early_pa > 2.0 * late.late_pa
    assert late.early_pa > 0.1 * rise
    # Fitted to the early part it fills too fast later on, as the ratio of the flows has it.
    assert early.factor > 1.5 * late.factor
    half = filling.true_pa > filling.true_pa[0] + 0.8 * rise
    assert np.mean((early.pressure_pa - filling.true_pa)[half]) > 1e4
    for part in ("early", "late"):
        full = filling.fit("pde", part)
        assert full.factor == pytest.approx(1.0, abs=0.02)
        assert max(full.early_pa, full.late_pa) < 0.002 * rise


@pytest.mark.long
def test_where_the_line_decides_the_plate_does_better() -> None:
    """An opening two thirds as wide as the line: its factor takes up the line's friction."""
    narrow, wide = filled(1e-6), filled(4e-6)
    for part, missed in (("early", "late_pa"), ("late", "early_pa")):
        of = [getattr(f.fit("thin_plate", part), missed) for f in (narrow, wide)]
        assert of[1] < 0.5 * of[0]
