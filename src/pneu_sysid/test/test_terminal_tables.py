# SPDX-License-Identifier: Apache-2.0
"""Every cell of the tables that commands print against their result, by heading and row."""

import functools
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Group
from studies.dragged import draw_case, write_case
from tests.distinct_results import BUILD, ENCODERS, MODELS, TAPS, Distinct, head, units_of
from tests.pages import check, shown

from pneu_common.tables import NamedTable
from pneu_sim.effects import find_effect
from pneu_sim.observe.drifts import Unknown
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import FitParameter
from pneu_sysid.command.diagnose import diagnosis_table
from pneu_sysid.command.fit import fitted_table, parameter_list
from pneu_sysid.command.tables import error_table, step_table
from pneu_sysid.compare import compare_table, recordings_table
from pneu_sysid.contacts import commands as scenes
from pneu_sysid.contacts.candidates import SceneScore
from pneu_sysid.contacts.diagnose import Finalist
from pneu_sysid.contacts.effects import find_scene_effect
from pneu_sysid.contacts.estimate import Parameter
from pneu_sysid.contacts.table_commands import cross_tables, left_out_table, spread_table
from pneu_sysid.contacts.tables import Cross, LeftOut, Spread
from pneu_sysid.design.command import experiments_table
from pneu_sysid.design.command import tables as plan_tables
from pneu_sysid.design.plan import Bounds, Expected, Plan, Separation
from pneu_sysid.diagnose import Diagnosis
from pneu_sysid.observed.command import rows_of
from pneu_sysid.observed.command import tables as observe_tables
from pneu_sysid.observed.figures import draw_observed
from pneu_sysid.observed.follow import Followed
from pneu_sysid.observed.summary import NINETY, summary_of
from pneu_sysid.refits import Refit
from pneu_sysid.results.observe import Drifting, ObservedSensor, ObserveResult, Said
from pneu_sysid.results.scenes import (
    Misread,
    SceneCompareResult,
    SceneFitResult,
    SceneLearnResult,
    SceneParameter,
    SceneStep,
)
from pneu_sysid.seals.identify import identify
from pneu_sysid.seals.reading import read_drag
from pneu_sysid.seals.words import result_of_friction, tables_of
from pneu_sysid.sites import Site

HOUSE = Path(__file__).parents[3]
TOLD = {"Pa": ("Pa", 1.0), "rad": ("mrad", 1e3), "m": ("mm", 1e3)}

both = pytest.mark.parametrize("mixed", [False, True], ids=["taps", "with encoders"])


@functools.cache
def result(command: str, mixed: bool) -> Any:
    return BUILD[command](mixed)


def at(table: NamedTable, row: tuple[str, ...], heading: str) -> str:
    """The cell of a row below a heading that stands once."""
    found = [k for k, column in enumerate(table.columns) if column.heading == heading]
    assert len(found) == 1, f"{heading!r} in {[c.heading for c in table.columns]}"
    return row[found[0]]


def check_unit(table: NamedTable, row: tuple[str, ...], sensor: str, mixed: bool, name: str) -> Any:
    """Factor from SI, and the cell of a heading, the unit being there or in a column."""
    unit, scale = TOLD[units_of(mixed)[sensor]]
    if mixed:
        assert at(table, row, "unit") == unit
        return scale, at(table, row, name)
    return scale, at(table, row, f"{name} Pa")


def parts_of(mixed: bool) -> list[NamedTable]:
    group = compare_table(result("compare", mixed))
    assert isinstance(group, Group)
    return [part for part in group.renderables if isinstance(part, NamedTable)]


@both
def test_errors_of_a_comparison(mixed: bool) -> None:
    table = parts_of(mixed)[0]
    rows = iter(table.rows)
    for model in result("compare", mixed).models:
        for k, sensor in enumerate(units_of(mixed)):
            row, error = next(rows), model.sensors[sensor]
            assert at(table, row, "model") == ("" if k else f"{model.name} ({model.model})")
            assert at(table, row, "sensor" if mixed else "tap") == sensor
            for name, value in (("RMSE", error.rmse), ("bias", error.bias)):
                scale, text = check_unit(table, row, sensor, mixed, name)
                check(text, scale * value)
            check(at(table, row, "atm"), getattr(error, "rmse_atm", None))
            check(at(table, row, "% of std"), 100.0 * error.normalised)
            check(at(table, row, "x noise"), error.times_noise)
            check(at(table, row, "lag ms"), 1e3 * error.lag_s)
            check(at(table, row, "gain"), error.gain)
            signed = check_unit(table, row, sensor, mixed, "bias")[1], at(table, row, "lag ms")
            assert all(text[0] in "+-" for text in signed)
    assert next(rows, None) is None
    assert table.note.startswith("Bias is measured minus model; a positive lag: the measurement")


