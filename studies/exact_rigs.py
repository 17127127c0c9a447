# SPDX-License-Identifier: Apache-2.0
"""Rigs drawn at random, and recordings of them: what an exact model has to explain to the noise."""

from typing import Any, Literal

import numpy as np

from pneu_sim.rig.schema import Rig
from pneu_sim.signals import Signal
from pneu_sim.simulator import Simulator
from pneu_sysid.records import Recording

SHAPES = ("line", "tee", "two_valves", "ring", "restrictor")
RATES: tuple[float | Literal["uneven"], ...] = (500.0, 125.0, 50.0, "uneven")
"""Taps at so many readings a second, or read one by one at uneven instants 20 to 50 ms apart."""
NOISE_PA = 300.0
COMMAND_HZ = 500.0
PLANT_S = 2e-4
"""The plant tells its taps so often; readings lie between."""
HISTORY_S = 0.3
"""Commands that a recording which begins in the middle holds from before its first reading."""


def draw_rig(shape: str, rng: np.random.Generator) -> Rig:
    """A rig of one of the shapes, its numbers drawn at random, supply from 2 to 10 bar.

    Args:
        shape: One of ``SHAPES``.
        rng: Source of the numbers.
    """
    between = rng.uniform

    def pipe(start: str, end: str, length_m: float, area_mm2: float) -> dict[str, Any]:
        return {
            "from": start,
            "to": end,
            "length_m": round(length_m, 3),
            "area_m2": 1e-6 * area_mm2,
        }

    def chamber(low_cm3: float, high_cm3: float) -> dict[str, float]:
        return {
            "volume_m3": 1e-6 * between(low_cm3, high_cm3),
            "heat_w_per_k": between(0.05, 0.25),
        }

    def valve(command: str, source: str, target: str, size: float) -> dict[str, Any]:
        curve = {
            "interpolation": "power",
            "voltage_v": [5.05, 5.2, 5.6, 7.5, 10.0],
            "fraction": [0.004, 0.03, 0.1, 0.4, 1.0],
        }
        fill = {
            "from": source,
            "to": target,
            "conductance_m3_s_pa": size,
            "critical_ratio": between(0.2, 0.4),
            "opening": curve,
        }
        drain = {
            "from": target,
            "to": "room",
            "conductance_m3_s_pa": size * between(0.8, 1.2),
            "critical_ratio": between(0.2, 0.4),
            "opening": {"mirror": "supply"},
        }
        spool = {"bandwidth_hz": between(40.0, 90.0), "damping": between(0.6, 1.0)}
        return {"command": command, "spool": spool, "ports": {"supply": fill, "exhaust": drain}}

    size = 1e-8 * between(0.5, 1.0)
    pipes = {"feed": pipe("supply", "valve_in", between(0.4, 1.5), between(12.0, 20.0))}
    valves = {"valve": valve("voltage", "valve_in", "valve_out", size)}
    commands: dict[str, Any] = {"voltage": {}}
    chambers: dict[str, Any] = {}
    orifices: dict[str, Any] = {}
    taps: dict[str, dict[str, Any]] = {
        "feed": {"pipe": "feed", "position_m": pipes["feed"]["length_m"] - 0.025}
    }
    if shape == "line":
        pipes["tube"] = pipe("valve_out", "closed", between(1.0, 5.0), between(5.0, 8.0))
        length = pipes["tube"]["length_m"]
        taps["valve_out"] = {"pipe": "tube", "position_m": 0.025}
        taps["middle"] = {"pipe": "tube", "position_m": 0.5 * length}
        taps["end"] = {"pipe": "tube", "position_m": length - 0.025}
    elif shape == "tee":
        pipes["stem"] = pipe("valve_out", "tee", between(0.3, 1.0), between(6.0, 10.0))
        pipes["branch_a"] = pipe("tee", "chamber_a", between(0.5, 2.0), between(4.0, 7.0))
        pipes["branch_b"] = pipe("tee", "chamber_b", between(0.3, 1.0), between(4.0, 7.0))
        chambers = {"chamber_a": chamber(15.0, 60.0), "chamber_b": chamber(10.0, 40.0)}
        taps["stem"] = {"pipe": "stem", "position_m": 0.03}
        taps["chamber_a"] = {"chamber": "chamber_a"}
        taps["chamber_b"] = {"chamber": "chamber_b"}
    elif shape == "two_valves":
        valves["right"] = valve("right", "right_in", "right_out", size * between(0.5, 1.2))
        commands["right"] = {}
        pipes["right_feed"] = pipe("supply", "right_in", between(0.4, 1.0), between(12.0, 20.0))
        pipes["left_tube"] = pipe("valve_out", "chamber", between(0.4, 1.5), between(5.0, 9.0))
        pipes["right_tube"] = pipe("right_out", "chamber", between(0.3, 1.0), between(5.0, 9.0))
        chambers = {"chamber": chamber(20.0, 80.0)}
        taps["left"] = {"pipe": "left_tube", "position_m": 0.03}
        taps["right"] = {"pipe": "right_tube", "position_m": 0.03}
        taps["chamber"] = {"chamber": "chamber"}
    elif shape == "ring":
        pipes["stem"] = pipe("valve_out", "near", between(0.3, 0.8), between(6.0, 10.0))
        pipes["one_way"] = pipe("near", "far", between(0.5, 1.5), between(4.0, 7.0))
        pipes["other_way"] = pipe("near", "far", between(0.5, 2.5), between(4.0, 7.0))
        pipes["tail"] = pipe("far", "closed", between(0.3, 1.0), between(4.0, 7.0))
        taps["stem"] = {"pipe": "stem", "position_m": 0.03}
        taps["ring"] = {"pipe": "other_way", "position_m": 0.25}
        taps["tail"] = {"pipe": "tail", "position_m": 0.2}
    elif shape == "restrictor":
        pipes["tube"] = pipe("valve_out", "before", between(0.5, 2.0), between(5.0, 9.0))
        pipes["behind"] = pipe("after", "chamber", between(0.1, 0.5), between(5.0, 9.0))
        orifices["restrictor"] = {
            "from": "before",
            "to": "after",
            "conductance_m3_s_pa": size * between(0.05, 0.3),
            "critical_ratio": between(0.2, 0.4),
        }
        chambers = {"chamber": chamber(10.0, 60.0)}
        taps["tube"] = {"pipe": "tube", "position_m": 0.1}
        taps["chamber"] = {"chamber": "chamber"}
    else:
        raise ValueError(f"shape: found {shape!r}, known are {', '.join(SHAPES)}")
    for tap in taps.values():
        tap["noise_pa"] = NOISE_PA
    reservoirs = {
        "supply": {"pressure_pa": between(2e5, 10e5)},
        "room": {"pressure_pa": 101325.0},
    }
    return Rig.model_validate(
        {
            "pneu_rig": 1,
            "name": shape,
            "reservoirs": reservoirs,
            "pipes": pipes,
            "chambers": chambers,
            "orifices": orifices,
            "valves": valves,
            "commands": commands,
            "taps": taps,
        }
    )


