# SPDX-License-Identifier: Apache-2.0
"""Rig files with cylinders and bodies on the command line: checked, simulated, recorded."""

from __future__ import annotations

import csv
import importlib.metadata
import math
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML
from typer.testing import CliRunner

from pneu_common.cli import COMMANDS_GROUP, build_app
from pneu_common.errors import InputError
from pneu_graph.bag.reader import BagReader
from pneu_sim.init import TEMPLATES
from pneu_sim.rig.cylinder import Cylinder
from pneu_sim.rig.load import load_rig
from pneu_sim.rig.schema import HORIZON_MOVING_S, HORIZON_S, Calibration, Rig
from pneu_sim.run import run_from_rest, run_rig

SEALED = {"node": "closed", "dead_volume_m3": 1e-8}
BORE_M, STROKE_M, MASS_KG = 0.025, 0.1, 1.0
SPRING: dict[str, Any] = {  # a mass between two sealed columns of air: nothing to command or sense
    "pneu_rig": 1,
    "name": "spring",
    "grid": {"dx_m": 0.07, "dt_s": 5e-5},
    "cylinders": {
        "c": {"bore_m": BORE_M, "stroke_m": STROKE_M, "head": SEALED, "rod": SEALED},
        "d": {"bore_m": 0.02, "rod_m": 0.01, "stroke_m": 0.05, "head": SEALED},
    },
    "bodies": {"b": {"kind": "rail", "cylinder": "c", "mass_kg": MASS_KG,
                     "slide": {"start": 0.051}}},
}  # fmt: skip

