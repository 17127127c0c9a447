# SPDX-License-Identifier: Apache-2.0
"""Subcommands of `pneu` that work on a recording: fit, compare, diagnose, add, learn, friction.

The numerics are imported by the command that uses them: `pneu --help` does without.
"""

import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from pneu_common.errors import InputError
from pneu_common.options import Force
from pneu_common.outputs import check_folder, check_output
from pneu_common.progress import progress
from pneu_common.tables import Column, NamedTable
from pneu_sysid.contacts.table_commands import contacts
from pneu_sysid.design.command import excite
from pneu_sysid.observed.command import observe

if TYPE_CHECKING:
    from pneu_sim.rig.schema import FitParameter, Rig
    from pneu_sysid.design.plan import Plan
    from pneu_sysid.diagnose import Diagnosis
    from pneu_sysid.fit import FitOutcome
    from pneu_sysid.records import Recording
    from pneu_sysid.results.fit import FitResult
    from pneu_sysid.results.head import Head
    from pneu_sysid.results.learn import Step

BagPaths = Annotated[
    list[Path],
    typer.Argument(
        metavar="BAG...", help="rosbag2 folders, .mcap files, or text recordings, of one rig."
    ),
]
RigPath = Annotated[
    Path, typer.Option("--rig", help="Rig file, or scene file (YAML).", show_default=False)
]
JsonPath = Annotated[
    Path | None, typer.Option("--json", help="Write the result as JSON.", show_default=False)
]
HtmlPath = Annotated[
    Path | None, typer.Option("--report", help="Write an HTML report.", show_default=False)
]
EffectsPath = Annotated[
    Path | None,
    typer.Option("--effects", help="Python file with effects of your own.", show_default=False),
]
KeptAside = Annotated[
    list[str] | None,
    typer.Option(
        "--aside",
        metavar="FROM:TO",
        help="Part of the recordings, s, that is kept aside for judging; every third stretch"
        " unless given. May be given several times.",
    ),
]
Workers = Annotated[
    int | None, typer.Option("--workers", help="Threads; all cores by default.", min=1)
]


def register(app: typer.Typer) -> None:
    """Adds these subcommands to the `pneu` application.

    Args:
        app: The application.
    """
    app.command("fit")(fit)
    app.command("compare")(compare)
    app.command("diagnose")(diagnose)
    app.command("add")(add)
    app.command("learn")(learn)
    app.command("friction")(friction)
    app.command("contacts")(contacts)
    app.command("excite")(excite)
    app.command("observe")(observe)


def _console() -> Console:
    # Without markup: brackets in names, of users and of files, are brackets.
    console = Console(markup=False, emoji=False)
    return console if console.is_terminal else Console(width=140, markup=False, emoji=False)


def _folder(path: Path, rig: Path, force: bool) -> None:
    """Makes an output folder and refuses one that cannot be written, or holds another's files."""
    check_folder(path, "learn.json", ("rig.yaml", "step_*.yaml", "report.html"), force)
    if path.is_dir() and rig.exists() and not force:
        for name in ("rig.yaml", *(step.name for step in path.glob("step_*.yaml"))):
            if (path / name).exists() and (path / name).samefile(rig):
                raise InputError(f"{rig}: would be replaced by the results; --force replaces it")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be made a folder ({error.strerror})") from None
    check_output(path / "learn.json", force)


def _is_scene(rig: Path, effects: Path | None = None) -> bool:
    """Whether a file says that it is a scene, which has its own catalogue of effects."""
    from pneu_sysid.contacts.scene import is_scene

    if not is_scene(rig):
        return False
    if effects is not None:
        raise InputError(f"{rig}: is a scene; --effects is of rigs")
    return True


def _load(rig: Path, effects: Path | None) -> "Rig":
    """Loads a rig, effects of the user's own first."""
    from pneu_sim.effects import load_effect_file
    from pneu_sim.rig import load_rig

    if effects is not None:
        load_effect_file(effects)
    return load_rig(rig)


