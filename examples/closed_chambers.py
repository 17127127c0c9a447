# SPDX-License-Identifier: Apache-2.0
"""Seven real chambers, filled and shut: the model without a leak fails, and the leak is named.

Run ``python examples/closed_chambers.py``; it prints a table and draws
docs/figures/closed_chambers.png, which needs matplotlib.

The e-folding time here is ``p / |dp/dt|`` of gauge pressure ``p``, taken at the middle of the
stretch used (the geometric mean of its first and last pressure), where the chord of an exponential
has the slope of the curve. The fitted leak gives it by its law, that of an orifice or of a porous
wall, whichever the diagnosis puts first; an exponential fitted straight to the readings, which
knows nothing of the rig, is the check.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.optimize import curve_fit

from pneu_sim.effects import find_effect
from pneu_sim.gas import AIR
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sysid.compare import compare
from pneu_sysid.diagnose import Diagnosis, diagnose
from pneu_sysid.learn import add_effect, refit_effects
from pneu_sysid.problem import make_problem, record_for
from pneu_sysid.records import Recording
from pneu_sysid.results.compare import CompareResult
from pneu_sysid.results.learn import Step

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "data" / "closed_chambers"
RIG = ROOT / "rigs" / "closed_chamber.yaml"
FIGURE = ROOT / "docs" / "figures" / "closed_chambers.png"
NAMES = (
    "Aluminium",
    "Formlabs",
    "Ultimaker_006",
    "Ultimaker_010",
    "Prusa",
    "Ultimaker_015",
    "Ultimaker_020",
)
STRETCHES = 4
ORIFICE, POROUS = "chamber_leak", "chamber_porous_leak"

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Chamber:
    """What one recording said.

    Attributes:
        name: Name of the chamber.
        recording: The stretch used.
        rig: Rig without the leak, its horizon short enough for this stretch.
        compared: Errors of both models without a leak.
        found: Diagnosis of the rig without the leak.
        before: Errors without the leak.
        after: Errors with it.
        law: The effect that the leak is added as.
        size: Its strength: effective area, m^2, or permeability x area / length, m^3.
        tau_s: E-folding time of the fitted leak.
        tau_error_s: Its standard error.
        direct_s: E-folding time of an exponential fitted to the readings.
        direct_error_s: Its standard error.
        predicted_pa: (T,) the fitted model over the whole stretch.
    """

    name: str
    recording: Recording
    rig: Rig
    compared: CompareResult
    found: Diagnosis
    before: Step
    after: Step
    law: str
    size: float
    tau_s: float
    tau_error_s: float
    direct_s: float
    direct_error_s: float
    predicted_pa: Floats


def stretch_of(rig: Rig, path: Path) -> Recording:
    """A recording up to where its gauge pressure has fallen to 1/e, if it ever has."""
    recording = record_for(rig, str(path))
    time_s, gauge = gauge_of(rig, recording)
    low = np.flatnonzero(gauge < np.median(gauge[:10]) / math.e)
    if not low.size:
        return recording
    return record_for(rig, str(path), end_s=float(time_s[low[0]]))


def gauge_of(rig: Rig, recording: Recording) -> tuple[Floats, Floats]:
    """When the chamber was read, s, and its gauge pressure then, Pa."""
    signal = recording.pressures["chamber"]
    return signal.time_s, signal.values - rig.ambient.pressure_pa


def cut(rig: Rig, recording: Recording) -> Rig:
    """The rig with a shorter horizon where the recording has no room for four of its own."""
    horizon = recording.end_s / (STRETCHES + 0.2)
    if horizon >= (rig.fit.horizon_s or 0.0):
        return rig
    # A leak this fast shows over one horizon, so the pull need not be slower than it sets it.
    fit = {"horizon_s": horizon, "warm_up_s": 0.15 * horizon, "nudge_s": None}
    return rig.model_copy(update={"fit": rig.fit.model_copy(update=fit)})


def inflation(residual: Floats) -> float:
    """How much a standard error that took residuals for unit white noise must grow.

    The root of mean square times integrated autocorrelation time, summed up to its first zero.
    """
    r = residual - residual.mean()
    power = np.abs(np.fft.rfft(r, 2 * r.size)) ** 2
    rho = np.fft.irfft(power)[: r.size] / float(np.sum(r * r))
    end = int(np.argmax(rho <= 0.0)) or r.size
    return math.sqrt(float(np.mean(residual**2)) * (1.0 + 2.0 * float(rho[1:end].sum())))


def e_folding_s(rig: Rig, law: str, size: float, gauge_pa: float) -> float:
    """E-folding time of gauge pressure of a chamber that leaks and stays at room temperature."""
    room, temperature = rig.ambient.pressure_pa, rig.ambient.temperature_k
    volume = rig.chambers["chamber"].volume_m3 + sum(
        p.length_m * p.area_m2 for p in rig.pipes.values()
    )
    p, gamma = room + gauge_pa, AIR.gamma
    if law == POROUS:
        return 2.0 * float(AIR.viscosity(temperature)) * volume / (size * (p + room))
    ratio = max(room / p, (2.0 / (gamma + 1.0)) ** (gamma / (gamma - 1.0)))
    psi = math.sqrt(
        2.0 * gamma / (gamma - 1.0) * (ratio ** (2.0 / gamma) - ratio ** ((gamma + 1.0) / gamma))
    )
    rt = AIR.r_specific * temperature
    return gauge_pa / (size * p * psi * math.sqrt(rt) / volume)


def direct_fit(time_s: Floats, gauge_pa: Floats) -> tuple[float, float]:
    """E-folding time of an exponential fitted to readings, and its standard error."""
    slope = -np.polyfit(time_s, np.log(gauge_pa), 1)[0]
    fitted, covariance = curve_fit(
        lambda t, p, rate: p * np.exp(-rate * t), time_s, gauge_pa, p0=(gauge_pa[0], slope)
    )
    rest = gauge_pa - fitted[0] * np.exp(-fitted[1] * time_s)
    grow = inflation(rest / np.std(rest))
    tau = 1.0 / float(fitted[1])
    return tau, grow * math.sqrt(covariance[1, 1]) * tau**2


def strength_of(law: str) -> str:
    """Name of the strength of a leak's law."""
    return find_effect(law).strength.name


