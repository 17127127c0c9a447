# SPDX-License-Identifier: Apache-2.0
"""Speed of the training environment and of a policy, on one core."""

from __future__ import annotations

import numpy as np

from benchmarks.report import ROOT, Table
from benchmarks.timing import best_s
from pneu_policy.control.observations import Recipe
from pneu_policy.task.make import make_env
from pneu_policy.task.tracking import EnvSettings

RIGS = ROOT / "rigs"
CASES = (
    # (what, rig file, cell length in m); 0.125 m makes 20 cells of the tube, 8 of the supply line
    # and 2 of the exhaust
    ("full model, 30 cells in all", "rig_a_fitted.yaml", 0.125),
    ("full model, 30 cells of the tube and 14 others", "rig_a_fitted.yaml", 2.5 / 30),
    ("thin plate", "rig_a_thin_plate.yaml", None),
)
STEPS = 40


def measure() -> list[Table]:
    """Measures environment steps and inference; kernels are compiled before."""
    return [_steps()]


def _steps() -> Table:
    table = Table(
        "Training: environment steps on one core",
        "`PressureTracking` on the 2.5 m rig: control periods of 10 ms with noise, features and"
        " reward, second-order scheme, one thread.",
        {
            "case": "model",
            "envs": "rigs side by side",
            "steps_per_s": "steps/s",
            "real_time": "times real time",
            "share": "of it in the physics",
        },
    )
    for what, rig, dx_m in CASES:
        for count in (1, 16, 64):
            taps = ("end", "valve_out", "middle", "supply", "exhaust")
            settings = EnvSettings(
                rig=str(RIGS / rig), recipe=Recipe(tap="end", taps=taps), num_envs=count, dx_m=dx_m,
                horizon=STEPS,
            )  # fmt: skip
            env = make_env(settings)
            action = np.random.default_rng(0).uniform(-0.5, 0.5, (STEPS, count, 1))

            def episode(env=env, action=action) -> None:
                for one in action:
                    env.step(one)

            def physics(env=env, action=action) -> None:
                for one in action:
                    env.plant.step(5.0 + 5.0 * one[:, 0])

            whole = best_s(episode, lambda env=env: env.reset(seed=0))
            alone = best_s(physics, lambda env=env: env.reset(seed=0))
            steps = STEPS * count / whole
            table.rows.append(
                {
                    "case": what,
                    "envs": count,
                    "steps_per_s": steps,
                    "real_time": steps * settings.recipe.period_s,
                    "share": alone / whole,
                }
            )
    return table
