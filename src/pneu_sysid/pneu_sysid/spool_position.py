# SPDX-License-Identifier: Apache-2.0
"""Spools identified from their own measured positions alone, without any gas (thesis 6.2).

Where a recording holds how the spool moved, it tells bandwidth, damping, delays and limits (thesis
eq. 5.4, corrected) more directly than any pressure does. A limit that is never reached has no slope
to follow, so limits and delays of closing are tried, fitted, and kept only where they are worth it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pneu_common.errors import InputError
from pneu_sim.rig.build import spool_row
from pneu_sim.rig.schema import Rig, Spool
from pneu_sim.signals import Signal
from pneu_sim.valve import positions_along
from pneu_sysid.gauss_newton import left_out_moves
from pneu_sysid.records import Recording

Floats = NDArray[np.float64]
Values = dict[str, float]
"""What is free of a spool, by its fields."""

SPEED, ACCELERATION, CLOSING = "max_speed_v_s", "max_acceleration_v_s2", "closing_delay_s"
LAG = ("bandwidth_hz", "damping")
BOUNDS = {
    "bandwidth_hz": (0.3, 1000.0),
    "damping": (0.05, 20.0),
    "delay_s": (0.0, 0.25),
    CLOSING: (0.0, 0.25),
    SPEED: (0.1, 1e7),
    ACCELERATION: (1.0, 1e10),
}
"""What is looked for."""
DELAYS = ("delay_s", CLOSING)
"""These may be 0 and are stepped by amounts; the others are positive and stepped in proportion."""
NUDGE, NUDGE_S = 1e-4, 1e-5
"""Steps of the slopes: relative ones, and those of delays."""

BANDWIDTHS_HZ = (3.0, 6.0, 12.0, 25.0, 50.0, 100.0, 200.0)
DAMPINGS = (0.5, 1.2)
DELAYS_S = (0.0, 3e-3, 8e-3, 20e-3)
"""Where the fit may start."""
SPEEDS = (0.8, 0.55, 0.35, 0.2)
"""Limits of the speed, in parts of the largest that the spool without one reaches."""
ACCELERATIONS = (0.6, 0.35, 0.2, 0.1, 0.05)
"""Limits of the acceleration, likewise."""
FASTER = (1.0, 1.4, 2.0, 3.0)
"""A spool with a limit is as much faster where it is not reached."""
APART_S = (-8e-3, -3e-3, -1e-3, 1e-3, 3e-3, 8e-3)
"""By how much later than opening closing may act."""

ROUGH, FINE, FINEST = 0.2, 0.045, 0.01
"""Radians of the spool's frequency between knots: while starts are tried, in fits, in the last."""
MOST_KNOTS = {ROUGH: 10.0, FINE: 20.0, FINEST: 80.0}
"""... but no more knots between two readings than these."""
MOST_STEP_S = 1e-3
"""Longest interval of the knots."""
RESOLVED_V = 1e-3
"""Errors below this are the grid's and the converter's, and no evidence for anything."""
SETTLED_S = 0.2
"""Readings so soon after the first command known answer to one that is not."""
BEFORE_S = 1.0
"""So long before the first reading a spool that is reckoned at rest may well have moved."""
BLOCK_S = 0.5
"""Errors farther apart than this are independent."""
LEAST_GAIN, MOST_GAIN = 0.5, 2.0
"""Volts measured per volt commanded that a sensor may show; beyond it is in other units."""


@dataclass(frozen=True)
class SpoolFit:
    """A spool as its measured positions tell it.

    Attributes:
        spool: The spool. What the positions do not tell (backlash, null, dead-band, the integral
            term) is the rig's; so is a limit or delay of closing in the rig that no recording
            contradicts or confirms.
        std_error: Standard error by path, such as ``valves.valve.spool.bandwidth_hz``, of all that
            was fitted, robust to errors that are alike for up to half a second; infinite where the
            recordings tell nothing.
        rms_v: Measured minus predicted, root mean square, V.
        limits: Which limits the positions show: ``max_speed_v_s``, ``max_acceleration_v_s2``.
        gain: Volts the sensor shows per volt of position.
        offset_v: What it shows at 0 V.
        readings: How many were compared.
    """

    spool: Spool
    std_error: dict[str, float]
    rms_v: float
    limits: tuple[str, ...]
    gain: float
    offset_v: float
    readings: int


