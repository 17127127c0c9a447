# SPDX-License-Identifier: Apache-2.0
"""What holds a body: soft seals, play, stops that push or hold, springs; against closed forms.

There is no gas to speak of in these cylinders, so that a mass on a rail moves by weight and contact
alone.
"""

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pneu_sim.rig.schema import Rig
from pneu_sim.simulator import Readings, Simulator

G = 9.80665
STEEP = math.pi / 2  # upright: weight draws the piston back


def rail(
    slide: dict[str, Any],
    friction: dict[str, float] | None = None,
    mass_kg: float = 2.0,
    incline_rad: float = 0.0,
    dt_s: float = 2e-5,
    **more: Any,
) -> Rig:
    """A mass on a rail, a piston in a vacuum, 0.5 m from either end."""
    side = {"node": "closed", "dead_volume_m3": 1e-3}
    cylinder = {"bore_m": 0.02, "stroke_m": 1.0, "head": side, "rod": side, **more}
    document = {
        "pneu_rig": 1,
        "name": "r",
        "grid": {"dt_s": dt_s},
        "ambient": {"pressure_pa": 1e-6},
        "cylinders": {"c": {**cylinder, "friction": friction or {}}},
        "bodies": {
            "b": {
                "kind": "rail",
                "cylinder": "c",
                "mass_kg": mass_kg,
                "incline_rad": incline_rad,
                "slide": {"start": 0.5, **slide},
            }
        },
    }
    return Rig.model_validate(document)


def run(rig: Rig, seconds: float, sample_s: float = 1e-3, speed_m_s: float = 0.0) -> Readings:
    simulator = Simulator(rig)
    simulator.plant.place({}, {"b_slide": speed_m_s})
    return simulator.run(seconds, sample_s=sample_s)


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9])
def test_a_soft_seal_gives_way_before_it_slides(share: float) -> None:
    """dF/dx = (1 - F/F_most) / compliance: F_most (1 - exp(-x / (compliance F_most))) = m g."""
    weight = 2.0 * G
    most, soft = weight / share, 5e-6
    rig = rail(
        {},
        {"coulomb_n": most, "presliding_m_n": soft, "presliding_n_s_m": 3e3},
        incline_rad=STEEP,
    )
    out = run(rig, 1.0)
    way = 0.5 - out.joints["b_slide"]
    expected = -most * soft * math.log1p(-share)
    assert way[-1] == pytest.approx(expected, rel=0.01)
    assert abs(out.speeds["b_slide"][-1]) < 1e-3 * expected


def lugre(
    friction: dict[str, float], mass_kg: float, rate: float, rest: float, speed: float, at: Any
) -> Any:
    """Position and speed of a mass on a spring by Canudas de Wit and others (1995), eq. 1 to 3.

    dz/dt = v - sigma0 |v| z / g(v) and F = sigma0 z + sigma1 dz/dt + sigma2 v, with
    g(v) = Fc + (Fs - Fc) exp(-(v / vs)^2). Integrated by scipy.
    """
    stiffness = 1.0 / friction["presliding_m_n"]

    def slopes(_: float, y: Any) -> list[float]:
        x, v, z = y
        g = friction["coulomb_n"]
        g += friction["breakaway_n"] * math.exp(-((v / friction["stribeck_m_s"]) ** 2))
        bending = v - stiffness * abs(v) * z / g
        force = stiffness * z + friction["presliding_n_s_m"] * bending
        force += friction["viscous_n_s_m"] * v
        return [v, (-rate * (x - rest) - force) / mass_kg, bending]

    start = [0.5, speed, 0.0]
    return solve_ivp(slopes, (0.0, at[-1]), start, "Radau", at, rtol=1e-8, atol=1e-12).y


LUGRE = {
    "coulomb_n": 7.0, "breakaway_n": 4.0, "stribeck_m_s": 0.02, "viscous_n_s_m": 12.0,
    "presliding_m_n": 2e-5, "presliding_n_s_m": 60.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("rate", "rest", "speed"),
    [
        (1500.0, 0.4997, 0.0),  # within the seal: less than half of what it can hold
        (1500.0, 0.4938, 0.0),  # breaks away at 11 N and sticks again
        (800.0, 0.52, 0.9),  # slides to and fro
        (800.0, 0.50, -0.9),
    ],
)
def test_a_soft_seal_is_that_of_lugre(rate: float, rest: float, speed: float) -> None:
    slide = {"spring": rate, "spring_at": rest}
    out = run(rail(slide, LUGRE, mass_kg=1.4, dt_s=5e-6), 0.25, speed_m_s=speed)
    x, v, _ = lugre(LUGRE, 1.4, rate, rest, speed, out.time_s)
    assert np.abs(out.joints["b_slide"] - x).max() < 0.01 * np.ptp(x)
    assert np.abs(out.speeds["b_slide"] - v).max() < 0.02 * np.abs(v).max()
    if speed:
        assert (v > 0.05).any() and (v < -0.05).any()


