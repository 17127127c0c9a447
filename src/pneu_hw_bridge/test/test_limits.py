# SPDX-License-Identifier: Apache-2.0
"""Limits of a bridge: each number where it belongs, and what is refused, at its boundary."""

import math
from pathlib import Path

import pytest

from pneu_common.errors import InputError
from pneu_hw_bridge.registers.load import parse_register_map
from pneu_hw_bridge.registers.schema import Frozen
from pneu_hw_bridge.safety.bound import check
from pneu_hw_bridge.safety.limits import Limits, OutputLimits, SensorLimits, limits_of
from pneu_hw_bridge.safety.motion import EncoderLimits, FrozenLimits
from pneu_hw_bridge.safety.stops import stops_of
from pneu_sim.rig import load_rig
from pneu_sim.rig.encoder import Encoder as RigEncoder

pytestmark = pytest.mark.kernel_free

ARM = Path(__file__).parents[3] / "rigs" / "arm.yaml"
MAP = parse_register_map(
    """
pneu_registers: 1
name: arm
device: {watchdog_s: 0.11}
channels:
  left: {direction: write, table: holding, address: 0, type: float32, range: [-1, 9], safe: 2}
  right: {direction: write, table: holding, address: 2, type: float32, range: [-3, 7], safe: 0.5}
  head: {direction: read, table: input, address: 0, type: float32, unit: Pa, range: [1.0e4, 1.0e6]}
  rod: {direction: read, table: input, address: 2, type: float32, unit: Pa, range: [2.0e4, 8.0e5],
        trip_above: 7.0e5, hold_below: 3.0e4, frozen_after_s: 0.25}
  oil: {direction: read, table: input, address: 4, type: float32, unit: K, range: [200, 400]}
encoders:
  shoulder: {table: input, address: 6, type: float32, unit: rad, range: [-4, 4]}
  elbow: {table: input, address: 8, type: uint16, unit: rad, range: [-2, 3], scale: 0.01,
          lower: -1.5, upper: 2.5, speed_limit: 5, impossible: 50}
""",
    "arm.yaml",
)
FROZEN = {"force": {"rod": -2.0, "head": 3.0}, "hold": 40.0, "offset": 5.0, "after_s": 0.06}


def map_with(**frozen):
    elbow = MAP.encoders["elbow"].model_copy(update={"frozen": Frozen(**{**FROZEN, **frozen})})
    return MAP.model_copy(update={"encoders": {**MAP.encoders, "elbow": elbow}})


def test_each_number_goes_where_it_belongs():
    found = limits_of(MAP, 0.09, 0.08, 70.0, 0.6, 0.5, 0.4)
    assert found == Limits(
        outputs={"left": OutputLimits(-1.0, 9.0, 2.0), "right": OutputLimits(-3.0, 7.0, 0.5)},
        sensors={
            "head": SensorLimits(1e4, 1e6, math.inf, -math.inf, math.inf),
            "rod": SensorLimits(2e4, 8e5, 7e5, 3e4, 0.25),
        },
        watchdog_s=0.09,
        sensor_timeout_s=0.08,
        slew_v_s=70.0,
        clamp_margin_v=0.6,
        dwell_s=0.5,
        safe_within_s=0.4,
        encoders={
            "shoulder": EncoderLimits(
                (-4.0, 4.0),
                -math.inf,
                math.inf,
                math.inf,
                math.inf,
                MAP.encoders["shoulder"].resolution,
                None,
            ),
            "elbow": EncoderLimits((-2.0, 3.0), -1.5, 2.5, 5.0, 50.0, 0.51 * 0.01, None),
        },
    )


