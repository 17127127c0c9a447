# SPDX-License-Identifier: Apache-2.0
"""Register maps: numbers against values worked out by hand, batching, and clear refusals."""

import math
import random
import re
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pneu_common.errors import InputError
from pneu_hw_bridge.registers.batches import plan, plan_writes
from pneu_hw_bridge.registers.codec import count_from_registers, from_registers, to_registers
from pneu_hw_bridge.registers.load import load_register_map, parse_register_map, profiles
from pneu_hw_bridge.registers.schema import Batching, Input, Output

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
    # octets and registers that differ from each other
    (-1.2345678806304932, "float32", "little", "big", [0x0652, 0xBF9E]),
    (-1.2345678806304932, "float32", "big", "little", [0x9EBF, 0x5206]),
]


@pytest.mark.parametrize(("value", "kind", "words", "octets", "registers"), KNOWN)
def test_known_numbers(value, kind, words, octets, registers):
    assert to_registers(value, kind, words, octets) == registers
    assert from_registers(registers, kind, words, octets) == value


WHOLE = {
    "int16": (-(2**15), 2**15 - 1),
    "uint16": (0, 2**16 - 1),
    "int32": (-(2**31), 2**31 - 1),
    "uint32": (0, 2**32 - 1),
    "uint64": (0, 2**64 - 1),
}
ORDERS = [(words, octets) for words in ("big", "little") for octets in ("big", "little")]


def registers_of(number, kind, words, octets):
    """Two's complement in arithmetic, apart from `struct`."""
    width = int(kind.lstrip("uint")) // 16
    bits = number % 2 ** (16 * width)
    found = [(bits >> 16 * (width - 1 - k)) & 0xFFFF for k in range(width)]
    if octets == "little":
        found = [(one >> 8) | (one & 0xFF) << 8 for one in found]
    return found if words == "big" else found[::-1]


def counts(kind):
    """Whole numbers of a type: its ends, small ones of either sign, and random ones."""
    low, high = WHOLE[kind]
    rng = random.Random(3)
    near = [
        n for n in (*range(low, low + 4), *range(-3, 4), *range(high - 3, high + 1)) if n >= low
    ]
    return sorted({*near, *(rng.randint(low, high) for _ in range(200))})


@pytest.mark.parametrize(("words", "octets"), ORDERS)
@pytest.mark.parametrize("kind", list(WHOLE))
def test_whole_numbers_survive_in_every_order(kind, words, octets):
    for number in counts(kind):
        expected = registers_of(number, kind, words, octets)
        assert count_from_registers(expected, kind, words, octets) == number
        assert from_registers(expected, kind, words, octets) == float(number)
        # (a float of 53 bits that has no other neighbour than this one)
        if float(number) == number and abs(number) < 2**53:
            assert to_registers(float(number), kind, words, octets) == expected
        assert to_registers(number, kind, words, octets) == expected


@pytest.mark.parametrize(("words", "octets"), ORDERS)
@pytest.mark.parametrize("kind", list(WHOLE))
def test_a_number_between_two_counts_becomes_the_nearest(kind, words, octets):
    low, high = WHOLE[kind]
    for number in counts(kind):
        if abs(number) > 2**48:  # which has no fraction as a float
            continue
        for part in (-0.5, -0.499, -0.4, -0.001, 0.001, 0.3, 0.499, 0.5):
            value = number + part
            if not low - 0.5 <= value <= high + 0.499:
                continue
            back = count_from_registers(
                to_registers(value, kind, words, octets), kind, words, octets
            )
            assert abs(back - value) <= 0.5
            if abs(part) < 0.5:
                assert back == number
            else:
                assert back % 2 == 0, "of two that are as near, the even one (IEEE 754)"


@pytest.mark.parametrize(("words", "octets"), ORDERS)
@pytest.mark.parametrize(("kind", "code", "size"), [("float32", "f", 4), ("float64", "d", 8)])
@given(st.data())
def test_floats_survive_in_every_order(kind, code, size, words, octets, data):
    value = data.draw(st.floats(width=8 * size))
    packed = struct.pack(f">{code}", value)
    expected = [int.from_bytes(packed[k : k + 2], octets) for k in range(0, size, 2)]
    found = to_registers(value, kind, words, octets)
    assert found == (expected if words == "big" else expected[::-1])
    back = from_registers(found, kind, words, octets)
    assert struct.pack(f">{code}", back) == packed


@given(st.floats(min_value=-3.4e38, max_value=3.4e38))
def test_a_float_between_two_of_four_bytes_becomes_the_nearest(value):
    back = from_registers(to_registers(value, "float32"), "float32")
    assert abs(back - value) <= 2.0**-24 * max(abs(value), 2.0**-126)


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        *((low - 0.501, kind) for kind, (low, _) in WHOLE.items() if kind != "uint64"),
        *((high + 0.501, kind) for kind, (_, high) in WHOLE.items() if kind != "uint64"),
        *((high + 1, kind) for kind, (_, high) in WHOLE.items()),
        *((low - 1, kind) for kind, (low, _) in WHOLE.items()),
        *((value, kind) for kind in WHOLE for value in (math.nan, math.inf, -math.inf)),
        (40000, "int16"),
        (1e39, "float32"),
        (-1e39, "float32"),
    ],
)
def test_numbers_that_do_not_fit_are_refused(value, kind):
    with pytest.raises(ValueError, match=f"^{re.escape(repr(value))} cannot be sent as {kind}$"):
        to_registers(value, kind)


