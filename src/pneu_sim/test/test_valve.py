# SPDX-License-Identifier: Apache-2.0
"""Spools with limits and two delays, held against ramps, rotations and what is drawn by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from pneu_sim.rig.build import build
from pneu_sim.rig.model import Model
from pneu_sim.rig.schema import Rig
from pneu_sim.signals import Signal
from pneu_sim.valve import Spools, evenly_open, openings_along

Floats = NDArray[np.float64]

STEP_S = 1.25e-4
NULL_V = 5.0


def valve(**spool: Any) -> Model:
    """A valve whose opening tells where its spool is: 0 at 0 V, 1 at 10 V."""
    port = {
        "from": "tank",
        "to": "end",
        "conductance_m3_s_pa": 1e-9,
        "opening": {"voltage_v": [0.0, 10.0], "fraction": [0.0, 1.0]},
    }
    return build(
        Rig.model_validate(
            {
                "name": "valve",
                "grid": {"dx_m": 0.5},
                "reservoirs": {"tank": {"pressure_pa": 3e5}},
                "pipes": {
                    "tube": {"from": "end", "to": "closed", "length_m": 1.0, "area_m2": 1e-5}
                },
                "valves": {"valve": {"command": "volts", "spool": spool, "ports": {"port": port}}},
                "commands": {"volts": {}},
                "taps": {"tap": {"pipe": "tube", "position_m": 0.5}},
            }
        )
    )


def along(
    time_s: list[float] | Floats, volts: list[float] | Floats, end_s: float, **spool: Any
) -> tuple[Floats, Floats]:
    """Times and positions of a spool along a command, from 0 s on."""
    signal = Signal(np.asarray(time_s, dtype=float), np.asarray(volts, dtype=float))
    count = round(end_s / STEP_S) + 1
    x = 10.0 * evenly_open(valve(**spool), {"volts": signal}, 0.0, STEP_S, count)[:, 0]
    return STEP_S * np.arange(x.size), x


def in_steps(
    volts: Floats, period_s: float, cuts: list[int], begin_s: float, **spool: Any
) -> Floats:
    """(periods, 5) positions of a spool that is commanded piece by piece, as a plant does it."""
    spools = Spools([valve(**spool)])
    found = [
        spools.follow(volts[None, None, a:b], begin_s, a, period_s, knots=4)[:, :, 0, 0]
        for a, b in zip([0, *cuts], [*cuts, volts.size], strict=True)
    ]
    return 10.0 * np.concatenate(found)


@pytest.mark.parametrize("start_s", [0.01, 0.01003, 0.0101])
@pytest.mark.parametrize("delay_s", [0.0, 0.0023])
def test_a_spool_without_a_lag_ramps(start_s: float, delay_s: float) -> None:
    t, x = along([0.0, start_s, 0.06], [5.0, 9.0, 6.0], 0.1, max_speed_v_s=200.0, delay_s=delay_s)
    up, down = start_s + delay_s, 0.06 + delay_s
    want = 5.0 + 200.0 * np.clip(t - up, 0.0, 0.02) - 200.0 * np.clip(t - down, 0.0, 0.015)
    assert np.abs(x - want).max() < 200.0 * STEP_S / 8.0 + 1e-9  # the corners are a mean
    corners = np.array([up, up + 0.02, down, down + 0.015])
    clear = np.abs(t[:, None] - corners).min(axis=1) > STEP_S
    assert np.abs(x - want)[clear].max() < 1e-10


def test_the_ramp_moves_smoothly_with_delay_and_speed() -> None:
    def at(delay_s: float, speed_v_s: float) -> Floats:
        volts = [5.0, 9.0, 2.0]
        return along([0.0, 0.01, 0.02], volts, 0.06, max_speed_v_s=speed_v_s, delay_s=delay_s)[1]

    for change in (1e-5, 1e-6, 1e-7):
        late = (at(0.003 + change, 300.0) - at(0.003, 300.0)) / change
        assert np.abs(late).max() < 300.0 * 1.001
        fast = (at(0.003, 300.0 + 1e4 * change) - at(0.003, 300.0)) / (1e4 * change)
        assert np.abs(fast).max() < 0.041  # no more than the time that it has moved


@pytest.mark.parametrize("spool", [{}, {"hysteresis_v": 0.4}, {"delay_s": 0.0031}])
def test_far_limits_change_nothing(spool: dict[str, Any]) -> None:
    rng = np.random.default_rng(5)
    time, volts = np.cumsum(rng.uniform(2e-3, 9e-3, 40)), rng.uniform(0.0, 10.0, 40)
    for lag in ({}, {"bandwidth_hz": 60.0, "damping": 0.5}, {"bandwidth_hz": 90.0, "damping": 2.0}):
        _, free = along(time, volts, 0.2, **spool, **lag)
        for limits in (
            {"max_speed_v_s": 1e9},
            {"max_speed_v_s": 1e9, "max_acceleration_v_s2": 1e15},
        ):
            _, x = along(time, volts, 0.2, **spool, **lag, **limits)
            differs = np.abs(x - free) > (1e-9 if lag else 1e-3)  # 10 ns of a knot for a step
            # Where play is taken up within an interval, a spool that follows at once is told the
            # mean after it, not before.
            assert differs.sum() <= (80 if not lag and "hysteresis_v" in spool else 0)
            assert np.abs(x - free).max() < 0.4


def test_the_spool_rings_as_its_equation_does() -> None:
    w, zeta = 2.0 * math.pi * 60.0, 0.5
    for limits in ({}, {"max_speed_v_s": 1e7}, {"max_acceleration_v_s2": 1e9}):
        t, x = along([0.0, 0.01], [5.0, 8.0], 0.05, bandwidth_hz=60.0, damping=zeta, **limits)
        wd = w * math.sqrt(1.0 - zeta**2)
        s = np.maximum(t - 0.01, 0.0)
        decay = np.exp(-zeta * w * s) * (np.cos(wd * s) + zeta * w / wd * np.sin(wd * s))
        assert np.abs(x - 8.0 + 3.0 * decay).max() < 1e-3 * 3.0


@pytest.mark.parametrize(
    "limits",
    [
        {"max_speed_v_s": 150.0},
        {"max_acceleration_v_s2": 6e4},
        {"max_speed_v_s": 250.0, "max_acceleration_v_s2": 8e4},
        {"max_speed_v_s": 250.0, "integral": 8.0},
    ],
)
def test_limited_spools_follow_their_equation(limits: dict[str, float]) -> None:
    w, zeta = 2.0 * math.pi * 40.0, 0.6
    most = limits.get("max_acceleration_v_s2", math.inf)
    fastest, ki = limits.get("max_speed_v_s", math.inf), limits.get("integral", 0.0)

    def rate(t: float, y: Floats) -> list[float]:
        x, v, acc = y
        f = w * w * (9.0 - x) - 2.0 * zeta * w * v + acc
        a = min(max(f, -most), most)
        held = abs(v) >= fastest and a * v > 0.0
        a = 0.0 if held else a
        free = 0.0 if held else (a / f if f != 0.0 else 1.0)
        return [v, a, free * ki * w * w * (9.0 - x)]

    t, x = along([0.0, 0.01], [5.0, 9.0], 0.08, bandwidth_hz=40.0, damping=zeta, **limits)
    s = np.maximum(t - 0.01, 0.0)
    want = solve_ivp(
        rate, (0.0, s[-1]), [5.0, 0.0, 0.0], t_eval=s[s > 0.0], max_step=2e-5, rtol=1e-6
    ).y[0]
    assert np.abs(x[s > 0.0] - want).max() < 4e-3 * 4.0
    assert np.abs(np.diff(x)).max() <= fastest * STEP_S * 1.0001


def test_a_limited_spool_changes_smoothly_with_its_limits() -> None:
    """As a fit takes its derivatives: halving the difference changes them little."""
    volts = 5.0 + 4.0 * np.sin(np.arange(40) * 0.7)
    time = 0.005 * np.arange(40)

    def at(speed_v_s: float, acceleration_v_s2: float) -> Floats:
        return along(
            time,
            volts,
            0.2,
            bandwidth_hz=50.0,
            max_speed_v_s=speed_v_s,
            max_acceleration_v_s2=acceleration_v_s2,
        )[1]

    base = at(300.0, 1e5)
    for change in ((1.0, 0.0), (0.0, 1.0)):
        slopes = [
            (at(300.0 * (1.0 + d * change[0]), 1e5 * (1.0 + d * change[1])) - base) / d
            for d in (1e-3, 1e-4, 1e-5)
        ]
        size = np.abs(slopes[0]).max()
        assert 0.05 < size < 5.0
        for slope in slopes[1:]:
            assert np.sqrt(np.mean((slope - slopes[0]) ** 2)) < 0.05 * size


def test_a_command_acts_from_its_own_time_on_however_hard_the_spool_is_pushed() -> None:
    """At its limit a spool gains x = a t^2 / 2 from the step on, wherever between knots it falls.

    The mean command over an interval is at the limit as well, and would push for all of it.
    """
    most = 4e4
    for late in np.linspace(0.0, STEP_S, 7):
        t, x = along(
            [0.0, 0.01 + late], [2.0, 9.0], 0.03, bandwidth_hz=200.0, max_acceleration_v_s2=most
        )
        s = np.clip(t - 0.01 - late, 0.0, 4e-3)
        early = t < 0.01 + late + 4e-3
        np.testing.assert_allclose(x[early], 2.0 + 0.5 * most * s[early] ** 2, atol=2e-3)


@pytest.mark.parametrize(
    "limits", [{}, {"max_acceleration_v_s2": 1e5}, {"max_speed_v_s": 200.0}, {"integral": 8.0}]
)
def test_a_lagging_spool_moves_with_its_delay(limits: dict[str, float]) -> None:
    """By the delay's change in time, as exactly for a small one as for a large one."""
    rng = np.random.default_rng(9)
    time, volts = np.cumsum(rng.uniform(2e-3, 9e-3, 30)), rng.uniform(0.0, 10.0, 30)

    def at(delay_s: float) -> Floats:
        return along(time, volts, 0.2, bandwidth_hz=50.0, delay_s=delay_s, **limits)[1]

    base = at(0.003)
    whole = at(0.003 + STEP_S)
    np.testing.assert_allclose(whole[1:], base[:-1], atol=0.02)
    speed = np.sqrt(np.mean((whole - base) ** 2)) / STEP_S
    for part in (0.1, 0.01, 0.001):
        moved = np.sqrt(np.mean((at(0.003 + part * STEP_S) - base) ** 2)) / (part * STEP_S)
        assert moved == pytest.approx(speed, rel=0.1)


