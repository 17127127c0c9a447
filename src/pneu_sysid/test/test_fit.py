# SPDX-License-Identifier: Apache-2.0
"""Calibration: what is fitted, from where it starts, and what is said where it stops short."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from studies.exact_rigs import draw_rig, record
from studies.experiments import plants
from tests.fit_jobs import job_of

from pneu_common.errors import InputError
from pneu_sim.rig import load_rig
from pneu_sim.rig.build import build, spool_row
from pneu_sim.rig.parameters import get_parameter, with_parameters
from pneu_sim.rig.schema import AttachedEffect, FitParameter, Opening, Rig
from pneu_sim.run import run_from_rest
from pneu_sim.signals import Signal
from pneu_sim.valve import positions_along
from pneu_sysid import fit as fit_module
from pneu_sysid import fit_step, spool_starts
from pneu_sysid.curves import EXPONENT_APART, WIDEST, curve_ties, mirrors_of, with_own_curves
from pneu_sysid.design.limits import limits_of
from pneu_sysid.fit import FitOutcome, _brought_back, fit_rig, parameters_of
from pneu_sysid.fit_step import Job, Taken, key_of
from pneu_sysid.last_steps import OWN_CELLS
from pneu_sysid.observed.noise import with_noise
from pneu_sysid.parameters import (
    calibrated_parameters,
    listed_parameters,
    rig_at,
    variables_of,
)
from pneu_sysid.problem import make_problem, pull_of, record_for
from pneu_sysid.records import Recording
from pneu_sysid.stages import Step, brought_back, cells_of, gained_little, is_slow, steps_of

ROOT = Path(__file__).parents[3]

BANDWIDTH = "valves.valve.spool.bandwidth_hz"
SUPPLY = "valves.valve.ports.supply.conductance_m3_s_pa"
EXHAUST = "valves.valve.ports.exhaust.conductance_m3_s_pa"
VOLUME = "chambers.chamber.volume_m3"


def coarse(shape: str, rng: np.random.Generator) -> Rig:
    """A rig on longer cells, which take a fraction of the time."""
    rig = draw_rig(shape, rng)
    rig.grid.dx_m, rig.grid.memory = 0.2, False
    return rig


def openings(rig: Rig, port: str, volts: np.ndarray) -> np.ndarray:
    """Opening of a port at some voltages, as the simulator has it."""
    model = build(rig)
    q = model.plan.port_names.index(f"valve.{port}")
    table = np.linspace(*model.curve_v[q], model.curve.shape[1])
    return np.interp(volts, table, model.curve[q])


@pytest.mark.parametrize("interpolation", ["power", "cubic"])
def test_ports_get_curves_of_their_own_and_keep_their_openings(interpolation: str) -> None:
    rig = draw_rig("line", np.random.default_rng(1))
    if interpolation == "cubic":
        given = Opening(voltage_v=[5.0, 5.5, 7.0, 10.0], fraction=[0.0, 0.05, 0.4, 1.0])
        rig.valves["valve"].ports["supply"].opening = given
    own = with_own_curves(rig)
    volts = np.linspace(5.15, 10.0, 60)
    for port, at in (("supply", volts), ("exhaust", 10.0 - volts)):
        curve = own.valves["valve"].ports[port].opening
        assert curve.mirror is None and curve.interpolation == "power"
        distance = np.sort(np.abs(np.array(curve.voltage_v) - 5.0))
        assert (distance[1:] / distance[:-1] < WIDEST * 1.001).all()
        # between the points another interpolation, hence not the same to the last digit
        np.testing.assert_allclose(
            openings(own, port, at), openings(rig, port, at), atol=0.02, rtol=0.05
        )
    assert rig.valves["valve"].ports["exhaust"].opening.mirror == "supply"


@pytest.mark.parametrize("name", ["lab", "rig_a", "kokoro"])
def test_a_fit_begins_with_the_rig_of_the_file(name: str) -> None:
    """Also where numbers differ that ports or pipes mostly share: the lab's do."""
    rig = load_rig(ROOT / "rigs" / f"{name}.yaml")
    rig.pipes[next(iter(rig.pipes))].wall.laminar = 1.1
    listed = calibrated_parameters(rig)
    begun = rig_at(rig, listed, np.array([v.value for v in variables_of(rig, listed)]))
    for valve, same in zip(rig.valves.values(), begun.valves.values(), strict=True):
        assert [p.laminar_ratio for p in valve.ports.values()] == pytest.approx(
            [p.laminar_ratio for p in same.ports.values()], rel=1e-12
        )
    assert [p.wall.laminar for p in begun.pipes.values()] == pytest.approx(
        [p.wall.laminar for p in rig.pipes.values()], rel=1e-12
    )
    paths = {p.path for p in listed}
    assert ("pipes.*.wall.laminar" in paths) == (len(rig.pipes) == 1)
    assert "pipes.*.wall.unsteady" in paths


