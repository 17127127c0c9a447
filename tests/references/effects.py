# SPDX-License-Identifier: Apache-2.0
"""Experiments with a reference result for every effect: a closed form, or equations by SciPy.

Each isolates one law: flow through a valve between two reservoirs, mass lost by a leaking chamber,
a mass on a spring. The formulas are written out here from the sources that the effects cite.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import jv

from pneu_sim.effects.base import Comparison
from pneu_sim.rig import Rig
from pneu_sim.rig.schema import AttachedEffect
from pneu_sim.simulator import Simulator

Floats = NDArray[np.float64]

P0, T0, R, GAMMA = 1e5, 293.15, 287.05, 1.4
HIGH = 6e5
RHO0, T_REF = 1.185, 293.15  # ISO 6358-1
STILL = {"laminar": 0.0, "turbulent": 0.0, "nusselt": 0.0, "heat_turbulent": 0.0}
STEP_S = 1e-3


def _rig(**parts: Any) -> Rig:
    parts.setdefault("ambient", {"pressure_pa": P0, "temperature_k": T0})
    parts.setdefault("grid", {"memory": False})
    parts.setdefault(
        "reservoirs", {"source": {"pressure_pa": HIGH}, "room": {"pressure_pa": P0, "room": True}}
    )
    return Rig.model_validate({"name": "reference", **parts})


# -- valves: one between two reservoirs ------------------------------------------------------------

C, B = 1e-9, 0.3


def _valve(low_pa: float = P0, **spool: float) -> Rig:
    def way(begin: str, end: str, volts: Sequence[float], opening: Sequence[float]) -> Any:
        curve = {"voltage_v": list(volts), "fraction": list(opening)}
        return {
            "from": begin,
            "to": end,
            "conductance_m3_s_pa": C,
            "critical_ratio": B,
            "opening": curve,
        }

    ports = {
        "fill": way("source", "low", (5.0, 10.0), (0.0, 1.0)),
        "drain": way("source", "room", (0.0, 5.0), (1.0, 0.0)),
    }
    return _rig(
        reservoirs={
            "source": {"pressure_pa": HIGH},
            "low": {"pressure_pa": low_pa, "room": False},
            "room": {"pressure_pa": P0, "room": True},
        },
        valves={"valve": {"command": "u", "spool": {"null_v": 5.0, **spool}, "ports": ports}},
        commands={"u": {}},
        chambers={"tank": {"volume_m3": 1e-3}},
        orifices={"o": {"from": "tank", "to": "room", "conductance_m3_s_pa": 1e-12}},
        taps={"tank": {"chamber": "tank"}},
    )


def _openings(volts: Floats, sample_s: float = STEP_S) -> Callable[[Rig], Floats]:
    """Openings of both ports at the middle of the last step before each sample."""

    def measure(rig: Rig) -> Floats:
        run = Simulator(rig).run(sample_s * volts.size, {"u": volts}, sample_s)
        flows = np.stack([run.flows["valve.fill"], run.flows["valve.drain"]])
        return np.asarray(flows[:, 1:] / (C * RHO0 * HIGH))

    return measure


def _held(*volts: float, samples: int = 60) -> Floats:
    return np.repeat(np.array(volts), samples)


def _static(
    opening: Callable[[float, float], float], gain: Callable[[float], float] = lambda _: 1.0
) -> dict[str, Any]:
    """What a valve passes that has come to rest at each of some voltages."""
    volts = (5.2, 6.0, 8.0, 9.5, 4.7, 3.0, 1.0)

    def measure(rig: Rig) -> Floats:
        return _openings(_held(*volts))(rig)[:, 59::60]

    def expected(strength: float) -> Floats:
        x = np.array([opening(u, strength) for u in volts])
        ways = np.stack([np.clip(x / 5.0, 0.0, 1.0), np.clip(-x / 5.0, 0.0, 1.0)])
        return np.asarray(gain(strength) * ways)

    return {"rig": _valve(), "place": "valve", "measure": measure, "expected": expected}


def _dead(u: float, width: float) -> float:
    return math.copysign(max(abs(u - 5.0) - width, 0.0), u - 5.0)


def _late(strength: float, closing: bool = False) -> Floats:
    """A step to or from 0.6 at 20 ms that comes later, as the middle of the last step tells it."""
    late = STEP_S * np.arange(1, 101) > 0.02 + strength + 1e-9
    x = np.where(late != closing, 0.6, 0.0)
    return np.stack([x, np.zeros_like(x)])


def _ramped(lag_s: float) -> Floats:
    """A second-order spool behind a ramp, integrated."""
    # 2 zeta / omega of the valve itself, damped so, and what is added to it
    zeta, own = 0.8, 2.0 * 0.8 / (2.0 * math.pi * 60.0)
    omega = 2.0 * zeta / (own + lag_s)
    found = solve_ivp(
        lambda t, y: [y[1], omega**2 * (20.0 * t - y[0]) - 2.0 * zeta * omega * y[1]],
        (0.0, 0.2),
        [0.0, 0.0],
        t_eval=np.arange(1, 201) * STEP_S,
        rtol=1e-10,
        atol=1e-12,
    )
    x = found.y[0] / 5.0
    return np.stack([x, np.zeros_like(x)])[:, 20:]


def _ramp(rig: Rig) -> Floats:
    # held between samples, a ramp of steps is half a sample late
    fine = 1e-4
    volts = 5.0 + 20.0 * fine * (np.arange(2000) + 0.5)
    seen = _openings(volts, fine)(rig)
    return np.asarray(seen[:, 9::10][:, 20:])


def _run_out(at: Callable[[float, float], float], step_s: float) -> dict[str, Any]:
    """The way of a spool towards a voltage far away, while a limit holds it back."""
    volts = np.full(20, 9.0)

    def measure(rig: Rig) -> Floats:
        return _openings(volts, step_s)(rig)[0]

    def expected(strength: float) -> Floats:
        return np.array([at(step_s * (k + 1), strength) / 5.0 for k in range(20)])

    return {"place": "valve", "measure": measure, "expected": expected}


def _iso(ratio: float, b: float) -> float:
    return 1.0 if ratio <= b else math.sqrt(1.0 - ((ratio - b) / (1.0 - b)) ** 2)


def _play(width: float) -> Floats:
    """Up from null to 9 V and back to 6 V: behind by half the width, then ahead by it."""
    up = np.linspace(5.0, 9.0, 41)[1:]
    down = np.linspace(9.0, 6.0, 31)[1:]
    top = 9.0 - 0.5 * width
    x = np.concatenate([np.maximum(up - 0.5 * width, 5.0), np.minimum(down + 0.5 * width, top)])
    return np.asarray((x - 5.0) / 5.0)


def _play_seen(rig: Rig) -> Floats:
    volts = np.concatenate([np.linspace(5.0, 9.0, 41)[1:], np.linspace(9.0, 6.0, 31)[1:]])
    return _openings(np.repeat(volts, 4))(rig)[0][3::4]


def _between() -> Rig:
    """A vessel that one port of a valve fills and the other empties."""
    rig = _valve()
    ports = rig.valves["valve"].ports
    ports["fill"].to_node = ports["drain"].from_node = "tank"
    return rig


def _in_and_out(rig: Rig) -> Floats:
    filled, emptied = Simulator(rig), Simulator(rig)
    filled.reset({"tank": P0})
    emptied.reset({"tank": 4e5})
    into = filled.run(2e-3, {"u": 7.5}, STEP_S).flows["valve.fill"][-1]
    out = emptied.run(2e-3, {"u": 2.5}, STEP_S).flows["valve.drain"][-1]
    return np.array([into, out])


VALVES = {
    "valve_delay": Comparison(
        "a step, later by the delay",
        _valve(),
        "valve",
        (3e-3, 8e-3, 0.05),
        _openings(np.r_[_held(5.0, samples=20), _held(8.0, samples=80)]),
        _late,
    ),
    "closing_delay": Comparison(
        "a step back to null, later by as much",
        _valve(),
        "valve",
        (3e-3, 8e-3, 0.05),
        _openings(np.r_[_held(8.0, samples=20), _held(5.0, samples=80)]),
        lambda s: _late(s, closing=True),
    ),
    "spool_bandwidth": Comparison(
        "its equation of motion behind a ramp, by SciPy",
        _valve(bandwidth_hz=60.0, damping=0.8),
        "valve",
        (5e-4, 5e-3, 0.05),
        _ramp,
        _ramped,
    ),
    "spool_speed_limit": Comparison(
        "x = v t",
        strengths=(3e-3, 1e-2, 0.1),
        rig=_valve(max_speed_v_s=500.0),
        **_run_out(lambda t, s: t / (1.0 / 500.0 + s), 2.5e-4),
    ),
    "spool_acceleration_limit": Comparison(
        "x = a t^2 / 2",
        strengths=(1e-5, 7e-5, 1e-3),
        rig=_valve(max_acceleration_v_s2=4e4, bandwidth_hz=2000.0),
        **_run_out(lambda t, s: 0.5 * t**2 / (1.0 / 4e4 + s), 2.5e-4),
        allowed=0.05,
    ),
    "dead_band": Comparison(
        "overlap on both sides of null", strengths=(0.1, 0.5, 2.5), **_static(_dead)
    ),
    "null_offset": Comparison(
        "another null", strengths=(0.1, -0.5, 2.0), **_static(lambda u, s: u - 5.0 - s)
    ),
    "hysteresis": Comparison(
        "play operator", _valve(), "valve", (0.1, 0.4, 2.0), _play_seen, _play
    ),
    "flow_gain": Comparison(
        "ISO 6358, choked",
        strengths=(0.1, -0.5, 2.0),
        **_static(lambda u, s: u - 5.0, lambda s: 1.0 + s),
    ),
    "critical_ratio": Comparison(
        "ISO 6358, subsonic, the ratio of pressures 0.8",
        _valve(0.8 * HIGH),
        "valve.fill",
        (0.1, -0.3, 0.45),
        lambda rig: _openings(_held(7.5))(rig)[0, -1:],
        lambda s: [0.5 * _iso(0.8, B + s)],
    ),
    "fill_exhaust_asymmetry": Comparison(
        "ISO 6358, a vessel filled and emptied",
        _between(),
        "valve",
        (0.1, -0.5, 1.5),
        _in_and_out,
        lambda s: [
            0.5 * (1.0 + 0.5 * s) * C * RHO0 * HIGH,
            0.5 * (1.0 - 0.5 * s) * C * RHO0 * 4e5,
        ],
    ),
    "spool_leakage": Comparison(
        "ISO 6358, choked, at null",
        _valve(),
        "valve.fill",
        (1e-3, 1e-2, 0.1),
        lambda rig: _openings(_held(5.0))(rig)[0, -1:],
        lambda s: [s],
    ),
}


# -- sensors: on a vessel that runs empty ----------------------------------------------------------


def _emptying() -> Rig:
    return _rig(
        chambers={"tank": {"volume_m3": 1e-5}, "other": {"volume_m3": 1e-5}},
        orifices={
            "o": {"from": "tank", "to": "room", "conductance_m3_s_pa": 2e-9},
            "p": {"from": "tank", "to": "other", "conductance_m3_s_pa": 1e-9},
        },
        taps={"tank": {"chamber": "tank"}, "other": {"chamber": "other"}},
    )


def _full(rig: Rig) -> Simulator:
    simulator = Simulator(rig)
    simulator.reset({"tank": HIGH})
    return simulator


def _true(sample_s: float, seconds: float) -> Floats:
    """Pressure in the vessel, without the sensor."""
    return _full(_emptying()).run(seconds, sample_s=sample_s).pressures["tank"]


def _tap(rig: Rig) -> Floats:
    return _full(rig).run(0.2, sample_s=STEP_S).taps["tank"][60:]


def _both(rig: Rig) -> Floats:
    seen = _full(rig).run(0.2, sample_s=STEP_S).taps
    return np.stack([seen["tank"][60:], seen["other"][60:]])


def _before(seconds: float, name: str = "tank") -> Floats:
    """The pressure some time before each sample from 60 ms on."""
    fine = _full(_emptying()).run(0.2, sample_s=2.5e-4).pressures[name]
    time = 2.5e-4 * np.arange(fine.size)
    return np.asarray(np.interp(STEP_S * np.arange(60, 201) - seconds, time, fine))


def _lagged(lag_s: float) -> Floats:
    """lag r' + r = p for a pressure that is straight between fine samples, exactly."""
    fine_s = 2e-5
    p = _true(fine_s, 0.2)
    if lag_s == 0.0:
        return p[:: round(STEP_S / fine_s)][60:]
    keep = math.exp(-fine_s / lag_s)
    slope = np.diff(p) / fine_s
    r = np.empty_like(p)
    r[0] = p[0]
    for k in range(slope.size):
        # behind a ramp it is late by its lag, and what it was off by fades
        off = r[k] - (p[k] - lag_s * slope[k])
        r[k + 1] = p[k + 1] - lag_s * slope[k] + keep * off
    return r[:: round(STEP_S / fine_s)][60:]


