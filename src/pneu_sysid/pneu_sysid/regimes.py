# SPDX-License-Identifier: Apache-2.0
"""What a rig was doing at each sample: flow direction, choking, valve opening, pressure, time.

Where it moves, also how: see ``motion``.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from pneu_sim import layout as L
from pneu_sim.gas import AIR
from pneu_sim.rig import rig_in_recording
from pneu_sim.rig.build import build
from pneu_sim.rig.network import port_ends, volume_of_tap, volumes_of
from pneu_sim.rig.plan import Plan, plan_grid
from pneu_sim.rig.schema import Rig
from pneu_sim.simulate import TICK_S, initial_field
from pneu_sim.valve import evenly_open
from pneu_sysid.motion import motion_sets
from pneu_sysid.problem import Problem, Rollouts
from pneu_sysid.results.compare import RegimeKind
from pneu_sysid.sensor_units import encoder_units
from pneu_sysid.ticks import STILL, Ticks

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SHUT = 0.005
"""A valve open by less counts as closed."""
OPENING_EDGES = ((SHUT, "closed"), (0.1, "below 10 % open"), (0.5, "10-50 % open"))
WIDE_OPEN = "above 50 % open"
SMOOTHING_S = 0.02
LEVELS = 3
FREQUENCY_EDGES_HZ = (0.0, 5.0, 20.0, 60.0, 150.0)
BLOCK_S = 1.0
LONGEST_TRANSFORM = 512
"""Readings that are transformed together: what that costs grows with their square."""
FEWEST = 5
"""A regime of fewer samples is not reported."""


@dataclass(frozen=True)
class SampleSet:
    """The readings of one sensor in one regime.

    Attributes:
        kind: By what the readings are divided.
        label: Which part this is.
        mask: (n_stretches, horizon) which readings belong to it.
        of: The valve, port, cylinder, joint or recording that it is about; empty where it is the
            sensor itself.
        lower: Where the part begins on its scale (opening, Pa, s); None where it has none.
        upper: Where it ends.
    """

    kind: RegimeKind
    label: str
    mask: Mask
    of: str = ""
    lower: float | None = None
    upper: float | None = None


@dataclass(frozen=True)
class Operation:
    """What a rig did along its recordings.

    Attributes:
        time_s: (n_stretches, horizon, n_sensors) time of each reading; NaN where there is none.
        by_tap: Sets of readings of each sensor.
    """

    time_s: Floats
    by_tap: dict[str, list[SampleSet]]

    def sets(self, tap: str) -> list[SampleSet]:
        """All sets of a sensor.

        Args:
            tap: Its name.
        """
        return self.by_tap.get(tap, [])


def operation(problem: Problem, rig: Rig, out: Rollouts) -> Operation:
    """Finds out what a rig did, from its commands and from what one model of it predicts.

    Args:
        problem: The problem.
        rig: The rig.
        out: Its predictions, flows included, the rig being the only one of its batch.
    """
    plan = plan_grid(rig, problem.dx_m)
    rigs = [rig_in_recording(rig, recording.name) for recording in problem.recordings]
    opened = []
    for recording, own, along in zip(problem.recordings, rigs, out.along, strict=True):
        model = build(own, plan)
        tick_s = along.tick_s
        opened.append(evenly_open(model, recording.commands, float(tick_s[0]), TICK_S, tick_s.size))
    common = _opening_sets(plan, opened)
    common += _choked_sets(rigs, plan, opened, [along.taps[0] for along in out.along])
    common += motion_sets(rig, out.along)
    seen = np.isfinite(problem.measured)
    tick = _tick_of(problem, out)

    def at(masks: list[Mask], t: int) -> Mask:
        mask = np.zeros(seen.shape[:2], dtype=bool)
        for c, of_ticks in enumerate(masks):
            mine = problem.of == c
            mask[mine] = of_ticks[tick[mine, :, t]]
        return np.asarray(mask & seen[:, :, t])

    directions = _directions(rig, out)
    units = encoder_units(rig)
    several = len(problem.recordings) > 1
    by_tap = {}
    for t, tap in enumerate(problem.taps):
        sets = [
            SampleSet(s.kind, s.label, at(s.masks, t), s.of, s.lower, s.upper)
            for s in directions.get(tap, []) + common
        ]
        sets += _level_sets(problem, t, units.get(tap))
        time = problem.time_s[:, :, t]
        for c, recording in enumerate(problem.recordings):
            mine = seen[:, :, t] & (problem.of == c)[:, None]
            last = np.max(time[mine], initial=0.0)
            for b in range(int(last // BLOCK_S) + 1):
                with np.errstate(invalid="ignore"):
                    mask = mine & (time >= b * BLOCK_S) & (time < (b + 1) * BLOCK_S)
                begin, end = b * BLOCK_S, (b + 1) * BLOCK_S
                label = f"{begin:g}-{end:g} s" + (f" of {recording.name}" if several else "")
                of = recording.name if several else ""
                sets.append(SampleSet("time", label, mask, of, begin, end))
        by_tap[tap] = [s for s in sets if s.mask.sum() >= FEWEST]
    return Operation(problem.time_s, by_tap)


def _tick_of(problem: Problem, out: Rollouts) -> NDArray[np.int64]:
    """(n_stretches, horizon, n_taps) the tick at or before each reading; 0 where there is none."""
    tick = np.zeros(problem.time_s.shape, dtype=np.int64)
    for c, along in enumerate(out.along):
        mine = problem.of == c
        since = (
            np.nan_to_num(problem.time_s[mine], nan=along.tick_s[0]) - along.tick_s[0]
        ) / TICK_S
        tick[mine] = np.clip(since + 1e-6, 0, along.tick_s.size - 1).astype(np.int64)
    return tick


def _opening_sets(plan: Plan, opened: list[Floats]) -> list[Ticks]:
    """By how far each valve's widest port is open."""
    sets = []
    labels = [label for _, label in OPENING_EDGES] + [WIDE_OPEN]
    edges = [0.0, *(edge for edge, _ in OPENING_EDGES), None]
    for v, name in enumerate(plan.valves):
        ports = [q for q, of in enumerate(plan.port_valve) if of == v]
        bands = [
            np.digitize(o[:, ports].max(axis=1), [edge for edge, _ in OPENING_EDGES])
            for o in opened
        ]
        for k, label in enumerate(labels):
            masks = [band == k for band in bands]
            sets.append(Ticks("opening", f"{name} {label}", masks, name, edges[k], edges[k + 1]))
    return sets