def fit_spools(rig: Rig, recordings: Recording | Sequence[Recording]) -> dict[str, SpoolFit]:
    """Identifies the spools of all valves whose position was measured.

    Every valve is fitted by itself, to all recordings at once. The command's and the sensor's clock
    have to be one: what they differ by is delay. Effects attached to the rig are not applied.

    Args:
        rig: The rig; its spools are where the fit starts, besides usual values.
        recordings: The recordings.

    Returns:
        Per valve what was found. Valves without a measured position are left out, as are those
        whose command never changes.

    Raises:
        InputError: A measured position is not in volts of command.
    """
    recordings = [recordings] if isinstance(recordings, Recording) else list(recordings)
    found = {}
    for name, valve in rig.valves.items():
        seen = [
            (r.name, piece)
            for r in recordings
            if name in r.positions
            and valve.command in r.commands
            and (piece := _piece(r.commands[valve.command], r.positions[name])) is not None
        ]
        if seen:
            data = _Data([piece for _, piece in seen], valve.spool)
            found[name] = _fit(rig, name, data, ", ".join(dict.fromkeys(n for n, _ in seen)))
    return found


@dataclass(frozen=True)
class _Piece:
    """What is compared of one recording: a command, readings, and when the spool sets out."""

    command: Signal
    measured: Signal
    begin_s: float


def _piece(command: Signal, measured: Signal) -> _Piece | None:
    """What a recording tells of a spool; None where its command never changes."""
    if len(command) < 2 or len(measured) < 2:
        return None
    known, first, last = float(command.time_s[0]), measured.time_s[0], measured.time_s[-1]
    settled = known + min(SETTLED_S, 0.1 * float(last - known))
    measured = measured.within(max(settled, float(first)), float(last))
    if not len(measured):
        return None
    begin = max(known, float(measured.time_s[0]) - BEFORE_S)
    acting = command.values[(command.time_s > begin) & (command.time_s < last)]
    if np.all(acting == command.held(begin)):
        return None
    return _Piece(command, measured, begin)


@dataclass(frozen=True)
class _Found:
    """A spool that was fitted.

    Attributes:
        values: What was free.
        residual: (n,) measured minus predicted, V.
        step_s: Interval of the knots.
    """

    values: Values
    residual: Floats
    step_s: float

    @property
    def cost(self) -> float:
        """Sum of the squared errors, V^2."""
        return float(self.residual @ self.residual)


class _Data:
    """All that was measured of one spool, and what a spool would have done."""

    def __init__(self, pieces: list[_Piece], given: Spool) -> None:
        self.pieces = pieces
        self.given = given
        self.measured = np.concatenate([p.measured.values for p in pieces])
        periods = [p.measured.period_s for p in pieces]
        self.period_s = float(np.median(periods))
        self.blocks = self._blocks()

    def _blocks(self) -> NDArray[np.int64]:
        """(n,) which block of time each reading belongs to, over all recordings."""
        parts: list[NDArray[np.int64]] = []
        first = 0
        for p in self.pieces:
            block = ((p.measured.time_s - p.measured.time_s[0]) / BLOCK_S).astype(np.int64)
            parts.append(first + block)
            first += int(block[-1]) + 1
        return np.concatenate(parts)

    def spool(self, values: Values) -> Spool:
        """The spool with some values, and without the lag, limits and delay that are not there."""
        free: dict[str, float | None] = dict.fromkeys(
            ("bandwidth_hz", SPEED, ACCELERATION, CLOSING)
        )
        return self.given.model_copy(update=free | values)

    def step_s(self, values: Values, angle: float) -> float:
        """Interval of the knots that suits a spool: radians of its frequency between them."""
        least = self.period_s / MOST_KNOTS[angle]
        if "bandwidth_hz" not in values:
            return least
        return max(min(angle / (2.0 * math.pi * values["bandwidth_hz"]), MOST_STEP_S), least)

    def paths(self, values: Values, step_s: float) -> list[Floats]:
        """Per recording where a spool stands at every knot, V."""
        row = spool_row(self.spool(values))
        paths = []
        for p in self.pieces:
            count = math.ceil((float(p.measured.time_s[-1]) - p.begin_s) / step_s) + 2
            paths.append(positions_along(row, p.command, p.begin_s, step_s, count))
        return paths

    def predict(self, values: Values, step_s: float) -> Floats:
        """(n,) where a spool stands at the readings' own times, V."""
        parts = []
        for p, path in zip(self.pieces, self.paths(values, step_s), strict=True):
            knots = p.begin_s + step_s * np.arange(path.size)
            parts.append(np.interp(p.measured.time_s, knots, path))
        return np.concatenate(parts)

    def sensor(self, position: Floats) -> tuple[float, float]:
        """Gain and offset of the sensor that fit best to a course."""
        away = position - position.mean()
        spread = float(away @ away)
        gain = float(away @ self.measured) / spread if spread > 0.0 else 1.0
        return gain, float(self.measured.mean() - gain * position.mean())

    def residual(self, values: Values, step_s: float) -> Floats:
        """(n,) measured minus predicted as the best sensor shows it, V."""
        position = self.predict(values, step_s)
        gain, offset = self.sensor(position)
        return np.asarray(self.measured - gain * position - offset)

    def bounds(self, field: str) -> tuple[float, float]:
        """What a value may be."""
        low, high = BOUNDS[field]
        if field == "bandwidth_hz":  # what is over between two readings is at once
            high = min(high, max(1.0 / self.period_s, 2.0 * low))
        return low, high

    def clipped(self, values: Values) -> Values:
        """Values within what is looked for."""
        return {f: float(np.clip(v, *self.bounds(f))) for f, v in values.items()}


