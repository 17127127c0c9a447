# SPDX-License-Identifier: Apache-2.0
"""The delay-and-attenuation line (thesis 3.2.2; Richer and Hurmuzlu 2000, J. Dyn. Sys. 122:416).

The thin-plate model with the line between valve and end: what the valve passes arrives after the
distance over the speed of sound, weakened by the line's resistance,

    mdot(L, t) = exp(-R_t R T L / (2 p c)) * mdot(0, t - L / c),

with ``R_t = 32 mu / D^2`` for laminar and ``0.158 mu / D^2 Re^(3/4)`` for turbulent flow. All flow
into the line is weakened by its whole length and each tap sees it after its own distance, so that
the pressures along the line are one curve, shifted in time, and equal at rest. The valve meets the
pressure at its own end of the line, not yet delayed.
"""

from dataclasses import replace

import numpy as np

from pneu_sim import layout as L
from pneu_sim.effects import apply_to_rig
from pneu_sim.gas import AIR, Gas
from pneu_sim.lumped import thin_plate
from pneu_sim.lumped.model import LumpedModel
from pneu_sim.rig.expand import with_cylinders
from pneu_sim.rig.model import Model
from pneu_sim.rig.network import distances_from, end_nodes, port_ends
from pneu_sim.rig.plan import Plan
from pneu_sim.rig.schema import Rig

BLASIUS = 0.158 / 32.0
"""Turbulent over laminar resistance, per Re^(3/4)."""


def build(rig: Rig, plan: Plan | None = None, gas: Gas = AIR) -> LumpedModel:
    """Reduces a rig to volumes behind delaying lines.

    Args:
        rig: The rig.
        plan: Its grid plan; None makes the rig's own.
        gas: The gas.

    Returns:
        The model.

    Raises:
        InputError: The rig has no such reduction.
    """
    model = thin_plate.build(rig, plan, gas)
    rig = with_cylinders(apply_to_rig(rig))  # lengths may have changed
    speed = float(gas.sound_speed(model.base.ambient[1]))
    nodes = [node for ends in port_ends(rig) for node in ends]
    n_sides = len(nodes)
    tap_delay = np.zeros((len(rig.taps), n_sides))
    side_delay = np.zeros((n_sides, n_sides))
    drag = np.zeros((n_sides, 2))
    resistance = {name: _resistance(model.base, name) for name in rig.pipes}
    for s, node in enumerate(nodes):
        if model.side[s] < 0:
            continue
        reach = distances_from(rig, node)
        for other, there in enumerate(nodes):
            if there in reach:
                side_delay[other, s] = reach[there][0] / speed
        for t, tap in enumerate(rig.taps.values()):
            if tap.chamber is not None and tap.chamber in reach:
                tap_delay[t, s] = reach[tap.chamber][0] / speed
            elif tap.pipe is not None:
                start, end = end_nodes(rig, tap.pipe)
                if start in reach and end in reach:
                    length = rig.pipes[tap.pipe].length_m
                    ways = (
                        reach[start][0] + tap.position_m,
                        reach[end][0] + length - tap.position_m,
                    )
                    tap_delay[t, s] = max(min(ways), 0.0) / speed
        _, way = max(reach.values())
        for name in way:
            drag[s] += resistance[name]
    drag *= {"laminar": (1.0, 0.0), "turbulent": (0.0, 1.0), "larger": (1.0, 1.0)}[
        rig.lumped.resistance
    ]
    return replace(model, tap_delay_s=tap_delay, side_delay_s=side_delay, drag=drag)


def _resistance(full: Model, pipe: str) -> np.ndarray:
    """Laminar and turbulent R_t L of a pipe; its wall's factors and blockages count."""
    first, n = full.plan.pipes[pipe]
    cell = full.cell[:, first : first + n]
    k = list(full.plan.pipes).index(pipe)
    plain = full.end_area[2 * k : 2 * k + 2].mean()
    # 8 pi mu / A = 32 mu / D^2, for the velocity where the pipe is not narrowed
    poiseuille = cell[L.VISCOUS] * cell[L.LENGTH] * (plain / cell[L.AREA])
    reynolds = cell[L.REYNOLDS] / cell[L.AREA]  # per kg/s
    laminar = poiseuille * cell[L.LAMINAR]
    turbulent = poiseuille * cell[L.TURBULENT] * BLASIUS * reynolds**0.75
    return np.array([laminar.sum(), turbulent.sum()])
