# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis could not tell apart, as rigs that have it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pneu_common.errors import InputError
from pneu_sim.effects import find_effect
from pneu_sim.effects.base import POSITION
from pneu_sim.rig.schema import AttachedEffect, Rig
from pneu_sysid.results.diagnose import Candidate, DiagnoseResult
from pneu_sysid.results.files import read_json
from pneu_sysid.sites import Site

MOST = 4
"""Candidates that are told apart at once."""
NEAR = 0.7
"""Candidates count that explain this share of what the best one does: what is just told from it in
one recording may be its look-alike in another."""
ELSEWHERE = 0.15
"""Where a candidate may be farther along its pipe than this share of it, it is tried there too: two
that are told apart where a recording happens to put them need not be where they are."""
PLACES = 5
"""So many places are tried of where it may be, from end to end: a volume a quarter of the way along
a tube is more like a longer tube than a volume at either end."""


@dataclass(frozen=True)
class Hypothesis:
    """A candidate for what a rig is missing.

    Attributes:
        label: Effect and place.
        rig: The rig with it, the last of its effects, at what was found.
    """

    label: str
    rig: Rig

    @property
    def part(self) -> str:
        """Effect and part of the rig, wherever along it."""
        return part_of(self.label)


def part_of(label: str) -> str:
    """Effect and part of the rig of a label, wherever along it.

    Args:
        label: Effect and place.
    """
    return label.split(":")[0]


def hypotheses_of(rig: Rig, result: DiagnoseResult, source: Path | str) -> list[Hypothesis]:
    """The best candidate of a diagnosis, those that it is not told from, and what comes near.

    Args:
        rig: The rig that was diagnosed.
        result: The diagnosis.
        source: Its file.

    Raises:
        InputError: It is of another rig, or left nothing to be told apart.
    """
    if rig.name not in result.rigs:
        raise InputError(
            f"{source}: is a diagnosis of {', '.join(result.rigs)}, and not of rig {rig.name!r}"
        )
    tested = [c for c in result.candidates if c.tested and c.strength is not None]
    if result.verdict == "nothing_missing" or len(tested) < 2:
        raise InputError(
            f"{source}: its verdict is {result.verdict} with {len(tested)} candidates that were"
            " tried; at least two are needed that are to be told apart"
        )
    best, *others = tested
    tied = [c for c in others if _label(c) in best.indistinguishable_from]
    least = NEAR * max(c.held_out_gain or 0.0 for c in tested)
    near = [c for c in others if c not in tied and (c.held_out_gain or 0.0) >= least]
    chosen = [best, *tied, *near]
    if len(chosen) < 2:  # of a verdict that is in doubt for another reason
        chosen.append(others[0])
    every = [one for c in chosen[:MOST] for one in (c, *_elsewhere(rig, c))]
    return [_hypothesis(rig, c, source) for c in every]


def _elsewhere(rig: Rig, candidate: Candidate) -> list[Candidate]:
    """A candidate where it may be as well."""
    if candidate.places_m is None or candidate.place not in rig.pipes:
        return []
    far = ELSEWHERE * rig.pipes[candidate.place].length_m
    low, high = candidate.places_m
    return [
        candidate.model_copy(
            update={"position_m": at, "parameters": {**candidate.parameters, POSITION: at}}
        )
        for at in np.linspace(low, high, PLACES).tolist()
        if abs(at - (candidate.position_m or 0.0)) > far
    ]


def _hypothesis(rig: Rig, candidate: Candidate, source: Path | str) -> Hypothesis:
    if not candidate.parameters:
        raise InputError(
            f"{source}: candidates: {_label(candidate)} has no parameters; it was made by an"
            " earlier version, and `pneu diagnose --json` makes it anew"
        )
    values = {k: float(v) for k, v in candidate.parameters.items() if v is not None}
    extra = AttachedEffect(effect=candidate.effect, place=candidate.place, parameters=values)
    return Hypothesis(_label(candidate), rig.model_copy(update={"effects": [*rig.effects, extra]}))


def _label(candidate: Candidate) -> str:
    shape = {} if candidate.position_m is None else {POSITION: candidate.position_m}
    return Site(find_effect(candidate.effect), candidate.place, shape).label


def read_diagnosis(path: Path) -> DiagnoseResult:
    """Reads the result of ``pneu diagnose --json``.

    Args:
        path: The file.

    Raises:
        InputError: It is none.
    """
    result = read_json(path)
    if not isinstance(result, DiagnoseResult):
        raise InputError(f"{path}: is no result of `pneu diagnose --json`")
    return result
