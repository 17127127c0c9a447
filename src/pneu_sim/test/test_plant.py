# SPDX-License-Identifier: Apache-2.0
"""Plants: cut anywhere, side by side, taken back to a state, perturbed, by every kind of model."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.effects import registry
from pneu_sim.full_solver import WIDTH
from pneu_sim.plant import Plant
from pneu_sim.rig import Rig, load_rig
from pneu_sim.rig.schema import AttachedEffect, Ripple

pytestmark = pytest.mark.compiles  # kernels of rigs without bodies, and of lumped models

RIGS = Path(__file__).parents[3] / "rigs"
INTERVALS, INTERVAL_S, DX_M = 60, 1e-3, 0.25


def rig_named(name: str, model: str = "pde") -> Rig:
    """A rig of the repository, all its taps but the first with a lag, a late clock or both."""
    rig = load_rig(RIGS / f"{name}.yaml").model_copy(update={"model": model})
    late = []
    for k, (tap, sensor) in enumerate(rig.taps.items()):
        sensor.lag_s = (0.0, 0.004, 0.0, 0.0021)[k % 4]
        by = {"offset_s": (0.0, 0.0034)[k % 2]}
        late.append(AttachedEffect(effect="clock_offset", place=tap, parameters=by))
    return rig.model_copy(update={"effects": [*rig.effects, *late]})


def two_valves() -> Rig:
    """Two lines, each fed by a valve of its own, that meet and lead to a vessel."""
    port = {
        "conductance_m3_s_pa": 5e-9,
        "opening": {"voltage_v": [5.0, 10.0], "fraction": [0.0, 1.0]},
    }
    pipe = {"to": "joint", "length_m": 0.5, "area_m2": 1.5e-5}
    sides = {"left": 6e5, "right": 3e5}
    return Rig.model_validate(
        {
            "name": "two",
            "grid": {"dx_m": 0.1},
            "reservoirs": {side: {"pressure_pa": p} for side, p in sides.items()},
            "chambers": {"vessel": {"volume_m3": 2e-5}},
            "pipes": {
                **{f"{s}_line": {**pipe, "from": f"{s}_end"} for s in sides},
                "last": {**pipe, "from": "joint", "to": "vessel"},
            },
            "valves": {
                s: {
                    "command": f"{s}_volts",
                    "spool": {"bandwidth_hz": 80.0, "delay_s": 0.0023},
                    "ports": {"supply": {**port, "from": s, "to": f"{s}_end"}},
                }
                for s in sides
            },
            "commands": {f"{s}_volts": {} for s in sides},
            "taps": {s: {"pipe": f"{s}_line", "position_m": 0.25} for s in sides},
        }
    )


def attached(rig: Rig, effect: str) -> Rig:
    kind = registry()[effect]
    place, shape = next(iter(kind.sites(rig)))
    values = {kind.strength.name: kind.strength.typical, **shape}
    one = AttachedEffect(effect=effect, place=place, parameters=values)
    return rig.model_copy(update={"effects": [*rig.effects, one]})


def commands(plant: Plant, intervals: int, lanes: int = 1) -> NDArray[np.float64]:
    """Steps of random length and height."""
    rng = np.random.default_rng(3)
    often = rng.uniform(2.0, 9.0, (lanes, len(plan := plant.plan.valves), intervals))
    assert len(plan) > 0
    hold = rng.uniform(size=intervals) < 0.3
    hold[0] = True
    return often[:, :, np.maximum.accumulate(np.where(hold, np.arange(intervals), 0))]


def run(plant: Plant, volts: NDArray[np.float64], cuts: list[int]) -> list[NDArray[np.float64]]:
    """Taps, flows, chambers and readings of a run in pieces."""
    found = []
    for a, b in pairwise([0, *cuts, volts.shape[2]]):
        series, readings = plant.advance(volts[:, :, a:b], INTERVAL_S)
        parts = (series.taps, series.flows, series.chambers, readings)
        found.append([part[1 if a else 0 :] for part in parts])
    return [np.concatenate(parts) for parts in zip(*found, strict=True)]


def is_the_same_cut(rig: Rig, dx_m: float | None = DX_M) -> None:
    whole, cut = Plant([rig], dx_m), Plant([rig], dx_m)
    volts = commands(whole, INTERVALS)
    at_once = run(whole, volts, [])
    for cuts in ([1, 2, 9, 30, 31, 50], list(range(1, INTERVALS))):
        cut.reset()
        for found, want in zip(run(cut, volts, cuts), at_once, strict=True):
            assert np.array_equal(found, want)
        assert cut.time_s == whole.time_s
    assert np.ptp(at_once[0]) > 1e4  # it did move
    for a, b in zip(cut.state().spools, whole.state().spools, strict=True):
        assert np.array_equal(a, b)


LATER = {"clock_offset", "common_clock_offset"}
"""Effects of which a sensor may show what has not happened yet where a run is cut."""


@pytest.mark.parametrize("effect", sorted(set(registry()) - LATER))
def test_a_plant_with_any_effect_may_be_cut_anywhere(effect: str) -> None:
    for rig in (rig_named("rig_a"), two_valves(), rig_named("kokoro")):
        if registry()[effect].places(rig):
            is_the_same_cut(attached(rig, effect))
            return
    pytest.fail("no rig here has a place for it")


@pytest.mark.parametrize(
    ("name", "model"),
    [("rig_b_fitted", "pde"), ("rig_a", "thin_plate"), ("rig_a", "delay_line")],
)
def test_a_plant_by_any_model_may_be_cut_anywhere(name: str, model: str) -> None:
    is_the_same_cut(rig_named(name, model))


@pytest.mark.parametrize("speed_m_s", [300.0, 150.0])
def test_a_plant_that_needs_more_steps_may_be_cut_anywhere(speed_m_s: float) -> None:
    rig = rig_named("rig_a")
    rig.grid.wave_speed_m_s = speed_m_s
    plant, plain = Plant([rig], 0.05), Plant([rig_named("rig_a")], 0.05)
    assert plant.solver.step_s > 1.5 * plain.solver.step_s
    volts = commands(plant, INTERVALS)
    found, want = run(plant, volts, [])[0], run(plain, volts, [])[0]
    assert np.isfinite(found).all() and np.abs(found - want).max() < 0.02 * np.ptp(want)
    is_the_same_cut(rig, 0.05)


@pytest.mark.long
@pytest.mark.parametrize("model", ["pde", "thin_plate", "delay_line"])
def test_rigs_side_by_side_are_those_alone(model: str) -> None:
    """Of different parameters, under commands of their own, and more of them than go together."""
    rigs = []
    for k in range(WIDTH + 3):
        rig = rig_named("rig_a", model)
        rig.valves["valve"].spool.delay_s = 0.0007 * (k % 4)
        rig.reservoirs["supply"].pressure_pa *= 1.0 - 0.01 * k
        rigs.append(rig)
    together = Plant(rigs, DX_M)
    volts = commands(together, 40, len(rigs))
    found = run(together, volts, [11])
    step_s = together.solver.step_s
    for k in (0, 5, WIDTH - 1, WIDTH, WIDTH + 2):
        alone = Plant([rigs[k]], DX_M)
        alone.solver.step_s = step_s  # of lumped rigs the fastest decides
        for one, of_all in zip(run(alone, volts[k : k + 1], []), found, strict=True):
            assert np.array_equal(one[..., 0], of_all[..., k])


def test_several_valves_are_told_apart() -> None:
    plant = Plant([two_valves()] * 2)
    volts = np.full((2, 2, 200), 5.0)
    volts[0, 0], volts[1, 1] = 9.0, 9.0
    taps = run(plant, volts, [])[0][-1]
    assert taps[:, 0] == pytest.approx([6e5, 6e5], rel=0.02)
    assert taps[:, 1] == pytest.approx([3e5, 3e5], rel=0.02)


@pytest.mark.parametrize("model", ["pde", "thin_plate", "delay_line"])
def test_a_plant_comes_back_to_a_state_and_puts_it_into_other_lanes(model: str) -> None:
    rig = rig_named("rig_a", model)
    rig.valves["valve"].spool.delay_s = 0.0063
    one, many = Plant([rig], DX_M), Plant([rig] * (WIDTH + 2), DX_M)
    volts = commands(one, 50)
    run(one, volts[:, :, :20], [])
    kept = one.state()
    run(many, volts[:, :, :7], [])
    many.set_state(kept.of(np.zeros(many.lanes, dtype=np.int64)))
    on, all_on = run(one, volts[:, :, 20:], []), run(many, volts[:, :, 20:], [])
    one.set_state(kept)
    again = run(one, volts[:, :, 20:], [13])
    there = many.state()
    order = np.random.default_rng(2).permutation(many.lanes)
    many.set_state(there.of(order))
    for a, b in zip(there.gas, many.state().gas, strict=True):
        assert np.array_equal(a[..., order], b)
    for first, second, of_all in zip(on, again, all_on, strict=True):
        assert np.array_equal(first, second)
        assert np.array_equal(np.broadcast_to(first, of_all.shape), of_all)
    assert one.time_s == many.time_s == pytest.approx(0.05)


@pytest.mark.parametrize("model", ["pde", "thin_plate", "delay_line"])
def test_a_state_of_another_interval_is_taken_back(model: str) -> None:
    rig = rig_named("rig_a", model)
    rig.reservoirs["supply"].ripples = [Ripple(amplitude_pa=2e4, frequency_hz=7.0)]
    plant = Plant([rig], DX_M)
    volts = commands(plant, 60)
    run(plant, volts[:, :, :20], [])
    kept = plant.state()
    on = run(plant, volts[:, :, 20:], [])
    plant.set_state(kept)
    plant.advance(volts[:, :, :7], 0.0037)  # other steps, other pasts
    plant.set_state(kept)
    for first, second in zip(on, run(plant, volts[:, :, 20:], [5]), strict=True):
        assert np.array_equal(first, second)


def test_gas_along_a_line_is_told_and_set() -> None:
    plant = Plant([rig_named("rig_a")] * 2, DX_M)
    density, velocity, pressure = plant.gas_in("tube")
    assert np.allclose(velocity, 0.0) and np.allclose(pressure, plant.rigs[0].ambient.pressure_pa)
    bump = pressure.copy()
    bump[: len(bump) // 2, 1] += 1e4
    plant.set_gas("tube", density * bump / pressure, velocity, bump)
    assert np.array_equal(plant.gas_in("tube")[2], bump)
    shown = plant.readings()
    tap = plant.plan.taps.index("valve_out")
    assert shown[tap, 1] - shown[tap, 0] == pytest.approx(1e4, rel=1e-6)
    taps = run(plant, np.full((1, 1, 40), 5.0), [])[0]
    far = plant.plan.taps.index("end")
    assert np.ptp(taps[:, far, 0]) < 1.0 < 1e3 < np.ptp(taps[:, far, 1])  # a wave in one alone


def test_a_change_of_interval_keeps_what_is_on_its_way() -> None:
    """Commands, and the waves in a line that has its delay by one number alone."""
    rig = load_rig(RIGS / "rig_a.yaml").model_copy(update={"model": "delay_line"})
    rig.valves["valve"].spool.delay_s = 0.0053
    plant, other = Plant([rig]), Plant([rig])
    volts = np.full((1, 1, 40), 7.0)
    want = run(plant, volts, [])[0]
    series, _ = other.advance(volts[:, :, :4], INTERVAL_S)
    late, _ = other.advance(volts[:, :, :18], 2.0 * INTERVAL_S)
    found = np.concatenate([series.taps[:-1], late.taps])
    scale = np.ptp(want)
    assert scale > 1e5
    assert np.abs(late.taps - want[4::2]).max() < 5e-3 * scale
    assert found.shape[0] == 4 + 19
    assert other.time_s == pytest.approx(plant.time_s)


def test_what_cannot_be_is_refused() -> None:
    pde, plate = rig_named("rig_a"), rig_named("rig_a", "thin_plate")
    with pytest.raises(InputError, match="model: found thin_plate, 'rig_a' beside it has pde"):
        Plant([pde, plate])
    plant = Plant([plate])
    for ask in (lambda: plant.gas_in("tube"), lambda: plant.set_gas("tube", 1.2, 0.0, 1e5)):
        with pytest.raises(InputError, match="line 'tube': the rig's model knows no gas along"):
            ask()
    with pytest.raises(InputError, match="no pipe 'hose'"):
        plant.gas_in("hose")
    with pytest.raises(InputError, match="mass and energy: the rig's model does not keep them"):
        plant.solver.held()
    with pytest.raises(InputError, match="no reservoir 'tank'"):
        Plant([pde]).set_reservoir("tank", 1e5)