Run = Callable[..., Any]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Runs `pneu` in an empty folder."""
    monkeypatch.chdir(tmp_path)
    entry = importlib.metadata.EntryPoint("sim", "pneu_sim.commands:register", COMMANDS_GROUP)
    return lambda *words: CliRunner().invoke(build_app([entry]), words, prog_name="pneu")


def written(rig: dict[str, Any]) -> str:
    YAML(typ="safe").dump(rig, Path("rig.yaml"))
    return "rig.yaml"


def changed(**changes: Any) -> dict[str, Any]:
    """The gas spring with changes, keys of a way joined by two underscores."""
    rig = deepcopy(SPRING)
    for key, value in changes.items():
        *way, last = key.split("__")
        part = rig
        for step in way:
            part = part[step]
        part[last] = value
    return rig


def refusal(result: Any) -> str:
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith("pneu: ") and result.stderr.count("\n") == 1
    return str(result.stderr)


# ---- pneu check ----------------------------------------------------------------------------------


def test_check_shows_cylinders_and_bodies(run: Run) -> None:
    rig = changed(
        grid={"dx_m": 0.02},
        pipes={"line": {"from": "h", "to": "closed", "length_m": 0.5, "area_m2": 5e-6}},
        cylinders={
            "c": {**SPRING["cylinders"]["c"], "rod_m": 0.008, "gas": "cells",
                  "piston_leak_m2": 1e-9, "head": {**SEALED, "dead_volume_m3": 1e-5},
                  "rod": {**SEALED, "dead_volume_m3": 1e-5},
                  "friction": {"coulomb_n": 3.0, "breakaway_n": 2.0, "viscous_n_s_m": 40.0}},
            "vane": {"rotary": {"displacement_m3_rad": 5e-6, "stroke_rad": 1.5},
                     "head": {"node": "h", "dead_volume_m3": 1e-6,
                              "port_conductance_m3_s_pa": 1e-9, "cushion": {"length_m": 0.1}}},
        },
        bodies={"cart": {"kind": "cart_pole", "cylinder": "c", "cart_kg": 1.0,
                         "rod": {"length_m": 0.5, "tip_kg": 0.1}, "slide": {"start": 0.05},
                         "pole": {"name": "rod", "start": 3.0, "upper": 3.1}}},
    )  # fmt: skip
    result = run("check", written(rig))
    assert result.exit_code == 0, result.stderr
    out = " ".join(result.stdout.replace("│", " ").split())
    assert "25 cells in 1 pipes" in out  # those of cylinders are no pipe's
    # 0.1 m and dead volumes of 20.4 and 22.7 mm in cells of 20 mm
    for told in ("bore 25 mm,", "100 mm", "up to 6 + 6", "10 + 10 cm3", "3 N, 2 N more", "40 N/("):
        assert told in out, told
    assert "piston 0.001 mm2" in out
    assert "5 cm3/rad 1.5 rad chamber h, throttled," in out and "nothing: locked" in out
    assert "cart cart_pole cart_slide 0.05 m none c" in out
    assert "rod 3 rad up to 3.1" in out


TWO: dict[str, Any] = {"kind": "rail", "cylinder": "d", "mass_kg": 1.0}
REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "rod as thick as the bore": (
        changed(cylinders__d__rod_m=0.02),
        "cylinders.d: rod_m: found 0.02, it must be smaller than bore_m 0.02",
    ),
    "bore in mm": (changed(cylinders__c__bore_m=25.0), "cylinders.c.bore_m: found 25 m, allowed"),
    "stroke shorter than a cell": (
        changed(cylinders__c__gas="cells", cylinders__c__dx_m=0.2),
        "cylinders.c: found a stroke of 0.1 m, shorter than a cell of 0.2 m",
    ),
    "start of a cylinder": (
        changed(cylinders__d__start_m=0.06),
        "cylinders.d: start_m: found 0.06, beyond its stroke of 0.05",
    ),
    "start of a body": (
        changed(bodies__b__slide={"start": 0.2}),
        "bodies.b: found slide.start 0.2, which put cylinder 'c' at an extension of 0.2; its stroke"
        " allows 0 to 0.1",
    ),
    "start of one of several joints": (
        changed(bodies__b={"kind": "kokoro", "theta_cylinder": "c", "theta_inertia_kg_m2": 0.02,
                           "mass_kg": 1.0, "centre_m": 0.1,
                           "slider": {"pivot_m": 0.16, "crank_m": 0.06, "closed_length_m": 0.11},
                           "theta": {"start": 1.5}}),
        "bodies.b: found alpha.start 0, theta.start 1.5, which put cylinder 'c' at",
    ),
    "no such cylinder": (
        changed(bodies__b__cylinder="x"),
        "bodies.b: found cylinder 'x', which is not among cylinders (c, d)",
    ),
    "two bodies on one cylinder": (
        changed(bodies__two={**TWO, "cylinder": "c"}),
        "bodies.two: found cylinder 'c', which moves bodies.b already",
    ),
    "two joints of one name": (
        changed(bodies__two={**TWO, "slide": {"name": "b_slide"}}),
        "bodies.two.slide.name: found 'b_slide', which another joint is named already",
    ),
    "a joint like another's velocity": (
        changed(bodies__two={**TWO, "slide": {"name": "b_slide_velocity"}}),
        "bodies.two.slide.name: found 'b_slide_velocity', beside which a joint and another's",
    ),
    "one node for two sides": (
        changed(cylinders__c__head={**SEALED, "node": "n"},
                cylinders__d__head={**SEALED, "node": "n"}),
        "cylinders.d.head.node: 'n' is the node of another side already",
    ),
    "a side that nothing meets": (
        changed(cylinders__c__head={**SEALED, "node": "lonely"}),
        "cylinders.c.head.node: found 'lonely', which no pipe, valve port, orifice or tap names",
    ),
    "a cushion without a way out": (
        changed(cylinders__c__head={**SEALED, "cushion": {"length_m": 0.01}}),
        "cylinders.c.head: a cushion needs a way out: node closed has none",
    ),
    "a cushion without a pipe": (
        changed(cylinders__c__head={**SEALED, "node": "lonely", "cushion": {"length_m": 0.01}}),
        "cylinders.c.head.node: found 'lonely', where no pipe ends; a cushion throttles",
    ),
    "no such kind": (
        changed(bodies__b__kind="train"),
        "bodies.b: kind: found 'train', allowed are 'rail',",
    ),
    "no kind": (changed(bodies__b={"cylinder": "c"}), "bodies.b: kind is needed"),
    "a key that a body has not": (
        changed(bodies__b__mas_kg=1.0),
        "unknown key 'bodies.b.mas_kg'; did you mean 'mass_kg'?",
    ),
    "a lumped model": (
        changed(model="delay_line"),
        "model: found delay_line, which moves no cylinders; allowed are pde, thin_plate",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("rig", "said"), REFUSED.values(), ids=list(REFUSED))
def test_what_cannot_be_is_refused_in_one_line_with_file_and_field(
    run: Run, rig: dict[str, Any], said: str
) -> None:
    line = refusal(run("check", written(rig)))
    assert line.startswith("pneu: rig.yaml: ") and said in line


TURNING = {"rotary": {"displacement_m3_rad": 5e-6, "stroke_rad": 1.5}, "head": SEALED}
PLAIN = {"bore_m": 0.02, "stroke_m": 0.05, "head": SEALED}
THROTTLED = {"node": "h", "dead_volume_m3": 1e-6, "port_conductance_m3_s_pa": 1e-9}
UNPORTED = {"node": "h", "dead_volume_m3": 1e-6, "cushion": {"length_m": 0.02}}
ALLOWED: list[dict[str, Any]] = [
    TURNING,
    {**TURNING, "rod_m": 0.0, "heat_w_m2_k": 0.0, "gas": "chamber", "start_m": 1.5},
    {**TURNING, "head": {**THROTTLED, "cushion": {"length_m": 1.5}}},
    PLAIN,
    {**PLAIN, "rod": UNPORTED},
    {**PLAIN, "rod_m": 0.0199, "start_m": 0.05, "heat_w_m2_k": 3.0, "gas": "cells"},
    {"bore_m": 0.02, "stroke_m": 0.05, "rod": {**THROTTLED, "cushion": {"length_m": 0.05}}},
    {**PLAIN, "gas": "cells", "rod": {**THROTTLED, "cushion": {"length_m": 0.02}}},
]
BOTH = "give either rotary or bore_m, rod_m and stroke_m, not both"
UNSOUND: list[tuple[dict[str, Any], str]] = [
    ({**TURNING, "bore_m": 0.02}, BOTH),
    ({**TURNING, "rod_m": 0.01}, BOTH),
    ({**TURNING, "stroke_m": 0.05}, BOTH),
    ({**TURNING, "heat_w_m2_k": 0.5}, "heat_w_m2_k: the wall of a rotary one is not known"),
    ({**TURNING, "gas": "cells"}, "gas: found cells, the gas of a rotary one is a chamber"),
    ({**TURNING, "start_m": 1.6}, "start_m: found 1.6, beyond its stroke of 1.5"),
    ({"bore_m": 0.02, "head": SEALED}, "bore_m and stroke_m are needed"),
    ({"stroke_m": 0.05, "head": SEALED}, "bore_m and stroke_m are needed"),
    ({**PLAIN, "rod_m": 0.02}, "rod_m: found 0.02, it must be smaller than bore_m 0.02"),
    ({"bore_m": 0.02, "stroke_m": 0.05}, "head or rod is needed"),
    ({**TURNING, "head": {**THROTTLED, "cushion": {"length_m": 1.6}}},
     "head.cushion.length_m: found 1.6, beyond the stroke of 1.5"),
    ({**PLAIN, "rod": {**THROTTLED, "cushion": {"length_m": 0.06}}},
     "rod.cushion.length_m: found 0.06, beyond the stroke of 0.05"),
    ({**PLAIN, "gas": "cells", "rod": UNPORTED},
     "rod.cushion: needs rod.port_conductance_m3_s_pa where gas is cells"),
]  # fmt: skip


@pytest.mark.parametrize("document", ALLOWED)
def test_what_a_cylinder_may_be_up_to_its_limits(document: dict[str, Any]) -> None:
    assert Cylinder.model_validate(document).stroke == (1.5 if "rotary" in document else 0.05)


@pytest.mark.parametrize(("document", "said"), UNSOUND)
def test_numbers_of_a_cylinder_that_exclude_each_other(document: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError) as refused:
        Cylinder.model_validate(document)
    [error] = refused.value.errors()
    assert error["msg"].startswith(f"Value error, {said}")


def test_a_sealed_side_may_have_a_node_for_its_tap(run: Run) -> None:
    rig = changed(cylinders__c__head={**SEALED, "node": "n"}, taps={"gauge": {"chamber": "n"}})
    assert run("check", written(rig)).exit_code == 0


@pytest.mark.parametrize("given", [None, 0.5, 0.15, 0.3, "null"])
def test_what_moves_is_predicted_less_far_unless_the_file_says_how_far(given: Any) -> None:
    """So it stands in a file that is written, too, and in a calibration whatever it is."""
    fit = {} if given is None else {"fit": {"horizon_s": None if given == "null" else given}}
    rig = Rig.model_validate(deepcopy(SPRING) | fit)
    wanted = HORIZON_MOVING_S if given is None else rig.fit.horizon_s
    assert rig.fit.horizon_s == wanted
    assert Rig.model_validate(rig.dump()).fit.horizon_s == wanted
    assert ("fit" in rig.dump()) == (given not in (None, HORIZON_MOVING_S))
    calibration = Calibration(recording="bag", rmse_pa={}, noise_floor_pa={})
    calibrated = rig.model_copy(update={"calibration": calibration})
    assert calibrated.dump()["fit"]["horizon_s"] == wanted
    still = Rig.model_validate({k: v for k, v in deepcopy(SPRING).items() if k != "bodies"})
    assert still.fit.horizon_s == HORIZON_S and "fit" not in still.dump()


def test_the_delay_line_says_that_it_moves_nothing(tmp_path: Path) -> None:
    """Rigs that programs build are not read from a file; they learn it when they are run."""
    path = tmp_path / "rig.yaml"
    YAML(typ="safe").dump(SPRING, path)
    rig = load_rig(path).model_copy(update={"model": "delay_line"})
    with pytest.raises(InputError, match="found delay_line, which moves no bodies; use pde"):
        run_from_rest(rig, {}, 1e-3, 10)


@pytest.mark.parametrize("model", ["pde", "thin_plate", "delay_line"])
def test_a_locked_cylinder_fills_as_a_chamber_of_its_volume(model: str) -> None:
    path = Path(__file__).resolve().parents[3] / "rigs" / "valve_flow.yaml"
    rig = load_rig(path).model_copy(update={"model": model})
    side = rig.cylinders["locked"].head
    assert side is not None
    volume = side.dead_volume_m3 + 0.1 * 0.25 * math.pi * 0.025**2
    chamber = {"volume_m3": volume, "heat_w_per_k": side.heat_w_per_k}
    twin = Rig.model_validate({**rig.dump(), "cylinders": {}, "chambers": {"cylinder": chamber}})
    volts = {name: np.where(np.arange(150) < 5, 5.0, 10.0) for name in rig.commands}
    filled, same = (run_rig(one, volts, 2e-3)["cylinder"] for one in (rig, twin))
    assert filled[-1] > 2e5
    np.testing.assert_allclose(filled, same, rtol=2e-3)  # heat of a wall is stepped in another way
    in_cells = rig.model_copy(deep=True)
    in_cells.cylinders["locked"] = in_cells.cylinders["locked"].model_copy(update={"gas": "cells"})
    if model != "pde":
        with pytest.raises(InputError, match=r"cylinders\.locked\.gas: found cells"):
            run_rig(in_cells, volts, 2e-3)


# ---- pneu simulate -------------------------------------------------------------------------------


def table(path: Path) -> dict[str, np.ndarray]:
    rows = list(csv.reader(path.open()))
    return dict(zip(rows[0], np.array(rows[1:], dtype=float).T, strict=True))


def test_a_weight_swings_on_two_columns_of_air(run: Run) -> None:
    """About where its weight m g presses it, with k = 2 gamma p A^2 / V; no command and no tap."""
    mass_kg = 0.1
    upright = {"mass_kg": mass_kg, "incline_rad": math.pi / 2, "slide": {"start": 0.5 * STROKE_M}}
    rig = changed(bodies__b={**SPRING["bodies"]["b"], **upright})
    words = ("simulate", "--rig", written(rig), "-o", "out.csv")
    assert "--duration: found none, needed is one, since rig 'spring' has no" in refusal(
        run(*words)
    )
    result = run(*words, "--duration", "0.15", "--rate", "1000", "--seed", "3")
    assert result.exit_code == 0, result.stderr
    assert "0 taps, 1 joints, 151 samples" in result.stdout
    seen = table(Path("out.csv"))
    assert list(seen) == ["time_s", "b_slide", "b_slide_velocity"]
    area = 0.25 * math.pi * BORE_M**2
    stiffness = 2.0 * 1.4 * 101325.0 * area**2 / (0.5 * STROKE_M * area + 1e-8)
    sag, omega = mass_kg * 9.80665 / stiffness, math.sqrt(stiffness / mass_kg)
    assert 3.5 < 0.15 * omega / (2.0 * math.pi) < 4.5  # turns of it
    turned = omega * seen["time_s"]
    expected = 0.5 * STROKE_M - sag * (1.0 - np.cos(turned))
    np.testing.assert_allclose(seen["b_slide"], expected, atol=0.01 * sag)
    np.testing.assert_allclose(
        seen["b_slide_velocity"], -sag * omega * np.sin(turned), atol=0.01 * sag * omega
    )


def test_joints_of_a_driven_rig_in_a_table_and_in_a_bag(run: Run, tmp_path: Path) -> None:
    rig = str(TEMPLATES / "cylinder.yaml")
    words = ("simulate", "--rig", rig, "--steps", "voltage=10:0.1,5:0.1", "--rate", "250", "-o")
    for output in ("out.csv", "bag", "one.mcap"):
        result = run(*words, output)
        assert result.exit_code == 0, result.stderr
        assert "2 taps, 1 joints, 51 samples" in result.stdout
    seen = table(Path("out.csv"))
    assert list(seen) == [
        "time_s", "voltage", "head", "rod", "load_slide", "load_slide_velocity",
    ]  # fmt: skip
    assert np.ptp(seen["load_slide"]) > 0.08
    store = get_typestore(Stores.ROS2_JAZZY)
    reader = BagReader(tmp_path / "bag")
    topics = {topic.name: topic for topic in reader.metadata.topics}
    assert topics["/joint_states"].type == "sensor_msgs/msg/JointState"
    states = [m for m in reader.messages() if m.topic == "/joint_states"]
    assert len(states) == 51
    for k, raw in enumerate(states):
        state: Any = store.deserialize_cdr(raw.data, "sensor_msgs/msg/JointState")
        stamp = state.header.stamp
        assert stamp.sec + 1e-9 * stamp.nanosec == pytest.approx(1.0 + seen["time_s"][k], abs=1e-9)
        assert (state.header.frame_id, list(state.name)) == ("cylinder", ["load_slide"])
        assert state.position[0] == pytest.approx(seen["load_slide"][k], rel=1e-8)
        assert state.velocity[0] == pytest.approx(seen["load_slide_velocity"][k], rel=1e-8)
        assert len(state.effort) == 0


def test_a_bag_of_joints_alone(run: Run, tmp_path: Path) -> None:
    result = run("simulate", "--rig", written(SPRING), "--duration", "0.01", "-o", "bag")
    assert result.exit_code == 0, result.stderr
    (topic,) = BagReader(tmp_path / "bag").metadata.topics
    assert (topic.name, topic.message_count) == ("/joint_states", 6)


@pytest.mark.parametrize("name", ["head", "voltage", "time_s"])
def test_a_joint_with_the_name_of_another_column_is_refused(run: Run, name: str) -> None:
    text = (TEMPLATES / "cylinder.yaml").read_text()
    text = text.replace("    slide:\n", f"    slide:\n      name: {name}\n")
    Path("rig.yaml").write_text(text)
    words = ("simulate", "--rig", "rig.yaml", "--steps", "voltage=10:0.01", "-o")
    line = refusal(run(*words, "out.csv"))
    assert f"out.csv: joint {name!r} of rig 'cylinder' would have the column {name!r}" in line
    assert not Path("out.csv").exists()
    assert run(*words, "bag").exit_code == 0


def test_a_channel_on_the_topic_of_the_joints_is_refused(run: Run) -> None:
    text = (TEMPLATES / "cylinder.yaml").read_text()
    Path("rig.yaml").write_text(text.replace("topic: /taps/rod", "topic: /joint_states"))
    words = ("simulate", "--rig", "rig.yaml", "--steps", "voltage=10:0.01", "-o", "bag")
    assert "bag: rod: topic '/joint_states' is that of the rig's joints" in refusal(run(*words))
    assert not Path("bag").exists()


def test_programs_see_joints_and_taps_as_the_simulator_has_them() -> None:
    rig = load_rig(TEMPLATES / "cylinder.yaml")
    volts = {"voltage": np.repeat([10.0, 5.0, 0.0], 20)}
    seen = run_from_rest(rig, volts, 2e-3)
    taps = run_rig(rig, volts, 2e-3)
    assert list(taps) == ["head", "rod"]
    assert all((seen.taps[name] == taps[name]).all() for name in taps)
    assert list(seen.joints) == list(seen.speeds) == ["load_slide"]
    assert seen.joints["load_slide"].shape == (60,)
