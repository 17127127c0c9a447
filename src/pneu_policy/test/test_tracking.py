# SPDX-License-Identifier: Apache-2.0
"""The training task: plants beside the simulator, features, episodes, drawn rigs."""

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

from pneu_common.errors import InputError  # noqa: E402
from pneu_policy.control.observations import Observer, Recipe  # noqa: E402
from pneu_policy.control.predictive_settings import ADAPTING  # noqa: E402
from pneu_policy.task.ensembles import draw_rigs  # noqa: E402
from pneu_policy.task.make import make_env  # noqa: E402
from pneu_policy.task.plants import ControlPlant  # noqa: E402
from pneu_policy.task.targets import Target  # noqa: E402
from pneu_policy.task.tracking import EnvSettings, PressureTracking, Reward  # noqa: E402
from pneu_sim.rig.load import load_rig  # noqa: E402
from pneu_sim.rig.parameters import get_parameter, with_parameters  # noqa: E402
from pneu_sim.rig.schema import Ripple  # noqa: E402
from pneu_sim.run import run_rig  # noqa: E402
from pneu_sim.simulator import Simulator  # noqa: E402

SHORT = "rigs/rig_a_fitted.yaml"
PLATE = "rigs/rig_a_thin_plate.yaml"
RECIPE = Recipe(tap="end", taps=("valve_out", "end"))


@pytest.fixture(scope="module")
def volts():
    return np.append(np.full(5, 5.0), np.repeat(np.random.default_rng(1).uniform(2, 8, 12), 5))


def run(plant, volts, start_pa=101e3):
    series = [plant.reset(start_pa)]
    series += [plant.step(np.full(plant.count, v)) for v in volts]
    return np.stack(series)


@pytest.mark.parametrize(
    ("name", "delay_s", "lag_s"), [(SHORT, 0.0, 0.0), (SHORT, 0.0073, 0.004), (PLATE, 0.0073, 0.0)]
)
def test_a_plant_does_what_the_simulator_does(name, delay_s, lag_s, volts):
    rig = load_rig(name)
    rig = with_parameters(rig, {"valves.valve.spool.delay_s": delay_s, "taps.end.lag_s": lag_s})
    plant = ControlPlant([rig] * 3, 0.01, 0.125)
    got = run(plant, volts)
    held = np.repeat(volts, 5)  # the plant follows openings every 2 ms
    if rig.model == "pde":
        taps = Simulator(rig, dx_m=0.125).run(0.01 * volts.size, {"voltage": held}, 0.002).taps
    else:
        taps = run_rig(rig, {"voltage": np.append(held, held[-1])}, 0.002)
    want = np.stack([taps[tap][::5] for tap in plant.taps], axis=-1)
    # The walls' slow terms are refreshed every few steps, counted from another step.
    assert np.abs(got[:, 0] - want).max() < 150.0
    assert np.array_equal(got[:, 0], got[:, 2])
    assert np.ptp(want[:, plant.taps.index("end")]) > 1e5


def test_a_plant_has_the_spool_of_the_simulator(volts):
    rig = load_rig(SHORT)
    spool = rig.valves["valve"].spool
    spool.delay_s, spool.closing_delay_s, spool.max_speed_v_s = 0.002, 0.009, 200.0
    plant = ControlPlant([rig] * 2, 0.01, 0.125)
    plant.set_delay(np.array([0.0, 0.003]))
    got = run(plant, volts)
    held = np.repeat(volts, 5)
    for lane, later_s in enumerate((0.0, 0.003)):
        spool.delay_s, spool.closing_delay_s = 0.002 + later_s, 0.009 + later_s
        taps = Simulator(rig, dx_m=0.125).run(0.01 * volts.size, {"voltage": held}, 0.002).taps
        want = np.stack([taps[tap][::5] for tap in plant.taps], axis=-1)
        assert np.abs(got[:, lane] - want).max() < 150.0


def test_a_plant_takes_as_many_steps_as_its_gas_needs(volts):
    rig = load_rig(SHORT)
    runs = []
    for speed_m_s in (900.0, 200.0):
        rig.grid.wave_speed_m_s = speed_m_s
        runs.append(run(ControlPlant([rig] * 3, 0.01, 0.125), volts))
    assert np.abs(runs[1] - runs[0]).max() < 4e3
    assert np.ptp(runs[0]) > 1e5


