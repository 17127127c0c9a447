# SPDX-License-Identifier: Apache-2.0
"""Every effect against what physics expects of it, worked out by hand."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_sim import layout as L
from pneu_sim.effects import registry
from pneu_sim.gas import AIR
from pneu_sim.rig import Rig, load_rig
from pneu_sim.rig.build import build
from pneu_sim.rig.plan import plan_grid
from pneu_sim.rig.schema import AttachedEffect, Chamber, Opening
from pneu_sim.signals import Signal
from pneu_sim.simulate import Prediction, RunOptions, even_course, initial_field, predict
from pneu_sim.simulator import Simulator
from pneu_sim.valve import KNOTS_PER_SAMPLE, evenly_open

HOUSE = Path(__file__).parents[3]
DT_S = 0.002
SUPPLY_PA, ROOM_PA, ROOM_K = 635e3, 101e3, 293.15
SUPPLY, VALVE_OUT, MIDDLE, END, EXHAUST = range(5)
FILL, DRAIN = 0, 1  # ports of rig A
CHOKED = 0.0404149  # m sqrt(T) / (A p) of the isentropic orifice in air, K^0.5 s/m


def openings(model, commands, dt_s, knots=KNOTS_PER_SAMPLE):
    """Openings along commands that are held between samples, so many times per sample."""
    signals = {name: Signal(dt_s * np.arange(v.size), v) for name, v in commands.items()}
    count = (len(next(iter(commands.values()))) - 1) * knots + 1
    return evenly_open(model, signals, 0.0, dt_s / knots, count)


@pytest.fixture
def rig() -> Rig:
    """Rig A on a coarse grid, with a valve of straight openings."""
    rig = load_rig(HOUSE / "rigs" / "rig_a.yaml")
    rig.grid.dx_m = 0.1
    # Straight openings from null, so that what a voltage lets through is known.
    ports = rig.valves["valve"].ports
    ports["supply"].opening = Opening(voltage_v=[5.0, 10.0], fraction=[0.0, 1.0])
    ports["exhaust"].opening = Opening(voltage_v=[0.0, 5.0], fraction=[1.0, 0.0])
    return rig


@pytest.fixture
def bottle(rig: Rig) -> Rig:
    """Rig A with a bottle at the end of its tube."""
    rig.pipes["tube"].to_node = "bottle"
    rig.chambers["bottle"] = Chamber(volume_m3=1e-4)
    return rig


@pytest.fixture
def blow_through() -> Rig:
    """A choked orifice feeds a tube that is open to the room; two taps, 0.6 m apart."""
    return Rig.model_validate(
        {
            "name": "blow-through",
            "grid": {"dx_m": 0.05},
            "ambient": {"pressure_pa": ROOM_PA, "temperature_k": ROOM_K},
            "reservoirs": {"source": {"pressure_pa": 5e5}, "room": {"pressure_pa": ROOM_PA}},
            "pipes": {"tube": {"from": "in", "to": "room", "length_m": 1.0, "area_m2": 20e-6}},
            "orifices": {"jet": {"from": "source", "to": "in", "conductance_m3_s_pa": 1.5e-9}},
            "taps": {
                "near": {"pipe": "tube", "position_m": 0.2},
                "far": {"pipe": "tube", "position_m": 0.8},
            },
        }
    )


def attach(rig: Rig, effect: str, place: str, **parameters: float) -> Rig:
    """A copy of the rig with one more effect."""
    copy = rig.model_copy(deep=True)
    attached = AttachedEffect(effect=effect, place=place, parameters=parameters)
    copy.effects = [*copy.effects, attached]
    return copy


def run(
    rigs: list[Rig], volts: np.ndarray, start_pa: list[float], dt_s: float = DT_S
) -> Prediction:
    """Rolls rigs out from rest, all on the grid of the first."""
    plan = plan_grid(rigs[0])
    models = [build(r, plan) for r in rigs]
    commands = {name: volts for name in rigs[0].commands}
    start = np.tile(start_pa, (volts.size, 1))
    field = initial_field(rigs[0], plan)
    course = even_course(field, commands, dt_s, start)
    return predict([models], [course], field, None, RunOptions(flows=True))[0]


def rig_a(rigs: list[Rig], volts: np.ndarray, tube_pa: float = ROOM_PA) -> tuple[np.ndarray, ...]:
    """Readings (rigs, samples, taps) and port flows of rig A and its variants."""
    out = run(rigs, volts, [SUPPLY_PA, tube_pa, tube_pa, tube_pa, ROOM_PA])
    return np.moveaxis(out.readings, 1, 2), out.flows


def hold(volts: float, seconds: float, rest_s: float = 0.02) -> np.ndarray:
    """A closed valve for ``rest_s``, then a step that is held."""
    steps = [5.0] * round(rest_s / DT_S) + [volts] * round(seconds / DT_S)
    return np.array(steps)


def step_and_hold() -> np.ndarray:
    """Fill, closed, exhaust, closed."""
    return np.repeat([5.0, 8.0, 5.0, 2.0, 5.0], [10, 40, 50, 40, 50])


# --- valve ----------------------------------------------------------------------------------------


def test_delay_shifts_all_taps_by_itself(rig: Rig) -> None:
    late = attach(rig, "valve_delay", "valve", delay_s=2.0 * DT_S)
    (plain, delayed), _ = rig_a([rig, late], step_and_hold(), 3e5)
    np.testing.assert_allclose(delayed[2:], plain[:-2], rtol=1e-6)


def test_delay_shifts_closing_as_it_does_opening(rig: Rig) -> None:
    rig.valves["valve"].spool.closing_delay_s = 0.007
    late = attach(rig, "valve_delay", "valve", delay_s=2.0 * DT_S)
    plain, delayed = (openings(build(r), {"voltage": step_and_hold()}, DT_S) for r in (rig, late))
    shift = 2 * KNOTS_PER_SAMPLE
    np.testing.assert_allclose(delayed[shift:], plain[:-shift], atol=1e-9)


def test_slow_spool_lags_a_ramp_by_the_lag(rig: Rig) -> None:
    ramp = 5.0 + np.arange(500) * DT_S * 2.0  # 2 V/s over a port of 5 V
    for bandwidth in (60.0, None):
        rig.valves["valve"].spool.bandwidth_hz = bandwidth
        slow = attach(rig, "spool_bandwidth", "valve", lag_s=6e-3)
        plain, lagging = (openings(build(r), {"voltage": ramp}, DT_S)[:, FILL] for r in (rig, slow))
        behind = np.mean((plain - lagging)[-100 * KNOTS_PER_SAMPLE :])
        assert behind / (2.0 / 5.0) == pytest.approx(6e-3, rel=1e-3)


def test_limited_spool_takes_time_in_proportion_to_its_step(rig: Rig) -> None:
    rig.valves["valve"].spool.bandwidth_hz = None
    rig.valves["valve"].spool.max_speed_v_s = 500.0
    slow = attach(rig, "spool_speed_limit", "valve", slowness_s_v=6e-3)
    for volts in (1.0, 4.0):
        x = openings(build(slow), {"voltage": hold(5.0 + volts, 0.1)}, DT_S)[:, FILL]
        # On a ramp from 0 to the step the integral of what is missing is half its time.
        missing = 1.0 - x[10 * KNOTS_PER_SAMPLE :] / x[-1]
        late = float(np.trapezoid(missing)) * DT_S / KNOTS_PER_SAMPLE
        assert 2.0 * late == pytest.approx((6e-3 + 1.0 / 500.0) * volts, rel=0.05)


def test_limited_acceleration_takes_time_with_the_root_of_the_step(rig: Rig) -> None:
    spool = rig.valves["valve"].spool
    spool.bandwidth_hz, spool.max_acceleration_v_s2 = 2000.0, 4e4
    weak = attach(rig, "spool_acceleration_limit", "valve", inertia_s2_v=7.5e-5)
    for volts in (1.0, 4.0):
        # Until the command is met a spool far slower than its bandwidth falls freely: s = a t^2/2.
        command = np.append(5.0, np.full(20, 5.0 + volts))
        x = openings(build(weak), {"voltage": command}, DT_S, 64)[:, FILL]
        half = int(np.argmax(x > 0.5 * volts / 5.0)) / 64 * DT_S - DT_S
        assert half == pytest.approx(math.sqrt(volts / 1e4), rel=0.02)


@pytest.mark.parametrize(("own_s", "extra_s"), [(None, 0.008), (0.006, 0.008), (0.006, -0.004)])
def test_closing_delay_shifts_what_closes_and_not_what_opens(
    rig: Rig, own_s: float | None, extra_s: float
) -> None:
    spool = rig.valves["valve"].spool
    spool.bandwidth_hz, spool.delay_s, spool.closing_delay_s = None, 0.002, own_s
    changed = attach(rig, "closing_delay", "valve", extra_s=extra_s)
    volts = np.repeat([5.0, 8.0, 5.0], [10, 40, 40])
    plain, moved = (openings(build(r), {"voltage": volts}, DT_S)[:, FILL] for r in (rig, changed))
    shift = round(extra_s / DT_S * KNOTS_PER_SAMPLE)
    middle = 30 * KNOTS_PER_SAMPLE
    np.testing.assert_allclose(moved[:middle], plain[:middle], atol=1e-12)
    np.testing.assert_allclose(
        moved[middle + shift :][: plain.size - middle - abs(shift)],
        plain[middle:][: plain.size - middle - abs(shift)],
        atol=1e-9,
    )
    assert np.max(np.abs(moved - plain)) == pytest.approx(0.6)


def test_no_valve_closes_before_it_is_told(rig: Rig) -> None:
    rig.valves["valve"].spool.delay_s = 0.003
    effect = registry()["closing_delay"]
    assert effect.limits(effect.strength, rig, "valve") == (-0.003, 0.05)
    early = attach(rig, "closing_delay", "valve", extra_s=-0.004)
    with pytest.raises(InputError, match=r"extra_s: found -0\.004, allowed is -0\.003 to 0\.05 s"):
        build(early)


def test_nothing_flows_inside_the_dead_band(rig: Rig) -> None:
    dead = attach(rig, "dead_band", "valve", width_v=0.25)
    for volts in (5.24, 4.76):
        (plain, banded), (some, none) = rig_a([rig, dead], hold(volts, 0.1), 3e5)
        assert np.all(none == 0.0)
        assert np.max(np.abs(some)) > 1e-5
        np.testing.assert_allclose(banded, np.broadcast_to(banded[0], banded.shape), rtol=1e-6)
        assert np.max(np.abs(plain - banded)) > 5e3
    # Beyond it the valve opens as it would at a command nearer null by the overlap.
    (beyond,), _ = rig_a([dead], hold(7.25, 0.1), 3e5)
    (nearer,), _ = rig_a([rig], hold(7.0, 0.1), 3e5)
    assert beyond[-1] == pytest.approx(nearer[-1], rel=0.01)


def test_an_overlap_may_leave_the_full_opening_as_it_was(rig: Rig) -> None:
    """Half of what is left of the stroke then opens as half of the stroke did."""
    rig.valves["valve"].spool.bandwidth_hz = None
    dead = attach(rig, "dead_band", "valve", width_v=0.5, recovered=1.0)
    plain = openings(build(rig), {"voltage": np.array([10.0, 7.5, 5.0])}, DT_S)[:, FILL]
    volts = np.array([10.0, 5.5 + 0.5 * 4.5, 5.5])
    banded = openings(build(dead), {"voltage": volts}, DT_S)[:, FILL]
    np.testing.assert_allclose(banded, plain, atol=1e-9)
    assert plain[0] == pytest.approx(1.0)


def test_hysteresis_parts_the_branches_by_its_width(rig: Rig) -> None:
    rig.valves["valve"].spool.bandwidth_hz = None
    wide = attach(rig, "hysteresis", "valve", width_v=0.4)
    triangle = np.concatenate([np.linspace(5.0, 9.0, 400), np.linspace(9.0, 5.0, 400)])
    x = openings(build(wide), {"voltage": triangle}, DT_S)[:, FILL]
    u = np.interp(np.arange(x.size) / KNOTS_PER_SAMPLE, np.arange(triangle.size), triangle)
    top = int(np.argmax(u))
    up = np.interp(0.5, x[:top], u[:top])
    down = np.interp(-0.5, -x[top:], u[top:])
    assert up - down == pytest.approx(0.4, abs=0.02)


def test_null_offset_is_a_shifted_command(rig: Rig) -> None:
    shifted = attach(rig, "null_offset", "valve", offset_v=0.3)
    volts = step_and_hold()
    (plain,), _ = rig_a([rig], volts, 3e5)
    (moved,), _ = rig_a([shifted], volts + 0.3, 3e5)
    np.testing.assert_allclose(moved, plain, rtol=1e-9)


def test_spool_leakage_is_a_choked_port(rig: Rig) -> None:
    leaky = attach(rig, "spool_leakage", "valve.supply", fraction=0.01)
    _, (none, some) = rig_a([rig, leaky], hold(5.0, 0.1), ROOM_PA)
    np.testing.assert_allclose(none, 0.0, atol=1e-12)
    expected = 0.01 * 0.9e-8 * 1.185 * SUPPLY_PA  # C rho_0 p_1, ISO 6358-1
    assert some[-1, FILL] == pytest.approx(expected, rel=0.01)
    assert some[-1, DRAIN] == pytest.approx(0.0, abs=1e-12)


def test_flow_gain_scales_choked_flow(rig: Rig) -> None:
    both = attach(rig, "flow_gain", "valve", error=0.2)
    one = attach(rig, "flow_gain", "valve.exhaust", error=0.2)
    _, flows = rig_a([rig, both, one], hold(5.05, 0.1), ROOM_PA)
    assert flows[1:, -1, FILL] / flows[0, -1, FILL] == pytest.approx([1.2, 1.0], rel=0.01)
    _, flows = rig_a([rig, both, one], hold(4.95, 0.03), 6e5)
    assert flows[1:, -1, DRAIN] / flows[0, -1, DRAIN] == pytest.approx([1.2, 1.2], rel=0.02)


def test_asymmetry_favours_one_way(rig: Rig) -> None:
    uneven = attach(rig, "fill_exhaust_asymmetry", "valve", difference=0.2)
    _, flows = rig_a([rig, uneven], hold(5.05, 0.1), ROOM_PA)
    assert flows[1, -1, FILL] / flows[0, -1, FILL] == pytest.approx(1.1, rel=0.01)
    _, flows = rig_a([rig, uneven], hold(4.95, 0.03), 6e5)
    assert flows[1, -1, DRAIN] / flows[0, -1, DRAIN] == pytest.approx(0.9, rel=0.02)


def test_critical_ratio_acts_on_subsonic_flow_only(rig: Rig) -> None:
    other = attach(rig, "critical_ratio", "valve", shift=0.2)
    _, flows = rig_a([rig, other], hold(5.2, 0.05), ROOM_PA)
    assert flows[1, -1, FILL] == pytest.approx(flows[0, -1, FILL], rel=1e-3)
    pressure = 0.8 * SUPPLY_PA
    _, flows = rig_a([rig, other], hold(5.1, 0.03), pressure)
    ellipse = [math.sqrt(1.0 - ((0.8 - b) / (1.0 - b)) ** 2) for b in (0.3, 0.5)]
    assert flows[1, -1, FILL] / flows[0, -1, FILL] == pytest.approx(
        ellipse[1] / ellipse[0], rel=0.02
    )


# --- line -----------------------------------------------------------------------------------------


def test_leak_empties_a_closed_line_as_an_orifice_does(rig: Rig) -> None:
    area = 5e-8
    volts = hold(5.0, 0.3)
    whole, holed = (
        rig_a([r], volts, 5e5)[0][0]
        for r in (rig, attach(rig, "leak", "tube", area_m2=area, position_m=2.5))
    )
    np.testing.assert_allclose(whole[-1], whole[0], rtol=1e-6)
    # p'/p = -n A 0.0404 R sqrt(T) / V with n between 1 (isothermal) and 1.4 (adiabatic)
    volume = 2.5 * 6e-6
    rate = CHOKED * area * AIR.r_specific * math.sqrt(ROOM_K) / volume
    fall = -math.log(holed[-1, MIDDLE] / holed[20, MIDDLE]) / ((volts.size - 21) * DT_S)
    assert rate < fall < 1.4 * rate
    assert np.all(holed[-1, [SUPPLY, EXHAUST]] == pytest.approx([SUPPLY_PA, ROOM_PA]))


def viscosity(temperature_k: float) -> float:
    """Sutherland's law for air, U.S. Standard Atmosphere 1976."""
    return 1.458e-6 * temperature_k**1.5 / (temperature_k + 110.4)


