# SPDX-License-Identifier: Apache-2.0
"""What a rig file may say: pipes, reservoirs, chambers, valves, taps, channels, effects, fit.

A rig is a network of named *nodes*. Pipes run from one node to another; a reservoir or a chamber of
that name sits at the node; valve ports and orifices connect two nodes. The node ``closed`` is a
wall. All quantities are SI, pressures absolute.
"""

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
from pneu_sim.bodies.kinds import AnyBody
from pneu_sim.channels import Channel, TextFormat
from pneu_sim.mechanism.settings import MechanismSettings
from pneu_sim.parts import Finite, NonNegative, Part, Positive, Ratio
from pneu_sim.rig.cylinder import Cylinder
from pneu_sim.rig.kinds import checked
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

SCHEMA_VERSION = 1
CLOSED = "closed"
LEAST_STEP_V = 1e-6
"""Between points of an opening curve; closer ones are one."""


class Grid(Part):
    """How the lines are discretised.

    Attributes:
        dx_m: Cell length.
        order: 1 is Godunov's scheme, 2 MUSCL-Hancock.
        flux: ``hllc``, or ``exact`` for the exact Riemann solution.
        limiter: Slope limiter of order 2.
        newton_iterations: Iterations for the star pressure of ``exact`` (thesis 4.6.3 uses two).
        cfl: Courant number of the time step (thesis eq. 4.23).
        wave_speed_m_s: Fastest wave the step must allow for.
        dt_s: Time step; None takes it from the CFL condition. Above the stable limit it is refused.
        memory: Whether wall friction and heat are frequency dependent.
        thesis_ends: Treat a reservoir as a neighbouring cell of constant state (thesis 5.5), which
            swallows every wave like an endless pipe, instead of as a large vessel.
        thesis_joints: Join pipes by smallest-area faces and fictitious walls (thesis 5.3,
            fig. 5.6), which resist steady flow wherever the area changes; else three or more ends
            share one pressure, and steady flow across an area step is kept as such.
    """

    dx_m: Positive = 0.05
    order: Literal[1, 2] = 2
    flux: Literal["hllc", "exact"] = "hllc"
    limiter: Literal["minmod", "van_leer"] = "van_leer"
    newton_iterations: int = Field(default=2, ge=1, le=50)
    cfl: float = Field(default=0.9, gt=0.0, le=1.0)
    wave_speed_m_s: Positive = 600.0
    dt_s: Positive | None = None
    memory: bool = True
    thesis_ends: bool = False
    thesis_joints: bool = False


class Ambient(Part):
    """The room: it surrounds every wall and takes up every leak.

    Attributes:
        pressure_pa: Its pressure.
        temperature_k: Its temperature.
    """

    pressure_pa: Positive = 101325.0
    temperature_k: Positive = 293.15


class Wall(Part):
    """How a pipe wall acts on the gas.

    Attributes:
        laminar: Factor on laminar drag 8 pi mu u; the thesis as printed (4 pi mu u) is 0.5.
        turbulent: Gain on what turbulence adds to the drag (Haaland); 0 is laminar throughout.
        onset_reynolds: Reynolds number at which turbulence sets in; full at 1.74 times that.
        roughness_m: Height of the wall's roughness.
        unsteady: Factor on frequency-dependent friction (Zielke).
        turbulent_fade: Gain on how much faster the memory of friction and heat fades in turbulent
            flow; 1 is Vardy and Brown (2003), 0 as in laminar flow.
        nusselt: Nusselt number of quasi-steady wall heat, on the section's mean temperature; 8 is
            the limit that belongs to the unsteady kernel, 3.66 the developed flow at constant wall
            temperature, 0 (with no gain on what follows) an adiabatic wall.
        heat_turbulent: Gain on what turbulence adds to wall heat (Gnielinski).
        heat_unsteady: Factor on frequency-dependent wall heat.
        heat_kappa: Conductivity of thesis eq. 5.3, W/(m^2 K); replaces ``nusselt`` where given.
        compliance_per_pa: Relative growth of the cross-section per pascal.
    """

    laminar: NonNegative = 1.0
    turbulent: NonNegative = 1.0
    onset_reynolds: Positive = 2300.0
    roughness_m: NonNegative = 0.0
    unsteady: NonNegative = 1.0
    turbulent_fade: NonNegative = 1.0
    nusselt: NonNegative = 8.0
    heat_turbulent: NonNegative = 1.0
    heat_unsteady: NonNegative = 1.0
    heat_kappa: NonNegative | None = None
    compliance_per_pa: NonNegative = 0.0


