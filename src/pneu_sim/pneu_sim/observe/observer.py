# SPDX-License-Identifier: Apache-2.0
"""Follows the state of a rig from its commands and readings: an ensemble Kalman filter.

Members are whole rigs of the batched plant, that differ in what is not well known (`drifts`). Each
step lets them run under the commands and then moves them by what the sensors read (`update`), gas
near a sensor more than gas far away (`nearness`). What was some steps ago may be moved along with
them (`past`): a smoother, for who can wait. Sensors that disagree with all else are left out
(`trust`), and what stays improbable says that the model is wrong (`watch`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.models import kind_of
from pneu_sim.observe.beginning import begin
from pneu_sim.observe.drifts import Drifts, that_may_drift
from pneu_sim.observe.past import Earlier, Past
from pneu_sim.observe.settings import ObserverSettings
from pneu_sim.observe.trust import Trust
from pneu_sim.observe.update import move
from pneu_sim.observe.vector import StateVector
from pneu_sim.observe.watch import Watch
from pneu_sim.plant import Plant, State
from pneu_sim.rig.schema import Rig
from pneu_sim.stepping import finite_lanes

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Innovation:
    """What a reading said beyond what was foreseen.

    Attributes:
        difference: Reading less what was foreseen, Pa, rad or m.
        std: What that was expected to be, one sigma.
        taken: Whether the members were moved by it.
    """

    difference: float
    std: float
    taken: bool


@dataclass(frozen=True)
class Estimate:
    """What sensors show or would show, by the members.

    Attributes:
        mean: By name, Pa, rad or m.
        std: One sigma of the estimate, without the noise of a sensor.
    """

    mean: Mapping[str, float]
    std: Mapping[str, float]


class Observer:
    """The state of a rig, followed.

    Attributes:
        rig: The rig.
        plant: The members.
        drifts: What of them wanders.
        sensors: Names of taps, then of encoders.
        used: Those whose readings are taken.
        trust: Which of them are believed.
        watch: Whether the model holds.
        lost: Whether all members became unstable, and what followed began anew, from rest.
        past: What was, by what was read since.
    """

    def __init__(
        self,
        rig: Rig,
        settings: ObserverSettings | None = None,
        used: Sequence[str] | None = None,
        steps_back: int = 0,
    ) -> None:
        """Builds the members, at rest in the room with valves closed.

        Args:
            rig: The rig, calibrated.
            settings: How it is followed.
            used: Taps and encoders whose readings are taken; None is all.
            steps_back: So many steps ago what was is moved too; 0 makes no smoother.

        Raises:
            InputError: A name is no sensor, or the rig cannot be followed.
        """
        self.settings = s = settings or ObserverSettings()
        self.rig = rig
        if not kind_of(rig).along_lines:
            raise InputError(
                f"rig {rig.name!r}: model: found {rig.model}, an observer needs the full one"
            )
        if rig.mechanism is not None:
            raise InputError(
                f"rig {rig.name!r}: mechanism: an observer follows bodies, no other mechanism"
            )
        member = that_may_drift(rig, s)
        self.plant = Plant([member] * s.members, s.dx_m, fewest_cells=s.fewest_cells)
        self._vector = StateVector(self.plant, s.reach_m)
        taps, encoders = list(self.plant.plan.taps), list(self.plant.plan.encoders)
        self.sensors = [*taps, *encoders]
        self.used = list(self.sensors if used is None else used)
        for name in self.used:
            if name not in self.sensors:
                raise InputError(f"sensor {name!r}: rig {rig.name!r} has {', '.join(self.sensors)}")
        known = [rig.taps[name] for name in taps]
        told = [rig.encoders[name] for name in encoders]
        self.drifts = Drifts(self.plant, s, self.used)
        self._variance = np.array(
            [(t.noise_pa or s.noise_pa) ** 2 + t.quantum_pa**2 / 12.0 for t in known]
            + [(e.noise or s.noise_position) ** 2 + e.quantum**2 / 12.0 for e in told]
        )
        noise = np.sqrt(self._variance)
        self.trust = Trust(
            self.used,
            {name: float(noise[self.sensors.index(name)]) for name in self.used},
            s,
            encoders,
        )
        self.watch = Watch(s)
        self.past = Past(steps_back)
        self.begin({})

    def begin(
        self,
        readings: Mapping[str, float],
        volts: Mapping[str, float] | None = None,
        known: bool = False,
    ) -> None:
        """Begins anew, by the first readings; see `pneu_sim.observe.beginning`.

        Args:
            readings: By sensor, Pa, rad or m; may be empty.
            volts: By command what the valves were told last, V; others are closed.
            known: Whether what the rig is like stays as it was found.
        """
        s, told = self.settings, volts or {}
        self._rng = np.random.default_rng([s.seed, 24])
        self.plant.reset(long_closed=True)
        held = {name: v for name, v in readings.items() if name in self.used and math.isfinite(v)}
        begin(self.plant, held, s, self._rng)
        for v, command in enumerate(self.plant.plan.commands):
            if command in told:
                self.plant.spools.memory[:, v, :2] = told[command]
        if known:
            self.drifts.apply()
        else:
            self.drifts.begin(self._rng)
        self.past.forget()
        self.trust.reset()
        self.watch.reset()
        self.lost = False
        self._since_s = 0.0
        self._shown = self.plant.readings()
        self._before = self._shown.mean(axis=1)

    def advance(self, volts: Floats, interval_s: float) -> None:
        """Lets the members run on.

        Args:
            volts: (valves, intervals) commands, each held for an interval, V.
            interval_s: Length of an interval, s.
        """
        self.drifts.wander(interval_s * volts.shape[1], self._rng)
        self.plant.advance(volts[None] + self.drifts.off_v().T[:, :, None], interval_s)
        self._since_s += interval_s * volts.shape[1]
        self._replace_lost()
        self._shown = self.plant.readings()

    def _replace_lost(self) -> None:
        """Has members that became unstable be like others that did not."""
        state = self.plant.state()
        fine = np.asarray(np.isfinite(self.plant.readings()).all(axis=0))
        for part in state.gas:
            if part.dtype.kind == "f":
                fine = fine & finite_lanes(part)
        if fine.all():
            return
        if not fine.any():
            self.begin({})
            self.lost = True
            return
        there = np.flatnonzero(fine)
        which = np.arange(len(fine))
        which[~fine] = there[np.arange(int((~fine).sum())) % there.size]
        self.plant.set_state(state.of(which))
        self.drifts.values = self.drifts.values[:, which]
        self.past.take(which)
        self.drifts.apply()

    def assimilate(self, readings: Mapping[str, float]) -> dict[str, Innovation]:
        """Moves the members by what was read now.

        Args:
            readings: By sensor, Pa, rad or m; those that are not finite or not used are passed by.

        Returns:
            What each that is used said beyond what was foreseen.
        """
        if self.lost:  # all members at once: what is read now is all that is known
            self.begin(readings)
        shown = self.plant.readings()
        read = {
            name: float(readings[name])
            for name in self.used
            if math.isfinite(readings.get(name, math.nan))
        }
        at = {name: self.sensors.index(name) for name in read}
        foreseen = {name: float(shown[n].mean()) for name, n in at.items()}
        since_s, self._since_s = self._since_s, 0.0
        variance = self._variance.copy()
        if since_s > 0.0:
            rate = (shown.mean(axis=1) - self._before) / since_s
            variance += (self.settings.timing_s * rate) ** 2
        total = {name: float(shown[n].var(ddof=1) + variance[n]) for name, n in at.items()}
        weights = self.trust.weigh(self.plant.time_s, since_s, read, foreseen, total)
        numbers, unknowns = self._vector.count, len(self.drifts.unknowns)
        now = np.concatenate([self._vector.gather(), self.drifts.values, shown])
        before = self.past.tables()
        members = np.concatenate([now, *before])
        near = np.ones(len(members))
        first, last = numbers + unknowns, len(now)
        drifts = slice(numbers, first)
        of_before = near[last:].reshape(len(before), numbers + len(shown))
        out: dict[str, Innovation] = {}
        for name, n in at.items():
            weight = weights[name]
            if math.isfinite(weight):
                near[:numbers] = of_before[:, :numbers] = self._vector.nearness[n]
                # as if the noise had been so large that it is within the gate
                noisy = float(variance[n]) + (weight - 1.0) * total[name]
                move(members, members[first + n].copy(), read[name], noisy, near, drifts)
            difference = read[name] - foreseen[name]
            out[name] = Innovation(difference, math.sqrt(total[name]), math.isfinite(weight))
        self._vector.scatter(members[:numbers])
        self.drifts.values = members[numbers:first]
        self.drifts.apply()
        self._shown = members[first:last]
        self.past.put(list(members[last:].reshape(*of_before.shape, shown.shape[1])), numbers)
        if self.past.steps:
            kept = Earlier(self.plant.time_s, self._vector.gather(), self._shown.copy())
            self.past.keep(kept)
        self._before = self._shown.mean(axis=1)
        believed = {name: i.difference / i.std for name, i in out.items() if i.taken}
        self.watch.see(since_s, believed, self.drifts.unknowns, self.drifts.drifted())
        return out

    def estimate(self) -> Estimate:
        """What all sensors show, or would show, now."""
        return self.estimate_of(self._shown)

    def estimate_of(self, shown: Floats) -> Estimate:
        """What sensors show by members, now or some steps ago (`past`).

        Args:
            shown: (sensors, members).
        """
        mean, std = shown.mean(axis=1), shown.std(axis=1, ddof=1)
        return Estimate(
            dict(zip(self.sensors, mean.tolist(), strict=True)),
            dict(zip(self.sensors, std.tolist(), strict=True)),
        )

    def earlier_state(self, then: State) -> State:
        """The state of one rig as it was so many steps ago, by all that was read since.

        Args:
            then: What `mean_state` said then: spools and sensors stay as it has them.

        Raises:
            InputError: Nothing is remembered, or pistons stand in cells, whose number may differ.
        """
        if not self.past.states:
            raise InputError(
                f"steps_back: found {self.past.steps}, and nothing read so far; what was is told by"
                " an observer that looks back, once it has read"
            )
        if self._vector.in_cells:
            raise InputError(
                f"rig {self.rig.name!r}: pistons stand in cells, what was is told of taps alone"
            )
        s = self.settings
        one = Plant([self.rig], s.dx_m, fewest_cells=s.fewest_cells)
        one.set_state(then)
        mean = self.past.states[0].numbers.mean(axis=1, keepdims=True)
        StateVector(one, s.reach_m).scatter(mean)
        return one.state()

    def mean_state(self) -> State:
        """The mean of the members, as the state of one rig.

        Where pistons stand in cells, whose number is a member's own, it is that of the member which
        is nearest to the mean.
        """
        state = self.plant.state()
        if self._vector.in_cells:
            off = self._vector.gather()
            off -= off.mean(axis=1, keepdims=True)
            off /= np.maximum(off.std(axis=1, keepdims=True), 1e-300)
            return state.of(np.array([int(np.argmin((off**2).sum(axis=0)))]))
        told, *spools = state.spools

        def mean(parts: Sequence[NDArray[Any]]) -> list[NDArray[Any]]:
            return [part.mean(axis=-1, keepdims=True) for part in parts]

        return State(state.clock, [told, *mean(spools)], mean(state.sensors), mean(state.gas))
