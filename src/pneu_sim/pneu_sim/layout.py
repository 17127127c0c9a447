# SPDX-License-Identifier: Apache-2.0
"""Row and column numbers of the arrays that the gas kernel works on.

Every field of a rig lives in one row of a two-dimensional array ``[row, slot * lanes + lane]``.
A *slot* is a gas cell or one of the two ghost cells that close each pipe; a *lane* is one rig of a
batch. The lane is the innermost index, so a neighbour in space is ``lanes`` entries away, and the
same loop vectorises along the pipe for one rig and across rigs for a batch.
"""

from typing import Final

# --- state rows -----------------------------------------------------------------------------------
RHO: Final = 0  # mass per volume, kg/m^3
MOM: Final = 1  # momentum per volume, kg/(m^2 s)
ENE: Final = 2  # total energy per volume, J/m^3
Y0: Final = 3  # first of UNSTEADY_TERMS memory states of the unsteady wall friction, m/s
Z0: Final = 9  # first of UNSTEADY_TERMS memory states of the unsteady wall heat, K
STATE_ROWS: Final = 15

# --- parameter rows -------------------------------------------------------------------------------
AREA: Final = 0  # cross-section of the cell, m^2
FACE: Final = 1  # area of the face between this slot and the next, m^2
INV_VOLUME: Final = 2  # 1 / volume, 1/m^3; zero marks a ghost
LENGTH: Final = 3  # cell length, m; negative marks a ghost
VISCOUS: Final = 4  # drag of Poiseuille's flow, 8 pi mu / A, Pa s/m^2
UNSTEADY: Final = 5  # unsteady drag 4 pi mu / A times the chosen factor, Pa s/m^2
RELAX: Final = 6  # pi mu N1 / A: decay of the slowest memory state, times density, kg/(m^3 s)
REYNOLDS: Final = 7  # D / mu, so that Re = rho |u| D / mu
ROUGH: Final = 8  # (epsilon / (3.7 D))^1.11 of Haaland's formula
TURBULENT: Final = 9  # gain on the turbulent excess of the drag, 1 = Haaland
LOSS: Final = 10  # velocity heads lost at the face between this slot and the next, K / A^2, 1/m^4
RESISTANCE: Final = 11  # pressure lost there per velocity, R / A, Pa s/m^3
HEAT: Final = 12  # quasi-steady wall heat in laminar flow, W/(m^3 K)
HEAT_UNSTEADY: Final = 13  # unsteady wall heat 4 pi k / A times the chosen factor, W/(m^3 K)
HEAT_TURBULENT: Final = 14  # gain on the turbulent excess of the wall heat, 1 = Gnielinski
WALL_T: Final = 15  # wall temperature, K
COMPLIANCE: Final = 16  # relative growth of the area per pascal, 1/Pa
REST_P: Final = 17  # pressure at which the wall has its nominal area, Pa
TAPER: Final = 18  # relative growth of the area along the pipe, where it tapers smoothly, 1/m
ONSET: Final = 19  # 1 / Reynolds number at which turbulence sets in
QUICKEN: Final = 20  # gain on how much faster memory fades in turbulent flow
LAMINAR: Final = 21  # gain on the laminar drag, 1 = Poiseuille
PARAM_ROWS: Final = 22

# --- work rows ------------------------------------------------------------------------------------
W_U: Final = 0
W_P: Final = 1
W_C: Final = 2
W_T: Final = 3
W_RI: Final = 4  # inverse density
W_FM: Final = 5  # flux through the face between this slot and the next, per area
W_FP: Final = 6
W_FE: Final = 7
WORK_ROWS: Final = 8  # those of the first order
W_RL: Final = 8  # state at the left face of the cell: density, velocity, pressure, inverse density
W_UL: Final = 9
W_PL: Final = 10
W_IL: Final = 11
W_RR: Final = 12  # state at the right face of the cell
W_UR: Final = 13
W_PR: Final = 14
W_IR: Final = 15
WORK_ROWS_OF_SECOND: Final = 16

