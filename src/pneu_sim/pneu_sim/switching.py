# SPDX-License-Identifier: Apache-2.0
"""Commands that are switches: what a spool is told when, by a threshold or by a duty.

A duty is what a pulse width modulation switches by: its periods begin at whole numbers of them from
time zero, and each keeps the duty that was in force as it began, as the compare register of a timer
does. Instants are exact, wherever in a control interval they fall.
"""

import math

import numpy as np
from numpy.typing import NDArray

from pneu_sim.compiling import compiled
from pneu_sim.rig import model as M
from pneu_sim.signals import SAME_S

Floats = NDArray[np.float64]

PAST_PERIODS = 3.0
"""Periods before a time in which commands still matter then: that under way, and one to compare."""


@compiled
def _modulated(
    time: Floats, duty: Floats, begin: float, end: float, row: Floats
) -> tuple[Floats, Floats]:
    """When a modulated switch is switched, and to what, from the period before a time on."""
    period = row[M.V_PERIOD]
    off, on = row[M.V_OFF], row[M.V_ON]
    first, last = math.floor(begin / period) - 1, math.ceil(end / period)
    out_time = np.empty(2 * (last - first + 1))
    out_volts = np.empty(out_time.size)
    n = 0
    i = 0
    for k in range(first, last + 1):
        at = k * period
        while i + 1 < time.size and time[i + 1] <= at + SAME_S:
            i += 1
        share = min(max(duty[i], 0.0), 1.0)
        for instant, volts, there in (
            (at, on, share > 0.0),
            (at + share * period, off, share < 1.0),
        ):
            if there:
                out_time[n] = instant
                out_volts[n] = volts
                n += 1
    return out_time[:n], out_volts[:n]


@compiled
def switched(
    time: Floats, command: Floats, begin: float, end: float, row: Floats
) -> tuple[Floats, Floats]:
    """What the spool of a valve with a switch is told.

    Args:
        time: (n,) when the switch is told, s, increasing.
        command: (n,) what, each held until the next; the first also before its time.
        begin: Time from which on it matters what the spool is told, s.
        end: Time up to which it does, s.
        row: Valve parameters, see ``pneu_sim.rig.model``.

    Returns:
        (m,) times, s, and (m,) volts, each held until the next.
    """
    if row[M.V_PERIOD] > 0.0:
        return _modulated(time, command, begin, end, row)
    volts = np.empty(command.size)
    off, on = row[M.V_OFF], row[M.V_ON]
    for i in range(command.size):
        beyond = (command[i] - row[M.V_THRESHOLD]) * (on - off) > 0.0
        volts[i] = on if beyond else off
    return time, volts


def has_switch(spool: Floats) -> bool:
    """Whether any valve has a switch.

    Args:
        spool: (..., VALVE_COLUMNS) valve parameters.
    """
    return bool(np.any(spool[..., M.V_ON] != spool[..., M.V_OFF]))
