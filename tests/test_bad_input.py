# SPDX-License-Identifier: Apache-2.0
"""Bad input to `pneu`: a non-zero exit, one sentence that names it, and nothing written."""

import importlib.metadata
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from typer.testing import CliRunner

from pneu_common.cli import COMMANDS_GROUP, build_app
from pneu_common.errors import InputError
from pneu_sim.rig import load_rig
from pneu_sysid.records import even_recording
from pneu_sysid.records.write import write_bag

ROOT = Path(__file__).parent.parent
RIG = ROOT / "rigs" / "rig_a.yaml"
RIG_TEXT = RIG.read_text(encoding="utf-8")
RATE_HZ = 500.0
PRESSURE_TYPE = "sensor_msgs/msg/FluidPressure"


def changed_rig(folder, *changes):
    """A copy of the rig file with texts replaced, each of which it must contain."""
    text = RIG_TEXT
    for old, new in changes:
        assert old in text, f"{RIG.name} no longer contains {old!r}"
        text = text.replace(old, new)
    path = folder / "rig.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def recording(samples):
    """A rig at rest under a switching valve: enough for every reader, no physics needed."""
    rig = load_rig(RIG)
    rng = np.random.default_rng(7)
    level = {name: 635000.0 if name == "supply" else 101000.0 for name in rig.taps}
    out = even_recording(
        "run",
        np.arange(samples) / RATE_HZ,
        {"voltage": np.where(np.arange(samples) % 40 < 20, 4.0, 6.0)},
        {n: p + rng.normal(0.0, 100.0, samples) for n, p in level.items()},
    )
    out.start_time_s = 1.76e9
    return out


@pytest.fixture(scope="module")
def good_bag(tmp_path_factory):
    path = tmp_path_factory.mktemp("good") / "run.mcap"
    write_bag(path, load_rig(RIG), recording(200))
    return path


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Runs `pneu` with both packages' commands, in the folder of the test."""
    entries = [
        importlib.metadata.EntryPoint(name, f"{name}.commands:register", COMMANDS_GROUP)
        for name in ("pneu_sim", "pneu_sysid")
    ]
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PNEU_TRACEBACK", raising=False)
    return lambda *words: CliRunner().invoke(
        build_app(entries), [str(word) for word in words], prog_name="pneu"
    )


def check_refusal(result, *named):
    """Exit status 2 and one line on stderr that contains each of the texts."""
    assert result.exit_code == 2, result.stdout + result.stderr
    assert re.fullmatch(r"pneu: [^\n]+\n", result.stderr), result.stderr
    for text in named:
        assert str(text) in result.stderr
    assert "Traceback" not in result.stderr
    assert not list(Path.cwd().rglob(".*.part")), "a file was left half-written"


COMMANDS = {
    "compare": lambda bag, rig: ["compare", bag, "--rig", rig, "--json", "out.json"],
    "fit": lambda bag, rig: ["fit", bag, "--rig", rig, "-o", "out.yaml"],
    "diagnose": lambda bag, rig: ["diagnose", bag, "--rig", rig, "--report", "out.html"],
    "add": lambda bag, rig: ["add", "leak@tube", "--rig", rig, "--bag", bag, "-o", "out.yaml"],
    "learn": lambda bag, rig: ["learn", bag, "--rig", rig, "-o", "out"],
}
every_command = pytest.mark.parametrize("command", list(COMMANDS))


def check_recording_refused(run, command, bag, rig, *named):
    check_refusal(run(*COMMANDS[command](bag, rig)), *named)
    written = [p for p in (Path("out.json"), Path("out.yaml"), Path("out.html")) if p.exists()]
    assert not written
    assert not Path("out").exists() or not list(Path("out").iterdir())


# ---- recordings ---------------------------------------------------------------------------------


