# SPDX-License-Identifier: Apache-2.0
"""Hand files: arms with motors, encoders and force sensors, and what else is measured, as YAML."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, ValidationError, model_validator

from pneu_common.documents import read_yaml
from pneu_common.errors import InputError
from pneu_common.validation import Settings, sentence

SCHEMA_VERSION = 1

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]


class JointSettings(Settings):
    """A joint with a motor and an encoder.

    Attributes:
        motor: Actuator of the MJCF, whose control is its torque, N m.
        encoder: Sensor of the MJCF that reads its angle, rad.
        counts_per_rad: Resolution of the encoder.
        torque_limit_n_m: Most that the motor is given for a moment.
        continuous_n_m: Most that it stands for long.
        velocity_limit_rad_s: Faster is wrong.
        lower_rad: Least angle; beyond by more than `beyond_rad` is wrong.
        upper_rad: Largest angle.
        stiffness_n_m_rad: Torque per angle off a commanded position.
        damping_n_m_s_rad: Torque per velocity off a commanded one.
    """

    motor: str
    encoder: str
    counts_per_rad: Positive = 5000.0
    torque_limit_n_m: Positive
    continuous_n_m: Positive
    velocity_limit_rad_s: Positive = 20.0
    lower_rad: float
    upper_rad: float
    stiffness_n_m_rad: NotNegative
    damping_n_m_s_rad: NotNegative

    @model_validator(mode="after")
    def _ranges(self) -> Self:
        if self.lower_rad >= self.upper_rad:
            raise ValueError(
                f"lower_rad: found {self.lower_rad:g}, allowed is below upper_rad,"
                f" {self.upper_rad:g}"
            )
        if self.continuous_n_m > self.torque_limit_n_m:
            raise ValueError(
                f"continuous_n_m: found {self.continuous_n_m:g}, allowed is up to"
                f" torque_limit_n_m, {self.torque_limit_n_m:g}"
            )
        return self


class WrenchSettings(Settings):
    """A force and torque sensor behind an ATI Net F/T.

    Attributes:
        force: Sensor of the MJCF.
        torque: Sensor of the MJCF.
        rate_hz: Records per second that the box sends (RDT output rate).
        counts_per_n: Counts per newton.
        counts_per_n_m: Counts per newton metre.
        range_n: Largest force that it reads.
        range_n_m: Largest torque.
        noise_n: Standard deviation of what an emulated one reads.
        noise_n_m: Likewise of torques.
    """

    force: str
    torque: str
    rate_hz: Annotated[float, Field(ge=1.0, le=7000.0)] = 1000.0
    counts_per_n: Positive = 1e6
    counts_per_n_m: Positive = 1e6
    range_n: Positive = 50.0
    range_n_m: Positive = 0.5
    noise_n: NotNegative = 0.01
    noise_n_m: NotNegative = 0.0001


class ArmSettings(Settings):
    """An arm of three joints.

    Its topics are ``<arm>/command``, ``<arm>/joint_states`` and ``<arm>/wrench``.

    Attributes:
        joints: Its joints by the names that messages have, in the order of the device.
        wrench: Its force sensor.
    """

    joints: Annotated[dict[Name, JointSettings], Field(min_length=1, max_length=3)]
    wrench: WrenchSettings | None = None


class ImuSettings(Settings):
    """An inertial unit, on ``<name>/imu``.

    Attributes:
        gyro: Sensor of the MJCF.
        accelerometer: Sensor of the MJCF.
        rate_hz: Messages per second.
        noise_rad_s: Standard deviation of an emulated gyroscope.
        noise_m_s2: Of an emulated accelerometer.
    """

    gyro: str
    accelerometer: str
    rate_hz: Annotated[float, Field(ge=1.0, le=8000.0)] = 1800.0
    noise_rad_s: NotNegative = 0.003
    noise_m_s2: NotNegative = 0.03


class PoseSettings(Settings):
    """A body that motion capture follows, on ``<name>/pose``.

    Attributes:
        position: Sensor of the MJCF.
        orientation: Sensor of the MJCF.
        rate_hz: Messages per second.
        noise_m: Standard deviation of an emulated one.
        noise_rad: Likewise of orientations.
    """

    position: str
    orientation: str
    rate_hz: Annotated[float, Field(ge=1.0, le=2000.0)] = 240.0
    noise_m: NotNegative = 0.0001
    noise_rad: NotNegative = 0.001


class HandSettings(Settings):
    """A hand.

    Attributes:
        pneu_hand: Version of this schema.
        name: Its name.
        description: What it is, for people.
        mjcf: Path of the MJCF, from the hand file.
        arms: Its arms.
        imus: Inertial units.
        poses: What motion capture follows.
    """

    pneu_hand: Literal[1] = 1
    name: str
    description: str = ""
    mjcf: str
    arms: Annotated[dict[Name, ArmSettings], Field(min_length=1)]
    imus: dict[Name, ImuSettings] = {}
    poses: dict[Name, PoseSettings] = {}


def read_hand(path: str | Path) -> HandSettings:
    """Reads a hand file, not its MJCF.

    Args:
        path: The YAML file.

    Raises:
        InputError: It is missing, is not YAML, or says what a hand cannot be.
    """
    data = read_yaml(path, "hand file")
    if not isinstance(data, dict):
        raise InputError(f"{path}: a hand file is a mapping, found {type(data).__name__}")
    if data.get("pneu_hand") != SCHEMA_VERSION:
        raise InputError(
            f"{path}: pneu_hand: found {data.get('pneu_hand')!r}, this version reads"
            f" {SCHEMA_VERSION}"
        )
    try:
        return HandSettings.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{path}: {sentence(error, HandSettings)}") from None
