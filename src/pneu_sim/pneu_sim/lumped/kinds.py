# SPDX-License-Identifier: Apache-2.0
"""The lumped models as kinds: volumes behind orifices, with or without the line's delay."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pneu_sim.gas import AIR, Gas
from pneu_sim.lumped import batch, delay_line, thin_plate
from pneu_sim.lumped.model import LumpedModel
from pneu_sim.lumped.moving import moving_solver
from pneu_sim.lumped.solver import LumpedSolver
from pneu_sim.models import FromRest, ModelKind
from pneu_sim.rig.plan import Plan
from pneu_sim.rig.schema import Rig
from pneu_sim.simulate import Course, InitialField, Prediction, RunOptions
from pneu_sim.simulator import run_from_rest
from pneu_sim.solver import Solver

Floats = NDArray[np.float64]


STILL = frozenset(
    {"regulator_droop", "supply_ripple", "chamber_heat", "chamber_convection", "cylinder_heat"}
)
"""Effects that change nothing where no piston moves: volumes keep their temperature, and sources
their pressure (thesis 3.2)."""


class Lumped(ModelKind):
    """A rig reduced to volumes and sources."""

    @classmethod
    def omits(cls, rig: Rig) -> frozenset[str]:
        """Names of effects that change nothing; see `ModelKind.omits`.

        Args:
            rig: The rig.
        """
        moving = bool(rig.moves or rig.cylinders)
        # all ports follow one law, and none of them is a way that a cushion narrows
        return (frozenset({"end_cushion"}) if moving else STILL) | {"critical_ratio"}

    @abstractmethod
    def build(self, rig: Rig, plan: Plan | None = None, gas: Gas = AIR) -> LumpedModel:
        """Reduces a rig.

        Args:
            rig: The rig; its attached effects are applied as far as a lumped model knows them.
            plan: Grid plan of the rig, from which volumes are summed; None makes the rig's own.
            gas: The gas.

        Raises:
            InputError: The rig has no such reduction.
        """

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
            field: Not looked at: volumes are drawn to the mean of their taps.
            options: How; the step follows the fastest volume, and none is unstable.
        """
        del field
        models = [[self.build(rig, plan) for rig in own] for own in rigs]
        return batch.predict(models, courses, options)

    def solver(self, rigs: Sequence[Rig], plan: Plan, gas: Gas = AIR) -> Solver:
        """What steps rigs side by side; see `ModelKind.solver`.

        Args:
            rigs: The rigs.
            plan: Their grid plan.
            gas: The gas.
        """
        return LumpedSolver([self.build(rig, plan, gas) for rig in rigs])


class ThinPlate(Lumped):
    """Volumes filled through orifices (thesis 3.2.1), which move pistons where a rig has any."""

    @classmethod
    def omits(cls, rig: Rig) -> frozenset[str]:
        """Names of effects that change nothing; see `ModelKind.omits`.

        Args:
            rig: The rig.
        """
        return super().omits(rig) | {"laminar_friction"}

    def build(self, rig: Rig, plan: Plan | None = None, gas: Gas = AIR) -> LumpedModel:
        """Reduces a rig; see `Lumped.build`.

        Args:
            rig: The rig.
            plan: Grid plan of the rig.
            gas: The gas.
        """
        return thin_plate.build(rig, plan, gas)

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
        if rig.moves:
            return run_from_rest(rig, commands, sample_s, samples)
        return super().from_rest(rig, commands, sample_s, samples)

    def solver(self, rigs: Sequence[Rig], plan: Plan, gas: Gas = AIR) -> Solver:
        """What steps rigs side by side; see `ModelKind.solver`.

        Args:
            rigs: The rigs.
            plan: Their grid plan.
            gas: The gas.
        """
        if not (rigs[0].moves or rigs[0].cylinders):
            return super().solver(rigs, plan, gas)
        return moving_solver(rigs, gas)  # pistons that move no body may be driven


class DelayLine(Lumped):
    """The same with the delay and attenuation of the line (thesis 3.2.2)."""

    def build(self, rig: Rig, plan: Plan | None = None, gas: Gas = AIR) -> LumpedModel:
        """Reduces a rig; see `Lumped.build`.

        Args:
            rig: The rig.
            plan: Grid plan of the rig.
            gas: The gas.
        """
        return delay_line.build(rig, plan, gas)
