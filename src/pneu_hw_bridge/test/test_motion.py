# SPDX-License-Identifier: Apache-2.0
"""What trips by an encoder's reading: value and slope on either side of each branch point."""

import math

import pytest

from pneu_hw_bridge.safety import motion
from pneu_hw_bridge.safety.motion import EncoderLimits, EncoderWatch, FrozenLimits

pytestmark = pytest.mark.kernel_free

GAP_S = 0.09375
TICK_S = 2.0**-20
NONE = EncoderLimits((-8.0, 8.0))


def up(value):
    return math.nextafter(value, math.inf)


def down(value):
    return math.nextafter(value, -math.inf)


def taking(limits, *readings, force=0.0, gap_s=math.inf):
    """What is said of each reading: pairs of time and place, by one clock."""
    watch = EncoderWatch("elbow", limits)
    return [watch.take(place, at_s, at_s, force, gap_s) for at_s, place in readings]


def test_the_constants():
    """The documentation of register maps promises them."""
    assert (motion.SPEED_OVER_S, motion.UNSURE_S) == (0.04, 0.01)
    assert (motion.REACH, motion.BEYOND) == (0.02, 0.05)


def test_a_new_watch_knows_nothing():
    watch = EncoderWatch("elbow", NONE)
    assert (watch.seen_s, watch.good) == (-math.inf, False)
    assert math.isnan(watch.value)
    assert watch.beyond() == ""


@pytest.mark.parametrize(
    ("value", "good"),
    [
        (-8.0, True),
        (8.0, True),
        (down(-8.0), False),
        (up(8.0), False),
        (math.nan, False),
        (math.inf, False),
    ],
)
def test_a_reading_can_be_true_at_both_ends_of_its_range(value, good):
    watch = EncoderWatch("elbow", NONE)
    assert watch.take(value, 3.0, 5.0, None, 1.0) == ""
    assert (watch.good, watch.seen_s) == (good, 3.0)
    assert watch.value == value or math.isnan(value)


@pytest.mark.parametrize(
    ("value", "says"),
    [
        (1.5, ""),
        (up(1.5), "elbow is at 1.5, above its limit 1.5"),
        (2.0, "elbow is at 2, above its limit 1.5"),
        (-0.5, ""),
        (down(-0.5), "elbow is at -0.5, below its limit -0.5"),
        (math.inf, ""),  # which cannot be true, and holds
        (-math.inf, ""),
        (math.nan, ""),
    ],
)
def test_a_place_trips_beyond_its_limits_and_not_at_them(value, says):
    limits = EncoderLimits((-8.0, 8.0), lower=-0.5, upper=1.5)
    assert taking(limits, (3.0, value)) == [says]


# Jumps: no further than 16/s times the time and 10 ms, and twice the resolution of 1/64

JUMPING = EncoderLimits((-8.0, 8.0), impossible=16.0, resolution=2.0**-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("passed_s", [2.0**-9, 2.0**-6, 0.125])
def test_a_jump_is_further_than_the_impossible_speed_allows(passed_s, sign):
    most = 16.0 * (passed_s + 0.01) + 2.0**-5
    assert taking(JUMPING, (4.0, 0.0), (4.0 + passed_s, sign * most)) == ["", ""]
    way = sign * up(most)
    assert taking(JUMPING, (4.0, 0.0), (4.0 + passed_s, way)) == [
        "",
        f"elbow jumped by {way:.4g} in {1e3 * passed_s:.1f} ms, faster than 16/s",
    ]


def test_a_jump_is_told_of_the_reading_before_and_not_of_an_earlier_one():
    places = [(4.0 + 2.0**-9 * k, 0.125 * k) for k in range(60)]  # 64/s, and 0.125 at a time
    assert set(taking(JUMPING, *places)) == {""}


def test_the_first_reading_is_no_jump_wherever_it_is():
    assert taking(JUMPING, (4.0, 7.0)) == [""]


@pytest.mark.parametrize("back_s", [0.0, -1.0])
def test_a_clock_that_does_not_go_on_begins_anew(back_s):
    assert taking(JUMPING, (4.0, 0.0), (4.0 + back_s, 7.0)) == ["", ""]
    found = taking(JUMPING, (4.0, 0.0), (4.0 + back_s, 7.0), (4.0 + back_s + 2.0**-9, 0.0))
    assert "jumped by -7" in found[2]


@pytest.mark.parametrize("gap", [GAP_S, up(64.0 + GAP_S) - 64.0])
def test_nothing_follows_from_readings_before_a_gap(gap):
    watch = EncoderWatch("elbow", JUMPING)
    assert watch.take(0.0, 64.0, 8.0, None, GAP_S) == ""
    said = watch.take(7.0, 64.0 + gap, 8.0 + 2.0**-6, None, GAP_S)
    assert bool(said) is (gap == GAP_S)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_place_that_is_no_number_and_one_without_a_time_are_left_out(value):
    watch = EncoderWatch("elbow", JUMPING)
    for place, at_s, taken_s in (
        (0.0, 4.0, 4.0),
        (value, 4.0 + 2.0**-9, 4.0 + 2.0**-9),
        (7.0, 4.0 + 2.0**-8, None),
    ):
        assert watch.take(place, at_s, taken_s, None, 1.0) == ""
    assert watch.take(0.25, 4.015625, 4.015625, None, 1.0) == "", "0.25 after 15.6 ms is no jump"


# Speeds: over 40 ms

FAST = EncoderLimits((-8.0, 8.0), speed=4.0, resolution=2.0**-8)
SLACK = 2.0**-7


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("at_s", "way", "says"),
    [
        (down(0.04), 7.0, ""),  # over any shorter time no speed is told
        (0.002, 7.0, ""),
        (0.02, 7.0, ""),
        (0.04, 4.0 * 0.04 + SLACK, ""),
        (0.04, up(4.0 * 0.04 + SLACK), "elbow moves at 4.195/s, above its limit 4"),
        (0.04, 0.4, "elbow moves at 10/s, above its limit 4"),
        (0.08, 4.0 * 0.08 + SLACK, ""),
        (0.08, up(4.0 * 0.08 + SLACK), "elbow moves at 4.098/s, above its limit 4"),
        (0.5, 2.25, "elbow moves at 4.5/s, above its limit 4"),
    ],
)
def test_a_speed_is_told_over_40_ms_and_no_less(at_s, way, says, sign):
    assert taking(FAST, (0.0, 0.0), (at_s, sign * way)) == ["", says]