@both
def test_worst_regimes_of_a_comparison(mixed: bool) -> None:
    table = parts_of(mixed)[2]
    rows = iter(table.rows)
    for model in result("compare", mixed).models:
        kinds = ("flow_direction", "pressure", "frequency")
        for k, kind in enumerate(kinds):
            own = [r for r in model.all_regimes if r.kind == kind]
            worst = max(own, key=lambda r: r.times_noise)
            row = next(r for r in [next(rows)])
            assert at(table, row, "model") == ("" if k else model.name)
            assert at(table, row, "by").split()[0] in kind.split("_")
            assert at(table, row, "regime") == worst.label
            sensor = at(table, row, "sensor" if mixed else "tap")
            assert sensor == worst.sensor
            for name, value in (("RMSE", worst.rmse), ("bias", worst.bias)):
                scale, text = check_unit(table, row, sensor, mixed, name)
                check(text, None if value is None else scale * value)
            check(at(table, row, "x noise"), worst.times_noise)
            check(at(table, row, "share %"), 100.0 * worst.share, 0.2)
    assert next(rows, None) is None


@both
def test_worst_stretches_of_a_comparison(mixed: bool) -> None:
    table = parts_of(mixed)[3]
    given = result("compare", mixed)
    rows = iter(table.rows)
    for model in given.models:
        stretches = [
            (s.rmse / given.noise_of[name], name, s)
            for name, e in model.sensors.items()
            for s in e.worst
        ]
        stretches.sort(key=lambda one: -one[0])
        left = list(stretches)
        count = 0
        while left and count < 5:
            _, sensor, worst = left[0]
            together = [
                one
                for one in left
                if one[2].recording == worst.recording
                and one[2].start_s < worst.end_s
                and worst.start_s < one[2].end_s
            ]
            left = [one for one in left if one not in together]
            row = next(rows)
            assert at(table, row, "model") == ("" if count else model.name)
            names = at(table, row, "sensor" if mixed else "tap").split(", ")
            assert names == list(dict.fromkeys(name for _, name, _ in together))
            check(at(table, row, "from s"), worst.start_s)
            check(at(table, row, "to s"), worst.end_s)
            scale, text = check_unit(table, row, sensor, mixed, "RMSE")
            check(text, scale * worst.rmse)
            assert at(table, row, "what the valve did") == f"{worst.recording}: {worst.doing}"
            count += 1
    assert next(rows, None) is None


def test_models_on_recordings() -> None:
    given = result("compare", False)
    table = recordings_table(given)
    assert [row[0] for row in table.rows] == given.recordings
    for row in table.rows:
        for model in given.models:
            check(at(table, row, model.name), model.by_recording[row[0]])
    assert [c.heading for c in table.columns] == ["recording", *MODELS]


def test_fitted_parameters() -> None:
    """Of curves the points are counted, and what is not identified is left out."""
    given = result("fit", False)
    points = [
        given.parameters[0].model_copy(update={"path": f"valves.v.opening.fraction.{k}"})
        for k in range(3)
    ]
    each = given.parameters[1].model_copy(
        update={"path": "reservoirs.supply.pressure_pa", "recording": "run 4", "value": -12.5}
    )
    given = given.model_copy(update={"parameters": [*points, *given.parameters, each]})
    table = fitted_table("title", given)
    shown_ = [p for p in given.parameters[3:] if p.identified or p.held]
    assert len(shown_) < len(given.parameters) - 3
    assert len(table.rows) == len(shown_) + 1
    for row, p in zip(table.rows, shown_, strict=False):
        name = p.path if p.recording is None else f"{p.path} in {p.recording}"
        assert at(table, row, "parameter") == name
        check(at(table, row, "start"), p.start, digits=5)
        check(at(table, row, "value"), p.value, digits=5)
        check(at(table, row, "std. error"), p.std_error, digits=2)
        text = re.fullmatch(r"(\S+) \((\S+) to (\S+)\)", at(table, row, "expected"))
        assert text
        check(text[1], p.expected_error, digits=2)
        for k in (0, 1):
            check(text[2 + k], p.expected_range[k], digits=2)
        assert at(table, row, "unit") == (p.unit or "-")
        assert at(table, row, "") == ("held" if p.held else "at bound" if p.at_bound else "")
    assert table.rows[-1][0] == "valves.v.opening: 3 points"


