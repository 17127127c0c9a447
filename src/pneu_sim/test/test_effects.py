# SPDX-License-Identifier: Apache-2.0
"""Every effect of the catalogue: what it declares, how it is refused, how it adds up."""

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_sim.effects import POSITION, Effect, registry
from pneu_sim.effects.document import as_markdown, as_table
from pneu_sim.effects.registry import BUILT_IN
from pneu_sim.rig import Rig, load_rig
from pneu_sim.rig.build import build
from pneu_sim.rig.plan import plan_grid
from pneu_sim.rig.schema import AttachedEffect, Chamber, Pipe
from pneu_sim.simulate import even_course, initial_field, predict

pytestmark = pytest.mark.takes(20)

HOUSE = Path(__file__).parents[3]
DT_S = 0.002
NOISE_PA = 250.0
NOISE_RAD = 0.25e-3
EFFECTS = [kind() for kind in BUILT_IN]


@pytest.fixture(scope="module")
def rig() -> Rig:
    """Rig A on a coarse grid."""
    rig = load_rig(HOUSE / "rigs" / "rig_a.yaml")
    rig.grid.dx_m = 0.1
    return rig


def with_chamber(rig: Rig) -> Rig:
    """The rig with a bottle at the end of its tube."""
    copy = rig.model_copy(deep=True)
    copy.pipes["tube"].to_node = "bottle"
    copy.chambers["bottle"] = Chamber(volume_m3=2e-5)
    return copy


def attach(rig: Rig, effect: str, place: str, **parameters: float) -> Rig:
    """A copy of the rig with one more effect."""
    copy = rig.model_copy(deep=True)
    attached = AttachedEffect(effect=effect, place=place, parameters=parameters)
    copy.effects = [*copy.effects, attached]
    return copy


def exciting_command() -> np.ndarray:
    """Steps both ways between holds, wide and narrow openings."""
    volts = [7.5, 5, 3, 5, 10, 5, 0, 5.6, 5, 4.5, 5, 9, 2, 6.2, 5, 4, 5.4, 5]
    hold_s = [30, 50, 30, 30, 50, 80, 50, 80, 30, 100, 50, 40, 30, 80, 100, 80, 100, 50]
    return np.repeat(volts, [round(1e-3 * h / DT_S) for h in hold_s])


def readings(base: Rig, rigs: list[Rig]) -> np.ndarray:
    """(rigs, samples, sensors) readings along the exciting command, on the base rig's grid.

    In deviations of the sensors' noise.
    """
    plan = plan_grid(base)
    command = exciting_command()
    commands = {"voltage": command}
    first = [635e3, 3e5, 3e5, 3e5, 101e3]
    if base.moves:  # the two valves against each other, gently; from end to end of a short stroke
        short = min(c.stroke for c in base.cylinders.values()) < 0.02
        swing = 5.0 + (0.6 if short else 0.15) * (np.roll(command, 100) - 5.0)
        commands = {"head": swing, "rod": 10.0 - swing}
        first = [3e5, 3e5, 3.5e5, 3.5e5, 0.0]
    models = [build(r, plan) for r in rigs]
    field = initial_field(base, plan)
    course = even_course(field, commands, DT_S, np.tile(first, (command.size, 1)))
    noise = np.array([NOISE_PA] * len(base.taps) + [NOISE_RAD] * len(base.encoders))
    return np.moveaxis(predict([models], [course], field)[0].readings, 1, 2) / noise


def with_junction(rig: Rig) -> Rig:
    """The rig with a blind branch at the end of its tube, and a stub to its tap there."""
    copy = rig.model_copy(deep=True)
    copy.pipes["tube"].to_node = "tee"
    for name, length_m in (("branch", 1.0), ("stub", 0.2)):
        copy.pipes[name] = Pipe.model_validate(
            {"from": "tee", "to": "closed", "length_m": length_m, "area_m2": 6e-6}
        )
    return copy


def with_limits(rig: Rig) -> Rig:
    """The rig with a spool at its limits: before they are reached, a change of them is nothing."""
    copy = rig.model_copy(deep=True)
    copy.valves["valve"].spool.max_speed_v_s = 200.0
    copy.valves["valve"].spool.max_acceleration_v_s2 = 1e5
    return copy


KOKORO = load_rig(HOUSE / "rigs" / "kokoro.yaml")


def robot() -> Rig:
    """A joint that a cylinder turns, on a coarse grid; its seals give way before they slide."""
    rig = KOKORO.model_copy(deep=True)
    rig.grid.dx_m = 0.25
    friction = rig.cylinders["forearm"].friction
    friction.presliding_m_n, friction.presliding_n_s_m = 1e-5, 300.0
    return rig


def short_robot() -> Rig:
    """The joint with a cylinder so short that its piston is always near both ends."""
    rig = robot()
    cylinder, arm = rig.cylinders["forearm"], rig.bodies["arm"]
    cylinder.stroke_m = 0.014
    arm.slider.closed_length_m = math.hypot(0.160, 0.035) - 0.5 * cylinder.stroke_m  # type: ignore[union-attr]
    arm.joints[1].lower, arm.joints[1].upper = -0.17, 0.17
    return rig


