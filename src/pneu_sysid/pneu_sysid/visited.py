# SPDX-License-Identifier: Apache-2.0
"""How far recordings open the ports of a rig: beyond that a calibration rests on the rig file."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pneu_sim.rig import rig_in_recording
from pneu_sim.rig.build import build
from pneu_sim.rig.plan import plan_grid
from pneu_sim.rig.schema import Rig
from pneu_sim.simulate import TICK_S
from pneu_sim.valve import evenly_open
from pneu_sysid.problem import Problem
from pneu_sysid.records import Recording

WIDE = 0.75
"""A port that was never so far open, of its full opening, is told."""
SOON_S = 0.05
"""What lasts less, all recordings together, tells nothing of an opening."""


def opened_to(rig: Rig, recordings: Sequence[Recording]) -> dict[str, float]:
    """How far each port was opened, as a part of its full opening, for ``SOON_S`` at least.

    Args:
        rig: The rig.
        recordings: The recordings.

    Returns:
        By the names of valve and port, `valve.port`.
    """
    plan = plan_grid(rig)
    if not plan.valves:
        return {}
    seen: list[np.ndarray] = []
    for recording in recordings:
        model = build(rig_in_recording(rig, recording.name), plan)
        begin = min(float(s.time_s[0]) for s in recording.commands.values())
        count = max(int((recording.end_s - begin) / TICK_S), 2)
        opened = evenly_open(model, recording.commands, begin, TICK_S, count)
        seen.append(opened / model.curve.max(axis=1))
    parts = -np.sort(-np.concatenate(seen), axis=0)
    rank = min(round(SOON_S / TICK_S), len(parts) - 1)
    return {name: float(part) for name, part in zip(plan.port_names, parts[rank], strict=True)}


def visited(rig: Rig, problem: Problem) -> dict[str, Any]:
    """Where recordings have been, and what is kept aside of them, as plain data.

    Args:
        rig: The rig.
        problem: The recordings.
    """
    measured = problem.measured
    return {
        "seconds": sum(r.end_s - r.start_s for r in problem.recordings),
        "openings": opened_to(rig, problem.recordings),
        "ranges": {
            name: [float(np.nanmin(measured[:, :, k])), float(np.nanmax(measured[:, :, k]))]
            for k, name in enumerate(problem.taps)
            if np.isfinite(measured[:, :, k]).any()
        },
        "words": words_on_openings(rig, problem.recordings),
        "stretches": problem.stretches,
        "kept_aside": int(problem.held_out.sum()),
    }


def never_wide(rig: Rig, recordings: Sequence[Recording]) -> dict[str, float]:
    """Ports that recordings never open wide, and how far they open them.

    Args:
        rig: The rig.
        recordings: The recordings.
    """
    return {name: part for name, part in opened_to(rig, recordings).items() if part < WIDE}


def words_on_openings(rig: Rig, recordings: Sequence[Recording]) -> str | None:
    """One sentence on the ports that recordings never open wide; None where they open all.

    Args:
        rig: The rig.
        recordings: The recordings.
    """
    short = never_wide(rig, recordings)
    if not short:
        return None
    named = ", ".join(f"{name} by more than {100.0 * part:.0f} %" for name, part in short.items())
    return (
        f"never open: {named}; beyond that the calibration follows the rig file, and a recording"
        " that opens them wide would tell"
    )
