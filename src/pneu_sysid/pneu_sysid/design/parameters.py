# SPDX-License-Identifier: Apache-2.0
"""Which numbers of a rig an experiment is to tell, and which may hide what is missing."""

from pathlib import Path

from pneu_common.errors import InputError
from pneu_sim.rig.schema import FitParameter, Rig
from pneu_sysid.fit import as_fitted
from pneu_sysid.parameters import estimated_parameters


def parameters_to_learn(rig: Rig) -> list[FitParameter]:
    """What ``pneu fit`` would estimate, of the rig as a fit begins with it (`fit.as_fitted`).

    Args:
        rig: The rig.
    """
    listed, held = estimated_parameters(as_fitted(rig), rig.fit.parameters)
    return [p for p in listed if p.path not in held]


def open_parameters(rig: Rig, source: Path | str) -> list[FitParameter]:
    """What a calibration could not see of a rig, and may hide what it is missing.

    Args:
        rig: The rig.
        source: Its file.

    Raises:
        InputError: It has no calibration: all its numbers may hide anything.
    """
    if rig.calibration is None:
        raise InputError(
            f"{source}: has no calibration; what is missing can be told only from numbers that are"
            " known, so `pneu fit` comes first"
        )
    return [p for p in rig.fit.parameters if p.std_error is None]
