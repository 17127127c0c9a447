# SPDX-License-Identifier: Apache-2.0
"""How a recording may begin, and what of its beginning the readings do not tell."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pneu_sim.gas import AIR
from pneu_sim.rig.cells import middles
from pneu_sim.rig.network import volume_of_tap, volumes_of
from pneu_sim.rig.plan import Plan
from pneu_sim.rig.schema import Rig
from pneu_sim.simulate import InitialField, Start, rest
from pneu_sysid.records import Recording

Floats = NDArray[np.float64]

EARLIEST_S = 10.0
"""Commands from before the first reading count this far back."""
FIRST_S, FEWEST_FIRST = 0.03, 5
"""Over this time, and of so many readings at least, an encoder tells how fast its joint moves."""
SPEED_SHARE = 0.2
"""... which is uncertain by this share of how fast it moves in the recording, one sigma."""
TEMPERATURE_K = 30.0
"""How far gas in motion may be from the room's temperature, one sigma."""
POSSIBLE_K = (150.0, 600.0)
"""Temperatures that gas in a rig may have."""
UNSEEN = 0.2
"""Uncertainty of the pressure of a volume without a tap, of the highest pressure around."""
READING_SIGMAS = 3.0
"""Uncertainty of the pressure of a volume with a tap, in deviations of its sensor."""
REMEMBERED = 6.0
"""For so many of the slowest thermal time constants the beginning is remembered."""
REMEMBERED_S = (1.0, 30.0)
"""... but no shorter or longer than this."""
FEWEST_LATE = 8
"""Of fewer readings nothing can be said of how long an error lasts."""


@dataclass(frozen=True)
class Beginning:
    """One way in which a recording may begin.

    Attributes:
        begin_s: When the run begins, s.
        start: Gas and spools then.
    """

    begin_s: float
    start: Start


@dataclass(frozen=True)
class Mode:
    """Something that is not known of a beginning.

    Attributes:
        start: The beginning with it changed.
        step: By how much.
        std: How uncertain it is, one sigma.
    """

    start: Start
    step: float
    std: float


@dataclass(frozen=True)
class Modes:
    """How the predictions along a recording depend on what is not known of its beginning.

    Attributes:
        change: (K, n_stretches, horizon, n_taps) in noise deviations per unit.
        std: (K,) uncertainty of each.
        doubt: By how much what a model leaves for other reasons says less than white noise of its
            sensors would, see `doubt_of`.
    """

    change: Floats
    std: Floats
    doubt: float = 1.0

    def amounts(self, residual: Floats) -> Floats:
        """How far each most likely was from what was taken for it (ridge regression).

        Args:
            residual: (n_rigs, n_stretches, horizon, n_taps) in noise deviations.

        Returns:
            (n_rigs, K), in units of ``std``.
        """
        a = self._scaled()
        r = residual.reshape(residual.shape[0], -1)
        return np.asarray(np.linalg.solve(a @ a.T + self.doubt * np.eye(self.std.size), a @ r.T).T)

    def explain(self, residual: Floats) -> Floats:
        """The part of residuals that the beginning most likely made.

        Args:
            residual: (n_rigs, n_stretches, horizon, n_taps) in noise deviations.

        Returns:
            The same shape.
        """
        return np.asarray((self.amounts(residual) @ self._scaled()).reshape(residual.shape))

    def _scaled(self) -> Floats:
        """(K, n) changes per deviation."""
        return np.asarray((self.change * self.std[:, None, None, None]).reshape(self.std.size, -1))


def doubt_of(residual: Floats, late: NDArray[np.bool_]) -> float:
    """By how much less residuals say than unit white noise would, from what is left later on.

    Their mean square times their integrated autocorrelation time, summed up to its first zero.

    Args:
        residual: (n_taps, m) in noise deviations; 0 where nothing is compared.
        late: (n_taps, m) which of them the beginning has no part in.

    Returns:
        The largest of all taps, no less than 1.
    """
    doubt = 1.0
    for values, chosen in zip(residual, late & (residual != 0.0), strict=True):
        r = values[chosen]
        if r.size < FEWEST_LATE:
            continue
        power = np.abs(np.fft.rfft(r, 2 * r.size)) ** 2
        rho = np.fft.irfft(power)[: r.size] / float(np.sum(r * r))
        end = int(np.argmax(rho <= 0.0)) or r.size
        doubt = max(doubt, float(np.mean(r * r)) * (1.0 + 2.0 * float(rho[1:end].sum())))
    return doubt


