# SPDX-License-Identifier: Apache-2.0
"""How candidates of a scene are judged by what is kept aside."""

from types import SimpleNamespace

import numpy as np
import pytest

from pneu_sysid.contacts.candidates import SceneScore, Scores, Seen
from pneu_sysid.contacts.diagnose import (
    SURE,
    TIED,
    Finalist,
    Floats,
    _apart,
    _tie,
)
from pneu_sysid.contacts.sureness import falls_of, lead_of, per_knot, trimmed


def _fall(before: Floats, after: Floats) -> tuple[float, float]:
    return trimmed(np.nanmean(falls_of(before, after), axis=1))


def test_flights_and_contacts_count_alike() -> None:
    """A tenth of the cost in flight is worth a tenth near contacts, though that is a thousandth."""
    before = np.tile([0.02, 20.0], (5, 1))
    flights, _ = _fall(before, before * [0.1, 1.0])
    contacts, _ = _fall(before, before * [1.0, 0.1])
    assert flights == pytest.approx(contacts) == pytest.approx(0.5 * np.log(10.0))


def test_one_recording_that_goes_another_way_decides_nothing() -> None:
    rng = np.random.default_rng(2)
    before = np.exp(rng.normal(size=(10, 2)))
    after = before * np.exp(-0.3 + 0.02 * rng.normal(size=(10, 2)))
    after[4] *= 1e4
    mean, error = _fall(before, after)
    assert mean == pytest.approx(0.3, abs=0.03)
    assert mean > 2.5 * error


def test_what_shows_where_bodies_touch_alone_is_sure_by_its_sum() -> None:
    rng = np.random.default_rng(3)
    touches = np.arange(10) % 2 == 0
    rises = np.where(touches, 400.0 * rng.uniform(0.5, 1.5, 10), 2.0 * rng.normal(size=10))
    mean, error = trimmed(rises)
    assert mean < SURE * error
    assert lead_of(rises) > SURE
    assert lead_of(-rises) < 0.0
    assert lead_of(np.array([1e4, *rng.normal(size=9)])) < SURE  # one that went another way


@pytest.mark.long
def test_a_second_look_is_no_second_chance() -> None:
    """Noise is not much more often beyond what decides by the surer of two looks than by one."""
    rng = np.random.default_rng(5)
    values = rng.standard_t(3, size=(2000, 10))
    by_mean = np.mean([trimmed(v)[0] > SURE * trimmed(v)[1] for v in values])
    by_either = np.mean([lead_of(v) > SURE for v in values])
    assert by_either < by_mean + 0.012 < 0.05


def _left(rng: np.random.Generator, touches: Floats, share: float) -> Finalist:
    """A candidate that takes a share of what is left where bodies touch, and nothing elsewhere."""
    falls = np.where(touches > 0.0, share * rng.uniform(0.5, 1.5, touches.size), 0.0)
    falls += 0.01 * rng.normal(size=touches.size)
    found = object.__new__(Finalist)
    found.falls, found.gain = falls, 0.3 * share
    return found


def test_candidates_are_told_apart_where_few_stretches_touch() -> None:
    """By their sum, one that explains far less; one that explains as much by the mean alone."""
    rng = np.random.default_rng(6)
    touches = np.array([1.0, 0.0, 0.0, 0.9, 0.0, 0.0, 1.1, 0.0, 0.0, 0.0])
    told, by_mean, same = 0, 0, 0
    for _ in range(100):
        strong, weak, equal = (_left(rng, touches, share) for share in (0.5, 0.02, 0.5))
        apart, spread = trimmed(strong.falls - weak.falls)
        by_mean += apart > TIED * spread
        told += _apart(strong, weak, True) > TIED
        same += _apart(strong, equal, True) > TIED
    assert by_mean < 50
    assert told > 95
    assert same < 20


def _named(name: str, falls: Floats) -> Finalist:
    """A candidate that takes away so much of the cost of each recording."""
    found = object.__new__(Finalist)
    p = SimpleNamespace(label=name, effect=None, place="")
    found.score = SceneScore(p, 1.0, 0.1, 1.0, 1.0)  # type: ignore[arg-type]
    found.falls = found.rise = falls
    found.gain = found.worth = float(1.0 - np.exp(-trimmed(falls)[0]))
    found.lead, found.alike = lead_of(falls), []
    return found


def test_one_that_explains_as_much_and_misses_being_sure_by_little_is_a_rival() -> None:
    """Drawn anew, the other of the two would be named: neither is ruled out."""
    rng = np.random.default_rng(8)
    tied, flipped, alone, unsure = 0, 0, 0, 0
    for _ in range(400):
        common = 0.07 + 0.13 * rng.normal(size=32)  # what both explain
        two = [_named(n, common + 0.03 * rng.normal(size=32)) for n in ("damping", "friction")]
        nothing = _named("bias", 0.02 + 0.05 * rng.normal(size=32))  # explains a little
        surest, other = sorted(two, key=lambda one: -one.lead)
        if not surest.lead >= SURE > other.lead:
            continue
        scores = Scores([one.score for one in (*two, nothing)], np.eye(3), 0.0, None)  # type: ignore[arg-type]
        _tie([surest, other, nothing], scores, True)
        flipped += 1
        tied += other.label in surest.alike
        if nothing.lead < SURE:
            unsure += 1
            alone += nothing.label not in surest.alike
    assert flipped > 10
    assert tied >= 0.7 * flipped  # within 1.5 deviations, the surer of two taken
    assert alone >= 0.9 * unsure > 0.5 * flipped  # it explains too little to be one


def test_recordings_that_never_touch_are_judged_by_flight_alone() -> None:
    before = np.column_stack([np.full(6, 2.0), np.full(6, np.nan)])
    mean, _ = _fall(before, 0.5 * before)
    assert mean == pytest.approx(np.log(2.0))
    assert per_knot(before) == pytest.approx(2.0)


def test_a_step_found_in_some_recordings_is_foretold_in_others() -> None:
    """Against a line through noise, in closed form: y = a + b t, b unknown to the model."""
    rng = np.random.default_rng(4)
    t = rng.uniform(-1.0, 1.0, size=(20, 30))
    y = 0.2 + 0.5 * t + rng.normal(size=t.shape)
    J = np.stack([np.ones_like(t), t], axis=2)
    r = -y  # at a = b = 0
    H, g = np.einsum("rni,rnj->rij", J, J), np.einsum("rni,rn->ri", J, r)
    none = np.zeros((2, 2)), np.zeros(2)
    ours, others = (Seen(H[k::2], g[k::2], 1, ["b"], *none) for k in (0, 1))
    at, step = ours.step("b")
    line = np.linalg.lstsq(J[::2].reshape(-1, 2), y[::2].ravel(), rcond=None)[0]
    assert step == pytest.approx(line)
    mean = ours.step(None)[1]
    assert mean == pytest.approx([y[::2].mean()])
    left = 0.5 * np.sum((y[1::2] - J[1::2] @ line) ** 2, axis=1)
    plain = 0.5 * np.sum((y[1::2] - y[::2].mean()) ** 2, axis=1)
    rise = others.rise(at, step) - others.rise(*ours.step(None))
    assert rise == pytest.approx(plain - left)
