# SPDX-License-Identifier: Apache-2.0
"""Plain values in a file that nobody reads by accident.

The seal is no secret: it is base64 with a checksum, so that a glance at the file, or a search for
a name, gives nothing away, and so that a damaged file is noticed.
"""

import base64
import hashlib
import json
import zlib
from pathlib import Path
from typing import Any

from pneu_common.documents import check_values, read_text
from pneu_common.errors import InputError
from pneu_common.files import write_whole

SEAL_VERSION = 1

LARGEST_BYTES = 1 << 20
"""What is hidden is not longer; what is longer is not unpacked further."""


def seal_values(values: Any, path: str | Path, note: str) -> None:
    """Writes values sealed.

    Args:
        values: They.
        path: The file; its folder must exist.
        note: What the file is, for who looks at it.

    Raises:
        InputError: The file cannot be written.
    """
    content = json.dumps(values).encode()
    document = {
        "pneu_sealed": SEAL_VERSION,
        "note": note,
        "sha256": hashlib.sha256(content).hexdigest(),
        "content": base64.b64encode(zlib.compress(content)).decode(),
    }
    write_whole(Path(path), json.dumps(document, indent=1) + "\n")


def open_values(path: str | Path, what: str) -> Any:
    """Reads sealed values.

    Args:
        path: The file.
        what: What they are, for messages, such as ``list of effects``.

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
        values = json.loads(content)
    except (ValueError, RecursionError):
        raise InputError(f"{path}: the sealed content is no {what}") from None
    check_values(values, str(path))
    return values


def is_sealed(path: str | Path) -> bool:
    """Whether a file says that it is sealed.

    Args:
        path: The file.
    """
    try:
        document = json.loads(read_text(path, "sealed file"))
    except (InputError, ValueError, RecursionError):
        return False
    return isinstance(document, dict) and "pneu_sealed" in document