def _read(bags: list[Path], rig: "Rig", console: Console) -> "list[Recording]":
    from pneu_sysid.problem import record_for

    recordings = [record_for(rig, str(bag)) for bag in bags]
    names = [recording.name for recording in recordings]
    for name in names:
        if names.count(name) > 1:
            raise InputError(
                f"recording {name!r} was given {names.count(name)} times; recordings are told by"
                " their names, so each is needed once and under another"
            )
    for recording in recordings:
        head = f"{recording.name}: " if len(recordings) > 1 else ""
        for finding in recording.report:
            console.print(head + str(finding), style="yellow")
    return recordings


def read_findings(recordings: "Sequence[Recording]") -> list[str]:
    """What was found while recordings were read, one line each.

    Args:
        recordings: The recordings.
    """
    several = len(recordings) > 1
    return [f"{r.name}: {f}" if several else str(f) for r in recordings for f in r.report]


def _titled(recordings: "Sequence[Recording]") -> str:
    return ", ".join(recording.name for recording in recordings)


def _error_table(
    title: str, columns: dict[str, dict[str, float | None]], encoders: Mapping[str, str]
) -> NamedTable:
    """Errors per sensor side by side; the unit in the headings, or in a column where it differs."""
    from pneu_sysid.sensor_units import shared, unit_of

    sensors = list(next(iter(columns.values())))
    one = shared(encoders, sensors)
    heads = [Column(f"{name}, {one.told}" if one else name, "number") for name in columns]
    names = [Column("sensor" if encoders else "tap"), *([] if one else [Column("unit")])]
    table = NamedTable(title, [*names, *heads])
    for sensor in sensors:
        unit = unit_of(sensor, encoders)
        cells = [unit.figure(values.get(sensor)) for values in columns.values()]
        table.add_row(sensor, *([] if one else [unit.told]), *cells)
    return table


def fit(
    bag: BagPaths,
    rig: RigPath,
    output: Annotated[Path, typer.Option("-o", "--output", help="Fitted rig file.")],
    robust: Annotated[bool, typer.Option(help="Huber loss, for recordings with outliers.")] = False,
    hold_out: Annotated[bool, typer.Option(help="Keep a third of the recording aside.")] = False,
    iterations: Annotated[
        int, typer.Option(help="Gauss-Newton iterations of a step, at most.", min=1)
    ] = 8,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Fit even a rig file that seems grossly wrong.")
    ] = False,
    show_list: Annotated[
        bool, typer.Option("--list", help="Show what would be fitted, and end.")
    ] = False,
    plan: Annotated[
        Path | None,
        typer.Option(
            help="Plan of `pneu excite` that the recording was made by: standard errors that it"
            " promised are set beside those that were found.",
            show_default=False,
        ),
    ] = None,
    effects: EffectsPath = None,
    json_path: JsonPath = None,
    report: HtmlPath = None,
    workers: Workers = None,
    force: Force = False,
) -> None:
    """Fit a rig's base parameters to recordings."""
    from pneu_sim.rig import save_rig
    from pneu_sysid.design.plan_file import check_plan, load_plan
    from pneu_sysid.fit import fit_rig, parameters_of
    from pneu_sysid.gross import refuse_gross_errors
    from pneu_sysid.shortfall import ENOUGH

    console = _console()
    for path in (output, json_path, report):
        check_output(path, force)
    if _is_scene(rig, effects):
        from pneu_sysid.contacts.commands import fit as fit_scene

        if plan is not None:
            raise InputError(f"{rig}: is a scene; --plan is of rigs")
        return fit_scene(bag, rig, output, json_path, report, workers, console)
    start = _load(rig, effects)
    if show_list:
        console.print(_parameter_list(start, parameters_of(start)))
        return
    played = None if plan is None else load_plan(plan)
    if played is not None:
        check_plan(played, start, plan or "plan")
    recordings = _read(bag, start, console)
    begun = time.monotonic()
    with progress("fitting") as tell:
        if not anyway:
            tell("looking for gross errors")
            try:
                refuse_gross_errors(start, recordings, workers)
            except InputError as error:
                raise InputError(f"{rig}: {error}; --anyway fits it all the same") from None
        outcome = fit_rig(
            start,
            recordings,
            robust=robust,
            hold_out=hold_out,
            iterations=iterations,
            workers=workers,
            progress=tell,
        )
    save_rig(outcome.rig, output)
    took_s = time.monotonic() - begun
    result = fit_result(str(rig), str(output), recordings, outcome, took_s, played)
    console.print(_fitted_table(f"{start.name} fitted to {_titled(recordings)}", result))
    columns = {"noise": result.noise_of, "fitted": result.rmse_of}
    if result.held_out_rmse_of:
        columns["held out"] = result.held_out_rmse_of
    title = "error per sensor" if result.encoders else "error per tap"
    console.print(_error_table(title, columns, result.encoders))
    for warning in outcome.warnings:
        console.print(warning, style="yellow")
    if outcome.shortfall is None:
        every = "sensor" if result.encoders else "tap"
        console.print(f"Every {every} is expected to be within {ENOUGH:g} times its noise.")
    else:
        for k, line in enumerate(outcome.shortfall.lines):
            console.print(line, style="bold red" if k == 0 else "yellow")
    console.print(f"condition number {outcome.known.condition:.2g}; wrote {output}")
    _finish(result, json_path, report, console, fit=result.as_dict())


