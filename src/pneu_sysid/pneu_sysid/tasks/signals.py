# SPDX-License-Identifier: Apache-2.0
"""Every reading of recordings beside what a model predicts, whole, as one file to look at."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_common.files import whole
from pneu_sim.rig.schema import Rig
from pneu_sysid.records import begins_of
from pneu_sysid.sensor_units import encoder_units, unit_of

if TYPE_CHECKING:  # whoever looks at signals loads no solver
    from pneu_sysid.problem import Problem

Floats = NDArray[np.float64]

SIGNALS = "signals.npz"
"""Its name in the folder of a model."""


@dataclass(frozen=True)
class Trace:
    """Readings of one sensor.

    Attributes:
        time_s: (n,) when each was taken, rising; recordings follow one another.
        measured: (n,) what was read, in the sensor's SI unit.
        model: (n,) what the model predicts; NaN where it does not.
        changes: By candidate (n,) what it would change of that.
    """

    time_s: Floats
    measured: Floats
    model: Floats
    changes: dict[str, Floats] = field(default_factory=dict)


@dataclass(frozen=True)
class About:
    """What goes with them.

    Attributes:
        units: Unit of each sensor, as it is shown.
        noise: Noise floor of each, SI.
        begins_s: When each recording begins, by its name, s.
        segments: Begin, end and whether it is kept aside, of each stretch, s.
        marks: Begin and end, s, of what was found while the recordings were read, the channel, and
            what it is.
    """

    units: dict[str, str]
    noise: dict[str, float]
    begins_s: dict[str, float]
    segments: list[tuple[float, float, bool]]
    marks: list[tuple[float, float, str, str]] = field(default_factory=list)


@dataclass(frozen=True)
class Signals:
    """All of it.

    Attributes:
        sensors: By name.
        commands: By name (2, n): when it changed, s, and volts from then on.
        about: What goes with them.
    """

    sensors: dict[str, Trace]
    commands: dict[str, Floats]
    about: About


def signals_of(
    problem: Problem, rig: Rig, readings: Floats, changes: Mapping[str, Floats] | None = None
) -> Signals:
    """Puts readings and predictions together.

    Args:
        problem: The recordings.
        rig: The rig.
        readings: (n_stretches, horizon, n_sensors) what it predicts.
        changes: By candidate the same of what it changes.
    """
    begins = np.array(begins_of(problem.recordings))
    since = begins[problem.of][:, None]
    units = encoder_units(rig)
    sensors = {}
    for k, name in enumerate(problem.taps):
        measured = problem.measured[:, :, k]
        there, order, time = readings_in_order(problem, k)
        told = {
            label: of[:, :, k][there][order].astype(float) for label, of in (changes or {}).items()
        }
        sensors[name] = Trace(time, measured[there][order], readings[:, :, k][there][order], told)
    commands = {}
    for name in problem.recordings[0].commands:
        parts = [
            np.stack([c.commands[name].time_s + begin, c.commands[name].values])
            for c, begin in zip(problem.recordings, begins, strict=True)
            if name in c.commands
        ]
        commands[name] = np.concatenate(parts, axis=1)
    edges = problem.span_s + since
    about = About(
        units={name: unit_of(name, units).si for name in problem.taps},
        noise=dict(zip(problem.taps, problem.noise_pa.tolist(), strict=True)),
        begins_s={r.name: float(b) for r, b in zip(problem.recordings, begins, strict=True)},
        segments=[
            (float(a), float(b), bool(held))
            for (a, b), held in zip(edges, problem.held_out, strict=True)
        ],
        marks=[
            (float(begin + a), float(begin + b), finding.channel, finding.kind.replace("_", " "))
            for recording, begin in zip(problem.recordings, begins, strict=True)
            for a, b, finding in recording.marks()
        ],
    )
    return Signals(sensors, commands, about)


def readings_in_order(
    problem: Problem, sensor: int
) -> tuple[NDArray[np.bool_], NDArray[np.int64], Floats]:
    """Where the readings of a sensor are in a problem, and how they follow one another.

    Args:
        problem: The problem.
        sensor: Number of the sensor.

    Returns:
        (n_stretches, horizon) whether there is one; (n,) what puts those that are in order; (n,)
        their times in that order, s, recordings one after the other.
    """
    there = np.isfinite(problem.measured[:, :, sensor])
    since = np.array(begins_of(problem.recordings))[problem.of][:, None]
    time = (problem.time_s[:, :, sensor] + since)[there]
    order = np.argsort(time, kind="stable")
    return there, order, time[order]


def save_signals(signals: Signals, path: Path) -> None:
    """Writes them, whole or not at all.

    Args:
        signals: They.
        path: NumPy archive.
    """
    arrays: dict[str, Any] = {"about": np.array(json.dumps(asdict(signals.about)))}
    arrays["sensors"], arrays["commands"] = (
        np.array(list(of), dtype=str) for of in (signals.sensors, signals.commands)
    )
    for k, trace in enumerate(signals.sensors.values()):
        arrays |= {f"time_{k}": trace.time_s, f"measured_{k}": trace.measured}
        arrays[f"model_{k}"] = trace.model
        for c, change in enumerate(trace.changes.values()):
            arrays[f"change_{k}_{c}"] = change.astype(np.float32)
    first = next(iter(signals.sensors.values()), None)
    arrays["candidates"] = np.array(list(first.changes) if first else [], dtype=str)
    for k, command in enumerate(signals.commands.values()):
        arrays[f"command_{k}"] = command
    with whole(path) as aside, aside.open("wb") as file:
        np.savez(file, **arrays)


def load_signals(path: Path) -> Signals:
    """Reads them again.

    Args:
        path: NumPy archive that `save_signals` wrote.

    Raises:
        InputError: It cannot be read, or is another's.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            about = json.loads(str(file["about"]))
            labels = [str(name) for name in file["candidates"]]
            sensors = {
                str(name): Trace(
                    file[f"time_{k}"],
                    file[f"measured_{k}"],
                    file[f"model_{k}"],
                    {c: file[f"change_{k}_{n}"].astype(float) for n, c in enumerate(labels)},
                )
                for k, name in enumerate(file["sensors"])
            }
            commands = {str(n): file[f"command_{k}"] for k, n in enumerate(file["commands"])}
    except (OSError, KeyError, ValueError) as error:
        raise InputError(f"{path}: holds no signals ({error})") from None
    for name in ("segments", "marks"):
        about[name] = [tuple(entry) for entry in about.get(name, [])]
    return Signals(sensors, commands, About(**about))
