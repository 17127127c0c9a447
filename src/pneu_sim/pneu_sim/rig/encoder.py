# SPDX-License-Identifier: Apache-2.0
"""What a rig file may say of an encoder: what it is on, and what it makes of the position there."""

from pydantic import model_validator

from pneu_sim.channels import Channel
from pneu_sim.parts import Finite, NonNegative, Part, Positive


class Encoder(Part):
    """A position sensor on a joint of a body, or on a piston.

    Angles are in rad, lengths in m, and so are its other numbers. In a `sensor_msgs/JointState` its
    reading stands under the encoder's own name.

    Attributes:
        joint: Name of the joint; None is the encoder's own name.
        cylinder: Instead of a joint, the cylinder whose extension it reads.
        channel: Where its readings are recorded; None is its position on ``joint_states``.
        lag_s: First-order lag.
        gain: Reading per true position.
        bias: Added to the reading, rad or m.
        offset_s: Lateness of its clock.
        noise: White noise, one sigma, rad or m; where given, errors are measured by it, and
            simulated readings have it. 0 is not known: recordings are asked.
        quantum: Quantisation step, likewise.
    """

    joint: str | None = None
    cylinder: str | None = None
    channel: Channel | None = None
    lag_s: NonNegative = 0.0
    gain: Positive = 1.0
    bias: Finite = 0.0
    offset_s: Finite = 0.0
    noise: NonNegative = 0.0
    quantum: NonNegative = 0.0

    @model_validator(mode="after")
    def _check(self) -> "Encoder":
        if self.joint is not None and self.cylinder is not None:
            raise ValueError("an encoder names either a joint or a cylinder, not both")
        return self

    def on(self, name: str) -> str:
        """The joint that it reads, of an encoder of some name that is on no cylinder.

        Args:
            name: Its name.
        """
        return self.joint or name
