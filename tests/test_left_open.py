# SPDX-License-Identifier: Apache-2.0
"""What a calibration left open of a robot is no change of it; what it knew is."""

from pathlib import Path

import pytest

from pneu_sim.rig.load import load_rig
from pneu_sim.rig.schema import AttachedEffect, Calibration, FitParameter, Rig
from pneu_sysid.left_open import left_open

FRICTION = "cylinders.forearm.friction."


@pytest.fixture
def robot() -> Rig:
    """A Kokoro whose seals are known to half a newton, and to a hundredth of their speeds."""
    rig = load_rig(Path(__file__).parent.parent / "rigs" / "kokoro.yaml")
    known = {"breakaway_n": 0.5, "stribeck_m_s": 0.005, "coulomb_n": 0.5, "viscous_n_s_m": 2.0}
    parameters = [
        FitParameter(path=FRICTION + name, lower=0.0, upper=100.0, std=1.0, std_error=error)
        for name, error in known.items()
    ]
    parameters.append(
        FitParameter(
            path="valves.head.ports.supply.conductance_m3_s_pa",
            lower=1e-9,
            upper=1e-8,
            std=1e-9,
            std_error=5e-10,
        )
    )
    rig.fit.parameters = parameters
    rig.calibration = Calibration(recording="before", rmse_pa={}, noise_floor_pa={})
    return rig


def with_effect(rig: Rig, effect: str, place: str, **values: float) -> Rig:
    attached = AttachedEffect(effect=effect, place=place, parameters=values)
    return rig.model_copy(update={"effects": [*rig.effects, attached]})


@pytest.mark.parametrize(
    ("effect", "values", "is_open"),
    [
        ("piston_stiction", {"force_n": 0.9, "stribeck_m_s": 0.01}, True),
        ("piston_stiction", {"force_n": 1.1, "stribeck_m_s": 0.01}, False),
        ("piston_stiction", {"force_n": 0.9, "stribeck_m_s": 0.09}, False),
        ("piston_friction", {"force_n": 0.9}, True),
        ("piston_friction", {"force_n": 1.1}, False),
        # Numbers that no calibration told.
        ("piston_leak", {"area_m2": 1e-12}, False),
        ("seal_friction", {"force_n_per_pa": 1e-9}, False),
    ],
)
def test_within_two_standard_errors(
    robot: Rig, effect: str, values: dict[str, float], is_open: bool
) -> None:
    assert left_open(with_effect(robot, effect, "forearm", **values)) is is_open


def test_only_the_last_effect_is_judged(robot: Rig) -> None:
    first = with_effect(robot, "piston_friction", "forearm", force_n=5.0)
    assert not left_open(first)
    assert left_open(
        with_effect(first, "piston_stiction", "forearm", force_n=0.9, stribeck_m_s=0.01)
    )


def test_a_robot_that_was_never_calibrated_leaves_nothing_open(robot: Rig) -> None:
    robot.calibration = None
    assert not left_open(with_effect(robot, "piston_friction", "forearm", force_n=0.1))


def test_lines_are_judged_by_their_predictions_alone(robot: Rig) -> None:
    """Conductance and bore are told together: each alone is known far less well."""
    opened = with_effect(robot, "flow_gain", "head.supply", error=0.01)
    assert not left_open(opened)