@pytest.mark.parametrize(("scale", "offset"), [(0.25, -3.0), (-0.01, 7.0), (1000.0, 101325.0)])
@pytest.mark.parametrize("kind", list(WHOLE))
def test_a_channel_scales_first_and_then_adds_its_offset(kind, scale, offset):
    one = Input(
        direction="read",
        table="input",
        address=5,
        type=kind,
        word_order="little",
        byte_order="little",
        unit="K",
        scale=scale,
        offset=offset,
        range=(-1.0, 1.0),
    )
    low, high = WHOLE[kind]
    rng = random.Random(5)
    for _ in range(200):
        number = rng.randint(max(low, -(2**40)), min(high, 2**40))
        raw = registers_of(number, kind, "little", "little")
        value = offset + scale * number
        assert one.decode(raw) == pytest.approx(value, rel=1e-12)
        assert one.encode(value) == raw
        between = value + 0.45 * scale
        found = one.decode(one.encode(between))
        assert abs(found - between) <= 0.5 * abs(scale) + 1e-9 * abs(value)
        assert found == pytest.approx(value, rel=1e-12)
    assert one.resolution == 0.51 * abs(scale)
    beyond = [offset + scale * (low - 1)] if low else [offset - scale]
    for value in (*beyond, offset + scale * (high + 1) * (1.0 + 1e-9)):
        with pytest.raises(ValueError, match="cannot be sent"):
            one.encode(value)


@pytest.mark.parametrize(("scale", "offset"), [(24.0, 2.0), (-24.0, 26.0)])
def test_a_bit_is_on_from_its_middle_on(scale, offset):
    one = Output(
        direction="write",
        table="coil",
        address=5,
        scale=scale,
        offset=offset,
        range=(2.0, 26.0),
        safe=2.0,
    )
    on, off = offset + scale, offset
    assert (one.decode([1]), one.decode([0])) == (on, off)
    assert (one.encode(on), one.encode(off)) == ([1], [0])
    middle = offset + 0.5 * scale
    assert one.encode(middle) == [1]
    assert one.encode(middle - 0.001 * scale) == [0]
    for value in (math.nan, math.inf):
        with pytest.raises(ValueError, match="cannot be sent as a bit"):
            one.encode(value)


@pytest.mark.parametrize(
    ("kind", "span", "offset", "resolution"),
    [
        ("float64", (-3.0, 2.0), 0.0, 3e-12),
        ("float64", (-3.0, 5.0), 0.0, 5e-12),
        ("float64", (-0.5, 0.25), 0.0, 2e-12),  # the scale
        ("float32", (-8.0, 4.0), 1.0, 2.0**-19),
        ("float32", (-8.0, 16.0), 1.0, 2.0**-18),
        ("float32", (-8.0, 16.0), -32.0, 2.0**-17),
    ],
)
def test_the_resolution_of_floats_is_that_of_the_largest_number(kind, span, offset, resolution):
    one = Input(
        direction="read",
        table="input",
        address=0,
        type=kind,
        unit="K",
        scale=2.0,
        offset=offset,
        range=span,
    )
    assert one.resolution == pytest.approx(resolution, rel=1e-12)


@pytest.mark.parametrize("words", [[], [1], [1, 2, 3]])
def test_wrong_count_is_refused(words):
    with pytest.raises(ValueError, match=f"found {len(words)} registers for float32, needed are 2"):
        from_registers(words, "float32")
    with pytest.raises(ValueError, match="needed are 2"):
        count_from_registers(words, "uint32")


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


