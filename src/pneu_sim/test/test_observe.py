# SPDX-License-Identifier: Apache-2.0
"""The observer: its analysis against the Kalman filter, and rigs that it sees a part of."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from pneu_common.errors import InputError
from pneu_sim import sensors
from pneu_sim.observe.leaks import with_room_for_leaks
from pneu_sim.observe.nearness import distances, gaspari_cohn
from pneu_sim.observe.observer import Observer
from pneu_sim.observe.settings import Drift, ObserverSettings
from pneu_sim.observe.trust import Trust
from pneu_sim.observe.update import move
from pneu_sim.plant import Plant
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import AttachedEffect

LAB = Path(__file__).parents[3] / "rigs/lab.yaml"
COARSE = ObserverSettings(dx_m=0.25, fewest_cells=1)
PERIOD_S = 0.004
NOISE_PA = 250.0


@pytest.fixture(scope="module")
def lab():
    return load_rig(LAB)


def commands(count, seed=1):
    """Levels about null, each held for 40 ms."""
    rng = np.random.default_rng(seed)
    return 5.0 + np.repeat(rng.uniform(-0.7, 0.9, count // 10 + 1), 10)[:count]


def recorded(rig, volts, effects=(), dx_m=0.1, seed=2):
    """What the taps of a rig read under commands: (n, taps) true and noisy."""
    plant = Plant([rig.model_copy(update={"effects": [*rig.effects, *effects]})], dx_m)
    _, seen = plant.advance(volts[None, None], PERIOD_S)
    true = seen[1:, :, 0]
    noise = np.full(true.shape[1], NOISE_PA)
    return true, sensors.corrupt(true, noise, np.zeros_like(noise), np.random.default_rng(seed))


def followed(rig, volts, read, used, settings=COARSE, spoil=None):
    """An observer led along; and (n, taps) what it said, and its standard deviations."""
    observer = Observer(rig, settings, used)
    mean, std = np.empty_like(read), np.empty_like(read)
    for n, row in enumerate(read):
        now = dict(zip(observer.sensors, row.tolist(), strict=True))
        if spoil is not None:
            now = spoil(n, now)
        observer.advance(volts[None, n : n + 1], PERIOD_S)
        observer.assimilate(now)
        told = observer.estimate()
        mean[n], std[n] = list(told.mean.values()), list(told.std.values())
    return observer, mean, std


def test_the_localisation_is_that_of_gaspari_and_cohn():
    # their eq. 4.10 where both of its pieces meet, and by hand at half of that
    at = np.array([0.0, 1.0, 2.0, 3.0])
    assert gaspari_cohn(at) == pytest.approx([1.0, 5.0 / 24.0, 0.0, 0.0])
    r = 0.5
    by_hand = -0.25 * r**5 + 0.5 * r**4 + 0.625 * r**3 - 5.0 / 3.0 * r**2 + 1.0
    assert gaspari_cohn(np.array([r]))[0] == pytest.approx(by_hand)


def test_the_analysis_is_the_kalman_filter_s():
    rng = np.random.default_rng(0)
    root = np.array([[2.0, 0.0], [1.2, 0.7]])
    members = root @ rng.standard_normal((2, 60)) + np.array([[3.0], [-1.0]])
    mean, covariance = members.mean(axis=1), np.cov(members)
    h, variance, reading = np.array([1.0, 0.5]), 0.8, 4.2
    move(members, h @ members, reading, variance, np.ones(2), slice(0, 0))
    gain = covariance @ h / (h @ covariance @ h + variance)
    assert members.mean(axis=1) == pytest.approx(mean + gain * (reading - h @ mean))
    assert np.cov(members) == pytest.approx(covariance - np.outer(gain, h @ covariance))


def test_analyses_in_turn_settle_at_the_riccati_equation_s():
    """An unstable linear plant without noise of its own: the filter's covariance has a limit."""
    step = np.array([[1.12, 0.3, 0.0], [-0.2, 1.05, 0.1], [0.0, 0.1, 1.2]])
    h, variance = np.array([[1.0, 0.4, 0.0], [0.0, -0.3, 0.8]]), np.array([0.8, 0.15])
    forecast = solve_discrete_are(step.T, h.T, np.zeros((3, 3)), np.diag(variance))
    rng = np.random.default_rng(4)
    members, truth = rng.standard_normal((3, 40)) + 2.0, np.array([0.5, -1.0, 0.3])
    gain = forecast @ h.T @ np.linalg.inv(h @ forecast @ h.T + np.diag(variance))
    for n in range(120):
        members, truth = step @ members, step @ truth
        reading = h @ truth + np.sqrt(variance) * rng.standard_normal(2)
        before = members.mean(axis=1)
        if n == 119:
            assert np.cov(members) == pytest.approx(forecast, rel=1e-6)
        for row in (0, 1):  # one sensor after the other, as the observer does
            move(members, h[row] @ members, reading[row], variance[row], np.ones(3), slice(0, 0))
    wanted = before + gain @ (reading - h @ before)
    assert members.mean(axis=1) == pytest.approx(wanted, rel=1e-6)
    assert np.cov(members) == pytest.approx((np.eye(3) - gain @ h) @ forecast, rel=1e-6)