def test_a_curve_follows_the_one_whose_mirror_the_file_calls_it() -> None:
    """Where nothing else is known it does so exactly; an exponent of its own costs what it says."""
    rig = draw_rig("line", np.random.default_rng(1))
    own = with_own_curves(rig)
    points = [p for p in calibrated_parameters(own) if ".opening.fraction." in p.path]
    ties, sides, group = curve_ties(own, points, mirrors_of(rig))
    free, _, _ = curve_ties(own, points)

    def logs(**exponents: float) -> np.ndarray:
        """Logarithms of the points of power laws of some exponents, full opening 1."""
        out = []
        for p in points:
            port, k = p.path.split(".")[3], int(p.path.split(".")[-1])
            distance = np.abs(np.array(own.valves["valve"].ports[port].opening.voltage_v) - 5.0)
            out.append(exponents[port] * np.log(distance[k] / distance.max()))
        return np.array(out)

    np.testing.assert_allclose(ties @ logs(supply=1.4, exhaust=1.4), sides, atol=1e-9)
    apart = ties @ logs(supply=1.4, exhaust=1.4 + EXPONENT_APART) - sides
    mirrored = np.abs(apart[np.abs(apart) > 1e-9])
    np.testing.assert_allclose(mirrored, 1.0, rtol=1e-9)
    assert len(mirrored) == len(own.valves["valve"].ports["exhaust"].opening.fraction) - 1
    assert len(ties) == len(free) + len(mirrored)
    assert np.sum(group == 1) == len(mirrored)


def test_the_file_adds_drops_and_holds() -> None:
    rig = draw_rig("restrictor", np.random.default_rng(2))
    paths = [p.path for p in parameters_of(rig)]
    assert "orifices.restrictor.conductance_m3_s_pa" in paths
    assert "chambers.chamber.heat_w_per_k" in paths
    assert any(p.endswith("loss_to") for p in paths)
    rig.fit.add = [
        FitParameter(path="taps.tube.lag_s", lower=0.0, upper=0.02, std=2e-3),
        FitParameter(path=BANDWIDTH, lower=10.0, upper=20.0, log=True),
    ]
    rig.fit.drop = ["valves.*.opening.*"]
    rig.fit.hold = ["chambers.*"]
    listed, held = listed_parameters(rig, calibrated_parameters(with_own_curves(rig)))
    by_path = {p.path: p for p in listed}
    assert by_path["taps.tube.lag_s"].upper == 0.02
    assert by_path[BANDWIDTH].upper == 20.0
    assert not any("opening" in path for path in by_path)
    assert set(held) == {VOLUME, "chambers.chamber.heat_w_per_k"}
    rig.fit.drop = ["valve.*"]
    with pytest.raises(InputError, match=r"fit\.drop\.0: found 'valve\.\*', which is no parameter"):
        parameters_of(rig)


def few(rig: Rig, *paths: str) -> list[FitParameter]:
    """Some parameters of a rig's list."""
    return [p for p in calibrated_parameters(rig) if p.path in paths]


@pytest.mark.long
def test_what_is_held_counts_in_the_errors_of_the_others() -> None:
    """A volume that is not known exactly makes the conductance that fills it as uncertain."""
    rng = np.random.default_rng(3)
    rig = coarse("two_valves", rng)
    recording = record(rig, rng, 125.0, 2.5, moving=False)
    rig.fit.parameters = few(rig, SUPPLY, EXHAUST, BANDWIDTH, VOLUME)

    def errors(**fit: list[str]) -> dict[str, float | None]:
        given = rig.model_copy(update={"fit": rig.fit.model_copy(update=fit)})
        outcome = fit_rig(given, recording, approach=False, iterations=2)
        return {p.path: p.std_error for p in outcome.parameters}

    exact, held = errors(drop=[VOLUME]), errors(hold=[VOLUME])
    assert VOLUME not in exact and held[VOLUME] is None
    volume = next(p for p in rig.fit.parameters if p.path == VOLUME)
    relative = volume.std / rig.chambers["chamber"].volume_m3
    conductance = rig.valves["valve"].ports["exhaust"].conductance_m3_s_pa
    # what flows fills the chamber: an error of the one is nearly as large an error of the other
    assert 0.5 * relative * conductance < held[EXHAUST] < 1.5 * relative * conductance
    assert exact[EXHAUST] < 0.1 * held[EXHAUST]