def test_a_plant_comes_back_to_a_state_and_puts_it_into_other_lanes():
    rig = load_rig(SHORT)
    one = ControlPlant([rig], 0.01, 0.25)
    many = ControlPlant([rig] * 19, 0.01, 0.25)
    for plant in (one, many):
        plant.set_delay(np.full(plant.count, 0.006))
    run(one, [8.0, 7.0, 3.0])
    run(many, [2.0])
    many.set_state(one.state(), np.zeros(19, dtype=np.int64))
    kept = many.state()
    first = [many.step(np.full(19, v)) for v in (9.0, 1.0)]
    alone = [one.step(np.array([v])) for v in (9.0, 1.0)]
    many.set_state(kept)
    again = [many.step(np.full(19, v)) for v in (9.0, 1.0)]
    assert np.array_equal(first, again)
    assert np.allclose(np.stack(first)[:, 18], np.stack(alone)[:, 0], rtol=1e-9)


def test_a_plant_keeps_the_time_of_a_ripple(volts):
    rig = load_rig(SHORT)
    rig.reservoirs["supply"].ripples = [Ripple(amplitude_pa=2e4, frequency_hz=7.0)]
    plant = ControlPlant([rig] * 3, 0.01, 0.125)
    got = [run(plant, volts) for _ in range(2)]
    assert np.array_equal(got[1], got[0])  # a reset begins anew
    held = np.repeat(volts, 5)
    taps = Simulator(rig, dx_m=0.125).run(0.01 * volts.size, {"voltage": held}, 0.002).taps
    want = np.stack([taps[tap][::5] for tap in plant.taps], axis=-1)
    assert np.abs(got[0][:, 0] - want).max() < 150.0
    kept = plant.state()
    first = plant.step(np.full(3, 6.0))
    plant.step(np.full(3, 4.0))
    plant.set_state(kept)
    assert np.array_equal(plant.step(np.full(3, 6.0)), first)


def test_lines_of_a_plant_are_told_and_a_lumped_one_has_none():
    rig = load_rig(SHORT)
    plant = ControlPlant([rig] * 2, 0.01, 0.125)
    plant.reset(350e3)
    gas = plant.line((("tube", 4),))
    assert gas.shape == (2, 12)
    assert np.allclose(gas[:, 4:8], 0.0)  # at rest
    assert np.allclose(gas[:, 8:], 350e3)
    assert np.allclose(gas[:, :4], 350e3 / (287.05 * 293.15), rtol=2e-3)  # ideal gas
    seen = Observer(Recipe(tap="end", taps=("end",), line=(("tube", 4),)), 2).observe(
        np.full((2, 1), 350e3), np.full((2, 6), 350e3), gas
    )
    assert np.allclose(seen[:, -4:], 0.0)  # at the centre of the scale
    assert np.allclose(seen[:, -12:-8], gas[:, :4] / 1.2)
    with pytest.raises(InputError, match="pipe 'hose'"):
        plant.line((("hose", 2),))
    with pytest.raises(InputError, match="knows no gas along its lines"):
        ControlPlant([load_rig(PLATE)], 0.01).line((("tube", 4),))


RECIPE_ALL = Recipe(
    tap="b", taps=("a", "b", "c"), preview_s=(0.0, 0.03, 0.1), past=3, base=3.0, levels=2,
    line=(("hose", 2), ("tube", 1)), period_s=0.02, span_pa=80e3, centre_pa=310e3, range_pa=170e3,
    null_v=4.4, half_v=2.5,
)  # fmt: skip


