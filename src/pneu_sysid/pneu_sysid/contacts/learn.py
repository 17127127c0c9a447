# SPDX-License-Identifier: Apache-2.0
"""Effect after effect added to a scene, until none makes what is kept aside better predicted."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from pneu_sysid.contacts.diagnose import Finalist, SceneDiagnosis, diagnose_scene
from pneu_sysid.contacts.estimate import Tell
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.scene import Loaded, Value, save_scene
from pneu_sysid.contacts.sureness import per_knot
from pneu_sysid.contacts.track import Track
from pneu_sysid.results.base import Verdict

MOST_EFFECTS = 3


@dataclass
class SceneLearned:
    """Outcome of the loop.

    Attributes:
        values: Effects of the scene with all that was added.
        added: What was added, in order.
        diagnoses: The diagnosis before each addition, and the last one.
        losses: Cost per knot kept aside: of the base, then after each addition.
        verdict: Over all that was added.
        sentence: In words.
    """

    values: tuple[Value, ...]
    added: list[Finalist] = field(default_factory=list)
    diagnoses: list[SceneDiagnosis] = field(default_factory=list)
    losses: list[float] = field(default_factory=list)
    verdict: Verdict = "nothing_missing"
    sentence: str = ""


def learn_scene(
    loaded: Loaded,
    tracks: Sequence[Track],
    out: Path | None = None,
    physics: Physics | None = None,
    tell: Tell | None = None,
    most: int = MOST_EFFECTS,
) -> SceneLearned:
    """Adds effects to a scene until none is worth it.

    Args:
        loaded: The scene.
        tracks: Its recordings.
        out: Folder that receives ``step_<n>.yaml`` after every step.
        physics: What evaluates models.
        tell: Called with a note and the fraction done.
        most: Effects that are added, at most.

    Returns:
        What was learned.
    """
    physics = physics or Physics()
    said = tell or (lambda note, done: None)
    state = SceneLearned(loaded.scene.values)
    for number in range(most + 1):
        share = 1.0 / (most + 1)

        def part(note: str, done: float, k: int = number, share: float = share) -> None:
            said(f"effect {k + 1}: {note}", (k + done) * share)

        found = diagnose_scene(loaded, tracks, state.values, physics, part)
        state.diagnoses.append(found)
        if not state.losses:
            state.losses.append(per_knot(found.held))
            state.values = found.base.values
            _keep(loaded, state, out)
        if found.verdict == "nothing_missing" or number == most:
            break
        best = found.finalists[0]
        state.added.append(best)
        state.values = best.fit.values
        state.losses.append(per_knot(best.held))
        _keep(loaded, state, out)
    first = state.diagnoses[0]
    state.verdict = first.verdict
    if not state.added:
        state.sentence = first.sentence
        return state
    parts = [f.words for f in state.added]
    state.sentence = (
        f"Missing: {' and '.join(parts)}; with that the cost per knot kept aside falls from"
        f" {state.losses[0]:.3g} to {state.losses[-1]:.3g}"
    )
    alike = sorted({label for f in state.added for label in f.alike})
    if alike:
        state.verdict = "ambiguous"
        state.sentence += f"; not to be told from {', '.join(alike)}"
    else:
        state.verdict = "effect"
    state.sentence += "."
    return state


def _keep(loaded: Loaded, state: SceneLearned, out: Path | None) -> None:
    if out is not None:
        save_scene(loaded, state.values, out / f"step_{len(state.added)}.yaml")
