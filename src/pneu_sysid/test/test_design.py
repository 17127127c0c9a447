# SPDX-License-Identifier: Apache-2.0
"""Plans of experiments: within limits, told by linear algebra that is checked, and chosen well."""

import dataclasses
import itertools
import json
import re
from pathlib import Path

import numpy as np
import pytest
from tests.one_tap import LAB, one_tap

from pneu_common.errors import InputError
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import AttachedEffect, Calibration, FitParameter
from pneu_sysid.design import design as designing
from pneu_sysid.design.choose import choose
from pneu_sysid.design.command import foreseen_words, joints_of
from pneu_sysid.design.design import REST_S, Asked, design, promise_of
from pneu_sysid.design.foreseen import foresee, lasting_share, with_known_noise
from pneu_sysid.design.hypotheses import Hypothesis
from pneu_sysid.design.information import Columns, Information, _scatter
from pneu_sysid.design.judge import promised_errors
from pneu_sysid.design.limits import limits_of, volts_of
from pneu_sysid.design.parameters import parameters_to_learn
from pneu_sysid.design.plan import Bounds, Expected, Plan
from pneu_sysid.design.plan_file import check_plan, load_plan
from pneu_sysid.design.possible import possible_rigs
from pneu_sysid.design.tracking import track
from pneu_sysid.design.waves import KINDS, STEP_S, draw_piece, joined
from pneu_sysid.fit import as_fitted
from pneu_sysid.gauss_newton import left_out_moves
from pneu_sysid.results.files import write_json

pytestmark = pytest.mark.takes(15)

ROOT = Path(__file__).resolve().parents[3]
FITTED = one_tap(0.1)


def with_effect(effect: str, place: str, **parameters: float) -> Hypothesis:
    extra = AttachedEffect(effect=effect, place=place, parameters=parameters)
    return Hypothesis(f"{effect}@{place}", FITTED.model_copy(update={"effects": [extra]}))


# ---- limits -----------------------------------------------------------------------------------


def test_volts_are_those_of_the_opening_curves():
    # supply from 5.1 to 10 V, exhaust its mirror image about 5 V
    assert volts_of(LAB) == {"voltage": pytest.approx((0.0, 10.0))}
    limits = limits_of(LAB, low_v=-3.0, high_v=7.0)
    assert (limits.low_v["voltage"], limits.high_v["voltage"]) == pytest.approx((0.0, 7.0))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"low_v": 6.0, "high_v": 6.01}, "6 to 6.01 V for command 'voltage', which leaves nothing"),
        ({"low_v": 12.0}, "which leaves nothing to excite; its valves open between 0 and 10 V"),
        ({"highest_pa": 5.0e4}, "pressures are absolute"),
        ({"lowest_pa": 3e5, "highest_pa": 2e5}, "300000 to 200000 Pa, which leaves nothing"),
        ({"slew_v_s": 0.0}, "slew_v_s: found 0"),
        ({"air_kg": float("nan")}, "air_kg: found nan"),
        ({"joints": {"elbow": (0.0, 1.0)}}, "joints: found 'elbow', rig 'lab' has none"),
    ],
)
def test_limits_that_leave_nothing_are_refused(wrong, words):
    with pytest.raises(InputError, match=words):
        limits_of(LAB, **wrong)


def test_joints_on_the_command_line():
    assert joints_of(["elbow=-0.5:1.2"]) == {"elbow": (-0.5, 1.2)}
    for wrong in ("elbow", "elbow=1", "elbow=a:b"):
        with pytest.raises(InputError, match="needed is NAME=FROM:TO"):
            joints_of([wrong])


# ---- waves ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_waves_keep_to_volts_and_slew_and_repeat(kind):
    kokoro = load_rig(ROOT / "rigs" / "kokoro.yaml")
    limits = limits_of(kokoro, low_v=2.0, high_v=7.5, slew_v_s=100.0)
    for seed in range(20):
        drawn = [
            draw_piece(kokoro, limits, 1.0, kind, np.random.default_rng(seed)) for _ in range(2)
        ]
        volts = joined(drawn, limits)
        assert volts.keys() == kokoro.commands.keys()
        for name, series in volts.items():
            np.testing.assert_array_equal(drawn[0][name], drawn[1][name])
            assert series.size == round(2.0 / STEP_S)
            assert limits.low_v[name] <= series.min() <= series.max() <= limits.high_v[name]
            assert np.abs(np.diff(series)).max() <= 100.0 * STEP_S * (1.0 + 1e-9)


