# SPDX-License-Identifier: Apache-2.0
"""What a rig file may say, its parts put together; some are described in files of their own.

A rig is a network of named *nodes*. Pipes run from one node to another; a reservoir or a chamber of
that name sits at the node; valve ports and orifices connect two nodes. The node ``closed`` is a
wall. All quantities are SI, pressures absolute.
"""

from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    Field,
    model_validator,
)

from pneu_sim.bodies.kinds import AnyBody
from pneu_sim.channels import Channel, TextFormat
from pneu_sim.mechanism.settings import MechanismSettings
from pneu_sim.parts import Finite, NonNegative, Part, Positive
from pneu_sim.rig.cylinder import Cylinder
from pneu_sim.rig.drag import Drag
from pneu_sim.rig.encoder import Encoder as Encoder
from pneu_sim.rig.kinds import checked
from pneu_sim.rig.valves import AnyValve as AnyValve
from pneu_sim.rig.valves import Opening as Opening
from pneu_sim.rig.valves import Orifice as Orifice
from pneu_sim.rig.valves import Port as Port
from pneu_sim.rig.valves import Spool as Spool
from pneu_sim.rig.valves import Valve as Valve
from pneu_sim.rig.vessels import Chamber as Chamber
from pneu_sim.rig.vessels import DeadVolume as DeadVolume
from pneu_sim.rig.vessels import Leak as Leak
from pneu_sim.rig.vessels import LocalLoss as LocalLoss
from pneu_sim.rig.vessels import Narrowing as Narrowing
from pneu_sim.rig.vessels import Pipe as Pipe
from pneu_sim.rig.vessels import PipeRelief as PipeRelief
from pneu_sim.rig.vessels import Relief as Relief
from pneu_sim.rig.vessels import Reservoir as Reservoir
from pneu_sim.rig.vessels import Ripple as Ripple
from pneu_sim.rig.vessels import Wall as Wall

SCHEMA_VERSION = 1
CLOSED = "closed"
HORIZON_S, HORIZON_MOVING_S = 0.5, 0.15
"""How far ahead a rig is asked to predict where its file does not say: the ends of the 0.1 to 0.5 s
of thesis 8.1.2, about. What rests and slips grows small errors into large ones: a tenth of a newton
decides when, and half a second later that alone is told. A controller looks 0.1 to 0.2 s ahead
(thesis 9.1)."""


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
            share one pressure, and flow contracts into a step of area without loss and widens from
            it as a jet (Borda, Carnot).
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


LONGEST_NAME = 100
"""Characters of the name of a part."""


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
            over that time; None lets it run free over the whole recording. Where the file does
            not say, 0.15 s of a rig whose joints or pistons move.
        warm_up_s: Time at the beginning of a recording that is not compared.
        nudge_s: Time constant of the pull, where it is not to follow from the horizon.
    """

    parameters: list[FitParameter] = []
    add: list[FitParameter] = []
    drop: list[str] = []
    hold: list[str] = []
    horizon_s: Positive | None = HORIZON_S
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
        rmse: Residual left per encoder, rad or m.
        noise_floor: Noise per encoder, likewise.
        held_out_rmse: Residual per encoder on the part kept aside, likewise.
    """

    recording: str
    recordings: list[str] = []
    rmse_pa: dict[str, float]
    noise_floor_pa: dict[str, float]
    held_out_rmse_pa: dict[str, float] = {}
    rmse: dict[str, float] = {}
    noise_floor: dict[str, float] = {}
    held_out_rmse: dict[str, float] = {}

    @property
    def left(self) -> dict[str, float]:
        """Residual left per tap and encoder, each in its own unit."""
        return {**self.rmse_pa, **self.rmse}

    @property
    def noise(self) -> dict[str, float]:
        """Noise per tap and encoder, each in its own unit."""
        return {**self.noise_floor_pa, **self.noise_floor}


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
        encoders: Position sensors, of joints and pistons.
        drag: A machine that drags a cylinder, and what it reads.
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
    encoders: dict[str, Encoder] = {}
    drag: Drag | None = None
    text: TextFormat | None = None
    rate_hz: Positive | None = None
    effects: list[AttachedEffect] = []
    recordings: dict[str, dict[str, Finite]] = {}
    fit: Fit = Fit()
    calibration: Calibration | None = None

    @model_validator(mode="after")
    def _connected(self) -> "Rig":
        _check_names(self)
        check_network(self)
        for reservoir in self.reservoirs.values():
            if reservoir.room is None:
                reservoir.room = reservoir.pressure_pa == self.ambient.pressure_pa
        if self.moves and "horizon_s" not in self.fit.model_fields_set:
            self.fit = self.fit.model_copy(update={"horizon_s": HORIZON_MOVING_S})
        return self

    @property
    def moves(self) -> bool:
        """Whether anything has joints: a body, or a mechanism."""
        return bool(self.bodies) or self.mechanism is not None

    def dump(self) -> dict[str, Any]:
        """Returns the rig as plain data for a YAML file, defaults left out."""
        data = self.model_dump(mode="json", by_alias=True, exclude_defaults=True)
        if self.moves:  # of which another horizon is left out; a calibration stands for its own
            if self.fit.horizon_s == HORIZON_S or self.calibration is not None:
                data.setdefault("fit", {})["horizon_s"] = self.fit.horizon_s
            elif self.fit.horizon_s == HORIZON_MOVING_S:
                del data["fit"]["horizon_s"]
                if not data["fit"]:
                    del data["fit"]
        for name, reservoir in self.reservoirs.items():
            if reservoir.room == (reservoir.pressure_pa == self.ambient.pressure_pa):
                del data["reservoirs"][name]["room"]  # as it would be read
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
    if rig.drag is not None and rig.drag.cylinder not in rig.cylinders:
        raise ValueError(
            f"drag.cylinder: found {rig.drag.cylinder!r}, which is not among cylinders"
            f" ({', '.join(rig.cylinders) or 'none declared'})"
        )
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
    _check_encoders(rig)