def test_every_feature_is_what_its_name_says():
    """Each by itself, for two rigs side by side; scales and centres all differ."""
    r, rng = RECIPE_ALL, np.random.default_rng(5)
    observer = Observer(r, 2)
    for _ in range(2):
        before, acted = None, [[0.0, 0.0]] * 3
        for _ in range(6):
            taps, targets = rng.uniform(1e5, 6e5, (2, 3)), rng.uniform(1e5, 6e5, (2, 3))
            density, velocity = rng.uniform(0.5, 8.0, (2, 3)), rng.normal(0.0, 60.0, (2, 3))
            pressure = rng.uniform(1e5, 6e5, (2, 3))
            gas = {"density": density / 1.2, "velocity": velocity / 100.0}
            gas["pressure"] = (pressure - 310e3) / 170e3
            # a pipe after the other, and of each pipe density, velocity, pressure at its points
            line = np.hstack(
                [a[:, p] for p in ([0, 1], [2]) for a in (density, velocity, pressure)]
            )
            seen = observer.observe(taps, targets, line)
            assert seen.shape == (2, r.size) and len(set(r.names())) == r.size
            for rig in range(2):
                wanted = {}
                for k, ahead in enumerate(("0", "0.03", "0.1")):
                    error = (targets[rig, k] - taps[rig, 1]) / 80e3
                    wanted[f"error at {ahead} s"] = error
                    for zoom in (1, 3):
                        wanted[f"sin({zoom} error at {ahead} s)"] = np.sin(zoom * error)
                        wanted[f"cos({zoom} error at {ahead} s)"] = np.cos(zoom * error)
                for k, tap in enumerate("abc"):
                    wanted[f"pressure {tap}"] = (taps[rig, k] - 310e3) / 170e3
                    changed = 0.0 if before is None else taps[rig, k] - before[rig, k]
                    wanted[f"change {tap}"] = changed / 80e3
                for k in range(3):
                    wanted[f"command {k + 1} back"] = acted[-1 - k][rig]
                for what, told in gas.items():
                    for k, place in enumerate(("hose 0", "hose 1", "tube 0")):
                        wanted[f"{what} {place}"] = told[rig, k]
                assert dict(zip(r.names(), seen[rig], strict=True)) == pytest.approx(wanted)
            actions = rng.uniform(-1.0, 1.0, 2)
            observer.acted(4.4 + 2.5 * actions)
            before = taps
            acted = [*acted, actions.tolist()]
        observer.reset()
    assert Recipe(**r.plain()) == r
    taps[1, 2] = np.nan
    with pytest.raises(ValueError, match="nan"):
        observer.observe(taps, targets, line)


def test_actions_are_cut_off_at_one_on_either_side():
    actions = np.array([-3.0, -1.0, -0.4, 0.0, 0.2, 1.0, 1.5])
    assert RECIPE_ALL.volts(actions) == pytest.approx([1.9, 1.9, 3.4, 4.4, 4.9, 6.9, 6.9])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tap": "c"}, "taps: found a, b"),
        ({"preview_s": [0.1]}, "preview_s"),
        ({"period_s": 0.0}, "period_s"),
        ({"levels": 99}, "levels"),
        ({"colour": 1}, "colour"),
        ({"past": "two"}, "past"),
        ({"past": 1.7}, "past: Input should be a valid integer, found 1.7"),
    ],
)
def test_a_recipe_that_makes_no_sense_is_refused(change, message):
    data = Recipe(tap="b", taps=("a", "b")).plain()
    with pytest.raises(InputError, match=message):
        Recipe(**(data | change))


def small(**changes):
    settings = {"rig": SHORT, "recipe": RECIPE, "num_envs": 5, "horizon": 20, "dx_m": 0.25}
    return EnvSettings(**(settings | changes))


def test_episodes_follow_from_their_seed_alone():
    action = np.random.default_rng(0).uniform(-1, 1, (20, 5, 1))

    def episodes(env, seed):
        seen = [env.reset(seed=seed)[0]]
        for a in action:
            observation, reward, terminated, truncated, info = env.step(a)
            seen.append(observation)
            assert not terminated.any()
        assert truncated.all()
        return np.stack(seen), reward, info

    env = make_env(small())
    assert isinstance(env, gymnasium.vector.VectorEnv)
    first, reward, info = episodes(env, 3)
    other, _, _ = episodes(env, 4)
    again, _, _ = episodes(make_env(small()), 3)
    assert np.array_equal(first, again)
    assert not np.allclose(first, other)
    assert env.observation_space.contains(first[0])
    assert np.allclose(info["error"], info["target_pa"] - info["pressure_pa"])
    assert np.allclose(reward, Reward().of(info["error"] / RECIPE.span_pa))
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(action[0])