def test_what_is_not_said_has_the_values_of_the_documentation():
    found = limits_of(MAP)
    bare = Limits(outputs=found.outputs, sensors=found.sensors)
    for one in (found, bare):
        assert (one.watchdog_s, one.sensor_timeout_s, one.slew_v_s) == (0.1, 0.1, 2000.0)
        assert (one.clamp_margin_v, one.dwell_s, one.safe_within_s) == (1.0, 1.0, 0.15)
    assert bare.encoders == {}
    assert SensorLimits(1.0, 2.0) == SensorLimits(1.0, 2.0, math.inf, -math.inf, math.inf)
    assert EncoderLimits((1.0, 2.0)) == EncoderLimits(
        (1.0, 2.0), -math.inf, math.inf, math.inf, math.inf, 0.0, None
    )


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("watchdog_s", (1e-9, 0.1), (0.0, -0.01, math.nextafter(0.1, 1.0), math.nan, math.inf)),
        ("sensor_timeout_s", (1e-9, 5.0), (0.0, -1.0, math.nan, math.inf)),
        ("slew_v_s", (1e-9, 5.0), (0.0, -1.0, math.nan, math.inf)),
        ("safe_within_s", (1e-9, 5.0), (0.0, -1.0, math.nan, math.inf)),
        ("clamp_margin_v", (0.0, 5.0), (-1e-9, math.nan, math.inf)),
        ("dwell_s", (0.0, 5.0), (-1e-9, math.nan, math.inf)),
    ],
)
def test_numbers_that_hardware_must_not_have_are_refused(name, good, bad):
    for value in good:
        assert getattr(limits_of(MAP, **{name: value}), name) == value
    for value in bad:
        with pytest.raises(InputError, match=f"^{name}: found {value:g}[, ]"):
            limits_of(MAP, **{name: value})


@pytest.mark.parametrize(("safe", "good"), [(1.0, True), (2.0, True), (0.9, False), (2.1, False)])
def test_a_safe_voltage_lies_within_its_range(safe, good):
    outputs = {"left": OutputLimits(0.0, 5.0, 0.0), "right": OutputLimits(1.0, 2.0, safe)}
    if good:
        assert Limits(outputs=outputs, sensors={}).outputs == outputs
        return
    with pytest.raises(InputError, match="command 'right': its safe voltage"):
        Limits(outputs=outputs, sensors={})


# Where joints end


@pytest.mark.parametrize(
    ("stops", "limits"),
    [
        ((-1.0, 3.0), (-1.2, 3.2)),  # a twentieth of the travel more on either side
        ((-1.0, math.inf), (-1.0, math.inf)),
        ((-math.inf, 3.0), (-math.inf, 3.0)),
        ((0.7, 0.7), (-math.inf, math.inf)),  # held
        ((0.7, 0.6), (-math.inf, math.inf)),
        (None, (-math.inf, math.inf)),
    ],
)
def test_an_encoder_without_limits_has_those_of_its_joint(stops, limits):
    ends = {"elbow": (-0.1, 0.1), **({} if stops is None else {"shoulder": stops})}
    found = limits_of(MAP, stops=ends).encoders
    assert (found["shoulder"].lower, found["shoulder"].upper) == pytest.approx(limits)
    assert (found["elbow"].lower, found["elbow"].upper) == (-1.5, 2.5), "said by the map"


def test_when_an_encoder_is_frozen():
    registers = map_with(stops=(-1.0, 2.0), still=0.03)
    assert limits_of(registers).encoders["elbow"].frozen == FrozenLimits(
        {"rod": -2.0, "head": 3.0}, 40.0, 5.0, 0.06, 0.03, (-1.0, 2.0)
    )
    registers = map_with()
    found = limits_of(registers, stops={"elbow": (-0.5, 1.5)}).encoders["elbow"].frozen
    assert found.stops == (-0.5, 1.5), "those of the rig file"
    assert found.still == 0.51 * 0.01, "the resolution"


@pytest.mark.parametrize("stops", [(-1.0, math.inf), (-math.inf, 1.0), (0.7, 0.7), None])
def test_a_frozen_encoder_needs_to_know_both_ends(stops):
    ends = {} if stops is None else {"elbow": stops}
    with pytest.raises(InputError, match=r"^arm: encoders\.elbow\.frozen\.stops: found none"):
        limits_of(map_with(), stops=ends)


# Settings with which valves cannot be safe in time; here within a quarter of a second


