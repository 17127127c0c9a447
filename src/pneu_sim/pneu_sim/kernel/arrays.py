# SPDX-License-Identifier: Apache-2.0
"""What belongs together travels together: the arrays of a batch of rigs, as the passes take them.

Rows and columns have their names in ``pneu_sim.layout``. A pass takes the groups that it needs;
each is a tuple of arrays with names, which Numba takes apart when it compiles.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Gas(NamedTuple):
    """An ideal gas.

    Attributes:
        gamma: Ratio of specific heats.
        r: Specific gas constant, J/(kg K).
        prandtl: Prandtl number.
        recovery: Recovery factor of a wall in turbulent flow, Pr^(1/3) (White, Viscous Fluid Flow).
    """

    gamma: float
    r: float
    prandtl: float
    recovery: float


class Scheme(NamedTuple):
    """How the equations are solved, and which of them.

    Attributes:
        order: 1 Godunov, 2 MUSCL-Hancock.
        flux: HLLC or EXACT.
        limiter: MINMOD or VAN_LEER.
        newton: Newton iterations of the exact star pressure.
        compliant: Whether any wall yields.
        memory: Whether wall friction and heat have memory.
        joints: Whether three or more pipes meet anywhere.
        tapered: Whether any pipe tapers smoothly.
    """

    order: int
    flux: int
    limiter: int
    newton: int
    compliant: bool
    memory: bool
    joints: bool
    tapered: bool


class Cells(NamedTuple):
    """All slots of all pipes; ``slots * lanes`` entries per row.

    Attributes:
        lanes: Rigs side by side.
        par: (PARAM_ROWS, n) parameters.
        state: (STATE_ROWS, n) state.
        work: (WORK_ROWS, n) what passes hand on to one another; in second order more rows.
        wall: (WALL_ROWS, n) what walls do.
        soft: (SOFT_ROWS, n) what yielding walls hold; no columns where none yields.
    """

    lanes: int
    par: Floats
    state: Floats
    work: Floats
    wall: Floats
    soft: Floats


class Steps(NamedTuple):
    """Faces at which the area jumps or a fitting takes pressure.

    Attributes:
        table: (n_steps, 5) face, then the cell and its direction on the left and on the right; the
            same cell twice where it is the only one of its pipe.
        area: (n_steps, 2, lanes) areas left and right, m2.
    """

    table: Ints
    area: Floats


class Sides(NamedTuple):
    """Volumes beside cells.

    Attributes:
        table: (n_sides, SIDE_COLUMNS).
        more: (n_sides, lanes) how many times the cell's own volume it is.
        kept: (n_sides, 3, lanes) density and momentum that the cells had, and what cell and side
            took up together in the last step, kg/s.
    """

    table: Ints
    more: Floats
    kept: Floats


class Ends(NamedTuple):
    """Ends of pipes.

    Attributes:
        table: (n_ends, END_COLUMNS).
        velocity: (n_ends, 2, lanes) of the gas at ends with ports or vessels, along the pipe, m/s:
            what it is taken to be in this step until that is solved, and what it was in the last.
        flow: (n_ends, lanes) what ports let through there in the last step, kg/(m^2 s).
        give: (n_ends, lanes) how far the pressure follows what flows; 1 but beside a volume.
        joint: (n_ends, JOINT_ROWS, lanes) common pressure and flows where three or more meet.
        ported: (n_ends, PORTED_ROWS, lanes) what leaves through ports at this step.
    """

    table: Ints
    velocity: Floats
    flow: Floats
    give: Floats
    joint: Floats
    ported: Floats


class Regulators(NamedTuple):
    """Pressure regulators, which open two ports each as the pressure behind them asks.

    Attributes:
        table: (n_regulators, REG_COLUMNS) their ports.
        par: (n_regulators, REG_PARAMS, lanes).
        state: (n_regulators, REG_STATE, lanes) what they show, where they stand.
    """

    table: Ints
    par: Floats
    state: Floats


class Ports(NamedTuple):
    """Ports of valves, then orifices.

    Attributes:
        table: (n_ports, PORT_COLUMNS).
        par: (n_ports, PORT_PARAMS, lanes).
        flow: (n_ports, 2, lanes) mass kg/s and enthalpy W of the last step.
        opening: (n_ports, lanes) at this step.
        regulators: What opens some of them otherwise.
    """

    table: Ints
    par: Floats
    flow: Floats
    opening: Floats
    regulators: Regulators


class Reservoirs(NamedTuple):
    """Reservoirs, and what pulsates in them.

    Attributes:
        par: (n_reservoirs, RESERVOIR_PARAMS, lanes).
        pressure: (n_reservoirs, lanes) present, Pa.
        supplied: (n_reservoirs, lanes) the same with its ripple, Pa.
        drawn: (n_reservoirs, lanes) what pipes and ports draw at this step, kg/s.
        ripple_of: (n_ripples,) reservoirs.
        ripple: (n_ripples, RIPPLE_PARAMS, lanes).
    """

    par: Floats
    pressure: Floats
    supplied: Floats
    drawn: Floats
    ripple_of: Ints
    ripple: Floats


class Chambers(NamedTuple):
    """Well-mixed volumes.

    Attributes:
        par: (n_chambers, CHAMBER_PARAMS, lanes).
        state: (n_chambers, 2, lanes) mass kg and energy J.
        work: (n_chambers, CHAMBER_ROWS, lanes) pressure, temperature, inflow, see ``layout``.
        small: (n_small,) those whose pressure is found with all that flows.
        stiff: (n_small, lanes) 1 in the rigs in which they are, else 0.
    """

    par: Floats
    state: Floats
    work: Floats
    small: Ints
    stiff: Floats


class Cylinders(NamedTuple):
    """Pistons between two gases.

    Attributes:
        table: (n_cylinders, CYLINDER_COLUMNS) what holds the gas of each side.
        moves: (n_cylinders,) body that each moves, or -1.
        par: (n_cylinders, CYLINDER_PARAMS, lanes).
        state: (n_cylinders, CYLINDER_STATE, lanes) where they stand.
        work: (n_cylinders, CYLINDER_WORK, lanes) what passes hand on to one another.
    """

    table: Ints
    moves: Ints
    par: Floats
    state: Floats
    work: Floats


class Bodies(NamedTuple):
    """What pistons move, and scratch for the equations of one body.

    Attributes:
        table: (n_bodies, BODY_COLUMNS).
        driven_by: (places,) cylinders that take hold of them, body by body.
        par: (n_bodies, BODY_PARAMS, lanes) numbers of each kind.
        joint: (n_joints, JOINT_PARAMS, lanes).
        state: (n_joints, JOINT_STATE, lanes).
        heat: (n_bodies, lanes) what friction and damping made since the beginning, J.
        q: (joints,) scratch, positions.
        v: (joints,) velocities.
        force: (joints,) forces, then accelerations.
        mass: (joints, joints) mass matrix, then its factor.
        x: (cylinders,) extensions.
        lever: (cylinders, joints) their growth per motion of joints.
        along: (rows, joints) directions in which dry friction acts.
        answer: (rows, joints) velocity per impulse along those.
        most: (rows,) greatest impulses.
        impulse: (rows,) impulses.
        soft: (rows,) deflection of seals per force.
        damping: (rows,) force per rate of that.
        bent: (rows,) deflection.
        loose: (cylinders,) whether each has play, and leans or is loose, see ``play``.
        row: (cylinders,) which of those directions is its own, or -1.
        there_q: (joints,) positions at a face of the play ...
        there_x: (cylinders,) ... extensions there ...
        there_lever: (cylinders, joints) ... and their growth.
    """

    table: Ints
    driven_by: Ints
    par: Floats
    joint: Floats
    state: Floats
    heat: Floats
    q: Floats
    v: Floats
    force: Floats
    mass: Floats
    x: Floats
    lever: Floats
    along: Floats
    answer: Floats
    most: Floats
    impulse: Floats
    soft: Floats
    damping: Floats
    bent: Floats
    loose: Floats
    row: Floats
    there_q: Floats
    there_x: Floats
    there_lever: Floats


class Term(NamedTuple):
    """What a term of the equations acts on.

    Attributes:
        table: (rows, TERM_COLUMNS) which slot, or -1 - chamber, and of which kind.
        par: (rows, columns, lanes) numbers; zeros where a lane does not have the row.
        room: (2, lanes) pressure Pa and temperature K.
        flow: (rows, lanes) of leaks the mass flow of the last step, kg/s; of other terms no rows.
    """

    table: Ints
    par: Floats
    room: Floats
    flow: Floats


class Taps(NamedTuple):
    """Taps, when they are read, and how the gas is corrected by what was measured.

    Attributes:
        slot: (n_taps, lanes) slot left of each tap, or -1 - chamber.
        weight: (n_taps, lanes) weight of the next slot.
        cell: (n_taps, lanes) slot whose flow loses pressure between what is read and the tap.
        lost: (n_taps, 2, lanes) what of m |m| / rho and of m / rho it loses; 0 where nothing.
        sensor: (n_taps, SENSOR_ROWS, lanes) what each sensor makes of the pressure.
        time: (n_taps, m, lanes) when each is read, in steps since the start, increasing; inf
            beyond the last reading.
        measured: (n_taps, m, lanes) what was measured then, Pa; NaN where nothing was.
        gain: (n_taps, m, lanes) share of the difference by which the gas is corrected then.
        spread_slot: (slots, n_taps) how a correction at the taps spreads over the slots.
        spread_chamber: (n_chambers, n_taps) the same for the chambers.
        next: (n_taps, lanes) the next reading.
        shown: (n_taps, lanes) what sensors make of it before gain and bias, Pa; NaN: at rest.
        felt: (n_taps, lanes) pressure behind that, Pa.
        error: (n_taps, lanes) what each tap asks of the gas, Pa.
        readings: (n_taps, m, lanes) what the sensors read, Pa.
    """

    slot: Ints
    weight: Floats
    cell: Ints
    lost: Floats
    sensor: Floats
    time: Floats
    measured: Floats
    gain: Floats
    spread_slot: Floats
    spread_chamber: Floats
    next: Ints
    shown: Floats
    felt: Floats
    error: Floats
    readings: Floats


class Rigs(NamedTuple):
    """A batch of rigs: all that a step works on."""

    gas: Gas
    scheme: Scheme
    cells: Cells
    steps: Steps
    sides: Sides
    ends: Ends
    ports: Ports
    reservoirs: Reservoirs
    chambers: Chambers
    terms: tuple[Term, ...]
    taps: Taps


class Encoders(NamedTuple):
    """Encoders, when they are read, and how joints are corrected by what was measured.

    Attributes:
        of: (n_encoders,) joint that each is on, or -1 - cylinder.
        sensor: (n_encoders, SENSOR_ROWS, lanes) what each makes of the position.
        time: (n_encoders, m, lanes) when each is read, in steps since the start; see `Taps`.
        measured: (n_encoders, m, lanes) what was measured then, rad or m; NaN where nothing was.
        gain: (n_encoders, m, lanes) share of the difference by which the position is corrected.
        push: (n_encoders, m, lanes) change of the velocity by the difference, 1/s.
        next: (n_encoders, lanes) the next reading.
        shown: (n_encoders, lanes) what sensors make of it before gain and bias; NaN: at rest.
        felt: (n_encoders, lanes) position behind that.
        shift: (n_encoders, 2, lanes) what each asks of position and velocity.
        readings: (n_encoders, m, lanes) what they read.
    """

    of: Ints
    sensor: Floats
    time: Floats
    measured: Floats
    gain: Floats
    push: Floats
    next: Ints
    shown: Floats
    felt: Floats
    shift: Floats
    readings: Floats


class Moving(NamedTuple):
    """What of a batch of rigs moves, and who reads it."""

    cylinders: Cylinders
    bodies: Bodies
    encoders: Encoders


class Clock(NamedTuple):
    """Where in time a run begins and how it is cut.

    Attributes:
        samples: Recorded samples; the first is the present state.
        steps: Steps between samples.
        dt: Step, s.
        knots: Parts of a sample interval between whose ends openings are given.
        lanes: (2, lanes) time from which steps are counted, s, and how many there were before.
        watched: Steps from which readings are counted, before this run.
        closing: Whether the taps are read at the very end too, no further call taking up there.
    """

    samples: int
    steps: int
    dt: float
    knots: int
    lanes: Floats
    watched: int
    closing: bool


class Record(NamedTuple):
    """What is written down at every sample.

    Attributes:
        taps: (samples, n_taps, lanes) pressures, Pa.
        flows: (samples, n_ports, lanes) kg/s.
        chambers: (samples, n_chambers, lanes) pressures, Pa.
        temperatures: (samples, n_chambers, lanes) K.
        cylinders: (samples, n_cylinders, 3, lanes) extension, speed, and force of gas and room.
        joints: (samples, n_joints, 2, lanes) positions and velocities.
        fastest: (samples, lanes) cells that the fastest wave crosses, 1/s; no samples where nobody
            asks.
    """

    taps: Floats
    flows: Floats
    chambers: Floats
    temperatures: Floats
    cylinders: Floats
    joints: Floats
    fastest: Floats
