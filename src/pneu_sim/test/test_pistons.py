# SPDX-License-Identifier: Apache-2.0
"""Gas that does work: pistons against closed forms; energy is kept while cells come and go.

References: AGARDograph 138 (free piston, as in gdtk's L1d), Rüchardt (1929), and the complex
polytropic exponent of a chamber with a wall (Pfriem 1940).
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneu_sim import layout as L
from pneu_sim.plant import Plant
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import Rig
from pneu_sim.simulator import Readings, Simulator

GAMMA = 1.4


def rig(cylinder: dict[str, Any], mass_kg: float = 1.0, **more: Any) -> Rig:
    """A mass on a rail that one cylinder moves.

    Args:
        cylinder: The cylinder.
        mass_kg: The mass.
        more: ``slide`` and ``incline_rad`` of the rail, ``grid`` and ``ambient`` of the rig.
    """
    rail = {key: more[key] for key in ("slide", "incline_rad") if key in more}
    rest = {key: more[key] for key in ("grid", "ambient") if key in more}
    body = {"kind": "rail", "cylinder": "c", "mass_kg": mass_kg, **rail}
    return Rig.model_validate(
        {"pneu_rig": 1, "name": "r", "cylinders": {"c": cylinder}, "bodies": {"b": body}, **rest}
    )


def alone(cylinder: dict[str, Any], **more: Any) -> Rig:
    """A cylinder that moves nothing: it stands, or goes as it is told.

    Args:
        cylinder: The cylinder.
        more: ``grid`` of the rig.
    """
    return Rig.model_validate({"pneu_rig": 1, "name": "r", "cylinders": {"c": cylinder}, **more})


def closed(bore_m: float, stroke_m: float, dead_m3: float = 1e-9, **more: Any) -> dict[str, Any]:
    """A cylinder shut at both ends."""
    side = {"node": "closed", "dead_volume_m3": dead_m3}
    return {"bore_m": bore_m, "stroke_m": stroke_m, "head": side, "rod": side, **more}


def frequency(out: Readings, about: float) -> float:
    """Frequency of the slide's oscillation by its upward crossings, Hz."""
    x = out.joints["b_slide"] - about
    k = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    at = out.time_s[k] + np.diff(out.time_s)[k] * x[k] / (x[k] - x[k + 1])
    return float(1.0 / np.mean(np.diff(at)))


# ---- free piston ---------------------------------------------------------------------------------


def free_piston(dx_m: float, order: int, **grid: Any) -> Rig:
    """A piston of 1 kg and 0.4 m bore before a long column at 1 bar and 1 kg/m3, and a vacuum."""
    column = {"node": "closed", "dead_volume_m3": 16.0 * math.pi * 0.04}
    cylinder = {
        "bore_m": 0.4, "stroke_m": 8.0, "gas": "cells", "gas_friction": 0.0, "head": column,
    }  # fmt: skip
    return rig(
        cylinder,
        grid={"dx_m": dx_m, "order": order, "wave_speed_m_s": 700.0, **grid},
        ambient={"pressure_pa": 1e-6, "temperature_k": 1e5 / 287.05},
    )


def exact_piston(t: float) -> tuple[float, float]:
    """Position, m, and speed, m/s, of the free piston (simple wave)."""
    a0, area = math.sqrt(GAMMA * 1e5), math.pi * 0.04
    k = 0.5 * (GAMMA + 1.0) * 1e5 * area / a0
    y = (1.0 + k * t) ** (-(GAMMA - 1.0) / (GAMMA + 1.0))
    speed = 2.0 * a0 * (1.0 - y) / (GAMMA - 1.0)
    bracket = (1.0 + k * t) ** (2.0 / (GAMMA + 1.0)) - 1.0
    return 2.0 * a0 / (GAMMA - 1.0) * (t - (GAMMA + 1.0) / (2.0 * k) * bracket), speed


