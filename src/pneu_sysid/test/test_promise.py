# SPDX-License-Identifier: Apache-2.0
"""Expected results of a plan, for one rig and for several; all numbers differ."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pneu_sim.signals import Signal
from pneu_sysid.design.promise import DEPENDS, LITTLE, expected_of

NAMES = ["pipes.tube.area_m2", "sensors.end.delay_s"]
LEARNT: Any = [SimpleNamespace(path=name, log=False) for name in NAMES]
LIMITS: Any = object()


def promise(
    scale: float, errors: tuple[float, float], share: tuple[float, float] = (0.1, 0.2),
    within: bool = True,
) -> Any:  # fmt: skip
    """Return the expectation for one rig; pressures, joints and air scale with a number."""
    time = np.array([0.0, 0.1, 0.2])
    pressures = {
        "end": Signal(time, 1e5 * (1.0 + scale * np.array([0.0, 1.0, 0.5]))),
        "valve_out": Signal(time, 1e5 * (2.0 - scale * np.array([0.0, 0.1, 0.2]))),
    }
    told = SimpleNamespace(
        found=lambda: np.array(share), variables=[SimpleNamespace(name=name) for name in NAMES]
    )
    seen = SimpleNamespace(
        recording=SimpleNamespace(pressures=pressures),
        joints={"elbow": scale * np.array([-0.3, 0.7])},
        air_kg=1e-3 * scale * np.array([0.5, 1.0]),
        within=lambda limits: within,
    )
    return SimpleNamespace(seen=seen, told=told, errors=lambda learnt: np.array(errors))


def test_one_rig_gives_no_range() -> None:
    told = expected_of([promise(1.0, (2.0, 30.0))], LIMITS, [], [], LEARNT, 4.0)
    assert told.std_errors == {NAMES[0]: 2.0, NAMES[1]: 30.0}
    assert told.std_errors_range == {} and told.words == []


def test_several_rigs_give_extremes_and_median_errors() -> None:
    rigs = [promise(1.0, (2.0, 30.0)), promise(3.0, (3.0, 20.0)), promise(2.0, (2.5, 50.0))]
    told = expected_of(rigs, LIMITS, [], [], LEARNT, 4.0)
    assert told.std_errors == {NAMES[0]: 2.5, NAMES[1]: 30.0}
    assert told.std_errors_range == {NAMES[0]: [2.0, 3.0], NAMES[1]: [20.0, 50.0]}
    assert told.highest_pa == {"end": 4e5, "valve_out": 2e5}
    assert told.lowest_pa == pytest.approx({"end": 1e5, "valve_out": 1.4e5})
    assert told.joints == {"elbow": pytest.approx([-0.9, 2.1])}
    assert told.air_kg == pytest.approx(3e-3)
    assert told.fastest_pa_s["end"] >= 3e6 > told.fastest_pa_s["valve_out"]
    assert told.words == []


def test_what_a_plan_cannot_promise_is_reported() -> None:
    rigs = [promise(1.0, (2.0, 1.0)), promise(1.0, (2.0, 1.01 * DEPENDS), within=False)]
    depends, beyond = expected_of(rigs, LIMITS, [], [], LEARNT, 4.0).words
    assert f"How much it tells of {NAMES[1]} depends on what the rig is" in depends
    assert beyond.startswith("In 1 of 2 rigs as this one may be")
    alone = promise(1.0, (2.0, 1.0), (LITTLE + 0.01, LITTLE - 0.01), within=False)
    (little,) = expected_of([alone], LIMITS, [], [], LEARNT, 4.0).words
    assert little.startswith(f"It tells little of {NAMES[0]}: what was known of it before")
