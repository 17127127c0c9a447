# SPDX-License-Identifier: Apache-2.0
"""Local losses against Fanno flow: the heads that are asked for, wherever and however computed."""

import math
from typing import Any

import numpy as np
import pytest
from tests.references.fanno import mass_flux

from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sim.simulator import Simulator

ROOM, T0, AREA = 101325.0, 293.15, 12e-6
SMOOTH = {
    **{"laminar": 0.0, "turbulent": 0.0, "unsteady": 0.0},
    **{"nusselt": 0.0, "heat_turbulent": 0.0, "heat_unsteady": 0.0},
}


def leg(start: str, end: str, length: float, **more: Any) -> dict[str, Any]:
    return {"from": start, "to": end, "length_m": length, "area_m2": AREA, "wall": SMOOTH, **more}


def line(supply: float, pipes: dict[str, Any], grid: dict[str, Any]) -> Rig:
    first = next(iter(pipes))
    return Rig.model_validate(
        {
            **{"name": "line", "pipes": pipes, "grid": {"memory": False, **grid}},
            "reservoirs": {"supply": {"pressure_pa": supply}, "room": {"pressure_pa": ROOM}},
            "taps": {"tap": {"pipe": first, "position_m": 0.0}},
        }
    )


def flux(rig: Rig, pipe: str, settle_s: float = 1.5) -> float:
    """Mean mass flux of a steady flow, kg/(m^2 s): the pipe rings."""
    simulator = Simulator(rig)
    simulator.run(settle_s, sample_s=0.05)
    seen = []
    for _ in range(20):
        simulator.run(0.01, sample_s=0.01)
        state = simulator.state(pipe)
        i = state["x_m"].size // 4
        seen.append(state["density"][i] * state["velocity"][i])
    return float(np.mean(seen))


def fitted(rig: Rig, effect: str, place: str, **values: float) -> Rig:
    attached = AttachedEffect(effect=effect, place=place, parameters=values)
    return rig.model_copy(update={"effects": [attached]})


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize(
    ("supply", "heads", "position", "grid"),
    [
        (1.05e5, 20.0, 2.0, {"dx_m": 0.1}),
        (1.5e5, 3.0, 2.0, {"dx_m": 0.1, "order": 1}),
        (1.5e5, 20.0, 2.03, {"dx_m": 0.1, "cfl": 0.1}),
        (1.5e5, 50.0, 0.0, {"dx_m": 0.2}),
        (1.5e5, 20.0, 4.0, {"dx_m": 0.1, "flux": "exact"}),
        (4e5, 5.0, 1.0, {"dx_m": 0.1}),
        (7e5, 60.0, 3.0, {"dx_m": 0.1, "order": 1}),
    ],
)
def test_a_steady_flow_loses_the_heads_that_are_asked_for(
    supply: float, heads: float, position: float, grid: dict[str, Any], backwards: bool
) -> None:
    """Whatever the cells, step, scheme, place and direction; and where it chokes."""
    ends = ("room", "supply") if backwards else ("supply", "room")
    rig = fitted(
        line(supply, {"tube": leg(*ends, 4.0)}, grid),
        "local_loss",
        "tube",
        **{"K": heads, "position_m": 4.0 - position if backwards else position},
    )
    expected = mass_flux(supply, T0, ROOM, heads) * (-1.0 if backwards else 1.0)
    assert flux(rig, "tube") == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("short", [0.04, 0.3])
def test_the_cells_of_other_pipes_change_nothing(short: float) -> None:
    pipes = {"tube": leg("supply", "end", 4.0), "tail": leg("end", "room", short)}
    rig = fitted(line(1.5e5, pipes, {"dx_m": 0.1}), "local_loss", "tube", K=20.0, position_m=1.0)
    assert flux(rig, "tube") == pytest.approx(mass_flux(1.5e5, T0, ROOM, 20.0), rel=0.01)


@pytest.mark.parametrize(("from_heads", "to_heads"), [(8.0, 0.0), (0.0, 30.0), (12.0, 5.0)])
def test_losses_at_both_ends_add_up(from_heads: float, to_heads: float) -> None:
    tube = leg("supply", "room", 3.0, loss_from=from_heads, loss_to=to_heads)
    found = flux(line(1.4e5, {"tube": tube}, {"dx_m": 0.1}), "tube")
    assert found == pytest.approx(mass_flux(1.4e5, T0, ROOM, from_heads + to_heads), rel=0.01)