def through_a_plug(p_pa: float, rate: float, time_s: np.ndarray) -> np.ndarray:
    """Pressure of an isothermal volume, p' = -rate (p^2 - p_room^2), rate = G / (2 mu V)."""
    # (p - r) / (p + r) decays with 2 r rate, for a volume above the room's pressure and below it.
    x = (p_pa - ROOM_PA) / (p_pa + ROOM_PA) * np.exp(-2.0 * ROOM_PA * rate * time_s)
    return ROOM_PA * (1.0 + x) / (1.0 - x)


@pytest.mark.parametrize("start_pa", [5e5, 1.05e5, 5e4])
def test_porous_chamber_leak_is_that_of_a_capillary(bottle: Rig, start_pa: float) -> None:
    bottle.chambers["bottle"].heat_w_per_k = 1e3  # isothermal
    bottle.pipes["tube"].area_m2 = 1e-7
    diameter, length = 1.2e-4, 5e-3
    conductance = math.pi * diameter**4 / (128.0 * length)  # m^3 / s = conductance / mu dp
    holed = attach(bottle, "chamber_porous_leak", "bottle", porous_m3=conductance)
    (leaky,), _ = rig_a([holed], hold(5.0, 1.0), start_pa)
    time = np.arange(leaky.shape[0]) * DT_S
    rate = conductance / (2.0 * viscosity(ROOM_K) * (1e-4 + 2.5e-7))
    expected = through_a_plug(start_pa, rate, time)
    assert abs(expected[-1] - start_pa) > 0.03 * abs(start_pa - ROOM_PA)
    fallen = leaky[:, END] - start_pa
    np.testing.assert_allclose(
        fallen, expected - start_pa, atol=0.006 * abs(expected[-1] - start_pa)
    )