def test_list_of_what_would_be_fitted() -> None:
    rig = load_rig(HOUSE / "rigs" / "rig_a.yaml")
    wanted = [
        FitParameter(path="pipes.tube.area_m2", lower=1.25e-6, upper=7.5e-5, std=3.1e-6),
        FitParameter(path="pipes.tube.friction_gain", lower=-0.5, upper=4.0),
    ]
    table = parameter_list(rig, wanted)
    for row, p in zip(table.rows, wanted, strict=True):
        assert at(table, row, "path") == p.path
        check(at(table, row, "lower"), p.lower, digits=4)
        check(at(table, row, "upper"), p.upper, digits=4)
    assert [at(table, row, "uncertain by") for row in table.rows] == ["3.1e-06", "all of it"]
    assert at(table, table.rows[0], "unit") == "m^2"


@both
def test_errors_of_a_fit(mixed: bool) -> None:
    given = result("fit", mixed)
    columns = {"noise": given.noise_of, "fitted": given.rmse_of, "held out": given.held_out_rmse_of}
    table = error_table("title", columns, given.encoders)
    for row, sensor in zip(table.rows, units_of(mixed), strict=True):
        assert at(table, row, "sensor" if mixed else "tap") == sensor
        unit, scale = TOLD[units_of(mixed)[sensor]]
        if mixed:
            assert at(table, row, "unit") == unit
        for name, values in columns.items():
            check(at(table, row, name if mixed else f"{name}, Pa"), scale * values[sensor], 0.1)
    assert given.rmse_of == {**given.rmse_pa, **given.rmse}
    assert given.held_out_rmse_of == {**given.held_out_rmse_pa, **given.held_out_rmse}


@both
def test_errors_after_each_step(mixed: bool) -> None:
    steps = result("learn", mixed).steps
    table = step_table(steps, ENCODERS if mixed else {})
    assert table.title.startswith("held-out error per")
    for row, step in zip(table.rows, steps, strict=True):
        held = {**step.held_out_rmse_pa, **step.held_out_rmse}
        for sensor, value in held.items():
            unit, scale = TOLD[units_of(mixed)[sensor]]
            assert mixed or table.title.endswith(f", {unit}")
            check(at(table, row, f"{sensor}, {unit}" if mixed else sensor), scale * value)
        check(at(table, row, "times noise"), step.held_out_times_noise)
        if step.added is None:
            assert at(table, row, "added") == "nothing yet" and at(table, row, "strength") == ""
            continue
        assert at(table, row, "added") == f"{step.added}@{step.place}"
        value, _, rest = at(table, row, "strength").partition(" ± ")
        check(value, step.strength, digits=3)
        error, _, unit = rest.partition(" ")
        check(error, step.std_error, digits=1)
        assert unit == step.unit


def test_candidates_of_a_diagnosis() -> None:
    rig = load_rig(HOUSE / "rigs" / "rig_a.yaml")
    draw = Distinct()
    leak, lag = find_effect("leak"), find_effect("sensor_lag")
    sites = [
        Site(lag, "end", {}),
        Site(leak, "tube", {"position_m": 1.25}),
        Site(lag, "middle", {}),
    ]
    none = np.zeros((1, 1))
    finalists = [
        Refit(
            site=site, strength=draw(0.01, signed=True), std_error=draw(1e-3), t=draw(9.0),
            position_error_m=None, explained=draw.share(), held_out=draw.share() - 0.5 * (k == 2),
            score_explained=draw.share(), residual=none, change=none, rig=rig,
        )
        for k, site in enumerate(sites)
    ]  # fmt: skip
    assert finalists[2].held_out < 0.0
    tied = [["leak@tube:1.25", "sensor_lag@middle"], ["sensor_lag@end"], []]
    found = Diagnosis(
        verdict="ambiguous", sentence="", finalists=finalists, believed=2, tied=tied, scores=[],
        rmse={}, depends_on=[], excess=1.0, left_over=1.0, numerics=None, bench=None,
    )  # type: ignore[arg-type]  # fmt: skip
    table = diagnosis_table(found)
    for row, one, others in zip(table.rows, finalists, tied, strict=True):
        assert at(table, row, "effect") == one.site.effect.name
        assert at(table, row, "place") == one.site.label.partition("@")[2]
        value, _, rest = at(table, row, "strength").partition(" ± ")
        check(value, one.strength, digits=3)
        check(rest.partition(" ")[0], one.std_error, digits=1)
        assert rest.partition(" ")[2] == ("s" if one.site.effect is lag else "m^2, effective")
        for name, share in (("score", one.score_explained), ("refit", one.explained),
                            ("held out", one.held_out)):  # fmt: skip
            check(at(table, row, name).removesuffix(" %"), 100.0 * share, 0.3)
        check(at(table, row, "t"), one.t)
        assert at(table, row, "not to be told from") == ", ".join(others)


