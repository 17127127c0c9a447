# SPDX-License-Identifier: Apache-2.0
"""A pneumatic joint drawn at random (thesis 9.2): two valves, tubes, cylinder, slider-crank, link.

What it is, and what its user knows of it: catalogue sizes, lengths by the ruler, masses about.
"""

import math
from typing import Any

import numpy as np

from pneu_sim.rig.schema import Rig

LONGEST_M = 4.0
"""Length of its tubes at most; longer ones are too slow to steer by."""


def draw_joint(rng: np.random.Generator) -> Rig:
    """A joint, its valves and walls as simple as a datasheet has them.

    Args:
        rng: Source of the numbers.
    """
    between = rng.uniform
    size = 1e-8 * between(0.5, 0.8)
    valves, pipes, taps = {}, {}, {}
    for side in ("head", "rod"):
        length = round(between(1.0, 2.5), 3)
        pipes[f"{side}_tube"] = {
            "from": f"{side}_valve",
            "to": side,
            "length_m": length,
            "area_m2": 1e-6 * between(5.0, 8.0),
        }
        taps[f"{side}_valve"] = {"pipe": f"{side}_tube", "position_m": 0.06}
        taps[f"{side}_port"] = {"pipe": f"{side}_tube", "position_m": length - 0.06}
        port = {"critical_ratio": between(0.2, 0.4), "opening": {"mirror": "supply"}}
        valves[side] = {
            "command": side,
            "spool": {"bandwidth_hz": 60.0},
            "ports": {
                "supply": {
                    **port,
                    "from": "supply",
                    "to": f"{side}_valve",
                    "conductance_m3_s_pa": size,
                    "opening": {"voltage_v": [5.0, 10.0], "fraction": [0.0, 1.0]},
                },
                "exhaust": {
                    **port,
                    "from": f"{side}_valve",
                    "to": "room",
                    "conductance_m3_s_pa": size * between(0.9, 1.25),
                },
            },
        }
    bore = float(rng.choice([0.020, 0.025, 0.032]))
    area = (bore / 0.025) ** 2
    theta = {
        "name": "elbow",
        "lower": -between(0.7, 0.95),
        "upper": between(0.7, 0.95),
        "start": between(-0.5, 0.5),
        "viscous": between(0.005, 0.04),
        "dry_friction": between(0.0, 0.1),
        "stop_stiffness": _log(rng, 1e3, 4e3),
        "stop_damping": between(1.0, 4.0),
        "stop_hold": between(0.0, 1.0),
    }
    pivot, crank = between(0.14, 0.20), between(0.03, 0.045)
    closed, stroke = _fitted(pivot, crank, theta, between(2e-3, 4e-3))
    mass, centre = between(0.45, 0.9), between(0.13, 0.20)
    data: dict[str, Any] = {
        "pneu_rig": 1,
        "name": "joint",
        "ambient": {"pressure_pa": between(97e3, 103e3), "temperature_k": 293.15},
        "reservoirs": {"supply": {"pressure_pa": between(5.5e5, 7.5e5)}, "room": {}},
        "pipes": pipes,
        "valves": valves,
        "commands": {"head": {}, "rod": {}},
        "taps": taps,
        "cylinders": {
            "forearm": {
                "bore_m": bore,
                "rod_m": 0.4 * bore,
                "stroke_m": stroke,
                "head": _side("head", rng),
                "rod": _side("rod", rng),
                "heat_w_m2_k": between(10.0, 60.0),
                "friction": {
                    "coulomb_n": between(3.0, 8.0) * area,
                    "breakaway_n": between(1.0, 6.0) * area,
                    "viscous_n_s_m": between(10.0, 40.0) * area,
                    "stribeck_m_s": _log(rng, 4e-3, 3e-2),
                    "presliding_m_n": _log(rng, 5e-6, 3e-5),
                    "presliding_n_s_m": _log(rng, 50.0, 500.0),
                },
            }
        },
        "bodies": {
            "arm": {
                "kind": "kokoro",
                "theta_cylinder": "forearm",
                "slider": {"pivot_m": pivot, "crank_m": crank, "closed_length_m": closed},
                "theta_inertia_kg_m2": mass * centre**2 * between(1.1, 1.4) + 3e-3,
                "mass_kg": mass,
                "centre_m": centre,
                "alpha": {"name": "shoulder", "held": True},
                "theta": theta,
            }
        },
        "encoders": {
            "elbow": {
                "noise": between(1e-4, 3e-4),
                "quantum": float(rng.choice([2e-4, 4e-4, 2.0 * math.pi / 8192])),
            }
        },
    }
    data["reservoirs"]["room"]["pressure_pa"] = data["ambient"]["pressure_pa"]
    return Rig.model_validate(data)


