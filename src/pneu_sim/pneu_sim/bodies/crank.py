# SPDX-License-Identifier: Apache-2.0
"""Cylinders that turn a joint by a crank: where they are pinned, how long they are, their levers.

One end of the cylinder turns about a pivot P on the parent, the other about a pin N on the driven
link. With both measured from the joint, and the link turned by q, the law of cosines gives the
length between them (thesis 7.1, fig. 7.1 B, and 9.2.1 for the slider-crank):

    L(q)^2 = |P|^2 + |N|^2 - 2 P.R(q)N = S - A cos q - B sin q
    S = |P|^2 + |N|^2,  A = 2 (Px Nx + Py Ny),  B = 2 (Py Nx - Px Ny)
    dL/dq = (A sin q - B cos q) / (2 L)

The kernel works with S, A, B and the length of the closed cylinder: `CRANK_NUMBERS` of them.
"""

import math
from abc import ABC, abstractmethod

from pneu_sim.bodies.base import Joint
from pneu_sim.parts import Finite, Part, Positive

CRANK_NUMBERS = 4
"""Numbers of one crank among those of its body."""
SHORTEST_M = 1e-9
"""Below it pivot and pin are one point, and there is no lever."""

Point = tuple[Finite, Finite]


class Linkage(Part, ABC):
    """A cylinder between a pivot on the parent and a pin on the link that it turns.

    Attributes:
        closed_length_m: From pivot to pin with the cylinder closed, m.
    """

    closed_length_m: Positive

    @abstractmethod
    def lengthen(self, error: float) -> None:
        """Has its pin farther from the joint, or nearer.

        Args:
            error: By which part of that distance.
        """

    @property
    @abstractmethod
    def ends(self) -> tuple[Point, Point]:
        """Pivot and pin from the joint at joint angle zero, m, in axes of the parent."""

    def numbers(self) -> list[float]:
        """Returns S, A and B of the length's square, m^2, and the closed length, m."""
        (px, py), (nx, ny) = self.ends
        return [
            px * px + py * py + nx * nx + ny * ny,
            2.0 * (px * nx + py * ny),
            2.0 * (py * nx - px * ny),
            self.closed_length_m,
        ]

    def length_m(self, q: float) -> float:
        """Length from pivot to pin, m.

        Args:
            q: Angle of the joint, rad.
        """
        s, a, b, _ = self.numbers()
        return math.sqrt(max(s - a * math.cos(q) - b * math.sin(q), 0.0))

    def range_m(self, lower: float | None, upper: float | None) -> tuple[float, float]:
        """Least and greatest length between two angles, m.

        Args:
            lower: The lower, rad; None is no bound, and the whole turn is taken.
            upper: The upper, rad; None likewise.
        """
        low, high = (0.0, 2.0 * math.pi) if lower is None or upper is None else (lower, upper)
        _, a, b, _ = self.numbers()
        # Least and greatest are at the ends, or where pivot, joint and pin are in line.
        in_line = math.atan2(b, a)
        first = math.ceil((low - in_line) / math.pi)
        last = math.floor((high - in_line) / math.pi)
        inner = [in_line + math.pi * k for k in range(first, min(last, first + 2) + 1)]
        lengths = [self.length_m(q) for q in [low, high, *inner]]
        return min(lengths), max(lengths)

    def check(self, where: str, joint: Joint) -> None:
        """Raises ValueError where the cylinder cannot work within a joint's stops, or at its start.

        Args:
            where: What to call it in the message.
            joint: The joint.
        """
        for end, (x, y) in zip(("pivot", "pin"), self.ends, strict=True):
            if math.hypot(x, y) < SHORTEST_M:
                raise ValueError(f"the {end} of {where} lies in the joint, which it cannot turn")
        closed = self.closed_length_m
        least, greatest = self.range_m(joint.lower, joint.upper)
        stops = "" if joint.lower is None or joint.upper is None else " within the joint's stops"
        if greatest <= closed:
            raise ValueError(
                f"closed_length_m {closed:g} of {where} is no shorter than {greatest:g} m, the"
                f" greatest distance from pivot to pin{stops}"
            )
        if least < SHORTEST_M:
            raise ValueError(f"pivot and pin of {where} meet{stops}; make one nearer to the joint")
        at_start = self.length_m(joint.start)
        if at_start < closed:
            raise ValueError(
                f"at start {joint.start:g} pivot and pin of {where} are {at_start:g} m apart, less"
                f" than closed_length_m {closed:g}"
            )


class Crank(Linkage):
    """A cylinder between a pivot on the parent and a pin on the driven link.

    Pivot and pin are measured from the joint, in the parent's axes, with the joint at zero; the pin
    then turns with the link.

    Attributes:
        pivot_m: (x, y) of the cylinder's end on the parent, m.
        pin_m: (x, y) of its end on the driven link, m.
        closed_length_m: From pivot to pin with the cylinder closed, m.
        offset_rad: Added to the joint's angle, for a pin that was measured in another position: the
            angle from that position to the joint's zero, counter-clockwise.
    """

    pivot_m: Point
    pin_m: Point
    offset_rad: Finite = 0.0

    def lengthen(self, error: float) -> None:
        """See `Linkage.lengthen`.

        Args:
            error: By which part of the distance from joint to pin.
        """
        x, y = self.pin_m
        self.pin_m = (x * (1.0 + error), y * (1.0 + error))

    @property
    def ends(self) -> tuple[Point, Point]:
        """Pivot and pin at joint angle zero; see `Linkage.ends`."""
        (x, y), c, s = self.pin_m, math.cos(self.offset_rad), math.sin(self.offset_rad)
        return self.pivot_m, (c * x - s * y, s * x + c * y)


class SliderCrank(Linkage):
    """A crank by its two lengths: sqrt(a^2 + r^2 + 2 a r sin(q + phase)) from pivot to pin.

    The pin is on the crank, which at zero lies along the parent's x axis, turned on by the phase;
    the pivot is on the y axis, on its negative side.

    Attributes:
        pivot_m: From the joint to the cylinder's pivot, the formula's a, m.
        crank_m: From the joint to the pin, its r, m.
        phase_rad: Added to the joint's angle, rad.
        closed_length_m: From pivot to pin with the cylinder closed, m.
    """

    pivot_m: Positive
    crank_m: Positive
    phase_rad: Finite = 0.0

    def lengthen(self, error: float) -> None:
        """See `Linkage.lengthen`.

        Args:
            error: By which part of the distance from joint to pin.
        """
        self.crank_m *= 1.0 + error

    @property
    def ends(self) -> tuple[Point, Point]:
        """Pivot and pin at joint angle zero; see `Linkage.ends`."""
        c, s = math.cos(self.phase_rad), math.sin(self.phase_rad)
        return (0.0, -self.pivot_m), (self.crank_m * c, self.crank_m * s)
