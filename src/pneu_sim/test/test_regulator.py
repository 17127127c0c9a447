# SPDX-License-Identifier: Apache-2.0
"""Pressure regulators: where they settle, what flow costs them, how they step, and any cut."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from tests.references import iso6358

from pneu_common.validation import sentence
from pneu_sim import stepping
from pneu_sim import tile as tiles
from pneu_sim.models import kind_of
from pneu_sim.plant import Plant
from pneu_sim.rig.build import build
from pneu_sim.rig.plan import plan_grid
from pneu_sim.rig.schema import Rig
from pneu_sim.simulate import even_course, initial_field
from pneu_sim.simulator import Simulator

Floats = NDArray[np.float64]

CONDUCTANCE, RATIO, LOAD, VOLUME = 1e-8, 0.3, 2e-9, 5e-4
SUPPLY_PA, ROOM_PA, ROOM_K = 7e5, 1e5, 293.15
LOW_PA, HIGH_PA = 1e5, 6e5
DEAD_PA, BAND_PA = 1e3, 5e4  # 0.2 and 10 % of the range, which are the defaults
GAMMA, R_GAS = 1.4, 287.05
MODELS = ["pde", "thin_plate", "delay_line"]


def rig_with(
    model: str = "pde",
    load: float = 0.0,
    volume_m3: float = VOLUME,
    at_pipe: bool = False,
    parts: dict[str, Any] | None = None,
    **valve: Any,
) -> Rig:
    """A regulator that feeds a vessel with a load, itself or through a line."""
    room = {"pressure_pa": ROOM_PA}
    start = "out" if at_pipe else "vessel"
    end = "vessel" if at_pipe else "closed"
    orifice = {"from": "vessel", "to": "room", "conductance_m3_s_pa": load, "critical_ratio": 0.3}
    return Rig.model_validate(
        {
            "name": "bench",
            "model": model,
            "ambient": {"pressure_pa": ROOM_PA, "temperature_k": ROOM_K},
            "reservoirs": {"tank": {"pressure_pa": SUPPLY_PA}, "room": room},
            "chambers": {"vessel": {"volume_m3": volume_m3}},
            "pipes": {"line": {"from": start, "to": end, "length_m": 0.3, "area_m2": 2e-5}},
            "valves": {
                "regulator": {
                    "kind": "regulator",
                    "command": "u",
                    "supply": "tank",
                    "outlet": start,
                    "exhaust": "room",
                    "conductance_m3_s_pa": CONDUCTANCE,
                    "critical_ratio": RATIO,
                    "low_pa": LOW_PA,
                    "high_pa": HIGH_PA,
                    **valve,
                }
            },
            "orifices": {"load": orifice} if load else {},
            "commands": {"u": {}},
            "taps": {"tap": {"chamber": "vessel"}},
            **(parts or {}),
        }
    )


def set_point(volts: float) -> float:
    return LOW_PA + (HIGH_PA - LOW_PA) * min(max(volts / 10.0, 0.0), 1.0)


@pytest.mark.parametrize("model", MODELS)
def test_without_flow_it_settles_within_its_dead_zone(model: str) -> None:
    """Up, down, and beyond what it knows."""
    simulator = Simulator(rig_with(model))
    for volts in (5.0, 5.01, 8.0, 3.0, 0.5, 10.0, 14.0, 1.0):
        held = simulator.run(3.0, {"u": volts}, 0.01).chambers["vessel"]
        assert np.abs(held[-50:] - set_point(volts)).max() <= 1.02 * DEAD_PA, volts
    # a command within the dead zone moves nothing
    simulator.reset()
    before = simulator.run(5.0, {"u": 5.0}, 0.01).chambers["vessel"][-1]
    after = simulator.run(1.0, {"u": 5.005}, 0.01).flows["regulator.fill"]
    assert before < set_point(5.0) and abs(after[-1]) < 5e-6


@pytest.mark.parametrize("load", [0.5e-9, 2e-9, 5e-9])
@pytest.mark.parametrize("leakage", [0.0, 0.02])
def test_flow_makes_it_sag_as_the_balance_of_flows_says(load: float, leakage: float) -> None:
    """Where the opening that the sag asks for lets in what the load takes (ISO 6358)."""
    # a wall that keeps its gas at the room's temperature
    vessel = {"volume_m3": VOLUME, "heat_w_per_k": 50.0}
    rig = rig_with(load=load, leakage=leakage, parts={"chambers": {"vessel": vessel}})
    simulator = Simulator(rig)
    for volts in (2.0, 6.0, 9.5):
        run = simulator.run(4.0, {"u": volts}, 0.01)

        def opening(beyond: float) -> float:
            return leakage + (1.0 - leakage) * min(max((beyond - DEAD_PA) / BAND_PA, 0.0), 1.0)

        def surplus(p: float, goal: float = set_point(volts)) -> float:
            enters = iso6358.mass_flow(CONDUCTANCE, RATIO, SUPPLY_PA, ROOM_K, p)
            leaves = iso6358.mass_flow(CONDUCTANCE, RATIO, p, ROOM_K, ROOM_PA)
            taken = iso6358.mass_flow(load, 0.3, p, ROOM_K, ROOM_PA)
            return opening(goal - p) * enters - opening(p - goal) * leaves - taken

        want = brentq(surplus, 1.01 * ROOM_PA, set_point(volts) + BAND_PA)
        assert run.chambers["vessel"][-1] == pytest.approx(want, abs=25.0)
        assert abs(set_point(volts) - want) > DEAD_PA


def test_an_integral_takes_the_sag_away_but_for_the_dead_zone() -> None:
    for model in MODELS:
        run = Simulator(rig_with(model, LOAD, integral_s=0.1)).run(4.0, {"u": 6.0}, 0.01)
        held = run.chambers["vessel"][-150:]
        assert np.abs(held - set_point(6.0)).max() < 1.3 * DEAD_PA, model


def loop_and_vessel(
    time_s: Floats, goal_pa: float, start_pa: float, adiabatic: bool, load: float
) -> Floats:
    """Pressures of a vessel behind a regulator, by an ODE solver of general use."""
    lag_s, sensor_s = 1.0 / (2.0 * np.pi * 50.0), 2e-3

    def rates(_: float, y: Floats) -> list[float]:
        mass, energy, seen, spool = y
        t = energy * (GAMMA - 1.0) / (mass * R_GAS) if adiabatic else ROOM_K
        p = mass * R_GAS * t / VOLUME
        beyond = goal_pa - seen
        beyond -= min(max(beyond, -DEAD_PA), DEAD_PA)
        asked = min(max(beyond / BAND_PA, -1.0), 1.0)
        enters = max(spool, 0.0) * iso6358.mass_flow(CONDUCTANCE, RATIO, SUPPLY_PA, ROOM_K, p)
        leaves = max(-spool, 0.0) * iso6358.mass_flow(CONDUCTANCE, RATIO, p, t, ROOM_PA)
        if load:
            leaves += iso6358.mass_flow(load, 0.3, p, t, ROOM_PA)
        cp = R_GAS * GAMMA / (GAMMA - 1.0)
        heat = cp * (enters * ROOM_K - leaves * t)
        return [enters - leaves, heat, (p - seen) / sensor_s, (asked - spool) / lag_s]

    mass = start_pa * VOLUME / (R_GAS * ROOM_K)
    start = [mass, start_pa * VOLUME / (GAMMA - 1.0), start_pa, 0.0]
    found = solve_ivp(
        rates, (0.0, time_s[-1]), start, t_eval=time_s, rtol=1e-7, atol=1e-9, max_step=1e-3
    )
    if adiabatic:
        return np.asarray((GAMMA - 1.0) * found.y[1] / VOLUME)
    return np.asarray(found.y[0] * R_GAS * ROOM_K / VOLUME)


@pytest.mark.parametrize(("start_pa", "volts"), [(ROOM_PA, 6.0), (5e5, 3.0), (3e5, 4.5)])
@pytest.mark.parametrize("load", [0.0, LOAD])
def test_a_step_is_that_of_its_equations(start_pa: float, volts: float, load: float) -> None:
    """The vessel without heat against the same equations by another solver."""
    pipe = {"from": "vessel", "to": "closed", "length_m": 0.05, "area_m2": 1e-7}
    rig = rig_with(load=load, parts={"pipes": {"line": pipe}})
    simulator = Simulator(rig, dx_m=0.02)
    simulator.reset({"vessel": start_pa, "line": start_pa})
    run = simulator.run(0.6, {"u": volts}, 2e-3)
    want = loop_and_vessel(run.time_s, set_point(volts), start_pa, True, load)
    assert np.ptp(want) > 1.5e4
    assert np.abs(run.chambers["vessel"] - want).max() < 0.001 * np.ptp(want) + 10.0


def test_a_step_of_the_lumped_model_is_that_of_an_isothermal_vessel() -> None:
    """Choked, an ideal orifice passes what the port does; the rest is the same loop."""
    pipe = {"from": "vessel", "to": "closed", "length_m": 0.05, "area_m2": 1e-7}
    rig = rig_with("thin_plate", parts={"pipes": {"line": pipe}})
    simulator = Simulator(rig)
    run = simulator.run(0.4, {"u": 2.5}, 2e-3)
    want = loop_and_vessel(run.time_s, set_point(2.5), ROOM_PA, False, 0.0)
    assert np.abs(run.chambers["vessel"] - want).max() < 0.01 * np.ptp(want)


def volts_at_random(intervals: int) -> Floats:
    rng = np.random.default_rng(8)
    every = rng.uniform(-1.0, 11.0, (1, 1, intervals))
    hold = np.maximum.accumulate(np.where(np.arange(intervals) % 9 == 0, np.arange(intervals), 0))
    return every[:, :, hold]


CASES = [("pde", False), ("pde", True), ("thin_plate", False), ("delay_line", True)]


@pytest.mark.parametrize(("model", "at_pipe"), CASES)
def test_a_run_may_be_cut_anywhere(model: str, at_pipe: bool) -> None:
    rig = rig_with(model, LOAD, 1e-4, at_pipe, integral_s=0.2, delay_s=0.0123)
    whole, cut = Plant([rig]), Plant([rig])
    volts = volts_at_random(90)
    series, readings = whole.advance(volts, 3e-3)
    for cuts in ([1, 2, 9, 31], list(range(1, 90))):
        cut.reset()
        for a, b in pairwise([0, *cuts, 90]):
            piece, shown = cut.advance(volts[:, :, a:b], 3e-3)
            for name in ("taps", "flows", "chambers"):
                assert np.array_equal(getattr(piece, name), getattr(series, name)[a : b + 1]), name
            assert np.array_equal(shown, readings[a : b + 1])
    assert np.ptp(series.taps) > 1e5


@pytest.mark.parametrize(("model", "at_pipe"), CASES)
def test_a_state_is_taken_up_and_put_into_others(model: str, at_pipe: bool) -> None:
    """Rigs side by side run as each would alone, from a state that was taken on the way."""
    rigs = [
        rig_with(model, LOAD, 1e-4, at_pipe, dead_zone_pa=dead, full_open_pa=band)
        for dead, band in ((500.0, 5e4), (5e3, 2e5), (2e3, 1e5))
    ]
    together = Plant(rigs)
    volts = volts_at_random(60)
    together.advance(volts[:, :, :25], 3e-3)
    state = together.state()
    want = together.advance(volts[:, :, 25:], 3e-3)[0]
    for k, rig in enumerate(rigs):
        alone = Plant([rig])
        alone.advance(volts[:, :, :25], 3e-3)
        if model == "pde":
            found = alone.advance(volts[:, :, 25:], 3e-3)[0]
            assert np.array_equal(found.chambers[..., 0], want.chambers[..., k])
        together.reset()
        together.set_state(state)
        again = together.advance(volts[:, :, 25:], 3e-3)[0]
        assert np.array_equal(again.flows, want.flows)
    assert not np.array_equal(want.chambers[..., 0], want.chambers[..., 1])


def test_a_tile_keeps_where_its_regulators_stand() -> None:
    model = build(rig_with(load=LOAD))
    tile = tiles.pack([model, model])
    assert "regulator_state" in tiles.CHANGING
    slots = tile.plan.slots
    tiles.fill_pipes(tile, np.full((slots, 2), ROOM_PA), np.full((slots, 2), ROOM_K))
    tiles.fill_chambers(tile, np.full((1, 2), ROOM_PA), np.full((1, 2), ROOM_K))
    opening = np.full((20, 3, tile.plan.ports.shape[0], 2), 0.5)
    stepping.advance(tile, 10, 5e-5, opening)
    assert (tile.regulator_state[0, 0] > ROOM_PA).all() and (tile.regulator_state[0, 1] > 0).all()
    tiles.forget(tile)
    assert not tile.regulator_state.any()


def general(**changes: Any) -> dict[str, Any]:
    """The regulator as the general valve, some of it otherwise."""
    plain = rig_with(at_pipe=True).dump()
    valve = plain["valves"]["regulator"]
    for path, value in changes.items():
        *way, last = path.split("__")
        part = valve
        for name in way:
            part = part[name]
        part[last] = value
    return dict(plain)


FAULTS = [
    ({"outlet": "tank"}, "valves.regulator: the regulator's outlet 'tank' is a reservoir, whose "),
    ({"high_pa": 9e4}, "valves.regulator: high_pa: found 90000, it must be above low_pa, 100000"),
    ({"command_v": [10.0, 0.0]}, "valves.regulator: command_v: found 10 to 0, it must increase"),
    ({"pwm_hz": 50.0}, "unknown key 'valves.regulator.pwm_hz'; known are "),
    ({"exhaust": "nowhere"}, "valves.regulator.ports.vent: node 'nowhere' is no pipe end, "),
]


@pytest.mark.parametrize(("valve", "said"), FAULTS)
def test_what_no_regulator_can_be(valve: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError) as error:
        rig_with(**valve)
    assert sentence(error.value, Rig).startswith(said), sentence(error.value, Rig)


def test_a_regulator_needs_an_exhaust() -> None:
    plain = {"kind": "regulator", "command": "u", "supply": "tank", "outlet": "vessel"}
    plain |= {"conductance_m3_s_pa": 1e-8, "high_pa": 6e5}
    with pytest.raises(ValidationError) as error:
        rig_with(parts={"valves": {"regulator": plain}})
    assert sentence(error.value, Rig) == "valves.regulator.exhaust: Field required"


OTHERWISE = [
    ("regulator__vent", "fill", "valves.regulator.regulator: fill and vent are both 'fill'; "),
    ("regulator__fill", "in", "valves.regulator.regulator.fill: 'in' is not among its ports "),
    ("ports__vent__from", "vessel", "valves.regulator.regulator: its fill 'fill' leads to 'out'"),
    ("ports__fill__model", "effective_area", "valves.regulator.ports.fill: model effective_area"),
    ("regulator__low_pa", 7e5, "valves.regulator.regulator: low_pa 700000 must be below high_pa "),
]


@pytest.mark.parametrize(("path", "value", "said"), OTHERWISE)
def test_what_no_general_regulator_can_be(path: str, value: Any, said: str) -> None:
    with pytest.raises(ValidationError) as error:
        Rig.model_validate(general(**{path: value}))
    assert sentence(error.value, Rig).startswith(said), sentence(error.value, Rig)


def test_the_general_form_is_the_same_rig() -> None:
    assert Rig.model_validate(general()) == rig_with(at_pipe=True)


@pytest.mark.parametrize("model", ["pde", "thin_plate"])
@pytest.mark.parametrize("kind", ["regulator", "3/2"])
def test_along_a_recording_it_is_what_it_is_in_a_simulator(model: str, kind: str) -> None:
    """Two ways to run a rig: told all commands beforehand, and one control interval at a time."""
    duty = {"kind": "3/2", "command": "u", "supply": "tank", "outlet": "vessel"}
    duty |= {"exhaust": "room", "conductance_m3_s_pa": 2e-9, "pwm_hz": 100.0}
    parts = {} if kind == "regulator" else {"valves": {"valve": duty}}
    rig = rig_with(model, LOAD, parts=parts)
    interval_s, count = 0.01, 120
    command = np.repeat([0.0, 0.6, 0.25, 0.9], 30) * (10.0 if kind == "regulator" else 1.0)
    simulator = Simulator(rig)
    run = simulator.run(count * interval_s, {"u": command}, interval_s)
    plan = plan_grid(rig)
    field = initial_field(rig, plan)
    readings = np.full((count + 1, 1), ROOM_PA)
    course = even_course(field, {"u": np.append(command, command[-1])}, interval_s, readings)
    (found,) = kind_of(rig).predict([[rig]], plan, [course], field)
    want = run.taps["tap"]
    assert np.ptp(want) > 5e4
    assert np.abs(found.readings[0, 0] - want).max() < 0.005 * np.ptp(want)
