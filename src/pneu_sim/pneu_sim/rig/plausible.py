# SPDX-License-Identifier: Apache-2.0
"""What of a rig file no laboratory has: mostly numbers in another unit than the SI's.

The schema refuses what has no meaning; this refuses what has one that nobody means, such as a
cylinder whose gas nothing meets. Rigs that programs build are not asked.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from pneu_sim.rig.kinds import STILL
from pneu_sim.rig.network import port_ends
from pneu_sim.rig.schema import CLOSED, Rig


@dataclass(frozen=True)
class Range:
    """What a kind of number may be.

    Attributes:
        low: Least value.
        high: Greatest value.
        unit: Its unit.
        others: Units in which it is often given: name, factor to the SI unit, offset.
        usual: Values that need no second thought; a number in another unit falls there.
        zero: Whether 0 is allowed besides.
    """

    low: float
    high: float
    unit: str
    others: tuple[tuple[str, float, float], ...] = ()
    usual: tuple[float, float] = (0.0, 0.0)
    zero: bool = True

    def objection(self, value: float) -> str:
        """What is wrong with a value; empty if nothing is.

        Args:
            value: The value, in the SI unit.
        """
        if self.low <= value <= self.high or (self.zero and value == 0.0):
            return ""
        text = f"found {value:g} {self.unit}, allowed are {self.low:g} to {self.high:g}"
        for name, factor, offset in self.others:
            meant = value * factor + offset
            if self.usual[0] <= meant <= self.usual[1]:
                return f"{text}; {value:g} {name} are {meant:.6g} {self.unit}"
        return text


_BAR = (("bar", 1e5, 0.0), ("kPa", 1e3, 0.0), ("psi", 6894.757, 0.0), ("MPa", 1e6, 0.0))
_MM = (("mm", 1e-3, 0.0),)
_MM2 = (("mm2", 1e-6, 0.0), ("cm2", 1e-4, 0.0))
_CM3 = (("cm3", 1e-6, 0.0), ("litres", 1e-3, 0.0))

RANGES = {
    "pressure_pa": Range(1e3, 1e8, "Pa", _BAR, (5e4, 2e7), zero=False),
    "temperature_k": Range(150.0, 1000.0, "K", (("°C", 1.0, 273.15),), (230.0, 400.0), zero=False),
    "length_m": Range(1e-3, 1e2, "m", _MM, (1e-2, 1e2), zero=False),
    "position_m": Range(0.0, 1e2, "m", _MM, (1e-2, 1e2)),
    "dx_m": Range(1e-4, 1e2, "m", _MM, (1e-3, 1.0), zero=False),
    "area_m2": Range(1e-12, 1e-2, "m2", _MM2, (1e-7, 1e-3)),
    "leak_area_m2": Range(1e-15, 0.1, "m2", _MM2, (1e-9, 1e-3)),
    "porous_m3": Range(1e-25, 1e-6, "m3"),
    "leak_porous_m3": Range(1e-25, 1e-6, "m3"),
    "set_pa": Range(1e3, 1e8, "Pa", _BAR, (5e4, 2e7), zero=False),
    "range_pa": Range(1.0, 1e8, "Pa", _BAR, (1e2, 1e6), zero=False),
    "low_pa": Range(1e3, 1e8, "Pa", _BAR, (5e4, 2e7), zero=False),
    "high_pa": Range(1e3, 1e8, "Pa", _BAR, (5e4, 2e7), zero=False),
    "dead_zone_pa": Range(0.1, 1e7, "Pa", _BAR, (1e2, 1e5)),
    "full_open_pa": Range(1.0, 1e8, "Pa", _BAR, (1e2, 1e7), zero=False),
    "amplitude_pa": Range(0.0, 1e7, "Pa", _BAR, (1e2, 1e6)),
    "frequency_hz": Range(1e-4, 1e5, "Hz", zero=False),
    "volume_m3": Range(1e-10, 10.0, "m3", _CM3, (1e-8, 1.0)),
    "volume_from_m3": Range(0.0, 0.1, "m3", _CM3, (1e-9, 1e-2)),
    "volume_to_m3": Range(0.0, 0.1, "m3", _CM3, (1e-9, 1e-2)),
    "conductance_m3_s_pa": Range(
        0.0, 1e-5, "m3/(s Pa)", (("dm3/(s bar)", 1e-8, 0.0), ("l/min/bar", 1e-8 / 60.0, 0.0)),
        (1e-11, 1e-6),
    ),
    "bore_m": Range(1e-3, 2.0, "m", _MM, (2e-3, 0.5), zero=False),
    "rod_m": Range(1e-4, 2.0, "m", _MM, (1e-3, 0.2)),
    "stroke_m": Range(1e-3, 20.0, "m", _MM, (1e-3, 5.0), zero=False),
    "start_m": Range(0.0, 20.0, "m", _MM, (1e-3, 5.0)),
    "closed_length_m": Range(1e-3, 20.0, "m", _MM, (1e-3, 5.0), zero=False),
    "dead_volume_m3": Range(1e-12, 1.0, "m3", _CM3, (1e-9, 1e-2), zero=False),
    "piston_leak_m2": Range(1e-15, 1e-2, "m2", _MM2, (1e-11, 1e-4)),
    "rod_leak_m2": Range(1e-15, 1e-2, "m2", _MM2, (1e-11, 1e-4)),
    "displacement_m3_rad": Range(1e-9, 1.0, "m3/rad", _CM3, (1e-8, 1e-2), zero=False),
    "port_conductance_m3_s_pa": Range(
        0.0, 1e-5, "m3/(s Pa)", (("dm3/(s bar)", 1e-8, 0.0), ("l/min/bar", 1e-8 / 60.0, 0.0)),
        (1e-11, 1e-6),
    ),
    "mass_kg": Range(1e-5, 1e5, "kg", (("g", 1e-3, 0.0),), (1e-3, 1e4)),
    "roughness_m": Range(0.0, 1e-2, "m", (("um", 1e-6, 0.0),), (1e-7, 1e-3)),
    "bandwidth_hz": Range(1e-3, 1e5, "Hz", zero=False),
    "damping": Range(1e-3, 1e3, ""),
    "max_speed_v_s": Range(1e-3, 1e9, "V/s", zero=False),
    "delay_s": Range(0.0, 10.0, "s", (("ms", 1e-3, 0.0),), (1e-4, 1.0)),
    "closing_delay_s": Range(0.0, 10.0, "s", (("ms", 1e-3, 0.0),), (1e-4, 1.0)),
    "sensor_lag_s": Range(0.0, 100.0, "s", (("ms", 1e-3, 0.0),), (1e-4, 10.0)),
    "integral_s": Range(1e-5, 1e5, "s", (("ms", 1e-3, 0.0),), (1e-3, 1e2), zero=False),
    "pwm_hz": Range(1e-3, 1e5, "Hz", zero=False),
    "lag_s": Range(0.0, 100.0, "s", (("ms", 1e-3, 0.0),), (1e-4, 10.0)),
    "offset_s": Range(-100.0, 100.0, "s", (("ms", 1e-3, 0.0),), (1e-4, 1.0)),
    "noise_pa": Range(0.0, 1e6, "Pa"),
    "quantum_pa": Range(0.0, 1e6, "Pa"),
    "bias_pa": Range(-1e7, 1e7, "Pa"),
    "heat_w_per_k": Range(0.0, 1e4, "W/K"),
    "convection_m2": Range(1e-6, 1e3, "m2", _MM2, (1e-5, 1e2)),
    "height_m": Range(1e-3, 1e2, "m", _MM, (1e-2, 1e1), zero=False),
    "inlet_m": Range(1e-5, 1.0, "m", _MM, (1e-4, 0.2), zero=False),
    "compliance_m3_per_pa": Range(0.0, 1e-2, "m3/Pa"),
    "droop_pa_s_per_kg": Range(0.0, 1e12, "Pa s/kg"),
    "droop_tau_s": Range(0.0, 100.0, "s", (("ms", 1e-3, 0.0),), (1e-4, 1.0)),
    "dt_s": Range(1e-8, 1.0, "s", zero=False),
    "wave_speed_m_s": Range(100.0, 1e4, "m/s", zero=False),
    "fraction": Range(0.0, 1e3, ""),
    "voltage_v": Range(-1e6, 1e6, "V"),
    "rate_hz": Range(1e-3, 1e6, "Hz", zero=False),
}  # fmt: skip
"""By the name of a field; pressures are absolute."""


def implausible(rig: Rig) -> str:
    """The first number that no laboratory has, as a sentence without the file's name; else empty.

    Args:
        rig: The rig.
    """
    for path, name, value in _numbers(rig, ""):
        known = RANGES.get(name)
        objection = "" if known is None else known.objection(value)
        if objection:
            return f"{path}: {objection}"
    return _unmoved(rig) or _unmet(rig)


def _unmoved(rig: Rig) -> str:
    """An objection to a model that cannot move what the rig has; else empty."""
    if rig.moves and rig.model in STILL:
        return f"model: found {rig.model}, which moves no cylinders; allowed are pde, thin_plate"
    return ""


def _unmet(rig: Rig) -> str:
    """An objection to a side of a cylinder whose node is named nowhere else; else empty."""
    met = {node for ends_of_port in port_ends(rig) for node in ends_of_port}
    met |= {node for pipe in rig.pipes.values() for node in (pipe.from_node, pipe.to_node)}
    met |= {tap.chamber for tap in rig.taps.values() if tap.chamber is not None} | {CLOSED}
    for name, cylinder in rig.cylinders.items():
        for side_name, side in cylinder.sides.items():
            if side.node not in met:
                return (
                    f"cylinders.{name}.{side_name}.node: found {side.node!r}, which no pipe, valve"
                    f" port, orifice or tap names; a side without any has the node {CLOSED!r}"
                )
    return ""


def _numbers(node: Any, path: str) -> Iterator[tuple[str, str, float]]:
    """Path, field and value of every number of the rig's own parts."""
    if isinstance(node, BaseModel):
        children = [(name, getattr(node, name)) for name in type(node).model_fields]
    elif isinstance(node, dict):
        children = list(node.items())
    else:
        children = [(str(k), value) for k, value in enumerate(node)]
    of_list = path.rpartition(".")[2] if isinstance(node, list) else ""
    for name, value in children:
        if path == "" and name in ("effects", "fit", "calibration", "recordings"):
            continue  # in units of their own
        where = f"{path}.{name}" if path else name
        if isinstance(value, int | float) and not isinstance(value, bool):
            yield where, of_list or name, float(value)
        elif isinstance(value, BaseModel | dict | list):
            yield from _numbers(value, where)