@pytest.mark.parametrize("speed", [0.4, -0.4])
def test_a_rigid_seal_slows_a_mass_as_its_stribeck_curve_says(speed: float) -> None:
    """m dv/dt = -(Fc + Fb exp(-(v/vs)^2) + kv v) until it rests, by scipy."""
    friction = {
        "coulomb_n": 5.0, "breakaway_n": 9.0, "stribeck_m_s": 0.15, "viscous_n_s_m": 14.0,
    }  # fmt: skip
    out = run(rail({}, friction, mass_kg=2.0), 0.15, speed_m_s=speed)

    def slopes(_: float, y: Any) -> list[float]:
        more = 9.0 * math.exp(-((y[1] / 0.15) ** 2))
        return [y[1], -(5.0 + more + 14.0 * y[1]) / 2.0]

    def rests(_: float, y: Any) -> float:
        return float(y[1])

    rests.terminal = True  # type: ignore[attr-defined]
    true = solve_ivp(slopes, (0.0, 0.15), [0.0, 0.4], events=rests, rtol=1e-9, dense_output=True)
    stop = float(true.t_events[0][0])
    assert 0.05 < stop < 0.12
    x, v = true.sol(np.minimum(out.time_s, stop))
    sign = math.copysign(1.0, speed)
    assert np.abs(sign * (out.joints["b_slide"] - 0.5) - x).max() < 2e-3 * x.max()
    assert np.abs(sign * out.speeds["b_slide"] - v).max() < 2e-3
    assert np.all(out.speeds["b_slide"][out.time_s > stop + 1e-3] == 0.0)


def test_a_rigid_seal_holds_and_a_weak_one_slides() -> None:
    weight = 2.0 * G
    held = run(rail({}, {"coulomb_n": 1.01 * weight}, incline_rad=STEEP), 0.2)
    assert np.ptp(held.joints["b_slide"]) == 0.0
    for soft in (0.0, 1e-6):
        friction = {"coulomb_n": 0.5 * weight, "presliding_m_n": soft}
        slid = run(rail({}, friction, incline_rad=STEEP), 0.2)
        t = slid.time_s
        free = 0.5 - 0.5 * 0.5 * G * t**2
        # until a seal has given way it falls freely, and keeps the speed from there
        ahead = math.sqrt(G * 0.5 * weight * soft) * t[-1]
        assert np.abs(slid.joints["b_slide"] - free).max() < 1e-5 + ahead


@pytest.mark.parametrize("incline", [STEEP, -STEEP])
def test_a_body_falls_through_its_play_and_no_farther(incline: float) -> None:
    """The piston sticks; the mass falls freely through half of the play, to its face."""
    play = 0.02
    rig = rail({"play": play}, {"coulomb_n": 1e5}, incline_rad=incline)
    out = run(rig, 0.2)
    way = (0.5 - out.joints["b_slide"]) * math.copysign(1.0, incline)
    falling = out.time_s < math.sqrt(play / G) - 1e-3
    assert np.allclose(way[falling], 0.5 * G * out.time_s[falling] ** 2, atol=1e-8)
    assert way[-1] == pytest.approx(0.5 * play, abs=2e-5)
    assert np.ptp(out.extensions["c"]) < 2e-5


def test_a_loose_piston_is_no_part_of_its_body() -> None:
    """The piston sticks in the middle of its play; a spring moves what is left of the mass."""
    mass, loose, rate = 2.0, 0.8, 5e3
    slide = {"play": 0.02, "spring": rate, "spring_at": 0.503}
    out = run(rail(slide, {"coulomb_n": 1e5}, mass_kg=mass, loose_kg=loose), 0.3)
    omega = math.sqrt(rate / (mass - loose))
    expected = 0.503 - 0.003 * np.cos(omega * out.time_s)
    assert np.abs(out.joints["b_slide"] - expected).max() < 1e-5


