# SPDX-License-Identifier: Apache-2.0
"""Rigs drawn from what a calibration left uncertain (thesis 2.9): one policy must do for them all.

Each fitted parameter is drawn around its value by the standard error that its rig file gives. The
file holds no correlations, so that the ensemble is wider than the calibration's own uncertainty.
"""

import numpy as np

from pneu_common.errors import InputError
from pneu_sim.rig.parameters import get_parameter, with_parameters
from pneu_sim.rig.schema import Rig


def draw_rigs(rig: Rig, count: int, seed: int, spread: float = 1.0) -> list[Rig]:
    """Draws rigs around a calibrated one.

    Args:
        rig: The calibrated rig.
        count: How many.
        seed: Seed of the draws.
        spread: Standard deviations over the standard errors of the calibration; 0 gives copies.

    Returns:
        The rigs; positions of taps are left where they are, as one grid serves all.

    Raises:
        InputError: The rig holds no standard error, or the spread is negative.
    """
    if spread < 0.0:
        raise InputError(f"spread: found {spread:g}, it must not be negative")
    if spread == 0.0:
        return [rig] * count
    known = [p for p in rig.fit.parameters if p.std_error is not None and p.std_error > 0.0]
    if not known:
        raise InputError(
            f"rig {rig.name!r}: fit.parameters hold no std_error to draw rigs by; `pneu fit` writes"
            " them, or set spread to 0"
        )
    rng = np.random.default_rng([seed, 0x9E37])
    rigs = []
    for _ in range(count):
        values = {}
        for parameter in known:
            draw = float(rng.normal())
            value = get_parameter(rig, parameter.path)
            # What the calibration left out stays out: a wall without memory costs less.
            if value == 0.0 or parameter.path.endswith("position_m"):
                continue
            error = spread * float(parameter.std_error or 0.0)
            if parameter.log:
                value *= float(np.exp(draw * error / value))
            else:
                value += draw * error
            values[parameter.path] = min(max(value, parameter.lower), parameter.upper)
        rigs.append(_monotone(with_parameters(rig, values)))
    return rigs


def _monotone(rig: Rig) -> Rig:
    """The rig with opening curves that never fall, as draws of single points may make them."""
    values = {}
    for name, valve in rig.valves.items():
        for port_name, port in valve.ports.items():
            fraction = getattr(port.opening, "fraction", None)
            if not fraction:  # a mirrored port takes its points from the other
                continue
            rising = np.sort(np.asarray(fraction, dtype=float))
            if fraction[0] > fraction[-1]:
                rising = rising[::-1]
            for k, value in enumerate(rising):
                path = f"valves.{name}.ports.{port_name}.opening.fraction.{k}"
                values[path] = float(value)
    return with_parameters(rig, values)
