# SPDX-License-Identifier: Apache-2.0
"""Thin-plate models whose cylinders move: their law, their volumes, short lines of full models."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from pneu_common.errors import InputError
from pneu_sim.kernel.orifices import ANR_DENSITY, ANR_TEMPERATURE, iso6358_flow
from pneu_sim.lumped.moving import critical_ratio, without_lines
from pneu_sim.plant import Plant
from pneu_sim.rig.load import load_rig
from pneu_sim.rig.schema import Rig

RIGS = Path(__file__).parents[3] / "rigs"
GAMMA, R = 1.4, 287.05
T0 = 293.15


def rail(length_m: float = 1.0, area_m2: float = 6e-6, **changes: Any) -> Rig:
    """A mass that one side of a cylinder lifts against the room, through a line."""
    data: dict[str, Any] = {
        "name": "rail",
        "model": "thin_plate",
        "ambient": {"pressure_pa": 101e3, "temperature_k": T0},
        "reservoirs": {"supply": {"pressure_pa": 6e5}, "room": {"pressure_pa": 101e3}},
        "pipes": {
            "line": {"from": "valve", "to": "head", "length_m": length_m, "area_m2": area_m2}
        },
        "cylinders": {
            "cart": {
                "bore_m": 0.02,
                "stroke_m": 0.3,
                "head": {"node": "head", "dead_volume_m3": 5e-6},
                "friction": {"viscous_n_s_m": 40.0},
            }
        },
        "bodies": {
            "cart": {
                "kind": "rail",
                "cylinder": "cart",
                "mass_kg": 3.0,
                "incline_rad": math.pi / 2,
                "slide": {"start": 0.1},
            }
        },
        "orifices": {
            "inlet": {
                "from": "supply",
                "to": "valve",
                "conductance_m3_s_pa": 2e-10,
                "critical_ratio": 0.5,
            },
        },
        "taps": {"head": {"pipe": "line", "position_m": 0.9 * length_m}},
    }
    return Rig.model_validate({**data, **changes})


def psi(x: float) -> float:
    """Thesis eq. 3.16's root, of the pressure ratio; choked below the critical one."""
    x = max(x, (2 / (GAMMA + 1)) ** (GAMMA / (GAMMA - 1)))
    return math.sqrt(x ** (2 / GAMMA) - x ** ((GAMMA + 1) / GAMMA))


def test_the_law_of_its_ports_is_the_thin_plates() -> None:
    b = critical_ratio(load_gas())
    assert b == pytest.approx(0.528282, abs=1e-6)
    choked = 1e-8 * ANR_DENSITY * 6e5 * math.sqrt(ANR_TEMPERATURE / T0)
    for x in np.linspace(0.0, 0.999, 400):
        flow = iso6358_flow(6e5, 0.0, T0, x * 6e5, 0.0, T0, 1e-8, b)
        assert abs(flow / choked - psi(x) / psi(0.0)) < 0.004


def load_gas() -> Any:
    """The gas of all rigs here."""
    from pneu_sim.gas import AIR

    return AIR


def test_a_lifted_mass_moves_as_the_equations_of_a_thin_plate_say() -> None:
    """By an integrator of its own: gas of a vessel (adiabatic), piston and mass, one orifice."""
    rig = rail()
    plant = Plant([rig])
    plant.reset({"head": 1.9e5})
    series, _ = plant.advance(np.full((1, 0, 400), 5.0), 1e-3)
    area, mass = math.pi / 4 * 0.02**2, 3.0
    held, cp = 5e-6 + 1.0 * 6e-6, GAMMA * R / (GAMMA - 1)
    reduced = without_lines(rig)
    c = reduced.orifices["inlet"].conductance_m3_s_pa
    b = reduced.orifices["inlet"].critical_ratio

    def slopes(_t: float, y: NDArray[np.float64]) -> list[float]:
        _, u, x, v = y  # mass and inner energy of the gas, extension, speed
        p = (GAMMA - 1) * u / (held + area * x)
        ratio = p / 6e5
        factor = 1.0 if ratio <= b else math.sqrt(max(1 - ((ratio - b) / (1 - b)) ** 2, 0.0))
        flow = c * ANR_DENSITY * 6e5 * math.sqrt(ANR_TEMPERATURE / T0) * factor
        force = (p - 101e3) * area - 40.0 * v - mass * 9.80665
        return [flow, flow * cp * T0 - p * area * v, v, force / mass]

    p0, volume = 1.9e5, held + area * 0.1
    start = [p0 * volume / (R * T0), p0 * volume / (GAMMA - 1), 0.1, 0.0]
    at = np.linspace(0.0, 0.4, 401)
    true = solve_ivp(slopes, (0.0, 0.4), start, t_eval=at, rtol=1e-9, atol=1e-12)
    pressure = (GAMMA - 1) * true.y[1] / (held + area * true.y[2])
    assert np.ptp(true.y[2]) > 0.01  # it does move
    assert np.abs(series.joints[:, 0, 0, 0] - true.y[2]).max() < 0.01 * np.ptp(true.y[2])
    assert np.abs(series.taps[:, 0, 0] - pressure).max() < 0.01 * np.ptp(pressure)


