# SPDX-License-Identifier: Apache-2.0
"""The lumped models are fitted by the same code as the full one, and come closer by it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pneu_sim.rig.schema import Rig
from pneu_sim.run import add_noise, run_rig
from pneu_sysid.fit import fit_rig, sensor_rmse
from pneu_sysid.parameters import default_parameters
from pneu_sysid.problem import make_problem
from pneu_sysid.records import Recording, even_recording

RATE = 250.0


def rig_with(**changes: Any) -> Rig:
    fill = {
        "from": "supply",
        "to": "out",
        "conductance_m3_s_pa": 0.5e-8,
        "opening": {"voltage_v": [5.0, 6.0, 7.5, 10.0], "fraction": [0.0, 0.2, 0.5, 1.0]},
    }
    empty = {**fill, "from": "out", "to": "room", "opening": {"mirror": "fill"}}
    data: dict[str, Any] = {
        "name": "short",
        "grid": {"dx_m": 0.1},
        "reservoirs": {"supply": {"pressure_pa": 6e5}, "room": {"pressure_pa": 101325.0}},
        "pipes": {"tube": {"from": "out", "to": "closed", "length_m": 1.5, "area_m2": 6e-6}},
        "valves": {
            "valve": {
                "command": "volts",
                "spool": {"bandwidth_hz": 60.0},
                "ports": {"fill": fill, "empty": empty},
            }
        },
        "commands": {"volts": {}},
        "taps": {"end": {"pipe": "tube", "position_m": 1.5}},
        "fit": {"horizon_s": 0.3, "warm_up_s": 0.1},
    }
    return Rig.model_validate({**data, **changes})


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Two seconds of the full model, with noise, under random voltage steps."""
    rng = np.random.default_rng(11)
    volts = np.repeat(rng.uniform(2.0, 8.0, 40), 13)[:501]
    rig = rig_with()
    taps = add_noise(rig, run_rig(rig, {"volts": volts}, 1.0 / RATE), rng, noise_pa=250.0)
    return even_recording("synthetic", np.arange(501) / RATE, {"volts": volts}, taps)


@pytest.mark.long
@pytest.mark.parametrize("model", ["thin_plate", "delay_line"])
def test_fit_of_a_lumped_model_reduces_its_error(recording: Recording, model: str) -> None:
    rig = rig_with(model=model)
    problem = make_problem(rig, recording)
    held_out = problem.held_out
    assert held_out.any()
    before = sensor_rmse(problem, problem.predict([rig])[0], held_out)["end"]
    outcome = fit_rig(rig, recording, hold_out=True)
    assert outcome.held_out_rmse["end"] < 0.6 * before
    assert outcome.rig.model == model


def test_lumped_models_estimate_the_openings_and_the_spool() -> None:
    paths = {p.path for p in default_parameters(rig_with(model="thin_plate"))}
    assert paths == {
        "valves.valve.spool.bandwidth_hz",
        "valves.valve.spool.damping",
        "valves.valve.ports.fill.conductance_m3_s_pa",
        "valves.valve.ports.fill.opening.fraction.1",
        "valves.valve.ports.fill.opening.fraction.2",
        "valves.valve.ports.empty.conductance_m3_s_pa",
    }
