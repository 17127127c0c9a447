# SPDX-License-Identifier: Apache-2.0
"""Controllers behind their one interface: what they answer, and what their files hold."""

import math
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from tests.references import iso6358

from pneu_common.errors import InputError
from pneu_policy.control.controllers import (
    FeedForwardPid,
    PidController,
    PolicyController,
    load_controller,
    save_pid,
)
from pneu_policy.control.feed_forward import FeedForward, Way
from pneu_policy.control.identity import rig_identity
from pneu_policy.control.observations import Observer, Recipe
from pneu_policy.control.pid import Gains, Pid
from pneu_policy.control.policy_file import PolicyFile
from pneu_policy.task.plants import ControlPlant
from pneu_policy.task.targets import Target
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import Rig

ROOT = Path(__file__).parents[3]
GAINS = Gains(kp_v_per_pa=1e-5, ki_v_per_pa_s=3e-5, kd_v_s_per_pa=1e-7)
ALL_TAPS = ("supply", "valve_out", "middle", "end", "exhaust")


@pytest.fixture(scope="module")
def rig():
    return load_rig(ROOT / "rigs/rig_a_fitted.yaml")


def make_policy(rig, recipe):
    rng = np.random.default_rng(4)
    sizes = [recipe.size, 32, 32, 1]
    weights = [
        (rng.normal(0.0, m**-0.5, (n, m)).astype(np.float32), np.zeros(n, dtype=np.float32))
        for m, n in pairwise(sizes)
    ]
    return PolicyFile(weights, recipe, rig_identity(rig), {})


def controllers(rig):
    ahead = FeedForward.of_rig(rig, "end", 0.8, 0.05)
    return [
        PidController(GAINS),
        FeedForwardPid(GAINS, ahead, 0.02),
        PolicyController(make_policy(rig, Recipe(tap="end", taps=ALL_TAPS))),
    ]


@pytest.fixture(params=[0, 1, 2], ids=["pid", "feed_forward", "policy"])
def controller(request, rig):
    return controllers(rig)[request.param]


def told(controller, k):
    """Made-up readings and targets of step k."""
    rng = np.random.default_rng(k)
    taps = {tap: 300e3 + 20e3 * rng.normal() for tap in controller.taps}
    return taps, [300e3 + 20e3 * rng.normal() for _ in controller.preview_s]


def test_after_a_reset_it_answers_as_before(controller):
    runs = []
    for _ in range(2):
        controller.reset()
        runs.append([controller.step(*told(controller, k)) for k in range(50)])
    assert runs[0] == runs[1]
    assert all(0.0 <= v <= 10.0 for v in runs[0]) and np.ptp(runs[0]) > 0.1


def test_what_it_must_be_told_is_consistent(controller):
    assert controller.tap in controller.taps and controller.period_s > 0.0
    assert controller.preview_s[0] == 0.0
    assert list(controller.preview_s) == sorted(set(controller.preview_s))


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_number_that_is_not_finite_is_refused_wherever_it_stands(controller, bad):
    for tap in controller.taps:
        taps, targets = told(controller, 0)
        with pytest.raises(ValueError, match="found"):
            controller.step({**taps, tap: bad}, targets)
    for n in range(len(controller.preview_s)):
        taps, targets = told(controller, 0)
        targets[n] = bad
        if isinstance(controller, FeedForwardPid) and n == 0:
            continue  # it looks ahead only
        with pytest.raises(ValueError, match="found"):
            controller.step(taps, targets)


def test_a_step_takes_microseconds(controller):
    taps, targets = told(controller, 0)
    spent = []
    for _ in range(2000):
        begin = time.perf_counter()
        controller.step(taps, targets)
        spent.append(time.perf_counter() - begin)
    assert np.median(spent) < 200e-6