def test_the_full_model_comes_to_it_as_lines_get_short() -> None:
    """With the volume of the line kept, what differs shrinks with the line's length."""
    apart = []
    for length in (4.0, 0.4):
        full = rail(length, 6e-6 / length, model="pde")
        ends = []
        for rig in (full, full.model_copy(update={"model": "thin_plate"})):
            plant = Plant([rig], length / 8)
            plant.reset({"line": 1.9e5, "head": 1.9e5})
            series, _ = plant.advance(np.full((1, 0, 200), 5.0), 2e-3)
            ends.append(series.joints[:, 0, 0, 0])
        apart.append(np.sqrt(np.mean((ends[0] - ends[1]) ** 2)))
    assert apart[1] < 0.35 * apart[0]


@pytest.mark.parametrize("name", ["kokoro", "cart_pole", "arm", "dog"])
def test_the_robots_move_without_their_lines(name: str) -> None:
    rig = load_rig(RIGS / f"{name}.yaml")
    plate = rig.model_copy(update={"model": "thin_plate"})
    plant = Plant([plate, plate])
    plant.reset(dict.fromkeys(plant.plan.chambers, 3e5))
    volts = np.full((2, len(rig.valves), 50), 5.0)
    volts[1, 0] = 7.0
    series, readings = plant.advance(volts, 2e-3)
    assert np.isfinite(series.joints).all()
    assert np.isfinite(readings).all()
    moved = np.abs(series.joints[-1, :, 0, 0] - series.joints[-1, :, 0, 1]).max()
    assert moved > 1e-3  # by its valve
    whole = sum(p.length_m * p.area_m2 for p in rig.pipes.values())
    reduced = without_lines(plate)
    dead = sum(s.dead_volume_m3 for c in reduced.cylinders.values() for s in c.sides.values())
    own = sum(s.dead_volume_m3 for c in rig.cylinders.values() for s in c.sides.values())
    assert dead - own == pytest.approx(whole, rel=1e-9)


def test_the_discharge_scales_every_port() -> None:
    rig = load_rig(RIGS / "kokoro.yaml").model_copy(update={"model": "thin_plate"})
    data = rig.dump()
    half = Rig.model_validate({**data, "lumped": {"discharge": 0.5}})
    for name, valve in without_lines(rig).valves.items():
        for key, port in valve.ports.items():
            small = without_lines(half).valves[name].ports[key]
            assert small.conductance_m3_s_pa == pytest.approx(0.5 * port.conductance_m3_s_pa)


def test_there_is_no_gas_along_lines() -> None:
    plant = Plant([rail()])
    with pytest.raises(InputError, match="line 'line': the rig's model knows no gas"):
        plant.gas_in("line")
    with pytest.raises(InputError, match="line 'line': the rig's model knows no gas"):
        plant.set_gas("line", 1.2, 0.0, 1e5)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"pipes": {"line": {"from": "valve", "to": "closed", "length_m": 1, "area_m2": 6e-6}}},
            "pipes.line: found no vessel at its ends",
        ),
        (
            {
                "pipes": {
                    "line": {"from": "valve", "to": "head", "length_m": 1, "area_m2": 6e-6},
                    "drain": {"from": "room", "to": "head", "length_m": 1, "area_m2": 6e-6},
                }
            },
            "pipes.line: found room and head at its ends",
        ),
        (
            {
                "pipes": {
                    "line": {"from": "valve", "to": "head", "length_m": 1, "area_m2": 6e-6},
                    "feed": {"from": "supply", "to": "closed", "length_m": 1, "area_m2": 6e-6},
                },
                "taps": {"feed": {"pipe": "feed", "position_m": 0.5}},
            },
            "taps.feed: found line 'feed', which is open to reservoir 'supply'",
        ),
    ],
)
def test_what_cannot_be_reduced_is_said(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Plant([rail(**changes)])


def test_cells_have_no_counterpart() -> None:
    rig = rail()
    cart = rig.cylinders["cart"].model_copy(update={"gas": "cells"})
    with pytest.raises(InputError, match=r"cylinders\.cart\.gas: found cells"):
        without_lines(rig.model_copy(update={"cylinders": {"cart": cart}}))