def base_for(effect: Effect, rig: Rig) -> Rig:
    """Rig A, or the same with what an effect needs to have a place and to be felt."""
    if effect.name in ("spool_speed_limit", "spool_acceleration_limit"):
        return with_limits(rig)
    if effect.name == "end_cushion":
        return short_robot()
    candidates = (rig, with_chamber(rig), with_junction(rig), robot())
    return next(base for base in candidates if effect.places(base))


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_declaration_is_complete(effect: Effect, rig: Rig) -> None:
    for text in (effect.title, effect.where, effect.formula, effect.source):
        assert text.strip()
    assert effect.next_experiment.endswith(".")
    assert len(effect.next_experiment.split()) > 8
    names = [p.name for p in effect.parameters]
    assert len(set(names)) == len(names)
    for p in effect.parameters:
        assert p.lower <= p.absent <= p.upper
        assert p.lower <= p.typical
        assert p.unit
        assert 0.0 < p.step < abs(p.typical - p.absent) or p is not effect.strength
    p = effect.strength
    # Room on the scale for three times what is typical, and small steps for sensitivities.
    assert p.absent + 3.0 * (p.typical - p.absent) <= p.upper
    assert 0.015 <= p.step / abs(p.typical - p.absent) <= 0.06
    base = base_for(effect, rig)
    assert effect.places(base)
    for place, shape in effect.sites(base):
        assert place in effect.places(base)
        assert set(shape) == set(names[1:])
        if POSITION in shape:
            assert 0.0 <= shape[POSITION] <= base.pipes[place].length_m


def test_names_are_unique_and_every_file_is_registered() -> None:
    names = [e.name for e in EFFECTS]
    assert len(set(names)) == len(names)
    folder = HOUSE / "src" / "pneu_sim" / "pneu_sim" / "effects"
    helpers = {"__init__", "base", "document", "places", "proof", "registry"}
    assert {path.stem for path in folder.glob("*.py")} - helpers == set(names)


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_attached_twice_adds_up(effect: Effect, rig: Rig) -> None:
    base = base_for(effect, rig)
    p = effect.strength
    place, shape = list(effect.sites(base))[-1]
    quarter, half = (p.absent + share * (p.typical - p.absent) for share in (0.25, 0.5))
    once = attach(base, effect.name, place, **{**shape, p.name: quarter})
    twice = attach(once, effect.name, place, **{**shape, p.name: quarter})
    direct = attach(base, effect.name, place, **{**shape, p.name: half})
    none, two, one = readings(base, [base, twice, direct])
    assert np.linalg.norm(two - one) < 0.1 * np.linalg.norm(one - none)


def test_short_pipes_are_tried_in_the_middle_only(rig: Rig) -> None:
    tried = [shape[POSITION] for place, shape in registry()["leak"].sites(rig) if place != "tube"]
    # the supply line has ten cells, the exhaust tube two
    assert tried == pytest.approx([0.0, 0.25, 0.5, 0.75, 1.0, 0.1])


def test_the_room_is_not_offered_as_a_regulator(rig: Rig) -> None:
    for name in ("regulator_droop", "supply_level", "supply_temperature"):
        assert registry()[name].places(rig) == ["supply"]


def test_the_rig_itself_stays_as_it_was(rig: Rig) -> None:
    before = rig.model_dump_json()
    for effect in EFFECTS:
        for place, shape in effect.sites(rig, spacing_m=10.0):
            typical = {**shape, effect.strength.name: effect.strength.typical}
            build(attach(rig, effect.name, place, **typical))
    assert rig.model_dump_json() == before


@pytest.mark.parametrize(
    ("effect", "place", "parameters", "sentence"),
    [
        ("lek", "tube", {}, "effect 'lek' is unknown; known are"),
        ("leak", "tub", {POSITION: 1.0}, "place 'tub' is not one of supply_line, tube, exhaust_t"),
        ("leak", "tube", {POSITION: 1.0, "area": 1.0}, "unknown parameter 'area'"),
        ("leak", "tube", {"area_m2": 1e-8}, "parameter 'position_m' is missing"),
        ("leak", "tube", {POSITION: 3.0}, "position_m: found 3, allowed is 0 to 2.5 m"),
        ("leak", "tube", {POSITION: 1.0, "area_m2": -1e-8}, "area_m2: found -1e-08, allowed is 0"),
        ("blockage", "tube", {POSITION: 1.0, "fraction": 1.2}, "fraction: found 1.2"),
    ],
)
def test_wrong_attachments_are_refused_in_one_sentence(
    rig: Rig, effect: str, place: str, parameters: dict[str, float], sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence) as caught:
        build(attach(rig, effect, place, **parameters))
    assert "\n" not in str(caught.value)


def test_the_page_is_up_to_date() -> None:
    page = (HOUSE / "docs" / "effects.md").read_text(encoding="utf-8")
    assert page == as_markdown(), "run python -m pneu_sim.effects.document > docs/effects.md"


def test_the_page_prints_alone() -> None:
    command = [sys.executable, "-m", "pneu_sim.effects.document"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == as_markdown()


def test_table_lists_all_effects_or_those_of_a_rig(rig: Rig) -> None:
    everything = {row.name: row for row in as_table()}
    assert set(everything) >= {e.name for e in EFFECTS}
    mine = {row.name: row for row in as_table(rig)}
    assert "chamber_leak" not in mine  # rig A has no chamber
    assert mine["leak"].where == "supply_line, tube, exhaust_tube"
    assert mine["leak"].shape == POSITION


def test_an_arm_is_a_fitted_parameter_that_is_never_nothing() -> None:
    armed = [effect for effect in registry().values() if effect.arm]
    assert armed
    for effect in armed:
        arm = next(p for p in effect.parameters if p.name == effect.arm)
        assert arm.fitted and arm.lower > 0.0
        assert effect.strength.absent == 0.0
