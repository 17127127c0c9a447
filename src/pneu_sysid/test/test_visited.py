# SPDX-License-Identifier: Apache-2.0
"""How far recordings open the ports of a rig."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from studies.exact_rigs import draw_rig

from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import Rig
from pneu_sim.signals import Signal
from pneu_sysid.records import Recording
from pneu_sysid.visited import opened_to, words_on_openings


def valve() -> Rig:
    """A rig whose spool follows at once and whose ports open in proportion."""
    rig = draw_rig("line", np.random.default_rng(1))
    one = rig.valves["valve"]
    one.spool = one.spool.model_copy(update={"bandwidth_hz": None})
    one.ports["supply"].opening.voltage_v = [5.0, 10.0]
    one.ports["supply"].opening.fraction = [0.0, 1.0]
    one.ports["supply"].opening.interpolation = "cubic"
    return rig


def recording(name: str, *volts: float, each_s: float = 0.2) -> Recording:
    """A command that stays at some voltages."""
    time = each_s * np.arange(len(volts) + 1)
    command = Signal(time, np.array([*volts, 5.0]))
    at = np.arange(0.0, time[-1] + 0.1, 0.01)
    return Recording(name, {"voltage": command}, {"end": Signal(at, np.full(at.size, 1e5))})


def test_each_port_is_open_as_far_as_its_command_goes() -> None:
    opened = opened_to(valve(), [recording("one", 8.0, 4.0)])
    assert opened["valve.supply"] == pytest.approx(0.6, abs=0.01)
    assert opened["valve.exhaust"] == pytest.approx(0.2, abs=0.01)


def test_recordings_count_together_and_a_blink_does_not() -> None:
    first, second = recording("one", 10.0, 4.0), recording("two", 4.5, 1.0)
    assert words_on_openings(valve(), [first, second]) is None
    said = words_on_openings(valve(), [first])
    assert said is not None
    assert "valve.exhaust by more than 20 %" in said and "supply" not in said
    blink = recording("three", 10.0, 0.0, 5.0, 5.0, each_s=0.03)
    said = words_on_openings(valve(), [blink])
    assert said is not None and "supply" in said and "exhaust" in said


def test_a_rig_without_valves_has_nothing_to_open() -> None:
    rig = load_rig(Path(__file__).parents[3] / "rigs" / "closed_chamber.yaml")
    assert not rig.valves
    assert opened_to(rig, [Recording("one", {}, {})]) == {}
    assert words_on_openings(rig, [Recording("one", {}, {})]) is None
