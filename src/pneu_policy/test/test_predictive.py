# SPDX-License-Identifier: Apache-2.0
"""Predictive control: plans on the model, limits, late plans, the file, the process beside."""

import math
from pathlib import Path

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_policy.control.controllers import PidController, load_controller, save_pid
from pneu_policy.control.horizon import Aim
from pneu_policy.control.late import with_delay
from pneu_policy.control.pid import Gains
from pneu_policy.control.planning import Beside, Planner, Request
from pneu_policy.control.predictive import Course, PredictiveController
from pneu_policy.control.predictive_file import save_predictive
from pneu_policy.control.predictive_settings import PredictiveSettings
from pneu_policy.control.robot_controllers import load_robot_controller
from pneu_policy.judge.evaluate import simulated_tracks
from pneu_policy.judge.metrics import target_at
from pneu_policy.judge.robot import JointTasks, judge_joint
from pneu_policy.judge.tasks import Conditions, Tasks
from pneu_policy.task.plants import ControlPlant
from pneu_sim.observe.observer import Observer
from pneu_sim.plant import Plant
from pneu_sim.rig import load_rig
from pneu_sim.rig.model import V_DELAY
from pneu_sim.rig.schema import AttachedEffect

pytestmark = pytest.mark.takes(20)

RIGS = Path(__file__).parents[3] / "rigs"
SHORT = (1, 1, 1, 2, 3)
METHODS = ("gauss_newton", "mppi", "adaptive")


@pytest.fixture(scope="module")
def lab():
    return load_rig(RIGS / "lab.yaml")


def request_of(rig, s, target_pa, plan=None):
    observer = Observer(rig, s.observer.model_copy(update={"dx_m": s.dx_m}), ("end",))
    planner = Planner(rig, Aim("end", ("end",)), s)
    samples = planner.horizon.ahead_s.size
    knots = planner.horizon.knots
    asked = Request(
        0.0,
        np.full(knots, s.null_v) if plan is None else plan,
        np.full(s.every, s.null_v),
        np.full(samples, target_pa),
        observer.mean_state(),
        np.zeros(len(observer.drifts.unknowns)),
    )
    return planner, asked


def test_a_roll_is_what_the_rig_does(lab):
    s = PredictiveSettings(holds=SHORT)
    planner, asked = request_of(lab, s, 2e5)
    horizon = planner.horizon
    horizon.begin(asked.state, asked.drifted)
    plan = np.array([5.6, 6.0, 5.2, 4.7, 5.1])
    seen = horizon.roll(asked.decided, np.tile(plan, (horizon.lanes, 1)))
    one = ControlPlant([lab], s.period_s, s.dx_m)
    one.reset(lab.ambient.pressure_pa)
    at = one.taps.index("end")
    volts = [5.0, *np.repeat(plan, SHORT)]
    alone = [float(one.step(v)[0, at]) for v in volts]
    # grids differ by the cells of the short exhaust line
    assert seen[s.samples - 1 :: s.samples, 0] == pytest.approx(alone, rel=0.02)


def test_commands_that_are_late_act_as_those_told_later(lab):
    """A period late: what is in force, then what was decided, then the plan but for its end."""
    s = PredictiveSettings(holds=(1,) * 5)
    planner, asked = request_of(lab, s, 2e5)
    horizon = planner.horizon
    horizon.begin(asked.state, asked.drifted)
    plan = np.array([6.1, 6.6, 5.4, 4.2, 5.9])

    def roll(late_s, before_v, decided, plan):
        horizon.late(late_s, before_v)
        return horizon.roll(np.array([decided]), np.tile(plan, (horizon.lanes, 1)))[:, 0]

    late = roll(0.0104, 5.7, 6.9, plan)  # to the nearest sample
    assert late == pytest.approx(roll(0.0, 9.0, 5.7, [6.9, *plan[:-1]]), rel=1e-12)
    assert np.abs(late - roll(0.0, 5.7, 6.9, plan)).max() > 1e3
    for late_s, like_s in ((0.0029, 0.002), (0.0031, 0.004), (-0.01, 0.0)):
        assert np.array_equal(roll(late_s, 5.7, 6.9, plan), roll(like_s, 5.7, 6.9, plan))


