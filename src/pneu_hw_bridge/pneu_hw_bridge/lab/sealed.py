# SPDX-License-Identifier: Apache-2.0
"""Hidden effects of the emulated lab in a file that nobody reads by accident."""

from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from pneu_common.documents import read_yaml
from pneu_common.errors import InputError
from pneu_common.validation import sentence
from pneu_hw_bridge.sealing import open_values, seal_values
from pneu_sim.effects import find_effect
from pneu_sim.rig.schema import AttachedEffect

_EFFECTS = TypeAdapter(list[AttachedEffect])


def read_effects(path: str | Path) -> list[AttachedEffect]:
    """Reads effects as a rig file lists them: a YAML or JSON list, or the value of ``effects``.

    Args:
        path: The file.

    Raises:
        InputError: It is no such list.
    """
    data = read_yaml(path, "list of effects")
    if isinstance(data, dict):
        data = data.get("effects")
    return _checked(data, str(path))


def seal(effects: list[AttachedEffect], path: str | Path) -> None:
    """Writes effects sealed.

    Args:
        effects: The effects.
        path: The file; its folder must exist.

    Raises:
        InputError: The file cannot be written.
    """
    note = "hidden effects for `pneu lab`; `pneu lab reveal` shows them"
    seal_values(_EFFECTS.dump_python(effects, mode="json"), path, note)


def open_sealed(path: str | Path) -> list[AttachedEffect]:
    """Reads sealed effects.

    Args:
        path: The file.

    Raises:
        InputError: The file is missing, damaged, or not sealed.
    """
    return _checked(open_values(path, "list of effects"), str(path))


def _checked(data: Any, path: str) -> list[AttachedEffect]:
    try:
        effects = _EFFECTS.validate_python(data)
    except ValidationError as error:
        raise InputError(
            f"{path}: {sentence(error, list[AttachedEffect])}; needed is a list of effect, place,"
            " parameters"
        ) from None
    for k, one in enumerate(effects):
        try:
            known = [p.name for p in find_effect(one.effect).parameters]
        except InputError as error:
            raise InputError(f"{path}: {k}.effect: {error}") from None
        for name in one.parameters:
            if name not in known:
                raise InputError(
                    f"{path}: {k}.parameters: found {name!r}, those of {one.effect} are"
                    f" {', '.join(known)}"
                )
    return effects
