# SPDX-License-Identifier: Apache-2.0
"""Verdicts from residuals and refits that are built directly: each threshold just below and above.

The numbers are those of the documentation, not of the thresholds' own fields, so that a changed
threshold shows as well as a comparison the wrong way round.
"""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.verdict_cases import (
    HORIZON,
    HOUSE,
    NOISE,
    STRETCHES,
    Case,
    E,
    calibrated,
    leading,
    problem_of,
    rig,
)

from pneu_sim.effects import find_effect
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import AttachedEffect, Calibration, FitParameter, Rig
from pneu_sysid import diagnose as diagnose_module
from pneu_sysid.candidates import Score, to_refit
from pneu_sysid.contacts.candidates import SceneScore, Scores
from pneu_sysid.contacts.diagnose import Finalist, _tie
from pneu_sysid.contacts.diagnose import _verdict as scene_verdict
from pneu_sysid.contacts.effects import find_scene_effect
from pneu_sysid.contacts.estimate import Parameter
from pneu_sysid.dependence import dependences, seldom
from pneu_sysid.diagnose import (
    _alike_but_scored,
    _believed,
    _is_answer,
    _judge,
    _nearly_as_good,
    result_of_diagnosis,
)
from pneu_sysid.evidence import lead
from pneu_sysid.learn import _worth_adding
from pneu_sysid.problem import Problem
from pneu_sysid.records import Recording, Signal
from pneu_sysid.seals.estimate import Estimate
from pneu_sysid.seals.identify import Errors
from pneu_sysid.seals.identify import _verdict as seal_verdict
from pneu_sysid.seals.laws import Term
from pneu_sysid.shortfall import shortfall_of
from pneu_sysid.sites import Site
from pneu_sysid.standing import against_noise, since_calibration, standing_of
from pneu_sysid.thresholds import Thresholds
from pneu_sysid.uncertainty import Known, pairs_above, warnings_of

__all__ = ["rig"]  # a fixture


# ---- Which candidates are accepted


@pytest.mark.parametrize(
    ("below", "above"),
    [
        ({"t": 3.0 - E}, {"t": 3.0 + E}),
        ({"held_out": 0.25 - E}, {"held_out": 0.25 + E}),
        ({"explained": 0.25 - E}, {"explained": 0.25 + E}),
    ],
)
def test_a_candidate_is_accepted_from_each_threshold_on(
    rig: Rig, below: dict[str, float], above: dict[str, float]
) -> None:
    case = Case(rig, 9.0)
    for more, accepted in ((below, False), (above, True)):
        one = replace(case.refit(held=0.6), **more)  # type: ignore[arg-type]
        assert (
            _believed(case.bench, one, case.base, case.bench.held_sum(case.base), 0.0) == accepted
        )


@pytest.mark.parametrize("floor", [1.0, 1.7])
def test_a_candidate_explains_more_than_chance_and_a_calibrations_rest(
    rig: Rig, floor: float
) -> None:
    """The noise once, and three tenths of what the calibration left beyond it."""
    case = Case(calibrated(rig, floor), 3.5)
    before = case.count * 3.5**2
    assert case.bench.held_sum(case.base) == pytest.approx(before)
    assert case.bench.floor == pytest.approx(case.count * floor**2)
    least = case.count * (1.0 + 0.3 * (floor**2 - 1.0)) / before
    for held in (least - E, least + E):
        one = replace(case.refit(held=0.6), held_out=held, explained=0.6)
        # at this size that is less than what is worth it, which is therefore lowered
        bench = replace(case.bench, thresholds=Thresholds(worth=0.0))
        assert _believed(bench, one, case.base, before, 0.0) == (held > least)


def test_a_companion_explains_more_than_a_fiftieth_of_an_effects_change(rig: Rig) -> None:
    case = Case(rig, 9.0)
    before = case.bench.held_sum(case.base)
    one = case.refit(held=0.6)
    for taken in (0.6 * before / 0.02**2 * (1 - E), 0.6 * before / 0.02**2 * (1 + E)):
        wanted = taken < 0.6 * before / 0.02**2
        assert _believed(case.bench, one, case.base, before, taken) == wanted


@pytest.mark.parametrize(("wanted", "accepted"), [(2.999, False), (3.001, True)])
def test_a_candidate_leads_the_rig_as_it_is(rig: Rig, wanted: float, accepted: bool) -> None:
    case = Case(rig, 0.9)
    bench = replace(case.bench, thresholds=Thresholds(worth=0.0, chance=0.0))
    one = case.refit(residual=leading(case.base, wanted))
    assert lead(one.residual, case.base, bench.blocks) == pytest.approx(wanted, abs=2e-4)
    assert _believed(bench, one, case.base, 1e9, 0.0) == accepted


# ---- Verdicts


