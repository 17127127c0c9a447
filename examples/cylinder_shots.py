# SPDX-License-Identifier: Apache-2.0
"""A cylinder throws a mass eight times: what carries the mass while it sinks?

Run ``python examples/cylinder_shots.py``; it prints seven tables and draws
docs/figures/cylinder_shots.png, which needs matplotlib. The rig file holds what it finds for
"Coulomb, viscous", rounded.

After each shot the mass sinks at 60 to 130 mm/s while the sensor reads no pressure, so that 14 N
are carried by what is not measured: friction, or air behind a throttle on either side. Each of
`CANDIDATES` is the rig file with parts left out or added. All are fitted to the odd shots by the
same least squares, with the same freedom of supply, valve, line and sensor, and judged on the even
ones.

A shot is simulated from 40 ms before its pressure rises. The mass starts at its measured place and
speed, the gas with the pressures that carry it at that speed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.optimize import brentq, least_squares

from pneu_common.errors import InputError
from pneu_sim.gas import AIR
from pneu_sim.kernel.orifices import iso6358_flow
from pneu_sim.rig import load_rig
from pneu_sim.rig.parameters import get_parameter, with_parameters
from pneu_sim.rig.schema import Rig
from pneu_sim.simulator import Simulator

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "data" / "cylinder_shots" / "shots.csv"
RIG = ROOT / "rigs" / "cylinder_shots.yaml"
FIGURE = ROOT / "docs" / "figures" / "cylinder_shots.png"

SAMPLE_S = 1e-3
BEFORE = 40
"""Samples of a shot before its pressure rises."""
LEAD = 5
"""Samples by which the commands come before the pressure shows them; delays take up the rest."""
WIDTH = 78
"""Samples for which the valve is commanded; what a shot has more is in its delays as well."""
RISING = 150
"""Samples after the command for which the mass rises: a check valve that follows it is open."""
PRESSED = 220
"""Samples from the beginning in which the pressure is compared; later it reads zero."""
HEIGHT_M = 0.07
"""Where the forces on the sinking mass are told: well after the vent, well before the next shot."""
FITTED, LIKE_THEM, SLOWER = (1, 3, 5, 7), (6, 8), (2, 4)
"""Shots by what they are for: fitted, judged, and judged though they sink more slowly."""
POSITION_M, PRESSURE_PA = 1e-3, 3e3
"""An error of this size counts as one; five and three counts of the sensors."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Shot:
    """One shot as measured.

    Attributes:
        number: 1 to 8.
        position_m: (T,) position, m, every millisecond.
        gauge_pa: (T,) reading of the pressure, Pa above the room.
        on_s: When the pressure passes 0.3 bar, s from the beginning.
        off_s: When it passes 1.5 bar as it falls.
        start_m: Place at the beginning, by a line through the samples before the valve opens.
        start_m_s: Speed there.
    """

    number: int
    position_m: Floats
    gauge_pa: Floats
    on_s: float
    off_s: float
    start_m: float
    start_m_s: float


@dataclass(frozen=True)
class Free:
    """A number that the fit may change.

    Attributes:
        path: Its path in the rig.
        lower: Lower bound; where positive, steps are relative.
        upper: Upper bound.
        scale: Step of numbers that may be zero or less.
    """

    path: str
    lower: float
    upper: float
    scale: float = 0.0

    def inner(self, value: float) -> float:
        """The number as the fit has it.

        Args:
            value: The number, within its bounds.
        """
        value = min(max(value, self.lower), self.upper)
        return value / self.scale if self.scale else float(np.log(value))

    def outer(self, inner: float) -> float:
        """The number itself.

        Args:
            inner: The number as the fit has it.
        """
        return inner * self.scale if self.scale else float(np.exp(inner))


