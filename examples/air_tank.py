# SPDX-License-Identifier: Apache-2.0
"""A real tank emptied and filled through an orifice: without heat from its wall the model fails.

Run ``python examples/air_tank.py`` (two to four minutes); it prints what diagnosis says and a
table, and draws docs/figures/air_tank.png, which needs matplotlib. ``python examples/air_tank.py
data`` makes the files of ``data/air_tank`` that are read out of those that were published.

The thermometer is shown to nobody but to one number, its own lag: diagnosis and sizes come from the
pressure, convection's area from the drawing. A size or a lag found on one recording is used on the
other as well, and the gas's temperature is compared with every point.
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
from pneu_sim.gas import AIR
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
ORIFICE_M, AUTHORS_M = 0.00271, 0.10
"""Diameter of the jet: the orifice's, and what the data's author gave his model (`D_throat`)."""
WIDER = 1.035
"""What the orifice passes relative to its description, where it is tried otherwise."""
WITHIN_K = 5.0
SAMPLE_S = 0.05
MOST_LAG_S = 20.0
"""Longest lag that is tried."""
FULL_S = 21.8
"""Time of a point of the filling after which next to nothing enters."""
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
        inlet_m: Diameter of the jet that stirs, 0 has none; convection only.
    """

    law: str
    size: float
    error: float
    found_on: str
    inlet_m: float = 0.0


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


def with_heat(rig: Rig, sized: Sized) -> Rig:
    """The rig with a law of heat, or as it is.

    Args:
        rig: The rig.
        sized: The law.
    """
    rig = rig.model_copy(deep=True)
    rig.chambers["tank"].inlet_m = sized.inlet_m or None
    if sized.law and sized.inlet_m == 0.0 and sized.law == CONVECTION:
        rig.chambers["tank"].convection_m2 = sized.size  # the effect has a jet in any case
    elif sized.law:
        parameters = {find_effect(sized.law).strength.name: sized.size}
        attached = AttachedEffect(effect=sized.law, place="tank", parameters=parameters)
        rig.effects = [attached]
    return rig


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
    inlet_m = ORIFICE_M if law == CONVECTION else 0.0
    rig = with_heat(rig.model_copy(update={"fit": free}), Sized(law, start, 0.0, "", inlet_m))
    problem = make_problem(rig, record_for(rig, str(DATA / f"{name}.csv")))
    fitted, estimate = refit_effects(problem, rig, [0], iterations=10)
    error = 1.0 / math.sqrt(float(np.sum(estimate.jacobian[0] ** 2)))
    size = fitted.effects[0].parameters[find_effect(law).strength.name]
    return Sized(law, size, error, name, inlet_m)


def judge(name: str, sized: Sized, passes: float = 1.0) -> Judged:
    """Runs a model from the start of a recording, and compares it with all published points.

    Args:
        name: Name of the recording.
        sized: Its law of heat.
        passes: What the orifice passes, relative to its description.
    """
    rig = rig_in_recording(with_heat(load_rig(RIG), sized), name)
    rig.orifices["hole"].conductance_m3_s_pa *= passes
    simulator = Simulator(rig)
    simulator.reset({"tank": START_PA[name], "stub": START_PA[name]})
    curves = {what: points(name, what) for what in ("pressure", "temperature")}
    steps = math.ceil(max(float(t.max()) for t, _ in curves.values()) / SAMPLE_S)
    out = simulator.run(steps * SAMPLE_S, sample_s=SAMPLE_S)
    of = {"pressure": out.chambers["tank"], "temperature": out.temperatures["tank"]}
    errors = {what: np.interp(t, out.time_s, of[what]) - y for what, (t, y) in curves.items()}
    return Judged(
        sized,
        name,
        out.time_s,
        of["pressure"],
        of["temperature"],
        errors["pressure"],
        errors["temperature"],
    )