class LocalLoss(Part):
    """A fitting or valve body in a pipe.

    Attributes:
        position_m: Where it sits.
        k: Velocity heads it costs (turbulent).
        resistance_pa_s_m: Pressure drop per velocity (viscous), the "added viscosity just for the
            valve-adjacent cell" of thesis 5.4.
    """

    position_m: NonNegative
    k: NonNegative = 0.0
    resistance_pa_s_m: NonNegative = 0.0


class Leak(Part):
    """A way to the room in a pipe's wall: a hole, or something porous (a seal, a thread).

    Attributes:
        position_m: Where it sits.
        area_m2: Effective area of an orifice.
        porous_m3: Permeability x area / length of a porous plug; of a capillary of diameter d and
            length l, pi d^4 / (128 l). It leaks porous_m3 (p^2 - p_room^2) / (2 mu R T).
    """

    position_m: NonNegative
    area_m2: NonNegative = 0.0
    porous_m3: NonNegative = 0.0


class Relief(Part):
    """A relief valve: an orifice to the room that opens above a set pressure.

    Attributes:
        area_m2: Effective area fully open.
        set_pa: Pressure at which it begins to open.
        range_pa: By how much more it is fully open; between, the area grows in proportion.
    """

    area_m2: NonNegative
    set_pa: Positive
    range_pa: Positive = 2e4


class PipeRelief(Relief):
    """A relief valve on a pipe.

    Attributes:
        area_m2: Effective area fully open.
        set_pa: Pressure at which it begins to open.
        range_pa: By how much more it is fully open; between, the area grows in proportion.
        position_m: Where it sits.
    """

    position_m: NonNegative


class Ripple(Part):
    """A pulsation of a reservoir's pressure: a compressor's strokes, a regulator that hunts.

    Attributes:
        amplitude_pa: Its amplitude, half of peak to peak.
        frequency_hz: Its frequency.
        phase_rad: Phase of its sine at time zero of the simulation or recording.
    """

    amplitude_pa: NonNegative
    frequency_hz: Positive
    phase_rad: Finite = 0.0


class DeadVolume(Part):
    """A volume that hangs on a pipe: a fitting, a sensor's cavity.

    Attributes:
        position_m: Where it sits.
        volume_m3: Its volume.
    """

    position_m: NonNegative
    volume_m3: NonNegative


class Narrowing(Part):
    """A stretch of a pipe with less area: a kink, a blockage.

    Attributes:
        position_m: Its middle.
        length_m: Its length.
        fraction: Share of the area that is lost.
    """

    position_m: NonNegative
    length_m: Positive = 0.1
    fraction: Annotated[float, Field(ge=0.0, le=0.98)]


class Pipe(Part):
    """A line between two nodes.

    Attributes:
        from_node: Node at position 0.
        to_node: Node at position ``length_m``.
        length_m: Length.
        area_m2: Cross-section.
        area_profile: Optional (position, area) corners of a cross-section that varies linearly.
        dx_m: Cell length, where it differs from the grid's.
        wall: Friction and heat.
        losses: Local losses.
        leaks: Leaks to the room.
        reliefs: Relief valves.
        volumes: Dead volumes.
        narrowings: Stretches of reduced area.
        volume_from_m3: Volume at the ``from`` end (a valve's chamber, a fitting).
        volume_to_m3: Volume at the ``to`` end.
        loss_from: Velocity heads lost at the ``from`` end (a fitting, this branch of a junction).
        loss_to: Velocity heads lost at the ``to`` end.
    """

    from_node: str = Field(alias="from")
    to_node: str = Field(alias="to")
    length_m: Positive
    area_m2: Positive
    area_profile: list[tuple[NonNegative, Positive]] | None = None
    dx_m: Positive | None = None
    wall: Wall = Wall()
    losses: list[LocalLoss] = []
    leaks: list[Leak] = []
    reliefs: list[PipeRelief] = []
    volumes: list[DeadVolume] = []
    narrowings: list[Narrowing] = []
    volume_from_m3: NonNegative = 0.0
    volume_to_m3: NonNegative = 0.0
    loss_from: NonNegative = 0.0
    loss_to: NonNegative = 0.0