@pytest.mark.parametrize("floor", [1.0, 1.6])
@pytest.mark.parametrize(("share", "verdict"), [(1 - E, "nothing_missing"), (1 + E, "unknown")])
def test_something_is_missing_from_twice_the_floor_on(
    rig: Rig, floor: float, share: float, verdict: str
) -> None:
    """On what is held out, and over all."""
    case = Case(calibrated(rig, floor), 2.0 * floor * math.sqrt(share))
    assert case.judged().verdict == verdict
    least = 0.1
    whole = math.sqrt((9.0 * 4.0 * floor**2 * share - 3.0 * least**2) / 6.0)
    case = Case(calibrated(rig, floor), least, whole)
    assert case.judged().verdict == verdict


def test_a_rig_that_explains_its_recording(rig: Rig) -> None:
    found = Case(rig, 1.1).judged()
    assert found.verdict == "nothing_missing" and not found.finalists
    words = "Nothing is missing: the model explains the recording to the sensor noise."
    assert found.sentence == words


def test_a_rig_that_is_as_good_as_where_it_was_calibrated(rig: Rig) -> None:
    found = Case(calibrated(rig, 1.6), 1.7).judged()
    assert found.verdict == "nothing_missing"
    assert found.sentence.startswith("Nothing changed since the calibration: the model explains")
    # on its own recording, or without a calibration, that cannot be said
    for own in (calibrated(rig, 1.6, "run"), rig):
        found = Case(own, 1.7).judged()
        assert found.sentence == (
            "No effect is missing: of the 1.70 times the noise that the model leaves, 1.70 would be"
            " left if its base parameters were fitted here."
        )


@pytest.mark.parametrize(("left", "verdict"), [(4.0 - 1e-4, "effect"), (4.0 + 1e-4, "unknown")])
def test_an_answer_brings_the_error_to_twice_the_floor(rig: Rig, left: float, verdict: str) -> None:
    floor = 1.5
    case = Case(calibrated(rig, floor), math.sqrt(20.0) * floor)
    found = case.judged(case.refit(held=1.0 - left / 20.0))
    assert found.verdict == verdict
    assert found.excess == pytest.approx(20.0)
    assert found.left_over == pytest.approx(left)
    if verdict == "effect":
        assert (
            found.sentence.startswith("Missing: ")
            and "more is missing besides" not in found.sentence
        )
        assert "explains 80 % of the held-out squared residual" in found.sentence
        assert "cannot tell" not in found.sentence
    else:
        assert "the nearest, leak@tube:1.50, explains only 80 %" in found.sentence


@pytest.mark.parametrize("left", [0.06**2 * (1 - 1e-3), 0.06**2 * (1 + 1e-3)])
def test_a_large_error_need_only_fall_to_a_share_of_itself(rig: Rig, left: float) -> None:
    case = Case(rig, 200.0)
    found = case.judged(case.refit(held=1.0 - left))
    assert found.verdict == "effect"  # it explains nearly all of it
    assert ("more is missing besides" in found.sentence) == (left > 0.06**2)


@pytest.mark.parametrize(("held", "verdict"), [(0.9 - E, "unknown"), (0.9 + E, "effect")])
def test_what_explains_nine_tenths_is_named_with_a_reservation(
    rig: Rig, held: float, verdict: str
) -> None:
    case = Case(rig, 20.0)
    found = case.judged(case.refit(held=held))
    assert found.verdict == verdict
    if verdict == "effect":
        assert found.sentence.endswith("; more is missing besides.")


@pytest.mark.parametrize(("share", "verdict"), [(0.35 - 1e-4, "unknown"), (0.35 + 1e-4, "effect")])
def test_a_second_effect_that_explains_a_third_of_the_rest(
    rig: Rig, share: float, verdict: str
) -> None:
    case = Case(rig, 20.0)
    top = case.refit(held=0.7)
    rest = top.residual.ravel()
    above = float(rest @ rest) - rest.size
    # what is projected on has this part of the rest's square
    part = share * above / float(rest @ rest)
    other = np.random.default_rng(1).normal(size=rest.size)
    other -= rest * float(other @ rest) / float(rest @ rest)
    way = math.sqrt(part) * rest / np.linalg.norm(rest) + math.sqrt(1.0 - part) * (
        other / np.linalg.norm(other)
    )
    projected = 3.7 * way.reshape(top.residual.shape)
    lag = Score(Site(find_effect("sensor_lag"), "end", {}), 0.01, 0.4, 5.0, projected, projected)
    assert case.judged(top, scores=[lag]).verdict == verdict
    # the same effect elsewhere in its own part is no second one
    own = replace(lag, site=top.site)
    assert case.judged(top, scores=[own]).verdict == "unknown"


