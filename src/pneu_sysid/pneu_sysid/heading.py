# SPDX-License-Identifier: Apache-2.0
"""What every result of one rig on its recordings begins with."""

from collections.abc import Sequence
from typing import Any

from pneu_common.installed import version
from pneu_sim.rig.schema import Rig
from pneu_sysid.problem import Problem
from pneu_sysid.sensor_units import apart, encoder_units


def heading(problem: Problem, rig: Rig, name: str, findings: Sequence[str]) -> dict[str, Any]:
    """The fields of `results.Head`.

    Args:
        problem: The problem.
        rig: The rig.
        name: Its name.
        findings: What was wrong with the recordings.
    """
    encoders = {n: unit for n, unit in encoder_units(rig).items() if n in problem.taps}
    noise = dict(zip(problem.taps, problem.noise_pa.tolist(), strict=True))
    of_taps, of_encoders = apart(noise, encoders)
    return {
        "pneu_version": version(),
        "recording": problem.name,
        "recordings": [recording.name for recording in problem.recordings],
        "rigs": [name],
        "taps": list(of_taps),
        "encoders": encoders,
        "noise_floor_pa": of_taps,
        "noise_floor": of_encoders,
        "findings": list(findings),
    }
