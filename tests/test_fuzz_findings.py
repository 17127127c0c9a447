# SPDX-License-Identifier: Apache-2.0
"""What the fuzzer found, each cause once: inputs that ended in anything but one sentence."""

import io
import struct
import warnings

import pytest
from mcap.writer import CompressionType, Writer
from studies.fuzz_bags import MAGIC, metadata
from studies.fuzz_cases import good_inputs
from studies.fuzz_mutations import DIGITS, LAUGHS
from tests.test_bad_input import check_refusal
from typer.testing import CliRunner

from pneu_common.cli import LONGEST_LINE, build_app
from pneu_common.documents import parse_yaml
from pneu_common.errors import InputError
from pneu_sim.effects.registry import _loaded

COMPARE = ["compare", "run.csv", "--rig", "text_rig.yaml", "--no-refine"]
SIMULATE = ["simulate", "--rig", "rig.yaml", "-o", "out.csv"]
STEPS = ["--steps", "voltage=6:0.01"]
# An address that no machine has: a lab that gets so far ends there instead of serving.
NOWHERE = ["--host", "192.0.2.1", "--expose", "--allow-slow"]
LAB = ["lab", "--rig", "rig.yaml", "--port", "0", "--control-port", "0", *NOWHERE]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with sound inputs of all kinds."""
    for name, content in good_inputs().items():
        (tmp_path / name).write_bytes(content)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PNEU_TRACEBACK", raising=False)
    return tmp_path


@pytest.fixture
def refused(folder):
    """Runs `pneu`, which has to refuse in one sentence, without a warning and without a file."""

    def files():
        return sorted(path for path in folder.rglob("*") if "__pycache__" not in path.parts)

    def check(words, *named):
        listed = files()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            ended = CliRunner().invoke(build_app(), [*map(str, words)], prog_name="pneu")
        check_refusal(ended, *named)
        assert len(ended.stderr) < LONGEST_LINE + 100
        assert ended.stderr.strip().isprintable()
        assert files() == listed

    return check


def change(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


# ---- YAML and JSON ------------------------------------------------------------------------------

READERS = {
    "rig.yaml": (["check", "rig.yaml"], "name: tiny"),
    "pid.yaml": (["policy", "pid.yaml"], "tap: end"),
    "settings.yaml": (["train", "settings.yaml", "-o", "file/x"], "seed: 0"),
    "registers.yaml": ([*LAB, "--registers", "registers.yaml"], "name: generic_plc"),
    "effects.yaml": (["lab", "seal", "effects.yaml", "out"], "place: tube"),
    "launch.yaml": (["launch", "launch.yaml", "--print"], "pkg: pneu_sim"),
}
LAUGHED = "[" + LAUGHS.replace("\n", "").replace("l0:", "&m {l0:").replace("]l", "], l") + "}]"
HAZARDS = {
    "5000 digits": DIGITS,
    "400 digits": "9" * 400,
    "deep": "[" * 1200 + "]" * 1200,
    "laughs": LAUGHED,
    "itself": "&m [*m]",
    "half a character": '"\\uD800"',
    "date": "2020-99-99",
    "mapping as key": "{{a: b}: c}",
}


@pytest.mark.long
@pytest.mark.parametrize("hazard", list(HAZARDS))
@pytest.mark.parametrize("name", list(READERS))
def test_what_yaml_can_say(refused, folder, name, hazard):
    words, old = READERS[name]
    change(folder / name, old, f"{old.partition(': ')[0]}: {HAZARDS[hazard]}")
    refused(words, name)


def test_the_laughs_are_what_they_should_be():
    with pytest.raises(InputError, match="stands for more than 1000000 values"):
        parse_yaml(f"a: {LAUGHED}", "a.yaml", "file")


@pytest.mark.parametrize("content", ["[" * 100_000, f'{{"control_port": {DIGITS}}}', "{}", "\0"])
def test_a_ready_file_that_is_none(refused, folder, content):
    (folder / "ready.json").write_text(content)
    refused(["lab", "status", "--ready-file", "ready.json"], "ready.json")


@pytest.mark.parametrize("content", ["[" * 100_000, f'{{"pneu_evaluation": {DIGITS}}}', "[]", "1"])
def test_a_folder_of_an_evaluation_that_is_none(folder, content):
    from pneu_policy.judge.results import load

    (folder / "evaluation.json").write_text(content)
    with pytest.raises(InputError, match=r"evaluation\.json"):
        load(folder / "evaluation.json")


@pytest.mark.parametrize(
    "words",
    [
        ["check", "/dev/zero"],
        ["policy", "/dev/zero"],
        ["lab", "reveal", "/dev/zero"],
        ["compare", "/dev/zero", "--rig", "text_rig.yaml"],
        [*SIMULATE, "--command", "voltage=/dev/zero"],
    ],
)
def test_a_device_without_an_end(refused, words):
    refused(words, "/dev/zero")


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("fraction: [0.0, 1.0]", "fraction: [0.0, 1e308]", "opening.fraction.1"),
        ("voltage_v: [5.0, 10.0]", "voltage_v: [5.0, 1e308]", "opening.voltage_v.1"),
        ("voltage_v: [5.0, 10.0]", "voltage_v: [0.0, 5e-324]", "voltage_v must increase by"),
    ],
)
def test_an_opening_that_cannot_be_drawn(refused, folder, old, new, named):
    change(folder / "rig.yaml", old, new)
    refused(["check", "rig.yaml"], "rig.yaml", "valves.valve.ports.fill", named)


@pytest.mark.parametrize("method", ["places", "on_rig", "on_model"])
def test_an_effect_of_ones_own_that_does_not_run(refused, folder, method):
    text = (folder / "own.py").read_text()
    assert f"def {method}(self" in text
    head, found, rest = text.partition(f"def {method}(self")
    line, end, body = rest.partition(":\n")
    (folder / "own.py").write_text(f"{head}{found}{line}{end}        {{}}['nothing']\n{body}")
    words = ["diagnose", "good.mcap", "--rig", "rig.yaml", "--no-refine", "--effects", "own.py"]
    try:
        refused(words, "own.py: effect", f"{method} does not run", "KeyError", "nothing")
    finally:
        _loaded.clear()  # the next test is told of the built-in ones alone


# ---- messages -----------------------------------------------------------------------------------


def test_what_is_quoted_is_printable_and_not_endless(refused, folder):
    change(folder / "rig.yaml", "length_m: 0.75", f'length_m: "\\e[31m\\0{"x" * 5000}"')
    refused(["check", "rig.yaml"], "pipes.tube.length_m", r"\x1b[31m\x00xxx")


# ---- tables -------------------------------------------------------------------------------------


@pytest.mark.parametrize("cell", ["1" * 200_000, '"' + "x" * 200_000])
def test_a_cell_that_is_longer_than_any_number(refused, folder, cell):
    change(folder / "run.csv", "\n2,", f"\n{cell},")
    refused(COMPARE, "run.csv", "line 3")
    change(folder / "volts.csv", "0.002,", f"{cell},")
    refused([*SIMULATE, "--command", "voltage=volts.csv"], "volts.csv")


def test_a_row_is_quoted_in_part(refused, folder):
    change(folder / "volts.csv", "0.002,", f"0.002,x{DIGITS}")
    refused([*SIMULATE, "--command", "voltage=volts.csv"], "volts.csv", "needed are time and volts")


def test_values_beyond_all_numbers(refused, folder):
    text = (folder / "run.csv").read_text().splitlines()
    far = [text[0]] + [",".join(["1e308", *row.split(",")[1:3], "1e305"]) for row in text[1:]]
    (folder / "run.csv").write_text("\n".join(far))
    refused(COMPARE, "run.csv")


def test_a_command_beyond_all_volts(folder):
    """It is dropped, as a reading that is no number, and does not end up in the JSON."""
    change(folder / "run.csv", "\n64,6,", "\n64,1e308,")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ended = CliRunner().invoke(build_app(), [*COMPARE, "--json", "c.json"], prog_name="pneu")
    assert ended.exit_code == 0, ended.output
    assert "Infinity" not in (folder / "c.json").read_text()


@pytest.mark.parametrize("delimiter", ["\\n", "\\r", '\\"'])
def test_a_delimiter_that_is_none(folder, delimiter):
    change(folder / "text_rig.yaml", 'delimiter: ","', f'delimiter: "{delimiter}"')
    ended = CliRunner().invoke(build_app(), COMPARE, prog_name="pneu")
    check_refusal(ended)


# ---- bags ---------------------------------------------------------------------------------------


def bag_of(definition, named="std_msgs/msg/Float64", topic="/valve/voltage"):
    out = io.BytesIO()
    writer = Writer(out, compression=CompressionType.NONE)
    writer.start()
    schema = writer.register_schema(named, "ros2msg", definition.encode())
    for name in (topic, "/taps/out", "/taps/end"):
        channel = writer.register_channel(name, "cdr", schema)
        for k in range(30):
            writer.add_message(channel, 10**9 + 2 * 10**6 * k, bytes(12), 0)
    writer.finish()
    return out.getvalue()


def test_stamps_from_here_to_the_end_of_time(refused, folder):
    """Each channel is so slow that nothing jumps."""
    out = io.BytesIO()
    writer = Writer(out)
    writer.start()
    schema = writer.register_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data\n")
    for name in ("/valve/voltage", "/taps/out", "/taps/end"):
        channel = writer.register_channel(name, "cdr", schema)
        level = 6.0 if name == "/valve/voltage" else 2e5
        for k in range(30):
            data = b"\0\1\0\0" + struct.pack("<d", level + k)
            writer.add_message(channel, 10**9 + k * 10**17, data, 0)
    writer.finish()
    (folder / "odd.mcap").write_bytes(out.getvalue())
    text = (folder / "rig.yaml").read_text().replace("field: fluid_pressure", "field: data")
    (folder / "plate.yaml").write_text(text.replace("name: tiny", "name: tiny\nmodel: thin_plate"))
    refused(["diagnose", "odd.mcap", "--rig", "plate.yaml"], "odd.mcap", "lasts 2.9e+09 s")


BAR = "=" * 80


@pytest.mark.parametrize(
    "definition",
    [
        "evil y\n",
        f"a/B y\n{BAR}\nMSG: a/B\na/C z\n",
        f"a/B y\n{BAR}\nMSG: a/B\na/B z\n",
        "float64 data\n\0",
    ],
)
def test_a_definition_that_defines_too_little(refused, folder, definition):
    (folder / "odd.mcap").write_bytes(bag_of(definition))
    refused(["compare", "odd.mcap", "--rig", "rig.yaml"], "odd.mcap", "/valve/voltage")


def test_a_type_by_its_short_name(refused, folder):
    (folder / "odd.mcap").write_bytes(bag_of("float64 data\n", named="std_msgs/Float64"))
    refused(["compare", "odd.mcap", "--rig", "rig.yaml"], "odd.mcap", "has no std_msgs/Float64")


def edited(good, opcode, edit):
    """A file with the content of its first record of a kind changed."""
    at = len(MAGIC)
    while good[at] != opcode:
        at += 9 + struct.unpack_from("<Q", good, at + 1)[0]
    body = bytearray(good[at + 9 : at + 9 + struct.unpack_from("<Q", good, at + 1)[0]])
    edit(body)
    return good[: at + 9] + bytes(body) + good[at + 9 + len(body) :]


FOOTER = 2


@pytest.mark.parametrize("offset", [0, 7, 2**31, 2**63, 2**64 - 1])
def test_an_index_that_is_nowhere(folder, offset):
    """The file is read without it."""
    good = (folder / "good.mcap").read_bytes()
    footer = edited(good, FOOTER, lambda b: b.__setitem__(slice(8), struct.pack("<Q", offset)))
    (folder / "odd.mcap").write_bytes(footer)
    ended = CliRunner().invoke(build_app(), ["bag", "info", "odd.mcap"], prog_name="pneu")
    assert ended.exit_code == 0, ended.output
    assert "Messages:          180" in ended.output


@pytest.mark.long
def test_a_file_that_is_cut_anywhere_near_its_end(folder):
    """Inside of the index, where lengths and offsets are read that are not there."""
    good = (folder / "good.mcap").read_bytes()
    app = build_app()
    for size in range(len(good) - 400, len(good), 3):
        (folder / "odd.mcap").write_bytes(good[:size])
        ended = CliRunner().invoke(app, ["bag", "info", "odd.mcap"], prog_name="pneu")
        assert ended.exit_code == 0, (size, ended.output)


@pytest.mark.parametrize("length", [2**31, 2**63, 2**64 - 1])
def test_a_chunk_that_says_it_is_endless(folder, length):
    def lengthen(body):
        body[36 : 36 + 8] = struct.pack("<Q", length)  # after times, size, checksum and b"zstd"

    good = (folder / "good.mcap").read_bytes()
    chunk = edited(good, 6, lengthen)
    (folder / "odd.mcap").write_bytes(chunk[:-100])
    ended = CliRunner().invoke(build_app(), ["bag", "info", "odd.mcap"], prog_name="pneu")
    assert ended.exit_code == 0, ended.output
    assert "damaged at byte" in ended.output


def test_a_message_of_no_channel(folder):
    out = io.BytesIO()
    writer = Writer(out, use_chunking=False)
    writer.start()
    writer.add_message(77, 10**9, bytes(12), 0)
    whole = out.getvalue()  # without index, as a killed recorder leaves it
    (folder / "odd.mcap").write_bytes(whole)
    for command in ("info", "recover"):
        ended = CliRunner().invoke(build_app(), ["bag", command, "odd.mcap"], prog_name="pneu")
        assert ended.exit_code == 0, ended.output
        assert "a message of channel 77, which is unknown" in ended.output


@pytest.mark.parametrize("path", ["1.5", "[a]", "{}", "../run.mcap", "/run.mcap", "~"])
def test_metadata_that_names_no_file(refused, folder, path):
    (folder / "bag").mkdir()
    (folder / "bag" / "run.mcap").write_bytes((folder / "good.mcap").read_bytes())
    text = metadata("run.mcap", 180).replace("- path: run.mcap", f"- path: {path}")
    (folder / "bag" / "metadata.yaml").write_text(text)
    refused(["bag", "info", "bag"], "metadata.yaml")


@pytest.mark.parametrize("count", [".inf", ".nan", "x", "[]"])
def test_metadata_with_a_count_that_is_none(refused, folder, count):
    (folder / "bag").mkdir()
    (folder / "bag" / "run.mcap").write_bytes((folder / "good.mcap").read_bytes())
    text = metadata("run.mcap", 180).replace("message_count: 180", f"message_count: {count}")
    (folder / "bag" / "metadata.yaml").write_text(text)
    refused(["bag", "info", "bag"], "metadata.yaml")
    refused(["compare", "bag", "--rig", "rig.yaml"], "metadata.yaml")


# ---- command lines ------------------------------------------------------------------------------


@pytest.mark.parametrize("value", ["x", "1.5", "", "-1", str(10**30), DIGITS])
@pytest.mark.parametrize(
    ("words", "option"),
    [
        ([*SIMULATE, *STEPS], "--seed"),
        (["tune", "--rig", "rig.yaml", "-o", "out.yaml"], "--seed"),
        (["train", "settings.yaml", "-o", "file/x"], "--seed"),
        (LAB, "--seed"),
        (["evaluate", "pid.yaml", "--rig", "rig.yaml", "-o", "out"], "--seeds"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else value,
)
def test_a_seed_that_is_none(refused, words, option, value):
    refused([*words, option, value], option)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ([*SIMULATE, *STEPS, "--duration", "2147483648"], "--duration"),
        ([*SIMULATE, *STEPS, "--duration", "inf"], "--duration"),
        (["tune", "--rig", "rig.yaml", "-o", "o.yaml", "--trials", str(10**9)], "--trials"),
        (["tune", "--rig", "rig.yaml", "-o", "o.yaml", "--generations", DIGITS], "--generations"),
        (["evaluate", "pid.yaml", "--rig", "rig.yaml", "-o", "o", "--duration", "inf"], "duration"),
        (["evaluate", "pid.yaml", "--rig", "rig.yaml", "-o", "o", "--duration", "1e9"], "duration"),
        (["lab", "status", "--control-port", "99999"], "--control-port"),
        (["lab", "status", "--control-port", "-1"], "--control-port"),
        ([*LAB, "--port", "99999"], "--port"),
    ],
    ids=lambda value: " ".join(value)[:60] if isinstance(value, list) else value,
)
def test_numbers_that_nobody_waits_for(refused, words, named):
    refused(words, named)


def test_two_signals_on_one_topic(refused, folder):
    change(folder / "rig.yaml", "/taps/end", "/taps/out")
    refused([*SIMULATE[:-1], "bag", *STEPS], "valve_out", "/taps/out", "one for each")


@pytest.mark.parametrize("duration", ["0.9", "1.0", "1.1"])
def test_a_run_that_ends_before_what_is_usually_shown(folder, duration):
    words = ["evaluate", "pid.yaml", "--rig", "rig.yaml", "--seeds", "0", "--targets", "smooth"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        words += ["--duration", duration, "--skip", "0.3", "-o", "out"]
        ended = CliRunner().invoke(build_app(), words, prog_name="pneu")
    assert ended.exit_code == 0, ended.output
    assert list((folder / "out").glob("runs-*.png"))