READ = """
  p: {direction: read, table: input, address: 7, type: int16, unit: K, range: [-2, 8], PART}
"""
ENCODER = """
encoders:
  e: {table: input, address: 5, type: int16, unit: rad, range: [-3, 3], PART}
"""


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
        (HEAD + "  a: " + WRITE.replace("type: float32, ", ""), "in table holding needs a type"),
        (HEAD + "  a: " + WRITE.replace("holding", "coil"), "a coil or discrete input has no type"),
        (HEAD + "  a: " + WRITE.replace("safe", "scale: 0, safe"), "scale must not be 0"),
        (
            HEAD + "  a: " + WRITE.replace("3, type: float32", "65533, type: float64"),
            "address 65533 leaves no room for float64",
        ),
        (
            HEAD + "  a: " + WRITE + READ.replace("PART", "trip_above: 8.5"),
            "channels.p: trip_above 8.5 lies outside of range [-2.0, 8.0]",
        ),
        (
            HEAD + "  a: " + WRITE + READ.replace("PART", "hold_below: -2.5"),
            "channels.p: hold_below -2.5 lies outside of range [-2.0, 8.0]",
        ),
        (
            HEAD
            + "  a: "
            + WRITE
            + ENCODER.replace("input", "discrete").replace("type: int16,", ""),
            "encoders.e: table discrete: an encoder needs a register, not a bit",
        ),
        (
            HEAD + "  a: " + WRITE + ENCODER.replace("PART", "upper: 3.5"),
            "encoders.e: upper 3.5 lies outside of range [-3.0, 3.0]",
        ),
        (
            HEAD + "  a: " + WRITE + ENCODER.replace("PART", "lower: 1.5, upper: 1.5"),
            "encoders.e: lower 1.5 must be less than upper 1.5",
        ),
        (
            HEAD + "  a: " + WRITE + ENCODER.replace("  e:", "  a:"),
            "encoders: 'a' is the name of a channel already",
        ),
        (
            HEAD + "  a: " + WRITE + "\nsettings: [{address: 9, value: 3}]",
            "settings.0: a setting needs a type, but on a coil",
        ),
        (
            HEAD
            + "  a: "
            + WRITE
            + "\nsettings: [{table: coil, type: int16, address: 9, value: 1}]",
            "settings.0: a setting needs a type, but on a coil",
        ),
    ],
)
def test_bad_maps_are_refused_in_one_sentence(text, says):
    with pytest.raises(InputError) as caught:
        parse_register_map(text.replace(", PART", ""), "map.yaml")
    assert says in str(caught.value)
    assert str(caught.value).startswith("map.yaml: ")


EDGES = """
  b: {direction: write, table: holding, address: 65532, type: float64, range: [0, 9], safe: 9}
  p: {direction: read, table: input, address: 7, type: int16, unit: K, range: [-2, 8],
      trip_above: 8, hold_below: -2}
encoders:
  e: {table: input, address: 5, type: int16, unit: rad, range: [-3, 3], lower: -3, upper: 3}
settings:
- {table: coil, address: 9, value: 0.5}
- {table: coil, address: 10, value: 0}
"""


def test_what_lies_on_an_edge_is_allowed():
    registers = parse_register_map(HEAD + "  a: " + WRITE + EDGES, "map.yaml")
    assert registers.channels["b"].encode(1.5) == [0x3FF8, 0, 0, 0]
    assert [one.encode() for one in registers.settings] == [[1], [0]]


@pytest.mark.parametrize(
    ("device", "where"),
    [
        ({}, "127.0.0.1:502 unit 7"),
        ({"host": "lab", "port": 1502}, "lab:1502 unit 7"),
        ({"transport": "rtu", "serial_port": "/dev/ttyS3", "unit": 5}, "/dev/ttyS3 unit 5"),
    ],
)
def test_entries_of_the_device_replace_those_of_the_file(device, where):
    text = HEAD + "  a: " + WRITE + "\ndevice: {unit: 7}"
    assert parse_register_map(text, "map.yaml", device).device.where == where
    with pytest.raises(InputError, match=r"^map\.yaml: device: "):
        parse_register_map(text.replace("{unit: 7}", "7"), "map.yaml", device)


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
    of_samples = parse_register_map(TAPPED[: TAPPED.index("  commands:")], "map.yaml")
    assert (of_samples.sample_span, of_samples.command_span) == (samples, None)
    without = parse_register_map(TAPPED[: TAPPED.index("clock:")], "map.yaml")
    assert without.sample_span is without.command_span is None


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
        (
            "records: 3\n    stride: 8",
            "records: 2\n    stride: 6",
            "less than the 7 registers of a record",
        ),
        ("records: 3", "records: 17", "take 135 registers, one read has at most 125"),
        ("records: 3", "records: 6", "both use input 40"),
        ("values: {a: 44}", "values: {b: 44}", "found b, needed are the outputs a"),
        ("values: {a: 44}", "values: {a: 43}", "both use input 43"),
        ("unit: Pa", "unit: K", "no channel in Pa that is sampled"),
        ("direction: read, table: input", "direction: read, table: holding", "no single read has"),
        ("time: {address: 2,", "time: {address: 2, table: holding,", "'clock.samples.time' is in"),
        (
            "time: {address: 42,",
            "time: {address: 42, table: holding,",
            "clock.commands: counter and time are in different tables",
        ),
        (
            "holding, address: 3, type: float32,",
            "coil, address: 3,",
            "clock.commands: output 'a' is a coil, which no record holds",
        ),
        (
            "counter: {address: 40}\n    time: {address: 42, tick_s: 1.0e-6}\n    values: {a: 44}",
            "counter: {address: 65531}\n    time: {address: 65533, tick_s: 1.0e-6}\n"
            "    values: {a: 65535}",
            "clock.commands: 1 records go beyond the last register",
        ),
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
