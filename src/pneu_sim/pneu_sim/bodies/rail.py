# SPDX-License-Identifier: Apache-2.0
"""A mass on a rail that the piston of one cylinder moves (thesis 7.1, fig. 7.1 A)."""

import math
from typing import ClassVar, Literal

from pneu_sim.bodies.base import Body, Floats, Joint
from pneu_sim.parts import Finite, Positive


class Rail(Body):
    """A mass on a rail; its coordinate is the extension of the cylinder.

    Attributes:
        kind: ``rail``.
        cylinder: The cylinder that moves it.
        mass_kg: Of all that moves, the piston included.
        incline_rad: How steeply the piston goes up as it extends; pi/2 lifts it vertically.
        slide: The joint, in m of extension.
        gravity_m_s2: Gravity.
    """

    joint_fields: ClassVar[tuple[str, ...]] = ("slide",)
    slides: ClassVar[tuple[str, ...]] = ("slide",)
    uncertain: ClassVar[dict[str, float]] = {"mass_kg": 0.2}
    loaded: ClassVar[tuple[str, ...]] = ("slide",)
    arm_free: ClassVar[tuple[str, ...]] = ("slide",)

    kind: Literal["rail"]
    cylinder: str
    mass_kg: Positive
    incline_rad: Finite = 0.0
    slide: Joint = Joint()

    def carry(self, field: str, mass_kg: float, distance_m: float) -> None:
        """See `Body.carry`.

        Args:
            field: The joint's field.
            mass_kg: The mass; may be negative.
            distance_m: From the joint.
        """
        del field, distance_m
        self.mass_kg += mass_kg

    @property
    def driven_by(self) -> list[str]:
        """Its one cylinder."""
        return [self.cylinder]

    def numbers(self) -> list[float]:
        """Mass, and weight along the rail."""
        return [self.mass_kg, self._weight_n()]

    def potential_j(self, q: Floats) -> float:
        """Potential energy; see `Body.potential_j`.

        Args:
            q: (1,).
        """
        return self._weight_n() * float(q[0])

    def mjcf(self) -> str:
        """Returns the same body as MJCF; see `Body.mjcf`."""
        c, s = math.cos(self.incline_rad), math.sin(self.incline_rad)
        return f"""<mujoco model="rail">
  <option gravity="0 0 {-self.gravity_m_s2!r}"/>
  <worldbody>
    <body name="slider">
      <joint name="slide" type="slide" axis="{c!r} 0 {s!r}"/>
      <geom type="box" size="0.03 0.03 0.03" mass="{self.mass_kg!r}"/>
    </body>
  </worldbody>
  <tendon><fixed name="cylinder"><joint joint="slide" coef="1"/></fixed></tendon>
</mujoco>
"""

    def _weight_n(self) -> float:
        return self.mass_kg * self.gravity_m_s2 * math.sin(self.incline_rad)