def _parameter_list(rig: "Rig", parameters: "list[FitParameter]") -> NamedTable:
    """What would be fitted, as a table."""
    from pneu_sysid.parameter_units import unit_of_parameter

    numbers = [Column(name, "number") for name in ("lower", "upper", "uncertain by")]
    table = NamedTable(f"{len(parameters)} parameters", [Column("path"), *numbers, Column("unit")])
    for p in parameters:
        std = "all of it" if p.std is None else f"{p.std:.3g}"
        unit = unit_of_parameter(rig, p.path) or "-"
        table.add_row(p.path, f"{p.lower:.4g}", f"{p.upper:.4g}", std, unit)
    return table


def _fitted_table(title: str, result: "FitResult") -> NamedTable:
    """Fitted parameters that the recordings show; the points of curves are in JSON and report."""
    promised = any(p.expected_error is not None for p in result.parameters)
    table = NamedTable(
        title,
        [
            Column("parameter"),
            Column("start", "number", drop=1),
            Column("value", "number"),
            Column("std. error", "number"),
            *([Column("expected", "number")] if promised else []),
            Column("unit"),
            Column("", "words"),
        ],
    )
    points: dict[str, int] = {}
    for p in result.parameters:
        curve, _, point = p.path.rpartition(".fraction.")
        if point.isdigit():
            points[curve] = points.get(curve, 0) + 1
            continue
        if not p.identified and not p.held:
            continue
        note = "held" if p.held else "at bound" if p.at_bound else ""
        error = "-" if p.std_error is None else f"{p.std_error:.2g}"
        name = p.path if p.recording is None else f"{p.path} in {p.recording}"
        cells = [f"{p.start:.5g}", f"{p.value:.5g}", error]
        if promised:
            cells.append("-" if p.expected_error is None else f"{p.expected_error:.2g}")
        table.add_row(name, *cells, p.unit or "-", note)
    for curve, count in points.items():
        blank = [""] * (4 if promised else 3)
        table.add_row(f"{curve}: {count} points", "", "in the file", *blank)
    return table