def test_experiments() -> None:
    experiments = result("learn", False).experiments
    table = experiments_table(experiments)
    rows = iter(table.rows)
    for one in experiments:
        for pair in one.told_apart:
            row = next(rows)
            assert at(table, row, "plan") == Path(one.plan).name
            assert (at(table, row, "one"), at(table, row, "other")) == (pair.one, pair.other)
            for name in ("expected", "found", "needed"):
                check(at(table, row, name), getattr(pair, name), 0.2)
        if not one.told_apart:
            assert next(rows) == (Path(one.plan).name, one.kind, "", "-", "-", "-")
    assert next(rows, None) is None


def test_promises_of_a_plan() -> None:
    separations = [
        Separation(one="a", other="b", standard_errors=5.3, needed=3.0, told_apart=True),
        Separation(one="c", other="d", standard_errors=-1.7, needed=4.5, told_apart=False),
        Separation(one="e", other="f", standard_errors=None, needed=3.5, told_apart=False),
    ]
    errors: dict[str, float | None] = {"pipes.tube.area_m2": 3.2e-7, "x": 0.41, "y": None}
    ranges = {"pipes.tube.area_m2": [1.5e-7, 8.7e-7]}
    expected = Expected.model_construct(
        separations=separations, std_errors=errors, std_errors_range=ranges, words=[]
    )
    plan = Plan.model_construct(expected=expected, limits=Bounds.model_construct())
    apart, promised = plan_tables(plan)
    for row, one in zip(apart.rows, separations, strict=True):
        assert (at(apart, row, "one"), at(apart, row, "other")) == (one.one, one.other)
        check(at(apart, row, "standard errors"), one.standard_errors)
        check(at(apart, row, "needed"), one.needed, 0.2)
    for row, (name, error) in zip(promised.rows, errors.items(), strict=True):
        assert at(promised, row, "parameter") == name
        least, greatest = ranges.get(name, [error, error])
        for heading, value in (("error", error), ("least", least), ("greatest", greatest)):
            check(at(promised, row, heading), value, digits=3)


def test_friction_of_a_seal(tmp_path: Path) -> None:
    """The tables against the JSON result, and both against what was identified."""
    case = replace(
        draw_case("growing", 0), gauge_bar=(5.0, 2.0), speed_m_s=(0.02, 0.02), cycles=3,
        noise_n=0.05,
    )  # fmt: skip
    file, paths = write_case(case, tmp_path)
    rig = load_rig(file)
    tests = [read_drag(rig, path) for path in paths]
    found = identify(rig, tests)
    # numbers in which the ways, the models and the levels differ by much
    draw = Distinct()
    steps = [
        replace(
            step,
            rmse_n=draw(2.0),
            held_out_n=None if k == 1 else draw(2.0),
            by_level=np.array([[draw(2.0), draw(2.0)] for _ in range(2)]),
        )
        for k, step in enumerate(found.steps)
    ]
    assert len(steps) >= 2
    found = replace(found, steps=steps, noise_n=0.37)
    given = result_of_friction(rig, "rig.yaml", None, tests, found)
    levels, terms = tables_of(found)
    pressures = [level.gauge_pa for level in given.levels]
    assert pressures == sorted(level.gauge_pa for level in found.pieces.levels)
    for row, level in zip(levels.rows, given.levels, strict=True):
        index = [one.gauge_pa for one in found.pieces.levels].index(level.gauge_pa)
        assert at(levels, row, "recording") == level.name == found.pieces.levels[index].name
        check(at(levels, row, "bar"), 1e-5 * level.gauge_pa)
        check(at(levels, row, "cycles"), level.cycles, 0.2)
        for model, values, step in (
            ("without", level.without_n, steps[0]),
            ("left", level.with_n, steps[-1]),
        ):
            for way, value, own in zip(("in", "out"), values, step.by_level[index], strict=True):
                assert value == own
                check(at(levels, row, f"{model}, {way}"), value)
        check(at(levels, row, "noise"), level.noise_n)
        half, _, spread = at(levels, row, "half difference").partition(" ± ")
        check(half, level.half_difference_n)
        check(spread, level.spread_n, 0.5)
        check(at(levels, row, "named"), level.friction_n)
    assert "rod pressed in, drawn out" in levels.title
    for row, step, own in zip(terms.rows, given.steps, steps, strict=True):
        assert at(terms, row, "added") == (step.added or "nothing yet")
        assert (step.rmse_n, step.held_out_rmse_n) == (own.rmse_n, own.held_out_n)
        check(at(terms, row, "error, N"), own.rmse_n)
        check(at(terms, row, "on strokes kept aside, N"), own.held_out_n)
        judged = own.rmse_n if own.held_out_n is None else own.held_out_n
        check(at(terms, row, "times noise"), judged / 0.37, 0.2)


