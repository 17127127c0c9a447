# SPDX-License-Identifier: Apache-2.0
"""An effect of a user may add a term of its own to the equations of the gas."""

from pathlib import Path

import numpy as np
import pytest

from pneu_sim import stepping
from pneu_sim import tile as tiles
from pneu_sim.effects import load_effect_file
from pneu_sim.rig.build import build
from pneu_sim.rig.schema import Rig
from pneu_sim.simulator import Simulator

EXAMPLE = Path(__file__).parents[1] / "examples" / "my_term.py"
LENGTH_M, AREA_M2, POWER_W = 1.0, 2e-5, 3.0


@pytest.fixture(scope="module", autouse=True)
def known() -> None:
    load_effect_file(EXAMPLE)


def tube(power_w: float | None) -> Rig:
    """A closed tube whose wall passes no heat."""
    ends = {"from": "closed", "to": "closed"}
    pipe = {**ends, "length_m": LENGTH_M, "area_m2": AREA_M2, "wall": {"nusselt": 0.0}}
    own = {"effect": "heated_wire", "place": "tube", "parameters": {"power_w": power_w}}
    return Rig.model_validate(
        {
            "name": "tube",
            "pipes": {"tube": pipe},
            "grid": {"memory": False},
            "taps": {"middle": {"pipe": "tube", "position_m": 0.5}},
            "effects": [] if power_w is None else [own],
        }
    )


@pytest.mark.long
def test_heat_raises_the_pressure_of_a_closed_line_as_the_first_law_says() -> None:
    simulator = Simulator(tube(POWER_W))
    energy = simulator.energy_j()
    seen = simulator.run(0.2, sample_s=0.01).pressures["middle"]
    assert simulator.energy_j() - energy == pytest.approx(0.2 * POWER_W, rel=1e-9)
    slope = np.polyfit(0.01 * np.arange(seen.size), seen, 1)[0]
    assert slope == pytest.approx(0.4 * POWER_W / (LENGTH_M * AREA_M2), rel=1e-3)


@pytest.mark.long
def test_rigs_with_and_without_it_run_side_by_side() -> None:
    rigs = [tube(None), tube(POWER_W), tube(0.0), tube(2.0 * POWER_W)]
    together = Simulator(rigs).run(0.05, sample_s=0.01).pressures["middle"]
    for k, rig in enumerate(rigs):
        alone = Simulator(rig).run(0.05, sample_s=0.01).pressures["middle"]
        assert np.array_equal(together[:, k], alone)
    assert np.array_equal(together[:, 0], together[:, 2])
    some = stepping.some_lanes(tiles.pack([build(rig) for rig in rigs]), np.array([1, 3]))
    assert [par.shape[-1] for _, par in some.own] == [2]
