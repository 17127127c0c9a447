# SPDX-License-Identifier: Apache-2.0
"""How a laboratory moves a joint, and what its sensors then read: the plant in a loop of its own.

Random voltages, small openings at which the joint creeps and sticks, and a controller that follows
targets (thesis eq. 9.2) with gains at random, which need not succeed.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.plant import Plant
from pneu_sim.rig.schema import Rig
from pneu_sim.sensors import Sensors
from studies.exact_rigs import COMMAND_HZ

Floats = NDArray[np.float64]

PLANT_S = 2.5e-4
"""The plant tells its sensors so often."""
NULL_V = 5.0
RESTART_S = 0.2
"""A joint without the effect is put so often to where the joint with it is: what is unlike since is
the effect's, not what small differences grow into."""
PARTS = ((0.03, "rest"), (0.18, "steps"), (0.32, "slow"), (0.82, "steered"), (1.0, "steps"))
"""What happens up to which share of a recording."""
SPEED_S = 0.01
"""The controller's speed is the angle's difference, smoothed over this."""
MOST_INTEGRAL_V = 2.0


class Gains(NamedTuple):
    """A controller's: ``u = kp e - kd w + ki int(e) - k_pressure (p1 A1 - p2 A2)``.

    Attributes:
        kp: V/rad.
        kd: V s/rad.
        ki: V/(rad s).
        k_pressure: V/N.
    """

    kp: float
    kd: float
    ki: float
    k_pressure: float


class Excitation(NamedTuple):
    """What is asked of a joint.

    Attributes:
        volts: Per command its voltages at ``COMMAND_HZ``, V; NaN where the controller says them.
        target_rad: What it is to follow then.
        gains: The controller's.
        unlike: (2, samples) what its readings are off by, in standard deviations: pressures, angle.
    """

    volts: dict[str, Floats]
    target_rad: Floats
    gains: Gains
    unlike: Floats


class Run(NamedTuple):
    """A run as it was.

    Attributes:
        volts: Commands at ``COMMAND_HZ``, V.
        time_s: When sensors are told, s.
        readings: Per tap and encoder what it reads then without noise, Pa or rad.
        beside: The same of the joint beside it; empty where there is none.
    """

    volts: dict[str, Floats]
    time_s: Floats
    readings: dict[str, Floats]
    beside: dict[str, Floats]


def draw_excitation(rig: Rig, samples: int, rng: np.random.Generator) -> Excitation:
    """What is asked of a joint.

    Args:
        rig: The joint.
        samples: How many commands, at ``COMMAND_HZ``.
        rng: Source of all that is drawn.
    """
    theta = rig.bodies["arm"].joints[1]
    assert theta.lower is not None and theta.upper is not None
    head, rod = np.full((2, samples), NULL_V)
    target = np.zeros(samples)
    at = 0
    for share, kind in PARTS:
        part = slice(at, round(share * samples))
        size = part.stop - at
        if kind == "steps":
            head[part], rod[part] = _steps(size, rng), _steps(size, rng)
        elif kind == "slow":
            small = _small(size, rng)
            head[part], rod[part] = NULL_V + small, NULL_V - small
        elif kind == "steered":
            head[part] = rod[part] = np.nan
            target[part] = _targets(size, 0.9 * theta.lower, 0.9 * theta.upper, rng)
        at = part.stop
    gains = Gains(
        _log(rng, 0.8, 8.0),
        _log(rng, 0.05, 0.8),
        float(rng.uniform(0.0, 6.0)),
        float(rng.uniform(0.0, 0.015)),
    )
    return Excitation({"head": head, "rod": rod}, target, gains, rng.normal(size=(2, samples)))


def run_joint(
    rig: Rig, excitation: Excitation, noise_pa: float = 0.0, beside: Rig | None = None
) -> Run:
    """Runs a joint in its loop; at `COMMAND_HZ` the controller reads two taps and the encoder.

    Args:
        rig: The joint, with the effects that are attached to it.
        excitation: What is asked of it.
        noise_pa: Noise of the taps that the controller reads, Pa.
        beside: A joint of the same structure that gets the same voltages, put to where the other is
            every ``RESTART_S``.

    Raises:
        InputError: The run became unstable.
    """
    rigs = [rig] if beside is None else [rig, beside]
    plant = Plant(rigs)
    fine = round(1.0 / (COMMAND_HZ * PLANT_S))
    joint = plant.solver.joint_names.index("elbow")
    control = _Controller(rig, excitation, noise_pa)
    where = [plant.plan.taps.index(f"{side}_port") for side in ("head", "rod")]
    encoder = len(plant.plan.taps) + plant.plan.encoders.index("elbow")
    order = plant.plan.commands
    samples = excitation.target_rad.size
    volts = np.empty((len(order), samples))
    angles = np.empty((samples * fine + 1, 1, len(rigs)))
    taps = np.empty((samples * fine + 1, len(plant.plan.taps), len(rigs)))
    origin = np.zeros(len(rigs), dtype=np.int64)
    every = round(RESTART_S * COMMAND_HZ)
    for k in range(samples):
        if len(rigs) > 1 and k % every == 0:
            plant.set_state(plant.state().of(origin))
        read = plant.readings()[:, 0]
        head, rod = control.volts(k, float(read[encoder]), read[where])
        volts[:, k] = [head if name == "head" else rod for name in order]
        held = np.repeat(volts[:, k, None], fine, axis=1)[None]
        series, _ = plant.advance(held, PLANT_S)
        part = slice(k * fine, (k + 1) * fine + 1)
        angles[part, 0], taps[part] = series.joints[:, joint, 0], series.taps
    if not (np.isfinite(angles).all() and np.isfinite(taps).all()):
        raise InputError(f"rig {rig.name!r}: its run along the excitation became unstable")
    # whole, as a sensor whose clock is ahead shows what comes
    shown = []
    models = plant.solver.models
    for sensors, true in ((Sensors.of_taps(models), taps), (Sensors.of_encoders(models), angles)):
        sensors.begin(true[0])
        shown.append(np.concatenate([sensors.readings()[None], sensors.follow(true[1:], PLANT_S)]))
    names = [*plant.plan.taps, *plant.plan.encoders]
    every_sensor = [
        dict(zip(names, np.concatenate(shown, axis=1)[:, :, lane].T, strict=True))
        for lane in range(len(rigs))
    ]
    return Run(
        dict(zip(order, volts, strict=True)),
        PLANT_S * np.arange(len(angles)),
        every_sensor[0],
        every_sensor[1] if beside is not None else {},
    )


