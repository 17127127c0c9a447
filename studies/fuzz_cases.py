# SPDX-License-Identifier: Apache-2.0
"""The cases of the fuzzer: what is written into a folder, and the commands that are run there.

A case is a generator: it yields the words of a command and is told the status it ended with.
"""

import functools
import inspect
import io
import random
import types
import typing
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import numpy as np
import typer

from pneu_common.errors import InputError
from pneu_sim.rig import load_rig
from pneu_sim.rig.plan import plan_grid
from pneu_sysid.records import even_recording
from pneu_sysid.records import write as records_write
from studies import fuzz_bags
from studies import fuzz_mutations as spoil

ROOT = Path(__file__).resolve().parent.parent
Case = Generator[list[str], int, None]

SAMPLES = 60
MOST_UPDATES = 3_000_000
"""Updates of cells that a simulation of a spoilt rig may take; it is cut short to that."""

TINY_RIG = """\
pneu_rig: 1
name: tiny
grid: {dx_m: 0.25, memory: false}
fit:
  warm_up_s: 0.0
  horizon_s: 0.1
  parameters:
  - {path: reservoirs.supply.pressure_pa, lower: 5.0e5, upper: 8.0e5, std_error: 1000.0}
reservoirs:
  supply: {pressure_pa: 635000.0}
  room: {pressure_pa: 101000.0}
pipes:
  tube: {from: valve_out, to: closed, length_m: 0.75, area_m2: 6.0e-6}
valves:
  valve:
    command: voltage
    ports:
      fill:
        from: supply
        to: valve_out
        conductance_m3_s_pa: 0.9e-8
        opening: {voltage_v: [5.0, 10.0], fraction: [0.0, 1.0]}
      exhaust:
        from: valve_out
        to: room
        conductance_m3_s_pa: 0.9e-8
        opening: {mirror: fill}
commands:
  voltage: {channel: {topic: /valve/voltage}}
taps:
  valve_out: {pipe: tube, position_m: 0.1, channel: {topic: /taps/out, field: fluid_pressure}}
  end: {pipe: tube, position_m: 0.75, channel: {topic: /taps/end, field: fluid_pressure}}
"""
TEXT_RIG = (
    TINY_RIG.replace("topic: /valve/voltage", "column: volts")
    .replace("topic: /taps/out, field: fluid_pressure", "column: 2")
    .replace("topic: /taps/end, field: fluid_pressure", "column: end, scale: 1.0e5")
    + 'text: {time: t, time_scale: 1.0e-3, delimiter: ","}\n'
)
PID = """\
pneu_controller: 1
kind: pid
tap: end
period_s: 0.01
gains: {kp_v_per_pa: 1.0e-05, ki_v_per_pa_s: 1.0e-05}
"""
SETTINGS = """\
iterations: 1
seed: 0
evaluate_every: 1
checkpoint_every: 1
sweep: {seed: [0, 1]}
npg: {gamma: 0.97, hidden: [8], value_hidden: [8], value_steps: 1}
env:
  rig: rig.yaml
  num_envs: 2
  horizon: 4
  kinds: [smooth, jagged]
  low_pa: 150000.0
  high_pa: 550000.0
  target_period_s: [0.3, 0.3]
  delay_s: [0.0, 0.01]
  spread: 0.0
  recipe: {tap: end, taps: [end], preview_s: [0.0, 0.04], period_s: 0.01, past: 1}
"""
EFFECTS = """\
- effect: leak
  place: tube
  parameters: {area_m2: 1.0e-8, position_m: 0.3}
"""
LAUNCH = """\
launch:
- arg: {name: speed, default: "1.0", description: How fast, choice: [{value: "1.0"}, {value: "2"}]}
- let: {name: twice, value: "$(eval '2 * $(var speed)')"}
- group:
  - push_ros_namespace: {namespace: lab}
  - node:
      pkg: pneu_sim
      exec: simulator
      if: $(eval '$(var speed) > 0')
      param: [{name: rig, value: rig.yaml}, {name: rate, value: $(var twice)}]
      remap: [{from: a, to: b}]
"""