class Asked:
    """Plans that are asked for and do not come."""

    def __init__(self):
        self.requests = []

    def ask(self, request):
        self.requests.append(request)
        return True

    def take(self):
        return None

    def forget(self):
        pass

    def end(self):
        pass


@pytest.mark.parametrize("every", [1, 2])
def test_a_plan_is_asked_for_with_targets_and_commands_at_their_times(lab, every):
    """Targets that bend, so that each time has its own; a running plan goes on meanwhile."""
    holds = (1, 1, 1, 1, 2, 2)
    s = PredictiveSettings(holds=holds, every=every, sample_s=0.005, delay_s=0.0)
    controller = PredictiveController(lab, settings=s)
    controller.planning = Asked()
    readings = dict.fromkeys(lab.taps, 101325.0)

    def target(ahead_s):
        return 1.5e5 + 4e5 * ahead_s + 3e6 * ahead_s**2

    controller.step(readings, [target(t) for t in controller.preview_s], late_s=0.003)
    course = np.array([6.1, 6.2, 6.3, 6.4, 6.5, 6.6])
    controller._course, volts = Course(0.01, course), np.repeat(course, holds).tolist()
    for step in range(1, 2 * every + 1):
        last = controller.step(readings, [target(t) for t in controller.preview_s], late_s=0.003)
        assert last == volts[step - 1]
    first, *_, request = controller.planning.requests
    assert (len(controller.planning.requests), controller.asked) == (3, 3)
    assert controller.missed == 0 and first.begin_s == pytest.approx(0.01 * every)
    now_s = 0.01 * 2 * every
    assert request.begin_s == pytest.approx(now_s + 0.01 * every)
    ahead = 0.005 * np.arange(1, 2 * (every + 8) + 1)
    chords = np.interp(ahead, np.arange(0.0, 0.2, 0.01), target(np.arange(0.0, 0.2, 0.01)))
    assert request.target == pytest.approx(chords)
    held = [*volts, *[6.6] * 20]
    assert request.decided == pytest.approx(held[2 * every - 1 : 3 * every - 1])
    middles = [3 * every - 1 + n for n in (0, 1, 2, 3, 5, 7)]  # of one or two periods each
    assert request.plan == pytest.approx([held[n] for n in middles])
    assert request.late_s == 0.003
    assert request.before_v == held[2 * every - 2]  # what was told now acts 3 ms later


@pytest.mark.parametrize("method", METHODS)
def test_plans_get_better_within_range_and_rate(lab, method):
    s = PredictiveSettings(
        holds=SHORT, method=method, low_v=3.0, high_v=7.0, most_rate_v_s=60.0, plans=16
    )
    planner, asked = request_of(lab, s, 1.8e5)

    def cost(plan):
        lanes = np.tile(plan, (planner.horizon.lanes, 1))
        planner.horizon.begin(asked.state, asked.drifted)
        error = planner.horizon.roll(asked.decided, lanes) - asked.target[:, None]
        return float(planner.horizon.cost(error, lanes, s.null_v)[0])

    plan = asked.plan
    first = cost(plan)
    for _ in range(12):
        asked = Request(0.0, plan, asked.decided, asked.target, asked.state, asked.drifted)
        plan = planner.plan(asked).volts
        assert plan.min() >= 3.0 - 1e-9
        assert plan.max() <= 7.0 + 1e-9
        assert np.abs(np.diff(plan, prepend=5.0)).max() <= 60.0 * s.period_s + 1e-9
    assert cost(plan) < 0.5 * first


def test_more_plans_than_fit_one_tile(lab):
    s = PredictiveSettings(holds=SHORT, method="mppi", plans=80)
    planner, asked = request_of(lab, s, 2e5)
    planner.horizon.begin(asked.state, np.full_like(asked.drifted, 0.01))
    seen = planner.horizon.roll(asked.decided, np.tile(np.full(len(SHORT), 6.0), (80, 1)))
    assert np.ptp(seen, axis=1).max() == pytest.approx(0.0, abs=1e-6)