def test_a_slewing_sine_becomes_a_triangle() -> None:
    """Far too slow for the sine: the spool turns where it meets the command, never at the crest."""
    rate_hz, amplitude, speed = 10.0, 4.0, 40.0
    time = np.arange(0.0, 2.6, 1e-4)
    t, x = along(
        time, NULL_V + amplitude * np.sin(2.0 * math.pi * rate_hz * time), 2.5, max_speed_v_s=speed
    )
    late = t > 2.0
    # A triangle of this slope has crests of speed / (4 f), and meets the sine there:
    crest = speed / (4.0 * rate_hz)
    assert np.ptp(x[late]) / 2.0 == pytest.approx(crest, rel=5e-3)
    phase = np.angle(np.sum((x[late] - NULL_V) * np.exp(-2j * math.pi * rate_hz * t[late])))
    lag = (-math.pi / 2.0 - phase) % (2.0 * math.pi)
    assert lag == pytest.approx(math.acos(crest / amplitude), abs=0.01)


SQUARE_S = [0.0, 0.02, 0.05, 0.09, 0.13]
SQUARE_V = [5.0, 8.0, 5.0, 1.0, 5.0]


@pytest.mark.parametrize("closing_s", [0.0, 0.002, 0.011])
def test_closing_has_a_delay_of_its_own(closing_s: float) -> None:
    t, x = along(SQUARE_S, SQUARE_V, 0.16, delay_s=0.006, closing_delay_s=closing_s)
    late = [0.0, 0.006, closing_s, 0.006, closing_s]
    edges = np.array(SQUARE_S) + np.array(late)
    want = np.array(SQUARE_V)[np.searchsorted(edges, t, "right") - 1]
    clear = np.abs(t[:, None] - edges).min(axis=1) > STEP_S
    assert np.abs(x - want)[clear].max() < 1e-12