def leak_of(rig: Rig, recording: Recording, law: str, start: float) -> tuple[float, float, Floats]:
    """Size of a leak over the whole recording run freely, its standard error, and the prediction.

    The sensor's offset goes along, so that the reading that starts the run is no pivot.
    """
    whole = rig.model_copy(
        update={
            "fit": rig.fit.model_copy(update={"horizon_s": None, "warm_up_s": 0.0}),
            "effects": [
                AttachedEffect(effect=law, place="chamber", parameters={strength_of(law): start}),
                AttachedEffect(effect="sensor_bias", place="chamber"),
            ],
        }
    )
    problem = make_problem(whole, recording)
    fitted, estimate = refit_effects(problem, whole, [0, 1], iterations=8)
    size = fitted.effects[0].parameters[strength_of(law)]
    error = math.sqrt(np.linalg.inv(estimate.jacobian[0].T @ estimate.jacobian[0])[0, 0])
    return size, error * inflation(estimate.residual[0]), problem.predict([fitted])[0, 0, :, 0]


def study(name: str) -> Chamber:
    """Takes one chamber through compare, diagnose, add and fit."""
    nominal = load_rig(RIG)
    recording = stretch_of(nominal, DATA / f"{name}.csv")
    rig = cut(nominal, recording)
    pde = rig.model_copy(update={"model": "pde"})
    compared = compare(recording, [("thin_plate", rig, None), ("pde", pde, None)], refine=False)
    found = diagnose(rig, recording, finalists=4, refine=False)
    law = POROUS if "porous" in found.finalists[0].site.effect.name else ORIFICE
    better, before, after = add_effect(rig, recording, law, "chamber")
    start = better.effects[-1].parameters[strength_of(law)]
    size, size_error, predicted = leak_of(rig, recording, law, start)
    time_s, gauge = gauge_of(rig, recording)
    middle = math.sqrt(float(np.median(gauge[:20]) * np.median(gauge[-20:])))
    tau = e_folding_s(rig, law, size, middle)
    direct, direct_error = direct_fit(time_s, gauge)
    return Chamber(
        name=name,
        recording=recording,
        rig=rig,
        compared=compared,
        found=found,
        before=before,
        after=after,
        law=law,
        size=size,
        tau_s=tau,
        tau_error_s=tau * size_error / size,
        direct_s=direct,
        direct_error_s=direct_error,
        predicted_pa=predicted,
    )


def seconds(value: float, error: float) -> str:
    """A time and its standard error, to the digits that the error leaves."""
    digits = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:.{digits}f} ± {error:.{digits}f}"


def table_of(chambers: list[Chamber]) -> Table:
    """The table of all chambers."""
    table = Table(title="closed chambers: a model without a leak")
    for column in (
        "chamber",
        "stretch, s",
        "thin plate, Pa",
        "pde, Pa",
        "leak, Pa",
        "verdict",
        "best",
    ):
        table.add_column(column, justify="right" if "," in column else "left")
    for column in ("held-out gain", "e-folding, s", "exponential, s"):
        table.add_column(column, justify="right")
    for c in chambers:
        best = c.found.finalists[0]
        alike = c.found.alike(0)
        table.add_row(
            c.name,
            f"{c.recording.end_s:.0f}",
            *(f"{model.rmse_pa:.0f}" for model in c.compared.models),
            f"{c.after.rmse_pa['chamber']:.0f}",
            c.found.verdict,
            " or ".join([best.site.effect.name, *(label.partition("@")[0] for label in alike)]),
            f"{100.0 * best.held_out:.0f} %",
            seconds(c.tau_s, c.tau_error_s),
            seconds(c.direct_s, c.direct_error_s),
        )
    return table


def draw(chambers: list[Chamber], path: Path) -> None:
    """Gauge pressure measured, without a leak, and with the fitted one."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 4, figsize=(13.0, 6.0), layout="constrained")
    for axis, c in zip(axes.flat, chambers, strict=False):
        scale = 1e-5
        room = c.rig.ambient.pressure_pa
        t, gauge = gauge_of(c.rig, c.recording)
        axis.plot(t, scale * gauge, color="0.6", lw=0.8, label="measured")
        axis.axhline(scale * float(np.median(gauge[:3])), color="C0", ls="--", label="no leak")
        axis.plot(t, scale * (c.predicted_pa - room), color="C3", label="leak added")
        axis.set_title(f"{c.name}: {seconds(c.tau_s, c.tau_error_s)} s", fontsize=10)
        axis.ticklabel_format(useOffset=False)
    for axis in axes[-1]:
        axis.set_xlabel("time, s")
    for axis in axes[:, 0]:
        axis.set_ylabel("gauge pressure, bar")
    handles, labels = axes.flat[0].get_legend_handles_labels()
    axes.flat[-1].axis("off")
    axes.flat[-1].legend(handles, labels, loc="center")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    """Prints the table and draws the figure."""
    chambers = [study(name) for name in NAMES]
    console = Console(width=220)
    console.print(table_of(chambers))
    for c in chambers:
        console.print(f"{c.name}: {c.found.sentence}")
    draw(chambers, FIGURE)
    console.print(f"wrote {FIGURE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
