# SPDX-License-Identifier: Apache-2.0
"""Hidden effects of the emulated lab in a file that nobody reads by accident.

The seal is no secret: it is base64 with a checksum, so that a glance at the file, or a search for
an effect's name, gives nothing away, and so that a damaged file is noticed.
"""

import base64
import hashlib
import json
import zlib
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from pneu_common.documents import check_values, read_text, read_yaml
from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_common.validation import sentence
from pneu_sim.effects import find_effect
from pneu_sim.rig.schema import AttachedEffect

SEAL_VERSION = 1

LARGEST_BYTES = 1 << 20
"""A list of effects is not longer; one that is longer is not unpacked further."""

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
    path = Path(path)
    content = json.dumps(_EFFECTS.dump_python(effects, mode="json")).encode()
    document = {
        "pneu_sealed": SEAL_VERSION,
        "note": "hidden effects for `pneu lab`; `pneu lab reveal` shows them",
        "sha256": hashlib.sha256(content).hexdigest(),
        "content": base64.b64encode(zlib.compress(content)).decode(),
    }
    write_whole(path, json.dumps(document, indent=1) + "\n")


def open_sealed(path: str | Path) -> list[AttachedEffect]:
    """Reads sealed effects.

    Args:
        path: The file.

    Raises:
        InputError: The file is missing, damaged, or not sealed.
    """
    text = read_text(path, "sealed file")
    try:
        document: Any = json.loads(text)
    except (ValueError, RecursionError):
        raise InputError(f"{path}: is not a sealed file; `pneu lab seal` makes one") from None
    if not isinstance(document, dict) or document.get("pneu_sealed") != SEAL_VERSION:
        found = document.get("pneu_sealed") if isinstance(document, dict) else None
        raise InputError(f"{path}: pneu_sealed: found {found!r}, this version reads {SEAL_VERSION}")
    try:
        packed = base64.b64decode(str(document["content"]), validate=True)
        # Not more than that is unpacked, whatever the file would unpack to.
        content = zlib.decompressobj().decompress(packed, LARGEST_BYTES)
    except (KeyError, ValueError, zlib.error):
        raise InputError(f"{path}: the sealed content is damaged") from None
    if hashlib.sha256(content).hexdigest() != document.get("sha256"):
        raise InputError(f"{path}: the sealed content does not match its checksum")
    try:
        effects = json.loads(content)
    except (ValueError, RecursionError):
        raise InputError(f"{path}: the sealed content is no list of effects") from None
    check_values(effects, str(path))
    return _checked(effects, str(path))


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
