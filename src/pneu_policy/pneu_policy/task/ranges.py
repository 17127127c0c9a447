# SPDX-License-Identifier: Apache-2.0
"""What settings of several kinds have alike: seeds, kinds of target, ranges of what is drawn."""

from typing import Annotated

from pydantic import AfterValidator, Field

from pneu_common.validation import Listed
from pneu_policy.task.targets import Kind

LONGEST_DELAY_S = 0.2


def _rising(pair: tuple[float, float]) -> tuple[float, float]:
    low, high = pair
    if not 0.0 <= low <= high:
        raise ValueError(f"found {low:g} to {high:g}, needed is a range that begins at 0 or above")
    return pair


def _short(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[1] > LONGEST_DELAY_S:
        raise ValueError(f"found {pair[1]:g}, allowed is up to {LONGEST_DELAY_S:g} s")
    return pair


Seed = Annotated[int, Field(ge=0, le=2**31 - 1)]
Kinds = Annotated[tuple[Kind, ...], Listed, Field(min_length=1)]
"""Kinds of target."""
Range = Annotated[tuple[float, float], Listed, AfterValidator(_rising)]
"""Least and most of what is drawn."""
DelayRange = Annotated[Range, AfterValidator(_short)]
"""Least and most delay of commands, s."""
