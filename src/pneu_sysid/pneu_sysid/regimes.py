# SPDX-License-Identifier: Apache-2.0
"""What a rig was doing at each sample: flow direction, choking, valve opening, pressure, time."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from pneu_sim import layout as L
from pneu_sim.gas import AIR
from pneu_sim.rig.build import Plan, build, plan_grid
from pneu_sim.rig.schema import CLOSED, Rig
from pneu_sim.simulate import Rollouts, initial_field
from pneu_sim.valve import KNOTS_PER_SAMPLE, openings
from pneu_sysid.problem import Problem
from pneu_sysid.results import RegimeKind

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SHUT = 0.005
"""A valve open by less counts as closed."""
OPENING_EDGES = ((SHUT, "closed"), (0.1, "below 10 % open"), (0.5, "10-50 % open"))
WIDE_OPEN = "above 50 % open"
STILL = 0.02
"""A flow (or rate of change) below this part of its 99th percentile counts as none."""
SMOOTHING_S = 0.02
LEVELS = 3
FREQUENCY_EDGES_HZ = (0.0, 5.0, 20.0, 60.0, 150.0)
BLOCK_S = 1.0
FEWEST = 5
"""A regime of fewer samples is not reported."""


@dataclass(frozen=True)
class SampleSet:
    """The samples of one regime.

    Attributes:
        kind: By what the samples are divided.
        label: Which part this is.
        mask: (n_starts, horizon) which samples belong to it.
    """

    kind: RegimeKind
    label: str
    mask: Mask


@dataclass(frozen=True)
class Operation:
    """What a rig did along the roll-outs of a problem.

    Attributes:
        time_s: (n_starts, horizon) time of each sample.
        common: Sample sets that hold for every tap: openings, choking, time.
        by_tap: Sample sets of single taps: flow direction, pressure.
    """

    time_s: Floats
    common: list[SampleSet]
    by_tap: dict[str, list[SampleSet]]

    def sets(self, tap: str) -> list[SampleSet]:
        """All sample sets of a tap.

        Args:
            tap: Its name.
        """
        return self.by_tap.get(tap, []) + self.common


def operation(problem: Problem, rig: Rig, out: Rollouts) -> Operation:
    """Finds out what a rig did, from its commands and from what one model of it predicts.

    Args:
        problem: The roll-outs.
        rig: The rig.
        out: Its roll-outs, the rig being the only one of its batch.
    """
    windows = problem.windows()
    time = problem.recording.time_s[windows]
    plan = plan_grid(rig, problem.dx_m)
    model = build(rig, plan)
    n = problem.recording.time_s.size
    opened = openings(model, problem.recording.commands or {"": np.zeros(n)}, problem.dt_s)
    opened = opened[::KNOTS_PER_SAMPLE][windows]
    common = _opening_sets(plan, opened)
    common += _choked_sets(rig, plan, model.port, opened, out.readings[0])
    for b in range(int(time.max() // BLOCK_S) + 1):
        mask = (time >= b * BLOCK_S) & (time < (b + 1) * BLOCK_S)
        common.append(SampleSet("time", f"{b * BLOCK_S:g}-{(b + 1) * BLOCK_S:g} s", mask))
    directions = _directions(problem, rig, plan, out.flows[0])
    by_tap = {tap: directions[tap] + _level_sets(problem, t) for t, tap in enumerate(problem.taps)}
    return Operation(
        time,
        [s for s in common if s.mask.sum() >= FEWEST],
        {tap: [s for s in sets if s.mask.sum() >= FEWEST] for tap, sets in by_tap.items()},
    )


def _opening_sets(plan: Plan, opened: Floats) -> list[SampleSet]:
    """By how far each valve's widest port is open."""
    sets = []
    for v, name in enumerate(plan.valves):
        ports = [q for q, of in enumerate(plan.port_valve) if of == v]
        widest = opened[:, :, ports].max(axis=2)
        band = np.digitize(widest, [edge for edge, _ in OPENING_EDGES])
        labels = [label for _, label in OPENING_EDGES] + [WIDE_OPEN]
        for k, label in enumerate(labels):
            sets.append(SampleSet("opening", f"{name} {label}", band == k))
    return sets


def _choked_sets(
    rig: Rig, plan: Plan, port: Floats, opened: Floats, readings: Floats
) -> list[SampleSet]:
    """By whether the flow through each open port is sonic."""
    field = initial_field(rig, plan)

    def side(kind: int, index: int) -> Floats:
        if kind == L.SIDE_RESERVOIR:
            pressure = list(rig.reservoirs.values())[index].pressure_pa
            return np.full(readings.shape[:2], pressure)
        if kind == L.SIDE_CHAMBER:
            weight, constant = field.chamber_weight[index], field.chamber_constant[index]
        else:
            slot = plan.ends[index, L.E_CELL]
            weight, constant = field.weight[slot], field.constant[slot]
        return np.asarray(readings @ weight + constant)

    sonic = float((2.0 / (AIR.gamma + 1.0)) ** (AIR.gamma / (AIR.gamma - 1.0)))
    sets = []
    for q, name in enumerate(plan.port_names):
        a = side(int(plan.ports[q, L.P_A]), int(plan.ports[q, L.P_AI]))
        b = side(int(plan.ports[q, L.P_B]), int(plan.ports[q, L.P_BI]))
        high, low = np.maximum(a, b), np.minimum(a, b)
        iso = plan.ports[q, L.P_MODE] == L.ISO6358
        critical = float(port[q, L.Q_RATIO]) if iso else sonic
        choked = low <= critical * high
        is_open = opened[:, :, q] > SHUT
        sets.append(SampleSet("choked", f"{name} choked", is_open & choked))
        sets.append(SampleSet("choked", f"{name} not choked", is_open & ~choked))
    return sets