@pytest.mark.parametrize(("order", "dx_m", "within"), [(1, 0.1, 3e-4), (2, 0.1, 2e-5)])
def test_a_free_piston_is_where_the_simple_wave_has_it(
    order: int, dx_m: float, within: float
) -> None:
    assert exact_piston(0.04) == (pytest.approx(6.550091, rel=1e-6), pytest.approx(276.65284))
    simulator = Simulator(free_piston(dx_m, order))
    simulator.reset({"c.head": 1e5})
    out = simulator.run(0.04, {}, 1e-3)
    for n in (10, 20, 30, 40):
        place, speed = exact_piston(n * 1e-3)
        assert out.joints["b_slide"][n] == pytest.approx(place, rel=within)
        assert out.speeds["b_slide"][n] == pytest.approx(speed, rel=within)


def test_the_free_piston_converges_in_second_order() -> None:
    errors = []
    for dx_m in (0.4, 0.2, 0.1):
        simulator = Simulator(free_piston(dx_m, 2))
        simulator.reset({"c.head": 1e5})
        out = simulator.run(0.01, {}, 1e-3)
        errors.append(abs(out.joints["b_slide"][-1] - exact_piston(0.01)[0]))
    assert math.log2(errors[0] / errors[1]) > 1.7
    assert math.log2(errors[1] / errors[2]) > 1.7


# ---- gas springs ---------------------------------------------------------------------------------

SPRINGS = [
    (0.025, 0.1, 4e5, 1.0, 16.689, 14.105),
    (0.016, 0.05, 5e5, 0.3, 30.833, 26.059),
    (0.010, 0.05, 4e5, 0.1, 29.854, 25.231),
]


def spring(
    bore_m: float, stroke_m: float, pressure_pa: float, mass_kg: float, **more: Any
) -> Readings:
    """A second of a gas spring that swings by 1 % of its stroke."""
    grid = {"dx_m": 0.07, "dt_s": 5e-5} if more.get("gas") != "cells" else {"dx_m": stroke_m / 10}
    dead_m3 = more.pop("dead_m3", 1e-9)
    simulator = Simulator(
        rig(
            closed(bore_m, stroke_m, dead_m3, **more),
            mass_kg,
            slide={"start": 0.5 * stroke_m},
            grid=grid,
        )
    )
    simulator.reset({name: pressure_pa for name in ("c.head", "c.rod")})
    simulator.plant.place({}, {"b_slide": 0.01 * stroke_m * 100.0})
    return simulator.run(1.0, {}, 5e-4)


@pytest.mark.parametrize(("bore_m", "stroke_m", "pressure_pa", "mass_kg", "hz", "warm_hz"), SPRINGS)
def test_a_gas_spring_swings_at_its_frequency(
    bore_m: float, stroke_m: float, pressure_pa: float, mass_kg: float, hz: float, warm_hz: float
) -> None:
    out = spring(bore_m, stroke_m, pressure_pa, mass_kg)
    assert frequency(out, 0.5 * stroke_m) == pytest.approx(hz, rel=1e-3)
    held = {"node": "closed", "dead_volume_m3": 1e-9, "heat_w_per_k": 1e4}  # isothermal
    out = spring(bore_m, stroke_m, pressure_pa, mass_kg, head=held, rod=held)
    assert frequency(out, 0.5 * stroke_m) == pytest.approx(warm_hz, rel=1e-3)


def test_a_gas_spring_in_cells_swings_at_its_frequency() -> None:
    bore_m, stroke_m, pressure_pa, mass_kg, *_ = SPRINGS[0]
    out = spring(
        bore_m, stroke_m, pressure_pa, mass_kg, gas="cells", gas_friction=0.0, dead_m3=5e-6
    )
    area = 0.25 * math.pi * bore_m**2
    volume = 0.5 * area * stroke_m + 5e-6
    hz = math.sqrt(GAMMA * area**2 * 2.0 * pressure_pa / volume / mass_kg) / (2.0 * math.pi)
    assert frequency(out, 0.5 * stroke_m) == pytest.approx(hz, rel=2e-3)


