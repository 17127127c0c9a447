# SPDX-License-Identifier: Apache-2.0
"""What options of several commands have in common."""

import math
from typing import Annotated

import typer

MOST_SEED = 2**31 - 1
"""Largest seed; what draws from one takes no larger everywhere."""

Force = Annotated[
    bool, typer.Option("--force", help="Replace files that exist and are no results of pneu.")
]


def finite(value: float) -> float:
    """Refuse NaN and infinity, which pass the range check of an option.

    A callback of `typer.Option`.

    Args:
        value: Value of the option.

    Raises:
        typer.BadParameter: The value is not finite.
    """
    if not math.isfinite(value):
        raise typer.BadParameter(f"found {value:g}, a finite number is needed")
    return value
