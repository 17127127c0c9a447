# SPDX-License-Identifier: Apache-2.0
"""The `pneu` command: plugins, one-line errors and exit status."""

import importlib.metadata
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pneu_common.cli import COMMANDS_GROUP, build_app

PLUGIN = '''
"""A plugin as another distribution would bring it."""
import signal
from pneu_common.errors import InputError

def register(app):
    @app.command()
    def wrong(bag: str):
        """Reject its input."""
        raise InputError(f"{bag}: no topic\\n'/valve', only '/tank'")

    @app.command()
    def broken():
        """Fail."""
        raise ZeroDivisionError("by zero")

    @app.command()
    def unreadable():
        """Open a file that is not there."""
        open("no/such/file")

    @app.command()
    def endless():
        """Be interrupted as by Ctrl-C."""
        signal.raise_signal(signal.SIGINT)

    @app.command()
    def fine():
        """Print."""
        print("fine")
        return "a value that must not become the exit status"
'''

RIG = Path(__file__).parent.parent / "rigs" / "rig_a_fitted.yaml"


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run the application with the plugin above and return the finished call."""
    (tmp_path / "plugin_under_test.py").write_text(PLUGIN)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delenv("PNEU_TRACEBACK", raising=False)
    entry = importlib.metadata.EntryPoint("x", "plugin_under_test:register", COMMANDS_GROUP)
    yield lambda *arguments: CliRunner().invoke(build_app([entry]), arguments, prog_name="pneu")
    sys.modules.pop("plugin_under_test", None)


@pytest.mark.parametrize(
    ("arguments", "status", "line"),
    [
        (["wrong", "a.mcap"], 2, "pneu: a.mcap: no topic '/valve', only '/tank'\n"),
        (["unreadable"], 2, "pneu: no/such/file: No such file or directory\n"),
        (["endless"], 130, "pneu: interrupted\n"),
    ],
)
def test_failure_is_one_line_and_a_status(run, arguments, status, line):
    result = run(*arguments)
    assert (result.exit_code, result.stderr, result.stdout) == (status, line, "")


@pytest.mark.parametrize("arguments", [["wrong"], ["nonsense"], ["fine", "--nonsense"]])
def test_wrong_usage_is_one_line_and_status_2(run, arguments):
    result = run(*arguments)
    assert result.exit_code == 2
    assert result.stderr.startswith("pneu: ") and result.stderr.count("\n") == 1
    assert "--help" in result.stderr


def test_fault_of_the_program_shows_its_traceback_only_when_asked(run, monkeypatch):
    result = run("broken")
    assert result.exit_code == 1
    assert "ZeroDivisionError: by zero" in result.stderr and result.stderr.count("\n") == 1
    monkeypatch.setenv("PNEU_TRACEBACK", "1")
    result = run("broken")
    assert result.exit_code == 1
    assert 'raise ZeroDivisionError("by zero")' in result.stderr


def test_success_and_help_exit_with_zero(run):
    result = run("fine")
    assert (result.exit_code, result.stdout, result.stderr) == (0, "fine\n", "")
    for arguments in ([], ["--help"]):
        result = run(*arguments)
        assert result.exit_code == 0
        assert "Reject its input." in result.stdout
    assert run("--version").stdout.startswith("pneu ")


def test_a_group_of_commands_that_cannot_be_imported_is_an_error_with_its_cause(run, tmp_path):
    """Its commands exist, so "no such command" would be wrong; those of other groups work."""
    run("fine")  # imports the plugin that works
    broken = importlib.metadata.EntryPoint("a", "no_such_module:register", COMMANDS_GROUP)
    works = importlib.metadata.EntryPoint("x", "plugin_under_test:register", COMMANDS_GROUP)

    def both(*words):
        return CliRunner().invoke(build_app([broken, works]), words, prog_name="pneu")

    cause = "pneu: the commands of no_such_module cannot be imported: ModuleNotFoundError: "
    missing = both("fit")
    assert (missing.exit_code, missing.stdout) == (1, "")
    assert missing.stderr == f"{cause}No module named 'no_such_module'\n"
    listed = both("--help")
    assert listed.exit_code == 1
    assert "fine" in listed.stdout and listed.stderr.startswith(cause)
    other = both("fine")
    assert (other.exit_code, other.stdout, other.stderr) == (0, "fine\n", "")


def test_installed_command_knows_both_packages():
    pneu = Path(sys.executable).with_name("pneu")
    if not pneu.exists():
        pytest.skip("pneu is not installed in this environment")
    result = subprocess.run([pneu, "--help"], capture_output=True, text=True, check=True)
    assert result.stderr == ""
    assert "effects" in result.stdout and "diagnose" in result.stdout


@pytest.mark.long
@pytest.mark.parametrize(
    "words",
    [
        ["--help"],
        ["effects"],
        ["init"],
        ["check", str(RIG)],
        ["topic", "--help"],
        ["lab", "--help"],
    ],
)
def test_what_needs_no_numerics_does_not_wait_for_them(words: list[str], tmp_path: Path) -> None:
    """Compilers and solvers take seconds to load; a list of commands does without."""
    code = (
        "import sys; from pneu_common.cli import main\n"
        f"sys.argv = ['pneu', *{words!r}]\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy = {'numba', 'scipy', 'mujoco', 'torch', 'pymodbus'} & set(sys.modules)\n"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
