# SPDX-License-Identifier: Apache-2.0
"""Dead-band: the spool's lands overlap the ports, so small commands open nothing."""

import math
from typing import ClassVar

import numpy as np

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.model import Model
from pneu_sim.rig.schema import Port, Rig

MOST = 0.9
"""An overlap takes at most this share of the stroke."""


class DeadBand(Effect):
    """Overlap on each side of null, added to the rig's.

    An overlap of the lands alone takes its width from the stroke, and the port no longer opens
    wholly; where the driver's gain was set with the overlap there, all of it opens nevertheless.
    A path that is open at null, or of a switched valve, opens later by the width and closes as much
    sooner. A valve that regulates pressure has a dead zone of its own and no such overlap.
    """

    name: ClassVar[str] = "dead_band"
    title: ClassVar[str] = "valve overlap (dead-band)"
    where: ClassVar[str] = "valve"
    formula: ClassVar[str] = (
        "x = null + sgn(u - null) max(|u - null| - width_v, 0) S / (S - recovered width_v),"
        " S: stroke on that side"
    )
    source: ClassVar[str] = (
        "Beater, Pneumatic Drives, Springer 2007 (valve overlap); Tao and Kokotovic, Adaptive"
        " Control of Systems with Actuator and Sensor Nonlinearities, Wiley 1996"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("width_v", "V per side", 0.0, 0.0, 2.5, 0.25, 0.01),
        EffectParameter("recovered", "share of the width", 0.0, 0.0, 1.0, 0.0, 0.05, fitted=True),
    )
    order: ClassVar[int] = 3
    curved: ClassVar[bool] = True
    next_experiment: ClassVar[str] = (
        "Drive a slow triangle of small amplitude through null at two pressures: an overlap leaves"
        " the same stretch of voltage without flow both ways, hysteresis shifts it with direction."
    )

    def places(self, rig: Rig) -> list[str]:
        return [name for name, valve in rig.valves.items() if valve.regulator is None]

    def limits(self, parameter: EffectParameter, rig: Rig, place: str) -> tuple[float, float]:
        if parameter.name != "width_v":
            return super().limits(parameter, rig, place)
        valve = rig.valves[place]
        reach = [_reach_v(port, valve.spool.null_v) for port in valve.ports.values()]
        return parameter.lower, min(parameter.upper, MOST * min(r for r in reach if r > 0.0))

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        del rig, place, values  # between their points the curves stay what they are

    def on_model(self, model: Model, rig: Rig, place: str, values: dict[str, float]) -> None:
        # Every path opens later by the width, and one that is open at null closes as much sooner:
        # the axis of voltage of the whole curve is moved, with what lies below its first point.
        width_v, null_v = values["width_v"], rig.valves[place].spool.null_v
        for q, name in enumerate(model.plan.port_names):
            if name.rpartition(".")[0] != place or width_v <= 0.0:
                continue
            volts, rising = model.curve_v[q] - null_v, model.curve[q, -1] > model.curve[q, 0]
            left = 1.0 - values["recovered"] * width_v / np.abs(volts).max()
            model.curve_v[q] = null_v + left * volts + (width_v if rising else -width_v)


def _reach_v(port: Port, null_v: float) -> float:
    """Volts from null to where an opening curve ends; infinite for one that follows another."""
    if port.opening.mirror is not None:
        return math.inf
    return max(abs(v - null_v) for v in port.opening.voltage_v)