def test_the_ball_of_ruechardt() -> None:
    area, weight = 0.25 * math.pi * 0.016**2, 0.0166 * 9.80665
    pressure = 101325.0 + weight / area
    cylinder = {
        "bore_m": 0.016, "stroke_m": 0.5, "head": {"node": "closed", "dead_volume_m3": 0.01},
    }  # fmt: skip
    simulator = Simulator(rig(cylinder, 0.0166, incline_rad=0.5 * math.pi, slide={"start": 0.25}))
    simulator.reset({"c.head": pressure})
    simulator.plant.place({}, {"b_slide": 0.02})
    out = simulator.run(10.0, {}, 1e-3)
    volume = 0.01 + 0.25 * area
    period = 2.0 * math.pi * math.sqrt(0.0166 * volume / (GAMMA * pressure * area**2))
    assert period == pytest.approx(1.0674, abs=2e-4)  # 1.06476 s at 10 l
    assert 1.0 / frequency(out, 0.25) == pytest.approx(period, rel=1e-3)


def test_a_warm_wall_damps_most_where_it_should() -> None:
    """Loss tangent of a chamber that is pressed to and fro, at its greatest: 0.16903."""
    cylinder = closed(0.025, 0.1, 1e-6)
    area = 0.25 * math.pi * 0.025**2
    volume, pressure, temperature = 0.5 * area * 0.1 + 1e-6, 3e5, 293.15
    heat_capacity = pressure * volume / temperature / (GAMMA - 1.0)  # m cv
    omega = 2.0 * math.pi * 2.0
    heat = heat_capacity * omega * math.sqrt(GAMMA)  # omega tau = 1 / sqrt(g)
    cylinder["head"] = {"node": "closed", "dead_volume_m3": 1e-6, "heat_w_per_k": heat}
    locked = alone({**cylinder, "start_m": 0.05})
    plant = Plant([locked])
    plant.reset({"c.head": pressure, "c.rod": pressure})
    interval, samples = 1e-3, 1500
    time = interval * (np.arange(samples) + 0.5)
    speed = 1e-4 * omega * np.cos(omega * time)
    p, x = [], []
    for v in speed:
        plant.solver.drive(np.array([[v]]))
        series, _ = plant.advance(np.zeros((1, 0, 1)), interval)
        p.append(series.chambers[-1, plant.plan.chambers.index("c.head"), 0])
        x.append(series.cylinders[-1, 0, 0, 0])
    wave = np.exp(-1j * omega * interval * np.arange(500))
    swing_p = np.sum((np.array(p[-500:]) - pressure) * wave)
    swing_x = np.sum((np.array(x[-500:]) - 0.05) * wave)
    stiffness = -swing_p / swing_x
    assert stiffness.imag / stiffness.real == pytest.approx(
        (GAMMA - 1.0) / (2.0 * math.sqrt(GAMMA)), rel=0.002
    )


# ---- books ---------------------------------------------------------------------------------------

RUBBING = {
    "coulomb_n": 1.0, "viscous_n_s_m": 1.0, "breakaway_n": 2.0, "coulomb_n_per_pa": 1e-6,
}  # fmt: skip


@pytest.mark.parametrize("gas", ["chamber", "cells"])
@pytest.mark.parametrize("order", [1, 2])
def test_energy_of_gas_body_and_heat_is_kept_while_cells_come_and_go(gas: str, order: int) -> None:
    mass_kg, dx_m = 1.0, 0.005
    simulator = Simulator(
        rig(
            closed(0.025, 0.1, 2e-6, gas=gas, friction=RUBBING),
            mass_kg,
            slide={"start": 0.05},
            grid={"dx_m": dx_m, "order": order, "dt_s": 5e-6},
        )
    )
    simulator.reset({"c.head": 4e5, "c.rod": 4e5})
    speed = 3.6
    simulator.plant.place({}, {"b_slide": speed})
    mass, energy = simulator.mass_kg(), simulator.energy_j() + 0.5 * mass_kg * speed**2
    out = simulator.run(0.5, {}, 5e-3)  # 1e5 steps
    assert out.extensions["c"].min() < 0.025 and out.extensions["c"].max() > 0.075
    heat = float(simulator.plant.solver.friction_heat()[0, 0])
    now = simulator.energy_j() + 0.5 * mass_kg * out.speeds["b_slide"][-1] ** 2 + heat
    assert heat > 2.0
    assert now == pytest.approx(energy, rel=1e-11)
    assert simulator.mass_kg() == pytest.approx(mass, rel=1e-11)