def test_a_calibrated_rig_is_fitted_again_with_the_patterns_of_its_file() -> None:
    """Its list lacks what a pattern dropped; the pattern still means something."""
    rng = np.random.default_rng(8)
    rig = coarse("line", rng)
    rig.fit.drop = ["pipes.*", "reservoirs.*", "valves.*.spool.*", "*.opening.*"]
    rig.fit.hold = ["*.laminar_*", "*.jet_loss", "*.inlet_head", "*.leakage", "*.critical_ratio"]
    recording = record(rig, rng, 125.0, 2.0, moving=False)
    once = fit_rig(rig, recording, approach=False, iterations=1)
    again = fit_rig(once.rig, recording, approach=False, iterations=1)
    assert {p.path for p in again.parameters} == {p.path for p in once.parameters}
    assert {p.path for p in again.parameters if p.std_error is not None} == {SUPPLY, EXHAUST}
    assert {p.path for p in again.rig.fit.parameters} == {p.path for p in once.rig.fit.parameters}


def test_what_is_held_and_dropped_leaves_something_to_fit() -> None:
    rng = np.random.default_rng(8)
    rig = coarse("line", rng)
    rig.fit.hold = ["*"]
    with pytest.raises(InputError, match=r"nothing is to be fitted"):
        fit_rig(rig, record(rig, rng, 125.0, 1.0, moving=False))


def test_a_bound_is_told_unless_nothing_lies_beyond_it() -> None:
    """A bandwidth held too low may be higher; a port that does not leak leaks no less."""
    rng = np.random.default_rng(9)
    rig = coarse("line", rng)
    leakage = "valves.valve.ports.supply.leakage"
    most = 0.8 * rig.valves["valve"].spool.bandwidth_hz
    parameters = [
        FitParameter(path=leakage, lower=0.0, upper=0.02),
        FitParameter(path=BANDWIDTH, lower=0.5 * most, upper=most, log=True),
    ]
    recording = record(rig, rng, 125.0, 2.0, moving=False)
    rig.valves["valve"].ports["supply"].leakage = 1e-3
    told = " ".join(fit_rig(rig, recording, parameters, approach=False, iterations=3).warnings)
    assert BANDWIDTH in told and leakage not in told


@pytest.fixture(scope="module")
def calibrated() -> tuple[Rig, Recording, FitOutcome, Rig]:
    """A rig with a slow spool and curves that differ, known from a datasheet, calibrated."""
    rng = np.random.default_rng(4)
    truth = with_own_curves(coarse("line", rng))
    valve = truth.valves["valve"]
    valve.spool.bandwidth_hz, valve.spool.damping, valve.spool.delay_s = 70.0, 0.8, 1e-3
    valve.spool.max_acceleration_v_s2 = 0.2 * 5.0 * (2.0 * np.pi * 70.0) ** 2
    supply, exhaust = valve.ports["supply"], valve.ports["exhaust"]
    exhaust.opening.fraction = [f**1.2 for f in exhaust.opening.fraction]
    datasheet = truth.model_copy(deep=True)
    guess = datasheet.valves["valve"]
    guess.spool = guess.spool.model_copy(
        update={"bandwidth_hz": 55.0, "delay_s": 0.0, "max_acceleration_v_s2": None}
    )
    guess.ports["supply"].conductance_m3_s_pa = 1.3 * supply.conductance_m3_s_pa
    guess.ports["exhaust"].conductance_m3_s_pa = exhaust.conductance_m3_s_pa / 1.2
    volts = [5.05, 5.1, 5.2, 5.35, 5.6, 6.0, 6.6, 7.5, 8.6, 10.0]
    guess.ports["supply"].opening = Opening(
        voltage_v=volts, fraction=[(v - 5.0) / 5.0 for v in volts], interpolation="power"
    )
    guess.ports["exhaust"].opening = Opening(mirror="supply")
    # what the recordings hardly show costs time here
    datasheet.fit.drop = ["pipes.*", "*.laminar_*", "*.jet_loss", "*.inlet_head", "reservoirs.*"]
    recordings = [record(truth, rng, 250.0, 6.0, moving=False, name=f"run_{k}") for k in (1, 2)]
    return truth, recordings[1], fit_rig(datasheet, recordings[0]), datasheet


@pytest.mark.long
def test_a_datasheet_becomes_a_calibration(
    calibrated: tuple[Rig, Recording, FitOutcome, Rig],
) -> None:
    """It is as good as the truth on a recording kept aside, though its file knew of no limit."""
    truth, aside, outcome, _ = calibrated

    def times_noise(rig: Rig) -> np.ndarray:
        problem = make_problem(rig, aside)
        # cells so long leave twice the noise themselves, which no number is fitted to
        problem.doubt_cells(rig)
        r = problem.residual(problem.predict([rig])[0])
        return np.sqrt(np.sum(r**2, axis=(0, 1)) / np.isfinite(problem.measured).sum(axis=(0, 1)))

    assert (times_noise(outcome.rig) < 1.35 * times_noise(truth)).all()
    # and on finer cells than either was run on both foretell the same
    finer = make_problem(truth, aside).with_grid(truth.grid.dx_m / 4.0)
    apart = finer.predict([outcome.rig])[0] - finer.predict([truth])[0]
    off = np.nanmedian(np.abs(apart), axis=(0, 1)), np.sqrt(np.nanmean(apart**2, axis=(0, 1)))
    assert (off[0] < finer.noise_pa / 3.0).all(), off
    assert (off[1] < 2e-3 * np.nanmax(aside.pressures["feed"].values)).all(), off  # at steep fronts
    spool = outcome.rig.valves["valve"].spool
    assert spool.max_acceleration_v_s2 is not None or spool.max_speed_v_s is not None
    for path in (SUPPLY, EXHAUST):
        k = next(k for k, p in enumerate(outcome.parameters) if p.path == path)
        port = path.split(".")[3]
        true = truth.valves["valve"].ports[port].conductance_m3_s_pa
        assert outcome.values[k] == pytest.approx(true, rel=0.02), path