def test_what_is_far_away_or_related_by_chance_alone_is_left():
    rng = np.random.default_rng(3)
    members = rng.standard_normal((400, 16))
    before = members.copy()
    shown = members[0].copy()
    near = np.ones(400)
    near[100:200] = 0.0
    move(members, shown, 1.0, 0.1, near, slice(200, 400))
    assert np.array_equal(members[100:200], before[100:200])
    moved = np.abs(members.mean(axis=1) - before.mean(axis=1))
    assert moved[200:].mean() < 0.5 * moved[1:100].mean()


def test_ways_go_along_lines_but_not_through_valves(lab):
    plant = Plant([lab], 0.25)
    far, _ = distances(lab, plant.plan)
    end = list(plant.plan.taps).index("end")
    first, cells = plant.plan.pipes["tube"]
    length = lab.pipes["tube"].length_m
    at = (np.arange(cells) + 0.5) * length / cells
    want = np.abs(at - lab.taps["end"].position_m)
    assert far[end, first : first + cells] == pytest.approx(want)
    first, cells = plant.plan.pipes["supply_line"]
    assert np.isinf(far[end, first : first + cells]).all()


def test_a_tap_that_is_never_shown_is_known_and_its_intervals_hold(lab):
    volts = commands(400)
    hidden = [
        AttachedEffect(effect="flow_gain", place="valve", parameters={"error": 0.03}),
        AttachedEffect(effect="null_offset", place="valve", parameters={"offset_v": 0.01}),
    ]
    true, read = recorded(lab, volts, hidden)
    observer, mean, std = followed(lab, volts, read, ("valve_out", "end"))
    taps = {name: n for n, name in enumerate(observer.sensors)}
    late = slice(100, None)
    middle = taps["middle"]
    error = (mean - true)[late, middle]
    share = 0.5
    straight = share * (read[:, taps["valve_out"]] + read[:, taps["end"]]) - true[:, middle]
    rms = math.sqrt(float(np.mean(error**2)))
    assert rms < 1.5 * NOISE_PA
    assert rms < 0.35 * math.sqrt(float(np.mean(straight[late] ** 2)))
    off = np.abs(read - mean)[late, middle] / np.hypot(std[late, middle], NOISE_PA)
    assert 0.8 < float(np.mean(off < 1.645)) < 0.99
    assert observer.watch.wrong == []


def test_later_readings_tell_of_what_was(lab):
    """The tap at the valve is known better once its waves have come to the one at the end."""
    volts = commands(400)
    hidden = [AttachedEffect(effect="flow_gain", place="valve", parameters={"error": 0.03})]
    true, read = recorded(lab, volts, hidden)
    back = 5
    observer = Observer(lab, COARSE, ("end",), steps_back=back)
    plain = Observer(lab, COARSE, ("end",))
    at = observer.sensors.index("valve_out")
    then, later = np.full(len(read), np.nan), np.full(len(read), np.nan)
    for n, row in enumerate(read):
        now = dict(zip(observer.sensors, row.tolist(), strict=True))
        for one in (observer, plain):
            one.advance(volts[None, n : n + 1], PERIOD_S)
            one.assimilate(now)
        told, alone = observer.estimate(), plain.estimate()  # looking back changes nothing of now
        assert told.mean == pytest.approx(alone.mean, rel=1e-9)
        then[n] = observer.estimate().mean["valve_out"]
        oldest = observer.past.states[0]
        if n >= back:
            assert oldest.time_s == pytest.approx(observer.plant.time_s - back * PERIOD_S)
            later[n - back] = observer.estimate_of(oldest.shown).mean["valve_out"]
    late = slice(100, len(read) - back)
    before, after = (math.sqrt(float(np.mean((x - true[:, at])[late] ** 2))) for x in (then, later))
    assert after < 0.8 * before


