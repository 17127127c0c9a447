# SPDX-License-Identifier: Apache-2.0
"""`pneu init`: a commented rig file to fill in, or a folder of examples to try.

A kind of rig is one file in `rig/templates`: its name is the kind, its first line, a comment, says
what it is, and its line `name:` takes the name of the file that is written.
"""

import json
import os
import re
import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from pneu_common.errors import InputError
from pneu_common.files import copy_whole, write_whole
from pneu_sim.carried import example_files

TEMPLATES = Path(__file__).parent / "rig" / "templates"
DEFAULT_KIND = "line"
DEFAULT_FILE = "rig.yaml"


def kinds() -> dict[str, str]:
    """What each kind of rig is, in a sentence, by kind."""
    found = {}
    for path in sorted(TEMPLATES.glob("*.yaml")):
        first = path.read_text(encoding="utf-8").partition("\n")[0]
        found[path.stem] = first.removeprefix("#").strip()
    return found


def _told() -> str:
    """The kinds on one line."""
    return ", ".join(f"{kind} ({what.rstrip('.')})" for kind, what in kinds().items())


def init(
    file: Annotated[
        Path | None,
        typer.Argument(
            help=f"Rig file to write, or a folder that gets {DEFAULT_FILE}; without a suffix it"
            f" gets .yaml.  [default: {DEFAULT_FILE}]",
            show_default=False,
        ),
    ] = None,
    kind: Annotated[
        str | None,
        typer.Option("--kind", help=f"{_told()}.  [default: {DEFAULT_KIND}]", show_default=False),
    ] = None,
    example: Annotated[
        Path | None,
        typer.Option(
            "--example",
            metavar="FOLDER",
            help="Instead of a rig file, a new folder with calibrated rigs and recordings to try.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Begin: write a commented rig file to fill in, or copy examples."""
    if example is None:
        _begin_rig(file, kind or DEFAULT_KIND)
    elif file is None and kind is None:
        _copy_examples(example)
    else:
        raise InputError(
            f"--example: found {'--kind' if file is None else file} beside it, allowed is the new"
            " folder alone"
        )


def _begin_rig(file: Path | None, kind: str) -> None:
    """Writes a rig file and says what comes next.

    Args:
        file: The file or an existing folder; None is the usual file here.
        kind: Its kind.
    """
    known = kinds()
    if kind not in known:
        raise InputError(f"--kind: found {kind!r}, allowed are {_told()}")
    path = Path(DEFAULT_FILE) if file is None else file
    if path.is_dir():
        path = path / DEFAULT_FILE
    if path.suffix == "":
        path = path.with_name(f"{path.name}.yaml")
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(f"{path}: found suffix {path.suffix!r}, allowed are .yaml, .yml, none")
    _must_be_new(path)
    text = (TEMPLATES / f"{kind}.yaml").read_text(encoding="utf-8")
    # A file name may hold bytes that are no text, which YAML does not allow.
    stem = os.fsencode(path.stem).decode(errors="replace")
    name = json.dumps(stem, ensure_ascii=False)
    text = re.sub(r"^name: .*$", lambda _: f"name: {name}", text, count=1, flags=re.MULTILINE)
    write_whole(path, text)
    shown = shlex.quote(str(path))
    beside = path.with_suffix("")
    simulated, fitted = (
        shlex.quote(f"{beside}{end}") for end in ("_simulated.csv", "_fitted.yaml")
    )
    print(
        f"{path}: a rig of kind {kind}. {known[kind]}\n"
        "\n"
        "Put your rig's numbers in the lines under CHANGE, then\n"
        f"  pneu check {shown}\n"
        f"  pneu simulate --rig {shown} {_steps(text)} -o {simulated}\n"
        "and with recordings of the rig, bags or text,\n"
        f"  pneu fit RECORDING --rig {shown} -o {fitted}\n"
        f"  pneu compare OTHER_RECORDING --rig {fitted}\n"
        "The first simulation compiles for half a minute."
    )


def _copy_examples(folder: Path) -> None:
    """Copies the examples and says what can be done with them.

    Args:
        folder: The folder, which must not exist.
    """
    found = example_files()
    if found is None:
        raise InputError(
            "--example: the example rigs and recordings did not come with this installation of"
            " Pneu; they are in rigs/ and data/bags/ of its checkout and in its wheels"
        )
    _must_be_new(folder)
    copy_whole(*found, folder)
    print(
        f"{folder}: calibrated rigs (rigs/README.md) and recordings (data/bags/README.md).\n"
        "\n"
        f"  cd {shlex.quote(str(folder))}\n"
        "How good are two models on a recording that the calibration never saw?\n"
        "  pneu compare data/bags/a_healthy_2 --rig rigs/rig_a_fitted.yaml"
        " --rig rigs/rig_a_thin_plate.yaml --no-refine\n"
        "A recording with a fault: where does the model fail, and what is missing?\n"
        "  pneu compare data/bags/a_leak --rig rigs/rig_a_fitted.yaml --report compare.html\n"
        "  pneu diagnose data/bags/a_leak --rig rigs/rig_a_fitted.yaml\n"
        "  pneu learn data/bags/a_leak --rig rigs/rig_a_fitted.yaml -o learned\n"
        "The first of them compiles for a minute."
    )


def _must_be_new(path: Path) -> None:
    """Refuses to write over anything, or into a folder that is not there.

    Args:
        path: What is to be written.
    """
    if path.exists() or path.is_symlink():
        raise InputError(f"{path}: exists already and is not overwritten; give another name")
    if not path.parent.is_dir():
        raise InputError(f"{path}: there is no folder {str(path.parent)!r}; make it first")


def _steps(text: str) -> str:
    """Options of `pneu simulate` that open every valve of a rig file and shut it again.

    Args:
        text: The rig file, which is one of the templates.
    """
    from ruamel.yaml import YAML

    rig: dict[str, Any] = YAML(typ="safe").load(text)
    options = []
    for command in rig["commands"]:
        valve = next(v for v in rig["valves"].values() if v["command"] == command)
        shut = valve["spool"]["null_v"]
        curves = [port["opening"].get("voltage_v", []) for port in valve["ports"].values()]
        wide = max((v for curve in curves for v in curve), key=lambda v: abs(v - shut))
        options.append(f"--steps {command}={wide:g}:0.3,{shut:g}:0.3")
    return " ".join(options)
