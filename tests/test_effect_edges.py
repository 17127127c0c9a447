# SPDX-License-Identifier: Apache-2.0
"""Effects at the edges of their strengths: none is the rig unchanged, and order does not count."""

from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.bodies.kokoro import Kokoro
from pneu_sim.bodies.link import Link
from pneu_sim.effects import apply_to_rig, registry
from pneu_sim.plant import Plant
from pneu_sim.rig import load_rig
from pneu_sim.rig.build import build
from pneu_sim.rig.cylinder import Cushion
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sim.run import run_from_rest

RIGS = Path(__file__).parents[1] / "rigs"
ROOM = 101325.0


def rig_of(name: str) -> Rig:
    return load_rig(RIGS / f"{name}.yaml")


def with_effects(rig: Rig, *effects: tuple[str, str, dict[str, float]]) -> Rig:
    attached = [AttachedEffect(effect=e, place=p, parameters=v) for e, p, v in effects]
    return rig.model_copy(update={"effects": attached})


def with_effect(rig: Rig, effect: str, place: str, **values: float) -> Rig:
    return with_effects(rig, (effect, place, values))


def seen(
    rig: Rig, commands: dict[str, NDArray[np.float64]], dt: float = 5e-3
) -> NDArray[np.float64]:
    out = run_from_rest(rig, commands, dt)
    return np.array(list(out.taps.values()))


def strokes() -> dict[str, NDArray[np.float64]]:
    head = np.r_[np.full(10, 5.0), np.full(70, 9.0), np.full(60, 1.0)]
    return {"head": head, "rod": 10.0 - head}


def steps() -> dict[str, NDArray[np.float64]]:
    levels = np.random.default_rng(1).choice([2.0, 3.5, 5.0, 6.5, 8.0], 12)
    return {"voltage": np.repeat(levels, 8)}


@pytest.mark.parametrize("length", [0.06, 0.01])
def test_a_cushion_that_vanishes_leaves_that_of_the_rig(length: float) -> None:
    rig = rig_of("rail")
    rig.cylinders["cart"].rod.cushion = Cushion(length_m=0.06, opening=0.05)
    slight = with_effect(rig, "end_cushion", "cart.rod", K=1e-9, length_m=length)
    assert np.abs(seen(slight, strokes()) - seen(rig, strokes())).max() < 0.1


def test_a_cushion_throttles_the_more_the_stronger_it_is_and_adds_to_that_of_the_rig() -> None:
    """In series: the throttles' heads add up where both are at their ends."""
    rig = rig_of("rail")
    plain = seen(rig, strokes())
    felt = [
        np.abs(
            seen(with_effect(rig, "end_cushion", "cart.rod", K=k, length_m=0.05), strokes()) - plain
        ).max()
        for k in (10.0, 100.0, 1000.0)
    ]
    assert 0.0 < felt[0] < felt[1] < felt[2]
    # an opening of 1 / sqrt(1 + K) at the end, as a cushion of the rig and as an effect
    cushioned = rig.model_copy(deep=True)
    cushioned.cylinders["cart"].rod.cushion = Cushion(length_m=0.05, opening=1.0 / 101.0**0.5)
    effect = with_effect(rig, "end_cushion", "cart.rod", K=100.0, length_m=0.05)
    assert np.abs(seen(effect, strokes()) - seen(cushioned, strokes())).max() < 1.0


@pytest.mark.parametrize("loose", [0.1, 0.3])
def test_play_that_vanishes_leaves_the_loose_mass_of_the_rig(loose: float) -> None:
    rig = rig_of("rail")
    rig.bodies["cart"].slide.play, rig.cylinders["cart"].loose_kg = 0.004, 0.1  # type: ignore
    wave = 3.0 * np.sign(np.sin(2.0 * np.pi * 6.0 * 5e-3 * np.arange(120) + 0.1))
    fro = {"head": 5.0 + wave, "rod": 5.0 - wave}
    slight = with_effect(rig, "backlash", "cart", width=1e-9, loose_kg=loose)
    assert np.abs(seen(slight, fro) - seen(rig, fro)).max() < 50.0