def test_what_nothing_shows_where_it_was_driven_is_brought_back() -> None:
    """Heat of walls that is as much as there can be is not seen, though less of it would be."""
    true = load_rig(ROOT / "rigs" / "lab.yaml")
    true.grid.dx_m = 0.2
    at = np.arange(0.0, 1.0, 1e-3)
    volts = np.where(np.floor(at / 0.25) % 2 == 0, 7.0, 5.0)  # filled, and never exhausted
    out = run_from_rest(true, {"voltage": volts}, 1e-3)
    signals = {n: Signal(at[::4], x[::4]) for n, x in out.taps.items()}
    recording = Recording("filled", {"voltage": Signal(at, volts)}, signals)
    paths = [f"pipes.{name}.wall.nusselt" for name in ("tube", "exhaust_tube")]
    driven = with_parameters(true, dict.fromkeys(paths, 40.0))
    hidden = [p for p in calibrated_parameters(true) if p.path in paths]
    problem = make_problem(driven, recording)
    used = np.ones(problem.stretches, dtype=bool)
    rig, seen = brought_back(driven, problem, used, hidden, [8.0, 8.0], [4.0, 4.0])
    assert [p.path for p in seen] == ["pipes.tube.wall.nusselt"]
    assert [get_parameter(rig, path) for path in paths] == [8.0, 8.0]
    # A step ends there likewise, with what is off by more than half a deviation of what was known.
    step = Step("all", true.grid.dx_m, None, 1)
    job = job_of(true, recording, hidden, step)
    values = [job.centres[key_of(p)] + 4.0 * job.spread(p) for p in hidden]
    last = Taken(step, driven, hidden, problem, SimpleNamespace(values=np.array(values)), True)  # type: ignore[arg-type]
    unseen = {key_of(p) for p in hidden}
    after, still = _brought_back(job, last, unseen)
    known = [get_parameter(true, path) for path in paths]
    assert [get_parameter(after.rig, path) for path in paths] == pytest.approx(known)
    assert after.back and still == {("pipes.exhaust_tube.wall.nusselt", None)}
    assert replace(after, rig=driven, back=False) == last
    for near, moved in ((0.51, True), (-0.51, True), (0.49, False), (-0.49, False)):
        values = [job.centres[key_of(p)] + near * job.spread(p) for p in hidden]
        tried = replace(last, estimate=SimpleNamespace(values=np.array(values)))  # type: ignore[arg-type]
        after, still = _brought_back(job, tried, unseen)
        assert (after is not tried) == moved
        assert len(still) == (1 if moved else 2)
    # What is seen where it is stays, however far off that is.
    after, still = _brought_back(job, last, set())
    assert after is last and still == set()
    # one that explains more where it is stays there, seen or not
    warm = make_problem(true, Recording("same", recording.commands, signals))
    rig, _ = brought_back(true, warm, used, hidden[:1], [40.0], [0.1])
    assert rig is true


def only(rig: Rig, *paths: str) -> Rig:
    """The rig, of whose list all parameters but some are dropped."""
    rig.valves["valve"].spool.closing_delay_s = 0.0  # or it would get one on the way
    rig.fit.drop = ["*.opening.*"]
    listed = [p.path for p in parameters_of(rig)]
    assert set(paths) <= set(listed)
    rig.fit.drop += [path for path in listed if path not in paths]
    return rig


