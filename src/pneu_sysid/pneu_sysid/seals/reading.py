# SPDX-License-Identifier: Apache-2.0
"""Drag tests as they were recorded: force, position and pressure at common times, units doubted."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.rig.cylinder import Cylinder
from pneu_sim.rig.schema import Rig
from pneu_sim.signals import Signal
from pneu_sysid.records import Finding, noise_floor, read_recording
from pneu_sysid.records.stream import LONGEST_STEP

Floats = NDArray[np.float64]

LEAST_PRESSURE_PA = 1e4
"""A median absolute pressure below this is one in bar or without the room's."""
MOST_PRESSURE_PA = 1e8
"""... and one above this is none that a cylinder holds."""
LEAST_SHARE = 0.003
"""A force that never reaches this share of the gas's push is one in kilonewtons."""
MOST_TIMES = 100.0
"""... and one of so many times that push is no force in newtons."""
LEAST_WAY = 0.01
"""A piston that moves over less than this share of its stroke does not move."""
MOST_WAY = 1.5
"""One that moves over more than so many strokes is in another unit."""


@dataclass(frozen=True)
class DragTest:
    """One recording of a cylinder that a machine drags.

    Attributes:
        name: Name of the recording.
        time_s: (n,) times, s.
        extension_m: (n,) extension of the piston, m.
        force_n: (n,) force with which the machine presses the rod in, N.
        load_n: (n,) force of the gas and the cylinder's own spring that presses it out, N.
        gauge_pa: (n,) gauge pressure of the measured side, Pa.
        mean_gauge_pa: (n,) mean gauge pressure of both sides, not below 0, Pa.
        noise_n: White noise of force and load together, one sigma, N.
        findings: What was found while it was read.
    """

    name: str
    time_s: Floats
    extension_m: Floats
    force_n: Floats
    load_n: Floats
    gauge_pa: Floats
    mean_gauge_pa: Floats
    noise_n: float
    findings: list[str]

    @property
    def rest_n(self) -> Floats:
        """(n,) what the force is beyond gas and spring, N: the model without friction's error."""
        return self.force_n - self.load_n


def read_drag(rig: Rig, path: str | Path) -> DragTest:
    """Reads a drag test as a rig file describes it.

    Args:
        rig: The rig; its section ``drag`` says where the signals are.
        path: Bag or text file.

    Returns:
        The test, at the times of the force.

    Raises:
        InputError: The rig has no such section, the recording cannot be read, nothing moves, or a
            signal is in another unit than the rig file says.
    """
    drag = rig.drag
    if drag is None:
        raise InputError(
            f"rig {rig.name!r}: drag: found none, needed are the cylinder that is dragged and the"
            " channels of force, position and pressure (docs/rig.md#drag)"
        )
    channels = {"pressure": drag.pressure, "force": drag.force, "position": drag.position}
    if drag.other_pressure is not None:
        channels["other_pressure"] = drag.other_pressure
    recording = read_recording(
        path, commands={}, pressures=channels, text=rig.text, rate_hz=rig.rate_hz
    )
    findings = _merged(recording.report)
    signals = recording.pressures
    time = _common(signals)
    if time.size < 20:
        raise InputError(
            f"{path}: force, position and pressure have {time.size} readings at common times, at"
            " least 20 are needed"
        )
    at = {name: np.interp(time, s.time_s, s.values) for name, s in signals.items()}
    room = rig.ambient.pressure_pa
    gauge = at["pressure"] - room
    other = at["other_pressure"] - room if "other_pressure" in at else np.zeros(time.size)
    cylinder = rig.cylinders[drag.cylinder]
    position = at["position"]
    _check(path, cylinder, at, time)
    head, rod = (gauge, other) if drag.side == "head" else (other, gauge)
    areas = cylinder.areas
    spring = cylinder.spring_preload_n + cylinder.spring_n_m * position
    load = areas[0] * head - areas[1] * rod - spring
    force = at["force"]
    push, pressed = float(np.median(load)), float(np.median(force))
    if abs(push) > 1.0:
        if float(np.max(np.abs(force))) < LEAST_SHARE * abs(push):
            raise InputError(
                f"{path}: force reads {np.max(np.abs(force)):.3g} N at most where the gas presses"
                f" with {abs(push):.3g} N; drag.force needs the scale to newtons (1000 for kN)"
            )
        if abs(pressed) > MOST_TIMES * abs(push):
            raise InputError(
                f"{path}: force reads {pressed:.3g} N where the gas presses with {push:.3g} N;"
                " drag.force needs the scale to newtons"
            )
        if pressed / push < -0.5:
            force = -force
            findings.append("force: turned: it was read negative where the gas presses the rod out")
    noise = np.hypot(
        _sigma(signals["force"]),
        areas[0 if drag.side == "head" else 1] * _sigma(signals["pressure"]),
    )
    return DragTest(
        name=recording.name,
        time_s=time,
        extension_m=position,
        force_n=force,
        load_n=load,
        gauge_pa=gauge,
        mean_gauge_pa=np.maximum(0.5 * (gauge + other), 0.0),
        noise_n=float(noise),
        findings=findings,
    )


