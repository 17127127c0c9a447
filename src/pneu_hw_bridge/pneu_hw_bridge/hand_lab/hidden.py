# SPDX-License-Identifier: Apache-2.0
"""What is hidden of an emulated hand, in a file, sealed or plain."""

from pathlib import Path

from pneu_hw_bridge.sealing import is_sealed, open_values, seal_values
from pneu_sim.hand.truth import Truth, checked_truth, read_truth


def seal_truth(truth: Truth, path: str | Path) -> None:
    """Writes it sealed.

    Args:
        truth: What is hidden.
        path: The file; its folder must exist.

    Raises:
        InputError: The file cannot be written.
    """
    note = "what is hidden of an emulated hand; `pneu lab reveal` shows it"
    seal_values(truth.model_dump(mode="json", exclude_defaults=True), path, note)


def open_truth(path: str | Path) -> Truth:
    """Reads it, sealed or plain.

    Args:
        path: The file.

    Raises:
        InputError: The file is missing, damaged, or something else.
    """
    if is_sealed(path):
        return checked_truth(open_values(path, "truth"), str(path))
    return read_truth(path)