def test_convection_that_vanishes_stirs_nothing() -> None:
    rig = Rig.model_validate(
        {
            "name": "tank",
            "reservoirs": {"supply": {"pressure_pa": 7e5}, "room": {"pressure_pa": ROOM}},
            "chambers": {"tank": {"volume_m3": 2e-4, "convection_m2": 0.03}},
            "valves": {
                "v": {
                    **{"kind": "3/3", "command": "u", "supply": "supply", "outlet": "tank"},
                    **{"exhaust": "room", "conductance_m3_s_pa": 2e-8},
                }
            },
            "commands": {"u": {}},
            "taps": {"t": {"chamber": "tank"}},
        }
    )
    fill = {"u": np.r_[np.full(10, 5.0), np.full(40, 9.0), np.full(50, 5.0)]}
    plain = seen(rig, fill)
    for area, most in ((0.0, 0.0), (1e-9, 0.1)):
        slight = with_effect(rig, "chamber_convection", "tank", area_m2=area, inlet_m=5e-3)
        assert np.abs(seen(slight, fill) - plain).max() <= most
    clear = with_effect(rig, "chamber_convection", "tank", area_m2=0.03, inlet_m=5e-3)
    assert np.abs(seen(clear, fill) - plain).max() > 1e3


def test_laminar_drag_can_be_taken_away_and_turbulent_drag_stays() -> None:
    rig = rig_of("rig_a")
    nearly, wholly = (
        seen(with_effect(rig, "laminar_friction", "tube", gain=g), steps()) for g in (-0.99999, -1)
    )
    assert np.abs(nearly - wholly).max() < 10.0
    smooth = rig.model_copy(deep=True)
    smooth.pipes["tube"].wall.laminar = 0.0
    plain = seen(smooth, steps())
    for effect, values in (
        ("turbulent_friction", {"gain": 1.0}),
        ("roughness", {"height_m": 1e-4}),
    ):
        assert (
            np.abs(seen(with_effect(smooth, effect, "tube", **values), steps()) - plain).max() > 1e3
        )


@pytest.mark.parametrize("lag", [1e-9, 2e-5, 1e-4])
def test_a_slower_spool_comes_from_one_that_follows_at_once(lag: float) -> None:
    """A short lag acts as a delay of the same length does."""
    rig = rig_of("rig_a")
    rig.valves["valve"].spool.bandwidth_hz = None
    plain = seen(rig, steps())
    slow = seen(with_effect(rig, "spool_bandwidth", "valve", lag_s=lag), steps()) - plain
    late = seen(with_effect(rig, "valve_delay", "valve", delay_s=1e-4), steps()) - plain
    acts = 1e-4 * float((slow * late).sum() / (late * late).sum())
    assert acts == pytest.approx(lag, rel=0.05, abs=1e-7)


def test_a_length_counts_whatever_else_is_attached_before_or_after() -> None:
    rig = rig_of("rig_a")
    effects = (
        ("length_error", "tube", {"error": 0.2}),
        ("leak", "tube", {"area_m2": 2e-8, "position_m": 1.5}),
        ("local_loss", "tube", {"K": 30.0, "position_m": 0.5}),
    )
    first, *others = (seen(with_effects(rig, *order), steps()) for order in permutations(effects))
    for other in others:
        np.testing.assert_array_equal(first, other)
    (leak,) = apply_to_rig(with_effects(rig, *effects)).pipes["tube"].leaks
    assert leak.position_m == pytest.approx(1.2 * 1.5)


def test_an_early_clock_is_refused_where_a_plant_is_stepped() -> None:
    late, early = (
        with_effect(rig_of("rig_a"), "clock_offset", "end", offset_s=s) for s in (3e-3, -3e-3)
    )
    Plant([late]).refuse_early_clocks()
    with pytest.raises(InputError, match=r"clock of 'end': found 3 ms early; .* give the other"):
        Plant([early]).refuse_early_clocks()


@pytest.mark.parametrize(("tip", "rod"), [(0.2, 0.0), (0.0, 0.3), (0.2, 0.3)])
def test_the_centre_of_a_link_moves_as_far_as_is_asked_and_its_inertia_stays(
    tip: float, rod: float
) -> None:
    link = Link(length_m=0.3, tip_kg=tip, mass_kg=rod)
    mass, centre = link.total_kg, link.first_moment_kg_m / link.total_kg
    own = link.second_moment_kg_m2 - mass * centre**2
    link.shift_centre(0.02)
    assert link.total_kg == pytest.approx(mass)
    assert link.first_moment_kg_m / mass == pytest.approx(centre + 0.02)
    assert link.second_moment_kg_m2 == pytest.approx(own + mass * (centre + 0.02) ** 2)


