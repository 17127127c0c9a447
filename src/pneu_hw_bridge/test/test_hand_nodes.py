# SPDX-License-Identifier: Apache-2.0
"""The nodes of an emulated hand and of an arm's bridge: parameters, folders, messages, no graph."""

import contextlib
import dataclasses
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from tests.domains import own_domain_id

from pneu_common.errors import InputError
from pneu_hw_bridge.nodes.hand_lab import HandLab, HandLabParameters, devices_folder
from pneu_hw_bridge.nodes.phantom_bridge import PhantomBridge, joint_state
from pneu_hw_bridge.nodes.phantom_settings import PhantomParameters
from pneu_hw_bridge.phantom.wire import JointSample
from pneu_hw_bridge.safety.supervisor import Latches
from pneu_sim.hand.drive import JointCommand

ROOT = Path(__file__).parents[3]
HAND = ROOT / "scenes/phantom/hand.yaml"
THREE = ROOT / "scenes/phantom/pushing.yaml"


@pytest.mark.parametrize("temporary", ["/some/where", ""])
def test_where_the_sockets_are(monkeypatch: pytest.MonkeyPatch, temporary: str) -> None:
    monkeypatch.setattr(tempfile, "tempdir", None)  # is looked for anew
    monkeypatch.delenv("TMPDIR", raising=False)
    if temporary:
        folder = Path(tempfile.mkdtemp())
        monkeypatch.setattr(tempfile, "tempdir", None)
        monkeypatch.setenv("TMPDIR", str(folder))
        assert devices_folder("") == folder / "pneu-devices"
        folder.rmdir()
    else:
        assert devices_folder("") == Path(tempfile.gettempdir()) / "pneu-devices"
    assert devices_folder("own") == Path("own")


def limits(kind: type) -> dict[str, Any]:
    """Of each number its default, range, and whether it is fixed."""
    of = {
        field.name: (field.default, field.metadata["about"]) for field in dataclasses.fields(kind)
    }
    return {k: (v, about.within, about.read_only) for k, (v, about) in of.items() if about.within}


def test_ranges_of_the_parameters() -> None:
    assert limits(HandLabParameters) == {
        "net_ft_port": (49152, (1, 65535), True),
        "net_ft_web_port": (8049, (1, 65535), True),
        "rate": (1.0, (0.02, 1.0), True),
        "operator_seconds": (10.0, (1.0, 600.0), True),
        "seed": (0, (0, 2**31 - 1), True),
    }
    given = HandLabParameters()
    assert (given.hand, given.truth, given.devices, given.operator) == ("", "", "", "")
    assert (given.follower, given.thing, given.tell_touch) == ("phantom", "object", False)
    assert (given.arm_fault, given.sensor_fault) == ("none", "none")
    assert limits(PhantomParameters) == {
        "rate_hz": (2000.0, (100.0, 4000.0), False),
        "publish_rate_hz": (1000.0, (1.0, 4000.0), False),
        "watchdog_s": (0.05, (0.002, 1.0), False),
        "device_timeout_s": (0.005, (0.001, 0.1), False),
        "sensor_timeout_s": (0.008, (0.001, 0.1), False),
        "dwell_s": (0.5, (0.0, 60.0), False),
        "net_ft_port": (49152, (1, 65535), False),
        "net_ft_web_port": (80, (1, 65535), False),
        "wait_s": (10.0, (0.0, 600.0), False),
    }


@pytest.mark.parametrize(
    ("device_ns", "host_ns", "stamp"),
    [
        (5_000_000_007, 9_000_000_011, (5, 7)),
        (-1, 9_000_000_011, (9, 11)),
        (0, 9_000_000_011, (0, 0)),
        (9_000_000_011, 5_000_000_007, (9, 11)),
    ],
)
def test_a_sample_has_the_devices_time_where_there_is_one(
    device_ns: int, host_ns: int, stamp: tuple[int, int]
) -> None:
    sample = JointSample(device_ns, host_ns, 3.0, (0.1, 0.2), (-0.3, 0.4), (0.5, -0.6))
    message = joint_state(sample, ("waist", "shoulder"))
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == stamp
    assert list(message.name) == ["waist", "shoulder"]
    assert list(message.position) == [0.1, 0.2]
    assert list(message.velocity) == [-0.3, 0.4]
    assert list(message.effort) == [0.5, -0.6]