SENSORS = {
    "sensor_bias": Comparison(
        "added",
        _emptying(),
        "tank",
        (100.0, -5e3, 1e5),
        _tap,
        lambda s: _true(STEP_S, 0.2)[60:] + s,
    ),
    "sensor_gain": Comparison(
        "of the gauge pressure",
        _emptying(),
        "tank",
        (0.01, -0.2, 0.4),
        _tap,
        lambda s: P0 + (1.0 + s) * (_true(STEP_S, 0.2)[60:] - P0),
    ),
    "sensor_lag": Comparison(
        "first-order lag, integrated", _emptying(), "tank", (1e-3, 8e-3, 0.1), _tap, _lagged
    ),
    "clock_offset": Comparison(
        "the pressure some time before", _emptying(), "tank", (2e-3, 0.0125, 0.05), _tap, _before
    ),
    "common_clock_offset": Comparison(
        "all pressures some time before",
        _emptying(),
        "taps",
        (2e-3, 0.0125, 0.05),
        _both,
        lambda s: np.stack([_before(s), _before(s, "other")]),
    ),
}


# -- supplies and the room: a choked orifice -------------------------------------------------------


def _jet() -> Rig:
    return _rig(
        chambers={"tank": {"volume_m3": 1e-3}},
        orifices={
            "jet": {"from": "source", "to": "room", "conductance_m3_s_pa": C, "critical_ratio": B},
            "o": {"from": "tank", "to": "room", "conductance_m3_s_pa": 1e-8},
        },
        taps={"tank": {"chamber": "tank"}},
    )