def moved(
    start: Start, wanted: list[Mode], amounts: Floats, room_k: float, walls_k: Floats
) -> Start:
    """A beginning with what is not known of it changed.

    Args:
        start: The beginning.
        wanted: What is not known of it.
        amounts: (K,) by how many deviations of each.
        room_k: Temperature of the lines where none is given, K.
        walls_k: (n_chambers,) the same for the chambers.
    """
    pressure, chamber = start.pressure.copy(), start.chamber_pressure.copy()
    warm = np.full(pressure.size, room_k) if start.temperature is None else start.temperature.copy()
    heat = walls_k.copy() if start.chamber_temperature is None else start.chamber_temperature.copy()
    joints = None if start.joints is None else start.joints.copy()
    for mode, amount in zip(wanted, amounts, strict=True):
        share = amount * mode.std / mode.step
        pressure += share * (mode.start.pressure - start.pressure)
        chamber += share * (mode.start.chamber_pressure - start.chamber_pressure)
        if joints is not None and mode.start.joints is not None and start.joints is not None:
            joints += share * (mode.start.joints - start.joints)
        if mode.start.temperature is not None:
            warm += share * (mode.start.temperature - _or(start.temperature, room_k, warm.size))
        if mode.start.chamber_temperature is not None:
            heat += share * (
                mode.start.chamber_temperature
                - (walls_k if start.chamber_temperature is None else start.chamber_temperature)
            )
    return replace(
        start,
        pressure=np.maximum(pressure, 0.1 * start.pressure),
        chamber_pressure=np.maximum(chamber, 0.1 * start.chamber_pressure),
        temperature=np.clip(warm, *POSSIBLE_K),
        chamber_temperature=np.clip(heat, *POSSIBLE_K),
        joints=joints,
    )


def carried(start: Start, before: Plan, now: Plan) -> Start:
    """A beginning on another grid.

    Args:
        start: The beginning.
        before: Grid that it is on.
        now: Grid that it is wanted on, of the same pipes and chambers.
    """

    def along(values: Floats) -> Floats:
        out = np.empty(now.slots)
        for name, (first, n) in now.pipes.items():
            old_first, old_n = before.pipes[name]
            old = values[old_first : old_first + old_n]
            new = np.interp(middles(1.0, n), middles(1.0, old_n), old)
            # the ghost slots at both ends go with the outermost cells
            out[first - 1 : first + n + 1] = np.pad(new, 1, mode="edge")
        return out

    warm = None if start.temperature is None else along(start.temperature)
    return replace(start, pressure=along(start.pressure), temperature=warm)


def _or(values: Floats | None, constant: float, size: int) -> Floats:
    return np.full(size, constant) if values is None else values


def beginnings(rig: Rig, plan: Plan, field: InitialField, recording: Recording) -> list[Beginning]:
    """The ways in which a recording may begin.

    At rest with the room, at the first command; or with the pressures that the taps read first,
    spools closed or where the first command has them.

    Args:
        rig: The rig.
        plan: Its grid.
        field: Map from taps to pressures.
        recording: The recording.
    """
    room = rig.ambient.pressure_pa
    first_read = recording.start_s
    ordered = max((float(s.time_s[0]) for s in recording.commands.values()), default=first_read)
    begin = min(max(ordered, first_read - EARLIEST_S), first_read)
    read = np.full(len(rig.taps), room)
    for t, name in enumerate(rig.taps):
        signal = recording.pressures.get(name)
        if signal is not None and len(signal):
            tap = rig.taps[name]
            read[t] = room + (signal.values[0] - tap.bias_pa - room) / tap.gain
    filled = Start(
        np.maximum(field.weight @ read + field.constant, 1.0),
        np.maximum(field.chamber_weight @ read + field.chamber_constant, 1.0),
        joints=_joints(rig, plan, recording),
    )
    ways = [Beginning(first_read, filled)]
    if rig.fit.horizon_s is not None and rig.commands:
        ways += [
            Beginning(begin, _still(rest(rig, plan), filled)),
            Beginning(first_read, replace(filled, at_null=True)),
        ]
    return ways


def _still(start: Start, read: Start) -> Start:
    """A start at rest whose joints stand where another's do."""
    if read.joints is None:
        return start
    return replace(start, joints=read.joints * [1.0, 0.0])


def _joints(rig: Rig, plan: Plan, recording: Recording) -> Floats | None:
    """(n_joints, 2) where the encoders first read the joints, and how fast they moved.

    The first readings decide, by a straight line through them; other joints are where the rig has
    them. Those of a piston whose encoder is on the cylinder likewise, as near as its stroke lets.
    """
    if not plan.joints:
        return None
    joints = np.zeros((len(plan.joints), 2))
    joints[:, 0] = [joint.start for body in rig.bodies.values() for joint in body.joints]
    held = [joint.held for body in rig.bodies.values() for joint in body.joints]
    for name, on in zip(plan.encoders, plan.encoder_of, strict=True):
        signal, encoder = recording.encoders.get(name), rig.encoders[name]
        if on < 0 or held[on] or signal is None or not len(signal):
            continue
        early = signal.time_s <= signal.time_s[0] + FIRST_S
        first = (signal.values[early] - encoder.bias) / encoder.gain
        since = signal.time_s[early] - signal.time_s[0]
        if first.size < FEWEST_FIRST:
            joints[on] = first[0], 0.0
            continue
        slope, level = np.polyfit(since, first, 1)
        joints[on] = level, slope
    return joints


