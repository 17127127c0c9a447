# SPDX-License-Identifier: Apache-2.0
"""Rigs drawn at random as a laboratory has them: what they are, and what their datasheets say.

The plant is the simulator on a finer grid with another flux, limiter and wall, its valves with
curves, delays and limits that no datasheet tells. The datasheet is off by 10 to 40 % in what
valves, chambers and walls are, by less in volumes and bores, and has the maker's catalogue curve.
Lines follow random commands; a joint (`studies.joint_rigs`) is steered too (`studies.joint_runs`).
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from pneu_sim.rig.schema import Rig
from pneu_sim.signals import Signal
from pneu_sim.simulator import Simulator
from pneu_sysid.records import Recording
from studies.exact_rigs import COMMAND_HZ, draw_rig
from studies.joint_rigs import LONGEST_M, draw_joint, known_of_joint
from studies.joint_runs import PLANT_S, Excitation, Run, draw_excitation, run_joint

SHAPES = ("line", "tee", "two_valves", "restrictor", "vessel", "joint")
PLANT_DX_M = 0.02
JOINT_DX_M = 0.025
"""Of a joint, whose flux is exact besides."""
CATALOGUE_V = [5.1, 5.2, 5.35, 5.5, 5.75, 6.0, 6.5, 7.5, 10.0]
CATALOGUE = [0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5, 1.0]
"""Opening curve that every datasheet has: proportional to the voltage."""
LENGTHS_M = (0.3, 8.0)
RATES_HZ = (125.0, 250.0, 500.0)
NOISE_PA = (150.0, 300.0)


@dataclass(frozen=True)
class Case:
    """A rig of a laboratory.

    Attributes:
        name: Its name.
        truth: What it is, as far as a rig file can say it, on the plant's own grid.
        datasheet: What is known of it.
        recordings: Two where they are wanted: to calibrate on, and to be kept aside.
        rate_hz: Readings of each tap per second.
        noise_pa: Standard deviation of their noise.
    """

    name: str
    truth: Rig
    datasheet: Rig
    recordings: list[Recording]
    rate_hz: float
    noise_pa: float


def draw_case(shape: str, seed: int, seconds: float = 14.0, count: int = 2) -> Case:
    """A rig, its datasheet and its recordings.

    Args:
        shape: One of ``SHAPES``.
        seed: Seed of all that is drawn.
        seconds: Length of each recording, s.
        count: How many recordings are made.
    """
    rng = np.random.default_rng([seed, SHAPES.index(shape)])
    truth = _truth(shape, rng)
    datasheet = _datasheet(truth, rng)
    rate = float(rng.choice(RATES_HZ))
    if truth.bodies:  # what steers a joint reads its sensors, and is what records them
        rate = COMMAND_HZ
    noise = float(rng.uniform(*NOISE_PA))
    plant = truth.model_copy(deep=True)
    plant.grid = plant.grid.model_copy(
        update={"dx_m": PLANT_DX_M, "limiter": "minmod", "wave_speed_m_s": 800.0}
        | ({"dx_m": JOINT_DX_M, "flux": "exact"} if plant.bodies else {})
    )
    recordings = [
        record(plant, rng, rate, noise, seconds, f"{shape}_{seed}_{k + 1}") for k in range(count)
    ]
    return Case(f"{shape}_{seed}", plant, datasheet, recordings, rate, noise)


def _curve(rng: np.random.Generator) -> list[float]:
    """Opening of a real valve at distances of 0.02 to 1 of the stroke."""
    exponent, bend = rng.uniform(1.0, 1.45), rng.uniform(-0.25, 0.35)
    s = np.array([0.004, 0.01, *((np.array(CATALOGUE_V) - 5.0) / 5.0)])
    f = s**exponent * (1.0 + bend * (1.0 - s))
    return [float(v) for v in f / f[-1]]


def _truth(shape: str, rng: np.random.Generator) -> Rig:
    joint = shape == "joint"
    drawn = draw_joint(rng) if joint else draw_rig("line" if shape == "vessel" else shape, rng)
    data: dict[str, Any] = drawn.dump()
    data["name"] = shape
    longest = max(p["length_m"] for n, p in data["pipes"].items() if "feed" not in n)
    wanted = math.exp(rng.uniform(math.log(0.4), math.log(LONGEST_M if joint else LENGTHS_M[1])))
    wall = {
        "roughness_m": 2e-6,
        "heat_unsteady": 0.0,
        "heat_turbulent": float(rng.uniform(0.8, 1.25)),
        "turbulent_fade": float(rng.uniform(0.0, 1.0)),
    }
    for name, pipe in data["pipes"].items():
        factor = 1.0 if "feed" in name else wanted / longest
        length = round(float(np.clip(pipe["length_m"] * factor, *LENGTHS_M)), 3)
        for tap in data["taps"].values():
            if tap.get("pipe") == name:
                inside = tap["position_m"] / pipe["length_m"]
                tap["position_m"] = round(min(max(inside * length, 0.02), length - 0.02), 3)
        pipe["length_m"] = length
        pipe["wall"] = {**wall, "nusselt": float(rng.uniform(3.3, 6.0))}
    if shape == "vessel":
        data["pipes"]["tube"]["to"] = "vessel"
        data["chambers"] = {
            "vessel": {
                "volume_m3": float(rng.uniform(20e-6, 80e-6)),
                "heat_w_per_k": float(rng.uniform(0.08, 0.25)),
            }
        }
        data["taps"]["vessel"] = {**data["taps"].pop("end"), "pipe": None, "chamber": "vessel"}
        del data["taps"]["vessel"]["position_m"], data["taps"]["vessel"]["pipe"]
    for valve in data["valves"].values():
        volts = [5.02, 5.05, *CATALOGUE_V]
        valve["spool"] = {
            "bandwidth_hz": float(rng.uniform(35.0, 110.0)),
            "damping": float(rng.uniform(0.6, 1.0)),
            "delay_s": float(rng.uniform(0.0, 2e-3)),
        }
        if rng.random() < 0.5:
            valve["spool"]["max_speed_v_s"] = float(rng.uniform(250.0, 900.0))
        if rng.random() < 0.5:
            reach = (2.0 * math.pi * valve["spool"]["bandwidth_hz"]) ** 2 * 5.0
            valve["spool"]["max_acceleration_v_s2"] = float(reach * rng.uniform(0.15, 0.8))
        if rng.random() < 0.5:
            valve["spool"]["closing_delay_s"] = float(rng.uniform(0.0, 4e-3))
        for name, port in valve["ports"].items():
            port["jet_loss"] = port["inlet_head"] = 2.0
            if name == "supply":
                curve = {"voltage_v": volts, "fraction": _curve(rng)}
            else:
                mirrored = [10.0 - v for v in reversed(volts)]
                curve = {"voltage_v": mirrored, "fraction": list(reversed(_curve(rng)))}
            port["opening"] = {"interpolation": "power", **curve}
    return Rig.model_validate(data)


def _off(rng: np.random.Generator, low: float = 0.1, high: float = 0.4) -> float:
    """A factor that is off by 10 to 40 % either way."""
    by = 1.0 + rng.uniform(low, high)
    return float(by if rng.random() < 0.5 else 1.0 / by)


def _datasheet(truth: Rig, rng: np.random.Generator) -> Rig:
    data = truth.dump()
    for pipe in data["pipes"].values():
        del pipe["wall"]
        pipe["area_m2"] *= _off(rng, 0.0, 0.03)
    for chamber in data.get("chambers", {}).values():
        chamber["heat_w_per_k"] *= _off(rng)
        chamber["volume_m3"] *= _off(rng, 0.0, 0.05)
    for orifice in data.get("orifices", {}).values():
        orifice["conductance_m3_s_pa"] *= _off(rng)
        orifice["critical_ratio"] = 0.3
    for valve in data["valves"].values():
        spool = valve["spool"]
        valve["spool"] = {"bandwidth_hz": spool["bandwidth_hz"] * _off(rng), "damping": 0.8}
        for name, port in valve["ports"].items():
            port["conductance_m3_s_pa"] *= _off(rng)
            port["critical_ratio"] = 0.3
            port["opening"] = {"mirror": "supply"}
            if name == "supply":
                port["opening"] = {
                    "interpolation": "power",
                    "voltage_v": CATALOGUE_V,
                    "fraction": CATALOGUE,
                }
    for tap in data["taps"].values():
        tap.pop("noise_pa", None)
    if truth.bodies:
        known_of_joint(data, rng)
    data["fit"] = {"warm_up_s": 0.4}
    return Rig.model_validate(data)


def draw_volts(samples: int, rng: np.random.Generator) -> np.ndarray:
    """Volts: steps held for 20 to 400 ms, full openings, rests, and sines about null.

    Args:
        samples: How many, at ``COMMAND_HZ``.
        rng: Source of all that is drawn.
    """
    volts = np.full(samples, 5.0)
    at = int(rng.integers(100, 200))  # a rest, as every recording begins with
    kind = 0
    while at < samples:
        kind = int(rng.integers(4))
        if kind == 0:
            part = slice(at, at + int(rng.integers(300, 900)))
            time = np.arange(volts[part].size) / COMMAND_HZ
            height = math.exp(rng.uniform(math.log(0.3), math.log(5.0)))
            rate = math.exp(rng.uniform(math.log(0.7), math.log(8.0)))
            wave = np.sin(2.0 * np.pi * rate * time + rng.uniform(0.0, 6.0))
            volts[part] = np.clip(5.0 + height * wave + rng.uniform(-0.3, 0.3), 0.0, 10.0)
        elif kind == 1:
            part = slice(at, at + int(rng.integers(10, 120)))
            volts[part] = rng.choice([0.0, 10.0])
        elif kind == 2:
            part = slice(at, at + int(rng.integers(50, 250)))
            volts[part] = 5.0
        else:
            part = slice(at, at + int(rng.integers(20, 200)))
            reach = math.exp(rng.uniform(math.log(0.1), math.log(5.0)))
            volts[part] = 5.0 + float(rng.choice([-1.0, 1.0])) * reach
        at = part.stop
    return volts


def record(
    plant: Rig, rng: np.random.Generator, rate: float, noise: float, seconds: float, name: str
) -> Recording:
    """A recording of a plant along a random command.

    Args:
        plant: The plant.
        rng: Source of the command, of the noise and of when the taps are read.
        rate: Readings of each tap per second, Hz.
        noise: Standard deviation of the noise, Pa.
        seconds: Length, s.
        name: Name of the recording.
    """
    asked = draw_asked(plant, seconds, rng)
    return sampled(plant, run_plant(plant, asked, noise), rng, rate, noise, name)


def draw_asked(
    plant: Rig, seconds: float, rng: np.random.Generator
) -> dict[str, np.ndarray] | Excitation:
    """What is asked of a plant: volts by command at ``COMMAND_HZ``, or what a joint is to do.

    Args:
        plant: The plant.
        seconds: How long, s.
        rng: Source of all that is drawn.
    """
    samples = round(seconds * COMMAND_HZ)
    if plant.bodies:
        return draw_excitation(plant, samples, rng)
    return {command: draw_volts(samples, rng) for command in plant.commands}


def run_plant(
    plant: Rig,
    asked: dict[str, np.ndarray] | Excitation,
    noise: float = 0.0,
    beside: Rig | None = None,
) -> Run:
    """What the sensors of a plant would read without noise, every ``PLANT_S``.

    Args:
        plant: The plant.
        asked: What is asked of it.
        noise: What the controller of a joint reads has this noise, Pa.
        beside: A joint beside it; see `studies.joint_runs.run_joint`.
    """
    if isinstance(asked, Excitation):
        return run_joint(plant, asked, noise, beside)
    fine = round(1.0 / (COMMAND_HZ * PLANT_S))
    samples = len(next(iter(asked.values())))
    along = {command: np.repeat(v, fine) for command, v in asked.items()}
    out = Simulator(plant).run(samples / COMMAND_HZ, along, PLANT_S)
    return Run(asked, out.time_s, {**out.taps, **out.encoders}, {})


def sampled(
    plant: Rig, run: Run, rng: np.random.Generator, rate: float, noise: float, name: str
) -> Recording:
    """The recording of a run, with noise and quantisation.

    Args:
        plant: The plant, whose encoders have noise and steps of their own.
        run: The run.
        rng: Source of the noise and of when the sensors are read.
        rate: Readings of each sensor per second, Hz.
        noise: Standard deviation of the noise of taps, Pa.
        name: Name of the recording.
    """
    times = np.arange(len(next(iter(run.volts.values())))) / COMMAND_HZ
    seconds = times.size / COMMAND_HZ
    pressures, encoders = {}, {}
    phase = float(rng.uniform(0.0, 1.0 / rate))
    at = phase + np.arange(round(seconds * rate) - 1) / rate
    for sensor, series in run.readings.items():
        values = np.interp(at, run.time_s, series)
        if sensor in plant.encoders:
            own = plant.encoders[sensor]
            values = values + own.noise * rng.normal(size=at.size)
            encoders[sensor] = Signal(at, np.round(values / own.quantum) * own.quantum)
        else:
            values = values + noise * rng.normal(size=at.size)
            pressures[sensor] = Signal(at, np.round(values / 30.0) * 30.0)
    volts = {c: Signal(times, v) for c, v in run.volts.items()}
    return Recording(name, volts, pressures, encoders=encoders)


def noises(plant: Rig, noise: float) -> dict[str, float]:
    """Standard deviation of the noise of each sensor, Pa or rad, steps of encoders included.

    Args:
        plant: The plant.
        noise: That of taps, Pa.
    """
    own = {n: math.hypot(e.noise, e.quantum / math.sqrt(12.0)) for n, e in plant.encoders.items()}
    return dict.fromkeys(plant.taps, noise) | own