def make_case(kind: str, seed: int, number: int, folder: Path) -> Case:
    """The case of a number, the same each time.

    Args:
        kind: One of `KINDS`.
        seed: Seed of the run.
        number: Number of the case.
        folder: An empty folder, where its inputs are written and its commands are run.
    """
    rng = random.Random(f"{seed} {kind} {number}")
    for name, content in good_inputs().items():
        (folder / name).write_bytes(content)
    (folder / "folder").mkdir()
    (folder / "full").mkdir()
    (folder / "full" / "notes.txt").write_text("mine")
    return _warm_case() if kind == "warm" else KINDS[kind](rng, folder)


def _warm_case() -> Case:
    """Every command once on sound inputs: what they load and compile is kept."""
    tiny = ["--rig", "rig.yaml"]
    yield ["check", "rig.yaml"]
    for rig in ("rig.yaml", "plate.yaml"):
        yield ["simulate", "--rig", rig, "--steps", "voltage=6:0.01", "-o", f"{rig}.csv"]
    yield [
        "compare",
        "good.mcap",
        *tiny,
        "--rig",
        "plate.yaml",
        "--no-refine",
        "--report",
        "c.html",
    ]
    yield ["fit", "good.mcap", *tiny, "--iterations", "1", "-o", "f.yaml"]
    yield ["diagnose", "good.mcap", *tiny, "--no-refine"]
    yield ["add", "leak@tube", "--bag", "good.mcap", *tiny, "-o", "better.yaml"]
    short = ["--trials", "1", "--candidates", "5", "--generations", "1"]
    yield ["tune", *tiny, *short, "-o", "tuned.yaml"]
    short = ["--duration", "1.0", "--skip", "0.3", "--seeds", "0", "--targets", "smooth"]
    yield ["evaluate", "pid.yaml", *tiny, *short, "-o", "judged"]
    yield ["train", "settings.yaml", "-o", "file/below"]
    yield ["policy", "policy.npz"]
    yield ["bag", "info", "good.mcap"]
    yield ["launch", "launch.yaml", "--print"]
    yield ["lab", *tiny, "--registers", "registers.yaml", *ALWAYS["lab"]]


@functools.cache
def good_inputs() -> dict[str, bytes]:
    """Sound files of every kind, by name: what is spoilt, and what is given beside it."""
    volts = np.where(np.arange(SAMPLES) % 20 < 10, 4.0, 6.0)
    time_s = np.arange(SAMPLES) / fuzz_bags.RATE_HZ
    level = np.random.default_rng(1).normal(2e5, 100.0, (2, SAMPLES))
    rows = zip(1e3 * time_s, volts, level[0], 1e-5 * level[1], strict=True)
    table = "t,volts,out,end\n" + "".join(f"{','.join(f'{x:.9g}' for x in r)}\n" for r in rows)
    files = {
        "rig.yaml": TINY_RIG.encode(),
        "text_rig.yaml": TEXT_RIG.encode(),
        "plate.yaml": TINY_RIG.replace("name: tiny", "name: plate\nmodel: thin_plate").encode(),
        "run.csv": table.encode(),
        "volts.csv": b"t,v\n0,5\n0.002,6\n0.004,4\n",
        "pid.yaml": PID.encode(),
        "settings.yaml": SETTINGS.encode(),
        "effects.yaml": EFFECTS.encode(),
        "launch.yaml": LAUNCH.encode(),
        "policy.npz": (ROOT / "policies" / "short_pde_0.npz").read_bytes(),
        "sealed.json": (ROOT / "rigs" / "plants" / "short.sealed.json").read_bytes(),
        "own.py": (ROOT / "examples" / "my_effect.py").read_bytes(),
        "file": b"mine",
        "empty": b"",
    }
    registers = ROOT / "src/pneu_hw_bridge/pneu_hw_bridge/registers/profiles/generic_plc.yaml"
    lines = registers.read_text(encoding="utf-8").splitlines(keepends=True)
    taps = ("supply:", "middle:", "exhaust:")  # which the tiny rig does not have
    files["registers.yaml"] = "".join(x for x in lines if not x.strip().startswith(taps)).encode()
    files["good.mcap"] = _good_bag(time_s, volts, level)
    return files


