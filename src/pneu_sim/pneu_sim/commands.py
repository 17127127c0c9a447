# SPDX-License-Identifier: Apache-2.0
"""Subcommands of `pneu` that need no recording: `init`, `effects`, `check`, `simulate`, `urdf`.

The numerics are imported by the command that uses them: `pneu --help` does without.
"""

import csv
import io
import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.console import Console

from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_common.options import MOST_SEED, Force
from pneu_common.outputs import check_output
from pneu_common.tables import Column, NamedTable
from pneu_sim.init import init

if TYPE_CHECKING:
    from pneu_sim.models import FromRest
    from pneu_sim.rig.schema import Rig
    from pneu_sim.signals import Floats

PLAIN_WIDTH = 160
"""Width of tables that go to a file or a pipe."""
MOST_SAMPLES = 10_000_000
"""Samples that a simulation may write."""

RigPath = Annotated[Path, typer.Option("--rig", help="Rig file (YAML).", show_default=False)]
EffectsPath = Annotated[
    Path | None,
    typer.Option("--effects", help="Python file with effects of your own.", show_default=False),
]


def register(app: typer.Typer) -> None:
    """Adds these subcommands to the `pneu` application.

    Args:
        app: The application.
    """
    app.command("init")(init)
    app.command("effects")(effects)
    app.command("check")(check)
    app.command("simulate")(simulate)
    app.command("urdf")(urdf)


def effects(
    effects_file: EffectsPath = None,
    rig: Annotated[
        Path | None,
        typer.Option("--rig", help="List only what this rig can have, and where."),
    ] = None,
    prove: Annotated[
        str | None,
        typer.Option(
            "--prove",
            metavar="NAME",
            help="Verify one effect on --rig, where its response is largest.",
        ),
    ] = None,
) -> None:
    """List the physical effects that a rig may have."""
    from pneu_sim.effects import load_effect_file
    from pneu_sim.effects.document import as_table
    from pneu_sim.rig.load import load_rig

    if effects_file is not None:
        load_effect_file(effects_file)
    if prove is not None:
        _prove(prove, rig)
        return
    rows = as_table(None if rig is None else load_rig(rig))
    _print_table(
        "",
        ("effect", "what", "where" if rig is None else "places", "strength", "unit", "typical"),
        [(r.name, r.title, r.where, r.strength, r.unit, r.typical) for r in rows],
    )


def _prove(name: str, rig: Path | None) -> None:
    """Verify one effect, print the checks, and fail where one does."""
    from pneu_sim.effects import find_effect, proof, registry
    from pneu_sim.rig.load import load_rig

    if rig is None:
        raise InputError("--prove: --rig is missing; name the rig to verify the effect on")
    effect = find_effect(name)
    plant = load_rig(rig)
    # Impacts at end stops make responses discontinuous: keep pistons away from them.
    experiment = proof.experiment_of(plant, reach=0.03 if plant.moves else 1.0)
    at = proof.strongest(experiment, effect)
    if at is None:
        raise InputError(f"effect {name!r}: rig {experiment.rig.name!r} has no place for it")
    # At equilibrium with the room only rounding errors differ.
    readings = experiment.readings([plant])
    if abs(at.responses([at.typical])).max() < proof.ROUND_OFF * abs(readings).max():
        raise InputError(
            f"effect {name!r}: rig {plant.name!r} does not respond to it from rest; verify it on"
            " another rig"
        )
    others = [proof.beside(at, one) for one in registry().values()]
    found = proof.prove(at, [one for one in others if one is not None])
    found += [one for case in effect.comparisons() for one in proof.compare(effect, case)]
    _print_table(
        f"{name} on {at.place}",
        ("check", "deviation", "limit", "", "details"),
        [
            (f.check, f"{f.deviation:.2g}", f"{f.allowed:g}", "" if f.holds else "FAILED", f.about)
            for f in found
        ],
    )
    if failed := sum(not f.holds for f in found):
        raise InputError(f"effect {name!r}: {failed} of {len(found)} checks failed")


