# SPDX-License-Identifier: Apache-2.0
"""`pneu excite`, which plans the next experiment of a rig, and what `pneu learn` shows of some."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from pneu_common.errors import InputError
from pneu_common.options import Force
from pneu_common.outputs import check_output
from pneu_common.progress import progress
from pneu_common.tables import Column, NamedTable

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pneu_sim.rig.schema import Rig
    from pneu_sysid.design.live import LiveRig
    from pneu_sysid.design.loop import Budget, Loop
    from pneu_sysid.design.plan import Plan
    from pneu_sysid.results.learn import Experiment

KINDS = "designed, steps, multisine, sweep, decay, reversal, tracking"


def excite(
    rig: Annotated[Path, typer.Argument(help="Rig file, calibrated where it can be.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Plan (JSON) to write.")],
    seconds: Annotated[float, typer.Option(help="How long, s.", min=0.5, max=600.0)] = 10.0,
    separate: Annotated[
        Path | None,
        typer.Option(
            help="Result of `pneu diagnose --json`: what tells its candidates apart, instead of"
            " most about the rig's parameters.",
            show_default=False,
        ),
    ] = None,
    kind: Annotated[str, typer.Option(help=f"How it is made: {KINDS}.")] = "designed",
    low: Annotated[float | None, typer.Option(help="Lowest volts.", show_default=False)] = None,
    high: Annotated[
        float | None, typer.Option(help="Highest voltage, V.", show_default=False)
    ] = None,
    slew: Annotated[
        float | None, typer.Option(help="Fastest change of a command, V/s.", show_default=False)
    ] = None,
    highest_pa: Annotated[
        float | None,
        typer.Option(help="Pressure nothing may exceed, Pa absolute.", show_default=False),
    ] = None,
    lowest_pa: Annotated[
        float | None,
        typer.Option(help="Pressure nothing may fall below, Pa absolute.", show_default=False),
    ] = None,
    joint: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=FROM:TO",
            help="How far a joint may go, rad or m. May be given several times.",
        ),
    ] = None,
    air_kg: Annotated[
        float | None, typer.Option(help="Air that may be taken, kg.", show_default=False)
    ] = None,
    rate: Annotated[float, typer.Option(help="Readings of a sensor per second.", min=5.0)] = 500.0,
    seed: Annotated[int, typer.Option(help="Of what is drawn.", min=0)] = 0,
    effects: Annotated[
        Path | None,
        typer.Option(help="Python file with effects of your own.", show_default=False),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="Threads; all cores by default.", min=1)
    ] = None,
    force: Force = False,
) -> None:
    """Plan the recording that tells most about a rig, or what sets candidates apart."""
    from pneu_sim.effects import load_effect_file
    from pneu_sim.rig import load_rig
    from pneu_sysid.design.design import Asked, design
    from pneu_sysid.design.hypotheses import hypotheses_of, read_diagnosis
    from pneu_sysid.design.limits import limits_of
    from pneu_sysid.design.parameters import open_parameters, parameters_to_learn
    from pneu_sysid.design.waves import CHOICES as WAVES
    from pneu_sysid.results.files import write_json

    if kind != "designed" and kind not in WAVES:
        raise InputError(f"--kind: found {kind!r}, allowed are {KINDS}")
    check_output(output, force)
    if effects is not None:
        load_effect_file(effects)
    loaded = load_rig(rig)
    limits = limits_of(
        loaded, low, high, slew, highest_pa, lowest_pa, joints_of(joint or []), air_kg
    )
    hypotheses = []
    parameters = parameters_to_learn(loaded)
    if separate is not None:
        hypotheses = hypotheses_of(loaded, read_diagnosis(separate), separate)
        parameters = open_parameters(loaded, rig)
    wanted = next((w for w in WAVES if w == kind), None)
    asked = Asked(seconds, limits, hypotheses, parameters, wanted, rate, seed, workers)
    with progress("designing") as tell:
        plan = design(loaded, asked, tell)
    write_json(output, plan)
    console = Console(markup=False, emoji=False)
    console = console if console.is_terminal else Console(width=140, markup=False, emoji=False)
    for table in tables(plan):
        console.print(table)
    console.print(foreseen_words(plan))
    for words in plan.expected.words:
        console.print(words, style="yellow")
    console.print(f"plan: {output}")


def foreseen_words(plan: "Plan") -> str:
    """The extremes that a plan is expected to reach, in one sentence.

    Args:
        plan: The plan.
    """
    expected, parts = plan.expected, []
    highest = {n: p for n, p in expected.highest_pa.items() if p is not None}
    fastest = {n: p for n, p in expected.fastest_pa_s.items() if p is not None}
    if highest:
        tap = max(highest, key=lambda n: highest[n])
        parts.append(f"highest pressure {1e-5 * highest[tap]:.2f} bar at {tap}")
    if fastest:
        tap = max(fastest, key=lambda n: fastest[n])
        parts.append(f"fastest change {1e-5 * fastest[tap]:.0f} bar/s at {tap}")
    parts += [f"{n} from {low:.3g} to {high:.3g}" for n, (low, high) in expected.joints.items()]
    if expected.air_kg is not None:
        parts.append(f"air {1e3 * expected.air_kg:.2g} g")
    return f"Expected: {', '.join(parts)}; {plan.seconds:g} s."


def joints_of(told: list[str]) -> dict[str, tuple[float, float]]:
    """Ranges of joints as they are told on the command line.

    Args:
        told: Such as ``elbow=-0.5:1.2``.

    Raises:
        InputError: One is something else.
    """
    out = {}
    for text in told:
        name, _, span = text.partition("=")
        low, _, high = span.partition(":")
        try:
            out[name] = float(low), float(high)
        except ValueError:
            raise InputError(
                f"--joint: found {text!r}, needed is NAME=FROM:TO in rad or m"
            ) from None
    return out


def tables(plan: "Plan") -> list[NamedTable]:
    """What a plan promises, to be printed.

    Args:
        plan: The plan.
    """
    expected = plan.expected
    out = []
    if expected.separations:
        table = NamedTable(
            "Expected to be told apart",
            [
                Column("one"),
                Column("other"),
                Column("standard errors", "number"),
                Column("needed", "number"),
            ],
        )
        for s in expected.separations:
            errors = "-" if s.standard_errors is None else f"{s.standard_errors:.1f}"
            table.add_row(s.one, s.other, errors, f"{s.needed:g}")
        out.append(table)
    if expected.std_errors:
        columns = [
            Column("parameter"), Column("error", "number"), Column("least", "number"),
            Column("greatest", "number"),
        ]  # fmt: skip
        table = NamedTable("Expected standard errors, of rigs as this one may be", columns)
        for name, error in expected.std_errors.items():
            found = [error, *expected.std_errors_range.get(name, [error, error])]
            table.add_row(name, *("-" if x is None else f"{x:.3g}" for x in found))
        out.append(table)
    return out


def experimented(
    rig: "Rig",
    rig_file: Path,
    bags: "Sequence[Path]",
    out: Path,
    budget: "Budget",
    where: "LiveRig",
    console: Console,
) -> "Loop":
    """Runs experiments on a live rig with progress, and says why no more were run.

    Args:
        rig: The rig, calibrated.
        rig_file: Its file.
        bags: Recordings that there are.
        out: Folder of the results.
        budget: How much may be tried.
        where: Where the rig runs.
        console: Where to say it.
    """
    from pneu_sysid.design.loop import run

    with progress("experimenting") as tell:
        # processes that are started need not work in this folder
        state = run(rig, rig_file.resolve(), bags, out.resolve(), budget, where, tell)
    for why in state.played_again:
        console.print(f"{why}; played again")
    ended = state.ended.replace("_", " ")
    console.print(f"{len(state.experiments)} experiments, ended: {ended}")
    if state.words:
        console.print(state.words)
    return state


def experiments_table(experiments: "Sequence[Experiment]") -> NamedTable:
    """What experiments were expected to tell, and what they told, to be printed.

    Args:
        experiments: They.
    """
    table = NamedTable(
        "Experiments: standard errors by which the first candidate leads",
        [
            Column("plan"),
            Column("one"),
            Column("other"),
            Column("expected", "number"),
            Column("found", "number"),
            Column("needed", "number"),
        ],
    )
    for one in experiments:
        for told in one.told_apart:
            numbers = [
                "-" if x is None else f"{x:.1f}" for x in (told.expected, told.found, told.needed)
            ]
            table.add_row(Path(one.plan).name, told.one, told.other, *numbers)
        if not one.told_apart:
            table.add_row(Path(one.plan).name, one.kind, "", "-", "-", "-")
    return table
