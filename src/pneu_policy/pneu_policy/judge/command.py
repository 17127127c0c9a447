# SPDX-License-Identifier: Apache-2.0
"""`pneu evaluate`: controllers x rigs x targets x seeds, in simulation or on the emulated lab."""

import hashlib
import importlib.util
import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer
from rich.console import Console

from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_common.options import MOST_SEED, Force
from pneu_common.outputs import check_folder, check_output
from pneu_common.progress import progress
from pneu_policy.judge.tasks import Conditions, Tasks

if TYPE_CHECKING:
    from pneu_policy.judge.results import Evaluation
    from pneu_sim.rig.schema import Rig

_DEFAULT = Tasks()
_SEEDS = re.compile(r"(\d{1,10})(?:-(\d{1,10}))?$")


def register_evaluate(app: typer.Typer) -> None:
    """Adds this subcommand to the `pneu` application.

    Args:
        app: The application.
    """
    app.command("evaluate")(evaluate)


def evaluate(
    controllers: Annotated[
        list[str],
        typer.Argument(
            metavar="CONTROLLER...",
            help="Policies (.npz) and PIDs (.yaml); NAME=FILE,FILE,... takes the files in turn.",
        ),
    ],
    rigs: Annotated[
        list[str],
        typer.Option("--rig", help="Rig file, or NAME=FILE; more than one is allowed."),
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder of the results.", show_default=False)
    ],
    sealed: Annotated[
        list[Path] | None,
        typer.Option(
            "--sealed", help="Hidden effects of the rigs' plants (pneu lab seal), one per rig."
        ),
    ] = None,
    targets: Annotated[
        str, typer.Option(help="Kinds of target, with commas between.")
    ] = "smooth,jagged",
    seeds: Annotated[str, typer.Option(help="Seeds of the targets, such as 0-4 or 1,5.")] = "0-4",
    low: Annotated[float, typer.Option(help="Lowest target, Pa.")] = _DEFAULT.low_pa,
    high: Annotated[float, typer.Option(help="Highest target, Pa.")] = _DEFAULT.high_pa,
    period: Annotated[
        float, typer.Option(help="Typical time between a target's extremes, s.")
    ] = _DEFAULT.period_s,
    jitter: Annotated[
        float, typer.Option(help="Share of it by which corners of jagged targets are moved.")
    ] = _DEFAULT.jitter,
    duration: Annotated[float, typer.Option(help="Length of a run, s.")] = _DEFAULT.duration_s,
    skip: Annotated[
        float, typer.Option(help="Beginning of a run that is not judged, s.")
    ] = _DEFAULT.skip_s,
    live: Annotated[
        bool, typer.Option("--live", help="Through the live graph against the emulated lab.")
    ] = False,
    limit: Annotated[
        bool, typer.Option("--limit", help="The physical limit of the plants as well (minutes).")
    ] = False,
    noise: Annotated[
        float, typer.Option(help="Noise of the sensors, one sigma, Pa.")
    ] = Conditions.noise_pa,
    delay: Annotated[
        float, typer.Option(help="Simulation: delay of commands beyond the rig's own, s.")
    ] = Conditions.delay_s,
    dx: Annotated[
        float | None,
        typer.Option(help="Cell length, m.", show_default="the rig's; half of it with --live"),
    ] = None,
    workers: Annotated[int, typer.Option(help="Processes for the limit.", min=1)] = 1,
    keep_bags: Annotated[
        bool, typer.Option("--keep-bags", help="Keep the recordings of --live.")
    ] = False,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", help="The results also as this file.", show_default=False),
    ] = None,
    force: Force = False,
) -> None:
    """Try controllers on the same targets and tell errors, latency, effort and oscillation."""
    from pneu_policy.control.controllers import load_controller
    from pneu_policy.judge.evaluate import evaluate_simulated
    from pneu_policy.judge.results import save

    tasks = Tasks(
        kinds=cast(Any, tuple(word.strip() for word in targets.split(","))),
        seeds=_seeds(seeds),
        low_pa=low,
        high_pa=high,
        period_s=period,
        jitter=jitter,
        duration_s=duration,
        skip_s=skip,
    )
    check_folder(output, "evaluation.json", ("table.md", "errors.png", "runs-*.png"), force)
    check_output(json_file, force)
    if not 0.0 <= noise < 1e6:
        raise InputError(f"--noise: found {noise:g}, it must not be negative")
    if live and noise == 0.0:
        raise InputError("--noise: found 0; with --live readings without noise count as frozen")
    if not 0.0 <= delay <= 0.2:
        raise InputError(f"--delay: found {delay:g}, allowed are 0 to 0.2 s")
    if dx is not None and not 1e-4 <= dx <= 1.0:
        raise InputError(f"--dx: found {dx:g}, allowed are 0.0001 to 1 m")
    files = _named_rigs(rigs)
    hidden = list(sealed or [])
    if hidden and len(hidden) != len(files):
        raise InputError(f"--sealed: found {len(hidden)} files for {len(files)} rigs")
    plants = {
        name: _with_effects(file, hidden[i] if hidden else None)
        for i, (name, file) in enumerate(files.items())
    }
    tried = _named_controllers(controllers)
    conditions = Conditions(noise_pa=noise, delay_s=0.0 if live else delay, dx_m=dx)
    evaluation = _opened(output, tasks, conditions, live, plants)
    console = _console()
    with progress("evaluating") as told:
        if live:
            from pneu_policy.live.evaluate import evaluate_live
            from pneu_policy.live.rig import LivePlant

            labs = [
                LivePlant(name, file, hidden[i] if hidden else None, dx, noise)
                for i, (name, file) in enumerate(files.items())
            ]
            evaluate_live(evaluation, tried, labs, tasks, keep_bags, told)
        else:
            evaluate_simulated(evaluation, tried, plants, tasks, conditions, told)
        if limit:
            from pneu_policy.judge.limit import evaluate_limit

            tap = load_controller(next(iter(tried.values()))[0]).tap
            evaluate_limit(evaluation, plants, tap, tasks, workers=workers, progress=told)
    report(evaluation, output, console)
    if json_file is not None:
        save(evaluation, json_file)
    failed = [run for run in evaluation.runs if run.metrics is None]
    for run in failed:
        console.print(f"no valid run: {run.key} after {run.attempts} tries ({run.note})")
    if failed:
        raise typer.Exit(1)


