# SPDX-License-Identifier: Apache-2.0
"""What every part of a JSON result is: strict, finite, and described where it is declared."""

import math
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field


def _finite(value: Any) -> Any:
    """None for a number that JSON cannot hold."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


Number = Annotated[float, Field(allow_inf_nan=False)]
Perhaps = Annotated[float | None, BeforeValidator(_finite)]


class Result(BaseModel):
    """Base of everything in a result file: unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", populate_by_name=True, use_attribute_docstrings=True)

    def as_dict(self) -> dict[str, Any]:
        """Returns the result as plain data, as it is written to JSON."""
        return self.model_dump(mode="json", by_alias=True)


Verdict = Literal["nothing_missing", "effect", "ambiguous", "unknown"]