def _choked_sets(
    rigs: list[Rig], plan: Plan, opened: list[Floats], pressures: list[Floats]
) -> list[Ticks]:
    """By whether the flow through each open port is sonic."""
    sonic = float((2.0 / (AIR.gamma + 1.0)) ** (AIR.gamma / (AIR.gamma - 1.0)))
    fields = [initial_field(rig, plan) for rig in rigs]
    ports = [build(rig, plan).port for rig in rigs]

    def side(c: int, kind: int, index: int) -> Floats:
        if kind == L.SIDE_RESERVOIR:
            pressure = list(rigs[c].reservoirs.values())[index].pressure_pa
            return np.full(pressures[c].shape[0], pressure)
        if kind == L.SIDE_CHAMBER:
            weight, constant = fields[c].chamber_weight[index], fields[c].chamber_constant[index]
        else:
            slot = plan.ends[index, L.E_CELL]
            weight, constant = fields[c].weight[slot], fields[c].constant[slot]
        return np.asarray(pressures[c] @ weight + constant)

    sets = []
    for q, name in enumerate(plan.port_names):
        choked, free = [], []
        for c in range(len(rigs)):
            a = side(c, int(plan.ports[q, L.P_A]), int(plan.ports[q, L.P_AI]))
            b = side(c, int(plan.ports[q, L.P_B]), int(plan.ports[q, L.P_BI]))
            iso = plan.ports[q, L.P_MODE] == L.ISO6358
            critical = float(ports[c][q, L.Q_RATIO]) if iso else sonic
            is_choked = np.minimum(a, b) <= critical * np.maximum(a, b)
            is_open = opened[c][:, q] > SHUT
            choked.append(is_open & is_choked)
            free.append(is_open & ~is_choked)
        sets.append(Ticks("choked", f"{name} choked", choked, name))
        sets.append(Ticks("choked", f"{name} not choked", free, name))
    return sets


def _directions(rig: Rig, out: Rollouts) -> dict[str, list[Ticks]]:
    """Flow direction per tap: filling and exhausting of the closed volume it sees.

    That is the volume the tap sits in, or, where this is open to a reservoir, the closed volumes
    behind its valve ports. Where a rig has none, the tap's own rise and fall take their place.
    """
    volume, fed = volumes_of(rig)
    ends = port_ends(rig)
    joined = [(volume.get(a, ""), volume.get(b, "")) for a, b in ends]
    known = all(
        along.flows.shape[-1] == len(ends) and bool(np.isfinite(along.flows).all())
        for along in out.along
    )
    sets = {}
    for t, (name, tap) in enumerate(rig.taps.items()):
        own = volume_of_tap(volume, tap)
        if own not in fed:
            seen = {own}
        else:
            seen = {side for pair in joined if own in pair for side in pair} - fed - {""}
        words = ("fill", "exhaust")
        if known and seen and any(seen & set(pair) for pair in joined):
            sign = np.array([float(b in seen) - float(a in seen) for a, b in joined])
            rates = [along.flows[0] @ sign for along in out.along]
        else:
            rates, words = (
                [_rise(along.taps[0, :, t]) for along in out.along],
                ("rising", "falling"),
            )
        limit = STILL * float(np.nanpercentile(np.abs(np.concatenate(rates)), 99))
        sets[name] = [
            Ticks("flow_direction", words[0], [r > limit for r in rates]),
            Ticks("flow_direction", words[1], [r < -limit for r in rates]),
            Ticks("flow_direction", "still", [np.abs(r) <= limit for r in rates]),
        ]
    return sets