def _good_bag(time_s: Any, volts: Any, level: Any) -> bytes:
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        rig_file, bag = Path(name, "rig.yaml"), Path(name, "good.mcap")
        rig_file.write_text(TINY_RIG)
        taps = {"valve_out": level[0], "end": level[1]}
        recording = even_recording("good", time_s, {"voltage": volts}, taps)
        recording.start_time_s = 1.76e9
        records_write.write_bag(bag, load_rig(rig_file), recording)
        return bag.read_bytes()


# ---- rig files ----------------------------------------------------------------------------------


@functools.cache
def _rig_texts() -> list[str]:
    paths = sorted((ROOT / "rigs").glob("*.yaml"))
    return [TINY_RIG, TEXT_RIG, *(path.read_text(encoding="utf-8") for path in paths)]


def _rig_case(rng: random.Random, folder: Path) -> Case:
    (folder / "spoilt.yaml").write_bytes(spoil.of_yaml(rng, rng.choice(_rig_texts())))
    status = yield ["check", "spoilt.yaml"]
    yield ["effects", "--rig", "spoilt.yaml"]
    if status == 0:
        yield _simulation(rng, folder / "spoilt.yaml")


def _simulation(rng: random.Random, path: Path) -> list[str]:
    """A simulation of a rig, not longer than can be waited for."""
    rig = load_rig(path)
    plan = plan_grid(rig)
    affordable_s = MOST_UPDATES / max(plan.slots, 1) * plan.dt_s
    span_s = min(0.02, affordable_s)
    rate = min(1e6, 4.0 / span_s)
    words = ["simulate", "--rig", path.name, "--rate", f"{rate:.9g}"]
    words += ["--duration", f"{3.0 / rate:.9g}", "-o", rng.choice(("out.csv", "out.mcap", "out"))]
    for name in rig.commands:
        volts = rng.choice(("6", "0", "-1e308", "1e-308", "7.5"))
        words += ["--steps", f"{name}={volts}:{span_s:.3g}"]
    if rng.random() < 0.3:
        words += ["--seed", "1"]
    return words


# ---- bags and tables ----------------------------------------------------------------------------


def _on_recording(rng: random.Random, recording: str, rig: str) -> list[str]:
    """A command that reads a recording, most often the cheapest."""
    compare = ["compare", recording, "--rig", rig, "--no-refine"]
    return rng.choice(
        (
            *[[*compare, *rng.choice(([], ["--json", "c.json"], ["--report", "c.html"]))]] * 8,
            ["fit", recording, "--rig", rig, "--iterations", "1", "-o", "f.yaml"],
            ["diagnose", recording, "--rig", rig, "--no-refine", "--report", "d.html"],
            ["add", "leak@tube:0.3", "--bag", recording, "--rig", rig, "-o", "better.yaml"],
        )
    )


def _bag_case(rng: random.Random, folder: Path) -> Case:
    rig = load_rig(folder / "rig.yaml")
    bag = fuzz_bags.write_bag(rng, folder, rig, (folder / "good.mcap").read_bytes())
    yield _on_recording(rng, bag.name, "rig.yaml")
    yield ["bag", "info", bag.name]
    if rng.random() < 0.3:
        yield ["bag", "recover", bag.name]


