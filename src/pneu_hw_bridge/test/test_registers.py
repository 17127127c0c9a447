# SPDX-License-Identifier: Apache-2.0
"""Register maps: numbers against values worked out by hand, batching, and clear refusals."""

import math
import random
import struct

import pytest

from pneu_common.errors import InputError
from pneu_hw_bridge.registers.batches import plan, plan_writes
from pneu_hw_bridge.registers.codec import (
    count_from_registers,
    from_registers,
    to_registers,
)
from pneu_hw_bridge.registers.load import load_register_map, parse_register_map, profiles
from pneu_hw_bridge.registers.schema import Batching, Input

pytestmark = pytest.mark.realtime

# From the standards of the formats: IEEE 754 and two's complement.
KNOWN = [
    (1.0, "float32", "big", "big", [0x3F80, 0x0000]),
    (1.0, "float32", "little", "big", [0x0000, 0x3F80]),
    (1.0, "float32", "big", "little", [0x803F, 0x0000]),
    (1.0, "float32", "little", "little", [0x0000, 0x803F]),
    (-2.5, "float32", "big", "big", [0xC020, 0x0000]),
    (1.0, "float64", "big", "big", [0x3FF0, 0, 0, 0]),
    (1.0, "float64", "little", "big", [0, 0, 0, 0x3FF0]),
    (-2, "int16", "big", "big", [0xFFFE]),
    (0x1234, "uint16", "big", "little", [0x3412]),
    (-2, "int32", "big", "big", [0xFFFF, 0xFFFE]),
    (0x12345678, "uint32", "big", "big", [0x1234, 0x5678]),
    (0x12345678, "uint32", "little", "big", [0x5678, 0x1234]),
    (0x12345678, "uint32", "little", "little", [0x7856, 0x3412]),
    # rounded to the nearest, halves to the even one: a cut, a floor and a ceiling differ
    (2.4, "int16", "big", "big", [2]),
    (2.6, "int16", "big", "big", [3]),
    (2.5, "uint16", "big", "big", [2]),
    (3.5, "uint32", "big", "big", [0, 4]),
    (-2.4, "int16", "big", "big", [0xFFFE]),
    (-2.6, "int32", "big", "big", [0xFFFF, 0xFFFD]),
    (0x0123456789ABCDEF, "uint64", "big", "big", [0x0123, 0x4567, 0x89AB, 0xCDEF]),
    (0x0123456789ABCDEF, "uint64", "little", "little", [0xEFCD, 0xAB89, 0x6745, 0x2301]),
    # octets and registers that differ from each other
    (1.5000001192092896, "float32", "little", "little", [0x0100, 0xC03F]),
    (4.0 / 3.0, "float64", "little", "big", [0x5555, 0x5555, 0x5555, 0x3FF5]),
    (-1.2345678806304932, "float32", "little", "big", [0x0652, 0xBF9E]),
    (-1.2345678806304932, "float32", "big", "little", [0x9EBF, 0x5206]),
]


@pytest.mark.parametrize(("value", "kind", "words", "octets", "registers"), KNOWN)
def test_known_numbers(value, kind, words, octets, registers):
    assert to_registers(value, kind, words, octets) == registers
    back = from_registers(registers, kind, words, octets)
    if kind.startswith("float"):
        assert back == value
    else:
        assert abs(back - value) <= 0.5
        exact = count_from_registers(registers, kind, words, octets)
        assert float(exact) == back and isinstance(exact, int)
    if kind == "uint64":
        assert exact == value


def test_random_numbers_agree_with_struct_and_survive():
    rng = random.Random(3)
    formats = {
        "float32": ">f", "float64": ">d", "int32": ">i", "uint32": ">I", "int16": ">h",
        "uint16": ">H", "uint64": ">Q",
    }  # fmt: skip
    for _ in range(2000):
        kind = rng.choice(list(formats))
        low = -(2**15) if kind.startswith("int") else 0
        number = rng.randrange(low, 2**15) if "int" in kind else rng.uniform(-1e6, 1e6)
        data = struct.pack(formats[kind], number)
        words, octets = rng.choice(["big", "little"]), rng.choice(["big", "little"])
        # both orders by what they mean: which register, and which octet of each, comes first
        pairs = [data[i : i + 2] for i in range(0, len(data), 2)]
        pairs = pairs if words == "big" else pairs[::-1]
        expected = [a << 8 | b if octets == "big" else b << 8 | a for a, b in pairs]
        assert to_registers(number, kind, words, octets) == expected
        again = from_registers(expected, kind, words, octets)
        assert again == struct.unpack(formats[kind], data)[0]


