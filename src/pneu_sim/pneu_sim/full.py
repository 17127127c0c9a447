# SPDX-License-Identifier: Apache-2.0
"""The model in full: the equations of gas dynamics along every pipe."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.coupled import CoupledSolver
from pneu_sim.full_solver import FullSolver
from pneu_sim.gas import AIR, Gas
from pneu_sim.models import FromRest, ModelKind
from pneu_sim.rig.build import build
from pneu_sim.rig.plan import Plan
from pneu_sim.rig.schema import Rig
from pneu_sim.simulate import Course, InitialField, Prediction, RunOptions, predict
from pneu_sim.simulator import run_from_rest
from pneu_sim.solver import Solver

Floats = NDArray[np.float64]


class Full(ModelKind):
    """Quasi-one-dimensional Euler equations on the rig's network (thesis ch. 4 and 5)."""

    along_lines: ClassVar[bool] = True

    def predict(
        self,
        rigs: Sequence[Sequence[Rig]],
        plan: Plan,
        courses: Sequence[Course],
        field: InitialField,
        options: RunOptions = RunOptions(),
    ) -> list[Prediction]:
        """Runs rigs along recordings; see `ModelKind.predict`.

        Args:
            rigs: (n_courses, n_rigs).
            plan: Their grid plan.
            courses: The recordings.
            field: How readings spread over lines and chambers.
            options: How.

        Raises:
            InputError: Rigs have a mechanism, which is stepped alone.
        """
        for rig in (one for own in rigs for one in own if one.mechanism is not None):
            raise InputError(
                f"rig {rig.name!r}: mechanism: found one, along recordings bodies alone are moved"
            )
        built = {id(own): [build(rig, plan) for rig in own] for own in rigs}
        models = [built[id(own)] for own in rigs]
        return predict(models, courses, field, None, options)

    def from_rest(
        self, rig: Rig, commands: Mapping[str, Floats], sample_s: float, samples: int
    ) -> FromRest:
        """Runs a rig that starts from rest; see `ModelKind.from_rest`.

        Args:
            rig: The rig.
            commands: (T,) volts per command.
            sample_s: Interval of commands and readings, s.
            samples: How many there are.
        """
        return run_from_rest(rig, commands, sample_s, samples)

    def solver(self, rigs: Sequence[Rig], plan: Plan, gas: Gas = AIR) -> Solver:
        """What steps rigs side by side; see `ModelKind.solver`.

        Args:
            rigs: The rigs.
            plan: Their grid plan.
            gas: The gas.
        """
        models = [build(rig, plan, gas) for rig in rigs]
        if rigs[0].mechanism is None:
            return FullSolver(models)
        return CoupledSolver(models, rigs)