def known_of_joint(data: dict[str, Any], rng: np.random.Generator) -> None:
    """Leaves in a joint's rig file what its user knows of it.

    Bore, rod, stroke and stops are the drawing's, the linkage is measured to half a percent, masses
    and inertia are about, dead volumes a guess; friction, heat and how stops yield are what
    cylinders and stops of that size usually have.

    Args:
        data: The rig file, which is changed.
        rng: Source of the errors.
    """
    (body,), (cylinder,) = data["bodies"].values(), data["cylinders"].values()
    theta, slider = body["theta"], body["slider"]
    for number, most in (("theta_inertia_kg_m2", 0.3), ("mass_kg", 0.15)):
        body[number] *= _about(rng, most)
    for number in ("pivot_m", "crank_m"):
        slider[number] *= _about(rng, 0.005)
    theta.update(
        viscous=0.02, dry_friction=0.0, stop_stiffness=2000.0, stop_damping=2.0, stop_hold=0.0
    )
    theta["start"] = 0.0
    # the clearance at the lower stop is measured with the cylinder closed
    gap = 0.5 * (cylinder["stroke_m"] - _way(slider, theta))
    slider["closed_length_m"] = _length(slider, theta["lower"]) - gap
    for side in ("head", "rod"):
        cylinder[side]["dead_volume_m3"] *= _about(rng, 0.5)
        cylinder[side].pop("heat_w_per_k", None)
    cylinder["heat_w_m2_k"] = 20.0
    cylinder["friction"] = {"coulomb_n": 4.0, "breakaway_n": 2.0, "viscous_n_s_m": 20.0}
    for encoder in data["encoders"].values():
        encoder.pop("noise", None)
        encoder.pop("quantum", None)


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _about(rng: np.random.Generator, most: float) -> float:
    """A factor that is off by at most so much either way."""
    by = 1.0 + rng.uniform(0.0, most)
    return float(by if rng.random() < 0.5 else 1.0 / by)


def _side(node: str, rng: np.random.Generator) -> dict[str, Any]:
    return {
        "node": node,
        "dead_volume_m3": 1e-6 * rng.uniform(2.5, 8.0),
        "heat_w_per_k": rng.uniform(0.0, 0.05),
    }


def _length(slider: dict[str, float], theta: float) -> float:
    """From the cylinder's pivot to the crank's pin at an angle, m."""
    a, r = slider["pivot_m"], slider["crank_m"]
    return math.sqrt(a * a + r * r + 2.0 * a * r * math.sin(theta))


def _way(slider: dict[str, float], theta: dict[str, float]) -> float:
    return _length(slider, theta["upper"]) - _length(slider, theta["lower"])


def _fitted(
    pivot_m: float, crank_m: float, theta: dict[str, Any], gap_m: float
) -> tuple[float, float]:
    """Length of the closed cylinder and its stroke, with a gap before either end at the stops."""
    slider = {"pivot_m": pivot_m, "crank_m": crank_m}
    stroke = math.ceil(1e3 * (_way(slider, theta) + 2.0 * gap_m)) / 1e3
    gap = 0.5 * (stroke - _way(slider, theta))
    return _length(slider, theta["lower"]) - gap, stroke
