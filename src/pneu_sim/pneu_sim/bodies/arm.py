# SPDX-License-Identifier: Apache-2.0
"""A planar arm of two links, each turned by a cylinder on a crank (thesis 7.1, fig. 7.1 B).

With absolute angles a = shoulder, b = shoulder + elbow, counter-clockwise from the horizontal, and
for each link its length l, mass m, first moment s and second moment J about its joint, the two-link
manipulator has (e.g. Spong et al., Robot Modeling and Control, 2nd ed., 6.4)

    T = 0.5 (J1 + m2 l1^2) a'^2 + 0.5 J2 b'^2 + l1 s2 cos(b - a) a' b'
    V = g ((s1 + m2 l1) sin a + s2 sin b)

The joints' own coordinates are a and b - a, so that a torque on a joint's coordinate is the sum of
those on the links beyond it.
"""

import math
from typing import ClassVar, Literal

from pydantic import model_validator

from pneu_sim.bodies import mjcf
from pneu_sim.bodies.base import Body, Floats, Joint
from pneu_sim.bodies.crank import Crank
from pneu_sim.bodies.link import Link

CRANKS = 5  # where their numbers begin


class Arm(Body):
    """An arm of two links in a vertical plane; without gravity, in a level one.

    Angles grow counter-clockwise with x to the right and y up. At zero both links lie along x; the
    elbow's angle is the forearm's from the upper arm's direction. A crank is measured from its
    joint, the shoulder's in axes of the ground, the elbow's in those of the upper arm, of which x
    points from shoulder to elbow.

    Attributes:
        kind: ``arm``.
        upper_arm: From shoulder to elbow; its tip is the mass at the elbow.
        forearm: From elbow to hand; its tip is the mass of the hand.
        shoulder_cylinder: The cylinder between ground and upper arm.
        shoulder_crank: How it is pinned.
        elbow_cylinder: The cylinder between upper arm and forearm.
        elbow_crank: How it is pinned.
        shoulder: The joint of the upper arm, rad.
        elbow: The joint of the forearm, rad.
        gravity_m_s2: Gravity.
    """

    joint_fields: ClassVar[tuple[str, ...]] = ("shoulder", "elbow")
    uncertain: ClassVar[dict[str, float]] = {
        "upper_arm.tip_kg": 0.2,
        "upper_arm.mass_kg": 0.2,
        "forearm.tip_kg": 0.2,
        "forearm.mass_kg": 0.2,
    }
    loaded: ClassVar[tuple[str, ...]] = ("shoulder", "elbow")
    off_centre: ClassVar[tuple[str, ...]] = ("shoulder", "elbow")
    cranks: ClassVar[dict[str, str]] = {"shoulder": "shoulder_crank", "elbow": "elbow_crank"}

    kind: Literal["arm"]
    upper_arm: Link
    forearm: Link
    shoulder_cylinder: str
    shoulder_crank: Crank
    elbow_cylinder: str
    elbow_crank: Crank
    shoulder: Joint = Joint()
    elbow: Joint = Joint()

    @model_validator(mode="after")
    def _check(self) -> "Arm":
        self.shoulder_crank.check("shoulder_crank", self.shoulder)
        self.elbow_crank.check("elbow_crank", self.elbow)
        return self

    def carry(self, field: str, mass_kg: float, distance_m: float) -> None:
        """See `Body.carry`.

        Args:
            field: The joint's field.
            mass_kg: The mass; may be negative.
            distance_m: From the joint.
        """
        self._link(field).carry(mass_kg, distance_m)

    def shift_centre(self, field: str, offset_m: float) -> None:
        """See `Body.shift_centre`.

        Args:
            field: The joint's field.
            offset_m: Away from the joint.
        """
        self._link(field).shift_centre(offset_m)

    def _link(self, field: str) -> Link:
        return self.upper_arm if field == "shoulder" else self.forearm

    @property
    def driven_by(self) -> list[str]:
        """The shoulder's cylinder and the elbow's."""
        return [self.shoulder_cylinder, self.elbow_cylinder]

    def numbers(self) -> list[float]:
        """Moments of the links, gravity's, and both cranks'."""
        l1, m2 = self.upper_arm.length_m, self.forearm.total_kg
        first2 = self.forearm.first_moment_kg_m
        return [
            self.upper_arm.second_moment_kg_m2 + m2 * l1 * l1,
            self.forearm.second_moment_kg_m2,
            l1 * first2,
            *self._weights_n_m(),
            *self.shoulder_crank.numbers(),
            *self.elbow_crank.numbers(),
        ]

    def potential_j(self, q: Floats) -> float:
        """Potential energy, none at the shoulder's height; see `Body.potential_j`.

        Args:
            q: (2,).
        """
        upper, fore = self._weights_n_m()
        return upper * math.sin(float(q[0])) + fore * math.sin(float(q[0] + q[1]))

    def mjcf(self) -> str:
        """Returns the same body as MJCF; see `Body.mjcf`."""
        length = self.upper_arm.length_m
        world = f"""
    {mjcf.pivot("shoulder_cylinder", self.shoulder_crank)}
    <body name="upper_arm">
      <joint name="shoulder" type="hinge" axis="{mjcf.COUNTER_CLOCKWISE}"/>
      {mjcf.link(self.upper_arm, 1.0, 0.0)}
      {mjcf.pin("shoulder_cylinder", self.shoulder_crank)}
      {mjcf.pivot("elbow_cylinder", self.elbow_crank, length)}
      <body name="forearm" pos="{mjcf.planar(length, 0.0)}">
        <joint name="elbow" type="hinge" axis="{mjcf.COUNTER_CLOCKWISE}"/>
        {mjcf.link(self.forearm, 1.0, 0.0)}
        {mjcf.pin("elbow_cylinder", self.elbow_crank)}
      </body>
    </body>"""
        tendons = [mjcf.between_sites(f"{name}_cylinder") for name in self.joint_fields]
        return mjcf.document("arm", self.gravity_m_s2, world, tendons)

    def _weights_n_m(self) -> tuple[float, float]:
        """Greatest torques of gravity on the upper arm with all it carries, and on the forearm."""
        first1 = self.upper_arm.first_moment_kg_m + self.forearm.total_kg * self.upper_arm.length_m
        return first1 * self.gravity_m_s2, self.forearm.first_moment_kg_m * self.gravity_m_s2