def observed(mixed: bool) -> ObserveResult:
    draw = Distinct()
    sensors = [
        ObservedSensor(
            name=name, used=k != 1, rmse=None if k == 2 else draw(typical),
            times_noise=None if k == 2 else draw(2.0), within_90=None if k == 2 else draw.share(),
            std=draw(typical),
        )
        for k, (name, unit) in enumerate(units_of(mixed).items())
        for typical in [{"Pa": 900.0, "rad": 3e-3, "m": 3e-4}[unit]]
    ]  # fmt: skip
    said = [
        Said(kind="model", subject="It leaks by", start_s=1.25, end_s=2.0, words="It leaks by 3"),
        Said(kind="sensor", subject="end", start_s=1.5, end_s=4.75, words="late by 2 ms"),
        Said(kind="model", subject="It leaks by", start_s=6.0, end_s=9.5, words="It leaks by 7"),
    ]
    drifting = [
        Drifting(name="pipes.tube: leak", unit="m^2", value=-3.2e-9, std=5.1e-10, times=-0.32),
        Drifting(name="valves.v: null", unit="V", value=0.041, std=0.0077, times=2.3),
    ]
    return ObserveResult(
        **head(mixed), rig="rig.yaml", begin_s=0.75, smooth_s=0.025, observed=sensors, said=said,
        drifting=drifting,
    )  # fmt: skip


@both
def test_what_an_observer_says(mixed: bool) -> None:
    given = observed(mixed)
    errors, said, drifting = observe_tables(given)
    assert "from 0.75 s on, 0.025 s later" in errors.title
    for row, one in zip(errors.rows, given.observed, strict=True):
        assert at(errors, row, "sensor") == one.name
        assert at(errors, row, "readings") == ("taken" if one.used else "only compared")
        unit, scale = TOLD[units_of(mixed)[one.name]]
        assert at(errors, row, "unit") == unit
        check(at(errors, row, "error"), None if one.rmse is None else scale * one.rmse)
        check(at(errors, row, "its own std."), scale * one.std)
        check(at(errors, row, "times noise"), one.times_noise)
        share = None if one.within_90 is None else 100.0 * one.within_90
        check(at(errors, row, "within 90 %").removesuffix(" %"), share)
    # what was said of one thing stands together: when first, when last, and for how long
    assert [c.heading for c in said.columns] == ["first [s]", "last [s]", "for [s]", "at last"]
    assert said.rows == [
        ("1.25", "9.50", "4.25", "It leaks by 7"),
        ("1.50", "4.75", "3.25", "end: late by 2 ms"),
    ]
    for row, drift in zip(drifting.rows, given.drifting, strict=True):
        assert (at(drifting, row, "what"), at(drifting, row, "unit")) == (drift.name, drift.unit)
        check(at(drifting, row, "off by"), drift.value, digits=3)
        check(at(drifting, row, "its std."), drift.std, digits=2)
        check(at(drifting, row, "of what is allowed"), drift.times, 0.2)


def followed() -> Followed:
    """An observer along 2 s, with readings that lie on both sides of what it says."""
    rng = np.random.default_rng(6)
    time_s = np.arange(0.0, 2.0, 0.01)
    n = time_s.size
    names = ("supply", "valve_out", "middle", "end", "exhaust")
    mean = {name: 1e5 + 1e4 * k + 1e3 * rng.normal(size=n) for k, name in enumerate(names)}
    std = {name: 100.0 * (1 + k) * rng.uniform(0.5, 1.5, n) for k, name in enumerate(names)}
    read = {k: v + 300.0 + 400.0 * rng.normal(size=n) for k, v in mean.items() if k != "middle"}
    read["end"][150:170] = np.nan
    read["supply"][:40] += 1e6  # before errors count
    wrong = [["It leaks by 3 mm^2"] if 100 <= k < 120 else [] for k in range(n)]
    matter = [{"end": "late by 2 ms"} if 60 <= k < 90 else {} for k in range(n)]
    drifts = [
        (Unknown("pipes.tube: leak", "m^2", "leak", 0, 4e-9, 60.0), 3e-9, 2e-10),
        (Unknown("valves.v: null", "V", "null", 0, 0.02, 30.0), -0.05, 0.003),
    ]
    return Followed(time_s, read, mean, std, wrong, matter, drifts)


