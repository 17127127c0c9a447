# SPDX-License-Identifier: Apache-2.0
"""What a kind of model can do, and the one that a rig names.

A kind is one class: it runs rigs along recordings. All else, such as a run from rest or the
comparison of kinds on one recording, is made of that. It is named in `pneu_sim.rig.kinds`, or by an
entry point of another distribution.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.gas import AIR, Gas
from pneu_sim.rig.kinds import found
from pneu_sim.rig.plan import Plan, plan_grid
from pneu_sim.rig.schema import Rig
from pneu_sim.signals import Signal
from pneu_sim.simulate import Course, InitialField, Prediction, RunOptions, rest
from pneu_sim.solver import Solver

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class FromRest:
    """What is seen of a rig that starts from rest.

    Attributes:
        taps: Per tap its (T,) readings, Pa, without noise.
        joints: Per joint of a body its (T,) positions, rad or m.
        speeds: Per joint its (T,) velocities, rad/s or m/s.
        encoders: Per encoder its (T,) readings, rad or m, without noise.
    """

    taps: dict[str, Floats]
    joints: dict[str, Floats] = field(default_factory=dict)
    speeds: dict[str, Floats] = field(default_factory=dict)
    encoders: dict[str, Floats] = field(default_factory=dict)


class ModelKind(ABC):
    """A way to compute the gas of a rig.

    Attributes:
        along_lines: Whether there is gas along lines, cell by cell, with waves and walls; else a
            line is a volume. What looks at grids and at numbers of walls asks for this.
    """

    along_lines: ClassVar[bool] = False

    @classmethod
    def omits(cls, rig: Rig) -> frozenset[str]:
        """Names of effects that change nothing of a rig that is computed so.

        Those that act along lines are none of a kind that has no gas along them, named or not.

        Args:
            rig: The rig.
        """
        del rig
        return frozenset()

    @abstractmethod
    def predict(
        self,
        rigs: Sequence[Sequence[Rig]],
        plan: Plan,
        courses: Sequence[Course],
        field: InitialField,
        options: RunOptions = RunOptions(),
    ) -> list[Prediction]:
        """Runs rigs along recordings, in one batch.

        Args:
            rigs: (n_courses, n_rigs) of one structure; a course may share its list with others.
            plan: Their grid plan.
            courses: The recordings.
            field: How readings spread over lines and chambers, for kinds that have any.
            options: How.

        Returns:
            The predictions, one per course.

        Raises:
            InputError: A rig cannot be computed so, or is unstable and that is an error.
        """

    def solver(self, rigs: Sequence[Rig], plan: Plan, gas: Gas = AIR) -> Solver:
        """What steps rigs of one structure side by side, as commands come in.

        Args:
            rigs: The rigs.
            plan: Their grid plan.
            gas: The gas.

        Raises:
            InputError: Rigs cannot be stepped so: this kind only runs along recordings.
        """
        del plan, gas
        raise InputError(
            f"rig {rigs[0].name!r}: model: found {rigs[0].model}, which runs along recordings only"
        )

    def from_rest(
        self, rig: Rig, commands: Mapping[str, Floats], sample_s: float, samples: int
    ) -> "FromRest":
        """Runs a rig that starts from rest, its lines at their reservoirs' pressures.

        Args:
            rig: The rig.
            commands: (T,) volts per command, each held until the next; T is `samples`.
            sample_s: Interval of commands and readings, s.
            samples: How many there are, the first at the start.

        Raises:
            InputError: The rig cannot be computed so.
        """
        if rig.moves:  # predictions are of taps alone
            raise InputError(
                f"rig {rig.name!r}: model: found {rig.model}, which moves no bodies; use pde"
            )
        plan = plan_grid(rig)
        time = sample_s * np.arange(samples, dtype=np.float64)
        nothing = np.full((len(rig.taps), samples), np.nan)
        course = Course(
            {name: Signal(time, np.asarray(v, dtype=float)) for name, v in commands.items()},
            0.0,
            float(time[-1]),
            np.tile(time, (len(rig.taps), 1)),
            nothing,
            np.zeros_like(nothing),
            rest(rig, plan),
        )
        nowhere = InitialField(
            np.zeros((plan.slots, len(rig.taps))),
            np.zeros(plan.slots),
            np.zeros((len(plan.chambers), len(rig.taps))),
            np.zeros(len(plan.chambers)),
        )
        readings = self.predict([[rig]], plan, [course], nowhere)[0].readings
        return FromRest({name: readings[0, t] for t, name in enumerate(rig.taps)})


def kind_of(rig: Rig) -> ModelKind:
    """The kind of model that a rig names.

    Args:
        rig: The rig.

    Raises:
        InputError: What is named is no kind of model.
    """
    point = found(rig.model)
    kind = point.load()
    if not (isinstance(kind, type) and issubclass(kind, ModelKind)):
        raise InputError(f"model {rig.model}: {point.value} is no subclass of ModelKind")
    return kind()