VALVE = "valves.valve"
BIAS = "taps.sensor.bias_pa"
SIDE = (
    Free("reservoirs.supply.pressure_pa", 3.2e5, 8e5),
    Free(f"{VALVE}.ports.supply.conductance_m3_s_pa", 5e-10, 1e-7),
    Free(f"{VALVE}.ports.exhaust.conductance_m3_s_pa", 3e-10, 1e-7),
    Free(f"{VALVE}.spool.delay_s", 0.0, 8e-3, 1e-3),
    Free(f"{VALVE}.spool.closing_delay_s", 0.0, 8e-3, 1e-3),
    Free(f"{VALVE}.spool.max_speed_v_s", 100.0, 3000.0),
    Free("orifices.line.conductance_m3_s_pa", 3e-10, 1e-7),
    Free("chambers.sensor.volume_m3", 6e-7, 1e-5),
    Free("cylinders.cylinder.head.dead_volume_m3", 2e-6, 6e-5),
    Free("taps.sensor.lag_s", 1e-4, 1e-2),
    Free(BIAS, -3e4, 5e3, 5e3),
)
"""What every candidate may choose: the head side, from the supply to the sensor's reading."""
COULOMB = Free("cylinders.cylinder.friction.coulomb_n", 0.1, 20.0)
VISCOUS = Free("cylinders.cylinder.friction.viscous_n_s_m", 0.1, 300.0)
BREAKAWAY = Free("cylinders.cylinder.friction.breakaway_n", 0.05, 20.0)
STRIBECK = Free("cylinders.cylinder.friction.stribeck_m_s", 5e-3, 0.5)
HEAD_CHECK = Free(f"{VALVE}.ports.head_check.conductance_m3_s_pa", 1e-11, 1e-7)
ROD = Free("orifices.rod.conductance_m3_s_pa", 1e-11, 5e-8)
ROD_VOLUME = Free("cylinders.cylinder.rod.dead_volume_m3", 3e-7, 1e-4)
ROD_CHECK = Free("valves.check.ports.rod_check.conductance_m3_s_pa", 1e-8, 5e-8)
"""Wide open whatever the fit: shut it would be `rod_throttle`."""


def no_friction(data: dict[str, Any]) -> None:
    """Takes the friction away.

    Args:
        data: The rig as plain data, changed in place.
    """
    del data["cylinders"]["cylinder"]["friction"]


def head_check(data: dict[str, Any]) -> None:
    """A check valve beside the line: open while the valve feeds, shut while the air leaves.

    Args:
        data: The rig as plain data, changed in place.
    """
    ports = data["valves"]["valve"]["ports"]
    ports["head_check"] = {**ports["supply"], "from": "sensor", "to": "head"}


def rod_throttle(data: dict[str, Any]) -> None:
    """Air on the rod side, behind a throttle to the room.

    Args:
        data: The rig as plain data, changed in place.
    """
    data["cylinders"]["cylinder"]["rod"] = {"node": "rod", "dead_volume_m3": 5e-6}
    throttle = {"from": "rod", "to": "room", "conductance_m3_s_pa": 7e-10, "laminar_ratio": 0.98}
    data["orifices"]["rod"] = throttle


def rod_check(data: dict[str, Any]) -> None:
    """The same, and a check valve that lets the air out while the mass rises.

    The simulator has none; a port that is told when the mass rises does the same.

    Args:
        data: The rig as plain data, changed in place.
    """
    rod_throttle(data)
    port = {
        "from": "rod",
        "to": "room",
        "conductance_m3_s_pa": 2e-8,
        "laminar_ratio": 0.98,
        "opening": {"voltage_v": [0.0, 1.0], "fraction": [0.0, 1.0]},
    }
    data["valves"]["check"] = {
        "command": "rising",
        "spool": {"null_v": 0.0},
        "ports": {"rod_check": port},
    }
    data["commands"]["rising"] = {}


def sensor_at_head(data: dict[str, Any]) -> None:
    """The sensor on the head side itself, instead of before the line that leads there.

    Args:
        data: The rig as plain data, changed in place.
    """
    data["taps"]["sensor"]["chamber"] = "head"


@dataclass(frozen=True)
class Candidate:
    """A guess at what carries the sinking mass.

    Attributes:
        name: What it is called.
        changes: What is changed of the rig file, one after the other.
        free: What the fit may change besides `SIDE`.
        start: Numbers by path from which its fit begins, where they are not the rig file's.
    """

    name: str
    changes: tuple[Callable[[dict[str, Any]], None], ...]
    free: tuple[Free, ...]
    start: dict[str, float] = field(default_factory=dict)

    def rig(self, base: Rig) -> Rig:
        """The rig that its fit begins with.

        Args:
            base: The rig file's.
        """
        data = base.dump()
        for change in self.changes:
            change(data)
        return with_parameters(Rig.model_validate(data), self.start)