@pytest.mark.parametrize(("wanted", "verdict"), [(2.999, "ambiguous"), (3.001, "effect")])
def test_candidates_are_tied_up_to_three_standard_errors(
    rig: Rig, wanted: float, verdict: str
) -> None:
    case = Case(rig, 6.0)
    worse = case.refit("sensor_lag", "end", residual=case.base * 0.2, held=0.96)
    top = case.refit(residual=leading(worse.residual, wanted), held=0.965)
    third = case.refit("sensor_gain", "end", held=0.3)
    found = case.judged(third, worse, top)
    assert [r.site.label for r in found.finalists] == [
        "leak@tube:1.50",
        "sensor_lag@end",
        "sensor_gain@end",
    ]
    assert found.verdict == verdict and found.believed == 3
    assert found.alike(0) == (["sensor_lag@end"] if verdict == "ambiguous" else [])
    said = "cannot tell it from sensor_lag@end" in found.sentence
    assert said == (verdict == "ambiguous")
    given = result_of_diagnosis("rig", found, ["odd"])
    assert given.candidates[0].indistinguishable_from == found.alike(0)
    # what longer cells get wrong, where it goes along with what sets them apart, may favour either
    grid = (worse.residual - top.residual).reshape(found.problem.measured.shape) * NOISE
    doubtful = replace(case.bench, grid_pa=grid)
    again = _judge(doubtful, case.base, [third, worse, top], [], case.bench.readings, 0.0)
    assert again.verdict == "ambiguous"


def test_every_cell_of_a_candidates_result_is_its_own(rig: Rig) -> None:
    case = Case(rig, 6.0)
    far = replace(
        case.refit(held=0.93), explained=0.81, score_explained=0.77, t=12.5, strength=-3e-8,
        std_error=2.4e-9, site=Site(find_effect("leak"), "tube", {"position_m": 1.25}),
        position_error_m=0.31, places_m=(0.4, 2.2),
    )  # fmt: skip
    lag = Score(Site(find_effect("sensor_lag"), "end", {}), -0.03, 0.41, 6.0, case.base, case.base)
    found = case.judged(far, scores=[lag])
    first, second = result_of_diagnosis("name", found, ["odd"]).candidates
    assert (first.effect, first.place, first.position_m) == ("leak", "tube", 1.25)
    assert (first.position_error_m, first.places_m) == (0.31, [0.4, 2.2])
    assert (first.strength, first.std_error, first.unit) == (-3e-8, 2.4e-9, "m^2, effective")
    assert (first.explained_fraction, first.refit_fraction, first.held_out_gain) == (
        0.77,
        0.81,
        0.93,
    )
    assert first.significance == 12.5 and first.tested
    assert (second.effect, second.place, second.tested) == ("sensor_lag", "end", False)
    assert (second.strength, second.unit, second.explained_fraction) == (-0.03, "s", 0.41)
    assert second.std_error == pytest.approx(0.03 / 6.0) and second.significance == 6.0
    given = result_of_diagnosis("name", found, ["odd"])
    assert given.rmse_pa == pytest.approx(
        {t: 6.0 * n for t, n in zip(rig.taps, NOISE, strict=True)}
    )
    assert given.times_noise == pytest.approx(6.0)
    assert given.findings == ["odd"] and given.rigs == ["name"]


@pytest.mark.parametrize("apart", [2.9, 3.1])
def test_a_special_case_is_named_unless_the_general_leads(rig: Rig, apart: float) -> None:
    """A relief valve that never shuts is a leak."""
    assert find_effect("relief_valve").contains == "leak"
    case = Case(rig, 6.0)
    leak = case.refit(residual=case.base * 0.2, held=0.96)
    other = leading(leak.residual, apart)
    relief = case.refit("relief_valve", "tube", residual=other, held=0.97)
    found = case.judged(relief, leak)
    assert found.finalists[0].site.effect.name == ("leak" if apart < 3.0 else "relief_valve")
    assert found.believed == (1 if apart < 3.0 else 2)


def test_of_equal_candidates_the_one_with_fewest_numbers_leads(rig: Rig) -> None:
    """By no more than one number may take away by chance: ln n of the mean square."""
    case = Case(rig, 6.0)
    count = case.base.size
    for more, first in ((0.99, "leak"), (1.01, "dead_volume")):
        by = 1.0 + more * math.log(count) / count
        better = case.refit("dead_volume", "tube", held=0.96)
        simple = case.refit(residual=better.residual * math.sqrt(by), held=0.96)
        fewer = len(simple.site.effect.fitted(rig, "tube"))
        if fewer == len(better.site.effect.fitted(rig, "tube")):
            fewer -= simple.site.effect.order < better.site.effect.order
        assert (fewer, simple.site.effect.order) < (
            len(better.site.effect.fitted(rig, "tube")), better.site.effect.order,
        )  # fmt: skip
        assert case.judged(better, simple).finalists[0].site.effect.name == first


