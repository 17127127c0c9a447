# SPDX-License-Identifier: Apache-2.0
"""A rigid link of a planar body: a rod, and a point mass at its end."""

from pydantic import model_validator

from pneu_sim.parts import Finite, NonNegative, Part, Positive


class Link(Part):
    """A rod that turns about a joint at its one end, with a point mass at the other.

    Attributes:
        length_m: From its joint to its end, m.
        tip_kg: Point mass at its end.
        mass_kg: Mass of the rod.
        centre_m: From the joint to the rod's centre of mass, m; None is half its length.
        inertia_kg_m2: The rod's moment of inertia about its centre of mass; None is a thin
            uniform rod's, mass length^2 / 12.
    """

    length_m: Positive
    tip_kg: NonNegative = 0.0
    mass_kg: NonNegative = 0.0
    centre_m: Finite | None = None
    inertia_kg_m2: NonNegative | None = None

    @model_validator(mode="after")
    def _check(self) -> "Link":
        if self.total_kg <= 0.0:
            raise ValueError("a link needs a mass: tip_kg or mass_kg must be above 0")
        if self.second_moment_kg_m2 <= 0.0:
            raise ValueError("a link needs inertia: its whole mass lies in its joint")
        return self

    @property
    def total_kg(self) -> float:
        """Mass of rod and tip, kg."""
        return self.tip_kg + self.mass_kg

    @property
    def first_moment_kg_m(self) -> float:
        """Mass times distance of the centre of mass from the joint, kg m."""
        return self.tip_kg * self.length_m + self.mass_kg * self._rod_centre_m()

    @property
    def second_moment_kg_m2(self) -> float:
        """Moment of inertia about the joint, kg m^2."""
        rod = self.inertia_kg_m2
        if rod is None:
            rod = self.mass_kg * self.length_m**2 / 12.0
        return self.tip_kg * self.length_m**2 + rod + self.mass_kg * self._rod_centre_m() ** 2

    def _rod_centre_m(self) -> float:
        return 0.5 * self.length_m if self.centre_m is None else self.centre_m
