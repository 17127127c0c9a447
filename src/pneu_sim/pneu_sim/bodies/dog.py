# SPDX-License-Identifier: Apache-2.0
"""A creature in a vertical plane: a torso, two legs of two links, ground (thesis fig. 7.1 D).

With the torso's centre (x, z) and pitch p, and for each leg absolute angles a of its thigh and b of
its shank, all counter-clockwise with x to the right and z up, links hanging down at zero; with the
hip at h along the torso, and for each link its length l, mass m, first moment s and second moment J
about its joint, a leg of mass m = m1 + m2 has

    T = 0.5 m |u|^2 + S a' u.n(a) + s2 b' u.n(b) + 0.5 K a'^2 + 0.5 J2 b'^2 + s2 l1 cos(b - a) a' b'
    V = g (m z + m h sin p - S cos a - s2 cos b)
    u = (x', z') + h p' (-sin p, cos p),  n(a) = (cos a, sin a),  S = s1 + m2 l1,  K = J1 + m2 l1^2

Lagrange's equations of this are written out below in absolute angles. Those of the joints are
a = p + hip and b = a + knee: a torque of a joint is the sum of those on what lies beyond it, which
also goes for the rows and columns of the mass matrix.
"""

import math
from typing import ClassVar, Literal

from pydantic import Field, model_validator

from pneu_sim.bodies import mjcf
from pneu_sim.bodies.base import Body, Floats, Joint
from pneu_sim.bodies.crank import Crank
from pneu_sim.bodies.ground import GROUND_NUMBERS, Ground
from pneu_sim.bodies.link import Link
from pneu_sim.parts import Part, Positive

# Where numbers begin: of the ground, and of the front leg and the rear one, cranks last.
GROUND = 3
LEG_NUMBERS = 9
FRONT = GROUND + GROUND_NUMBERS
REAR = FRONT + LEG_NUMBERS
CRANKS = REAR + LEG_NUMBERS

_SUNK_M = 0.02  # deeper than that is a mistake in the starting position, not the ground giving way


class Leg(Part):
    """A leg with the two cylinders that move it.

    The hip's crank is measured from the hip in the torso's axes, x forward; the knee's from the
    knee in the thigh's, of which y points to the hip.

    Attributes:
        hip_cylinder: The cylinder between torso and thigh.
        knee_cylinder: The cylinder between thigh and shank.
        hip_crank: How the first is pinned.
        knee_crank: How the second is pinned.
        thigh: From hip to knee.
        shank: From knee to foot.
    """

    hip_cylinder: str
    knee_cylinder: str
    hip_crank: Crank
    knee_crank: Crank = Crank(pivot_m=(0.0, 0.18), pin_m=(-0.02, -0.03), closed_length_m=0.15)
    thigh: Link = Link(length_m=0.2, mass_kg=0.25, tip_kg=0.25)
    shank: Link = Link(length_m=0.2, mass_kg=0.15, tip_kg=0.1)


class FrontLeg(Leg):
    """The leg whose hip is at the front of the torso; its cylinder lies behind the hip.

    Attributes:
        hip_crank: How the hip's cylinder is pinned.
    """

    hip_crank: Crank = Crank(pivot_m=(-0.2, 0.0), pin_m=(0.0, -0.04), closed_length_m=0.178)


class RearLeg(Leg):
    """The leg whose hip is at the rear of the torso; its cylinder lies before the hip.

    Attributes:
        hip_crank: How the hip's cylinder is pinned.
    """

    hip_crank: Crank = Crank(pivot_m=(0.2, 0.0), pin_m=(0.0, -0.04), closed_length_m=0.16)


def _hip() -> Joint:
    return Joint(start=0.45, lower=-0.6, upper=1.2, viscous=0.05, stop_stiffness=300.0)


def _knee() -> Joint:
    return Joint(start=-0.9, lower=-1.9, upper=-0.1, viscous=0.05, stop_stiffness=300.0)


