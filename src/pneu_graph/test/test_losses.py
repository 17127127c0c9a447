# SPDX-License-Identifier: Apache-2.0
"""Messages that were sent and never came are counted, and no others."""

import math
import random

import pytest

from pneu_graph.bag.losses import GRACE_S, Losses


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5])
def test_what_senders_tell_is_compared_with_what_came(share):
    """Messages come late and in another order, and what is told overtakes them."""
    rng = random.Random(3)
    losses, expected, arrivals = Losses(), 0, []
    begun = 700  # sent before anybody listened
    for k in range(5000):
        stamp_ns = (k + 1) * 1_000_000
        if rng.random() < share and k >= 100:
            expected += 1
        else:
            arrivals.append(
                (stamp_ns * 1e-9 + rng.uniform(0.0, 0.9 * GRACE_S), "message", stamp_ns)
            )
        if k % 500 == 50:
            arrivals.append((stamp_ns * 1e-9, "told", (begun + k + 1, stamp_ns)))
    arrivals.append((5.0, "told", (begun + 5000, 5000 * 1_000_000)))
    shown = []
    for at_s, what, value in sorted(arrivals, key=lambda one: one[0]):
        if what == "message":
            losses.seen("/taps", "ab", value, None)
        else:
            losses.told({"ab": value, "somebody else": (10**6, 1)}, at_s)
        shown.append(sum(losses.by_topic(at_s).values()))
    assert shown == sorted(shown), "a message that comes late is not lost for a while"
    assert losses.by_topic(math.inf) == ({"/taps": expected} if expected else {})


def test_numbers_are_believed_where_there_are_some():
    losses = Losses()
    for number in (7, 8, 11, 12, 12, 3, 4, 6):  # a new publisher begins at 3
        losses.seen("/taps", "", 0, number)
    assert losses.by_topic(0.0) == {"/taps": 3}


def test_numbers_of_two_publications_are_not_compared():
    """A killed publisher counts for a while, during which the numbers of the next say nothing."""
    losses = Losses()
    for number in (400, 401, 1, 2, None, None, None, 1950, 1951):
        losses.seen("/taps", "", 0, number)
    assert losses.by_topic(0.0) == {}


def test_each_publication_is_counted_by_itself():
    losses = Losses()
    for k in range(10):
        losses.seen("/a", "01", 100 * k, None)
        losses.seen("/a", "02", 100 * k, None)
    losses.told({"01": (10, 900), "02": (55, 900)}, 0.0)
    losses.told({"01": (14, 1000), "02": (55, 900)}, 1.0)
    assert losses.by_topic(0.5) == {}
    assert losses.by_topic(math.inf) == {"/a": 4}


@pytest.mark.parametrize("taken", [7, 8, 9, 10])
def test_what_is_on_its_way_at_the_end_is_not_lost(taken):
    """The last count may be taken before the messages that it is of; those before are counted."""
    losses = Losses()
    for k in range(taken):
        if k != 5:
            losses.seen("/a", "01", 100 * k, None)
        if k == 3:
            losses.told({"01": (4, 300)}, 0.0)
    losses.told({"01": (9, 800)}, 1.2)
    missed = {"/a": 1} if taken == 10 else {}  # one came that is later than what was told
    assert losses.by_topic(1.3, ended=True) == missed


def test_the_last_ones_are_lost_if_they_had_time_to_come():
    losses = Losses()
    losses.seen("/a", "01", 100, None)
    losses.told({"01": (1, 100)}, 0.0)
    losses.told({"01": (3, 300)}, 0.5)
    assert losses.by_topic(0.5 + GRACE_S, ended=True) == {"/a": 2}
