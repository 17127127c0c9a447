# SPDX-License-Identifier: Apache-2.0
"""The simple model matched to the full one, valve by valve and opening by opening (thesis 7.4).

All that the two do not share is the flow through valves, as it is behind lines. So joints are held,
each valve is opened by so many volts, from several pressures on, in the full model; and the opening
of the thin-plate model is scaled by what lets its vessels fill and empty most alike.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.plant import Plant
from pneu_sim.rig.build import opening_table
from pneu_sim.rig.schema import Opening, Rig
from pneu_sim.rig.valves import Valve

Floats = NDArray[np.float64]

SAMPLE_S = 2e-3
SECONDS = 0.4
SHARES = (0.0, 0.3, 0.6, 1.0)
"""Pressures from which vessels are filled and emptied: shares of the way from room to supply."""
SCALES = 17
"""Tried at a time: over a factor of 30 either way, then between the neighbours of the best."""
WIDEST = 30.0


@dataclass(frozen=True)
class Matched:
    """A rig by the thin-plate model, and how well it does.

    Attributes:
        rig: The rig, its openings scaled.
        volts: (levels,) voltages that were tried, V.
        scales: Per valve (levels,) factor on the opening at each.
        rmse_pa: Per valve (levels,) pressures of the matched model off those of the full one, Pa.
        unmatched_pa: The same of the model as it was.
    """

    rig: Rig
    volts: Floats
    scales: dict[str, Floats]
    rmse_pa: dict[str, Floats]
    unmatched_pa: dict[str, Floats]


def match_thin_plate(
    rig: Rig,
    levels: int = 5,
    dx_m: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> Matched:
    """Matches the thin-plate model of a rig to its full model.

    Args:
        rig: The rig, by the full model.
        levels: Openings to either side of a valve's null.
        dx_m: Cell length of the full model, m; None is the rig's own.
        progress: Called with the share that is done.

    Raises:
        InputError: The rig has a mechanism, whose joints cannot be held, or no thin-plate model.
    """
    if rig.mechanism is not None:
        raise InputError(f"rig {rig.name!r}: mechanism: found one, a match holds joints of bodies")
    full = _held(rig).model_copy(update={"model": "pde"})
    plate = _held(rig).model_copy(update={"model": "thin_plate"})
    names = list(rig.valves)
    low, high = _ends(rig.valves[names[0]])
    null = rig.valves[names[0]].spool.null_v
    steps = np.arange(1, levels + 1) / levels
    volts = np.concatenate([null - (null - low) * steps[::-1], null + (high - null) * steps])
    asked = [(v, k) for v in range(len(names)) for k in range(volts.size)]
    true = _filled([full], [(v, float(volts[k])) for v, k in asked], dx_m)
    scales = {name: np.ones(volts.size) for name in names}
    rmse = {name: np.zeros(volts.size) for name in names}
    before = {name: np.zeros(volts.size) for name in names}
    for n, (v, k) in enumerate(asked):
        one = (v, float(volts[k]))
        before[names[v]][k] = _off(plate, one, np.ones(1), true[n])[0]
        tried = np.geomspace(1.0 / WIDEST, WIDEST, SCALES)
        for _ in range(3):
            off = _off(plate, one, tried, true[n])
            best = int(np.argmin(off))
            scales[names[v]][k], rmse[names[v]][k] = tried[best], off[best]
            left, right = tried[max(best - 1, 0)], tried[min(best + 1, SCALES - 1)]
            tried = np.geomspace(left, right, SCALES)
        if progress is not None:
            progress((n + 1) / len(asked))
    valves = {name: _scaled(valve, volts, scales[name]) for name, valve in rig.valves.items()}
    matched = rig.model_copy(update={"model": "thin_plate", "valves": valves})
    return Matched(matched, volts, scales, rmse, before)


def _held(rig: Rig) -> Rig:
    """A rig whose joints are held where they start."""
    bodies = {}
    for name, body in rig.bodies.items():
        held = {
            field: joint.model_copy(update={"held": True})
            for field, joint in zip(body.joint_fields, body.joints, strict=True)
        }
        bodies[name] = body.model_copy(update=held)
    return rig.model_copy(update={"bodies": bodies})


def _ends(valve: Valve) -> tuple[float, float]:
    """Voltages between which the ports of a valve open."""
    tables = [opening_table(port, valve)[1] for port in valve.ports.values()]
    return min(float(v[0]) for v in tables), max(float(v[1]) for v in tables)


def _filled(rigs: Sequence[Rig], asked: Sequence[tuple[int, float]], dx_m: float | None) -> Floats:
    """(asked, starts, rigs, samples, chambers) pressures after a valve is opened, Pa."""
    first = rigs[0]
    room = first.ambient.pressure_pa
    supply = max(source.pressure_pa for source in first.reservoirs.values())
    starts = [room + share * (supply - room) for share in SHARES]
    lanes = [
        (a, s, r) for a in range(len(asked)) for s in range(len(starts)) for r in range(len(rigs))
    ]
    plant = Plant([rigs[r] for *_, r in lanes], dx_m)
    pressure = np.array([starts[s] for _, s, _ in lanes])
    fed = {*first.pipes, *plant.plan.chambers}
    plant.reset(dict.fromkeys(sorted(fed), pressure))
    samples = round(SECONDS / SAMPLE_S)
    null = np.array([valve.spool.null_v for valve in first.valves.values()])
    volts = np.tile(null[None, :, None], (len(lanes), 1, samples))
    for lane, (a, _, _) in enumerate(lanes):
        volts[lane, asked[a][0]] = asked[a][1]
    series, _ = plant.advance(volts, SAMPLE_S)
    shape = (len(asked), len(starts), len(rigs))
    return series.chambers[1:].transpose(2, 0, 1).reshape(*shape, samples, -1)


def _off(plate: Rig, one: tuple[int, float], scales: Floats, true: Floats) -> Floats:
    """(scales,) root mean square of pressures off those of the full model, Pa."""
    rigs = [
        plate.model_copy(
            update={
                "lumped": plate.lumped.model_copy(
                    update={"discharge": plate.lumped.discharge * float(scale)}
                )
            }
        )
        for scale in scales
    ]
    found = _filled(rigs, [one], None)[0]
    moving = np.ptp(true, axis=(0, 1, 2)) > 1.0  # chambers that the valve has to do with
    off = (found - true)[..., moving]
    return np.asarray(np.sqrt((off**2).mean(axis=(0, 2, 3))))


def _scaled(valve: Valve, volts: Floats, scales: Floats) -> Valve:
    """A valve whose ports open by so much more at each voltage."""
    null = valve.spool.null_v
    at = np.append(volts, null)
    factor = np.append(scales, math.nan)  # closed there: nothing to scale
    order = np.argsort(at)
    at, factor = at[order], factor[order]
    ports = {}
    for name, port in valve.ports.items():
        table, (low, high) = opening_table(port, valve)
        was = np.interp(at, np.linspace(low, high, len(table)), table)
        now = np.where(np.isfinite(factor), was * np.nan_to_num(factor), was)
        most = max(float(now.max()), 1e-9)
        curve = Opening(voltage_v=at.tolist(), fraction=(now / most).tolist())
        ports[name] = port.model_copy(
            update={
                "opening": curve,
                "conductance_m3_s_pa": port.conductance_m3_s_pa * most,
                "area_m2": port.area_m2 * most,
                "leakage": 0.0,  # the table has it
            }
        )
    return valve.model_copy(update={"ports": ports})