def shown_by(judged: Judged, lag_s: float) -> Floats:
    """What a thermometer that lags shows of a model's gas, K.

    Args:
        judged: The model.
        lag_s: Time constant of the thermometer; 0 is none.
    """
    shown = judged.temperature_k.copy()
    if lag_s > 0.0:
        keep = math.exp(-SAMPLE_S / lag_s)
        for k in range(1, shown.size):
            shown[k] = judged.temperature_k[k] + keep * (shown[k - 1] - judged.temperature_k[k])
    return shown


def as_shown(judged: Judged, lag_s: float) -> Floats:
    """Errors of temperature where the thermometer lags, K.

    Args:
        judged: The model.
        lag_s: Time constant of the thermometer; 0 is none.
    """
    time_s, measured = points(judged.recording, "temperature")
    return np.asarray(np.interp(time_s, judged.time_s, shown_by(judged, lag_s)) - measured)


def lag_of(judged: Judged) -> float:
    """Lag of a thermometer that would make most of the errors go, to half a second.

    Args:
        judged: The model.
    """
    lags = np.arange(0.0, MOST_LAG_S + 0.25, 0.5)
    return float(lags[np.argmin([rms(as_shown(judged, lag)) for lag in lags])])


def sheath_m(lag_s: float, nusselt: float) -> float:
    """Diameter of a steel sheath that lags so in gas: what it stores over what its skin passes.

    tau = rho c d / (4 h) and h = Nu k / d. A thin cylinder in gas that hardly moves has a Nusselt
    number between 1 and 2 (Morgan 1975, Adv. Heat Transfer 11, 199-264).

    Args:
        lag_s: Its time constant.
        nusselt: Nusselt number of its skin.
    """
    steel = 8000.0 * 500.0  # J/(m^3 K)
    return math.sqrt(4.0 * nusselt * float(AIR.conductivity(290.0)) * lag_s / steel)


def settles_s(time_s: Floats, temperature_k: Floats) -> float:
    """E-folding time of the gas's excess in the filling, from the end of the inflow on.

    Args:
        time_s: (n,) times in order.
        temperature_k: (n,) temperatures.
    """
    room_k = rig_in_recording(load_rig(RIG), "filling").ambient.temperature_k
    begin, end = np.interp((FULL_S, time_s[-1]), time_s, temperature_k) - room_k
    return float((time_s[-1] - FULL_S) / math.log(begin / end))


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


def drawn(inlet_m: float) -> Sized:
    """Convection along the wall of the drawing, nothing of it fitted.

    Args:
        inlet_m: Diameter of the jet that stirs, 0 has none.
    """
    return Sized(CONVECTION, WALL_M2, 0.0, "drawing", inlet_m)


def laws() -> list[Sized]:
    """Without heat; both laws as each recording's pressure sizes them; convection as drawn."""
    found = [size_of(name, law) for law in (CONSTANT, CONVECTION) for name in PUBLISHED]
    return [Sized("", 0.0, 0.0, ""), *found, *map(drawn, (0.0, ORIFICE_M, AUTHORS_M))]


def summary(error: Floats) -> str:
    """Root mean square and worst of errors, and how many are farther away than the bound.

    Args:
        error: (n,) errors, K.
    """
    return f"{rms(error):.1f}, {worst(error):+.1f}, {beyond(error)}"


def table_of(judged: list[Judged]) -> Table:
    """The table of all models on both recordings.

    Args:
        judged: The models.
    """
    table = Table(
        title="air tank: errors of the gas's temperature at the published points, K: rms, worst,"
        f" how many beyond {WITHIN_K:g} K"
    )
    columns = ("recording", "heat", "jet, mm", "size", "found on", "pressure, Pa", "no lag")
    for column in (*columns, *(f"lag of the {name}" for name in PUBLISHED)):
        table.add_column(column, justify="right" if "," in column else "left")
    lag_s = {(j.recording, j.sized): lag_of(j) for j in judged}
    for j in judged:
        s = j.sized
        lags = [lag_s[name, s] for name in PUBLISHED]
        unit = find_effect(s.law).strength.unit if s.law else ""
        error = f" ± {s.error:.2g}" if s.error else ""
        table.add_row(
            j.recording,
            s.law or "none",
            f"{1e3 * s.inlet_m:g}" if s.inlet_m else "",
            f"{s.size:.3g}{error} {unit}" if s.law else "",
            s.found_on,
            f"{rms(j.pressure_error_pa):.0f}",
            summary(j.error_k),
            *(f"{lag:g} s: {summary(as_shown(j, lag))}" for lag in lags),
        )
    return table


