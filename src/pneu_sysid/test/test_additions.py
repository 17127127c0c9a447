# SPDX-License-Identifier: Apache-2.0
"""The loop that diagnoses and adds effects: each decision just below and above its threshold.

Searches and fits, which are expensive, are replaced by given outcomes; residuals and thresholds are
real. The whole loop on a simulated plant: tests/test_hidden_effects.py.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.verdict_cases import (
    HORIZON,
    NOISE,
    STRETCHES,
    Case,
    E,
    Floats,
    calibrated,
    leading,
    problem_of,
    rig,
)

from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sysid import diagnose as diagnose_module
from pneu_sysid import learn as learn_module
from pneu_sysid.along import Positions
from pneu_sysid.bench import Bench
from pneu_sysid.diagnose import (
    Diagnosis,
)
from pneu_sysid.problem import Problem
from pneu_sysid.records import Recording
from pneu_sysid.standing import against_noise
from pneu_sysid.thresholds import Thresholds

__all__ = ["rig"]  # a fixture


DELAY = AttachedEffect(effect="valve_delay", place="valve", parameters={"delay_s": 3e-3})
LEAK = AttachedEffect(effect="leak", place="tube", parameters={"area_m2": 2e-8, "position_m": 1.25})
GAIN = AttachedEffect(effect="sensor_gain", place="end", parameters={"error": 0.02})
LAG = AttachedEffect(effect="sensor_lag", place="middle", parameters={"lag_s": 4e-3})


def names_of(effects: Iterable[AttachedEffect]) -> tuple[str, ...]:
    return tuple(e.effect for e in effects)


def with_effects(rig: Rig, *effects: AttachedEffect) -> Rig:
    return rig.model_copy(update={"effects": list(effects)})


@dataclass
class Fits:
    """Stands in for fits of added effects: what a rig with them leaves is given.

    Attributes:
        case: The case.
        left: Residual by the names of the added effects in order.
        asked: Of each fit the names, the number of effects that were there, and the iterations.
    """

    case: Case
    left: dict[tuple[str, ...], Floats]
    asked: list[tuple[tuple[str, ...], int, int]] = field(default_factory=list)

    def __call__(self, bench: Bench, rig: Rig, given: int, iterations: int = 4) -> Any:
        assert bench is self.case.bench
        names = names_of(rig.effects[given:])
        self.asked.append((names, given, iterations))
        units = self.left[names].reshape(self.case.problem.measured.shape)
        readings = self.case.problem.measured - units * NOISE
        # Standard errors of all that is fitted, strengths before positions; the last two are 1, 2.
        errors = np.array([9.0, 8.0, 7.0, 6.0, 1.0, 2.0])
        model = learn_module._Model(rig, readings, bench.residual(readings), 0.5)
        return model, SimpleNamespace(std_errors=errors, of=names)


@pytest.fixture
def fits(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> Fits:
    """Of a rig with an effect of its own, which is never fitted."""
    case = Case(with_effects(calibrated(rig), LAG), 9.0)
    found = Fits(case, {(): case.base})
    monkeypatch.setattr(learn_module, "_together", found)
    monkeypatch.setattr(learn_module, "_placed", lambda bench, model, of, given: (model, of))
    return found


@pytest.mark.parametrize(
    ("ahead", "stands", "alike"),
    [
        # What leads takes the place, what is tied stays in doubt, and what is behind is out.
        (3.001, "sensor_gain", []), (2.999, "leak", ["sensor_gain"]),
        (-2.999, "leak", ["sensor_gain"]), (-3.001, "leak", []),
    ],
)  # fmt: skip
def test_an_earlier_addition_is_reconsidered(
    fits: Fits, ahead: float, stands: str, alike: list[str]
) -> None:
    bench, worse = fits.case.bench, 0.2 * fits.case.base
    better = leading(worse, abs(ahead))
    leak, gain = (worse, better) if ahead > 0.0 else (better, worse)
    fits.left |= {("leak", "valve_delay"): leak, ("sensor_gain", "valve_delay"): gain}
    model, estimate = fits(bench, with_effects(fits.case.rig, LAG, LEAK, DELAY), 1)
    mates = [[GAIN], [LAG, LEAK]]
    found, of, left = learn_module._reconsider(bench, model, estimate, 1, mates)
    assert fits.asked[1:] == [(("sensor_gain", "valve_delay"), 1, 3)]
    assert names_of(found.rig.effects) == ("sensor_lag", stands, "valve_delay")
    assert of.of == (stands, "valve_delay")
    np.testing.assert_allclose(found.residual, fits.left[of.of], atol=1e-9)
    # Those of the last addition are not tried yet.
    assert [names_of(options) for options in left] == [tuple(alike), ("sensor_lag", "leak")]
    assert mates == [[GAIN], [LAG, LEAK]]


def test_of_those_that_look_alike_all_are_reconsidered(fits: Fits) -> None:
    """The first is tied with what stands, the second leads, the third is tied with that."""
    bench, base = fits.case.bench, 0.2 * fits.case.base
    lead_of = {"leak": 0.0, "sensor_lag": 2.9, "sensor_gain": 4.0, "valve_delay": 4.0}
    for name, wanted in lead_of.items():
        fits.left[name, "dead_band"] = leading(base, wanted) if wanted else base
    dead = AttachedEffect(effect="dead_band", place="valve", parameters={"width_v": 0.1})
    model, estimate = fits(bench, with_effects(fits.case.rig, LAG, LEAK, dead), 1)
    mates = [[LAG, GAIN, DELAY], []]
    found, _, left = learn_module._reconsider(bench, model, estimate, 1, mates)
    assert [names for names, _, _ in fits.asked[1:]] == [
        (name, "dead_band") for name in ("sensor_lag", "sensor_gain", "valve_delay")
    ]
    assert names_of(found.rig.effects) == ("sensor_lag", "sensor_gain", "dead_band")
    assert [names_of(options) for options in left] == [("valve_delay",), ()]


@pytest.mark.parametrize(
    ("share", "ahead", "stays"),
    [
        # Of what is left without it it takes away a quarter, and by three standard errors.
        (0.25 + E, None, True), (0.25 - E, None, False), (None, 3.001, True), (None, 2.999, False),
    ],
)  # fmt: skip
def test_an_addition_that_has_become_superfluous_is_dropped(
    fits: Fits, share: float | None, ahead: float | None, stays: bool
) -> None:
    case = fits.case
    without = 0.2 * case.base
    if share is not None:
        left = without * math.sqrt(1.0 - share)
    else:
        assert ahead is not None
        left = leading(without, ahead)
        case.bench.thresholds = Thresholds(worth=0.0)
    fits.left |= {
        ("sensor_gain", "leak", "valve_delay"): left,
        ("leak", "valve_delay"): 30.0 * left,
        ("sensor_gain", "valve_delay"): without,
        ("valve_delay",): 40.0 * left,
    }
    model, estimate = fits(case.bench, with_effects(case.rig, LAG, GAIN, LEAK, DELAY), 1)
    mates = [[LAG], [DELAY], [GAIN]]
    found, of, left_over = learn_module._needed(case.bench, model, estimate, 1, mates)
    wanted = ("sensor_gain", "leak", "valve_delay") if stays else ("sensor_gain", "valve_delay")
    assert names_of(found.rig.effects) == ("sensor_lag", *wanted)
    assert of.of == wanted
    assert left_over == (mates if stays else [[LAG], [GAIN]])
    # The one that was added last is not asked about, and all are fitted as often as usual.
    assert fits.asked[1:] == [
        (("leak", "valve_delay"), 1, 4), (("sensor_gain", "valve_delay"), 1, 4)
    ]  # fmt: skip


def test_effects_are_absent_in_recordings_without_them(rig: Rig) -> None:
    given = with_effects(rig, LAG, LEAK, DELAY.model_copy(update={"parameters": {}}))
    own = {"monday": {"taps.end.gain": 1.1}, "friday": {"taps.end.gain": 1.2}}
    given = given.model_copy(update={"recordings": own})
    found = learn_module._without_effects(given, 1, ["monday", "sunday"])
    absent = {"effects.1.parameters.area_m2": 0.0, "effects.2.parameters.delay_s": 0.0}
    assert found.recordings == {
        "monday": {"taps.end.gain": 1.1, **absent}, "friday": own["friday"], "sunday": absent,
    }  # fmt: skip
    # A value of its own needs one that it replaces.
    assert found.effects[2].parameters == {"delay_s": 0.0}
    assert found.effects[:2] == [LAG, LEAK]
    assert given.recordings == {
        "monday": {"taps.end.gain": 1.1},
        "friday": {"taps.end.gain": 1.2},
    }
    assert given.effects[2].parameters == {}


def test_steps_that_no_longer_hold_are_fitted_anew(fits: Fits) -> None:
    """From the first that is another; those before it are kept as they are."""
    bench, base = fits.case.bench, fits.case.base
    one, two = ("valve_delay",), ("valve_delay", "leak")
    other, three = ("valve_delay", "sensor_gain"), ("valve_delay", "sensor_gain", "leak")
    fits.left |= {one: 0.5 * base, two: 0.3 * base, other: 0.2 * base, three: 0.1 * base}
    rigs = {
        one: with_effects(fits.case.rig, LAG, DELAY),
        two: with_effects(fits.case.rig, LAG, DELAY, LEAK),
        three: with_effects(fits.case.rig, LAG, DELAY, GAIN, LEAK),
    }
    before = [learn_module._step_of(0, bench, fits(bench, fits.case.rig, 1)[0])]
    for names in (one, two):
        before = learn_module._steps(bench, before, *fits(bench, rigs[names], 1), 1)
    assert [step.added for step in before] == [None, "valve_delay", "leak"]
    assert [(step.std_error, step.position_error_m) for step in before[1:]] == [
        (2.0, None),
        (1.0, 2.0),
    ]
    fits.asked.clear()
    steps = learn_module._steps(bench, before, *fits(bench, rigs[three], 1), 1)
    assert fits.asked[1:] == [(other, 1, 4)]
    assert steps[0] is before[0] and steps[1] is before[1]
    assert [step.step for step in steps] == [0, 1, 2, 3]
    assert [step.added for step in steps] == [None, "valve_delay", "sensor_gain", "leak"]
    assert [step.place for step in steps] == [None, "valve", "end", "tube:1.25"]
    assert [step.strength for step in steps] == [None, 3e-3, 0.02, 2e-8]
    times = [step.held_out_times_noise for step in steps]
    assert times == pytest.approx([9.0, 4.5, 1.8, 0.9])
    assert [step.total_times_noise for step in steps] == pytest.approx(times)
    # An error that is lower than how far positions are not told apart counts as that.
    assert steps[3].position_error_m == 2.0


@dataclass
class Script:
    """Stands in for the search: what each look finds is given.

    Attributes:
        fits: What fits leave.
        found: What each look finds, in order.
        taken: Squared error taken away so far, of each look but the first.
    """

    fits: Fits
    found: list[Diagnosis]
    taken: list[float] = field(default_factory=list)

    def first(self, *asked: Any) -> Diagnosis:
        return self.found.pop(0)

    def look(self, bench: Bench, rig: Rig, readings: Floats, tell: Any, taken: float) -> Diagnosis:
        self.taken.append(taken)
        return self.found.pop(0)

    def learn(self, **more: Any) -> Any:
        rig = self.fits.case.rig
        return learn_module.learn(rig, self.fits.case.problem.recordings[0], **more)


@pytest.fixture
def script(fits: Fits, monkeypatch: pytest.MonkeyPatch) -> Script:
    made = Script(fits, [])
    monkeypatch.setattr(learn_module, "diagnose_apart", made.first)
    monkeypatch.setattr(learn_module, "look", made.look)
    return made


def found_in(fits: Fits, *effects: AttachedEffect, alike: tuple[AttachedEffect, ...] = ()) -> Any:
    """A diagnosis that names the last of some effects, which some others look like."""
    case = fits.case
    refits = [
        replace(
            case.refit(one.effect, one.place, held=0.96),
            rig=with_effects(case.rig, LAG, *effects[:-1], one),
        )
        for one in (effects[-1], *alike)
    ]
    found = case.judged(*refits)
    return replace(
        found, verdict="ambiguous" if alike else "effect", believed=len(refits), finalists=refits,
        tied=[[r.site.label for r in refits[1:]], *([] for _ in alike)],
    )  # fmt: skip


def test_effects_are_added_until_too_little_goes(script: Script) -> None:
    """An addition that takes away less than a quarter is not kept."""
    fits, base = script.fits, script.fits.case.base
    for share, added in ((0.25 - E, 1), (0.25 + E, 2)):
        left = 0.5 * math.sqrt(1.0 - share)
        fits.left |= {
            ("valve_delay",): 0.5 * base,
            ("valve_delay", "leak"): left * base,
            ("leak",): 3.0 * base,
            ("valve_delay", "leak", "sensor_gain"): 0.49 * left * base,
        }
        script.found = [found_in(fits, DELAY), found_in(fits, DELAY, LEAK, alike=(GAIN,))]
        nothing = replace(fits.case.judged(), verdict="nothing_missing")
        script.found.append(nothing)
        script.taken.clear()
        learned = script.learn()
        assert names_of(learned.rig.effects) == ("sensor_lag", "valve_delay", "leak")[: 1 + added]
        assert len(learned.steps) == len(learned.rigs) == 1 + added
        assert [len(r.effects) for r in learned.rigs] == list(range(1, 2 + added))
        total = fits.case.bench.held_sum(base)
        gone = [0.75, 1.0 - left**2][: len(script.taken)]
        assert script.taken == pytest.approx([total * one for one in gone])
        # More than the floor is left, and what looks like a later one counts as well.
        assert learned.verdict == "unknown"
        assert learned.alike == ([] if added == 1 else ["sensor_gain@end"])
        assert learned.sentence.endswith("; more is missing that the catalogue does not hold.")


@pytest.mark.parametrize("most", [1, 2])
def test_no_more_effects_are_added_than_may_be(script: Script, most: int) -> None:
    fits, base = script.fits, script.fits.case.base
    fits.left |= {
        ("valve_delay",): 0.5 * base, ("valve_delay", "leak"): 0.25 * base, ("leak",): 3.0 * base,
    }  # fmt: skip
    script.found = [
        found_in(fits, DELAY), found_in(fits, DELAY, LEAK), found_in(fits, DELAY, LEAK, GAIN)
    ]  # fmt: skip
    learned = script.learn(thresholds=Thresholds(most_effects=most))
    assert len(learned.steps) == 1 + most and len(learned.diagnoses) == 1 + most


@pytest.mark.parametrize("alike", [(), (GAIN,), (GAIN, LEAK)])
@pytest.mark.parametrize(("left", "looks"), [(1.1 - E, 1), (1.1 + E, 2)])
def test_nothing_more_is_looked_for_at_a_tenth_above_the_floor(
    script: Script, left: float, looks: int, alike: tuple[AttachedEffect, ...]
) -> None:
    fits = script.fits
    fits.left["valve_delay",] = math.sqrt(left) * fits.case.base / 9.0
    script.found = [
        found_in(fits, DELAY, alike=alike),
        replace(fits.case.judged(), verdict="nothing_missing"),
    ]
    learned = script.learn()
    assert len(learned.diagnoses) == looks
    assert learned.verdict == ("ambiguous" if alike else "effect")
    labels = ["sensor_gain@end", "leak@tube:1.25"][: len(alike)]
    assert learned.alike == labels
    assert learned.sentence == (
        "Missing: valve transport delay at valve, 0.003 s (± 2); with that the held-out error"
        " falls from 9.00 to 1.05 times the noise"
        + (f"; not to be told from {', '.join(sorted(labels))}" if labels else "")
        + "."
    )


def test_an_addition_that_makes_another_superfluous_is_the_last(script: Script) -> None:
    fits, base = script.fits, script.fits.case.base
    fits.left |= {
        ("valve_delay",): 0.5 * base, ("valve_delay", "leak"): 0.3 * base, ("leak",): 0.3 * base,
    }  # fmt: skip
    script.found = [found_in(fits, DELAY, alike=(GAIN,)), found_in(fits, DELAY, LEAK)]
    fits.left["sensor_gain", "leak"] = 9.0 * base
    learned = script.learn()
    assert not script.found and names_of(learned.rig.effects) == ("sensor_lag", "leak")
    assert [step.added for step in learned.steps] == [None, "leak"]
    assert [names_of(r.effects) for r in learned.rigs] == [("sensor_lag",), ("sensor_lag", "leak")]
    assert learned.alike == []


@pytest.mark.parametrize(("elsewhere", "stays"), [(0.49, False), (0.51, True)])
@pytest.mark.parametrize("own_cells", [True, False])
def test_what_was_added_last_is_placed(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, own_cells: bool, elsewhere: float, stays: bool
) -> None:
    """It goes where it does better after it was fitted there, and is then looked at from there."""
    case = Case(with_effects(calibrated(rig), LAG, DELAY), 9.0)
    there = LEAK.model_copy(update={"parameters": {"area_m2": 3e-8, "position_m": 2.0}})
    longer = replace(case.problem)
    on = case.problem if own_cells else longer
    wrong = np.full_like(case.base, 0.25)
    model = learn_module._Model(
        with_effects(case.rig, LAG, DELAY, LEAK), case.bench.readings, 0.5 * case.base
    )
    better = with_effects(case.rig, LAG, DELAY, there)
    fitted: list[Any] = []
    looked: list[Any] = []

    def refit_effects(problem: Problem, of: Rig, indices: list[int], *more: Any) -> Any:
        fitted.append((problem is on, of, indices, more))
        return of, SimpleNamespace(of=of)

    def predict(rigs: list[Rig]) -> Floats:
        share = elsewhere if rigs[0] is better else 0.5
        units = share * case.base.reshape(case.problem.measured.shape)
        return np.asarray([case.problem.measured - units * NOISE])

    def positions(problem: Problem, of: Rig, last: int, *more: Any) -> Positions:
        looked.append((problem is on, of, last, more))
        return Positions(better, 0.3) if len(looked) == 1 else Positions(None, 0.7)

    monkeypatch.setattr(learn_module, "refit_effects", refit_effects)
    monkeypatch.setattr(learn_module, "positions", positions)
    case.problem.predict = predict  # type: ignore[method-assign]
    case.bench.faithful = lambda rig, readings: (on, wrong)  # type: ignore[method-assign]
    given = SimpleNamespace(of=None)
    found, estimate = learn_module._placed(case.bench, model, given, 1)  # type: ignore[arg-type]
    assert found.rig is (model.rig if stays else better)
    assert found.untold_m == (0.3 if stays else 0.7)
    if stays and not own_cells:
        assert found is model and estimate is given
    else:
        assert estimate.of is found.rig
        left = 0.5 if stays else elsewhere
        np.testing.assert_allclose(found.residual, left * case.base, atol=1e-9)
    tried = [model.rig, better] if own_cells else [better]
    assert fitted == [(True, of, [1, 2], (3, None)) for of in tried]
    assert [(mine, of) for mine, of, _, _ in looked] == [
        (True, model.rig), *([] if stays else [(True, better)])
    ]  # fmt: skip
    for _, _, last, (blocks, project, what) in looked:
        assert last == 2 and blocks is case.bench.blocks and project is None and what is wrong


def test_a_rig_that_lacks_nothing_stays_as_it_is(script: Script) -> None:
    for verdict in ("nothing_missing", "unknown"):
        found = replace(script.fits.case.judged(), verdict=verdict, sentence=f"{verdict}!")
        script.found = [found]
        learned = script.learn()
        assert learned.rig is script.fits.case.rig and len(learned.steps) == 1
        assert (learned.verdict, learned.sentence) == (verdict, f"{verdict}!")
        assert learned.diagnoses == [found]


def test_what_is_said_once_of_a_diagnosis(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a change, of the noise, and where candidates are tied of what would tell them apart."""
    case = Case(calibrated(rig), 6.0)
    asked: list[Any] = []

    def bench_of(*given: Any) -> Bench:
        asked.append(given)
        return case.bench

    monkeypatch.setattr(diagnose_module, "bench_of", bench_of)
    one, two = case.refit(held=0.96), case.refit("sensor_lag", "end", held=0.96)
    for refits, left_open, first in (
        ([one], False, "Something changed since the calibration."),
        ([one, two], False, "Something changed since the calibration."),
        ([one], True, "Nothing is known to have changed since the calibration."),
    ):
        found = replace(case.judged(*refits), left_open=left_open)
        monkeypatch.setattr(diagnose_module, "look", lambda *given, found=found: found)
        told = diagnose_module.diagnose(
            rig, [], 4, False, 3, None, Thresholds(worth=0.1), ["leak"], [(1.0, 2.0)]
        )
        assert told.statements[:2] == [first, against_noise(case.bench.standing, Thresholds())]
        more = told.statements[2:]
        if len(refits) == 2:
            assert told.verdict == "ambiguous"
            best = told.finalists[0].site
            assert more == [f"To tell {best.label} from the others: {best.effect.next_experiment}"]
        else:
            assert more == []
    assert asked[0][:4] == (rig, [], False, 3)
    assert asked[0][5:] == (Thresholds(worth=0.1, finalists=4), ["leak"], [(1.0, 2.0)])


