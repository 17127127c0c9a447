# SPDX-License-Identifier: Apache-2.0
"""A session as one small file: all that is needed to come back to it, without what is computed.

Signals are left out: they are hundreds of times as large, and a model that is run again makes them.
"""

import json
import zipfile
from pathlib import Path
from typing import Any

from pneu_common.errors import InputError
from pneu_common.files import whole

SESSION = "session.json"
KEPT = ("rig.yaml", "compare.json", "visited.json")
"""Of each version."""
MOST_BYTES = 512 << 20
"""Of all that a file unpacks to."""
MOST_FILES = 10_000
SUFFIX = ".zip"


def pack(folder: Path, file: Path) -> None:
    """Writes a session as one file, whole or not at all.

    Args:
        folder: The session's.
        file: Where.
    """
    state = json.loads((folder / SESSION).read_text(encoding="utf-8"))
    state["diagnosis"] = None  # its candidates are drawn from signals
    with whole(file) as aside, zipfile.ZipFile(aside, "w", zipfile.ZIP_DEFLATED) as out:
        for version in state["versions"]["all"]:
            version["rig"] = f"{version['folder']}/rig.yaml"
            for name in KEPT:
                out.write(folder / version["folder"] / name, f"{version['folder']}/{name}")
        out.writestr(SESSION, json.dumps(state))


def unpack(file: Path, folder: Path) -> None:
    """Makes a session's folder of such a file.

    Args:
        file: The file.
        folder: The folder; it must be new.

    Raises:
        InputError: It is no such file, holds more than a session does, or the folder is there.
    """
    if folder.exists():
        raise InputError(
            f"{folder}: is there already, and {file.name} would be unpacked to it; go on with"
            " --session and that folder, or move it away"
        )
    try:
        with zipfile.ZipFile(file) as archive:
            entries = archive.infolist()
            if len(entries) > MOST_FILES or sum(e.file_size for e in entries) > MOST_BYTES:
                raise ValueError("it holds more than a session does")
            state = json.loads(archive.read(SESSION))
            names = {str(version["folder"]) for version in state["versions"]["all"]}
            if any(Path(name).name != name or name in ("", ".", "..") for name in names):
                raise ValueError("a version's folder is no plain name")
            parts: dict[str, bytes] = {}
            for name in sorted(names):
                parts |= {f"{name}/{one}": archive.read(f"{name}/{one}") for one in KEPT}
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile, RuntimeError) as error:
        raise InputError(f"{file}: is no session of the workbench ({error})") from None
    folder.mkdir(parents=True)
    for name, content in parts.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
    _at_home(state, folder)
    (folder / SESSION).write_text(json.dumps(state), encoding="utf-8")


def _at_home(state: dict[str, Any], folder: Path) -> None:
    for version in state["versions"]["all"]:
        version["rig"] = str(folder.resolve() / version["folder"] / "rig.yaml")
