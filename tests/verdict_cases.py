# SPDX-License-Identifier: Apache-2.0
"""A rig, recordings and candidates with chosen residuals, for tests of what decides verdicts."""

import math
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pneu_sim.effects import find_effect
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import Calibration, Rig
from pneu_sysid.bench import Bench
from pneu_sysid.candidates import Score
from pneu_sysid.diagnose import (
    Diagnosis,
    _judge,
)
from pneu_sysid.problem import Problem
from pneu_sysid.records import Recording
from pneu_sysid.refits import Refit
from pneu_sysid.sites import Site
from pneu_sysid.standing import standing_of
from pneu_sysid.thresholds import Thresholds

Floats = NDArray[np.float64]
HOUSE = Path(__file__).parents[1]
STRETCHES, HORIZON = 9, 40
NOISE = np.array([200.0, 250.0, 300.0, 350.0, 400.0])
E = 1e-6


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(HOUSE / "rigs" / "rig_a.yaml")


def calibrated(rig: Rig, floor: float = 1.0, recording: str = "before") -> Rig:
    """The rig as if a calibration had left so many times the noise at every tap."""
    left = {tap: floor * x for tap, x in zip(rig.taps, NOISE.tolist(), strict=True)}
    noise = dict(zip(rig.taps, NOISE.tolist(), strict=True))
    told = Calibration(recording=recording, rmse_pa=left, noise_floor_pa=noise)
    return rig.model_copy(update={"calibration": told})


def problem_of(rig: Rig, names: tuple[str, ...] = ("run",)) -> Problem:
    """A problem of readings at even times; every third stretch is held out."""
    time = np.arange(STRETCHES * HORIZON).reshape(STRETCHES, HORIZON, 1) * 0.01
    return Problem(
        recordings=[Recording(name, {}, {}) for name in names],
        taps=list(rig.taps),
        time_s=np.tile(time, (1, 1, NOISE.size)),
        measured=np.zeros((STRETCHES, HORIZON, NOISE.size)),
        noise_pa=NOISE,
        noise_words={},
        of=np.arange(STRETCHES) % len(names),
        span_s=np.array([[0.4 * k, 0.4 * (k + 1)] for k in range(STRETCHES)]),
        pull_s=None,
    )


@dataclass
class Case:
    """A rig with a residual that is the same size everywhere, ready to be judged.

    Attributes:
        rig: The rig.
        times: Size of the residual in noise deviations, where it is held out and elsewhere.
        used: The latter, where it differs.
    """

    rig: Rig
    times: float
    used: float | None = None

    def __post_init__(self) -> None:
        self.problem = problem_of(self.rig)
        signs = np.random.default_rng(4).choice([-1.0, 1.0], (STRETCHES, HORIZON * NOISE.size))
        self.base = self.times * signs
        if self.used is not None:
            self.base[~self.problem.held_out] *= self.used / self.times
        units = self.base.reshape(self.problem.measured.shape)
        self.problem.measured = units * NOISE
        blocks = np.arange(STRETCHES * HORIZON)[:, None] // 8
        blocks = np.repeat(blocks, NOISE.size, axis=1).reshape(STRETCHES, -1)
        none: Future[Any] = Future()
        none.set_result(None)
        standing = standing_of(self.rig, self.problem, self.base, Thresholds())
        readings = np.zeros((STRETCHES, HORIZON, NOISE.size))
        self.bench = Bench(
            rig=self.rig, problem=self.problem, readings=readings, standing=standing, known=[],
            project=None, blocks=blocks, thresholds=Thresholds(), numerics=none,
        )  # fmt: skip

    def refit(
        self, name: str = "leak", place: str = "tube", held: float = 0.95, **more: Any
    ) -> Refit:
        """A candidate that takes away a share of the squared residual everywhere."""
        effect = find_effect(name)
        shapes = dict(effect.sites(self.rig, 1.0))
        shape = {k: 1.5 if k == "position_m" else v for k, v in shapes.get(place, {}).items()}
        site = Site(effect, place, shape)
        residual = more.pop("residual", self.base * math.sqrt(max(1.0 - held, 0.0)))
        values: dict[str, Any] = {
            "strength": 1.5 * effect.strength.typical, "std_error": 0.1 * effect.strength.typical,
            "position_error_m": None, "explained": held, "held_out": held, "t": 15.0,
            "score_explained": 0.7, "residual": residual, "change": self.base - residual,
            "rig": site.attached(self.rig, 1.5 * effect.strength.typical),
        }  # fmt: skip
        return Refit(**({"site": site} | values | more))

    def judged(self, *refits: Refit, scores: list[Score] | None = None) -> Diagnosis:
        return _judge(self.bench, self.base, list(refits), scores or [], self.bench.readings, 0.0)

    @property
    def count(self) -> int:
        """Readings that are held out."""
        return 3 * HORIZON * NOISE.size


def leading(other: Floats, wanted: float) -> Floats:
    """A residual whose lead over another, the same size everywhere, is of a size.

    What sets them apart is orthogonal to it in every block of time, so that it leads by half the
    length of that.
    """
    a = 4.0 * wanted**2 / float(np.sum(other**2))
    alternating = np.where(np.arange(other.shape[1]) % 2, -1.0, 1.0)
    return np.asarray(other - a * other - math.sqrt(a - a**2) * other * alternating)