def test_a_spool_is_tried_before_it_is_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where all that flows is known, the step that fits what flows is left out."""
    rng = np.random.default_rng(21)
    true = coarse("line", rng)
    recording = record(true, rng, 250.0, 1.5, moving=False)
    spool = true.valves["valve"].spool
    assert spool.bandwidth_hz is not None
    drawn = true.model_copy(deep=True)
    drawn.valves["valve"].spool.bandwidth_hz = 1.4 * spool.bandwidth_hz
    drawn = only(drawn, BANDWIDTH, "valves.valve.spool.damping")
    told: list[tuple[str, float, str]] = []
    tried: list[Rig] = []
    begun: list[Rig] = []

    def taken(job: Job, rig: Rig, *more: Any) -> Taken:
        begun.append(rig)
        return fit_step.taken(job, rig, *more)

    def try_spools(rig: Rig, *more: Any) -> Rig:
        tried.append(spool_starts.try_spools(rig, *more))
        return tried[-1]

    monkeypatch.setattr(fit_module, "taken", taken)
    monkeypatch.setattr(fit_module, "try_spools", try_spools)
    outcome = fit_rig(drawn, recording, progress=lambda *words: told.append(words))  # type: ignore[arg-type]
    (first_try,) = tried
    assert begun[0] is first_try
    assert first_try.valves["valve"].spool.bandwidth_hz == pytest.approx(
        0.6 * 1.4 * spool.bandwidth_hz
    )
    first = [p for p in calibrated_parameters(drawn) if p.path == BANDWIDTH]
    (found,) = [p for p in outcome.parameters if p.path == BANDWIDTH]
    assert found.model_copy(update={"std_error": None}) == first[0]
    values = dict(zip([p.path for p in outcome.parameters], outcome.values, strict=True))
    begun = dict(zip([p.path for p in outcome.parameters], outcome.start, strict=True))
    assert begun[BANDWIDTH] == pytest.approx(1.4 * spool.bandwidth_hz)
    assert found.std_error is not None and found.std_error < 0.05 * spool.bandwidth_hz
    assert abs(values[BANDWIDTH] - spool.bandwidth_hz) < 4.0 * found.std_error
    assert values["valves.valve.spool.damping"] == pytest.approx(spool.damping, rel=0.1)
    now = outcome.rig.valves["valve"].spool
    assert (now.max_speed_v_s, now.max_acceleration_v_s2) == (None, None)
    assert now.bandwidth_hz == values[BANDWIDTH]
    words = [note for _, _, note in told]
    assert not any(note.startswith("slow") for note in words)
    assert any(note.startswith("fast: spools") for note in words)
    fractions = [done for _, done, _ in told]
    assert fractions == sorted(fractions) and 0.0 < fractions[-1] <= 1.0


@pytest.mark.parametrize("changed", [True, False])
def test_limits_that_are_found_are_fitted(monkeypatch: pytest.MonkeyPatch, changed: bool) -> None:
    """Unless a list was given, which is all that is fitted then."""
    rig = coarse("line", np.random.default_rng(21))
    path = "valves.valve.spool.max_speed_v_s"
    every = [p for p in calibrated_parameters(rig) if "spool" in p.path]
    step = Step("limits", rig.grid.dx_m, None, 1, limits=True)
    empty = Recording("none", {}, {})
    job = replace(
        job_of(rig, empty, every, step), given=False, measured={"valves.b.spool.delay_s": None}
    )
    known = {key_of(p): p for p in every}
    job.known.update(known)
    limited = rig.model_copy(deep=True)
    limited.valves["valve"].spool.max_speed_v_s = 300.0
    problem = SimpleNamespace(held_out=np.zeros(2, dtype=bool), stretches=2)
    last = Taken(step, rig, every, problem, SimpleNamespace(name="it"), True)  # type: ignore[arg-type]
    asked: list[Any] = []

    def try_limits(*given: Any) -> tuple[Rig, bool]:
        asked.append(given[:6])
        return limited, changed

    monkeypatch.setattr(fit_module, "try_limits", try_limits)
    monkeypatch.setattr(fit_module, "try_spools", lambda *given: pytest.fail("not now"))
    assert fit_module._tried(replace(job, given=True), rig, step, every, last) == (rig, every)
    assert asked == []
    found, listed = fit_module._tried(job, rig, step, every, last)
    assert found is limited
    ((of, on, used, estimate, fitted, done),) = asked
    assert (of, on, estimate, fitted, done) == (rig, problem, last.estimate, every, {"b"})
    assert used.all()
    if not changed:
        assert listed is every and job.known == known
        return
    assert path in {p.path for p in listed}
    assert job.centres[path, None] == pytest.approx(np.log(300.0))
    for p in listed:
        assert job.known[key_of(p)] == p and known.get(key_of(p), p) == p


def test_what_no_step_shows_is_left_as_it_is() -> None:
    """Also where all that is to be fitted is of that kind."""
    rng = np.random.default_rng(21)
    path = "pipes.*.wall.heat_unsteady"
    rig = only(coarse("line", rng), path)
    outcome = fit_rig(rig, record(rig, rng, 250.0, 1.0, moving=False), iterations=1)
    assert [p.path for p in outcome.parameters] == [path]
    assert outcome.values == outcome.start and outcome.parameters[0].std_error is None
    assert outcome.warnings[0].startswith("1 of 1 parameters kept their values")


def test_what_is_missed_after_a_step_undoes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A limit that was given up, without which the fitted rig does worse."""
    rng = np.random.default_rng(8)
    rig = coarse("line", rng)
    recording = record(rig, rng, 125.0, 1.0, moving=False)
    wrong = rig.model_copy(deep=True)
    wrong.valves["valve"].ports["supply"].conductance_m3_s_pa *= 1.2
    wrong.fit.parameters = few(rig, SUPPLY)
    one, two = steps_of(wrong, False, 1)
    three = replace(two, words="all once more")
    asked: list[tuple[float, float]] = []
    begun: list[float] = []

    def taken(job: Job, rig: Rig, *more: Any) -> Taken:
        begun.append(get_parameter(rig, SUPPLY))
        return fit_step.taken(job, rig, *more)

    def missed(before: Rig, after: Rig, *on: object) -> bool:
        asked.append((get_parameter(before, SUPPLY), get_parameter(after, SUPPLY)))
        return True

    monkeypatch.setattr(fit_module, "taken", taken)
    monkeypatch.setattr(fit_module, "limits_missed", missed)
    monkeypatch.setattr(fit_module, "steps_of", lambda *given: [one, two, three])
    undone = fit_rig(wrong, recording, approach=False, iterations=1)
    assert begun == [get_parameter(wrong, SUPPLY), asked[0][0], asked[0][0]]
    monkeypatch.setattr(fit_module, "steps_of", lambda *given: [one])
    alone = fit_rig(wrong, recording, approach=False, iterations=1)
    assert len(asked) == 2 and undone.values == alone.values == [asked[0][0]] == [asked[1][0]]
    true = get_parameter(rig, SUPPLY)
    assert abs(asked[0][1] - true) < 0.5 * abs(asked[0][0] - true)