def test_a_state_of_before_is_one_that_runs_on(lab):
    """From what is known later of a state, a run comes nearer to what then happened."""
    volts = commands(200)
    true, read = recorded(lab, volts)
    back = 5
    observer = Observer(lab, COARSE, ("end",), steps_back=back)
    one = Plant([lab], COARSE.dx_m, fewest_cells=COARSE.fewest_cells)
    known = []
    off = {"then": [], "later": []}
    for n, row in enumerate(read):
        observer.advance(volts[None, n : n + 1], PERIOD_S)
        observer.assimilate(dict(zip(observer.sensors, row.tolist(), strict=True)))
        known.append(observer.mean_state())
        if n < 100 or n % 5:
            continue
        states = {"then": known[n - back], "later": observer.earlier_state(known[n - back])}
        for when, state in states.items():
            one.set_state(state)
            _, seen = one.advance(volts[None, None, n - back + 1 : n + 1], PERIOD_S)
            off[when].append(seen[-1, : true.shape[1], 0] - true[n])
    then, later = (float(np.mean(np.square(off[when]))) for when in ("then", "later"))
    assert later < 0.9 * then


def test_it_is_the_same_for_the_same_seed(lab):
    volts = commands(20)
    _, read = recorded(lab, volts)
    first, again = (followed(lab, volts, read, ("end",))[1] for _ in range(2))
    other = followed(lab, volts, read, ("end",), COARSE.model_copy(update={"seed": 1}))[1]
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize(
    ("fault", "word"),
    [("frozen", "frozen"), ("off", "off by 2"), ("late", "late by")],
)
def test_a_tap_that_fails_is_named_and_left_out(lab, fault, word):
    volts = commands(550, seed=5)
    true, read = recorded(lab, volts)
    shown = read.copy()
    used = ("valve_out", "middle", "end")
    end = list(lab.taps).index("end")
    begin = 250
    if fault == "frozen":
        shown[begin:, end] = shown[begin, end]
    elif fault == "off":
        shown[begin:, end] += 20e3
    else:
        for n in range(begin, len(shown)):
            step = 1.0 - math.exp(-PERIOD_S / 0.02)
            shown[n, end] = shown[n - 1, end] + step * (read[n, end] - shown[n - 1, end])
    observer, mean, _ = followed(lab, volts, shown, used)
    assert [name for name in used if observer.trust.standing[name].out] == ["end"]
    assert word in observer.trust.matter("end")
    last = slice(begin + 100, None)
    assert math.sqrt(float(np.mean((mean - true)[last, end] ** 2))) < 3.0 * NOISE_PA


def test_the_drift_of_a_valve_is_found(lab):
    volts = commands(500, seed=7)
    hidden = [AttachedEffect(effect="null_offset", place="valve", parameters={"offset_v": 0.06})]
    _, read = recorded(lab, volts, hidden)
    wide = ObserverSettings(dx_m=0.25, fewest_cells=1, members=32, null=Drift(std=0.1, time_s=20.0))
    observer, _, _ = followed(lab, volts, read, ("valve_out", "end"), wide)
    at = next(n for n, u in enumerate(observer.drifts.unknowns) if u.kind == "null")
    # an offset adds to where the valve closes: the command counts for less
    assert observer.drifts.values[at].mean() == pytest.approx(-0.06, abs=0.03)


def test_a_leak_that_came_about_is_found_and_told(lab):
    """At another place than where there is room for one; where there is none, none is."""
    volts = commands(500, seed=7)
    values = {"area_m2": 4e-8, "position_m": 1.2}
    hidden = [AttachedEffect(effect="leak", place="tube", parameters=values)]
    leaking = ObserverSettings(dx_m=0.25, fewest_cells=1, leak=Drift(std=5e-9, time_s=20.0))
    found = {}
    for effects in (hidden, []):
        true, read = recorded(lab, volts, effects)
        observer, mean, _ = followed(lab, volts, read, ("valve_out", "end"), leaking)
        at = next(n for n, u in enumerate(observer.drifts.unknowns) if u.name == "pipes.tube: leak")
        told = [w for w in observer.watch.wrong if w.startswith("pipes.tube: leak has drifted")]
        found[bool(effects)] = (observer.drifts.values[at].mean(), told)
        off = (mean - true)[250:, observer.sensors.index("middle")]
        assert np.sqrt(np.mean(off**2)) < 2.0 * NOISE_PA
    assert 2e-8 < found[True][0] < 4.5e-8 and found[True][1]
    assert abs(found[False][0]) < 5e-9 and not found[False][1]


