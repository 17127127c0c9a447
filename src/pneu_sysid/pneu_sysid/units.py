# SPDX-License-Identifier: Apache-2.0
"""Recordings whose numbers are not in the units that the rig file says, told by the rig itself.

A model that is fed bar for pascals becomes unstable, or waits for hours, and names neither.
"""

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.channels import PRESSURES
from pneu_sim.models import kind_of
from pneu_sim.rig.schema import Rig
from pneu_sim.signals import Signal
from pneu_sysid.encoder_check import checked_encoders
from pneu_sysid.records import Finding, Recording

Floats = NDArray[np.float64]

STRANGE_LOW, STRANGE_HIGH = 0.3, 3.0
"""Readings below and above these multiples of the rig's own pressures are not believed."""
MEANT_LOW, MEANT_HIGH = 0.7, 1.3
"""In the unit that was meant they lie within these."""
MOST_MARKS = 3
"""A sensor marks what it could not read by one value, or a few."""
LONGEST_S = 1e6
"""Recordings that last longer are none."""
SLOW_S, LONG_S = 0.25, 1800.0
"""A line rings in milliseconds: readings this far apart for this long are hardly meant."""


def checked(rig: Rig, path: str, recording: Recording) -> Recording:
    """The recording without the marks of readings that failed, if its units are the rig's.

    Encoders that began again at a whole turn are made continuous.

    Args:
        rig: The rig.
        path: Where the recording was read from, for messages.
        recording: The recording.

    Raises:
        InputError: Pressures, positions, commands or times are in another unit, as far as the rig
            tells.
    """
    room = rig.ambient.pressure_pa
    sources = [room, *(r.pressure_pa for r in rig.reservoirs.values())]
    low, high = min(sources), max(sources)
    if len(sources) == 1:  # nothing says what fills it
        high = 100.0 * room
    _check_time(rig, path, recording)
    for name, command in recording.commands.items():
        _check_command(rig, path, name, command)
    for tap, signal in recording.pressures.items():
        kept, finding = _without_marks(tap, signal, low, high)
        if finding is not None:
            recording.pressures[tap] = kept
            recording.report.append(finding)
        _check_pressure(path, tap, kept.values, low, high, room)
    if recording.encoders:
        checked_encoders(rig, path, recording)
    return recording


def _without_marks(
    tap: str, signal: Signal, low: float, high: float
) -> tuple[Signal, Finding | None]:
    """Drops readings that all have one of a few values which no gas of the rig can have."""
    strange = (signal.values < STRANGE_LOW * low) | (signal.values > STRANGE_HIGH * high)
    count = int(strange.sum())
    if not count or 2 * count > len(signal):
        return signal, None
    marks = np.unique(signal.values[strange])
    if marks.size > MOST_MARKS:
        return signal, None
    named = ", ".join(f"{value:g}" for value in marks)
    note = (
        f"reading(s) of {named} Pa, which mark what the sensor could not read, were dropped and"
        " count as missing"
    )
    kept = Signal(signal.time_s[~strange], signal.values[~strange])
    return kept, Finding(tap, "mark", count, note)


def _check_pressure(
    path: str, tap: str, values: Floats, low: float, high: float, room: float
) -> None:
    """Refuses readings that are no absolute pascals of this rig."""
    least, most = (float(q) for q in np.quantile(values, (0.02, 0.98)))
    if STRANGE_LOW * low <= least and most <= STRANGE_HIGH * high:
        return
    text = (
        f"{path}: tap {tap!r}: readings run from {least:.4g} to {most:.4g} Pa, where the rig file"
        f" has pressures of {low:.4g} to {high:.4g} Pa"
    )
    meant = []
    for unit, scale in PRESSURES:
        for above in (False, True):
            offset = room if above else 0.0
            lowest, highest = least * scale + offset, most * scale + offset
            if MEANT_LOW * low <= lowest and highest <= MEANT_HIGH * high:
                # the likeliest is the one in which the rig's pressures are reached
                apart = abs(np.log(lowest / low)) + abs(np.log(highest / high))
                kind = f"{unit} above the room's pressure" if above else f"{unit}, absolute"
                more = f", offset: {offset:g}" if above else ""
                meant.append((float(apart), kind, f"scale: {scale:g}{more}"))
    if not meant:
        raise InputError(f"{text}; are scale and offset of its channel right?")
    _, kind, words = min(meant)
    raise InputError(f"{text}; they seem to be in {kind}: say so in its channel with {words}")


def _check_command(rig: Rig, path: str, name: str, command: Signal) -> None:
    """Refuses commands far beyond the voltages for which the valve's opening is known."""
    known: list[float] = []
    for valve in rig.valves.values():
        if valve.command == name:
            null = valve.spool.null_v
            known.append(abs(null))
            for port in valve.ports.values():
                # mirrored curves reach as far on the other side
                known += [abs(v) for v in port.opening.voltage_v]
                known += [abs(2.0 * null - v) for v in port.opening.voltage_v]
    if not known or not len(command):
        return
    reach, most = max(known), float(np.quantile(np.abs(command.values), 0.98))
    if most <= 10.0 * reach:
        return
    text = (
        f"{path}: command {name!r}: values reach {most:.4g} V, the valve's opening is known to"
        f" {reach:.4g} V"
    )
    if most * 1e-3 <= 1.5 * reach:
        raise InputError(f"{text}; they seem to be millivolts: say so with scale: 0.001")
    raise InputError(f"{text}; are scale and offset of its channel right?")


def _check_time(rig: Rig, path: str, recording: Recording) -> None:
    """Refuses times that seem to be milliseconds where lines would be simulated through them."""
    if recording.end_s > LONGEST_S:
        raise InputError(
            f"{path}: lasts {recording.end_s:.4g} s, allowed are {LONGEST_S:g}; a stamp is wrong,"
            " or text.time_scale"
        )
    steps = [float(np.median(np.diff(s.time_s))) for s in recording.readings.values()]
    period = min(steps)
    if not kind_of(rig).along_lines or period < SLOW_S or recording.end_s < LONG_S:
        return
    raise InputError(
        f"{path}: lasts {recording.end_s:.4g} s with a reading every {period:.3g} s; if its times"
        " are in milliseconds, say so with text.time_scale: 0.001, else a lumped model is meant"
        " for such recordings (model: thin_plate)"
    )
