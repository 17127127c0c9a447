# SPDX-License-Identifier: Apache-2.0
"""What a recording of the live graph shows of a run: pressure, target and what the valve did.

Bag in, series out: nothing that the processes claim of themselves is used, but that a controller
had no time for its plans.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pneu_common.errors import InputError
from pneu_graph.bag.reader import BagReader
from pneu_policy.control.planning import PLANS, PLANS_LATE
from pneu_policy.judge.metrics import Track
from pneu_runtime import hook

NAMESPACE = "lab"
DIAGNOSTICS = "/diagnostics"
MOST_UNFOLLOWED_S = 0.02
"""Longest total time in which the bridge held the valve safe, in a valid run."""
SAFE_V = 0.0
"""Voltage at which it does, after the register map of the lab."""
MOST_UNPLANNED = 0.02
"""Most plans of a controller that were not made in time, in a valid run, as a share of all."""
LEAST_RATE_HZ = 200.0
"""Fewest readings per second of a valid run; the bridge aims at 500."""


class LateError(Exception):
    """A run that does not show the rig in real time, or not whole."""


def track_of(bag: Path, tap: str, namespace: str = NAMESPACE) -> Track:
    """What a recording shows of a run: time zero is that of the first target.

    Args:
        bag: The recording.
        tap: Tap that is controlled.
        namespace: Of the graph.

    Raises:
        LateError: The recording is damaged, lacks a topic or has too few readings, the valve was
            not where it was commanded, or the controller had no time for its plans.
    """
    hook.install()
    from diagnostic_msgs.msg import DiagnosticArray
    from pneu_msgs.msg import PressureTarget, ValveCommand
    from rclpy.serialization import deserialize_message
    from sensor_msgs.msg import FluidPressure

    kinds = {
        f"/{namespace}/taps/{tap}/pressure": FluidPressure,
        f"/{namespace}/target": PressureTarget,
        f"/{namespace}/valve/command": ValveCommand,
        f"/{namespace}/valve/applied": ValveCommand,
    }
    found: dict[str, dict[int, Any]] = {topic: {} for topic in kinds}
    told: dict[str, list[float]] = {PLANS: [], PLANS_LATE: []}
    try:
        recorded = list(BagReader(bag).messages({*kinds, DIAGNOSTICS}))
    except InputError as error:
        raise LateError(f"no recording: {error}") from None
    for message in recorded:
        if message.topic == DIAGNOSTICS:
            for status in deserialize_message(message.data, DiagnosticArray).status:
                for pair in status.values:
                    if pair.key in told:
                        told[pair.key].append(float(pair.value))
            continue
        content = deserialize_message(message.data, kinds[message.topic])
        stamp = content.header.stamp
        found[message.topic][stamp.sec * 1_000_000_000 + stamp.nanosec] = content
    _check_planned(told[PLANS], told[PLANS_LATE])
    readings, targets, commands, applied = found.values()
    for topic, messages in found.items():
        if len(messages) < 2:
            raise LateError(f"{len(messages)} messages of {topic} were recorded")
    zero = min(targets)

    def seconds(messages: Mapping[int, Any]) -> Any:
        return (np.array(sorted(messages), dtype=np.int64) - zero) * 1e-9

    def values(messages: Mapping[int, Any], read: Callable[[Any], float]) -> Any:
        return np.array([read(messages[stamp]) for stamp in sorted(messages)], dtype=np.float64)

    track = Track(
        seconds(readings),
        values(readings, lambda message: message.fluid_pressure),
        seconds(targets),
        values(targets, lambda message: message.pressure_pa[0]),
        seconds(applied),
        values(applied, lambda message: message.voltage_v[0]),
    )
    during = (track.time_s > 0.0) & (track.time_s < track.target_time_s[-1])
    rate_hz = np.count_nonzero(during) / track.target_time_s[-1]
    if rate_hz < LEAST_RATE_HZ:
        raise LateError(f"{rate_hz:.0f} readings per second, needed are {LEAST_RATE_HZ:.0f}")
    _check_followed(
        track, seconds(commands), values(commands, lambda message: message.voltage_v[0])
    )
    return track


def _check_planned(wanted: list[float], late: list[float]) -> None:
    """Raises where a controller had no time for its plans; those of before the run do not count.

    Args:
        wanted: How many were wanted so far, as diagnostics told it time and again.
        late: How many of them were not made in time.
    """
    if not wanted or not late:
        return
    all_of_them, missing = wanted[-1] - wanted[0], late[-1] - late[0]
    if missing > MOST_UNPLANNED * max(all_of_them, 1.0):
        raise LateError(f"{missing:.0f} of {all_of_them:.0f} plans were not made in time")


def _check_followed(track: Track, command_s: Any, volts: Any) -> None:
    """Raises where the bridge held the valve safe for long and nobody had commanded that.

    It does so where commands or readings are late; such a run shows the bridge. Elsewhere what took
    effect may lag behind fast commands, as the bridge limits their slope: that is the controller's.
    """
    ends = np.append(track.command_time_s[1:], track.command_time_s[-1])
    lasted = ends - track.command_time_s
    unfollowed_s = 0.0
    last_s = float(track.target_time_s[-1])
    for at, value, length in zip(track.command_time_s, track.volts, lasted, strict=True):
        if not 0.1 < at < last_s or abs(value - SAFE_V) > 1e-6:
            continue
        end = int(np.searchsorted(command_s, at + 1e-3))
        begin = max(int(np.searchsorted(command_s, at - 0.05)) - 1, 0)
        near = volts[begin:end]
        if near.size == 0 or np.min(np.abs(near - SAFE_V)) > 0.02:
            unfollowed_s += float(length)
    if unfollowed_s > MOST_UNFOLLOWED_S:
        raise LateError(f"the valve did not follow the commands for {unfollowed_s:.3f} s")
