# SPDX-License-Identifier: Apache-2.0
"""Drag tests as read from a file: forces by the areas, limits from both sides, noise, gaps."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.rig.schema import Rig
from pneu_sysid.seals.reading import DragTest, read_drag

Floats = NDArray[np.float64]

ROOM_PA = 98000.0
BORE_M, ROD_M, STROKE_M = 0.02, 0.008, 0.05
HEAD_M2 = np.pi * BORE_M**2 / 4.0
ROD_M2 = np.pi * (BORE_M**2 - ROD_M**2) / 4.0
COUNT = 60
TIME_S = 0.01 * np.arange(COUNT)
WAY_M = 0.02 + 0.015 * np.sin(9.0 * TIME_S)
PRESSURE_PA = 3.2e5 + 2e4 * np.cos(7.0 * TIME_S)
OTHER_PA = 1.7e5 + 1e4 * np.sin(5.0 * TIME_S)


def rig_of(side: str = "head", other: bool = True, **cylinder: Any) -> Rig:
    channels = ("position", "pressure", "other_pressure", "force")
    drag = {name: {"column": k} for k, name in enumerate(channels, start=1)}
    if not other:
        del drag["other_pressure"]
    gas = {"node": "closed", "dead_volume_m3": 1e-5}
    size = {"bore_m": BORE_M, "rod_m": ROD_M, "stroke_m": STROKE_M, "head": gas, "rod": gas}
    return Rig.model_validate(
        {
            "pneu_rig": 1,
            "name": "drawn",
            "ambient": {"pressure_pa": ROOM_PA},
            "cylinders": {
                "x": {"bore_m": 0.1, "stroke_m": 0.3, "head": gas},
                "c": {**size, **cylinder},
            },
            "text": {"time": 0, "delimiter": " "},
            "drag": {"cylinder": "c", "side": side, **drag},
        }
    )


def read(folder: Path, rig: Rig, columns: dict[str, Any] | None = None) -> DragTest:
    """Reads a file of the usual columns, some of them replaced; NaN is missing."""
    given: dict[str, Any] = {
        "time": TIME_S,
        "position": WAY_M,
        "pressure": PRESSURE_PA,
        "other": OTHER_PA,
        "force": 30.0 + 0.0 * TIME_S + np.sin(3.0 * TIME_S),
        **(columns or {}),
    }
    n = np.size(given["time"])
    rows = np.column_stack([np.broadcast_to(v, n) for v in given.values()])
    path = folder / "test.txt"
    np.savetxt(path, rows, fmt="%.12g")
    return read_drag(rig, path)


@pytest.mark.parametrize("side", ["head", "rod"])
@pytest.mark.parametrize("other", [False, True], ids=["one", "both"])
@pytest.mark.parametrize(
    ("rate", "preload"), [(0.0, 0.0), (300.0, 4.0), (0.0, 12.0), (200.0, -3.0)]
)
def test_load_is_that_of_gas_and_spring(
    side: str, other: bool, rate: float, preload: float, tmp_path: Path
) -> None:
    found = read(tmp_path, rig_of(side, other, spring_n_m=rate, spring_preload_n=preload))
    second = OTHER_PA if other else ROOM_PA
    head, rod = (PRESSURE_PA, second) if side == "head" else (second, PRESSURE_PA)
    load = HEAD_M2 * (head - ROOM_PA) - ROD_M2 * (rod - ROOM_PA) - preload - rate * WAY_M

    assert found.name == "test"
    np.testing.assert_allclose(found.time_s, TIME_S, atol=1e-9)
    np.testing.assert_allclose(found.extension_m, WAY_M, rtol=1e-9)
    np.testing.assert_allclose(found.load_n, load, rtol=1e-9)
    np.testing.assert_allclose(found.gauge_pa, PRESSURE_PA - ROOM_PA, rtol=1e-9)
    mean = 0.5 * (PRESSURE_PA + second) - ROOM_PA
    np.testing.assert_allclose(found.mean_gauge_pa, mean, rtol=1e-9)
    force = 30.0 + np.sin(3.0 * TIME_S)
    turned = bool(30.0 / np.median(load) < -0.5)
    np.testing.assert_allclose(found.force_n, -force if turned else force, rtol=1e-9)
    np.testing.assert_allclose(found.rest_n, found.force_n - load, atol=1e-8)
    assert any("force: turned" in f for f in found.findings) is turned


def test_a_vacuum_presses_no_seal(tmp_path: Path) -> None:
    found = read(tmp_path, rig_of(), {"pressure": ROOM_PA - 4e4, "other": ROOM_PA + 1e4})
    assert not found.mean_gauge_pa.any()
    np.testing.assert_allclose(found.gauge_pa, -4e4)
    found = read(tmp_path, rig_of(), {"pressure": ROOM_PA - 4e4, "other": ROOM_PA + 5e4})
    np.testing.assert_allclose(found.mean_gauge_pa, 5e3)


PUSH_N = HEAD_M2 * 3e5 - ROD_M2 * 0.0
EVEN = {"pressure": ROOM_PA + 3e5, "other": ROOM_PA}
PULLED = {"pressure": ROOM_PA, "other": ROOM_PA + 3e5}
PULL_N = -ROD_M2 * 3e5


@pytest.mark.parametrize(("gas", "push"), [(EVEN, PUSH_N), (PULLED, PULL_N)], ids=["out", "in"])
@pytest.mark.parametrize(
    ("times", "turned"),
    [(1.0, False), (0.45, False), (-0.45, False), (-0.55, True), (-1.0, True), (-9.0, True)],
)
def test_a_force_against_the_push_is_turned(
    gas: dict[str, float], push: float, times: float, turned: bool, tmp_path: Path
) -> None:
    found = read(tmp_path, rig_of(), {**gas, "force": times * push + np.sin(TIME_S)})
    wanted = times * push + np.sin(TIME_S)
    np.testing.assert_allclose(found.force_n, -wanted if turned else wanted, rtol=1e-8, atol=1e-8)
    said = [f for f in found.findings if "turned" in f]
    assert len(said) == int(turned)
    assert all("force: turned: it was read negative" in f for f in said)


def test_a_force_is_not_judged_without_a_push(tmp_path: Path) -> None:
    small = {"pressure": ROOM_PA + 0.9 / HEAD_M2, "other": ROOM_PA}
    for force in (-2.0, 200.0, 1e-5):
        found = read(tmp_path, rig_of(), {**small, "force": force + 1e-6 * np.sin(TIME_S)})
        assert np.median(found.force_n) == pytest.approx(force, rel=0.1)
    more = {"pressure": ROOM_PA + 1.1 / HEAD_M2, "other": ROOM_PA}
    with pytest.raises(InputError, match="scale to newtons"):
        read(tmp_path, rig_of(), {**more, "force": 200.0 + np.sin(TIME_S)})
    found = read(tmp_path, rig_of(), {**more, "force": -2.0 + 0.1 * np.sin(TIME_S)})
    assert np.median(found.force_n) > 0.0


SWING = np.sin(9.0 * TIME_S)
LONGEST_M = np.ptp(np.quantile(SWING, [0.01, 0.99]))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("gas", "push"), [(EVEN, PUSH_N), (PULLED, PULL_N)], ids=["out", "in"])
@pytest.mark.parametrize(
    ("times", "message"),
    [
        (0.00295, "force reads {most} N at most where the gas presses with {push} N;"
                  " drag.force needs the scale to newtons (1000 for kN)"),
        (0.00305, None),
        (99.0, None),
        (101.0, "force reads {median} N where the gas presses with {signed} N;"
                " drag.force needs the scale to newtons"),
    ],
)  # fmt: skip
def test_limits_of_the_force(
    sign: float,
    gas: dict[str, float],
    push: float,
    times: float,
    message: str | None,
    tmp_path: Path,
) -> None:
    force = sign * times * push * (1.0 - 0.001 * SWING**2)
    columns = {**gas, "force": force}
    if message is None:
        assert read(tmp_path, rig_of(), columns).force_n.size == COUNT
        return
    words = message.format(
        most=f"{np.max(np.abs(force)):.3g}",
        push=f"{abs(push):.3g}",
        median=f"{np.median(force):.3g}",
        signed=f"{push:.3g}",
    )
    with pytest.raises(InputError, match=re.escape(words) + "$"):
        read(tmp_path, rig_of(), columns)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"pressure": 9.9e3}, "pressure is 9900 Pa at its median, absolute pascals are needed;"
                              " drag.pressure needs a scale"),
        ({"pressure": 1.01e4}, None),
        ({"pressure": 1.01e8, "force": 3e4}, "pressure is 1.01e+08 Pa at its median, allowed is"
                                             " up to 1e+08; drag.pressure has another scale"),
        ({"pressure": 9.9e7, "force": 3e4}, None),
        ({"other": 9.9e3}, "other_pressure is 9900 Pa at its median, absolute pascals are needed;"
                           " drag.other_pressure needs a scale"),
        ({"other": 1.01e4}, None),
        ({"other": 1.01e8, "force": 3e4}, "other_pressure is 1.01e+08 Pa at its median, allowed is"
                                          " up to 1e+08; drag.other_pressure has another scale"),
        ({"other": 9.9e7, "force": -3e4}, None),
        ({"position": 0.0099 * STROKE_M / LONGEST_M * SWING},
         "position moves over 0.000495 m in 0.59 s, less than 1 % of the stroke of 0.05 m: nothing"
         " was dragged, or drag.position needs the scale to metres"),
        ({"position": 0.0101 * STROKE_M / LONGEST_M * SWING}, None),
        ({"position": 1.49 * STROKE_M / LONGEST_M * SWING}, None),
        ({"position": 1.51 * STROKE_M / LONGEST_M * SWING},
         "position moves over 0.0755 m, the cylinder's stroke_m is 0.05; drag.position needs the"
         " scale to metres (1e-3 for mm)"),
    ],
)  # fmt: skip
def test_limits_of_pressures_and_way(
    columns: dict[str, Any], message: str | None, tmp_path: Path
) -> None:
    columns = {"force": 30.0 + np.sin(TIME_S), **columns}
    if message is None:
        assert read(tmp_path, rig_of(), columns).time_s.size == COUNT
        return
    with pytest.raises(InputError, match=re.escape(f"test.txt: {message}")):
        read(tmp_path, rig_of(), columns)


def test_a_way_is_judged_without_its_outliers(tmp_path: Path) -> None:
    n = 400
    time = 0.01 * np.arange(n)
    way = 0.02 + 0.015 * np.sin(9.0 * time)
    way[[50, 300]] = 3.0, -3.0
    found = read(
        tmp_path, rig_of(), {"time": time, "position": way, "pressure": 3e5, "other": 1e5}
        | {"force": 30.0 + np.sin(time)},
    )  # fmt: skip
    assert found.time_s.size == n


def test_a_rig_without_a_drag_test_is_refused(tmp_path: Path) -> None:
    rig = rig_of().model_copy(update={"drag": None})
    with pytest.raises(InputError, match="rig 'drawn': drag: found none, needed are the cylinder"):
        read(tmp_path, rig)


@pytest.mark.parametrize("gone", ["position", "pressure", "other"])
@pytest.mark.parametrize(("missing", "kept"), [(2, True), (3, False)])
def test_forces_within_gaps_of_the_others_are_left_out(
    gone: str, missing: int, kept: bool, tmp_path: Path
) -> None:
    values = {"position": WAY_M, "pressure": PRESSURE_PA, "other": OTHER_PA}[gone].copy()
    values[20 : 20 + missing] = np.nan
    values[-1] = np.nan  # beyond the last reading there is none
    found = read(tmp_path, rig_of(), {gone: values})
    left = np.ones(COUNT, dtype=bool)
    if not kept:
        left[20 : 20 + missing] = False
    left[-1] = False
    np.testing.assert_allclose(found.time_s, TIME_S[left], atol=1e-9)
    known = np.isfinite(values)
    between = np.interp(TIME_S, TIME_S[known], values[known])[left]
    own = {"position": found.extension_m, "pressure": found.gauge_pa + ROOM_PA}
    if gone in own:
        np.testing.assert_allclose(own[gone], between, rtol=1e-9)


@pytest.mark.parametrize("first", [20, 21])
def test_too_few_common_readings_are_refused(first: int, tmp_path: Path) -> None:
    force, way = 30.0 + np.sin(TIME_S), WAY_M.copy()
    force[:first] = np.nan
    way[40:] = np.nan
    if first == 20:
        found = read(tmp_path, rig_of(), {"force": force, "position": way})
        np.testing.assert_allclose(found.time_s, TIME_S[20:40], atol=1e-9)
        np.testing.assert_allclose(found.force_n, force[20:40])
        return
    with pytest.raises(InputError, match="position and pressure have 19 readings at common times"):
        read(tmp_path, rig_of(), {"force": force, "position": way})


@pytest.mark.parametrize(
    ("side", "force_n", "pressure_pa", "wanted"),
    [
        ("head", 0.3, 0.0, 0.3),
        ("head", 0.0, 900.0, HEAD_M2 * 900.0),
        ("rod", 0.0, 900.0, ROD_M2 * 900.0),
        ("rod", 0.3, 1500.0, np.hypot(0.3, ROD_M2 * 1500.0)),
    ],
)
def test_noise_of_force_and_load(
    side: str, force_n: float, pressure_pa: float, wanted: float, tmp_path: Path
) -> None:
    n = 4000
    rng = np.random.default_rng(8)
    time = 0.01 * np.arange(n)
    columns = {
        "time": time,
        "position": 0.02 + 0.015 * np.sin(time),
        "pressure": 3e5 + pressure_pa * rng.standard_normal(n),
        "other": 1e5,
        "force": 30.0 + force_n * rng.standard_normal(n),
    }
    found = read(tmp_path, rig_of(side), columns)
    assert found.noise_n == pytest.approx(wanted, rel=0.06)


def test_findings_that_channels_share_are_told_once(tmp_path: Path) -> None:
    time = TIME_S.copy()
    time[30:] += 1.0  # of every channel alike
    found = read(tmp_path, rig_of(), {"time": time, "other": 1e5})
    assert [f for f in found.findings if ": gap" in f] and len(found.findings) == 2
    names, kind, _ = found.findings[0].split(": ", 2)
    assert kind == "frozen (60)" and names == "other_pressure"
    names, kind, _ = found.findings[1].split(": ", 2)
    assert set(names.split(", ")) == {"pressure", "force", "position", "other_pressure"}
    assert kind == "gap (1)"