def test_equal_delays_are_one() -> None:
    rng = np.random.default_rng(6)
    time, volts = np.cumsum(rng.uniform(2e-3, 9e-3, 40)), rng.uniform(0.0, 10.0, 40)
    for lag in ({}, {"bandwidth_hz": 60.0}, {"max_speed_v_s": 300.0}):
        one = along(time, volts, 0.2, delay_s=0.0047, **lag)[1]
        both = along(time, volts, 0.2, delay_s=0.0047, closing_delay_s=0.0047, **lag)[1]
        assert np.array_equal(one, both)
        near = along(time, volts, 0.2, delay_s=0.0047, closing_delay_s=0.0047 + 1e-9, **lag)[1]
        assert np.abs(near - one).max() < 1e-3


def test_short_pulses_are_swallowed() -> None:
    # Opened for 3 ms where closing is 4 ms quicker, and closed for 3 ms where it is 4 ms slower.
    _, x = along([0.0, 0.02, 0.023], [5.0, 9.0, 5.0], 0.05, delay_s=0.006, closing_delay_s=0.002)
    assert np.abs(x - 5.0).max() < 1e-12
    _, x = along(
        [0.0, 0.01, 0.023, 0.026], [5.0, 9.0, 5.0, 9.0], 0.06, delay_s=0.006, closing_delay_s=0.01
    )
    assert np.abs(x[140:] - 9.0).max() < 1e-12
    # A little longer, and what remains is the difference.
    for over_s in (1e-3, 2e-3):
        _, x = along(
            [0.0, 0.02, 0.024 + over_s],
            [5.0, 9.0, 5.0],
            0.05,
            delay_s=0.006,
            closing_delay_s=0.002,
        )
        assert (x - 5.0).sum() * STEP_S == pytest.approx(4.0 * over_s, rel=1e-9)


