# SPDX-License-Identifier: Apache-2.0
"""Signals end a command in order at any moment, and no character stops its output."""

import codecs
import os
import signal
import subprocess
import sys

import pytest
from tests.packages import python_path

from pneu_common import process
from pneu_common.files import write_whole

COMMAND = """
from importlib.metadata import EntryPoint
from pneu_common import process
from pneu_common.cli import COMMANDS_GROUP, build_app
process.prepare()
build_app([EntryPoint("own", "own:register", COMMANDS_GROUP)])(prog_name="pneu")
"""

# The name of each is that of the subcommand; it prints "up" at the moment that is tested.
OWN = """
import os, subprocess, sys, tempfile, time

def up(seconds):
    print("up", flush=True)
    time.sleep(seconds)

class Finalised:
    def __del__(self):
        up(0.3)

def register(app):
    if "loading" in sys.argv:
        up(30.0)

    @app.command()
    def working():
        with tempfile.TemporaryDirectory(dir=os.getcwd()):
            with subprocess.Popen(["cat"], stdin=subprocess.PIPE):
                up(30.0)

    @app.command()
    def importing():
        with tempfile.TemporaryDirectory(dir=os.getcwd()):
            import swallowing
            time.sleep(30.0)

    @app.command()
    def ending():
        import swallowing  # and no time is left for the signal to be repeated

    @app.command()
    def finalising():
        Finalised()
        time.sleep(30.0)

    @app.command()
    def mistaking():
        try:
            up(30.0)
        except BaseException:
            raise RuntimeError("mistaken for something else")

    @app.command()
    def nothing():
        pass
"""

SWALLOWING = """
import own
try:
    own.up(0.3)
except BaseException:
    pass
"""


