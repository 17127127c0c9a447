# SPDX-License-Identifier: Apache-2.0
"""What a body has: joints, numbers, places where cylinders take hold, and itself as MJCF.

Its equations of motion are in ``pneu_sim.kernel.equations``, in a file of the same name.
"""

import math
from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from pneu_sim.parts import Finite, NonNegative, Part, Positive, Share

Floats = NDArray[np.float64]


class Joint(Part):
    """A joint of a body: a rotation in rad, or a translation in m.

    Attributes:
        name: Its name in `sensor_msgs/JointState`; None is the body's name and its own.
        start: Where it stands at the beginning, rad or m.
        held: Whether it is clamped there.
        viscous: Friction per speed, N m s/rad, or N s/m.
        dry_friction: Dry friction, N m or N, whatever the speed.
        lower: Where its lower stop begins; None has none.
        upper: Where its upper stop begins; None has none.
        stop_stiffness: Of both stops, N m/rad or N/m.
        stop_damping: Of both stops, N m s/rad or N s/m.
        stop_hold: What is left of a stop's force while it would hold back the joint that leaves
            it: 0 of a bare stop, which only pushes; 1 of a bumper that sticks (Kelvin and Voigt's
            spring and damper).
        spring: Rate of a spring that draws it to a position, N m/rad or N/m.
        spring_at: That position, rad or m.
        play: Way that it can move without what drives it, from one face of the backlash to the
            other, rad or m.
    """

    name: str | None = None
    start: Finite = 0.0
    held: bool = False
    viscous: NonNegative = 0.0
    dry_friction: NonNegative = 0.0
    lower: Finite | None = None
    upper: Finite | None = None
    stop_stiffness: Positive = 1e4
    stop_damping: NonNegative = 10.0
    stop_hold: Share = 0.0
    spring: NonNegative = 0.0
    spring_at: Finite = 0.0
    play: NonNegative = 0.0

    @model_validator(mode="after")
    def _check(self) -> "Joint":
        low = -math.inf if self.lower is None else self.lower
        high = math.inf if self.upper is None else self.upper
        if not low < high:
            raise ValueError(f"lower {low:g} must be below upper {high:g}")
        if not low <= self.start <= high:
            raise ValueError(f"start {self.start:g} lies beyond its stops, {low:g} and {high:g}")
        return self


class Body(Part, ABC):
    """A body whose equations of motion are solved with the gas.

    Attributes:
        gravity_m_s2: Gravity.
    """

    gravity_m_s2: NonNegative = Field(default=9.80665)

    joint_fields: ClassVar[tuple[str, ...]]
    """Names of the fields that hold its joints, in the order of its coordinates."""
    slides: ClassVar[tuple[str, ...]] = ()
    """Those of them that are translations."""
    uncertain: ClassVar[dict[str, float]]
    """Paths of its numbers that no datasheet tells well, with their relative uncertainty, one
    sigma. Of numbers that its equations know by their product alone one is named."""

    loaded: ClassVar[tuple[str, ...]] = ()
    """Fields of the joints that may carry something, see `carry`."""
    arm_free: ClassVar[tuple[str, ...]] = ()
    """Those of them whose load has no lever arm: slides, and the middle of a torso."""
    off_centre: ClassVar[tuple[str, ...]] = ()
    """Fields of the joints whose link's centre of mass may be elsewhere, see `shift_centre`."""
    cranks: ClassVar[dict[str, str]] = {}
    """Paths of its cranks, by the field of the joint that each turns."""

    def carry(self, field: str, mass_kg: float, distance_m: float) -> None:
        """Gives what a joint moves a point mass.

        Args:
            field: One of `loaded`.
            mass_kg: The mass; may be negative.
            distance_m: From a rotary joint, along its link.
        """
        raise ValueError(f"nothing that {field} moves can be loaded")

    def shift_centre(self, field: str, offset_m: float) -> None:
        """Moves the centre of mass of all that a joint's link has, its inertia about that kept.

        Args:
            field: One of `off_centre`.
            offset_m: Away from the joint.
        """
        raise ValueError(f"what {field} moves has no centre of mass that could be elsewhere")

    @property
    def joints(self) -> list[Joint]:
        """Its joints, in the order of its coordinates."""
        return [getattr(self, name) for name in self.joint_fields]

    @property
    @abstractmethod
    def driven_by(self) -> list[str]:
        """Names of the cylinders that take hold of it, in the order of its levers."""

    @abstractmethod
    def numbers(self) -> list[float]:
        """Returns what its equations work with, in SI units."""

    @abstractmethod
    def potential_j(self, q: Floats) -> float:
        """Potential energy, J.

        Args:
            q: (joints,) positions.
        """

    @abstractmethod
    def mjcf(self) -> str:
        """Returns the same body as MJCF, with a joint of the same name for each of `joint_fields`.

        Its cylinders are tendons or joints of the same geometry, named after their places.
        """