@pytest.mark.parametrize("heads", [1.5, 10.0, 50.0])
def test_a_junction_loses_them_on_the_way_in_and_on_the_way_out(heads: float) -> None:
    """Each on the velocity head of its own branch."""
    ways = {"x": ("supply", "j"), "y": ("j", "room"), "z": ("j", "closed")}
    legs = {name: leg(*way, 1.0) for name, way in ways.items()}
    rig = fitted(line(1.2e5, legs, {"dx_m": 0.1}), "junction_loss", "j", K=heads)
    assert flux(rig, "x") == pytest.approx(mass_flux(1.2e5, T0, ROOM, 2.0 * heads), rel=0.01)


def test_a_linear_resistance_takes_pressure_with_the_velocity() -> None:
    """Little of it, so that the density is nearly the same before and behind."""
    fitting = {"position_m": 1.0, "k": 0.0, "resistance_pa_s_m": 300.0}
    tube = leg("supply", "room", 2.0, losses=[fitting])
    found = flux(line(ROOM + 1e3, {"tube": tube}, {"dx_m": 0.1}), "tube")
    density = (ROOM + 500.0) / (287.05 * T0)
    # 1 kPa = 300 u + (entry) rho u^2 / 2
    speed = (-300.0 + math.sqrt(300.0**2 + 2.0 * density * 1e3)) / density
    assert found == pytest.approx(density * speed, rel=0.01)


@pytest.mark.parametrize("heads", [1e-9, 1e-5])
def test_a_loss_that_vanishes_changes_nothing(heads: float) -> None:
    plain = line(1.5e5, {"tube": leg("supply", "closed", 1.0)}, {"dx_m": 0.05})
    lossy = fitted(plain, "local_loss", "tube", K=heads, position_m=0.4)
    seen = [Simulator(rig).run(0.02, sample_s=1e-4).pressures["tap"] for rig in (plain, lossy)]
    assert np.abs(seen[0] - seen[1]).max() < 1e-2 + 1e5 * heads


@pytest.mark.parametrize("dx", [0.1, 0.05, 0.02])
@pytest.mark.parametrize("above", [400.0, -400.0])
@pytest.mark.parametrize("end", ["loss_from", "loss_to", "losses", "resistance"])
def test_a_tap_beside_a_fitting_at_an_end_is_on_its_own_side(
    end: str, above: float, dx: float
) -> None:
    """Bernoulli without friction: the fitting is at the end, whatever cell the tap is in."""
    heads = 6.0
    wall = {"laminar": 0.0, "turbulent": 0.0, "nusselt": 0.0, "heat_turbulent": 0.0}
    pipe = {"from": "left", "to": "right", "length_m": 1.0, "area_m2": 6e-6, "wall": wall}
    resistance = 40.0  # Pa s/m
    if end == "losses":
        pipe["losses"] = [{"position_m": 0.995, "k": heads}]
    elif end == "resistance":
        pipe["losses"] = [{"position_m": 0.995, "resistance_pa_s_m": resistance}]
    else:
        pipe[end] = heads
    places = {"first": 0.01, "second": 0.04, "middle": 0.5, "third": 0.96, "fourth": 0.99}
    rig = Rig.model_validate(
        {
            "name": "beside",
            "grid": {"dx_m": dx, "memory": False, "wave_speed_m_s": 400.0},
            "ambient": {"pressure_pa": 1e5, "temperature_k": 293.15},
            "reservoirs": {
                "left": {"pressure_pa": 1e5 + above},
                "right": {"pressure_pa": 1e5, "room": True},
            },
            "pipes": {"tube": pipe},
            "taps": {name: {"pipe": "tube", "position_m": x} for name, x in places.items()},
        }
    )
    simulator = Simulator(rig)
    seen = {name: y[-1] for name, y in simulator.run(2.0, sample_s=0.1).taps.items()}
    state = simulator.state("tube")
    speed = float(np.median(state["velocity"]))
    head = 0.5 * float(np.median(state["density"])) * speed * abs(speed)
    if end == "resistance":
        heads = resistance * abs(speed) / abs(head)
    # one head goes into the flow at the mouth, and none comes back at the outlet
    assert above == pytest.approx(head * (1.0 + heads), rel=0.01)
    entered = 1.0 + (heads if (end == "loss_from") == (above > 0.0) else 0.0)
    inside = 1e5 + max(above, 0.0) - abs(head) * entered
    for name, pressure in seen.items():
        assert pressure == pytest.approx(inside, abs=0.02 * abs(head) * heads), name
