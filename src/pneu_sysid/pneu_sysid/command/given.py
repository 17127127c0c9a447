# SPDX-License-Identifier: Apache-2.0
"""What commands are given: rigs and recordings, where results go; and how they end."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from pneu_common.errors import InputError
from pneu_common.outputs import check_folder, check_output

if TYPE_CHECKING:
    from pneu_sim.rig.schema import Rig
    from pneu_sysid.records import Recording
    from pneu_sysid.results.head import Head


def make_console() -> Console:
    """The console that results are shown on; wide where it is none."""
    # Without markup: brackets in names, of users and of files, are brackets.
    console = Console(markup=False, emoji=False)
    return console if console.is_terminal else Console(width=140, markup=False, emoji=False)


def make_results_folder(path: Path, rig: Path, force: bool) -> None:
    """Makes a folder for results; refuses one that cannot be written, or holds another's files.

    Args:
        path: The folder.
        rig: The rig file, which the results must not replace.
        force: Whether they may.

    Raises:
        InputError: It is refused.
    """
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


def is_scene_file(rig: Path, effects: Path | None = None) -> bool:
    """Whether a file says that it is a scene, which has its own catalogue of effects.

    Args:
        rig: The file.
        effects: Effects of the user's own; a scene has none.

    Raises:
        InputError: It is a scene, and there are effects for a rig.
    """
    from pneu_sysid.contacts.scene import is_scene

    if not is_scene(rig):
        return False
    if effects is not None:
        raise InputError(f"{rig}: is a scene; --effects is of rigs")
    return True


def load(rig: Path, effects: Path | None) -> "Rig":
    """Loads a rig, effects of the user's own first.

    Args:
        rig: Its file.
        effects: Theirs, if there are any.
    """
    from pneu_sim.effects import load_effect_file
    from pneu_sim.rig import load_rig

    if effects is not None:
        load_effect_file(effects)
    return load_rig(rig)


def read(bags: list[Path], rig: "Rig", console: Console) -> "list[Recording]":
    """Reads recordings of a rig, and says what was found on the way.

    Args:
        bags: Their files or folders.
        rig: The rig.
        console: Where to say it.

    Raises:
        InputError: One cannot be read, or two have one name.
    """
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


def titled(recordings: "Sequence[Recording]") -> str:
    """Names of recordings, in one line.

    Args:
        recordings: They.
    """
    return ", ".join(recording.name for recording in recordings)


def finish(
    result: "Head",
    json_path: Path | None,
    report: Path | None,
    console: Console,
    **sections: object,
) -> None:
    """Writes a result and a report where they are asked for.

    Args:
        result: The result.
        json_path: Where it goes; None is nowhere.
        report: Where the report goes; None is nowhere.
        console: Where to say so.
        **sections: Parts of the report.
    """
    from pneu_sysid.report import write_report
    from pneu_sysid.results.files import write_json

    if json_path is not None:
        write_json(json_path, result)
        console.print(f"wrote {json_path}")
    if report is not None:
        write_report(report, title=result.recording, **sections)  # type: ignore[arg-type]
        console.print(f"report: {report}")