def check(
    rig_file: Annotated[Path, typer.Argument(metavar="RIG", help="Rig file (YAML).")],
    effects_file: EffectsPath = None,
) -> None:
    """Check a rig file and show what would be simulated."""
    from pneu_sim.effects import load_effect_file
    from pneu_sim.rig import moving
    from pneu_sim.rig.build import build
    from pneu_sim.rig.load import load_rig
    from pneu_sim.rig.parameters import misfit
    from pneu_sim.rig.plan import plan_grid

    if effects_file is not None:
        load_effect_file(effects_file)
    rig = load_rig(rig_file)
    try:
        objection = misfit(rig)
    except InputError as error:
        objection = f"fit: {error}"
    if objection:
        raise InputError(f"{rig_file}: {objection}")
    plan = plan_grid(rig)
    build(rig, plan)
    cells = sum(plan.pipes[name][1] for name in rig.pipes)
    print(f"{rig.name}: {rig.description.strip()}" if rig.description else rig.name)
    print(
        f"model {rig.model}, {cells} cells in {len(rig.pipes)} pipes, time step"
        f" {1e6 * plan.dt_s:.3g} us (order {rig.grid.order}, {rig.grid.flux})"
    )
    if not rig.cylinders:
        print(f"closed volumes of the lumped models: {_volumes(rig)}")
    _print_table(
        "pipes",
        ("name", "from", "to", "length [m]", "area [mm2]", "cells", "cell [mm]"),
        [
            (
                name,
                pipe.from_node,
                pipe.to_node,
                f"{pipe.length_m:g}",
                f"{1e6 * pipe.area_m2:g}",
                str(plan.pipes[name][1]),
                f"{1e3 * pipe.length_m / plan.pipes[name][1]:.3g}",
            )
            for name, pipe in rig.pipes.items()
        ],
    )
    _print_table(
        "reservoirs and chambers",
        ("name", "kind", "size"),
        [(n, "reservoir", f"{r.pressure_pa / 1e3:g} kPa") for n, r in rig.reservoirs.items()]
        + [(n, "chamber", f"{1e6 * c.volume_m3:g} cm3") for n, c in rig.chambers.items()],
    )
    _print_table("cylinders", moving.CYLINDER_COLUMNS, moving.cylinder_rows(rig, plan))
    _print_table("bodies", moving.BODY_COLUMNS, moving.body_rows(rig))
    _print_table("mechanism", moving.MECHANISM_COLUMNS, moving.mechanism_rows(rig))
    _print_table(
        "ports",
        ("name", "from", "to", "C [dm3/(s bar)]", "b", "area [mm2]", "command"),
        [
            (
                f"{v}.{p}",
                port.from_node,
                port.to_node,
                f"{1e8 * port.conductance_m3_s_pa:g}" if port.model == "iso6358" else "",
                f"{port.critical_ratio:g}" if port.model == "iso6358" else "",
                f"{1e6 * port.area_m2:g}" if port.model == "effective_area" else "",
                valve.command,
            )
            for v, valve in rig.valves.items()
            for p, port in valve.ports.items()
        ]
        + [
            (n, o.from_node, o.to_node, f"{1e8 * o.conductance_m3_s_pa:g}",
             f"{o.critical_ratio:g}", "", "")
            for n, o in rig.orifices.items()
        ],
    )  # fmt: skip
    _print_table(
        "taps",
        ("name", "on", "position [m]", "recorded as"),
        [
            (
                name,
                str(tap.pipe or tap.chamber),
                "" if tap.pipe is None else f"{tap.position_m:g}",
                "" if tap.channel is None else str(tap.channel.topic or tap.channel.column),
            )
            for name, tap in rig.taps.items()
        ],
    )
    _print_table("encoders", moving.ENCODER_COLUMNS, moving.encoder_rows(rig))
    _print_table(
        "attached effects",
        ("effect", "place", "parameters"),
        [
            (e.effect, e.place, ", ".join(f"{k} {v:g}" for k, v in e.parameters.items()))
            for e in rig.effects
        ],
    )