NOISE = {"supply": 310.0, "valve_out": 250.0, "middle": 270.0, "end": 190.0, "exhaust": 230.0}


def test_figures_of_an_observer() -> None:
    """Computed once more from what it says: errors, ratios to the noise, shares, spans, drifts."""
    rig = load_rig(HOUSE / "rigs" / "rig_a.yaml")
    found = followed()
    given = summary_of(rig, "rig.yaml", "run", found, ["supply", "end"], NOISE, ["odd"], 0.02)
    assert given.begin_s == pytest.approx(0.2 * 1.99)
    late = found.time_s >= given.begin_s
    for one in given.observed:
        assert one.used == (one.name in ("supply", "end"))
        check(f"{one.std:.6g}", float(np.sqrt(np.mean(found.std[one.name][late] ** 2))))
        if one.name == "middle":
            assert (one.rmse, one.times_noise, one.within_90) == (None, None, None)
            continue
        off = (found.read[one.name] - found.mean[one.name])[late]
        wide = 1.645 * np.hypot(found.std[one.name][late], NOISE[one.name])
        seen = np.isfinite(off)
        assert one.rmse == pytest.approx(np.sqrt(np.mean(off[seen] ** 2)))
        assert one.times_noise == pytest.approx(one.rmse / NOISE[one.name])
        assert one.within_90 == pytest.approx(np.mean(np.abs(off[seen]) < wide[seen]))
        assert 0.0 < one.within_90 < 1.0
    spans = [(s.kind, s.subject, round(s.start_s, 6), round(s.end_s, 6)) for s in given.said]
    assert spans == [("sensor", "end", 0.6, 0.89), ("model", "It leaks by", 1.0, 1.19)]
    for drift, (unknown, value, std) in zip(given.drifting, found.drifts, strict=True):
        assert (drift.name, drift.unit) == (unknown.name, unknown.unit)
        assert (drift.value, drift.std) == (value, std)
        assert drift.times == pytest.approx(value / unknown.std)
    assert given.noise_floor_pa == NOISE and given.findings == ["odd"]


def test_rows_of_an_observer() -> None:
    found = followed()
    lines = rows_of(found).splitlines()
    names = lines[0].split(",")
    table = np.genfromtxt(lines[1:], delimiter=",")
    assert table.shape == (200, 16)
    for name in found.mean:
        for part, values in (("", found.mean), (".std", found.std), (".read", found.read)):
            own = values.get(name, np.full(200, np.nan))
            np.testing.assert_allclose(table[:, names.index(name + part)], own, rtol=1e-8)
    np.testing.assert_allclose(table[:, names.index("time_s")], found.time_s)


def test_picture_of_an_observer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is drawn: readings, estimates, errors with their sign, and intervals about zero."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    rig = load_rig(HOUSE / "rigs" / "rig_a.yaml")
    found = followed()
    given = summary_of(rig, "rig.yaml", "run", found, ["supply", "end"], NOISE)
    figures: list[Any] = []
    close = pyplot.close
    monkeypatch.setattr(pyplot, "close", figures.append)
    draw_observed(found, given, tmp_path / "o.png")
    figure = figures[0]
    for k, one in enumerate(given.observed):
        left, right = figure.axes[2 * k : 2 * k + 2]
        assert left.get_ylabel() == f"{one.name}, kPa"
        taken = "its readings taken" if one.used else "never shown to the observer"
        assert left.get_title() == taken
        lines = {line.get_label(): line.get_ydata() for line in left.lines}
        read = found.read.get(one.name, np.full(200, np.nan))
        np.testing.assert_allclose(lines["recorded"], 1e-3 * read)
        np.testing.assert_allclose(lines["observed"], 1e-3 * found.mean[one.name])
        error, low, high = (line.get_ydata() for line in right.lines)
        np.testing.assert_allclose(error, 1e-3 * (read - found.mean[one.name]), atol=1e-9)
        wide = 1e-3 * NINETY * np.hypot(found.std[one.name], NOISE[one.name])
        np.testing.assert_allclose(low, -wide)
        np.testing.assert_allclose(high, wide)
        if one.rmse is None:
            assert right.get_title() == "not recorded"
        else:
            words = re.fullmatch(
                r"error (\S+) times the noise, (\S+) % within the intervals", right.get_title()
            )
            assert words
            check(words[1], one.times_noise)
            check(words[2], 100.0 * (one.within_90 or 0.0))
        spans = sorted(patch.get_extents().x0 for patch in right.patches)
        assert len(spans) == (2 if one.name == "end" else 1)
    close(figure)


