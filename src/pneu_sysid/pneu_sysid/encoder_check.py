# SPDX-License-Identifier: Apache-2.0
"""Encoders whose numbers cannot be where the rig's joints and pistons can stand.

Degrees for radians and millimetres for metres are refused and named; whole turns are taken off; an
encoder that stands still while the gas moves is told.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.bodies.kinds import NUMBER
from pneu_sim.rig.mechanics import body_rows, within_stroke
from pneu_sim.rig.schema import Rig
from pneu_sim.signals import Signal
from pneu_sysid.records import Finding, Recording
from pneu_sysid.sensor_units import encoder_unit, joints_of

Floats = NDArray[np.float64]

TURN = 2.0 * np.pi
SLACK = 0.5
"""A reading may lie beyond its range by this part of it: stops give way, and a zero is seldom known
well."""
MEANT = 0.1
"""In the unit, or the turn, that was meant it lies no further beyond."""
JUMP_RAD = 1.0
"""A jump that is a turn to within this is an encoder that began again."""
UNITS = {
    "rad": (("degrees", np.pi / 180.0), ("milliradians", 1e-3), ("turns", TURN)),
    "m": (("millimetres", 1e-3), ("centimetres", 1e-2)),
}
"""What else angles and lengths may be told in, and how large one of it is."""
FROZEN_S = 0.3
"""For so long at least an encoder repeats one number that is told to be stuck, ..."""
MOVES = 0.5
"""... and some pressure moves meanwhile by this part of its whole range."""
SCANNED = 721
"""Positions at which a joint without stops is tried, over a turn or a metre either way."""


def checked_encoders(rig: Rig, path: str, recording: Recording) -> None:
    """Refuses, or puts right in place, readings that the rig's encoders cannot have.

    Args:
        rig: The rig.
        path: Where the recording was read from, for messages.
        recording: The recording; what was found is added to its report.

    Raises:
        InputError: Readings are in another unit, or far from where the joint can be.
    """
    for name, signal in list(recording.encoders.items()):
        if name not in rig.encoders or not len(signal):
            continue
        reach = reading_range(rig, name)
        unit = encoder_unit(rig, name)
        if reach is not None:
            _check_unit(path, name, signal.values, reach, unit)
        if unit == "rad":
            signal = _unwrapped(recording, name, signal, reach)
        if reach is not None:
            _check_range(path, name, signal.values, reach, unit)
        recording.report += _stuck(name, signal, recording.pressures.values())


def reading_range(rig: Rig, encoder: str) -> tuple[float, float] | None:
    """What an encoder may read: between the stops of its joint, or the ends of pistons.

    Args:
        rig: The rig.
        encoder: Name of the encoder.

    Returns:
        The least and the largest, rad or m; None where nothing limits its joint.
    """
    one = rig.encoders[encoder]
    if one.cylinder is not None:
        ends: tuple[float, float] | None = (0.0, rig.cylinders[one.cylinder].stroke)
    else:
        ends = _joint_range(rig, one.on(encoder))
    if ends is None:
        return None
    low, high = (one.gain * end + one.bias for end in ends)
    return low, high


def _joint_range(rig: Rig, name: str) -> tuple[float, float] | None:
    """Where a joint can stand: between its stops, or as far as pistons let it."""
    joint = joints_of(rig)[name][0] if name in joints_of(rig) else None
    if joint is None:
        return None
    if joint.lower is not None and joint.upper is not None:
        return joint.lower, joint.upper
    body = next(b for b in rig.bodies.values() if joint in b.joints)
    if not body.driven_by:
        return None
    # The compiler is loaded where there are bodies.
    from pneu_sim.kernel.equations.kinds import levers

    number = list(rig.bodies.values()).index(body)
    rows = body_rows(rig)[0][:, :, None]
    place = next(k for k, one in enumerate(body.joints) if one is joint)
    start = np.array([one.start for one in body.joints])
    strokes = [rig.cylinders[driven].stroke for driven in body.driven_by]
    tried = start[place] + np.linspace(-np.pi, np.pi, SCANNED)
    fits = np.zeros(SCANNED, dtype=bool)
    for k, position in enumerate(tried.tolist()):
        at = start.copy()
        at[place] = position
        extension, lever = np.zeros(len(strokes)), np.zeros((len(strokes), start.size))
        levers(NUMBER[type(body)], rows, number, 0, at, extension, lever)
        fits[k] = all(map(within_stroke, extension.tolist(), strokes))
    middle = SCANNED // 2
    if fits.all() or not fits[middle]:
        return None
    beyond = np.flatnonzero(~fits)
    low = beyond[beyond < middle].max(initial=-1) + 1
    high = beyond[beyond > middle].min(initial=SCANNED) - 1
    if low == 0 or high == SCANNED - 1:
        return None
    return float(tried[low]), float(tried[high])


def _within(
    values: Floats, reach: tuple[float, float], slack: float, scale: float = 1.0
) -> tuple[bool, float, float]:
    """Whether readings lie in a range, and their least and largest but for a few."""
    least, most = (float(scale * q) for q in np.quantile(values, (0.01, 0.99)))
    room = slack * (reach[1] - reach[0])
    return reach[0] - room <= least and most <= reach[1] + room, least, most


def _found(path: str, name: str, values: Floats, reach: tuple[float, float], unit: str) -> str:
    _, least, most = _within(values, reach, 0.0)
    return (
        f"{path}: encoder {name!r}: readings run from {least:.4g} to {most:.4g} {unit}, where the"
        f" rig lets it read {reach[0]:.4g} to {reach[1]:.4g} {unit}"
    )


def _check_unit(
    path: str, name: str, values: Floats, reach: tuple[float, float], unit: str
) -> None:
    """Refuses readings that would fit well in another unit, and in this one not at all."""
    fits, least, most = _within(values, reach, SLACK)
    if fits or (unit == "rad" and most - least <= 1.01 * TURN and _some_turn(values, reach)):
        return
    if most - least <= (1.0 + 2.0 * SLACK) * (reach[1] - reach[0]):
        return  # off by a constant rather than too large
    for other, size in UNITS[unit]:
        turned = unit == "rad" and size < 1.0 and _some_turn(size * values, reach)
        if turned or _within(values, reach, MEANT, size)[0]:
            raise InputError(
                f"{_found(path, name, values, reach, unit)}; they seem to be in {other}: say so in"
                f" its channel with scale: {size:.6g}"
            )


def _some_turn(values: Floats, reach: tuple[float, float]) -> bool:
    """Whether every reading is where the joint can be, but for whole turns."""
    middle = 0.5 * (reach[0] + reach[1])
    nearest = values - TURN * np.round((values - middle) / TURN)
    return _within(nearest, reach, MEANT)[0]


def _check_range(
    path: str, name: str, values: Floats, reach: tuple[float, float], unit: str
) -> None:
    if not _within(values, reach, SLACK)[0]:
        raise InputError(
            f"{_found(path, name, values, reach, unit)}; are scale and offset of its channel, and"
            " the encoder's bias, right?"
        )


def _unwrapped(
    recording: Recording, name: str, signal: Signal, reach: tuple[float, float] | None
) -> Signal:
    """Takes off the turns at which an encoder began again, and those by which it is off."""
    values = signal.values
    steps = np.diff(values)
    jumps = np.where(np.abs(np.abs(steps) - TURN) < JUMP_RAD, np.sign(steps), 0.0)
    count = int(np.count_nonzero(jumps))
    turns = np.concatenate([[0.0], -np.cumsum(jumps)])
    whole = values + TURN * turns
    off = 0.0
    if reach is not None and not _within(whole, reach, MEANT)[0]:
        off = float(np.round((np.median(whole) - 0.5 * (reach[0] + reach[1])) / TURN))
        if not _within(whole - TURN * off, reach, SLACK)[0]:
            off = 0.0
    elif count and reach is None:  # the turn in which it was for longest
        off = float(np.median(turns))
    if not count and not off:
        return signal
    fixed = Signal(signal.time_s, whole - TURN * off)
    recording.encoders[name] = fixed
    changed = int(np.count_nonzero(turns - off))
    where = "" if reach is None else " the turn is that in which its joint can stand;"
    note = (
        f"jump(s) of a turn of the encoder;{where} {changed} of {len(signal)} readings were moved"
        " by whole turns"
    )
    recording.report.append(Finding(name, "wrapped", count, note))
    return fixed


def _stuck(name: str, signal: Signal, pressures: Iterable[Signal]) -> list[Finding]:
    """What is told of an encoder that repeats one number while the gas moves."""
    values, time = signal.values, signal.time_s
    if len(values) < 2 or np.ptp(values) == 0.0:  # that it never changes is told already
        return []
    first = np.concatenate([[0], np.flatnonzero(np.diff(values) != 0.0) + 1])
    last = np.concatenate([first[1:] - 1, [len(values) - 1]])
    found = [
        (float(time[a]), float(time[b]))
        for a, b in zip(first, last, strict=True)
        if time[b] - time[a] >= FROZEN_S and _moves(pressures, float(time[a]), float(time[b]))
    ]
    if not found:
        return []
    total = sum(end - begin for begin, end in found)
    note = (
        f"stretch(es) of one value, {total:.3g} s in all, the first at {found[0][0]:.4g} s, in"
        " which pressures move; kept, but if it does not stand at a stop there, the encoder is"
        " stuck"
    )
    return [Finding(name, "frozen", len(found), note)]


def _moves(pressures: Iterable[Signal], begin: float, end: float) -> bool:
    """Whether a pressure moves by much of its range within some time."""
    for signal in pressures:
        inside = signal.within(begin, end).values
        if len(inside) > 1 and np.ptp(inside) > MOVES * np.ptp(signal.values) > 0.0:
            return True
    return False
