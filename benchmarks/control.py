# SPDX-License-Identifier: Apache-2.0
"""An observer at the rate of its readings, and predictive control against the clock."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.report import Table

ROOT = Path(__file__).resolve().parents[1]
RIG = ROOT / "rigs/rig_a_fitted.yaml"
CONTROLLER = ROOT / "policies/short_predictive.yaml"
SECONDS = 60.0
READINGS_HZ = 500.0
NOISE_PA = 250.0


def observer() -> Table:
    """Steps of an observer, one after the other, on one core."""
    from pneu_policy.task.plants import ControlPlant
    from pneu_sim.observe.observer import Observer
    from pneu_sim.observe.settings import ObserverSettings
    from pneu_sim.rig.load import load_rig

    rig, period_s = load_rig(RIG), 1.0 / READINGS_HZ
    plant = ControlPlant([rig], period_s, 0.1)
    rng = np.random.default_rng(0)
    table = Table(
        "Control: an observer of rig A at 500 Hz",
        "Steps of 2 ms with the taps valve_out and end, cells of 0.1 m, on one core: time of the"
        " members' advance and of their analysis together.",
        {
            "members": "members",
            "p50": "p50, ms",
            "p99": "p99, ms",
            "worst": "worst, ms",
            "share": "of the 2 ms, p50, %",
        },
    )
    for members in (16, 32):
        made = Observer(rig, ObserverSettings(members=members, dx_m=0.1), ("valve_out", "end"))
        clean, took = plant.reset(101325.0), []
        for n in range(2000):
            volts = 5.0 + float(np.sin(0.02 * n))
            noisy = clean[0] + NOISE_PA * rng.standard_normal(clean.shape[1])
            read = dict(zip(plant.taps, noisy.tolist(), strict=True))
            begin = time.perf_counter()
            made.advance(np.full((1, 1), volts), period_s)
            made.assimilate(read)
            took.append(1e3 * (time.perf_counter() - begin))
            clean = plant.step(volts)
        late = np.array(took[100:])
        table.rows.append(
            {
                "members": members,
                "p50": float(np.quantile(late, 0.5)),
                "p99": float(np.quantile(late, 0.99)),
                "worst": float(late.max()),
                "share": float(np.quantile(late, 0.5)) / (10.0 * period_s),
            }
        )
    return table


def predictive() -> Table:
    """A predictive controller at 100 Hz for 60 s, with the process that plans for it."""
    from pneu_hw_bridge.priority import precedence, punctual
    from pneu_policy.control.controllers import load_controller
    from pneu_policy.control.predictive import PredictiveController
    from pneu_policy.task.plants import ControlPlant
    from pneu_policy.task.targets import Target

    made = load_controller(CONTROLLER)
    assert isinstance(made, PredictiveController)
    plant = ControlPlant([made.rig], made.period_s, 0.25)
    target = Target("smooth", 150e3, 550e3, 0.3, 1)
    clean, rng = plant.reset(101325.0), np.random.default_rng(0)
    at = plant.taps.index(made.tap)
    off: list[float] = []
    errors: list[float] = []
    rows: list[dict[str, Any]] = []
    longest = run = before = 0
    with precedence():
        punctual()
        made.plan_beside()
        made.deferred = True
        try:
            begin = time.monotonic()
            for n in range(round(SECONDS / made.period_s)):
                due = begin + n * made.period_s
                left = due - time.monotonic()
                if left > 0.0:
                    time.sleep(left)
                off.append(1e3 * (time.monotonic() - due))
                seen = clean[0] + NOISE_PA * rng.standard_normal(clean.shape[1])
                read = dict(zip(plant.taps, seen.tolist(), strict=True))
                now = n * made.period_s
                volts = made.step(read, target.at(now + np.array(made.preview_s)).tolist())
                made.follow()
                errors.append(float(clean[0, at]) - float(target.at(now)))
                clean = plant.step(volts)
                run = run + 1 if made.missed > before else 0
                before, longest = made.missed, max(longest, run)
        finally:
            made.end()
    took = 1e3 * np.array(made.took_s)
    rows.append(
        {
            "plans": len(took),
            "p50": float(np.quantile(took, 0.5)),
            "p99": float(np.quantile(took, 0.99)),
            "worst": float(took.max()),
            "missed": made.missed,
            "longest": longest,
            "late": float(np.quantile(off, 0.99)),
            "error": float(np.sqrt(np.mean(np.square(errors[200:])))) / 101325.0,
        }
    )
    return Table(
        "Control: predictive control at 100 Hz for 60 s",
        "The controller of `policies/short_predictive.yaml`, the process that plans for it, and a"
        " plant in the controller's own process, against the clock. A plan is due after 10 ms; one"
        " that is late is not waited for.",
        {
            "plans": "plans",
            "p50": "plan p50, ms",
            "p99": "plan p99, ms",
            "worst": "plan at worst, ms",
            "missed": "not ready in time",
            "longest": "in a row at most",
            "late": "step late p99, ms",
            "error": "RMSE, atm",
        },
        rows,
    )


def measure() -> list[Table]:
    """Both tables."""
    return [observer(), predictive()]