def _volumes(rig: Rig) -> tuple[dict[str, str], set[str]]:
    """Which nodes and pipes hang together without a valve between, and which meet a reservoir.

    Returns:
        Volume (any one of its nodes or pipes) of every node and ``pipe:name``, and the fed ones.
    """
    root: dict[str, str] = {}

    def find(item: str) -> str:
        root.setdefault(item, item)
        while root[item] != item:
            item = root[item]
        return item

    for node in rig.chambers:
        find(node)
    for name, pipe in rig.pipes.items():
        for node in (pipe.from_node, pipe.to_node):
            if node != CLOSED and node not in rig.reservoirs:
                root[find(f"pipe:{name}")] = find(node)
    volume = {item: find(item) for item in [*root, *(f"pipe:{name}" for name in rig.pipes)]}
    fed = {
        volume[f"pipe:{name}"]
        for name, pipe in rig.pipes.items()
        if pipe.from_node in rig.reservoirs or pipe.to_node in rig.reservoirs
    }
    return volume, fed


def _directions(
    problem: Problem, rig: Rig, plan: Plan, flows: Floats
) -> dict[str, list[SampleSet]]:
    """Flow direction per tap: filling and exhausting of the closed volume it sees.

    That is the volume the tap sits in, or, where this is open to a reservoir, the closed volumes
    behind its valve ports. Where a rig has none, the tap's own rise and fall take their place.
    """
    volume, fed = _volumes(rig)
    ends = [
        (port.from_node, port.to_node)
        for valve in rig.valves.values()
        for port in valve.ports.values()
    ] + [(orifice.from_node, orifice.to_node) for orifice in rig.orifices.values()]
    joined = [(volume.get(a, ""), volume.get(b, "")) for a, b in ends]
    known = flows.shape[-1] == len(plan.port_names) and bool(np.isfinite(flows).all())

    def inflow(where: set[str]) -> Floats:
        sign = [float(b in where) - float(a in where) for a, b in joined]
        return np.asarray(flows @ np.array(sign))

    sets = {}
    for t, (name, tap) in enumerate(rig.taps.items()):
        own = volume[f"pipe:{tap.pipe}" if tap.pipe is not None else str(tap.chamber)]
        if own not in fed:
            seen = {own}
        else:
            seen = {side for pair in joined if own in pair for side in pair} - fed - {""}
        words = ("fill", "exhaust")
        if known and seen and any(seen & set(pair) for pair in joined):
            rate = inflow(seen)
        else:
            rate, words = _rise(problem, t), ("rising", "falling")
        limit = STILL * float(np.nanpercentile(np.abs(rate), 99)) if rate.size else 0.0
        up, down = rate > limit, rate < -limit
        sets[name] = [
            SampleSet("flow_direction", words[0], up),
            SampleSet("flow_direction", words[1], down),
            SampleSet("flow_direction", "still", ~up & ~down),
        ]
    return sets


def _rise(problem: Problem, tap: int) -> Floats:
    """(n_starts, horizon) rate of change of a measured pressure, Pa/s; 0 where it is missing."""
    series = problem.measured[:, tap]
    good = np.isfinite(series)
    if good.sum() < 2:
        return np.zeros((len(problem.starts), problem.horizon))
    index = np.arange(series.size)
    filled = np.interp(index, index[good], series[good])
    width = max(3, round(SMOOTHING_S / problem.dt_s))
    rate = np.gradient(uniform_filter1d(filled, width, mode="nearest"), problem.dt_s)
    return np.asarray(rate[problem.windows()])


def _level_sets(problem: Problem, tap: int) -> list[SampleSet]:
    """Equal bands of the measured pressure; none for a tap that stands still."""
    measured = problem.target()[:, :, tap]
    good = np.isfinite(measured)
    if not good.any():
        return []
    low, high = np.percentile(measured[good], [1.0, 99.0])
    if high - low < 20.0 * problem.noise_pa[tap]:
        return []
    edges = np.linspace(low, high, LEVELS + 1)
    band = np.digitize(np.nan_to_num(measured, nan=low), edges[1:-1])
    return [
        SampleSet(
            "pressure",
            f"{edges[k] / 1e5:.2f}-{edges[k + 1] / 1e5:.2f} bar",
            good & (band == k),
        )
        for k in range(LEVELS)
    ]


def frequency_shares(error: Floats, dt_s: float) -> list[tuple[str, float, float]]:
    """Shares of a squared error by frequency, from windowed transforms of the roll-outs.

    Args:
        error: (n_starts, horizon) error, 0 where it is not known.
        dt_s: Sample interval, s.

    Returns:
        Label, share of the squared error, and share that white noise would have, for each band up
        to half the sampling rate.
    """
    window = np.hanning(error.shape[1] + 2)[1:-1]
    power = (np.abs(np.fft.rfft(error * window, axis=1)) ** 2).sum(axis=0)
    frequency = np.fft.rfftfreq(error.shape[1], dt_s)
    weight = np.full(frequency.size, 2.0)  # both signs of a frequency; zero and the last have one
    weight[0] = 1.0
    if error.shape[1] % 2 == 0:
        weight[-1] = 1.0
    total = float(np.sum(weight * power))
    nyquist = 0.5 / dt_s
    edges = [edge for edge in FREQUENCY_EDGES_HZ if edge < nyquist]
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
        out.append((label, share, float(weight[inside].sum() / weight.sum())))
    return out