def test_a_large_step_is_tried_before_it_is_taken(lab):
    s = PredictiveSettings(holds=SHORT)
    tries = []
    for target_pa in (101e3, 5e5):  # where it is, and far away
        planner, asked = request_of(lab, s, target_pa)
        roll, rolled = planner.horizon.roll, []
        planner.horizon.roll = lambda *a, roll=roll, rolled=rolled: rolled.append(1) or roll(*a)
        planner.plan(asked)
        tries.append(len(rolled))
    assert tries == [1, 2]


@pytest.mark.parametrize("more_pa", [2e3, 4e3, 8e3])
@pytest.mark.parametrize(("width_v", "from_v"), [(0.0, 4.95), (0.06, 5.0), (0.12, 5.05)])
def test_a_step_out_of_the_dead_band_makes_no_plan_worse(lab, width_v, from_v, more_pa):
    """What 0.1 V hardly moves is no linear model of what half a volt does."""
    band = AttachedEffect(effect="dead_band", place="valve", parameters={"width_v": width_v})
    rig = lab.model_copy(update={"effects": [*lab.effects, band]})
    s = PredictiveSettings(holds=SHORT)
    start = np.full(len(SHORT), from_v)
    planner, asked = request_of(rig, s, 101325.0 + more_pa, start)
    found = planner.plan(asked).volts

    def cost(plan):
        planner.horizon.begin(asked.state, asked.drifted)
        lanes = np.tile(plan, (planner.horizon.lanes, 1))
        error = planner.horizon.roll(asked.decided, lanes) - asked.target[:, None]
        return float(planner.horizon.cost(error, lanes, s.null_v)[0])

    assert cost(found) < 0.7 * cost(start)


def test_it_follows_on_a_plant_that_its_model_does_not_know(lab, tmp_path):
    save_predictive(tmp_path / "p.yaml", str(RIGS / "lab.yaml"), "end", None, {})
    hidden = [
        AttachedEffect(effect="valve_delay", place="valve", parameters={"delay_s": 0.002}),
        AttachedEffect(effect="flow_gain", place="valve", parameters={"error": -0.06}),
        AttachedEffect(effect="dead_band", place="valve", parameters={"width_v": 0.04}),
    ]
    plant = lab.model_copy(update={"effects": [*lab.effects, *hidden]})
    tasks = Tasks(kinds=("smooth",), seeds=(3,), duration_s=2.5)
    track = simulated_tracks(
        tmp_path / "p.yaml", plant, [tasks.target("smooth", 3)], [3], 2.5, Conditions(dx_m=0.1)
    )[0]
    late = track.time_s > 1.0
    error = (track.pressure_pa - target_at(track, track.time_s))[late]
    assert math.sqrt(float(np.mean(error**2))) < 2.5e3  # of 400 kPa, noise of 250 Pa in it


def test_a_plan_goes_by_time_and_a_late_one_is_not_waited_for(lab):
    s = PredictiveSettings(holds=SHORT)
    controller = PredictiveController(lab, settings=s)

    readings = dict.fromkeys(lab.taps, 101325.0)
    ahead = [1.5e5] * len(controller.preview_s)
    for _ in range(3):
        controller.step(readings, ahead)
    plan = controller.planning.take()
    assert plan is not None
    volts = [plan.volts[0], plan.volts[1], plan.volts[2], *np.repeat(plan.volts[3:], SHORT[3:])]

    class Once(Asked):
        """One plan, then none; whoever makes it is busy."""

        def __init__(self):
            self.plan = plan

        def ask(self, request):
            return False

        def take(self):
            out, self.plan = self.plan, None
            return out

    controller.planning = Once()
    assert controller.step(readings, ahead) == volts[0]
    assert controller.step(readings, ahead, 0.02) == volts[2]  # a step of two periods
    assert controller.step(readings, ahead, 0.01) == volts[3]
    assert controller.missed == 3


def test_plans_made_beside_are_the_same_and_the_process_ends(lab):
    s = PredictiveSettings(holds=SHORT, rounds=1)
    planner, asked = request_of(lab, s, 1.7e5)
    here = planner.plan(asked)
    beside = Beside(lab, Aim("end", ("end",)), s)
    try:
        assert beside.ask(asked)
        assert not beside.ask(asked)  # it is busy
        found = None
        while found is None:
            found = beside.take()
        assert found.volts == pytest.approx(here.volts, abs=1e-12)
        assert beside.ask(asked)
        beside.forget()
        while beside._busy:
            assert beside.take() is None  # what was forgotten comes to nothing
        assert beside.ask(asked)
    finally:
        beside.end()
    assert not beside._process.is_alive()
    with pytest.raises(InputError, match="has ended"):
        beside._busy = False
        beside.ask(asked)