# ---- fitting -------------------------------------------------------------------------------


def _coded(values: Values) -> Floats:
    """Values as the solver has them: logarithms, and delays in milliseconds."""
    return np.array([1e3 * v if f in DELAYS else math.log(v) for f, v in values.items()])


def _decoded(code: Floats, fields: Sequence[str]) -> Values:
    return {
        f: 1e-3 * float(c) if f in DELAYS else math.exp(c)
        for f, c in zip(fields, code, strict=True)
    }


def _nudges(fields: Sequence[str]) -> Floats:
    return np.array([1e3 * NUDGE_S if f in DELAYS else NUDGE for f in fields])


def _polished(data: _Data, start: Values, angle: float = FINE) -> _Found:
    """The spool that fits best, from a start; what the start has not stays away."""
    start = data.clipped(start)
    fields = list(start)
    step_s = data.step_s(start, angle)
    low, high = (_coded({f: max(data.bounds(f)[k], 0.0) for f in fields}) for k in (0, 1))
    nudges = _nudges(fields)

    def residual(code: Floats) -> Floats:
        return data.residual(_decoded(code, fields), step_s)

    def slopes(code: Floats) -> Floats:
        here = residual(code)
        columns = []
        for k, nudge in enumerate(nudges):
            moved = code.copy()
            moved[k] += nudge if code[k] + nudge <= high[k] else -nudge
            columns.append((residual(moved) - here) / (moved[k] - code[k]))
        return np.stack(columns, axis=1)

    slack = 1e-9 * (high - low)
    solved = least_squares(
        residual,
        np.clip(_coded(start), low + slack, high - slack),
        jac=slopes,
        bounds=(low, high),
        method="trf",
        x_scale="jac",
        xtol=1e-7,
        ftol=1e-7,
        max_nfev=40,
    )
    values = _decoded(np.asarray(solved.x), fields)
    step_s = data.step_s(values, angle)  # of starts far off the knots were, too
    return _Found(values, data.residual(values, step_s), step_s)


def _best(data: _Data, starts: Sequence[Values], most: int) -> _Found:
    """The best of the fits from the most promising of some starts."""
    starts = [data.clipped(start) for start in starts]
    if len(starts) > most:
        costs = []
        for start in starts:
            r = data.residual(start, data.step_s(start, ROUGH))
            costs.append(float(r @ r))
        starts = [starts[k] for k in np.argsort(costs, kind="stable")[:most]]
    return min((_polished(data, start) for start in starts), key=lambda found: found.cost)


def _evidence(found: _Found, among: _Found) -> float:
    """What a spool costs by the Bayesian criterion, given how alike neighbouring errors are.

    Args:
        found: The spool.
        among: The one of those compared whose errors are taken for noise.
    """
    n = found.residual.size
    independent = n / _alike(among.residual)
    scatter = found.cost / n + RESOLVED_V**2
    return independent * math.log(scatter) + len(found.values) * math.log(max(independent, 2.0))


