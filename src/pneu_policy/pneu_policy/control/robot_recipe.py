# SPDX-License-Identifier: Apache-2.0
"""What a learned controller of a robot sees and does (thesis 7.1-7.3, 9.2.1, 9.2.4).

A recipe says which features are made of encoders, pressures and targets; it travels with the
policy, so that training and the real rig use one code. What only a model tells (spools, gas along
lines) is for studies in simulation; `hardware` says whether a recipe does without.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from pneu_common.validation import Listed, Settings
from pneu_policy.control.observations import DENSITY_KG_M3, GAS, VELOCITY_M_S, Points
from pneu_policy.control.plan_settings import PlanSettings
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]
Positive = Annotated[float, Field(gt=0.0)]
Names = Annotated[tuple[str, ...], Listed]
Times = Annotated[tuple[float, ...], Listed]

SPOOL_SPEED_V_S = 500.0
"""Speeds of spools are told in these."""


class Motion(Settings):
    """How what an encoder reads is told.

    Attributes:
        centre: Positions are told from here, rad or m ...
        range: ... in these.
        speed: Speeds are told in these, per second.
        span: Distances from a target are told in these.
        turns: Whether it turns round and round: told as sine and cosine of its angle.
        hidden: Whether its position is left out, as that of something that walks away.
    """

    centre: float = 0.0
    range: Positive = 1.0
    speed: Positive = 1.0
    span: Positive = 1.0
    turns: bool = False
    hidden: bool = False


class Chain(Settings):
    """A hand at the end of links in one plane, told as two more encoders, x and y, m.

    Attributes:
        joints: Encoders of its joints, from the base on; angles from the link before.
        lengths_m: Lengths of the links.
        x: Name of the hand's place along the direction of all joints at zero.
        y: Name of that across.
    """

    joints: Names
    lengths_m: Times
    x: str = "hand_x"
    y: str = "hand_y"

    def place(self, angles: Floats) -> tuple[Floats, Floats]:
        """Where the hand is, m.

        Args:
            angles: (..., joints) rad.
        """
        whole = np.cumsum(angles, axis=-1)
        lengths = np.array(self.lengths_m)
        return np.cos(whole) @ lengths, np.sin(whole) @ lengths


class Push(Settings):
    """The net force of the gas on a piston, as two taps tell it, and what is asked of it.

    Attributes:
        head_tap: Tap at the head side; None is open to the room.
        rod_tap: Tap at the rod side; likewise.
        head_m2: Area there, or displacement of a rotary actuator; None is the rig's.
        rod_m2: Likewise.
        room_pa: Pressure of the room; None is the rig's.
        span_n: Forces are told in these.
    """

    head_tap: str | None
    rod_tap: str | None
    head_m2: float | None = None
    rod_m2: float | None = None
    room_pa: float | None = None
    span_n: Positive = 100.0

    def of_rig(self, rig: Rig, cylinder: str) -> "Push":
        """The same with what a rig says where nothing was said.

        Args:
            rig: The rig.
            cylinder: The cylinder.
        """
        head_m2, rod_m2 = rig.cylinders[cylinder].areas
        filled = {
            "head_m2": head_m2 if self.head_m2 is None else self.head_m2,
            "rod_m2": rod_m2 if self.rod_m2 is None else self.rod_m2,
            "room_pa": rig.ambient.pressure_pa if self.room_pa is None else self.room_pa,
        }
        return self.model_copy(update=filled)

    def force_n(self, pressure_pa: Mapping[str, Any]) -> Any:
        """Net force of the gas on the piston, N.

        Args:
            pressure_pa: By tap its reading or readings, Pa.

        Raises:
            ValueError: Areas or the room's pressure are not known.
        """
        if self.head_m2 is None or self.rod_m2 is None or self.room_pa is None:
            raise ValueError("areas and the room's pressure are not known; take them from a rig")
        force: Any = 0.0
        for tap, area in ((self.head_tap, self.head_m2), (self.rod_tap, -self.rod_m2)):
            if tap is not None:
                force = force + area * (pressure_pa[tap] - self.room_pa)
        return force


class RobotRecipe(Settings):
    """How features are made, and actions become voltages.

    Attributes:
        encoders: What is seen of the motion, by the rig's encoder.
        tracked: Encoders that have a target.
        see_target: Whether distances from targets are told.
        see_motion: Whether encoders are told; their targets may be without.
        chain: Places that are computed from encoders as if they were some themselves.
        taps: Taps that are seen.
        commands: Commands of the actions, in their order.
        opposed: Whether commands go in pairs, the second closed as far as the first is opened (eq.
            9.2); there is one action to a pair then.
        preview_s: Times ahead at which targets are told, s; the first is now.
        forces: Cylinders whose required force is told at these times (thesis 9.2.3, 9.2.4).
        ways: Whether the way that their pistons will go is told as well.
        plan: How joints are led to their targets, where that says which forces are required.
        past: How many of the latest commands are seen.
        spools: Whether spools are seen, in simulation.
        line: Pipes whose gas is seen, each with its number of points, in simulation (thesis 7.3).
        base: Base b of the positional encoding (thesis 7.2).
        levels: Zoom levels of the positional encoding, b^0 to b^(levels - 1); 0 is without.
        period_s: Control period, s.
        centre_pa: Pressures are told from here, Pa ...
        range_pa: ... in these, Pa.
        null_v: Voltage at which a valve closes, V.
        half_v: Volts from there at an action of one.
    """

    encoders: dict[str, Motion]
    tracked: Names = ()
    see_target: bool = True
    see_motion: bool = True
    chain: Chain | None = None
    taps: Names = ()
    commands: Names
    opposed: bool = False
    preview_s: Times = (0.0,)
    forces: dict[str, Push] = Field(default_factory=dict)
    ways: bool = False
    plan: PlanSettings | None = None
    past: Annotated[int, Field(ge=0, le=20)] = 1
    spools: bool = False
    line: Annotated[tuple[Points, ...], Listed] = ()
    base: Positive = 2.0
    levels: Annotated[int, Field(ge=0, le=20)] = 3
    period_s: Positive = 0.01
    centre_pa: Positive = 350e3
    range_pa: Positive = 200e3
    null_v: float = 5.0
    half_v: Positive = 5.0

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        ahead = self.preview_s
        if not ahead or ahead[0] != 0.0 or not all(a < b for a, b in pairwise(ahead)):
            raise ValueError(f"preview_s: found {list(ahead)}, needed are rising times from 0")
        for name in self.tracked:
            if name not in self.encoders:
                known = ", ".join(self.encoders) or "none"
                raise ValueError(f"tracked: found {name!r}, encoders has {known}")
        if self.chain is not None:
            c = self.chain
            if len(c.joints) != len(c.lengths_m):
                raise ValueError(f"chain: found {len(c.joints)} joints, {len(c.lengths_m)} lengths")
            for name in (*c.joints, c.x, c.y):
                if name not in self.encoders:
                    raise ValueError(f"chain: found {name!r}, which encoders does not have")
        for what, names in (("taps", self.taps), ("commands", self.commands)):
            if len(set(names)) != len(names):
                raise ValueError(f"{what}: found {', '.join(names)}, each may stand there once")
        if self.ways and not self.forces:
            raise ValueError("ways: found true, of which cylinders is said by forces")
        if not self.commands:
            raise ValueError("commands: found none, needed is one at least")
        if self.opposed and len(self.commands) % 2:
            raise ValueError(f"commands: found {len(self.commands)}, opposed ones go in pairs")
        for name, push in self.forces.items():
            for tap in (push.head_tap, push.rod_tap):
                if tap is not None and tap not in self.taps:
                    raise ValueError(f"forces.{name}: found tap {tap!r}, which taps does not have")
        return self

    def of_rig(self, rig: Rig) -> "RobotRecipe":
        """The same with what a rig says of cylinders where nothing was said.

        Args:
            rig: The rig; has the cylinders.
        """
        forces = {name: push.of_rig(rig, name) for name, push in self.forces.items()}
        return self.model_copy(update={"forces": forces})

    @property
    def hardware(self) -> bool:
        """Whether sensors alone tell what it sees."""
        return not (self.spools or self.line)

    @property
    def measured(self) -> Names:
        """Encoders that are read, in the order of what is given to `positions`."""
        computed = () if self.chain is None else (self.chain.x, self.chain.y)
        return tuple(name for name in self.encoders if name not in computed)

    def positions(self, readings: Floats) -> Floats:
        """What is seen of the motion, rad or m.

        Args:
            readings: (count, measured).

        Returns:
            (count, encoders), computed ones among them.
        """
        if self.chain is None:
            return readings
        told = dict(zip(self.measured, readings.T, strict=True))
        angles = np.stack([told[name] for name in self.chain.joints], axis=-1)
        told[self.chain.x], told[self.chain.y] = self.chain.place(angles)
        return np.stack([told[name] for name in self.encoders], axis=-1)

    @property
    def actions(self) -> int:
        """Number of actions."""
        return len(self.commands) // (2 if self.opposed else 1)

    def names(self) -> list[str]:
        """Returns what each feature is, in order."""
        zooms = [f"{wave} {n} of " for wave in ("sin", "cos") for n in range(self.levels)]
        names: list[str] = []
        followed = self.tracked if self.see_target else ()
        for what in (*followed, *(f"force {name}" for name in self.forces)):
            for ahead in self.preview_s:
                error = f"{what} off its target at {ahead:g} s"
                names += [error, *(zoom + error for zoom in zooms)]
        if self.ways:
            names += [f"way {name} at {at:g} s" for name in self.forces for at in self.preview_s]
        for name, motion in self.encoders.items() if self.see_motion else ():
            if not motion.hidden:
                names += [f"sin {name}", f"cos {name}"] if motion.turns else [f"position {name}"]
        names += [f"speed {name}" for name in self.encoders if self.see_motion]
        names += [f"pressure {tap}" for tap in self.taps]
        names += [f"force {name}" for name in self.forces]
        names += [f"{name} {n + 1} back" for n in range(self.past) for name in self._acted()]
        if self.spools:
            names += [f"{what} {name}" for what in ("spool", "its speed") for name in self.commands]
        for pipe, points in self.line:
            names += [f"{what} {pipe} {n}" for what in GAS for n in range(points)]
        return names

    @property
    def size(self) -> int:
        """Number of features."""
        return len(self.names())

    def _acted(self) -> Names:
        return self.commands[::2] if self.opposed else self.commands

    def volts(self, actions: Any) -> Floats:
        """(count, commands) voltages of actions.

        Args:
            actions: (count, actions); beyond -1 and 1 they are cut off.
        """
        a = np.clip(np.asarray(actions, dtype=np.float64), -1.0, 1.0)
        if self.opposed:
            a = np.stack([a, -a], axis=-1).reshape(len(a), -1)
        return self.null_v + self.half_v * a


@dataclass(frozen=True)
class Moment:
    """What is known at one moment of robots side by side; what no recipe asks for may be left out.

    Attributes:
        positions: (count, encoders) as of `RobotRecipe.positions`.
        taps_pa: (count, taps).
        targets: (count, tracked, previews) rad or m.
        forces_n: (count, cylinders, previews) required of the gas.
        ways: (count, cylinders, previews) extensions over the stroke.
        spools_v: (count, 2 commands) positions, then speeds.
        line: (count, points) gas of lines.
    """

    positions: Floats
    taps_pa: Floats
    targets: Floats | None = None
    forces_n: Floats | None = None
    ways: Floats | None = None
    spools_v: Floats | None = None
    line: Floats | None = None


class RobotObserver:
    """Makes the features of one robot or of many side by side, remembering what they need."""

    def __init__(self, recipe: RobotRecipe, count: int = 1) -> None:
        """Starts without a past.

        Args:
            recipe: How features are made.
            count: Robots side by side.
        """
        r = self.recipe = recipe
        self._zoom = r.base ** np.arange(r.levels)
        motions = list(r.encoders.values())
        self._tracked = [list(r.encoders).index(name) for name in r.tracked]
        self._span = np.array([motions[e].span for e in self._tracked])
        self._turning = [e for e, m in enumerate(motions) if m.turns and not m.hidden]
        self._order = _order(motions)
        self._centre = np.array([m.centre for m in motions])
        self._range = np.array([m.range for m in motions])
        self._speed = np.array([m.speed for m in motions])
        self._whole = np.array([m.turns for m in motions], dtype=bool)
        self._force_span = np.array([push.span_n for push in r.forces.values()])
        counts = [points for _, points in r.line]
        self._line_from = np.concatenate(
            [np.repeat([0.0, 0.0, r.centre_pa], n) for n in counts] or [np.empty(0)]
        )
        self._line_in = np.concatenate(
            [np.repeat([DENSITY_KG_M3, VELOCITY_M_S, r.range_pa], n) for n in counts]
            or [np.empty(0)]
        )
        self._before: Floats | None = None
        self._commands = np.zeros((count, r.past, r.actions))

    def reset(self) -> None:
        """Forgets the past: as if all had stood still and valves had been closed."""
        self._before = None
        self._commands[:] = 0.0

    def forces(self, taps_pa: Floats) -> Floats:
        """(count, cylinders) net forces of the gas on pistons, N.

        Args:
            taps_pa: (count, taps) in the order of the recipe's taps.
        """
        r = self.recipe
        told = dict(zip(r.taps, taps_pa.T, strict=True))
        out = np.zeros((len(taps_pa), len(r.forces)))
        for c, push in enumerate(r.forces.values()):
            out[:, c] = push.force_n(told)
        return out

    def observe(self, now: Moment) -> Floats:
        """Features of a moment, one control period after the last.

        Args:
            now: What is known.

        Returns:
            (count, size) features.

        Raises:
            ValueError: A value is not finite, or something that the recipe asks for is missing.
        """
        r = self.recipe
        n = len(now.positions)
        parts: list[Floats] = []
        if r.tracked and r.see_target:
            off = _given(now.targets, "targets") - now.positions[:, self._tracked, None]
            parts.append(self._encoded(off / self._span[:, None]))
        pushed = self.forces(now.taps_pa)
        if r.forces:
            off = _given(now.forces_n, "forces") - pushed[:, :, None]
            parts.append(self._encoded(off / self._force_span[:, None]))
        if r.ways:
            parts.append((2.0 * _given(now.ways, "ways") - 1.0).reshape(n, -1))
        if r.see_motion:
            parts += self._motion(now.positions)
        parts.append((now.taps_pa - r.centre_pa) / r.range_pa)
        if r.forces:
            parts.append(pushed / self._force_span)
        parts.append(self._commands.reshape(n, -1))
        if r.spools:
            spools = _given(now.spools_v, "spools")
            k = len(r.commands)
            parts.append((spools[:, :k] - r.null_v) / r.half_v)
            parts.append(spools[:, k:] / SPOOL_SPEED_V_S)
        if r.line:
            parts.append((_given(now.line, "the gas of lines") - self._line_from) / self._line_in)
        out = np.concatenate(parts, axis=1)
        # A sum is not finite where a term is not; cheaper than a look at each.
        if not math.isfinite(float(out.sum())):
            raise ValueError(
                f"found positions {now.positions}, readings {now.taps_pa} Pa and targets"
                f" {now.targets}; all must be finite"
            )
        return out

    def acted(self, actions: Floats) -> None:
        """Remembers what was done.

        Args:
            actions: (count, actions), cut off at -1 and 1.
        """
        if self.recipe.past:
            self._commands[:, 1:] = self._commands[:, :-1].copy()
            self._commands[:, 0] = np.clip(actions, -1.0, 1.0)

    def _motion(self, positions: Floats) -> list[Floats]:
        """Positions and speeds as they are told; remembers them."""
        plain = (positions - self._centre) / self._range
        angle = positions[:, self._turning]
        told = np.concatenate([plain, np.sin(angle), np.cos(angle)], axis=1)
        moved = positions - (positions if self._before is None else self._before)
        turned = moved[:, self._whole]
        moved[:, self._whole] = np.arctan2(np.sin(turned), np.cos(turned))
        self._before = positions.copy()
        return [told[:, self._order], moved / (self.recipe.period_s * self._speed)]

    def _encoded(self, error: Floats) -> Floats:
        """(count, rows, previews) errors, each with its positional encoding, in one row."""
        angle = error[..., None] * self._zoom
        told = np.concatenate([error[..., None], np.sin(angle), np.cos(angle)], axis=-1)
        return told.reshape(len(error), -1)


def _given(value: Floats | None, what: str) -> Floats:
    if value is None:
        raise ValueError(f"the recipe wants {what}, found none")
    return value


def _order(motions: list[Motion]) -> list[int]:
    """Where each told position stands in all positions, then the sines, then the cosines."""
    turning = [e for e, m in enumerate(motions) if m.turns and not m.hidden]
    order: list[int] = []
    for e, motion in enumerate(motions):
        if motion.hidden:
            continue
        if motion.turns:
            at = len(motions) + turning.index(e)
            order += [at, at + len(turning)]
        else:
            order.append(e)
    return order