def test_it_goes_on_by_its_virtual_tap(lab):
    s = PredictiveSettings(holds=SHORT)
    controller = PredictiveController(lab, settings=s)
    plant = ControlPlant([lab], 0.01, 0.1)
    seen = plant.reset(101325.0)
    at = plant.taps.index("end")
    for n in range(120):
        read = dict(zip(plant.taps, seen[0].tolist(), strict=True))
        if n > 60:
            read["end"] = math.nan
        volts = controller.step(read, [2.2e5] * len(controller.preview_s))
        seen = plant.step(volts)
    assert seen[0, at] == pytest.approx(2.2e5, rel=0.02)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("tap: end", "rig: found None, needed is the path of a rig file"),
        ("rig: {lab}\ntap: 3", "tap: found 3, needed is the name of a tap"),
        ("rig: {lab}\ntaps: end", "taps: found 'end', needed are names of taps"),
        ("rig: {lab}\ntap: far", "'far': rig 'lab' has supply"),
        ("rig: {lab}\ntaps: [far]", "taps: 'far': rig 'lab' has supply"),
        ("rig: {lab}\nsettings: {{period_s: -1}}", "settings.period_s"),
        ("rig: {lab}\nsettings: {{sample_s: 0.003}}", "sample_s: found 0.003, it must divide"),
        ("rig: {lab}\nsettings: {{holds: []}}", "holds: found"),
        ("rig: {lab}\nsettings: {{observer: {{member: 3}}}}", "did you mean 'members'"),
        ("rig: {lab}\nspeed: 1", "speed: unknown, known are"),
        ("rig: nowhere.yaml", "nowhere.yaml"),
    ],
)
def test_a_file_that_makes_none_is_refused_in_a_sentence(tmp_path, text, words):
    path = tmp_path / "p.yaml"
    text = text.format(lab=RIGS / "lab.yaml")
    path.write_text(f"pneu_controller: 1\nkind: predictive\n{text}\n", encoding="utf-8")
    with pytest.raises(InputError) as found:
        load_controller(path)
    assert words in str(found.value)
    assert str(found.value).startswith(str(path)) or "nowhere" in words


def test_it_refuses_another_rig(lab):
    controller = PredictiveController(lab, settings=PredictiveSettings(holds=SHORT))
    with pytest.raises(InputError, match="p: plans on rig 'lab', found rig"):
        controller.check_rig(load_rig(RIGS / "rig_b_fitted.yaml"), "p")
    with pytest.raises(ValueError, match="a target that is not finite"):
        controller.step(dict.fromkeys(lab.taps, 1e5), [math.nan] * len(controller.preview_s))


def test_a_controller_sees_virtual_taps_and_does_not_know(lab, tmp_path):
    save_pid(PidController(Gains(2e-5, 1e-4)), {}, tmp_path / "pid.yaml")
    text = f"pneu_controller: 1\nkind: virtual\ncontroller: pid.yaml\nrig: {RIGS / 'lab.yaml'}\n"
    (tmp_path / "v.yaml").write_text(text + "taps: [valve_out]\n", encoding="utf-8")
    controller = load_controller(tmp_path / "v.yaml")
    assert (controller.tap, controller.taps) == ("end", ("valve_out",))
    plant = ControlPlant([lab], controller.period_s, 0.1)
    seen = plant.reset(101325.0)
    for _ in range(400):
        read = {"valve_out": float(seen[0, plant.taps.index("valve_out")])}
        seen = plant.step(controller.step(read, [2.2e5] * len(controller.preview_s)))
    assert seen[0, plant.taps.index("end")] == pytest.approx(2.2e5, rel=0.02)
    for line, words in (
        ("", "taps: found None, needed are names"),
        ("taps: [far]\n", "'far': rig 'lab' has supply"),
        ("taps: [end]\nspeed: 1\n", "speed: unknown, known are"),
        ("taps: [end]\nobserver: {members: 1}\n", "v.yaml: observer.members"),
        ("taps: [end]\ndelay_s: late\n", "v.yaml: delay_s"),
    ):
        (tmp_path / "v.yaml").write_text(text + line, encoding="utf-8")
        with pytest.raises(InputError, match=words):
            load_controller(tmp_path / "v.yaml")


