# SPDX-License-Identifier: Apache-2.0
"""Base parameters that may be otherwise, and what effects they may hide.

All those that were fitted to the very recording that is diagnosed. Of a calibration on another one
those that it could not see: a port that was never opened wide may be as its datasheet says, or not.
The others a calibration knows so well that they change the prediction by less than it left.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.schema import Rig
from pneu_sysid.candidates import residual_matrix
from pneu_sysid.parameters import default_parameters, one_each, rig_at, variables_of
from pneu_sysid.problem import Problem
from pneu_sysid.slopes import jacobian
from pneu_sysid.standing import is_own

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Nuisance:
    """What base parameters can make of a residual, to first order.

    Attributes:
        change: (n_stretches, m, P) residual per deviation of each parameter's range.
    """

    change: Floats

    def without(self, used: NDArray[np.bool_]) -> Callable[[Floats], Floats]:
        """A map that takes out of residuals what the parameters explain of them (ridge regression).

        What they explain is learnt on some stretches and taken out of all.

        Args:
            used: (n_stretches,) those that it is learnt on.

        Returns:
            Map of (n_stretches, m) to the same; linear.
        """
        flat = self.change.reshape(-1, self.change.shape[-1])
        a = self.change[used].reshape(-1, self.change.shape[-1])
        inverse = np.linalg.inv(a.T @ a + np.eye(a.shape[1]))

        def take_out(r: Floats) -> Floats:
            amount = inverse @ (a.T @ r[used].ravel())
            return np.asarray(r - (flat @ amount).reshape(r.shape))

        return take_out


def nuisance_of(rig: Rig, problem: Problem) -> Nuisance | None:
    """What base parameters fitted on these very recordings may hide.

    A rig calibrated on other recordings is trusted in what these could see.

    Args:
        rig: The rig.
        problem: The problem.
    """
    listed = rig.fit.parameters or default_parameters(rig)
    if rig.calibration is not None and not is_own(rig, problem):
        listed = [p for p in rig.fit.parameters if p.std_error is None]
    parameters = one_each(listed, [recording.name for recording in problem.recordings])
    if not parameters:
        return None
    variables = variables_of(rig, parameters)
    x = np.array([v.value for v in variables])

    def residuals(points: list[Floats]) -> Floats:
        y = problem.predict([rig_at(rig, parameters, p) for p in points])
        return np.stack([residual_matrix(problem, y[k]) for k in range(len(points))])

    _, j = jacobian(residuals, x, variables)  # type: ignore[arg-type]
    # In units of what was not known of each beforehand.
    j = j * np.array([v.known_std for v in variables])
    # A parameter whose prior range moves the prediction by less than the noise hides nothing.
    felt = np.linalg.norm(j.reshape(-1, x.size), axis=0)
    return Nuisance(j[..., felt > 1.0]) if (felt > 1.0).any() else None
