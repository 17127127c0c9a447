# SPDX-License-Identifier: Apache-2.0
"""What a learned controller sees: measurements and targets turned into features (thesis 7.1-7.3).

A recipe says which; it travels with the policy, so that training and the real rig use one code.
"""

import math
from itertools import pairwise
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from pneu_common.validation import Listed, Settings

Floats = NDArray[np.float64]

GAS = ("density", "velocity", "pressure")
"""State variables of the gas at a point of a line, in the order in which they are told."""

DENSITY_KG_M3, VELOCITY_M_S = 1.2, 100.0
"""Densities and velocities of the gas are told in these."""


Positive = Annotated[float, Field(gt=0.0)]
Points = Annotated[tuple[str, Annotated[int, Field(ge=1, le=1000)]], Listed]
"""A pipe with a number of points along it."""


class Recipe(Settings):
    """How features are made.

    Attributes:
        tap: Tap whose pressure is controlled.
        taps: Taps that are seen, the controlled one among them.
        preview_s: Times ahead at which the target is told, s; the first is now.
        past: How many of the latest commands are seen.
        line: Pipes whose gas is seen, each with its number of evenly spaced points; in simulation
            alone, as no sensor tells it (thesis 7.3).
        base: Base b of the positional encoding.
        levels: Zoom levels of the positional encoding, b^0 to b^(levels - 1); 0 is without.
        period_s: Control period, s.
        span_pa: Errors and changes of pressure are told in these, Pa.
        centre_pa: Pressures are told from here, Pa ...
        range_pa: ... in these, Pa.
        null_v: Voltage at which the valve closes, V.
        half_v: Volts from there at an action of one.
    """

    tap: str
    taps: Annotated[tuple[str, ...], Listed]
    preview_s: Annotated[tuple[float, ...], Listed] = (0.0, 0.04, 0.08, 0.12, 0.16, 0.2)
    past: Annotated[int, Field(ge=0, le=20)] = 2
    line: Annotated[tuple[Points, ...], Listed] = ()
    base: Positive = 2.0
    levels: Annotated[int, Field(ge=0, le=20)] = 3
    period_s: Positive = 0.01
    span_pa: Positive = 1.0e5
    centre_pa: Positive = 350e3
    range_pa: Positive = 200e3
    null_v: float = 5.0
    half_v: Positive = 5.0

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if self.tap not in self.taps:
            raise ValueError(f"taps: found {', '.join(self.taps) or 'none'}, needed is {self.tap}")
        if len(set(self.taps)) != len(self.taps):
            raise ValueError(f"taps: found {', '.join(self.taps)}, each may stand there once")
        ahead = self.preview_s
        if not ahead or ahead[0] != 0.0 or not all(a < b for a, b in pairwise(ahead)):
            raise ValueError(f"preview_s: found {list(ahead)}, needed are rising times from 0")
        return self

    @property
    def size(self) -> int:
        """Number of features."""
        gas = len(GAS) * sum(points for _, points in self.line)
        return len(self.preview_s) * (1 + 2 * self.levels) + 2 * len(self.taps) + self.past + gas

    def names(self) -> list[str]:
        """Returns what each feature is, in order."""
        names = []
        for ahead in self.preview_s:
            error = f"error at {ahead:g} s"
            names.append(error)
            zooms = [self.base**n for n in range(self.levels)]
            names += [f"{wave}({b:g} {error})" for wave in ("sin", "cos") for b in zooms]
        names += [f"pressure {tap}" for tap in self.taps]
        names += [f"change {tap}" for tap in self.taps]
        names += [f"command {n + 1} back" for n in range(self.past)]
        for pipe, points in self.line:
            names += [f"{what} {pipe} {n}" for what in GAS for n in range(points)]
        return names

    def volts(self, action: Any) -> Any:
        """Voltage of an action.

        Args:
            action: Action or array of them; beyond -1 and 1 it is cut off.
        """
        return self.null_v + self.half_v * np.clip(action, -1.0, 1.0)


class Observer:
    """Makes the features of one rig or of many side by side, remembering what they need."""

    def __init__(self, recipe: Recipe, count: int = 1) -> None:
        """Starts without a past.

        Args:
            recipe: How features are made.
            count: Rigs side by side.
        """
        self.recipe = recipe
        self._controlled = recipe.taps.index(recipe.tap)
        self._zoom = recipe.base ** np.arange(recipe.levels)
        counts = [points for _, points in recipe.line]
        self._line_from = np.concatenate(
            [np.repeat([0.0, 0.0, recipe.centre_pa], n) for n in counts] or [np.empty(0)]
        )
        self._line_in = np.concatenate(
            [np.repeat([DENSITY_KG_M3, VELOCITY_M_S, recipe.range_pa], n) for n in counts]
            or [np.empty(0)]
        )
        self._before: Floats | None = None
        self._commands = np.zeros((count, recipe.past))
        self._features = np.empty((count, recipe.size))

    def reset(self) -> None:
        """Forgets the past: as if pressures had not changed and the valve had been closed."""
        self._before = None
        self._commands[:] = 0.0

    def observe(self, taps_pa: Floats, targets_pa: Floats, line: Floats | None = None) -> Floats:
        """Features of the present moment, one control period after the last.

        Args:
            taps_pa: (count, taps) readings in the order of the recipe's taps, Pa.
            targets_pa: (count, previews) targets at the recipe's times ahead, Pa.
            line: (count, points) gas of the lines, as a plant's ``line`` gives it.

        Returns:
            (count, size) features; the array is written anew at the next call.

        Raises:
            ValueError: A value is not finite.
        """
        r, out = self.recipe, self._features
        # A sum is not finite where a term is not; cheaper than a look at each.
        if not math.isfinite(float(taps_pa.sum()) + float(targets_pa.sum())):
            raise ValueError(f"found readings {taps_pa} Pa and targets {targets_pa} Pa")
        error = (targets_pa - taps_pa[:, self._controlled, None]) / r.span_pa
        n, k = error.shape[0], error.shape[1]
        width = 1 + 2 * r.levels
        block = out[:, : k * width].reshape(n, k, width)
        block[:, :, 0] = error
        if r.levels:
            angle = error[:, :, None] * self._zoom
            np.sin(angle, out=block[:, :, 1 : 1 + r.levels])
            np.cos(angle, out=block[:, :, 1 + r.levels :])
        at = k * width
        m = len(r.taps)
        out[:, at : at + m] = (taps_pa - r.centre_pa) / r.range_pa
        before = taps_pa if self._before is None else self._before
        out[:, at + m : at + 2 * m] = (taps_pa - before) / r.span_pa
        self._before = taps_pa.copy()
        at += 2 * m
        out[:, at : at + r.past] = self._commands
        at += r.past
        if r.line:
            if line is None:
                raise ValueError("the recipe wants the gas of lines, found none")
            out[:, at:] = (line - self._line_from) / self._line_in
        return out

    def acted(self, volts: Floats) -> None:
        """Remembers the command that was sent.

        Args:
            volts: (count,) voltages.
        """
        if self.recipe.past:
            self._commands[:, 1:] = self._commands[:, :-1].copy()
            self._commands[:, 0] = (volts - self.recipe.null_v) / self.recipe.half_v
