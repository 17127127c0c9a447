# SPDX-License-Identifier: Apache-2.0
"""A link on two joints at right angles, the second turned by a slider-crank (thesis 9.2).

Equation 9.1, without damping, of the angles alpha and theta, both zero with the link upright:

    (w1 + cos(theta)^2 w2) alpha'' = tau_alpha + 2 alpha' theta' sin(theta) cos(theta) w2
                                     + cos(theta) sin(alpha) l g m1
    w2 theta''                     = tau_theta - alpha'^2 cos(theta) sin(theta) w2
                                     + sin(theta) cos(alpha) l g m1

It is that of the Lagrangian with T = 0.5 (w1 + cos(theta)^2 w2) alpha'^2 + 0.5 w2 theta'^2 and
V = m1 g l cos(theta) cos(alpha): a thin link, without inertia about its own length.
"""

import math
from typing import ClassVar, Literal

from pydantic import model_validator

from pneu_sim.bodies import mjcf
from pneu_sim.bodies.base import Body, Floats, Joint
from pneu_sim.bodies.crank import SliderCrank
from pneu_sim.parts import NonNegative, Positive

CRANK = 4  # where its numbers begin


class Kokoro(Body):
    """A link that stands on two joints; with the first held it is a single joint under gravity.

    Only the product of `mass_kg` and `centre_m` is in the equations.

    Attributes:
        kind: ``kokoro``.
        theta_cylinder: The cylinder that turns the second joint by the slider-crank.
        slider: The slider-crank; see `SliderCrank`.
        theta_inertia_kg_m2: Of the link about the second joint, w2.
        mass_kg: Of the link, m1.
        centre_m: From the joint to the link's centre of mass, l.
        alpha_cylinder: The rotary actuator of the first joint, whose angle is alpha; None has none.
        alpha_inertia_kg_m2: Of the first stage about the first joint, w1; needed unless that is
            held.
        alpha: The first joint, rad; held at zero unless it is given.
        theta: The second joint, rad; 0 is upright.
        gravity_m_s2: Gravity.
    """

    joint_fields: ClassVar[tuple[str, ...]] = ("alpha", "theta")
    uncertain: ClassVar[dict[str, float]] = {
        "alpha_inertia_kg_m2": 0.3,
        "theta_inertia_kg_m2": 0.3,
        "mass_kg": 0.2,
        "slider.pivot_m": 0.005,
        "slider.crank_m": 0.005,
        "slider.closed_length_m": 0.005,
    }
    loaded: ClassVar[tuple[str, ...]] = ("theta",)
    off_centre: ClassVar[tuple[str, ...]] = ("theta",)
    cranks: ClassVar[dict[str, str]] = {"theta": "slider"}

    kind: Literal["kokoro"]
    theta_cylinder: str
    slider: SliderCrank
    theta_inertia_kg_m2: Positive
    mass_kg: Positive
    centre_m: NonNegative
    alpha_cylinder: str | None = None
    alpha_inertia_kg_m2: Positive | None = None
    alpha: Joint = Joint(held=True)
    theta: Joint = Joint()

    @model_validator(mode="after")
    def _check(self) -> "Kokoro":
        if self.alpha_inertia_kg_m2 is None and not self.alpha.held:
            raise ValueError("alpha_inertia_kg_m2 is needed where alpha is not held")
        self.slider.check("slider", self.theta)
        return self

    def carry(self, field: str, mass_kg: float, distance_m: float) -> None:
        """See `Body.carry`.

        Args:
            field: The joint's field.
            mass_kg: The mass; may be negative.
            distance_m: From the joint.
        """
        del field
        moment = self.mass_kg * self.centre_m + mass_kg * distance_m
        self.mass_kg += mass_kg
        self.centre_m = moment / self.mass_kg
        self.theta_inertia_kg_m2 += mass_kg * distance_m**2

    def shift_centre(self, field: str, offset_m: float) -> None:
        """See `Body.shift_centre`.

        Args:
            field: The joint's field.
            offset_m: Away from the joint.
        """
        del field
        before, self.centre_m = self.centre_m, self.centre_m + offset_m
        self.theta_inertia_kg_m2 += self.mass_kg * (self.centre_m**2 - before**2)

    @property
    def driven_by(self) -> list[str]:
        """The cylinder of theta, and the actuator of alpha where there is one."""
        return [one for one in (self.theta_cylinder, self.alpha_cylinder) if one is not None]

    def numbers(self) -> list[float]:
        """Inertias, weight, whether alpha is driven, and the slider-crank's."""
        return [
            self._alpha_inertia(),
            self.theta_inertia_kg_m2,
            self._weight_n_m(),
            0.0 if self.alpha_cylinder is None else 1.0,
            *self.slider.numbers(),
        ]

    def potential_j(self, q: Floats) -> float:
        """Potential energy, none at the joint's height; see `Body.potential_j`.

        Args:
            q: (2,).
        """
        return self._weight_n_m() * math.cos(float(q[0])) * math.cos(float(q[1]))

    def mjcf(self) -> str:
        """Returns the same body as MJCF.

        A centre of mass that is farther out than the inertia allows is brought in, with more mass,
        so that their product stays: MuJoCo wants both physical.
        """
        moment, inertia = self.mass_kg * self.centre_m, self.theta_inertia_kg_m2
        centre = self.centre_m
        if moment * centre > inertia:
            centre = 0.5 * inertia / moment
        mass = moment / centre if centre > 0.0 else self.mass_kg
        about = inertia - mass * centre * centre
        # The crank's plane turns about +y: its x is MJCF's z, and its y MJCF's x.
        (px, py), (nx, ny) = self.slider.ends
        world = f"""
    <body name="stage">
      <joint name="alpha" type="hinge" axis="1 0 0"/>
      {mjcf.inertial(1.0, "0 0 0", self._alpha_inertia())}
      {mjcf.site("theta_cylinder_pivot", mjcf.numbers(py, 0.0, px))}
      <body name="link">
        <joint name="theta" type="hinge" axis="0 1 0"/>
        {mjcf.inertial(mass, mjcf.numbers(0.0, 0.0, centre), about, about, 0.0)}
        <geom type="capsule" fromto="0 0 0 0 0 {2.0 * self.centre_m + 0.01!r}" size="0.01"
          contype="0" conaffinity="0"/>
        {mjcf.site("theta_cylinder_pin", mjcf.numbers(ny, 0.0, nx))}
      </body>
    </body>"""
        tendons = [mjcf.between_sites("theta_cylinder")]
        if self.alpha_cylinder is not None:
            tendons.append(mjcf.along_joint("alpha_cylinder", "alpha"))
        return mjcf.document("kokoro", self.gravity_m_s2, world, tendons)

    def _alpha_inertia(self) -> float:
        return 1.0 if self.alpha_inertia_kg_m2 is None else self.alpha_inertia_kg_m2

    def _weight_n_m(self) -> float:
        return self.mass_kg * self.gravity_m_s2 * self.centre_m
