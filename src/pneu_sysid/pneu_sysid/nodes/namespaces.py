# SPDX-License-Identifier: Apache-2.0
"""In which namespace of the graph a rig is, whose topics are relative."""

from collections.abc import Iterable

from pneu_sim import topics
from pneu_sim.rig.schema import Rig


def relative_topics(rig: Rig) -> dict[str, str]:
    """Topics of a rig that a namespace decides about, and their types.

    Args:
        rig: The rig.
    """
    every = (*topics.tap_topics(rig), *topics.encoder_topics(rig), *topics.command_topics(rig))
    return {topic.name: topic.type for topic in every if not topic.name.startswith("/")}


def namespaces_of(rig: Rig, there: Iterable[tuple[str, Iterable[str]]]) -> list[str]:
    """Namespaces in which all relative topics of a rig are, in order of the alphabet.

    Args:
        rig: The rig.
        there: Topics of the graph, absolute, each with its types.

    Returns:
        None where not all are there yet; the root alone where no topic is relative.
    """
    wanted = relative_topics(rig)
    if not wanted:
        return ["/"]
    types = {name: tuple(of) for name, of in there}
    first = next(iter(wanted))
    found = {name[: -len(first)] for name in types if name.endswith(f"/{first}")}
    return sorted(
        base.rstrip("/") or "/"
        for base in found
        if all(kind in types.get(base + name, ()) for name, kind in wanted.items())
    )