def test_what_was_left_open_is_no_change_in_one_of_several(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = Case(calibrated(rig), 6.0)
    runs = [Recording(name, {}, {}) for name in ("early", "late")]
    many = problem_of(rig, ("early", "late"))
    monkeypatch.setattr(diagnose_module, "make_problem", lambda *_, **__: many)
    monkeypatch.setattr(type(many), "predict", lambda self, rigs: many.measured[None])
    r = np.ones((STRETCHES, HORIZON * NOISE.size))
    r[many.of == 1] = 7.0
    monkeypatch.setattr(diagnose_module, "residual_matrix", lambda problem, readings: r)
    for left_open in (True, False):
        found = replace(
            case.judged(case.refit(held=0.96)), left_open=left_open, statements=["own", "noise"]
        )
        asked = []

        def diagnose(
            rig: Rig, differ: list[Recording], *more: Any, asked: Any = asked, found: Any = found
        ) -> Any:
            asked.append((differ, more))
            return found

        monkeypatch.setattr(diagnose_module, "diagnose", diagnose)
        told = diagnose_module.diagnose_apart(
            calibrated(rig), runs, 2, False, 3, None, Thresholds(worth=0.1), ["leak"]
        )
        assert asked == [([runs[1]], (2, False, 3, None, Thresholds(worth=0.1), ["leak"]))]
        changed = "Something changed in late since the calibration, and nothing in early."
        assert told.statements == [
            "own" if left_open else changed,
            "noise",
            "The verdict is of late; the model without it explains early.",
        ]
        assert told.unchanged == ["early"]
    # With parts that somebody chose to keep aside, all are diagnosed together.
    asked = []
    monkeypatch.setattr(diagnose_module, "diagnose", lambda *given: asked.append(given))
    diagnose_module.diagnose_apart(rig, runs, 2, aside=[(0.0, 1.0)])
    assert asked[0][1] is runs and asked[0][-1] == [(0.0, 1.0)]
