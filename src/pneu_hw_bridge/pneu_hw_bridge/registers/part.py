# SPDX-License-Identifier: Apache-2.0
"""What all parts of a register map are made of."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

MAX_READ_REGISTERS = 125
"""Most registers that one read may ask for, by the Modbus application protocol 1.1b3, 6.3."""

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class Part(BaseModel):
    """Base of every part of a map: unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)