# --- rows of what walls do ------------------------------------------------------------------------
D_PHI: Final = 0  # wall drag relative to Poiseuille's
D_AU: Final = 1  # decay factor of the slowest memory state of drag
D_AT: Final = 2  # decay factor of the slowest memory state of heat
D_FADE: Final = 3  # additional decay of all memory in turbulent flow
D_FILM: Final = 4  # quasi-steady wall heat, W/(m^3 K)
D_STAY: Final = 5  # inverse of the slowest decay rate times density, m^3 s/kg
D_DRAG: Final = 6  # momentum that the wall gave in the last step, per volume and time, N/m^3
D_WARM: Final = 7  # heat that the wall gave in the last step, W/m^3
D_EXCESS: Final = (
    8  # what turbulence adds to that at the Reynolds number, in a smooth tube's gain of 1
)
WALL_ROWS: Final = 9

# --- rows of what yielding walls hold -------------------------------------------------------------
SOFT_STRETCH: Final = 0  # area relative to the nominal one
SOFT_RHO: Final = 1  # what the wall's widening holds, per nominal volume: mass, momentum, energy
SOFT_MOM: Final = 2
SOFT_ENE: Final = 3
SOFT_FACE: Final = 4  # area of the face between this slot and the next, m^2
SOFT_ROWS: Final = 5

# --- pipe ends (integer columns) ------------------------------------------------------------------
E_CELL: Final = 0  # slot of the last cell
E_GHOST: Final = 1  # slot of the ghost beyond it
E_FACE: Final = 2  # face number
E_SIGN: Final = 3  # +1 at the downstream (right) end, -1 at the upstream (left) end
E_KIND: Final = 4
E_REF: Final = 5  # reservoir, chamber or partner end
END_COLUMNS: Final = 6

WALL: Final = 0  # closed end
RESERVOIR: Final = 1  # constant state as a neighbouring cell (thesis 5.5): reflects no wave
LINK: Final = 2  # two ends in series: one common face
BRANCH: Final = 3  # further ends of a thesis joint, with the fictitious wall of thesis fig. 5.6
CHAMBER: Final = 4  # well-mixed volume
PORTED: Final = 5  # wall fed only through valve ports
JUNCTION: Final = 7  # one of three or more ends at a common pressure
TANK: Final = 6  # large vessel: outflow meets its pressure, inflow its stagnation state

# --- volumes beside cells (integer columns) ------------------------------------------------------
D_SLOT: Final = 0  # the cell
D_END: Final = 1  # the end of its pipe that it lies at, or -1 where it lies beside its middle
SIDE_COLUMNS: Final = 2

# --- joints of three or more ends -----------------------------------------------------------------
J_MASS: Final = 0  # kept with the first end of a joint: mass that flows in, kg/s
J_HEAT: Final = 1  # enthalpy that flows in, W
J_FLOW: Final = 2  # of each end its outward mass flow per area, kg/(m^2 s)
J_SLOPE: Final = 3  # by how much that grows as the joint's pressure falls, s/m
J_PRESSURE: Final = 4  # and the pressure at it, Pa
JOINT_ROWS: Final = 5

# --- what leaves pipe ends through ports ----------------------------------------------------------
N_MASS: Final = 0  # kg/s
N_HEAT: Final = 1  # W
N_PUSH: Final = 2  # N, through ports that are variable areas
# the state at the end that a port was last solved with
N_SLOPE: Final = 3  # by how much its flux grows with the velocity, kg/m^3; 0: no port was solved
N_FLUX: Final = 4  # mass flux, kg/(m^2 s)
N_SPEED: Final = 5  # outward velocity, m/s
N_STATIC: Final = 6  # pressure, Pa
N_FALL: Final = 7  # by how much that falls as the velocity grows, kg/(m^2 s)
N_ENTHALPY: Final = 8  # total enthalpy of gas that would enter, J/kg
PORTED_ROWS: Final = 9

# --- ports (integer columns) ----------------------------------------------------------------------
P_A: Final = 0  # kind of the side a: one of SIDE_*
P_AI: Final = 1
P_B: Final = 2
P_BI: Final = 3
P_MODE: Final = 4
PORT_COLUMNS: Final = 5

SIDE_END: Final = 0
SIDE_CHAMBER: Final = 1
SIDE_RESERVOIR: Final = 2