def test_porous_leak_empties_a_line_by_the_square_of_its_pressure(rig: Rig) -> None:
    conductance = 1e-15
    holed = attach(rig, "porous_leak", "tube", porous_m3=conductance, position_m=1.0)
    for start in (5e5, 2.5e5):
        (leaky,), _ = rig_a([holed], hold(5.0, 0.1), start)
        # p' = -n G (p^2 - p_room^2) / (2 mu V) with n between 1 (isothermal) and 1.4 (adiabatic)
        rate = conductance / (2.0 * viscosity(ROOM_K) * 2.5 * 6e-6)
        fall = (leaky[20, MIDDLE] - leaky[-1, MIDDLE]) / ((leaky.shape[0] - 21) * DT_S)
        middle = 0.5 * (leaky[20, MIDDLE] + leaky[-1, MIDDLE])
        assert 1.0 < fall / (rate * (middle**2 - ROOM_PA**2)) < 1.4


def filled_through_a_jet(**pipe: object) -> Rig:
    """A tube with a closed end, fed from 20 bar through a small jet, which is choked."""
    return Rig.model_validate(
        {
            "name": "jet",
            "grid": {"dx_m": 0.05},
            "ambient": {"pressure_pa": ROOM_PA, "temperature_k": ROOM_K},
            "reservoirs": {"source": {"pressure_pa": 2e6}},
            "pipes": {
                "tube": {"from": "in", "to": "closed", "length_m": 0.5, "area_m2": 20e-6, **pipe}
            },
            "orifices": {"jet": {"from": "source", "to": "in", "conductance_m3_s_pa": 2e-11}},
            "taps": {"end": {"pipe": "tube", "position_m": 0.45}},
        }
    )


def test_relief_valve_holds_the_pressure_at_which_it_passes_the_flow() -> None:
    rig = filled_through_a_jet()
    flow = 2e-11 * 1.185 * 2e6
    area, opens, span = 2e-7, 3.5e5, 3e4
    relieved = attach(
        rig, "relief_valve", "tube", area_m2=area, set_pa=opens, range_pa=span, position_m=0.4
    )
    plain, held = run([rig, relieved], np.zeros(1000), [3.2e5]).readings[:, 0]
    below = np.flatnonzero(held >= opens - 100.0)[0]
    assert below > 20
    np.testing.assert_array_equal(held[:below], plain[:below])
    # A x p 0.0404 / sqrt(T) = flow with x = (p - set) / range
    b = flow * math.sqrt(ROOM_K) / (CHOKED * area) * span
    expected = 0.5 * (opens + math.sqrt(opens**2 + 4.0 * b))
    assert opens + 0.1 * span < expected < opens + 0.9 * span
    assert held[-1] - opens == pytest.approx(expected - opens, rel=0.02)
    assert plain[-1] > 6e5


