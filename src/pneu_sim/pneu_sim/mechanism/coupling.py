# SPDX-License-Identifier: Apache-2.0
r"""Gas and mechanism in turn: pistons at constant speeds, mechanisms under constant forces.

The thesis (5.6) takes the force at the beginning of a physics step, lets the physics engine do the
step, and moves the gas with the speed that follows: of first order in the physics step, h, as the
force is old by h/2 on average.

The second order's step is symmetric about its middle:

1. The piston moves on for h/2 with the speed that the mechanism has. The gas tells its mean force
   over that half, and with the one of the half before it (both h/4 from the beginning) that
   gives the force in the middle of the step, ``1.5 m1 - 0.5 m0``.
2. The mechanism does its step under that force.
3. The piston moves for h/2 with the speed that brings it exactly to where the mechanism now is.

For a gas spring that is the Störmer-Verlet method. Only means over time enter, so waves in a
cylinder, faster than the physics, average out; and the impulse that the gas gave to the piston in a
step but the mechanism did not get is added in the next one, so that momentum is never lost. This
damps a spring by ``ω (ω h)^3 / 16`` a second, 0.1 % at 10 Hz and 1 ms. It is stable up to
``ω h = 1.6``, where ω² is the stiffness of the gas over the mass it sees.

A mechanism goes past the end of a cylinder by up to one and a half times what it goes in a step,
before MuJoCo's stop has taken its speed; what a chamber holds beyond the stroke has to be longer.

In both, extension and gas agree at the end of every step. What the integrator of the mechanism does
with its constant force has to be of second order too: MuJoCo's `Euler`, `implicit` and
`implicitfast` are of first order in damping, Coriolis forces and levers, so the second order has it
take `RK4`, at three to four times the time. RK4 takes damping explicitly and wants a step below 2.7
times mass over damping. Impacts are of first order whatever one does.
"""

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pneu_sim.mechanism.mechanism import Mechanism

Floats = NDArray[np.float64]
Move = Callable[[Floats, float, Floats | None], Floats]


class PistonGas(Protocol):
    """The gas behind the pistons, as a coupling moves it."""

    def __call__(self, speed_m_s: Floats, duration_s: float) -> Floats:
        """Moves the pistons and advances the gas.

        Args:
            speed_m_s: (n_cyl, lanes) of the pistons, positive where they extend, m/s.
            duration_s: How long, s; after 0 nothing has changed.

        Returns:
            (n_cyl, lanes) mean force on the pistons over it, N, positive where it extends them;
            over a duration of 0 the force there is.
        """


class Coupling:
    """Moves gas and mechanism together, in turn; see ``pneu_sim.mechanism.coupling``.

    Attributes:
        mechanism: The mechanism.
    """

    def __init__(self, mechanism: Mechanism) -> None:
        """Begins with the mechanism as it stands.

        Args:
            mechanism: The mechanism; its settings say which coupling.
        """
        self.mechanism = mechanism
        self.reset()

    def reset(self) -> None:
        """Forgets the steps before; gas and mechanism stand as they are."""
        shape = self.mechanism.extension().shape
        self._begun = np.zeros(shape[1], bool)
        self._before = np.zeros(shape)
        self._owed = np.zeros(shape)

    def step(
        self, gas: PistonGas, friction_n: Floats | None = None, move: Move | None = None
    ) -> Floats:
        """Moves gas and mechanism by one physics step.

        Args:
            gas: The gas.
            friction_n: (n_cyl, lanes) dry friction of the pistons, N; None is none.
            move: Moves the mechanism by the step, as `Mechanism.advance`, which it is by default.

        Returns:
            (n_cyl, lanes) force that the mechanism was given, N.
        """
        if self.mechanism.settings.coupling == "thesis":
            return self._thesis(gas, friction_n, move or self.mechanism.advance)
        return self._second_order(gas, friction_n, move or self.mechanism.advance)

    def advance(self, gas: PistonGas, duration_s: float, friction_n: Floats | None = None) -> None:
        """Moves gas and mechanism by whole physics steps.

        Args:
            gas: The gas.
            duration_s: How long, s; a whole number of steps.
            friction_n: (n_cyl, lanes) dry friction of the pistons, N; None is none.

        Raises:
            InputError: The duration is no whole number of steps.
        """
        for _ in range(self.mechanism.steps(duration_s)):
            self.step(gas, friction_n)

    def state(self) -> list[NDArray[Any]]:
        """Returns copies of all that the future depends on but the gas, the rig as last index."""
        own = [self._begun, self._before, self._owed]
        return [*self.mechanism.state(), *(part.copy() for part in own)]

    def set_state(self, parts: Sequence[NDArray[Any]]) -> None:
        """Goes back to a state.

        Args:
            parts: As of `state`, of a coupling of the same structure and step.
        """
        *of_mechanism, begun, before, owed = parts
        self.mechanism.set_state(of_mechanism)
        self._begun, self._before, self._owed = begun.copy(), before.copy(), owed.copy()

    def _thesis(self, gas: PistonGas, friction_n: Floats | None, move: Move) -> Floats:
        """Force at the beginning, physics step, gas (thesis 5.6)."""
        h = self.mechanism.step_s
        force = gas(np.zeros_like(self._owed), 0.0)
        moved = move(force, h, friction_n)
        gas(moved / h, h)
        return force

    def _led(self, x: Floats, speed: Floats, duration: float) -> Floats:
        """The speed by which the gas goes ahead of the mechanism: not past the ends of cylinders.

        Args:
            x: (n_cyl, lanes) extensions, m; past an end they go no further.
            speed: (n_cyl, lanes) m/s.
            duration: s.
        """
        stroke = self.mechanism.stroke_m
        low = np.where(np.isfinite(stroke), np.minimum(x, 0.0), -np.inf)
        high = np.maximum(x, stroke)
        return np.clip(speed, (low - x) / duration, (high - x) / duration)

    def _second_order(self, gas: PistonGas, friction_n: Floats | None, move: Move) -> Floats:
        """Half a step of gas, physics step, the other half of gas."""
        mechanism, half = self.mechanism, 0.5 * self.mechanism.step_s
        speed = self._led(mechanism.extension(), mechanism.speed(), half)
        first = gas(speed, half)
        # Where nothing came before, what is wrong with the middle is owed to the second step.
        self._before = np.where(self._begun, self._before, first)
        self._begun[:] = True
        middle = 1.5 * first - 0.5 * self._before
        force = middle + self._owed
        moved = move(force, 2.0 * half, friction_n)
        last = gas(moved / half - speed, half)
        self._owed = 0.5 * (first + last) - middle
        self._before = last
        return force