def test_spools_that_were_measured_are_not_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(8)
    rig = coarse("line", rng)
    recording = record(rig, rng, 125.0, 1.0, moving=False)
    assert fit_module._with_measured_spools(rig, [recording]) == (rig, {})
    spool = rig.valves["valve"].spool.model_copy(update={"bandwidth_hz": 33.0})
    found = SimpleNamespace(spool=spool, std_error={BANDWIDTH: 0.5})
    monkeypatch.setattr(fit_module, "fit_spools", lambda *given: {"valve": found})
    seen = Recording(
        "seen",
        recording.commands,
        recording.pressures,
        positions={"valve": recording.commands["voltage"]},
    )
    rig.fit.parameters = few(rig, SUPPLY, BANDWIDTH)
    outcome = fit_rig(rig, [seen], approach=False, iterations=1)
    assert outcome.rig.valves["valve"].spool.bandwidth_hz == 33.0
    assert rig.valves["valve"].spool.bandwidth_hz != 33.0
    assert [p.path for p in outcome.fitted] == [SUPPLY]
    errors = {p.path: p.std_error for p in outcome.parameters}
    assert errors[BANDWIDTH] == 0.5
    rig.fit.parameters = few(rig, BANDWIDTH)
    with pytest.raises(InputError, match="nothing is to be fitted"):
        fit_rig(rig, [seen], approach=False)


def test_a_lumped_model_has_no_cells_that_could_be_wrong() -> None:
    rig = load_rig(ROOT / "rigs" / "rig_b_thin_plate.yaml")
    volts = plants.random_volts(rig, limits_of(rig), 2.0, 5)
    wrong = rig.model_copy(deep=True)
    wrong.fit.parameters = few(rig, EXHAUST)
    wrong.valves["valve"].ports["exhaust"].conductance_m3_s_pa *= 1.3
    noisy = with_noise(rig, dict.fromkeys(rig.taps, 250.0))
    recording = plants.record(noisy, volts, "plate", 1)
    outcome = fit_rig(wrong, recording, approach=False, iterations=3)
    assert outcome.values == [pytest.approx(get_parameter(rig, EXHAUST), rel=1e-2)]
    assert not any("cells" in line for line in outcome.warnings)


def test_what_cannot_be_compared_is_said() -> None:
    rig = load_rig(ROOT / "rigs" / "rig_a.yaml")
    with pytest.raises(InputError, match="no recording was given, at least one is needed"):
        make_problem(rig, [])
    deaf = rig.model_copy(deep=True)
    for tap in deaf.taps.values():
        tap.channel = None
    words = f"rig {rig.name!r}: no tap has a channel, so nothing can be compared"
    with pytest.raises(InputError, match=words):
        record_for(deaf, "run.mcap")
    deaf.commands["voltage"].channel = None
    with pytest.raises(InputError, match=r"commands\.voltage has no channel to read"):
        record_for(deaf, "run.mcap")


