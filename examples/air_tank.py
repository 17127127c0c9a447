# SPDX-License-Identifier: Apache-2.0
"""A real tank emptied and filled through an orifice: without heat from its wall the model fails.

Run ``python examples/air_tank.py`` (three minutes); it prints two tables and draws
docs/figures/air_tank.png, which needs matplotlib. ``python examples/air_tank.py data`` makes the
files of ``data/air_tank`` that are read out of those that were published.

The thermometer is shown to nobody: diagnosis and sizes come from the pressure. A size found on one
recording is used on the other as well, and the gas's temperature is compared with every point.
"""

import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from ruamel.yaml import YAML
from scipy.interpolate import PchipInterpolator

from pneu_sim.effects import find_effect
from pneu_sim.rig import load_rig
from pneu_sim.rig.parameters import rig_in_recording
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sim.simulator import Simulator
from pneu_sysid.diagnose import Diagnosis, diagnose
from pneu_sysid.learn import refit_effects
from pneu_sysid.problem import make_problem, record_for

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "data" / "air_tank"
RIG = ROOT / "rigs" / "air_tank.yaml"
FIGURE = ROOT / "docs" / "figures" / "air_tank.png"
PUBLISHED = {"discharge": "Air_790kPa_21mm.yml", "filling": "Air_3-7kPa_271mm.yml"}
START_PA = {"discharge": 7.9e5, "filling": 3.7e3}
"""Pressure at time zero, from the same files."""
CONSTANT, CONVECTION = "chamber_heat", "chamber_convection"
LENGTH_M, DIAMETER_M = 0.515, 0.20
WALL_M2 = math.pi * DIAMETER_M * (LENGTH_M + 0.5 * DIAMETER_M)
"""Inner wall of the tank, both ends flat."""
WITHIN_K = 5.0
SAMPLE_S = 0.05
OTHERWISE = ((2000.0, 10.0), (3000.0, 20.0), (2000.0, 20.0))
"""Other uncertainties of a point, Pa, and lengths of stretches, s: the verdict depends on them."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Sized:
    """A law of heat, and how much of it there is.

    Attributes:
        law: Name of the effect; empty for an adiabatic tank.
        size: Its strength.
        error: Standard error of it, 0 where it was not fitted.
        found_on: The recording whose pressure told it, or where else it is from.
    """

    law: str
    size: float
    error: float
    found_on: str


@dataclass(frozen=True)
class Judged:
    """What a model says of a recording.

    Attributes:
        sized: The law.
        recording: Name of the recording.
        time_s: (T,) times of what follows.
        pressure_pa: (T,) pressure of the gas.
        temperature_k: (T,) temperature of the gas.
        pressure_error_pa: (n,) at the published points, model less measured.
        error_k: (n,) likewise of the temperature.
    """

    sized: Sized
    recording: str
    time_s: Floats
    pressure_pa: Floats
    temperature_k: Floats
    pressure_error_pa: Floats
    error_k: Floats


def points(name: str, what: str) -> tuple[Floats, Floats]:
    """Published points of a recording: times, s, and pressure, Pa, or temperature, K.

    Args:
        name: Name of the recording.
        what: ``pressure`` or ``temperature``.
    """
    time_s, value = np.loadtxt(
        DATA / f"{name}_{what}.csv", delimiter=",", skiprows=1, unpack=True, dtype=float
    )
    return time_s, value * (1e5 if what == "pressure" else 1.0)


def write_data(folder: Path = DATA) -> None:
    """Makes the text files out of the published ones.

    A recording needs more readings than the fifteen points of a curve. They are laid on the curve
    once a second, by monotone cubics, of the logarithm where pressure falls to an eighth.

    Args:
        folder: Where the published files are and the others go.
    """
    for name, file in PUBLISHED.items():
        curves = YAML(typ="safe").load((folder / file).read_text(encoding="utf-8"))["validation"]
        temperature = next(iter(curves["temperature"].values()))
        pressure = curves["pressure"]
        for what, unit, time_s, values in (
            ("pressure", "bar", pressure["time"], pressure["pres"]),
            ("temperature", "k", temperature["time"], temperature["temp"]),
        ):
            rows = [f"{t},{v}\n" for t, v in zip(time_s, values, strict=True)]
            text = "".join([f"time_s,{what}_{unit}\n", *rows])
            (folder / f"{name}_{what}.csv").write_text(text, encoding="utf-8")
        at = np.arange(pressure["time"][0], pressure["time"][-1], 1.0)
        if name == "discharge":
            laid = np.exp(PchipInterpolator(pressure["time"], np.log(pressure["pres"]))(at))
        else:
            laid = PchipInterpolator(pressure["time"], pressure["pres"])(at)
        rows = [f"{t:.4f},{p:.5f}\n" for t, p in zip(at, laid, strict=True)]
        text = "".join(["time_s,pressure_bar\n", *rows])
        (folder / f"{name}.csv").write_text(text, encoding="utf-8")


def with_heat(rig: Rig, law: str, size: float) -> Rig:
    """The rig with a law of heat, or as it is.

    Args:
        rig: The rig.
        law: Name of the effect; empty for none.
        size: Its strength.
    """
    if not law:
        return rig
    parameters = {find_effect(law).strength.name: size}
    attached = AttachedEffect(effect=law, place="tank", parameters=parameters)
    return rig.model_copy(update={"effects": [attached]})


def named(name: str, noise_pa: float | None = None, horizon_s: float | None = None) -> Diagnosis:
    """What diagnosis says of a recording's pressure.

    Args:
        name: Name of the recording.
        noise_pa: How uncertain its readings are; None is as in the rig file.
        horizon_s: Length of its stretches; None is as in the rig file.
    """
    rig = load_rig(RIG)
    if noise_pa is not None:
        rig.taps["tank"].noise_pa = noise_pa
    if horizon_s is not None:
        rig.fit.horizon_s = horizon_s
    return diagnose(rig, record_for(rig, str(DATA / f"{name}.csv")), finalists=6, refine=False)


def size_of(name: str, law: str) -> Sized:
    """Size of a law over a whole recording's pressure, run freely; the orifice as it is described.

    Args:
        name: Name of the recording.
        law: Name of the effect.
    """
    rig = load_rig(RIG)
    free = rig.fit.model_copy(update={"horizon_s": None, "warm_up_s": 0.0})
    start = {CONSTANT: 3.0, CONVECTION: WALL_M2}[law]
    rig = with_heat(rig.model_copy(update={"fit": free}), law, start)
    problem = make_problem(rig, record_for(rig, str(DATA / f"{name}.csv")))
    fitted, estimate = refit_effects(problem, rig, [0], iterations=10)
    error = 1.0 / math.sqrt(float(np.sum(estimate.jacobian[0] ** 2)))
    return Sized(law, fitted.effects[0].parameters[find_effect(law).strength.name], error, name)


def judge(name: str, sized: Sized) -> Judged:
    """Runs a model from the start of a recording, and compares it with all published points.

    Args:
        name: Name of the recording.
        sized: Its law of heat.
    """
    rig = rig_in_recording(with_heat(load_rig(RIG), sized.law, sized.size), name)
    simulator = Simulator(rig)
    simulator.reset({"tank": START_PA[name], "stub": START_PA[name]})
    curves = {what: points(name, what) for what in ("pressure", "temperature")}
    steps = math.ceil(max(float(t.max()) for t, _ in curves.values()) / SAMPLE_S)
    gas = [simulator.chamber_gas("tank")]
    for _ in range(steps):
        simulator.run(SAMPLE_S, sample_s=SAMPLE_S)
        gas.append(simulator.chamber_gas("tank"))
    time_s = SAMPLE_S * np.arange(steps + 1)
    of = {what: np.array([float(g[what]) for g in gas]) for what in curves}
    errors = {what: np.interp(t, time_s, of[what]) - y for what, (t, y) in curves.items()}
    return Judged(
        sized,
        name,
        time_s,
        of["pressure"],
        of["temperature"],
        errors["pressure"],
        errors["temperature"],
    )


def as_shown(judged: Judged, lag_s: float) -> Floats:
    """Errors of temperature where the thermometer lags, K.

    Args:
        judged: The model.
        lag_s: Time constant of the thermometer; 0 is none.
    """
    shown = judged.temperature_k.copy()
    if lag_s > 0.0:
        keep = math.exp(-SAMPLE_S / lag_s)
        for k in range(1, shown.size):
            shown[k] = judged.temperature_k[k] + keep * (shown[k - 1] - judged.temperature_k[k])
    time_s, measured = points(judged.recording, "temperature")
    return np.asarray(np.interp(time_s, judged.time_s, shown) - measured)


def lag_of(judged: Judged) -> float:
    """Lag of a thermometer that would make most of the errors go, to half a second.

    Args:
        judged: The model.
    """
    lags = np.arange(0.0, 15.0, 0.5)
    return float(lags[np.argmin([rms(as_shown(judged, lag)) for lag in lags])])


def rms(error: Floats) -> float:
    """Root of the mean square.

    Args:
        error: (n,) errors.
    """
    return float(np.sqrt(np.mean(error**2)))


def worst(error: Floats) -> float:
    """The error that is farthest from zero, with its sign.

    Args:
        error: (n,) errors.
    """
    return float(error[np.argmax(np.abs(error))])


def beyond(error: Floats) -> str:
    """How many points are farther away than the bound, of how many.

    Args:
        error: (n,) errors, K.
    """
    return f"{int(np.sum(np.abs(error) > WITHIN_K))} of {error.size}"


def laws() -> list[Sized]:
    """Without heat; both laws as each recording's pressure sizes them; convection as drawn."""
    found = [size_of(name, law) for law in (CONSTANT, CONVECTION) for name in PUBLISHED]
    return [Sized("", 0.0, 0.0, ""), *found, Sized(CONVECTION, WALL_M2, 0.0, "drawing")]


