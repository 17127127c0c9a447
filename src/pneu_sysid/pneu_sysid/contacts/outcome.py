# SPDX-License-Identifier: Apache-2.0
"""What was found of a scene, as the results that go into JSON."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pneu_common.installed import version
from pneu_sysid.contacts.diagnose import SceneDiagnosis
from pneu_sysid.contacts.effects.base import Setup
from pneu_sysid.contacts.estimate import Problem, State
from pneu_sysid.contacts.fit import SceneFit
from pneu_sysid.contacts.foresee import Foreseen
from pneu_sysid.contacts.learn import SceneLearned
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.scene import Loaded
from pneu_sysid.contacts.track import Track
from pneu_sysid.results.scenes import (
    Misread,
    SceneCandidate,
    SceneCompareResult,
    SceneDiagnoseResult,
    SceneFitResult,
    SceneLearnResult,
    SceneParameter,
    SceneStep,
)

UNITS = {"framepos": "m", "framequat": "rad", "jointpos": "rad or m", "gyro": "rad/s"}
"""Units of what sensors of usual kinds are off by."""
OTHERS = {"accelerometer": "m/s^2", "force": "N", "torque": "N m", "jointvel": "rad/s or m/s"}


def _head(path: Path, loaded: Loaded, tracks: Sequence[Track]) -> dict[str, object]:
    setup = loaded.setup()
    return {
        "pneu_version": version(),
        "scene": str(path),
        "recordings": [track.name for track in tracks],
        "sensors": {name: unit_of(setup, name) for name in loaded.names},
        "findings": [f"{t.name}: {f}" for t in tracks for f in t.findings],
    }


def unit_of(setup: Setup, sensor: str) -> str:
    """Unit of what a sensor is off by.

    Args:
        setup: The scene.
        sensor: Its name.
    """
    kind = setup.spec.sensor(sensor).type.name.removeprefix("mjSENS_").lower()
    return (UNITS | OTHERS).get(kind, "of the sensor")


def result_of_fit(
    path: Path, output: Path | None, found: SceneFit, tracks: Sequence[Track], seconds: float | None
) -> SceneFitResult:
    """The JSON result of a fit.

    Args:
        path: Scene file it started from.
        output: Scene file written.
        found: The fit.
        tracks: The recordings.
        seconds: How long it took, s.
    """
    loaded = found.loaded
    before = loaded.setup(loaded.scene.values)
    parameters = []
    for k, p in enumerate(found.parameters):
        value, error = found.told(k)
        near = 1e-6 * (p.upper - p.lower)
        parameters.append(
            SceneParameter(
                effect=p.effect.name, place=p.place, value=value, std_error=error,
                start=p.effect.value(before, p.place), unit=p.effect.unit,
                at_bound=value <= p.lower + near or value >= p.upper - near,
            )
        )  # fmt: skip
    problem = Problem(loaded, found.chains, found.values, [], Physics())
    said, model, setup = problem.outputs(State(found.q, np.zeros(0)))
    rows = [c.rows(o, setup, plain=True) for c, o in zip(found.chains, said, strict=True)]
    force = np.sqrt(np.nanmean(np.concatenate([f for f, _ in rows]) ** 2, axis=0))
    read = np.concatenate([r for _, r in rows])
    rmse: dict[str, float | None] = {}
    at = 0
    for channel in found.chains[0].channels:
        part = read[:, at : at + channel.size]
        rmse[channel.name] = float(np.sqrt(np.nanmean(np.sum(part**2, axis=1))))
        at += channel.size
    unknowns = sum(q.shape[0] * int(model.nv) for q in found.q) + len(found.x)
    return SceneFitResult(
        **_head(path, loaded, tracks),  # type: ignore[arg-type]
        output=None if output is None else str(output),
        parameters=parameters,
        unknowns=unknowns,
        history=list(found.estimated.history),
        converged=found.estimated.converged,
        loss={t.name: float(x) for t, x in zip(tracks, found.loss, strict=True)},
        force={name: float(x) for name, x in zip(dof_names(model), force, strict=True)},
        rmse=rmse,
        notes=found.notes,
        seconds=seconds,
    )


def dof_names(model: object) -> list[str]:
    """A name for each direction of motion, as ``joint`` or ``joint.x``, turns as ``joint.rx``.

    Args:
        model: An ``MjModel``.
    """
    out = []
    for j in range(model.njnt):  # type: ignore[attr-defined]
        name = model.joint(j).name  # type: ignore[attr-defined]
        kind = int(model.jnt_type[j])  # type: ignore[attr-defined]
        moves = [f"{name}.{a}" for a in "xyz"]
        turns = [f"{name}.r{a}" for a in "xyz"]
        out += {0: moves + turns, 1: turns}.get(kind, [name])
    return out


def result_of_compare(
    path: Path, loaded: Loaded, tracks: Sequence[Track], foreseen: Sequence[Foreseen]
) -> SceneCompareResult:
    """The JSON result of a comparison.

    Args:
        path: Scene file.
        loaded: The scene.
        tracks: The recordings.
        foreseen: What was foretold of each.
    """
    off = {}
    for f in foreseen:
        off[f.track.name] = {
            name: Misread(
                mean=float(np.mean(x)), rms=float(np.sqrt(np.mean(x**2))), last=float(x[-1])
            )
            for name, x in f.off.items()
        }
    means = {name: [f.mean(name) for f in foreseen] for name in loaded.names}
    return SceneCompareResult(
        **_head(path, loaded, tracks),  # type: ignore[arg-type]
        start_s=loaded.scene.start_s,
        off=off,
        mean={name: float(np.mean(x)) for name, x in means.items()},
        median={name: float(np.median(x)) for name, x in means.items()},
    )


def result_of_diagnosis(
    path: Path, loaded: Loaded, tracks: Sequence[Track], found: SceneDiagnosis
) -> SceneDiagnoseResult:
    """The JSON result of a diagnosis.

    Args:
        path: Scene file.
        loaded: The scene.
        tracks: The recordings.
        found: The diagnosis.
    """
    refitted = {f.label: f for f in found.finalists}
    order = [*(f.score for f in found.finalists)]
    order += [s for s in found.scores.scores if s.parameter.label not in refitted]
    candidates = []
    for score in order:
        p, f = score.parameter, refitted.get(score.parameter.label)
        candidates.append(
            SceneCandidate(
                effect=p.effect.name, title=p.effect.title, place=p.place, unit=p.effect.unit,
                score=score.gain, step=score.step, step_t=score.t,
                strength=None if f is None else f.strength,
                std_error=None if f is None else f.std_error,
                held_out_gain=None if f is None else f.gain,
                significance=None if f is None else f.lead,
                indistinguishable_from=[] if f is None else f.alike,
                tested=f is not None,
            )
        )  # fmt: skip
    return SceneDiagnoseResult(
        **_head(path, loaded, tracks),  # type: ignore[arg-type]
        verdict=found.verdict,
        sentence=found.sentence,
        used=found.used,
        aside=found.aside,
        candidates=candidates,
    )


def result_of_learning(
    path: Path, loaded: Loaded, tracks: Sequence[Track], found: SceneLearned, output: Path | None
) -> SceneLearnResult:
    """The JSON result of the loop.

    Args:
        path: Scene file.
        loaded: The scene.
        tracks: The recordings.
        found: What was learned.
        output: Folder of the results.
    """
    steps = [SceneStep(step=0, added=None, held_out_loss=found.losses[0])]
    for k, f in enumerate(found.added):
        p = f.score.parameter
        steps.append(
            SceneStep(
                step=k + 1, added=p.effect.name, place=p.place, strength=f.strength,
                std_error=f.std_error, unit=p.effect.unit, held_out_loss=found.losses[k + 1],
            )
        )  # fmt: skip
    return SceneLearnResult(
        **_head(path, loaded, tracks),  # type: ignore[arg-type]
        steps=steps,
        verdict=found.verdict,
        sentence=found.sentence,
        output=None if output is None else str(output),
    )