SHUT_IN = {
    "reservoirs.supply.pressure_pa": 4.0e5,
    f"{VALVE}.ports.supply.conductance_m3_s_pa": 3.3e-9,
    f"{VALVE}.ports.exhaust.conductance_m3_s_pa": 1.5e-9,
    f"{VALVE}.spool.delay_s": 2.4e-3,
    f"{VALVE}.spool.closing_delay_s": 1.2e-3,
    "orifices.line.conductance_m3_s_pa": 9e-10,
    HEAD_CHECK.path: 2.9e-9,
    "chambers.sensor.volume_m3": 2.8e-6,
    "cylinders.cylinder.head.dead_volume_m3": 1.5e-5,
    "taps.sensor.lag_s": 3e-4,
    BIAS: -1.1e4,
}
"""Where fits with a throttled head side begin; least squares has more than one minimum."""
ROD_ALONE = {
    f"{VALVE}.ports.exhaust.conductance_m3_s_pa": 7e-10,
    f"{VALVE}.spool.delay_s": 5e-4,
    f"{VALVE}.spool.closing_delay_s": 1e-4,
    "orifices.line.conductance_m3_s_pa": 2.8e-9,
    "cylinders.cylinder.head.dead_volume_m3": 4e-5,
    "taps.sensor.lag_s": 4e-3,
    ROD.path: 2.5e-9,
    ROD_VOLUME.path: 7.4e-6,
}
"""Where fits begin that brake the rise by the air on the rod side, there being no friction."""
STRONG_SUPPLY = {
    "reservoirs.supply.pressure_pa": 5.7e5,
    f"{VALVE}.ports.supply.conductance_m3_s_pa": 1.7e-9,
    f"{VALVE}.ports.exhaust.conductance_m3_s_pa": 1.06e-9,
    "taps.sensor.lag_s": 1.5e-3,
    BIAS: -2.9e4,
}
"""Where fits begin that are left with viscous friction and no throttle beside the line."""
SUCKING_ROD = {ROD.path: 6.5e-10, ROD_VOLUME.path: 6.7e-7, ROD_CHECK.path: 3.5e-8}
WIDE_ROD = {ROD.path: 3e-9, ROD_VOLUME.path: 4.6e-5}
CANDIDATES = (
    Candidate("no friction", (no_friction,), ()),
    Candidate("no friction; rod", (no_friction, rod_throttle), (ROD, ROD_VOLUME), ROD_ALONE),
    Candidate(
        "no friction; head one way, rod",
        (no_friction, head_check, rod_throttle),
        (HEAD_CHECK, ROD, ROD_VOLUME),
        {**ROD_ALONE, "orifices.line.conductance_m3_s_pa": 2e-9, HEAD_CHECK.path: 8e-10},
    ),
    Candidate(
        "viscous",
        (),
        (VISCOUS,),
        {
            **STRONG_SUPPLY,
            f"{VALVE}.ports.exhaust.conductance_m3_s_pa": 8.2e-10,
            COULOMB.path: 0.0,
            VISCOUS.path: 44.6,
        },
    ),
    Candidate(
        "viscous; rod one way",
        (rod_check,),
        (VISCOUS, ROD, ROD_VOLUME, ROD_CHECK),
        {**STRONG_SUPPLY, **SUCKING_ROD, COULOMB.path: 0.0, VISCOUS.path: 47.0},
    ),
    Candidate(
        "viscous; head one way",
        (head_check,),
        (VISCOUS, HEAD_CHECK),
        {**SHUT_IN, COULOMB.path: 0.0, VISCOUS.path: 57.0},
    ),
    Candidate(
        "viscous; head one way, rod",
        (head_check, rod_throttle),
        (VISCOUS, HEAD_CHECK, ROD, ROD_VOLUME),
        {**SHUT_IN, **WIDE_ROD, COULOMB.path: 0.0, VISCOUS.path: 38.0},
    ),
    Candidate("Coulomb, viscous", (), (COULOMB, VISCOUS)),
    Candidate("Coulomb, viscous; sensor at head", (sensor_at_head,), (COULOMB, VISCOUS)),
    Candidate(
        "Coulomb, viscous, Stribeck",
        (),
        (COULOMB, VISCOUS, BREAKAWAY, STRIBECK),
        {BREAKAWAY.path: 3.7, STRIBECK.path: 0.13, BIAS: -1.4e4},
    ),
    Candidate(
        "Coulomb, viscous; rod one way",
        (rod_check,),
        (COULOMB, VISCOUS, ROD, ROD_VOLUME, ROD_CHECK),
        {ROD.path: 2e-9, ROD_VOLUME.path: 2e-6, COULOMB.path: 7.0},
    ),
    Candidate(
        "Coulomb, viscous; head one way, rod",
        (head_check, rod_throttle),
        (COULOMB, VISCOUS, HEAD_CHECK, ROD, ROD_VOLUME),
        {**SHUT_IN, **WIDE_ROD, COULOMB.path: 2.0, VISCOUS.path: 38.0},
    ),
)
OWN = "Coulomb, viscous"
"""The candidate that the rig file is."""
RIVAL = "viscous; head one way, rod"
"""The candidate without Coulomb friction that comes closest."""
CLOSEST = ("Coulomb, viscous, Stribeck", RIVAL)
"""The candidates that come closest, one with much friction and one with little."""
STEPS = 15
"""Most steps of a fit."""


