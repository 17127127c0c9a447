# SPDX-License-Identifier: Apache-2.0
"""What a rig file may say of what lets gas pass: valves, their ports and spools, orifices."""

from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    model_validator,
)

from pneu_common.validation import sentence
from pneu_sim.channels import Channel
from pneu_sim.parts import Finite, NonNegative, Part, Positive, Ratio
from pneu_sim.rig.valve_kinds import (
    FiveThree,
    Regulation,
    Regulator,
    Switch,
    ThreeThree,
    ThreeTwo,
    TwoTwo,
    kind_of_valve,
    of_a_kind,
)

LEAST_STEP_V = 1e-6
"""Between points of an opening curve; closer ones are one."""


class Opening(Part):
    """A port's opening as a measured curve of spool voltage.

    Attributes:
        voltage_v: Voltages of the points, increasing.
        fraction: Opening at each, 1 = fully open.
        interpolation: ``cubic`` is monotone cubic between the points; ``power`` is monotone cubic
            in the logarithms of opening and distance from the null voltage, so that two points are
            a power law, and goes on as one down to zero at null. Its points lie on one side of it.
        mirror: Instead of points, the name of another port of the valve: its curve, mirrored about
            the null voltage, as a symmetrical spool has it.
    """

    voltage_v: list[Finite] = []
    fraction: list[NonNegative] = []
    interpolation: Literal["cubic", "power"] = "cubic"
    mirror: str | None = None

    @model_validator(mode="after")
    def _check(self) -> "Opening":
        if self.mirror is not None:
            if self.voltage_v or self.fraction:
                raise ValueError("give either mirror or voltage_v and fraction, not both")
            return self
        if len(self.voltage_v) < 2:
            raise ValueError("voltage_v needs at least two points (or name a port to mirror)")
        if len(self.voltage_v) != len(self.fraction):
            raise ValueError(
                f"voltage_v has {len(self.voltage_v)} points and fraction {len(self.fraction)};"
                " they need equally many"
            )
        if any(b <= a for a, b in pairwise(self.voltage_v)):
            raise ValueError("voltage_v must increase")
        if any(b - a < LEAST_STEP_V for a, b in pairwise(self.voltage_v)):
            raise ValueError(f"voltage_v must increase by {LEAST_STEP_V:g} V or more each time")
        return self


class Port(Part):
    """One flow path of a valve.

    Attributes:
        from_node: Node on one side; positive flow leaves it.
        to_node: Node on the other side.
        model: ``iso6358`` (sonic conductance) or ``effective_area`` (thesis 5.4).
        conductance_m3_s_pa: Sonic conductance fully open (1 dm^3/(s bar) = 1e-8).
        critical_ratio: Critical pressure ratio b.
        laminar_ratio: Pressure ratio above which flow is linear in the pressure drop, fully open.
        laminar_widening: Exponent n with which that range of ratios, 1 - ``laminar_ratio``, grows
            with the opening. 0 fixes the ratio, as ISO 6358 does; 2 fixes the slope of the flow
            where the pressures meet, as a flutter of the flow through the port makes it.
        laminar_share: Flow at the end of that range, as a share of what ISO 6358 gives there; below
            1 the flow jumps, where it turns turbulent or its flutter ends.
        jet_loss: Velocity heads of the entered pipe that the jet behind the port does not recover;
            1 makes its stagnation pressure the downstream pressure.
        inlet_head: Share of the velocity head of the pipe it leaves that drives the port; 1 makes
            its stagnation pressure the upstream pressure, as ISO 6358 does; 2 is a port that takes
            gas but none of its momentum, which piles up before it (a tee, a blind end behind it).
        area_m2: Effective area fully open, for ``effective_area``.
        opening: Opening fraction against spool voltage.
        leakage: Opening fraction that remains when the spool closes the port.
    """

    from_node: str = Field(alias="from")
    to_node: str = Field(alias="to")
    model: Literal["iso6358", "effective_area"] = "iso6358"
    conductance_m3_s_pa: NonNegative = 0.0
    critical_ratio: Ratio = 0.3
    laminar_ratio: Annotated[float, Field(gt=0.8, le=1.0)] = 0.999
    laminar_widening: Annotated[float, Field(ge=0.0, le=4.0)] = 0.0
    laminar_share: Annotated[float, Field(ge=0.1, le=1.0)] = 1.0
    jet_loss: NonNegative = 1.0
    inlet_head: Annotated[float, Field(ge=0.0, le=2.0)] = 1.0
    area_m2: NonNegative = 0.0
    opening: Opening
    leakage: NonNegative = 0.0


