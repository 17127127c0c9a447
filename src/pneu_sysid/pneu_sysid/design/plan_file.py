# SPDX-License-Identifier: Apache-2.0
"""A plan's file, read and checked before anything is played; `results.write_json` writes it."""

import math
from pathlib import Path

import numpy as np

from pneu_common.errors import InputError
from pneu_sim.rig.schema import Rig
from pneu_sysid.design.plan import Plan
from pneu_sysid.results.files import read_json


def load_plan(path: Path) -> Plan:
    """Reads a plan and checks it.

    Args:
        path: The file.

    Raises:
        InputError: It is no plan.
    """
    plan = read_json(path)
    if not isinstance(plan, Plan):
        raise InputError(f"{path}: is no plan of `pneu excite`")
    for name, of in plan.commands.items():
        time_s, volts = np.array(of.time_s, dtype=float), np.array(of.volts, dtype=float)
        where = f"{path}: commands.{name}"
        if time_s.size != volts.size or time_s.size == 0:
            raise InputError(
                f"{where}: found {time_s.size} times and {volts.size} volts, as many are needed"
            )
        if not (np.isfinite(time_s).all() and np.isfinite(volts).all()):
            raise InputError(f"{where}: found a number that is not finite")
        if time_s[0] != 0.0 or np.any(np.diff(time_s) <= 0.0):
            raise InputError(f"{where}: its times have to begin with 0 and to rise")
        low, high = plan.limits.low_v.get(name), plan.limits.high_v.get(name)
        if low is None or high is None:
            raise InputError(f"{where}: has no limits; low_v and high_v of it are needed")
        if volts.min() < low - 1e-3 or volts.max() > high + 1e-3:
            raise InputError(
                f"{where}: found {volts.min():g} to {volts.max():g} V, its limits are"
                f" {low:g} to {high:g}"
            )
    if not (math.isfinite(plan.seconds) and plan.seconds > 0.0):
        raise InputError(f"{path}: seconds: found {plan.seconds:g}, it must be positive")
    return plan


def check_plan(plan: Plan, rig: Rig, path: Path | str = "plan") -> None:
    """Raises InputError where a plan is for another rig.

    Args:
        plan: The plan.
        rig: The rig.
        path: File of the plan.
    """
    if plan.rig != rig.name or set(plan.commands) != set(rig.commands):
        raise InputError(
            f"{path}: is for rig {plan.rig!r} with commands {', '.join(plan.commands)}; this is"
            f" {rig.name!r} with {', '.join(rig.commands) or 'none'}"
        )
