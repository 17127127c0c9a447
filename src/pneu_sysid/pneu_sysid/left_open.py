# SPDX-License-Identifier: Apache-2.0
"""Whether an effect of what moves says no more than what the calibration left open.

A calibration on fast strokes hardly sees at which force a seal lets go; where a joint then comes to
rest, a tenth of a newton decides when it slips. What differs there is no change of the robot.
"""

from typing import Any

from pneu_sim.effects.registry import apply_to_rig
from pneu_sim.rig.schema import Rig

WITHIN = 2.0
"""Standard errors of the calibration within which a number is what it was."""
MOVING = ("cylinders.", "bodies.")
"""Numbers that are judged so. Those of lines are known far better together than each alone."""


def left_open(rig: Rig) -> bool:
    """Whether the last effect of a rig changes numbers of what moves within their standard errors.

    Args:
        rig: The rig, calibrated, with at least one effect.
    """
    if rig.calibration is None or not rig.effects:
        return False
    before = rig.model_copy(update={"effects": rig.effects[:-1]})
    old, new = (_numbers(apply_to_rig(r).model_dump()) for r in (before, rig))
    changed = [path for path in {*old, *new} if old.get(path) != new.get(path)]
    known = {p.path: p.std_error for p in rig.fit.parameters if p.std_error is not None}
    return bool(changed) and all(
        path.startswith(MOVING)
        and path in known
        and abs(_number(new, path) - _number(old, path)) <= WITHIN * known[path]
        for path in changed
    )


def _number(values: dict[str, Any], path: str) -> float:
    value = values.get(path)
    return float(value) if isinstance(value, int | float) else float("nan")


def _numbers(part: Any, path: str = "") -> dict[str, Any]:
    """What a dumped rig says, by its dotted path; without its effects."""
    if isinstance(part, dict):
        inner = list(part.items())
    elif isinstance(part, list | tuple):
        inner = [(str(k), value) for k, value in enumerate(part)]
    else:
        return {path: part}
    return {
        p: value
        for name, value in inner
        if path or name not in ("effects", "fit", "calibration")
        for p, value in _numbers(value, f"{path}.{name}" if path else str(name)).items()
    }