def simulate(
    rig: RigPath,
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help="A .csv file, a .mcap file, or a folder for a rosbag2 recording.",
            show_default=False,
        ),
    ],
    command: Annotated[
        list[str] | None,
        typer.Option(
            "--command",
            help="NAME=FILE.csv with rows of time in s and volts, held; once per command.",
        ),
    ] = None,
    steps: Annotated[
        list[str] | None,
        typer.Option(
            "--steps", help="NAME=VOLTS:SECONDS,VOLTS:SECONDS,... instead of a file, held in turn."
        ),
    ] = None,
    duration: Annotated[
        float | None, typer.Option(help="Seconds; else until the last command ends.")
    ] = None,
    rate: Annotated[float, typer.Option(help="Samples per second.")] = 500.0,
    seed: Annotated[
        int | None,
        typer.Option(
            help="Adds the noise of the rig's sensors from this seed.", min=0, max=MOST_SEED
        ),
    ] = None,
    noise: Annotated[
        float | None, typer.Option(help="Noise in Pa, one sigma, instead of the rig's.")
    ] = None,
    effects_file: EffectsPath = None,
    force: Force = False,
) -> None:
    """Run a rig from rest along valve commands; write what its sensors read and where joints are.

    An encoder is a column; in a bag it is in the sensor_msgs/JointState of its topic. A rig without
    encoders has its joints written: two columns each, position and JOINT_velocity, m or rad and per
    second; in a bag all are the JointState of the topic /joint_states.
    """
    import numpy as np

    from pneu_sim.effects import load_effect_file
    from pneu_sim.models import FromRest
    from pneu_sim.rig.load import load_rig
    from pneu_sim.run import add_encoder_noise, add_noise, check_commands, run_from_rest

    if effects_file is not None:
        load_effect_file(effects_file)
    if noise is not None and (seed is None or not noise >= 0.0):
        raise InputError("--noise: needs a value of 0 or more and a --seed to draw it from")
    if not 0.0 < rate <= 1e6:
        raise InputError(f"--rate: found {rate:g}, allowed is above 0 and up to 1e6")
    _check_simulation(output, force)
    loaded = load_rig(rig)
    curves = {name: _from_file(name, Path(text)) for name, text in _named("--command", command)}
    for name, text in _named("--steps", steps):
        if name in curves:
            raise InputError(f"--steps: command {name!r} is already given by --command")
        curves[name] = _from_steps(name, text)
    check_commands(loaded, curves)
    if output.suffix == ".csv":
        _check_columns(output, loaded)
    if not curves and duration is None:
        raise InputError(
            f"--duration: found none, needed is one, since rig {loaded.name!r} has no commands that"
            " end"
        )
    span = duration if duration is not None else max(end for _, _, end in curves.values())
    if span * rate > MOST_SAMPLES:
        raise InputError(
            f"--duration: found {span:g} s at {rate:g} samples per second, allowed are"
            f" {MOST_SAMPLES} samples"
        )
    samples = round(span * rate) + 1 if math.isfinite(span) else 0
    if samples < 2:
        raise InputError(
            f"--duration: found {span:g} s, needed is at least one sample of {1 / rate:g} s"
        )
    time_s = np.arange(samples) / rate
    commands = {name: _held(t, v, time_s) for name, (t, v, _) in curves.items()}
    seen = run_from_rest(loaded, commands, 1.0 / rate, samples)
    if loaded.encoders:  # as on the graph: where joints truly are nobody knows
        seen = FromRest(seen.taps, encoders=seen.encoders)
    if seed is not None:
        rng = np.random.default_rng(seed)
        noisy = add_noise(loaded, seen.taps, rng, noise)
        read = add_encoder_noise(loaded, seen.encoders, rng)
        seen = FromRest(noisy, seen.joints, seen.speeds, read)
    _write_simulation(output, loaded, time_s, commands, seen, force)
    joints = f", {len(seen.joints)} joints" if seen.joints else ""
    joints += f", {len(seen.encoders)} encoders" if seen.encoders else ""
    print(
        f"{output}: {len(seen.taps)} taps{joints}, {samples} samples at {rate:g} Hz,"
        f" model {loaded.model} of rig {loaded.name}"
    )


def urdf(
    rig_file: Annotated[Path, typer.Argument(metavar="RIG", help="Rig file (YAML).")],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="The URDF file.", show_default=False)
    ],
    force: Force = False,
) -> None:
    """Write a rig's bodies as URDF, for viewers and robot_state_publisher."""
    from pneu_sim.rig.load import load_rig
    from pneu_sim.view.urdf import urdf_of

    check_output(output, force)
    write_whole(output, urdf_of(load_rig(rig_file)))


def _check_simulation(output: Path, force: bool) -> None:
    """Refuses an output of a simulation that is of another kind, or holds something already."""
    if output.suffix not in ("", ".csv", ".mcap"):
        raise InputError(f"{output}: found suffix {output.suffix!r}, allowed are .csv, .mcap, none")
    if output.suffix:
        check_output(output, force)
    elif output.exists():
        raise InputError(f"{output}: exists already; a bag is written to a new folder")


