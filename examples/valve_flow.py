# SPDX-License-Identifier: Apache-2.0
"""Flow of a valve by the thin-plate model and by the Riemann problem (thesis 6.3).

Run ``python examples/valve_flow.py`` (half a minute); it prints a table and draws
docs/figures/valve_flow.png, which needs matplotlib.

First the flow itself (thesis fig. 6.3): gas at rest on both sides of a fixed opening, by the
thin-plate model (eqs. 3.15-3.17) and by the exact solution of the Riemann problem. Then a cylinder
at the end of a line, filled after its valve has opened (fig. 6.4): one number of each model, the
plate's discharge factor or the opening's area, is fitted to the early or to the late part of the
filling. What they are compared with is the model in full on a grid four times as fine.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rich.console import Console
from rich.table import Table

from pneu_sim.gas import AIR
from pneu_sim.lumped.filling import flow_function
from pneu_sim.riemann import exact_flux
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import Rig
from pneu_sim.simulator import Simulator

ROOT = Path(__file__).resolve().parents[1]
RIG = ROOT / "rigs" / "valve_flow.yaml"
FIGURE = ROOT / "docs" / "figures" / "valve_flow.png"
DURATION_S = {1e-6: 1.8, 2e-6: 1.0, 4e-6: 0.6}
"""Openings, m^2, and how long the cylinder takes to fill through each."""
SAMPLE_S = 1e-3
FINER = 4
EARLY = (0.0, 0.5)
LATE = (0.8, 0.995)
"""Share of the whole rise of pressure that early and late parts are of."""
ROUNDS, TRIED = 3, 25

Floats = NDArray[np.float64]


def thin_plate_flux(ratio: ArrayLike, upstream_pa: float, temperature_k: float) -> Floats:
    """Mass flux through a thin plate with a discharge coefficient of 1, kg/(m^2 s).

    Args:
        ratio: Downstream over upstream pressure, below 1.
        upstream_pa: Upstream pressure, Pa.
        temperature_k: Temperature of the gas, K.
    """
    psi = [flow_function(float(x), AIR.gamma) for x in np.ravel(ratio)]
    return upstream_pa / np.sqrt(AIR.r_specific * temperature_k) * np.array(psi)


def riemann_flux(ratio: ArrayLike, upstream_pa: float, temperature_k: float) -> Floats:
    """Mass flux between two gases at rest, by the exact solution of the Riemann problem.

    Args:
        ratio: Downstream over upstream pressure, below 1.
        upstream_pa: Upstream pressure, Pa.
        temperature_k: Temperature of both, K.
    """
    up = float(AIR.density(upstream_pa, temperature_k))
    return np.array(
        [
            exact_flux(up, 0.0, upstream_pa, up * x, 0.0, x * upstream_pa, AIR.gamma, 50)[0]
            for x in np.ravel(ratio).tolist()
        ]
    )


@dataclass(frozen=True)
class Fitted:
    """One number of a model, fitted to a part of the filling.

    Attributes:
        model: ``thin_plate`` or ``pde``.
        part: ``early`` or ``late``.
        factor: The number over that of the rig file: discharge factor, or area.
        pressure_pa: (T,) pressure of the cylinder.
        early_pa: Root mean square of what is missed in the early part.
        late_pa: Likewise in the late one.
    """

    model: str
    part: str
    factor: float
    pressure_pa: Floats
    early_pa: float
    late_pa: float


@dataclass(frozen=True)
class Filling:
    """A cylinder filled through an opening.

    Attributes:
        area_m2: The opening.
        time_s: (T,) times.
        true_pa: (T,) pressure of the cylinder by the finer grid.
        fits: Both models, fitted to either part.
    """

    area_m2: float
    time_s: Floats
    true_pa: Floats
    fits: list[Fitted]

    def fit(self, model: str, part: str) -> Fitted:
        """One of the fits.

        Args:
            model: Its model.
            part: What it was fitted to.
        """
        return next(f for f in self.fits if (f.model, f.part) == (model, part))


def pressures(rigs: Rig | Sequence[Rig], duration_s: float, dx_m: float | None = None) -> Floats:
    """Pressure of the cylinder after the valve was told to open fully, (T,) or (T, rigs), Pa.

    Args:
        rigs: The rig, or several.
        duration_s: How long.
        dx_m: Cell length in place of the rig's.
    """
    simulator = Simulator(rigs, dx_m=dx_m)
    return simulator.run(duration_s, {"voltage": 10.0}, SAMPLE_S).chambers["cylinder"]


def with_discharge(rig: Rig, factor: float) -> Rig:
    """The rig's thin-plate model with a discharge factor.

    Args:
        rig: The rig.
        factor: The factor.
    """
    lumped = rig.lumped.model_copy(update={"discharge": factor})
    return rig.model_copy(update={"model": "thin_plate", "lumped": lumped})


def with_area(rig: Rig, factor: float) -> Rig:
    """The rig with another opening.

    Args:
        rig: The rig.
        factor: Area over the rig's.
    """
    copy = rig.model_copy(deep=True)
    copy.valves["valve"].ports["supply"].area_m2 *= factor
    return copy


def fill(area_m2: float) -> Filling:
    """Fills the cylinder, and fits both models to either part.

    Args:
        area_m2: Area of the valve's opening.
    """
    rig = load_rig(RIG)
    rig.valves["valve"].ports["supply"].area_m2 = area_m2
    duration_s = DURATION_S[area_m2]
    true = pressures(rig, duration_s, rig.grid.dx_m / FINER)
    rise = (true - true[0]) / (rig.reservoirs["supply"].pressure_pa - true[0])
    parts = {
        name: (rise >= first) & (rise < last)
        for name, (first, last) in (("early", EARLY), ("late", LATE))
    }
    kinds: dict[str, tuple[Callable[[Rig, float], Rig], float, float]] = {
        "thin_plate": (with_discharge, 0.1, 1.2),
        "pde": (with_area, 0.8, 1.25),
    }
    fits = []
    for model, (change, lower, upper) in kinds.items():
        for part, chosen in parts.items():
            low, high = lower, upper
            for _ in range(ROUNDS):
                factors = np.geomspace(low, high, TRIED)
                runs = pressures([change(rig, float(x)) for x in factors], duration_s)
                missed = np.sum((runs - true[:, None])[chosen] ** 2, axis=0)
                k = int(np.argmin(missed))
                low, high = factors[max(k - 1, 0)], factors[min(k + 1, TRIED - 1)]
            error = runs[:, k] - true
            early, late = (float(np.sqrt(np.mean(error[p] ** 2))) for p in parts.values())
            fits.append(Fitted(model, part, float(factors[k]), runs[:, k], early, late))
    return Filling(area_m2, SAMPLE_S * np.arange(true.size), true, fits)


def table_of(fillings: list[Filling]) -> Table:
    """The table of all fits.

    Args:
        fillings: The cylinders.
    """
    table = Table(title="a cylinder filled through a valve: error of its pressure")
    for column in ("opening, mm2", "model", "fitted to", "factor", "early, Pa", "late, Pa"):
        table.add_column(column, justify="right" if "," in column else "left")
    for filling in fillings:
        for f in filling.fits:
            opening = f"{1e6 * filling.area_m2:g}"
            errors = (f"{f.early_pa:.0f}", f"{f.late_pa:.0f}")
            table.add_row(opening, f.model, f.part, f"{f.factor:.3f}", *errors)
    return table


def draw(filling: Filling, path: Path) -> None:
    """The ratio of the flows, and the filling with its fits.

    Args:
        filling: The cylinder.
        path: File to write.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    rig = load_rig(RIG)
    gas = (rig.reservoirs["supply"].pressure_pa, rig.ambient.temperature_k)
    figure, axes = plt.subplots(1, 3, figsize=(13.5, 4.2), layout="constrained")
    ratio = np.concatenate([np.linspace(0.02, 0.98, 97), 1.0 - np.geomspace(0.019, 1e-4, 60)])
    axes[0].plot(ratio, thin_plate_flux(ratio, *gas) / riemann_flux(ratio, *gas), color="C3")
    axes[0].axvline(AIR.critical_pressure_ratio, color="0.7", lw=0.8)
    axes[0].set(ylim=(0.0, 20.0), xlabel="downstream over upstream pressure")
    axes[0].set(ylabel="flow, thin plate over Riemann problem")
    for axis, part in zip(axes[1:], ("early", "late"), strict=True):
        axis.plot(filling.time_s, 1e-5 * filling.true_pa, color="0.6", lw=4.0, label="finer grid")
        for model, colour, words in (("pde", "C0", "model in full"), ("thin_plate", "C3", "plate")):
            f = filling.fit(model, part)
            axis.plot(filling.time_s, 1e-5 * f.pressure_pa, color=colour, label=words)
        axis.set(title=f"fitted to the {part} part", xlabel="time, s", ylabel="pressure, bar")
        axis.legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    """Prints the table and draws the figure."""
    console = Console(width=120)
    gas = (load_rig(RIG).reservoirs["supply"].pressure_pa, load_rig(RIG).ambient.temperature_k)
    for x in (0.02, 0.05, 0.2, 0.528, 0.8, 0.9, 0.99, 0.999):
        flows = float(thin_plate_flux(x, *gas)[0] / riemann_flux(x, *gas)[0])
        console.print(f"pressure ratio {x:5g}: thin plate over Riemann problem {flows:.2f}")
    fillings = [fill(area_m2) for area_m2 in DURATION_S]
    console.print(table_of(fillings))
    draw(fillings[0], FIGURE)
    console.print(f"wrote {FIGURE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