def _merged(report: Sequence[Finding]) -> list[str]:
    """Findings in lines; what all channels of a file have in common is told once."""
    channels: dict[tuple[str, int, str], list[str]] = {}
    for f in report:
        if f.kind == "suspicious_unit" and f.channel in ("force", "position"):
            continue  # they are no pressures
        channels.setdefault((f.kind, f.count, f.action), []).append(f.channel)
    return [str(Finding(", ".join(names), *key)) for key, names in channels.items()]


def _sigma(signal: Signal) -> float:
    sigma = noise_floor(signal.time_s, signal.values).sigma_pa
    return sigma if np.isfinite(sigma) else 0.0


def _common(signals: dict[str, Signal]) -> Floats:
    """Times of the force at which every other signal was read shortly before and after."""
    time = signals["force"].time_s
    near = np.ones(time.size, dtype=bool)
    for signal in signals.values():
        t = signal.time_s
        after = np.clip(np.searchsorted(t, time), 1, t.size - 1)
        inside = (time >= t[0]) & (time <= t[-1])
        exact = (time == t[after]) | (time == t[after - 1])
        near &= inside & (exact | (t[after] - t[after - 1] <= LONGEST_STEP * np.median(np.diff(t))))
    return time[near]


def _check(path: str | Path, cylinder: Cylinder, at: dict[str, Floats], time: Floats) -> None:
    """Raises InputError where a signal is not what the rig file says, or nothing moves."""
    for name in ("pressure", "other_pressure"):
        if name in at and float(np.median(at[name])) < LEAST_PRESSURE_PA:
            raise InputError(
                f"{path}: {name} is {np.median(at[name]):.4g} Pa at its median, absolute pascals"
                f" are needed; drag.{name} needs a scale (1e5 for bar) and, of a gauge, the room's"
                " pressure as its offset"
            )
        if name in at and float(np.median(at[name])) > MOST_PRESSURE_PA:
            raise InputError(
                f"{path}: {name} is {np.median(at[name]):.4g} Pa at its median, allowed is up to"
                f" {MOST_PRESSURE_PA:g}; drag.{name} has another scale than the file's unit"
            )
    low, high = np.quantile(at["position"], [0.01, 0.99])
    way = float(high - low)
    if way > MOST_WAY * cylinder.stroke:
        raise InputError(
            f"{path}: position moves over {way:.4g} m, the cylinder's stroke_m is"
            f" {cylinder.stroke:g}; drag.position needs the scale to metres (1e-3 for mm)"
        )
    if way < LEAST_WAY * cylinder.stroke:
        raise InputError(
            f"{path}: position moves over {way:.3g} m in {time[-1] - time[0]:.3g} s, less than"
            f" {100.0 * LEAST_WAY:g} % of the stroke of {cylinder.stroke:g} m: nothing was dragged,"
            " or drag.position needs the scale to metres"
        )