def fit_result(
    rig: str,
    output: str | None,
    recordings: "Sequence[Recording]",
    outcome: "FitOutcome",
    seconds: float | None = None,
    plan: "Plan | None" = None,
) -> "FitResult":
    """The JSON result of a fit.

    Args:
        rig: Rig file the fit started from.
        output: Rig file written.
        recordings: The recordings.
        outcome: The outcome.
        seconds: How long it took, s.
        plan: The plan that was played.
    """
    from pneu_sysid.design.judge import promised_errors
    from pneu_sysid.parameter_units import unit_of_parameter
    from pneu_sysid.results.files import pneu_version
    from pneu_sysid.results.fit import Correlation, FitResult, FitShortfall, FittedParameter
    from pneu_sysid.sensor_units import encoder_units
    from pneu_sysid.uncertainty import pairs_above

    known = outcome.known
    promised = {} if plan is None else promised_errors(plan, [p.path for p in outcome.parameters])
    parameters = [
        FittedParameter(
            path=p.path,
            recording=p.recording,
            value=outcome.values[k],
            start=outcome.start[k],
            std_error=p.std_error,
            expected_error=promised.get(p.path),
            unit=unit_of_parameter(outcome.rig, p.path),
            at_bound=bool(known.at_bound[k]),
            identified=bool(known.seen[k]),
            held=bool(known.held[k]),
            lower=p.lower,
            upper=p.upper,
        )
        for k, p in enumerate(outcome.parameters)
    ]
    names = [p.path for p in outcome.parameters]
    calibration = outcome.rig.calibration
    assert calibration is not None
    short = outcome.shortfall
    return FitResult(
        pneu_version=pneu_version(),
        recording=_titled(recordings),
        recordings=[recording.name for recording in recordings],
        rigs=[outcome.rig.name],
        taps=list(outcome.rig.taps),
        encoders=encoder_units(outcome.rig),
        noise_floor_pa=dict(calibration.noise_floor_pa),
        noise_floor=dict(calibration.noise_floor),
        findings=read_findings(recordings),
        rig=rig,
        output=output,
        parameters=parameters,
        correlations=[
            Correlation(a=names[a], b=names[b], value=value)
            for a, b, value in pairs_above(known.correlation, 0.9)
        ],
        condition=known.condition,
        warnings=outcome.warnings,
        shortfall=None
        if short is None
        else FitShortfall(
            times_noise=dict(short.by_tap),
            sentence=short.sentence,
            where=short.where,
            help=short.help,
        ),
        rmse_pa=dict(calibration.rmse_pa),
        held_out_rmse_pa=dict(calibration.held_out_rmse_pa),
        rmse=dict(calibration.rmse),
        held_out_rmse=dict(calibration.held_out_rmse),
        history=list(outcome.estimate.history),
        seconds=seconds,
    )


def compare(
    bag: BagPaths,
    rig: Annotated[list[Path], typer.Option("--rig", help="Rig file; repeat to compare several.")],
    refine: Annotated[bool, typer.Option(help="Run the first model on a finer grid too.")] = True,
    effects: EffectsPath = None,
    json_path: JsonPath = None,
    report: HtmlPath = None,
    force: Force = False,
) -> None:
    """Show how far models are from recordings, and where."""
    from pneu_sysid.compare import compare as run_compare
    from pneu_sysid.compare import compare_table

    console = _console()
    for path in (json_path, report):
        check_output(path, force)
    if _is_scene(rig[0], effects):
        from pneu_sysid.contacts.commands import compare as compare_scenes

        return compare_scenes(bag, rig, json_path, report, console)
    rigs = [_load(path, effects if k == 0 else None) for k, path in enumerate(rig)]
    recordings = _read(bag, rigs[0], console)
    with progress("comparing") as tell:
        result = run_compare(
            recordings,
            [(_model_name(r, path), r, str(path)) for r, path in zip(rigs, rig, strict=True)],
            refine=refine,
            progress=lambda done: tell("comparing", done),
        )
    console.print(compare_table(result))
    _finish(result, json_path, report, console, compare=result.as_dict())


def _model_name(rig: "Rig", path: Path) -> str:
    from pneu_sim.models import kind_of

    return path.stem if kind_of(rig).along_lines else f"{path.stem} ({rig.model.replace('_', '-')})"


def diagnose(
    bag: BagPaths,
    rig: RigPath,
    refine: Annotated[bool, typer.Option(help="Check the grid first.")] = True,
    effects: EffectsPath = None,
    aside: KeptAside = None,
    json_path: JsonPath = None,
    report: HtmlPath = None,
    workers: Workers = None,
    force: Force = False,
) -> None:
    """Rank what is missing in a model, and say which effect it is."""
    from pneu_sysid.diagnose import diagnose_apart, result_of_diagnosis

    console = _console()
    for path in (json_path, report):
        check_output(path, force)
    if _is_scene(rig, effects):
        from pneu_sysid.contacts.commands import diagnose as diagnose_scene

        if aside:
            raise InputError("--aside: a scene keeps whole recordings aside, leave it out")
        return diagnose_scene(bag, rig, json_path, report, workers, console)
    loaded = _load(rig, effects)
    kept = parts_of("--aside", aside or [])
    recordings = _read(bag, loaded, console)
    with progress("diagnosing") as tell:
        found = diagnose_apart(
            loaded, recordings, refine=refine, workers=workers, progress=tell, aside=kept
        )
    console.print(diagnosis_table(found))
    console.print(found.sentence, style="bold")
    for statement in found.statements:
        console.print(statement)
    result = result_of_diagnosis(loaded.name, found, read_findings(recordings))
    if result.numerics.discretisation:
        console.print(result.numerics.sentence, style="yellow")
    _finish(result, json_path, report, console, diagnose=result.as_dict())