def scene_head() -> dict[str, Any]:
    return {
        "pneu_version": "1", "scene": "scene.yaml", "recordings": ["first", "second", "third"],
        "sensors": {"position": "m", "orientation": "rad"},
    }  # fmt: skip


def test_scenes_that_are_compared() -> None:
    draw = Distinct()
    results = []
    for name in ("as it is", "better"):
        off: dict[str, dict[str, Misread]] = {
            recording: {
                sensor: Misread(mean=draw(0.3), rms=draw(0.3), last=draw(0.3))
                for sensor in ("position", "orientation")
            }
            for recording in ("first", "second", "third")
        }
        if name == "better":
            off["second"]["position"] = Misread(mean=None, rms=None, last=None)
        one = SceneCompareResult(
            **scene_head(), start_s=0.1, off=off,
            mean={"position": draw(0.3), "orientation": draw(0.3)},
            median={"position": draw(0.3), "orientation": draw(0.3)},
        )  # fmt: skip
        results.append((name, one))
    table = scenes.misread_table(results)
    wanted = [(name, r, sensor) for name, r in results for sensor in r.sensors]
    for row, (name, one, sensor) in zip(table.rows, wanted, strict=True):
        assert (at(table, row, "scene"), at(table, row, "sensor")) == (name, sensor)
        assert at(table, row, "unit") == one.sensors[sensor]
        check(at(table, row, "mean"), one.mean[sensor], digits=4)
        check(at(table, row, "median"), one.median[sensor], digits=4)
        each = {r: misread[sensor].mean for r, misread in one.off.items()}
        if None in each.values():
            assert (at(table, row, "worst"), at(table, row, "in")) == ("ran away", "second")
            continue
        worst = max(each, key=lambda r, each=each: each[r] or 0.0)
        assert at(table, row, "in") == worst
        check(at(table, row, "worst"), each[worst], digits=4)


def test_parameters_and_steps_of_a_scene() -> None:
    draw = Distinct()
    parameters = [
        SceneParameter(
            effect=f"effect_{k}", place=f"place_{k}", value=draw(1.0, True), start=draw(1.0, True),
            std_error=None if k == 1 else draw(0.1), unit=("N s/m", "", "kg")[k], at_bound=k == 2,
        )
        for k in range(3)
    ]  # fmt: skip
    unknown = parameters[0].model_copy(update={"value": None, "start": None})
    fit = SceneFitResult(
        **scene_head(), output=None, parameters=[*parameters, unknown], unknowns=7, history=[],
        converged=True, loss={}, force={}, rmse={},
    )  # fmt: skip
    table = scenes.parameter_table(fit, "title")
    for row, p in zip(table.rows, fit.parameters, strict=True):
        assert at(table, row, "parameter") == f"{p.effect}@{p.place}"
        check(at(table, row, "start"), p.start, digits=5)
        check(at(table, row, "value"), p.value, digits=5)
        check(at(table, row, "std. error"), p.std_error, digits=2)
        assert at(table, row, "unit") == (p.unit or "-")
        assert at(table, row, "") == ("at bound" if p.at_bound else "")
    steps = [
        SceneStep(step=0, added=None, held_out_loss=4.31),
        SceneStep(step=1, added="drag", place="air", strength=-0.21, std_error=0.03, unit="N s/m",
                  held_out_loss=0.217),
        SceneStep(step=2, added="mass", place="cube", strength=1.7, std_error=0.4, unit="",
                  held_out_loss=None),
    ]  # fmt: skip
    learned = SceneLearnResult(
        **scene_head(), steps=steps, verdict="effect", sentence="", output=None
    )
    table = scenes.step_table(learned)
    assert [at(table, row, "added") for row in table.rows] == ["nothing yet", "drag@air",
                                                               "mass@cube"]  # fmt: skip
    assert [at(table, row, "strength") for row in table.rows] == [
        "",
        "-0.21 ± 0.03 N s/m",
        "1.7 ± 0.4",
    ]
    for row, step in zip(table.rows, steps, strict=True):
        check(at(table, row, "cost"), step.held_out_loss, digits=4)


