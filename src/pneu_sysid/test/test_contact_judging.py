# SPDX-License-Identifier: Apache-2.0
"""How candidates of a scene are judged by what is kept aside."""

import numpy as np
import pytest

from pneu_sysid.contacts.diagnose import _fall, per_knot


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


def test_recordings_that_never_touch_are_judged_by_flight_alone() -> None:
    before = np.column_stack([np.full(6, 2.0), np.full(6, np.nan)])
    mean, _ = _fall(before, 0.5 * before)
    assert mean == pytest.approx(np.log(2.0))
    assert per_knot(before) == pytest.approx(2.0)
