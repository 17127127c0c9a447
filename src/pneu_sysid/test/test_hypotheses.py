# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis could not tell apart, as rigs: also where along a pipe it may be."""

import pytest
from tests.one_tap import one_tap

from pneu_common.errors import InputError
from pneu_common.installed import version
from pneu_sysid.design.hypotheses import MOST, hypotheses_of
from pneu_sysid.design.promise import pairs_of
from pneu_sysid.results.compare import Numerics
from pneu_sysid.results.diagnose import Candidate, DiagnoseResult

RIG = one_tap(0.1)  # its tube is 1.5 m long


def candidate(effect: str, gain: float, places_m=None, **parameters: float) -> Candidate:
    return Candidate(
        effect=effect,
        title=effect,
        place="end" if effect.startswith("sensor") else "tube",
        position_m=parameters.get("position_m"),
        places_m=places_m,
        strength=1.0,
        unit="1",
        explained_fraction=gain,
        held_out_gain=gain,
        significance=9.0,
        next_experiment="",
        tested=True,
        std_error=0.1,
        parameters=parameters,
    )


def result(*candidates: Candidate, verdict: str = "ambiguous") -> DiagnoseResult:
    return DiagnoseResult(
        pneu_version=version(), recording="r", recordings=["r"], rigs=["lab"], taps=["end"],
        encoders={}, noise_floor_pa={"end": 250.0}, noise_floor={}, findings=[], verdict=verdict,
        sentence="", statements=[], unchanged=[], times_noise=2.0, rmse_pa={}, rmse={},
        candidates=list(candidates), depends_on=[],
        numerics=Numerics(dx_m=0.1, refined_dx_m=None, change_pa={}, discretisation=False,
                          sentence=""),
    )  # fmt: skip


def test_one_that_may_be_elsewhere_is_tried_there_too():
    volume = candidate("dead_volume", 0.9, (0.0, 1.5), volume_m3=4e-7, position_m=0.1)
    longer = candidate("length_error", 0.9, error=0.04)
    found = hypotheses_of(RIG, result(volume, longer), "d.json")
    # at the one end it is as good as where it was found
    assert [h.label for h in found] == [
        "dead_volume@tube:0.10", "dead_volume@tube:0.38", "dead_volume@tube:0.75",
        "dead_volume@tube:1.12", "dead_volume@tube:1.50", "length_error@tube",
    ]  # fmt: skip
    places = [h.rig.effects[-1].parameters.get("position_m") for h in found]
    assert places == [0.1, 0.375, 0.75, 1.125, 1.5, None]
    assert found[1].rig.effects[-1].parameters["volume_m3"] == 4e-7
    # one and the same at two places need not be told apart
    assert pairs_of(found) == [(k, 5) for k in range(5)]


def test_one_that_is_where_it_was_found_is_tried_there_alone():
    leak = candidate("leak", 0.9, (1.1, 1.3), area_m2=3e-9, position_m=1.2)
    porous = candidate("porous_leak", 0.9, None, conductance=1e-15, position_m=0.7)
    found = hypotheses_of(RIG, result(leak, porous), "d.json")
    assert [h.label for h in found] == ["leak@tube:1.20", "porous_leak@tube:0.70"]


def test_no_more_candidates_than_can_be_told_apart_at_once():
    names = ("dead_volume", "leak", "blockage", "local_loss", "length_error", "area_error")
    many = [candidate(name, 0.9, error=0.1) for name in names]
    assert len(hypotheses_of(RIG, result(*many), "d.json")) == MOST


def test_nothing_to_tell_apart_is_said():
    one = candidate("length_error", 0.9, error=0.04)
    with pytest.raises(InputError, match=r"d\.json: its verdict is ambiguous with 1 candidates"):
        hypotheses_of(RIG, result(one), "d.json")