def test_room_for_leaks_changes_nothing(lab):
    """Whether lines have a leak of their own or none."""
    values = {"area_m2": 1e-8, "position_m": 0.7}
    own = AttachedEffect(effect="leak", place="tube", parameters=values)
    for effects in ([], [own]):
        rig = lab.model_copy(update={"effects": effects})
        true, _ = recorded(rig, commands(100))
        with_room, _ = recorded(with_room_for_leaks(rig), commands(100))
        np.testing.assert_allclose(with_room, true, rtol=1e-9)


def test_members_that_became_unstable_are_replaced(lab):
    volts = commands(20)
    observer = Observer(lab, COARSE, ("end",))
    state = observer.plant.state()
    state.gas[0][..., 3] = np.nan
    observer.plant.set_state(state)
    observer.advance(volts[None, :1], PERIOD_S)
    assert not observer.lost
    told = observer.estimate()
    assert all(math.isfinite(value) for value in told.mean.values())


def test_where_all_members_are_lost_it_begins_with_what_is_read(lab):
    observer = Observer(lab, COARSE, ("valve_out", "end"))
    state = observer.plant.state()
    state.gas[0][:] = np.nan
    observer.plant.set_state(state)
    observer.advance(np.full((1, 1), 5.0), PERIOD_S)
    assert observer.lost
    observer.assimilate({"valve_out": 3e5, "end": 3e5})
    assert not observer.lost
    assert observer.estimate().mean["middle"] == pytest.approx(3e5, abs=5e3)


def test_the_mean_state_is_that_of_one_rig(lab):
    observer = Observer(lab, COARSE, ("end",))
    state = observer.mean_state()
    one = Plant([lab], 0.25, fewest_cells=1)
    one.set_state(state)
    assert one.readings()[:, 0] == pytest.approx(list(observer.estimate().mean.values()), rel=1e-9)


