# SPDX-License-Identifier: Apache-2.0
"""Subcommands that run before the command line is loaded, and how signals end them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.packages import python_path

from pneu_common.entry import COMMAND

pytestmark = pytest.mark.kernel_free

# A distribution as somebody might install it, with a subcommand of either kind.
OWN = """
import atexit, logging, os, signal, sys, typing
import pneu_common.process as process

def stop():
    os.kill(os.getpid(), signal.SIGTERM)

if "loading" in sys.argv:
    stop()

def at_once(words):
    atexit.register(lambda: print(signal.getsignal(signal.SIGTERM) == signal.SIG_DFL))
    if words[0] == "pass":
        return None
    if words == ["working"]:
        stop()
    if words == ["importing"]:
        import swallowing
    print(words, "typer" in sys.modules)
    return 3

def register(app):
    if "registering" in sys.argv:
        stop()

    @app.command()
    def quick(words: typing.List[str]):
        logging.getLogger("pneu").info("compiling")
        print("command line", words, "pneu_sim" in sys.modules)
"""
SWALLOWING = """
import own
try:
    own.stop()
except BaseException:
    pass
"""
ENTRY_POINTS = "[pneu.at_once]\nquick = own:at_once\n[pneu.commands]\n0-own = own:register\n"


@pytest.fixture
def run(tmp_path: Path):
    """Runs the `pneu` command where that distribution is installed."""
    (tmp_path / "own.py").write_text(OWN)
    (tmp_path / "swallowing.py").write_text(SWALLOWING)
    info = tmp_path / "own-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    environment = {
        **os.environ,
        "PYTHONPATH": python_path(tmp_path),
        "PYTHONDONTWRITEBYTECODE": "1",
    }

    def run(*words: str, command: tuple[str, ...] = COMMAND) -> tuple[int, str, str]:
        done = subprocess.run(
            [*command, *words],
            env=environment,
            capture_output=True,
            text=True,
            timeout=60.0,
            check=False,
        )
        return done.returncode, done.stdout, done.stderr

    return run


def test_its_status_is_that_of_the_command(run) -> None:
    assert (sys.executable, "-P", "-m", "pneu_common.entry") == COMMAND
    assert run("quick", "a", "b") == (3, "['a', 'b'] False\nTrue\n", "")


@pytest.mark.parametrize(
    ("moment", "printed"),
    [("loading", ""), ("working", "True\n"), ("importing", "['importing'] False\nTrue\n")],
)
def test_a_signal_ends_it_in_order(run, moment: str, printed: str) -> None:
    """Also before it has begun, and where an import lost the exception."""
    assert run("quick", moment) == (143, printed, "pneu: terminated\n")


def test_words_that_it_passes_on(run) -> None:
    said = "command line ['pass', 'on'] False\nTrue\n"  # no other commands are loaded
    assert run("quick", "pass", "on") == (0, said, "pneu: compiling\n")
    assert run("quick", "pass", "registering") == (143, "True\n", "pneu: terminated\n")
    alone = (sys.executable, "-m", "pneu_common.cli")
    assert run("quick", "registering", command=alone) == (143, "", "pneu: terminated\n")


def test_no_words_at_all(run) -> None:
    code = (
        "import importlib.metadata as m; found = m.entry_points\n"
        "m.entry_points = lambda **given: found(**given, name='0-own')\n"  # no other's commands
        "from pneu_common.entry import main; main()"
    )
    status, printed, errors = run(command=(sys.executable, "-c", code))
    assert (status, errors) == (0, "")
    assert printed.startswith("Usage: pneu [OPTIONS] COMMAND [ARGS]...") and "quick" in printed