def read_shots(path: Path = DATA) -> list[Shot]:
    """The shots of the recording that end within it.

    Args:
        path: The recording.
    """
    columns = np.genfromtxt(path, delimiter=",", skip_header=1, dtype=float)
    position, gauge = columns[:, 1], columns[:, 2] - 101325.0
    rises = np.flatnonzero((gauge[1:] > 5e3) & (gauge[:-1] <= 5e3))
    shots = []
    for number, (rise, following) in enumerate(pairwise(rises), start=1):
        x = position[rise - BEFORE : following - 5]
        p = gauge[rise - BEFORE : following - 5]
        speed, start = np.polyfit(SAMPLE_S * np.arange(BEFORE), x[:BEFORE], 1)
        on = passes(p, BEFORE - 5, 3e4)
        off = passes(-p, BEFORE + 40, -1.5e5)
        shots.append(Shot(number, x, p, on, off, float(start), float(speed)))
    return shots


def passes(series: Floats, begin: int, level: float) -> float:
    """When a series first exceeds a level, s; linear between samples.

    Args:
        series: The series, one per sample.
        begin: First sample that is looked at.
        level: The level.
    """
    k = begin + int(np.flatnonzero(series[begin:] > level)[0])
    part = (level - series[k - 1]) / (series[k] - series[k - 1])
    return SAMPLE_S * (k - 1 + float(part))


@dataclass(frozen=True)
class Course:
    """Rigs along shots, side by side.

    Attributes:
        position_m: (T, rigs) position, m.
        speed_m_s: (T, rigs) speed.
        gauge_pa: (T, rigs) what the sensor shows, Pa above the room; it shows nothing below.
        head_pa: (T, rigs) pressure on the head side, Pa above the room.
        rod_pa: (T, rigs) on the rod side.
    """

    position_m: Floats
    speed_m_s: Floats
    gauge_pa: Floats
    head_pa: Floats
    rod_pa: Floats


def fly(rigs: Sequence[Rig], shots: Sequence[Shot]) -> Course:
    """Simulates shots, as long as the longest.

    Args:
        rigs: The rig of each shot, all of one structure.
        shots: The shots.
    """
    first = rigs[0]
    samples = max(shot.position_m.size for shot in shots)
    on = BEFORE - LEAD
    simulator = Simulator([timed(rig, shot) for rig, shot in zip(rigs, shots, strict=True)])
    states = [carried(rig, shot.start_m_s) for rig, shot in zip(rigs, shots, strict=True)]
    kelvin = first.ambient.temperature_k
    simulator.set_chamber("head", [head for head, _ in states], kelvin)
    if first.cylinders["cylinder"].rod is not None:
        simulator.set_chamber("rod", [rod for _, rod in states], kelvin)
    simulator.plant.place(
        {"load_slide": [shot.start_m for shot in shots]},
        {"load_slide": [shot.start_m_s for shot in shots]},
    )
    at = np.arange(samples - 1)
    commands = {"valve": ((at >= on) & (at < on + WIDTH)).astype(float)}
    if "rising" in first.commands:
        commands["rising"] = ((at >= on) & (at < on + RISING)).astype(float)
    out = simulator.run(SAMPLE_S * (samples - 1), commands, SAMPLE_S)
    room = first.ambient.pressure_pa
    head = out.chambers["head"] - room
    return Course(
        out.joints["load_slide"],
        out.speeds["load_slide"],
        np.maximum(out.taps["sensor"] - room, 0.0),
        head,
        out.chambers["rod"] - room if "rod" in out.chambers else np.zeros_like(head),
    )


