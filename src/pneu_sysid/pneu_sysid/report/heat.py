# SPDX-License-Identifier: Apache-2.0
"""The colour scale of the residual maps: error over sensor noise, in fixed steps.

The steps are the same in every map of every report, so that before and after can be compared.
"""

from bisect import bisect_left

from pneu_sysid.report.markup import Markup, tag
from pneu_sysid.report.quantities import number

EDGES = (1.25, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0)  # upper ends of all steps but the last


def heat_class(times_noise: float | None) -> str:
    """Return the CSS class of an error given in multiples of the sensor noise.

    Args:
        times_noise: The error over the noise floor; None where unknown.
    """
    return "h-none" if times_noise is None else f"h{bisect_left(EDGES, times_noise)}"


def legend() -> Markup:
    """Return the key of the colour scale."""
    labels = [f"≤ {number(EDGES[0])}", *(f"≤ {number(edge, 2)}" for edge in EDGES[1:])]
    labels.append(f"> {number(EDGES[-1], 2)}")
    swatches = [tag("span", label, class_=f"step h{i}") for i, label in enumerate(labels)]
    return tag("p", "Error over sensor noise: ", swatches, class_="key")