def test_relief_valve_of_a_chamber_is_an_orifice_when_wide_open(bottle: Rig) -> None:
    area = 2e-7
    values = {"area_m2": area, "set_pa": 3e5, "range_pa": 1e4}
    holed = attach(bottle, "chamber_relief_valve", "bottle", **values)
    bottle.pipes["tube"].area_m2 = holed.pipes["tube"].area_m2 = 1e-7
    (closed,), _ = rig_a([holed], hold(5.0, 0.2), 2.9e5)
    (whole,), _ = rig_a([bottle], hold(5.0, 0.2), 2.9e5)
    np.testing.assert_array_equal(closed, whole)
    (leaky,), _ = rig_a([holed], hold(5.0, 0.2), 5e5)
    rate = 1.4 * CHOKED * area * AIR.r_specific * math.sqrt(ROOM_K) / 1e-4
    fall = -math.log(leaky[100, END] / leaky[10, END]) / (90 * DT_S)
    assert fall == pytest.approx(rate, rel=0.03)
    (settled,), _ = rig_a([holed], hold(5.0, 2.0), 3.05e5)
    assert 3e5 < settled[-1, END] < 3.005e5


@pytest.mark.parametrize("name", [e.name for e in registry().values() if e.contains])
def test_what_contains_another_can_be_it(bottle: Rig, name: str) -> None:
    """At the least values of its other parameters, far above the room's pressure: the same run."""
    effect = registry()[name]
    special = registry()[str(effect.contains)]
    place = next(p for p in effect.places(bottle) if p in ("tube", "bottle"))
    at = {"position_m": 1.0} if effect.has_position else {}
    at[effect.strength.name] = 3e-8
    own = [p for p in effect.parameters if p.name not in at]
    least = {p.name: effect.limits(p, bottle, place)[0] for p in own}
    general = attach(bottle, name, place, **at, **least)
    rigs = [general, attach(bottle, special.name, place, **at), bottle]
    taps, _ = rig_a(rigs, np.full(100, 5.0), tube_pa=5e5)
    assert np.max(np.abs(taps[1] - taps[2])) > 1e3
    np.testing.assert_allclose(taps[0], taps[1], rtol=1e-12)


def test_relief_valves_of_one_place_open_one_after_the_other() -> None:
    rig = filled_through_a_jet()
    valve = {"position_m": 0.4, "area_m2": 4e-8, "range_pa": 1e4}
    two = attach(attach(rig, "relief_valve", "tube", set_pa=4e5, **valve),
                 "relief_valve", "tube", set_pa=3e5, **valve)  # fmt: skip
    one = attach(rig, "relief_valve", "tube", set_pa=3e5, **valve)
    (held, lower) = run([two, one], np.zeros(2000), [2.8e5]).readings[:, 0]
    # Wide open the lower one passes 0.0404 A p / sqrt(T); what is more opens the upper one.
    flow, k = 2e-11 * 1.185 * 2e6, CHOKED * 4e-8 / math.sqrt(ROOM_K)
    assert lower[-1] == pytest.approx(flow / k, rel=0.02)
    p = held[-1]
    assert k * p + k * p * (p - 4e5) / 1e4 == pytest.approx(flow, rel=0.02)


@pytest.mark.parametrize(
    ("effect", "strength"),
    [("blockage", {"fraction": 0.6}), ("local_loss", {"K": 20.0})],
)
def test_what_sits_along_the_tube_echoes_after_its_distance(
    rig: Rig, effect: str, strength: dict[str, float]
) -> None:
    rig.grid.dx_m = 0.05
    rig.valves["valve"].spool.bandwidth_hz = None
    at = attach(rig, effect, "tube", position_m=1.5, **strength)
    (plain, changed), _ = rig_a([rig, at], hold(10.0, 0.03, rest_s=0.0), ROOM_PA)
    echo = np.abs(changed - plain)[:, VALVE_OUT]
    there_and_back = 2.0 * 1.4 / AIR.sound_speed(ROOM_K)
    first = np.argmax(echo > 0.05 * np.max(echo)) * DT_S
    # The pulse compresses and carries the gas it runs through, so it may be faster than sound.
    assert 0.55 * there_and_back < first < 1.25 * there_and_back


def steady_drop(rig: Rig) -> tuple[float, float]:
    """Pressure drop between the taps of the blow-through rig at steady flow, and that flow."""
    out = run([rig], np.zeros(400), [ROOM_PA + 1e3, ROOM_PA])
    near, far = out.readings[0, :, -1]
    return near - far, float(out.flows[0, -1, 0])


def test_choked_source_sets_the_flow(blow_through: Rig) -> None:
    _, flow = steady_drop(blow_through)
    assert flow == pytest.approx(1.5e-9 * 1.185 * 5e5, rel=1e-3)


def mean_density(drop_pa: float) -> float:
    """Density between the taps, from the pressure halfway to the open end."""
    return float(AIR.density(ROOM_PA + drop_pa / 0.6 * 0.5, ROOM_K))


def test_local_loss_costs_velocity_heads(blow_through: Rig) -> None:
    drop, flow = steady_drop(blow_through)
    lossy, _ = steady_drop(attach(blow_through, "local_loss", "tube", K=4.0, position_m=0.5))
    head = 0.5 * (flow / 20e-6) ** 2 / mean_density(drop)
    assert lossy - drop == pytest.approx(4.0 * head, rel=0.05)


@pytest.mark.parametrize("stub", [False, True])
def test_losses_at_the_ends_of_pipes_cost_velocity_heads(blow_through: Rig, stub: bool) -> None:
    """Two tubes in series, or two ways of a junction whose third is closed."""
    tube = blow_through.pipes["tube"]
    head_tube = tube.model_copy(update={"to_node": "joint", "length_m": 0.5})
    tail = tube.model_copy(update={"from_node": "joint", "length_m": 0.5})
    closed = tail.model_copy(update={"to_node": "closed", "length_m": 0.1, "loss_from": 50.0})
    blow_through.pipes = {"tube": head_tube, "tail": tail}
    if stub:
        blow_through.pipes["stub"] = closed
    blow_through.taps["far"] = blow_through.taps["far"].model_copy(
        update={"pipe": "tail", "position_m": 0.3}
    )
    plain, flow = steady_drop(blow_through)
    for losses in ((3.0, 0.0), (0.0, 2.0), (3.0, 2.0)):
        head_tube.loss_to, tail.loss_from = losses
        lossy, _ = steady_drop(blow_through)
        head = 0.5 * (flow / 20e-6) ** 2 / mean_density(plain)
        assert lossy - plain == pytest.approx(sum(losses) * head, rel=0.05)


def test_junction_loss_costs_velocity_heads_in_every_way_through(blow_through: Rig) -> None:
    tube = blow_through.pipes["tube"]
    head_tube = tube.model_copy(update={"to_node": "tee", "length_m": 0.5})
    tail = tube.model_copy(update={"from_node": "tee", "length_m": 0.5})
    stub = tube.model_copy(update={"from_node": "tee", "to_node": "closed", "length_m": 0.1})
    blow_through.taps["far"] = blow_through.taps["far"].model_copy(
        update={"pipe": "tail", "position_m": 0.3}
    )
    effect = registry()["junction_loss"]
    blow_through.pipes = {"tube": head_tube, "tail": tail}
    assert effect.places(blow_through) == []  # a joint of two pipes is a fitting
    blow_through.pipes["stub"] = stub
    assert effect.places(blow_through) == ["tee"]
    plain, flow = steady_drop(blow_through)
    lossy, _ = steady_drop(attach(blow_through, "junction_loss", "tee", K=2.5))
    head = 0.5 * (flow / 20e-6) ** 2 / mean_density(plain)
    assert lossy - plain == pytest.approx(2.0 * 2.5 * head, rel=0.05)