@pytest.mark.long
@pytest.mark.parametrize(
    ("order", "speed", "most"), [(1, 1.0, 5e-4), (2, 1.0, 2e-5), (2, 3.0, 1e-4)]
)
def test_no_pressure_jumps_when_cells_appear_and_vanish(
    order: int, speed: float, most: float
) -> None:
    """A piston that goes steadily: pressures on its faces bend by no more where cells change."""
    cylinder = closed(0.025, 0.2, 1e-5, gas="cells", gas_friction=0.0)
    plant = Plant([alone({**cylinder, "start_m": 0.02}, grid={"dx_m": 0.01, "order": order})])
    plant.reset({"c.head": 4e5, "c.rod": 4e5})
    tile = plant.solver.tiles[0][0]  # type: ignore[attr-defined]
    step = plant.solver.step_s
    steps = round(0.15 / speed / step)
    counts, pressures = [], []
    for n in range(steps):
        # sped up gently, so that what waves there are do not hide a jump
        ramp = min(6.0 * n / steps, 6.0 * (steps - n) / steps, 1.0)
        plant.solver.drive(np.array([[speed * ramp]]))
        plant.advance(np.zeros((1, 0, 1)), step)
        counts.append(tile.cylinder_state[0, L.SY_COUNT : L.SY_COUNT + 2, 0].copy())
        pressures.append(tile.cylinder_work[0, L.WY_FACE : L.WY_FACE + 2, 0].copy())
    assert np.count_nonzero(np.diff(np.array(counts), axis=0), axis=0).min() >= 10
    p = np.array(pressures)
    assert np.max(np.abs(np.diff(p, 2, axis=0)) / p[2:]) < most


def test_the_coupling_is_of_second_order_in_the_step() -> None:
    """A mass between chambers with warm walls, at steps that are halved."""
    ends = []
    for dt_s in (1e-3, 5e-4, 2.5e-4, 1.25e-4):
        side = {"node": "closed", "dead_volume_m3": 2e-6, "heat_w_per_k": 0.05}
        simulator = Simulator(
            rig(
                closed(0.025, 0.1, head=side, rod=side, friction={"viscous_n_s_m": 3.0}),
                grid={"dx_m": 0.7, "dt_s": dt_s},
                slide={"start": 0.05},
            )
        )
        simulator.reset({"c.head": 4e5, "c.rod": 4e5})
        simulator.plant.place({}, {"b_slide": 2.0})
        out = simulator.run(0.08, {}, 0.08)
        ends.append((out.joints["b_slide"][-1], out.speeds["b_slide"][-1]))
    steps = np.abs(np.diff(np.array(ends), axis=0))
    assert np.all(np.log2(steps[:-1] / steps[1:]) > 1.8)


# ---- seals, stops and springs --------------------------------------------------------------------


def test_a_piston_sticks_until_it_breaks_away_and_then_slides() -> None:
    area = 0.25 * math.pi * 0.025**2
    cylinder = {
        "bore_m": 0.025, "stroke_m": 0.1, "head": {"node": "closed", "dead_volume_m3": 1e-3},
        "friction": {"coulomb_n": 10.0, "breakaway_n": 5.0, "stribeck_m_s": 0.001},
    }  # fmt: skip
    for newton, slides in ((14.5, False), (15.5, True)):
        simulator = Simulator(rig(cylinder, 2.0, slide={"start": 0.05}, grid={"dx_m": 0.05}))
        simulator.reset({"c.head": 101325.0 + newton / area})
        out = simulator.run(0.05, {}, 1e-3)
        moved = out.joints["b_slide"][-1] - 0.05
        if not slides:
            assert abs(moved) < 1e-12
            continue
        # once away only the sliding part holds: 5.5 N on 2 kg
        late = out.speeds["b_slide"][-1] - out.speeds["b_slide"][-21]
        assert late / 0.02 == pytest.approx(5.5 / 2.0, rel=0.02)


