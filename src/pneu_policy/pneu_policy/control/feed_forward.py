# SPDX-License-Identifier: Apache-2.0
"""The voltage that a target's slope asks for, from what the rig file says of valve and volume.

The volume V behind the valve takes dm/dt = V / (R T) dp*/dt to follow the target p* (thesis 3.2.1,
isothermal). A port fully open passes, after ISO 6358-1,

    m = C rho_0 p_1 sqrt(T_0 / T_1) sqrt(1 - ((p_2/p_1 - b) / (1 - b))^2)

with the root at 1 where choked. The quotient of the two is the opening needed, and the inverse of
the port's opening curve its voltage. Pressure lost along the lines and a volume that is not
isothermal are left to one factor on the flow, and the time that valve and line take to how far
ahead the slope is taken; both are tuned like the gains.
"""

import bisect
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np

from pneu_common.errors import InputError
from pneu_sim.gas import AIR, ANR_DENSITY_KG_M3, ANR_TEMPERATURE_K
from pneu_sim.rig.build import build
from pneu_sim.rig.network import volume_of_tap, volumes_of
from pneu_sim.rig.plan import plan_grid
from pneu_sim.rig.schema import Rig

HALF_WINDOW_S = 0.01
"""The slope is that of the target's chord over twice this."""

POINTS = 25
"""Points of an inverse opening curve, closer together near null."""

LISTS = ("voltage_v", "fraction")
"""Fields of a port that hold lists."""


@dataclass(frozen=True)
class Way:
    """One of the valve's ports, as a source or sink of the controlled volume.

    Attributes:
        pressure_pa: Pressure of the reservoir behind it, Pa.
        conductance_m3_s_pa: Sonic conductance C fully open.
        critical_ratio: Critical pressure ratio b.
        voltage_v: Voltages of the opening curve, from null outwards.
        fraction: Opening at each, rising.
    """

    pressure_pa: float
    conductance_m3_s_pa: float
    critical_ratio: float
    voltage_v: tuple[float, ...]
    fraction: tuple[float, ...]

    def __post_init__(self) -> None:
        """Raises InputError where the numbers make no port."""
        for name in ("pressure_pa", "conductance_m3_s_pa"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name}: found {value}, it must be positive")
        if not 0.0 <= self.critical_ratio < 1.0:
            raise InputError(f"critical_ratio: found {self.critical_ratio}, allowed are 0 to 1")
        f, v = self.fraction, self.voltage_v
        if len(f) < 2 or len(f) != len(v) or not all(map(math.isfinite, (*f, *v))):
            raise InputError("voltage_v, fraction: needed are two points or more, equally many")
        if any(b <= a for a, b in pairwise(f)):
            raise InputError("fraction: it must rise from point to point")

    def flow_kg_s(self, upstream_pa: float, downstream_pa: float, temperature_k: float) -> float:
        """Mass flow fully open, after ISO 6358-1.

        Args:
            upstream_pa: Pressure before it, Pa.
            downstream_pa: Pressure behind it, Pa.
            temperature_k: Temperature before it, K.
        """
        if downstream_pa >= upstream_pa:
            return 0.0
        b = self.critical_ratio
        excess = max((downstream_pa / upstream_pa - b) / (1.0 - b), 0.0)
        choked = self.conductance_m3_s_pa * ANR_DENSITY_KG_M3 * upstream_pa
        root = math.sqrt(ANR_TEMPERATURE_K / temperature_k)
        return choked * root * math.sqrt(1.0 - excess * excess)

    def volts(self, opening: float) -> float:
        """Voltage that opens the port so far; beyond the curve that of its end.

        Args:
            opening: Opening, 1 is fully open.
        """
        f, v = self.fraction, self.voltage_v
        right = bisect.bisect_right(f, opening)
        if right == 0:
            return v[0]
        if right == len(f):
            return v[-1]
        left = right - 1
        return v[left] + (v[right] - v[left]) * (opening - f[left]) / (f[right] - f[left])