def _blown(rig: Rig) -> Floats:
    return Simulator(rig).run(0.05, sample_s=STEP_S).flows["jet"][-1:]


def _choked(pressure_pa: float, temperature_k: float = T0) -> Floats:
    return np.array([C * RHO0 * pressure_pa * math.sqrt(T_REF / temperature_k)])


def _rippled(rig: Rig) -> Floats:
    return Simulator(rig).run(0.2, sample_s=1e-2).flows["jet"][1:]


def _ripple(amplitude: float) -> Floats:
    # a flow is that of the middle of the last step
    step_s = 1e-2 / math.ceil(1e-2 / (0.9 * 0.05 / 600.0))
    time = 1e-2 * np.arange(1, 21) - 0.5 * step_s
    return np.asarray(C * RHO0 * (HIGH + amplitude * np.sin(2.0 * math.pi * 7.0 * time + 0.6)))


SUPPLIES = {
    "supply_level": Comparison(
        "ISO 6358, choked",
        _jet(),
        "source",
        (1e4, -1e5, 5e5),
        _blown,
        lambda s: _choked(HIGH + s),
    ),
    "supply_temperature": Comparison(
        "ISO 6358, choked",
        _jet(),
        "source",
        (10.0, -40.0, 100.0),
        _blown,
        lambda s: _choked(HIGH, T0 + s),
    ),
    "ambient_temperature": Comparison(
        "ISO 6358, choked",
        _jet(),
        "room",
        (5.0, -20.0, 40.0),
        _blown,
        lambda s: _choked(HIGH, T0 + s),
    ),
    "regulator_droop": Comparison(
        "ISO 6358, choked, and the droop",
        _jet(),
        "source",
        (1e7, 1e8, 2e8),
        _blown,
        lambda s: _choked(HIGH) / (1.0 + s * C * RHO0),
    ),
    "supply_ripple": Comparison(
        "ISO 6358, choked, at every instant",
        _jet(),
        "source",
        (1e3, 5e4, 1e5),
        _rippled,
        _ripple,
        {"frequency_hz": 7.0, "phase_rad": 0.6},
    ),
    "ambient_pressure": Comparison(
        "a vessel open to the room",
        _jet(),
        "room",
        (-3e3, 1e3, 1e4),
        lambda rig: Simulator(rig).run(3.0, sample_s=0.1).taps["tank"][-1:],
        lambda s: [P0 + s],
    ),
}


# -- vessels ---------------------------------------------------------------------------------------

VOLUME = 1e-3


def _vessel(**chamber: float) -> Rig:
    return _rig(
        chambers={"tank": {"volume_m3": VOLUME, **chamber}},
        orifices={"o": {"from": "source", "to": "tank", "conductance_m3_s_pa": 1e-12}},
        taps={"tank": {"chamber": "tank"}},
    )


def _loss(pressure_pa: float, seconds: float = 4e-3) -> Callable[[Rig], Floats]:
    """Mass per second that a full vessel loses at first."""

    def measure(rig: Rig) -> Floats:
        simulator = Simulator(rig)
        simulator.reset({"tank": pressure_pa})
        before = simulator.mass_kg()
        simulator.run(seconds, sample_s=STEP_S)
        return np.array([(before - simulator.mass_kg()) / seconds])

    return measure


def orifice(area_m2: float, pressure_pa: float, back_pa: float = P0, t_k: float = T0) -> float:
    """Isentropic flow through an orifice (Saint-Venant and Wantzel), kg/s.

    Args:
        area_m2: Effective area.
        pressure_pa: Pressure before it.
        back_pa: Pressure behind it.
        t_k: Temperature before it.
    """
    ratio = max(back_pa / pressure_pa, (2.0 / (GAMMA + 1.0)) ** (GAMMA / (GAMMA - 1.0)))
    wave = ratio ** (2.0 / GAMMA) - ratio ** ((GAMMA + 1.0) / GAMMA)
    root = math.sqrt(2.0 * GAMMA / (GAMMA - 1.0) * max(wave, 0.0))
    return area_m2 * pressure_pa / math.sqrt(R * t_k) * root


def viscosity(t_k: float) -> float:
    """Sutherland's law for air, U.S. Standard Atmosphere 1976, Pa s."""
    return 1.458e-6 * t_k**1.5 / (t_k + 110.4)


def porous(size_m3: float, pressure_pa: float) -> float:
    """Isothermal laminar flow through a plug to the room, kg/s."""
    return size_m3 * (pressure_pa**2 - P0**2) / (2.0 * viscosity(T0) * R * T0)


def _rise(rig: Rig) -> Floats:
    """Rate of the pressure in an empty vessel that a choked jet fills, Pa/s."""
    run = Simulator(rig).run(0.02, sample_s=STEP_S)
    return np.array([(run.chambers["tank"][-1] - run.chambers["tank"][0]) / 0.02])


def _filled(**chamber: float) -> Rig:
    return _rig(
        chambers={"tank": {"volume_m3": VOLUME, **chamber}},
        orifices={"o": {"from": "source", "to": "tank", "conductance_m3_s_pa": C}},
        taps={"tank": {"chamber": "tank"}},
    )