def _print_table(title: str, columns: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> None:
    rows = list(rows)
    if not rows:
        return
    console = Console()
    if not console.is_terminal:
        console = Console(width=PLAIN_WIDTH)
    table = NamedTable(title, [Column(column, _kind_of(column)) for column in columns])
    for row in rows:
        table.add_row(*row)
    console.print(table)


def _kind_of(column: str) -> Literal["name", "words", "number"]:
    """What a column of these tables holds; names come before words where there is little room."""
    if "[" in column or column in ("b", "cells", "typical"):
        return "number"
    words = ("what", "where", "unit", "kind", "size", "parameters", "friction", "leaks", "gas")
    return "words" if column in words else "name"


def _volumes(rig: "Rig") -> str:
    """The volumes that a lumped model of a rig would have, in words."""
    from pneu_sim.lumped.network import reduce_network

    try:
        network = reduce_network(rig)
    except InputError:
        return "none (a lumped model needs a line that ends closed behind a valve)"
    return "; ".join(" + ".join((*v.pipes, *v.chambers)) for v in network.volumes)


def _named(option: str, texts: list[str] | None) -> list[tuple[str, str]]:
    pairs = []
    for text in texts or []:
        name, equals, rest = text.partition("=")
        if not equals or not name or not rest:
            raise InputError(f"{option}: found {text!r}, it is the command's name, '=', a value")
        pairs.append((name, rest))
    names = [name for name, _ in pairs]
    if len(set(names)) < len(names):
        raise InputError(f"{option}: a command is given twice, found {', '.join(names)}")
    return pairs


def _from_steps(name: str, text: str) -> "tuple[Floats, Floats, float]":
    """Start times, volts and total duration of ``VOLTS:SECONDS,...``."""
    import numpy as np

    volts, lengths = [], []
    for part in text.split(","):
        try:
            v, s = (float(word) for word in part.split(":"))
        except ValueError:
            v = s = math.nan
        if not (math.isfinite(v) and math.isfinite(s) and s > 0.0):
            raise InputError(
                f"--steps {name}: found {part!r}, each step is VOLTS:SECONDS with seconds above 0"
            )
        volts.append(v)
        lengths.append(s)
    ends = np.cumsum(lengths)
    return np.concatenate([[0.0], ends[:-1]]), np.array(volts), float(ends[-1])


def _from_file(name: str, path: Path) -> "tuple[Floats, Floats, float]":
    """Times, volts and last time of a file with two columns; a heading is skipped."""
    import numpy as np

    if path.is_char_device():
        raise InputError(f"{path}: command {name!r}: is a device, a file is needed")
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = [row for row in csv.reader(stream) if any(word.strip() for word in row)]
    except (OSError, ValueError, csv.Error) as error:
        text = isinstance(error, UnicodeDecodeError)
        what = "it is not text" if text else getattr(error, "strerror", None) or error
        raise InputError(f"{path}: command {name!r} cannot be read ({what})") from None
    if rows and not _number(rows[0][0]):
        rows = rows[1:]
    for row in rows:
        if len(row) < 2 or not (_number(row[0]) and _number(row[1])):
            raise InputError(
                f"{path}: command {name!r}: found row {','.join(row)[:80]!r}, needed are time and"
                " volts"
            )
    if not rows:
        raise InputError(f"{path}: command {name!r}: found no rows of time and volts")
    table = np.array([[float(row[0]), float(row[1])] for row in rows])
    if np.any(np.diff(table[:, 0]) <= 0.0):
        raise InputError(f"{path}: command {name!r}: times must increase from row to row")
    return table[:, 0] - table[0, 0], table[:, 1], float(table[-1, 0] - table[0, 0])


def _number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _held(times_s: "Floats", volts: "Floats", at_s: "Floats") -> "Floats":
    """Volts at given times, each held until the next."""
    import numpy as np

    latest = np.searchsorted(times_s, at_s + 1e-9, side="right") - 1
    return np.asarray(volts[np.maximum(latest, 0)])


def _check_columns(path: Path, rig: "Rig") -> None:
    """Refuses a table in which a column of a joint or encoder would have the name of another."""
    from pneu_sim.rig.plan import plan_grid
    from pneu_sim.signals import velocity_of

    taken = {"time_s", *rig.commands, *rig.taps}
    for name in rig.encoders:
        if name in taken:
            raise InputError(
                f"{path}: encoder {name!r} of rig {rig.name!r} would have the column {name!r},"
                " which is there already; give the encoder another name, or write a bag"
            )
    if rig.encoders:  # which are written in place of joints
        return
    for joint in plan_grid(rig).joints:
        for column in (joint, velocity_of(joint)):
            if column in taken:
                raise InputError(
                    f"{path}: joint {joint!r} of rig {rig.name!r} would have the column {column!r},"
                    " which is there already; give the joint another name, or write a bag"
                )
            taken.add(column)


def _write_simulation(
    path: Path,
    rig: "Rig",
    time_s: "Floats",
    commands: "dict[str, Floats]",
    seen: "FromRest",
    replace: bool,
) -> None:
    """Writes a table of time, volts, pascals and joints, or a bag, whole or not at all."""
    from pneu_sim.bag import write_bag
    from pneu_sim.signals import Motion, Signal, velocity_of

    if path.suffix != ".csv":
        volts = {name: Signal(time_s, values) for name, values in commands.items()}
        readings = {name: Signal(time_s, values) for name, values in seen.taps.items()}
        motion = Motion(time_s, seen.joints, seen.speeds)
        encoders = {name: Signal(time_s, values) for name, values in seen.encoders.items()}
        write_bag(path, rig, volts, readings, replace=replace, motion=motion, encoders=encoders)
        return
    columns = {"time_s": time_s, **commands, **seen.taps, **seen.encoders}
    for name in seen.joints:
        columns |= {name: seen.joints[name], velocity_of(name): seen.speeds[name]}
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        writer.writerow([f"{value:.9g}" for value in row])
    write_whole(path, text.getvalue())
