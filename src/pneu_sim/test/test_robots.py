# SPDX-License-Identifier: Apache-2.0
"""Robots whose gas, pistons and bodies are solved together: energy, MuJoCo's way, valves."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter

from pneu_common.errors import InputError
from pneu_sim.bodies import kinds
from pneu_sim.bodies.kinds import AnyBody
from pneu_sim.kernel.equations import kinds as equations
from pneu_sim.plant import Plant
from pneu_sim.rig.load import load_rig
from pneu_sim.rig.schema import Rig
from pneu_sim.simulator import Simulator

ROOT = Path(__file__).resolve().parents[3]

ARM = {
    "kind": "arm",
    "upper_arm": {"length_m": 0.3, "tip_kg": 0.6, "mass_kg": 0.3, "centre_m": 0.12},
    "forearm": {"length_m": 0.25, "tip_kg": 0.4},
    "shoulder_cylinder": "one",
    "shoulder_crank": {"pivot_m": [0.05, -0.2], "pin_m": [0.06, 0.01], "closed_length_m": 0.15},
    "elbow_cylinder": "two",
    "elbow_crank": {
        "pivot_m": [-0.25, 0.03], "pin_m": [0.05, 0.0], "closed_length_m": 0.21, "offset_rad": 1.2,
    },
    "shoulder": {"name": "shoulder", "start": 0.4},
    "elbow": {"name": "elbow", "start": 0.5},
}  # fmt: skip
SIDE = {"node": "closed", "dead_volume_m3": 5e-6}
SHUT = {"bore_m": 0.025, "stroke_m": 0.12, "head": SIDE, "rod": SIDE}


def arm_rig(dt_s: float, **more: Any) -> Rig:
    """The arm between four sealed gases."""
    return Rig.model_validate(
        {"pneu_rig": 1, "name": "arm", "grid": {"dx_m": 1.0, "dt_s": dt_s},
         "cylinders": {"one": SHUT, "two": SHUT}, "bodies": {"arm": {**ARM, **more}}}
    )  # fmt: skip


def energy_of(rig: Rig, name: str, q: np.ndarray, v: np.ndarray) -> float:
    """Kinetic and potential energy of a body."""
    body = rig.bodies[name]
    n = len(body.joints)
    par = np.array(body.numbers())[None, :, None]
    mass, force = np.zeros((n, n)), np.zeros(n)
    equations.mechanics(kinds.NUMBER[type(body)], par, 0, 0, q, v, mass, force)
    return float(0.5 * v @ mass @ v + body.potential_j(q))


def test_an_arm_between_gas_springs_keeps_its_energy_to_second_order() -> None:
    drifts = []
    for dt_s in (5e-4, 2.5e-4, 1.25e-4):
        rig = arm_rig(dt_s)
        simulator = Simulator(rig)
        simulator.reset({"one.head": 3e5, "one.rod": 2e5, "two.head": 2e5, "two.rod": 3e5})
        joints = ("shoulder", "elbow")
        room = 101325.0
        areas = {name: part.areas for name, part in rig.cylinders.items()}

        def total(q: np.ndarray, v: np.ndarray, x: dict[str, float]) -> float:
            against = sum(room * (a - b) * x[n] for n, (a, b) in areas.items())  # noqa: B023
            return simulator.energy_j() + energy_of(rig, "arm", q, v) + against  # noqa: B023

        start = np.array([0.4, 0.5])
        x0 = {n: float(x[0]) for n, x in simulator.run(dt_s, {}, dt_s).extensions.items()}
        simulator.reset({"one.head": 3e5, "one.rod": 2e5, "two.head": 2e5, "two.rod": 3e5})
        before = total(start, np.zeros(2), x0)
        out = simulator.run(0.2, {}, 0.2)
        q, v = (np.array([of[j][-1] for j in joints]) for of in (out.joints, out.speeds))
        after = total(q, v, {n: float(x[-1]) for n, x in out.extensions.items()})
        assert np.ptp(np.concatenate([q, start])) > 0.05  # it swings
        drifts.append(abs(after - before))
    assert drifts[-1] < 1e-4
    assert math.log2(drifts[0] / drifts[-1]) / 2.0 > 1.8


def test_an_arm_in_the_kernel_swings_as_its_twin_in_mujoco(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="MuJoCo is an extra of the package")
    rig = arm_rig(1e-4)
    body = TypeAdapter(AnyBody).validate_python(ARM)
    (tmp_path / "arm.xml").write_text(body.mjcf())
    lengths = {"one": ("shoulder", 0.15), "two": ("elbow", 0.21)}
    twin = Rig.model_validate(
        {"pneu_rig": 1, "name": "twin", "grid": {"dx_m": 1.0, "dt_s": 1e-4},
         "cylinders": {"one": SHUT, "two": SHUT},
         "mechanism": {
             "mjcf": str(tmp_path / "arm.xml"), "step_s": 5e-4,
             "start": {"shoulder": 0.4, "elbow": 0.5},
             "cylinders": {
                 name: {"tendon": f"{joint}_cylinder", "offset_m": closed}
                 for name, (joint, closed) in lengths.items()
             },
         }}
    )  # fmt: skip
    swings = []
    for one in (rig, twin):
        simulator = Simulator(one)
        simulator.reset({"one.head": 3e5, "one.rod": 2e5, "two.head": 2e5, "two.rod": 3e5})
        out = simulator.run(0.3, {}, 0.01)
        swings.append(np.array([out.joints["shoulder"], out.joints["elbow"]]))
    assert np.ptp(swings[0], axis=1).min() > 0.03
    np.testing.assert_allclose(swings[1], swings[0], atol=0.005 * np.ptp(swings[0]))


def test_kokoro_moves_by_its_valves_between_its_stops() -> None:
    rig = load_rig(ROOT / "rigs" / "kokoro.yaml")
    simulator = Simulator(rig)
    out = simulator.run(0.5, {"head": 10.0, "rod": 0.0}, 2e-3)
    assert out.joints["elbow"][-1] == pytest.approx(0.85, abs=0.01)
    simulator.reset()
    out = simulator.run(0.5, {"head": 0.0, "rod": 10.0}, 2e-3)
    assert out.joints["elbow"][-1] == pytest.approx(-0.85, abs=0.01)
    assert np.all(out.joints["shoulder"] == 0.0)
    # torque of the cylinder against the stop's: the chambers are at supply and room
    assert out.chambers["rod"][-1] == pytest.approx(635e3, rel=0.01)
    assert out.chambers["head"][-1] == pytest.approx(101e3, rel=0.01)


def test_rigs_side_by_side_move_as_each_alone() -> None:
    rig = load_rig(ROOT / "rigs" / "kokoro.yaml")
    heavy = rig.model_copy(deep=True)
    heavy.bodies["arm"].mass_kg = 1.5  # type: ignore[union-attr]
    volts = np.repeat([[[6.5], [3.5]]], 40, axis=2)
    both = Plant([rig, heavy]).advance(volts, 5e-3)[0]
    for j, one in enumerate((rig, heavy)):
        alone = Plant([one]).advance(volts, 5e-3)[0]
        np.testing.assert_array_equal(both.joints[..., j], alone.joints[..., 0])
    assert np.ptp(both.joints[-1, 1, 0]) > 0.0


def test_a_cushion_throttles_what_leaves_and_lets_in_what_enters() -> None:
    """Near the end the port passes its share of the sonic flow; inwards all of it."""
    side = {
        "node": "line", "dead_volume_m3": 1e-4, "port_conductance_m3_s_pa": 1e-9,
        "port_critical_ratio": 0.4, "cushion": {"length_m": 0.02, "opening": 0.1},
    }  # fmt: skip
    room = {"node": "closed", "dead_volume_m3": 1e-4}

    def flow(start_m: float, pressure: float, line: float) -> float:
        rig = Rig.model_validate(
            {"pneu_rig": 1, "name": "r", "grid": {"dx_m": 0.05},
             "reservoirs": {"tank": {"pressure_pa": line}},
             "pipes": {"p": {"from": "tank", "to": "line", "length_m": 0.2, "area_m2": 5e-5}},
             "cylinders": {"c": {"bore_m": 0.025, "stroke_m": 0.1, "head": side, "rod": room,
                                 "start_m": start_m}},
             "taps": {"t": {"pipe": "p", "position_m": 0.1}}}
        )  # fmt: skip
        simulator = Simulator(rig)
        simulator.reset({"c.head": pressure, "c.rod": 1e5, "p": line})
        return float(simulator.run(5e-3, {}, 1e-3).flows["c.head.port"][-1])

    sonic = 1e-9 * 1.185
    open_ = flow(0.05, 8e5, 1e5)
    assert open_ == pytest.approx(-sonic * 8e5, rel=0.03)
    assert flow(0.01, 8e5, 1e5) == pytest.approx(0.55 * open_, rel=0.02)
    assert flow(0.0, 8e5, 1e5) == pytest.approx(0.1 * open_, rel=0.03)
    assert flow(0.0, 1e5, 8e5) == pytest.approx(sonic * 8e5, rel=0.05)


def test_a_cushion_without_a_port_throttles_the_end_of_the_pipe() -> None:
    """What leaves a chamber passes the share of the pipe that is left, choked (ISO 6358's C)."""
    area, left = 5e-5, 0.05

    def flow(start_m: float, pressure: float, line: float) -> float:
        side = {"node": "line", "dead_volume_m3": 1e-2,
                "cushion": {"length_m": 0.02, "opening": left}}  # fmt: skip
        rig = Rig.model_validate(
            {"pneu_rig": 1, "name": "r", "grid": {"dx_m": 0.05},
             "reservoirs": {"tank": {"pressure_pa": line}},
             "pipes": {"p": {"from": "tank", "to": "line", "length_m": 0.2, "area_m2": area}},
             "cylinders": {"c": {"bore_m": 0.025, "stroke_m": 0.1, "head": side,
                                 "rod": {"node": "closed", "dead_volume_m3": 1e-4},
                                 "start_m": start_m}},
             "taps": {"t": {"pipe": "p", "position_m": 0.1}}}
        )  # fmt: skip
        simulator = Simulator(rig)
        simulator.reset({"c.head": pressure, "c.rod": 1e5, "p": line})
        simulator.run(0.01, {}, 1e-3)  # the line is steady then, and the chamber much as it was
        before = float(simulator.mass_kg())
        simulator.run(0.01, {}, 1e-3)
        return (before - float(simulator.mass_kg())) / 0.01

    def passed(share: float, pressure: float) -> float:
        r, t, g = 287.05, 293.15, 1.4
        choked = math.sqrt(g) * (2.0 / (g + 1.0)) ** ((g + 1.0) / (2.0 * (g - 1.0)))
        return share * area * pressure / math.sqrt(r * t) * choked

    shut = flow(0.0, 8e5, 1e5)
    assert shut == pytest.approx(passed(left, 8e5), rel=0.1)
    half = flow(0.01, 8e5, 1e5)
    assert half == pytest.approx(passed(0.5 * (1.0 + left), 8e5), rel=0.15)
    assert half < 0.8 * flow(0.05, 8e5, 1e5)
    assert flow(0.0, 1e5, 8e5) == pytest.approx(flow(0.05, 1e5, 8e5), rel=0.02)


def test_a_piston_beyond_its_stroke_is_refused() -> None:
    simulator = Simulator(arm_rig(1e-4))
    with pytest.raises(InputError, match=r"cylinders\.one: found an extension of .* past its"):
        simulator.plant.place({"shoulder": -1.49})
    with pytest.raises(InputError, match="no joint 'knee'"):
        simulator.plant.place({"knee": 0.0})


@pytest.mark.parametrize("gas", ["chamber", "cells"])
def test_a_side_has_its_names_however_its_gas_is_held(gas: str) -> None:
    rig = load_rig(ROOT / "rigs" / "kokoro.yaml")
    more = {"gas": gas, "dx_m": 0.01}
    rig.cylinders["forearm"] = rig.cylinders["forearm"].model_copy(update=more)
    simulator = Simulator(rig)
    area = rig.cylinders["forearm"].areas[0]
    for names in (("head", "rod"), ("forearm.head", "forearm.rod")):
        simulator.reset(dict(zip(names, (5e5, 1.01e5), strict=True)))
        out = simulator.run(1e-4, {"head": 5.0, "rod": 5.0}, 1e-4)
        assert out.forces["forearm"][-1] == pytest.approx((5e5 - 1.01e5) * area, rel=0.02)
    with pytest.raises(InputError, match=r"no pipe 'forearm\.head'"):
        simulator.state("forearm.head")


# ---- what a plant keeps --------------------------------------------------------------------------


def slider(gas: str, **more: Any) -> Rig:
    """A mass between two sealed gases."""
    cylinder = {**SHUT, "gas": gas, "dx_m": 0.01}
    body = {"kind": "rail", "cylinder": "c", "mass_kg": 1.0, "slide": {"start": 0.02, **more}}
    return Rig.model_validate(
        {"pneu_rig": 1, "name": "r", "cylinders": {"c": cylinder}, "bodies": {"b": body}}
    )


@pytest.mark.parametrize("gas", ["chamber", "cells"])
def test_volumes_come_back_with_a_state(gas: str) -> None:
    plant = Plant([slider(gas)])
    plant.reset({"c.head": 6e5, "c.rod": 1e5})
    kept, mass, energy = plant.state(), *(float(of[0]) for of in plant.solver.held())
    nothing = np.zeros((1, 0, 50))
    plant.advance(nothing, 1e-3)
    plant.set_state(kept)
    assert [float(of[0]) for of in plant.solver.held()] == [mass, energy]
    plant.place({"b_slide": 0.02})
    assert float(plant.solver.held()[0][0]) == pytest.approx(mass, rel=1e-12)
    force = plant.advance(nothing[:, :, :1], 1e-3)[0].cylinders[0, 0, 2, 0]
    areas = Rig.model_validate(slider(gas)).cylinders["c"].areas
    assert force == pytest.approx(6e5 * areas[0] - 1e5 * areas[1], rel=1e-9)


@pytest.mark.parametrize("gas", ["chamber", "cells"])
def test_a_place_that_is_refused_moves_nothing_and_its_own_place_is_neutral(gas: str) -> None:
    plant = Plant([slider(gas)])
    plant.reset({"c.head": 6e5, "c.rod": 1e5})
    plant.advance(np.zeros((1, 0, 7)), 1e-3)
    before = [part.copy() for part in plant.solver.state()]
    with pytest.raises(InputError, match="past its stroke"):
        plant.place({"b_slide": 0.5})
    for one, other in zip(plant.solver.state(), before, strict=True):
        np.testing.assert_array_equal(one, other)
    mass, energy = (float(of[0]) for of in plant.solver.held())
    plant.place({})
    assert [float(of[0]) for of in plant.solver.held()] == [mass, energy]


def test_a_joint_that_is_held_has_no_velocity() -> None:
    plant = Plant([slider("chamber", held=True)])
    plant.place({}, {"b_slide": 0.5})
    series, _ = plant.advance(np.zeros((1, 0, 20)), 1e-3)
    assert np.all(series.joints[:, 0, 0] == 0.02)


def test_rigs_that_move_otherwise_do_not_run_side_by_side() -> None:
    rig = slider("chamber")
    one_sided = {**SHUT, "head": None}
    other = Rig.model_validate({**rig.dump(), "cylinders": {"c": one_sided}})
    with pytest.raises(InputError, match="share one structure"):
        Plant([rig, other])
    loaded = load_rig(ROOT / "rigs" / "kokoro.yaml")
    with pytest.raises(InputError, match="share one structure"):
        Plant([loaded, loaded.model_copy(update={"bodies": {}, "encoders": {}})])


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"chambers": {"c.head": {"volume_m3": 1e-3}}}, "'c.head' is what its head side is called"),
        (
            {"cylinders": {"c": {
                "rotary": {"displacement_m3_rad": 1e-5, "stroke_rad": 1.0}, "head": SIDE,
                "heat_w_m2_k": 10.0,
            }}},
            "give heat_w_per_k",
        ),
        (
            {"cylinders": {"c": {**SHUT, "head": {
                **SIDE, "node": "n", "port_conductance_m3_s_pa": 1e-9,
                "cushion": {"length_m": 0.01, "opening": 0.0},
            }}}},
            "greater than 0",
        ),
    ],
)  # fmt: skip
def test_what_would_come_out_wrong_is_refused(change: dict[str, Any], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        Rig.model_validate({**slider("chamber").dump(), **change})


def test_cells_too_short_to_be_run_are_refused() -> None:
    tiny = {"node": "closed", "dead_volume_m3": 1e-12}
    rig = Rig.model_validate(
        {**slider("cells").dump(), "cylinders": {"c": {**SHUT, "gas": "cells", "head": tiny}}}
    )
    with pytest.raises(InputError, match="needs steps of"):
        Plant([rig])