ISO6358: Final = 0  # sonic conductance and critical pressure ratio
EFFECTIVE_AREA: Final = 1  # Riemann flux through a variable area, thesis sec. 5.4

# --- port parameter rows --------------------------------------------------------------------------
Q_CONDUCTANCE: Final = 0  # sonic conductance C fully open, m^3/(s Pa)
Q_RATIO: Final = 1  # critical pressure ratio b
Q_AREA: Final = 2  # effective area fully open, m^2 (EFFECTIVE_AREA ports)
Q_LAMINAR: Final = 3  # pressure ratio above which flow is linear in the pressure drop
Q_JET: Final = 4  # velocity heads of the entered line that the port's jet does not recover
Q_HEAD: Final = 5  # share of the velocity head of the line it leaves that drives the port
Q_WIDENING: Final = 6  # exponent with which the linear range grows with the opening
Q_SHARE: Final = 7  # flow at the end of the linear range, share of what ISO 6358 gives there
PORT_PARAMS: Final = 8

# --- pressure regulators --------------------------------------------------------------------------
REG_FILL: Final = 0  # integer columns: the port that fills its outlet, the one that vents it
REG_VENT: Final = 1
REG_COLUMNS: Final = 2

REG_LOW: Final = 0  # parameters: set-point where the opening of the fill is told as 0, Pa
REG_SPAN: Final = 1  # by how much more it is where that is 1, Pa
REG_DEAD: Final = 2  # within this of the set-point nothing opens, Pa
REG_BAND: Final = 3  # by how much more a port is fully open, Pa
REG_LAG: Final = 4  # time constant of its spool, s
REG_SENSOR: Final = 5  # time constant of its sensor, s; 0 is none
REG_RATE: Final = 6  # rate of its integral term, 1/s; 0 is none
REG_FILL_LEAK: Final = 7  # opening that remains of the closed ports
REG_VENT_LEAK: Final = 8
REG_PARAMS: Final = 9

REG_SEEN: Final = 0  # state: the pressure that its sensor shows, Pa; 0 before it has seen any
REG_SPOOL: Final = 1  # where its spool stands: fill fully open at 1, vent at -1
REG_SUM: Final = 2  # its integral term
REG_STATE: Final = 3

# --- reservoir parameter rows ---------------------------------------------------------------------
R_PRESSURE: Final = 0
R_TEMPERATURE: Final = 1
R_DROOP: Final = 2  # Pa per kg/s drawn
R_TAU: Final = 3  # time constant of the droop, s
R_LOSS: Final = 4  # velocity heads lost where gas enters a pipe
RESERVOIR_PARAMS: Final = 5

# --- ripples of reservoirs ------------------------------------------------------------------------
RIPPLE_AMPLITUDE: Final = 0  # Pa
RIPPLE_RATE: Final = 1  # angular frequency, rad/s
RIPPLE_PHASE: Final = 2  # at time zero, rad
RIPPLE_PARAMS: Final = 3

# --- terms, and leaks to the room -----------------------------------------------------------------
K_SLOT: Final = 0  # slot that a term acts on, or -1 - chamber
K_KIND: Final = 1
TERM_COLUMNS: Final = 2

ORIFICE: Final = 0  # isentropic orifice
POROUS: Final = 1  # laminar flow, in proportion to the difference of the pressures' squares
RELIEF: Final = 2  # orifice that opens above a set pressure, outwards only

LEAK_SIZE: Final = (
    0  # effective area, m^2; of a POROUS leak its flow over p^2 - p_room^2, kg/(s Pa^2)
)
LEAK_SET: Final = 1  # pressure at which a RELIEF begins to open, Pa
LEAK_RANGE: Final = 2  # by how much more it is fully open, Pa
LEAK_PARAMS: Final = 3

# --- chamber parameter rows -----------------------------------------------------------------------
C_VOLUME: Final = 0  # m^3 at the rest pressure
C_COMPLIANCE: Final = 1  # m^3/Pa
C_HEAT: Final = 2  # h S, W/K
C_WALL_T: Final = 3
C_REST_P: Final = 4
C_CONVECTION: Final = 5  # area of the wall along which its gas convects, m^2; 0 is none
C_HEIGHT: Final = 6  # height of its gas, m
C_INLET: Final = 7  # diameter of the jet that enters, m; 0 stirs nothing
C_VISCOUS: Final = 8  # Sutherland's law mu = C_VISCOUS T^1.5 / (T + C_SUTHERLAND), kg/(m s K^0.5)
C_SUTHERLAND: Final = 9  # K
C_STIRRED: Final = 10  # share of that area which the jet stirs
CHAMBER_PARAMS: Final = 11