def test_what_a_calibration_left_open_is_no_change(rig: Rig) -> None:
    robot = load_rig(HOUSE / "rigs" / "kokoro.yaml")
    known = {"breakaway_n": 0.5, "stribeck_m_s": 0.005, "coulomb_n": 0.5, "viscous_n_s_m": 2.0}
    robot.fit.parameters = [
        FitParameter(
            path=f"cylinders.forearm.friction.{name}", lower=0.0, upper=100.0, std_error=error
        )
        for name, error in known.items()
    ]
    robot.calibration = Calibration(recording="before", rmse_pa={}, noise_floor_pa={})
    for force, verdict in ((0.99, "nothing_missing"), (1.01, "effect")):
        attached = AttachedEffect(
            effect="piston_friction", place="forearm", parameters={"force_n": force}
        )
        case = Case(rig, 6.0)
        one = case.refit("piston_friction", "forearm", held=0.96)
        one = replace(one, rig=robot.model_copy(update={"effects": [attached]}))
        found = case.judged(one)
        assert found.verdict == verdict
        assert found.left_open == (verdict == "nothing_missing")
        if found.left_open:
            assert found.believed == 0
            assert "changes no number by more than two standard errors" in found.sentence


def test_what_is_unknown_is_described(rig: Rig) -> None:
    """By what it depends on, and by when it is there, where that is seldom."""
    case = Case(rig, 0.01)
    case.base[4, :200] = 60.0
    found = case.judged()
    assert found.verdict == "unknown"
    assert found.sentence.startswith("Something is missing that the catalogue does not hold")
    assert "the nearest" not in found.sentence
    assert "most of it is at 1.6 to 2.0 s of run" in found.sentence
    given = result_of_diagnosis("rig", found, [])
    assert [d.gain for d in given.depends_on] == [gain for _, _, gain in found.depends_on]


def moving(rig: Rig, stretches: int) -> Problem:
    """A problem with an encoder that is compared, and one of which hardly anything was read."""
    problem = problem_of(rig)
    problem.taps[3] = "elbow"
    time = np.arange(0.0, 4.0, 0.005)
    signals = {
        "elbow": Signal(time, np.sin(2.0 * np.pi * 0.9 * time)),
        "wrist": Signal(np.array([0.1]), np.array([0.5])),
    }
    problem.recordings = [Recording("run", {}, {}, encoders=signals)]
    for name in ("time_s", "measured", "of", "span_s"):
        setattr(problem, name, getattr(problem, name)[:stretches])
    return problem


def test_what_a_residual_of_motion_depends_on(rig: Rig) -> None:
    """Of its own sensor's motion, not of its reading as if that were a pressure."""
    problem = moving(rig, STRETCHES)
    rng = np.random.default_rng(3)
    r = 0.5 * rng.normal(size=problem.measured.shape)
    direction = np.sign(np.cos(2.0 * np.pi * 0.9 * problem.time_s[:, :, 3]))
    r[:, :, 3] += 4.0 * direction
    found = dependences(problem, r.reshape(STRETCHES, -1), Thresholds())
    assert (found[0][0], found[0][1]) in (
        ("direction of elbow", "elbow"), ("speed of elbow", "elbow")
    )  # fmt: skip
    assert found[0][2] > 0.9 and {tap for _, tap, _ in found} == {"elbow"}
    named = {name for name, _, _ in found}
    assert "direction of elbow" in named and not any("pressure" in name for name in named)
    assert not any("wrist" in name for name in named)


@pytest.mark.parametrize(("stretches", "named"), [(1, False), (2, True), (5, True)])
def test_a_dependence_is_tried_on_other_stretches(rig: Rig, stretches: int, named: bool) -> None:
    """On one alone nothing can be tried, so nothing is said."""
    problem = moving(rig, stretches)
    r = np.zeros_like(problem.measured)
    level = np.where(np.arange(HORIZON) % 2, 9.0, -3.0)
    problem.measured[:, :, 1] = 1e5 + 1e4 * (level > 0.0)
    r[:, :, 1] = level
    found = dependences(problem, r.reshape(stretches, -1), Thresholds())
    assert (("pressure", list(rig.taps)[1], pytest.approx(1.0)) in found) == named
    if not named:
        assert found == []


def test_of_readings_that_are_hardly_any_no_rate_is_told(rig: Rig) -> None:
    problem = problem_of(rig)
    for name in ("time_s", "measured"):
        setattr(problem, name, getattr(problem, name)[:, :2])
    r = np.full(problem.measured.shape, 9.0)
    found = dependences(problem, r.reshape(STRETCHES, -1), Thresholds())
    names = {name for name, _, _ in found}
    assert "pressure" in names and "rate of pressure" not in names


@pytest.mark.parametrize(("blocks", "named"), [(6, True), (7, False)])
def test_what_is_in_fifteen_hundredths_of_the_time_is_seldom(
    rig: Rig, blocks: int, named: bool
) -> None:
    """Of 45 blocks six are less than fifteen hundredths, seven are more."""
    case = Case(rig, 1e-3)
    r = case.base.copy()
    r.reshape(45, -1)[3 : 3 + blocks] = 5.0
    # four fifths are needed of it: all of the blocks but a fifth, and one more
    found = seldom(case.problem, r, case.bench.blocks, replace(Thresholds(), most_of_it=0.9999))
    assert bool(found) == named
    if named:
        ((name, begin, end),) = found
        assert name == "run"
        assert (begin, end) == (pytest.approx(0.24), pytest.approx(0.24 + 8 * blocks * 0.01 - 0.01))


