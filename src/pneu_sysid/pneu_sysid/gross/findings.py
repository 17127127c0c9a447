# SPDX-License-Identifier: Apache-2.0
"""What was found to be grossly wrong in a rig file."""

from dataclasses import dataclass


@dataclass(frozen=True)
class GrossError:
    """Something in a rig file that no fit makes good.

    Attributes:
        what: Path of the part that is wrong.
        sentence: What was found, and what would fit.
        error_before: What the datasheet leaves after an ordinary fit, in times the noise.
        error_after: What the corrected one leaves.
    """

    what: str
    sentence: str
    error_before: float
    error_after: float
