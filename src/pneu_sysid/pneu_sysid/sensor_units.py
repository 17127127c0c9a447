# SPDX-License-Identifier: Apache-2.0
"""What the sensors of a rig read, pressures, angles or lengths, and how their errors are written.

Arrays hold Pa for taps, and rad or m for encoders. A result file keeps the two kinds apart, since
the unit is in a key's name where it is pascals. Tables tell Pa, mrad and mm; reports draw kPa
instead of the first.
"""

from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeVar

from pneu_sim.bodies.base import Joint
from pneu_sim.rig.schema import Rig

EncoderUnit = Literal["rad", "m"]
_T = TypeVar("_T")


@dataclass(frozen=True)
class Unit:
    """A unit, and how errors in it are written for people.

    Attributes:
        si: What arrays and files hold.
        told: The unit of tables and sentences.
        scale: How many of them one of SI is.
        places: Decimals of an error there.
        drawn: The unit of reports.
        drawn_scale: How many of them one of SI is.
    """

    si: str
    told: str
    scale: float
    places: int
    drawn: str
    drawn_scale: float

    def figure(self, value: float | None, signed: bool = False) -> str:
        """An error as tables have it, without its unit; a dash where there is none.

        Args:
            value: The error, in SI.
            signed: Whether a positive one gets its sign.
        """
        if value is None:
            return "-"
        return f"{self.scale * value:{'+' if signed else ''}.{self.places}f}"

    def words(self, value: float) -> str:
        """An error as sentences have it, with its unit.

        Args:
            value: The error, in SI.
        """
        return f"{self.figure(value)} {self.told}"


UNITS = {
    "Pa": Unit("Pa", "Pa", 1.0, 0, "kPa", 1e-3),
    "rad": Unit("rad", "mrad", 1e3, 2, "mrad", 1e3),
    "m": Unit("m", "mm", 1e3, 3, "mm", 1e3),
}
PASCAL = UNITS["Pa"]


def joints_of(rig: Rig) -> dict[str, tuple[Joint, EncoderUnit]]:
    """The joints of a rig's bodies by name, and what their positions are in.

    Args:
        rig: The rig.
    """
    return {
        joint.name or f"{name}_{field}": (joint, "m" if field in body.slides else "rad")
        for name, body in rig.bodies.items()
        for field, joint in zip(body.joint_fields, body.joints, strict=True)
    }


def encoder_unit(rig: Rig, encoder: str) -> EncoderUnit:
    """What an encoder reads: ``rad`` or ``m``.

    Args:
        rig: The rig.
        encoder: Name of the encoder; one on a joint of an MJCF, along whose recordings no model is
            run, counts as ``rad``.
    """
    one = rig.encoders[encoder]
    if one.cylinder is not None:
        return "m" if rig.cylinders[one.cylinder].rotary is None else "rad"
    joints = joints_of(rig)
    return joints[one.on(encoder)][1] if one.on(encoder) in joints else "rad"


def encoder_units(rig: Rig) -> dict[str, EncoderUnit]:
    """What each encoder of a rig reads, in the order of the rig file.

    Args:
        rig: The rig.
    """
    return {name: encoder_unit(rig, name) for name in rig.encoders}


def unit_of(sensor: str, encoders: Mapping[str, str]) -> Unit:
    """The unit of a sensor: pascals where it is no encoder.

    Args:
        sensor: Its name.
        encoders: What the encoders read.
    """
    return UNITS[encoders.get(sensor, "Pa")]


def shared(encoders: Mapping[str, str], sensors: Iterable[str]) -> Unit | None:
    """The unit of some sensors where they have one alone: it stands in a table's heading.

    Args:
        encoders: What the encoders read.
        sensors: Their names.
    """
    found = {unit_of(sensor, encoders) for sensor in sensors}
    return found.pop() if len(found) == 1 else None


def apart(
    values: Mapping[str, _T], encoders: Container[str]
) -> tuple[dict[str, _T], dict[str, _T]]:
    """Values by sensor as those of taps, in pascals, and those of encoders, in their own units.

    Args:
        values: Values by sensor.
        encoders: Names of the encoders.
    """
    return (
        {name: value for name, value in values.items() if name not in encoders},
        {name: value for name, value in values.items() if name in encoders},
    )
