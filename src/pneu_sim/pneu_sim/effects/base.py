# SPDX-License-Identifier: Apache-2.0
"""What every physical effect declares: formula, source, parameters, places, and how it acts."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from numpy.typing import ArrayLike

from pneu_sim.rig.kinds import found
from pneu_sim.rig.model import Model
from pneu_sim.rig.schema import Rig

POSITION = "position_m"
"""Name of the parameter that says where along a pipe an effect sits."""

FREQUENCY = "frequency_hz"
"""Name of the parameter that says how fast an effect pulsates; a recording's spectrum tells it."""

RESOLVED_CELLS = 3
"""Cells a pipe needs before positions along it are told apart."""


@dataclass(frozen=True)
class EffectParameter:
    """A number of an effect.

    Attributes:
        name: Name with unit suffix.
        unit: Unit for people.
        absent: Value at which the effect vanishes; for a shape parameter its usual value.
        lower: Lower bound.
        upper: Upper bound.
        typical: A strength that is clearly felt on a laboratory rig; tests inject it.
        step: Step for sensitivities at zero strength.
        fitted: Whether diagnosis fits it beside the strength.
        scanned: Values between its bounds that diagnosis looks at besides; 0 where the misfit has
            one valley.
    """

    name: str
    unit: str
    absent: float
    lower: float
    upper: float
    typical: float
    step: float
    fitted: bool = False
    scanned: int = 0


@dataclass(frozen=True)
class Comparison:
    """An experiment with a reference result, from a closed form or an independent model.

    Attributes:
        what: Name of the reference, such as "isentropic orifice".
        rig: The rig without the effect.
        place: Place of the effect.
        strengths: Strengths that are compared; the last one is extreme.
        measure: Returns the measured quantity of a rig, a number or an array.
        expected: Returns the reference value of that quantity at a strength.
        shape: Parameters of the effect other than its strength.
        allowed: Largest deviation, relative to the largest change that the effect makes.
    """

    what: str
    rig: Rig
    place: str
    strengths: tuple[float, ...]
    measure: Callable[[Rig], ArrayLike]
    expected: Callable[[float], ArrayLike]
    shape: Mapping[str, float] = field(default_factory=dict)
    allowed: float = 0.01


def position_along_pipe() -> EffectParameter:
    """The parameter of effects that sit at a point of a pipe; at most the pipe's length."""
    return EffectParameter(POSITION, "m", 0.0, 0.0, math.inf, 1.0, 0.01, fitted=True, scanned=11)


def resolved(rig: Rig, pipe: str) -> bool:
    """Whether a pipe has cells enough that positions along it are told apart.

    Args:
        rig: The rig.
        pipe: Name of the pipe.
    """
    part = rig.pipes[pipe]
    return part.length_m >= (RESOLVED_CELLS - 0.5) * (part.dx_m or rig.grid.dx_m)