def test_the_speed_of_a_joint_is_seen_through_a_coarse_encoder():
    rig = load_rig(LAB.parent / "kokoro_fitted.yaml")
    quantum = 2e-3
    plant = Plant([rig], 0.12)
    plant.reset(dict.fromkeys(("head_tube", "rod_tube", "forearm.head", "forearm.rod"), 3.5e5))
    plant.place({"elbow": 0.1})
    used = ("head_port", "rod_port", "elbow")
    told = ObserverSettings(dx_m=0.25, noise_position=0.3 * quantum)
    observer, rng = Observer(rig, told, used), np.random.default_rng(4)
    names, elbow = [*plant.plan.taps, *plant.plan.encoders], plant.joint_names.index("elbow")
    volts, before, goal = np.array([5.0, 5.0]), 0.1, 0.3
    errors: dict[str, list[float]] = {"observed": [], "differences": [], "speed": []}
    inside = []
    for k in range(300):
        goal = rng.uniform(-0.5, 0.5) if k % 25 == 0 else goal
        place, speed = plant.joints()[elbow, :, 0]
        read = dict(zip(names, plant.readings()[:, 0].tolist(), strict=True))
        read |= {tap: read[tap] + NOISE_PA * rng.standard_normal() for tap in used[:2]}
        read["elbow"] = quantum * round(read["elbow"] / quantum)
        if k == 0:
            observer.begin(read, dict(zip(plant.plan.commands, volts, strict=True)))
        else:
            observer.advance(np.repeat(volts[:, None], 5, axis=1), 0.002)
        observer.assimilate(read)
        members = observer.plant.joints()[elbow, 1]
        if k > 25:
            errors["observed"].append(members.mean() - speed)
            errors["differences"].append((read["elbow"] - before) / 0.01 - speed)
            errors["speed"].append(speed)
            inside.append(abs(members.mean() - speed) < 1.645 * members.std(ddof=1))
        before = read["elbow"]
        u = float(np.clip(4.0 * (goal - place) - 0.3 * speed, -1.5, 1.5))
        volts = np.array([5.0 + u, 5.0 - u])
        plant.advance(np.repeat(volts[:, None], 5, axis=1)[None], 0.002)
    rms = {name: math.sqrt(float(np.mean(np.square(of)))) for name, of in errors.items()}
    assert rms["speed"] > 0.5
    assert rms["observed"] < 0.2 * rms["differences"]
    assert np.mean(inside) > 0.8
    # the mean of members is a rig again: the joint where the members have it
    one = Plant([rig], 0.25)
    one.set_state(observer.mean_state())
    mean = observer.plant.joints().mean(axis=-1)
    np.testing.assert_allclose(one.joints()[..., 0], mean, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", ["rail", "cart_pole", "arm", "rig_j", "cylinder_shots"])
def test_whatever_moves_is_followed(name):
    rig = load_rig(LAB.parent / f"{name}.yaml")
    plant = Plant([rig], 0.5, fewest_cells=1)
    observer = Observer(rig, ObserverSettings(members=8, dx_m=0.5, fewest_cells=1))
    names, rng = [*plant.plan.taps, *plant.plan.encoders], np.random.default_rng(5)
    for k in range(25):
        volts = 5.0 + rng.uniform(-0.5, 0.5, (len(plant.plan.commands), 1))
        read = dict(zip(names, plant.readings()[:, 0].tolist(), strict=True))
        if k == 0:
            observer.begin(read)
        else:
            observer.advance(volts, PERIOD_S)
        observer.assimilate(read)
        plant.advance(volts[None], PERIOD_S)
    told = observer.estimate()
    now = dict(zip(names, plant.readings()[:, 0].tolist(), strict=True))
    assert not observer.lost
    assert observer.mean_state().gas[0].shape[-1] == 1
    for tap in plant.plan.taps:
        assert told.mean[tap] == pytest.approx(now[tap], rel=0.1)
    for encoder in plant.plan.encoders:
        assert told.mean[encoder] == pytest.approx(now[encoder], abs=0.02)


def test_one_that_is_wrong_does_not_overrule_two_that_agree():
    s = ObserverSettings()
    trust = Trust(("a", "b", "c"), dict.fromkeys("abc", 250.0), s)
    foreseen, total = dict.fromkeys("abc", 3e5), dict.fromkeys("abc", 300.0**2)
    weights = {}
    for n in range(40):
        read = {"a": 3e5 + 100.0, "b": 3e5 - 100.0, "c": 3.2e5}
        weights = trust.weigh(1.0 + 0.004 * n, 0.004, read, foreseen, total)
        assert math.isinf(weights["c"])
    assert trust.standing["c"].out
    assert weights["a"] == weights["b"] == 1.0


def test_an_encoder_is_not_overruled_by_taps():
    """A link that carries what no file tells moves otherwise than foreseen; its gas does not."""
    noise = {"a": 250.0, "b": 250.0, "q": 1e-3, "r": 1e-3}
    trust = Trust(tuple(noise), noise, ObserverSettings(), ("q", "r"))
    foreseen = {"a": 3e5, "b": 3e5, "q": 0.0, "r": 0.0}
    total = {"a": 300.0**2, "b": 300.0**2, "q": 1e-6, "r": 1e-6}
    for n in range(100):
        # one by fifty standard deviations, the other not at all
        read = {"a": 3e5 + 100.0, "b": 3e5 - 100.0, "q": 0.05, "r": 0.0}
        weights = trust.weigh(1.0 + 0.004 * n, 0.004, read, foreseen, total)
        assert weights == dict.fromkeys(noise, 1.0)
    assert not trust.standing["q"].out and not trust.matter("q")


def test_bad_input_is_told_in_a_sentence(lab):
    with pytest.raises(InputError, match="sensor 'nowhere': rig 'lab' has supply"):
        Observer(lab, COARSE, ("nowhere",))
    with pytest.raises(InputError, match="members: Input should be greater than or equal to 4"):
        ObserverSettings(members=2)
    plate = load_rig(LAB.parent / "rig_a_thin_plate.yaml")
    with pytest.raises(InputError, match="an observer needs the full one"):
        Observer(plate, COARSE)
    with pytest.raises(InputError, match="mechanism: an observer follows bodies"):
        Observer(load_rig(LAB.parent / "arm4.yaml"), COARSE)