class Reservoir(Part):
    """A source or sink of constant state: compressor, regulator, room.

    Attributes:
        pressure_pa: Pressure at no flow.
        temperature_k: Temperature; None is the room's.
        droop_pa_s_per_kg: Sag of the pressure per flow drawn.
        droop_tau_s: Time constant of the sag.
        inlet_loss: Velocity heads lost where gas enters a pipe (0 rounded, 0.5 sharp).
        ripples: Pulsations of its pressure, added up. Lumped models have none.
    """

    pressure_pa: Positive
    temperature_k: Positive | None = None
    droop_pa_s_per_kg: NonNegative = 0.0
    droop_tau_s: NonNegative = 0.002
    inlet_loss: NonNegative = 0.0
    ripples: list[Ripple] = []


class Chamber(Part):
    """A well-mixed volume.

    Attributes:
        volume_m3: Volume at the room's pressure.
        compliance_m3_per_pa: Growth of the volume per pascal above the room (a test lung).
        heat_w_per_k: Heat conductance of its wall.
        convection_m2: Area of its wall along which the gas convects: Nu = 0.56 Re^0.67 + 0.104
            Ra^0.352 of the jet that enters and of the gas's height.
        height_m: Height of its gas for that; none is the edge of a cube of its volume.
        inlet_m: Diameter of the jet that enters; none is one that stirs nothing.
        leak_area_m2: Effective area of its leak to the room.
        leak_porous_m3: Permeability x area / length of a porous leak to the room, see a pipe's.
        reliefs: Relief valves.
    """

    volume_m3: Positive
    compliance_m3_per_pa: NonNegative = 0.0
    heat_w_per_k: NonNegative = 0.0
    convection_m2: NonNegative = 0.0
    height_m: Positive | None = None
    inlet_m: Positive | None = None
    leak_area_m2: NonNegative = 0.0
    leak_porous_m3: NonNegative = 0.0
    reliefs: list[Relief] = []


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


class Tap(Part):
    """A pressure sensor on a pipe or a chamber.

    Attributes:
        pipe: Pipe it sits on; exclusive with ``chamber``.
        position_m: Where on the pipe.
        chamber: Chamber it sits on.
        channel: Where its readings are recorded.
        lag_s: First-order lag of the sensor.
        gain: Reading per true gauge pressure.
        bias_pa: Added to the reading.
        offset_s: Lateness of its clock.
        noise_pa: White noise, one sigma; where given, errors are measured by it, and simulated
            readings have it. 0 is not known: recordings are asked.
        quantum_pa: Quantisation step, likewise.
    """

    pipe: str | None = None
    position_m: NonNegative = 0.0
    chamber: str | None = None
    channel: Channel | None = None
    lag_s: NonNegative = 0.0
    gain: Positive = 1.0
    bias_pa: Finite = 0.0
    offset_s: Finite = 0.0
    noise_pa: NonNegative = 0.0
    quantum_pa: NonNegative = 0.0

    @model_validator(mode="after")
    def _check(self) -> "Tap":
        if (self.pipe is None) == (self.chamber is None):
            raise ValueError("a tap names either a pipe or a chamber")
        return self


class Command(Part):
    """A valve command, in volts.

    Attributes:
        channel: Where it is recorded.
    """

    channel: Channel | None = None


class AttachedEffect(Part):
    """An effect of the catalogue, attached at a place.

    Attributes:
        effect: Name, as listed by ``pneu effects``.
        place: Part of the rig it sits on.
        parameters: Its strength and shape; what is not given is at its usual value.
    """

    effect: str
    place: str
    parameters: dict[str, Finite] = {}


class FitParameter(Part):
    """A number of the rig that identification may change.

    Attributes:
        path: Dotted path into the rig, such as ``pipes.tube.area_m2``.
        lower: Lower bound.
        upper: Upper bound.
        std: Uncertainty before calibration; None is the full range.
        std_error: Standard error that ``pneu fit`` found; None where it could not be identified.
        log: Whether steps are relative (positive quantities of unknown size).
        each: Whether it has one value in each recording (a supply, the room, a weight) instead of
            one in all.
        recording: The recording that a value is for; filled in where it has one in each.
    """

    path: str
    lower: Finite
    upper: Finite
    std: Positive | None = None
    std_error: Positive | None = None
    log: bool = False
    each: bool = False
    recording: str | None = None

    @model_validator(mode="after")
    def _check(self) -> "FitParameter":
        if not self.lower < self.upper:
            raise ValueError(f"{self.path}: lower {self.lower} must be below upper {self.upper}")
        if self.log and self.lower <= 0.0:
            raise ValueError(f"{self.path}: a logarithmic parameter needs lower > 0")
        return self