# --- chamber rows ---------------------------------------------------------------------------------
H_PRESSURE: Final = 0  # Pa
H_TEMPERATURE: Final = 1  # K
H_MIDDLE: Final = 2  # pressure at the middle of the step, Pa
H_WEIGHT: Final = 3  # of its own pressure in that
H_INFLOW: Final = 4  # what enters in this step, kg/s
H_SHUT: Final = 5  # part of the way into a pipe that is shut for what leaves (a cushion)
CHAMBER_ROWS: Final = 6

# --- cylinders (integer columns): what each side is, head first, then rod ---------------------
Y_KIND: Final = 0  # of the head side: one of GAS_*; of the rod side the same COLUMNS_PER_SIDE later
Y_REF: Final = 1  # chamber, or first slot
Y_CELLS: Final = 2  # slots
COLUMNS_PER_SIDE: Final = 3
Y_PORT: Final = 6  # orifice of the head side's port, or -1
Y_PORT_ROD: Final = 7
CYLINDER_COLUMNS: Final = 8

GAS_ROOM: Final = 0  # open to the room
GAS_CHAMBER: Final = 1
GAS_CELLS: Final = 2

# --- cylinder parameter rows ----------------------------------------------------------------------
PY_AREA: Final = 0  # of the head side, m^2; of the rod side the next
PY_AREA_ROD: Final = 1
PY_DEAD: Final = 2  # dead volume of the head side, m^3; of the rod side the next
PY_DEAD_ROD: Final = 3
PY_STROKE: Final = 4
PY_COULOMB: Final = 5  # sliding friction, N
PY_PER_PA: Final = 6  # its growth with the mean gauge pressure, N/Pa
PY_BREAKAWAY: Final = 7  # how much more it holds at rest, N
PY_STRIBECK: Final = 8  # speed over which that vanishes, m/s
PY_VISCOUS: Final = 9  # N s/m
PY_LEAK: Final = 10  # effective area from side to side, m^2
PY_ROD_LEAK: Final = 11  # effective area from the rod side to the room, m^2
PY_SPRING: Final = 12  # N/m
PY_PRELOAD: Final = 13  # N
PY_STOP: Final = 14  # stiffness of the end stops, N/m
PY_STOP_DAMPING: Final = 15  # N s/m
PY_FILM: Final = 16  # heat conductance of the wall per way, W/(m K); of the rod side the next
PY_FILM_ROD: Final = 17
PY_HEAT: Final = 18  # heat conductance of the covers, W/K; of the rod side the next
PY_HEAT_ROD: Final = 19
PY_CUSHION: Final = 20  # length of the head side's cushion, m, 0 has none; of the rod side the next
PY_CUSHION_ROD: Final = 21
PY_LEFT: Final = 22  # share of the way in that it leaves; of the rod side the next
PY_LEFT_ROD: Final = 23
PY_ROOM_P: Final = 24  # Pa
PY_ROOM_T: Final = 25  # K
PY_START: Final = 26  # extension at the start, m
PY_MASS: Final = 27  # of what moves by itself where a joint has play, kg
PY_SOFT: Final = 28  # deflection of the seals per force before they slide, m/N
PY_SOFT_DAMPING: Final = 29  # force per rate of that, N s/m
PY_THROTTLE: Final = 30  # length of a throttle besides the cushion, m; of the rod side the next
PY_THROTTLE_ROD: Final = 31
PY_HEADS: Final = 32  # velocity heads that it costs at the end; of the rod side the next
PY_HEADS_ROD: Final = 33
CYLINDER_PARAMS: Final = 34

