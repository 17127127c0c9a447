# SPDX-License-Identifier: Apache-2.0
"""Limits within which a rig is excited: volts, how fast they change, pressures, joints, air."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pneu_common.errors import InputError
from pneu_sim.rig.build import build
from pneu_sim.rig.plan import plan_grid
from pneu_sim.rig.schema import Rig

SLEW_V_S = 2000.0
"""As a bridge has it: from end to end of a spool in a few milliseconds."""
ABOVE_SUPPLY = 1.1
"""Waves go above the highest reservoir, by 6 % where a closed line is filled with the valve wide
open; where no pressure is given nothing more than this may."""
LEAST_SPAN_V = 0.05
"""Commands that may move by less excite nothing."""


@dataclass(frozen=True)
class Limits:
    """What a plan keeps to.

    Attributes:
        low_v: Lowest voltage of each command.
        high_v: Highest.
        slew_v_s: Fastest change of a command, V/s.
        highest_pa: Pressure that no tap and no chamber may exceed.
        lowest_pa: Pressure that none may fall below.
        joints: Per joint how far it may go, rad or m; none is as far as its stops.
        air_kg: Air that may be taken from the supplies; infinite for any amount.
    """

    low_v: Mapping[str, float]
    high_v: Mapping[str, float]
    slew_v_s: float = SLEW_V_S
    highest_pa: float = math.inf
    lowest_pa: float = 0.0
    joints: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    air_kg: float = math.inf


def volts_of(rig: Rig) -> dict[str, tuple[float, float]]:
    """Between which voltages the opening curves that each command moves are known.

    Args:
        rig: The rig.
    """
    plan = plan_grid(rig)
    model = build(rig, plan)
    found: dict[str, tuple[float, float]] = {}
    for q, name in enumerate(plan.port_names):
        valve = rig.valves.get(name.split(".")[0])
        if valve is None:
            continue
        low, high = (float(v) for v in model.curve_v[q])
        null = valve.spool.null_v
        before = found.get(valve.command, (null, null))
        found[valve.command] = min(low, before[0]), max(high, before[1])
    return {command: found[command] for command in rig.commands if command in found}


def limits_of(
    rig: Rig,
    low_v: float | None = None,
    high_v: float | None = None,
    slew_v_s: float | None = None,
    highest_pa: float | None = None,
    lowest_pa: float | None = None,
    joints: Mapping[str, tuple[float, float]] | None = None,
    air_kg: float | None = None,
) -> Limits:
    """Limits of a rig, narrowed by what is asked for.

    Args:
        rig: The rig.
        low_v: Lowest voltage of all commands; None is where their opening curves begin.
        high_v: Highest.
        slew_v_s: Fastest change, V/s.
        highest_pa: Pressure that nothing may exceed; None is just above the highest reservoir.
        lowest_pa: Pressure that nothing may fall below.
        joints: Per joint how far it may go, rad or m.
        air_kg: Air that may be taken from the supplies.

    Raises:
        InputError: They are no limits of this rig, or leave nothing to excite.
    """
    volts = volts_of(rig)
    if not volts:
        raise InputError(f"rig {rig.name!r}: found no valve with a command, nothing can be excited")
    lows, highs = {}, {}
    for command, (low, high) in volts.items():
        lows[command] = low if low_v is None else max(low, low_v)
        highs[command] = high if high_v is None else min(high, high_v)
        if not highs[command] - lows[command] >= LEAST_SPAN_V:
            raise InputError(
                f"limits: found {lows[command]:g} to {highs[command]:g} V for command {command!r},"
                f" which leaves nothing to excite; its valves open between {low:g} and {high:g} V"
            )
    for name, value in (("slew_v_s", slew_v_s), ("air_kg", air_kg)):
        if value is not None and not value > 0.0:
            raise InputError(f"{name}: found {value:g}, it must be positive")
    supply = max((r.pressure_pa for r in rig.reservoirs.values()), default=math.inf)
    highest = ABOVE_SUPPLY * supply if highest_pa is None else highest_pa
    room = rig.ambient.pressure_pa
    lowest = 0.0 if lowest_pa is None else lowest_pa
    if not lowest < highest or highest <= room:
        raise InputError(
            f"limits: found pressures of {lowest:.6g} to {highest:.6g} Pa, which leaves nothing to"
            f" excite; the room has {room:.6g} Pa, and pressures are absolute"
        )
    known = set(plan_grid(rig).joints)
    given = dict(joints or {})
    for joint, (low, high) in given.items():
        if joint not in known:
            named = ", ".join(sorted(known)) or "none"
            raise InputError(f"joints: found {joint!r}, rig {rig.name!r} has {named}")
        if not low < high:
            raise InputError(f"joints: found {joint} from {low:g} to {high:g}, low is to be less")
    return Limits(
        lows, highs, SLEW_V_S if slew_v_s is None else slew_v_s, highest, lowest, given,
        math.inf if air_kg is None else air_kg,
    )  # fmt: skip


def slewed(volts: np.ndarray, step_s: float, limits: Limits) -> np.ndarray:
    """Commands that change no faster than they may.

    Args:
        volts: (T,) what is asked for, V.
        step_s: Between them, s.
        limits: The limits.
    """
    most = limits.slew_v_s * step_s
    if not np.any(np.abs(np.diff(volts)) > most):
        return volts
    out = volts.copy()
    for k in range(1, out.size):
        out[k] = np.clip(out[k], out[k - 1] - most, out[k - 1] + most)
    return out
