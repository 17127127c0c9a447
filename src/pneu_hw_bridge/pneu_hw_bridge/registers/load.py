# SPDX-License-Identifier: Apache-2.0
"""Reading register maps: a YAML file or a profile by name, one clear sentence where it is wrong."""

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from pneu_common.documents import parse_yaml, read_text
from pneu_common.errors import InputError
from pneu_common.validation import sentence
from pneu_hw_bridge.registers.schema import (
    SCHEMA_VERSION,
    RegisterMap,
)


def profiles() -> list[str]:
    """Names of the maps that come with the package."""
    folder = resources.files("pneu_hw_bridge.registers").joinpath("profiles")
    return sorted(one.name.removesuffix(".yaml") for one in folder.iterdir() if one.is_file())


def load_register_map(source: str | Path, device: Mapping[str, Any] | None = None) -> RegisterMap:
    """Reads and checks a register map.

    Args:
        source: A YAML file, or the name of a profile.
        device: Entries of ``device`` that replace those of the file.

    Raises:
        InputError: There is no such map, or it says something a map cannot be.
    """
    known = profiles()
    if str(source) in known:
        folder = resources.files("pneu_hw_bridge.registers").joinpath("profiles")
        text = folder.joinpath(f"{source}.yaml").read_text(encoding="utf-8")
    else:
        text = read_text(source, f"register map (a file, or one of {', '.join(known)})")
    return parse_register_map(text, str(source), device)


def parse_register_map(
    text: str, name: str, device: Mapping[str, Any] | None = None
) -> RegisterMap:
    """Reads and checks the text of a register map.

    Args:
        text: The YAML text.
        name: What messages call it.
        device: Entries of ``device`` that replace those of the text.

    Raises:
        InputError: It says something a map cannot be.
    """
    data = parse_yaml(text, name, "register map")
    if not isinstance(data, dict):
        raise InputError(f"{name}: a register map is a mapping, found {type(data).__name__}")
    if data.get("pneu_registers") != SCHEMA_VERSION:
        raise InputError(
            f"{name}: pneu_registers: found {data.get('pneu_registers')!r}, this version reads"
            f" {SCHEMA_VERSION}"
        )
    if device:
        given = data.get("device") or {}
        if isinstance(given, dict):
            data["device"] = {**given, **device}
    try:
        return RegisterMap.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{name}: {sentence(error, RegisterMap)}") from None