def parts_of(option: str, told: Sequence[str]) -> list[tuple[float, float]]:
    """Parts of recordings as the command line tells them.

    Args:
        option: Its name.
        told: FROM:TO each, s.

    Raises:
        InputError: One is no such.
    """
    parts = []
    for text in told:
        begin, colon, end = text.partition(":")
        try:
            part = float(begin), float(end)
        except ValueError:
            part = math.nan, math.nan
        if not (colon and part[0] < part[1] < math.inf and part[0] > -math.inf):
            raise InputError(
                f"{option}: found {text!r}, allowed is FROM:TO in seconds, as in 10:20"
            )
        parts.append(part)
    return parts


def diagnosis_table(found: "Diagnosis") -> NamedTable:
    """The ranking as a table.

    Args:
        found: The diagnosis.
    """
    from pneu_sysid.parameter_units import strength_unit

    table = NamedTable(
        "candidates, best first",
        [
            Column("effect"),
            Column("place"),
            Column("strength", "words"),
            Column("score", "number", drop=2),
            Column("refit", "number", drop=1),
            Column("held out", "number"),
            Column("t", "number"),
            Column("not to be told from"),
        ],
    )
    for k, r in enumerate(found.finalists):
        unit = strength_unit(r.rig, r.site.effect, r.site.place)
        strength = f"{r.strength:.3g} ± {r.std_error:.1g} {unit}"
        table.add_row(
            r.site.effect.name,
            r.site.label.split("@", 1)[1],
            strength,
            f"{100 * r.score_explained:.0f} %",
            f"{100 * r.explained:.0f} %",
            f"{100 * r.held_out:.0f} %",
            f"{r.t:.1f}",
            ", ".join(found.alike(k)),
        )
    return table


def add(
    effect: Annotated[
        str,
        typer.Argument(
            metavar="EFFECT[@PLACE[:POSITION]]",
            help="Effect of `pneu effects`, where, and how far along a pipe in m.",
        ),
    ],
    rig: RigPath,
    bag: Annotated[
        list[Path], typer.Option("--bag", help="Recording to refit on; repeat for several.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Better rig file.")],
    effects: EffectsPath = None,
    json_path: JsonPath = None,
    workers: Workers = None,
    force: Force = False,
) -> None:
    """Add an effect to a rig and refit it."""
    from pneu_sim.rig import save_rig
    from pneu_sysid.heading import heading
    from pneu_sysid.learn import add_effect
    from pneu_sysid.problem import make_problem
    from pneu_sysid.results.files import write_json
    from pneu_sysid.results.learn import LearnResult
    from pneu_sysid.sensor_units import encoder_units

    console = _console()
    for path in (output, json_path):
        check_output(path, force)
    name, _, where = effect.partition("@")
    if _is_scene(rig, effects):
        from pneu_sysid.contacts.commands import add as add_to_scene

        return add_to_scene(name, where, bag, rig, output, workers, console)
    place, _, position = where.partition(":")
    try:
        at = float(position) if position else None
    except ValueError:
        at = math.nan
    if at is not None and not math.isfinite(at):
        raise InputError(f"effect {effect!r}: position {position!r} is no number of metres")
    loaded = _load(rig, effects)
    recordings = _read(bag, loaded, console)
    better, before, after = add_effect(loaded, recordings, name, place or None, at, workers)
    save_rig(better, output)
    console.print(step_table([before, after], encoder_units(better)))
    console.print(f"wrote {output}")
    if json_path is not None:
        problem = make_problem(better, recordings)
        write_json(
            json_path,
            LearnResult(
                **heading(problem, better, loaded.name, read_findings(recordings)),
                steps=[before, after],
                verdict="effect",
                sentence=f"{name} added at {after.place}.",
                output=str(output),
            ),
        )


