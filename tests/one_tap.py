# SPDX-License-Identifier: Apache-2.0
"""The lab with one tap alone, as a calibration leaves it: much of it cannot be told apart."""

from pathlib import Path

from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import Calibration, Rig

LAB = load_rig(Path(__file__).resolve().parents[1] / "rigs" / "lab.yaml")
NOISE_PA = 250.0


def one_tap(dx_m: float) -> Rig:
    """The rig on cells of some length; only its delay was fitted, and is known."""
    known = LAB.fit.parameters[0].model_copy(update={"std": 1e-3, "std_error": 1e-5})
    return LAB.model_copy(
        update={
            "taps": {"end": LAB.taps["end"]},
            "grid": LAB.grid.model_copy(update={"dx_m": dx_m}),
            "calibration": Calibration(
                recording="healthy",
                rmse_pa={"end": 1.04 * NOISE_PA},
                noise_floor_pa={"end": NOISE_PA},
            ),
            "fit": LAB.fit.model_copy(update={"parameters": [known]}),
        }
    )
