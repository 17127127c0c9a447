# SPDX-License-Identifier: Apache-2.0
"""Encoders whose registers begin anew after a turn: their positions without the jumps."""

import math
from collections.abc import Mapping

from pneu_hw_bridge.registers.schema import Encoder


class Turns:
    """Finds the turn that each reading belongs to.

    A joint whose range is less than a turn is where its range says, whatever came before. Of one
    that goes further, each reading is taken to be less than half a turn from the one before; the
    first is the one nearest to the middle of its range.
    """

    def __init__(self, encoders: Mapping[str, Encoder]) -> None:
        """Begins without a past.

        Args:
            encoders: The encoders by name.
        """
        self._encoders = {n: one for n, one in encoders.items() if math.isfinite(one.turn)}
        self._last: dict[str, float] = {}

    def unwrap(self, values: Mapping[str, float]) -> dict[str, float]:
        """Positions in place of what the registers say of them.

        Args:
            values: SI value per channel; others are left as they are.
        """
        out = dict(values)
        for name, encoder in self._encoders.items():
            value = out.get(name, math.nan)
            if not math.isfinite(value):
                continue
            middle, turn = 0.5 * sum(encoder.range), encoder.turn
            further = encoder.range[1] - encoder.range[0] > turn
            near = self._last.get(name, middle) if further else middle
            out[name] = value - turn * round((value - near) / turn)
            self._last[name] = out[name]
        return out