def test_meeting_a_face_keeps_the_momentum_of_both() -> None:
    """A spring draws the mass to a face of a piston at rest; they go on together, as heavy as both.

    They do so until the spring is slack, where they are fastest.
    """
    mass, loose, rate, drawn, way = 2.0, 0.8, 5e3, 0.003, 0.002
    slide = {"play": 2.0 * way, "spring": rate, "spring_at": 0.5 + drawn}
    out = run(rail(slide, mass_kg=mass, loose_kg=loose), 0.05, sample_s=1e-4)
    apart = out.joints["b_slide"] - out.extensions["c"]
    meeting = math.acos(1.0 - way / drawn) / math.sqrt(rate / (mass - loose))
    assert out.time_s[np.argmax(apart > way - 1e-7)] == pytest.approx(meeting, abs=2e-4)
    before = math.sqrt(rate / (mass - loose) * (drawn**2 - (drawn - way) ** 2))
    both = (mass - loose) / mass * before
    fastest = math.sqrt(both**2 + rate / mass * (drawn - way) ** 2)
    after = out.time_s > meeting + 2e-4
    assert out.speeds["b_slide"][after].max() == pytest.approx(fastest, rel=2e-3)


def test_a_piston_takes_its_body_along_from_face_to_face() -> None:
    """A spring of the cylinder draws the piston in; the mass follows by the play behind."""
    slow = {"viscous_n_s_m": 200.0}
    rig = rail({"play": 0.01}, slow, spring_n_m=0.0, spring_preload_n=20.0)
    out = run(rig, 1.0)
    gap = out.extensions["c"] - out.joints["b_slide"]
    assert np.abs(gap).max() <= 0.005 + 1e-9
    late = out.time_s > 0.2
    assert np.allclose(gap[late], -0.005, atol=1e-9)
    assert out.speeds["b_slide"][-1] == pytest.approx(-20.0 / 200.0, rel=1e-3)


def test_no_play_is_the_limit_of_little() -> None:
    friction = {"coulomb_n": 5.0, "viscous_n_s_m": 20.0}
    more = {"spring_n_m": 400.0, "spring_preload_n": -150.0}
    none, little = (
        run(rail({"play": play}, friction, **more), 1.0).joints["b_slide"] for play in (0.0, 1e-6)
    )
    assert np.ptp(none) > 0.05
    assert np.abs(none - little).max() < 5e-5


@pytest.mark.parametrize("hold", [0.0, 1.0])
@pytest.mark.parametrize("ratio", [0.1, 0.6])
def test_a_stop_gives_back_what_its_damper_leaves(hold: float, ratio: float) -> None:
    """x = -v0 / w exp(-ratio omega t) sin(w t) while it touches; then it goes on as fast."""
    mass, stiff, speed = 2.0, 8e4, -1.5
    omega = math.sqrt(stiff / mass)
    slide = {
        "lower": 0.4999,
        "stop_stiffness": stiff,
        "stop_damping": 2.0 * ratio * mass * omega,
        "stop_hold": hold,
    }
    out = run(rail(slide), 0.1, speed_m_s=speed)
    w = omega * math.sqrt(1.0 - ratio**2)
    # it lets go where the force is none (stiffness x + damping v = 0), or leaves with the stop
    end = math.pi if hold else math.atan2(2.0 * ratio * w / omega, 2.0 * ratio**2 - 1.0)
    decay = math.exp(-ratio * omega * end / w)
    left = speed * decay * (math.cos(end) - ratio * omega / w * math.sin(end))
    assert out.speeds["b_slide"][-1] == pytest.approx(left, rel=2e-3)
    deepest = math.atan2(w, ratio * omega)
    depth = -speed / w * math.exp(-ratio * omega * deepest / w) * math.sin(deepest)
    assert 0.4999 - out.joints["b_slide"].min() == pytest.approx(depth, rel=5e-3)


def test_a_spring_of_a_joint_swings_at_its_frequency() -> None:
    out = run(rail({"spring": 800.0, "spring_at": 0.55}), 2.0)
    x = out.joints["b_slide"]
    expected = 0.55 - 0.05 * np.cos(math.sqrt(800.0 / 2.0) * out.time_s)
    assert np.abs(x - expected).max() < 1e-4
