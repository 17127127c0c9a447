# SPDX-License-Identifier: Apache-2.0
"""Gas that is faster than the grid was laid out for: more steps for it, and for it alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim import layout as L
from pneu_sim.rig.build import build
from pneu_sim.rig.model import Model
from pneu_sim.rig.plan import plan_grid
from pneu_sim.rig.schema import Chamber, Rig, Ripple
from pneu_sim.simulate import Prediction, RunOptions, even_course, initial_field, predict
from pneu_sim.simulator import Simulator

Floats = NDArray[np.float64]

VOLTS = np.repeat([0.0, 10.0, 2.0, 8.0], 15)


def rig(wave_speed_m_s: float, room_k: float = 293.15, **supply: Any) -> Rig:
    """A port that is opened to a closed tube."""
    return Rig.model_validate(
        {
            "name": "rig",
            "grid": {"dx_m": 0.02, "wave_speed_m_s": wave_speed_m_s},
            "ambient": {"temperature_k": room_k},
            "reservoirs": {"supply": {"pressure_pa": 8e5, **supply}},
            "pipes": {
                "feed": {"from": "supply", "to": "in", "length_m": 0.3, "area_m2": 2e-5},
                "tube": {"from": "out", "to": "closed", "length_m": 0.6, "area_m2": 1e-5},
            },
            "valves": {
                "valve": {
                    "command": "volts",
                    "spool": {"null_v": 0.0},
                    "ports": {
                        "port": {
                            "from": "in",
                            "to": "out",
                            "conductance_m3_s_pa": 2e-8,
                            "opening": {"voltage_v": [0.0, 10.0], "fraction": [0.0, 1.0]},
                        }
                    },
                }
            },
            "commands": {"volts": {}},
            "taps": {"end": {"pipe": "tube", "position_m": 0.55, "lag_s": 0.001}},
        }
    )


def predicted(models: list[Model], strict: bool = True, flows: bool = False) -> Prediction:
    first = rig(600.0)
    field = initial_field(first, models[0].plan)
    start = np.full((VOLTS.size, 1), 101325.0)
    course = even_course(field, {"volts": VOLTS}, 1e-3, start)
    return predict([models], [course], field, None, RunOptions(1, None, strict, flows))[0]


PROPER = {100.0: 425.0, 250.0: 500.0}
"""Wave speeds that make the grid take the number of steps that these need in the end."""


def close(found: Floats, fine: Floats) -> bool:
    """Whether two runs differ no more than grids of other steps do where fronts pass."""
    return bool(np.sqrt(np.mean((found - fine) ** 2)) < 5e-3 * np.ptp(fine))


@pytest.mark.parametrize(("speed", "proper"), PROPER.items())
def test_a_simulator_takes_as_many_steps_as_its_gas_needs(speed: float, proper: float) -> None:
    want, fine, found = (
        Simulator(rig(s)).run(0.06, {"volts": VOLTS}).pressures["end"]
        for s in (proper, 900.0, speed)
    )
    assert np.ptp(want) > 4e5
    assert found == pytest.approx(want, rel=1e-6)
    assert close(found, fine)
    pieces = [Simulator(rig(s)) for s in (900.0, speed)]
    told = [
        [simulator.run(1e-3, {"volts": v}).pressures["end"][-1] for v in VOLTS]
        for simulator in pieces
    ]
    assert close(np.array(told[1]), np.array(told[0]))


@pytest.mark.parametrize(("speed", "proper"), PROPER.items())
def test_a_prediction_takes_as_many_steps_as_its_gas_needs(speed: float, proper: float) -> None:
    want, fine, found = (predicted([build(rig(s))], flows=True) for s in (proper, 900.0, speed))
    assert np.ptp(want.readings) > 4e5
    for kind in ("readings", "flows", "taps"):
        assert np.array_equal(getattr(found, kind), getattr(want, kind))
        assert close(getattr(found, kind), getattr(fine, kind))


def test_lanes_that_need_no_more_steps_keep_theirs() -> None:
    """One rig of a batch stands in an oven: sound is too fast there for the common step."""
    rooms = [rig(420.0), rig(420.0), rig(420.0)]
    oven = [rig(420.0), rig(420.0, room_k=1000.0), rig(420.0)]
    plan = plan_grid(rooms[0])
    plain, mixed = (predicted([build(r, plan) for r in rigs], flows=True) for rigs in (rooms, oven))
    for kind in ("readings", "flows", "taps"):
        for lane in (0, 2):
            assert np.array_equal(getattr(plain, kind)[lane], getattr(mixed, kind)[lane])
    alone = predicted([build(rig(840.0, room_k=1000.0))])  # takes twice the steps
    assert mixed.readings[1] == pytest.approx(alone.readings[0], rel=1e-6)
    runs = [Simulator(rigs).run(0.06, {"volts": VOLTS}) for rigs in (rooms, oven)]
    plain_pa, mixed_pa = (r.pressures["end"] for r in runs)
    assert np.array_equal(plain_pa[:, [0, 2]], mixed_pa[:, [0, 2]])
    proper = Simulator(rig(850.0, room_k=1000.0)).run(0.06, {"volts": VOLTS})
    assert mixed_pa[:, 1] == pytest.approx(proper.pressures["end"], rel=1e-6)


def test_what_no_step_helps_is_told_in_one_sentence() -> None:
    models = [build(rig(600.0)), build(rig(600.0))]
    models[1].cell[L.VISCOUS] = np.nan
    with pytest.raises(InputError) as caught:
        predicted(models)
    text = str(caught.value)
    assert "unstable at a time step of 2.99e-05 s" in text and "8 times as many" in text
    assert "\n" not in text
    out = predicted(models, strict=False)
    assert np.isfinite(out.readings[0]).all() and not np.isfinite(out.readings[1, :, 1:]).any()
    simulator = Simulator(rig(600.0))
    simulator.plant.solver.tiles[0][0].cell[L.VISCOUS] = np.nan
    with pytest.raises(InputError, match="8 times as many steps; "):
        simulator.run(0.01, {"volts": 5.0})


def test_a_ripple_keeps_its_time_whatever_steps_are_taken() -> None:
    found, want = (rig(speed) for speed in (250.0, PROPER[250.0]))
    for one in (found, want):
        name = next(iter(one.reservoirs))
        one.reservoirs[name].ripples = [Ripple(amplitude_pa=5e4, frequency_hz=40.0)]
    runs = [Simulator(one).run(0.06, {"volts": VOLTS}).pressures["end"] for one in (found, want)]
    assert runs[0] == pytest.approx(runs[1], rel=1e-6)
    plain = Simulator(rig(250.0)).run(0.06, {"volts": VOLTS}).pressures["end"]
    assert np.abs(runs[0] - plain).max() > 1e4


def test_a_regulator_sags_by_its_droop_and_comes_back() -> None:
    """With the one reservoir of this rig, whose present pressure is not the one it goes back to."""
    drawing = rig(600.0, droop_pa_s_per_kg=1e7, droop_tau_s=0.002)
    drawing.chambers["hall"] = Chamber(volume_m3=1.0)
    drawing.pipes["tube"].to_node = "hall"
    simulator = Simulator(drawing)
    for volts in (3.0, 6.0):
        drawn = simulator.run(0.3, {"volts": volts}).flows["valve.port"][-1]
        gas = simulator.state("feed")
        sagged = (gas["pressure"] + 0.5 * gas["density"] * gas["velocity"] ** 2)[0]
        assert 8e5 - sagged == pytest.approx(1e7 * drawn, rel=0.02)
        assert 8e5 - sagged > 1e4
    simulator.run(0.3, {"volts": 0.0})
    assert simulator.state("feed")["pressure"] == pytest.approx(8e5, rel=2e-3)


@pytest.mark.parametrize("head", [1.0, 2.0])
def test_a_port_wider_than_its_tube_chokes_the_tube(head: float) -> None:
    """What passes from a vessel through a frictionless tube is what a nozzle of its bore passes."""
    area, pressure, temperature = 5e-6, 6e5, 293.15
    still = {
        "laminar": 0.0,
        "turbulent": 0.0,
        "unsteady": 0.0,
        "nusselt": 0.0,
        "heat_turbulent": 0.0,
        "heat_unsteady": 0.0,
    }
    port = {
        "from": "out",
        "to": "room",
        "conductance_m3_s_pa": 5e-8,  # five times what the bore lets pass
        "jet_loss": 2.0,
        "inlet_head": head,
        "opening": {"voltage_v": [5.0, 10.0], "fraction": [0.0, 1.0]},
    }
    rig = Rig.model_validate(
        {
            "name": "wide",
            "reservoirs": {"tank": {"pressure_pa": pressure}, "room": {"pressure_pa": 101325.0}},
            "pipes": {
                "tube": {
                    "from": "tank",
                    "to": "out",
                    "length_m": 0.5,
                    "area_m2": area,
                    "wall": still,
                }
            },
            "valves": {"valve": {"command": "volts", "ports": {"port": port}}},
            "commands": {"volts": {}},
            "taps": {"middle": {"pipe": "tube", "position_m": 0.25}},
        }
    )
    out = Simulator(rig).run(0.3, {"volts": 10.0})
    gamma, gas = 1.4, 287.05
    choked = area * pressure * np.sqrt(gamma / (gas * temperature))
    choked *= (2.0 / (gamma + 1.0)) ** ((gamma + 1.0) / (2.0 * (gamma - 1.0)))
    np.testing.assert_allclose(out.flows["valve.port"][-50:], choked, rtol=0.02)
