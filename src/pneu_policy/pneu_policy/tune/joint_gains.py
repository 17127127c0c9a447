# SPDX-License-Identifier: Apache-2.0
"""Tuning of controllers of a joint: a stated search, on stated targets, with a seed.

As for a pressure's (`pneu_policy.tune.gains`): candidates meet the same rigs drawn from the
calibration's uncertainty, the same targets, noise and late commands; least is the RMSE of the joint
off its target.
"""

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from pneu_common.errors import InputError
from pneu_common.validation import Listed, Settings
from pneu_policy.control.joint import JointGains
from pneu_policy.control.plan_settings import PlanSettings
from pneu_policy.control.robot_controllers import (
    ComputedTorque,
    Drive,
    JointPidController,
    TorqueGains,
)
from pneu_policy.task.ensembles import draw_rigs
from pneu_policy.task.plants import RobotPlant
from pneu_policy.task.ranges import DelayRange, Kinds, Seed
from pneu_policy.task.waves import Wave
from pneu_policy.tune.search import Knob, seek
from pneu_sim.models import kind_of
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]
Positive = Annotated[float, Field(gt=0.0)]
Count = Annotated[int, Field(ge=1, le=10_000)]

TARGETS_WITHIN_S = 60.0
"""Targets are taken from a random place within this time of their start."""
START_PA = 3.5e5
"""Pressure of all gas behind valves at the start, Pa."""

PID_KNOBS = (
    Knob("kp_v", 0.3, 60.0, 4.0),
    Knob("ki_v_s", 0.01, 100.0, 2.0),
    Knob("kd_v_s", 0.003, 5.0, 0.2),
    Knob("kf_v_n", 1e-4, 0.1, 0.01),
    Knob("derivative_hz", 5.0, 100.0, 30.0),
    Knob("integral_v", 0.05, 5.0, 1.5),
)
TORQUE_KNOBS = (
    Knob("kf_v_n", 0.003, 0.2, 0.04),
    Knob("ki_v_n_s", 1e-3, 3.0, 0.2),
    Knob("integral_v", 0.05, 5.0, 1.0),
    Knob("lead_s", 0.0, 0.12, 0.03, log=False),
    Knob("joining_hz", 1.0, 10.0, 4.0),
)


class JointTuneSettings(Settings):
    """What is tuned, and on what.

    Attributes:
        rig: Rig file.
        kind: ``joint_pid`` (eq. 9.2) or ``computed_torque``.
        encoder: Encoder of the joint.
        cylinder: Cylinder that moves it.
        taps: Taps at its head and at its rod side.
        period_s: Control period, s.
        low: Lowest target, rad or m.
        high: Highest.
        kinds: Kinds of target.
        target_period_s: Typical time from one extreme to the next, s, of each kind.
        jitter: Share of that by which corners of jagged targets are moved.
        trials: Runs of each candidate.
        seconds: Length of a run, s.
        settle_s: What of it is not judged, s.
        delay_s: Least and most delay of commands, s.
        noise_pa: Noise of pressures, one sigma, Pa.
        noise_position: Noise of the encoder, one sigma, rad or m.
        spread: Rigs are drawn by this many standard errors of the calibration.
        dx_m: Cell length, m; None is the rig's own.
        candidates: Of a generation.
        generations: How many.
        seed: Of all draws.
    """

    rig: str
    kind: Literal["joint_pid", "computed_torque"] = "joint_pid"
    encoder: str
    cylinder: str
    taps: Annotated[tuple[str, str], Listed]
    period_s: Positive = 0.004
    low: float
    high: float
    kinds: Kinds = ("smooth", "jagged")
    target_period_s: Annotated[tuple[Positive, ...], Listed]
    jitter: float = 0.6
    trials: Count = 6
    seconds: Positive = 5.0
    settle_s: Annotated[float, Field(ge=0.0)] = 1.0
    delay_s: DelayRange = (0.002, 0.01)
    noise_pa: Annotated[float, Field(ge=0.0)] = 250.0
    noise_position: Annotated[float, Field(ge=0.0)] = 2e-4
    spread: Annotated[float, Field(ge=0.0)] = 1.0
    dx_m: float | None = None
    candidates: Count = 24
    generations: Count = 20
    seed: Seed = 0


@dataclass(frozen=True)
class TunedJoint:
    """What a tuning found.

    Attributes:
        controller: The best candidate.
        rmse: Its RMSE over all runs, rad or m.
        history: Least RMSE after each generation.
        settings: What was tuned, and on what.
        rig_sha256: Digest of the rig file.
    """

    controller: JointPidController | ComputedTorque
    rmse: float
    history: list[float]
    settings: JointTuneSettings
    rig_sha256: str

    def provenance(self) -> dict[str, Any]:
        """Returns how the gains were found, as plain data for a file."""
        return {
            "search": "differential evolution, best/1/bin",
            "rmse": self.rmse,
            "evaluations": self.settings.candidates * len(self.history),
            "rig_sha256": self.rig_sha256,
            "settings": self.settings.plain(),
        }


