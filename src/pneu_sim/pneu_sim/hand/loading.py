# SPDX-License-Identifier: Apache-2.0
"""A hand with its MJCF: what is driven and measured, and where it stands in MuJoCo's arrays."""

from pathlib import Path
from typing import Any

from pneu_common.errors import InputError
from pneu_sim.hand.settings import HandSettings, read_hand
from pneu_sim.mechanism.loading import mujoco_module


class Hand:
    """A hand file and the MJCF that it names.

    Attributes:
        settings: The file.
        path: Where it is.
        mjcf: Path of the MJCF.
    """

    def __init__(self, path: str | Path) -> None:
        """Reads both, and checks that one is of the other.

        Args:
            path: The hand file.

        Raises:
            InputError: One is missing or wrong.
        """
        self.path = Path(path)
        self.settings: HandSettings = read_hand(path)
        self.mjcf = self.path.parent / self.settings.mjcf
        self._mujoco = mujoco_module()
        self._check(self.spec().compile())

    def spec(self) -> Any:
        """The MJCF, to be changed and compiled."""
        if not self.mjcf.is_file():
            raise InputError(f"{self.mjcf}: no such MJCF")
        try:
            spec = self._mujoco.MjSpec.from_file(str(self.mjcf))
            spec.compile()
            return spec
        except (ValueError, self._mujoco.FatalError) as error:
            raise InputError(f"{self.mjcf}: no MJCF that MuJoCo takes ({error})") from None

    def _check(self, model: Any) -> None:
        sensors = {model.sensor(k).name: int(model.sensor_dim[k]) for k in range(model.nsensor)}
        motors = [model.actuator(k).name for k in range(model.nu)]

        def sensor(where: str, name: str, width: int) -> None:
            if name not in sensors:
                raise InputError(
                    f"{self.path}: {where}: {self.mjcf.name} has no sensor {name!r}; it has"
                    f" {', '.join(sensors) or 'none'}"
                )
            if sensors[name] != width:
                raise InputError(
                    f"{self.path}: {where}: sensor {name!r} of {self.mjcf.name} has"
                    f" {sensors[name]} components, {width} are needed"
                )

        taken: dict[str, str] = {}
        for arm, its in self.settings.arms.items():
            for name, joint in its.joints.items():
                where = f"arms.{arm}.joints.{name}"
                sensor(f"{where}.encoder", joint.encoder, 1)
                if joint.motor not in motors:
                    raise InputError(
                        f"{self.path}: {where}.motor: {self.mjcf.name} has no actuator"
                        f" {joint.motor!r}; it has {', '.join(motors) or 'none'}"
                    )
                if joint.motor in taken:
                    raise InputError(
                        f"{self.path}: {where}.motor: {joint.motor!r} is that of"
                        f" {taken[joint.motor]} already"
                    )
                taken[joint.motor] = where
            if its.wrench is not None:
                sensor(f"arms.{arm}.wrench.force", its.wrench.force, 3)
                sensor(f"arms.{arm}.wrench.torque", its.wrench.torque, 3)
        for name, imu in self.settings.imus.items():
            sensor(f"imus.{name}.gyro", imu.gyro, 3)
            sensor(f"imus.{name}.accelerometer", imu.accelerometer, 3)
        for name, pose in self.settings.poses.items():
            sensor(f"poses.{name}.position", pose.position, 3)
            sensor(f"poses.{name}.orientation", pose.orientation, 4)
        if len(taken) != len(motors):
            left = [m for m in motors if m not in taken]
            raise InputError(
                f"{self.path}: arms: nobody drives {', '.join(left)} of {self.mjcf.name}"
            )
