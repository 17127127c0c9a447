# SPDX-License-Identifier: Apache-2.0
"""The JSON results of ``compare``, ``fit``, ``diagnose`` and others, read and written.

The models of this folder are the only source of their schema; ``docs/json.md`` is made from them
(`pneu_sysid.results.page`). A number that is not finite becomes null on the way in, so no file ever
holds NaN.
"""

import json
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_common.validation import sentence
from pneu_sysid.design.plan import Plan
from pneu_sysid.results.base import Result
from pneu_sysid.results.compare import CompareResult
from pneu_sysid.results.diagnose import DiagnoseResult
from pneu_sysid.results.fit import FitResult
from pneu_sysid.results.friction import FrictionResult
from pneu_sysid.results.learn import LearnResult
from pneu_sysid.results.observe import ObserveResult
from pneu_sysid.results.scenes import (
    SceneCompareResult,
    SceneDiagnoseResult,
    SceneFitResult,
    SceneLearnResult,
)

RESULTS: tuple[type[Result], ...] = (
    CompareResult,
    FitResult,
    DiagnoseResult,
    LearnResult,
    FrictionResult,
    ObserveResult,
    SceneCompareResult,
    SceneFitResult,
    SceneDiagnoseResult,
    SceneLearnResult,
    Plan,
)


def result_of(data: dict[str, Any]) -> Any:
    """Checks plain data against the schema it names.

    Args:
        data: A result, as read from its file.

    Returns:
        The result.

    Raises:
        InputError: The schema is unknown, or the data do not follow it.
    """
    name = data.get("schema")
    kinds = {kind.model_fields["schema_"].default: kind for kind in RESULTS}
    if name not in kinds:
        raise InputError(f"schema: found {name!r}, known are {', '.join(kinds)}")
    try:
        return kinds[name].model_validate(data)
    except ValidationError as error:
        raise InputError(f"result of schema {name}: {sentence(error, kinds[name])}") from None


def read_json(path: Path) -> Any:
    """Reads a result file.

    Args:
        path: The file.

    Returns:
        The result.

    Raises:
        InputError: It cannot be read, or is no result.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError as error:  # bytes that are no text, too
        raise InputError(f"{path}: is no JSON ({error})") from None
    try:
        return result_of(data if isinstance(data, dict) else {})
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def write_json(path: str | Path, result: Result | dict[str, Any]) -> None:
    """Writes a result file, whole or not at all.

    Args:
        path: Where; its folder must exist.
        result: The result; plain data are checked first.

    Raises:
        InputError: The file cannot be written, or the data do not follow their schema.
    """
    path = Path(path)
    checked = result if isinstance(result, Result) else result_of(result)
    data = checked.as_dict()
    data = {"schema": data.pop("schema"), **data}
    lines = [f"  {json.dumps(k)}: {json.dumps(v, allow_nan=False)}" for k, v in data.items()]
    write_whole(path, "{\n" + ",\n".join(lines) + "\n}\n")
