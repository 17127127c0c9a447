# SPDX-License-Identifier: Apache-2.0
"""Numbers that the safety of a bridge goes by, checked once; hardware refuses to run without."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from pneu_common.errors import InputError
from pneu_hw_bridge.registers.schema import Encoder, RegisterMap
from pneu_hw_bridge.safety.motion import BEYOND, EncoderLimits, FrozenLimits

LONGEST_WATCHDOG_S = 0.1
"""Longest time that hardware may run on without a new command."""

SHORTEST_WATCHDOG_S = 0.02
"""However slow a device is, commands may be so far apart; else none is followed."""

SAFE_WITHIN_S = 0.15
"""How soon valves are to be safe, unless somebody allows for more."""


@dataclass(frozen=True)
class OutputLimits:
    """Limits of one valve command.

    Attributes:
        lower_v: Lowest voltage.
        upper_v: Highest voltage.
        safe_v: Voltage that vents.
    """

    lower_v: float
    upper_v: float
    safe_v: float


@dataclass(frozen=True)
class SensorLimits:
    """Limits of one sensor.

    Attributes:
        lower_pa: Lowest reading that can be true.
        upper_pa: Highest reading that can be true.
        trip_above_pa: Reading above which the bridge trips; infinite for none.
        hold_below_pa: Reading below which the bridge vents until it has risen; -infinite for none.
        frozen_after_s: For how long a reading may stay exactly the same; infinite for ever.
    """

    lower_pa: float
    upper_pa: float
    trip_above_pa: float = math.inf
    hold_below_pa: float = -math.inf
    frozen_after_s: float = math.inf


@dataclass(frozen=True)
class Limits:
    """Limits of a whole bridge.

    Attributes:
        outputs: Per command its limits.
        sensors: Per tap its limits.
        encoders: Per encoder its limits.
        watchdog_s: How long a command is followed without a new one.
        sensor_timeout_s: How old the newest reading of a tap may be.
        slew_v_s: Fastest change of a voltage while commands are followed.
        clamp_margin_v: How far beyond its range a command is clamped; beyond that it is refused.
        dwell_s: For how long nothing may be wrong before commands are followed again.
        safe_within_s: How soon the valves must be safe at the device.
    """

    outputs: Mapping[str, OutputLimits]
    sensors: Mapping[str, SensorLimits]
    watchdog_s: float = 0.1
    sensor_timeout_s: float = 0.1
    slew_v_s: float = 2000.0
    clamp_margin_v: float = 1.0
    dwell_s: float = 1.0
    safe_within_s: float = SAFE_WITHIN_S
    encoders: Mapping[str, EncoderLimits] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not 0.0 < self.watchdog_s <= LONGEST_WATCHDOG_S:
            raise InputError(
                f"watchdog_s: found {self.watchdog_s:g}, hardware needs more than 0 and at most"
                f" {LONGEST_WATCHDOG_S:g} s"
            )
        for name in ("sensor_timeout_s", "slew_v_s", "safe_within_s"):
            value = getattr(self, name)
            if not (value > 0.0 and math.isfinite(value)):
                raise InputError(f"{name}: found {value:g}, needed is a positive number")
        for name in ("clamp_margin_v", "dwell_s"):
            value = getattr(self, name)
            if not (value >= 0.0 and math.isfinite(value)):
                raise InputError(f"{name}: found {value:g}, must not be negative")
        for name, output in self.outputs.items():
            if not output.lower_v <= output.safe_v <= output.upper_v:
                raise InputError(f"command {name!r}: its safe voltage lies outside of its range")


def limits_of(
    registers: RegisterMap,
    watchdog_s: float = 0.1,
    sensor_timeout_s: float = 0.1,
    slew_v_s: float = 2000.0,
    clamp_margin_v: float = 1.0,
    dwell_s: float = 1.0,
    safe_within_s: float = SAFE_WITHIN_S,
    stops: Mapping[str, tuple[float, float]] | None = None,
) -> Limits:
    """Limits of the device of a register map.

    Args:
        registers: The map.
        watchdog_s: How long a command is followed without a new one, s.
        sensor_timeout_s: How old the newest reading of a tap may be, s.
        slew_v_s: Fastest change of a voltage, V/s.
        clamp_margin_v: How far beyond its range a command is clamped, V.
        dwell_s: For how long nothing may be wrong before commands are followed again, s.
        safe_within_s: How soon the valves must be safe at the device, s.
        stops: Per encoder where its joint ends, rad or m, for what the map leaves open.

    Raises:
        InputError: A number is not allowed on hardware, or it is not known where a joint ends.
    """
    ends = stops or {}
    return Limits(
        outputs={
            name: OutputLimits(*channel.range, channel.safe)
            for name, channel in registers.outputs.items()
        },
        sensors={
            name: SensorLimits(
                *channel.range,
                math.inf if channel.trip_above is None else channel.trip_above,
                -math.inf if channel.hold_below is None else channel.hold_below,
                math.inf if channel.frozen_after_s is None else channel.frozen_after_s,
            )
            for name, channel in registers.taps.items()
        },
        watchdog_s=watchdog_s,
        sensor_timeout_s=sensor_timeout_s,
        slew_v_s=slew_v_s,
        clamp_margin_v=clamp_margin_v,
        dwell_s=dwell_s,
        safe_within_s=safe_within_s,
        encoders={
            name: _encoder_limits(registers.name, name, one, ends.get(name, (-math.inf, math.inf)))
            for name, one in registers.encoders.items()
        },
    )


def _encoder_limits(
    where: str, name: str, encoder: Encoder, stops: tuple[float, float]
) -> EncoderLimits:
    """Limits of one encoder; what its map leaves open is where its joint ends."""
    low, high = stops
    if not low < high:  # a joint that is held has no travel that could end
        low, high = -math.inf, math.inf
    reach = BEYOND * (high - low) if math.isfinite(high - low) else 0.0
    frozen = encoder.frozen
    ended = (
        low if frozen is None or frozen.stops is None else frozen.stops[0],
        high if frozen is None or frozen.stops is None else frozen.stops[1],
    )
    if frozen is not None and not (math.isfinite(ended[0]) and math.isfinite(ended[1])):
        raise InputError(
            f"{where}: encoders.{name}.frozen.stops: found none, and no rig file says where its"
            " joint ends; a joint that is pushed into a stop does not move"
        )
    return EncoderLimits(
        range=encoder.range,
        lower=low - reach if encoder.lower is None else encoder.lower,
        upper=high + reach if encoder.upper is None else encoder.upper,
        speed=math.inf if encoder.speed_limit is None else encoder.speed_limit,
        impossible=math.inf if encoder.impossible is None else encoder.impossible,
        resolution=encoder.resolution,
        frozen=None
        if frozen is None
        else FrozenLimits(
            frozen.force,
            frozen.hold,
            frozen.offset,
            frozen.after_s,
            encoder.resolution if frozen.still is None else frozen.still,
            ended,
        ),
    )