def _filling(volume: float, yields: float) -> Floats:
    """The same: V dp + gamma p dV = gamma R T_0 dm, integrated."""
    flow = C * RHO0 * HIGH

    def rate(_: float, p: Floats) -> Floats:
        now = volume + yields * (p - P0)
        return np.asarray(GAMMA * R * T0 * flow / (now + GAMMA * p * yields))

    end = solve_ivp(rate, (0.0, 0.02), [P0], rtol=1e-10, atol=1e-6).y[0, -1]
    return np.array([(end - P0) / 0.02])


def _cooled(rig: Rig) -> Floats:
    simulator = Simulator(rig)
    simulator.set_chamber("tank", HIGH, 350.0)
    return simulator.run(2.0, sample_s=0.1).temperatures["tank"]


def _cooling(conductance: float) -> Floats:
    mass = HIGH * VOLUME / (R * 350.0)
    time = 0.1 * np.arange(21)
    rate = conductance / (mass * R / (GAMMA - 1.0))
    return np.asarray(T0 + (350.0 - T0) * np.exp(-rate * time))


def _still(area_m2: float, p: float, t: float, height: float) -> float:
    """Heat to a wall along which gas rises, W: Nu = 0.104 Ra^0.352."""
    film = 0.5 * (t + T0)
    mu = viscosity(film)
    # conductivity of air: U.S. Standard Atmosphere 1976
    k = 2.64638e-3 * film**1.5 / (film + 245.4 * 10.0 ** (-12.0 / film))
    prandtl = mu * 1004.7 / k
    nu = mu * R * film / p
    rayleigh = 9.81 * abs(t - T0) / film * prandtl / nu**2 * height**3
    return area_m2 * 0.104 * rayleigh**0.352 * k / height * (T0 - t)


def _convecting(area_m2: float) -> Floats:
    mass, height = HIGH * VOLUME / (R * 350.0), VOLUME ** (1.0 / 3.0)

    def rate(_: float, t: Floats) -> Floats:
        pressure = mass * R * float(t[0]) / VOLUME
        heat = _still(area_m2, pressure, float(t[0]), height)
        return np.array([heat / (mass * R / (GAMMA - 1.0))])

    time = 0.1 * np.arange(21)
    return np.asarray(solve_ivp(rate, (0.0, 2.0), [350.0], t_eval=time, rtol=1e-9).y[0])


VESSELS = {
    "chamber_leak": Comparison(
        "isentropic orifice",
        _vessel(),
        "tank",
        (1e-8, 1e-7, 5e-6),
        _loss(5e5),
        lambda s: [orifice(s, 5e5)],
    ),
    "chamber_porous_leak": Comparison(
        "Darcy's law, isothermal",
        _vessel(),
        "tank",
        (2e-16, 2e-15, 5e-14),
        _loss(5e5),
        lambda s: [porous(s, 5e5)],
    ),
    "chamber_relief_valve": Comparison(
        "isentropic orifice, open in part",
        _vessel(),
        "tank",
        (1e-8, 1e-7, 1e-6),
        _loss(5e5),
        lambda s: [orifice(0.25 * s, 5e5)],
        {"set_pa": 4.9e5, "range_pa": 4e4},
    ),
    "chamber_volume": Comparison(
        "first law while it fills",
        _filled(),
        "tank",
        (0.02, -0.4, 0.9),
        _rise,
        lambda s: _filling(VOLUME * (1.0 + s), 0.0),
    ),
    "chamber_compliance": Comparison(
        "first law while it fills and yields",
        _filled(),
        "tank",
        (2e-7, 2e-6, 1e-4),
        _rise,
        lambda s: _filling(VOLUME, s * VOLUME),
    ),
    "chamber_heat": Comparison(
        "exponential decay", _vessel(), "tank", (0.05, 1.0, 100.0), _cooled, _cooling
    ),
    "chamber_convection": Comparison(
        "its correlation, integrated by SciPy",
        _vessel(),
        "tank",
        (5e-3, 5e-2, 5.0),
        _cooled,
        _convecting,
        {"inlet_m": 1.0},
        allowed=0.05,
    ),
}


# -- lines -----------------------------------------------------------------------------------------

AREA, WIDE, LENGTH = 6e-6, 1e-4, 2.0


def _tube(**pipe: Any) -> Rig:
    tube = {"from": "tank", "to": "closed", "length_m": LENGTH, "area_m2": AREA, **pipe}
    tube.setdefault("wall", {**STILL, "laminar": 30.0})
    return _rig(
        chambers={"tank": {"volume_m3": 1e-5}},
        pipes={"tube": tube},
        taps={"tank": {"chamber": "tank"}},
    )


def _shared(rig: Rig) -> Floats:
    """Mean pressure after a full vessel has shared its gas with a line."""
    simulator = Simulator(rig)
    simulator.reset({"tank": HIGH, "tube": P0})
    run = simulator.run(1.0, sample_s=2e-3)
    return np.array([run.taps["tank"][-250:].mean()])


def _mixed(volume: float) -> Floats:
    """Energy is kept: p (V_1 + V_2) = p_1 V_1 + p_2 V_2."""
    return np.array([(HIGH * 1e-5 + P0 * volume) / (1e-5 + volume)])


def _line_loss(rig: Rig) -> Floats:
    """Mass per second that a closed line loses at first, at 5 bar."""
    simulator = Simulator(rig)
    simulator.reset({"tank": 5e5, "tube": 5e5})
    before = simulator.mass_kg()
    simulator.run(2e-3, sample_s=1e-3)
    return np.array([(before - simulator.mass_kg()) / 2e-3])


def _through(area: float = AREA, **wall: float) -> Rig:
    """A line between two reservoirs a little apart."""
    return _rig(
        grid={"memory": False, "dx_m": 0.1, "wave_speed_m_s": 400.0},
        reservoirs={
            "high": {"pressure_pa": P0 + wall.pop("above", 300.0), "room": False},
            "low": {"pressure_pa": P0, "room": True},
        },
        pipes={
            "tube": {
                "from": "high",
                "to": "low",
                "length_m": LENGTH,
                "area_m2": area,
                "wall": {**STILL, **wall},
            }
        },
        taps={"middle": {"pipe": "tube", "position_m": 1.0}},
    )


def _parted() -> Rig:
    rig = _through()
    ends = {"one": ("high", "tee"), "two": ("tee", "low"), "three": ("tee", "low")}
    parts = rig.model_dump(by_alias=True, exclude_defaults=True)
    tube = parts["pipes"].pop("tube")
    parts["pipes"] = {
        n: {**tube, "from": a, "to": b, "length_m": 1.0} for n, (a, b) in ends.items()
    }
    parts["taps"] = {"middle": {"pipe": "one", "position_m": 0.5}}
    return Rig.model_validate(parts)


