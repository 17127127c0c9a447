# SPDX-License-Identifier: Apache-2.0
"""Where an ensemble begins: gas between the first readings, and how little is known beyond them.

Pressures lie on straight lines between the taps of a line, beyond them and where it has none at the
nearest reading. Members differ from that by smooth fields of pressure, temperature and speed: waves
may be on their way. Joints stand where encoders say, at speeds that are not known.
"""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pneu_sim.gas import AIR
from pneu_sim.observe.drifts import centred
from pneu_sim.observe.nearness import distances, gaspari_cohn
from pneu_sim.observe.settings import ObserverSettings
from pneu_sim.plant import Plant
from pneu_sim.rig.cells import middles

Floats = NDArray[np.float64]

LEAST_PA = 100.0
"""Least pressure, absolute, that a reading is taken for: with less, the molecules of air fly a
fifteenth of a millimetre, and the gas in a line flows no more as a continuum."""
SMOOTH = 0.25
"""Fields of a beginning vary over this share of a line: half of their correlation's support."""
SMALLEST = 1e-9
"""Added to the diagonal of correlations, so that they can be factored."""


def begin(
    plant: Plant,
    readings: Mapping[str, float],
    settings: ObserverSettings,
    rng: np.random.Generator,
) -> None:
    """Fills the members.

    Args:
        plant: The members, reset: what no reading tells of is as that left it.
        readings: First readings of sensors, Pa, rad or m.
        settings: How little is known.
        rng: Source of the draws.
    """
    rig, plan = plant.rigs[0], plant.plan
    _place(plant, readings, settings, rng)
    known = {name: value for name, value in readings.items() if name in plan.taps}
    if not known:
        return
    far_slots, far_chambers = distances(rig, plan)
    rows = [plan.taps.index(name) for name in known]
    values = np.array(list(known.values()))
    for name, (first, n) in plan.pipes.items():
        near = far_slots[rows, first : first + n]
        if not np.isfinite(near).any():
            continue
        own = sorted(
            (rig.taps[tap].position_m, value)
            for tap, value in known.items()
            if rig.taps[tap].pipe == name
        )
        at = middles(1.0, n)
        if own:
            length = rig.pipes[name].length_m
            where, level = np.array(own).T
            mean = np.interp(at * length, where, level)
        else:
            mean = values[np.argmin(near, axis=0)]
        warm = rig.ambient.temperature_k
        density = mean / (AIR.r_specific * warm)
        sound = math.sqrt(AIR.gamma * AIR.r_specific * warm)
        fields = [_field(at, plant.lanes, rng) for _ in range(3)]
        start = settings.start_std_pa
        p = _pressures(np.asarray(mean)[:, None], start, fields[0])
        t = warm + settings.start_std_k * fields[1]
        u = start / (density * sound)[:, None] * fields[2]
        plant.set_gas(name, p / (AIR.r_specific * t), u, p)
    for c, chamber in enumerate(plan.chambers):
        near = far_chambers[rows, c]
        if np.isfinite(near).any():
            level = values[int(np.argmin(near))]
            draw = centred(rng, (2, plant.lanes))
            p = _pressures(np.asarray(level), settings.start_std_pa, draw[0])
            t = rig.ambient.temperature_k + settings.start_std_k * draw[1]
            plant.set_chamber(chamber, p, t)


def _place(
    plant: Plant,
    readings: Mapping[str, float],
    settings: ObserverSettings,
    rng: np.random.Generator,
) -> None:
    """Puts joints where encoders say."""
    joints = dict(zip(plant.plan.encoders, plant.encoder_of.tolist(), strict=True))
    told = {name: at for name, at in joints.items() if at >= 0 and name in readings}
    if not told:
        return
    names = plant.solver.joint_names
    speed = settings.start_speed * centred(rng, (len(told), plant.lanes))
    plant.place(
        {names[at]: readings[name] for name, at in told.items()},
        {names[at]: speed[k] for k, at in enumerate(told.values())},
    )


def _pressures(mean: Floats, std: float, draw: Floats) -> Floats:
    """Lognormal pressures of a mean and a standard deviation: positive, however low the mean."""
    mean = np.maximum(mean, LEAST_PA)
    spread = np.sqrt(np.log1p((std / mean) ** 2))
    return np.asarray(mean * np.exp(spread * draw - 0.5 * spread**2))


def _field(at: Floats, lanes: int, rng: np.random.Generator) -> Floats:
    """(cells, lanes) smooth draws of variance 1 along a line, ``at`` in its lengths."""
    share = gaspari_cohn(np.abs(at[:, None] - at[None]) / SMOOTH)
    factor = np.linalg.cholesky(share + SMALLEST * np.eye(len(at)))
    return np.asarray(factor @ centred(rng, (len(at), lanes)))
