# SPDX-License-Identifier: Apache-2.0
"""Encoders at the bridge: turns that wrap, limits by map and rig file, and what trips."""

import math
from io import StringIO
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from pneu_common.errors import InputError
from pneu_hw_bridge.registers.load import load_register_map, parse_register_map
from pneu_hw_bridge.registers.schema import Encoder
from pneu_hw_bridge.registers.turns import Turns
from pneu_hw_bridge.safety.bound import check
from pneu_hw_bridge.safety.limits import limits_of
from pneu_hw_bridge.safety.motion import EncoderLimits, EncoderWatch, FrozenLimits
from pneu_hw_bridge.safety.stops import stops_of
from pneu_hw_bridge.safety.supervisor import State, Supervisor
from pneu_sim.rig import load_rig

pytestmark = pytest.mark.realtime

ROOT = Path(__file__).parents[3]
KOKORO = ROOT / "rigs" / "kokoro.yaml"
PROFILE = (
    ROOT / "src" / "pneu_hw_bridge" / "pneu_hw_bridge" / "registers" / "profiles"
) / "kokoro_plc.yaml"
TURN = 2.0 * math.pi


def encoder(low, high, **more):
    one = {"table": "input", "address": 0, "type": "uint16", "unit": "rad", "range": (low, high)}
    return Encoder(**{"scale": TURN / 16384, "wrap": 16384, **one, **more})


def test_a_joint_within_a_turn_is_where_its_range_says_whatever_came_before():
    joint = encoder(-1.2, 1.2, offset=0.3)
    turns = Turns({"elbow": joint})
    for place in (-1.1, 0.29, 0.31, 1.1, -0.8, math.nan, 0.0):
        raw = round((place - 0.3) / joint.scale) % 16384 if math.isfinite(place) else None
        read = math.nan if raw is None else joint.decode([raw])
        found = turns.unwrap({"elbow": read, "end": 1e5})
        assert found["end"] == 1e5
        assert found["elbow"] == pytest.approx(place, abs=joint.resolution, nan_ok=True)


def test_a_joint_that_goes_further_is_followed_from_reading_to_reading():
    wheel = encoder(-40.0, 40.0)
    turns = Turns({"wheel": wheel})
    places = [0.4 * k for k in range(60)] + [0.4 * k for k in range(60, -60, -1)]
    found = [
        turns.unwrap({"wheel": wheel.decode([round(p / wheel.scale) % 16384])})["wheel"]
        for p in places
    ]
    assert found == pytest.approx(places, abs=wheel.resolution)


@pytest.mark.parametrize(("beyond", "follows"), [(0.0, False), (0.01, True)])
def test_a_joint_is_followed_where_its_range_is_more_than_a_turn(beyond, follows):
    joint = encoder(-math.pi - beyond, math.pi)
    turns = Turns({"hip": encoder(-1.0, 1.0), "elbow": joint})
    found = [
        turns.unwrap({"elbow": joint.decode([round(place / joint.scale) % 16384])})["elbow"]
        for place in (2.0, 3.1, -3.1)
    ]
    last = TURN - 3.1 if follows else -3.1
    assert found == pytest.approx([2.0, 3.1, last], abs=joint.resolution)


def test_where_a_joint_ends_is_said_by_the_rig_file_unless_the_map_says_otherwise():
    registers = load_register_map("kokoro_plc")
    rig = load_rig(KOKORO)
    limits = limits_of(registers, stops=stops_of(rig)).encoders["elbow"]
    assert (limits.lower, limits.upper) == pytest.approx((-0.935, 0.935))
    assert limits.frozen.stops == (-0.85, 0.85)
    nearer = registers.encoders["elbow"].model_copy(update={"upper": 0.5})
    registers = registers.model_copy(update={"encoders": {"elbow": nearer}})
    limits = limits_of(registers, stops=stops_of(rig)).encoders["elbow"]
    assert (limits.lower, limits.upper) == pytest.approx((-0.935, 0.5))
    with pytest.raises(InputError, match=r"encoders\.elbow\.frozen\.stops: found none"):
        limits_of(registers)


