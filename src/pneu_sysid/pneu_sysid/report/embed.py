# SPDX-License-Identifier: Apache-2.0
"""Data inside the page: JSON that cannot end its script element, arrays as base64."""

import base64
import json
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from pneu_sysid.report.markup import Markup


def json_block(identifier: str, value: Any) -> Markup:
    """Return a data block that a script of the page reads with `JSON.parse`.

    `<`, `>` and `&` are written as escapes, so no string in the data can close the element or
    open a comment (HTML Living Standard, section 4.12.1.3).

    Args:
        identifier: `id` of the element; a constant of this package.
        value: Anything JSON holds, numbers finite.

    Returns:
        The script element of type application/json.
    """
    text = json.dumps(value, allow_nan=False, separators=(",", ":"), ensure_ascii=True)
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(f'<script type="application/json" id="{identifier}">{text}</script>')


def packed(values: ArrayLike, dtype: DTypeLike = "<f4") -> str:
    """Return numbers as base64 of little-endian floats, a third shorter than their digits.

    Args:
        values: Shape (n,), None or NaN where missing.
        dtype: Little-endian type; single precision resolves 0.04 Pa at 6 bar.

    Returns:
        The base64 text.
    """
    array = np.asarray(values, dtype=np.float64).astype(dtype)
    return base64.b64encode(array.tobytes()).decode("ascii")