@pytest.mark.parametrize("file", ["lab", "rig_j"])
def test_tracking_has_pressures_follow_targets_within_limits(file):
    rig = load_rig(ROOT / "rigs" / f"{file}.yaml")
    limits = limits_of(rig, low_v=1.0, high_v=9.0, slew_v_s=500.0)
    found = track(rig, limits, 1.0, 4, np.random.default_rng(3))
    assert found.targets.keys() == set(rig.commands)
    for name, target in found.targets.items():
        off = (found.shown[name] - target)[40:]
        assert np.sqrt(np.mean(off**2)) < 0.4 * target.std()
        for piece in found.pieces:
            assert 1.0 <= piece[name].min() < 4.9 and 5.1 < piece[name].max() <= 9.0
            assert np.abs(np.diff(piece[name])).max() <= 500.0 * STEP_S * (1.0 + 1e-9)


def test_a_tracking_plan_is_one_piece_of_the_asked_length(monkeypatch):
    monkeypatch.setattr(designing, "PROMISED", 1)  # of other rigs, by which it is judged
    plan = design(FITTED, Asked(2.0, limits_of(FITTED), [], FITTED.fit.parameters, "tracking"))
    assert plan.kind == "tracking"
    assert plan.volts(STEP_S)["voltage"].size * STEP_S == pytest.approx(2.0)
    assert plan.expected.highest_pa["end"] > 3e5


# ---- what pieces tell -------------------------------------------------------------------------


def made_up(rng: np.random.Generator, pieces: int, m: int = 200) -> tuple[np.ndarray, Information]:
    """Columns of two hypotheses (with one and two numbers of their own) and of two parameters."""
    columns = rng.normal(size=(pieces, m, 7))
    columns[..., 1] += 0.5 * columns[..., 0]
    grams = np.einsum("smi,smj->sij", columns, columns)
    grams = np.stack([grams, grams], axis=1)  # what is left is noise
    layout = Columns(change=[0, 2], own=[[1], [3, 4]], parameters=[5, 6])
    return columns, Information(layout, grams, [], np.ones(2), np.eye(2))


