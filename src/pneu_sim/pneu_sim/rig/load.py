# SPDX-License-Identifier: Apache-2.0
"""Reading and writing rig files: one YAML file, one clear sentence where it is wrong."""

import difflib
import io
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from ruamel.yaml import YAML

from pneu_common.documents import read_yaml
from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_sim.rig.plan import plan_grid
from pneu_sim.rig.plausible import implausible
from pneu_sim.rig.schema import SCHEMA_VERSION, Rig


def _sentence(path: str, error: ValidationError) -> str:
    """Turns the first fault of a validation into one sentence."""
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        known = _fields_at(first["loc"][:-1])
        key = str(first["loc"][-1])
        near = difflib.get_close_matches(key, known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else f"; known are {', '.join(known)}"
        return f"{path}: unknown key {where!r}{hint}"
    message = first["msg"].removeprefix("Value error, ")
    found = first.get("input")
    shown = f", found {found!r}" if isinstance(found, int | float | str | bool) else ""
    return f"{path}: {where + ': ' if where else ''}{message}{shown}"


def _fields_at(loc: tuple[int | str, ...]) -> list[str]:
    """Names allowed at a location of the schema, by walking the annotations."""
    model: Any = Rig
    for part in loc:
        if not (isinstance(model, type) and issubclass(model, BaseModel)):
            return []
        fields = {f.alias or n: f for n, f in model.model_fields.items()}
        if part in fields:
            model = fields[str(part)].annotation
            args = [a for a in getattr(model, "__args__", ()) if a not in (str, type(None))]
            if args:
                inner = getattr(args[-1], "__args__", None)
                model = args[-1] if inner is None else inner[0]
        # a part that is no field is a key of a mapping or an index of a list: the model stays
    if isinstance(model, type) and issubclass(model, BaseModel):
        return [f.alias or n for n, f in model.model_fields.items()]
    return []


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
    if not isinstance(data, dict):
        raise InputError(f"{path}: a rig file is a mapping, found {type(data).__name__}")
    if data.get("pneu_rig") != SCHEMA_VERSION:
        raise InputError(
            f"{path}: pneu_rig: found {data.get('pneu_rig')!r}, this version reads {SCHEMA_VERSION}"
        )
    try:
        rig = Rig.model_validate(data)
    except ValidationError as error:
        raise InputError(_sentence(str(path), error)) from None
    objection = implausible(rig)
    if objection:
        raise InputError(f"{path}: {objection}")
    try:
        plan_grid(rig)  # knows the limits of the grid; better refused now than after a long run
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
    yaml.dump(rig.dump(), text)
    write_whole(path, text.getvalue())
