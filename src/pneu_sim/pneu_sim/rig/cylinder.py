# SPDX-License-Identifier: Apache-2.0
"""What a rig file may say of a cylinder: its gas, its seals, its friction and where it ends."""

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from pneu_sim.parts import Finite, NonNegative, Part, Positive, Ratio


class Friction(Part):
    """What the seals of a piston and its rod hold it back with, whatever its speed or with it.

    While it slides, ``coulomb_n + coulomb_n_per_pa * mean gauge pressure + breakaway_n exp(-(v /
    stribeck_m_s)^2) + viscous_n_s_m v``; at rest it holds against the sum of the first three. In N,
    or in N m of a rotary one.

    Attributes:
        coulomb_n: Sliding friction.
        coulomb_n_per_pa: Growth of the sliding friction per pascal of the mean gauge pressure of
            both sides (for seals that the pressure presses on).
        breakaway_n: By how much more it holds at rest.
        stribeck_m_s: Speed over which that vanishes (Stribeck).
        viscous_n_s_m: Friction per speed, N s/m.
        presliding_m_n: Compliance of the seals before they slide, m/N: the piston moves by that
            much per force it is held with, and the force comes near the whole friction as the way
            grows (the bristles of Canudas de Wit and others 1995, doi:10.1109/9.376053). 0 holds it
            rigidly until it slides.
        presliding_n_s_m: Damping of that deflection, N s/m.
    """

    coulomb_n: NonNegative = 0.0
    coulomb_n_per_pa: NonNegative = 0.0
    breakaway_n: NonNegative = 0.0
    stribeck_m_s: Positive = 0.01
    viscous_n_s_m: NonNegative = 0.0
    presliding_m_n: NonNegative = 0.0
    presliding_n_s_m: NonNegative = 0.0


class Cushion(Part):
    """What throttles the gas that leaves a side while its piston comes to that end.

    Attributes:
        length_m: How far from the end it begins, m, or rad of a rotary one.
        opening: Share of the way in that is left at the end: of the side's port, or, where it has
            none, of the end of its pipe. It shrinks in proportion to the piston's way. Gas that
            enters finds it open (a check valve).
    """

    length_m: Positive
    opening: Annotated[Ratio, Field(gt=0.0)] = 0.1


class Side(Part):
    """The gas on one side of a piston.

    Attributes:
        node: Node at which it lies: a pipe's end, a valve's port. ``closed`` is sealed.
        dead_volume_m3: Volume that is left when the piston stands at this side's end.
        heat_w_per_k: Heat conductance of its wall that does not change with the piston's way.
        port_conductance_m3_s_pa: Sonic conductance of the way in; None does not throttle.
        port_critical_ratio: Critical pressure ratio of that.
        cushion: Throttling at this end of what leaves through a port or, of a chamber, a pipe.
    """

    node: str
    dead_volume_m3: Positive
    heat_w_per_k: NonNegative = 0.0
    port_conductance_m3_s_pa: Positive | None = None
    port_critical_ratio: Ratio = 0.3
    cushion: Cushion | None = None

    @model_validator(mode="after")
    def _check(self) -> "Side":
        if self.cushion is not None and self.node == "closed":
            raise ValueError("a cushion needs a way out: node closed has none")
        if self.node == "closed" and self.port_conductance_m3_s_pa is not None:
            raise ValueError("node closed has no port: leave port_conductance_m3_s_pa out")
        return self


class Rotary(Part):
    """A rotary actuator (a vane, a rack): angles take the place of lengths.

    Attributes:
        displacement_m3_rad: Volume per angle, alike on both sides, m3/rad.
        stroke_rad: Its range.
    """

    displacement_m3_rad: Positive
    stroke_rad: Positive


