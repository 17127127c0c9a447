# SPDX-License-Identifier: Apache-2.0
"""When one model is told from another, and what pulsates in a residual."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pneu_sim.effects import find_effect
from pneu_sysid.candidates import Score, scores_of, to_refit
from pneu_sysid.candidates import Sensitivity as Known
from pneu_sysid.evidence import lead, share_explained
from pneu_sysid.problem import Problem
from pneu_sysid.records import Recording
from pneu_sysid.sites import Site
from pneu_sysid.spectrum import lines_of
from pneu_sysid.thresholds import Thresholds
from pneu_sysid.together import each_of

STRETCHES, LENGTH = 12, 400


def blocks() -> np.ndarray:
    """Blocks of forty readings."""
    return np.arange(STRETCHES * LENGTH).reshape(STRETCHES, LENGTH) // 40


def test_a_model_that_is_right_leads_by_half_of_what_tells_it_apart() -> None:
    """With white noise the lead scatters about |D| / 2 by one, whichever noise it was."""
    apart = np.zeros((STRETCHES, LENGTH))
    apart[3, 20:60] = 1.0
    leads = []
    for seed in range(300):
        noise = np.random.default_rng(seed).normal(size=apart.shape)
        leads.append(lead(noise, noise + apart, blocks()))
    norm = float(np.linalg.norm(apart))
    # never more than white noise allows: what blocks show beyond it takes from the lead
    assert 0.3 * norm < np.mean(leads) <= 0.55 * norm
    assert np.std(leads) < 1.2


def test_what_neither_model_knows_takes_from_the_lead() -> None:
    """A large error of both that happens to favour one is no reason to prefer it."""
    rng = np.random.default_rng(1)
    apart = 0.5 * rng.normal(size=(STRETCHES, LENGTH))
    unknown = np.repeat(rng.normal(size=(STRETCHES, LENGTH // 40)), 40, axis=1) * 8.0
    common = unknown * np.sign(apart)
    noise = rng.normal(size=apart.shape)
    assert abs(lead(noise + common, noise + common + apart, blocks())) < 3.0
    assert lead(noise, noise + apart, blocks()) > 10.0


def test_a_lead_has_a_sign() -> None:
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, STRETCHES, LENGTH))
    assert lead(a, b, blocks()) == pytest.approx(-lead(b, a, blocks()))
    assert lead(a, a, blocks()) == 0.0
    assert share_explained(a, 0.5 * a) == pytest.approx(0.75)


def known(name: str, place: str, change: np.ndarray) -> Known:
    """A candidate that changes the prediction in a given way."""
    effect = find_effect(name)
    return Known(Site(effect, place, {}), effect.strength.lower, np.inf, change)


def test_one_of_each_kind_is_refitted() -> None:
    """Four that change the same, and one that explains less in a way of its own."""
    rng = np.random.default_rng(3)
    first, second = rng.normal(size=(2, STRETCHES, LENGTH))
    residual = 3.0 * first + 2.0 * second + rng.normal(size=first.shape)
    alike = [first + 0.02 * rng.normal(size=first.shape) for _ in range(4)]
    names = ("leak", "blockage", "local_loss", "dead_volume")
    candidates = [known(n, "tube", c) for n, c in zip(names, alike, strict=True)]
    candidates.append(known("sensor_lag", "end", second))
    scores = sorted(scores_of(residual, candidates), key=lambda s: -s.explained)
    chosen, left = to_refit(scores, Thresholds(finalists=3, contender=0.2))
    found = [s.site.effect.name for s in chosen]
    assert "sensor_lag" in found
    assert len(chosen) == 3
    assert {s.site.effect.name for s in [*chosen, *left]} == {*names, "sensor_lag"}
    strengths = {s.site.effect.name: s.strength for s in scores}
    assert strengths["sensor_lag"] == pytest.approx(2.0, rel=0.1)


def test_what_explains_next_to_nothing_is_not_refitted() -> None:
    rng = np.random.default_rng(4)
    residual = rng.normal(size=(STRETCHES, LENGTH))
    scores: list[Score] = scores_of(
        residual, [known("leak", "tube", rng.normal(size=residual.shape))]
    )
    assert to_refit(scores, Thresholds()) == ([], [])


def pulsating(frequency_hz: float, amplitude: float) -> tuple[Problem, np.ndarray]:
    """A problem of one tap read at uneven times, and its residual."""
    rng = np.random.default_rng(5)
    time = np.sort(rng.uniform(0.0, 12.0, STRETCHES * LENGTH)).reshape(STRETCHES, LENGTH, 1)
    slow = 0.5 * np.cumsum(rng.normal(size=time.size)).reshape(time.shape) / np.sqrt(time.size)
    r = rng.normal(size=time.shape) + slow
    r += amplitude * np.sin(2.0 * np.pi * frequency_hz * time + 0.7)
    problem = Problem(
        recordings=[Recording("made", {}, {})],
        taps=["end"],
        time_s=time,
        measured=np.ones_like(time),
        noise_pa=np.ones(1),
        noise_words={},
        of=np.zeros(STRETCHES, dtype=np.int64),
        span_s=np.zeros((STRETCHES, 2)),
        pull_s=None,
    )
    return problem, r.reshape(STRETCHES, -1)


def test_a_line_in_the_spectrum_is_found() -> None:
    problem, residual = pulsating(7.3, 1.0)
    (line,) = lines_of(problem, residual)
    assert line.tap == "end"
    assert line.frequency_hz == pytest.approx(7.3, abs=0.25 / 12.0)
    # a sine of amplitude one beside noise of one: half of one and a half
    assert line.share == pytest.approx(0.5 * residual.size / np.sum(residual**2), rel=0.1)


def test_noise_has_no_line() -> None:
    assert lines_of(*pulsating(7.3, 0.0)) == []


def test_an_error_of_a_run_together_reaches_all_that_asked() -> None:
    """Also one that had to wait for the others; what only one of them does is its own."""
    problem = SimpleNamespace(simulate=None)

    def simulate(rigs: list[str], strict: bool) -> None:
        assert sorted(rigs) == ["a", "b", "c"] and not strict
        raise ValueError("all three")

    problem.simulate = simulate
    told: list[str] = []

    def ask(shared: Any, item: str) -> None:
        try:
            shared.simulate([item])
        except ValueError as error:
            told.append(f"{item}: {error}")
            raise

    with pytest.raises(ValueError, match="all three"):
        each_of(["a", "b", "c"], problem, ask)  # type: ignore[arg-type]
    assert sorted(told) == [f"{item}: all three" for item in "abc"]