def test_a_blow_that_is_over_within_40_ms_is_no_speed():
    """There and back at 10/s; over every 40 ms it has gone nowhere."""
    places = [(0.002 * k, 0.02 * min(k % 20, 20 - k % 20)) for k in range(200)]
    assert set(taking(FAST, *places)) == {""}


@pytest.mark.parametrize("speed", [4.5, 6.0, 12.0, -6.0])
def test_a_joint_that_begins_to_move_trips_once_40_ms_hold_too_much_way(speed):
    """Worked out by hand: the way of the last 40 ms is what it has moved since it began."""
    rest = [(2.0**-9 * k, 1.0) for k in range(100)]
    begun_s = rest[-1][0]
    moving = [(begun_s + 2.0**-9 * k, 1.0 + speed * 2.0**-9 * k) for k in range(1, 60)]
    found = taking(FAST, *rest, *moving)
    first = next(k for k, said in enumerate(found) if said) - 99
    # 21 steps of 1/512 s are the shortest window of at least 40 ms.
    window_s = 21.0 * 2.0**-9
    needed = (4.0 * window_s + SLACK) / abs(speed)
    assert first == math.floor(needed / 2.0**-9) + 1 <= 21


def test_a_joint_below_its_speed_limit_never_trips():
    assert set(taking(FAST, *[(2.0**-9 * k, 3.9 * 2.0**-9 * k) for k in range(500)])) == {""}


def test_the_window_is_counted_from_the_newest_reading_that_is_40_ms_old():
    # Fast at first, then at rest: the speed of the last 40 ms alone counts.
    places = [(0.0, 0.0), (0.02, 1.0), (0.04, 1.0)]
    assert taking(FAST, *places)[-1] == "elbow moves at 25/s, above its limit 4"
    assert taking(FAST, *places, (0.0625, 1.0))[-1] == ""
    # Of three the middle one is exactly 40 ms old: what was before it is forgotten.
    three = (-0.03125, 0.0), (0.0, 1.0)
    assert taking(FAST, *three, (0.04, 1.0))[-1] == ""
    shown = taking(FAST, *three, (down(0.04), 1.0))[-1]
    assert shown == "elbow moves at 14.04/s, above its limit 4"


def test_a_jump_is_said_before_a_speed_and_a_place_beyond_before_both():
    limits = EncoderLimits((-8.0, 8.0), upper=3.0, speed=4.0, impossible=16.0)
    assert "jumped" in taking(limits, (0.0, 0.0), (0.04, 2.0))[1]
    assert "above its limit 3" in taking(limits, (0.0, 0.0), (0.04, 3.5))[1]


# Frozen: stops at -1 and 3, so that 2 % of the travel are 0.08

FROZEN = FrozenLimits({}, 32.0, 0.0, 0.0625, 0.125, (-1.0, 3.0))
STILL = EncoderLimits((-8.0, 8.0), frozen=FROZEN)
STEP_S = 2.0**-8


def frozen_after(force, place=1.0, limits=STILL, steps=64):
    """After how many steps an encoder that reads the same is said to be frozen, and why."""
    watch = EncoderWatch("elbow", limits)
    for k in range(steps):
        said = watch.take(place, 4.0 + STEP_S * k, 4.0 + STEP_S * k, force, math.inf)
        if said:
            return k, said
    return None, ""