@pytest.mark.parametrize(("share", "count"), [(0.8 + 1e-6, 4), (0.8 - 1e-6, 5)])
def test_most_of_a_residual_is_four_fifths_of_its_square(
    rig: Rig, share: float, count: int
) -> None:
    """Of five blocks of which four hold a share, as many are named as are needed."""
    case = Case(rig, 1e-9)
    r = case.base.copy().reshape(45, -1)
    for k in range(4):
        r[9 * k] = math.sqrt(share / 4.0)
    r[40] = r[42] = math.sqrt(0.5 * (1.0 - share))
    found = seldom(case.problem, r.reshape(case.base.shape), case.bench.blocks, Thresholds())
    assert len(found) == count


def test_the_search_ends_with_an_answer(rig: Rig) -> None:
    """Which leaves no more than it may, most of the error gone, its strength not at its end."""
    case = Case(calibrated(rig, 1.5), 1.5 * math.sqrt(20.0))
    for held, answers in ((0.9 - E, False), (0.9 + E, True)):
        assert _is_answer(case.judged(case.refit(held=held)), case.bench) == answers
    # or, with less gone, a rest with which nothing more would be looked for
    near = Case(calibrated(rig, 1.5), 1.5 * 2.1)
    for left, answers in ((1.1 - E, True), (1.1 + E, False)):
        one = near.refit(held=1.0 - left / 2.1**2)
        assert _is_answer(near.judged(one), near.bench) == answers
    leak = find_effect("leak").strength
    bounds = find_effect("leak").limits(leak, rig, "tube")
    at_bound = case.refit(held=0.95, strength=max(bounds))
    assert at_bound.at_bound and not _is_answer(case.judged(at_bound), case.bench)
    assert _is_answer(Case(rig, 1.0).judged(), Case(rig, 1.0).bench)
    assert not _is_answer(Case(rig, 9.0).judged(), Case(rig, 9.0).bench)


def test_what_is_nearly_as_good_is_settled(rig: Rig) -> None:
    case = Case(rig, 6.0)
    top = case.refit(held=0.96)
    names = ("sensor_lag", "sensor_gain", "sensor_offset")
    most = diagnose_module.NEARLY
    near = case.refit(names[0], "end", residual=top.residual * math.sqrt(most - 1e-6))
    far = case.refit(names[1], "end", residual=top.residual * math.sqrt(most + 1e-6))
    found = case.judged(far, near, top)
    assert [r.site.label for r in _nearly_as_good(found)] == ["leak@tube:1.50", "sensor_lag@end"]
    assert _nearly_as_good(case.judged(far, top)) == []
    assert _nearly_as_good(Case(rig, 1.0).judged()) == []


@pytest.mark.parametrize(
    ("cosine", "explained", "named"),
    [(0.951, 0.2, True), (0.949, 0.2, False), (-0.951, 0.2, True), (0.99, 0.139, False),
     (0.99, 0.141, True)],
)  # fmt: skip
def test_one_that_looks_alike_is_refitted_too(
    rig: Rig, cosine: float, explained: float, named: bool
) -> None:
    case = Case(rig, 6.0)
    rng = np.random.default_rng(6)
    a, b = rng.normal(size=(2, *case.base.shape))
    a /= np.linalg.norm(a)
    b -= a * float(np.sum(a * b))
    b /= np.linalg.norm(b)
    other = cosine * a + math.sqrt(1.0 - cosine**2) * b
    best = Score(Site(find_effect("leak"), "tube", {}), 1e-8, 0.4, 9.0, a, a)
    alike = Score(Site(find_effect("sensor_lag"), "end", {}), 0.01, explained, 9.0, other, other)
    top = case.refit(held=0.96)
    found = case.judged(top)
    assert _alike_but_scored(found, [top], [best, alike], Thresholds()) == (
        [alike] if named else []
    )


@pytest.mark.parametrize(
    ("explained", "count"),
    [
        # of the first three any is taken that is worth it; others have a third of the best's score
        ((0.9, 0.126, 0.126, 0.126), 3), ((0.9, 0.3, 0.3, 0.316), 4), ((0.9, 0.3, 0.3, 0.314), 3),
        ((0.126,), 1), ((0.124,), 0), ((0.9, 0.0, 0.8), 1),
    ],
)  # fmt: skip
def test_scores_that_are_worth_a_refit(explained: tuple[float, ...], count: int) -> None:
    scores = []
    for k, share in enumerate(explained):
        way = np.zeros((2, 5))
        way.ravel()[k] = 1.0
        site = Site(find_effect("leak"), f"place_{k}", {})
        scores.append(Score(site, 1e-8, share, 9.0, way, way))
    chosen, others = to_refit(scores, Thresholds())
    assert len(chosen) == count and others == []