def timed(rig: Rig, shot: Shot) -> Rig:
    """The rig whose valve takes as long as it does after the commands that all shots have.

    Args:
        rig: The rig.
        shot: The shot.
    """
    on = SAMPLE_S * (BEFORE - LEAD)
    late = {
        "delay_s": shot.on_s - SAMPLE_S * (LEAD - 1) - on,
        "closing_delay_s": shot.off_s - SAMPLE_S * (LEAD - 1) - on - SAMPLE_S * WIDTH,
    }
    paths = {f"{VALVE}.spool.{name}": value for name, value in late.items()}
    return with_parameters(
        rig, {path: get_parameter(rig, path) + value for path, value in paths.items()}
    )


def friction_n(rig: Rig, speed_m_s: float) -> float:
    """Friction of the seals at some speed, N.

    Args:
        rig: The rig.
        speed_m_s: The speed, of either sign.
    """
    seals, v = rig.cylinders["cylinder"].friction, abs(speed_m_s)
    more = seals.breakaway_n * float(np.exp(-((v / seals.stribeck_m_s) ** 2)))
    return seals.coulomb_n + more + seals.viscous_n_s_m * v


def weight_n(rig: Rig) -> float:
    """Weight of the mass, N.

    Args:
        rig: The rig.
    """
    return rig.bodies["load"].numbers()[1]


def carried(rig: Rig, speed_m_s: float) -> tuple[float, float]:
    """Pressures on head and rod side with which the mass sinks at a steady speed, Pa.

    Args:
        rig: The rig.
        speed_m_s: The speed.
    """
    room, cylinder = rig.ambient.pressure_pa, rig.cylinders["cylinder"]
    area, rod_area = cylinder.areas
    rod = room
    if cylinder.rod is not None:
        way, kelvin = rig.orifices["rod"], rig.ambient.temperature_k

        def short(p: float) -> float:
            enters = iso6358_flow(
                room, 0.0, kelvin, p, 0.0, kelvin,
                way.conductance_m3_s_pa, way.critical_ratio, way.laminar_ratio,
            )  # fmt: skip
            return float(enters) - p * rod_area * abs(speed_m_s) / (AIR.r_specific * kelvin)

        rod = float(brentq(short, 0.01 * room, room))
    push = weight_n(rig) - friction_n(rig, speed_m_s) + (rod - room) * rod_area
    return max(room + push / area, 0.9 * room), rod


def residual(course: Course, shots: Sequence[Shot]) -> list[Floats]:
    """Errors of each lane, of position and then pressure, in `POSITION_M` and `PRESSURE_PA`.

    Args:
        course: The rigs along the shots.
        shots: The shots, one per lane.
    """
    return [
        np.concatenate(
            [
                (course.position_m[: shot.position_m.size : 4, lane] - shot.position_m[::4])
                / POSITION_M,
                (course.gauge_pa[:PRESSED, lane] - shot.gauge_pa[:PRESSED]) / PRESSURE_PA,
            ]
        )
        for lane, shot in enumerate(shots)
    ]


def fit(rig: Rig, free: Sequence[Free], shots: Sequence[Shot]) -> tuple[Rig, float]:
    """Fits numbers of a rig to shots by least squares.

    Args:
        rig: The rig.
        free: What may change.
        shots: The shots.

    Returns:
        The fitted rig, and the sum of squares that is left.
    """

    def with_values(z: Floats) -> Rig:
        values = {f.path: f.outer(x) for f, x in zip(free, z, strict=True)}
        return with_parameters(rig, values)

    def errors(points: Sequence[Floats]) -> list[Floats]:
        lanes = [rig for rig in map(with_values, points) for _ in shots]
        each = [*shots] * len(points)
        parts = residual(fly(lanes, each), each)
        n = len(shots)
        return [np.concatenate(parts[n * k : n * k + n]) for k in range(len(points))]

    def slope(z: Floats) -> Floats:
        h = np.where(z + 1e-3 <= upper, 1e-3, -1e-3)
        moved = errors([z, *(z + row for row in np.diag(h))])
        return np.stack([(m - moved[0]) / step for m, step in zip(moved[1:], h, strict=True)], 1)

    lower = np.array([f.inner(f.lower) for f in free])
    upper = np.array([f.inner(f.upper) for f in free])
    begin = np.array([f.inner(get_parameter(rig, f.path)) for f in free])
    margin = 1e-6 * (upper - lower)
    found = least_squares(
        lambda z: errors([z])[0],
        np.clip(begin, lower + margin, upper - margin),
        jac=slope,
        bounds=(lower, upper),
        x_scale=0.3,
        max_nfev=STEPS,
        ftol=1e-4,
    )
    return with_values(found.x), 2.0 * float(found.cost)


