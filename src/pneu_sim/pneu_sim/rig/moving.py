# SPDX-License-Identifier: Apache-2.0
"""What of a rig moves, in words: the rows of the tables in which `pneu check` shows it."""

from collections.abc import Iterator
from pathlib import Path

from pneu_sim.bodies.base import Body, Joint
from pneu_sim.rig.cylinder import Cylinder, Side
from pneu_sim.rig.expand import part_name
from pneu_sim.rig.plan import Plan
from pneu_sim.rig.schema import Rig

ROOM = "room"
"""What lies on a side that holds no gas of its own."""

CYLINDER_COLUMNS = (
    "name", "size", "stroke", "gas", "head at", "rod at", "dead volumes", "friction", "leaks",
    "moves",
)  # fmt: skip
MECHANISM_COLUMNS = ("joint", "start", "physics step", "coupling")
ENCODER_COLUMNS = ("name", "on", "noise", "quantum", "recorded as")
BODY_COLUMNS = ("name", "kind", "joint", "start", "stops", "cylinders")


def cylinder_rows(rig: Rig, plan: Plan) -> Iterator[tuple[str, ...]]:
    """Rows of the table of cylinders, one each.

    Args:
        rig: The rig.
        plan: Its grid.
    """
    moved = {used: name for name, body in rig.bodies.items() for used in body.driven_by}
    if rig.mechanism is not None:
        moved |= dict.fromkeys(rig.mechanism.cylinders, Path(rig.mechanism.mjcf).name)
    for name, cylinder in rig.cylinders.items():
        yield (
            name,
            _size(cylinder),
            _way(cylinder),
            _gas(name, cylinder, plan),
            _node(cylinder.head),
            _node(cylinder.rod),
            " + ".join(f"{1e6 * s.dead_volume_m3:g}" for s in cylinder.sides.values()) + " cm3",
            _friction(cylinder),
            _leaks(cylinder),
            moved.get(name, "nothing: locked"),
        )


def body_rows(rig: Rig) -> Iterator[tuple[str, ...]]:
    """Rows of the table of bodies, one for each joint.

    Args:
        rig: The rig.
    """
    for name, body in rig.bodies.items():
        about = [name, str(getattr(body, "kind", "")), ", ".join(body.driven_by)]
        for field, joint in zip(body.joint_fields, body.joints, strict=True):
            start = f"{joint.start:g} {unit(body, field)}"
            yield (
                about[0],
                about[1],
                joint.name or f"{name}_{field}",
                f"held at {start}" if joint.held else start,
                _stops(joint),
                about[2],
            )
            about = ["", "", ""]  # once is enough


def mechanism_rows(rig: Rig) -> Iterator[tuple[str, ...]]:
    """Rows of the table of a mechanism's joints, one each; builds it, so that what is wrong shows.

    Args:
        rig: The rig.

    Raises:
        InputError: MuJoCo is missing, or the MJCF does not fit the rig.
    """
    if rig.mechanism is None:
        return
    # MuJoCo and what leads to it are loaded where a rig names an MJCF.
    from pneu_sim.mechanism.mechanism import Mechanism

    stroke = {name: rig.cylinders[name].stroke for name in rig.mechanism.cylinders}
    mechanism = Mechanism(rig.mechanism, 1, stroke_m=stroke)
    positions = mechanism.joint_positions()[:, 0].tolist()
    for joint, position in zip(mechanism.joints, positions, strict=True):
        yield joint, f"{position:.4g}", f"{1e3 * mechanism.step_s:g} ms", rig.mechanism.coupling


def encoder_rows(rig: Rig) -> Iterator[tuple[str, ...]]:
    """Rows of the table of encoders, one each.

    Args:
        rig: The rig.
    """
    for name, encoder in rig.encoders.items():
        channel = encoder.channel
        yield (
            name,
            f"joint {encoder.on(name)}" if encoder.cylinder is None else encoder.cylinder,
            f"{encoder.noise:g}" if encoder.noise > 0.0 else "",
            f"{encoder.quantum:g}" if encoder.quantum > 0.0 else "",
            "/joint_states" if channel is None else str(channel.topic or channel.column),
        )


def unit(body: Body, field: str) -> str:
    """Unit of a joint's position.

    Args:
        body: The body.
        field: Name of the joint among its fields.
    """
    return "m" if field in body.slides else "rad"


def _size(cylinder: Cylinder) -> str:
    if cylinder.rotary is not None:
        return f"{1e6 * cylinder.rotary.displacement_m3_rad:g} cm3/rad"
    assert cylinder.bore_m is not None
    rod = f", rod {1e3 * cylinder.rod_m:g} mm" if cylinder.rod_m > 0.0 else ""
    return f"bore {1e3 * cylinder.bore_m:g} mm{rod}"


def _way(cylinder: Cylinder) -> str:
    if cylinder.rotary is not None:
        return f"{cylinder.stroke:g} rad"
    return f"{1e3 * cylinder.stroke:g} mm"


def _gas(name: str, cylinder: Cylinder, plan: Plan) -> str:
    if cylinder.gas == "chamber":
        return "chamber"
    counts = [plan.pipes[part_name(name, side)][1] for side in cylinder.sides]
    return f"up to {' + '.join(map(str, counts))} cells"


def _node(side: Side | None) -> str:
    if side is None:
        return ROOM
    throttled = "" if side.port_conductance_m3_s_pa is None else ", throttled"
    return side.node + throttled + ("" if side.cushion is None else ", cushion")


def _friction(cylinder: Cylinder) -> str:
    f, force = cylinder.friction, "N" if cylinder.rotary is None else "N m"
    speed = "m/s" if cylinder.rotary is None else "rad/s"
    parts = (
        (f.coulomb_n, f"{f.coulomb_n:g} {force}"),
        (f.coulomb_n_per_pa, f"{1e5 * f.coulomb_n_per_pa:g} {force}/bar"),
        (f.breakaway_n, f"{f.breakaway_n:g} {force} more at rest"),
        (f.viscous_n_s_m, f"{f.viscous_n_s_m:g} {force}/({speed})"),
    )
    return ", ".join(text for value, text in parts if value > 0.0) or "none"


def _leaks(cylinder: Cylinder) -> str:
    parts = (("piston", cylinder.piston_leak_m2), ("rod", cylinder.rod_leak_m2))
    return ", ".join(f"{what} {1e6 * area:g} mm2" for what, area in parts if area > 0.0) or "none"


def _stops(joint: Joint) -> str:
    lower, upper = joint.lower, joint.upper
    if lower is None:
        return "none" if upper is None else f"up to {upper:g}"
    return f"from {lower:g}" if upper is None else f"{lower:g} to {upper:g}"
