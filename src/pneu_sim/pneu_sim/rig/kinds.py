# SPDX-License-Identifier: Apache-2.0
"""Kinds of model by name: what a rig's `model` may say, and where each is to be found.

Other distributions add theirs under the entry-point group `pneu.models`; see
`pneu_sim.models.ModelKind`.
"""

from importlib.metadata import EntryPoint, entry_points

GROUP = "pneu.models"
BUILT_IN = {
    "pde": "pneu_sim.full:Full",
    "thin_plate": "pneu_sim.lumped.kinds:ThinPlate",
    "delay_line": "pneu_sim.lumped.kinds:DelayLine",
}
"""One line per kind."""
STILL = ("delay_line",)
"""Those that move no pistons."""


def known() -> dict[str, EntryPoint]:
    """Where every kind is to be found, by name."""
    added = {point.name: point for point in entry_points(group=GROUP)}
    return {name: found(name) for name in BUILT_IN} | added


def found(name: str) -> EntryPoint:
    """Where a kind is to be found; to look for those of other distributions takes a while.

    Args:
        name: Its name, one of `known`.
    """
    where = BUILT_IN.get(name)
    return known()[name] if where is None else EntryPoint(name, where, GROUP)


def checked(name: str) -> str:
    """A name, if there is such a kind.

    Args:
        name: The name.

    Raises:
        ValueError: There is none.
    """
    if name not in BUILT_IN and name not in known():
        raise ValueError(f"there is no such model, known are {', '.join(known())}")
    return name
