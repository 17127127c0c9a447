# SPDX-License-Identifier: Apache-2.0
"""What is uncertain at the beginning of a recording, one thing at a time."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from pneu_sim.rig import load_rig
from pneu_sim.rig.expand import with_cylinders
from pneu_sim.rig.plan import plan_grid
from pneu_sim.simulate import rest
from pneu_sysid.records import Recording, Signal
from pneu_sysid.start import READING_SIGMAS, SPEED_SHARE, TEMPERATURE_K, UNSEEN, modes_of

RIGS = Path(__file__).parents[3] / "rigs"
CONSTANT = {"temperature": "temperature_k", "chamber_temperature": "temperature_k"}


def modes(name):
    """The modes of a rig that stands, whose encoders go to and fro at 0.5 Hz."""
    rig = with_cylinders(load_rig(RIGS / f"{name}.yaml"))
    plan = plan_grid(rig)
    start = rest(rig, plan)
    time_s = np.arange(0.0, 4.0, 0.01)
    swing = Signal(time_s, 0.25 * np.sin(np.pi * time_s))
    if plan.encoders:
        joints = np.zeros((1 + max(plan.encoder_of), 2))
        start = type(start)(**{**vars(start), "joints": joints})
    sensors = [*rig.taps, *plan.encoders]
    noise = 100.0 + np.arange(len(sensors))
    noise[len(rig.taps) :] = 1e-3
    recording = Recording(name, {}, {}, encoders=dict.fromkeys(plan.encoders, swing))
    return rig, start, noise, modes_of(rig, plan, start, sensors, noise, recording)


def changes(rig, start, mode):
    """What a mode changes, by field: all that differs from the beginning, in its unit."""
    found = {}
    for field in fields(start):
        before, after = getattr(start, field.name), getattr(mode.start, field.name)
        if after is None or isinstance(after, bool):
            continue
        if before is None:
            before = getattr(rig.ambient, CONSTANT[field.name])
        if (moved := (after - before)[after != before]).size:
            found[field.name] = moved
    return found


@pytest.mark.parametrize("name", ["kokoro", "rig_a", "closed_chamber"])
def test_each_mode_moves_one_thing_by_its_step(name):
    rig, start, noise, found = modes(name)
    of = {"temperature": 0, "pressure": 0, "joints": 0}
    highest_pa = max(r.pressure_pa for r in rig.reservoirs.values()) if rig.reservoirs else 0.0
    for mode in found:
        changed = changes(rig, start, mode)
        kinds = {kind.removeprefix("chamber_") for kind in changed}
        assert len(kinds) == 1, "gas of one kind of quantity at a time"
        (kind,) = kinds
        of[kind] += 1
        for moved in changed.values():
            np.testing.assert_allclose(moved, mode.step, rtol=1e-9)
        if kind == "temperature":
            assert mode.std == TEMPERATURE_K
        elif kind == "pressure":
            seen = [READING_SIGMAS * one for one in noise[: len(rig.taps)]]
            assert mode.std in [*seen, UNSEEN * (highest_pa or rig.ambient.pressure_pa)]
            assert mode.step == min(mode.std, 1e3)
    assert of["temperature"] > 0
    if name == "kokoro":
        # The swing's speed is 0.25 pi cos(pi t), of which the deviation is 1/sqrt(2) of the most.
        speed = SPEED_SHARE * 0.25 * np.pi / np.sqrt(2.0)
        place, pace = (mode.std for mode in found if "joints" in changes(rig, start, mode))
        assert place == pytest.approx(READING_SIGMAS * 1e-3)
        assert pace == pytest.approx(speed, rel=0.01)
