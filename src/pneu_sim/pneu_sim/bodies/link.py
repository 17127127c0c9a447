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

    def carry(self, mass_kg: float, distance_m: float) -> None:
        """Adds a point mass to the rod.

        Args:
            mass_kg: The mass; may be negative.
            distance_m: From the joint, m.
        """
        whole = self.mass_kg + mass_kg
        if whole <= 0.0:
            raise ValueError(f"mass_kg: found {mass_kg:g}, of a rod of {self.mass_kg:g} kg")
        before, rod = self._rod_centre_m(), self._rod_inertia_kg_m2()
        centre = (self.mass_kg * before + mass_kg * distance_m) / whole
        rod += self.mass_kg * (before - centre) ** 2 + mass_kg * (distance_m - centre) ** 2
        self.mass_kg, self.centre_m, self.inertia_kg_m2 = whole, centre, max(rod, 0.0)

    def shift_centre(self, offset_m: float) -> None:
        """Moves the centre of mass of rod and tip, which become one rod of their inertia.

        Args:
            offset_m: Away from the joint, m.
        """
        whole, centre = self.total_kg, self.first_moment_kg_m / self.total_kg
        inertia = self.second_moment_kg_m2 - whole * centre**2
        self.tip_kg, self.mass_kg, self.centre_m = 0.0, whole, centre + offset_m
        self.inertia_kg_m2 = max(inertia, 0.0)

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
        rod = self._rod_inertia_kg_m2()
        return self.tip_kg * self.length_m**2 + rod + self.mass_kg * self._rod_centre_m() ** 2

    def _rod_inertia_kg_m2(self) -> float:
        if self.inertia_kg_m2 is None:
            return self.mass_kg * self.length_m**2 / 12.0
        return self.inertia_kg_m2

    def _rod_centre_m(self) -> float:
        return 0.5 * self.length_m if self.centre_m is None else self.centre_m
