# SPDX-License-Identifier: Apache-2.0
"""Where a recorded signal is found in a bag or a text file, and its scale to SI units."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

PRESSURES = (
    ("bar", 1e5),
    ("kPa", 1e3),
    ("psi", 6894.757),
    ("mbar", 1e2),
    ("MPa", 1e6),
    ("atm", 101325.0),
    ("pascals", 1.0),
)
"""Units of pressure by name, in Pa; each may be absolute or above the room's."""
BEYOND = 1e30
"""No sensor reads that much, in whatever unit."""


class Channel(BaseModel):
    """One recorded signal and its conversion ``value_si = raw * scale + offset``.

    Attributes:
        topic: Topic of the signal in a bag.
        applied: Topic, with messages alike, on which a bridge confirms what took effect, and when.
            A command that was decided acts later, and not always by as much; where the bag has this
            topic it is read in place of ``topic``.
        field: Dotted path of the number inside the message, such as ``fluid_pressure``,
            ``data`` or ``position[0]``.
        type: Message type the topic must have, checked where given.
        column: Column of the signal in a text file: a name, or a number counted from 0.
        scale: SI units per raw unit (1e5 for bar).
        offset: Value in SI units at raw zero (101325 for gauge pressure in standard air).
        stamp: Clock of the samples: the message header's stamp, the recorder's log
            time, or ``auto``, which is the header's where there is one.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    topic: str | None = None
    applied: str | None = None
    field: str = "data"
    type: str | None = None
    column: str | int | None = None
    scale: float = Field(default=1.0, allow_inf_nan=False)
    offset: float = Field(default=0.0, allow_inf_nan=False)
    stamp: Literal["auto", "header", "log"] = "auto"

    @model_validator(mode="after")
    def _has_source_and_scale(self) -> "Channel":
        if self.topic is None and self.column is None:
            raise ValueError("a channel needs a topic (bag) or a column (text file)")
        if self.applied is not None and self.topic is None:
            raise ValueError("a channel with 'applied' needs a topic, too")
        if self.scale == 0.0:
            raise ValueError("the scale of a channel must not be 0")
        return self

    def convert(self, raw: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values in SI units; what is beyond all that is measured becomes infinite.

        Args:
            raw: (n,) values as they were recorded.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            values = raw * self.scale + self.offset
        return np.where(np.abs(values) > BEYOND, np.inf, values)


class TextFormat(BaseModel):
    """How the rows of a delimited text recording are laid out.

    Attributes:
        delimiter: Character between columns; None takes whichever of ``;``, ``,``, tab
            or blanks the first rows use; a blank means any run of blanks.
        comment: Lines that start with this are skipped.
        time: Column of time: a name, or a number counted from 0.
        time_scale: Seconds per unit of the time column.
        decimal: Decimal point.
        thousands_separator: Character that groups thousands. Where it equals the decimal
            point, the last one in a number is the decimal point and those before it
            group (``31.102.000`` is 31102.000).
        skip_rows: Lines dropped from the top of the file, before all else.
        names: Column names; None takes them from a heading row, or from the last
            comment line above the numbers where that has as many words as columns.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    delimiter: str | None = Field(default=None, min_length=1, max_length=1)
    comment: str = "#"
    time: str | int = 0
    time_scale: float = Field(default=1.0, gt=0.0, allow_inf_nan=False)
    decimal: str = Field(default=".", min_length=1, max_length=1)
    thousands_separator: str | None = Field(default=None, min_length=1, max_length=1)
    skip_rows: int = Field(default=0, ge=0)
    names: tuple[str, ...] | None = None
