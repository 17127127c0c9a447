# SPDX-License-Identifier: Apache-2.0
"""Rig files that are grossly wrong are told so, by the part that is wrong; ordinary ones are not.

The rigs are drawn at random and their files put off by 10 to 40 % where datasheets are.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from studies.exact_rigs import draw_rig, record

from pneu_sim.rig import with_parameters
from pneu_sim.rig.parameters import get_parameter
from pneu_sim.rig.schema import Rig
from pneu_sim.signals import Signal
from pneu_sysid.gross import GrossError, gross_errors
from pneu_sysid.problem import make_problem
from pneu_sysid.records import Recording

SECONDS = 2.5
RATE_HZ = 250.0
DX_M = 0.4
FACTORS = (0.75, 1.3, 0.8, 1.25, 0.7, 1.35)
CATALOGUE_V = [5.1, 5.5, 6.0, 7.5, 10.0]
CATALOGUE = [0.02, 0.1, 0.2, 0.5, 1.0]


@cache
def drawn(shape: str, seed: int) -> tuple[Rig, Recording]:
    """The datasheet of a rig, 20 to 35 % off, and a recording of the rig."""
    rng = np.random.default_rng([7, seed])
    rig = draw_rig(shape, rng)
    rig.grid.dx_m, rig.grid.memory = 0.1, False
    recording = record(rig, rng, RATE_HZ, SECONDS, moving=False)
    paths = [f"valves.{v}.spool.bandwidth_hz" for v in rig.valves]
    paths += [
        f"valves.{v}.ports.{p}.conductance_m3_s_pa"
        for v, valve in rig.valves.items()
        for p in valve.ports
    ]
    paths += [f"orifices.{o}.conductance_m3_s_pa" for o in rig.orifices]
    paths += [f"chambers.{c}.heat_w_per_k" for c in rig.chambers]
    factors = np.resize(FACTORS, len(paths))
    off = {p: get_parameter(rig, p) * f for p, f in zip(paths, factors, strict=True)}
    sheet = with_parameters(rig, off)
    for valve in sheet.valves.values():
        curve = valve.ports["supply"].opening
        curve.voltage_v, curve.fraction = CATALOGUE_V, CATALOGUE
    return sheet, recording


def asked(rig: Rig, recording: Recording) -> list[GrossError]:
    return gross_errors(rig, make_problem(rig, recording, pull_s=0.3, dx_m=DX_M, workers=1))


def scaled(rig: Rig, factor: float, *paths: str) -> Rig:
    return with_parameters(rig, {path: get_parameter(rig, path) * factor for path in paths})


@pytest.mark.parametrize("shape", ["line", "tee", "two_valves", "restrictor"])
def test_ordinary_datasheets_are_not_accused(shape: str) -> None:
    assert asked(*drawn(shape, 0)) == []


@pytest.mark.long
@pytest.mark.parametrize(
    ("shape", "paths", "factor"),
    [
        (
            "line",
            (
                "valves.valve.ports.supply.conductance_m3_s_pa",
                "valves.valve.ports.exhaust.conductance_m3_s_pa",
            ),
            0.1,
        ),
        ("restrictor", ("orifices.restrictor.conductance_m3_s_pa",), 10.0),
    ],
)
def test_a_size_in_another_unit_is_found(shape: str, paths: tuple[str, ...], factor: float) -> None:
    rig, recording = drawn(shape, 0)
    first, *_ = asked(scaled(rig, factor, *paths), recording)
    common = paths[0] if len(paths) == 1 else paths[0].rpartition(".ports")[0] + ".ports"
    assert first.what == common
    assert first.error_after < 0.3 * first.error_before


def test_a_supply_given_above_the_rooms_pressure_is_found() -> None:
    rig, recording = drawn("line", 0)
    path = "reservoirs.supply.pressure_pa"
    wrong = with_parameters(rig, {path: get_parameter(rig, path) - 101325.0})
    (error,) = asked(wrong, recording)
    assert error.what == path
    assert "above the room's pressure instead of absolute" in error.sentence


def mirrored(recording: Recording) -> Recording:
    volts = recording.commands["voltage"]
    turned = {"voltage": Signal(volts.time_s, 10.0 - volts.values)}
    return replace(recording, commands={**recording.commands, **turned})


def crossed(recording: Recording) -> Recording:
    voltage, right = recording.commands["voltage"], recording.commands["right"]
    return replace(recording, commands={"voltage": right, "right": voltage})


def exchanged(recording: Recording) -> Recording:
    a, b = recording.pressures["feed"], recording.pressures["middle"]
    return replace(recording, pressures={**recording.pressures, "feed": b, "middle": a})


@pytest.mark.long
@pytest.mark.parametrize(
    ("shape", "change", "what", "words"),
    [
        ("line", mirrored, "valves.valve", ("exchanged", "mirrored about 5 V")),
        ("two_valves", crossed, "valves.valve.command", ("'voltage' and 'right'",)),
        ("line", exchanged, "taps.feed", ("'feed' and 'middle'", "exchanged")),
    ],
)
def test_what_is_connected_wrongly_is_found(
    shape: str,
    change: Callable[[Recording], Recording],
    what: str,
    words: tuple[str, ...],
) -> None:
    rig, recording = drawn(shape, 0)
    first, *_ = asked(rig, change(recording))
    assert first.what == what
    for word in words:
        assert word in first.sentence


def test_a_tap_in_another_volume_than_the_file_says_is_found() -> None:
    rig, recording = drawn("line", 0)
    wrong = rig.model_copy(deep=True)
    wrong.taps["end"] = wrong.taps["end"].model_copy(update={"pipe": "feed", "position_m": 0.2})
    first, *_ = asked(wrong, recording)
    assert first.what == "taps.end"
    assert "'to' end of pipe 'tube'" in first.sentence