def remembered_s(rig: Rig, start: Start) -> float:
    """How long a rig remembers the temperature that its gas had at a beginning, s.

    A chamber forgets it within ``m c_v / (h A)``; the gas in lines, with far more wall to its
    volume, within a fraction of that. What a model is wrong about later says nothing of it.

    Args:
        rig: The rig.
        start: The beginning.
    """
    highest = max([r.pressure_pa for r in rig.reservoirs.values()], default=rig.ambient.pressure_pa)
    highest = max(highest, float(start.chamber_pressure.max(initial=0.0)))
    slowest = 0.0
    for chamber in rig.chambers.values():
        content = highest * chamber.volume_m3 / rig.ambient.temperature_k / (AIR.gamma - 1.0)
        slowest = max(slowest, content / max(chamber.heat_w_per_k, 1e-9))
    return float(np.clip(REMEMBERED * slowest, *REMEMBERED_S))


def modes_of(
    rig: Rig, plan: Plan, start: Start, taps: list[str], noise_pa: Floats, recording: Recording
) -> list[Mode]:
    """What is not known of a beginning: temperatures, pressures of closed volumes, joints' speeds.

    Args:
        rig: The rig.
        plan: Its grid.
        start: The beginning.
        taps: Names of the taps, then of the encoders.
        noise_pa: Their noise, Pa, rad or m.
        recording: The recording.
    """
    room = rig.ambient.temperature_k
    out = []
    volume, fed = volumes_of(rig)
    spans = {name: slice(f - 1, f + n + 1) for name, (f, n) in plan.pipes.items()}
    for name in rig.pipes:
        if volume[f"pipe:{name}"] in fed:
            continue  # what flows through is replaced at once
        warm = _or(start.temperature, room, plan.slots).copy()
        warm[spans[name]] += 0.2 * TEMPERATURE_K
        changed = replace(start, temperature=warm)
        out.append(Mode(changed, 0.2 * TEMPERATURE_K, TEMPERATURE_K))
    for c in range(len(plan.chambers)):
        heated = _or(start.chamber_temperature, room, len(plan.chambers)).copy()
        heated[c] += 0.2 * TEMPERATURE_K
        changed = replace(start, chamber_temperature=heated)
        out.append(Mode(changed, 0.2 * TEMPERATURE_K, TEMPERATURE_K))
    highest = max([r.pressure_pa for r in rig.reservoirs.values()], default=rig.ambient.pressure_pa)
    for which in sorted(set(volume.values()) - fed):
        inside = [
            noise_pa[t]
            for t, name in enumerate(taps[: len(rig.taps)])
            if volume_of_tap(volume, rig.taps[name]) == which
        ]
        std = READING_SIGMAS * min(inside) if inside else UNSEEN * highest
        step = min(std, 1e3)
        pressure, chamber = start.pressure.copy(), start.chamber_pressure.copy()
        for name, span in spans.items():
            if volume[f"pipe:{name}"] == which:
                pressure[span] += step
        for c, name in enumerate(plan.chambers):
            if volume.get(name) == which:
                chamber[c] += step
        changed = replace(start, pressure=pressure, chamber_pressure=chamber)
        out.append(Mode(changed, step, std))
    return out + _modes_of_joints(plan, start, noise_pa[len(rig.taps) :], recording)


def _modes_of_joints(plan: Plan, start: Start, noise: Floats, recording: Recording) -> list[Mode]:
    """Where joints began, within what their encoders resolve, and how fast they moved there."""
    out: list[Mode] = []
    if start.joints is None:
        return out
    for name, on, sigma in zip(plan.encoders, plan.encoder_of, noise, strict=True):
        signal = recording.encoders.get(name)
        if on < 0 or signal is None or len(signal) < FEWEST_FIRST:
            continue
        apart = max(round(FIRST_S / max(signal.period_s, 1e-9)), 1)
        speeds = (signal.values[apart:] - signal.values[:-apart]) / (
            signal.time_s[apart:] - signal.time_s[:-apart]
        )
        usual = float(np.std(speeds)) if speeds.size else 0.0
        for column, std in ((0, READING_SIGMAS * sigma), (1, SPEED_SHARE * usual)):
            if std > 0.0:
                joints = start.joints.copy()
                joints[on, column] += std
                out.append(Mode(replace(start, joints=joints), std, std))
    return out
