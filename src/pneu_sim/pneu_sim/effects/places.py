# SPDX-License-Identifier: Apache-2.0
"""Names of the parts of a rig at which effects may sit, and the parts by those names."""

from pneu_sim.bodies.base import Body, Joint
from pneu_sim.rig.cylinder import Side
from pneu_sim.rig.schema import CLOSED, Orifice, Pipe, Port, Rig, joint_names

ROOM = "room"
"""Place of effects that act on the surroundings of the whole rig."""

TAPS = "taps"
"""Place of effects that act on all taps of a rig alike."""

FILLED = 10.0
"""Pressure over the room's up to which gas is taken to have been filled in, where no source is."""
SELDOM = 0.1
OFTEN = 0.6
"""Of the way from the room's pressure to the highest: gas is seldom below the one, and often above
and below the other."""


def reached_pa(rig: Rig, lower: float, upper: float) -> tuple[float, float]:
    """Pressures that the gas of a rig goes through, from above the room's to its highest source's.

    Args:
        rig: The rig.
        lower: They are at least this, Pa.
        upper: They are at most this, Pa.
    """
    room = rig.ambient.pressure_pa
    highest = max((rig.reservoirs[name].pressure_pa for name in sources(rig)), default=room)
    # gas that is shut in was once filled from somewhere
    high = highest if highest > room else FILLED * room
    # what opens from the room's pressure on is a leak
    return max(room + SELDOM * (high - room), lower), min(high, upper)


def sources(rig: Rig) -> list[str]:
    """Names of the reservoirs that are regulated sources.

    Args:
        rig: The rig.
    """
    return [name for name, reservoir in rig.reservoirs.items() if not reservoir.room]


def valve_ports(rig: Rig) -> dict[str, Port]:
    """Ports of all valves, by ``valve.port``.

    Args:
        rig: The rig.
    """
    return {f"{v}.{p}": port for v, valve in rig.valves.items() for p, port in valve.ports.items()}


def flow_paths(rig: Rig) -> dict[str, list[Port | Orifice]]:
    """Restrictions by place: each valve as a whole, each of several ports alone, each orifice.

    Args:
        rig: The rig.
    """
    paths: dict[str, list[Port | Orifice]] = {}
    for v, valve in rig.valves.items():
        paths[v] = list(valve.ports.values())
        if len(valve.ports) > 1:
            paths.update({f"{v}.{p}": [port] for p, port in valve.ports.items()})
    for name, orifice in rig.orifices.items():
        paths[name] = [orifice]
    return paths


def open_to_room(rig: Rig) -> list[str]:
    """Pipes with an end in a reservoir that is the room.

    Args:
        rig: The rig.
    """
    room = {name for name, reservoir in rig.reservoirs.items() if reservoir.room}
    return [name for name, pipe in rig.pipes.items() if {pipe.from_node, pipe.to_node} & room]


def junctions(rig: Rig) -> list[str]:
    """Nodes that join three or more pipe ends and nothing else.

    Args:
        rig: The rig.
    """
    ends: dict[str, int] = {}
    for pipe in rig.pipes.values():
        for node in (pipe.from_node, pipe.to_node):
            ends[node] = ends.get(node, 0) + 1
    fixed = {CLOSED, *rig.reservoirs, *rig.chambers}
    return [node for node, count in ends.items() if count > 2 and node not in fixed]


def fill_and_exhaust(rig: Rig, valve: str) -> tuple[list[Port], list[Port]]:
    """Ports of a valve that lead to a source, and those that lead to the room or a vacuum.

    Args:
        rig: The rig.
        valve: Name of the valve.
    """
    fill: list[Port] = []
    exhaust: list[Port] = []
    for port in rig.valves[valve].ports.values():
        reached = _reservoirs_behind(rig, port.from_node) | _reservoirs_behind(rig, port.to_node)
        above = [
            not rig.reservoirs[r].room and rig.reservoirs[r].pressure_pa > rig.ambient.pressure_pa
            for r in reached
        ]
        if any(above):
            fill.append(port)
        elif reached:
            exhaust.append(port)
    return fill, exhaust


def _reservoirs_behind(rig: Rig, node: str) -> set[str]:
    """Reservoirs that pipes connect to a node without a valve between."""
    seen: set[str] = set()
    front = [node]
    while front:
        here = front.pop()
        if here in seen:
            continue
        seen.add(here)
        if here in rig.reservoirs:
            continue
        for pipe in rig.pipes.values():
            if here in (pipe.from_node, pipe.to_node):
                front += [pipe.from_node, pipe.to_node]
    return seen & set(rig.reservoirs)


def joints(rig: Rig) -> dict[str, tuple[Body, str]]:
    """Joints that move, by name: the body of each, and its field there.

    Args:
        rig: The rig.
    """
    out: dict[str, tuple[Body, str]] = {}
    names = iter(joint_names(rig))
    for body in rig.bodies.values():
        for field, joint in zip(body.joint_fields, body.joints, strict=True):
            name = next(names)
            if not joint.held:
                out[name] = (body, field)
    return out


def joint_at(rig: Rig, place: str) -> Joint:
    """The joint of a name.

    Args:
        rig: The rig.
        place: The name.
    """
    body, field = joints(rig)[place]
    joint: Joint = getattr(body, field)
    return joint


def driven_joints(rig: Rig) -> list[str]:
    """Joints that cylinders turn by a crank, or push.

    Args:
        rig: The rig.
    """
    return [
        name
        for name, (body, field) in joints(rig).items()
        if field in body.cranks or (field in body.slides and body.driven_by)
    ]


def moved_cylinders(rig: Rig) -> list[str]:
    """Cylinders that move a body.

    Args:
        rig: The rig.
    """
    return [name for body in rig.bodies.values() for name in body.driven_by]


def cylinder_sides(rig: Rig) -> dict[str, Side]:
    """Sides of cylinders that move a body, by ``cylinder.side``.

    Args:
        rig: The rig.
    """
    return {
        f"{name}.{side_name}": side
        for name in moved_cylinders(rig)
        for side_name, side in rig.cylinders[name].sides.items()
    }


def ways_in(rig: Rig) -> list[str]:
    """Sides of cylinders that move a body and have a port, or a chamber that a pipe opens into.

    Args:
        rig: The rig.
    """
    ends = {node for pipe in rig.pipes.values() for node in (pipe.from_node, pipe.to_node)}
    return [
        place
        for place, side in cylinder_sides(rig).items()
        if side.node != CLOSED
        and (
            side.port_conductance_m3_s_pa is not None
            or (rig.cylinders[place.rsplit(".", 1)[0]].gas == "chamber" and side.node in ends)
        )
    ]


def on_pipe(pipe: Pipe, position_m: float) -> float:
    """Keeps a position on a pipe, since a difference step may reach just past its end.

    Args:
        pipe: The pipe.
        position_m: Position, m.
    """
    return min(max(position_m, 0.0), pipe.length_m)
