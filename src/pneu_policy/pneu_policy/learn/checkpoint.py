# SPDX-License-Identifier: Apache-2.0
"""Checkpoints of a training: written aside and renamed, checked whole before they are read.

A checkpoint is one line of text with the length and SHA-256 of what follows, and then the state as
PyTorch saves it. Reading takes tensors and plain values only, never code.
"""

import hashlib
import io
import pickle
from pathlib import Path
from typing import Any

import torch

from pneu_common.errors import InputError
from pneu_common.files import whole

HEAD = "pneu-checkpoint"
VERSION = 1


def save_checkpoint(state: dict[str, Any], path: str | Path) -> None:
    """Writes a checkpoint, whole or not at all.

    Args:
        state: Tensors and plain values.
        path: The file; its folder must exist.

    Raises:
        InputError: It cannot be written.
    """
    path = Path(path)
    held = io.BytesIO()
    torch.save(state, held)
    content = held.getvalue()
    digest = hashlib.sha256(content).hexdigest()
    with whole(path) as aside, aside.open("wb") as stream:
        stream.write(f"{HEAD} {VERSION} {len(content)} {digest}\n".encode())
        stream.write(content)


def load_checkpoint(path: str | Path) -> dict[str, Any]:
    """Reads a checkpoint onto the CPU.

    Args:
        path: The file.

    Raises:
        InputError: It is missing, cut short, damaged, or no checkpoint.
    """
    path = Path(path)
    try:
        whole = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such checkpoint") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    line, _, content = whole.partition(b"\n")
    words = line.decode("ascii", errors="replace").split(" ") if len(line) < 200 else []
    if len(words) != 4 or words[0] != HEAD or not words[2].isdigit():
        raise InputError(
            f"{path}: is not a checkpoint of `pneu train`, or its beginning is damaged"
        )
    if words[1] != str(VERSION):
        raise InputError(f"{path}: found checkpoint version {words[1]}, allowed is {VERSION}")
    if len(content) < int(words[2]):
        raise InputError(
            f"{path}: the checkpoint is cut short, found {len(content)} of {words[2]} bytes; start"
            " the training anew or from an older copy"
        )
    if hashlib.sha256(content).hexdigest() != words[3]:
        raise InputError(f"{path}: the checkpoint is damaged, its checksum does not match")
    try:
        state = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, RuntimeError) as error:
        first = str(error).splitlines()[0]
        raise InputError(f"{path}: the checkpoint cannot be read ({first})") from None
    if not isinstance(state, dict):
        raise InputError(f"{path}: found {type(state).__name__} in the checkpoint, not a state")
    return state
