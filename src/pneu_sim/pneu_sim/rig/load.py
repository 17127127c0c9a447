# SPDX-License-Identifier: Apache-2.0
"""Reading and writing rig files: one YAML file, one clear sentence where it is wrong."""

import io
import os
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from ruamel.yaml import YAML

from pneu_common.documents import read_yaml
from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_common.validation import sentence
from pneu_sim.rig.mechanics import check_starts
from pneu_sim.rig.plan import plan_grid
from pneu_sim.rig.plausible import implausible
from pneu_sim.rig.schema import SCHEMA_VERSION, Rig


def load_rig(path: str | Path) -> Rig:
    """Reads and checks a rig file.

    Args:
        path: The YAML file.

    Returns:
        The rig.

    Raises:
        InputError: The file is missing, is not YAML, or says something a rig cannot be.
    """
    path = Path(path)
    data = read_yaml(path, "rig file")
    return check_rig(data, path)


def check_rig(data: Any, path: Path) -> Rig:
    """Checks what a rig file says.

    Args:
        data: The file as plain values.
        path: The file, for messages, and for files that it names.

    Returns:
        The rig.

    Raises:
        InputError: It says something a rig cannot be.
    """
    if not isinstance(data, dict):
        raise InputError(f"{path}: a rig file is a mapping, found {type(data).__name__}")
    if data.get("pneu_rig") != SCHEMA_VERSION:
        raise InputError(
            f"{path}: pneu_rig: found {data.get('pneu_rig')!r}, this version reads {SCHEMA_VERSION}"
        )
    try:
        rig = Rig.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{path}: {sentence(error, Rig)}") from None
    if rig.mechanism is not None:
        rig.mechanism.mjcf = str((path.parent / rig.mechanism.mjcf).resolve())
    objection = implausible(rig)
    if objection:
        raise InputError(f"{path}: {objection}")
    try:
        plan_grid(rig)  # knows the limits of the grid; better refused now than after a long run
        check_starts(rig)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return rig


def save_rig(rig: Rig, path: str | Path) -> None:
    """Writes a rig file, whole or not at all.

    Args:
        rig: The rig.
        path: Where; its folder must exist.

    Raises:
        InputError: The file cannot be written.
    """
    path = Path(path)
    yaml = YAML()
    yaml.default_flow_style = None
    yaml.width = 100
    text = io.StringIO()
    data = rig.dump()
    if rig.mechanism is not None:
        data["mechanism"]["mjcf"] = os.path.relpath(rig.mechanism.mjcf, path.parent)
    yaml.dump(data, text)
    write_whole(path, text.getvalue())