@dataclass(frozen=True)
class FeedForward:
    """Voltage from null that follows a target's slope.

    Attributes:
        gain: Factor on the flow that the volume needs.
        lead_s: How far ahead the slope is taken, s.
        volume_m3: Volume behind the valve, m^3.
        temperature_k: Temperature of the gas, K.
        null_v: Voltage at which the valve closes, V.
        fill: The port that fills the volume.
        drain: The port that empties it.
    """

    gain: float
    lead_s: float
    volume_m3: float
    temperature_k: float
    null_v: float
    fill: Way
    drain: Way

    def __post_init__(self) -> None:
        """Raises InputError where the numbers make no feed-forward."""
        for name in ("volume_m3", "temperature_k"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name}: found {value}, it must be positive")
        for name in ("gain", "lead_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"{name}: found {value}, it must not be negative")
        if not math.isfinite(self.null_v):
            raise InputError(f"null_v: found {self.null_v}, it must be finite")

    @property
    def preview_s(self) -> tuple[float, float]:
        """Times ahead between which the slope is taken, s."""
        early = round(max(self.lead_s - HALF_WINDOW_S, 0.0), 6)
        return early, round(early + 2.0 * HALF_WINDOW_S, 6)

    def volts(self, early_pa: float, late_pa: float) -> float:
        """Voltage beyond null.

        Args:
            early_pa: Target at the first of the previewed times, Pa.
            late_pa: Target at the second, Pa.
        """
        slope = (late_pa - early_pa) / (2.0 * HALF_WINDOW_S)
        if slope == 0.0 or self.gain == 0.0:
            return 0.0
        pressure = 0.5 * (early_pa + late_pa)
        needed = self.gain * self.volume_m3 * abs(slope) / (AIR.r_specific * self.temperature_k)
        if slope > 0.0:
            way, flow = (
                self.fill,
                self.fill.flow_kg_s(self.fill.pressure_pa, pressure, self.temperature_k),
            )
        else:
            way, flow = (
                self.drain,
                self.drain.flow_kg_s(pressure, self.drain.pressure_pa, self.temperature_k),
            )
        # Where the reservoir cannot drive the flow at all, open is the best there is.
        opening = needed / flow if flow > needed else 1.0
        return way.volts(opening) - self.null_v

    def to_dict(self) -> dict[str, Any]:
        """Returns it as plain lists and numbers."""
        data = asdict(self)
        for way in ("fill", "drain"):
            for name in ("voltage_v", "fraction"):
                data[way][name] = list(data[way][name])
        return data

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "FeedForward":
        """Reads it back.

        Args:
            data: What `to_dict` gave.

        Raises:
            InputError: A field is unknown, missing or no number.
        """
        values: dict[str, Any] = _numbers(data, cls, ("fill", "drain"))
        for name in ("fill", "drain"):
            try:
                values[name] = Way(**_numbers(data[name], Way, ()))
            except InputError as error:
                raise InputError(f"{name}.{error}") from None
        return cls(**values)

    @classmethod
    def of_rig(cls, rig: Rig, tap: str, gain: float = 1.0, lead_s: float = 0.0) -> "FeedForward":
        """Takes valve and volume from a rig of one valve between two reservoirs.

        Args:
            rig: The rig.
            tap: Tap whose pressure is controlled.
            gain: Factor on the flow.
            lead_s: How far ahead the slope is taken, s.

        Raises:
            InputError: The rig has no such tap, or no valve that fills and drains the line.
        """
        if tap not in rig.taps:
            raise InputError(f"tap: found {tap!r}, rig {rig.name!r} has {', '.join(rig.taps)}")
        if len(rig.valves) != 1 or len(rig.reservoirs) < 2:
            raise InputError(
                f"rig {rig.name!r}: found {len(rig.valves)} valves and {len(rig.reservoirs)}"
                " reservoirs, feed-forward needs one valve between a supply and a sink"
            )
        (valve,) = rig.valves.values()
        levels = sorted(one.pressure_pa for one in rig.reservoirs.values())
        model = build(rig, plan_grid(rig))
        ways: dict[bool, Way] = {}
        for row, port in enumerate(valve.ports.values()):
            low, high = model.curve_v[row]
            table = model.curve[row]
            fills = bool(table[-1] > table[0])
            end = high if fills else low
            # Quadratic spacing, because the curve bends most near null.
            share = np.linspace(0.0, 1.0, POINTS) ** 2
            volts = valve.spool.null_v + (end - valve.spool.null_v) * share
            opening = np.interp(volts, np.linspace(low, high, table.size), table)
            keep = np.concatenate([[True], np.diff(np.maximum.accumulate(opening)) > 1e-9])
            ways[fills] = Way(
                pressure_pa=_short(levels[-1] if fills else levels[0]),
                conductance_m3_s_pa=_short(port.conductance_m3_s_pa),
                critical_ratio=_short(port.critical_ratio),
                voltage_v=tuple(map(_short, volts[keep])),
                fraction=tuple(map(_short, opening[keep])),
            )
        if len(ways) != 2:
            raise InputError(
                f"rig {rig.name!r}: its valve has no port that fills and one that drains"
            )
        return cls(
            gain,
            lead_s,
            _short(_volume_behind(rig, tap)),
            rig.ambient.temperature_k,
            valve.spool.null_v,
            ways[True],
            ways[False],
        )


def _short(value: float) -> float:
    """Six digits are more than a calibration finds, and read well in a file."""
    return float(f"{value:.6g}")


def _numbers(data: Any, kind: type, but: tuple[str, ...]) -> dict[str, Any]:
    """Fields of a dataclass from plain data, all of them numbers or lists of numbers."""
    if not isinstance(data, Mapping):
        raise InputError(f"found {data!r}, needed is a mapping")
    known = [one.name for one in fields(kind)]
    for name in data:
        if name not in known:
            raise InputError(f"{name}: unknown, known are {', '.join(known)}")
    values: dict[str, Any] = {}
    for name in known:
        if name not in data:
            raise InputError(f"{name}: missing")
        if name in but:
            continue
        value = data[name]
        listed = name in LISTS
        try:
            if isinstance(value, list | tuple) != listed:
                raise TypeError
            values[name] = tuple(map(float, value)) if listed else float(value)
        except (TypeError, ValueError):
            needed = "a list of numbers" if listed else "a number"
            raise InputError(f"{name}: found {value!r}, needed is {needed}") from None
    return values


def _volume_behind(rig: Rig, tap: str) -> float:
    """Volume of all pipes and chambers joined to a tap without a valve or reservoir between."""
    volume, _ = volumes_of(rig)
    own = volume_of_tap(volume, rig.taps[tap])
    total = sum(c.volume_m3 for name, c in rig.chambers.items() if volume[name] == own)
    for name, pipe in rig.pipes.items():
        if volume[f"pipe:{name}"] != own:
            continue
        area = pipe.area_m2
        if pipe.area_profile is not None:
            at, areas = zip(*pipe.area_profile, strict=True)
            area = float(np.trapezoid(areas, at)) / pipe.length_m
        extra = sum(one.volume_m3 for one in pipe.volumes)
        total += area * pipe.length_m + extra + pipe.volume_from_m3 + pipe.volume_to_m3
    return float(total)