def test_the_target_shown_ahead_is_the_one_that_comes():
    recipe = Recipe(tap="end", taps=("middle", "end"), preview_s=(0.0, 0.03), past=0, levels=0)
    env = make_env(small(recipe=recipe, noise_pa=0.0))
    observation, _ = env.reset(seed=1)
    pressure = env.plant.readings()[:, env.plant.taps.index("end")]
    ahead = observation[:, 1] * recipe.span_pa + pressure
    for _ in range(3):
        *_, info = env.step(np.ones((5, 1)))
    assert np.allclose(info["target_pa"], ahead, atol=1.0)
    at_end, elsewhere = (
        env.plant.readings()[:, env.plant.taps.index(tap)] for tap in ("end", "middle")
    )
    assert np.array_equal(info["pressure_pa"], at_end)
    assert not np.allclose(at_end, elsewhere, atol=100.0)


def test_the_reward_is_floored_and_falls_with_the_error():
    reward = Reward(alpha=2.0, beta=0.5, floor=0.1)
    assert reward.of(np.array([0.05]))[0] == pytest.approx(-0.1 - 0.5 * np.log(0.1))
    assert (np.diff(reward.of(np.linspace(0.0, 3.0, 50))) < 0.0).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"recipe": Recipe(tap="tip", taps=("tip",))}, "recipe.taps: found 'tip'"),
        ({"kinds": ("round",)}, "kinds"),
        ({"num_envs": 0}, "num_envs"),
        ({"delay_s": (0.01, 0.0)}, "delay_s"),
        ({"physics_step_s": 3e-5 * 1.1}, "whole multiple"),
        ({"physics_step_s": 5e-3}, "stable is up to"),
        ({"rig": "rigs/rig_a.yaml"}, "no std_error"),
        (
            {"rig": PLATE, "recipe": Recipe(tap="end", taps=("end",), line=(("tube", 3),))},
            "knows no gas",
        ),
    ],
)
def test_settings_that_cannot_be_trained_on_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        make_env(small(**change))


def test_the_physics_step_may_be_chosen():
    env = make_env(small(physics_step_s=1e-4))
    assert env.plant.step_s == pytest.approx(1e-4)
    env.reset(seed=0)
    *_, info = env.step(np.ones((5, 1)))
    usual = make_env(small())
    usual.reset(seed=0)
    *_, same = usual.step(np.ones((5, 1)))
    assert np.allclose(info["pressure_pa"], same["pressure_pa"], rtol=0.02)


def test_settings_survive_being_written_down():
    settings = small(reward=Reward(beta=0.1), target_period_s=(0.2, 0.4))
    assert EnvSettings(**settings.plain()) == settings
    with pytest.raises(InputError, match="unknown key 'color'"):
        EnvSettings(**(settings.plain() | {"color": 1}))
    with pytest.raises(InputError, match="rig: Field required"):
        EnvSettings(recipe=RECIPE.plain())


def test_drawn_rigs_scatter_by_the_standard_errors():
    rig = load_rig(SHORT)
    path = "valves.valve.ports.supply.conductance_m3_s_pa"
    drawn = np.array([get_parameter(r, path) for r in draw_rigs(rig, 300, 1)])
    sigma = next(p.std_error for p in rig.fit.parameters if p.path == path)
    assert drawn.std() == pytest.approx(sigma, rel=0.15)
    assert drawn.mean() == pytest.approx(get_parameter(rig, path), rel=0.01)
    again = draw_rigs(rig, 2, 1)
    assert get_parameter(again[1], path) == drawn[1]
    assert get_parameter(draw_rigs(rig, 1, 2)[0], path) != drawn[0]
    for one in again:
        assert (np.diff(one.valves["valve"].ports["supply"].opening.fraction) >= 0.0).all()
    assert draw_rigs(rig, 2, 1, spread=0.0) == [rig, rig]