def joint_names(rig: Rig) -> list[str]:
    """Names of the joints of a rig's bodies, in their order; a mechanism's are in its MJCF.

    Args:
        rig: The rig.
    """
    return [
        joint.name or f"{name}_{field}"
        for name, body in rig.bodies.items()
        for field, joint in zip(body.joint_fields, body.joints, strict=True)
    ]


def _check_names(rig: Rig) -> None:
    """Refuse names of parts that could not stand in a heading, a line of a log, or a command."""
    for field in type(rig).model_fields:
        part = getattr(rig, field)
        if field == "recordings" or not isinstance(part, dict):  # those are names of files
            continue
        for name in part:
            bad = not str(name).isprintable() or str(name)[:1] in set("=+-@ ")
            if bad or not 0 < len(str(name)) <= LONGEST_NAME:
                raise ValueError(
                    f"{field}: found the name {str(name)[:LONGEST_NAME]!r}; allowed are 1 to"
                    f" {LONGEST_NAME} printable characters that do not begin with =, +, -, @ or a"
                    " space"
                )


def _check_encoders(rig: Rig) -> None:
    """Raises ValueError where an encoder sits on nothing that moves, or is called as a tap is."""
    joints = joint_names(rig)
    for name, encoder in rig.encoders.items():
        if name in rig.taps:
            raise ValueError(f"encoders.{name}: a tap has this name already")
        if encoder.cylinder is not None:
            if encoder.cylinder not in rig.cylinders:
                raise ValueError(
                    f"encoders.{name}.cylinder: {encoder.cylinder!r} is not among cylinders"
                    f" ({', '.join(rig.cylinders) or 'none declared'})"
                )
        elif rig.mechanism is None and encoder.on(name) not in joints:
            raise ValueError(
                f"encoders.{name}.joint: {encoder.on(name)!r} is not among joints"
                f" ({', '.join(joints) or 'there is no body'})"
            )


def _check_cylinders(rig: Rig) -> list[str]:
    """Raises ValueError where cylinders and bodies do not fit; returns all nodes with a vessel."""
    vessels = list(rig.chambers)
    named = {*rig.pipes, *rig.chambers, *rig.reservoirs, *rig.orifices}
    named |= {node for pipe in rig.pipes.values() for node in (pipe.from_node, pipe.to_node)}
    for name, cylinder in rig.cylinders.items():
        for side_name in ("head", "rod"):
            for reserved in (f"{name}.{side_name}", f"{name}.{side_name}.port"):
                if reserved in named:
                    raise ValueError(
                        f"cylinders.{name}: {reserved!r} is what its {side_name} side is called;"
                        " give that other part another name"
                    )
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
            if side.cushion is not None and not meets:
                raise ValueError(
                    f"{where}: found {side.node!r}, where no pipe ends; a cushion throttles a"
                    " pipe's end, or a port between it and the cylinder"
                )
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
