# SPDX-License-Identifier: Apache-2.0
"""Which pipes and chambers of a rig hang together without a valve or an orifice between."""

from pneu_sim.rig.schema import CLOSED, Rig, Tap


def volumes_of(rig: Rig) -> tuple[dict[str, str], set[str]]:
    """Which nodes and pipes hang together without a valve between, and which meet a reservoir.

    Args:
        rig: The rig.

    Returns:
        Volume (any one of its nodes or pipes) of every node and ``pipe:name``, and the fed ones.
    """
    root: dict[str, str] = {}

    def find(item: str) -> str:
        root.setdefault(item, item)
        while root[item] != item:
            item = root[item]
        return item

    for node in rig.chambers:
        find(node)
    for name, pipe in rig.pipes.items():
        for node in (pipe.from_node, pipe.to_node):
            if node != CLOSED and node not in rig.reservoirs:
                root[find(f"pipe:{name}")] = find(node)
    volume = {item: find(item) for item in [*root, *(f"pipe:{name}" for name in rig.pipes)]}
    fed = {
        volume[f"pipe:{name}"]
        for name, pipe in rig.pipes.items()
        if pipe.from_node in rig.reservoirs or pipe.to_node in rig.reservoirs
    }
    return volume, fed


def volume_of_tap(volume: dict[str, str], tap: Tap) -> str:
    """The volume that a tap sits in.

    Args:
        volume: As of `volumes_of`.
        tap: The tap.
    """
    return volume[f"pipe:{tap.pipe}" if tap.pipe is not None else str(tap.chamber)]