def _speed(rig: Rig, pipe: str = "tube") -> Floats:
    simulator = Simulator(rig)
    simulator.run(1.5, sample_s=0.1)
    return np.array([np.median(simulator.state(pipe)["velocity"])])


def _haaland(reynolds: float, rough: float = 0.0) -> float:
    return (-1.8 * math.log10(6.9 / reynolds + (rough / 3.7) ** 1.11)) ** -2.0


def _driven(
    above: float, factor: Callable[[float], float], heads: float = 0.0, area: float = AREA
) -> Floats:
    """Steady velocity: what drives it goes into friction, heads, and the one lost at the outlet."""
    rho, mu, d = (P0 + 0.5 * above) / (R * T0), viscosity(T0), math.sqrt(4.0 * area / math.pi)

    def off(u: float) -> float:
        return (factor(rho * u * d / mu) * LENGTH / d + heads + 1.0) * 0.5 * rho * u**2 - above

    return np.array([brentq(off, 1e-3, 300.0)])


def _turbulent(gain: float, re: float) -> float:
    return 64.0 / re * (1.0 + gain * (_haaland(re) * re / 64.0 - 1.0))


def _rung(rig: Rig) -> Floats:
    """Frequency of a small standing wave in a closed line, Hz."""
    simulator = Simulator(rig)
    state = simulator.state("tube")
    wave = 20.0 * np.cos(math.pi * state["x_m"] / LENGTH)
    simulator.set_state(
        "tube", 4e5 / (R * T0) * (1.0 + wave / (GAMMA * 4e5)), 0.0 * wave, 4e5 + wave
    )
    run = simulator.run(0.2, sample_s=1e-4)
    signal = run.taps["end"] - run.taps["end"].mean()
    i = np.flatnonzero(np.diff(np.sign(signal)) != 0)
    at = i - signal[i] / (signal[i + 1] - signal[i])
    return np.array([(at.size - 1) / 2.0 / (at[-1] - at[0]) * 1e4])


def _organ() -> Rig:
    return _rig(
        pipes={
            "tube": {
                "from": "closed",
                "to": "closed",
                "length_m": LENGTH,
                "area_m2": AREA,
                "wall": STILL,
            }
        },
        taps={"end": {"pipe": "tube", "position_m": 0.0}},
    )


def _ringing(kappa: float) -> Floats:
    stretched = 1.0 + kappa * (4e5 - P0)
    speed = math.sqrt(GAMMA * R * T0 / (1.0 + GAMMA * 4e5 * kappa / stretched))
    return np.array([speed / (2.0 * LENGTH)])


def _warm(rig: Rig) -> Floats:
    simulator = Simulator(rig)
    simulator.set_state("tube", 4e5 / (R * 320.0), 0.0, 4e5)
    simulator.run(0.2, sample_s=0.02)
    return np.array([simulator.state("tube")["temperature"].mean()])


def _warming(gain: float) -> Floats:
    """Gas at rest between walls, Nu of 8 per gain, whose conductivity is that of the room."""
    k = 2.64638e-3 * T0**1.5 / (T0 + 245.4 * 10.0 ** (-12.0 / T0))
    rate = 8.0 * gain * math.pi * k / (4e5 / (R * 320.0) * AREA * R / (GAMMA - 1.0))
    return np.array([T0 + (320.0 - T0) * math.exp(-0.2 * rate)])


def _remembering() -> Rig:
    rig = _organ()
    rig.grid.memory = True
    rig.pipes["tube"].wall.laminar = 1.0
    rig.pipes["tube"].wall.unsteady = rig.pipes["tube"].wall.heat_unsteady = 0.0
    return rig


def _dying(rig: Rig) -> Floats:
    """How fast a small standing wave in a closed line dies away, 1/s."""
    simulator = Simulator(rig)
    wave = 20.0 * np.cos(math.pi * simulator.state("tube")["x_m"] / LENGTH)
    density = 4e5 / (R * T0) * (1.0 + wave / (GAMMA * 4e5))
    simulator.set_state("tube", density, 0.0 * wave, 4e5 + wave)
    p = simulator.run(0.35, sample_s=1e-4).taps["end"] - 4e5
    tops = [k for k in range(1, p.size - 1) if p[k] > 0.0 and p[k - 1] < p[k] >= p[k + 1]]
    tops = [k for k in tops if 1e-4 * k > 0.05]  # what was not there at the start is felt by then
    slope = np.polyfit(1e-4 * np.array(tops), np.log(p[tops]), 1)[0]
    return np.array([-slope])


def _dies(gain: float) -> Floats:
    """The same by the impedance of a tube (Zielke 1968): its unsteady part in that share."""
    radius, nu = math.sqrt(AREA / math.pi), viscosity(T0) * R * T0 / 4e5
    c, k = math.sqrt(GAMMA * R * T0), math.pi / LENGTH

    def drag(omega: complex) -> complex:
        z = np.sqrt(-1j * omega / nu) * radius
        whole = 1j * omega / (1.0 - 2.0 * jv(1, z) / (z * jv(0, z)))
        steady = 8.0 * nu / radius**2
        return complex(steady + gain * (whole - 1j * omega - steady))

    omega = complex(c * k)
    for _ in range(100):  # (1j omega + drag) 1j omega + c^2 k^2 = 0
        b = drag(omega)
        omega = 0.5 * (1j * b + np.sqrt(4.0 * (c * k) ** 2 - b**2))
    return np.array([omega.imag])


