# SPDX-License-Identifier: Apache-2.0
"""Every number that a fit may change has a unit, and it is that of the rig file's key."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import pytest
from pydantic import BaseModel

from pneu_sim.effects import registry
from pneu_sim.rig import load_rig
from pneu_sim.rig.plausible import RANGES
from pneu_sim.rig.schema import AttachedEffect, Calibration, FitParameter, Rig
from pneu_sysid.command.fit_result import fit_result
from pneu_sysid.parameter_units import (
    ENCODER,
    JOINT,
    PURE,
    strength_unit,
    unit_of_name,
    unit_of_parameter,
)
from pneu_sysid.parameters import calibrated_parameters

RIGS = sorted((Path(__file__).parents[3] / "rigs").glob("*.yaml"))
NOT_OF_THE_RIG = {"Fit", "FitParameter", "Calibration", "TextFormat", "Channel"}
"""Parts of a rig file that say how it is recorded and fitted."""
NO_UNIT_IN_THE_NAME = {
    "area_profile", "newton_iterations", "order", "pneu_rig", "masses_kg", *JOINT,
    *ENCODER,
}  # fmt: skip


def parts_of(kind: type[BaseModel], found: dict[str, type[BaseModel]]) -> None:
    """The kinds of parts that a rig file is made of, by name."""
    if kind.__name__ in found or kind.__name__ in NOT_OF_THE_RIG:
        return
    found[kind.__name__] = kind
    todo: list[Any] = [field.annotation for field in kind.model_fields.values()]
    while todo:
        one = todo.pop()
        if isinstance(one, type) and issubclass(one, BaseModel):
            parts_of(one, found)
        todo += get_args(one)


def is_number(annotation: Any) -> bool:
    return annotation in (float, int) or any(is_number(one) for one in get_args(annotation))


def test_every_number_of_the_schema_has_a_unit() -> None:
    kinds: dict[str, type[BaseModel]] = {}
    parts_of(Rig, kinds)
    assert len(kinds) > 15
    for kind in kinds.values():
        for name, field in kind.model_fields.items():
            if name in NO_UNIT_IN_THE_NAME or name in ("parameters", "recordings"):
                continue  # parameters of effects, values of recordings: by paths of their own
            if is_number(field.annotation):
                assert unit_of_name(name) is not None, f"{kind.__name__}.{name}"
                pure = name in PURE
                assert (unit_of_name(name) == "1") == pure


@pytest.mark.parametrize("path", RIGS, ids=lambda path: path.stem)
def test_every_parameter_of_the_example_rigs_has_a_unit(path: Path) -> None:
    rig = load_rig(path)
    for p in calibrated_parameters(rig):
        assert unit_of_parameter(rig, p.path) is not None, p.path


def test_units_are_those_that_a_rig_file_is_checked_for() -> None:
    for name, known in RANGES.items():
        unit = (unit_of_name(name) or "").replace("^", "")
        assert unit == (known.unit or "1"), name


def test_units_of_paths() -> None:
    rig = load_rig(RIGS[0])
    leak = {"area_m2": 1e-8, "position_m": 1.0}
    rig.effects = [AttachedEffect(effect="leak", place=next(iter(rig.pipes)), parameters=leak)]
    for path, unit in {
        "valves.valve.ports.supply.conductance_m3_s_pa": "m^3/(s Pa)",
        "valves.valve.ports.supply.opening.fraction.3": "1",
        "valves.valve.spool.max_acceleration_v_s2": "V/s^2",
        "pipes.*.wall.roughness_m": "m",
        "pipes.tube.losses.0.k": "1",
        "pipes.tube.losses.0.resistance_pa_s_m": "Pa s/m",
        "reservoirs.supply.temperature_k": "K",
        "effects.0.parameters.area_m2": "m^2, effective",
        "effects.7.parameters.position_m": "m",
        "effects.*.parameters.area_m2": "m^2",
        "effects.0.parameters.lag_s": "s",
        "pipes.tube.area_profile.0.1": None,
    }.items():
        assert unit_of_parameter(rig, path) == unit, path


def test_units_of_a_joint_are_those_of_its_motion() -> None:
    rig = load_rig(next(path for path in RIGS if path.stem == "cart_pole"))
    for path, unit in {
        "bodies.cart_pole.slide.viscous": "N s/m",
        "bodies.cart_pole.pole.viscous": "N m s/rad",
        "bodies.cart_pole.cart_kg": "kg",
        "cylinders.cart.friction.coulomb_n_per_pa": "N/Pa",
        "cylinders.cart.head.dead_volume_m3": "m^3",
    }.items():
        assert unit_of_parameter(rig, path) == unit, path


def test_the_result_of_a_fit_carries_units() -> None:
    rig = load_rig(RIGS[0]).model_copy(deep=True)
    paths = ["valves.valve.spool.bandwidth_hz", "pipes.*.wall.unsteady"]
    known = SimpleNamespace(
        at_bound=[False, False],
        seen=[True, True],
        held=[False, False],
        condition=1.0,
        correlation=np.eye(2),
    )
    outcome = SimpleNamespace(
        rig=SimpleNamespace(
            calibration=Calibration(recording="bag", rmse_pa={}, noise_floor_pa={}),
            name="rig",
            taps={},
            encoders={},
            effects=rig.effects,
        ),
        parameters=[FitParameter(path=path, lower=0.0, upper=100.0) for path in paths],
        values=[50.0, 1.0],
        start=[60.0, 1.0],
        known=known,
        shortfall=None,
        warnings=[],
        estimate=SimpleNamespace(history=[]),
    )
    result: Any = fit_result("rig.yaml", None, [], outcome)  # type: ignore[arg-type]
    assert [p["unit"] for p in result.as_dict()["parameters"]] == ["Hz", "1"]


@pytest.mark.parametrize(
    ("file", "effect", "place", "unit"),
    [
        ("kokoro", "backlash", "elbow", "rad"),
        ("kokoro", "encoder_bias", "elbow", "rad"),
        ("cart_pole", "backlash", "cart", "m"),
        ("cart_pole", "external_spring", "cart", "N/m"),
        ("cart_pole", "external_spring", "pole", "N m/rad"),
        ("rig_a", "leak", "tube", "m^2, effective"),
    ],
)
def test_strengths_have_the_unit_of_their_place(
    file: str, effect: str, place: str, unit: str
) -> None:
    """Not of what turns and of what slides, both at once."""
    rig = load_rig(next(path for path in RIGS if path.stem == file))
    assert strength_unit(rig, registry()[effect], place) == unit
    for other in registry().values():
        for at in other.places(rig):
            assert " or " not in strength_unit(rig, other, at)
            values = {p.name: p.typical for p in other.parameters}
            attached = AttachedEffect(effect=other.name, place=at, parameters=values)
            having = rig.model_copy(update={"effects": [attached]})
            for p in other.parameters:  # as the table of a fit tells them, one unit each
                told = unit_of_parameter(having, f"effects.0.parameters.{p.name}")
                assert told in p.unit.split(" or ")
