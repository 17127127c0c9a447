# SPDX-License-Identifier: Apache-2.0
"""Frequency response of a tube with an end volume: published curves, theory and our solver.

``python -m studies.line_response [PICTURE]`` draws all curves of ``data/line_response``
(H. Bergh and H. Tijdeman, NLR-TR F.238, 1965); it needs matplotlib.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tests.references import bergh_curves, bergh_tijdeman

from pneu_sim.gas import Gas
from pneu_sim.rig.schema import Rig
from pneu_sim.simulator import Simulator

PICTURE = Path(__file__).resolve().parent.parent / "docs" / "figures" / "line_response.png"


@dataclass(frozen=True)
class Line:
    """A tube (m) that ends in a volume (m3), filled with air at a mean pressure (Pa)."""

    radius: float
    length: float
    volume: float
    pressure: float = 101325.0
    temperature: float = 288.15


def simulated_response(
    line: Line,
    frequency_hz: NDArray[np.float64],
    dx_m: float = 0.02,
    duration_s: float = 1.0,
    memory: bool = True,
    **wall: Any,
) -> NDArray[np.complex128]:
    """Pressure in the end volume over that at the tube's inlet, by a small pulse.

    A feed line in front of the tube begins with a bump of pressure; all gas beyond the inlet begins
    at rest, so the ratio of the two recorded transients' spectra is the response, whatever the feed
    line does. The tube is a few cells longer than the length that counts, so that the inlet is read
    in the middle of a cell and away from the joint.

    Args:
        line: The tube.
        frequency_hz: Where the response is wanted, shape (frequencies,).
        dx_m: Cell length.
        duration_s: How long to record; the transients must have died away.
        memory: Whether wall friction and heat are frequency dependent.
        wall: Settings of the tube's wall that differ from the standard ones.
    """
    area = float(np.pi * line.radius**2)
    cells = round(line.length / dx_m)
    dx = line.length / (cells - 0.5)
    lead = 5 * dx
    feed = 0.6
    rig = Rig.model_validate(
        {
            "name": "line",
            "grid": {"dx_m": dx, "wave_speed_m_s": 360.0, "memory": memory},
            "ambient": {"pressure_pa": line.pressure, "temperature_k": line.temperature},
            "reservoirs": {"room": {"pressure_pa": line.pressure}},
            "chambers": {"end": {"volume_m3": line.volume}},
            "pipes": {
                "feed": {
                    "from": "room",
                    "to": "inlet",
                    "length_m": feed,
                    "area_m2": area,
                    "wall": {"laminar": 20.0},
                },
                "tube": {
                    "from": "inlet",
                    "to": "end",
                    "length_m": lead + cells * dx,
                    "area_m2": area,
                    "wall": wall,
                },
            },
            "taps": {
                "inlet": {"pipe": "tube", "position_m": lead + 0.5 * dx},
                "end": {"chamber": "end"},
            },
        }
    )
    gas = bergh_tijdeman.LineGas()
    air = Gas(gas.gamma, gas.r_specific, gas.viscosity, gas.prandtl, t_ref=line.temperature)
    simulator = Simulator(rig, gas=air)
    state = simulator.state("feed")
    bump = 5e-4 * line.pressure * np.sin(np.pi * state["x_m"] / feed) ** 2
    rise = bump / line.pressure
    simulator.set_state(
        "feed", state["density"] * (1.0 + rise / gas.gamma), 0.0, state["pressure"] + bump
    )
    record = simulator.run(duration_s, sample_s=2.5e-4)
    waves = np.exp(-2j * np.pi * np.outer(frequency_hz, record.time_s))
    inlet, end = (waves @ (p - line.pressure) for p in record.pressures.values())
    return np.asarray(end / inlet)


def theory(line: Line, frequency_hz: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Bergh and Tijdeman's response of the same tube."""
    gas = bergh_tijdeman.LineGas(pressure=line.pressure, temperature=line.temperature)
    return bergh_tijdeman.tube_and_volume(line.radius, line.length, line.volume, frequency_hz, gas)


def draw(path: Path) -> None:
    """Draws all published curves with theory and simulation."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    curves = bergh_curves.load()
    frequency = np.arange(2.0, 301.0, 1.0)
    figure, panels = plt.subplots(
        6, 4, figsize=(15.0, 17.0), height_ratios=[2, 1] * 3, layout="constrained"
    )
    for k, curve in enumerate(curves):
        line = Line(curve.radius, curve.length, curve.volume, curve.pressure)
        ideal = theory(line, frequency)
        ours = simulated_response(line, frequency)
        steady = simulated_response(
            line, frequency, duration_s=2.0, memory=False, nusselt=0.0, heat_turbulent=0.0
        )
        top, bottom = panels[2 * (k // 4), k % 4], panels[2 * (k // 4) + 1, k % 4]
        band = frequency <= 200.0
        error = np.max(np.abs(np.abs(ours) / np.abs(ideal) - 1.0)[band])
        top.set_title(
            f"R {curve.radius * 1e3:g} mm, L {curve.length:g} m, V {curve.volume * 1e9:.0f} mm³, "
            f"{curve.pressure / 101325.0:g} atm",
            fontsize=10,
        )
        top.plot(
            frequency,
            np.abs(steady),
            color="0.75",
            lw=1.2,
            label="solver, steady friction, no wall heat",
        )
        top.plot(*curve.amplitude.T, "o", ms=3.5, mfc="none", color="C0", label="figure, 1965")
        top.plot(frequency, np.abs(ideal), "k-", lw=1.0, label="theory")
        top.plot(frequency, np.abs(ours), "--", color="C3", lw=1.6, label="solver, dx = 2 cm")
        top.set_ylim(0.0, 1.35 * max(np.abs(ideal).max(), 1.0))
        top.text(0.97, 0.93, f"to 200 Hz within {100.0 * error:.1f} %", transform=top.transAxes,
                 ha="right", va="top", fontsize=9)  # fmt: skip
        bottom.plot(*curve.phase.T, "o", ms=3.5, mfc="none", color="C0")
        bottom.plot(frequency, np.degrees(np.unwrap(np.angle(ideal))), "k-", lw=1.0)
        bottom.plot(frequency, np.degrees(np.unwrap(np.angle(ours))), "--", color="C3", lw=1.6)
        for panel in (top, bottom):
            panel.set_xlim(0.0, 300.0)
            panel.grid(alpha=0.3)
        top.tick_params(labelbottom=False)
        if k % 4 == 0:
            top.set_ylabel("amplitude ratio")
            bottom.set_ylabel("phase, degrees")
        if k // 4 == 2:
            bottom.set_xlabel("frequency, Hz")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle("Tube with end volume: pressure at the end over pressure at the inlet")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=90)
    plt.close(figure)


if __name__ == "__main__":
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else PICTURE)
