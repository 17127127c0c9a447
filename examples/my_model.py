# SPDX-License-Identifier: Apache-2.0
"""A kind of model of one's own in one file: a line that follows its supply with one time constant.

It knows the rig's reservoirs, the opening of its first port and nothing of gas dynamics: what one
would try first, and a measure for all that is better. A distribution that installs it says

    [project.entry-points."pneu.models"]
    first_order = "my_model:FirstOrder"

and a rig file that says ``model: first_order`` is then checked, simulated, and compared with others
like any other.
"""

from collections.abc import Sequence

import numpy as np
from scipy.integrate import cumulative_simpson

from pneu_sim.models import ModelKind
from pneu_sim.rig.plan import Plan
from pneu_sim.rig.schema import Rig
from pneu_sim.simulate import TICK_S, Course, InitialField, Prediction, RunOptions

TAU_S = 0.15


class FirstOrder(ModelKind):
    """Every tap follows the pressure between the rig's reservoirs that the valve asks for."""

    def predict(
        self,
        rigs: Sequence[Sequence[Rig]],
        plan: Plan,
        courses: Sequence[Course],
        field: InitialField,
        options: RunOptions = RunOptions(),
    ) -> list[Prediction]:
        """Follows the commands by a first-order lag, its integral taken from tick to tick."""
        out = []
        for own, course in zip(rigs, courses, strict=True):
            tick_s = course.begin_s + TICK_S * np.arange(course.ticks, dtype=np.float64)
            readings = np.full((len(own), *course.time_s.shape), np.nan)
            taps = np.empty((len(own), course.ticks if options.flows else 0, len(plan.taps)))
            for k, rig in enumerate(own):
                low, *_, high = sorted(r.pressure_pa for r in rig.reservoirs.values())
                valve = next(iter(rig.valves.values()))
                port = next(iter(valve.ports.values()))
                volts = course.commands[valve.command].held(tick_s)
                share = np.interp(volts, port.opening.voltage_v, port.opening.fraction)
                begin = float(np.mean(course.start.pressure))
                grown = np.exp((tick_s - tick_s[0]) / TAU_S)
                asked = (low + share * (high - low)) * grown / TAU_S
                pressure = (begin + cumulative_simpson(asked, x=tick_s, initial=0.0)) / grown
                for t in range(len(plan.taps)):
                    due = np.isfinite(course.time_s[t])
                    readings[k, t, due] = np.interp(course.time_s[t, due], tick_s, pressure)
                if options.flows:
                    taps[k] = pressure[:, None]
            nothing = np.zeros((len(own), taps.shape[1], 0))
            ports = np.zeros((len(own), taps.shape[1], plan.ports.shape[0]))
            chambers = nothing[:, :, : len(plan.chambers)]
            out.append(Prediction(readings, tick_s, ports, chambers, taps))
        return out