def report(evaluation: "Evaluation", folder: Path, console: Console) -> None:
    """Prints the tables and writes them, with the figures, beside the results.

    Args:
        evaluation: What was found.
        folder: Where they go.
        console: Where to print.
    """
    from pneu_policy.judge.results import error_rows, markdown, rich_table, rows

    errors, figures = error_rows(evaluation), rows(evaluation)
    console.print(rich_table("mean ± standard deviation over runs", *errors))
    console.print(rich_table("all figures", *figures))
    text = f"{markdown(*errors)}\n{markdown(*figures)}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror or error})") from None
    write_whole(folder / "table.md", text)
    if importlib.util.find_spec("matplotlib") is None:
        console.print("no figures: they need matplotlib, `pip install matplotlib`")
        return
    from pneu_policy.judge.figures import write_figures

    for path in write_figures(evaluation, folder):
        console.print(f"{path}")


def _seeds(text: str) -> tuple[int, ...]:
    """Seeds of a text such as ``0-4,7``."""
    found: list[int] = []
    for part in text.split(","):
        match = _SEEDS.match(part.strip())
        if match is None or int(match[2] or match[1]) - int(match[1]) not in range(1000):
            raise InputError(f"--seeds: found {text!r}, allowed are such as 0-4 or 1,5,9")
        if int(match[2] or match[1]) > MOST_SEED:
            raise InputError(f"--seeds: found {text!r}, allowed are seeds up to {MOST_SEED}")
        found += range(int(match[1]), int(match[2] or match[1]) + 1)
    return tuple(found)


def _named_controllers(texts: Sequence[str]) -> dict[str, list[Path]]:
    """Files of controllers by name: the one given, else that of the file."""
    from pneu_policy.judge.evaluate import names_of
    from pneu_policy.judge.results import LIMIT

    named = {n: [Path(f) for f in rest.split(",")] for n, e, rest in _parted(texts) if e}
    plain = names_of([Path(name) for name, equals, _ in _parted(texts) if not equals])
    if len(named) + len(plain) < len(texts) or LIMIT in named or set(named) & set(plain):
        raise InputError("controllers: a name is given twice, or is 'limit', which is taken")
    for name in named:
        if not re.fullmatch(r"[\w.-]+", name):
            raise InputError(f"controllers: found {name!r}, a name is letters and digits")
    return {**named, **{name: [file] for name, file in plain.items()}}


def _parted(texts: Sequence[str]) -> list[tuple[str, str, str]]:
    return [text.partition("=") for text in texts]


def _named_rigs(texts: Sequence[str]) -> dict[str, Path]:
    """Rig files by name: the one given, else that of the file."""
    out: dict[str, Path] = {}
    for text in texts:
        name, equals, rest = text.partition("=")
        file = Path(rest if equals else text)
        name = name if equals else file.stem
        if not re.fullmatch(r"[\w.-]+", name) or name in out:
            raise InputError(f"--rig: found {text!r}, names are letters and digits, each once")
        out[name] = file
    return out


def _with_effects(file: Path, hidden: Path | None) -> "Rig":
    from pneu_hw_bridge.lab.sealed import open_sealed
    from pneu_sim.rig import load_rig

    rig = load_rig(file)
    if hidden is None:
        return rig
    return rig.model_copy(update={"effects": [*rig.effects, *open_sealed(hidden)]})


def _opened(
    folder: Path, tasks: Tasks, conditions: Conditions, live: bool, plants: "dict[str, Rig]"
) -> "Evaluation":
    """What a folder holds already, if it was made alike; else an empty evaluation."""
    from pneu_policy.judge.results import Evaluation, load

    digests = {
        name: hashlib.sha256(rig.model_dump_json().encode()).hexdigest()
        for name, rig in plants.items()
    }
    settings: dict[str, Any] = {
        "live": live,
        "conditions": asdict(conditions),
        "tasks": tasks.to_dict(),
        "plants": digests,
    }
    path = folder / "evaluation.json"
    if not path.exists():
        return Evaluation(settings, folder=folder)
    found = load(path)
    before = found.settings
    for part in ("live", "conditions"):
        if before.get(part) != settings[part]:
            raise _other(path, part)
    for name, value in settings["tasks"].items():
        # More kinds and seeds may be added to what is there.
        if name not in ("kinds", "seeds") and before.get("tasks", {}).get(name) != value:
            raise _other(path, name)
    for name, digest in digests.items():
        if before.get("plants", {}).get(name, digest) != digest:
            raise _other(path, f"rig {name}")
    found.settings = {**settings, "plants": {**before.get("plants", {}), **digests}}
    return found


def _other(path: Path, what: str) -> InputError:
    return InputError(
        f"{path}: was made with other settings ({what}); choose another folder, or remove it"
    )


def _console() -> Console:
    console = Console()
    return console if console.is_terminal else Console(width=200)