def step_table(steps: "list[Step]", encoders: Mapping[str, str]) -> NamedTable:
    """Errors after every added effect, held-out part, as a table.

    Args:
        steps: The steps.
        encoders: What the rig's encoders read.
    """
    from pneu_sysid.sensor_units import shared, unit_of

    sensors = list(steps[0].errors)
    one = shared(encoders, sensors)
    heads = sensors if one else [f"{s}, {unit_of(s, encoders).told}" for s in sensors]
    numbers = [Column(name, "number") for name in (*heads, "times noise")]
    table = NamedTable(
        f"held-out error per tap, {one.told}" if one else "held-out error per sensor",
        [Column("added"), Column("strength", "words"), *numbers],
    )
    for step in steps:
        name = "nothing yet" if step.added is None else f"{step.added}@{step.place}"
        strength = ""
        if step.strength is not None:
            strength = f"{step.strength:.3g} ± {step.std_error or 0.0:.1g} {step.unit}"
        table.add_row(
            name,
            strength,
            *(unit_of(name, encoders).figure(v) for name, v in step.errors.items()),
            "-" if step.held_out_times_noise is None else f"{step.held_out_times_noise:.2f}",
        )
    return table


def learn(
    rig: RigPath,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")],
    bag: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="BAG...",
            help="rosbag2 folders, .mcap files, or text recordings, of one rig; none is needed of"
            " one that is live.",
        ),
    ] = None,
    plan: Annotated[
        list[Path] | None,
        typer.Option(
            help="Plan of `pneu excite` that a recording was made by: what it was to tell is set"
            " beside what it told. May be given several times.",
        ),
    ] = None,
    rig_is_live: Annotated[
        bool,
        typer.Option(
            "--rig-is-live",
            help="Run experiments on the rig, which is on the graph, until it is known what is"
            " missing.",
        ),
    ] = False,
    budget: Annotated[int, typer.Option(help="Experiments at most.", min=1, max=50)] = 4,
    seconds: Annotated[float, typer.Option(help="Length of each, s.", min=1.0, max=600.0)] = 10.0,
    namespace: Annotated[str, typer.Option(help="Where the live rig's topics are.")] = "lab",
    sim_time: Annotated[bool, typer.Option(help="Whether the graph goes by /clock.")] = False,
    low: Annotated[float | None, typer.Option(help="Lowest volts.", show_default=False)] = None,
    high: Annotated[float | None, typer.Option(help="Highest volts.", show_default=False)] = None,
    effects: EffectsPath = None,
    json_path: JsonPath = None,
    workers: Workers = None,
    force: Force = False,
) -> None:
    """Name, add and refit effect after effect until nothing more is worth adding."""
    from pneu_sim.rig import save_rig
    from pneu_sysid.compare import compare as run_compare
    from pneu_sysid.compare import recordings_table
    from pneu_sysid.design.command import experimented, experiments_table
    from pneu_sysid.design.judge import judged
    from pneu_sysid.design.limits import limits_of
    from pneu_sysid.design.live import LiveRig
    from pneu_sysid.design.loop import Budget
    from pneu_sysid.design.plan_file import check_plan, load_plan
    from pneu_sysid.diagnose import result_of_diagnosis
    from pneu_sysid.learn import learn as run_learn
    from pneu_sysid.learn import result_of_learning
    from pneu_sysid.problem import make_problem
    from pneu_sysid.report import write_report
    from pneu_sysid.results.files import write_json
    from pneu_sysid.sensor_units import encoder_units

    console = _console()
    bags = list(bag or [])
    if not bags and not rig_is_live:
        raise InputError("BAG: none was given; --rig-is-live has them recorded")
    check_output(json_path, force)
    _folder(output, rig, force)
    if _is_scene(rig, effects):
        from pneu_sysid.contacts.commands import learn as learn_scene

        if rig_is_live or plan:
            raise InputError(f"{rig}: is a scene; --rig-is-live and --plan are of rigs")
        return learn_scene(bags, rig, output, json_path, workers, console)
    loaded = _load(rig, effects)
    plans = [(path, load_plan(path)) for path in plan or []]
    for path, one in plans:
        check_plan(one, loaded, path)
    recordings = _read(bags, loaded, console)
    experiments = []
    if rig_is_live:
        allowed = Budget(budget, seconds, limits_of(loaded, low, high), workers=workers)
        where = LiveRig(namespace, sim_time)
        state = experimented(loaded, rig, bags, output, allowed, where, console)
        recordings, experiments = state.recordings, state.experiments
    with progress("learning") as tell:
        learned = run_learn(loaded, recordings, out=output, workers=workers, progress=tell)
    experiments += [judged(str(path), one, learned.diagnoses[0]) for path, one in plans]
    if experiments:
        console.print(experiments_table(experiments))
    console.print(step_table(learned.steps, encoder_units(learned.rig)))
    console.print(learned.sentence, style="bold")
    problem = make_problem(learned.rig, recordings)
    findings = read_findings(recordings)
    result = result_of_learning(loaded.name, learned, problem, findings, str(output), experiments)
    save_rig(learned.rig, output / "rig.yaml")
    write_json(output / "learn.json", result)
    if json_path is not None:
        write_json(json_path, result)
    names: list[tuple[str, Rig, str | None]] = [("before", learned.rigs[0], None)]
    if len(learned.rigs) > 1:
        names.append(("after", learned.rigs[-1], str(output / "rig.yaml")))
    compared = run_compare(recordings, names, refine=False)
    if len(recordings) > 1:
        console.print(recordings_table(compared))
    first = result_of_diagnosis(loaded.name, learned.diagnoses[0], findings)
    path = write_report(
        output / "report.html",
        compare=compared.as_dict(),
        diagnose=first.as_dict(),
        learn=result.as_dict(),
        title=f"{loaded.name}: {_titled(recordings)}",
    )
    console.print(f"report: {path}")