def test_corners_of_a_jagged_target_move_within_their_period():
    even = Target("jagged", 1e5, 5e5, 0.5, seed=2)
    moved = Target("jagged", 1e5, 5e5, 0.5, seed=2, jitter=0.6)
    times = np.arange(0.0, 10.0, 1e-3)
    for target in (even, moved):
        series = target.at(times)
        assert np.array_equal(series[::7], target.at(times[::7]))  # whichever is asked for first
        bends = np.abs(np.diff(series, 2)) > 1.0
        corners = times[1:-1][bends]
        corners = corners[np.diff(corners, prepend=-1.0) > 5e-3]
        off = np.abs((corners + 0.25) % 0.5 - 0.25)
        assert corners.size >= 17
        assert off.max() < (0.002 if target is even else 0.152)
        assert np.abs(np.diff(series)).max() < 4e5 * 1e-3 / (0.5 * (1 - target.jitter)) * 1.01
    assert off.max() > 0.05
    with pytest.raises(InputError, match="jitter"):
        Target("jagged", 1e5, 5e5, jitter=1.0)


def test_the_environment_can_be_made_from_a_rig_at_hand():
    rig = load_rig(SHORT)
    env = PressureTracking(small(spread=0.0), rig)
    assert env.rig is rig


def test_a_policy_trains_on_what_an_observer_tells():
    """Of all taps and of the gas, by the controlled tap alone: near the truth, and no more."""
    recipe = Recipe(tap="end", taps=("end", "valve_out", "middle"), line=(("tube", 3),))
    settings = {"num_envs": 3, "recipe": recipe, "spread": 0.0, "noise_pa": 250.0, "horizon": 60}
    virtual = {"taps": ["end"], "observer": {"members": 16, "dx_m": 0.25}}
    real, seen = make_env(small(**settings)), make_env(small(**settings, virtual=virtual))
    action = np.random.default_rng(5).uniform(-0.5, 0.5, (60, 3, 1))
    first, gas = 6 * 7, slice(-9, None)  # previews with their zooms come first
    pressures = slice(first, first + 3)
    off_taps, off_gas = [], []
    for env in (real, seen):
        env.reset(seed=3)
    for k, a in enumerate(action):
        true, told = (env.step(a)[0] for env in (real, seen))
        assert np.isfinite(told).all()
        if k > 20:
            off_taps.append(told[:, pressures] - true[:, pressures])
            off_gas.append(told[:, gas] - true[:, gas])
        if k == 40:
            moved = np.ptp(true[:, gas])
    scale = recipe.range_pa
    # a virtual tap beside a real one with its noise of 250 Pa; what is heard is no truth
    assert 100.0 < np.std(off_taps) * scale < 4e3
    assert np.std(off_gas) < 0.05 * moved
    # what other taps read is not seen: with those deaf there is no difference
    deaf, alike = (make_env(small(**settings, virtual=virtual)) for _ in range(2))
    deaf._noise[1:] = 1e6
    for env in (deaf, alike):
        env.reset(seed=3)
    for a in action[:10]:
        np.testing.assert_array_equal(alike.step(a)[0], deaf.step(a)[0])


@pytest.mark.parametrize(
    ("virtual", "words"),
    [
        ({"taps": ["supply"]}, "virtual.taps: found 'supply', the recipe has valve_out, end"),
        ({"taps": []}, "virtual.taps"),
        ({"taps": ["end"], "observer": {"members": 1}}, "virtual.observer.members"),
        ({"taps": ["end"], "observer": {"colour": 1}}, "unknown key 'virtual.observer.colour'"),
    ],
)
def test_virtual_taps_of_a_training_that_make_no_sense(virtual, words):
    with pytest.raises(InputError, match=words):
        make_env(small(virtual=virtual))


def test_settings_of_an_observer_are_the_usual_ones_but_for_those_given():
    found = small(virtual={"taps": ["end"], "observer": {"members": 8}}).virtual.observer
    assert found == ADAPTING.model_copy(update={"members": 8})
    again = EnvSettings(**small(virtual={"taps": ["end"], "observer": found}).plain())
    assert again.virtual.observer == found