LINES = {
    "leak": Comparison(
        "isentropic orifice",
        _tube(),
        "tube",
        (1e-9, 1e-8, 1e-7),
        _line_loss,
        lambda s: [orifice(s, 5e5)],
        {"position_m": 1.0},
    ),
    "porous_leak": Comparison(
        "Darcy's law, isothermal",
        _tube(),
        "tube",
        (2e-17, 2e-16, 8e-16),
        _line_loss,
        lambda s: [porous(s, 5e5)],
        {"position_m": 1.0},
    ),
    "relief_valve": Comparison(
        "isentropic orifice, open in part",
        _tube(),
        "tube",
        (1e-9, 1e-8, 8e-8),
        _line_loss,
        lambda s: [orifice(0.25 * s, 5e5)],
        {"position_m": 1.0, "set_pa": 4e5, "range_pa": 4e5},
    ),
    "dead_volume": Comparison(
        "energy of gas that is shared",
        _tube(),
        "tube",
        (1e-6, 1e-5, 2e-4),
        _shared,
        lambda s: _mixed(AREA * LENGTH + s),
        {"position_m": 1.0},
    ),
    "length_error": Comparison(
        "energy of gas that is shared",
        _tube(),
        "tube",
        (0.05, -0.3, 0.5),
        _shared,
        lambda s: _mixed(AREA * LENGTH * (1.0 + s)),
    ),
    "area_error": Comparison(
        "energy of gas that is shared",
        _tube(),
        "tube",
        (0.05, -0.6, 1.0),
        _shared,
        lambda s: _mixed(AREA * LENGTH * (1.0 + s)),
    ),
    "wall_compliance": Comparison(
        "Korteweg's wave speed", _organ(), "tube", (1e-7, 5e-7, 2e-6), _rung, _ringing
    ),
    "laminar_friction": Comparison(
        "Hagen and Poiseuille",
        _through(laminar=1.0, above=60.0),
        "tube",
        (0.1, -0.5, 10.0),
        _speed,
        lambda s: _driven(60.0, lambda re: 64.0 / re * (1.0 + s)),
    ),
    "turbulent_friction": Comparison(
        "Haaland",
        _through(WIDE, laminar=1.0, turbulent=1.0, above=2e3),
        "tube",
        (0.1, -0.5, 5.0),
        _speed,
        lambda s: _driven(2e3, lambda re: _turbulent(1.0 + s, re), area=WIDE),
        allowed=0.05,
    ),
    "roughness": Comparison(
        "Haaland",
        _through(WIDE, laminar=1.0, turbulent=1.0, above=2e3),
        "tube",
        (2e-5, 1e-4, 5e-4),
        _speed,
        lambda s: _driven(
            2e3, lambda re: _haaland(re, s / math.sqrt(4.0 * WIDE / math.pi)), area=WIDE
        ),
        allowed=0.05,
    ),
    "unsteady_friction": Comparison(
        "Zielke's weighting function, in the frequency domain",
        _remembering(),
        "tube",
        (0.1, 1.0, 4.0),
        _dying,
        _dies,
        allowed=0.05,
    ),
    "local_loss": Comparison(
        "Bernoulli",
        _through(),
        "tube",
        (0.5, 5.0, 200.0),
        _speed,
        lambda s: _driven(300.0, lambda re: 0.0, s),
        {"position_m": 1.0},
    ),
    "junction_loss": Comparison(
        "Bernoulli, one way in and two alike out",
        _parted(),
        "tee",
        (0.5, 5.0, 50.0),
        lambda rig: _speed(rig, "one"),
        lambda s: [math.sqrt(2.0 * 300.0 / (P0 + 150.0) * R * T0 / (1.0 + 1.25 * s))],
    ),
    "blockage": Comparison(
        "Borda and Carnot, and a sharp edge (Idelchik)",
        _through(),
        "tube",
        (0.3, 0.6, 0.95),
        _speed,
        lambda s: _driven(
            300.0,
            lambda re: 0.0,
            (1.0 / (1.0 - s) - 1.0) ** 2 + 0.5 * s**0.75 / (1.0 - s) ** 2,
        ),
        {"position_m": 1.05, "length_m": 0.1},
        allowed=0.05,
    ),
    "wall_heat": Comparison(
        "exponential decay", _organ(), "tube", (0.1, 1.0, 10.0), _warm, _warming, allowed=0.05
    ),
}


# -- cylinders and joints: a cart on a spring, between sides that are open -------------------------

MASS, RATE = 0.5, 150.0
BORE, ROD, STROKE = 0.025, 0.004, 0.2


def _cart(**more: Any) -> Rig:
    pressures = more.pop("pressures", (P0, P0))
    cylinder = {
        "bore_m": BORE,
        "rod_m": ROD,
        "stroke_m": STROKE,
        "head": {"node": "head", "dead_volume_m3": 1e-4},
        "rod": {"node": "rod", "dead_volume_m3": 1e-4},
        "friction": more.pop("friction", {}),
    }
    wide = {"length_m": 0.05, "area_m2": 4e-4, "wall": STILL}
    slide = {"name": "cart", "start": 0.1, **more.pop("slide", {})}
    body = {"kind": "rail", "cylinder": "cart", "mass_kg": MASS, "slide": slide}
    body["incline_rad"] = more.pop("incline_rad", 0.0)
    return _rig(
        grid={"memory": False, "dx_m": 0.025},
        reservoirs={
            "first": {"pressure_pa": pressures[0], "room": False},
            "second": {"pressure_pa": pressures[1], "room": False},
            "room": {"pressure_pa": P0, "room": True},
        },
        pipes={
            "a": {"from": "first", "to": "head", **wide},
            "b": {"from": "second", "to": "rod", **wide},
        },
        cylinders={"cart": cylinder},
        bodies={"cart": body},
        encoders={"cart": {}},
        taps={"head": {"chamber": "head"}},
        **more,
    )


def _sprung(**more: Any) -> Rig:
    """The cart at 0.1 m on a spring that would have it at 0.12 m."""
    rig = _cart(**more)
    rig.effects = [
        AttachedEffect(
            effect="external_spring", place="cart", parameters={"rate": RATE, "at": 0.12}
        )
    ]
    return rig


def _swung(rig: Rig) -> Floats:
    return Simulator(rig).run(0.6, sample_s=2e-3).joints["cart"]


def _swing(
    mass: float = MASS,
    rate: float = RATE,
    damping: float = 0.0,
    dry: float = 0.0,
    stribeck: float = 0.0,
    push: float = 0.0,
) -> Floats:
    """Positions of a mass on a spring with viscous, dry and Stribeck friction, by SciPy."""

    def motion(_: float, y: Floats) -> list[float]:
        grip = dry + stribeck * math.exp(-((y[1] / 0.01) ** 2))
        force = rate * (0.12 - y[0]) + push - damping * y[1] - grip * math.tanh(y[1] / 1e-5)
        return [y[1], force / mass]

    time = 2e-3 * np.arange(301)
    found = solve_ivp(
        motion, (0.0, 0.6), [0.1, 0.0], t_eval=time, method="LSODA", rtol=1e-9, atol=1e-12
    )
    return np.asarray(found.y[0])


def _seal(force_per_pa: float) -> Floats:
    gauge = 2e5
    return _swing(dry=force_per_pa * gauge, push=gauge * math.pi / 4.0 * ROD**2)


def _lagging_encoder(lag_s: float) -> Floats:
    time = np.linspace(0.0, 0.6, 30001)
    omega = math.sqrt(RATE / MASS)
    # r' = (q - r) / lag, q = 0.12 - 0.02 cos(omega t), r(0) = q(0)
    a = 1.0 / (1.0 + (omega * lag_s) ** 2)
    part = 0.12 - 0.02 * a * (np.cos(omega * time) + omega * lag_s * np.sin(omega * time))
    fade = np.exp(-time / lag_s) if lag_s > 0.0 else 0.0 * time
    return np.asarray((part + (0.1 - (0.12 - 0.02 * a)) * fade)[::100])