# --- cylinder state rows --------------------------------------------------------------------------
SY_EXTENSION: Final = 0  # m, or rad of a rotary one
SY_SPEED: Final = 1  # m/s, or rad/s; of one that moves no body, what it is told
SY_PUSH: Final = 2  # growth of that speed in the last step, m/s^2
SY_COUNT: Final = 3  # cells of the head side that are in use; of the rod side the next
SY_COUNT_ROD: Final = 4
SY_IMPULSE: Final = 5  # of gas and room on the piston since it was last asked for, N s
SY_FORCE: Final = 6  # of gas and room on the piston, at the last step, N
SY_SIDE: Final = 7  # 1: leans on its body that it pushes, -1: that it pulls, 0: is loose between
SY_BENT: Final = 8  # deflection of its seals, m
CYLINDER_STATE: Final = 9

# --- cylinder work rows ---------------------------------------------------------------------------
WY_SPEED: Final = 0  # foreseen at the middle of the step, m/s
WY_FACE: Final = 1  # pressure on the piston, head side, Pa; rod side the next
WY_FACE_ROD: Final = 2
WY_MOVE: Final = 3  # way in this step, m
WY_HEAT: Final = 4  # heat conductance of the wall, head side, W/K; rod side the next
WY_HEAT_ROD: Final = 5
CYLINDER_WORK: Final = 6

# --- bodies (integer columns) ---------------------------------------------------------------------
B_KIND: Final = 0  # number in ``pneu_sim.bodies.kinds``
B_JOINT: Final = 1  # its first joint
B_JOINTS: Final = 2
B_PLACE: Final = 3  # its first place in the list of cylinders that bodies are driven by
B_PLACES: Final = 4
BODY_COLUMNS: Final = 5
BODY_PARAMS: Final = 48

# --- joint parameter rows -------------------------------------------------------------------------
PJ_DAMPING: Final = 0
PJ_FRICTION: Final = 1
PJ_LOWER: Final = 2
PJ_UPPER: Final = 3
PJ_STOP: Final = 4
PJ_STOP_DAMPING: Final = 5
PJ_HELD: Final = 6
PJ_START: Final = 7
PJ_PLAY: Final = 8  # between what turns it and itself, rad or m
PJ_SPRING: Final = 9  # rate of a spring, N m/rad or N/m ...
PJ_REST: Final = 10  # ... and where it is at rest
PJ_HOLD: Final = 11  # what of a force its stops keep that holds it back as it leaves
JOINT_PARAMS: Final = 12

# --- joint state rows -----------------------------------------------------------------------------
SJ_POSITION: Final = 0
SJ_VELOCITY: Final = 1
SJ_PUSH: Final = 2  # acceleration of the last step
JOINT_STATE: Final = 3

# --- sensor rows ----------------------------------------------------------------------------------
SENSE_KEEP: Final = 0  # share of its last reading that a lagging sensor keeps over a step
SENSE_OLD: Final = 1  # weight of the pressure one step ago
SENSE_NEW: Final = 2  # weight of the present pressure
SENSE_GAIN: Final = 3  # reading per pressure
SENSE_BIAS: Final = 4  # reading at no pressure, Pa
SENSOR_ROWS: Final = 5

# --- schemes --------------------------------------------------------------------------------------
HLLC: Final = 0
EXACT: Final = 1
MINMOD: Final = 0
VAN_LEER: Final = 1

NUSSELT_LAMINAR: Final = 3.66
"""Nusselt number of developed laminar flow in a round pipe at constant wall temperature."""
UNSTEADY_TERMS: Final = 6
"""Memory states per cell of the unsteady wall friction (and of the unsteady wall heat)."""
UNSTEADY_RATE: Final = 28.0
"""Decay rate of the slowest memory state, in nu / R^2; each next one is four times faster."""
UNSTEADY_WEIGHTS: Final = (1.17738631, 2.27579547, 4.65128154, 9.49798127, 14.11059658, 90.6150335)
"""Weights m_k of W(tau) = sum m_k exp(-n_k tau), n_k = 28 * 4^k.

Fitted by non-negative least squares to the exact wall shear of oscillating laminar pipe flow,
``sqrt(s) I1(sqrt s) / I2(sqrt s)`` (Zielke 1968), relative error <= 0.2 % for |s| nu / R^2 up to
3000. The ratio of four turns the six exponentials per cell and step into one and its squares.
"""
