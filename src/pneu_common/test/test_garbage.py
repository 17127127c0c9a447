# SPDX-License-Identifier: Apache-2.0
"""The collector of garbage passes by what stays, and still takes what comes after."""

import gc
import weakref

import pytest

from pneu_common.garbage import spare_what_stays

pytestmark = pytest.mark.kernel_free


class Ring:
    """Something that only the collector can take."""

    def __init__(self):
        self.itself = self


@pytest.fixture
def thawed():
    yield
    gc.unfreeze()


def test_what_stays_is_passed_by_and_what_comes_later_is_taken(thawed):
    gc.disable()
    try:
        before, gone = weakref.ref(Ring()), weakref.ref(Ring())
        spare_what_stays()
    finally:
        gc.enable()
    assert before() is None and gone() is None  # one last pass
    kept = Ring()
    assert gc.is_tracked(kept)
    assert gc.get_freeze_count() > 1000
    assert len(gc.get_objects()) < 1000
    later = weakref.ref(Ring())
    gc.collect()
    assert later() is None