@pytest.mark.parametrize(
    ("verdict", "believed", "held", "adds"),
    [
        ("nothing_missing", 1, 0.9, False), ("effect", 0, 0.9, False), ("effect", 1, 0.1, True),
        ("ambiguous", 1, 0.1, True), ("unknown", 1, 0.5 - E, False), ("unknown", 1, 0.5 + E, True),
    ],
)  # fmt: skip
def test_what_is_worth_adding(
    rig: Rig, verdict: Any, believed: int, held: float, adds: bool
) -> None:
    case = Case(rig, 6.0)
    found = case.judged(case.refit(held=0.96))
    one = replace(found.finalists[0], held_out=held)
    found = replace(found, verdict=verdict, believed=believed, finalists=[one])
    assert _worth_adding(found, case.bench) == adds


# ---- How a model stands to recordings


def standing(rig: Rig, sizes: tuple[float, ...]) -> Any:
    """Of three recordings with errors of these sizes."""
    problem = problem_of(rig, tuple(f"run {k}" for k in range(len(sizes))))
    r = np.ones((STRETCHES, HORIZON * NOISE.size)) * np.array(sizes)[problem.of][:, None]
    return standing_of(rig, problem, r, Thresholds())


@pytest.mark.parametrize("floor", [1.0, 1.5])
def test_recordings_that_differ_from_a_calibration(rig: Rig, floor: float) -> None:
    own = calibrated(rig, floor)
    found = standing(own, (floor * 2.0 * (1 - E), floor * 2.0 * (1 + E), 1.9 * floor))
    assert found.changed == ["run 1"]
    np.testing.assert_allclose(found.excess, [4.0, 4.0, 1.9**2], rtol=1e-5)
    # or from the best, which counts as no better than the floor
    for best in (1.0, 0.2):
        less = math.sqrt(3.0 * max(best**2, 1.0))
        sizes = (floor * best, floor * less * (1 - E), floor * less * (1 + E))
        assert standing(own, sizes).changed == ["run 2"]
    np.testing.assert_allclose(found.floor, floor)


@pytest.mark.parametrize(("times", "explains"), [(1.2 - E, True), (1.2 + E, False)])
def test_a_model_explains_to_the_noise(rig: Rig, times: float, explains: bool) -> None:
    found = standing(rig, (times, times, times))
    assert found.explains == explains and found.times_noise == pytest.approx(times)
    words = against_noise(found, Thresholds())
    if explains:
        assert words == "The model explains the measurement to the noise (1.20 times)."
    else:
        assert words.startswith("The model leaves 1.20 times the noise, most at ")


@pytest.mark.parametrize(("floor", "told"), [(1.2 - E, False), (1.2 + E, True), (1.7, True)])
def test_what_a_calibration_left_is_said(rig: Rig, floor: float, told: bool) -> None:
    problem = problem_of(rig)
    r = np.ones((STRETCHES, HORIZON, NOISE.size)) * np.array([1.0, 2.0, 7.0, 3.0, 1.0])
    flat = r.reshape(STRETCHES, -1)
    own = standing_of(calibrated(rig, floor), problem, flat, Thresholds())
    words = against_noise(own, Thresholds())
    assert f"most at {list(rig.taps)[2]} (7.00)" in words
    assert (f"; {floor:.2f} times were left where it was calibrated" in words) == told
    on_its_own = standing_of(calibrated(rig, floor, "run"), problem, flat, Thresholds())
    assert "were left" not in against_noise(on_its_own, Thresholds())
    assert (on_its_own.floor == 1.0).all() and on_its_own.own


def test_sentences_on_a_change_since_the_calibration(rig: Rig) -> None:
    names = ["run 0", "run 1", "run 2"]
    assert "was never calibrated" in since_calibration(standing(rig, (9.0,) * 3), names, True)
    own = standing(calibrated(rig, 1.0, "run 1"), (9.0, 9.0, 9.0))
    assert "calibrated on this very recording" in since_calibration(own, names, True)
    one = standing(calibrated(rig), (1.0, 9.0, 1.0))
    assert since_calibration(one, names, True) == (
        "Something changed in run 1 since the calibration, and nothing in run 0, run 2."
    )
    every = standing(calibrated(rig), (9.0, 9.0, 9.0))
    same = standing(calibrated(rig), (1.0, 1.0, 1.0))
    changed = "Something changed since the calibration."
    assert since_calibration(every, names, False) == changed
    assert since_calibration(same, names, True) == changed
    assert since_calibration(same, names, False) == "Nothing changed since the calibration."


# ---- What a fit cannot tell


def known(**changes: Any) -> Known:
    none = np.zeros(4, dtype=bool)
    values: dict[str, Any] = {
        "std_errors": np.ones(4), "at_bound": none, "beyond": none, "seen": ~none, "held": none,
        "pairs": [], "correlation": np.eye(4), "condition": 10.0,
    }  # fmt: skip
    return Known(**(values | changes))