def changed(**elbow):
    yaml = YAML(typ="safe")
    data = yaml.load(PROFILE)
    data["encoders"]["elbow"].update(elbow)
    text = StringIO()
    yaml.dump(data, text)
    return parse_register_map(text.getvalue(), "map.yaml")


@pytest.mark.parametrize(
    ("elbow", "told"),
    [
        ({"unit": "Pa"}, "unit"),
        ({"address": 6}, "both use input"),
        ({"lower": -2.0}, "outside of range"),
        ({"frozen": {"force": {"nose": 1.0}, "hold": 1.0}}, "'nose' is not among taps"),
        ({"wrap": 0.0}, "wrap"),
    ],
)
def test_a_map_that_cannot_be_is_refused_in_a_sentence(elbow, told):
    with pytest.raises(InputError, match=told) as error:
        changed(**elbow)
    assert str(error.value).startswith("map.yaml: ") and "\n" not in str(error.value)


def test_a_freeze_that_is_looked_at_too_long_is_refused():
    frozen = {"force": {"head_port": 5e-4}, "hold": 70.0, "after_s": 0.2, "stops": [-1.0, 1.0]}
    registers = changed(frozen=frozen)
    with pytest.raises(InputError, match=r"encoders\.elbow\.frozen\.after_s: found 0\.2 s"):
        check(registers, limits_of(registers), 0.002, 0.1)


FROZEN = FrozenLimits({"head": 1.0}, 50.0, 0.0, 0.05, 1e-3, (-1.0, 1.0))
LIMITS = EncoderLimits((-2.0, 2.0), -1.1, 1.1, 10.0, 30.0, 4e-4, FROZEN)


class Taken:
    """An encoder's readings, one every 2 ms."""

    def __init__(self, limits=LIMITS):
        self.watch, self.now_s = EncoderWatch("elbow", limits), 100.0

    def read(self, value, force=0.0, count=1, dt_s=0.002):
        """The first trip among some equal readings, and how long it took."""
        for k in range(count):
            self.now_s += dt_s
            said = self.watch.take(value, self.now_s, self.now_s, force, 0.1)
            if said:
                return said, (k + 1) * dt_s
        return "", count * dt_s


def test_an_encoder_at_rest_is_never_frozen_whatever_can_be_held_pushes_it():
    taken = Taken()
    for force in (0.0, 49.0, -49.0, 20.0):
        assert taken.read(0.3, force, 500)[0] == ""


@pytest.mark.parametrize(("place", "into"), [(1.0, 300.0), (0.97, 300.0), (-1.0, -300.0)])
def test_a_joint_that_is_pushed_into_a_stop_is_not_frozen_but_one_pushed_away_is(place, into):
    taken = Taken()
    assert taken.read(place, into, 500)[0] == ""
    said, took_s = taken.read(place, -into, 500)
    assert "is frozen at" in said and 0.05 <= took_s < 0.06


def test_an_encoder_that_flickers_by_less_than_a_movement_is_frozen_too():
    taken, said = Taken(), ""
    for k in range(60):
        said = said or taken.read(0.3 + 4e-4 * (k % 2), 80.0)[0]
    assert "pushed by 80" in said


def test_an_arm_that_begins_to_move_slowly_is_not_frozen():
    taken = Taken()
    for k in range(200):  # with 1 rad/s^2
        assert taken.read(0.5 * (0.05 + 0.002 * k) ** 2, 80.0)[0] == ""


def test_samples_that_come_late_freeze_by_their_own_time():
    for pace, freezes in ((1.0, True), (0.2, False)):  # device time per steady time
        watch = EncoderWatch("elbow", LIMITS)
        said = ""
        for k in range(40):  # 78 ms of steady time
            now_s = 100.0 + 0.002 * k
            said = said or watch.take(0.1, now_s, 1e9 + pace * (now_s - 100.0), 200.0, 1.0)
        assert bool(said) is freezes


