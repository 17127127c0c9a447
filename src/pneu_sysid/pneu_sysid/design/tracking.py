# SPDX-License-Identifier: Apache-2.0
"""Commands as a controller sends them that has pressures follow random targets.

Where a rig is to be controlled its recordings are of this kind: what moves fast only as far as it
has to, and is corrected without end. The model is led along the targets by a proportional law, all
pieces side by side, and what it was commanded is what will be played.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sim.plant import Plant
from pneu_sim.rig.build import build
from pneu_sim.rig.network import joined
from pneu_sim.rig.plan import plan_grid
from pneu_sim.rig.schema import Rig, Valve
from pneu_sysid.design.foreseen import nodes_of_supplies
from pneu_sysid.design.limits import Limits, slewed
from pneu_sysid.design.waves import STEP_S, nulls_of

Floats = NDArray[np.float64]

GAIN = 4.0
"""A command is at its end where a pressure is off by one of so many parts of its range."""
PERIOD_S = (0.1, 0.8)
"""From one extreme of a target to the next."""
INSIDE = 0.05
"""Targets keep so far from the room's pressure and from the highest, as a share of what is between:
no valve fills a line quite to the end."""


@dataclass(frozen=True)
class Follower:
    """A command, and the tap whose pressure it has follow a target.

    Attributes:
        command: The command.
        tap: The tap.
        sign: 1 where a higher voltage fills, -1 where it empties.
    """

    command: str
    tap: str
    sign: float


@dataclass(frozen=True)
class Tracked:
    """Pieces that track.

    Attributes:
        pieces: Each by command its (T,) volts, every ``STEP_S``.
        targets: By command (T, n) what was to be followed, Pa.
        shown: By command (T, n) what its tap then showed, Pa.
    """

    pieces: list[dict[str, Floats]]
    targets: dict[str, Floats]
    shown: dict[str, Floats]


def followers_of(rig: Rig) -> list[Follower]:
    """What may follow a pressure: every command whose valve fills or empties a line with a tap.

    Args:
        rig: The rig.
    """
    plan = plan_grid(rig)
    model = build(rig, plan)
    supplied = nodes_of_supplies(rig)
    out: list[Follower] = []
    for name, valve in rig.valves.items():
        tap = _tap_behind(rig, valve)
        sign = 0.0
        for q, of in enumerate(plan.port_names):
            own, _, port = of.partition(".")
            if own == name and {valve.ports[port].from_node, valve.ports[port].to_node} & supplied:
                sign = float(np.sign(model.curve[q, -1] - model.curve[q, 0]))
        if tap is not None and sign and all(f.command != valve.command for f in out):
            out.append(Follower(valve.command, tap, sign))
    return out


def _tap_behind(rig: Rig, valve: Valve) -> str | None:
    """The tap nearest to what a valve fills and empties; None where there is none."""
    group = joined(rig)
    ends = {group[name] for name in rig.reservoirs}
    nodes = {n for p in valve.ports.values() for n in (p.from_node, p.to_node)}
    nodes = {n for n in nodes if group.get(n, n) not in ends}
    found: list[tuple[float, str]] = []
    for name, tap in rig.taps.items():
        if tap.pipe is None:
            if tap.chamber in nodes:
                found.append((0.0, name))
            continue
        pipe = rig.pipes[tap.pipe]
        if pipe.from_node in nodes:
            found.append((tap.position_m, name))
        if pipe.to_node in nodes:
            found.append((pipe.length_m - tap.position_m, name))
    return min(found)[1] if found else None


def track(
    rig: Rig, limits: Limits, seconds: float, count: int, rng: np.random.Generator
) -> Tracked:
    """Pieces in which pressures follow targets, each begun at rest.

    Of two commands that act on the two sides of a piston the second follows the mirror image of
    the first as often as a target of its own. A command without a tap stays where it shuts.

    Args:
        rig: The rig.
        limits: What volts keep to, and the highest pressure of targets.
        seconds: Length of each, s.
        count: How many.
        rng: Of the draws.
    """
    samples = round(seconds / STEP_S)
    room = rig.ambient.pressure_pa
    top = max((r.pressure_pa for r in rig.reservoirs.values()), default=room)
    reach = min(top, limits.highest_pa) - room
    low, high = room + INSIDE * reach, room + (1.0 - INSIDE) * reach
    followers = {f.command: f for f in followers_of(rig)}
    targets: dict[str, Floats] = {}
    for k, command in enumerate(f for f in rig.commands if f in followers):
        own = np.stack([_target(samples, low, high, rng) for _ in range(count)], axis=1)
        if k % 2:
            before = targets[list(targets)[-1]]
            own = np.where(rng.uniform(size=count) < 0.5, low + high - before, own)
        targets[command] = own
    plant, nulls = Plant([rig] * count), nulls_of(rig)
    taps = list(plant.plan.taps)
    at = {name: taps.index(f.tap) for name, f in followers.items()}
    volts = np.tile(_shut(plant.plan.commands, nulls, limits)[:, None], (1, count))
    series = np.empty((samples, *volts.shape))
    shown = {name: np.empty((samples, count)) for name in targets}
    for n in range(samples):
        readings = plant.readings()
        for v, command in enumerate(plant.plan.commands):
            if command not in targets:
                continue
            read = np.nan_to_num(readings[at[command]], nan=room)
            shown[command][n] = read
            off = followers[command].sign * (targets[command][n] - read) / reach
            null, least, most = nulls[command], limits.low_v[command], limits.high_v[command]
            wide = np.where(off > 0.0, most - null, null - least)
            asked = np.clip(null + np.clip(GAIN * off, -1.0, 1.0) * wide, least, most)
            change = limits.slew_v_s * STEP_S
            volts[v] = np.clip(asked, volts[v] - change, volts[v] + change)
        series[n] = volts
        plant.advance(volts.T[:, :, None], STEP_S)
    pieces = [
        {
            command: slewed(series[:, v, k].copy(), STEP_S, limits)
            for v, command in enumerate(plant.plan.commands)
        }
        for k in range(count)
    ]
    return Tracked(pieces, targets, shown)


def _shut(commands: list[str], nulls: Mapping[str, float], limits: Limits) -> Floats:
    return np.array([np.clip(nulls[c], limits.low_v[c], limits.high_v[c]) for c in commands])


def _target(samples: int, low: float, high: float, rng: np.random.Generator) -> Floats:
    """(T,) a target: from extreme to extreme, as often smoothly as in straight lines."""
    time = STEP_S * np.arange(samples)
    period = float(np.exp(rng.uniform(*np.log(PERIOD_S))))
    count = int(time[-1] / (0.5 * period)) + 3
    knots = np.concatenate([[0.0], np.cumsum(period * rng.uniform(0.5, 1.5, count))])
    levels = rng.uniform(low, high, knots.size)
    if rng.uniform() < 0.5:
        return np.asarray(np.interp(time, knots, levels))
    at = np.clip(np.searchsorted(knots, time, side="right") - 1, 0, knots.size - 2)
    share = (time - knots[at]) / np.diff(knots)[at]
    smooth = 0.5 - 0.5 * np.cos(np.pi * np.clip(share, 0.0, 1.0))
    return np.asarray(levels[at] + (levels[at + 1] - levels[at]) * smooth)