def test_distance_is_what_a_fit_leaves():
    """Against least squares on the columns themselves, the parameters with their priors."""
    columns, told = made_up(np.random.default_rng(3), 4)
    flat = columns.reshape(-1, 7)
    for true, other, own in ((0, 2, [3, 4]), (2, 0, [1])):
        free = flat[:, [*own, 5, 6]]
        prior = np.zeros((2, len(own) + 2))
        prior[:, len(own) :] = np.eye(2)
        a = np.concatenate([free, prior])
        b = np.concatenate([flat[:, true] - flat[:, other], np.zeros(2)])
        left = b - a @ np.linalg.lstsq(a, b, rcond=None)[0]
        gram = told.grams.sum(axis=0)
        whole = told.residual(gram, true // 2, other // 2)
        found = np.sqrt(whole @ gram[0] @ whole)
        # what the priors take up is no part of what is left of the readings
        left = left[: flat.shape[0]]
        assert found == pytest.approx(np.linalg.norm(left), rel=1e-6)


def test_what_is_doubtful_lowers_a_lead_and_widens_errors():
    """As much as it goes along with what sets two apart, or with a parameter."""
    columns, told = made_up(np.random.default_rng(8), 2)
    flat = columns.reshape(-1, 7)
    gram = np.stack([flat.T @ flat] * 2)
    doubt = 3.0 * (flat[:, 0] - flat[:, 2]) + 2.0 * flat[:, 5]
    wide = np.concatenate([flat, doubt[:, None]], axis=1)
    layout = dataclasses.replace(told.columns, doubtful=[7])
    doubtful = dataclasses.replace(told, columns=layout)
    widened = np.stack([wide.T @ wide] * 2)
    assert doubtful.lead(widened, 0, 1) < 0.1 * told.lead(gram, 0, 1)
    before, after = told.covariance(gram), doubtful.covariance(widened)
    # generalised least squares, an unknown amount of the doubtful column in what is measured
    j = flat[:, 5:]
    weight = np.linalg.inv(np.eye(doubt.size) + np.outer(doubt, doubt))
    np.testing.assert_allclose(after, np.linalg.inv(j.T @ weight @ j + np.eye(2)), rtol=1e-6)
    assert after[0, 0] > 1.15 * before[0, 0]


def test_what_lasts_makes_fits_and_leads_scatter():
    """Against draws: noise of which a part stays the same through a block, and what a fit makes."""
    rng = np.random.default_rng(21)
    stretches, per_block, blocks, taps = 6, 10, 4, 2
    m = per_block * blocks * taps
    columns = rng.normal(size=(stretches, m, 2)) + 1.0
    share = np.array([0.5, 0.0])
    block = np.repeat(np.arange(stretches * blocks), per_block * taps).reshape(stretches, m)
    scatter = _scatter(columns, share, block).sum(axis=0)
    made = []
    for _ in range(4000):
        left = rng.normal(size=(stretches, m // taps, taps)) * np.sqrt(1.0 - share)
        slow = rng.normal(size=(stretches, blocks, 1, taps)) * np.sqrt(share)
        left += np.broadcast_to(slow, (stretches, blocks, per_block, taps)).reshape(left.shape)
        made.append(np.einsum("smc,sm->c", columns, left.reshape(stretches, m)))
    np.testing.assert_allclose(np.cov(np.array(made).T), scatter, rtol=0.1)
    flat = columns.reshape(-1, 2)
    assert scatter[0, 0] > 1.5 * (flat.T @ flat)[0, 0]
    told = Information(Columns([], [], [0, 1]), np.zeros((1, 2, 2, 2)), [], np.ones(2), np.eye(2))
    wide = told.covariance(np.stack([flat.T @ flat, scatter]))
    a = np.linalg.inv(flat.T @ flat + np.eye(2))
    np.testing.assert_allclose(wide, a @ (scatter + np.eye(2)) @ a)


def test_what_a_calibration_left_beyond_noise_lasts():
    assert lasting_share(LAB) == {}
    left, noise = {"end": 200.0, "valve_out": 50.0}, {"end": 100.0, "valve_out": 60.0}
    calibration = Calibration(recording="a", rmse_pa=left, noise_floor_pa=noise)
    assert lasting_share(LAB.model_copy(update={"calibration": calibration})) == {"end": 0.75}


def test_covariance_is_that_of_a_fit():
    columns, told = made_up(np.random.default_rng(5), 3)
    j = columns.reshape(-1, 7)[:, 5:]
    rng = np.random.default_rng(0)
    inverse = np.linalg.inv(j.T @ j + np.eye(2))
    drawn = [
        inverse @ (j.T @ (j @ (x := rng.normal(size=2)) + rng.normal(size=j.shape[0]))) - x
        for _ in range(4000)
    ]
    found = told.covariance(told.grams.sum(axis=0))
    np.testing.assert_allclose(np.cov(np.array(drawn).T), found, rtol=0.1, atol=2e-5)


def test_errors_promised_are_those_that_leaving_stretches_out_finds():
    """Against fits of linear models to draws, few stretches telling much alone."""
    columns, _ = made_up(np.random.default_rng(9), 5, 8)
    j = columns[:, :, 5:].copy()
    j[1:, :, 1] *= 0.05  # one stretch alone tells of the second number
    grams = np.einsum("smi,smj->sij", j, j)
    alone = Information(
        Columns([], [], [0, 1]), np.stack([grams, grams], axis=1), [], np.ones(2), np.eye(2)
    )
    whole = grams.sum(axis=0) + np.eye(2)
    inverse = np.linalg.inv(whole)
    rng, moved = np.random.default_rng(2), []
    for _ in range(4000):
        y = j @ rng.normal(size=2) + rng.normal(size=j.shape[:2])
        r = y - j @ (inverse @ np.einsum("smp,sm->p", j, y))
        moves = left_out_moves(whole, grams, np.einsum("smp,sm->sp", j, r))
        moved.append(0.8 * np.sum(moves**2, axis=0) + np.diag(inverse @ inverse))
    found = np.sqrt(np.mean(moved, axis=0))
    assert found[1] > 1.2 * np.sqrt(inverse[1, 1])
    np.testing.assert_allclose(alone.found(), found, rtol=0.05)


def test_the_choice_is_the_best_of_all():
    _, told = made_up(np.random.default_rng(11), 6, 8)
    best = max(
        told.log_determinant(told.grams[list(which)].sum(axis=0))
        for which in itertools.combinations_with_replacement(range(6), 3)
    )
    chosen = choose(told.grams, 3, range(6), told.log_determinant)
    assert told.log_determinant(told.grams[chosen].sum(axis=0)) >= best - 0.02 * abs(best)
    assert set(choose(told.grams, 3, [1, 4], told.log_determinant)) <= {1, 4}


# ---- plans ------------------------------------------------------------------------------------


@pytest.fixture
def few_pieces(monkeypatch):
    """A third of the pieces to choose from and a quarter of the plans tried.

    Runs of the model, one per plan that is tried, take nearly all the time of a design.
    """
    monkeypatch.setattr(designing, "POOL", 40)
    monkeypatch.setattr(designing, "MOST_TRIES", 10)


@pytest.mark.long
def test_a_chosen_plan_tells_more_than_a_random_one_and_keeps_to_its_limits(tmp_path, few_pieces):
    limits = limits_of(FITTED, highest_pa=5.5e5, air_kg=2e-3)
    pair = [
        with_effect("leak", "tube", area_m2=2e-9, position_m=1.4),
        with_effect("spool_leakage", "valve.exhaust", fraction=2e-3),
    ]
    plans = [
        design(FITTED, Asked(1.6, limits, pair, [], kind, rate_hz=100.0, seed=2))
        for kind in (None, "steps")
    ]
    leads = [plan.expected.separations[0].standard_errors for plan in plans]
    assert leads[0] > 3.0 * leads[1]
    for plan in plans:
        expected = plan.expected
        assert expected.highest_pa["end"] <= 5.5e5
        assert 0.0 < expected.air_kg <= 2e-3
        assert expected.fastest_pa_s["end"] > 0.0
    assert re.match(
        r"Expected: highest pressure [1-5]\.\d\d bar at end, fastest change \d+ bar/s at end, air"
        r" 0\.\d+ g; 1\.6 s\.$",
        foreseen_words(plans[0]),
    )
    write_json(tmp_path / "plan.json", plans[0])
    again = load_plan(tmp_path / "plan.json")
    assert again == plans[0]
    check_plan(again, FITTED)
    # it is what was foreseen: played, it gives the same pressures
    seen = foresee(FITTED, again.volts(STEP_S), 100.0)
    assert seen.recording.pressures["end"].values.max() == pytest.approx(
        again.expected.highest_pa["end"], rel=1e-3
    )


@pytest.mark.long
def test_what_no_experiment_can_tell_is_said_before():
    """With one tap, a valve that acts late and a clock that is late are one and the same.

    Both are told from a leak all the same.
    """
    three = [
        with_effect("valve_delay", "valve", delay_s=3e-3),
        with_effect("clock_offset", "end", offset_s=3e-3),
        with_effect("leak", "tube", area_m2=2e-8, position_m=1.4),
    ]
    plan = design(FITTED, Asked(1.2, limits_of(FITTED), three, [], rate_hz=100.0))
    told = {(s.one.split("@")[0], s.other.split("@")[0]): s for s in plan.expected.separations}
    assert told["valve_delay", "clock_offset"].inseparable
    assert not told["valve_delay", "clock_offset"].told_apart
    for pair in (("valve_delay", "leak"), ("clock_offset", "leak")):
        assert told[pair].told_apart and not told[pair].inseparable
    # valves are shut at first, so that nothing has to be guessed of the beginning
    volts = plan.volts(STEP_S)["voltage"]
    assert np.all(volts[: round(REST_S / STEP_S)] == 5.0)
    assert volts.size * STEP_S == pytest.approx(1.2, abs=0.02)
    (words,) = plan.expected.words
    assert words.startswith(
        "No experiment within these limits can tell valve_delay@valve from clock_offset@end"
    )


SOME = (
    "reservoirs.supply.pressure_pa",
    "valves.valve.ports.supply.conductance_m3_s_pa",
    "valves.valve.ports.exhaust.conductance_m3_s_pa",
    "valves.valve.spool.bandwidth_hz",
    "pipes.tube.area_m2",
    "pipes.tube.wall.turbulent",
)


BARE = FITTED.model_copy(update={"fit": FITTED.fit.model_copy(update={"parameters": []})})


def some() -> list[FitParameter]:
    found = [p for p in parameters_to_learn(BARE) if p.path in SOME]
    assert len(found) == len(SOME)
    return found


@pytest.mark.long
def test_promises_hold_for_rigs_like_the_one_that_is_known():
    """What a plan tells of rigs that it was not made by, beside what it promises."""
    listed = some()
    asked = Asked(2.0, limits_of(BARE), [], listed, rate_hz=100.0, seed=1)
    plan = design(BARE, asked)
    promised = np.array([plan.expected.std_errors[p.path] for p in listed], dtype=float)
    ratios = []
    rng = np.random.default_rng(100)
    for one in possible_rigs(with_known_noise(as_fitted(BARE)), listed, {}, 6, rng):
        there = dataclasses.replace(asked, parameters=one.parameters)
        told = promise_of(one.rig, there, plan.volts(STEP_S))
        ratios.append(told.errors(listed) / promised)
    assert 1.0 / 1.5 < np.median(ratios) < 1.5
    assert np.quantile(ratios, 0.1) > 0.3 and np.quantile(ratios, 0.9) < 3.0


@pytest.mark.long
def test_limits_that_hold_for_the_rig_as_it_is_known_and_not_for_others_like_it():
    listed = [p for p in some() if p.path == SOME[0]]
    (supply,) = listed
    assert supply.std is not None
    highest = BARE.reservoirs["supply"].pressure_pa + 0.5 * supply.std
    limits = limits_of(BARE, highest_pa=highest)
    plan = design(BARE, Asked(2.0, limits, [], listed, "steps", rate_hz=100.0))
    (words,) = [w for w in plan.expected.words if w.startswith("In ")]
    assert re.match(r"In [1-5] of 5 rigs as this one may be by what is known of it", words)
    assert plan.expected.highest_pa["end"] > highest
    (least, greatest) = plan.expected.std_errors_range[SOME[0]]
    assert 0.0 < least <= (plan.expected.std_errors[SOME[0]] or 0.0) <= greatest


def test_promises_are_of_the_same_points_of_curves():
    expected = Expected(
        highest_pa={}, lowest_pa={}, fastest_pa_s={}, air_kg=None,
        std_errors={"v.delay_s": 1e-4, "v.bad": None, "a.fraction.0": 0.1, "a.fraction.1": 0.2,
                    "b.fraction.0": 0.3},
    )  # fmt: skip
    limits = Bounds(low_v={}, high_v={}, slew_v_s=1.0, highest_pa=1.0, lowest_pa=0.0, joints={},
                    air_kg=1.0)  # fmt: skip
    plan = Plan(
        pneu_version="0", rig="r", kind="parameters", seconds=1.0, seed=0, commands={},
        limits=limits, expected=expected,
    )  # fmt: skip
    fitted = ["v.delay_s", "v.bad", "v.new", "a.fraction.0", "a.fraction.1"]
    fitted += ["b.fraction.0", "b.fraction.1"]  # the fit gave this curve a point more
    found = promised_errors(plan, fitted)
    assert found == {"v.delay_s": 1e-4, "a.fraction.0": 0.1, "a.fraction.1": 0.2}


@pytest.mark.long
def test_limits_that_nothing_keeps_to_are_told_with_what_would_be():
    with pytest.raises(InputError, match="nothing that was drawn keeps to them; pressures would"):
        design(
            FITTED,
            Asked(2.0, limits_of(FITTED, lowest_pa=2e5), [], FITTED.fit.parameters, rate_hz=50.0),
        )


BAD = (
    ("no json", "{", "is no JSON"),
    ("other", '{"schema": "pneu.learned/1"}', "schema: found 'pneu.learned/1', known are"),
    ("list", "[1]", "schema: found None, known are"),
)


@pytest.mark.parametrize(("name", "text", "words"), BAD, ids=[one[0] for one in BAD])
def test_files_that_are_no_plan(tmp_path, name, text, words):
    path = tmp_path / "plan.json"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        load_plan(path)


HOSTILE = (
    ({"time_s": [0.0, 1.0], "volts": [5.0]}, "found 2 times and 1 volts"),
    ({"time_s": [0.0, 0.0], "volts": [5.0, 6.0]}, "to begin with 0 and to rise"),
    ({"time_s": [1.0], "volts": [5.0]}, "to begin with 0 and to rise"),
    ({"time_s": [0.0], "volts": [50.0]}, "found 50 to 50 V, its limits are 0 to 10"),
    ({"time_s": [], "volts": []}, "found 0 times and 0 volts"),
)


@pytest.fixture(scope="module")
def plan():
    """A plan of random steps, promised by one other rig instead of five."""
    asked = Asked(1.0, limits_of(FITTED), [], FITTED.fit.parameters, "steps", rate_hz=50.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(designing, "PROMISED", 1)
        return design(FITTED, asked)


@pytest.mark.parametrize(("commands", "words"), HOSTILE)
def test_hostile_plans_are_refused(tmp_path, plan, commands, words):
    hostile = plan.as_dict()
    hostile["commands"]["voltage"] = commands
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(hostile))
    with pytest.raises(InputError, match=words):
        load_plan(path)


def test_a_plan_for_another_rig(plan):
    other = load_rig(ROOT / "rigs" / "kokoro.yaml")
    with pytest.raises(InputError, match="plan: is for rig 'lab' with commands voltage; this is"):
        check_plan(plan, other)
