# SPDX-License-Identifier: Apache-2.0
"""What every result of one rig on its recordings begins with."""

from collections.abc import Sequence
from typing import Any

from pneu_sysid.problem import Problem
from pneu_sysid.results import pneu_version


def heading(problem: Problem, rig: str, findings: Sequence[str]) -> dict[str, Any]:
    """The fields of `results.Head`.

    Args:
        problem: The problem.
        rig: Name of the rig.
        findings: What was wrong with the recordings.
    """
    return {
        "pneu_version": pneu_version(),
        "recording": problem.name,
        "recordings": [recording.name for recording in problem.recordings],
        "rigs": [rig],
        "taps": problem.taps,
        "noise_floor_pa": dict(zip(problem.taps, problem.noise_pa.tolist(), strict=True)),
        "findings": list(findings),
    }
