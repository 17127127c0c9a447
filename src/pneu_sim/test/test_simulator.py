# SPDX-License-Identifier: Apache-2.0
"""The steppable simulator: what it keeps between calls, batches, and its refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_sim.rig.schema import Rig
from pneu_sim.simulator import Simulator

OPENING = {"voltage_v": [5.0, 10.0], "fraction": [0.0, 1.0]}


def valve_rig(**changes: Any) -> Rig:
    data: dict[str, Any] = {
        "name": "valve_rig",
        "grid": {"dx_m": 0.02},
        "reservoirs": {"supply": {"pressure_pa": 6e5}},
        "pipes": {
            "feed": {"from": "supply", "to": "in", "length_m": 0.4, "area_m2": 2e-5},
            "tube": {"from": "out", "to": "volume", "length_m": 0.6, "area_m2": 6e-6},
        },
        "chambers": {"volume": {"volume_m3": 2e-6, "heat_w_per_k": 0.01}},
        "valves": {
            "valve": {
                "command": "volts",
                "spool": {
                    "bandwidth_hz": 60.0,
                    "delay_s": 0.0035,
                    "hysteresis_v": 0.2,
                    "max_acceleration_v_s2": 2e5,
                    "integral": 5.0,
                },
                "ports": {
                    "port": {
                        "from": "in",
                        "to": "out",
                        "conductance_m3_s_pa": 0.5e-8,
                        "opening": OPENING,
                    }
                },
            }
        },
        "commands": {"volts": {}},
        "taps": {
            "start": {"pipe": "tube", "position_m": 0.05, "lag_s": 0.004, "gain": 1.01},
            "end": {"chamber": "volume", "offset_s": 0.0025},
        },
    }
    return Rig.model_validate({**data, **changes})


VOLTS = 5.0 + 4.0 * np.abs(np.sin(np.arange(60) * 0.31)) * (np.arange(60) % 13 < 7)


def test_rest_stays_at_rest() -> None:
    simulator = Simulator(valve_rig())
    record = simulator.run(0.05, {"volts": 0.0})
    assert np.ptp(record.pressures["start"]) < 1e-8
    assert record.pressures["end"][-1] == pytest.approx(101325.0, rel=1e-12)
    assert simulator.state("feed")["pressure"] == pytest.approx(6e5, rel=1e-12)
    assert np.abs(simulator.state("feed")["velocity"]).max() < 1e-9
    assert simulator.time_s == pytest.approx(0.05)


def test_a_run_in_pieces_is_the_whole_run() -> None:
    whole = Simulator(valve_rig()).run(0.06, {"volts": VOLTS})
    pieces = Simulator(valve_rig())
    records = []
    for a, b in ((0, 1), (1, 9), (9, 10), (10, 37), (37, 60)):
        records.append(pieces.run((b - a) * 1e-3, {"volts": VOLTS[a:b]}))
    for kind in ("taps", "pressures"):
        for name in ("start", "end"):
            joined = np.concatenate(
                [getattr(records[0], kind)[name][:1]]
                + [getattr(r, kind)[name][1:] for r in records]
            )
            expected = getattr(whole, kind)[name]
            assert np.ptp(expected) > 1e5
            assert np.abs(joined - expected).max() < 1e-4 * np.ptp(expected)
    assert records[-1].time_s[-1] == pytest.approx(0.06)


def test_batch_agrees_with_single_rigs() -> None:
    sizes = (1e-6, 2e-6, 5e-6)
    rigs = [valve_rig(chambers={"volume": {"volume_m3": v}}) for v in sizes]
    batch = Simulator(rigs)
    batch.reset({"tube": [1.5e5, 2e5, 3e5]})
    together = batch.run(0.04, {"volts": VOLTS[:40]})
    assert np.shape(batch.mass_kg()) == (3,)
    assert batch.state("tube")["pressure"].shape == (30, 3)
    for k, (rig, start) in enumerate(zip(rigs, (1.5e5, 2e5, 3e5), strict=True)):
        alone = Simulator(rig)
        alone.reset({"tube": start})
        record = alone.run(0.04, {"volts": VOLTS[:40]})
        assert together.pressures["end"][:, k] == pytest.approx(record.pressures["end"], rel=1e-9)
        assert together.flows["valve.port"][:, k] == pytest.approx(
            record.flows["valve.port"], rel=1e-9, abs=1e-12
        )


def test_mass_follows_the_port() -> None:
    simulator = Simulator(valve_rig())
    feed = simulator.state("feed")
    before = float(simulator.mass_kg())
    assert feed["density"] == pytest.approx(6e5 / (287.05 * 293.15))
    simulator.run(0.3, {"volts": 10.0})
    after = float(simulator.mass_kg())
    gain = (6e5 - 101325.0) * (0.6 * 6e-6 + 2e-6) / (287.05 * 293.15)
    # full, and warmer than the room: less than isothermal, more than without any heat to the walls
    assert gain / 1.4 < after - before < 0.98 * gain
    assert simulator.energy_j() > 0.0


def test_state_can_be_set() -> None:
    simulator = Simulator(valve_rig())
    simulator.set_state("tube", 2.0, np.linspace(0.0, 9.0, 30), 1.7e5)
    simulator.set_chamber("volume", 1.7e5, 300.0)
    state = simulator.state("tube")
    assert state["x_m"][[0, -1]] == pytest.approx([0.01, 0.59])
    assert state["density"] == pytest.approx(np.full(30, 2.0))
    assert state["velocity"] == pytest.approx(np.linspace(0.0, 9.0, 30))
    assert state["pressure"] == pytest.approx(np.full(30, 1.7e5))
    assert state["temperature"] == pytest.approx(np.full(30, 1.7e5 / (2.0 * 287.05)))
    out = simulator.run(1e-3, {"volts": 5.0})
    assert out.chambers["volume"][0] == pytest.approx(1.7e5, rel=1e-12)
    assert out.temperatures["volume"][0] == pytest.approx(300.0, rel=1e-12)


@pytest.mark.parametrize(
    ("action", "words"),
    [
        (lambda s: s.run(0.01), "command 'volts'"),
        (lambda s: s.run(0.01, {"volts": [1.0, 2.0]}), "shape (2,)"),
        (lambda s: s.run(0.01, {"volts": np.nan}), "not finite"),
        (lambda s: s.run(0.01, {"volts": 5.0, "bolts": 1.0}), "'bolts'"),
        (lambda s: s.run(0.0105, {"volts": 5.0}), "whole number"),
        (lambda s: s.state("hose"), "no pipe 'hose'"),
        (lambda s: s.set_state("tube", np.ones(7), 0.0, 1e5), "30 cells"),
        (lambda s: s.set_state("tube", -1.0, 0.0, 1e5), "density"),
        (lambda s: s.set_chamber("tank", 1e5, 300.0), "no chamber 'tank'"),
        (lambda s: s.reset({"tank": 1e5}), "'tank'"),
        (lambda s: Simulator([valve_rig(), valve_rig(grid={"dx_m": 0.05})]), "share one structure"),
    ],
)
def test_refusals(action: Any, words: str) -> None:
    with pytest.raises(InputError) as caught:
        action(Simulator(valve_rig()))
    assert words in str(caught.value)