class Fit(Part):
    """How the rig is identified: parameters, and how far ahead it predicts (thesis 8.1.1, 8.1.2).

    Paths of ``drop`` and ``hold`` are patterns: ``*`` stands for anything, so that
    ``valves.*.opening.*`` means every point of every curve.

    Attributes:
        parameters: What may change, in place of the list that follows from the rig.
        add: What may change besides; a path that is in the list already has these bounds instead.
        drop: Patterns of paths that are known exactly: they keep the file's value.
        hold: Patterns of paths that keep the file's value though it is not exact: its uncertainty
            counts in the standard errors of the others.
        horizon_s: How far ahead the model has to predict, and the length of the stretches into
            which a recording is cut: its gas is drawn to the taps so slowly that errors add up
            over that time; None lets it run free over the whole recording.
        warm_up_s: Time at the beginning of a recording that is not compared.
        nudge_s: Time constant of the pull, where it is not to follow from the horizon.
    """

    parameters: list[FitParameter] = []
    add: list[FitParameter] = []
    drop: list[str] = []
    hold: list[str] = []
    horizon_s: Positive | None = 0.5
    warm_up_s: NonNegative = 0.15
    nudge_s: Positive | None = None


class Calibration(Part):
    """What ``pneu fit`` leaves in the file beside the values: how good the model was there.

    Attributes:
        recording: Recording it was fitted to, the first of several.
        recordings: All of them.
        rmse_pa: Residual left per tap.
        noise_floor_pa: Sensor noise per tap.
        held_out_rmse_pa: Residual on the part kept aside.
    """

    recording: str
    recordings: list[str] = []
    rmse_pa: dict[str, float]
    noise_floor_pa: dict[str, float]
    held_out_rmse_pa: dict[str, float] = {}


class Lumped(Part):
    """How the lumped models (``model: thin_plate`` or ``delay_line``) treat the gas.

    Attributes:
        discharge: Factor on the effective area of every port, the fudge factor C_e of thesis
            eq. 3.16. An area that follows from a sonic conductance already contains it.
        exponent: Polytropic exponent of the closed volumes: 1 is isothermal, the gas's ratio of
            specific heats (1.4 for air) adiabatic.
        resistance: Law of the line's resistance in the ``delay_line`` model: ``laminar``,
            ``turbulent`` (Blasius), or ``larger``, whichever resists more at the present flow. Over
            metres of line and grams per second the turbulent law lets little of the flow through.
    """

    discharge: Positive = 1.0
    exponent: float = Field(default=1.0, ge=1.0, le=5.0 / 3.0)
    resistance: Literal["laminar", "turbulent", "larger"] = "laminar"


class Rig(Part):
    """A rig: everything the models, the bridge and the identification build from.

    Attributes:
        pneu_rig: Version of this schema.
        name: Name.
        description: What it is, for people.
        model: How its gas is modelled: ``pde``, the equations of gas dynamics along every pipe;
            ``thin_plate``, closed volumes filled through orifices (thesis 3.2.1); ``delay_line``,
            the same with the delay and attenuation of the line (thesis 3.2.2).
        lumped: Settings of the latter two.
        grid: How the lines are discretised.
        ambient: The room.
        pipes: Lines between nodes.
        reservoirs: Sources and sinks of constant state.
        chambers: Well-mixed volumes.
        cylinders: Pistons between two gases.
        bodies: What cylinders move; one that moves nothing is locked.
        mechanism: Instead of bodies, a mechanism that MuJoCo moves.
        valves: Spools and the ports they open.
        orifices: Fixed restrictions.
        commands: What the valves follow.
        taps: Pressure sensors.
        text: Layout of text recordings.
        rate_hz: Most readings a second that are used of each tap; None uses all.
        effects: Attached effects.
        recordings: Values that differ from recording to recording: per recording, by path.
        fit: How the rig is identified.
        calibration: How good the model was where it was fitted.
    """

    pneu_rig: Literal[1] = 1
    name: str
    description: str = ""
    model: Annotated[str, AfterValidator(checked)] = "pde"
    lumped: Lumped = Lumped()
    grid: Grid = Grid()
    ambient: Ambient = Ambient()
    pipes: dict[str, Pipe] = {}
    reservoirs: dict[str, Reservoir] = {}
    chambers: dict[str, Chamber] = {}
    cylinders: dict[str, Cylinder] = {}
    bodies: dict[str, AnyBody] = {}
    mechanism: MechanismSettings | None = None
    valves: dict[str, AnyValve] = {}
    orifices: dict[str, Orifice] = {}
    commands: dict[str, Command] = {}
    taps: dict[str, Tap] = {}
    text: TextFormat | None = None
    rate_hz: Positive | None = None
    effects: list[AttachedEffect] = []
    recordings: dict[str, dict[str, Finite]] = {}
    fit: Fit = Fit()
    calibration: Calibration | None = None

    @model_validator(mode="after")
    def _connected(self) -> "Rig":
        check_network(self)
        return self

    def dump(self) -> dict[str, Any]:
        """Returns the rig as plain data for a YAML file, defaults left out."""
        data = self.model_dump(mode="json", by_alias=True, exclude_defaults=True)
        return {"pneu_rig": SCHEMA_VERSION, **data}


