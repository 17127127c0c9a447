# SPDX-License-Identifier: Apache-2.0
"""Recordings in other units than the rig file's: named in a sentence; right ones left alone."""

from pathlib import Path

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import Rig
from pneu_sysid.records import Recording, Signal, even_recording
from pneu_sysid.units import checked

ROOT = Path(__file__).parents[3]
RATE_HZ = 500.0


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(ROOT / "rigs" / "rig_a.yaml")


def recording(rig: Rig, scale: float = 1.0, offset: float = 0.0, seconds: float = 2.0) -> Recording:
    """A tube that fills and empties; readings are (absolute pascals - offset) / scale."""
    rng = np.random.default_rng(3)
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    supply, room = rig.reservoirs["supply"].pressure_pa, rig.ambient.pressure_pa
    taps = {}
    for k, tap in enumerate(rig.taps):
        wave = 0.5 - 0.5 * np.cos(2.0 * np.pi * time_s + k)
        taps[tap] = room + (supply - room) * wave + rng.normal(0.0, 250.0, time_s.size)
    taps = {tap: (values - offset) / scale for tap, values in taps.items()}
    return even_recording("run", time_s, {"voltage": 5.0 + 5.0 * np.sin(time_s)}, taps)


def test_pascals_are_left_alone(rig: Rig) -> None:
    given = recording(rig)
    before = {tap: signal.values.copy() for tap, signal in given.pressures.items()}
    found = checked(rig, "run.mcap", given)
    for tap, values in before.items():
        np.testing.assert_array_equal(found.pressures[tap].values, values)
    assert not found.report


@pytest.mark.parametrize(
    ("scale", "gauge", "words"),
    [
        (1e5, False, "bar, absolute: say so in its channel with scale: 100000"),
        (1e5, True, "bar above the room's pressure: say so in its channel with scale: 100000,"),
        (1e3, False, "kPa, absolute"),
        (6894.757, False, "psi, absolute"),
        (6894.757, True, "psi above the room's pressure"),
        (1.0, True, "pascals above the room's pressure"),
    ],
)
def test_another_unit_of_pressure_is_named(rig: Rig, scale: float, gauge: bool, words: str) -> None:
    offset = rig.ambient.pressure_pa if gauge else 0.0
    with pytest.raises(InputError) as caught:
        checked(rig, "run.mcap", recording(rig, scale, offset))
    assert "run.mcap: tap 'supply'" in str(caught.value)
    assert words in str(caught.value)


@pytest.mark.parametrize("mark", [-999.0, 0.0, 6553500.0])
def test_marks_of_failed_readings_are_dropped_and_told(rig: Rig, mark: float) -> None:
    given = recording(rig)
    given.pressures["end"].values[100:140] = mark
    found = checked(rig, "run.mcap", given)
    assert len(found.pressures["end"]) == len(found.pressures["middle"]) - 40
    (finding,) = found.report
    assert (finding.channel, finding.kind, finding.count) == ("end", "mark", 40)
    assert f"{mark:g} Pa" in finding.action


def test_millivolts_are_named(rig: Rig) -> None:
    given = recording(rig)
    given.commands["voltage"].values[:] *= 1e3
    with pytest.raises(InputError, match=r"millivolts: say so with scale: 0\.001"):
        checked(rig, "run.mcap", given)


def test_milliseconds_are_named(rig: Rig) -> None:
    given = recording(rig, seconds=5.0)
    for signal in (*given.commands.values(), *given.pressures.values()):
        signal.time_s[:] *= 1e3
    with pytest.raises(InputError, match=r"milliseconds, say so with text\.time_scale"):
        checked(rig, "run.csv", given)


def test_numbers_of_no_unit_are_doubted(rig: Rig) -> None:
    """Neither pascals nor volts, nor anything that a factor would make of them."""
    with pytest.raises(InputError) as caught:
        checked(rig, "run.mcap", recording(rig, 1e-7))
    assert str(caught.value).startswith("run.mcap: tap 'supply': readings run from ")
    assert str(caught.value).endswith("; are scale and offset of its channel right?")
    for factor, words in (
        (10.2e3, "are scale and offset of its channel right?"),
        (1.4e3, "they seem to be millivolts: say so with scale: 0.001"),
    ):
        given = recording(rig)
        given.commands["voltage"].values[:] = 10.0 * factor
        with pytest.raises(InputError) as caught:
            checked(rig, "run.mcap", given)
        assert str(caught.value) == (
            f"run.mcap: command 'voltage': values reach {10.0 * factor:.4g} V, the valve's opening"
            f" is known to 10 V; {words}"
        )
    # A command that no valve listens to may have any values, and one may have none.
    given = recording(rig)
    other = rig.model_copy(deep=True)
    other.commands["spare"] = other.commands["voltage"]
    given.commands["spare"] = Signal(np.array([0.0, 1.0]), np.array([1e9, -1e9]))
    assert checked(other, "run.mcap", given).commands["spare"].values[0] == 1e9
    given.commands["voltage"] = Signal(np.zeros(0), np.zeros(0))
    assert len(checked(other, "run.mcap", given).commands["voltage"]) == 0
