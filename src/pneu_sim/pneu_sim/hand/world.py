# SPDX-License-Identifier: Apache-2.0
"""A hand's plant in time: motors and an operator's pulls in, sensors at their own rates out.

MuJoCo tells its sensors for the beginning of each step, under the torques of that step; readings
are stamped so. What is measured less often than the plant steps is taken at the step on or after
its instant, so that the mean rate is kept whatever the step.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.hand.loading import Hand
from pneu_sim.hand.operator import Operator
from pneu_sim.hand.touch import driven_by, geoms_with, touch_of
from pneu_sim.hand.truth import Lie, Truth
from pneu_sim.mechanism.loading import mujoco_module

Floats = NDArray[np.float64]

TOUCH_HZ = 1000.0
"""How often true forces are told."""


@dataclass(frozen=True)
class Reading:
    """What a sensor read.

    Attributes:
        kind: ``wrench``, ``imu``, ``pose``, or ``touch``, which no sensor tells.
        name: Arm, inertial unit, or body.
        number: How many it has read before.
        time_s: When, of the plant's time.
        values: Force and torque; angular velocity and acceleration; position and quaternion,
            scalar first; of a touch, force and its moment about the origin, in the world's frame.
    """

    kind: str
    name: str
    number: int
    time_s: float
    values: Floats


@dataclass
class _Sensor:
    """A sensor that has a rate of its own."""

    kind: str
    name: str
    parts: tuple[tuple[slice, Lie, float], ...]  # where, how it lies, its noise
    rate_hz: float
    number: int = 0

    def due(self, time_s: float) -> bool:
        return time_s * self.rate_hz >= self.number - 1e-6


class World:
    """The plant.

    Attributes:
        hand: What it is of.
        model: MuJoCo's model, with what is hidden.
        data: Its state.
        time_s: Plant time at the beginning of the next step.
        arms: Numbers of the motors of each arm, in the order of its joints.
    """

    def __init__(
        self,
        hand: Hand,
        truth: Truth | None = None,
        seed: int = 0,
        step_s: float | None = None,
        touch: bool = False,
        operator: Operator | None = None,
    ) -> None:
        """Builds it at rest.

        Args:
            hand: The hand.
            truth: What is hidden.
            seed: Of the noise of sensors.
            step_s: Step of the plant; the MJCF's own unless given.
            touch: Whether true forces of the arms on what they touch are among the readings.
            operator: Whose hand is on an arm.

        Raises:
            InputError: What is hidden cannot be put in.
        """
        self.hand = hand
        truth = truth or Truth()
        spec = hand.spec()
        truth.put(spec, "truth")
        if step_s is not None:
            spec.option.timestep = step_s
        self._mujoco = mujoco_module()
        self.model: Any = spec.compile()
        self.data: Any = self._mujoco.MjData(self.model)
        self.time_s = 0.0
        self.step_s = float(self.model.opt.timestep)
        self._steps = 0
        self._rng = np.random.default_rng(seed)
        settings = hand.settings
        self.arms = {
            arm: [self.model.actuator(j.motor).id for j in its.joints.values()]
            for arm, its in settings.arms.items()
        }

        def part(name: str, noise: float = 0.0) -> tuple[slice, Lie, float]:
            number = self.model.sensor(name).id
            first = int(self.model.sensor_adr[number])
            width = int(self.model.sensor_dim[number])
            return slice(first, first + width), truth.sensors.get(name, Lie()), noise

        self._encoders = {
            arm: [(part(j.encoder), j.counts_per_rad) for j in its.joints.values()]
            for arm, its in settings.arms.items()
        }
        self._sensors: list[_Sensor] = []
        for arm, its in settings.arms.items():
            if (w := its.wrench) is not None:
                parts = (part(w.force, w.noise_n), part(w.torque, w.noise_n_m))
                self._sensors.append(_Sensor("wrench", arm, parts, w.rate_hz))
        for name, imu in settings.imus.items():
            parts = (part(imu.gyro, imu.noise_rad_s), part(imu.accelerometer, imu.noise_m_s2))
            self._sensors.append(_Sensor("imu", name, parts, imu.rate_hz))
        for name, pose in settings.poses.items():
            parts = (part(pose.position, pose.noise_m), part(pose.orientation, pose.noise_rad))
            self._sensors.append(_Sensor("pose", name, parts, pose.rate_hz))
        lags = [lie.lag_s for lie in truth.sensors.values()]
        self._touch = touch
        self._operator = operator
        self._touches = 0
        self._geoms = {
            arm: geoms_with(
                self.model, driven_by(self.model, next(iter(its.joints.values())).motor)
            )
            for arm, its in settings.arms.items()
        }
        self._past: deque[Floats] = deque(
            maxlen=2 + math.ceil(max(lags, default=0.0) / self.step_s)
        )
        for sensor in self._sensors:
            if sensor.rate_hz * self.step_s > 1.0 + 1e-9:
                raise InputError(
                    f"{hand.path}: {sensor.kind} of {sensor.name}: rate_hz: found"
                    f" {sensor.rate_hz:g}, the plant steps at {1.0 / self.step_s:g} Hz"
                )

    def advance(self, torque_n_m: dict[str, list[float]]) -> list[Reading]:
        """Moves the plant by one step.

        Args:
            torque_n_m: Of each arm's motors, in the order of its joints; of others, nothing.

        Returns:
            What sensors read at the beginning of the step.
        """
        control = self.data.ctrl
        control[:] = 0.0
        for arm, torques in torque_n_m.items():
            for motor, torque in zip(self.arms[arm], torques, strict=True):
                control[motor] = torque
        if self._operator is not None:
            self._operator.pull(self.model, self.data, self.time_s)
        self._mujoco.mj_step(self.model, self.data)
        self._past.append(self.data.sensordata.copy())
        now = self.time_s
        out = []
        for sensor in self._sensors:
            if sensor.due(now):
                out.append(
                    Reading(sensor.kind, sensor.name, sensor.number, now, self._read(sensor))
                )
                sensor.number += 1
        if self._touch and now * TOUCH_HZ >= self._touches - 1e-6:
            out += [Reading("touch", arm, self._touches, now, self.touch(arm)) for arm in self.arms]
            self._touches += 1
        self._steps += 1
        self.time_s = self._steps * self.step_s
        return out

    def counts(self, arm: str) -> list[int]:
        """What encoders of an arm read at the beginning of the last step, in counts.

        Args:
            arm: Its name.
        """
        return [
            math.floor(float(self._told(where, lie)[0]) * by + 0.5)
            for (where, lie, _), by in self._encoders[arm]
        ]

    def touch(self, arm: str) -> Floats:
        """Force and moment about the origin of an arm on what it touches, in the world's frame.

        Args:
            arm: Its name.
        """
        return touch_of(self.model, self.data, self._geoms[arm])

    def _told(self, where: slice, lie: Lie) -> Floats:
        """What a sensor tells but for its noise; of some time ago where it lags."""
        if not self._past:
            self._mujoco.mj_forward(self.model, self.data)
            return np.asarray(lie.gain * self.data.sensordata[where] + lie.bias)
        back = lie.lag_s / self.step_s
        last = len(self._past) - 1
        whole = int(back)
        share = back - whole
        newer = self._past[max(last - whole, 0)][where]
        older = self._past[max(last - whole - 1, 0)][where]
        return np.asarray(lie.gain * ((1.0 - share) * newer + share * older) + lie.bias)

    def _read(self, sensor: _Sensor) -> Floats:
        out = []
        for where, lie, noise in sensor.parts:
            told = self._told(where, lie)
            width = where.stop - where.start
            if width == 4:
                told = told / np.linalg.norm(told)
                turn = 0.5 * noise * self._rng.normal(size=3)
                w, v = told[0], told[1:]
                told = np.concatenate(
                    [[w - v @ turn], v + w * turn + np.cross(v, turn)]
                )  # a small turn in the body's frame
                told = told / np.linalg.norm(told)
            elif noise:
                told = told + noise * self._rng.normal(size=width)
            out.append(told)
        return np.concatenate(out)