def test_blockage_loses_what_borda_and_carnot_say(blow_through: Rig) -> None:
    drop, flow = steady_drop(blow_through)
    narrow = attach(blow_through, "blockage", "tube", fraction=0.5, position_m=0.5, length_m=0.1)
    blocked, _ = steady_drop(narrow)
    head = 0.5 * (flow / 20e-6) ** 2 / mean_density(drop)
    # (A / A_narrow - 1)^2 heads at the widening, those of a sharp edge at the entrance (Idelchik),
    # and 0.1 m of friction at twice the speed
    reynolds = flow * math.sqrt(4.0 * 20e-6 / math.pi) / (AIR.viscosity(ROOM_K) * 20e-6)
    pipe_heads = haaland(reynolds) * 0.1 / math.sqrt(4.0 * 20e-6 / math.pi)
    entrance = 0.5 * 0.5**0.75 * 2.0**2
    expected = (1.0 + entrance + pipe_heads * (2.0**2.375 - 1.0)) * head
    assert 0.8 * expected < blocked - drop < 1.4 * expected


def test_a_blockage_is_the_same_on_short_and_long_cells(blow_through: Rig) -> None:
    """Wherever its middle lies between the faces of cells."""
    losses = []
    for dx_m, position_m in ((0.1, 0.5), (0.1, 0.55), (0.05, 0.51), (0.0125, 0.5)):
        blow_through.grid.dx_m = dx_m
        drop, _ = steady_drop(blow_through)
        at = {"fraction": 0.5, "position_m": position_m, "length_m": 0.1}
        blocked, _ = steady_drop(attach(blow_through, "blockage", "tube", **at))
        losses.append(blocked - drop)
    assert max(losses) < 1.4 * min(losses)


def haaland(reynolds: float, roughness: float = 0.0) -> float:
    """Darcy friction factor; ``roughness`` relative to the diameter."""
    return (-1.8 * math.log10(6.9 / reynolds + (roughness / 3.7) ** 1.11)) ** -2


def test_turbulent_friction_and_roughness_follow_haaland(blow_through: Rig) -> None:
    drop, flow = steady_drop(blow_through)
    diameter = math.sqrt(4.0 * 20e-6 / math.pi)
    reynolds = flow * diameter / (AIR.viscosity(ROOM_K) * 20e-6)
    assert reynolds > 4000.0
    heads = 0.5 * (flow / 20e-6) ** 2 / mean_density(drop) * 0.6 / diameter
    gained, _ = steady_drop(attach(blow_through, "turbulent_friction", "tube", gain=0.3))
    assert gained - drop == pytest.approx(
        0.3 * (haaland(reynolds) - 64.0 / reynolds) * heads, rel=0.05
    )
    rough, _ = steady_drop(attach(blow_through, "roughness", "tube", height_m=5e-5))
    expected = (haaland(reynolds, 5e-5 / diameter) - haaland(reynolds)) * heads
    assert rough - drop == pytest.approx(expected, rel=0.06)


def test_laminar_friction_follows_poiseuille(blow_through: Rig) -> None:
    blow_through.orifices["jet"].conductance_m3_s_pa = 1.2e-10
    drop, flow = steady_drop(blow_through)
    more, _ = steady_drop(attach(blow_through, "laminar_friction", "tube", gain=1.0))
    rho = float(AIR.density(ROOM_PA, ROOM_K))
    expected = 8.0 * math.pi * AIR.viscosity(ROOM_K) * flow / rho / 20e-6**2 * 0.6
    assert drop == pytest.approx(expected, rel=0.02)
    assert more - drop == pytest.approx(expected, rel=0.02)


def ringing(y: np.ndarray) -> float:
    """Size of what still moves at the end of a hold."""
    return float(np.std(np.diff(y[-40:, END])))


def test_unsteady_friction_damps_the_ringing(rig: Rig) -> None:
    rig.pipes["tube"].wall.heat_unsteady = 0.0
    quiet = attach(rig, "unsteady_friction", "tube", gain=1.0)
    freer = attach(rig, "unsteady_friction", "tube", gain=-1.0)
    pulse = np.repeat([10.0, 5.0], [4, 60])
    y, _ = rig_a([freer, rig, quiet], pulse, 3e5)
    assert ringing(y[0]) > 1.2 * ringing(y[1]) > 1.4 * ringing(y[2])


def test_unsteady_friction_gives_one_pipe_of_a_thesis_rig_a_memory(rig: Rig) -> None:
    only = rig.model_copy(deep=True)
    for name, pipe in only.pipes.items():
        pipe.wall.unsteady = 1.0 if name == "tube" else 0.0
        pipe.wall.heat_unsteady = 0.0
    rig.grid.memory = False
    gained = attach(rig, "unsteady_friction", "tube", gain=1.0)
    volts = step_and_hold()
    y, _ = rig_a([rig, gained, only], volts, 3e5)
    np.testing.assert_allclose(y[1], y[2], rtol=1e-12)
    assert np.max(np.abs(y[0] - y[1])) > 1e3
    (alone,), _ = rig_a([rig], volts, 3e5)
    np.testing.assert_allclose(y[0], alone, rtol=1e-9)  # memory elsewhere in a batch is no matter


def test_wall_heat_sags_after_a_fill_and_rises_after_an_exhaust(rig: Rig) -> None:
    for pipe in rig.pipes.values():
        pipe.wall.nusselt = pipe.wall.heat_turbulent = pipe.wall.heat_unsteady = 0.0
    warm = attach(rig, "wall_heat", "tube", gain=1.0)
    for volts, start, sign in ((9.0, 2e5, -1.0), (2.0, 6e5, 1.0)):
        command = np.repeat([volts, 5.0], [12, 300])
        y, _ = rig_a([rig, warm], command, start)
        inside = y[:, :, VALVE_OUT : END + 1].mean(axis=2)
        drift = inside[:, -100:].mean(axis=1) - inside[:, 16:30].mean(axis=1)
        assert sign * (drift[1] - drift[0]) > 3e3
        assert abs(drift[0]) < 0.3 * abs(drift[1])


def test_dead_volume_slows_a_choked_fill_in_proportion(rig: Rig) -> None:
    added = attach(rig, "dead_volume", "tube", volume_m3=5e-6, position_m=2.5)
    y, flows = rig_a([rig, added], hold(5.05, 0.16), ROOM_PA)
    assert flows[1, -1, FILL] == pytest.approx(flows[0, -1, FILL], rel=1e-2)
    gain = y[:, -1, MIDDLE] - y[:, 30, MIDDLE]
    # The tube's walls keep it near their temperature, the volume has none: isentropic beside
    # isothermal gas, but for what mixes.
    own, added_m3 = 2.5 * 6e-6, 5e-6
    assert own / (own + added_m3) < gain[1] / gain[0] < own / (own + added_m3 / 1.4)