def draw_command(samples: int, rng: np.random.Generator) -> np.ndarray:
    """Volts of steps that are held, full openings, and sines about null.

    Args:
        samples: How many, at ``COMMAND_HZ``.
        rng: Source of the numbers.
    """
    volts = np.empty(samples)
    at, kind = 0, 0
    while at < samples:
        count = int(rng.integers(150, 400)) if kind % 3 == 0 else int(rng.integers(10, 120))
        part = slice(at, at + count)
        if kind % 3 == 0:
            time = np.arange(volts[part].size) / COMMAND_HZ
            wave = np.sin(2.0 * np.pi * rng.uniform(0.5, 5.0) * time + rng.uniform(0.0, 6.0))
            volts[part] = 5.0 + rng.uniform(-1.0, 1.0) * wave + rng.uniform(-0.3, 0.3)
        else:
            volts[part] = rng.choice([0.0, 10.0, 5.0, rng.uniform(3.0, 7.0)])
        at, kind = at + count, kind + 1
    return volts


def record(
    rig: Rig,
    rng: np.random.Generator,
    rate: float | Literal["uneven"],
    seconds: float,
    moving: bool,
    name: str = "drawn",
) -> Recording:
    """A recording of a rig that is driven at random; each tap is read at times of its own.

    Args:
        rig: The rig.
        rng: Source of commands, instants and noise.
        rate: One of ``RATES``.
        seconds: How long the rig is driven, s.
        moving: Whether the recording begins in the middle instead of at rest.
        name: Its name.
    """
    samples = round(seconds * COMMAND_HZ)
    volts = {command: draw_command(samples, rng) for command in rig.commands}
    fine = round(1.0 / (COMMAND_HZ * PLANT_S))
    out = Simulator(rig).run(
        seconds, {command: np.repeat(v, fine) for command, v in volts.items()}, PLANT_S
    )
    begin = float(rng.uniform(1.0, 1.5)) if moving else 0.0
    pressures = {}
    for tap, series in out.taps.items():
        if rate == "uneven":
            steps = rng.uniform(0.02, 0.05, int(seconds / 0.02))
            at = begin + rng.uniform(0.0, 0.03) + np.cumsum(steps)
        else:
            at = begin + rng.uniform(0.0, 1.0 / rate) + np.arange(round(seconds * rate)) / rate
        at = at[at < seconds]
        noise = rng.normal(size=at.size) * rig.taps[tap].noise_pa
        pressures[tap] = Signal(at - begin, np.interp(at, out.time_s, series) + noise)
    at = np.arange(samples) / COMMAND_HZ - begin
    kept = at >= -HISTORY_S
    commands = {command: Signal(at[kept], v[kept]) for command, v in volts.items()}
    return Recording(name, commands, pressures)