def test_friction_that_grows_with_pressure_holds_by_the_mean_gauge_pressure() -> None:
    cylinder = closed(0.025, 0.1, 1e-3, friction={"coulomb_n_per_pa": 25e-6})
    simulator = Simulator(rig(cylinder, 2.0, slide={"start": 0.05}, grid={"dx_m": 0.05}))
    simulator.reset({"c.head": 501325.0, "c.rod": 501325.0})
    simulator.plant.place({}, {"b_slide": 0.1})
    out = simulator.run(0.01, {}, 1e-3)
    slowed = (out.speeds["b_slide"][-1] - 0.1) / 0.01
    assert slowed == pytest.approx(-25e-6 * 4e5 / 2.0, rel=0.03)


def test_a_piston_leak_and_a_rod_leak_pass_what_an_orifice_does() -> None:
    leaking = closed(0.025, 0.1, 5e-5, rod_m=0.01, piston_leak_m2=6e-8, rod_leak_m2=2e-8)
    locked = rig({**leaking}, slide={"start": 0.05, "held": True}, grid={"dx_m": 0.05})
    simulator = Simulator(locked)
    simulator.reset({"c.head": 9e5, "c.rod": 3e5})
    before = simulator.mass_kg()
    out = simulator.run(0.01, {}, 1e-3)
    assert np.all(out.joints["b_slide"] == 0.05)
    # both choked: 0.0404149 A p / sqrt(T)
    lost = 0.0404149 * 2e-8 * 3e5 / math.sqrt(293.15) * 0.01
    assert before - simulator.mass_kg() == pytest.approx(lost, rel=0.01)
    rate = 0.0404149 * 6e-8 * 9e5 / math.sqrt(293.15)
    area = 0.25 * math.pi * 0.025**2
    volume = 5e-5 + 0.05 * area
    fall = GAMMA * 287.05 * 293.15 * rate / volume * 0.01
    assert out.chambers["c.head"][0] - out.chambers["c.head"][-1] == pytest.approx(fall, rel=0.02)


def test_a_spring_draws_a_single_acting_piston_back_to_its_stop() -> None:
    cylinder = {
        "bore_m": 0.025, "stroke_m": 0.1, "head": {"node": "closed", "dead_volume_m3": 1e-3},
        "spring_n_m": 200.0, "spring_preload_n": 30.0,
    }  # fmt: skip
    grid = {"dx_m": 0.05, "dt_s": 1e-5}
    simulator = Simulator(rig(cylinder, 1.0, slide={"start": 0.08}, grid=grid))
    simulator.reset({"c.head": 101325.0})
    out = simulator.run(0.3, {}, 2e-5)
    x = out.joints["b_slide"]
    area = 0.25 * math.pi * 0.025**2
    pressed = 101325.0 * ((1e-3 + 0.08 * area) / 1e-3) ** GAMMA
    pushed = (pressed - 101325.0) * area
    # it comes at what the spring gave it and the gas did not take, and the stop yields
    taken = (pressed * 1e-3 - 101325.0 * (1e-3 + 0.08 * area)) / (GAMMA - 1.0)
    taken -= 101325.0 * 0.08 * area
    speed = math.sqrt(2.0 * (30.0 * 0.08 + 100.0 * 0.08**2 - taken))
    stop = math.sqrt(2e7)  # 1/s, on 1 kg
    damping = 5e3 / (2.0 * stop)
    yields = math.exp(-damping / math.sqrt(1.0 - damping**2) * math.acos(damping)) * speed / stop
    assert x.min() == pytest.approx(-yields, rel=0.02)
    # then it leans on the stop with what the spring draws more than the gas pushes
    assert out.chambers["c.head"][-1] == pytest.approx(pressed, rel=1e-5)
    assert out.forces["c"][-1] == pytest.approx(pushed, rel=1e-3)
    assert x[-1] == pytest.approx(-(30.0 - pushed) / 2e7, rel=1e-3)
    assert abs(out.speeds["b_slide"][-1]) < 1e-9