def draw(judged: list[Judged], path: Path) -> None:
    """Pressure and temperature, measured and modelled; dotted as a lagging thermometer shows it.

    Args:
        judged: The models.
        path: File to write.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(11.0, 7.0), layout="constrained", sharex="col")
    styles = {
        ("", "", 0.0): ("C0", "adiabatic"),
        (CONSTANT, "discharge", 0.0): ("C1", "conductance, sized on the discharge's pressure"),
        (CONVECTION, "drawing", 0.0): ("C2", "convection as drawn, still gas"),
        (CONVECTION, "drawing", ORIFICE_M): ("C3", "with the orifice's jet"),
        (CONVECTION, "drawing", AUTHORS_M): ("C4", "with a jet of 100 mm"),
    }
    lag_s = lag_of(next(j for j in judged if j.sized == drawn(0.0) and j.recording == "discharge"))
    for column, name in zip(axes.T, PUBLISHED, strict=True):
        for j in judged:
            style = styles.get((j.sized.law, j.sized.found_on, j.sized.inlet_m))
            if j.recording != name or style is None:
                continue
            colour, label = style
            line = "-" if j.sized.law else "--"
            column[0].plot(j.time_s, 1e-5 * j.pressure_pa, color=colour, ls=line, label=label)
            column[1].plot(j.time_s, j.temperature_k, color=colour, ls=line)
            if j.sized.found_on == "drawing":
                column[1].plot(j.time_s, shown_by(j, lag_s), color=colour, ls=":")
        for axis, what, scale in ((column[0], "pressure", 1e-5), (column[1], "temperature", 1.0)):
            time_s, value = points(name, what)
            axis.plot(time_s, scale * value, "k.", ms=7, label="measured")
        column[0].set_title(name)
        column[1].set_xlabel("time, s")
    axes[0, 0].set_ylabel("pressure, bar absolute")
    axes[1, 0].set_ylabel("gas temperature, K")
    axes[1, 1].plot([], [], "k:", label=f"as a thermometer that lags {lag_s:g} s shows it")
    for axis, place in ((axes[0, 0], "upper right"), (axes[1, 1], "center right")):
        axis.legend(fontsize=9, loc=place)
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
    of = {(j.recording, j.sized): j for j in judged}
    lag_s = lag_of(of["discharge", drawn(0.0)])
    console.print(
        f"a lag of {lag_s:g} s is that of a sheath of {1e3 * sheath_m(lag_s, 1.0):.1f} to"
        f" {1e3 * sheath_m(lag_s, 2.0):.1f} mm"
    )
    wider = judge("discharge", drawn(0.0), WIDER)
    console.print(
        f"discharge, still gas as drawn, an orifice that passes {100.0 * (WIDER - 1.0):.1f} % more:"
        f" pressure {rms(wider.pressure_error_pa):.0f} Pa, temperature, lag {lag_of(wider):g} s:"
        f" {summary(as_shown(wider, lag_of(wider)))}"
    )
    time_s, read_k = points("filling", "temperature")
    still, stirred = (of["filling", drawn(inlet_m)] for inlet_m in (0.0, ORIFICE_M))
    colder = int(np.sum(stirred.error_k < 0.0))
    console.print(
        f"filling: with the orifice's jet the gas is colder than read at {colder} of"
        f" {time_s.size} points; after the inflow what was read settles in"
        f" {settles_s(time_s, read_k):.0f} s, still gas as drawn in"
        f" {settles_s(still.time_s, still.temperature_k):.0f} s"
    )
    draw(judged, FIGURE)
    console.print(f"wrote {FIGURE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