@every_command
def test_truncated_bag(run, command, good_bag, tmp_path):
    cut = tmp_path / "cut.mcap"
    whole = good_bag.read_bytes()
    cut.write_bytes(whole[: len(whole) // 2])
    check_recording_refused(run, command, cut, RIG, cut)


@pytest.mark.parametrize("size", [0, 5, 40])
def test_bag_cut_in_its_first_bytes(run, good_bag, tmp_path, size):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(good_bag.read_bytes()[:size])
    check_recording_refused(run, "compare", cut, RIG, cut)


@every_command
def test_bag_without_the_mapped_topic(run, command, good_bag, tmp_path):
    rig = changed_rig(tmp_path, ("/taps/middle/pressure", "/taps/centre/pressure"))
    check_recording_refused(
        run, command, good_bag, rig, good_bag, "/taps/centre/pressure", "/taps/middle/pressure"
    )


@every_command
def test_wrong_field(run, command, good_bag, tmp_path):
    rig = changed_rig(tmp_path, ("field: fluid_pressure", "field: presure"))
    check_recording_refused(
        run, command, good_bag, rig, good_bag, "/taps/", "'presure'", "fluid_pressure"
    )


@every_command
def test_wrong_message_type(run, command, tmp_path):
    other = changed_rig(
        tmp_path,
        (
            "/taps/end/pressure, field: fluid_pressure, type: " + PRESSURE_TYPE,
            "/taps/end/pressure, field: data, type: std_msgs/msg/Float64",
        ),
    )
    bag = tmp_path / "other"
    write_bag(bag, load_rig(other), recording(200))
    check_recording_refused(
        run, command, bag, RIG, bag, "/taps/end/pressure", "std_msgs/msg/Float64", PRESSURE_TYPE
    )


@every_command
def test_tap_that_is_nan_throughout(run, command, good_bag, tmp_path):
    bag = tmp_path / "deaf"
    spoil(good_bag, bag, "/taps/middle/pressure")
    check_recording_refused(run, command, bag, RIG, bag, "/taps/middle/pressure")


def spoil(source, target, topic):
    """Copies a bag with every pressure of one topic replaced by NaN."""
    store = get_typestore(Stores.ROS2_JAZZY)
    reader = Reader(source)
    with reader, Writer(target, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {
            c.topic: writer.add_connection(c.topic, c.msgtype, typestore=store)
            for c in reader.connections
        }
        for connection, stamp_ns, raw in reader.messages():
            if connection.topic == topic:
                message = store.deserialize_cdr(raw, connection.msgtype)
                message.fluid_pressure = float("nan")
                raw = store.serialize_cdr(message, connection.msgtype)
            writer.write(topics[connection.topic], stamp_ns, raw)


@every_command
def test_bag_of_three_samples(run, command, tmp_path):
    bag = tmp_path / "short.mcap"
    write_bag(bag, load_rig(RIG), recording(3))
    check_recording_refused(run, command, bag, RIG, bag, "3 usable sample(s)")


@every_command
def test_recording_that_is_not_there(run, command, tmp_path):
    check_recording_refused(run, command, "nowhere.mcap", RIG, "nowhere.mcap")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("noise.mcap", bytes(range(256)) * 8),
        ("noise.csv", b"\xff\xfe\x00garbage"),
        ("old.db3", b"SQLite format 3\x00"),
    ],
)
def test_file_that_is_no_recording(run, tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    check_recording_refused(run, "compare", name, RIG, name)


def test_folder_that_is_no_bag(run, tmp_path):
    (tmp_path / "folder").mkdir()
    check_recording_refused(run, "compare", "folder", RIG, "folder")


# ---- rig files ----------------------------------------------------------------------------------

WRONG_RIGS = {
    "unknown key": (("length_m: 2.5", "length: 2.5"), ["pipes.tube.length", "length_m"]),
    "unknown key at the top": (("ambient:", "ambiance:"), ["ambiance", "ambient"]),
    "negative length": (("length_m: 2.5", "length_m: -2.5"), ["pipes.tube.length_m", "-2.5"]),
    "length not a number": (("length_m: 2.5", "length_m: .nan"), ["pipes.tube.length_m"]),
    "length in words": (("length_m: 2.5", "length_m: long"), ["pipes.tube.length_m", "long"]),
    "length missing": (("length_m: 2.5, ", ""), ["pipes.tube.length_m"]),
    "unconnected pipe": (("to: closed", "to: nothing"), ["pipes.tube", "nothing", "unconnected"]),
    "port to nowhere": (
        ("from: valve_in", "from: valve"),
        ["valves.valve.ports.supply", "'valve'"],
    ),
    "tap beyond the pipe": (("position_m: 2.475", "position_m: 2.6"), ["taps.end", "2.6", "2.5"]),
    "tap on no pipe": (("{pipe: exhaust_tube", "{pipe: pipe"), ["taps.exhaust.pipe", "'pipe'"]),
    "unknown command": (("command: voltage", "command: volts"), ["valve.command", "'volts'"]),
    "later version": (("pneu_rig: 1", "pneu_rig: 9"), ["pneu_rig", "9"]),
    "unknown effect": (
        ("grid:", "effects: [{effect: gremlin, place: tube}]\ngrid:"),
        ["gremlin"],
    ),
}


@pytest.mark.parametrize("fault", list(WRONG_RIGS))
def test_wrong_rig_file(run, tmp_path, fault):
    change, named = WRONG_RIGS[fault]
    rig = changed_rig(tmp_path, change)
    check_refusal(run("check", rig), *named)


@every_command
@pytest.mark.parametrize("fault", ["unknown key", "negative length", "unconnected pipe"])
def test_wrong_rig_file_with_a_recording(run, command, good_bag, tmp_path, fault):
    change, named = WRONG_RIGS[fault]
    rig = changed_rig(tmp_path, change)
    check_recording_refused(run, command, good_bag, rig, rig, *named)


@pytest.mark.parametrize("command", [*COMMANDS, "check", "simulate"])
def test_time_step_above_the_stable_limit(run, command, good_bag, tmp_path):
    rig = changed_rig(tmp_path, ("grid: {dx_m: 0.05}", "grid: {dx_m: 0.05, dt_s: 1.0e-3}"))
    named = [rig, "grid.dt_s", "0.001", "stable limit"]
    if command == "check":
        check_refusal(run("check", rig), *named)
    elif command == "simulate":
        words = ["simulate", "--rig", rig, "-o", "out.csv", "--steps", "voltage=6:0.1"]
        check_refusal(run(*words), *named)
        assert not Path("out.csv").exists()
    else:
        check_recording_refused(run, command, good_bag, rig, *named)


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (b"", ["mapping"]),
        (b"- a\n- b\n", ["mapping"]),
        (b"name: [rig\npipes: }", ["YAML", "line"]),
        (b"name: a\nname: b\n", ["YAML", "name"]),
        (b"\x89PNG\r\n\x1a\n\xff\xff", ["rig file"]),
    ],
)
def test_file_that_is_no_rig(run, tmp_path, content, named):
    path = tmp_path / "rig.yaml"
    path.write_bytes(content)
    check_refusal(run("check", path), path, *named)


