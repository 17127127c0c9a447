# SPDX-License-Identifier: Apache-2.0
"""Which numbers of cylinders and bodies are fitted when a rig's file does not say."""

from collections.abc import Iterator
from typing import Any

from pneu_sim.rig.cylinder import Cylinder
from pneu_sim.rig.parameters import get_parameter
from pneu_sim.rig.schema import FitParameter, Rig

MOST_GRIP, USUAL_GRIP = 0.3, 0.03
"""Friction of seals, of the greatest force of the gas: at most, and one sigma."""
MOST_DRAG, USUAL_DRAG = 1.0, 0.1
"""Viscous friction at 1 m/s, or 1 rad/s of a rotary one, likewise."""
MOST_HOLD, USUAL_HOLD = 0.2, 0.01
"""Friction of a joint, of the greatest torque of the cylinder that turns it, likewise; viscous
friction at 1 rad/s."""
MOST_COVER, USUAL_COVER = 1.0, 0.05
"""Heat conductance of a side that the piston's way does not change, W/K, likewise."""
USUAL_BENT_M = 1e-4
"""Seals give way by so much before they slide, m, one sigma."""
STRIBECK = 10.0
"""The speed over which breakaway friction vanishes is known to within this factor."""
STOPS = 30.0
"""Stiffness and damping of a joint's stops are known to within this factor at the worst."""
MOST_FILM, USUAL_FILM = 200.0, 20.0
"""Heat transfer from the wall of a cylinder, W/(m^2 K), likewise."""


def moving_parameters(rig: Rig) -> Iterator[FitParameter]:
    """Numbers of what moves, with ranges that a datasheet leaves open.

    Of cylinders that move something: dead volumes, heat, friction of the seals. Of bodies: what
    each kind calls uncertain, and the friction of joints that are not held.

    Args:
        rig: The rig.
    """
    if not rig.bodies:
        return
    room = rig.ambient.pressure_pa
    highest = max([r.pressure_pa for r in rig.reservoirs.values()], default=room)
    force = {name: max(highest - room, room) * c.areas[0] for name, c in rig.cylinders.items()}
    for name, cylinder in rig.cylinders.items():
        if not any(name in body.driven_by for body in rig.bodies.values()):
            continue
        yield from _of_cylinder(f"cylinders.{name}", cylinder, force[name])
    for name, body in rig.bodies.items():
        base = f"bodies.{name}"
        for path, share in body.uncertain.items():
            if (value := _number(body, path)) is not None and value > 0.0:
                factor = 1.0 + 5.0 * share
                yield FitParameter(
                    path=f"{base}.{path}",
                    lower=value / factor,
                    upper=value * factor,
                    std=share * value,
                    log=True,
                )
        lever = max((rig.cylinders[c].stroke for c in body.driven_by), default=0.0)
        torque = max((force[c] for c in body.driven_by), default=0.0)
        for field, joint in zip(body.joint_fields, body.joints, strict=True):
            if joint.held or not body.driven_by:
                continue
            most = torque if field in body.slides else torque * lever
            for number in ("viscous", "dry_friction"):
                value = float(get_parameter(rig, f"{base}.{field}.{number}"))
                yield FitParameter(
                    path=f"{base}.{field}.{number}",
                    lower=0.0,
                    upper=max(MOST_HOLD * most, 5.0 * value),
                    std=max(USUAL_HOLD * most, value),
                )
            if joint.lower is not None or joint.upper is not None:
                yield from _of_stops(f"{base}.{field}.", joint.stop_stiffness, joint.stop_damping)
                yield FitParameter(path=f"{base}.{field}.stop_hold", lower=0.0, upper=1.0, std=0.5)


def _of_cylinder(base: str, cylinder: Cylinder, force: float) -> Iterator[FitParameter]:
    """Numbers of one cylinder."""
    for side_name, side in cylinder.sides.items():
        value = side.dead_volume_m3
        # no logarithm: of a linkage that is larger as a whole all numbers grow by a factor but
        # these, by which the piston's way from its end differs is added to them; half a per cent is
        # a seventh of a small one, whose logarithm bends that valley so that no step leads along
        yield FitParameter(
            path=f"{base}.{side_name}.dead_volume_m3",
            lower=value / 4.0,
            upper=value * 4.0,
            std=0.5 * value,
        )
        yield FitParameter(
            path=f"{base}.{side_name}.heat_w_per_k",
            lower=0.0,
            upper=max(MOST_COVER, 4.0 * side.heat_w_per_k),
            std=max(USUAL_COVER, 0.5 * side.heat_w_per_k),
        )
    if cylinder.rotary is None:
        usual = max(USUAL_FILM, 0.5 * cylinder.heat_w_m2_k)
        yield FitParameter(
            path=f"{base}.heat_w_m2_k",
            lower=0.0,
            upper=max(MOST_FILM, 4.0 * cylinder.heat_w_m2_k),
            std=usual,
        )
    yield FitParameter(
        path=f"{base}.friction.stribeck_m_s",
        lower=cylinder.friction.stribeck_m_s / STRIBECK,
        upper=cylinder.friction.stribeck_m_s * STRIBECK,
        std=cylinder.friction.stribeck_m_s,
        log=True,
    )
    friction = cylinder.friction
    softest = USUAL_BENT_M / (USUAL_GRIP * force)
    yield FitParameter(
        path=f"{base}.friction.presliding_m_n",
        lower=0.0,
        upper=max(10.0 * softest, 5.0 * friction.presliding_m_n),
        std=max(softest, friction.presliding_m_n),
    )
    yield FitParameter(
        path=f"{base}.friction.presliding_n_s_m",
        lower=0.0,
        upper=max(10.0 * force, 5.0 * friction.presliding_n_s_m),
        std=max(2.0 * force, friction.presliding_n_s_m),
    )
    for number, most, usual, value in (
        ("coulomb_n", MOST_GRIP, USUAL_GRIP, friction.coulomb_n),
        ("breakaway_n", MOST_GRIP, USUAL_GRIP, friction.breakaway_n),
        ("viscous_n_s_m", MOST_DRAG, USUAL_DRAG, friction.viscous_n_s_m),
    ):
        yield FitParameter(
            path=f"{base}.friction.{number}",
            lower=0.0,
            upper=max(most * force, 5.0 * value),
            std=max(usual * force, value),
        )


def _of_stops(base: str, stiffness: float, damping: float) -> Iterator[FitParameter]:
    """How stops yield, which nobody measures."""
    for name, value in (("stop_stiffness", stiffness), ("stop_damping", damping)):
        if value > 0.0:
            yield FitParameter(
                path=base + name,
                lower=value / STOPS,
                upper=value * STOPS,
                std=value,
                log=True,
            )


def _number(part: Any, path: str) -> float | None:
    """A number of a body by its dotted path; None where it has none."""
    for name in path.split("."):
        part = getattr(part, name)
    return None if part is None else float(part)