def test_warnings_of_a_fit() -> None:
    parameters = [FitParameter(path=f"p{k}", lower=0.0, upper=1.0) for k in range(4)]
    assert warnings_of(parameters, known()) == []
    blind = known(
        seen=np.array([True, False, False, True]), held=np.array([False, False, True, False])
    )
    (line,) = warnings_of(parameters, blind)
    assert line.startswith("1 of 4 parameters kept their values") and line.endswith(": p1")
    (line,) = warnings_of(parameters, known(beyond=np.array([False, False, True, False])))
    assert line == "1 at a bound, the truth may lie beyond: p2"
    (line,) = warnings_of(parameters, known(pairs=[(3, 1, -0.99)]))
    assert line == "1 pairs can only be told in combination: p3 with p1"
    assert warnings_of(parameters, known(condition=1e6 * (1 - E))) == []
    assert "ill-conditioned" in warnings_of(parameters, known(condition=1e6 * (1 + E)))[0]
    many = [FitParameter(path=f"q{k}", lower=0.0, upper=1.0) for k in range(6)]
    none = np.zeros(6, dtype=bool)
    (line,) = warnings_of(many, known(seen=none, held=none, beyond=none))
    assert line.endswith(": q0, q1, q2, q3 and 2 more")


def test_pairs_are_listed_from_a_limit_on_the_strongest_first() -> None:
    c = np.eye(4)
    for a, b, value in ((0, 1, 0.9), (0, 3, -0.97), (1, 2, 0.9 - E), (2, 3, -0.9 + E)):
        c[a, b] = c[b, a] = value
    assert pairs_above(c, 0.9) == [(0, 3, -0.97), (0, 1, 0.9)]


def test_a_fit_stops_short_above_twice_the_noise_alone(rig: Rig) -> None:
    problem = problem_of(rig)
    out = SimpleNamespace(readings=np.zeros((1, STRETCHES, HORIZON, NOISE.size)))
    times = dict.fromkeys(rig.taps, 2.0)
    assert shortfall_of(rig, problem, out, times, [], []) is None  # type: ignore[arg-type]


# ---- Scenes


def finalist(name: str, **changes: Any) -> Finalist:
    parameter = Parameter(find_scene_effect(name), "there", 0.0, 1.0)
    values: dict[str, Any] = {
        "score": SceneScore(parameter, 1.0, 0.1, 1.0, 1.0), "fit": None, "strength": -0.21,
        "std_error": 0.03, "held": np.zeros(0), "gain": 0.4, "worth": 0.5, "lead": 9.0,
        "falls": np.linspace(0.3, 0.5, 12), "rise": np.linspace(0.3, 0.5, 12), "alike": [],
    }  # fmt: skip
    return Finalist(**(values | changes))


@pytest.mark.parametrize(
    ("changes", "verdict"),
    [
        ({"worth": 0.02 - E}, "nothing_missing"), ({"worth": 0.02 + E}, "effect"),
        ({"lead": 2.5 - E}, "nothing_missing"), ({"lead": 2.5 + E}, "effect"),
        ({"alike": ["sensor_bias@x"]}, "ambiguous"),
    ],
)  # fmt: skip
def test_verdicts_on_a_scene(changes: dict[str, Any], verdict: str) -> None:
    weak = finalist("joint_damping", lead=0.5)
    found, sentence = scene_verdict([weak, finalist("air_drag", **changes)])
    assert found == verdict
    if verdict == "nothing_missing":
        assert "the best, joint_damping@there, by 40 %, 0.5 standard errors" in sentence
        return
    title, unit = find_scene_effect("air_drag").title, find_scene_effect("air_drag").unit
    assert f"Missing: {title} at there, -0.21 ± 0.03 {unit}" in sentence
    assert ("not to be told from sensor_bias@x" in sentence) == (verdict == "ambiguous")


def test_no_candidate_of_a_scene_is_no_verdict_on_one() -> None:
    verdict, sentence = scene_verdict([])
    assert verdict == "nothing_missing" and "the best" not in sentence


@pytest.mark.parametrize("gain", [0.02 - E, 0.02 + E])
def test_a_sentence_on_a_scene_says_where_it_shows(gain: float) -> None:
    """Over all motion, or in the kind in which it falls most where it falls by little over all."""
    _, sentence = scene_verdict([finalist("air_drag", gain=gain, worth=0.6)])
    assert ("of flights or of contacts" in sentence) == (gain < 0.02)
    assert f"explained by {60 if gain < 0.02 else 2} % better" in sentence