def test_commands_told_again_supersede_nothing() -> None:
    often = np.arange(0.0, 0.16, 1e-3)
    again = np.array(SQUARE_V)[np.searchsorted(SQUARE_S, often + 1e-9, "right") - 1]
    spool = {"delay_s": 0.012, "closing_delay_s": 0.003}
    once = along(SQUARE_S, SQUARE_V, 0.16, **spool)[1]
    assert np.abs(along(often, again, 0.16, **spool)[1] - once).max() < 1e-9


SPOOLS = [
    {"delay_s": 0.006, "closing_delay_s": 0.0023},
    {"delay_s": 0.0023, "closing_delay_s": 0.0157, "bandwidth_hz": 70.0},
    {"delay_s": 0.004, "closing_delay_s": 0.001, "max_speed_v_s": 400.0, "hysteresis_v": 0.2},
    {"max_speed_v_s": 400.0},
    {"delay_s": 0.001, "max_speed_v_s": 300.0, "bandwidth_hz": 70.0, "integral": 3.0},
]


@pytest.mark.parametrize("period_s", [1e-3, 7e-3])
@pytest.mark.parametrize("spool", SPOOLS)
def test_a_run_in_pieces_is_one_run(spool: dict[str, Any], period_s: float) -> None:
    volts = np.repeat(np.random.default_rng(7).uniform(0.0, 10.0, 60), 3)
    begin_s = 12.34567
    whole = in_steps(volts, period_s, [], begin_s, **spool)
    for cuts in ([1, 2, 7, 40, 41, 42, 100, 170], list(range(1, volts.size))):
        assert np.array_equal(in_steps(volts, period_s, cuts, begin_s, **spool), whole)
    assert np.ptp(whole) > 3.0
    # The same along signals with times of their own, in pieces or not.
    model = valve(**spool)
    signals = {"volts": Signal(begin_s + period_s * np.arange(volts.size), volts)}
    found = []
    for pieces in (1, 9):
        memory, count = np.full((1, 4), np.nan), volts.size // pieces
        parts = [
            openings_along(
                model, signals, begin_s, k * count, (count, 4), period_s, memory, at_null=True
            )
            for k in range(pieces)
        ]
        found.append(10.0 * np.concatenate(parts)[:, :, 0])
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(found[0], whole)