def test_a_sensor_of_which_hardly_anything_was_read_has_the_finest_noise() -> None:
    """Of a tap a pascal, which is more than the share of its readings that counts anyway."""
    rng = np.random.default_rng(8)
    rig = coarse("line", rng)
    recording = record(rig, rng, 125.0, 1.5, moving=False)
    for tap in rig.taps.values():
        tap.noise_pa = 0.0
    feed = recording.pressures["feed"]
    few = {name: Signal(s.time_s[:0], s.values[:0]) for name, s in recording.pressures.items()}
    few["feed"] = Signal(feed.time_s[[0, 90, -1]], np.array([7.0, 8.0, 9.0]))
    problem = make_problem(rig, Recording("few", recording.commands, few))
    np.testing.assert_array_equal(problem.noise_pa, 1.0)
    few["feed"] = Signal(feed.time_s[[0, 90, -1]], np.array([2e5, 3e5, 4e5]))
    problem = make_problem(rig, Recording("few", recording.commands, few))
    np.testing.assert_array_equal(problem.noise_pa, 40.0)


@pytest.mark.parametrize(
    ("path", "slow"),
    [
        ("valves.valve.ports.supply.conductance_m3_s_pa", True),
        ("valves.valve.ports.supply.opening.fraction.3", True),
        ("valves.valve.spool.delay_s", False),
        ("reservoirs.supply.pressure_pa", True), ("taps.end.lag_s", False),
        ("cylinders.forearm.friction.coulomb_n", True), ("bodies.arm.elbow.viscous", True),
        ("pipes.tube.wall.nusselt", False), ("pipes.tube.volume_from_m3", False),
        ("chambers.tank.volume_m3", True),
    ],
)  # fmt: skip
def test_what_says_how_much_flows_is_slow(path: str, slow: bool) -> None:
    assert is_slow(FitParameter(path=path, lower=0.0, upper=1.0)) == slow


@pytest.mark.parametrize("weight", [1.0, 2.5])
def test_a_little_gain_is_little_for_what_the_readings_weigh(weight: float) -> None:
    """Half the square of four tenths of a standard error of each parameter."""
    least = 0.5 * 3 * (0.4 * weight) ** 2
    for gain, little in ((least * (1.0 - 1e-9), True), (least * (1.0 + 1e-9), False)):
        found = SimpleNamespace(
            history=[50.0 + gain, 51.0, 50.0], values=np.zeros(3), weight=weight
        )
        assert gained_little(found) == little  # type: ignore[arg-type]


@pytest.mark.long
def test_warnings_are_three_lines_at_most(
    calibrated: tuple[Rig, Recording, FitOutcome, Rig],
) -> None:
    assert len(calibrated[2].warnings) <= 4  # three on parameters, one on what was not visited


@pytest.mark.long
def test_what_was_known_beforehand_stays_that(
    calibrated: tuple[Rig, Recording, FitOutcome, Rig],
) -> None:
    """A list made on the way, as the spool got a limit, keeps the bounds of the datasheet."""
    _, _, outcome, datasheet = calibrated
    found = {p.path: p.model_copy(update={"std_error": None}) for p in outcome.parameters}
    assert any(".spool.max_" in path for path in found)
    assert [found[p.path] for p in parameters_of(datasheet)] == parameters_of(datasheet)


@pytest.mark.long
def test_a_spool_whose_position_was_recorded_is_fitted_to_it() -> None:
    """Its numbers come from the position alone, and the gas tells the rest."""
    rng = np.random.default_rng(7)
    rig = coarse("line", rng)
    recording = record(rig, rng, 125.0, 3.0, moving=False)
    spool = rig.valves["valve"].spool
    command = recording.commands["voltage"]
    at = np.arange(0.0, 2.9, 2e-3)
    seen = positions_along(spool_row(spool), command, 0.0, 2e-3, at.size)
    recording.positions["valve"] = Signal(at, seen + 0.01 * rng.normal(size=at.size))
    datasheet = rig.model_copy(deep=True)
    datasheet.valves["valve"].spool.bandwidth_hz = 1.4 * spool.bandwidth_hz
    outcome = fit_rig(
        datasheet, recording, few(rig, SUPPLY, EXHAUST, BANDWIDTH), approach=False, iterations=2
    )
    by_path = {p.path: (p, v) for p, v in zip(outcome.parameters, outcome.values, strict=True)}
    found, value = by_path[BANDWIDTH]
    assert abs(value - spool.bandwidth_hz) < 0.02 * spool.bandwidth_hz
    assert found.std_error < 0.01 * value
    assert by_path[SUPPLY][0].std_error is not None


@pytest.mark.long
@pytest.mark.parametrize("hold_out", [False, True])
def test_where_it_stops_short_it_says_where_and_what_would_help(hold_out: bool) -> None:
    """A lag of one sensor, which no calibration fits: the tap is named, and the effect."""
    rng = np.random.default_rng(5)
    truth = coarse("line", rng)
    lag = AttachedEffect(effect="sensor_lag", place="end", parameters={"lag_s": 8e-3})
    plant = truth.model_copy(update={"effects": [lag]})
    recording = record(plant, rng, 250.0, 3.0, moving=False)
    parameters = few(truth, SUPPLY, EXHAUST, BANDWIDTH)
    short = fit_rig(truth, recording, parameters, hold_out, approach=False, iterations=2).shortfall
    assert short is not None
    assert max(short.by_tap, key=short.by_tap.__getitem__) == "end"
    assert "stops short" in short.sentence and "end" in short.sentence
    assert any(line.startswith("end: most with") for line in short.where)
    assert any(line.startswith("sensor_lag@end would explain") for line in short.help)


