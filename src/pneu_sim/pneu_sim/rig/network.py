# SPDX-License-Identifier: Apache-2.0
"""What of a rig hangs together by pipes, which reservoir feeds it, and the ways along pipes."""

import heapq
from collections.abc import Collection, Sequence

from pneu_sim.rig.schema import CLOSED, Rig, Tap


def end_nodes(rig: Rig, pipe: str) -> tuple[str, str]:
    """Returns the nodes of a pipe, each closed end as a node of its own.

    Args:
        rig: The rig.
        pipe: Name of the pipe.
    """
    line = rig.pipes[pipe]
    start, end = line.from_node, line.to_node
    return (
        f"{CLOSED} start of {pipe}" if start == CLOSED else start,
        f"{CLOSED} end of {pipe}" if end == CLOSED else end,
    )


def port_ends(rig: Rig) -> list[tuple[str, str]]:
    """Returns the nodes on both sides of all ports, then orifices, in the order of the grid plan.

    Args:
        rig: The rig.
    """
    ports = [port for valve in rig.valves.values() for port in valve.ports.values()]
    return [(p.from_node, p.to_node) for p in ports] + [
        (o.from_node, o.to_node) for o in rig.orifices.values()
    ]


def joined(rig: Rig, apart: Collection[str] = ()) -> dict[str, str]:
    """What hangs together by pipes alone.

    Args:
        rig: The rig.
        apart: Nodes through which nothing does.

    Returns:
        One of its members for every node but those, and for every pipe, as ``pipe:name``.
    """
    root: dict[str, str] = {}

    def find(item: str) -> str:
        root.setdefault(item, item)
        while root[item] != item:
            item = root[item]
        return item

    for node in (*rig.reservoirs, *rig.chambers):
        if node not in apart:
            find(node)
    for name in rig.pipes:
        own = f"pipe:{name}"
        find(own)
        for node in end_nodes(rig, name):
            if node not in apart:
                root[find(own)] = find(node)
    return {item: find(item) for item in root}


def volumes_of(rig: Rig) -> tuple[dict[str, str], set[str]]:
    """Which nodes and pipes share a volume, no valve between, and which volumes meet a reservoir.

    Args:
        rig: The rig.

    Returns:
        As `joined`, reservoirs being apart; and the fed ones.
    """
    volume = joined(rig, rig.reservoirs)
    fed = {
        volume[f"pipe:{name}"]
        for name in rig.pipes
        if any(node in rig.reservoirs for node in end_nodes(rig, name))
    }
    return volume, fed


def volume_of_tap(volume: dict[str, str], tap: Tap) -> str:
    """The volume that a tap sits in.

    Args:
        volume: As of `volumes_of`.
        tap: The tap.
    """
    return volume[f"pipe:{tap.pipe}" if tap.pipe is not None else str(tap.chamber)]


def reservoir_of_pipes(rig: Rig, reservoirs: Sequence[str]) -> dict[str, int]:
    """Number of the reservoir that each pipe is filled from, through pipes alone.

    Args:
        rig: The rig.
        reservoirs: Names of the reservoirs, in the order of their numbers.
    """
    found: dict[str, int] = {}
    reached = {name: i for i, name in enumerate(reservoirs)}
    for _ in rig.pipes:
        for name in rig.pipes:
            start, end = end_nodes(rig, name)
            for node, far in ((start, end), (end, start)):
                if node in reached and name not in found:
                    found[name] = reached[node]
                    if far not in rig.chambers:
                        reached.setdefault(far, reached[node])
    return found


def distances_from(rig: Rig, node: str) -> dict[str, tuple[float, tuple[str, ...]]]:
    """Shortest ways along pipes from a node.

    Args:
        rig: The rig.
        node: Where they start.

    Returns:
        Per node that pipes lead to, its distance in metres and the pipes on the way.
    """
    beside: dict[str, list[tuple[str, str]]] = {}
    for name in rig.pipes:
        start, end = end_nodes(rig, name)
        beside.setdefault(start, []).append((end, name))
        beside.setdefault(end, []).append((start, name))
    found: dict[str, tuple[float, tuple[str, ...]]] = {}
    waiting: list[tuple[float, str, tuple[str, ...]]] = [(0.0, node, ())]
    while waiting:
        distance, here, way = heapq.heappop(waiting)
        if here in found:
            continue
        found[here] = (distance, way)
        for there, pipe in beside.get(here, []):
            heapq.heappush(waiting, (distance + rig.pipes[pipe].length_m, there, (*way, pipe)))
    return found
