# SPDX-License-Identifier: Apache-2.0
"""The digitised Bergh and Tijdeman curves of data/line_response, with their cases decoded."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FOLDER = Path(__file__).resolve().parents[2] / "data" / "line_response"


@dataclass(frozen=True)
class Curve:
    """One tube: its geometry (m, m3), mean pressure (Pa), and what the figure shows."""

    name: str
    radius: float
    length: float
    volume: float
    pressure: float
    amplitude: NDArray[np.float64]
    """Frequency (Hz) and amplitude ratio, shape (points, 2)."""
    phase: NDArray[np.float64]
    """Frequency (Hz) and phase (degrees), shape (points, 2)."""


def load(folder: Path = FOLDER) -> list[Curve]:
    """Returns all curves, ordered by name; points below 0.5 Hz (digitising artefacts) are cut."""
    curves = []
    for path in sorted(folder.glob("*-ampl.txt")):
        name = path.name.removesuffix("-ampl.txt")
        radius, length, volume, pressure = 0.75e-3, 1.0, 300e-9, 101325.0
        if geometry := re.search(r"R(\d+_\d+)mm-L(\d+)mm-Vv(\d+)mm3", name):
            radius = float(geometry[1].replace("_", ".")) * 1e-3
            length = float(geometry[2]) * 1e-3
            volume = float(geometry[3]) * 1e-9
        if mean := re.search(r"Pa(\d+_\d+)atm", name):
            pressure *= float(mean[1].replace("_", "."))
        tables = [
            np.loadtxt(folder / f"{name}-{kind}.txt", delimiter=",") for kind in ("ampl", "phase")
        ]
        amplitude, phase = (table[table[:, 0] > 0.5] for table in tables)
        curves.append(Curve(name, radius, length, volume, pressure, amplitude, phase))
    return curves