def table_of(judged: list[Judged]) -> Table:
    """The table of all models on both recordings.

    Args:
        judged: The models.
    """
    table = Table(title=f"air tank: temperature of the gas at the published points, {WITHIN_K:g} K")
    columns = ("recording", "heat", "size", "found on", "pressure, Pa", "rms, K", "worst, K")
    for column in (*columns, "beyond"):
        table.add_column(column, justify="right" if "," in column else "left")
    for j in judged:
        s = j.sized
        unit = find_effect(s.law).strength.unit if s.law else ""
        error = f" ± {s.error:.2g}" if s.error else ""
        table.add_row(
            j.recording,
            s.law or "none",
            f"{s.size:.3g}{error} {unit}" if s.law else "",
            s.found_on,
            f"{rms(j.pressure_error_pa):.0f}",
            f"{rms(j.error_k):.1f}",
            f"{worst(j.error_k):+.1f}",
            beyond(j.error_k),
        )
    return table


def draw(judged: list[Judged], path: Path) -> None:
    """Pressure and temperature: measured, adiabatic, and with either law sized on the discharge.

    Args:
        judged: The models.
        path: File to write.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(11.0, 7.0), layout="constrained", sharex="col")
    styles = {
        ("", ""): ("C0", "--", "adiabatic"),
        (CONSTANT, "discharge"): ("C1", "-", "conductance, sized on the discharge's pressure"),
        (CONVECTION, "discharge"): ("C3", "-", "convection, sized on the discharge's pressure"),
        (CONVECTION, "drawing"): ("C2", ":", "convection, wall area of the drawing"),
    }
    for column, name in zip(axes.T, PUBLISHED, strict=True):
        for j in judged:
            style = styles.get((j.sized.law, j.sized.found_on))
            if j.recording != name or style is None:
                continue
            colour, line, label = style
            column[0].plot(j.time_s, 1e-5 * j.pressure_pa, color=colour, ls=line, label=label)
            column[1].plot(j.time_s, j.temperature_k, color=colour, ls=line, label=label)
        for axis, what, scale in ((column[0], "pressure", 1e-5), (column[1], "temperature", 1.0)):
            time_s, value = points(name, what)
            axis.plot(time_s, scale * value, "k.", ms=7, label="measured")
        column[0].set_title(name)
        column[1].set_xlabel("time, s")
    axes[0, 0].set_ylabel("pressure, bar absolute")
    axes[1, 0].set_ylabel("gas temperature, K")
    axes[0, 0].legend(fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    """Prints the tables and draws the figure; or makes the data."""
    if sys.argv[1:] == ["data"]:
        write_data()
        return
    console = Console(width=200)
    for name in PUBLISHED:
        found = named(name)
        console.print(f"{name}: {found.verdict}. {found.sentence}")
    for noise_pa, horizon_s in OTHERWISE:
        found = named("discharge", noise_pa, horizon_s)
        console.print(
            f"discharge, read to {noise_pa:g} Pa, in stretches of {horizon_s:g} s:"
            f" {found.verdict}. {found.sentence}"
        )
    every = laws()
    judged = [judge(name, sized) for name in PUBLISHED for sized in every]
    console.print(table_of(judged))
    drawn = {j.recording: j for j in judged if j.sized.found_on == "drawing"}
    lag_s = lag_of(drawn["discharge"])
    for name, j in drawn.items():
        shown = as_shown(j, lag_s)
        console.print(
            f"{name}, convection as drawn, read by a thermometer that lags {lag_s:g} s (found on"
            f" the discharge): rms {rms(shown):.1f} K, worst {worst(shown):+.1f} K,"
            f" {beyond(shown)} beyond {WITHIN_K:g} K"
        )
    draw(judged, FIGURE)
    console.print(f"wrote {FIGURE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
