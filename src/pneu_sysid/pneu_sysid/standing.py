# SPDX-License-Identifier: Apache-2.0
"""How a model stands to recordings: against what its calibration left, and against the noise."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.schema import Rig
from pneu_sysid.problem import Problem
from pneu_sysid.thresholds import Thresholds

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Standing:
    """How a model does on recordings.

    Attributes:
        own: Whether one of the recordings is one that it was calibrated on.
        calibrated: Whether it was calibrated at all.
        floor: (n_sensors,) error that it cannot be blamed for, in noise deviations: what its
            calibration left, or the noise alone where the recording is the calibration's own.
        excess: (n_recordings,) squared error over that floor.
        times_noise: Root mean square error in noise deviations, over all taps and recordings.
        by_tap: The same per tap.
        changed: Recordings that differ from the calibration.
        explains: Whether the model explains the measurement to the noise.
    """

    own: bool
    calibrated: bool
    floor: Floats
    excess: Floats
    times_noise: float
    by_tap: dict[str, float]
    changed: list[str]
    explains: bool


def floor_of(rig: Rig, problem: Problem) -> Floats:
    """(n_sensors,) what the model cannot be blamed for, over the noise: 1, or what a fit left.

    On a recording that it was calibrated on, nothing but the noise excuses it: what was fitted
    there should have left no more.

    Args:
        rig: The rig; its calibration tells how well it did on its own recording.
        problem: The problem.
    """
    floor = np.ones(len(problem.taps))
    if rig.calibration is not None and not is_own(rig, problem):
        for k, tap in enumerate(problem.taps):
            left = rig.calibration.left.get(tap)
            if left is not None:
                floor[k] = max(1.0, left / problem.noise_pa[k])
    return floor


def is_own(rig: Rig, problem: Problem) -> bool:
    """Whether a rig was calibrated on one of the recordings.

    Args:
        rig: The rig.
        problem: The problem.
    """
    if rig.calibration is None:
        return False
    own = rig.calibration.recordings or [rig.calibration.recording]
    return any(recording.name in own for recording in problem.recordings)


def standing_of(rig: Rig, problem: Problem, residual: Floats, thresholds: Thresholds) -> Standing:
    """How a model stands to recordings.

    Args:
        rig: The rig.
        problem: The problem.
        residual: (n_stretches, horizon * n_taps) its residual in noise deviations.
        thresholds: What decides.
    """
    floor = floor_of(rig, problem)
    r = residual.reshape(problem.measured.shape)
    count = np.isfinite(problem.measured).sum(axis=1)  # (n_stretches, n_taps)
    square = np.sum(r**2, axis=1)
    excess = np.array(
        [
            float(square[problem.of == c].sum())
            / max(float(np.sum(count[problem.of == c] * floor**2)), 1e-300)
            for c in range(len(problem.recordings))
        ]
    )
    total = np.sqrt(square.sum(axis=0) / np.maximum(count.sum(axis=0), 1))
    differs = excess > thresholds.unexplained
    differs |= excess > thresholds.apart * max(float(excess.min()), 1.0)
    times_noise = float(np.sqrt(square.sum() / max(int(count.sum()), 1)))
    return Standing(
        own=is_own(rig, problem),
        calibrated=rig.calibration is not None,
        floor=floor,
        excess=excess,
        times_noise=times_noise,
        by_tap={tap: float(v) for tap, v in zip(problem.taps, total, strict=True)},
        changed=[
            recording.name
            for recording, is_other in zip(problem.recordings, differs, strict=True)
            if is_other
        ],
        explains=times_noise <= thresholds.at_noise,
    )


def since_calibration(standing: Standing, names: list[str], found: bool) -> str:
    """What changed since the calibration, in one sentence.

    Args:
        standing: How the model stands.
        names: Names of the recordings.
        found: Whether an effect was found that explains what changed.
    """
    if not standing.calibrated:
        return "The model was never calibrated, so nothing can be said of a change since."
    if standing.own:
        return "The model was calibrated on this very recording, so nothing can have changed since."
    changed = standing.changed
    if changed and len(changed) < len(names):
        others = [name for name in names if name not in changed]
        return (
            f"Something changed in {', '.join(changed)} since the calibration, and nothing in"
            f" {', '.join(others)}."
        )
    if changed or found:
        return "Something changed since the calibration."
    return "Nothing changed since the calibration."


def against_noise(standing: Standing, thresholds: Thresholds) -> str:
    """Whether the model explains the measurement to the noise, in one sentence.

    Args:
        standing: How the model stands.
        thresholds: What decides.
    """
    if standing.explains:
        return (
            f"The model explains the measurement to the noise ({standing.times_noise:.2f} times)."
        )
    worst = max(standing.by_tap, key=lambda tap: standing.by_tap[tap])
    text = (
        f"The model leaves {standing.times_noise:.2f} times the noise, most at {worst}"
        f" ({standing.by_tap[worst]:.2f})"
    )
    floor = float(np.sqrt(np.mean(standing.floor**2)))
    if standing.calibrated and not standing.own and floor > thresholds.at_noise:
        text += f"; {floor:.2f} times were left where it was calibrated"
    return text + "."
