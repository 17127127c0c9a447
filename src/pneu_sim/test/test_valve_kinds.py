# SPDX-License-Identifier: Apache-2.0
"""Kinds of valves: drawn out as by hand, pulses exact, mean flow under a duty in closed form."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from pneu_common.validation import sentence
from pneu_sim.plant import Plant
from pneu_sim.rig.build import build
from pneu_sim.rig.schema import Rig
from pneu_sim.signals import Signal
from pneu_sim.simulator import Simulator
from pneu_sim.valve import evenly_open, voltage_limits

Floats = NDArray[np.float64]

CONDUCTANCE = 4e-9
SUPPLY_PA, ROOM_PA, ROOM_K = 7e5, 1e5, 293.15
STEP_S = 1.25e-4


def rig_with(valve: dict[str, Any], model: str = "pde", **parts: Any) -> Rig:
    """A valve between a tank, two vessels and the room; a pipe because a rig has one."""
    vessel = {"volume_m3": 1.0}
    return Rig.model_validate(
        {
            "name": "bench",
            "model": model,
            "grid": {"dx_m": 0.05},
            "ambient": {"pressure_pa": ROOM_PA, "temperature_k": ROOM_K},
            "reservoirs": {"tank": {"pressure_pa": SUPPLY_PA}, "room": {"pressure_pa": ROOM_PA}},
            "chambers": {"a": vessel, "b": vessel},
            "pipes": {"line": {"from": "a", "to": "closed", "length_m": 0.1, "area_m2": 1e-5}},
            "valves": {"valve": {"command": "u", "conductance_m3_s_pa": CONDUCTANCE, **valve}},
            "commands": {"u": {}},
            "taps": {"tap": {"chamber": "a"}},
            **parts,
        }
    )


FIVE: dict[str, Any] = {
    "kind": "5/3",
    "supply": "tank",
    "outlets": ["a", "b"],
    "exhausts": ["room"],
}
THREE: dict[str, Any] = {"kind": "3/3", "supply": "tank", "outlet": "a", "exhaust": "room"}
TWO: dict[str, Any] = {"kind": "2/2", "supply": "tank", "outlet": "a"}


def opening_at(rig: Rig, volts: float) -> dict[str, float]:
    """Opening of every port of the valve where its spool has come to rest."""
    signal = Signal(np.zeros(1), np.array([volts]))
    model = build(rig)
    found = evenly_open(model, {"u": signal}, 1.0, 1e-3, 2)[-1]
    names = [name.partition(".")[2] for name in model.plan.port_names]
    return dict(zip(names, found.tolist(), strict=True))


def test_a_5_3_valve_is_the_general_one_that_a_hand_would_write() -> None:
    path = {"conductance_m3_s_pa": CONDUCTANCE, "critical_ratio": 0.25}
    vent = {"conductance_m3_s_pa": 5e-9, "critical_ratio": 0.4}
    upwards = {"opening": {"voltage_v": [5.0, 9.5], "fraction": [0.0, 1.0]}}
    by_hand = {
        "command": "u",
        "spool": {"null_v": 5.0, "dead_band_v": 0.5, "bandwidth_hz": 100.0, "delay_s": 0.002},
        "ports": {
            "supply_a": {"from": "tank", "to": "a", **path, **upwards},
            "supply_b": {"from": "tank", "to": "b", **path, "opening": {"mirror": "supply_a"}},
            "exhaust_a": {"from": "a", "to": "room", **vent, "opening": {"mirror": "exhaust_b"}},
            "exhaust_b": {"from": "b", "to": "room", **vent, **upwards},
        },
    }
    short = {
        **FIVE,
        "critical_ratio": 0.25,
        "exhaust_conductance_m3_s_pa": 5e-9,
        "exhaust_critical_ratio": 0.4,
        "overlap_v": 0.5,
        "bandwidth_hz": 100.0,
        "delay_s": 0.002,
    }
    rig = rig_with(short)
    general = rig.model_copy(deep=True)
    general.valves = Rig.model_validate({**rig.dump(), "valves": {"valve": by_hand}}).valves
    assert rig == general
    assert Rig.model_validate(rig.dump()) == rig  # as a fit writes it and a file is read again


@pytest.mark.parametrize(("low", "high"), [(0.0, 10.0), (-1.0, 1.0), (0.0, 12.0)])
def test_what_the_outlets_of_a_5_3_valve_meet(low: float, high: float) -> None:
    """Drawn by hand: which of the paths P-A, P-B, A-R, B-R are open at which command."""
    centre_v = 5.0 if high == 12.0 else 0.5 * (low + high)
    lap = 0.1 * (high - centre_v)
    names = ("supply_a", "supply_b", "exhaust_a", "exhaust_b")
    at_centre = {
        "closed": (0.0, 0.0, 0.0, 0.0),
        "exhausted": (0.0, 0.0, 1.0, 1.0),
        "pressurised": (1.0, 1.0, 0.0, 0.0),
    }
    for centre, middle in at_centre.items():
        rig = rig_with(
            {
                **FIVE,
                "centre": centre,
                "overlap_v": lap,
                "command_v": [low, high],
                "centre_v": centre_v,
            }
        )
        want = {high: (1, 0, 0, 1), low: (0, 1, 1, 0), centre_v: middle}
        # at the overlap what is open at the centre is closed on one side, nothing opens yet
        keep = {k: middle[k] for k in range(4)}
        want[centre_v + lap] = (keep[0], 0, 0, keep[3])
        want[centre_v - lap] = (0, keep[1], keep[2], 0)
        for volts, paths in want.items():
            found = opening_at(rig, volts)
            assert [found[name] for name in names] == pytest.approx(paths, abs=2e-3), (
                centre,
                volts,
            )


def test_a_proportional_3_3_valve_is_that_of_the_thesis() -> None:
    """Thesis figs. 3.3 and 5.6: supply fully open at 10 V, closed at 5 V, exhaust open at 0 V."""
    rig = rig_with(THREE)
    for volts, paths in {
        10.0: (1, 0),
        7.5: (0.5, 0),
        5.0: (0, 0),
        2.5: (0, 0.5),
        0.0: (0, 1),
    }.items():
        found = opening_at(rig, volts)
        assert (found["supply"], found["exhaust"]) == pytest.approx(paths, abs=1e-9)
    for centre, paths in {"exhausted": (0, 0.3), "pressurised": (0.3, 0)}.items():
        more = {"centre": centre, "overlap_v": 0.5, "centre_opening": 0.3}
        found = opening_at(rig_with({**THREE, **more}), 5.0)
        assert (found["supply"], found["exhaust"]) == pytest.approx(paths, abs=1e-6)


def test_a_5_3_valve_fills_one_vessel_and_empties_the_other() -> None:
    """Choked either way: C rho0 p, with the pressure that drives it (ISO 6358)."""
    rig = rig_with(FIVE)
    simulator = Simulator(rig)
    simulator.reset({"b": 6e5})
    flows = simulator.run(0.05, {"u": 10.0}, 5e-3).flows
    assert flows["valve.supply_a"][-1] == pytest.approx(CONDUCTANCE * 1.185 * SUPPLY_PA, rel=2e-3)
    assert flows["valve.exhaust_b"][-1] == pytest.approx(CONDUCTANCE * 1.185 * 6e5, rel=4e-3)
    assert flows["valve.supply_b"][-1] == flows["valve.exhaust_a"][-1] == 0.0


def opened(rig: Rig, time_s: list[float], command: list[float], end_s: float) -> Floats:
    """(n, ports) openings every 1.25e-4 s from 0 s on; of steps they are means about each."""
    signal = Signal(np.array(time_s), np.array(command))
    return evenly_open(build(rig), {"u": signal}, 0.0, STEP_S, round(end_s / STEP_S) + 1)


PULSES = [
    # opening delay, closing delay, movement, pulse; ms
    (1.5, 1.5, 0.5, 2.0),
    (3.0, 1.0, 0.5, 2.6),
    (1.0, 3.0, 0.5, 0.4),
    (5.0, 7.0, 1.0, 2.0),
    (3.0, 1.0, 0.5, 1.9),
    (1.5, 1.5, 1.0, 0.6),
    (2.0, 2.0, 0.0, 2.0),
]


@pytest.mark.parametrize("normally", ["closed", "open"])
@pytest.mark.parametrize(("opens", "closes", "moves", "pulse"), PULSES)
def test_a_pulse_is_delayed_and_as_long_as_the_delays_make_it(
    normally: str, opens: float, closes: float, moves: float, pulse: float
) -> None:
    """A trapezoid by hand: it begins after the delay of opening and its area is its length."""
    valve = {
        **TWO,
        "normally": normally,
        "opening_delay_s": 1e-3 * opens,
        "closing_delay_s": 1e-3 * closes,
        "movement_s": 1e-3 * moves,
    }
    shut, free = (0.0, 24.0) if normally == "closed" else (24.0, 0.0)
    begin_s = 10.1e-3  # on no knot
    end_s = begin_s + 1e-3 * pulse
    x = opened(rig_with(valve), [0.0, begin_s, end_s], [shut, free, shut], 0.04)[:, 0]
    length = pulse + closes - opens
    want = 0.0 if length <= 0.0 else (length if length >= moves else length**2 / moves)
    assert 1e3 * np.trapezoid(x, dx=STEP_S) == pytest.approx(want, abs=1e-6)
    if want > 0.0:
        # its centre of gravity is halfway between its ends
        times = 1e3 * STEP_S * np.arange(x.size)
        peak = min(length / moves, 1.0) if moves > 0.0 else 1.0
        last = 1e3 * begin_s + pulse + closes + peak * moves
        middle = 0.5 * (1e3 * begin_s + opens + last)
        assert float(times @ x / x.sum()) == pytest.approx(middle, abs=1e-3)
        assert x.max() == pytest.approx(peak, abs=0.12)
        assert not x[times < 1e3 * begin_s + opens - 0.13].any()


def test_a_3_2_valve_exhausts_while_it_does_not_supply() -> None:
    valve = {**TWO, "kind": "3/2", "exhaust": "room", "closing_delay_s": 0.003}
    times, command = [0.0, 0.01, 0.02], [0.0, 24.0, 0.0]
    x = opened(rig_with(valve), times, command, 0.04)
    assert np.allclose(x.sum(axis=1), 1.0) and x[0].tolist() == [0.0, 1.0]
    other = opened(rig_with({**valve, "normally": "open"}), times, [24.0, 0.0, 24.0], 0.04)
    assert np.allclose(other, x, atol=1e-12)  # open is that the supply is, whatever the current
    reverse = {**valve, "command_v": [5.0, 0.0]}
    assert np.allclose(opened(rig_with(reverse), times, [5.0, 0.0, 5.0], 0.04), x, atol=1e-12)


def edges(duty: list[float], control_s: float, hz: float, end_s: float) -> tuple[Any, Any]:
    """What a timer makes of duties: switched on as a period begins, off after its share of it."""
    times, volts = [], []
    for k in range(-2, math.ceil(end_s * hz) + 1):
        held = duty[min(max(math.floor(k / hz / control_s + 1e-9), 0), len(duty) - 1)]
        if held > 0.0:
            times.append(k / hz)
            volts.append(24.0)
        if held < 1.0:
            times.append((k + held) / hz)
            volts.append(0.0)
    return times, volts


@pytest.mark.parametrize("hz", [40.0, 100.0, 130.0, 333.0])
@pytest.mark.parametrize("closing_s", [0.0005, 0.0015, 0.003])
def test_a_duty_switches_as_the_pulses_it_stands_for(hz: float, closing_s: float) -> None:
    """The same valve once with a duty every 10 ms, once with all its pulses as commands."""
    rng = np.random.default_rng(int(hz))
    control_s, end_s = 0.01, 0.4
    duty = np.clip(rng.uniform(-0.2, 1.2, 40), 0.0, 1.0)
    valve = {**TWO, "closing_delay_s": closing_s}
    with_duty = rig_with({**valve, "pwm_hz": hz})
    found = opened(with_duty, [control_s * k for k in range(40)], duty.tolist(), end_s)
    want = opened(rig_with(valve), *edges(duty.tolist(), control_s, hz, end_s), end_s)
    assert np.allclose(found, want, atol=1e-9) and 0.2 < np.mean(want) < 0.9


def effective(duty: float, period: float, opens: float, closes: float, moves: float) -> float:
    """Mean opening under a duty: linear in it less the dead part, with its corners rounded."""
    if duty <= 0.0 or duty >= 1.0:
        return float(duty >= 1.0)
    length = duty * period + closes - opens
    gap = period - length
    if length <= 0.0 or gap <= 0.0:
        return float(gap <= 0.0)
    if length < moves:
        return length**2 / moves / period
    if gap < moves:
        return 1.0 - gap**2 / moves / period
    return length / period


@pytest.mark.parametrize("model", ["pde", "thin_plate"])
@pytest.mark.parametrize(
    ("hz", "opens", "closes", "moves"),
    [(50.0, 3e-3, 1.5e-3, 1e-3), (100.0, 1.5e-3, 2.5e-3, 5e-4), (125.0, 12e-3, 12e-3, 1e-3)],
)
def test_mean_flow_against_duty(
    model: str, hz: float, opens: float, closes: float, moves: float
) -> None:
    """Choked, the mean flow is that of the open valve times the mean opening in closed form."""
    valve = {
        **TWO,
        "pwm_hz": hz,
        "opening_delay_s": opens,
        "closing_delay_s": closes,
        "movement_s": moves,
    }
    full = CONDUCTANCE * 1.185 * SUPPLY_PA
    for duty in (0.0, 0.05, 0.15, 0.2, 0.5, 0.7, 0.93, 1.0):
        simulator = Simulator(rig_with(valve, model))
        simulator.run(0.1, {"u": duty}, 0.01)
        flows = simulator.run(0.4, {"u": duty}, 1e-4).flows["valve.supply"]
        want = effective(duty, 1.0 / hz, opens, closes, moves)
        assert np.mean(flows[1:]) / full == pytest.approx(want, abs=2e-3), duty


def test_the_mass_that_a_duty_lets_in() -> None:
    """The same by what is in the vessel in the end, commanded every 10 ms, on coarse cells too."""
    valve = {**TWO, "pwm_hz": 100.0, "opening_delay_s": 0.003, "closing_delay_s": 0.001}
    for grid in ({"dx_m": 0.05}, {"dx_m": 0.5}):
        rig = rig_with(valve, grid=grid)
        simulator = Simulator(rig)
        simulator.run(0.1, {"u": 0.4}, 0.01)
        before = float(simulator.mass_kg())
        simulator.run(0.5, {"u": 0.4}, 0.01)
        mean = (float(simulator.mass_kg()) - before) / 0.5
        want = CONDUCTANCE * 1.185 * SUPPLY_PA * 0.2
        assert mean == pytest.approx(want, rel=3e-3)


@pytest.mark.parametrize("model", ["pde", "delay_line"])
@pytest.mark.parametrize("hz", [37.0, 100.0])
def test_a_run_under_duties_may_be_cut_anywhere(model: str, hz: float) -> None:
    valve = {
        **TWO,
        "kind": "3/2",
        "exhaust": "room",
        "pwm_hz": hz,
        "opening_delay_s": 0.004,
        "closing_delay_s": 0.0013,
    }
    rig = rig_with(valve, model, chambers={"a": {"volume_m3": 1e-4}})
    duty = np.random.default_rng(5).uniform(0.0, 1.0, (1, 1, 60))
    whole, cut = Plant([rig]), Plant([rig])
    for interval_s in (0.01, 0.003):
        whole.reset()
        series, readings = whole.advance(duty, interval_s)
        for cuts in ([1, 2, 9, 31], list(range(1, 60))):
            cut.reset()
            for a, b in pairwise([0, *cuts, 60]):
                piece, shown = cut.advance(duty[:, :, a:b], interval_s)
                assert np.array_equal(piece.flows, series.flows[a : b + 1])
                assert np.array_equal(piece.taps, series.taps[a : b + 1])
                assert np.array_equal(shown, readings[a : b + 1])
        assert np.ptp(series.taps) > 5e4


def test_a_state_under_duties_is_taken_up() -> None:
    valve = {**TWO, "pwm_hz": 45.0, "opening_delay_s": 0.03, "closing_delay_s": 0.02}
    plant = Plant([rig_with(valve, chambers={"a": {"volume_m3": 1e-4}})])
    duty = np.random.default_rng(6).uniform(0.0, 1.0, (1, 1, 40))
    plant.advance(duty[:, :, :17], 0.01)
    state = plant.state()
    want = plant.advance(duty[:, :, 17:], 0.01)[0].taps
    plant.reset()
    plant.set_state(state)
    assert np.array_equal(plant.advance(duty[:, :, 17:], 0.01)[0].taps, want)


FAULTS = [
    ({"kind": "5/4"}, "valves.valve: kind: found '5/4', a valve's kind is one of general, 5/3, "),
    ({**FIVE, "pwm_hz": 100.0}, "unknown key 'valves.valve.pwm_hz'; known are "),
    ({**FIVE, "outlets": ["a"]}, "valves.valve.outlets.1: Field required"),
    ({**FIVE, "supply": "cellar"}, "valves.valve.ports.supply_a: node 'cellar' is no pipe end, "),
    ({**FIVE, "centre": "exhausted"}, "valves.valve: overlap_v: found 0, a centre that is exhau"),
    ({**FIVE, "command_v": [10.0, 0.0]}, "valves.valve: command_v: found 10 to 0 about a centre"),
    ({**FIVE, "overlap_v": 5.0}, "valves.valve: overlap_v: found 5, it must be below 5, "),
    ({**TWO, "threshold_v": 30.0}, "valves.valve: threshold_v: found 30, it must be between "),
    ({**TWO, "command_v": [5.0, 5.0]}, "valves.valve: command_v: found 5 for off and for on; "),
    ({**TWO, "pwm_hz": 50.0, "command_v": [0.0, 24.0]}, "valves.valve: command_v: found one besi"),
    ({**TWO, "pwm_hz": 0.0}, "valves.valve.pwm_hz: Input should be greater than 0, found 0.0"),
    ({**TWO, "kind": "3/2"}, "valves.valve.exhaust: Field required"),
    ({**TWO, "normaly": "open"}, "unknown key 'valves.valve.normaly'; did you mean 'normally'?"),
]


@pytest.mark.parametrize(("valve", "said"), FAULTS)
def test_what_no_valve_can_be(valve: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError) as error:
        rig_with(valve)
    found = sentence(error.value, Rig)
    assert found.startswith(said) and "\n" not in found, found


def test_delays_may_be_longer_than_a_period() -> None:
    """Pulses are then on their way while the next ones are commanded; none is lost."""
    valve = {**TWO, "pwm_hz": 250.0, "opening_delay_s": 0.03, "closing_delay_s": 0.031}
    x = opened(rig_with(valve), [0.0], [0.5], 0.4)[:, 0]
    assert np.mean(x[800:2400]) == pytest.approx(0.75, abs=2e-3)


def test_the_range_of_a_modulated_command_is_that_of_a_duty_cycle() -> None:
    assert set(voltage_limits(rig_with(TWO | {"pwm_hz": 100.0})).values()) == {(0.0, 1.0)}
    (switched,) = voltage_limits(rig_with(TWO)).values()
    assert switched[1] > 1.0