def test_a_joint_with_its_own_inertia_keeps_that_about_its_centre() -> None:
    body = rig_of("kokoro").bodies
    (joint,) = (b for b in body.values() if isinstance(b, Kokoro))
    mass, centre, inertia = joint.mass_kg, joint.centre_m, joint.theta_inertia_kg_m2
    joint.shift_centre("theta", 0.03)
    assert joint.centre_m == pytest.approx(centre + 0.03)
    own = inertia - mass * centre**2
    assert joint.theta_inertia_kg_m2 == pytest.approx(own + mass * (centre + 0.03) ** 2)


def test_a_load_on_a_slide_has_no_distance_to_fit() -> None:
    effect = registry()["payload"]
    assert effect.fitted(rig_of("rail"), "cart") == ()
    assert [p.name for p in effect.fitted(rig_of("kokoro"), "elbow")] == ["distance_m"]


def test_a_blower_little_above_the_room_is_a_source() -> None:
    """The room is the reservoir of its pressure as the file is read, or the one that says so."""
    rig = rig_of("ventilator")
    assert {name: r.room for name, r in rig.reservoirs.items()} == {"blower": False, "room": True}
    assert registry()["supply_level"].places(rig) == ["blower"]
    assert registry()["regulator_droop"].places(rig) == ["blower"]
    moved = apply_to_rig(with_effect(rig, "ambient_pressure", "room", offset_pa=-2e3))
    pressures = {name: r.pressure_pa for name, r in moved.reservoirs.items()}
    assert pressures == {"blower": 105800.0, "room": 99325.0}
    low = {s["set_pa"] for _, s in registry()["relief_valve"].sites(rig)}
    assert all(ROOM < pressure < 105800.0 for pressure in low)
    # a fit that moves the room's own pressure does not make a source of it
    rig.reservoirs["room"].pressure_pa += 1e4
    assert registry()["supply_level"].places(rig) == ["blower"]
    assert load_rig_of(rig).reservoirs["room"].room


def load_rig_of(rig: Rig) -> Rig:
    return Rig.model_validate(rig.dump())


@pytest.mark.parametrize("name", ["rig_a", "ventilator"])
def test_a_file_says_nothing_of_the_room_that_its_pressure_says(name: str) -> None:
    for reservoir in rig_of(name).dump()["reservoirs"].values():
        assert "room" not in reservoir


def valve_of(**more: object) -> Rig:
    """A tank filled and emptied through one valve."""
    return Rig.model_validate(
        {
            "name": "tank",
            "reservoirs": {"supply": {"pressure_pa": 7e5}, "room": {"pressure_pa": ROOM}},
            "chambers": {"tank": {"volume_m3": 2e-4}},
            "valves": {
                "v": {
                    **{"command": "u", "supply": "supply", "outlet": "tank", "exhaust": "room"},
                    **{"conductance_m3_s_pa": 2e-8, **more},
                }
            },
            "commands": {"u": {}},
            "taps": {"t": {"chamber": "tank"}},
        }
    )


def opening(rig: Rig, port: str, volts: float) -> float:
    """Opening of a path where the spool stands, as the model has it."""
    model, spool = build(rig), rig.valves["v"].spool
    q = model.plan.port_names.index(f"v.{port}")
    away = volts - spool.null_v
    x = spool.null_v + np.sign(away) * max(abs(away) - spool.dead_band_v, 0.0)
    at = np.linspace(*model.curve_v[q], model.curve.shape[1])
    return float(np.interp(x, at, model.curve[q]))


@pytest.mark.parametrize("recovered", [0.0, 1.0])
def test_an_overlap_of_a_port_that_opens_by_a_power_is_closed_too(recovered: float) -> None:
    """Below its first point such a curve goes on to null: the overlap moves null as well."""
    rig = valve_of(kind="3/3", command_v=[0.0, 10.0])
    measured = type(rig.valves["v"].ports["supply"].opening)(
        voltage_v=[5.1, 6.0, 10.0], fraction=[0.004, 0.1, 1.0], interpolation="power"
    )
    rig.valves["v"].ports["supply"].opening = measured
    wide = with_effect(rig, "dead_band", "v", width_v=0.25, recovered=recovered)
    left = (5.0 - 0.25 * recovered) / 5.0
    for volts in (5.0, 5.1, 5.2, 5.25):
        assert opening(wide, "supply", volts) == 0.0
    for volts in (5.02, 5.1, 5.5, 7.0, 9.5):
        there = 5.0 + left * (volts - 5.0) + 0.25
        assert opening(wide, "supply", there) == pytest.approx(opening(rig, "supply", volts), 2e-3)