def test_unknown_pressures_prove_nothing():
    assert Taken().read(0.3, None, 500)[0] == ""


def test_a_jump_trips_at_once_and_a_fast_joint_after_it_was_fast_for_a_while():
    taken = Taken()
    assert taken.read(0.0, 0.0, 50)[0] == ""
    said, took_s = taken.read(0.4)
    assert "jumped by 0.4 in 2.0 ms" in said and took_s == 0.002
    taken = Taken()
    said = ""
    for k in range(40):  # 12 rad/s
        said = said or taken.read(-1.0 + 0.024 * k)[0]
    assert "moves at 12/s, above its limit 10" in said
    taken = Taken()
    for k in range(40):  # 9 rad/s
        assert taken.read(-1.0 + 0.018 * k)[0] == ""


def test_after_a_gap_nothing_follows_from_the_reading_before():
    taken = Taken()
    taken.read(-0.9)
    assert taken.read(0.9, dt_s=0.2)[0] == ""


def test_readings_of_no_known_time_tell_no_speed():
    watch = EncoderWatch("elbow", LIMITS)
    for k, value in enumerate((0.0, 0.9, -0.9)):
        assert watch.take(value, 100.0 + 0.002 * k, None, 0.0, 0.1) == ""


def supervised():
    registers = load_register_map("kokoro_plc")
    one = Supervisor(limits_of(registers, stops=stops_of(load_rig(KOKORO))))
    one.bus("")
    one.publishers(1)
    one.enable()
    return one


def step(one, now_s, elbow=0.1, pressure=2e5, command=7.0):
    for k, tap in enumerate(one.limits.sensors):
        one.reading(tap, pressure + 1e3 * now_s + k, now_s)
    if elbow is not None:
        one.position("elbow", elbow, now_s, now_s)
    one.command({"head": command, "rod": command}, now_s)
    return one.output(now_s)


def test_both_valves_are_held_while_an_encoder_is_silent_and_follow_again():
    one, now_s = supervised(), 100.0
    assert step(one, now_s, elbow=None) == {"head": 0.0, "rod": 0.0}
    assert "encoder elbow: never read" in one.explain(now_s)
    for k in range(600):
        step(one, now_s := 100.0 + 0.002 * k)
    assert one.state(now_s) is State.FOLLOWING
    for _ in range(60):
        out = step(one, now_s := now_s + 0.002, elbow=None)
    assert out == {"head": 0.0, "rod": 0.0} and "encoder elbow: stale" in one.explain(now_s)
    for _ in range(600):
        step(one, now_s := now_s + 0.002)
    assert one.state(now_s) is State.FOLLOWING


def test_a_joint_beyond_its_limit_trips_until_it_is_back_and_somebody_resets():
    one, now_s = supervised(), 100.0
    for k in range(10):
        step(one, now_s := 100.0 + 0.002 * k, 0.9)
    assert one.state(now_s) is State.FOLLOWING
    now_s += 0.002
    assert step(one, now_s, 0.94) == {"head": 0.0, "rod": 0.0}
    assert one.state(now_s) is State.TRIPPED and one.counters.trips == 1
    assert one.explain(now_s) == "encoder: elbow is at 0.94, above its limit 0.935"
    assert "still" in one.reset(now_s)
    step(one, now_s := now_s + 0.002, 0.9)
    assert one.state(now_s) is State.TRIPPED
    assert one.reset(now_s) == ""
    one.enable()
    step(one, now_s := now_s + 0.002, 0.9)
    assert one.state(now_s) is State.FOLLOWING


def test_an_encoder_out_of_its_range_holds():
    one, now_s = supervised(), 100.0
    for k in range(10):
        step(one, now_s := 100.0 + 0.002 * k)
    one._encoders["elbow"].forget()
    assert step(one, now_s + 0.002, math.nan) == {"head": 0.0, "rod": 0.0}
    assert one.state(now_s + 0.002) is State.HOLDING
