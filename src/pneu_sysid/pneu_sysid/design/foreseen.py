# SPDX-License-Identifier: Apache-2.0
"""What a model foresees of commands: readings as a recording, and whether limits are kept."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sim.models import kind_of
from pneu_sim.rig.plan import Plan, plan_grid
from pneu_sim.rig.schema import CLOSED, Rig
from pneu_sim.signals import Signal
from pneu_sim.simulate import Course, Prediction, RunOptions, initial_field, rest
from pneu_sysid.design.limits import Limits
from pneu_sysid.design.waves import STEP_S
from pneu_sysid.records import Recording

Floats = NDArray[np.float64]

NAME = "plan"
"""Of the recording that is foreseen; no calibration has it."""
UNKNOWN_NOISE_PA = 100.0
"""Of a tap whose rig file and calibration say nothing of its noise."""


@dataclass(frozen=True)
class Foreseen:
    """What happens along commands.

    Attributes:
        recording: Readings without noise, of all sensors.
        tick_s: (n,) times of what follows, s.
        pressures_pa: (n, k) of all taps and chambers.
        joints: Per joint its (n,) positions.
        air_kg: (n,) air that had been taken from the supplies by then.
    """

    recording: Recording
    tick_s: Floats
    pressures_pa: Floats
    joints: dict[str, Floats]
    air_kg: Floats

    def keeps(self, limits: Limits, begin_s: float, end_s: float) -> bool:
        """Whether pressures and joints stay within limits for a time.

        Args:
            limits: The limits.
            begin_s: From, s.
            end_s: To, s.
        """
        now = (self.tick_s >= begin_s) & (self.tick_s <= end_s)
        p = self.pressures_pa[now]
        if p.size and not (p.max() <= limits.highest_pa and p.min() >= limits.lowest_pa):
            return False
        return all(
            bool(np.all((self.joints[name][now] >= low) & (self.joints[name][now] <= high)))
            for name, (low, high) in limits.joints.items()
        )

    def within(self, limits: Limits) -> bool:
        """Whether all keeps to limits, the air that is taken too.

        Args:
            limits: The limits.
        """
        return self.keeps(limits, 0.0, math.inf) and float(self.air_kg[-1]) <= limits.air_kg

    def taken_kg(self, begin_s: float, end_s: float) -> float:
        """Air that is taken from the supplies for a time.

        Args:
            begin_s: From, s.
            end_s: To, s.
        """
        return float(np.diff(np.interp([begin_s, end_s], self.tick_s, self.air_kg))[0])


def with_known_noise(rig: Rig) -> Rig:
    """A rig whose sensors' noise is what a model of it leaves: told, or what its calibration left.

    What a calibration leaves is more than noise, and hides effects as noise does.

    Args:
        rig: The rig.
    """
    left = {} if rig.calibration is None else rig.calibration.left
    taps = {
        name: tap.model_copy(
            update={
                "noise_pa": max(tap.noise_pa, left.get(name, 0.0))
                or (0.0 if tap.quantum_pa else UNKNOWN_NOISE_PA)
            }
        )
        for name, tap in rig.taps.items()
    }
    encoders = {
        name: encoder.model_copy(update={"noise": max(encoder.noise, left.get(name, 0.0))})
        for name, encoder in rig.encoders.items()
    }
    return rig.model_copy(update={"taps": taps, "encoders": encoders})


def lasting_share(rig: Rig) -> dict[str, float]:
    """Per sensor, of the square of what its calibration left, the share that is no noise.

    Noise is another from reading to reading; errors of a model last.

    Args:
        rig: The rig.
    """
    if rig.calibration is None:
        return {}
    left, noise = rig.calibration.left, rig.calibration.noise
    return {
        name: 1.0 - (noise[name] / left[name]) ** 2
        for name in left
        if 0.0 < noise.get(name, 0.0) < left[name]
    }


def foresee(
    rig: Rig,
    volts: Mapping[str, Floats],
    rate_hz: float,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Foreseen:
    """Runs a rig from rest along commands.

    Args:
        rig: The rig.
        volts: Per command its (T,) volts, every ``STEP_S``.
        rate_hz: Readings of each sensor per second.
        workers: Threads.
        progress: Called with the fraction done.

    Raises:
        InputError: The simulation became unstable.
    """
    plan = plan_grid(rig)
    samples = len(next(iter(volts.values())))
    seconds = samples * STEP_S
    time: Floats = np.arange(samples, dtype=np.float64) * STEP_S
    commands = {name: Signal(time, values) for name, values in volts.items()}
    at: Floats = np.arange(int(seconds * rate_hz), dtype=np.float64) / rate_hz
    names = [*rig.taps, *rig.encoders]
    shape = (len(names), at.size)
    course = Course(
        commands, 0.0, seconds, np.tile(at, (len(names), 1)), np.full(shape, np.nan),
        np.zeros(shape), rest(rig, plan), np.zeros(shape),
    )  # fmt: skip
    out = kind_of(rig).predict(
        [[rig]], plan, [course], initial_field(rig, plan), RunOptions(workers, progress, True, True)
    )[0]
    readings = dict(zip(names, out.readings[0], strict=True))
    recording = Recording(
        NAME,
        commands,
        {name: Signal(at, readings[name]) for name in rig.taps},
        encoders={name: Signal(at, readings[name]) for name in rig.encoders},
    )
    pressures = np.concatenate([out.taps[0], out.chambers[0]], axis=1)
    joints = {}
    if out.joints.size:
        joints = {name: out.joints[0, :, k, 0] for k, name in enumerate(plan.joints)}
    return Foreseen(recording, out.tick_s, pressures, joints, _taken(rig, plan, out))


def _taken(rig: Rig, plan: Plan, out: Prediction) -> Floats:
    """(ticks,) air that has passed the ports next to supplies: those above the room's pressure."""
    supplied = nodes_of_supplies(rig)
    total = np.zeros(out.tick_s.size)
    for q, name in enumerate(plan.port_names):
        valve, _, port = name.partition(".")
        if valve not in rig.valves:
            continue
        of = rig.valves[valve].ports[port]
        sign = 1.0 if of.from_node in supplied else -1.0 if of.to_node in supplied else 0.0
        if sign:
            total += np.maximum(sign * out.flows[0, :, q], 0.0)
    step = float(np.median(np.diff(out.tick_s)))
    return np.asarray(np.cumsum(total) * step)


def nodes_of_supplies(rig: Rig) -> set[str]:
    """Supplies, and all nodes that lines without a valve between join to them.

    Args:
        rig: The rig.
    """
    above = 1.02 * rig.ambient.pressure_pa
    nodes = {name for name, r in rig.reservoirs.items() if r.pressure_pa > above}
    for _ in range(len(rig.pipes) + len(rig.orifices)):
        for ends in [
            *({p.from_node, p.to_node} for p in rig.pipes.values()),
            *({o.from_node, o.to_node} for o in rig.orifices.values()),
        ]:
            if ends & nodes:
                nodes |= {n for n in ends if n not in rig.reservoirs and n != CLOSED}
    return nodes


def fastest_pa_s(recording: Recording) -> dict[str, float]:
    """Fastest change of each tap's pressure from reading to reading, Pa/s.

    Args:
        recording: The recording.
    """
    return {
        name: float(np.max(np.abs(np.diff(s.values)) / np.diff(s.time_s)))
        for name, s in recording.pressures.items()
        if len(s) > 1
    }