def test_an_overlap_of_a_closed_centre_takes_its_width_on_both_sides() -> None:
    rig = valve_of(kind="3/3", command_v=[0.0, 10.0])
    rig.valves["v"].ports["exhaust"].opening = type(rig.valves["v"].ports["supply"].opening)(
        voltage_v=[0.0, 5.0], fraction=[1.0, 0.0]
    )
    wide = with_effect(rig, "dead_band", "v", width_v=1.0)
    for volts in (2.0, 3.9, 4.5, 5.0, 5.5, 6.1, 8.0):
        assert opening(wide, "supply", volts) == pytest.approx(max(volts - 6.0, 0.0) / 5.0)
        assert opening(wide, "exhaust", volts) == pytest.approx(max(4.0 - volts, 0.0) / 5.0)


def test_an_overlap_closes_a_path_that_is_open_at_the_centre_sooner() -> None:
    rig = valve_of(kind="3/3", command_v=[0.0, 10.0], centre="exhausted", overlap_v=2.0)
    wide = with_effect(rig, "dead_band", "v", width_v=0.5)
    for volts in np.linspace(0.0, 10.0, 41):
        assert opening(wide, "exhaust", volts) == pytest.approx(
            opening(rig, "exhaust", volts + 0.5)
        )
        assert opening(wide, "supply", volts) == pytest.approx(opening(rig, "supply", volts - 0.5))


def test_an_overlap_of_a_switched_valve_leaves_no_path_open_for_ever() -> None:
    rig = valve_of(kind="3/2")
    switch = rig.valves["v"].switch
    assert switch is not None
    wide = with_effect(rig, "dead_band", "v", width_v=1.0)
    between = np.linspace(switch.off_v, switch.on_v, 97)
    for one in (rig, wide):
        ways = [[opening(one, port, v) for v in between] for port in one.valves["v"].ports]
        for way in ways:
            assert min(way) == 0.0 and max(way) > 0.8
    both = [
        sum(min(opening(one, port, v) for port in one.valves["v"].ports) for v in between)
        for one in (rig, wide)
    ]
    assert both[1] <= both[0]  # never more open to both sides


def test_a_valve_that_regulates_has_no_overlap_and_a_duty_has_bounds_of_its_own() -> None:
    regulated = valve_of(kind="regulator", low_pa=2e5, high_pa=6e5)
    assert registry()["dead_band"].places(regulated) == []
    assert registry()["null_offset"].places(regulated) == ["v"]
    effect = registry()["null_offset"]
    rig = rig_of("ventilator")
    for valve in rig.valves:
        low, high = effect.limits(effect.strength, rig, valve)
        assert -0.5 < low < 0.0 < high < 0.5


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("leak", {"area_m2": 1e-7}),
        ("porous_leak", {"porous_m3": 1e-15}),
        ("relief_valve", {"area_m2": 1e-7, "set_pa": 3e5, "range_pa": 2e4}),
        ("wall_compliance", {"compliance_per_pa": 1e-7}),
    ],
)
def test_lines_that_are_part_of_a_vessel_act_on_it(effect: str, values: dict[str, float]) -> None:
    """As they do at the vessel itself: the thin-plate model has no pressure drop along them."""
    rig = rig_of("rail").model_copy(update={"model": "thin_plate"})
    found = registry()[effect]
    pipe = next(iter(found.places(rig)))
    names = {p.name for p in found.parameters}
    given = {k: v for k, v in values.items() if k in names}
    assert len(given) == len(values), names
    if found.has_position:
        given["position_m"] = 0.5 * rig.pipes[pipe].length_m
    plain = seen(rig, strokes())
    assert np.abs(seen(with_effect(rig, effect, pipe, **given), strokes()) - plain).max() > 200.0