@pytest.mark.parametrize(
    ("number", "word", "status"),
    [(signal.SIGINT, "interrupted", 130), (signal.SIGTERM, "terminated", 143)],
    ids=["SIGINT", "SIGTERM"],
)
@pytest.mark.parametrize(
    "moment", ["loading", "working", "importing", "ending", "finalising", "mistaking"]
)
def test_a_signal_ends_a_command_in_order(moment, number, word, status, tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    (tmp_path / "swallowing.py").write_text(SWALLOWING)
    code = ["own.py", "swallowing.py"]
    with subprocess.Popen(
        [sys.executable, "-B", "-c", COMMAND, moment],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": python_path(tmp_path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as command:
        assert command.stdout.readline() == "up\n"
        command.send_signal(number)
        _, errors = command.communicate(timeout=20.0)
    assert (command.returncode, errors) == (status, f"pneu: {word}\n")
    assert sorted(path.name for path in tmp_path.iterdir()) == code


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_that_is_ignored_stays_so(number):
    code = "import signal; from pneu_common import process; process.prepare()"
    code += f"; print(signal.getsignal({int(number)}) == signal.SIG_IGN)"
    before = lambda: signal.signal(number, signal.SIG_IGN)  # noqa: E731
    command = [sys.executable, "-c", code]
    assert subprocess.check_output(command, preexec_fn=before, text=True) == "True\n"


TABLE = """
from pneu_common import process
process.represent_all_characters()
from rich.console import Console
from pneu_common.tables import Column, NamedTable
table = NamedTable("of \\udcff", [Column("caf\\u00e9"), Column("number", "number")])
table.add_row("x \\u00b1 1", "3")
Console(width=60).print(table)
"""

PLAIN = r"""of \udcff
+----------------+
| caf\xe9  | number |
|-------+--------|
| x +- 1 |      3 |
+----------------+
"""


@pytest.mark.parametrize(
    "variables",
    [
        {"PYTHONIOENCODING": "ascii"},
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    ],
    ids=["ascii", "C"],
)
def test_output_degrades_to_what_its_encoding_has(variables):
    command = [sys.executable, "-c", TABLE]
    shown = subprocess.check_output(command, env={**os.environ, **variables})
    assert shown.decode("ascii") == PLAIN


def test_what_is_no_text_is_printed_and_written_all_the_same(tmp_path):
    command = [sys.executable, "-c", TABLE]
    variables = {"PYTHONIOENCODING": "utf-8"}
    shown = subprocess.check_output(command, env={**os.environ, **variables}).decode()
    assert shown.splitlines()[0] == "of \\udcff" and "x ± 1" in shown
    write_whole(tmp_path / "a.json", '"caf\u00e9 \udcff"')
    assert (tmp_path / "a.json").read_bytes() == '"caf\u00e9 \\udcff"'.encode()


def test_what_is_told_of_a_signal():
    assert process.ending(KeyboardInterrupt()) == ("interrupted", 130)
    assert process.ending(process.TerminatedError()) == ("terminated", 143)
    assert (process.INTERRUPTED, process.TERMINATED) == (130, 143)


def test_characters_that_an_encoding_lacks():
    codecs.register_error("pneu", process._represent)
    text = "1 ± 2 °, ≥ 3, ≤ 4, é€\udcff"
    assert text.encode("ascii", "pneu") == rb"1 +- 2  deg, >= 3, <= 4, \xe9\u20ac\udcff"
    assert text.encode("latin-1", "pneu") == b"1 \xb1 2 \xb0, >= 3, <= 4, \xe9\\u20ac\\udcff"
    with pytest.raises(UnicodeDecodeError):
        b"\xff".decode("ascii", "pneu")


SIGNALS = """
import os, signal, sys
from pneu_common import process
names = {{signal.SIG_DFL: "default", signal.SIG_IGN: "ignored", process._on_signal: "ours"}}

def tell():
    both = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    print(*(names.get(one, "another") for one in both), signal.getitimer(signal.ITIMER_REAL)[0])

{before}
process.prepare()
tell()
process.begin_work()
assert process.received() is None
process.raise_postponed()
{between}
process.restore_signals()
tell()
"""


@pytest.mark.parametrize(
    ("before", "between", "told"),
    [
        ("", "", ["ours ours 0.0", "default default 0.0"]),
        (
            "signal.signal(signal.SIGTERM, lambda *_: None)",
            "",
            ["ours another 0.0", "default another 0.0"],
        ),
        (
            "signal.signal(signal.SIGINT, signal.SIG_IGN)",
            "signal.setitimer(signal.ITIMER_REAL, 100.0)",
            ["ignored ours 0.0", "ignored default 0.0"],
        ),
    ],
)
def test_handlers_of_signals_are_installed_and_removed(before, between, told):
    code = SIGNALS.format(before=before, between=between)
    assert subprocess.check_output([sys.executable, "-c", code], text=True).splitlines() == told


RAISED = """
import signal
from pneu_common import process
process.prepare()
process.begin_work()
for number, name in ((signal.SIGINT, "KeyboardInterrupt"), (signal.SIGTERM, "TerminatedError")):
    try:
        signal.raise_signal(number)
    except KeyboardInterrupt as error:
        print(type(error).__name__ == name, type(process.received()).__name__ == name)
    signal.setitimer(signal.ITIMER_REAL, 100.0)  # as where it was postponed
    try:
        process.raise_postponed()
    except KeyboardInterrupt as error:
        print(type(error).__name__ == name, signal.getitimer(signal.ITIMER_REAL)[0])
process.raise_postponed()  # once only
process._received = 0
signal.setitimer(signal.ITIMER_REAL, 100.0)
try:
    process.raise_postponed()
except KeyboardInterrupt as error:
    print(type(error).__name__)
"""


def test_exceptions_of_signals():
    told = subprocess.check_output([sys.executable, "-c", RAISED], text=True).splitlines()
    assert told == ["True True", "True 0.0", "True True", "True 0.0", "KeyboardInterrupt"]


def test_an_error_in_a_finaliser_is_printed_as_always():
    code = (
        "import sys; from pneu_common import process\nprocess.prepare()\n"
        "class Bad:\n    def __del__(self): raise ValueError('odd')\n"
        "Bad(); sys.stdout = None; process.represent_all_characters()"  # no stream at all
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr.startswith("Exception ignored in: <function Bad")
    assert done.stderr.endswith("ValueError: odd\n")