@pytest.mark.parametrize(
    ("value", "kind"),
    [(40000, "int16"), (-1, "uint16"), (2**32, "uint32"), (math.nan, "int32"), (1e39, "float32")],
)
def test_numbers_that_do_not_fit_are_refused(value, kind):
    with pytest.raises(ValueError, match="cannot be sent"):
        to_registers(value, kind)


def test_wrong_count_is_refused():
    with pytest.raises(ValueError, match="needed are 2"):
        from_registers([1], "float32")


@pytest.mark.parametrize("name", profiles())
def test_profiles_are_valid_and_read_in_one_request(name):
    registers = load_register_map(name)
    assert len(plan({**registers.inputs, **registers.encoders}, registers.batching)) == 1
    assert {output.safe for output in registers.outputs.values()} == {0.0}
    if not name.startswith("kokoro"):
        assert set(registers.taps) == {"supply", "valve_out", "middle", "end", "exhaust"}


def test_labjack_addresses_and_scales():
    registers = load_register_map("labjack_t")
    voltage = registers.channels["voltage"]
    assert (voltage.table, voltage.address) == ("holding", 1000)
    assert voltage.encode(10.0) == [0x40A0, 0x0000]  # 5 V from the DAC, the amplifier doubles it
    assert [tap.address for tap in registers.taps.values()] == [0, 2, 4, 6, 8]
    # 1 V from the transmitter is 1 bar gauge
    assert registers.channels["end"].decode([0x3F80, 0x0000]) == pytest.approx(201325.0)
    assert registers.settings[0].encode() == [0x4120, 0x0000]


def channel(address, table="input", kind="float32"):
    return Input(
        direction="read", table=table, address=address, type=kind, unit="Pa", range=(0.0, 1e6)
    )


def test_batches_follow_gaps_limits_and_tables():
    channels = {
        "a": channel(0),
        "b": channel(2),
        "far": channel(40),
        "near": channel(44, kind="uint16"),
        "other": channel(3, "holding"),
    }
    batches = plan(channels, Batching(max_gap=2))
    assert [(b.table, b.address, b.count) for b in batches] == [
        ("holding", 3, 2),
        ("input", 0, 4),
        ("input", 40, 5),
    ]
    raw = [0x3F80, 0, 0x4000, 0]
    assert batches[1].decode(raw) == {"a": 1.0, "b": 2.0}
    many = {str(i): channel(2 * i) for i in range(10)}
    assert [b.count for b in plan(many, Batching(max_registers=6))] == [6, 6, 6, 2]


def test_nothing_undefined_is_written():
    registers = parse_register_map(
        """
pneu_registers: 1
name: two
channels:
  a: {direction: write, table: holding, address: 0, type: uint16, scale: 0.001,
      range: [0, 10], safe: 0}
  b: {direction: write, table: holding, address: 2, type: uint16, scale: 0.001,
      range: [0, 10], safe: 5}
""",
        "two.yaml",
    )
    batches = plan_writes(registers.outputs)
    assert [(b.address, b.encode({"a": 1.0, "b": 2.0})) for b in batches] == [
        (0, [1000]),
        (2, [2000]),
    ]