@pytest.mark.parametrize(("factor", "cut"), [(6.0, 1.5), (-6.0, 7.7)])
def test_the_policy_is_its_network_on_the_features_of_its_recipe(rig, factor, cut):
    """The controlled tap is not the first; readings come in another order and with one more."""
    recipe = Recipe(
        tap="end", taps=("middle", "end"), preview_s=(0.0, 0.1), past=2, levels=2,
        null_v=4.6, half_v=3.1,
    )  # fmt: skip
    *layers, (weight, bias) = make_policy(rig, recipe).weights
    # so that some actions are cut off, on either side
    policy = PolicyFile([*layers, (factor * weight, bias)], recipe, rig_identity(rig), {})
    controller, observer = PolicyController(policy), Observer(recipe, 1)
    found = []
    for k in range(60):
        taps, targets = told(controller, k)
        seen = np.array([[taps["middle"], taps["end"]]])
        volts = recipe.volts(policy.act(observer.observe(seen, np.array([targets]))[0]))
        observer.acted(np.array([volts]))
        given = {"supply": 9e5, "end": taps["end"], "middle": taps["middle"]}
        found.append(controller.step(given, targets))
        assert found[-1] == pytest.approx(volts, abs=1e-12)
    assert 0 < sum(abs(volts - cut) < 1e-9 for volts in found) < 56


def test_a_feed_forward_pid_takes_each_target_at_its_own_time(rig):
    """A ramp that bends, so that the targets ahead all differ."""
    ahead = FeedForward.of_rig(rig, "end", 0.8, 0.05)
    for lead_s in (0.0, 0.02, 0.04, 0.11):  # before, at and after those of the slope
        controller, pid = (
            FeedForwardPid(GAINS, ahead, lead_s, tap="middle", period_s=0.006),
            Pid(GAINS),
        )
        assert set(controller.preview_s) == {0.0, lead_s, 0.04, 0.06}
        for k in range(30):
            at = {
                t: 250e3 + 40e3 * (k * 0.006 + t) + 9e5 * t * t for t in (0.0, lead_s, 0.04, 0.06)
            }
            pressure = 240e3 + 300.0 * k
            wanted = pid.step(at[lead_s], pressure, 0.006, ahead.volts(at[0.04], at[0.06]))
            taps = {"end": 5e5, "middle": pressure}
            found = controller.step(taps, [at[t] for t in controller.preview_s])
            assert found == pytest.approx(wanted, abs=1e-12)
        assert 0.0 < wanted < 10.0


@pytest.mark.parametrize("tap", ["middle", "end", "valve_out"])
def test_every_feature_of_a_pressure_policy_is_what_its_name_says(tap):
    """Of the second of two rigs, whichever of the taps is controlled."""
    taps = ("valve_out", "middle", "end")
    recipe = Recipe(tap=tap, taps=taps, preview_s=(0.0, 0.125), past=2, levels=2, base=3.0)
    observer = Observer(recipe, 2)
    first = dict(zip(taps, (310e3, 340e3, 290e3), strict=True))
    now = dict(zip(taps, (330e3, 335e3, 260e3), strict=True))
    targets = np.array([[1e5, 2e5], [365e3, 405e3]])
    observer.observe(np.array([[9e4] * 3, list(first.values())]), targets)
    observer.acted(np.array([0.0, 7.5]))
    observer.acted(np.array([0.0, 4.0]))
    seen = observer.observe(np.array([[9e4] * 3, list(now.values())]), targets)
    expected = {}
    for ahead, target in zip(("0", "0.125"), targets[1], strict=True):
        error = (target - now[tap]) / 1e5
        expected[f"error at {ahead} s"] = error
        for zoom in (1, 3):
            expected[f"sin({zoom} error at {ahead} s)"] = math.sin(zoom * error)
            expected[f"cos({zoom} error at {ahead} s)"] = math.cos(zoom * error)
    for one in taps:
        expected[f"pressure {one}"] = (now[one] - 350e3) / 200e3
        expected[f"change {one}"] = (now[one] - first[one]) / 1e5
    expected |= {"command 1 back": -0.2, "command 2 back": 0.5}
    found = dict(zip(recipe.names(), seen[1].tolist(), strict=True))
    assert found == pytest.approx(expected, abs=1e-12)


def test_a_policy_that_sees_the_gas_of_lines_wants_it(rig):
    recipe = Recipe(tap="end", taps=("end",), line=(("tube", 2),))
    controller = PolicyController(make_policy(rig, recipe))
    taps, targets = told(controller, 0)
    with pytest.raises(ValueError, match="gas of lines"):
        controller.step(taps, targets)
    assert 0.0 <= controller.step(taps, targets, np.zeros((1, 6))) <= 10.0


