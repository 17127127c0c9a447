# SPDX-License-Identifier: Apache-2.0
"""A cart on a level rail, moved by one cylinder, with a rod that turns on it (thesis fig. 7.1 C).

With x of the cart, and the rod's angle theta from upright, growing as it leans to positive x, the
Lagrangian (e.g. Spong et al., Robot Modeling and Control, 2nd ed., ch. 6) of cart m_c and rod of
mass m, first moment s and second moment J about its joint gives

    (m_c + m) x'' + s cos(theta) theta'' = s sin(theta) theta'^2
    s cos(theta) x'' + J theta''         = g s sin(theta)
"""

import math
from typing import ClassVar, Literal

from pneu_sim.bodies import mjcf
from pneu_sim.bodies.base import Body, Floats, Joint
from pneu_sim.bodies.link import Link
from pneu_sim.parts import Finite, Positive


class CartPole(Body):
    """A cart on a level rail with a rod that turns on it freely.

    Attributes:
        kind: ``cart_pole``.
        cylinder: The cylinder that moves the cart.
        cart_kg: Of all that slides, the piston included, without the rod.
        rod: The rod and the mass at its end.
        closed_at_m: Where the cart is with the cylinder closed; from there the extension counts.
        slide: The joint of the cart, in m along the rail.
        pole: The joint of the rod, in rad: 0 is upright, pi hangs down, positive leans to where
            the cart goes as the cylinder extends.
        gravity_m_s2: Gravity.
    """

    joint_fields: ClassVar[tuple[str, ...]] = ("slide", "pole")
    slides: ClassVar[tuple[str, ...]] = ("slide",)
    uncertain: ClassVar[dict[str, float]] = {
        "cart_kg": 0.2,
        "rod.tip_kg": 0.2,
        "rod.mass_kg": 0.2,
    }
    loaded: ClassVar[tuple[str, ...]] = ("slide", "pole")
    arm_free: ClassVar[tuple[str, ...]] = ("slide",)
    off_centre: ClassVar[tuple[str, ...]] = ("pole",)

    kind: Literal["cart_pole"]
    cylinder: str
    cart_kg: Positive
    rod: Link
    closed_at_m: Finite = 0.0
    slide: Joint = Joint()
    pole: Joint = Joint()

    def carry(self, field: str, mass_kg: float, distance_m: float) -> None:
        """See `Body.carry`.

        Args:
            field: The joint's field.
            mass_kg: The mass; may be negative.
            distance_m: From the joint.
        """
        if field == "slide":
            self.cart_kg += mass_kg
        else:
            self.rod.carry(mass_kg, distance_m)

    def shift_centre(self, field: str, offset_m: float) -> None:
        """See `Body.shift_centre`.

        Args:
            field: The joint's field.
            offset_m: Away from the joint.
        """
        del field
        self.rod.shift_centre(offset_m)

    @property
    def driven_by(self) -> list[str]:
        """Its one cylinder."""
        return [self.cylinder]

    def numbers(self) -> list[float]:
        """Whole mass, the rod's moments, gravity's, and where the cylinder is closed."""
        first = self.rod.first_moment_kg_m
        return [
            self.cart_kg + self.rod.total_kg,
            first,
            self.rod.second_moment_kg_m2,
            first * self.gravity_m_s2,
            self.closed_at_m,
        ]

    def potential_j(self, q: Floats) -> float:
        """Potential energy; see `Body.potential_j`.

        Args:
            q: (2,).
        """
        return self.rod.first_moment_kg_m * self.gravity_m_s2 * math.cos(float(q[1]))

    def mjcf(self) -> str:
        """Returns the same body as MJCF; the tendon is as long as the cart's coordinate."""
        world = f"""
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0"/>
      <geom type="box" size="0.05 0.03 0.02" mass="{self.cart_kg!r}" contype="0" conaffinity="0"/>
      <body name="rod">
        <joint name="pole" type="hinge" axis="0 1 0"/>
        {mjcf.link(self.rod, 0.0, 1.0)}
      </body>
    </body>"""
        tendons = [mjcf.along_joint("cylinder", "slide")]
        return mjcf.document("cart_pole", self.gravity_m_s2, world, tendons)