@dataclass(frozen=True)
class Found:
    """A candidate, fitted.

    Attributes:
        candidate: The candidate.
        rig: Its rig, fitted to the odd shots.
        squares: Sum of squares that is left of these.
        course: That rig along all shots.
        position_m: (shots,) root mean square of the error of position over the whole shot, m.
        rise_m: (shots,) the same over the first 0.3 s.
        pressure_pa: (shots,) that of pressure, over `PRESSED`, Pa.
        forces_n: What carries the mass at `HEIGHT_M` as it sinks, mean over the shots, N: friction,
            the air on the head side, that on the rod side.
    """

    candidate: Candidate
    rig: Rig
    squares: float
    course: Course
    position_m: Floats
    rise_m: Floats
    pressure_pa: Floats
    forces_n: tuple[float, float, float]


def study(candidate: Candidate, base: Rig, shots: Sequence[Shot]) -> Found:
    """Fits a candidate and runs it along all shots.

    Args:
        candidate: The candidate.
        base: The rig file's rig.
        shots: All shots.
    """
    rig, squares = fit(candidate.rig(base), [*SIDE, *candidate.free], odd(shots))
    return judge(candidate, rig, shots, squares)


def odd(shots: Sequence[Shot]) -> list[Shot]:
    """The shots that are fitted.

    Args:
        shots: All shots.
    """
    return [shot for shot in shots if shot.number in FITTED]


def judge(
    candidate: Candidate, rig: Rig, shots: Sequence[Shot], squares: float = float("nan")
) -> Found:
    """Runs a rig along all shots.

    Args:
        candidate: The candidate that it is.
        rig: The rig.
        shots: All shots.
        squares: Sum of squares that a fit has left.
    """
    course = fly([rig] * len(shots), shots)
    position, rise, pressure, forces = [], [], [], []
    for lane, shot in enumerate(shots):
        error = course.position_m[: shot.position_m.size, lane] - shot.position_m
        position.append(rms(error))
        rise.append(rms(error[:300]))
        pressure.append(rms(course.gauge_pa[:PRESSED, lane] - shot.gauge_pa[:PRESSED]))
        forces.append(carrying_n(rig, course, lane))
    friction, head, rod = np.mean(forces, axis=0)
    return Found(
        candidate,
        rig,
        squares,
        course,
        np.array(position),
        np.array(rise),
        np.array(pressure),
        (float(friction), float(head), float(rod)),
    )


def rms(error: Floats) -> float:
    """Root of the mean square.

    Args:
        error: Any errors.
    """
    return float(np.sqrt(np.mean(error**2)))


def carrying_n(rig: Rig, course: Course, lane: int) -> tuple[float, float, float]:
    """What carries the mass at `HEIGHT_M` as it sinks, N: friction, air on head and rod side.

    Args:
        rig: The rig of a lane.
        course: The rigs along the shots.
        lane: The lane.
    """
    x = course.position_m[:, lane]
    top = int(np.argmax(x))
    k = top + int(np.argmax(x[top:] < HEIGHT_M))
    area, rod_area = rig.cylinders["cylinder"].areas
    return (
        friction_n(rig, course.speed_m_s[k, lane]),
        float(course.head_pa[k, lane]) * area,
        -float(course.rod_pa[k, lane]) * rod_area,
    )


def measured_speed_m_s(shot: Shot) -> float:
    """Speed at which the mass sinks past `HEIGHT_M`, m/s, by a line through 10 mm about it.

    Args:
        shot: The shot.
    """
    x = shot.position_m
    at = np.arange(x.size)
    near = (at > int(np.argmax(x))) & (np.abs(x - HEIGHT_M) < 5e-3)
    return float(np.polyfit(SAMPLE_S * at[near], x[near], 1)[0])


def columns(title: str, names: Sequence[str]) -> Table:
    """An empty table.

    Args:
        title: Its title.
        names: Its columns, the first of words and the others of numbers.
    """
    table = Table(title=title)
    for k, name in enumerate(names):
        table.add_column(name, justify="right" if k else "left")
    return table