def _table_case(rng: random.Random, folder: Path) -> Case:
    table = folder / rng.choice(("spoilt.csv", "spoilt.txt", "spoilt"))
    text = (folder / "run.csv").read_text()
    table.write_bytes(_table_spoilt(rng, text))
    rig = "text_rig.yaml"
    if rng.random() < 0.4:
        layout = rng.choice(
            (
                {"delimiter": rng.choice((" ", "\t", ";", '"', "é", "\0", "\n", "ab", ""))},
                {"comment": rng.choice(("", "t", ",", "\0", "0"))},
                {"time": rng.choice((0, -1, 99, "absent", "", 10**30))},
                {"time_scale": rng.choice((1e-300, 1e300, 0.0, -1.0, "x"))},
                {"decimal": rng.choice((",", ".", "0", "e"))},
                {"thousands_separator": rng.choice((",", ".", "1"))},
                {"skip_rows": rng.choice((1, 59, 61, 10**30, -1))},
                {"names": rng.choice((["a"], [], ["t", "volts", "out", "end"], ["t"] * 4))},
            )
        )
        sound = {"time": "t", "time_scale": 1e-3}  # milliseconds as seconds would take long
        out = io.StringIO()
        spoil.YAML(typ="safe", pure=True).dump({**sound, **layout}, out)
        body = TEXT_RIG.partition("text: ")[0]
        lines = "".join(f"  {line}\n" for line in out.getvalue().splitlines())
        (folder / "own_rig.yaml").write_text(f"{body}text:\n{lines}", encoding="utf-8")
        rig = "own_rig.yaml"
    yield _on_recording(rng, table.name, rig)
    (folder / "volts_spoilt.csv").write_bytes(
        _table_spoilt(rng, (folder / "volts.csv").read_text())
    )
    words = ["simulate", "--rig", "rig.yaml", "--command", "voltage=volts_spoilt.csv"]
    yield [*words, "--duration", "0.01", "-o", "out.csv"]


def _table_spoilt(rng: random.Random, text: str) -> bytes:
    kind = rng.randrange(4)
    if kind == 0:
        return spoil.of_bytes(rng, text.encode())
    if kind == 1:
        return spoil.of_text(rng, text)
    rows = [line.split(",") for line in text.splitlines()]
    for _ in range(rng.choice((1, 3, 20))):
        row = rng.choice(rows)
        cell = rng.randrange(len(row))
        what = rng.randrange(8)
        if what < 4:
            row[cell] = rng.choice(
                ("nan", "inf", "-inf", "1e308", "-1e308", "1e999", "", '"', '"a\nb"', "\0", "x",
                 spoil.DIGITS, "1" * 200_000, '"' * 3, "٣", "1_0", " 1 ", "0x1p3", "-0", "#")
            )  # fmt: skip
        elif what == 4 and len(row) > 1:
            del row[cell]
        elif what == 5:
            row.insert(cell, "0")
        elif what == 6:
            rows.insert(rng.randrange(len(rows)), list(row))
        else:
            rows.sort(key=lambda _: rng.random())
    return "\n".join(",".join(row) for row in rows).encode()


# ---- command lines ------------------------------------------------------------------------------

PATHS = (
    "file", "empty", "folder", "full", "absent", "absent/below", "file/below", "/dev/null",
    "/dev/full", "", ".", "..", "/", "rig.yaml", "run.csv", "good.mcap", "pid.yaml", "x" * 300,
    "policy.npz", "full/notes.txt", "/proc/self/mem", "a\nb", "[red]", "\udcff",
)  # fmt: skip
OUTPUTS = ("out", "json_path", "json_file", "report", "output", "ready_file")
OUTSIDE = ("/", "..")
"""Beginnings of what is never written to: whoever is root could."""
NUMBERS = (
    "nan", "inf", "-inf", "-1", "0", "1e308", "-1e308", "1e-308", "x", "", str(10**30),
    str(-(10**30)), str(2**31), str(2**64), spoil.DIGITS, "0x1", "1.5", "٣", "1e3",
)  # fmt: skip
TEXTS = (
    "", "x", "=", "a=", "=a", "a=b", "voltage", "voltage=", "voltage=x", "voltage=6:0.01,",
    "voltage=6:nan", "voltage=1e400:1", "voltage=volts.csv", "voltage=folder", "leak@", "@tube",
    "leak@tube:", "leak@tube:9", "leak@tube:-1", "leak@tube:1e999", "[red]", "\0", "a\nb", "smooth",
    "0-99999999999", "5-1", "1,1", "-", "0-", spoil.DIGITS, "name=absent.yaml", "pid", "tcp",
    "speed:=2", "speed:=x", "speed:=", ":=", "speed:=2 if", "absent:=1", f"speed:={10**30}",
)  # fmt: skip
GOOD: dict[str, tuple[str, ...]] = {
    "rig": ("rig.yaml", "rig.yaml", "plate.yaml"),
    "rig_file": ("rig.yaml",),
    "rigs": ("rig.yaml", "a=rig.yaml"),
    "bag": ("good.mcap",),
    "effect": ("leak@tube:0.3",),
    "effects_file": ("own.py",),
    "controllers": ("pid.yaml",),
    "settings": ("settings.yaml",),
    "file": ("pid.yaml", "policy.npz"),
    "sealed": ("sealed.json",),
    "registers": ("registers.yaml",),
    "steps": ("voltage=6:0.01,5:0.01",),
    "command": ("voltage=volts.csv",),
    "output": ("out.csv", "out.mcap", "out", "out.yaml"),
    "out": ("out",),
    "json_path": ("out.json",),
    "json_file": ("out.json",),
    "report": ("out.html",),
    "kind": ("pid", "feed_forward"),
    "tap": ("end",),
    "targets": ("smooth", "smooth,jagged"),
    "seeds": ("0", "0-1"),
    "low": ("150000",),
    "high": ("550000",),
    "period": ("0.3",),
    "noise": ("0", "250"),
    "duration": ("1.0",),
    "skip": ("0.3",),
    "delay": ("0.0",),
    "dx": ("0.25",),
    "workers": ("1",),
    "iterations": ("1",),
    "trials": ("1",),
    "candidates": ("5",),
    "generations": ("1",),
    "seed": ("1",),
    "rate": ("500",),
    "words": ("launch.yaml", "launch.yaml", "speed:=2"),
    "name": ("std_msgs/msg/Float64",),
}
"""Sound values by the name of the argument."""