@pytest.mark.parametrize(
    ("force", "frozen"),
    [(32.0, False), (-32.0, False), (up(32.0), True), (down(-32.0), True), (None, False)],
)
def test_more_than_can_be_held_freezes_after_its_time_exactly(force, frozen):
    after, said = frozen_after(force)
    if not frozen:
        assert said == ""
        return
    assert after == 16, "62.5 ms are 16 steps"
    assert said == (
        "elbow is frozen at 1: pushed by 32 for 62 ms it shows no movement; at rest 32 can be held"
    )


def test_without_limits_nothing_freezes():
    assert frozen_after(1e3, limits=NONE) == (None, "")


REACHED = 0.02 * 4.0


@pytest.mark.parametrize(
    ("force", "place", "frozen"),
    [
        (40.0, 3.0 - REACHED, False),
        (40.0, down(3.0 - REACHED), True),
        (40.0, 3.5, False),
        (40.0, -1.0, True),  # away from the stop that it is at
        (-40.0, -1.0 + REACHED, False),
        (-40.0, up(-1.0 + REACHED), True),
        (-40.0, -1.5, False),
        (-40.0, 3.0, True),
    ],
)
def test_a_joint_that_is_pushed_into_the_stop_it_is_at_may_rest(force, place, frozen):
    assert (frozen_after(force, place)[0] == 16) is frozen
    assert bool(frozen_after(force, place)[1]) is frozen


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("moved", "frozen"), [(0.125, True), (up(1.125) - 1.0, False)])
def test_a_movement_is_more_than_what_counts_as_still(moved, frozen, sign):
    watch = EncoderWatch("elbow", STILL)
    said = ""
    for k in range(20):
        place = 1.0 + sign * moved * (k % 2)
        said = said or watch.take(place, 4.0 + STEP_S * k, 4.0 + STEP_S * k, 40.0, math.inf)
    assert bool(said) is frozen


def test_a_creep_is_measured_from_where_it_last_moved():
    watch = EncoderWatch("elbow", STILL)
    for k in range(200):  # each step 0.01, so that it counts as moved every 13 steps
        at_s = 4.0 + STEP_S * k
        assert watch.take(-0.5 + 0.01 * k, at_s, at_s, 40.0, math.inf) == ""


@pytest.mark.parametrize("released", [None, 32.0, -32.0])
def test_the_time_counts_anew_once_it_was_not_pushed(released):
    watch = EncoderWatch("elbow", STILL)
    forces = [40.0] * 15 + [released] + [40.0] * 17
    said = [
        watch.take(1.0, 4.0 + STEP_S * k, 4.0 + STEP_S * k, f, math.inf)
        for k, f in enumerate(forces)
    ]
    assert [k for k, one in enumerate(said) if one] == [32]


@pytest.mark.parametrize(
    ("pace", "steps"),
    [
        (1.0, 16),
        (2.0, 16),  # no sooner by a clock that is ahead
        (0.5, 32),  # samples that come late are told by their own time
        (-1.0, 16),  # a clock that went back tells nothing
        (None, 16),
    ],
)
def test_the_time_is_the_shorter_one_of_both_clocks(pace, steps):
    watch = EncoderWatch("elbow", STILL)
    for k in range(40):
        taken_s = None if pace is None else 900.0 + pace * STEP_S * k
        if watch.take(1.0, 4.0 + STEP_S * k, taken_s, 40.0, math.inf):
            break
    assert k == steps


def test_a_time_that_becomes_known_later_is_not_compared():
    watch = EncoderWatch("elbow", STILL)
    for k in range(40):
        taken_s = None if k < 8 else 900.0
        if watch.take(1.0, 4.0 + STEP_S * k, taken_s, 40.0, math.inf):
            break
    assert k == 16


def test_forgetting_counts_anew():
    watch = EncoderWatch("elbow", STILL)
    for k in range(16):
        assert watch.take(1.0, 4.0 + STEP_S * k, 4.0 + STEP_S * k, 40.0, math.inf) == ""
    watch.forget()
    for k in range(16, 32):
        assert watch.take(1.0, 4.0 + STEP_S * k, 4.0 + STEP_S * k, 40.0, math.inf) == ""
    assert watch.take(1.0, 4.0 + STEP_S * 32, 4.0 + STEP_S * 32, 40.0, math.inf)


@pytest.mark.parametrize(("impossible", "says"), [(16.0, "frozen"), (8.0, "jumped")])
def test_a_jump_is_said_before_that_it_is_frozen(impossible, says):
    """0.125 at once: 16/s for 10 ms are more, 8/s less, and it counts as no movement."""
    limits = EncoderLimits((-8.0, 8.0), impossible=impossible, frozen=FROZEN)
    watch = EncoderWatch("elbow", limits)
    for k in range(20):
        watch.take(1.0, 4.0 + STEP_S * k, 4.0 + STEP_S * k, 40.0, math.inf)
    last_s = 4.0 + STEP_S * 19
    assert says in watch.take(1.125, last_s + STEP_S, last_s + TICK_S, 40.0, math.inf)