def test_without_feed_forward_and_lead_it_is_the_pid(rig):
    plain = PidController(GAINS)
    other = FeedForwardPid(GAINS, FeedForward.of_rig(rig, "end", gain=0.0))
    for k in range(50):
        taps, targets = told(other, k)
        assert other.step(taps, targets) == plain.step(taps, targets[:1])


def test_feed_forward_adds_to_the_voltage_but_not_to_the_integral():
    one, two = Pid(GAINS), Pid(GAINS)
    for k in range(50):
        volts = one.step(3e5, 2.99e5 + 10.0 * k, 0.01)
        assert two.step(3e5, 2.99e5 + 10.0 * k, 0.01, more_v=0.25) == pytest.approx(volts + 0.25)
        assert two.integral_v == one.integral_v


def chamber_like(length_m=0.1):
    """A short wide pipe behind a linear valve: close to a well-mixed volume without losses."""
    opening = {"voltage_v": [5.0, 10.0], "fraction": [0.0, 1.0]}
    closing = {"voltage_v": [0.0, 5.0], "fraction": [1.0, 0.0]}
    port = {"conductance_m3_s_pa": 1e-9, "critical_ratio": 0.3}
    wide = {"area_m2": 1e-4, "wall": {"nusselt": 1e6}}  # isothermal
    return Rig.model_validate(
        {
            "name": "chamber_like",
            "pipes": {
                "supply_line": {"from": "supply", "to": "a", "length_m": 0.1, **wide},
                "vessel": {"from": "b", "to": "closed", "length_m": length_m, **wide},
                "exhaust_line": {"from": "c", "to": "room", "length_m": 0.1, **wide},
            },
            "reservoirs": {"supply": {"pressure_pa": 7e5}, "room": {"pressure_pa": 1e5}},
            "valves": {
                "valve": {
                    "command": "voltage",
                    "ports": {
                        "in": {"from": "a", "to": "b", **port, "opening": opening},
                        "out": {"from": "b", "to": "c", **port, "opening": closing},
                    },
                }
            },
            "commands": {"voltage": {}},
            "taps": {"end": {"pipe": "vessel", "position_m": 0.05}},
        }
    )


@pytest.mark.parametrize("slope", [4e5, -4e5])
def test_feed_forward_alone_follows_a_ramp_of_the_simulated_vessel(slope):
    rig = chamber_like()
    ahead = FeedForward.of_rig(rig, "end")
    assert ahead.volume_m3 == pytest.approx(1e-5)
    plant = ControlPlant([rig], 0.01)
    start = 300e3
    plant.reset(np.array([start]))
    for k in range(40):
        early = start + slope * (0.01 * k - 0.005)
        seen = plant.step(np.array([5.0 + ahead.volts(early, early + 0.02 * slope)]))
    # Half a tenth of the way: nearly isothermal, and the losses of the lines are small.
    assert seen[0, 0] - start == pytest.approx(0.4 * slope, rel=0.05)


@pytest.mark.parametrize("slope", [3e5, -3e5])
@pytest.mark.parametrize("pressure", [150e3, 320e3, 560e3])
def test_feed_forward_is_the_quotient_of_the_flows_that_are_needed_and_there(pressure, slope):
    """Flows by the reference of ISO 6358; choked and not, filling and draining."""
    fill = Way(7e5, 2.1e-9, 0.31, (4.7, 5.5, 9.0), (0.0, 0.2, 1.0))
    drain = Way(1e5, 3.3e-9, 0.22, (4.5, 3.0, 0.5), (0.0, 0.5, 1.0))
    ahead = FeedForward(0.9, 0.05, 1.7e-5, 281.0, 4.6, fill, drain)
    way, up, down = (fill, 7e5, pressure) if slope > 0.0 else (drain, pressure, 1e5)
    flow = iso6358.mass_flow(way.conductance_m3_s_pa, way.critical_ratio, up, 281.0, down)
    opening = 0.9 * 1.7e-5 * 3e5 / (287.05 * 281.0) / flow
    assert 0.02 < opening < 0.9
    rising = np.interp(opening, way.fraction, way.voltage_v)
    found = ahead.volts(pressure - 0.01 * slope, pressure + 0.01 * slope)
    assert found == pytest.approx(rising - 4.6, rel=2e-3, abs=1e-4)
    assert ahead.preview_s == (0.04, 0.06)