def test_a_rotary_actuator_turns_by_volume_per_angle() -> None:
    side = {"node": "closed", "dead_volume_m3": 2e-6}
    rotary = {
        "rotary": {"displacement_m3_rad": 2e-5, "stroke_rad": 1.5}, "head": side, "rod": side,
    }  # fmt: skip
    simulator = Simulator(rig(rotary, 0.05, slide={"start": 0.75}, grid={"dx_m": 0.05}))
    simulator.reset({"c.head": 4e5, "c.rod": 4e5})
    simulator.plant.place({}, {"b_slide": 0.2})
    out = simulator.run(1.0, {}, 5e-4)
    volume = 0.75 * 2e-5 + 2e-6
    hz = math.sqrt(GAMMA * (2e-5) ** 2 * 8e5 / volume / 0.05) / (2.0 * math.pi)
    assert frequency(out, 0.75) == pytest.approx(hz, rel=2e-3)


# ---- side by side, and cut -----------------------------------------------------------------------


@pytest.mark.parametrize("gas", ["chamber", "cells"])
def test_any_cutting_of_a_run_and_any_lane_give_the_same_bits(gas: str) -> None:
    def one(mass_kg: float) -> Rig:
        return rig(
            closed(0.025, 0.1, 5e-6, gas=gas, friction=RUBBING, heat_w_m2_k=20.0),
            mass_kg,
            slide={"start": 0.05},
            grid={"dx_m": 0.01},
        )

    def ends(rigs: list[Rig], cuts: list[int]) -> np.ndarray:
        plant = Plant(rigs)
        plant.reset({"c.head": 5e5, "c.rod": 3e5})
        plant.place({}, {"b_slide": 1.0})
        for samples in cuts:
            series, _ = plant.advance(np.zeros((1, 0, samples)), 1e-3)
        return np.concatenate([series.joints[-1].ravel(), series.cylinders[-1].ravel()])

    whole = ends([one(1.0)], [60])
    np.testing.assert_array_equal(ends([one(1.0)], [7, 1, 32, 20]), whole)
    several = Plant([one(m) for m in (0.5, 1.0, 2.0)])
    several.reset({"c.head": 5e5, "c.rod": 3e5})
    several.place({}, {"b_slide": 1.0})
    series, _ = several.advance(np.zeros((1, 0, 60)), 1e-3)
    np.testing.assert_array_equal(series.joints[-1, :, :, 1].ravel(), whole[:2])
    # a state that was taken, and put back
    plant = Plant([one(1.0)])
    plant.reset({"c.head": 5e5, "c.rod": 3e5})
    plant.place({}, {"b_slide": 1.0})
    plant.advance(np.zeros((1, 0, 25)), 1e-3)
    kept = plant.state()
    first = plant.advance(np.zeros((1, 0, 35)), 1e-3)[0]
    plant.set_state(kept)
    again = plant.advance(np.zeros((1, 0, 35)), 1e-3)[0]
    np.testing.assert_array_equal(first.cylinders, again.cylinders)
    np.testing.assert_array_equal(first.joints[-1].ravel(), whole[:2])


def test_a_piston_that_moves_a_body_starts_where_the_body_does() -> None:
    """The others start where they are told, and go as they are told."""
    rig = load_rig(Path(__file__).parents[3] / "rigs" / "rail.yaml")
    rig.cylinders["free"] = Rig.model_validate(
        {"pneu_rig": 1, "name": "r", "cylinders": {"c": closed(0.02, 0.1)}}
    ).cylinders["c"]
    plant = Plant([rig])
    assert (plant.plan.moves >= 0).tolist() == [True, False]
    plant.reset()
    before = plant.solver.tiles[0][0].cylinder[:, L.PY_START, 0].copy()
    plant.solver.start_pistons(np.array([[0.03], [0.04]]))
    plant.solver.drive(np.array([[0.5], [0.6]]))
    tile, _ = plant.solver.tiles[0]
    assert tile.cylinder[:, L.PY_START, 0].tolist() == [before[0], 0.04]
    assert tile.cylinder_state[:, L.SY_SPEED, 0].tolist() == [0.0, 0.6]
