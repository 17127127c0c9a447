# SPDX-License-Identifier: Apache-2.0
"""A real ventilator breathing a test lung: compared, fitted, diagnosed, and what stays unexplained.

Run ``python examples/ventilator.py``. The rig is fitted to one recording; the last line shows the
same calibration on another recording, of another setting, which it was never shown.
"""

import time
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from pneu_sim.rig import get_parameter, load_rig
from pneu_sim.rig.schema import Rig
from pneu_sysid.compare import compare
from pneu_sysid.diagnose import Diagnosis, diagnose
from pneu_sysid.fit import FitOutcome, fit_rig
from pneu_sysid.problem import record_for
from pneu_sysid.records import Recording
from pneu_sysid.results.compare import CompareResult

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "data" / "ventilator"
RIG = ROOT / "rigs" / "ventilator.yaml"
FITTED = DATA / "air_pc_1.dat"
OTHER = DATA / "air_pc_3.dat"
OTHER_START_S = 1.7
"""The other recording begins within a breath; from here on it starts between two, as the first."""


@dataclass(frozen=True)
class Outcome:
    """What came of the two recordings.

    Attributes:
        recording: The one the rig was fitted to.
        fit: The fit, every third breath kept aside.
        fit_s: Time it took.
        compared: Errors of the rig as described and as fitted.
        found: Diagnosis of the fitted rig on the recording it was fitted to.
        elsewhere: Errors on the other recording.
        found_elsewhere: Diagnosis there.
    """

    recording: Recording
    fit: FitOutcome
    fit_s: float
    compared: CompareResult
    found: Diagnosis
    elsewhere: CompareResult
    found_elsewhere: Diagnosis


def study() -> Outcome:
    """Fits the rig to one recording and tries it on that and on another."""
    nominal = load_rig(RIG)
    recording = record_for(nominal, str(FITTED))
    begun = time.perf_counter()
    # One horizon: this rig answers slowly, and shorter ones say little about it.
    fit = fit_rig(nominal, recording, hold_out=True, approach=False)
    fit_s = time.perf_counter() - begun
    models: list[tuple[str, Rig, str | None]] = [
        ("as described", nominal, None),
        ("fitted", fit.rig, None),
    ]
    other = record_for(nominal, str(OTHER), start_s=OTHER_START_S)
    return Outcome(
        recording=recording,
        fit=fit,
        fit_s=fit_s,
        compared=compare(recording, models),
        found=diagnose(fit.rig, recording),
        elsewhere=compare(other, models, refine=False),
        found_elsewhere=diagnose(fit.rig, other, refine=False),
    )


def main() -> None:
    """Prints the errors, the fitted parameters and the verdicts."""
    out = study()
    console = Console(width=120)
    table = Table(title="error at the airway, Pa")
    for column in ("recording", "noise", "as described", "fitted", "fitted, held out"):
        table.add_column(column, justify="left" if column == "recording" else "right")
    for result, held in (
        (out.compared, f"{out.fit.held_out_rmse['airway']:.1f}"),
        (out.elsewhere, "all of it"),
    ):
        errors = [f"{model.taps['airway'].rmse_pa:.1f}" for model in result.models]
        noise = f"{result.noise_floor_pa['airway']:.1f}"
        table.add_row(result.recording, noise, *errors, held)
    console.print(table)
    fitted = Table(title=f"fitted in {out.fit_s:.1f} s")
    for column in ("parameter", "start", "value", "std. error"):
        left = column == "parameter"
        fitted.add_column(column, justify="left" if left else "right", overflow="fold")
    for p, start in zip(out.fit.parameters, out.fit.start, strict=True):
        value = get_parameter(out.fit.rig, p.path)
        error = "-" if p.std_error is None else f"{p.std_error:.2g}"
        fitted.add_row(p.path, f"{start:.4g}", f"{value:.4g}", error)
    console.print(fitted)
    for warning in out.fit.warnings:
        console.print(warning)
    console.print("where the fitted model's error is:")
    regimes = out.compared.models[1].regimes
    for regime in sorted(regimes, key=lambda r: -(r.times_noise or 0.0))[:4]:
        console.print(f"  {regime.label}: {regime.rmse_pa:.0f} Pa, {100.0 * regime.share:.0f} %")
    console.print(f"grid: {out.compared.numerics.sentence}")
    for recording, found in (
        (out.recording.name, out.found),
        (out.elsewhere.recording, out.found_elsewhere),
    ):
        console.print(f"{recording}: {found.verdict}. {found.sentence}")


if __name__ == "__main__":
    main()