def test_wider_and_longer_tubes_fill_in_proportion(rig: Rig) -> None:
    wide = attach(rig, "area_error", "tube", error=0.25)
    long = attach(rig, "length_error", "tube", error=0.25)
    y, _ = rig_a([rig, wide, long], hold(5.05, 0.16), ROOM_PA)
    gain = y[:, -1, MIDDLE] - y[:, 30, MIDDLE]
    np.testing.assert_allclose(gain[1:] / gain[0], 1.0 / 1.25, rtol=0.03)


def arrival_s(rig: Rig, tap: int, tube_pa: float) -> float:
    """Time at which half a small pulse's height reaches a tap."""
    rig.grid.dx_m = 0.02
    rig.valves["valve"].spool.bandwidth_hz = None
    fine_s = 2e-4
    # Over before its echo from the end comes by the middle.
    pulse = np.repeat([5.3, 5.0], [10, 60 if tap == END else 26])
    start = [SUPPLY_PA, tube_pa, tube_pa, tube_pa, ROOM_PA]
    y = run([rig], pulse, start, fine_s).readings[0, tap]
    level = y[0] + 0.5 * (np.max(y) - y[0])
    k = int(np.argmax(y > level))
    return (k - (y[k] - level) / (y[k] - y[k - 1])) * fine_s


def test_longer_tube_delays_the_arrival_by_its_length(rig: Rig) -> None:
    long = attach(rig, "length_error", "tube", error=0.2)
    extra = 0.2 * 2.475 / AIR.sound_speed(ROOM_K)
    later = arrival_s(long, END, 3e5) - arrival_s(rig, END, 3e5)
    assert later == pytest.approx(extra, rel=0.08)


def test_yielding_wall_slows_waves_the_more_the_higher_the_pressure(rig: Rig) -> None:
    kappa = 5e-7
    soft = attach(rig, "wall_compliance", "tube", compliance_per_pa=kappa)
    for pressure in (2e5, 5e5):
        later = arrival_s(soft, MIDDLE, pressure) - arrival_s(rig, MIDDLE, pressure)
        # Moens and Korteweg, with gas of bulk modulus gamma p
        slower = math.sqrt(1.0 + 1.4 * pressure * kappa / (1.0 + kappa * (pressure - ROOM_PA)))
        expected = 1.25 / AIR.sound_speed(ROOM_K) * (slower - 1.0)
        assert later == pytest.approx(expected, rel=0.12)


def test_yielding_wall_holds_more_gas_and_keeps_it(rig: Rig) -> None:
    kappa = 1e-6
    soft = attach(rig, "wall_compliance", "tube", compliance_per_pa=kappa)
    (_, rest), _ = rig_a([rig, soft], hold(5.0, 0.2), 5e5)
    np.testing.assert_allclose(rest, np.broadcast_to(rest[0], rest.shape), rtol=1e-9)
    # Filled and left alone until warm as the room, the mass that went in is A L s p / (R T) more.
    command = np.repeat([6.0, 5.0], [50, 600])
    y, flows = rig_a([rig, soft], command, 2e5)
    taken = flows[:, :, FILL].sum(axis=1) * DT_S
    for k, mass in ((0.0, taken[0]), (kappa, taken[1])):
        p = y[int(k > 0.0), -1, MIDDLE]
        held = [q * (1.0 + k * (q - ROOM_PA)) for q in (2e5, p)]
        assert mass == pytest.approx(
            2.5 * 6e-6 * (held[1] - held[0]) / (AIR.r_specific * ROOM_K), rel=0.02
        )


# --- chambers -------------------------------------------------------------------------------------


def test_chamber_leak_is_an_adiabatic_orifice(bottle: Rig) -> None:
    area = 2e-7
    holed = attach(bottle, "chamber_leak", "bottle", area_m2=area)
    bottle.pipes["tube"].area_m2 = holed.pipes["tube"].area_m2 = 1e-7  # next to no gas in the tube
    (whole, leaky), _ = rig_a([bottle, holed], hold(5.0, 0.2), 5e5)
    np.testing.assert_allclose(whole[-1], whole[0], rtol=1e-6)
    rate = 1.4 * CHOKED * area * AIR.r_specific * math.sqrt(ROOM_K) / 1e-4
    fall = -math.log(leaky[100, END] / leaky[10, END]) / (90 * DT_S)
    assert fall == pytest.approx(rate, rel=0.03)


def test_chamber_volume_and_compliance_slow_a_choked_fill(bottle: Rig) -> None:
    bottle.pipes["tube"].length_m = 0.5
    for tap, at in (("middle", 0.25), ("end", 0.475)):
        bottle.taps[tap].position_m = at
    bigger = attach(bottle, "chamber_volume", "bottle", error=0.3)
    softer = attach(bottle, "chamber_compliance", "bottle", compliance_per_pa=1e-6)
    y, _ = rig_a([bottle, bigger, softer], hold(5.1, 0.3), ROOM_PA)
    gain = y[:, -1, END] - y[:, 40, END]
    tube = 0.5 * 6e-6
    assert gain[1] / gain[0] == pytest.approx((1e-4 + tube) / (1.3e-4 + tube), rel=0.02)
    # Adiabatic filling of a yielding vessel: p' (V + gamma p dV/dp) = gamma R T m, V grows as well.
    p = y[2, 40:, END].mean()
    volume = 1e-4 * (1.0 + 1e-6 * (p - ROOM_PA)) + tube
    assert gain[2] / gain[0] == pytest.approx(
        (1e-4 + tube) / (volume + 1.4 * p * 1e-4 * 1e-6), rel=0.04
    )


def test_stiffer_chamber_fills_as_a_rigid_one(bottle: Rig) -> None:
    soft = bottle.model_copy(deep=True)
    soft.chambers["bottle"].compliance_m3_per_pa = 1e-4 * 4e-7
    effect = registry()["chamber_compliance"]
    assert effect.limits(effect.strength, bottle, "bottle") == (0.0, 1e-4)
    lower, _ = effect.limits(effect.strength, soft, "bottle")
    assert lower == pytest.approx(-4e-7, rel=1e-12)
    stiff = attach(soft, "chamber_compliance", "bottle", compliance_per_pa=lower)
    half = attach(soft, "chamber_compliance", "bottle", compliance_per_pa=0.5 * lower)
    assert build(half).chamber[0, L.C_COMPLIANCE] == pytest.approx(1e-4 * 2e-7, rel=1e-12)
    (rigid, stiffened, yielding), _ = rig_a([bottle, stiff, soft], hold(6.0, 0.3))
    np.testing.assert_allclose(stiffened, rigid, rtol=1e-12)
    assert yielding[-1, END] < 0.95 * rigid[-1, END]


def test_chamber_heat_settles_an_emptied_bottle_back_to_the_room(bottle: Rig) -> None:
    warm = attach(bottle, "chamber_heat", "bottle", conductance_w_per_k=0.5)
    command = np.repeat([0.0, 5.0], [60, 340])
    (adiabatic, heated), _ = rig_a([bottle, warm], command, 6e5)
    rise = heated[-1, END] - heated[80, END]
    assert rise > 5e3
    assert rise > 3.0 * abs(adiabatic[-1, END] - adiabatic[80, END])