def check_network(rig: Rig) -> None:
    """Raises ValueError where parts of the rig do not meet.

    Args:
        rig: The rig.
    """
    if not (rig.pipes or rig.chambers or rig.cylinders):
        raise ValueError("pipes: found none, and no chambers or cylinders; there is no gas")
    if not (rig.taps or rig.cylinders):
        raise ValueError("taps: found none, and no cylinders; there is nothing to see")
    vessels = _check_cylinders(rig)
    ends: dict[str, int] = {}
    for name, pipe in rig.pipes.items():
        for node in (pipe.from_node, pipe.to_node):
            ends[node] = ends.get(node, 0) + 1
        placed: list[LocalLoss | Leak | PipeRelief | DeadVolume | Narrowing] = [
            *pipe.losses,
            *pipe.leaks,
            *pipe.reliefs,
            *pipe.volumes,
            *pipe.narrowings,
        ]
        for part in placed:
            if part.position_m > pipe.length_m:
                raise ValueError(
                    f"pipes.{name}: position_m {part.position_m} lies beyond length_m"
                    f" {pipe.length_m}"
                )
    both = set(rig.reservoirs) & set(rig.chambers)
    if both:
        raise ValueError(f"node {sorted(both)[0]!r} is both a reservoir and a chamber")
    ports: dict[str, int] = {}
    paths: list[tuple[str, Port | Orifice]] = [
        (f"valves.{v}.ports.{p}", port)
        for v, valve in rig.valves.items()
        for p, port in valve.ports.items()
    ]
    paths += [(f"orifices.{o}", orifice) for o, orifice in rig.orifices.items()]
    for where, path in paths:
        for node in (path.from_node, path.to_node):
            ports[node] = ports.get(node, 0) + 1
            if node == CLOSED or not (node in ends or node in rig.reservoirs or node in vessels):
                raise ValueError(
                    f"{where}: node {node!r} is no pipe end, reservoir, chamber or cylinder side"
                )
    for name, pipe in rig.pipes.items():
        for node in (pipe.from_node, pipe.to_node):
            fixed = node == CLOSED or node in rig.reservoirs or node in vessels
            if not fixed and ends[node] == 1 and node not in ports:
                raise ValueError(
                    f"pipes.{name}: its end at node {node!r} is unconnected; name a reservoir, a"
                    f" chamber, another pipe's node, a valve port's node, or {CLOSED!r}"
                )
            if not fixed and ends[node] > 1 and node in ports:
                raise ValueError(
                    f"node {node!r} joins {ends[node]} pipes and a valve port; declare a chamber"
                    " there"
                )
    for name, valve in rig.valves.items():
        if valve.command not in rig.commands:
            raise ValueError(
                f"valves.{name}.command: {valve.command!r} is not among commands"
                f" ({', '.join(rig.commands) or 'none declared'})"
            )
        for p, port in valve.ports.items():
            other = port.opening.mirror
            if other is None and port.opening.interpolation == "power":
                side = [v - valve.spool.null_v for v in port.opening.voltage_v]
                if not (min(side) > 0.0 or max(side) < 0.0) or min(port.opening.fraction) <= 0.0:
                    raise ValueError(
                        f"valves.{name}.ports.{p}.opening: interpolation power needs positive"
                        " fractions, at voltages all above or all below spool.null_v"
                    )
            if other is not None and (
                other not in valve.ports or valve.ports[other].opening.mirror is not None
            ):
                raise ValueError(
                    f"valves.{name}.ports.{p}.opening.mirror: {other!r} is no port of this valve"
                    " with a curve of its own"
                )
            if port.model == "effective_area":
                for node in (port.from_node, port.to_node):
                    if node in rig.reservoirs or node in vessels:
                        raise ValueError(
                            f"valves.{name}.ports.{p}: model effective_area needs a pipe at"
                            f" {node!r}"
                        )
        _check_regulator(rig, name, valve)
    for name, tap in rig.taps.items():
        if tap.pipe is not None:
            if tap.pipe not in rig.pipes:
                raise ValueError(
                    f"taps.{name}.pipe: {tap.pipe!r} is not among pipes ({', '.join(rig.pipes)})"
                )
            if tap.position_m > rig.pipes[tap.pipe].length_m * (1.0 + 1e-9):
                raise ValueError(
                    f"taps.{name}.position_m: {tap.position_m} lies beyond the pipe's length"
                    f" {rig.pipes[tap.pipe].length_m}"
                )
        elif tap.chamber not in vessels:
            raise ValueError(
                f"taps.{name}.chamber: {tap.chamber!r} is not among chambers and nodes of cylinders"
                f" ({', '.join(vessels) or 'none declared'})"
            )