def test_rig_that_is_not_there_or_is_a_folder(run, tmp_path):
    check_refusal(run("check", "nowhere.yaml"), "nowhere.yaml")
    check_refusal(run("check", tmp_path), tmp_path)


# ---- outputs ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("command", "option"),
    [
        ("compare", "--json"),
        ("compare", "--report"),
        ("fit", "-o"),
        ("fit", "--json"),
        ("diagnose", "--report"),
        ("add", "-o"),
        ("learn", "-o"),
        ("learn", "--json"),
    ],
)
def test_output_that_cannot_be_written(run, command, option, good_bag, tmp_path):
    # below a file, where not even root can write
    (tmp_path / "file").write_text("")
    target = Path("file") / "result"
    words = COMMANDS[command](good_bag, RIG)
    if option in words:
        words[words.index(option) + 1] = target
    else:
        words += [option, target]
    check_refusal(run(*words), target)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root writes anywhere")
def test_output_in_a_folder_without_permission(run, good_bag, tmp_path):
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o500)
    check_refusal(run("fit", good_bag, "--rig", RIG, "-o", locked / "rig.yaml"), locked)


def test_simulation_that_cannot_be_written(run, tmp_path):
    (tmp_path / "file").write_text("")
    words = ["simulate", "--rig", RIG, "--steps", "voltage=6:0.02", "-o"]
    for name in ("result", "result.csv", "result.mcap"):
        check_refusal(run(*words, Path("file") / name), Path("file") / name)