class _Controller:
    """Equation 9.2 on readings as a laboratory has them."""

    def __init__(self, rig: Rig, excitation: Excitation, noise_pa: float) -> None:
        self._asked, self._encoder = excitation, rig.encoders["elbow"]
        self._noise_pa, self._room_pa = noise_pa, rig.ambient.pressure_pa
        self._areas = rig.cylinders["forearm"].areas
        self._sum_v = self._speed = 0.0
        self._before: float | None = None

    def volts(self, k: int, angle_rad: float, pressures_pa: Floats) -> tuple[float, float]:
        """Voltages of both valves at a command; what sensors show then is given without noise."""
        asked, interval = self._asked, 1.0 / COMMAND_HZ
        encoder, (off_pa, off) = self._encoder, asked.unlike[:, k]
        read = angle_rad + encoder.noise * off
        if encoder.quantum > 0.0:
            read = encoder.quantum * round(read / encoder.quantum)
        before = read if self._before is None else self._before
        self._before = read
        share = 1.0 - math.exp(-interval / SPEED_S)
        self._speed += share * ((read - before) / interval - self._speed)
        head, rod = (float(asked.volts[name][k]) for name in ("head", "rod"))
        if not math.isnan(head):
            return head, rod
        p1, p2 = pressures_pa + self._noise_pa * off_pa - self._room_pa
        error = float(asked.target_rad[k]) - read
        gains = asked.gains
        self._sum_v += gains.ki * error * interval
        self._sum_v = min(max(self._sum_v, -MOST_INTEGRAL_V), MOST_INTEGRAL_V)
        force = float(p1 * self._areas[0] - p2 * self._areas[1])
        u = gains.kp * error - gains.kd * self._speed + self._sum_v - gains.k_pressure * force
        u = min(max(u, -NULL_V), NULL_V)
        return NULL_V + u, NULL_V - u


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _steps(samples: int, rng: np.random.Generator) -> Floats:
    """Voltages held for 20 to 300 ms, near null and far from it."""
    out = np.empty(samples)
    at = 0
    while at < samples:
        part = slice(at, at + int(rng.integers(10, 150)))
        out[part] = NULL_V + float(rng.choice([-1.0, 1.0])) * _log(rng, 0.1, 5.0)
        at = part.stop
    return out


def _small(samples: int, rng: np.random.Generator) -> Floats:
    """Small openings held for 0.2 to 0.7 s, V about null: one way, then the other."""
    out = np.empty(samples)
    at, sign = 0, float(rng.choice([-1.0, 1.0]))
    while at < samples:
        part = slice(at, at + int(rng.integers(100, 350)))
        out[part] = sign * _log(rng, 0.05, 0.5)
        at, sign = part.stop, -sign
    return out


def _targets(samples: int, low: float, high: float, rng: np.random.Generator) -> Floats:
    """Targets: half sums of sines, a quarter saw-teeth, a quarter steps; some of them small."""
    out = np.empty(samples)
    at = 0
    while at < samples:
        part = slice(at, at + int(rng.integers(750, 1750)))
        time = np.arange(out[part].size) / COMMAND_HZ
        reach = 0.5 * (high - low) * _log(rng, 0.1, 1.0)
        middle = rng.uniform(low + reach, high - reach)
        kind = int(rng.integers(4))
        if kind < 2:
            rates = [_log(rng, 0.1, 2.0) for _ in range(3)]
            heights = rng.dirichlet(np.ones(3))
            waves = (
                h * np.sin(2.0 * np.pi * (f * time + rng.uniform(0.0, 1.0)))
                for h, f in zip(heights, rates, strict=True)
            )
            way = np.sum(list(waves), axis=0)
        elif kind == 2:
            turns = time / _log(rng, 0.5, 4.0) + rng.uniform(0.0, 1.0)
            way = float(rng.choice([-1.0, 1.0])) * (2.0 * (turns % 1.0) - 1.0)
        else:
            edges = np.cumsum(rng.uniform(0.3, 1.0, 20))
            way = rng.uniform(-1.0, 1.0, 21)[np.searchsorted(edges, time)]
        out[part] = middle + reach * way
        at = part.stop
    return out