def _rise(pressure: Floats) -> Floats:
    """(ticks,) rate of change of a predicted pressure, Pa/s."""
    width = max(3, round(SMOOTHING_S / TICK_S))
    return np.asarray(np.gradient(uniform_filter1d(pressure, width, mode="nearest"), TICK_S))


def _level_sets(problem: Problem, sensor: int, unit: str | None) -> list[SampleSet]:
    """Equal bands of what was measured; none for a sensor that stands still.

    Args:
        problem: The problem.
        sensor: Number of the sensor.
        unit: The unit of an encoder; None is a tap.
    """
    measured = problem.target()[:, :, sensor]
    good = np.isfinite(measured)
    if not good.any():
        return []
    low, high = np.percentile(measured[good], [1.0, 99.0])
    if high - low < 20.0 * problem.noise_pa[sensor]:
        return []
    edges = np.linspace(low, high, LEVELS + 1)
    band = np.digitize(np.nan_to_num(measured, nan=low), edges[1:-1])
    return [
        SampleSet(
            "pressure" if unit is None else "position",
            f"{a / 1e5:.2f}-{b / 1e5:.2f} bar" if unit is None else f"{a:.3g} to {b:.3g} {unit}",
            good & (band == k),
            lower=float(a),
            upper=float(b),
        )
        for k, (a, b) in enumerate(pairwise(edges.tolist()))
    ]


@dataclass(frozen=True)
class Band:
    """The part of an error in one band of frequencies.

    Attributes:
        label: Which band it is.
        low_hz: Where it begins.
        high_hz: Where it ends; None for the last.
        share: Its share of the squared error.
        white: The share that white noise would have.
    """

    label: str
    low_hz: float
    high_hz: float | None
    share: float
    white: float


def frequency_shares(error: Floats, time_s: Floats) -> list[Band]:
    """Shares of a squared error by frequency, from windowed transforms at the readings' own times.

    Args:
        error: (n_stretches, horizon) error; NaN where there is none.
        time_s: (n_stretches, horizon) times, s.

    Returns:
        The bands up to half the mean sampling rate, lowest first.
    """
    rows = [
        (e[good], t[good])
        for e, t in zip(*_blocks(error, time_s), strict=True)
        if (good := np.isfinite(e)).sum() > FEWEST
    ]
    if not rows:
        return []
    period = float(np.median(np.concatenate([np.diff(t) for _, t in rows])))
    length = float(np.median([t[-1] - t[0] for _, t in rows])) + period
    frequency = np.arange(int(0.5 * length / period) + 1) / length
    power = np.zeros(frequency.size)
    for e, t in rows:
        place = (t - t[0] + period) / (t[-1] - t[0] + 2.0 * period)
        window = np.sin(np.pi * place) ** 2
        # Multiples of one frequency are powers of one wave: a tenth of as many exponentials. Summed
        # without BLAS, whose threads wait for each other thousands of times where a core is taken.
        wave = np.empty((frequency.size, t.size), dtype=complex)
        wave[0], wave[1:] = e * window, np.exp(-2j * np.pi * (t - t[0]) / length)
        np.multiply.accumulate(wave, axis=0, out=wave)
        power += np.abs(wave.sum(axis=1)) ** 2
    weight = np.full(frequency.size, 2.0)  # both signs of a frequency; zero and the last have one
    weight[0] = 1.0
    weight[-1] = 1.0
    total = float(np.sum(weight * power))
    edges = [edge for edge in FREQUENCY_EDGES_HZ if edge < 0.5 / period]
    out = []
    for k, low in enumerate(edges):
        last = k == len(edges) - 1
        high = np.inf if last else edges[k + 1]
        inside = (frequency >= low) & (frequency < high)
        if not inside.any():
            continue
        if low == 0.0:
            label = f"below {high:g} Hz" if not last else "all frequencies"
        else:
            label = f"{low:g}-{high:g} Hz" if not last else f"above {low:g} Hz"
        share = float(np.sum((weight * power)[inside])) / total if total > 0.0 else 0.0
        white = float(weight[inside].sum() / weight.sum())
        out.append(Band(label, low, None if last else high, share, white))
    return out


def _blocks(error: Floats, time_s: Floats) -> tuple[list[Floats], list[Floats]]:
    """Stretches cut into pieces that are transformed one by one."""
    pieces = max(1, -(-error.shape[1] // LONGEST_TRANSFORM))
    return (
        [part for row in error for part in np.array_split(row, pieces)],
        [part for row in time_s for part in np.array_split(row, pieces)],
    )