# ---- effects ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ("raise RuntimeError('out of gas')", ["RuntimeError", "out of gas"]),
        ("import sys; sys.exit(3)", ["SystemExit"]),
        ("import no_such_module_at_all", ["no_such_module_at_all"]),
        ("def broken(:", ["SyntaxError"]),
        ("X = 1", ["Effect"]),
    ],
)
def test_effects_file_that_does_not_run(run, good_bag, tmp_path, content, named):
    path = tmp_path / "own.py"
    path.write_text(content)
    check_refusal(run("effects", "--effects", path), path, *named)
    words = [*COMMANDS["diagnose"](good_bag, RIG), "--effects", path]
    check_refusal(run(*words), path, *named)


def test_effects_file_that_is_not_there(run):
    check_refusal(run("effects", "--effects", "nowhere.py"), "nowhere.py")


@pytest.mark.parametrize(
    ("effect", "named"),
    [
        ("gremlin@tube", ["gremlin", "leak"]),
        ("leak@attic", ["leak", "attic", "tube"]),
        ("leak@tube:far", ["far"]),
    ],
)
def test_adding_what_there_is_not(run, good_bag, effect, named):
    words = COMMANDS["add"](good_bag, RIG)
    words[1] = effect
    check_refusal(run(*words), *named)


# ---- the program as it is installed -------------------------------------------------------------


def test_in_a_process_of_its_own(tmp_path):
    words = ["check", str(changed_rig(tmp_path, WRONG_RIGS["negative length"][0]))]
    code = "import sys; sys.argv[0] = 'pneu'; from pneu_common.cli import main; main()"
    result = subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, check=False
    )
    assert (result.returncode, result.stdout) == (2, "")
    assert re.fullmatch(r"pneu: \S*rig\.yaml: pipes\.tube\.length_m: .*-2\.5\n", result.stderr)


def test_brackets_in_names_are_brackets(tmp_path, good_bag):
    """Names are not markup: neither lost nor an error after all the work is done."""
    path = changed_rig(
        tmp_path,
        ("  end: {pipe", '  "[/end]": {pipe'),
        ("name: rig_a", 'name: "[red]x"'),
        ("{warm_up_s: 0.4}", "{warm_up_s: 0.0, horizon_s: 0.1}"),
    )
    result = CliRunner().invoke(
        build_app(), ["compare", str(good_bag), "--rig", str(path), "--no-refine"], prog_name="pneu"
    )
    assert result.exit_code == 0, result.output
    assert "[/end]" in result.output


def test_a_position_that_is_no_number(tmp_path, good_bag):
    words = ["add", "leak@tube:nan", "--rig", str(RIG), "--bag", str(good_bag)]
    result = CliRunner().invoke(
        build_app(), [*words, "-o", str(tmp_path / "better.yaml")], prog_name="pneu"
    )
    assert result.exit_code == 2
    assert "position 'nan' is no number of metres" in result.stderr


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("=1+1", "'=1+1'"),
        ("@SUM(A1)", "'@SUM(A1)'"),
        ("a\nb", r"'a\nb'"),
        ("\x1b[31mred", r"'\x1b[31mred'"),
        ("a\u202eb", r"'a\u202eb'"),
        ("", "''"),
        ("x" * 101, "'xxx"),
    ],
)
def test_a_part_has_no_name_that_a_table_or_terminal_would_obey(tmp_path, name, shown):
    rig = load_rig(ROOT / "rigs" / "rig_a.yaml").dump()
    rig["taps"][name] = rig["taps"].pop("end")
    path = tmp_path / "rig.yaml"
    path.write_text(json.dumps(rig))
    with pytest.raises(InputError, match="taps: found the name") as error:
        load_rig(path)
    assert shown in str(error.value) and str(error.value).isprintable()
