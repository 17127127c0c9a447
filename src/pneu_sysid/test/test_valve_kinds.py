# SPDX-License-Identifier: Apache-2.0
"""What identification makes of kinds of valves: which of their curves it frees."""

from __future__ import annotations

import warnings
from typing import Any

import pytest

from pneu_sim.rig.schema import Rig
from pneu_sysid.curves import curve_ties, mirrors_of, with_own_curves
from pneu_sysid.parameters import default_parameters

KINDS: dict[str, dict[str, Any]] = {
    "5/3": {"outlets": ["a", "b"], "exhausts": ["room"]},
    "5/3 exhausted": {
        "kind": "5/3",
        "outlets": ["a", "b"],
        "exhausts": ["room"],
        "centre": "exhausted",
        "overlap_v": 0.5,
    },
    "3/2": {"outlet": "a", "exhaust": "room", "pwm_hz": 100.0},
    "regulator": {"outlet": "a", "exhaust": "room", "high_pa": 6e5},
}


def rig_with(kind: str) -> Rig:
    valve = {"kind": kind, "command": "u", "supply": "tank", "conductance_m3_s_pa": 1e-8}
    return Rig.model_validate(
        {
            "name": "bench",
            "reservoirs": {"tank": {"pressure_pa": 7e5}, "room": {"pressure_pa": 1e5}},
            "chambers": {"a": {"volume_m3": 1e-4}, "b": {"volume_m3": 1e-4}},
            "pipes": {"line": {"from": "a", "to": "closed", "length_m": 0.5, "area_m2": 1e-5}},
            "valves": {"valve": valve | KINDS[kind]},
            "commands": {"u": {}},
            "taps": {"tap": {"chamber": "a"}},
        }
    )


@pytest.mark.parametrize("kind", KINDS)
def test_curves_that_are_freed(kind: str) -> None:
    """Those of a spool that opens from null on; not what is switched or a set-point."""
    rig = rig_with(kind)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        own = with_own_curves(rig)
        freed = default_parameters(own)
        curve_ties(own, freed, mirrors_of(rig))
    ports = {path.split(".")[3] for path in (p.path for p in freed) if ".opening.fraction." in path}
    want = {
        "5/3": {"supply_a", "supply_b", "exhaust_a", "exhaust_b"},
        "5/3 exhausted": {"supply_a", "supply_b"},
    }
    assert ports == want.get(kind, set())

    assert any(".conductance_m3_s_pa" in p.path for p in freed)