def _shut(**more: Any) -> Rig:
    """A cylinder whose sides are shut, behind a mass that does not move."""
    rig = _cart(**more)
    rig.bodies["cart"].mass_kg = 1e6
    return rig.model_copy(
        update={
            "pipes": {},
            "reservoirs": {k: v for k, v in rig.reservoirs.items() if k == "room"},
        }
    )


HEAD_M3 = 1e-4 + 0.1 * math.pi / 4.0 * BORE**2
ROD_M3 = 1e-4 + 0.1 * math.pi / 4.0 * (BORE**2 - ROD**2)


def _sides(seconds: float) -> Callable[[Rig], Floats]:
    """Change of the pressures on both sides that begin at 5 and 1.5 bar, Pa/s."""

    def measure(rig: Rig) -> Floats:
        simulator = Simulator(rig)
        simulator.set_chamber("head", 5e5, T0)
        simulator.set_chamber("rod", 1.5e5, T0)
        run = simulator.run(seconds, sample_s=STEP_S)
        rise = [run.chambers[side][-1] - run.chambers[side][0] for side in ("head", "rod")]
        return np.array(rise) / seconds

    return measure


def _hot_side(rig: Rig) -> Floats:
    simulator = Simulator(rig)
    simulator.set_chamber("head", 5e5, 350.0)
    simulator.set_chamber("rod", 5e5, T0)
    return simulator.run(1.0, sample_s=0.05).temperatures["head"]


def _cooling_side(film: float) -> Floats:
    # bore and both covers; the dead volume is as much more bore
    wall = math.pi * BORE * HEAD_M3 / (math.pi / 4.0 * BORE**2) + 2.0 * math.pi / 4.0 * BORE**2
    mass = 5e5 * HEAD_M3 / (R * 350.0)
    rate = film * wall / (mass * R / (GAMMA - 1.0))
    return np.asarray(T0 + (350.0 - T0) * np.exp(-rate * 0.05 * np.arange(21)))


def _fed() -> Rig:
    rig = _shut()
    rig.reservoirs["source"] = _jet().reservoirs["source"]
    parts = rig.model_dump(by_alias=True, exclude_defaults=True)
    parts["orifices"] = {"o": {"from": "source", "to": "head", "conductance_m3_s_pa": C}}
    return Rig.model_validate(parts)


def _fed_side(rig: Rig) -> Floats:
    run = Simulator(rig).run(4e-3, sample_s=STEP_S)
    return np.array([(run.chambers["head"][-1] - run.chambers["head"][0]) / 4e-3])


CUSHION_M, BEFORE_END_M = 0.02, 1e-3
PORT = 1e-5


def _at_the_end() -> Rig:
    """A piston within the cushion of a side, which empties through a line and a nozzle."""
    rig = _shut(slide={"start": BEFORE_END_M})
    parts = rig.model_dump(by_alias=True, exclude_defaults=True)
    parts["pipes"] = {
        "a": {"from": "head", "to": "mouth", "length_m": 0.02, "area_m2": PORT, "wall": STILL}
    }
    parts["orifices"] = {"o": {"from": "mouth", "to": "room", "conductance_m3_s_pa": 4.0 * C}}
    return Rig.model_validate(parts)


def _emptied_side(rig: Rig) -> Floats:
    simulator = Simulator(rig)
    simulator.reset({"head": 5e5, "a": 5e5})
    return simulator.run(0.1, sample_s=5e-3).chambers["head"][1:]


def _throttled(heads: float) -> Floats:
    """A vessel, an isentropic jet, a line and a choked nozzle in series, all adiabatic.

    The jet fills the line without getting back any pressure.
    """
    least = 1.0 / math.sqrt(1.0 + heads)
    way = PORT * (least + (1.0 - least) * BEFORE_END_M / CUSHION_M)
    volume = 1e-4 + BEFORE_END_M * math.pi / 4.0 * BORE**2

    def flow(p: float, t: float) -> float:
        """Mass flow at which what the jet brings is what the nozzle takes."""

        def excess(low: float) -> float:
            brought = orifice(way, p, low, t)
            cp = GAMMA * R / (GAMMA - 1.0)
            g = brought * R / (PORT * low)  # u = g T, and T + u^2 / (2 cp) = t
            static = t
            if g > 0.0:
                static = (math.sqrt(1.0 + 2.0 * g * g * t / cp) - 1.0) * cp / (g * g)
            total = low * (t / static) ** (GAMMA / (GAMMA - 1.0))
            return brought - 4.0 * C * RHO0 * total * math.sqrt(T0 / t)

        star = 2.0 / (GAMMA + 1.0) * t
        sonic = orifice(way, p, 0.0, t) * math.sqrt(R * star / GAMMA) / PORT
        return orifice(way, p, brentq(excess, sonic, p, xtol=1e-6), t)

    def empties(_: float, y: Floats) -> list[float]:
        t = T0 * (y[0] / 5e5) ** ((GAMMA - 1.0) / GAMMA)
        return [-GAMMA * R * t * flow(y[0], t) / volume]

    time = 5e-3 * np.arange(1, 21)
    found = solve_ivp(empties, (0.0, 0.1), [5e5], t_eval=time, rtol=1e-8, atol=1e-3)
    return np.asarray(found.y[0])


ANGLES = (-0.6, -0.2, 0.3, 0.7)
ARM = {"pivot_m": 0.16, "crank_m": 0.035, "closed_length_m": 0.1}
INERTIA, LINK, CENTRE = 0.05, 0.75, 0.2


def _arm() -> Rig:
    """An upright link whose cylinder is open on both sides."""
    wide = {"length_m": 0.05, "area_m2": 4e-4, "wall": STILL}
    return _rig(
        grid={"memory": False, "dx_m": 0.025},
        pipes={
            "a": {"from": "room", "to": "head", **wide},
            "b": {"from": "room", "to": "rod", **wide},
        },
        cylinders={
            "forearm": {
                "bore_m": 0.01,
                "stroke_m": 0.12,
                "head": {"node": "head", "dead_volume_m3": 1e-5},
                "rod": {"node": "rod", "dead_volume_m3": 1e-5},
            }
        },
        bodies={
            "arm": {
                "kind": "kokoro",
                "theta_cylinder": "forearm",
                "slider": ARM,
                "theta_inertia_kg_m2": INERTIA,
                "mass_kg": LINK,
                "centre_m": CENTRE,
                "alpha": {"name": "shoulder", "held": True},
                "theta": {"name": "elbow", "start": 0.3},
            }
        },
        taps={"head": {"chamber": "head"}},
    )


