# SPDX-License-Identifier: Apache-2.0
"""The model run forwards from an estimated trajectory, and parameters fitted to what it predicts.

A trajectory with forces that nobody applied can follow readings whatever the model; a roll-out
cannot. It starts anew every now and then (thesis 8.1.2), as lines of gas do, so that an impact that
went another way is not held against what came before.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_sim.mechanism.loading import mujoco_module
from pneu_sysid.contacts.bearings import bearings_of
from pneu_sysid.contacts.chain import Chain, Outputs
from pneu_sysid.contacts.effects.base import SceneEffect, Setup
from pneu_sysid.contacts.estimate import Problem
from pneu_sysid.contacts.physics import Motion, Physics

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Tell = Callable[[str, float], None]

HUBER = 3.0
"""Misreadings beyond this many of their standard deviations count linearly."""


def starts_of(chain: Chain, horizon_s: float) -> Ints:
    """Knots at which roll-outs begin: one after another, each as long as the last.

    Args:
        chain: The knots.
        horizon_s: How long each runs; infinite for one over all.
    """
    t = chain.time_s
    if not np.isfinite(horizon_s) or horizon_s >= t[-1] - t[0]:
        return np.array([0])
    count = max(1, round((t[-1] - t[0]) / horizon_s))
    marks = t[0] + (t[-1] - t[0]) * np.arange(count) / count
    return np.unique(np.clip(np.searchsorted(t, marks - 1e-9), 0, len(t) - 3))


def rolled_out(chain: Chain, model: Any, setup: Setup, q: Floats, starts: Ints) -> Motion:
    """Runs a model from several knots of a trajectory, each until the next begins.

    Args:
        chain: The knots.
        model: The model.
        setup: The scene it is made from.
        q: (n, nq) the trajectory; of each start and the knot after it alone.
        starts: Where roll-outs begin.

    Returns:
        The motion; NaN from where a roll-out ran away.
    """
    mujoco = mujoco_module()
    man = chain.manifold
    h = np.diff(chain.time_s) * setup.clock
    out = np.full((chain.size, man.nq), np.nan)
    vel = np.full((chain.size, man.nv), np.nan)
    acc = np.full((chain.size, man.nv), np.nan)
    data = mujoco.MjData(model)
    drag = np.zeros(man.nv)
    drag[chain.free.ravel()] = setup.drag
    forward = mujoco.mj_forward
    bearings = bearings_of(model, setup.loaded)
    plain = not len(man.turns_q)
    for number, first in enumerate(starts):
        last = chain.size - 1 if number + 1 == len(starts) else int(starts[number + 1]) - 1
        at = q[first]
        v = man.between(q[first : first + 1], q[first + 1 : first + 2])[0] / h[first]
        out[first], vel[first] = at, v
        data.qacc_warmstart[:] = 0.0
        slowed: Floats | None = None
        for i in range(first, last):
            if i > first:
                data.qpos[:] = at
                data.qvel[:] = v
                if model.nu:
                    data.ctrl[:] = chain.control[i]
                data.qfrc_applied[:] = -drag * v
                if slowed is not None and bearings is not None:
                    data.qfrc_applied[bearings.along] -= slowed
                forward(model, data)
                acc[i] = data.qacc
                if bearings is not None:  # by what it carried a step before
                    slowed = bearings.slowing(model, data, h[i])
                v = v + 0.5 * (h[i] + h[i - 1]) * data.qacc
                if not np.max(np.abs(v)) < 1e6:
                    break
            if plain:
                at = at + h[i] * v
            else:
                data.qpos[:] = at
                mujoco.mj_integratePos(model, data.qpos, v, h[i])
                at = data.qpos.copy()
            out[i + 1], vel[i + 1] = at, v
        acc[first] = acc[first + 1] if first + 1 < chain.size else 0.0
    return Motion(out, vel, acc, chain.control)


@dataclass(frozen=True)
class Prediction:
    """What roll-outs predicted along one chain.

    Attributes:
        motion: The motion.
        misread: (n, R) residuals of sensors, NaN where there is none; where a roll-out ran away,
            a large number.
        chain: The chain.
        starts: Where roll-outs began.
    """

    motion: Motion
    misread: Floats
    chain: Chain
    starts: Ints


LOST = 1e3
"""Misreading, in standard deviations, of a roll-out that ran away."""


def predicted(
    problem: Problem,
    model: Any,
    setup: Setup,
    q: Sequence[Floats],
    horizon_s: float,
) -> list[Prediction]:
    """Predicts every chain of a problem from its estimated trajectory.

    Args:
        problem: The problem.
        model: The model.
        setup: The scene it is made from.
        q: Trajectory of each chain.
        horizon_s: How long each roll-out is.
    """
    alone = Physics(1)  # each chain in a thread of its own

    def one(chain: Chain, at: Floats) -> Prediction:
        starts = starts_of(chain, horizon_s)
        motion = rolled_out(chain, model, setup, at, starts)
        there = motion.there
        safe = motion.whole(at)
        sensors = alone.evaluate(model, safe)[1]
        outputs = Outputs(np.zeros_like(safe.v), sensors, safe)
        _, misread = chain.rows(outputs, setup)
        lost = ~there[:, None] & np.isfinite(misread)
        return Prediction(
            motion, np.where(lost, LOST * chain.sensor_sigma(), misread), chain, starts
        )

    return problem.physics.each(one, problem.chains, q)


@dataclass(frozen=True)
class Polished:
    """Parameters fitted to what a model predicts.

    Attributes:
        x: (c,) their coordinates.
        std_errors: (c,) by leaving out one recording after another, to first order.
        loss: (chains,) mean Huber loss of each, in standard deviations of what is misread.
        history: Mean loss after each step, the start first.
    """

    x: Floats
    std_errors: Floats
    loss: Floats
    history: list[float]


def scales_of(predictions: Sequence[Prediction]) -> Floats:
    """(R,) how far predictions are off at each component, robustly; of nothing less than noise.

    Args:
        predictions: They.
    """
    rows = np.concatenate([np.abs(p.misread) for p in predictions])
    chain = predictions[0].chain
    sigma = chain.sensor_sigma()
    usual = 1.4826 * np.nanmedian(rows, axis=0)
    out = np.empty_like(usual)
    at = 0
    for channel in chain.channels:  # all components of a sensor alike
        here = slice(at, at + channel.size)
        out[here] = max(float(np.sqrt(np.mean(usual[here] ** 2))), float(sigma[at]))
        at += channel.size
    return out


def huber(z: Floats) -> Floats:
    """Huber's loss of misreadings in standard deviations.

    Args:
        z: They.
    """
    size = np.abs(z)
    return np.where(size <= HUBER, 0.5 * z**2, HUBER * (size - 0.5 * HUBER))


def huber_weight(z: Floats) -> Floats:
    """Return the slope of Huber's loss over the misreading.

    Args:
        z: Misreadings in standard deviations.
    """
    return np.asarray(np.minimum(1.0, HUBER / np.maximum(np.abs(z), 1e-12)))


def losses(predictions: Sequence[Prediction], scales: Floats) -> Floats:
    """(chains,) mean Huber loss per reading of each chain.

    Args:
        predictions: What was predicted.
        scales: (R,) standard deviations.
    """
    return np.array([float(np.nanmean(huber(p.misread / scales))) for p in predictions])


def polish(
    problem: Problem,
    x: Floats,
    q: Sequence[Floats],
    horizon_s: float,
    iterations: int = 8,
    scales: Floats | None = None,
    tell: Tell | None = None,
) -> Polished:
    """Fits parameters to what roll-outs predict, trajectories held.

    Args:
        problem: The problem.
        x: (c,) coordinates to start from.
        q: Trajectory of each chain.
        horizon_s: How long roll-outs are.
        iterations: Steps of Gauss and Newton, at most.
        scales: See `scales_of`; of the start unless given.
        tell: Called with a note and the fraction done.

    Returns:
        What was found.
    """
    low, high = problem.bounds()

    def run(at: Floats) -> list[Prediction]:
        model, setup = problem.model(at)
        return predicted(problem, model, setup, q, horizon_s)

    here = run(x)
    if scales is None:
        scales = scales_of(here)

    def total(predictions: list[Prediction]) -> float:
        return float(np.mean(losses(predictions, scales)))

    now = total(here)
    history = [now]
    steps = np.array([_step(p.effect) for p in problem.parameters])
    H: list[Floats] = []
    g: list[Floats] = []
    damping = 1e-2
    for number in range(iterations):
        if tell is not None:
            tell(f"prediction {now:.4g}", number / iterations)
        changes = []
        for k in range(len(x)):
            ends = []
            for way in (steps[k], -steps[k]):
                at = x.copy()
                at[k] = float(np.clip(x[k] + way, low[k], high[k]))
                ends.append((at[k], run(at)))
            apart = ends[0][0] - ends[1][0] or 1.0
            changes.append(
                [
                    (a.misread - b.misread) / apart
                    for a, b in zip(ends[0][1], ends[1][1], strict=True)
                ]
            )
        H, g = [], []
        for c, prediction in enumerate(here):
            z = (prediction.misread / scales).ravel()
            J = np.stack([(change[c] / scales).ravel() for change in changes], axis=1)
            there = np.isfinite(z) & np.isfinite(J).all(axis=1)
            z, J = z[there], J[there]
            # a change that a roll-out tips over by says nothing of its slope
            most = 10.0 / np.maximum(steps, 1e-300)
            J = np.clip(J, -most, most)
            weight = huber_weight(z) / max(len(z), 1)
            H.append(J.T @ (J * weight[:, None]))
            g.append(J.T @ (z * weight))
        whole, slope = np.sum(H, axis=0) / len(H), np.sum(g, axis=0) / len(g)
        better = None
        for _ in range(6):
            diagonal = np.diag(whole)
            step = -np.linalg.solve(
                whole + damping * np.diag(diagonal) + 1e-9 * np.diag(1.0 / steps**2), slope
            )
            at = np.clip(x + step, low, high)
            there_now = run(at)
            value = total(there_now)
            if value < now:
                better = (at, there_now, value)
                damping = max(0.1 * damping, 1e-6)
                break
            damping *= 10.0
        if better is None:
            break
        gone = now - better[2]
        x, here, now = better
        history.append(now)
        if gone < 1e-3 * now:
            break
    errors = np.full(len(x), np.inf)
    if len(H) > 1:
        whole, slope = np.sum(H, axis=0), np.sum(g, axis=0)
        floor = 1e-9 * np.diag(1.0 / steps**2)
        left = np.array(
            [-np.linalg.solve(whole - h + floor, slope - b) for h, b in zip(H, g, strict=True)]
        )
        n = len(H)
        errors = np.sqrt((n - 1) / n * np.sum((left - left.mean(axis=0)) ** 2, axis=0))
    return Polished(x, errors, losses(here, scales), history)


def _step(effect: SceneEffect) -> float:
    """Of a difference that sees past the kinks of a roll-out."""
    return 0.05 if effect.logarithmic else 0.1 * effect.typical