@pytest.mark.long
def test_a_policy_that_sees_gas_runs_by_what_an_observer_tells(tmp_path):
    """One tap is there: what the thesis could only simulate (7.3) drives a plant."""
    policy, rig_file = RIGS.parent / "policies" / "short_line_0.npz", RIGS / "rig_a_fitted.yaml"
    text = f"pneu_controller: 1\nkind: virtual\ncontroller: {policy}\ntaps: [end]\n"
    (tmp_path / "v.yaml").write_text(f"{text}rig: {rig_file}\n", encoding="utf-8")
    rig = load_rig(rig_file)
    tasks = Tasks(seeds=(101,), duration_s=2.0)
    target, conditions = tasks.target("jagged", 101), Conditions(dx_m=0.125)
    observed, true = (
        tasks.judge(
            simulated_tracks(file, rig, [target], [1], tasks.duration_s, conditions)[0]
        ).rmse_atm
        for file in (tmp_path / "v.yaml", policy)
    )
    assert observed < 1.2 * true < 0.05
    (tmp_path / "v.yaml").write_text(f"{text}rig: {RIGS / 'kokoro.yaml'}\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"v\.yaml: taps: 'end': rig 'kokoro' has"):
        load_controller(tmp_path / "v.yaml")


def test_commands_are_late_at_all_valves():
    rig = load_rig(RIGS / "kokoro_fitted.yaml")
    known, late = (
        Plant([one], 0.25).spools.spool[0, :, V_DELAY] for one in (rig, with_delay(rig, 0.006))
    )
    np.testing.assert_allclose(late - known, 0.006)


@pytest.mark.long
def test_a_joint_follows_by_both_its_valves():
    known, path = load_rig(RIGS / "kokoro_fitted.yaml"), RIGS.parent / "policies"
    tasks = JointTasks("elbow", -0.4, 0.4, kinds=("smooth",), runs=1, seconds=1.5)
    (run,) = judge_joint(path / "kokoro_predictive.yaml", known, known, tasks, 0.12)
    assert run.rmse < math.radians(1.5)
    # one opens as far as the other closes
    np.testing.assert_allclose(run.volts.sum(axis=0), 10.0, atol=1e-9)


@pytest.mark.long
def test_a_joint_carries_what_nobody_told_it_of():
    """As well as with what it carries in its rig file, after it has found out."""
    known, path = load_rig(RIGS / "kokoro_fitted.yaml"), RIGS.parent / "policies"
    values = {"mass_kg": 0.3, "distance_m": 0.15}
    load = AttachedEffect(effect="payload", place="elbow", parameters=values)
    true = known.model_copy(update={"effects": [load]})
    tasks = JointTasks("elbow", -0.4, 0.4, kinds=("smooth",), runs=1, seconds=1.5)
    (run,) = judge_joint(path / "kokoro_predictive.yaml", known, true, tasks, 0.12)
    assert run.rmse < math.radians(2.5)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("settings: {period_s: 0.02}", "period_s"),
        ("settings: {dx: 0.2}", "did you mean .dx_m"),
        ("drives: []", "drives: found 0, a predictive controller has one"),
    ],
)
def test_a_file_of_a_joint_that_makes_none_is_refused(tmp_path, text, words):
    head = "pneu_robot_controller: 1\nkind: predictive\nperiod_s: 0.01\n"
    drives = "drives: [{encoder: elbow, cylinder: forearm, taps: [head_port, rod_port]}]\n"
    path = tmp_path / "p.yaml"
    path.write_text(head + ("" if "drives" in text else drives) + text + "\n", encoding="utf-8")
    with pytest.raises(InputError, match=words):
        load_robot_controller(path, load_rig(RIGS / "kokoro_fitted.yaml"))