def still_conductance(
    pressure: float, temperature: float, area_m2: float, height_m: float
) -> float:
    """Conductance of a wall along which gas rises, W/K: Nu = 0.104 Ra^0.352."""
    film = 0.5 * (temperature + ROOM_K)
    nu = float(AIR.viscosity(film)) * AIR.r_specific * film / pressure
    rayleigh = 9.81 * abs(temperature - ROOM_K) / film * AIR.prandtl / nu**2 * height_m**3
    # Another law for plates, McAdams' of 1954, is nearly as high.
    assert 0.104 * rayleigh**0.352 == pytest.approx(0.13 * rayleigh ** (1.0 / 3.0), rel=0.2)
    return area_m2 * 0.104 * rayleigh**0.352 * float(AIR.conductivity(film)) / height_m


def test_chamber_convection_is_its_law_at_any_density(bottle: Rig) -> None:
    warm = attach(bottle, "chamber_convection", "bottle", area_m2=0.02, inlet_m=1.0)
    warm.pipes["tube"].area_m2 = 1e-7  # next to no gas in the tube
    for height_m in (None, 0.15):
        warm.chambers["bottle"].height_m = height_m
        for pressure, temperature in ((1e5, 260.0), (8e5, 260.0), (8e5, 340.0)):
            simulator = Simulator(warm)
            simulator.set_chamber("bottle", pressure, temperature)
            simulator.set_state("tube", pressure / (AIR.r_specific * ROOM_K), 0.0, pressure)
            out = simulator.run(5e-3, {"voltage": 5.0})
            watts = still_conductance(pressure, temperature, 0.02, height_m or 1e-4 ** (1.0 / 3.0))
            watts *= ROOM_K - temperature
            mass = pressure * 1e-4 / (AIR.r_specific * temperature)
            expected = 5e-3 * watts / (mass * AIR.cv)
            warmed = out.temperatures["bottle"][-1] - temperature
            assert warmed == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("through", ["orifice", "pipe"])
def test_what_enters_a_chamber_stirs_it(through: str) -> None:
    """Heat beside a chamber that has none: its law at the inflow that the gas itself tells."""
    volume, inlet_m, area_m2, start_k = 1e-3, 4e-3, 2e-3, 380.0
    pipe = {"from": "in", "to": "tank", "length_m": 0.2, "area_m2": 2e-5}
    chamber = {"volume_m3": volume, "inlet_m": inlet_m}
    ends = ("source", "tank") if through == "orifice" else ("source", "in")
    rig = Rig.model_validate(
        {
            "name": "filled",
            "grid": {"dx_m": 0.05},
            "ambient": {"pressure_pa": ROOM_PA, "temperature_k": ROOM_K},
            "reservoirs": {"source": {"pressure_pa": 6e5}},
            "chambers": {"tank": chamber},
            "pipes": {"tube": pipe | ({"from": "closed"} if through == "orifice" else {})},
            "orifices": {"o": {"from": ends[0], "to": ends[1], "conductance_m3_s_pa": 2e-9}},
            "taps": {"tank": {"chamber": "tank"}},
        }
    )
    stirred = rig.model_copy(deep=True)
    stirred.chambers["tank"].convection_m2 = area_m2
    energy = []
    for one in (rig, stirred):
        simulator = Simulator(one)
        simulator.set_chamber("tank", ROOM_PA, start_k)
        out = simulator.run(0.05, sample_s=5e-4)
        p, t = out.chambers["tank"], out.temperatures["tank"]
        energy.append(p[-1] * volume / 0.4)
    mass = p * volume / (AIR.r_specific * t)
    inflow = np.maximum(np.diff(mass) / 5e-4, 0.0)
    given = 0.0
    for k, m in enumerate(inflow):
        warm, film = 0.5 * (t[k] + t[k + 1]), 0.25 * (t[k] + t[k + 1]) + 0.5 * ROOM_K
        reynolds = 4.0 * m / (math.pi * inlet_m * float(AIR.viscosity(film)))
        jet = area_m2 * 0.56 * reynolds**0.67 * float(AIR.conductivity(film)) / 0.1
        given += 5e-4 * (jet + still_conductance(p[k], warm, area_m2, 0.1)) * (ROOM_K - warm)
    assert inflow[-1] == pytest.approx(2e-9 * 1.185 * 6e5, rel=0.05)
    assert energy[1] - energy[0] == pytest.approx(given, rel=0.03)


# --- supply and room ------------------------------------------------------------------------------


def test_droop_lowers_the_supply_in_proportion_to_flow(rig: Rig) -> None:
    sagging = attach(rig, "regulator_droop", "supply", droop_pa_s_per_kg=2e7)
    (plain, sagged), (_, flow) = rig_a([rig, sagging], hold(5.4, 0.12), ROOM_PA)
    drop = plain[-1, SUPPLY] - sagged[-1, SUPPLY]
    assert drop == pytest.approx(2e7 * flow[-1, FILL], rel=0.05)
    (plain, sagged), _ = rig_a([rig, sagging], hold(5.0, 0.05), ROOM_PA)
    np.testing.assert_allclose(sagged, plain, rtol=1e-9)  # no flow, no droop


def test_supply_level_shows_wherever_the_supply_reaches(rig: Rig) -> None:
    higher = attach(rig, "supply_level", "supply", offset_pa=1e4)
    (plain, raised), _ = rig_a([rig, higher], hold(7.0, 2.0), 5.5e5)
    shift = raised[-1] - plain[-1]
    np.testing.assert_allclose(shift[[SUPPLY, VALVE_OUT, MIDDLE, END]], 1e4, rtol=0.05)
    assert shift[EXHAUST] == pytest.approx(0.0, abs=1.0)


def sine_of(y: np.ndarray, time_s: np.ndarray, frequency_hz: float) -> complex:
    """Amplitude and phase of a sine of known frequency, by least squares."""
    x = 2.0 * math.pi * frequency_hz * time_s
    basis = np.stack([np.sin(x), np.cos(x), np.ones_like(x)], axis=1)
    (a, b, _), *_ = np.linalg.lstsq(basis, y, rcond=None)
    return complex(a, b)


def test_ripple_modulates_a_choked_flow_at_every_instant(blow_through: Rig) -> None:
    rippled = attach(
        blow_through, "supply_ripple", "source", amplitude_pa=2e4, frequency_hz=7.0, phase_rad=0.6
    )
    twice = attach(
        rippled, "supply_ripple", "source", amplitude_pa=1e4, frequency_hz=31.0, phase_rad=-1.0
    )
    out = run([rippled, twice], np.zeros(400), [ROOM_PA + 1e3, ROOM_PA])
    step = DT_S / math.ceil(DT_S * 600.0 / (0.9 * 0.05))
    # A flow is that of the middle of the last step.
    time = np.arange(1, 400) * DT_S - 0.5 * step
    first = 2e4 * np.sin(2.0 * math.pi * 7.0 * time + 0.6)
    second = 1e4 * np.sin(2.0 * math.pi * 31.0 * time - 1.0)
    expected = 1.5e-9 * 1.185 * (5e5 + np.stack([first, first + second]))
    np.testing.assert_allclose(out.flows[:, 1:400, 0], expected, rtol=1e-9)