def friction(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE...", help="Drag tests of one cylinder: text files or bags."),
    ],
    rig: RigPath,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Write a rig file with it.", show_default=False),
    ] = None,
    json_path: JsonPath = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", help="Draw it (.png, .svg).", show_default=False)
    ] = None,
    force: Force = False,
) -> None:
    """Name the friction of a cylinder's seals, from force, position and pressure of drag tests."""
    from pneu_sim.rig import save_rig
    from pneu_sysid.pictures import check_figure
    from pneu_sysid.results.files import write_json
    from pneu_sysid.seals.figures import draw_friction
    from pneu_sysid.seals.identify import identify, with_friction
    from pneu_sysid.seals.reading import DragTest, read_drag
    from pneu_sysid.seals.words import result_of_friction, tables_of

    console = _console()
    for path in (output, json_path, figure):
        check_output(path, force)
    check_figure(figure)
    loaded = _load(rig, None)
    tests: list[DragTest] = []
    for path in files:
        if any(path.resolve() == other.resolve() for other in files[: len(tests)]):
            raise InputError(f"{path}: was given twice; each recording is needed once")
        tests.append(read_drag(loaded, path))
    with progress("finding friction"):
        found = identify(loaded, tests)
    result = result_of_friction(
        loaded, str(rig), None if output is None else str(output), tests, found
    )
    for finding in result.findings:
        console.print(finding, style="yellow")
    for table in tables_of(found):
        console.print(table)
    console.print(result.sentence, style="bold")
    for statement in result.statements:
        console.print(statement)
    if output is not None:
        save_rig(with_friction(loaded, found), output)
        console.print(f"wrote {output}")
    if figure is not None:
        draw_friction([(loaded.name, found)], figure)
        console.print(f"wrote {figure}")
    if json_path is not None:
        write_json(json_path, result)
        console.print(f"wrote {json_path}")


def _finish(
    result: "Head",
    json_path: Path | None,
    report: Path | None,
    console: Console,
    **sections: object,
) -> None:
    from pneu_sysid.report import write_report
    from pneu_sysid.results.files import write_json

    if json_path is not None:
        write_json(json_path, result)
        console.print(f"wrote {json_path}")
    if report is not None:
        write_report(report, title=result.recording, **sections)  # type: ignore[arg-type]
        console.print(f"report: {report}")
