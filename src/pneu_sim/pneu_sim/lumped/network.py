# SPDX-License-Identifier: Apache-2.0
"""Reducing a rig to closed volumes and sources, and distances along its lines."""

import heapq
from dataclasses import dataclass

from pneu_common.errors import InputError
from pneu_sim.rig.schema import CLOSED, Rig


@dataclass(frozen=True)
class Volume:
    """Pipes and chambers that share one pressure, apart from the rest by ports alone.

    Attributes:
        pipes: Names of its pipes.
        chambers: Names of its chambers.
    """

    pipes: tuple[str, ...]
    chambers: tuple[str, ...]


@dataclass(frozen=True)
class Network:
    """What a lumped model makes of a rig.

    A place of the rig belongs to a volume, given by its number from 0 on, or to a source, given as
    ``-1 - k`` for the rig's k-th reservoir: a line open to a reservoir has its pressure.

    Attributes:
        volumes: The closed volumes.
        of_node: Per node, chamber and reservoir, where it belongs.
        of_pipe: Per pipe, where it belongs.
    """

    volumes: list[Volume]
    of_node: dict[str, int]
    of_pipe: dict[str, int]


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


def reduce_network(rig: Rig) -> Network:
    """Groups the pipes and chambers of a rig into closed volumes and sources.

    Args:
        rig: The rig.

    Raises:
        InputError: Two reservoirs are joined by pipes alone, or no volume is closed.
    """
    group = {node: node for node in (*rig.reservoirs, *rig.chambers)}

    def root(node: str) -> str:
        while group.setdefault(node, node) != node:
            node = group[node]
        return node

    for pipe in rig.pipes:
        start, end = end_nodes(rig, pipe)
        group[root(end)] = root(start)
    source_of: dict[str, int] = {}
    for r, reservoir in enumerate(rig.reservoirs):
        other = source_of.setdefault(root(reservoir), r)
        if other != r:
            raise InputError(
                f"rig {rig.name!r}: model {rig.model!r} needs lines that end closed or at a valve,"
                f" found reservoirs {list(rig.reservoirs)[other]!r} and {reservoir!r} joined by"
                " pipes alone; use model 'pde'"
            )
    roots = [node for node in group if root(node) == node and node not in source_of]
    number = {node: k for k, node in enumerate(roots)} | {n: -1 - r for n, r in source_of.items()}
    if not roots:
        raise InputError(
            f"rig {rig.name!r}: model {rig.model!r} needs a closed volume to fill, found every pipe"
            " and chamber open to a reservoir; use model 'pde'"
        )
    of_pipe = {name: number[root(end_nodes(rig, name)[0])] for name in rig.pipes}
    of_node = {node: number[root(node)] for node in list(group)}
    volumes = [
        Volume(
            pipes=tuple(name for name in rig.pipes if of_pipe[name] == k),
            chambers=tuple(name for name in rig.chambers if of_node[name] == k),
        )
        for k in range(len(roots))
    ]
    return Network(volumes, of_node, of_pipe)


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