HEAD = "pneu_registers: 1\nname: m\nchannels:\n"
WRITE = "{direction: write, table: holding, address: 3, type: float32, range: [0, 10], safe: 0}"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("pneu_registers: 2", "found 2, this version reads 1"),
        ("- a", "a register map is a mapping"),
        ("{", "is not YAML"),
        (HEAD + "  a: " + WRITE.replace("address", "adress"), "did you mean 'address'"),
        (HEAD + "  a: " + WRITE.replace("holding", "input"), "cannot be written to table input"),
        (HEAD + "  a: " + WRITE.replace("safe: 0", "safe: 11"), "lies outside of range"),
        (HEAD + "  a: " + WRITE.replace("float32", "float16"), "channels.a.type"),
        (HEAD + "  a: " + WRITE.replace("float32", "uint16, scale: 1.0e-5"), "cannot be sent"),
        (HEAD + "  a: " + WRITE + "\n  b: " + WRITE, "both use holding 3"),
        (HEAD + "  a: " + WRITE.replace("[0, 10]", "[10, 0]"), "must increase"),
        (
            HEAD
            + "  a: {direction: read, table: input, address: 0, type: int16, unit: Pa,"
            + " range: [0, 1]}",
            "nothing to command",
        ),
        (HEAD + "  a: " + WRITE + "\ndevice: {portt: 3}", "did you mean 'port'"),
    ],
)
def test_bad_maps_are_refused_in_one_sentence(text, says):
    with pytest.raises(InputError) as caught:
        parse_register_map(text, "map.yaml")
    assert says in str(caught.value)
    assert str(caught.value).startswith("map.yaml: ")


TAPPED = (
    HEAD
    + "  a: "
    + WRITE
    + """
  p: {direction: read, table: input, address: 6, type: uint16, unit: Pa, range: [0, 1.0e6]}
clock:
  samples:
    counter: {address: 0}
    time: {address: 2, type: uint64, tick_s: 1.0e-9}
    records: 3
    stride: 8
  commands:
    counter: {address: 40}
    time: {address: 42, tick_s: 1.0e-6}
    values: {a: 44}
"""
)


def test_a_clock_is_read():
    registers = parse_register_map(TAPPED, "map.yaml")
    samples, commands = registers.sample_span, registers.command_span
    assert (samples.table, samples.address, samples.count) == ("input", 0, 23)
    assert (commands.table, commands.address, commands.count) == ("input", 40, 6)
    count = registers.clock.samples.time
    assert count.decode([0, 0, 1, 2]) == 2**16 + 2
    assert count.encode(2**64 + 2**16 + 2) == [0, 0, 1, 2]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("counter: {address: 0}", "counter: {adress: 0}", "did you mean 'address'"),
        ("counter: {address: 0}", "counter: {address: 0, type: float32}", "clock.samples.counter"),
        ("counter: {address: 0}", "counter: {address: 6}", "both use input 6"),
        ("counter: {address: 0}", "counter: {table: holding, address: 9}", "no single read has"),
        ("tick_s: 1.0e-9", "tick_s: 0.0", "clock.samples.time.tick_s"),
        (
            "tick_s: 1.0e-9",
            "period: 1.0e-9",
            "known are table, address, type, word_order, byte_order, tick_s",
        ),
        ("stride: 8", "stride: 6", "less than the 7 registers of a record"),
        ("    stride: 8\n", "", "3 records need a stride"),
        ("records: 3", "records: 17", "take 135 registers, one read has at most 125"),
        ("records: 3", "records: 6", "both use input 40"),
        ("values: {a: 44}", "values: {b: 44}", "found b, needed are the outputs a"),
        ("values: {a: 44}", "values: {a: 43}", "both use input 43"),
        ("unit: Pa", "unit: K", "no channel in Pa that is sampled"),
        ("direction: read, table: input", "direction: read, table: holding", "no single read has"),
    ],
)
def test_a_clock_that_cannot_be_is_refused_in_one_sentence(old, new, says):
    assert old in TAPPED
    with pytest.raises(InputError) as caught:
        parse_register_map(TAPPED.replace(old, new, 1), "map.yaml")
    assert says in str(caught.value)
    assert str(caught.value).startswith("map.yaml: ")
    assert "\n" not in str(caught.value)


def test_missing_map_names_the_profiles():
    with pytest.raises(
        InputError, match="generic_plc, kokoro_logger, kokoro_plc, labjack_t, logging_plc"
    ):
        load_register_map("no_such_map.yaml")