def _reach(angle: float, crank: float) -> float:
    """From pivot to pin: the sides enclose a right angle where the link stands upright."""
    a = ARM["pivot_m"]
    return math.sqrt(a**2 + crank**2 + 2.0 * a * crank * math.sin(angle))


def _extensions(rig: Rig) -> Floats:
    found = []
    for angle in ANGLES:
        rig.bodies["arm"].theta.start = angle
        found.append(Simulator(rig).run(1e-3, sample_s=1e-3).extensions["forearm"][0])
    return np.array(found)


def _fallen(offset: float) -> Floats:
    centre = CENTRE + offset
    inertia = INERTIA + LINK * (centre**2 - CENTRE**2)

    def motion(_: float, y: Floats) -> list[float]:
        return [y[1], LINK * 9.81 * centre * math.sin(y[0]) / inertia]

    time = 2e-3 * np.arange(126)
    return np.asarray(solve_ivp(motion, (0.0, 0.25), [0.3, 0.0], t_eval=time, rtol=1e-9).y[0])


JOINTS = {
    "external_spring": Comparison(
        "a mass on two springs",
        _sprung(),
        "cart",
        (5.0, 50.0, 200.0),
        _swung,
        lambda s: _swing(rate=RATE + s),
        {"at": 0.12},
    ),
    "payload": Comparison(
        "a heavier mass on its spring",
        _sprung(),
        "cart",
        (0.1, 2.0, 50.0),
        _swung,
        lambda s: _swing(mass=MASS + s),
    ),
    "joint_damping": Comparison(
        "a damped mass on its spring",
        _sprung(),
        "cart",
        (1.0, 10.0, 20.0),
        _swung,
        lambda s: _swing(damping=s),
    ),
    "piston_damping": Comparison(
        "a damped mass on its spring",
        _sprung(),
        "cart",
        (1.0, 20.0, 500.0),
        _swung,
        lambda s: _swing(damping=s),
    ),
    "joint_friction": Comparison(
        "a mass on its spring, rubbing",
        _sprung(),
        "cart",
        (0.2, 2.0, 8.0),
        _swung,
        lambda s: _swing(dry=s),
        allowed=0.05,
    ),
    "piston_friction": Comparison(
        "a mass on its spring, rubbing",
        _sprung(),
        "cart",
        (0.2, 2.0, 8.0),
        _swung,
        lambda s: _swing(dry=s),
        allowed=0.05,
    ),
    "piston_stiction": Comparison(
        "a mass on its spring, Stribeck's curve",
        _sprung(),
        "cart",
        (2.0, 2.5, 2.9),
        _swung,
        lambda s: _swing(stribeck=s),
        {"stribeck_m_s": 0.01},
        allowed=0.05,
    ),
    "seal_friction": Comparison(
        "a mass on its spring, rubbing under pressure",
        _sprung(pressures=(3e5, 3e5)),
        "cart",
        (1e-6, 1e-5, 2e-5),
        _swung,
        _seal,
    ),
    "piston_leak": Comparison(
        "isentropic orifice, first law",
        _shut(),
        "cart",
        (1e-9, 1e-8, 1e-7),
        _sides(4e-3),
        lambda s: [
            -GAMMA * R * T0 * orifice(s, 5e5, 1.5e5) / HEAD_M3,
            GAMMA * R * T0 * orifice(s, 5e5, 1.5e5) / ROD_M3,
        ],
    ),
    "rod_leak": Comparison(
        "isentropic orifice, first law",
        _shut(),
        "cart",
        (1e-9, 1e-8, 1e-7),
        _sides(4e-3),
        lambda s: [0.0, -GAMMA * R * T0 * orifice(s, 1.5e5) / ROD_M3],
    ),
    "cylinder_heat": Comparison(
        "exponential decay", _shut(), "cart", (2.0, 20.0, 1000.0), _hot_side, _cooling_side
    ),
    "end_cushion": Comparison(
        "an adiabatic vessel, a jet and a nozzle in series, by SciPy",
        _at_the_end(),
        "cart.head",
        (10.0, 100.0, 1e5),
        _emptied_side,
        _throttled,
        {"length_m": CUSHION_M},
    ),
    "cylinder_volume": Comparison(
        "first law while it fills",
        _fed(),
        "cart.head",
        (1e-6, 1e-4, 1e-3),
        _fed_side,
        lambda s: [GAMMA * R * T0 * C * RHO0 * HIGH / (HEAD_M3 + s)],
    ),
    "crank_error": Comparison(
        "law of cosines",
        _arm(),
        "elbow",
        (0.02, -0.3, 0.4),
        _extensions,
        lambda s: [_reach(q, 0.035 * (1.0 + s)) - 0.1 for q in ANGLES],
    ),
    "centre_of_mass": Comparison(
        "a pendulum that falls, integrated by SciPy",
        _arm(),
        "elbow",
        (0.01, -0.15, 0.3),
        lambda rig: Simulator(rig).run(0.25, sample_s=2e-3).joints["elbow"],
        _fallen,
    ),
    "backlash": Comparison(
        "free fall through half of it, and no rebound",
        _cart(friction={"coulomb_n": 1e5}, incline_rad=math.pi / 2.0),
        "cart",
        (1e-3, 0.02, 0.1),
        lambda rig: Simulator(rig).run(0.2, sample_s=2e-3).joints["cart"],
        lambda s: 0.1 - np.minimum(0.5 * 9.81 * (2e-3 * np.arange(101)) ** 2, 0.5 * s),
    ),
    "encoder_lag": Comparison(
        "first-order lag behind a sine, in closed form",
        _sprung(),
        "cart",
        (2e-3, 2e-2, 0.1),
        lambda rig: Simulator(rig).run(0.6, sample_s=2e-3).encoders["cart"],
        lambda s: _lagging_encoder(s)[:301],
    ),
    "encoder_bias": Comparison(
        "added",
        _sprung(),
        "cart",
        (1e-3, -0.05, 3.0),
        lambda rig: Simulator(rig).run(0.6, sample_s=2e-3).encoders["cart"],
        lambda s: _swing() + s,
    ),
    "encoder_gain": Comparison(
        "a factor",
        _sprung(),
        "cart",
        (0.01, -0.4, 1.0),
        lambda rig: Simulator(rig).run(0.6, sample_s=2e-3).encoders["cart"],
        lambda s: (1.0 + s) * _swing(),
    ),
}


COMPARISONS: dict[str, Comparison] = {**VALVES, **SENSORS, **SUPPLIES, **VESSELS, **LINES, **JOINTS}
"""By the name of the effect."""