@pytest.mark.parametrize("first", [0, 3])
def test_spools_begin_where_the_command_has_them_unless_they_are_said_to_be_closed(
    first: int,
) -> None:
    """From closed, one limited in speed goes evenly from the null voltage to what is commanded."""
    model, begin_s = valve(max_speed_v_s=400.0), 2.0 + 0.01 * first
    signals = {"volts": Signal(np.array([0.0, begin_s]), np.array([3.0, 8.0]))}

    def along_two(memory: Floats, **more: bool) -> Floats:
        found = openings_along(model, signals, 2.0, first, (2, 4), 0.01, memory, **more)
        assert found.shape == (2, 5, 1)
        return found[:, :, 0]

    def rising(start_v: float) -> Floats:
        """Means about the knots, each interval by itself, of a ramp that ends at 8 V."""
        top_s = (8.0 - start_v) / 400.0
        knots_s = np.array([0.0, 2.5e-3, 5e-3, 7.5e-3, 1e-2])
        low, high = (np.clip(knots_s + way, 0.0, 1e-2) for way in (-1.25e-3, 1.25e-3))
        area = 200.0 * (np.minimum(high, top_s) ** 2 - np.minimum(low, top_s) ** 2)
        area += 400.0 * top_s * (np.maximum(high, top_s) - np.maximum(low, top_s))
        return np.array([(start_v + area / (high - low)) / 10.0, np.full(5, 0.8)])

    rest = np.full((1, 4), np.nan)
    assert along_two(rest) == pytest.approx(np.full((2, 5), 0.8), rel=1e-12)
    assert rest[0, 1] == pytest.approx(8.0)
    found = along_two(np.full((1, 4), np.nan), at_null=True)
    assert found == pytest.approx(rising(NULL_V), rel=1e-9)
    # what has moved goes on from where it stands, whatever is said of spools at rest
    for closed in (False, True):
        found = along_two(np.array([[6.0, 6.0, 0.0, 0.0]]), at_null=closed)
        assert found == pytest.approx(rising(6.0), rel=1e-9)


@pytest.mark.parametrize("delay_s", [0.0, 0.0013, 0.0078])
def test_both_ends_of_a_period_are_its_own(delay_s: float) -> None:
    """What is commanded next shows in no period before it acts, and at once where it does."""
    volts = np.array([5.0, 8.0, 2.0, 2.0, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0])
    x = in_steps(volts, 1e-3, [], 0.0, delay_s=delay_s)
    area = 1e-3 * (x[:, :-1] + x[:, 1:]).sum(axis=1) / 8.0
    edges = 1e-3 * np.arange(volts.size + 1)
    told = Signal(edges[:-1] + delay_s, volts)
    assert np.allclose(area, 1e-3 * told.mean_between(edges), rtol=1e-12)
    if delay_s == 0.0:
        assert np.array_equal(x, np.repeat(volts[:, None], 5, axis=1))


@pytest.mark.parametrize("spool", SPOOLS)
def test_spools_side_by_side_are_those_alone(spool: dict[str, Any]) -> None:
    volts = np.repeat(np.random.default_rng(8).uniform(0.0, 10.0, (3, 1, 30)), 4, axis=2)
    models = [valve(**spool), valve(), valve(**spool)]
    together = Spools(models).follow(volts, 0.0, 0, 1e-3)
    for k, model in enumerate(models):
        alone = Spools([model]).follow(volts[k : k + 1], 0.0, 0, 1e-3)
        assert np.array_equal(together[..., k], alone[..., 0])
