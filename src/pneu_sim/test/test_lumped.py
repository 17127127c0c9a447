# SPDX-License-Identifier: Apache-2.0
"""Lumped models against closed forms: filling, discharge, delay, attenuation; and their network."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from tests.references import iso6358
from tests.uncompiled import plain

from pneu_common.errors import InputError
from pneu_sim.lumped import filling
from pneu_sim.lumped.batch import predict
from pneu_sim.lumped.kinds import Lumped
from pneu_sim.lumped.model import LumpedModel
from pneu_sim.models import kind_of
from pneu_sim.rig import with_parameters
from pneu_sim.rig.load import load_rig
from pneu_sim.rig.plan import Plan, plan_grid
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sim.run import run_rig
from pneu_sim.simulate import Prediction, RunOptions, even_course, initial_field

R, GAMMA, T0 = 287.05, 1.4, 293.15
MU = 1.8134e-5  # air at 293.15 K: Sutherland's law, U.S. Standard Atmosphere 1976
SOUND = math.sqrt(GAMMA * R * T0)
CRITICAL = (2.0 / (GAMMA + 1.0)) ** (GAMMA / (GAMMA - 1.0))
HOLE = 0.02e-8  # m3/(s Pa), of the vessel
CONDUCTANCE = 0.3e-8  # of the line's valve
VESSEL, STUB = 20e-6, 0.5 * 4e-6  # m3: a chamber, and a closed tube that hangs on it
VOLUME = VESSEL + STUB
RIG_A = Path(__file__).parents[3] / "rigs" / "rig_a.yaml"


def reduced(rig: Rig, plan: Plan | None = None) -> LumpedModel:
    """The lumped model that a rig names."""
    kind = kind_of(rig)
    assert isinstance(kind, Lumped)
    return kind.build(rig, plan)


def vessel_rig(outside_pa: float, exponent: float, **changes: Any) -> Rig:
    """A vessel behind a fixed orifice."""
    data: dict[str, Any] = {
        "name": "vessel",
        "model": "thin_plate",
        "lumped": {"exponent": exponent},
        "ambient": {"temperature_k": T0},
        "reservoirs": {"outside": {"pressure_pa": outside_pa}},
        "chambers": {"vessel": {"volume_m3": VESSEL}},
        "pipes": {"stub": {"from": "vessel", "to": "closed", "length_m": 0.5, "area_m2": 4e-6}},
        "orifices": {"hole": {"from": "outside", "to": "vessel", "conductance_m3_s_pa": HOLE}},
        "taps": {"vessel": {"chamber": "vessel"}},
    }
    return Rig.model_validate({**data, **changes})


def line_rig(model: str, **changes: Any) -> Rig:
    """A tube of 2.5 m behind a valve that opens at once."""
    data: dict[str, Any] = {
        "name": "line",
        "model": model,
        "ambient": {"pressure_pa": 1e5, "temperature_k": T0},
        "reservoirs": {"supply": {"pressure_pa": 7e5}, "room": {"pressure_pa": 1e5}},
        "pipes": {
            "feed": {"from": "supply", "to": "in", "length_m": 1.0, "area_m2": 2e-5},
            "tube": {"from": "out", "to": "closed", "length_m": 2.5, "area_m2": 6e-6},
            "silencer": {"from": "gone", "to": "room", "length_m": 0.2, "area_m2": 1.2e-5},
        },
        "valves": {
            "valve": {
                "command": "volts",
                "ports": {
                    "fill": {
                        "from": "in",
                        "to": "out",
                        "conductance_m3_s_pa": CONDUCTANCE,
                        "opening": {"voltage_v": [5.0, 10.0], "fraction": [0.0, 1.0]},
                    },
                    "empty": {
                        "from": "out",
                        "to": "gone",
                        "conductance_m3_s_pa": CONDUCTANCE,
                        "opening": {"mirror": "fill"},
                    },
                },
            }
        },
        "commands": {"volts": {}},
        "taps": {
            "supply": {"pipe": "feed", "position_m": 0.9},
            "near": {"pipe": "tube", "position_m": 0.0},
            "middle": {"pipe": "tube", "position_m": 1.25},
            "end": {"pipe": "tube", "position_m": 2.5},
            "exhaust": {"pipe": "silencer", "position_m": 0.0},
        },
    }
    return Rig.model_validate({**data, **changes})


def roll(
    rigs: Rig | list[Rig],
    volts: NDArray[Any] | None,
    dt_s: float,
    samples: int,
    taps_pa: Any,
    **more: Any,
) -> Prediction:
    rigs = rigs if isinstance(rigs, list) else [rigs]
    plan = plan_grid(rigs[0])
    measured = np.broadcast_to(np.asarray(taps_pa, dtype=float), (samples, len(plan.taps)))
    commands = {} if volts is None else {"volts": volts}
    models = [reduced(rig, plan) for rig in rigs]
    field = initial_field(rigs[0], plan)
    course = even_course(field, commands, dt_s, measured, **more)
    return predict([models], [course], RunOptions(flows=True))[0]


def choked(conductance: float, p_up: float) -> float:
    """Mass flow of a sonic conductance by ISO 6358-1."""
    return iso6358.mass_flow(conductance, 0.0, p_up, T0, 0.0)


# ---- filling and discharge -----------------------------------------------------------------


@pytest.mark.parametrize("exponent", [1.0, 1.2, 1.4])
def test_choked_filling_is_linear_in_time(exponent: float) -> None:
    supply = 8e5
    p = roll(vessel_rig(supply, exponent), None, 1e-3, 301, [1e5]).readings[0, 0]
    slope = exponent * R * T0 * choked(HOLE, supply) / VOLUME
    time = np.arange(301) * 1e-3
    assert p[-1] < CRITICAL * supply
    np.testing.assert_allclose(p, 1e5 + slope * time, rtol=1e-7)


def test_subsonic_filling_takes_as_long_as_the_orifice_law_says() -> None:
    supply = 3e5
    p = roll(vessel_rig(supply, 1.0), None, 2e-3, 1000, [1.8e5]).readings[0, 0]

    def flow(x: float) -> float:  # thesis eq. 3.16 over eq. 3.17
        excess = x ** (2.0 / GAMMA) - x ** ((GAMMA + 1.0) / GAMMA)
        most = GAMMA * (2.0 / (GAMMA + 1.0)) ** ((GAMMA + 1.0) / (GAMMA - 1.0))
        return math.sqrt(2.0 * GAMMA / (GAMMA - 1.0) * excess / most)

    tau = VOLUME * supply / (R * T0 * choked(HOLE, supply))
    for share in (0.7, 0.9, 0.99):
        expected = tau * quad(lambda x: 1.0 / flow(x), 0.6, share)[0]
        assert np.interp(share * supply, p, np.arange(1000) * 2e-3) == pytest.approx(
            expected, rel=2e-4
        )


def test_choked_discharge_isothermal_and_adiabatic() -> None:
    start = 9e5
    tau = VOLUME * start / (R * T0 * choked(HOLE, start))
    time = np.arange(400) * 1e-2
    isothermal = roll(vessel_rig(1e3, 1.0), None, 1e-2, 400, [start]).readings[0, 0]
    adiabatic = roll(vessel_rig(1e3, 1.4), None, 1e-2, 400, [start]).readings[0, 0]
    assert isothermal[-1] < 0.1 * start
    np.testing.assert_allclose(isothermal, start * np.exp(-time / tau), rtol=1e-6)
    expected = [start * iso6358.adiabatic_discharge_pressure(t / tau) for t in time]
    np.testing.assert_allclose(adiabatic, expected, rtol=1e-6)


def test_two_vessels_settle_at_their_common_pressure() -> None:
    rig = vessel_rig(
        1e5,
        1.0,
        chambers={"vessel": {"volume_m3": VESSEL}, "other": {"volume_m3": 3 * VOLUME}},
        orifices={"hole": {"from": "vessel", "to": "other", "conductance_m3_s_pa": HOLE}},
        taps={"vessel": {"chamber": "vessel"}, "other": {"chamber": "other"}},
    )
    out = roll(rig, None, 1e-2, 1500, [6e5, 2e5])
    np.testing.assert_allclose(out.readings[0, :, -1], 3e5, rtol=1e-6)
    np.testing.assert_allclose(out.chambers[0, -1], 3e5, rtol=1e-6)
    assert out.flows[0, 0, 0] > 0.0


def test_leak_yielding_chamber_and_dead_volume_count() -> None:
    p = {}
    extra = AttachedEffect(
        effect="dead_volume",
        place="stub",
        parameters={"volume_m3": VOLUME, "position_m": 0.2},
    )
    lung = {"vessel": {"volume_m3": VESSEL, "compliance_m3_per_pa": 1e-10}}
    leak = {"vessel": {"volume_m3": VESSEL, "leak_area_m2": 1.5e-8}}
    for name, rig in {
        "plain": vessel_rig(8e5, 1.0),
        "dead": vessel_rig(8e5, 1.0, effects=[extra]),
        "lung": vessel_rig(8e5, 1.0, chambers=lung),
        "leak": vessel_rig(8e5, 1.0, chambers=leak, orifices={}),
    }.items():
        p[name] = roll(rig, None, 1e-3, 201, [2e5]).readings[0, 0]
    rise = p["plain"] - 2e5
    np.testing.assert_allclose(p["dead"] - 2e5, 0.5 * rise, rtol=1e-6)
    # isothermal: p (V + C (p - room)) grows by what enters
    room, c = 101325.0, 1e-10
    held = p["lung"] * (VOLUME + c * (p["lung"] - room))
    np.testing.assert_allclose(held - held[0], VOLUME * rise, rtol=1e-6, atol=1e-9)
    # choked leak from 2e5 Pa: exponential decay
    k = math.sqrt(GAMMA / R) * (2.0 / (GAMMA + 1.0)) ** ((GAMMA + 1.0) / (2.0 * (GAMMA - 1.0)))
    rate = R * T0 * k * 1.5e-8 / math.sqrt(T0) / VOLUME
    decay = 2e5 * np.exp(-rate * np.arange(201) * 1e-3)
    still_choked = room / decay < CRITICAL
    assert still_choked.sum() > 50
    np.testing.assert_allclose(p["leak"][still_choked], decay[still_choked], rtol=1e-6)


def test_porous_leaks_and_relief_valves_count() -> None:
    room, conductance = 101325.0, 2e-15
    leaks = {
        "stub": {"from": "vessel", "to": "closed", "length_m": 0.5, "area_m2": 4e-6,
                 "leaks": [{"position_m": 0.2, "porous_m3": 0.5 * conductance}]}
    }  # fmt: skip
    porous = {"vessel": {"volume_m3": VESSEL, "leak_porous_m3": 0.5 * conductance}}
    rig = vessel_rig(8e5, 1.0, chambers=porous, pipes=leaks, orifices={})
    p = roll(rig, None, 1e-3, 201, [4e5]).readings[0, 0]
    # isothermal: p' = -G (p^2 - room^2) / (2 mu V)
    decay = np.exp(-room * conductance / (MU * VOLUME) * np.arange(201) * 1e-3)
    x = (4e5 - room) / (4e5 + room) * decay
    np.testing.assert_allclose(p, room * (1.0 + x) / (1.0 - x), rtol=1e-4)
    assert p[-1] < 3.5e5
    valves = [
        {"area_m2": 1e-6, "set_pa": 3e5, "range_pa": 1e4},
        {"area_m2": 1e-6, "set_pa": 3.5e5},
    ]
    relief = {"vessel": {"volume_m3": VESSEL, "reliefs": valves}}
    rig = vessel_rig(8e5, 1.0, chambers=relief)
    held = roll(rig, None, 1e-3, 401, [2e5]).readings[0, 0, -1]
    # What the hole brings, choked, leaves through the partly open valve, choked.
    k = math.sqrt(GAMMA / R) * (2.0 / (GAMMA + 1.0)) ** ((GAMMA + 1.0) / (2.0 * (GAMMA - 1.0)))
    brought = HOLE * 1.185 * 8e5
    leaves = k * 1e-6 * (held - 3e5) / 1e4 * held / math.sqrt(T0)
    assert leaves == pytest.approx(brought, rel=2e-3)


# ---- what belongs to which volume ----------------------------------------------------------


def test_taps_on_open_lines_read_their_reservoir() -> None:
    volts = np.full(100, 10.0)
    out = roll(line_rig("thin_plate"), volts, 1e-3, 100, [7.1e5, 2e5, 2e5, 2e5, 1.2e5])
    assert (out.readings[0, 0] == 7e5).all()
    assert (out.readings[0, 4] == 1e5).all()
    near, middle, end = out.readings[0, 1:4]
    assert (near == end).all() and (near == middle).all() and near[-1] > near[0]


def test_runs_start_at_the_mean_of_the_taps_and_are_drawn_to_it() -> None:
    volts = np.full(60, 5.0)
    taps = np.tile([7e5, 2e5, 2.5e5, 3e5, 1e5], (60, 1))
    taps[30:, 1:4] = 4e5
    free = roll(line_rig("thin_plate"), volts, 1e-3, 60, taps)
    np.testing.assert_allclose(free.readings[0, 3], 2.5e5, rtol=1e-12)
    gain = 1.0 - math.exp(-1e-3 / 2e-3)
    drawn = roll(line_rig("thin_plate"), volts, 1e-3, 60, taps, gain=gain)
    # The pull lasts over the 60 readings, on average once in 59 / 60 ms.
    goal = 4e5 - 1.5e5 * math.exp(-(45 - 29.5) / 2.0 * 60 / 59)
    assert drawn.readings[0, 3, 45] == pytest.approx(goal, abs=20.0)


def test_one_pressure_for_a_branched_volume() -> None:
    pipes = {
        "a": {"from": "tee", "to": "closed", "length_m": 1.0, "area_m2": 6e-6},
        "b": {"from": "tee", "to": "vessel", "length_m": 2.0, "area_m2": 3e-6},
        "c": {"from": "tee", "to": "closed", "length_m": 0.5, "area_m2": 4e-6},
    }
    whole = VESSEL + 6e-6 + 6e-6 + 2e-6
    branched = roll(vessel_rig(8e5, 1.0, pipes=pipes), None, 1e-3, 101, [1e5])
    slope = R * T0 * choked(HOLE, 8e5) / whole
    assert branched.readings[0, 0, -1] == pytest.approx(1e5 + 0.1 * slope, rel=1e-9)


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        (
            {
                "reservoirs": {"outside": {"pressure_pa": 8e5}, "room": {"pressure_pa": 1e5}},
                "pipes": {"p": {"from": "outside", "to": "room", "length_m": 1, "area_m2": 1e-6}},
            },
            "reservoirs 'outside' and 'room' joined by pipes alone",
        ),
        (
            {
                "chambers": {},
                "orifices": {},
                "pipes": {"p": {"from": "outside", "to": "closed", "length_m": 1, "area_m2": 1e-6}},
                "taps": {"t": {"pipe": "p"}},
            },
            "needs a closed volume to fill",
        ),
    ],
)
def test_rigs_without_a_reduction_are_refused(changes: dict[str, Any], fault: str) -> None:
    with pytest.raises(InputError, match=fault):
        reduced(vessel_rig(8e5, 1.0, **changes))


def test_batch_is_the_same_as_one_by_one() -> None:
    rng = np.random.default_rng(3)
    volts = np.repeat(rng.uniform(0.0, 10.0, 12), 10)
    taps = np.tile([7e5, 3e5, 3e5, 3e5, 1e5], (120, 1)) + rng.normal(0.0, 1e3, (120, 5))
    base = line_rig("delay_line")
    path = "valves.valve.ports.fill.conductance_m3_s_pa"
    rigs = [with_parameters(base, {path: c}) for c in (0.35e-8, 0.4e-8, 0.45e-8)]
    batch = roll(rigs, volts, 2e-3, 120, taps, gain=0.01)
    assert batch.readings.shape == (3, 5, 120) and batch.flows.shape == (3, 120, 2)
    for m, rig in enumerate(rigs):
        alone = roll(rig, volts, 2e-3, 120, taps, gain=0.01)
        np.testing.assert_allclose(batch.readings[m], alone.readings[0], rtol=1e-12)
    assert (batch.readings[0] != batch.readings[1]).any()


# ---- the line ------------------------------------------------------------------------------


def test_a_step_arrives_after_the_distance_over_the_speed_of_sound() -> None:
    dt = 1e-4
    time = np.arange(300) * dt
    out = roll(line_rig("delay_line"), np.full(300, 10.0), dt, 300, [7e5, 1e5, 1e5, 1e5, 1e5])
    near, middle, end = out.readings[0, 1:4]
    arrival = 2.5 / SOUND
    assert 7.2e-3 < arrival < 7.4e-3
    tick = 5e-4  # readings are linear between the model's ticks
    assert near[1] > 1e5  # the valve's end does not wait
    assert (end[time < arrival - tick] == 1e5).all()
    assert (end[time > arrival + dt] > 1e5).all()
    for tap, distance in ((middle, 1.25), (end, 2.5)):
        late = time > distance / SOUND + tick
        shifted = np.interp(time[late] - distance / SOUND, time, near)
        np.testing.assert_allclose(tap[late], shifted, rtol=1e-4)


@pytest.mark.parametrize("law", ["laminar", "turbulent", "larger"])
def test_flow_is_attenuated_as_richer_and_hurmuzlu_say(law: str) -> None:
    rig = line_rig("delay_line", lumped={"resistance": law})
    dt = 1e-3
    near = roll(rig, np.full(40, 10.0), dt, 40, [7e5, 1e5, 1e5, 1e5, 1e5]).readings[0, 1]
    m = choked(CONDUCTANCE, 7e5)
    diameter = math.sqrt(4.0 * 6e-6 / math.pi)
    reynolds = 4.0 * m / (math.pi * diameter * MU)
    laminar = 32.0 * MU / diameter**2
    turbulent = 0.158 * MU / diameter**2 * reynolds**0.75
    resistance = {"laminar": laminar, "turbulent": turbulent, "larger": turbulent}[law]
    assert reynolds > 2300.0 and turbulent > laminar
    near = near[near < CRITICAL * 7e5]
    assert near.size > 15
    slope = np.gradient(near, dt)[1:-1]
    p = near[1:-1]
    passed = np.exp(-resistance * R * T0 * 2.5 / (2.0 * p * SOUND))
    assert passed[0] < 0.9
    expected = R * T0 * m / (2.5 * 6e-6) * passed
    np.testing.assert_allclose(slope, expected, rtol=5e-3)


def test_line_without_resistance_comes_to_the_same_rest_everywhere() -> None:
    volts = np.where(np.arange(400) < 20, 10.0, 5.0)
    out = roll(line_rig("delay_line"), volts, 1e-3, 400, [7e5, 1e5, 1e5, 1e5, 1e5])
    near, middle, end = out.readings[0, 1:4, -1]
    assert near == pytest.approx(end, rel=1e-12) and near == pytest.approx(middle, rel=1e-12)
    assert 1.1e5 < near < 7e5


def test_rig_a_fills_to_the_supply_and_empties_to_the_room() -> None:
    rig = load_rig(RIG_A)
    volts = np.repeat([10.0, 0.0], 1000)
    for model in ("thin_plate", "delay_line"):
        taps = run_rig(rig.model_copy(update={"model": model}), {"voltage": volts}, 2e-3)
        assert taps["end"][0] == 101000.0
        assert taps["end"][999] == pytest.approx(635000.0, rel=1e-3)
        assert taps["end"][-1] == pytest.approx(101000.0, rel=1e-3)


# ---- rates, as plain Python ----------------------------------------------------------------


def volumes(side: list[int], volume: Any, delays: Any, tap: list[int]) -> filling.Volumes:
    """Volumes of one rig with ports that are shut, in a room of 1e5 Pa and 290 K."""
    ports = len(side) // 2
    return filling.Volumes(
        GAMMA, R, np.float64(1.3), np.array(side, dtype=np.int64), np.zeros(ports),
        np.full(ports, 0.999), np.array([[6e5, 300.0]]), np.array(volume),
        np.array(tap, dtype=np.int64), np.zeros(0, dtype=np.int64), np.array(delays),
        np.zeros((2 * ports, 2 * ports)), np.zeros((2 * ports, 2)), np.array([1e5, 290.0]),
        np.zeros((0, 2), dtype=np.int64), np.zeros((0, 9)),
    )  # fmt: skip


def shares_of(base: list[float], now: Any, past: Any, head: int, ports: int) -> filling.Shares:
    return filling.Shares(
        np.array(base), np.array(now), past, np.array([head]), np.zeros(ports), np.zeros((0, 3))
    )


@pytest.mark.parametrize("porous", [0.0, 3e-15])
@pytest.mark.parametrize("pressure", [4e5, 0.8e5])
@pytest.mark.parametrize("pull", [0.0, 12.0])
def test_gas_that_is_drawn_enters_by_the_gas_law(
    pull: float, pressure: float, porous: float
) -> None:
    """Of three volumes with yielding walls the second has two of four taps, one without a goal."""
    size, yields, rest = 2e-5, 3e-11, 1.5e5
    rows = [[9e-5, 0.0, 0.0, 0.0, 0.0], [size, yields, rest, 0.0, porous], [7e-5] + [0.0] * 4]
    rig = volumes([], rows, np.zeros((5, 0)), [0, 1, 1, 2, 1])
    mass = 8e-5
    held = pressure * (size + yields * (pressure - rest))
    temperature = held / (mass * R)
    base = [2e5, pressure - 5e3, 3e5]
    now = [0.0, 5e3, 0.0, 1e-4, mass, 2e-4]  # common shares, then masses
    scratch = filling.Scratch(
        np.zeros(6), np.zeros(6), np.full(6, np.nan), np.zeros(0), np.zeros(0),
        np.array([2.5e5, pressure + 3e3, np.nan, 3e5, pressure - 1e4]),
    )  # fmt: skip
    shares = shares_of(base, now, np.zeros((3, 0)), 0, 0)
    plain(filling._rates)(rig, shares, scratch, 340.0, pull, 0.0, 1e-3)
    drawn = pull * (3e3 - 1e4) / 2.0

    def mass_at(p: float) -> float:
        return p * (size + yields * (p - rest)) / (R * temperature)

    leak = porous * (pressure**2 - 1e5**2)
    carried = temperature if leak > 0.0 else 290.0
    room = size + yields * (pressure - rest)
    # n p dV + V dp = n R T dm (the polytropic law with a yielding wall)
    lost = 1.3 * R * carried * leak / (room + 1.3 * pressure * yields)
    assert scratch.rate[1] == pytest.approx(drawn - lost, rel=1e-12)
    entered = (mass_at(pressure + 1.0) - mass_at(pressure - 1.0)) / 2.0 * drawn
    assert scratch.rate[4] == pytest.approx(entered - leak, rel=1e-9)
    # the others: one draws for its own tap, one has nothing to be drawn to
    assert scratch.rate[[0, 2]] == pytest.approx([pull * 5e4, 0.0])
    kept = [9e-5 * 1e-4 / (2e5 * 9e-5) * pull * 5e4, 0.0]  # m V / (p V) dp
    assert scratch.rate[[3, 5]] == pytest.approx(kept, rel=1e-12)


@pytest.mark.parametrize("ahead", [0.0, 4e-4, 1e-3])
@pytest.mark.parametrize("delay", [0.0, 2e-4, 4e-4, 7e-4, 1e-3, 1.2e-3, 2e-3, 2.9e-3])
def test_a_share_is_felt_after_its_delay(delay: float, ahead: float) -> None:
    """Shares grow evenly; the second of the five rows of the ring, 1 ms apart, is the newest."""
    h, grow, at = 1e-3, np.array([3e6, -2e6, 5e6, 7e6]), np.array([4e3, 1e3, -2e3, 9e3])
    rig = volumes([1, 0, 1, -1], [[1e-5] + [0.0] * 4] * 2, np.zeros((0, 4)), [])
    ring = np.empty((5, 4))
    for back in range(5):
        ring[(1 - back) % 5] = at - back * h * grow
    now = [*(at + ahead * grow), 50.0, 70.0, 1e-4, 2e-4]
    shares = shares_of([1e5, 2e5], now, ring, 1, 2)
    before = np.array([*at, 20.0, 30.0, 1e-4, 2e-4])
    delays = np.array([delay, 9.0, 0.3 * delay, 9.0])
    felt = plain(filling._felt)(1, delays, rig, shares, before, ahead, h)
    came = [at[k] + (ahead - delays[k]) * grow[k] for k in (0, 2)]
    assert felt == pytest.approx(2e5 + 70.0 + sum(came), rel=1e-12)
