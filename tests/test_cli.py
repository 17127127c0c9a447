# SPDX-License-Identifier: Apache-2.0
"""The `pneu` command: plugins, one-line errors and exit status."""

import importlib.metadata
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pneu_common.cli import COMMANDS_GROUP, build_app
from pneu_common.errors import InputError

PLUGIN = '''
"""A plugin as another distribution would bring it."""
import signal
import typer
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

    @app.command()
    def raises(what: str, count: int = 1):
        """Raise an exception of a kind."""
        raise {
            "exit": lambda: typer.Exit(count),
            "abort": typer.Abort,
            "memory": MemoryError,
            "system": lambda: OSError("odd"),
            "usage": lambda: typer.BadParameter("odd."),
            "command": lambda: typer.BadParameter.__mro__[2]("odd."),  # that of no command
            "long": lambda: InputError("a" * (count - 1) + "z"),
            "control": lambda: InputError("a\\x1b[31m  b\\0\\u00e9"),
        }[what]()
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
        (["raises", "exit"], 1, ""),
        (["raises", "exit", "--count", "7"], 7, ""),
        (["raises", "abort"], 130, "pneu: interrupted\n"),
        (["raises", "memory"], 1, "pneu: the machine's memory is not enough for this\n"),
        (
            ["raises", "system"],
            1,
            "pneu: error inside the program: OSError: odd"
            " (PNEU_TRACEBACK=1 shows where it arose)\n",
        ),
        (["raises", "usage"], 2, "pneu: Invalid value: odd (see pneu raises --help)\n"),
        (["raises", "command"], 1, "pneu: odd\n"),
        (["raises", "long", "--count", "800"], 2, f"pneu: {'a' * 799}z\n"),
        (["raises", "long", "--count", "801"], 2, f"pneu: {'a' * 397} ... {'a' * 396}z\n"),
        (["raises", "control"], 2, "pneu: a\\x1b[31m b\\x00\u00e9\n"),
    ],
)
def test_failure_is_one_line_and_a_status(run, arguments, status, line):
    result = run(*arguments)
    assert (result.exit_code, result.stderr, result.stdout) == (status, line, "")


@pytest.mark.parametrize(
    ("arguments", "command"),
    [(["wrong"], "pneu wrong"), (["nonsense"], "pneu"), (["fine", "--nonsense"], "pneu fine")],
)
def test_wrong_usage_is_one_line_and_status_2(run, arguments, command):
    result = run(*arguments)
    assert result.exit_code == 2
    assert result.stderr.startswith("pneu: ") and result.stderr.count("\n") == 1
    assert result.stderr.endswith(f" (see {command} --help)\n")


def test_fault_of_the_program_shows_its_traceback_only_when_asked(run, monkeypatch):
    result = run("broken")
    assert result.exit_code == 1
    assert "ZeroDivisionError: by zero" in result.stderr and result.stderr.count("\n") == 1
    monkeypatch.setenv("PNEU_TRACEBACK", "0")
    assert run("broken").stderr == result.stderr
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
        assert "completion" not in result.stdout
    for arguments in (["--version"], ["--version", "--help"]):
        assert run(*arguments).stdout == f"pneu {importlib.metadata.version('pneu')}\n"


def test_a_caller_in_python_gets_exceptions_and_no_exit(run):
    run("fine")  # imports the plugin
    entry = importlib.metadata.EntryPoint("x", "plugin_under_test:register", COMMANDS_GROUP)
    app = build_app([entry])
    for words, raised in ((["wrong", "a"], InputError), (["broken"], ZeroDivisionError)):
        with pytest.raises(raised):
            app(words, standalone_mode=False)
    assert app(["fine"], standalone_mode=False) is None
    assert app(["raises", "exit", "--count", "7"], standalone_mode=False) == 7


SEVERAL = """
import typer

def register(app):
    @app.command()
    def two_words_{name}(): ...

    @app.command("named-{name}")
    def otherwise(): ...

    group = typer.Typer()
    @group.command()
    def inner(): ...
    app.add_typer(group, name="group_{name}")
    app.add_typer(typer.Typer(), name=None)
"""


@pytest.mark.parametrize(
    ("wanted", "loaded"),
    [
        ("two-words-a", "a"),
        ("named-a", "a"),
        ("group_a", "a"),
        ("two-words-b", "ab"),
        ("two_words_a", "abc"),
        ("inner", "abc"),
        ("otherwise", "abc"),
        (None, "abc"),
    ],
)
def test_groups_of_commands_after_the_one_that_is_wanted_are_not_loaded(
    wanted, loaded, tmp_path, monkeypatch
):
    """They are loaded in the order of their names, each once."""
    monkeypatch.syspath_prepend(tmp_path)
    for name in "abc":
        (tmp_path / f"several_{name}.py").write_text(SEVERAL.format(name=name))
    point = importlib.metadata.EntryPoint
    pairs = [("2", "b"), ("1", "a"), ("0", "c"), ("3", "c")]  # the last of a name counts
    app = build_app([point(k, f"several_{name}:register", COMMANDS_GROUP) for k, name in pairs],
                    wanted)  # fmt: skip
    try:
        assert [name for name in "abc" if f"several_{name}" in sys.modules] == list(loaded)
        groups = [group.name for group in app.registered_groups if group.name]
        assert groups == [f"group_{n}" for n in loaded]
        assert len(app.registered_commands) == 2 * len(loaded)
    finally:
        for name in "abc":
            sys.modules.pop(f"several_{name}", None)


def test_a_group_of_commands_that_cannot_be_imported_is_an_error_with_its_cause(
    run, monkeypatch, capsys
):
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
    assert both("--version").exit_code == 0
    monkeypatch.setenv("PNEU_TRACEBACK", "1")
    build_app([broken])
    assert "Traceback (most recent call last)" in capsys.readouterr().err
    monkeypatch.delenv("PNEU_TRACEBACK")
    other = importlib.metadata.EntryPoint("b", "no_other:register", COMMANDS_GROUP)
    result = CliRunner().invoke(build_app([broken, works, other]), ["fit"], prog_name="pneu")
    assert result.stderr == (
        f"{cause}No module named 'no_such_module'; the commands of no_other cannot be imported:"
        " ModuleNotFoundError: No module named 'no_other'\n"
    )
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


def test_a_plant_is_imported_without_what_it_does_not_compute_with() -> None:
    """Every node of a plant waits for that: SciPy's optimisers alone take as long as the rest."""
    code = (
        "import sys, pneu_sim.simulator\n"
        "print({'scipy.optimize', 'mujoco', 'torch', 'matplotlib'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