def tables(shots: Sequence[Shot], found: Sequence[Found]) -> list[Table]:
    """The shots; per candidate the errors of position and pressure of every shot, and the forces.

    Args:
        shots: The shots.
        found: The candidates, fitted.
    """
    names = ["shot", "pressed, ms", "lowest, mm", "top, mm", "sinks at 70 mm, mm/s", "mean, mm/s"]
    measured = columns("as measured", names)
    for shot in shots:
        x, top = shot.position_m, int(np.argmax(shot.position_m))
        mean = (x[-1] - x[top]) / (SAMPLE_S * (x.size - 1 - top))
        measured.add_row(
            str(shot.number),
            f"{1e3 * (shot.off_s - shot.on_s):.1f}",
            f"{1e3 * x[:100].min():.1f}",
            f"{1e3 * x[top]:.1f}",
            f"{-1e3 * measured_speed_m_s(shot):.0f}",
            f"{-1e3 * mean:.0f}",
        )
    heads = ["candidate", *(f"shot {shot.number}" for shot in shots)]
    position = columns("error of position, rms, mm (fitted to 1, 3, 5, 7)", heads)
    pressure = columns("error of pressure, rms, bar, first 0.22 s", heads)
    carried_by = columns(
        "what carries the mass as it sinks past 70 mm, N",
        ["candidate", "free", "squares", "first 0.3 s, mm", "friction", "head air", "rod air"],
    )
    for one in found:
        name = one.candidate.name
        position.add_row(name, *(f"{1e3 * e:.2f}" for e in one.position_m))
        pressure.add_row(name, *(f"{1e-5 * e:.3f}" for e in one.pressure_pa))
        carried_by.add_row(
            name,
            str(len(SIDE) + len(one.candidate.free)),
            f"{one.squares:.0f}",
            f"{1e3 * rms(one.rise_m):.2f}",
            *(f"{force:.1f}" for force in one.forces_n),
        )
    return [measured, position, pressure, carried_by]


SLOWER_BY = (
    (OWN, COULOMB.path),
    (OWN, VISCOUS.path),
    (OWN, f"{VALVE}.ports.exhaust.conductance_m3_s_pa"),
    (RIVAL, VISCOUS.path),
    (RIVAL, "orifices.line.conductance_m3_s_pa"),
    (RIVAL, ROD.path),
)
"""Which candidate, and the one number that is fitted anew to shot 2."""


def numbers(found: Sequence[Found]) -> Table:
    """What was found for the rig file's candidate and for its rival.

    Args:
        found: The candidates, fitted.
    """
    rigs = [one.rig for name in (OWN, RIVAL) for one in found if one.candidate.name == name]
    table = columns("what was found", ["number", OWN, RIVAL])
    for number in (*SIDE, COULOMB, VISCOUS, HEAD_CHECK, ROD, ROD_VOLUME):
        cells = []
        for rig in rigs:
            try:
                cells.append(f"{get_parameter(rig, number.path):.3g}")
            except InputError:  # a part that only one of them has
                cells.append("-")
        table.add_row(number.path, *cells)
    return table


def slower(found: Sequence[Found], shots: Sequence[Shot]) -> Table:
    """What one number would have to be in shot 2, and whether it then also makes shot 4.

    Args:
        found: The candidates, fitted.
        shots: All shots.
    """
    names = ["candidate: number", "odd shots", "shot 2", "shot 4, mm", "shot 4, bar"]
    table = columns("shots 2 and 4 sink more slowly: one number, fitted anew to shot 2", names)
    by_name = {one.candidate.name: one for one in found}
    free = {f.path: f for f in (*SIDE, COULOMB, VISCOUS, ROD)}
    for name, path in SLOWER_BY:
        one = by_name[name]
        rig, _ = fit(one.rig, [free[path]], [shots[1]])
        again = judge(one.candidate, rig, shots)
        table.add_row(
            f"{name}: {path}",
            f"{get_parameter(one.rig, path):.3g}",
            f"{get_parameter(rig, path):.3g}",
            f"{1e3 * again.position_m[3]:.2f}",
            f"{1e-5 * again.pressure_pa[3]:.3f}",
        )
    return table


