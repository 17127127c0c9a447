# SPDX-License-Identifier: Apache-2.0
"""A fit of a few parameters, as far as single steps of it need it."""

from collections.abc import Sequence

from pneu_sim.rig.schema import FitParameter, Rig
from pneu_sysid.fit_step import Job, key_of
from pneu_sysid.parameters import variables_of
from pneu_sysid.records import Recording
from pneu_sysid.stages import Step, Work


def job_of(known: Rig, recording: Recording, few: Sequence[FitParameter], step: Step) -> Job:
    """What does not change from step to step.

    Args:
        known: The rig as it is known beforehand.
        recording: What is fitted.
        few: What is estimated.
        step: The only step that is known beforehand.
    """
    variables = variables_of(known, list(few))
    return Job(
        recordings=[recording],
        given=True,
        hold_out=False,
        robust=False,
        workers=None,
        work=Work.of_steps([(step, 1.0, len(few), 1)], lambda *told: None),
        centres={key_of(p): v.value for p, v in zip(few, variables, strict=True)},
        measured={},
        mirrors={},
    )
