# SPDX-License-Identifier: Apache-2.0
"""A recording through two seconds in which the machine stood still: gaps named, no false verdict.

The rig goes on meanwhile: 0.1 s after the last command the device vents by itself, and the bridge
tells so once it runs again. Of that time there is no other command and no reading.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from studies.synthetic import NOISE_PA, RATE_HZ, commands, synthetic

from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sysid.compare import compare
from pneu_sysid.diagnose import diagnose
from pneu_sysid.problem import record_for
from pneu_sysid.records import Recording, Signal
from pneu_sysid.records.write import write_bag

ROOT = Path(__file__).resolve().parent.parent
SECONDS, BEGUN_S, VENTED_S, ENDED_S = 7.0, 3.0, 3.1, 5.0
LEAK = AttachedEffect(effect="leak", place="tube", parameters={"area_m2": 3e-8, "position_m": 1.0})


@pytest.fixture(scope="module")
def rig() -> Rig:
    """Rig A on cheap cells, for recordings made from it: its calibration is exact there."""
    rig = load_rig(ROOT / "rigs" / "rig_a_fitted.yaml")
    assert rig.calibration is not None
    floor = dict.fromkeys(rig.taps, NOISE_PA)
    return rig.model_copy(
        update={
            "calibration": rig.calibration.model_copy(update={"rmse_pa": floor}),
            "grid": rig.grid.model_copy(update={"dx_m": 0.125, "memory": False}),
        }
    )


def recordings(rig: Rig, effects: list[AttachedEffect]) -> tuple[Recording, Recording]:
    """What a recorder that never stands still has of a rig with effects, and what ours has."""
    volts = commands(SECONDS, np.random.default_rng(31))
    time_s = np.arange(volts.size) / RATE_HZ
    volts[(time_s >= BEGUN_S) & (time_s < VENTED_S)] = volts[time_s < BEGUN_S][-1]
    volts[(time_s >= VENTED_S) & (time_s < ENDED_S)] = 0.0
    hidden = rig.model_copy(update={"effects": effects})
    whole = synthetic(hidden, SECONDS, seed=32, name="whole", volts=volts)
    vented_s = time_s[time_s >= VENTED_S][:1]

    def kept(signal: Signal, besides: np.ndarray) -> Signal:
        there = (signal.time_s < BEGUN_S) | (signal.time_s >= ENDED_S)
        there |= np.isin(signal.time_s, besides)
        return Signal(signal.time_s[there], signal.values[there])

    ours = Recording(
        "stalled",
        {name: kept(signal, vented_s) for name, signal in whole.commands.items()},
        {name: kept(signal, np.empty(0)) for name, signal in whole.pressures.items()},
    )
    return whole, ours


@pytest.mark.long
@pytest.mark.parametrize("effects", [[], [LEAK]], ids=["healthy", "leak"])
def test_a_recording_through_a_stall(
    rig: Rig, effects: list[AttachedEffect], tmp_path: Path
) -> None:
    whole, ours = recordings(rig, effects)
    write_bag(tmp_path / "stalled", rig, ours)
    stalled = record_for(rig, str(tmp_path / "stalled"))
    compared = compare(stalled, [("pde", rig, None)], refine=False)
    for tap in rig.taps:
        (gap,) = [one for one in compared.findings if one.startswith(f"{tap}: gap")]
        assert "the longest 2.0" in gap
    found = diagnose(rig, stalled, refine=False)
    if effects:
        assert found.verdict in ("effect", "ambiguous")
        top = found.finalists[0]
        assert top.site.effect.name == LEAK.effect
        assert top.site.place.split(":")[0] == LEAK.place
        assert top.strength == pytest.approx(LEAK.parameters["area_m2"], rel=0.2)
    else:
        assert found.verdict == "nothing_missing"
        usual = compare(whole, [("pde", rig, None)], refine=False).models[0].taps
        for name, tap in compared.models[0].taps.items():
            assert (tap.times_noise or np.inf) < 1.2 * (usual[name].times_noise or 0.0)
