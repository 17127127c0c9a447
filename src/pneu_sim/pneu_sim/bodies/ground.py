# SPDX-License-Identifier: Apache-2.0
"""Level ground at height zero: what it does to a point of a body that sinks into it.

The normal force is Hunt and Crossley's (J. Appl. Mech. 42, 1975) with exponent one, for a depth d:

    N = k d max(0, 1 + c d')

Its damping grows with the depth, so that the force is continuous at touch-down; being cut at zero,
it never pulls. Dry friction is Coulomb's with the jump at rest made steep but finite:

    F = -mu N r(u / w),   r(x) = x (2 - |x|) up to |x| = 1, and the sign of x beyond
    w = 2 (slip + mu N / grip)

of the sliding speed u. Its slope at rest is below ``grip`` however hard the point is pressed, for a
slope in proportion to N makes steps of fixed length unstable at every impact; a point mass m takes
steps dt up to m / grip without overshoot.
"""

from pneu_sim.parts import NonNegative, Part, Positive

GROUND_NUMBERS = 5
"""Numbers of the ground among those of its body."""


class Ground(Part):
    """Compliant ground with dry friction; the equations stand at the top of its file.

    Attributes:
        stiffness_n_m: Normal force per depth, k.
        damping_s_m: Growth of the normal force per speed of sinking, relative, c.
        friction_coefficient: Coefficient of dry friction, mu.
        slip_m_s: Sliding speed over which friction of a lightly loaded point builds up.
        grip_n_s_m: Most friction per sliding speed; a point under load F creeps at about F / grip.
    """

    stiffness_n_m: Positive = 2e4
    damping_s_m: NonNegative = 2.0
    friction_coefficient: NonNegative = 0.8
    slip_m_s: Positive = 0.01
    grip_n_s_m: Positive = 400.0

    def numbers(self) -> list[float]:
        """Returns its fields in their order."""
        return [
            self.stiffness_n_m,
            self.damping_s_m,
            self.friction_coefficient,
            self.slip_m_s,
            self.grip_n_s_m,
        ]

    def spring_j(self, height_m: float) -> float:
        """Energy that the ground keeps of a point that sinks into it, J.

        Args:
            height_m: Of the point.
        """
        return 0.5 * self.stiffness_n_m * min(height_m, 0.0) ** 2
