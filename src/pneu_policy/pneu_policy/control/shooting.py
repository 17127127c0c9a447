# SPDX-License-Identifier: Apache-2.0
"""Direct single shooting of a valve's voltages: differences, Gauss-Newton steps, and the cost.

Rigs that run side by side give the derivatives, and try the steps (Nocedal and Wright, Numerical
Optimization, 2nd ed. 2006, ch. 10). Errors are told in a unit that makes them about one.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pneu_sysid.gauss_newton import damped_steps

Floats = NDArray[np.float64]

LANES = 8
"""Rigs run side by side in multiples of this at no further cost."""
SCALE_PA = 1.0e3
"""Errors of a pressure are told in this, Pa."""
DIFFERENCES_V = (0.1, -0.1, 0.3, -0.3)
"""Steps of the differences in turn: forth and back, as the valve's flow has a kink at null, and far
enough to come out of its backlash."""


def differences(
    plan: Floats, turn: int, lanes: int, low_v: float, high_v: float
) -> tuple[Floats, Floats]:
    """Plans that each differ from one in one voltage.

    Args:
        plan: (knots,) V.
        turn: How often differences were taken before.
        lanes: How many plans; what is left over is the plan itself, and the first is.
        low_v: Lowest voltage, V.
        high_v: Highest voltage, V.

    Returns:
        (lanes, knots) plans, and (knots,) by how much the voltage of each differs.
    """
    step, knots = DIFFERENCES_V[turn % len(DIFFERENCES_V)], plan.size
    # the other way where the range ends
    signed = np.where((plan + step > high_v) | (plan + step < low_v), -step, step)
    plans = np.repeat(plan[None], lanes, axis=0)
    plans[np.arange(knots) + 1, np.arange(knots)] += signed
    return plans, signed


def steps_of(
    plan: Floats,
    seen: Floats,
    signed: Floats,
    target: Floats,
    last_v: float,
    bounds: tuple[float, float],
    weight: float,
    dampings: Sequence[float],
    scale: float = SCALE_PA,
) -> tuple[Floats, list[Floats]]:
    """Gauss-Newton steps by what differences brought.

    Args:
        plan: (knots,) V.
        seen: (samples, lanes) what `differences` made of what is controlled, Pa, rad or m.
        signed: (knots,) their differences, V.
        target: (samples,) in the same unit.
        last_v: What is commanded before the plan, V.
        bounds: Lowest and highest voltage, V.
        weight: What a volt of change from knot to knot counts as, in the unit of errors.
        dampings: Levenberg-Marquardt terms, relative to the mean square of the derivatives.
        scale: The unit of errors.

    Returns:
        (samples,) error of the plan in that unit, and for each damping (knots,) a step, V.
    """
    knots = plan.size
    error = (seen[:, 0] - target) / scale
    slope = (seen[:, 1 : knots + 1] - seen[:, :1]) / signed / scale
    # changes of voltage from knot to knot, the first from what was commanded before
    change = np.eye(knots) - np.eye(knots, k=-1)
    moved = change @ plan
    moved[0] -= last_v
    size = math.sqrt(float(np.mean(np.sum(slope**2, axis=0))) + 1e-12)
    steps = damped_steps(
        np.vstack([slope, weight * change]),
        -np.concatenate([error, weight * moved]),
        bounds[0] - plan,
        bounds[1] - plan,
        dampings,
        np.full(knots, size),
    )
    return error, steps


def cost(error: Floats, plans: Floats, last_v: float, weight: float) -> Floats:
    """(lanes,) sums of squares of errors and of the plans' changes.

    Args:
        error: (samples, lanes), in the unit of errors.
        plans: (lanes, knots) V.
        last_v: What is commanded before the plans, V.
        weight: See `steps_of`.
    """
    moved = np.diff(plans, axis=1, prepend=last_v)
    return np.asarray(np.sum(error**2, axis=0) + weight**2 * np.sum(moved**2, axis=1))
