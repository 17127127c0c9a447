# SPDX-License-Identifier: Apache-2.0
"""Controllers of a joint judged on a simulated robot that they do not know (thesis table 9.2).

Runs go side by side, each with a target, a delay and noise of its own; errors are of the true joint
from the first second on.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_policy.control.robot_controllers import RobotController, load_robot_controller
from pneu_policy.judge.latency import EARLY_S, LATE_S, latency, rms
from pneu_policy.task.plants import RobotPlant
from pneu_policy.task.waves import Kind, Wave
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]

BEGIN_S = 1.0
"""What comes before is the way to the target."""
START_PA = 3.5e5
"""Pressure of all gas behind valves at the start, Pa."""


@dataclass(frozen=True)
class JointTasks:
    """What is asked of a joint.

    Attributes:
        encoder: Encoder of the joint.
        low: Lowest target, rad or m.
        high: Highest.
        period_s: Typical time from one extreme to the next, s, of each kind.
        jitter: Share of that by which corners of jagged targets are moved.
        kinds: Kinds of target.
        runs: Runs of each kind.
        seconds: How long each is judged.
        delay_s: Least and most delay of commands, s.
        seed: Seed of targets, delays and noise.
    """

    encoder: str
    low: float
    high: float
    period_s: tuple[float, ...] = (0.6, 0.2)
    jitter: float = 0.6
    kinds: tuple[Kind, ...] = ("smooth", "jagged")
    runs: int = 5
    seconds: float = 20.0
    delay_s: tuple[float, float] = (0.002, 0.01)
    seed: int = 7000

    def wave(self, kind: Kind, run: int) -> Wave:
        """The target of a run.

        Args:
            kind: Its kind.
            run: Number of the run.
        """
        at = self.kinds.index(kind)
        seed = self.seed + 100 * at + run
        return Wave(kind, self.low, self.high, self.period_s[at], seed, jitter=self.jitter)


@dataclass(frozen=True)
class JointRun:
    """How a run went.

    Attributes:
        kind: Kind of the target.
        run: Number of the run.
        rmse: Root mean square of the joint off its target, rad or m.
        latency_s: Shift of the target that fits best, positive where the joint is late.
        adjusted_rmse: What is left at that shift.
        effort_v: Root mean square of commands about the valves' null, V.
        time_s: Times, s.
        position: The joint there.
        target: The target there.
        volts: (commands, times) what was commanded.
    """

    kind: str
    run: int
    rmse: float
    latency_s: float
    adjusted_rmse: float
    effort_v: float
    time_s: Floats
    position: Floats
    target: Floats
    volts: Floats


def judge_joint(
    controller: Path,
    known: Rig,
    true: Rig,
    tasks: JointTasks,
    dx_m: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[JointRun]:
    """Runs a controller on a robot.

    Args:
        controller: Its file.
        known: The rig as the controller knows it.
        true: The robot.
        tasks: What is asked of it.
        dx_m: Cell length of the robot, m.
        progress: Called with the share that is done.

    Returns:
        One run after the other, kind by kind.

    Raises:
        InputError: The controller does not fit the rig, or the rigs do not fit one another.
    """
    courses = [(kind, run) for kind in tasks.kinds for run in range(tasks.runs)]
    count = len(courses)
    controllers = [load_robot_controller(controller, known) for _ in courses]
    first = controllers[0]
    if list(first.tracked) != [tasks.encoder]:
        raise InputError(
            f"{controller}: tracks {', '.join(first.tracked) or 'nothing'}, asked for is"
            f" {tasks.encoder}"
        )
    waves = [tasks.wave(kind, run) for kind, run in courses]
    rng = np.random.default_rng([tasks.seed, 1])
    plant = RobotPlant([true] * count, first.period_s, dx_m)
    plant.set_delay(rng.uniform(*tasks.delay_s, count))
    joint = plant.joints.index(true.encoders[tasks.encoder].on(tasks.encoder))
    taps = [plant.taps.index(name) for name in first.taps]
    encoders = [plant.encoders.index(name) for name in first.encoders]
    valves = [plant.commands.index(name) for name in first.commands]
    null = np.array([valve.spool.null_v for valve in true.valves.values()])
    tap_noise = np.array([true.taps[name].noise_pa for name in first.taps])
    noise = np.array([true.encoders[name].noise for name in first.encoders])
    quantum = np.array([true.encoders[name].quantum for name in first.encoders])
    start = np.array([wave.at(0.0) for wave in waves])
    plant.reset(START_PA, {plant.joints[joint]: start})
    period_s = first.period_s
    steps = round((BEGIN_S + tasks.seconds + LATE_S + EARLY_S) / period_s)
    grid: Floats = np.arange(steps + first.reach + 1, dtype=np.float64) * period_s
    targets = np.stack([wave.at(grid) for wave in waves])
    position = np.zeros((steps + 1, count))
    volts = np.zeros((steps, count, len(valves)))
    position[0] = plant.motion()[0][:, joint]
    for k in range(steps):
        pressures, angles = plant.seen()
        pressures = pressures[:, taps] + tap_noise * rng.normal(size=(count, len(taps)))
        angles = angles[:, encoders] + noise * rng.normal(size=(count, len(encoders)))
        coarse = quantum > 0.0
        angles[:, coarse] = np.round(angles[:, coarse] / quantum[coarse]) * quantum[coarse]
        for n, one in enumerate(controllers):
            volts[k, n] = _asked(one, angles[n], pressures[n], targets[n, k : k + one.reach])
        sent = np.tile(null, (count, 1))
        sent[:, valves] = volts[k]
        plant.step(sent)
        position[k + 1] = plant.motion()[0][:, joint]
        if progress is not None and k % 50 == 0:
            progress(k / steps)
    time: Floats = np.arange(steps + 1, dtype=np.float64) * period_s
    inside = (time >= BEGIN_S) & (time <= BEGIN_S + tasks.seconds)
    out = []
    for n, (kind, run) in enumerate(courses):
        at, q = time[inside], position[inside, n]
        late, left = latency(at, q, grid, targets[n])
        judged = volts[inside[:-1], n]
        out.append(
            JointRun(
                kind=kind,
                run=run,
                rmse=rms(at, q - targets[n, : steps + 1][inside]),
                latency_s=late,
                adjusted_rmse=left,
                effort_v=float(np.sqrt(np.mean((judged - null[valves]) ** 2))),
                time_s=at,
                position=q,
                target=targets[n, : steps + 1][inside],
                volts=judged.T,
            )
        )
    return out


def _asked(
    controller: RobotController, positions: Floats, pressures: Floats, targets: Floats
) -> Sequence[float]:
    """Voltages in the order of the controller's commands."""
    told = controller.step(
        dict(zip(controller.encoders, positions.tolist(), strict=True)),
        dict(zip(controller.taps, pressures.tolist(), strict=True)),
        targets[None],
    )
    return [told[name] for name in controller.commands]