class Effect(ABC):
    """A physical effect. Subclasses are one file each, and one line in the registry.

    The first of ``parameters`` is the strength; at its ``absent`` value the rig behaves as if the
    effect were not there. An effect along a pipe has a parameter named ``position_m``.

    Attributes:
        name: Identifier, as in ``pneu add NAME``.
        title: A few words for people.
        where: Kind of part it sits at, for people.
        formula: The law.
        source: Where the law is from.
        parameters: Strength first, then shape.
        order: Diagnosis looks at lower orders first when two effects explain equally much
            (sensors, timing, steady flow, holds, small signals, slow).
        spread_out: Whether it is much the same wherever along a pipe it sits, so that the middle is
            tried for all of it; its position is fitted all the same.
        curved: Whether what it changes is far from proportional to its strength: a small one looks
            unlike a large one, and it is tried at several strengths.
        traded: Whether strength and shape make up for each other, so that neither is known well
            though that there is the effect is.
        arm: Name of the fitted parameter by which the strength acts as a weight by its arm: their
            product is seen first, and is fitted in place of the strength; empty for none. Such an
            effect vanishes at strength zero.
        contains: Name of an effect that is a special case of this one; it is named instead, unless
            this one explains more.
        along_lines: Whether it acts on the cells of a line, so that models without them omit it.
        stage: Effects of a lower stage are applied first, whatever the order of attachment: the
            room before what is relative to it, and changes of position last.
        exchanges: What it exchanges with the room: "gas", "heat", or nothing.
        indistinguishable_from: Names of effects with exactly the same response on some rigs, such
            as friction of a slide and of the piston that drives it.
        next_experiment: Recording that shows this effect apart from its look-alikes.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    where: ClassVar[str] = "part of a rig"
    formula: ClassVar[str]
    source: ClassVar[str]
    parameters: ClassVar[tuple[EffectParameter, ...]]
    order: ClassVar[int] = 5
    spread_out: ClassVar[bool] = False
    curved: ClassVar[bool] = False
    traded: ClassVar[bool] = False
    arm: ClassVar[str] = ""
    contains: ClassVar[str | None] = None
    along_lines: ClassVar[bool] = False
    stage: ClassVar[int] = 0
    exchanges: ClassVar[tuple[str, ...]] = ()
    indistinguishable_from: ClassVar[tuple[str, ...]] = ()
    next_experiment: ClassVar[str]

    @property
    def strength(self) -> EffectParameter:
        """The parameter that measures how much of the effect there is."""
        return self.parameters[0]

    def fitted(self, rig: Rig, place: str) -> tuple[EffectParameter, ...]:
        """The parameters that diagnosis fits beside the strength; no position that no cell tells.

        Args:
            rig: The rig.
            place: One of ``places``.
        """
        return tuple(
            p
            for p in self.parameters[1:]
            if p.fitted and (p.name != POSITION or resolved(rig, place))
        )

    @property
    def has_position(self) -> bool:
        """Whether the effect sits at a point along a pipe."""
        return any(p.name == POSITION for p in self.parameters)

    @abstractmethod
    def places(self, rig: Rig) -> list[str]:
        """Names of the parts of a rig that may have this effect.

        Args:
            rig: The rig.
        """

    def available_places(self, rig: Rig) -> list[str]:
        """Return the ``places`` of this effect; none where the model of the rig omits it.

        Args:
            rig: The rig.
        """
        return [] if self.is_omitted(rig) else self.places(rig)

    def is_omitted(self, rig: Rig) -> bool:
        """Return whether the kind of model of a rig omits this effect.

        Args:
            rig: The rig.
        """
        kind: Any = found(rig.model).load()  # a `pneu_sim.models.ModelKind`, which knows effects
        return (self.along_lines and not kind.along_lines) or self.name in kind.omits(rig)

    def comparisons(self) -> tuple["Comparison", ...]:
        """Return experiments with a reference result; ``pneu effects --prove`` runs them.

        References of the built-in effects are in the tests.
        """
        return ()

    @abstractmethod
    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        """Changes a private copy of the rig to have the effect.

        Args:
            rig: Copy that may be changed freely.
            place: One of ``places``.
            values: Value of every parameter.
        """

    def on_model(  # noqa: B027 (most effects have nothing to do here)
        self, model: Model, rig: Rig, place: str, values: dict[str, float]
    ) -> None:
        """Changes the numbers of the built model, for effects that no rig field expresses.

        Args:
            model: Model that may be changed freely; rows are named in ``pneu_sim.layout``.
            rig: The rig it was built from.
            place: One of ``places``.
            values: Value of every parameter.
        """

    def limits(self, parameter: EffectParameter, rig: Rig, place: str) -> tuple[float, float]:
        """Bounds of a parameter at a place; a position ends where its pipe does.

        Args:
            parameter: One of ``parameters``.
            rig: The rig.
            place: One of ``places``.
        """
        if parameter.name == POSITION:
            return parameter.lower, min(parameter.upper, rig.pipes[place].length_m)
        return parameter.lower, parameter.upper

    def sites(self, rig: Rig, spacing_m: float = 0.25) -> Iterator[tuple[str, dict[str, float]]]:
        """Places to try, with a position where the effect sits along a pipe.

        A pipe of fewer than ``RESOLVED_CELLS`` cells cannot tell positions apart: only its middle
        is tried.

        Args:
            rig: The rig.
            spacing_m: Distance between tried positions.

        Yields:
            Place and the shape parameters to start from.
        """
        for place in self.available_places(rig):
            shape = {p.name: p.typical for p in self.parameters[1:]}
            if not self.has_position:
                yield place, shape
                continue
            pipe = rig.pipes[place]
            if self.spread_out or not resolved(rig, place):
                yield place, {**shape, POSITION: 0.5 * pipe.length_m}
                continue
            count = max(1, round(pipe.length_m / spacing_m))
            for i in range(count + 1):
                yield place, {**shape, POSITION: pipe.length_m * i / count}
