# SPDX-License-Identifier: Apache-2.0
"""A model run at other strengths by a process that holds it ready."""

import queue
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.coarse import coarsened
from tests.short_bags import shorten

from pneu_common.errors import InputError
from pneu_sim.rig import load_rig, save_rig
from pneu_sim.rig.schema import AttachedEffect
from pneu_sysid.tasks.signals import load_signals
from pneu_sysid.tasks.trial import range_of, with_strength
from pneu_sysid.tasks.trial_process import TrialProcess

ROOT = Path(__file__).resolve().parents[3]
BAG = ROOT / "data" / "bags" / "a_leak" / "a_leak.mcap"
SECONDS = 4.0
"""How much of the recording is used, s."""
FITTED = ROOT / "rigs" / "rig_a_fitted.yaml"
AREA_M2 = 1.6e-8
"""Of the leak that is hidden in the recording, as `pneu diagnose` finds it."""


@pytest.fixture
def leaking(tmp_path: Path) -> Path:
    leak = AttachedEffect(
        effect="leak", place="tube", parameters={"area_m2": AREA_M2, "position_m": 2.38}
    )
    rig = load_rig(coarsened(FITTED, tmp_path / "coarse.yaml", dx_m=0.125, memory=False))
    save_rig(rig.model_copy(update={"effects": [*rig.effects, leak]}), tmp_path / "rig.yaml")
    return tmp_path / "rig.yaml"


def test_a_range_leads_from_where_an_effect_vanishes(leaking: Path) -> None:
    rig = load_rig(leaking)
    told = range_of(rig)
    assert (told["lower"], told["strength"]) == (0.0, AREA_M2)
    assert told["upper"] == pytest.approx(3.0 * AREA_M2)
    assert with_strength(rig, 1e-8).effects[-1].parameters["area_m2"] == 1e-8
    assert rig.effects[-1].parameters["area_m2"] == AREA_M2
    with pytest.raises(InputError, match="effects: found none"):
        range_of(load_rig(FITTED))


@pytest.mark.long
def test_the_error_is_least_at_the_strength_that_is_hidden(leaking: Path, tmp_path: Path) -> None:
    heard: queue.Queue[dict[str, Any]] = queue.Queue()
    shorten(BAG, tmp_path / "short.mcap", SECONDS)
    process = TrialProcess([str(tmp_path / "short.mcap")], str(leaking), 1, heard.put)
    try:
        assert heard.get(timeout=120.0)["strength"] == AREA_M2
        errors = {}
        for share in (0.0, 0.5, 1.0, 2.0):
            process.run(share * AREA_M2, str(tmp_path / "signals.npz"))
            told = heard.get(timeout=120.0)
            errors[share] = told["errors"]["end"]
            trace = load_signals(tmp_path / "signals.npz").sensors["end"]
            noise = load_signals(tmp_path / "signals.npz").about.noise["end"]
            rms = np.sqrt(np.mean((trace.measured - trace.model) ** 2)) / noise
            assert rms == pytest.approx(errors[share], rel=1e-6)
        assert errors[1.0] < 3.0 < errors[0.5] < errors[0.0]
        assert errors[2.0] > 10.0
        for k in range(20):  # dragged: what waits is forgotten, the last is answered
            process.run((1.0 + k / 20.0) * AREA_M2, str(tmp_path / "signals.npz"))
        answered = [heard.get(timeout=120.0)["strength"]]
        while answered[-1] != pytest.approx(1.95 * AREA_M2):
            answered.append(heard.get(timeout=120.0)["strength"])
        assert len(answered) <= 20 and answered == sorted(answered)
    finally:
        process.end()
    assert heard.empty()


def test_what_cannot_be_run_is_said(tmp_path: Path) -> None:
    heard: queue.Queue[dict[str, Any]] = queue.Queue()
    process = TrialProcess([str(BAG)], str(tmp_path / "no.yaml"), 1, heard.put)
    assert "no.yaml" in heard.get(timeout=120.0)["fault"]
    process.end()