class JointTrials:
    """The runs that all candidates must do."""

    def __init__(self, settings: JointTuneSettings, rig: Rig) -> None:
        """Draws rigs, targets, delays and noise.

        Args:
            settings: What is tuned, and on what.
            rig: The rig.

        Raises:
            InputError: The rig has no such parts.
        """
        s = settings
        if len(s.target_period_s) != len(s.kinds):
            raise InputError(
                f"target_period_s: found {len(s.target_period_s)}, needed is one to each of"
                f" {len(s.kinds)} kinds"
            )
        rng = np.random.default_rng([s.seed, 1])
        n = s.trials
        seeds = rng.integers(2**31, size=n)
        self.settings, self.rig = s, rig
        self.drive = Drive.of_rig(rig, s.encoder, s.cylinder, s.taps)
        waves = [
            Wave(
                s.kinds[k % len(s.kinds)], s.low, s.high, s.target_period_s[k % len(s.kinds)],
                int(seeds[k]), jitter=s.jitter,
            )
            for k in range(n)
        ]  # fmt: skip
        begins = rng.uniform(0.0, TARGETS_WITHIN_S, n)
        self._delays = rng.uniform(*s.delay_s, n)
        self.steps = round(s.seconds / s.period_s)
        reach = round(0.3 / s.period_s)
        grid = np.arange(self.steps + reach + 1) * s.period_s
        self._targets = np.stack([w.at(b + grid) for w, b in zip(waves, begins, strict=True)])
        self._noise = rng.normal(size=(self.steps, n, 3))
        rigs = draw_rigs(rig, n, s.seed, s.spread)
        dx_m = s.dx_m if kind_of(rig).along_lines else None
        self._plant = RobotPlant(rigs * s.candidates, s.period_s, dx_m)
        self._joint = self._plant.joints.index(rig.encoders[s.encoder].on(s.encoder))
        self._encoder = self._plant.encoders.index(s.encoder)
        self._taps = [self._plant.taps.index(tap) for tap in s.taps]

    def make(self, set_to: dict[str, float]) -> JointPidController | ComputedTorque:
        """A controller.

        Args:
            set_to: What it is set to, by knob.
        """
        s = self.settings
        if s.kind == "joint_pid":
            return JointPidController([self.drive], [JointGains(**set_to)], s.period_s)
        own = dict(set_to)
        plan = PlanSettings(joining_hz=own.pop("joining_hz"))
        return ComputedTorque([self.drive], [TorqueGains(**own)], plan, self.rig, s.period_s)

    def run(self, candidates: list[dict[str, float]]) -> Floats:
        """Errors of some candidates.

        Args:
            candidates: What each is set to; as many as the settings say, or fewer.

        Returns:
            (candidates, trials) mean of the squared error.
        """
        s, n = self.settings, self.settings.trials
        lanes = s.candidates * n
        # Lanes without a candidate repeat the first.
        of = [lane // n if lane // n < len(candidates) else 0 for lane in range(lanes)]
        controllers = [self.make(candidates[k]) for k in of]
        self._plant.set_delay(np.tile(self._delays, s.candidates))
        start = np.tile(self._targets[:, 0], s.candidates)
        self._plant.reset(START_PA, {self._plant.joints[self._joint]: start})
        valves = [self._plant.commands.index(name) for name in controllers[0].commands]
        square, counted = np.zeros(lanes), 0
        volts = np.full((lanes, len(self._plant.commands)), self.drive.null_v)
        for k in range(self.steps):
            taps, encoders = self._plant.seen()
            noise = np.tile(self._noise[k], (s.candidates, 1))
            angle = encoders[:, self._encoder] + s.noise_position * noise[:, 0]
            pressure = taps[:, self._taps] + s.noise_pa * noise[:, 1:]
            for lane, one in enumerate(controllers):
                told = one.step(
                    {s.encoder: float(angle[lane])},
                    dict(zip(s.taps, pressure[lane].tolist(), strict=True)),
                    self._targets[lane % n, None, k : k + one.reach],
                )
                volts[lane, valves] = [told[name] for name in one.commands]
            self._plant.step(volts)
            if k * s.period_s >= s.settle_s:
                now = self._plant.motion()[0][:, self._joint]
                square += (np.tile(self._targets[:, k + 1], s.candidates) - now) ** 2
                counted += 1
        return (square / max(counted, 1)).reshape(s.candidates, n)[: len(candidates)]


def tune_joint(
    settings: JointTuneSettings, progress: Callable[[int, float], None] | None = None
) -> TunedJoint:
    """Seeks the gains with the least RMSE.

    Args:
        settings: What is tuned, and on what.
        progress: Called after each generation with its number and the least RMSE so far.

    Returns:
        What was found.

    Raises:
        InputError: The rig file or a setting is wrong.
    """
    s = settings
    trials = JointTrials(s, load_rig(s.rig))
    knobs = PID_KNOBS if s.kind == "joint_pid" else TORQUE_KNOBS
    rng = np.random.default_rng([s.seed, 2])
    history: list[float] = []
    least, best = math.inf, np.array([knob.share() for knob in knobs])

    def set_to(shares: Floats) -> dict[str, float]:
        # Seven digits are more than a tuning finds, and read well in a file.
        return {
            k.name: float(f"{k.value(float(x)):.7g}") for k, x in zip(knobs, shares, strict=True)
        }

    def of_generation(points: Floats) -> Floats:
        nonlocal least, best
        values = trials.run([set_to(point) for point in points.T]).mean(axis=1)
        k = int(np.argmin(values))
        if values[k] < least:
            least, best = float(values[k]), points[:, k].copy()
        history.append(math.sqrt(least))
        if progress is not None:
            progress(len(history), history[-1])
        return np.asarray(values)

    seek(of_generation, knobs, s.candidates, s.generations, rng)
    return TunedJoint(
        controller=trials.make(set_to(best)),
        rmse=history[-1],
        history=history,
        settings=s,
        rig_sha256=hashlib.sha256(Path(s.rig).read_bytes()).hexdigest(),
    )
