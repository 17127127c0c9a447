# SPDX-License-Identifier: Apache-2.0
"""What every part of a rig file is made of: numbers with their bounds, and no unknown keys."""

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field


def _no_truth(value: Any) -> Any:
    """Refuses true and false where a number is meant; Python would take them for 1 and 0."""
    if isinstance(value, bool):
        raise ValueError("a number is needed")
    return value


Number = Annotated[float, BeforeValidator(_no_truth)]
Positive = Annotated[Number, Field(gt=0.0, allow_inf_nan=False)]
NonNegative = Annotated[Number, Field(ge=0.0, allow_inf_nan=False)]
Finite = Annotated[Number, Field(allow_inf_nan=False)]
Ratio = Annotated[Number, Field(ge=0.0, lt=1.0)]
Share = Annotated[Number, Field(ge=0.0, le=1.0)]


class Part(BaseModel):
    """Base of every part of a rig: unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", populate_by_name=True)