def test_feed_forward_opens_wide_where_the_reservoir_cannot_drive_the_flow(rig):
    ahead = FeedForward.of_rig(rig, "end")
    assert ahead.null_v + ahead.volts(640e3, 650e3) == 10.0
    assert ahead.null_v + ahead.volts(100e3, 90e3) == 0.0
    assert ahead.volts(300e3, 300e3) == 0.0


def tracking_error(rig, controller, kind):
    """RMS of target minus pressure, with sensor noise and a command that is a period late, Pa."""
    plant = ControlPlant([rig], controller.period_s)
    target = Target(kind, 150e3, 550e3, 0.6, seed=3)
    rng = np.random.default_rng(0)
    seen = plant.reset(np.array([float(target.at(0.0))]))[0]
    late, errors = 5.0, []
    for k in range(round(3.0 / controller.period_s)):
        noisy = dict(zip(plant.taps, seen + 250.0 * rng.normal(size=seen.size), strict=True))
        wanted = target.at(k * controller.period_s + np.array(controller.preview_s))
        volts = controller.step(noisy, wanted.tolist())
        seen, late = plant.step(np.array([late]))[0], volts
        errors.append(wanted[0] - seen[plant.taps.index("end")])
    return float(np.sqrt(np.mean(np.square(errors))))


def test_feed_forward_helps_the_same_gains(rig):
    gains = Gains(kp_v_per_pa=8e-6, ki_v_per_pa_s=1e-6)
    plain = tracking_error(rig, PidController(gains), "smooth")
    ahead = FeedForward.of_rig(rig, "end", 1.0, 0.03)
    assert tracking_error(rig, FeedForwardPid(gains, ahead), "smooth") < 0.5 * plain


def test_pids_come_back_from_their_files(rig, tmp_path):
    for one in controllers(rig)[:2]:
        path = tmp_path / f"{one.name}.yaml"
        save_pid(one, {"seed": 3}, path)
        again = load_controller(path)
        assert type(again) is type(one) and again.gains == one.gains
        assert (again.period_s, again.preview_s) == (one.period_s, one.preview_s)
        steps = [told(one, k) for k in range(20)]
        assert [again.step(*s) for s in steps] == [one.step(*s) for s in steps]
    assert again.ahead == one.ahead


def test_a_policy_comes_from_its_file(rig, tmp_path):
    policy = make_policy(rig, Recipe(tap="end", taps=ALL_TAPS))
    policy.save(tmp_path / "deft.npz")
    controller = load_controller(tmp_path / "deft.npz")
    assert isinstance(controller, PolicyController) and controller.name == "deft"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("pneu_rig: 1", "pneu_controller: found None"),
        ("pneu_controller: 1\nkind: fuzzy", "found 'fuzzy', allowed are pid, feed_forward"),
        ("pneu_controller: 1\nkind: pid", "gains: found None"),
        ("pneu_controller: 1\nkind: pid\ngains: {}", "gains.kp_v_per_pa: missing"),
        ("pneu_controller: 1\nkind: pid\ngains: {kp: 1}", "gains.kp: unknown"),
        ("pneu_controller: 1\nkind: pid\ngains: {kp_v_per_pa: x}", "gains.kp_v_per_pa: found 'x'"),
        ("pneu_controller: 1\nkind: pid\ngains: {kp_v_per_pa: -1}", "gains.kp_v_per_pa: found -1"),
        ("pneu_controller: 1\nkind: pid\nlead: 3\ngains: {kp_v_per_pa: 1}", "lead: unknown"),
        (
            "pneu_controller: 1\nkind: feed_forward\ngains: {kp_v_per_pa: 1}",
            "feed_forward.*gain: missing",
        ),
        ("a: [", "is not YAML"),
    ],
)
def test_files_that_hold_no_controller_are_refused(tmp_path, text, message):
    path = tmp_path / "pid.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as error:
        load_controller(path)
    assert str(path) in str(error.value)


def test_other_files_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"\.npz.*\.yaml"):
        load_controller("pid.txt")
    with pytest.raises(InputError, match="no such"):
        load_controller(tmp_path / "pid.yaml")


def test_feed_forward_is_refused_where_the_rig_gives_none():
    with pytest.raises(InputError, match="found 'nose'"):
        FeedForward.of_rig(chamber_like(), "nose")
    with pytest.raises(InputError, match="one valve"):
        FeedForward.of_rig(load_rig(ROOT / "rigs/ventilator.yaml"), "airway")