COMMANDS = (
    "check", "effects", "simulate", "simulate", "fit", "compare", "diagnose", "add", "learn",
    "tune", "tune", "train", "policy", "evaluate", "evaluate", "lab", "lab fault", "lab seal",
    "lab reveal", "lab status", "bag info", "bag recover", "launch", "interface show",
)  # fmt: skip
ALWAYS = {
    "compare": ["--no-refine"],
    "diagnose": ["--no-refine"],
    "launch": ["--print"],
    # These would take long, or serve until they are stopped: no machine has that address, and
    # nothing can be written below a file.
    "lab": [
        "--host",
        "192.0.2.1",
        "--expose",
        "--allow-slow",
        "--port",
        "0",
        "--control-port",
        "0",
    ],
    "train": ["--out", "file/below"],
    "evaluate": ["--duration", "1.0", "--skip", "0.3", "--seeds", "0"],
    "tune": ["--trials", "1", "--candidates", "5", "--generations", "1"],
    "fit": ["--iterations", "1"],
}
"""Words that keep a command cheap, before what is drawn."""
NEVER = {
    "lab": ("host", "expose", "control_port"),
    "train": ("out", "resume"),
    "evaluate": ("live", "limit", "keep_bags"),
    "compare": ("refine",),
    "diagnose": ("refine",),
    "launch": ("print_only",),
}
"""Options that make a command dear, or undo what keeps it cheap."""
SPOILT = {
    "rig.yaml": "yaml", "pid.yaml": "yaml", "settings.yaml": "yaml", "effects.yaml": "yaml",
    "registers.yaml": "yaml", "launch.yaml": "yaml", "policy.npz": "bytes", "sealed.json": "bytes",
    "own.py": "bytes", "volts.csv": "bytes",
}  # fmt: skip

MAINLY = {
    "tune": ("rig.yaml",),
    "train": ("settings.yaml",),
    "policy": ("pid.yaml", "policy.npz"),
    "evaluate": ("pid.yaml", "rig.yaml", "sealed.json"),
    "lab": ("registers.yaml", "rig.yaml", "sealed.json"),
    "lab seal": ("effects.yaml",),
    "lab reveal": ("sealed.json",),
    "launch": ("launch.yaml",),
    "effects": ("own.py",),
    "simulate": ("volts.csv", "rig.yaml"),
}
"""Which of the files a command reads above all."""


