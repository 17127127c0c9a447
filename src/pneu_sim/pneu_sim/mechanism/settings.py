# SPDX-License-Identifier: Apache-2.0
"""What a rig file says of a mechanism: its MJCF, and where the pistons of cylinders take hold."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from pneu_sim.parts import Finite, NonNegative, Part, Positive


def _not_zero(value: float) -> float:
    """Refuses a gear by which a cylinder would not move anything."""
    if value == 0.0:
        raise ValueError("a number other than 0 is needed")
    return value


class Grip(Part):
    """Where a cylinder takes hold: at one joint, at one tendon, or between two sites.

    Its extension is ``gear`` times the joint's position, the tendon's length or the distance of the
    sites, less ``offset_m``.

    Attributes:
        joint: Name of a joint that turns or slides about one axis.
        tendon: Name of a tendon.
        sites: Names of two sites; the cylinder acts along the line between them.
        offset_m: What stands there where the piston is fully retracted, m.
        gear: Extension per motion of what it holds: m/rad at a joint that turns, else 1 or, where
            the cylinder shortens as the other grows, -1.
    """

    joint: str | None = None
    tendon: str | None = None
    sites: Annotated[list[str], Field(min_length=2, max_length=2)] | None = None
    offset_m: Finite = 0.0
    gear: Annotated[Finite, AfterValidator(_not_zero)] = 1.0

    @model_validator(mode="after")
    def _check(self) -> "Grip":
        held = [n for n in ("joint", "tendon", "sites") if getattr(self, n) is not None]
        if len(held) != 1:
            found = " and ".join(held) or "none"
            raise ValueError(f"found {found}, one of joint, tendon and sites is needed")
        if self.sites and self.sites[0] == self.sites[1]:
            raise ValueError(f"sites: found {self.sites[0]!r} twice, two sites are needed")
        return self

    @property
    def held(self) -> tuple[str, ...]:
        """What it holds, the same for all ways to write it."""
        if self.joint is not None:
            return "joint", self.joint
        if self.tendon is not None:
            return "tendon", self.tendon
        return ("sites", *sorted(self.sites or ()))

    @property
    def told(self) -> str:
        """What it holds, as a sentence has it."""
        kind, *names = self.held
        return f"{kind} {' and '.join(repr(name) for name in names)}"


class MechanismSettings(Part):
    """A mechanism that MuJoCo moves.

    Attributes:
        mjcf: The MJCF file; relative to the rig file's folder.
        cylinders: Where cylinders take hold, by the cylinder's name.
        step_s: Physics step, s; None is the MJCF's own.
        coupling: How gas and mechanism are stepped in turn: ``second_order``, or as in the
            ``thesis`` (5.6), of first order.
        keyframe: The MJCF's keyframe it starts from; None is its reference position.
        start: Positions of joints at the beginning that differ from it, rad or m, by name.
        masses_kg: Masses of bodies that differ from the MJCF's, by name; their inertia about
            themselves goes with them.
        damping: Damping of joints that differs from the MJCF's, by name, N m s/rad or N s/m.
    """

    mjcf: str
    cylinders: dict[str, Grip] = Field(min_length=1)
    step_s: Positive | None = None
    coupling: Literal["thesis", "second_order"] = "second_order"
    keyframe: str | None = None
    start: dict[str, Finite] = Field(default_factory=dict)
    masses_kg: dict[str, Positive] = Field(default_factory=dict)
    damping: dict[str, NonNegative] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check(self) -> "MechanismSettings":
        by: dict[tuple[str, ...], str] = {}
        for name, grip in self.cylinders.items():
            other = by.setdefault(grip.held, name)
            if other != name:
                raise ValueError(
                    f"cylinders.{name}: found {grip.told}, which {other!r} holds already; each"
                    " cylinder needs one of its own"
                )
        return self
