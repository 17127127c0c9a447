# SPDX-License-Identifier: Apache-2.0
"""Reducing a rig to closed volumes and sources."""

from dataclasses import dataclass

from pneu_common.errors import InputError
from pneu_sim.rig.expand import with_cylinders
from pneu_sim.rig.network import joined
from pneu_sim.rig.schema import Rig


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


def reduce_network(rig: Rig) -> Network:
    """Groups the pipes and chambers of a rig into closed volumes and sources.

    Args:
        rig: The rig.

    Raises:
        InputError: Two reservoirs are joined by pipes alone, no volume is closed, or cylinders are
            not locked or hold their gas in cells.
    """
    if rig.moves:
        raise InputError(
            f"rig {rig.name!r}: model: found {rig.model}, which moves no cylinders along"
            " recordings; use pde"
        )
    for name, cylinder in rig.cylinders.items():
        if cylinder.gas == "cells":
            raise InputError(
                f"rig {rig.name!r}: cylinders.{name}.gas: found cells, of which model {rig.model}"
                " has none; use chamber"
            )
    rig = with_cylinders(rig)
    group = joined(rig)
    source_of: dict[str, int] = {}
    for r, reservoir in enumerate(rig.reservoirs):
        other = source_of.setdefault(group[reservoir], r)
        if other != r:
            raise InputError(
                f"rig {rig.name!r}: model {rig.model!r} needs lines that end closed or at a valve,"
                f" found reservoirs {list(rig.reservoirs)[other]!r} and {reservoir!r} joined by"
                " pipes alone; use model 'pde'"
            )
    roots = [root for root in dict.fromkeys(group.values()) if root not in source_of]
    number = {node: k for k, node in enumerate(roots)} | {n: -1 - r for n, r in source_of.items()}
    if not roots:
        raise InputError(
            f"rig {rig.name!r}: model {rig.model!r} needs a closed volume to fill, found every pipe"
            " and chamber open to a reservoir; use model 'pde'"
        )
    of_pipe = {name: number[group[f"pipe:{name}"]] for name in rig.pipes}
    of_node = {node: number[root] for node, root in group.items()}
    volumes = [
        Volume(
            pipes=tuple(name for name in rig.pipes if of_pipe[name] == k),
            chambers=tuple(name for name in rig.chambers if of_node[name] == k),
        )
        for k in range(len(roots))
    ]
    return Network(volumes, of_node, of_pipe)
