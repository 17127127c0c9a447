# SPDX-License-Identifier: Apache-2.0
"""Rigs whose pistons move a mechanism in MuJoCo, beside the same body solved in the kernel."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_sim.bodies.rail import Rail
from pneu_sim.plant import Plant
from pneu_sim.rig.load import load_rig, save_rig
from pneu_sim.rig.schema import Rig
from pneu_sim.simulator import Simulator

pytest.importorskip("mujoco", reason="MuJoCo is an extra of the package")

ROOT = Path(__file__).resolve().parents[3]
ARM = ROOT / "rigs" / "arm4.yaml"


def cylinder(**more: Any) -> dict[str, Any]:
    """A cylinder shut at both ends."""
    side = {"node": "closed", "dead_volume_m3": 2e-6}
    return {"bore_m": 0.025, "stroke_m": 0.1, "head": side, "rod": side, **more}


def in_kernel(**more: Any) -> Rig:
    """A mass on a rail, solved in the kernel."""
    body = {"kind": "rail", "cylinder": "c", "mass_kg": 1.0, "incline_rad": 0.5 * math.pi}
    body["slide"] = {"start": 0.06, "name": "slide"}
    return Rig.model_validate(
        {"pneu_rig": 1, "name": "r", "grid": {"dx_m": 0.05},
         "cylinders": {"c": cylinder(**more)}, "bodies": {"b": body}}
    )  # fmt: skip


def in_mujoco(folder: Path, step_s: float, coupling: str = "second_order", **more: Any) -> Rig:
    """The same mass as MJCF."""
    body = Rail(kind="rail", cylinder="c", mass_kg=1.0, incline_rad=0.5 * math.pi)
    path = folder / "rail.xml"
    path.write_text(body.mjcf())
    return Rig.model_validate(
        {"pneu_rig": 1, "name": "r", "grid": {"dx_m": 0.05},
         "cylinders": {"c": cylinder(**more)},
         "mechanism": {
             "mjcf": str(path), "step_s": step_s, "coupling": coupling,
             "start": {"slide": 0.06}, "cylinders": {"c": {"joint": "slide"}},
         }}
    )  # fmt: skip


def swing(rig: Rig) -> np.ndarray:
    """Where the mass is while it swings, every 10 ms."""
    simulator = Simulator(rig)
    simulator.reset({"c.head": 4e5, "c.rod": 3e5})
    return simulator.run(0.3, {}, 0.01).joints["slide"]


def test_a_mass_in_mujoco_swings_as_the_one_in_the_kernel(tmp_path: Path) -> None:
    reference = swing(in_kernel())
    amplitude = np.ptp(reference)
    assert amplitude > 0.005
    errors = {}
    for coupling in ("thesis", "second_order"):
        for step_s in (2e-3, 1e-3):
            x = swing(in_mujoco(tmp_path, step_s, coupling))
            errors[coupling, step_s] = np.max(np.abs(x - reference)) / amplitude
    assert errors["second_order", 1e-3] < 4e-3
    order = math.log2(errors["second_order", 2e-3] / errors["second_order", 1e-3])
    assert order > 1.8
    assert errors["thesis", 1e-3] > 5.0 * errors["second_order", 1e-3]


def test_friction_and_springs_of_cylinders_reach_the_mechanism(tmp_path: Path) -> None:
    more: dict[str, Any] = {
        "friction": {"coulomb_n": 4.0, "viscous_n_s_m": 5.0, "coulomb_n_per_pa": 1e-5},
        "spring_n_m": 300.0,
        "spring_preload_n": 5.0,
    }
    reference = swing(in_kernel(**more))
    x = swing(in_mujoco(tmp_path, 5e-4, **more))
    np.testing.assert_allclose(x, reference, atol=0.02 * np.ptp(reference))


def test_gas_in_cells_moves_a_mechanism_too(tmp_path: Path) -> None:
    more = {"gas": "cells", "dx_m": 0.01}
    reference = swing(in_kernel(**more))
    x = swing(in_mujoco(tmp_path, 1e-3, **more))
    np.testing.assert_allclose(x, reference, atol=0.01 * np.ptp(reference))


def test_any_cutting_and_a_state_put_back_give_the_same_bits() -> None:
    rig = load_rig(ARM)

    def ends(cuts: list[int]) -> np.ndarray:
        plant = Plant([rig, rig])
        volts = 5.0 + np.array([[1.0, -1.0, 2.0, -2.0]]).T[None] * np.ones((1, 4, 30))
        done = 0
        for n in cuts:
            series, _ = plant.advance(volts[:, :, done : done + n], 2e-3)
            done += n
        return np.concatenate([series.joints[-1].ravel(), series.taps[-1].ravel()])

    whole = ends([30])
    np.testing.assert_array_equal(ends([4, 1, 25]), whole)
    plant = Plant([rig, rig])
    volts = 5.0 + np.array([[1.0, -1.0, 2.0, -2.0]]).T[None] * np.ones((1, 4, 30))
    plant.advance(volts[:, :, :10], 2e-3)
    kept = plant.state()
    plant.advance(volts[:, :, 10:], 2e-3)
    plant.set_state(kept)
    series, _ = plant.advance(volts[:, :, 10:], 2e-3)
    again = np.concatenate([series.joints[-1].ravel(), series.taps[-1].ravel()])
    np.testing.assert_array_equal(again, whole)


def test_friction_by_pressure_comes_back_with_a_state_and_is_forgotten_by_a_reset(
    tmp_path: Path,
) -> None:
    friction = {"coulomb_n": 1.0, "coulomb_n_per_pa": 2e-5}
    simulator = Simulator(in_mujoco(tmp_path, 1e-3, friction=friction))
    runs = []
    for _ in range(2):
        simulator.reset({"c.head": 4e5, "c.rod": 3e5})
        runs.append(simulator.run(0.05, {}, 1e-3).joints["slide"])
    np.testing.assert_array_equal(runs[0], runs[1])
    kept = simulator.plant.state()
    first = simulator.run(0.05, {}, 1e-3).joints["slide"]
    fresh = Simulator(in_mujoco(tmp_path, 1e-3, friction=friction))
    fresh.plant.set_state(kept)
    np.testing.assert_array_equal(fresh.run(0.05, {}, 1e-3).joints["slide"], first)


def test_the_arm_follows_its_valves_and_stays_within_its_strokes() -> None:
    rig = load_rig(ARM)
    simulator = Simulator(rig)
    shut = dict.fromkeys(rig.commands, 5.0)
    out = simulator.run(1.0, {**shut, "boom": 8.0, "stick": 8.0}, 2e-3)
    # both cylinders push: boom up, stick folded in
    assert out.joints["shoulder"][-1] > out.joints["shoulder"][0] + 0.5
    assert out.joints["elbow"][-1] < out.joints["elbow"][0] - 0.5
    for name, part in rig.cylinders.items():
        x = out.extensions[name]
        assert x.min() > -2e-3 and x.max() < part.stroke + 2e-3
    # what the gas has and what MuJoCo has are one
    at = simulator.plant.solver.mechanism.extension()[:, 0]  # type: ignore[attr-defined]
    np.testing.assert_allclose([x[-1] for x in out.extensions.values()], at, atol=1e-12)


def test_a_saved_rig_finds_its_mjcf_again(tmp_path: Path) -> None:
    rig = load_rig(ARM)
    (tmp_path / "deep").mkdir()
    save_rig(rig, tmp_path / "deep" / "rig.yaml")
    assert load_rig(tmp_path / "deep" / "rig.yaml") == rig


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"mjcf": "none.xml"}, "none.xml"),
        ({"cylinders": {"c": {"joint": "missing"}}}, "missing"),
        ({"start": {"slide": 0.2}}, "found an extension of 0.2 m at the start"),
        ({"step_s": 3e-3}, "whole number of steps"),
    ],
)
def test_what_does_not_fit_is_said_in_one_sentence(
    tmp_path: Path, change: dict[str, Any], told: str
) -> None:
    rig = in_mujoco(tmp_path, 1e-3)
    rig.mechanism = rig.mechanism.model_validate(  # type: ignore[union-attr]
        {**rig.mechanism.model_dump(exclude_none=True), **change}  # type: ignore[union-attr]
    )
    with pytest.raises(InputError, match=told) as error:
        Simulator(rig).run(0.01, {}, 0.01)
    assert "\n" not in str(error.value)


def test_an_mjcf_that_does_not_compile_is_said_in_one_sentence(tmp_path: Path) -> None:
    rig = in_mujoco(tmp_path, 1e-3)
    (tmp_path / "rail.xml").write_text("<mujoco><worldbody><body></worldbody></mujoco>")
    with pytest.raises(InputError, match=r"rail\.xml") as error:
        Simulator(rig)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("soft_m_n", "damping_n_s_m"), [(1e-4, 5.0), (3e-5, 20.0)])
def test_presliding_in_mujoco_is_that_of_the_body_in_the_kernel(
    tmp_path: Path, soft_m_n: float, damping_n_s_m: float
) -> None:
    """Seals that are soft before they slide, and those that are not."""
    rigid: dict[str, Any] = {"friction": {"coulomb_n": 30.0}}
    soft = {"presliding_m_n": soft_m_n, "presliding_n_s_m": damping_n_s_m}
    bristles = {"friction": rigid["friction"] | soft}
    wanted = swing(in_kernel(**bristles))
    effect = np.ptp(wanted - swing(in_kernel(**rigid)))
    assert effect > 1e-4
    for step_s in (1e-3, 5e-4):
        found = swing(in_mujoco(tmp_path, step_s, **bristles))
        hard = swing(in_mujoco(tmp_path, step_s, **rigid))
        assert np.ptp(found - hard) == pytest.approx(effect, rel=0.01)