class Cylinder(Part):
    """A cylinder, single- or double-acting; its extension grows as the head side fills.

    Forces, lengths and speeds of a rotary one are torques, angles and angular speeds.

    Attributes:
        bore_m: Diameter of the piston.
        rod_m: Diameter of the rod; 0 has none.
        stroke_m: Way from end to end.
        rotary: Instead of these three, a rotary actuator.
        head: Gas on the side that extends; None is open to the room.
        rod: Gas on the side of the rod; None is open to the room (single-acting).
        gas: How it is held: ``chamber``, well mixed; ``cells``, as a wide pipe whose cells appear
            and vanish as the piston moves (thesis 5.6, 5.7).
        dx_m: Length of those cells, where it differs from the grid's.
        gas_friction: Factor on the friction of the gas along the bore, where it is held in cells.
        heat_w_m2_k: Heat transfer from all of its wall that the gas wets.
        friction: Friction of its seals.
        piston_leak_m2: Effective area from side to side past the piston.
        rod_leak_m2: Effective area from the rod side to the room past the rod.
        spring_n_m: Rate of a spring that draws it in.
        spring_preload_n: Force of that spring when drawn in.
        stop_stiffness_n_m: Of both end stops.
        stop_damping_n_s_m: Of both end stops.
        start_m: Extension at which it stands, where no body says so.
        loose_kg: Mass of what moves by itself within the play of a joint: piston, rod, clevis (or
            kg m^2 of a rotary one). Where there is no play it is part of the body's inertia.
    """

    bore_m: Positive | None = None
    rod_m: NonNegative = 0.0
    stroke_m: Positive | None = None
    rotary: Rotary | None = None
    head: Side | None = None
    rod: Side | None = None
    gas: Literal["chamber", "cells"] = "chamber"
    dx_m: Positive | None = None
    gas_friction: NonNegative = 1.0
    heat_w_m2_k: NonNegative = 0.0
    friction: Friction = Friction()
    piston_leak_m2: NonNegative = 0.0
    rod_leak_m2: NonNegative = 0.0
    spring_n_m: NonNegative = 0.0
    spring_preload_n: Finite = 0.0
    stop_stiffness_n_m: Positive = 2e7
    stop_damping_n_s_m: NonNegative = 5000.0
    start_m: NonNegative = 0.0
    loose_kg: Positive = 0.1

    @model_validator(mode="after")
    def _check(self) -> "Cylinder":
        if self.rotary is not None:
            if self.bore_m is not None or self.stroke_m is not None or self.rod_m > 0.0:
                raise ValueError("give either rotary or bore_m, rod_m and stroke_m, not both")
            if self.heat_w_m2_k > 0.0:
                raise ValueError(
                    "heat_w_m2_k: the wall of a rotary one is not known; give heat_w_per_k of its"
                    " sides"
                )
            if self.gas != "chamber":
                raise ValueError("gas: found cells, the gas of a rotary one is a chamber")
        elif self.bore_m is None or self.stroke_m is None:
            raise ValueError("bore_m and stroke_m are needed (or rotary)")
        elif self.rod_m >= self.bore_m:
            raise ValueError(
                f"rod_m: found {self.rod_m:g}, it must be smaller than bore_m {self.bore_m:g}"
            )
        if self.head is None and self.rod is None:
            raise ValueError("head or rod is needed: a side that holds gas")
        if self.start_m > self.stroke:
            raise ValueError(
                f"start_m: found {self.start_m:g}, beyond its stroke of {self.stroke:g}"
            )
        for name, side in (("head", self.head), ("rod", self.rod)):
            cushion = None if side is None else side.cushion
            if cushion is None or side is None:
                continue
            if self.gas == "cells" and side.port_conductance_m3_s_pa is None:
                raise ValueError(
                    f"{name}.cushion: needs {name}.port_conductance_m3_s_pa where gas is cells"
                )
            if cushion.length_m > self.stroke:
                raise ValueError(
                    f"{name}.cushion.length_m: found {cushion.length_m:g}, beyond the stroke of"
                    f" {self.stroke:g}"
                )
        return self

    @property
    def stroke(self) -> float:
        """Way from end to end, m, or rad of a rotary one."""
        if self.rotary is not None:
            return self.rotary.stroke_rad
        assert self.stroke_m is not None
        return self.stroke_m

    @property
    def areas(self) -> tuple[float, float]:
        """Of head and rod side, m2, or m3/rad of a rotary one."""
        if self.rotary is not None:
            return self.rotary.displacement_m3_rad, self.rotary.displacement_m3_rad
        assert self.bore_m is not None
        quarter = 0.25 * math.pi
        return quarter * self.bore_m**2, quarter * (self.bore_m**2 - self.rod_m**2)

    @property
    def sides(self) -> dict[str, Side]:
        """The sides that hold gas, by name."""
        both = {"head": self.head, "rod": self.rod}
        return {name: side for name, side in both.items() if side is not None}

    def perimeter_m(self, side: str) -> float:
        """What gas on a side wets per way of the piston: bore, and rod, m.

        Args:
            side: ``head`` or ``rod``.
        """
        if self.bore_m is None:
            return 0.0
        return math.pi * (self.bore_m + (self.rod_m if side == "rod" else 0.0))