@pytest.fixture
def context(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[rclpy.Context]:
    monkeypatch.setenv("PNEU_STATE_DIR", str(tmp_path / "state"))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    one = rclpy.Context()
    rclpy.init(args=[], context=one, domain_id=own_domain_id())
    yield one
    one.try_shutdown()


@contextlib.contextmanager
def bridge(context: rclpy.Context, **given: Any) -> Iterator[PhantomBridge]:
    overrides = [Parameter(name, value=value) for name, value in given.items()]
    one = PhantomBridge(context=context, parameter_overrides=overrides)
    try:
        yield one
    finally:
        one.end()
        one.destroy_node()


def test_what_the_loop_is_told(context: rclpy.Context) -> None:
    numbers = {"watchdog_s": 0.06, "device_timeout_s": 0.007, "sensor_timeout_s": 0.009}
    numbers |= {"dwell_s": 0.25, "rate_hz": 1000.0}
    words = {"hand": str(THREE), "arm": "two", "device": "emulated:x", "library": "lib.so"}
    for publish_hz, every in ((400.0, 2), (300.0, 3), (1.0, 1000), (4000.0, 1)):
        with bridge(context, **numbers, **words, publish_rate_hz=publish_hz) as one:
            name, arm = one._arm()
            told = one._told(arm)
        assert name == "two" and arm.wrench is None
        assert told.pop("every") == every
        joints = told.pop("joints")
        assert list(joints) == list(arm.joints)
        assert joints["shoulder"] == arm.joints["shoulder"].model_dump()
        expected = numbers | {"device": "emulated:x", "library": "lib.so", "sensor": None}
        assert told == expected


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({}, "hand: found nothing, a hand file is needed"),
        ({"hand": str(THREE)}, "arm: found '', FILE has one, two, three"),
        ({"hand": str(THREE), "arm": "four"}, "arm: found 'four', FILE has one, two, three"),
        ({"hand": str(HAND)}, None),
    ],
)
def test_which_arm_it_is(context: rclpy.Context, given: dict[str, str], says: str | None) -> None:
    with bridge(context, **given) as one:
        if says is None:
            name, arm = one._arm()
            assert name == "phantom"
            with pytest.raises(InputError) as caught:
                one._told(arm)
            needed = "net_ft_host: found nothing; the arm has a force sensor in the hand file"
            assert str(caught.value) == needed
            return
        with pytest.raises(InputError) as caught:
            one._arm()
        assert str(caught.value) == says.replace("FILE", str(THREE))


def test_what_a_command_asks_of_each_joint(context: rclpy.Context) -> None:
    with bridge(context) as one:
        one._joint_names = ("waist", "shoulder")
        message = JointState(name=["shoulder", "waist"], position=[1.0, 2.0], effort=[3.0, 4.0])
        asked = one._asked(message)
        assert [(a.position_rad, a.effort_n_m) for a in asked] == [(2.0, 4.0), (1.0, 3.0)]
        strange = one._asked(JointState(name=["waist", "knee"], position=[1.0, 2.0]))
        assert strange == [JointCommand(effort_n_m=math.inf)] * 2


def test_a_stop_and_a_reset_of_a_bridge_that_is_not_open(context: rclpy.Context) -> None:
    with bridge(context) as one:
        one._look_at_servo()  # there is none
        (line,) = one._report()
        assert (line.name, line.message) == ("phantom_bridge: safety", "not open")
        assert line.level == b"\x00" and line.hardware_id == "phantom"
        assert one._stop("first") == (True, "latched; the device is not open")
        assert one._stop("second")[0] and one._emergency.latches.e_stop == "first"
        (line,) = one._report()
        assert (line.level, line.message) == (b"\x02", "e-stop: first")
        one._emergency.latches.trip = "too fast"
        refused = one._reset()
        assert refused == "the device is not open, so the joints' positions are not known"
        assert one._emergency.latches.e_stop == "first"
        one._emergency.latches.trip = ""
        assert one._reset() == "" and one._emergency.latches.e_stop == ""


def test_what_was_latched_is_latched_at_the_next_start(context: rclpy.Context) -> None:
    with bridge(context) as one:
        one._emergency.recall("emulated:x")
        assert one._emergency.latches == Latches()
        one._emergency.latches.trip = "too fast"
        one._stop("first")
    with bridge(context) as one:
        one._emergency.recall("emulated:y")  # another device
        assert one._emergency.latches == Latches()
        one._emergency.recall("emulated:x")
        assert one._emergency.latches == Latches(e_stop="first", trip="too fast")
    with bridge(context) as one:
        one._stop("second")
        one._emergency.recall("emulated:x")
        assert one._emergency.latches == Latches(e_stop="second", trip="too fast")


def test_an_emulated_hand_needs_a_hand_file(context: rclpy.Context) -> None:
    with pytest.raises(InputError, match=r"^hand: found nothing, a hand file is needed$"):
        HandLab(context=context)
    with pytest.raises(InputError, match="parameter arm_fault: found 'fire', allowed are none, "):
        HandLab(context=context, parameter_overrides=[Parameter("arm_fault", value="fire")])