class Spool(Part):
    """How the spool follows its command (thesis eq. 5.4, corrected).

    Attributes:
        bandwidth_hz: Natural frequency; None follows at once.
        damping: Damping ratio.
        integral: Gain of the position loop's integral term, 1/s.
        max_acceleration_v_s2: Limit of the acceleration; None is unlimited.
        max_speed_v_s: Limit of the speed; None is unlimited. A spool without a bandwidth follows
            at once, but no faster.
        delay_s: Transport delay of the command.
        closing_delay_s: Transport delay of a command that moves the spool towards ``null_v``, where
            it differs; None is ``delay_s``. A change across null counts as closing unless it ends
            farther from null than it began. What would act before an earlier change supersedes
            it: a pulse shorter than the difference of the delays is swallowed.
        hysteresis_v: Backlash, full width.
        null_offset_v: Shift of the spool's null.
        dead_band_v: Overlap on each side of null.
        null_v: Voltage at which the spool closes; the overlap lies around it.
    """

    bandwidth_hz: Positive | None = None
    damping: Positive = 0.8
    integral: NonNegative = 0.0
    max_acceleration_v_s2: Positive | None = None
    max_speed_v_s: Positive | None = None
    delay_s: NonNegative = 0.0
    closing_delay_s: NonNegative | None = None
    hysteresis_v: NonNegative = 0.0
    null_offset_v: Finite = 0.0
    dead_band_v: NonNegative = 0.0
    null_v: Finite = 5.0


class Valve(Part):
    """A spool and the ports it opens: the general valve, which every other kind becomes.

    Attributes:
        kind: Says that it is a general one; other kinds follow below.
        command: Name of the command it follows.
        position: Where the spool's measured position is recorded, in volts of command. Recordings
            may lack it; from those that have it the spool is identified without any gas.
        spool: How the spool follows.
        switch: How the command becomes one of two voltages, of an on-off valve.
        ports: Its flow paths.
        regulator: How it holds the pressure behind it, of a pressure regulator.
    """

    kind: Literal["general"] = "general"
    command: str
    position: Channel | None = None
    spool: Spool = Spool()
    switch: Switch | None = None
    ports: dict[str, Port] = Field(min_length=1)
    regulator: Regulation | None = None

    @model_validator(mode="after")
    def _check(self) -> "Valve":
        if self.position is not None and (self.switch or self.regulator):
            raise ValueError("position: a valve with a switch or a regulator records none")
        return self


def _as_general(valve: Any) -> Valve:
    """Any kind of valve as the general one."""
    if isinstance(valve, Valve):
        return valve
    try:
        return Valve.model_validate(valve.general())
    except ValidationError as error:
        raise ValueError(sentence(error, Valve)) from None


if TYPE_CHECKING:
    AnyValve = Valve
else:
    AnyValve = Annotated[
        Annotated[Valve, Tag("general")]
        | Annotated[FiveThree, Tag("5/3")]
        | Annotated[ThreeThree, Tag("3/3")]
        | Annotated[ThreeTwo, Tag("3/2")]
        | Annotated[TwoTwo, Tag("2/2")]
        | Annotated[Regulator, Tag("regulator")],
        Discriminator(kind_of_valve),
        BeforeValidator(of_a_kind),
        AfterValidator(_as_general),
    ]
    """A valve of any kind in the file, a general one from then on."""


class Orifice(Part):
    """A fixed restriction between two nodes.

    Attributes:
        from_node: Node on one side; positive flow leaves it.
        to_node: Node on the other side.
        conductance_m3_s_pa: Sonic conductance (ISO 6358).
        critical_ratio: Critical pressure ratio b.
        laminar_ratio: Pressure ratio above which flow is linear in the pressure drop (viscous).
    """

    from_node: str = Field(alias="from")
    to_node: str = Field(alias="to")
    conductance_m3_s_pa: NonNegative
    critical_ratio: Ratio = 0.3
    laminar_ratio: Annotated[float, Field(gt=0.8, le=1.0)] = 0.999