@pytest.mark.parametrize("frequency_hz", [5.0, 30.0])
def test_ripple_stands_in_the_line_as_a_sound_wave_does(rig: Rig, frequency_hz: float) -> None:
    rig.grid.dx_m = 0.05
    rippled = attach(
        rig, "supply_ripple", "supply", amplitude_pa=2e3, frequency_hz=frequency_hz, phase_rad=0.4
    )
    (plain, y), _ = rig_a([rig, rippled], np.full(1000, 5.0), ROOM_PA)
    np.testing.assert_allclose(y[:, VALVE_OUT:], plain[:, VALVE_OUT:], rtol=1e-12)  # valve closed
    time = np.arange(1000) * DT_S
    seen = sine_of(y[500:, SUPPLY], time[500:], frequency_hz)
    # A line without friction, closed at the far end: cos(k (L - x)) / cos(k L)
    k = 2.0 * math.pi * frequency_hz / AIR.sound_speed(ROOM_K)
    expected = 2e3 * math.cos(0.025 * k) / math.cos(k) * complex(math.cos(0.4), math.sin(0.4))
    assert abs(seen - expected) < 0.04 * abs(expected)


def test_ripple_keeps_the_time_of_the_run(rig: Rig) -> None:
    rippled = attach(rig, "supply_ripple", "supply", amplitude_pa=5e3, frequency_hz=13.0)
    whole = Simulator(rippled).run(0.1, {"voltage": 6.0})
    pieces = Simulator(rippled)
    for _ in range(4):
        last = pieces.run(0.025, {"voltage": 6.0})
    assert last.taps["supply"][-1] == pytest.approx(whole.taps["supply"][-1], abs=2.0)
    # A recording that begins later finds the ripple further on.
    plan = plan_grid(rippled)
    field = initial_field(rippled, plan)
    volts = np.full(60, 6.0)
    start = np.tile([SUPPLY_PA, 3e5, 3e5, 3e5, ROOM_PA], (60, 1))
    course = even_course(field, {"voltage": volts}, DT_S, start)
    later = replace(
        course,
        begin_s=0.03,
        end_s=course.end_s + 0.03,
        time_s=course.time_s + 0.03,
        commands={"voltage": Signal(course.commands["voltage"].time_s + 0.03, volts)},
    )
    ahead = rippled.model_copy(deep=True)
    ahead.effects[0].parameters["phase_rad"] = 2.0 * math.pi * 13.0 * 0.03
    (y,) = predict([[build(rippled, plan)]], [later], field)
    (z,) = predict([[build(ahead, plan)]], [course], field)
    np.testing.assert_allclose(y.readings, z.readings, rtol=1e-9)


def test_warm_supply_passes_less_mass(blow_through: Rig) -> None:
    warm = attach(blow_through, "supply_temperature", "source", offset_k=60.0)
    _, cold_flow = steady_drop(blow_through)
    _, warm_flow = steady_drop(warm)
    assert warm_flow / cold_flow == pytest.approx(math.sqrt(ROOM_K / (ROOM_K + 60.0)), rel=1e-3)


def test_warm_room_warms_the_supply_too(blow_through: Rig) -> None:
    _, cold_flow = steady_drop(blow_through)
    _, warm_flow = steady_drop(attach(blow_through, "ambient_temperature", "room", offset_k=30.0))
    assert warm_flow / cold_flow == pytest.approx(math.sqrt(ROOM_K / (ROOM_K + 30.0)), rel=1e-3)


def test_barometer_moves_what_is_open_to_the_room(rig: Rig) -> None:
    low = attach(rig, "ambient_pressure", "room", offset_pa=-3e3)
    out = run([rig, low], hold(1.0, 1.5), [SUPPLY_PA, 3e5, 3e5, 3e5, ROOM_PA])
    shift = out.readings[1, :, -1] - out.readings[0, :, -1]
    np.testing.assert_allclose(shift[[VALVE_OUT, MIDDLE, END, EXHAUST]], -3e3, rtol=0.05)
    assert shift[SUPPLY] == pytest.approx(0.0, abs=1.0)


# --- sensors --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("effect", "parameters"),
    [
        ("sensor_lag", {"lag_s": 6e-3}),
        ("sensor_bias", {"bias_pa": 2e3}),
        ("sensor_gain", {"error": 0.05}),
        ("clock_offset", {"offset_s": 2.0 * DT_S}),
        ("clock_offset", {"offset_s": -2.0 * DT_S}),
    ],
)
def test_sensor_effects_touch_their_own_tap_only(
    rig: Rig, effect: str, parameters: dict[str, float]
) -> None:
    odd = attach(rig, effect, "end", **parameters)
    (p, r), _ = rig_a([rig, odd], step_and_hold(), 3e5)
    others = [SUPPLY, VALVE_OUT, MIDDLE, EXHAUST]
    assert np.all(r[:, others] == p[:, others])
    p, r = p[:, END], r[:, END]
    if effect == "sensor_bias":
        np.testing.assert_allclose(r, p + 2e3)
    elif effect == "sensor_gain":
        np.testing.assert_allclose(r - ROOM_PA, 1.05 * (p - ROOM_PA))
    elif effect == "clock_offset" and parameters["offset_s"] > 0.0:
        np.testing.assert_allclose(r[2:], p[:-2], rtol=1e-9)
    elif effect == "clock_offset":
        np.testing.assert_allclose(r[:-2], p[2:], rtol=1e-9)
    else:  # lag r' + r = p, integrated over everything: lag (r_end - r_start) = integral of p - r
        area = float(np.sum(0.5 * (p - r)[1:] + 0.5 * (p - r)[:-1])) * DT_S
        assert 6e-3 * (r[-1] - r[0]) == pytest.approx(area, rel=0.02)
        assert np.max(np.abs(np.diff(r))) < np.max(np.abs(np.diff(p)))


@pytest.mark.parametrize("shift", [2, -2])
def test_common_clock_offset_shifts_every_tap(rig: Rig, shift: int) -> None:
    odd = attach(rig, "common_clock_offset", "taps", offset_s=shift * DT_S)
    (p, r), _ = rig_a([rig, odd], step_and_hold(), 3e5)
    if shift > 0:
        np.testing.assert_allclose(r[shift:], p[:-shift], rtol=1e-9)
    else:
        np.testing.assert_allclose(r[:shift], p[-shift:], rtol=1e-9)


def test_late_clocks_look_like_a_late_valve(rig: Rig) -> None:
    late = attach(rig, "common_clock_offset", "taps", offset_s=2.0 * DT_S)
    slow = attach(rig, "valve_delay", "valve", delay_s=2.0 * DT_S)
    (plain, clock, valve), _ = rig_a([rig, late, slow], step_and_hold(), 3e5)
    np.testing.assert_allclose(clock[2:], valve[2:], rtol=1e-6)
    assert np.max(np.abs(clock - plain)) > 1e4


def test_a_single_tap_has_no_common_clock(rig: Rig) -> None:
    rig.taps = {"end": rig.taps["end"]}
    assert registry()["common_clock_offset"].places(rig) == []
    assert registry()["clock_offset"].places(rig) == ["end"]