class Dog(Body):
    """A walking creature of a torso and two legs; by default 4 kg for bores of 16 to 25 mm.

    Forward is positive x. Angles grow counter-clockwise: a positive pitch lifts the front, a
    positive hip swings the leg forward, a knee bends negative. At zero the torso is level and the
    legs hang straight down. Feet, knees and hips touch the ground, which is level at height zero.

    Attributes:
        kind: ``dog``.
        front: The leg at the front.
        rear: The leg at the rear.
        torso_kg: Of the torso, its centre of mass midway between the hips.
        torso_length_m: From hip to hip.
        torso_inertia_kg_m2: Of the torso about its centre of mass; None is a uniform bar's.
        ground: What it walks on.
        x: Place of the torso's centre along the ground, m.
        z: Height of the torso's centre, m.
        pitch: Angle of the torso, rad.
        front_hip: Joint of the front thigh, rad.
        front_knee: Joint of the front shank, rad.
        rear_hip: Joint of the rear thigh, rad.
        rear_knee: Joint of the rear shank, rad.
        gravity_m_s2: Gravity.
    """

    joint_fields: ClassVar[tuple[str, ...]] = (
        "x",
        "z",
        "pitch",
        "front_hip",
        "front_knee",
        "rear_hip",
        "rear_knee",
    )
    slides: ClassVar[tuple[str, ...]] = ("x", "z")
    uncertain: ClassVar[dict[str, float]] = {
        "torso_kg": 0.2,
        "ground.friction_coefficient": 0.3,
        "ground.stiffness_n_m": 0.5,
        "ground.damping_s_m": 0.5,
    }
    loaded: ClassVar[tuple[str, ...]] = ("pitch",)
    arm_free: ClassVar[tuple[str, ...]] = ("pitch",)
    cranks: ClassVar[dict[str, str]] = {
        "front_hip": "front.hip_crank",
        "front_knee": "front.knee_crank",
        "rear_hip": "rear.hip_crank",
        "rear_knee": "rear.knee_crank",
    }

    kind: Literal["dog"]
    front: FrontLeg
    rear: RearLeg
    torso_kg: Positive = 2.5
    torso_length_m: Positive = 0.4
    torso_inertia_kg_m2: Positive | None = None
    ground: Ground = Ground()
    x: Joint = Joint()
    z: Joint = Joint(start=0.36)
    pitch: Joint = Joint()
    front_hip: Joint = Field(default_factory=_hip)
    front_knee: Joint = Field(default_factory=_knee)
    rear_hip: Joint = Field(default_factory=_hip)
    rear_knee: Joint = Field(default_factory=_knee)

    @model_validator(mode="after")
    def _check(self) -> "Dog":
        for side, leg in self._legs():
            leg.hip_crank.check(f"{side}.hip_crank", getattr(self, f"{side}_hip"))
            leg.knee_crank.check(f"{side}.knee_crank", getattr(self, f"{side}_knee"))
        lowest = min(self._heights([joint.start for joint in self.joints]))
        if lowest < -_SUNK_M:
            raise ValueError(
                f"at its start the lowest point is {-lowest:.3g} m below the ground; start z higher"
            )
        return self

    def carry(self, field: str, mass_kg: float, distance_m: float) -> None:
        """See `Body.carry`; it lies on the middle of the torso.

        Args:
            field: The joint's field.
            mass_kg: The mass; may be negative.
            distance_m: From the joint.
        """
        del field, distance_m
        self.torso_kg += mass_kg

    @property
    def driven_by(self) -> list[str]:
        """Cylinders of the front hip, the front knee, the rear hip, the rear knee."""
        legs = [leg for _, leg in self._legs()]
        return [name for leg in legs for name in (leg.hip_cylinder, leg.knee_cylinder)]

    def numbers(self) -> list[float]:
        """Gravity, torso, ground, both legs' lengths and moments, and the four cranks'."""
        inertia = self.torso_inertia_kg_m2
        if inertia is None:
            inertia = self.torso_kg * self.torso_length_m**2 / 12.0
        found = [self.gravity_m_s2, self.torso_kg, inertia, *self.ground.numbers()]
        for side, leg in self._legs():
            l1, m2 = leg.thigh.length_m, leg.shank.total_kg
            first2 = leg.shank.first_moment_kg_m
            found += [
                self._hip_at_m(side),
                l1,
                leg.shank.length_m,
                leg.thigh.total_kg + m2,
                leg.thigh.first_moment_kg_m + m2 * l1,
                leg.thigh.second_moment_kg_m2 + m2 * l1 * l1,
                first2,
                leg.shank.second_moment_kg_m2,
                first2 * l1,
            ]
        for _, leg in self._legs():
            found += [*leg.hip_crank.numbers(), *leg.knee_crank.numbers()]
        return found

    def potential_j(self, q: Floats) -> float:
        """Potential energy of weight, none at height zero, and of the ground under the points.

        Args:
            q: (7,).
        """
        position = [float(one) for one in q]
        z, pitch = position[1], position[2]
        weighted = self.torso_kg * z
        for (side, leg), (hip, knee) in zip(
            self._legs(), (position[3:5], position[5:7]), strict=True
        ):
            m2 = leg.shank.total_kg
            weighted += (leg.thigh.total_kg + m2) * (z + self._hip_at_m(side) * math.sin(pitch))
            first1 = leg.thigh.first_moment_kg_m + m2 * leg.thigh.length_m
            weighted -= first1 * math.cos(pitch + hip)
            weighted -= leg.shank.first_moment_kg_m * math.cos(pitch + hip + knee)
        springs = sum(self.ground.spring_j(height) for height in self._heights(position))
        return self.gravity_m_s2 * weighted + springs

    def mjcf(self) -> str:
        """Returns the same body as MJCF, with a floor that MuJoCo's own contacts hold it up on."""
        inertia, half = self.numbers()[2], 0.5 * self.torso_length_m
        sliding = f"{self.ground.friction_coefficient!r} 0 0"
        world = f"""
    <geom name="ground" type="plane" size="0 0 1" friction="{sliding}"/>
    <body name="torso">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <joint name="pitch" type="hinge" axis="{mjcf.COUNTER_CLOCKWISE}"/>
      {mjcf.inertial(self.torso_kg, "0 0 0", inertia)}
      <geom type="capsule" fromto="{mjcf.planar(-half, 0)} {mjcf.planar(half, 0)}" size="0.02"
        contype="0" conaffinity="0"/>
      {"".join(self._mjcf_leg(side, leg, sliding) for side, leg in self._legs())}
    </body>"""
        names = [f"{name}_cylinder" for name in self.joint_fields[3:]]
        tendons = [mjcf.between_sites(name) for name in names]
        return mjcf.document("dog", self.gravity_m_s2, world, tendons)

    def _mjcf_leg(self, side: str, leg: Leg, sliding: str) -> str:
        hip, knee = f"{side}_hip_cylinder", f"{side}_knee_cylinder"
        at, down = self._hip_at_m(side), -leg.thigh.length_m
        # MuJoCo wants a radius; contacts of the legs are with the floor alone.
        touch = f'size="0.001" mass="0" contype="0" conaffinity="1" friction="{sliding}"'
        return f"""
      {mjcf.pivot(hip, leg.hip_crank, at)}
      <geom name="{side}_hip" pos="{mjcf.planar(at, 0)}" {touch}/>
      <body name="{side}_thigh" pos="{mjcf.planar(at, 0)}">
        <joint name="{side}_hip" type="hinge" axis="{mjcf.COUNTER_CLOCKWISE}"/>
        {mjcf.link(leg.thigh, 0.0, -1.0)}
        {mjcf.pin(hip, leg.hip_crank)}
        {mjcf.pivot(knee, leg.knee_crank, 0.0, down)}
        <geom name="{side}_knee" pos="{mjcf.planar(0, down)}" {touch}/>
        <body name="{side}_shank" pos="{mjcf.planar(0, down)}">
          <joint name="{side}_knee" type="hinge" axis="{mjcf.COUNTER_CLOCKWISE}"/>
          {mjcf.link(leg.shank, 0.0, -1.0)}
          {mjcf.pin(knee, leg.knee_crank)}
          <geom name="{side}_foot" pos="{mjcf.planar(0, -leg.shank.length_m)}" {touch}/>
        </body>
      </body>"""

    def _legs(self) -> list[tuple[str, Leg]]:
        return [("front", self.front), ("rear", self.rear)]

    def _hip_at_m(self, side: str) -> float:
        """Where along the torso a hip is, from its centre."""
        return 0.5 * self.torso_length_m * (1.0 if side == "front" else -1.0)

    def _heights(self, q: list[float]) -> list[float]:
        """Heights of hip, knee and foot, of the front leg and of the rear one."""
        found = []
        for (side, leg), (hip, knee) in zip(self._legs(), (q[3:5], q[5:7]), strict=True):
            at_hip = q[1] + self._hip_at_m(side) * math.sin(q[2])
            at_knee = at_hip - leg.thigh.length_m * math.cos(q[2] + hip)
            at_foot = at_knee - leg.shank.length_m * math.cos(q[2] + hip + knee)
            found += [at_hip, at_knee, at_foot]
        return found
