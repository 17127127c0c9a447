# SPDX-License-Identifier: Apache-2.0
"""The simple model matched to the full one: what the scales are, and that they help."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_sim.lumped.match import Matched, match_thin_plate
from pneu_sim.plant import Plant
from pneu_sim.rig.load import load_rig
from pneu_sim.rig.schema import Rig

RIGS = Path(__file__).parents[3] / "rigs"


def rail(length_m: float) -> Rig:
    """The cart with lines of some length, and the critical ratio of an orifice."""
    data = load_rig(RIGS / "rail.yaml").dump()
    for pipe in data["pipes"].values():
        pipe["length_m"] = length_m
    for valve in data["valves"].values():
        for port in valve["ports"].values():
            port["critical_ratio"] = 0.528
    return Rig.model_validate(data)


SHORT_M = 0.1


@pytest.fixture(scope="module")
def matched() -> dict[float, Matched]:
    cells = {SHORT_M: 4, 1.0: 8, 4.0: 8}  # short ones take short steps
    return {at: match_thin_plate(rail(at), levels=2, dx_m=at / n) for at, n in cells.items()}


@pytest.mark.long
def test_lines_let_less_through_the_longer_and_the_wider_the_valve_opens(
    matched: dict[float, Matched],
) -> None:
    """As in thesis fig. 7.4: length lowers the scale, and more so at large openings."""
    short, usual, long = (matched[at].scales["head"] for at in (SHORT_M, 1.0, 4.0))
    np.testing.assert_allclose(short, 1.0, atol=0.06)  # hardly any line, no scale
    assert (usual < short).all() and (long < usual).all()
    for scales in (usual, long):
        assert scales[0] < scales[1] and scales[-1] < scales[-2]  # ends are wide open
    volts = matched[1.0].volts
    np.testing.assert_allclose(volts, [0.0, 2.5, 7.5, 10.0])


@pytest.mark.long
def test_a_match_leaves_a_fraction_of_the_error(matched: dict[float, Matched]) -> None:
    one = matched[4.0]
    for name in one.scales:
        assert (one.rmse_pa[name] < 0.6 * one.unmatched_pa[name]).all()


@pytest.mark.long
def test_the_matched_rig_opens_as_its_scales_say(matched: dict[float, Matched]) -> None:
    """Alone and from a file again, it is off the full model by what the match left."""
    one = matched[4.0]
    rig = Rig.model_validate(one.rig.dump())
    full = rail(4.0)
    held = {"cart": full.bodies["cart"].model_copy(update={"slide": _held(full)})}
    ends = []
    for model, dx in ((full, 0.5), (rig, None)):
        plant = Plant([model.model_copy(update={"bodies": held})], dx)
        plant.reset(dict.fromkeys([*model.pipes, *plant.plan.chambers], 1.01325e5))
        volts = np.full((1, 2, 200), 5.0)
        volts[:, 0] = 7.5
        series, _ = plant.advance(volts, 2e-3)
        ends.append(series.chambers[1:, 0, 0])
    off = np.sqrt(np.mean((ends[0] - ends[1]) ** 2))
    at = list(one.volts).index(7.5)
    assert off < 2.5 * one.rmse_pa["head"][at] < 0.3 * np.ptp(ends[0])


def _held(rig: Rig):  # type: ignore[no-untyped-def]
    return rig.bodies["cart"].joints[0].model_copy(update={"held": True})


def test_mechanisms_are_not_matched() -> None:
    with pytest.raises(InputError, match="mechanism: found one, a match holds joints of bodies"):
        match_thin_plate(load_rig(RIGS / "arm4.yaml"))