def test_candidates_of_a_scene() -> None:
    draw = Distinct()
    found = []
    for k, (name, place) in enumerate([("air_drag", "air"), ("sensor_scale", "position")]):
        parameter = Parameter(find_scene_effect(name), place, 0.0, 1.0)
        score = SceneScore(parameter, draw(1.0), draw(1.0), draw(30.0), draw.share())
        empty = np.zeros(0)
        found.append(
            Finalist(
                score, None, draw(0.1, True), draw(0.01), empty, draw.share() - 0.6 * k,
                draw.share(), empty, empty, draw(4.0), ["other@there"] if k else [],
            )  # type: ignore[arg-type]
        )  # fmt: skip
    table = scenes.candidate_table(SimpleNamespace(finalists=found))  # type: ignore[arg-type]
    for row, one in zip(table.rows, found, strict=True):
        p = one.score.parameter
        assert (at(table, row, "effect"), at(table, row, "place")) == (p.effect.name, p.place)
        value, _, rest = at(table, row, "strength").partition(" ± ")
        check(value, one.strength, digits=3)
        check(rest.partition(" ")[0], one.std_error, digits=1)
        assert rest.partition(" ")[2] == p.effect.unit
        check(at(table, row, "score"), one.score.gain, digits=3)
        check(at(table, row, "held out").removesuffix(" %"), 100.0 * one.gain, 0.3)
        check(at(table, row, "t"), one.lead, 0.2)
        assert at(table, row, "not to be told from") == ", ".join(one.alike)


def test_tables_of_how_far_a_scene_is_to_be_trusted() -> None:
    rng = np.random.default_rng(8)
    values, costs = rng.normal(size=(2, 3)), np.array([[2.13, 3.37], [7.71, 5.02]])
    manual = rng.uniform(10.0, 90.0, 2)
    crossed = Cross(["first", "second"], ["a", "b", "c"], values, manual, costs)
    found, cost = cross_tables(crossed)
    for k, name in enumerate(crossed.names):
        row = found.rows[k]
        assert at(found, row, "recording") == name
        for j, label in enumerate(crossed.labels):
            check(at(found, row, label), values[k, j], digits=4)
        row = cost.rows[k]
        assert at(cost, row, "recording") == name
        check(at(cost, row, "the scene's"), manual[k], digits=4)
        for j, other in enumerate(crossed.names):
            check(at(cost, row, f"of {other}"), costs[k, j], digits=4)
    # of a recording with another's parameters, over that with its own
    assert crossed.worst == pytest.approx(max(costs[0, 1] / costs[0, 0], costs[1, 0] / costs[1, 1]))
    own = [manual[0] / costs[0, 0], manual[1] / costs[1, 1]]
    assert crossed.gain == pytest.approx(min(own))
    left = [LeftOut("force", 0.37, 5.9, 0.11), LeftOut("x", 2.1, 0.0, 1.3)]
    table = left_out_table(left)
    for row, one in zip(table.rows, left, strict=True):
        assert at(table, row, "sensor") == one.sensor
        check(at(table, row, "error without it"), one.rmse, digits=4)
        check(at(table, row, "error with it"), one.with_it, digits=4)
        text = at(table, row, "error of its range").removesuffix(" %")
        check(text, 100.0 * one.rmse / one.span if one.span else None)
    check(at(table, table.rows[0], "its range"), 5.9, digits=4)
    spread = Spread(["a", "b"], rng.normal(size=(5, 2)), np.array([3.0, 3.05, 9.0, 3.07, 4.0]))
    table = spread_table("title", spread)
    assert table.title == "5 starts, title"
    rows = {"cost": spread.costs, "a": spread.values[:, 0], "b": spread.values[:, 1]}
    for row, (name, own_values) in zip(table.rows, rows.items(), strict=True):
        assert row[0] == name
        check(at(table, row, "mean"), float(np.mean(own_values)), digits=5)
        check(at(table, row, "std. deviation"), float(np.std(own_values)), digits=2)
    assert spread.same == pytest.approx(0.4)


def test_numbers_of_texts_are_read_as_people_read_them() -> None:
    """The reader of cells itself: signs, powers, digits."""
    assert shown("−1.50×10⁻⁸ m²") == (pytest.approx(-1.5e-8), pytest.approx(5e-11))
    assert shown("+0.25") == (0.25, pytest.approx(0.005))
    assert shown("3.1e-06 m")[0] == pytest.approx(3.1e-6)
    for text, value in (
        ("12.3", 12.36),
        ("-12.3", 12.3),
        ("12.3", -12.3),
        ("–", 1.0),
        ("0.0", 0.04),
    ):
        with pytest.raises(AssertionError):
            check(text, value)
    assert len(TAPS) == 3