@functools.cache
def callbacks() -> dict[str, Callable[..., Any]]:
    """The functions of all subcommands, by their words."""
    from pneu_common.cli import build_app

    out: dict[str, Callable[..., Any]] = {}

    def walk(app: typer.Typer, before: str) -> None:
        for command in app.registered_commands:
            name = command.name or str(command.callback.__name__).replace("_", "-")  # type: ignore[union-attr]
            if command.callback is not None:
                out[before + name] = command.callback
        for group in app.registered_groups:
            if group.typer_instance is not None:
                walk(group.typer_instance, f"{before}{group.name} ")
                back = group.typer_instance.registered_callback
                if back is not None and back.callback is not None:
                    out[f"{before}{group.name}"] = back.callback

    walk(build_app(), "")
    return out


def _command_case(rng: random.Random, folder: Path) -> Case:
    name = rng.choice(COMMANDS)
    for _ in range(rng.choice((0, 1))):
        # Most often what the command reads.
        read = [file for file in SPOILT if file in MAINLY.get(name, ())]
        file = rng.choice(read) if read and rng.random() < 0.8 else rng.choice(list(SPOILT))
        how = SPOILT[file]
        path = folder / file
        data = path.read_bytes()
        path.write_bytes(
            spoil.of_yaml(rng, data.decode()) if how == "yaml" else spoil.of_bytes(rng, data)
        )
    hostility = rng.choice((0.0, 0.1, 0.2, 0.4))
    words: list[list[str]] = []
    for option, hint, default in _parameters(name):
        if option in NEVER.get(name, ()):
            continue
        required = isinstance(default, typer.models.ArgumentInfo | typer.models.OptionInfo)
        if rng.random() > (0.97 if required else 0.3):
            continue
        values = _values(rng, option, hint, hostility)
        flags = _flags(name, option)
        if hint is bool:
            words.append([rng.choice(flags)])
        else:
            words += [[rng.choice(flags), value] if flags else [value] for value in values]
    rng.shuffle(words)
    if rng.random() < 0.05:
        words.insert(
            rng.randrange(len(words) + 1), [rng.choice(("--absent", "-x", "--", "--help"))]
        )
    yield [*name.split(), *ALWAYS.get(name, []), *(word for some in words for word in some)]


def _values(rng: random.Random, option: str, hint: Any, hostility: float) -> list[str]:
    count = rng.choice((1, 1, 2)) if typing.get_origin(hint) is list else 1
    kind = (typing.get_args(hint) or (hint,))[0]
    hostile = {int: NUMBERS, float: NUMBERS, Path: PATHS}.get(kind, TEXTS + PATHS)
    if option in OUTPUTS:
        hostile = tuple(path for path in PATHS if not path.startswith(OUTSIDE))
    good = GOOD.get(option, ("1",) if kind in (int, float) else hostile)
    return [
        rng.choice(hostile) if rng.random() < hostility else rng.choice(good) for _ in range(count)
    ]


@functools.cache
def _parameters(name: str) -> list[tuple[str, Any, Any]]:
    """Name, type without None, and default of every parameter of a subcommand."""
    function = callbacks()[name]
    hints = typing.get_type_hints(function)
    out = []
    for option, parameter in inspect.signature(function).parameters.items():
        hint = hints.get(option)
        if option == "_ctx":
            continue
        if typing.get_origin(hint) in (types.UnionType, typing.Union):
            hint = next(one for one in typing.get_args(hint) if one is not type(None))
        missing = parameter.default is inspect.Parameter.empty
        out.append((option, hint, typer.models.OptionInfo() if missing else parameter.default))
    return out


@functools.cache
def _flags(name: str, option: str) -> list[str]:
    """How an option may be written; nothing for an argument."""
    from pneu_common.cli import build_app

    command: Any = typer.main.get_command(build_app())
    for word in name.split():
        command = command.commands[word]
    for parameter in command.params:
        if parameter.name == option:
            return [flag for flag in parameter.opts + parameter.secondary_opts if flag[0] == "-"]
    raise InputError(f"{name}: found no parameter {option!r}")


KINDS: dict[str, Callable[[random.Random, Path], Case]] = {
    "rig": _rig_case,
    "bag": _bag_case,
    "csv": _table_case,
    "command": _command_case,
}