def _alike(residual: Floats) -> float:
    """How many neighbouring errors tell as much as one: the sum of their correlations."""
    r = residual - residual.mean()
    own = float(r @ r)
    if own <= 0.0:
        return 1.0
    total = 1.0
    for lag in range(1, min(200, r.size // 4)):
        alike = float(r[lag:] @ r[:-lag]) / own
        if alike < 0.05:
            break
        total += 2.0 * alike
    return total


def _better(new: _Found, old: _Found) -> bool:
    """Whether what a spool has more is worth it."""
    finer = min(new, old, key=lambda found: found.cost)
    return _evidence(new, finer) < _evidence(old, finer)


def _fit(rig: Rig, name: str, data: _Data, recordings: str) -> SpoolFit:
    """The spool of one valve."""
    given = data.given
    starts: list[Values] = [
        {"bandwidth_hz": b, "damping": z, "delay_s": d}
        for b in BANDWIDTHS_HZ
        for z in DAMPINGS
        for d in DELAYS_S
    ]
    if given.bandwidth_hz is not None:
        own = {"bandwidth_hz": given.bandwidth_hz, "damping": given.damping}
        starts.append({**own, "delay_s": given.delay_s})
    lagging = _best(data, starts, 3)
    _check_unit(rig, name, data, lagging, recordings)
    at_once = _best(data, [{"delay_s": d} for d in (*DELAYS_S, given.delay_s)], 2)
    plain = _extended(data, at_once)
    quick = {"bandwidth_hz": 0.3 * data.bounds("bandwidth_hz")[1], "damping": 0.8}
    lagged = _polished(data, {**quick, **plain.values})
    best = plain
    if _better(lagged, plain) or not _better(plain, lagging):  # else there is no lag to be seen
        same = lagged.values.keys() == lagging.values.keys() and math.isclose(
            lagged.cost, lagging.cost, rel_tol=1e-4
        )
        for start in (lagging,) if same else (lagging, lagged):
            other = _extended(data, start)
            best = other if _better(other, best) else best
    # What limits seemed to explain may have been the grid.
    best = _lean(data, _polished(data, best.values, FINEST))
    position = data.predict(best.values, best.step_s)
    gain, offset = data.sensor(position)
    return SpoolFit(
        spool=data.spool(_with_given(data, best)),
        std_error=_standard_errors(f"valves.{name}.spool", data, best),
        rms_v=float(np.sqrt(np.mean(best.residual**2))),
        limits=tuple(f for f in (SPEED, ACCELERATION) if f in best.values),
        gain=gain,
        offset_v=offset,
        readings=int(best.residual.size),
    )


def _extended(data: _Data, best: _Found) -> _Found:
    """A spool with the limits and the delay of closing that are worth it, one after the other."""
    while True:
        more = [
            _best(data, starts, 2)
            for fields in ((SPEED,), (ACCELERATION,), (SPEED, ACCELERATION), (CLOSING,))
            if (starts := _starts(data, best, fields))
        ]
        worth = [found for found in more if _better(found, best)]
        if not worth:
            return best
        finest = min(worth, key=lambda found: found.cost)
        best = min(worth, key=lambda found: _evidence(found, finest))


def _starts(data: _Data, best: _Found, fields: tuple[str, ...]) -> list[Values]:
    """Where the fit of a spool with more than the best one has may start."""
    values = best.values
    lags = "bandwidth_hz" in values
    if any(f in values for f in fields) or (ACCELERATION in fields and not lags):
        return []
    if fields == (CLOSING,):
        delay = values["delay_s"]
        later = {max(delay + apart, 0.0) for apart in APART_S} - {delay}
        return [{**values, CLOSING: closing} for closing in sorted(later)]
    paths = data.paths(values, best.step_s)
    speed = [np.diff(path) / best.step_s for path in paths]
    fastest = max(float(np.abs(v).max()) for v in speed)
    hardest = max(float(np.abs(np.diff(v)).max(initial=0.0)) for v in speed) / best.step_s
    if not lags:  # what follows at once has no speed; the readings' own is of that order
        fastest = float(np.abs(np.diff(data.measured)).max()) / data.period_s
    limits: list[Values] = [{}]
    for f, parts, most in ((SPEED, SPEEDS, fastest), (ACCELERATION, ACCELERATIONS, hardest)):
        if f in fields:
            limits = [{**one, f: part * most} for one in limits for part in parts]
    if not lags:
        return [{**values, **one} for one in limits]
    return [
        {**values, **one, "bandwidth_hz": values["bandwidth_hz"] * b}
        for one in limits
        for b in FASTER
    ]


def _lean(data: _Data, best: _Found) -> _Found:
    """A spool without what it does as well without, now that it has the rest, on the last grid."""
    for field in (SPEED, ACCELERATION, CLOSING):
        if field in best.values:
            less = _polished(data, {f: v for f, v in best.values.items() if f != field}, FINEST)
            if _better(less, best):
                best = less
    return best


def _with_given(data: _Data, best: _Found) -> Values:
    """What was found, with those limits and delays of the rig that it does not contradict.

    Recordings in which a limit is not reached say nothing against it.
    """
    values, cost = best.values, best.cost
    independent = best.residual.size / _alike(best.residual)
    floor = best.residual.size * RESOLVED_V**2
    for field in (SPEED, ACCELERATION, CLOSING):
        own = getattr(data.given, field)
        if own is None or field in values:
            continue
        r = data.residual({**values, field: own}, best.step_s)
        worse = independent * math.log((float(r @ r) + floor) / (cost + floor))
        if worse < math.log(max(independent, 2.0)):
            values, cost = {**values, field: own}, float(r @ r)
    return values


# ---- what is said of it --------------------------------------------------------------------


def _check_unit(rig: Rig, name: str, data: _Data, found: _Found, recordings: str) -> None:
    """Refuses a position that is not in volts of command.

    Raises:
        InputError: The sensor would show far more or less than the spool moves.
    """
    gain, _ = data.sensor(data.predict(found.values, found.step_s))
    if LEAST_GAIN <= gain <= MOST_GAIN:
        return
    channel = rig.valves[name].position
    where, scale = "", 1.0
    if channel is not None:
        source = f"topic {channel.topic}" if channel.topic else f"column {channel.column}"
        where, scale = f" ({source})", channel.scale
    text = (
        f"rig {rig.name!r}, recording {recordings}: valves.{name}.position{where}: found"
        f" {gain:.3g} V measured per volt of command, allowed are {LEAST_GAIN:g} to {MOST_GAIN:g}"
    )
    explained = 1.0 - found.cost / max(float(np.var(data.measured)) * data.measured.size, 1e-300)
    if explained < 0.5:
        raise InputError(f"{text}; is it the position of this valve's spool?")
    raise InputError(f"{text}; its channel seems to want scale: {scale / gain:.3g}, and an offset")


def _standard_errors(path: str, data: _Data, found: _Found) -> dict[str, float]:
    """Standard error of every value, by path: of leaving out blocks of time, one after the other.

    To first order, with the information of the block taken out too, as in the fit of the gas: a
    block that alone tells of a value has fitted it to its own errors. Never below that of errors
    without correlation, which blocks too few to scatter could undercut.
    """
    fields = list(found.values)
    code = _coded(found.values)
    position = data.predict(found.values, found.step_s)
    gain, _ = data.sensor(position)
    columns = []
    for k, nudge in enumerate(_nudges(fields)):
        ends = []
        for sign in (-1.0, 1.0):
            moved = code.copy()
            moved[k] += sign * nudge
            values = data.clipped(_decoded(moved, fields))
            ends.append((data.predict(values, found.step_s), _coded(values)[k]))
        (before, low), (after, high) = ends
        columns.append(gain * (after - before) / (high - low))
    jacobian = np.stack([*columns, position, np.ones(position.size)], axis=1)
    size = np.linalg.norm(jacobian, axis=0)
    told = size > 0.0
    jacobian = jacobian[:, told] / size[told]
    hessian = jacobian.T @ jacobian
    left = max(position.size - int(told.sum()), 1)
    white = found.cost / left + RESOLVED_V**2
    inverse = np.linalg.pinv(hessian, rcond=1e-12, hermitian=True)
    variance = white * np.diag(inverse)
    parts = [data.blocks == block for block in np.unique(data.blocks)]
    information = np.array([jacobian[mine].T @ jacobian[mine] for mine in parts])
    scores = np.array([jacobian[mine].T @ found.residual[mine] for mine in parts])
    moves = left_out_moves(hessian, information, scores)
    if len(moves) > 1:
        # At a bound the slopes do not add up to nothing; only what scatters counts.
        spread = moves - np.mean(moves, axis=0)
        scatter = (len(moves) - 1) / len(moves) * np.sum(spread**2, axis=0)
        variance = np.maximum(variance, scatter)
    error = np.full(told.size, np.inf)
    error[told] = np.sqrt(variance) / size[told]
    if "bandwidth_hz" not in fields and SPEED not in fields:
        # A spool that jumps between two readings tells that it did, whatever the slopes say.
        error[: len(fields)] = 1e3 * data.period_s / math.sqrt(12.0)
    return {
        f"{path}.{f}": float(error[k]) * (1e-3 if f in DELAYS else found.values[f])
        for k, f in enumerate(fields)
    }