def zeroed(found: Sequence[Found], shots: Sequence[Shot]) -> Table:
    """What `CLOSEST` leave once more, were the sensor's zero right.

    Args:
        found: The candidates, fitted; fits begin with what they found.
        shots: All shots.
    """
    table = columns(
        "the sensor's zero taken to be right",
        ["candidate", "squares", "before", "friction, N", "head air, N", "rod air, N"],
    )
    side = [number for number in SIDE if number.path != BIAS]
    for one in found:
        if one.candidate.name in CLOSEST:
            rig = with_parameters(one.rig, {BIAS: 0.0})
            rig, squares = fit(rig, [*side, *one.candidate.free], odd(shots))
            again = judge(one.candidate, rig, shots, squares)
            table.add_row(
                one.candidate.name,
                f"{squares:.0f}",
                f"{one.squares:.0f}",
                *(f"{force:.1f}" for force in again.forces_n),
            )
    return table


def draw(shots: Sequence[Shot], found: Sequence[Found], path: Path) -> None:
    """Positions, pressures, errors, and what carries the mass.

    Args:
        shots: The shots.
        found: The candidates, fitted.
        path: Where to.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    by_name = {one.candidate.name: one for one in found}
    shown = ((OWN, "C3", "-"), (RIVAL, "C0", "--"), ("no friction; rod", "C2", ":"))
    figure, ((above, press), (wrong, bars)) = plt.subplots(
        2, 2, figsize=(13.0, 8.5), layout="constrained"
    )
    for shot in shots:
        at = SAMPLE_S * (np.arange(shot.position_m.size) - BEFORE)
        label = {1: "measured", 2: "measured, shots 2 and 4"}.get(shot.number)
        color = "0.75" if shot.number in SLOWER else "0.45"
        above.plot(at, 1e3 * shot.position_m, color=color, lw=1.6, label=label)
        press.plot(at[:PRESSED], 1e-5 * shot.gauge_pa[:PRESSED], color="0.45", lw=1.6)
    lane = 7
    n = shots[lane].position_m.size
    at = SAMPLE_S * (np.arange(n) - BEFORE)
    for name, color, line in shown:
        one = by_name[name]
        x = one.course.position_m[:n, lane]
        above.plot(at, 1e3 * x, color=color, ls=line, label=f"{name} (shot 8)")
        press.plot(at[:PRESSED], 1e-5 * one.course.gauge_pa[:PRESSED, lane], color=color, ls=line)
        wrong.plot(at, 1e3 * (x - shots[lane].position_m), color=color, ls=line, label=name)
    for name, color, _ in shown[:2]:
        head = by_name[name].course.head_pa[:PRESSED, lane]
        press.plot(at[:PRESSED], 1e-5 * head, color=color, lw=0.8, alpha=0.7)
    press.set_title("pressure: the sensor's; thin, the model's on the head side")
    above.set_title("position")
    wrong.set_title("error of position, shot 8, which was not fitted")
    wrong.axhline(0.0, color="0.7", lw=0.8)
    above.set_ylabel("mm")
    press.set_ylabel("bar gauge")
    wrong.set_ylabel("mm")
    for axis in (above, press, wrong):
        axis.set_xlabel("time, s")
    above.legend(fontsize=8)
    wrong.legend(fontsize=8)
    place = np.arange(len(found))[::-1]
    left = np.zeros(len(found))
    for k, (name, color) in enumerate((("friction", "C3"), ("head air", "C0"), ("rod air", "C2"))):
        width = np.array([one.forces_n[k] for one in found])
        bars.barh(place, width, left=left, color=color, label=name)
        left += width
    least = min(one.squares for one in found)
    labels = [f"{one.candidate.name}  ({one.squares / least:.2f})" for one in found]
    bars.set_yticks(place, labels, fontsize=8)
    bars.set_xlim(0.0, 1.25 * weight_n(found[0].rig))
    bars.axvline(weight_n(found[0].rig), color="k", lw=0.8)
    bars.set_title("what carries the mass at 70 mm (squares left, least is 1)")
    bars.set_xlabel("N; the line is the weight")
    bars.legend(fontsize=8, loc="lower right")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    """Prints the tables and draws the figure."""
    shots, base = read_shots(), load_rig(RIG)
    found = [study(candidate, base, shots) for candidate in CANDIDATES]
    console = Console(width=160)
    for table in (
        *tables(shots, found),
        numbers(found),
        slower(found, shots),
        zeroed(found, shots),
    ):
        console.print(table)
    draw(shots, found, FIGURE)
    console.print(f"wrote {FIGURE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