def test_the_first_part_of_a_recording() -> None:
    rng = np.random.default_rng(6)
    recording = record(coarse("line", rng), rng, 125.0, 3.0, moving=True)
    part = recording.until(1.0)
    assert part.end_s <= 1.0 < recording.end_s
    assert part.commands["voltage"].time_s[0] == recording.commands["voltage"].time_s[0]
    assert recording.until(10.0) is recording


@pytest.mark.long
@pytest.mark.parametrize(("gain", "taken"), [(0.0, True), (1e-2, False)])
def test_the_rig_s_own_cells_have_the_last_word_near_the_noise(gain: float, taken: bool) -> None:
    """Where more is left, something is missing."""
    rig = load_rig(ROOT / "rigs/rig_b.yaml")
    rig = with_noise(rig, dict.fromkeys(rig.taps, 250.0))
    wrong = AttachedEffect(effect="sensor_gain", place="end", parameters={"error": gain})
    levels = np.random.default_rng(1).choice([0.0, 2.0, 5.0, 8.0, 10.0], 38)
    volts = {"voltage": np.repeat(levels, round(0.04 / plants.STEP_S))}
    hidden = wrong if gain else None
    recording = plants.record(plants.plant_of(rig, hidden), volts, "steep", 3)
    few = [p for p in parameters_of(rig) if p.path.endswith("out.position_m")]
    said: list[tuple[float, str]] = []

    def tell(stage: str, done: float | None = None, note: str = "") -> None:
        said.append((done or 0.0, note))

    fit_rig(rig, [recording], few, progress=tell)
    notes = {note for _, note in said}
    assert (OWN_CELLS in notes) == taken
    told = [done for done, _ in said if done]
    assert told == sorted(told) and told[-1] <= 1.0


@pytest.mark.long
def test_an_encoder_without_noise_does_not_outweigh_the_pressures() -> None:
    """What its model's cells get wrong of a joint would else be what flows are fitted to."""
    true = load_rig(ROOT / "rigs/rig_j.yaml")
    true = with_noise(true, dict.fromkeys(true.taps, 250.0))
    volts = plants.random_volts(true, limits_of(true), 3.0, 1)
    recording = plants.record(plants.plant_of(true), volts, "silent", 1)
    told = ("conductance_m3_s_pa", "mass_kg", "theta_inertia_kg_m2", "head.dead_volume_m3")
    few = [p for p in parameters_of(true) if p.path.endswith(told)]
    off = np.exp(np.random.default_rng(3).normal(0.0, 0.3, len(few)))
    truth = np.array([get_parameter(true, p.path) for p in few])
    sheet = {p.path: float(v) for p, v in zip(few, truth * off, strict=True)}
    found = fit_rig(with_parameters(true, sheet), [recording], few)
    assert found.rmse["elbow"] < 1e-4
    assert np.allclose(found.values, truth, rtol=1.5e-3)  # counting for all it may, 4e-3


@pytest.mark.parametrize(("horizon_s", "moves"), [(0.5, False), (0.15, True), (0.5, True)])
def test_what_flows_is_fitted_first_of_whatever_moves(horizon_s: float, moves: bool) -> None:
    """From a datasheet's flows a robot's joints are far off, and what they tell leads astray."""
    rig = load_rig(ROOT / "rigs" / ("kokoro.yaml" if moves else "rig_a.yaml"))
    rig.fit.horizon_s = horizon_s
    steps = steps_of(rig, approach=True, iterations=8)
    assert steps[0].slow and steps[0].part
    assert (steps[0].pull_s or 0.0) <= (pull_of(rig) or 0.0)


@pytest.mark.parametrize(("dx_m", "longer"), [(0.2, 1.0), (0.05, None), (0.01, 4.0)])
def test_first_steps_are_on_longer_cells_as_long_as_twenty_are_left(
    dx_m: float, longer: float | None
) -> None:
    rig = load_rig(ROOT / "rigs" / "rig_a.yaml")
    rig.grid.dx_m = dx_m
    for pipe in rig.pipes.values():
        pipe.dx_m = None
    first, *_ = steps_of(rig, approach=True, iterations=8)
    ratio = first.dx_m / dx_m
    if longer is None:
        assert 1.0 < ratio < 4.0 and cells_of(rig, first.dx_m) == pytest.approx(20, abs=3)
    else:
        assert ratio == pytest.approx(longer)