def _check_cylinders(rig: Rig) -> list[str]:
    """Raises ValueError where cylinders and bodies do not fit; returns all nodes with a vessel."""
    vessels = list(rig.chambers)
    for name, cylinder in rig.cylinders.items():
        for side_name, side in cylinder.sides.items():
            where = f"cylinders.{name}.{side_name}.node"
            if side.node in rig.reservoirs or side.node in rig.chambers:
                raise ValueError(
                    f"{where}: {side.node!r} is a reservoir or a chamber; a side is a vessel of its"
                    " own"
                )
            if side.node == CLOSED:
                continue
            if side.node in vessels:
                raise ValueError(f"{where}: {side.node!r} is the node of another side already")
            vessels.append(side.node)
            meets = [p for p in rig.pipes.values() if side.node in (p.from_node, p.to_node)]
            if side.port_conductance_m3_s_pa is not None and len(meets) != 1:
                raise ValueError(
                    f"{where}: {side.node!r} needs one pipe that ends there, since it has a port"
                    f" that throttles; found {len(meets)}"
                )
    users: dict[str, str] = {}
    moved = {f"bodies.{name}": body.driven_by for name, body in rig.bodies.items()}
    if rig.mechanism is not None:
        if rig.bodies:
            raise ValueError("mechanism: found bodies besides; a rig has one or the other")
        moved["mechanism.cylinders"] = list(rig.mechanism.cylinders)
    for name, driven_by in moved.items():
        for used in driven_by:
            if used not in rig.cylinders:
                raise ValueError(
                    f"{name}: found cylinder {used!r}, which is not among cylinders"
                    f" ({', '.join(rig.cylinders) or 'none declared'})"
                )
            if used in users:
                raise ValueError(
                    f"{name}: found cylinder {used!r}, which moves {users[used]} already"
                )
            users[used] = name
    return vessels


def _check_regulator(rig: Rig, name: str, valve: Valve) -> None:
    """Raises ValueError where a regulator has no outlet whose pressure it could hold."""
    regulator = valve.regulator
    if regulator is None:
        return
    for field, port in (("fill", regulator.fill), ("vent", regulator.vent)):
        if port not in valve.ports:
            raise ValueError(
                f"valves.{name}.regulator.{field}: {port!r} is not among its ports"
                f" ({', '.join(valve.ports)})"
            )
        if valve.ports[port].model != "iso6358":
            raise ValueError(f"valves.{name}.ports.{port}.model: a regulator's is iso6358")
    fill, vent = valve.ports[regulator.fill], valve.ports[regulator.vent]
    if fill.to_node != vent.from_node:
        raise ValueError(
            f"valves.{name}.regulator: its fill {regulator.fill!r} leads to {fill.to_node!r} and"
            f" its vent {regulator.vent!r} starts from {vent.from_node!r}; both need to meet at its"
            " outlet"
        )
    if fill.to_node in rig.reservoirs:
        raise ValueError(
            f"valves.{name}: the regulator's outlet {fill.to_node!r} is a reservoir, whose pressure"
            " nothing changes; name a chamber or the end of a pipe"
        )
