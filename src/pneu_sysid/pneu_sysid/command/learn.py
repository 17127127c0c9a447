# SPDX-License-Identifier: Apache-2.0
"""``pneu learn``: effect after effect named, added and refitted, with experiments if need be."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pneu_common.errors import InputError
from pneu_common.options import Force
from pneu_common.outputs import check_output
from pneu_common.progress import progress
from pneu_sysid.command.given import (
    is_scene_file,
    load,
    make_console,
    make_results_folder,
    read,
    read_findings,
    titled,
)
from pneu_sysid.command.options import EffectsPath, JsonPath, RigPath, Workers
from pneu_sysid.command.tables import step_table

if TYPE_CHECKING:
    from pneu_sim.rig.schema import Rig


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

    console = make_console()
    bags = list(bag or [])
    if not bags and not rig_is_live:
        raise InputError("BAG: none was given; --rig-is-live has them recorded")
    check_output(json_path, force)
    make_results_folder(output, rig, force)
    if is_scene_file(rig, effects):
        from pneu_sysid.contacts.commands import learn as learn_scene

        if rig_is_live or plan:
            raise InputError(f"{rig}: is a scene; --rig-is-live and --plan are of rigs")
        return learn_scene(bags, rig, output, json_path, workers, console)
    loaded = load(rig, effects)
    plans = [(path, load_plan(path)) for path in plan or []]
    for path, one in plans:
        check_plan(one, loaded, path)
    recordings = read(bags, loaded, console)
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
        title=f"{loaded.name}: {titled(recordings)}",
    )
    console.print(f"report: {path}")