@pytest.mark.parametrize(
    ("changes", "cosine", "shift", "tied"),
    [
        # one that is sure itself is tied unless the best leads by one and a half standard errors
        ({}, 0.0, 1.4, True), ({}, 0.0, 1.6, False),
        # one whose column is the same to these recordings, by two and a half
        ({}, 0.951, 2.4, True), ({}, 0.951, 2.6, False), ({}, -0.951, 2.4, True),
        ({}, 0.949, 2.4, False),
        # one that is not sure is tied where it explains half as much and misses by little
        ({"lead": 1.5 + E}, 0.0, 1.0, True), ({"lead": 1.5 - E}, 0.0, 1.0, False),
        ({"lead": 2.0, "worth": 0.02 - E}, 0.0, 1.0, False),
        ({"lead": 2.0, "gain": 0.2 + E}, 0.0, 1.0, True),
        ({"lead": 2.0, "gain": 0.2 - E}, 0.0, 1.0, False),
    ],
)  # fmt: skip
def test_candidates_of_a_scene_are_tied(
    changes: dict[str, Any], cosine: float, shift: float, tied: bool
) -> None:
    from pneu_sysid.contacts.sureness import trimmed

    scatter = np.array([-1.3, 0.2, 0.9, -0.4, 1.1, -0.8, 0.5, -0.2, 0.7, -0.7, 0.3, -0.3])
    mean, spread = trimmed(scatter)
    way = scatter - mean + shift * spread  # leads by so many standard errors
    best = finalist("air_drag", falls=np.full(12, 2.0), rise=np.full(12, 2.0))
    other = finalist("sensor_scale", falls=2.0 - way, rise=2.0 - way, **changes)
    alike = np.array([[1.0, cosine], [cosine, 1.0]])
    scores = Scores([best.score, other.score], alike, 0.0, None)  # type: ignore[arg-type]
    _tie([best, other], scores, True)
    assert best.alike == (["sensor_scale@there"] if tied else [])
    assert other.alike == []


# ---- Seals


def law(*terms: Term) -> Estimate:
    return Estimate(
        terms, dict.fromkeys(terms, 1.0), dict.fromkeys(terms, 0.1), 0.01, 0.0, 0.0, 0.0, 1.0,
        np.eye(len(terms)),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("terms", "alike", "own", "left", "explained", "verdict"),
    [
        # the rig's own friction is as good as the best up to a twentieth more, or to the noise
        (("constant",), [], 1.05 * 2.0 - E, 2.0, 0.9, "nothing_missing"),
        (("constant",), [], 1.05 * 2.0 + E, 2.0, 0.9, "effect"),
        (("constant",), [], 1.05 * 0.5 - E, 0.3, 0.9, "nothing_missing"),
        (("constant",), [], 1.05 * 0.5 + E, 0.3, 0.9, "effect"),
        # without friction up to twice the noise
        ((), [], None, 1.0 - E, 0.0, "nothing_missing"), ((), [], None, 1.0 + E, 0.0, "unknown"),
        # a law explains half of the squared error at least
        (("constant",), [], None, 2.0, 0.5 - E, "unknown"),
        (("constant",), [], None, 2.0, 0.5 + E, "effect"),
        (("viscous",), [("pressure",)], None, 2.0, 0.9, "ambiguous"),
        (("constant", "viscous"), [("constant", "pressure")], None, 2.0, 0.9, "effect"),
    ],
)  # fmt: skip
def test_verdicts_on_a_seal(
    terms: tuple[Term, ...],
    alike: list[tuple[Term, ...]],
    own: float | None,
    left: float,
    explained: float,
    verdict: str,
) -> None:
    steps = [
        Errors((), 9.0, 8.0, np.zeros((1, 2))),
        Errors(terms, 7.0, left, np.zeros((1, 2))),
    ]
    others = [law(*one) for one in alike]
    assert seal_verdict(law(*terms), others, steps, own, 0.5, explained) == verdict
    # where none is held out, the error of what was fitted decides
    plain = [replace(step, held_out_n=None, rmse_n=step.judged_n) for step in steps]
    assert seal_verdict(law(*terms), others, plain, own, 0.5, explained) == verdict


def test_none_is_looked_for_beside_one_that_was_not_scored(rig: Rig) -> None:
    case = Case(rig, 6.0)
    top = case.refit(held=0.96)
    way = np.ones_like(case.base)
    lag = Score(Site(find_effect("sensor_lag"), "end", {}), 0.01, 0.9, 9.0, way, way)
    assert _alike_but_scored(case.judged(top), [top], [lag], Thresholds()) == []


def test_a_sensor_that_the_calibration_lacked_counts_as_the_noise(rig: Rig) -> None:
    own = calibrated(rig, 1.7)
    assert own.calibration is not None
    middle = list(rig.taps)[2]
    left = {tap: x for tap, x in own.calibration.rmse_pa.items() if tap != middle}
    own = own.model_copy(
        update={"calibration": own.calibration.model_copy(update={"rmse_pa": left})}
    )
    np.testing.assert_allclose(standing(own, (1.0,) * 3).floor, [1.7, 1.7, 1.0, 1.7, 1.7])


def test_a_candidate_of_no_use_is_as_good_as_none(rig: Rig) -> None:
    """Of two that explain as much as nothing: a second that changes nothing helps not either."""
    case = Case(rig, 20.0)
    top = case.refit(held=0.7)
    none = np.zeros_like(case.base)
    blind = Score(Site(find_effect("sensor_lag"), "end", {}), 0.0, 0.0, 0.0, none, none)
    found = case.judged(top, scores=[blind])
    assert found.verdict == "unknown"
    (_, second) = result_of_diagnosis("rig", found, []).candidates
    assert second.std_error is None and second.strength == 0.0