@pytest.mark.parametrize(
    ("name", "most_s"),
    [
        ("timeout_s", 0.25),
        ("sensor_timeout_s", 0.25),
        ("rate_hz", 0.25),
        ("device.watchdog_s", 0.25),
        ("encoders.elbow.frozen.after_s", 0.25),
    ],
)
def test_each_setting_may_take_as_long_as_all_and_no_longer(name, most_s):
    def checked(seconds):
        given = dict.fromkeys(
            ("timeout_s", "sensor_timeout_s", "device.watchdog_s", "encoders.elbow.frozen.after_s"),
            0.125,
        )
        given["rate_hz"] = 0.0078125
        given[name] = seconds
        if name == "rate_hz":
            given["sensor_timeout_s"] = 0.25
        registers = map_with(after_s=given["encoders.elbow.frozen.after_s"], stops=(-1.0, 2.0))
        device = registers.device.model_copy(update={"watchdog_s": given["device.watchdog_s"]})
        registers = registers.model_copy(update={"device": device})
        limits = limits_of(
            registers, sensor_timeout_s=given["sensor_timeout_s"], safe_within_s=0.25
        )
        check(registers, limits, given["rate_hz"], given["timeout_s"])

    beyond = math.nextafter(most_s, 1.0)
    if name == "rate_hz":  # then readings are never fresh
        with pytest.raises(InputError, match=r"^sensor_timeout_s: found 0\.25 s; at rate_hz 4 "):
            checked(most_s)
        with pytest.raises(InputError, match=r"^rate_hz: found 4/s, that is 0\.25 s: a pressure"):
            checked(beyond)
        return
    checked(most_s)
    with pytest.raises(InputError, match=rf"^{name}: found 0\.25\d* s: .*; allowed is 0\.25 s"):
        checked(beyond)


def test_a_good_reading_is_up_to_one_and_a_half_periods_old():
    limits = limits_of(MAP, sensor_timeout_s=0.09375)
    check(MAP, limits, 0.0625, 0.1)
    with pytest.raises(InputError, match=r"good readings are up to 0\.09375 s old"):
        check(MAP, limits, math.nextafter(0.0625, 1.0), 0.1)


def test_a_device_without_a_watchdog_is_no_reason_to_refuse():
    device = MAP.device.model_copy(update={"watchdog_s": None})
    registers = MAP.model_copy(update={"device": device})
    check(registers, limits_of(registers), 0.002, 0.1)


# Where joints end, by the rig file


def test_stops_are_those_of_the_cylinder_or_joint_that_an_encoder_is_on():
    rig = load_rig(ARM)
    channel = rig.encoders["elbow"].channel
    encoders = {
        "elbow": RigEncoder(channel=channel),
        "upper": RigEncoder(channel=channel, joint="shoulder"),
        "rod": RigEncoder(channel=channel, cylinder="elbow"),
        "other_rod": RigEncoder(channel=channel, cylinder="shoulder"),
    }
    rig = rig.model_copy(update={"encoders": encoders})
    assert stops_of(rig) == {
        "elbow": (-1.0, 1.5),
        "upper": (-1.2, 1.4),
        "rod": (0.0, 0.1),
        "other_rod": (0.0, 0.12),
    }


@pytest.mark.parametrize(
    ("joint", "stops"),
    [
        ({"lower": None}, (-math.inf, 1.5)),
        ({"upper": None}, (-1.0, math.inf)),
        ({"lower": 0.0, "upper": 0.25}, (0.0, 0.25)),
        ({"held": True, "start": 0.75}, (0.75, 0.75)),
    ],
)
def test_a_joint_that_is_held_or_open_to_one_side(joint, stops):
    rig = load_rig(ARM)
    body = rig.bodies["arm"]
    changed = body.model_copy(
        update={body.joint_fields[1]: body.joints[1].model_copy(update=joint)}
    )
    rig = rig.model_copy(update={"bodies": {"arm": changed}})
    assert stops_of(rig) == {"shoulder": (-1.2, 1.4), "elbow": stops}


def test_an_encoder_of_a_mechanism_has_no_ends_here():
    rig = load_rig(ARM.parent / "arm4.yaml")
    assert set(stops_of(rig).values()) == {(-math.inf, math.inf)}
