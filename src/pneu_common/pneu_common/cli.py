# SPDX-License-Identifier: Apache-2.0
"""The `pneu` command: gathers subcommands from entry points and reports errors in one line.

Subcommands come from the entry-point group `pneu.commands`. Each entry is a function
`register(app: typer.Typer) -> None` that adds its commands to the application.

Exit status: 0 success, 1 an error inside the program, 2 bad input or usage, 130 interrupted by
SIGINT, 143 terminated by SIGTERM. Errors are one line on stderr; with the environment variable
PNEU_TRACEBACK=1 the traceback precedes it.
What the packages log about themselves, such as that kernels are being compiled, is shown there.
"""

import importlib.metadata
import os
import sys
import traceback
from collections.abc import Iterable, Sequence
from typing import Annotated, Any, ClassVar

import typer
from typer.core import TyperGroup

from pneu_common import process
from pneu_common.errors import InputError
from pneu_common.installed import version
from pneu_common.log import hand_on
from pneu_common.text import one_line

COMMANDS_GROUP = "pneu.commands"

EXIT_INTERNAL_ERROR = 1
EXIT_BAD_INPUT = 2

LONGEST_LINE = 800
"""Characters of a message; of a longer one the middle is left out."""


class _InterruptedError(Exception):
    """SIGINT or SIGTERM inside a command; the cause is the exception that it raised."""


class _NotLoadedError(Exception):
    """A subcommand is unknown, and a group of commands that may hold it could not be imported."""


class _OneLineErrorGroup(TyperGroup):
    """Root command that turns every failure into one line on stderr and an exit status."""

    not_loaded: ClassVar[list[str]] = []
    """A sentence for each group of commands that could not be imported."""
    incomplete = False

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        try:
            return super().resolve_command(ctx, args)
        except Exception as error:
            if self.not_loaded:
                raise _NotLoadedError("; ".join(self.not_loaded)) from error
            raise

    def format_help(self, ctx: Any, formatter: Any) -> None:
        super().format_help(ctx, formatter)
        self.incomplete = bool(self.not_loaded)
        for sentence in self.not_loaded:
            _say(sentence)

    def invoke(self, ctx: Any) -> None:
        process.begin_work()
        # Caught here because releases of typer differ in what they make of it further out.
        try:
            super().invoke(ctx)
            process.raise_postponed()
        except KeyboardInterrupt as error:
            raise _InterruptedError from error

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        try:
            # Without standalone mode an early exit (--help, typer.Exit) returns its status.
            status = super().main(
                args, prog_name, complete_var, False, windows_expand_args, **extra
            )
            if self.incomplete:
                status = EXIT_INTERNAL_ERROR
        except (Exception, KeyboardInterrupt) as error:
            if not standalone_mode:
                raise
            process.restore_signals()
            status = _report(error)
        if standalone_mode:
            process.restore_signals()
            sys.exit(status)
        return status


def build_app(
    plugins: Iterable[importlib.metadata.EntryPoint] | None = None, wanted: str | None = None
) -> typer.Typer:
    """Build the `pneu` application with the subcommands of the plugins.

    A plugin that cannot be imported does not take the other commands with it: it is an error,
    with its cause, where a subcommand is asked for that no other plugin has, and in the list of all
    subcommands.

    Args:
        plugins: Entry points to load instead of the installed ones of group `pneu.commands`.
        wanted: A subcommand; plugins after the one that has it are not loaded, so that a tool of
            the graph does not wait for the numerics.

    Returns:
        The application; calling it runs the command line.
    """
    not_loaded: list[str] = []
    app = typer.Typer(
        cls=type("_Root", (_OneLineErrorGroup,), {"not_loaded": not_loaded}),
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        help="Simulate pneumatic rigs, fit them to recordings, and find the physics they lack.",
    )
    app.callback(invoke_without_command=True)(_root)
    if plugins is None:
        plugins = importlib.metadata.entry_points(group=COMMANDS_GROUP)
    # pip and colcon may both have installed the same entry point; the value identifies it.
    distinct = {plugin.value: plugin for plugin in plugins}.values()
    for plugin in sorted(distinct, key=lambda plugin: plugin.name):
        try:
            plugin.load()(app)
        except Exception as error:
            _print_traceback_if_asked(error)
            not_loaded.append(
                f"the commands of {plugin.value.partition(':')[0]} cannot be imported:"
                f" {type(error).__name__}: {error}"
            )
        if wanted in _subcommands(app):
            break
    return app


def _subcommands(app: typer.Typer) -> set[str]:
    """Names of the subcommands that an application has so far."""
    names = {group.name or "" for group in app.registered_groups}
    for command in app.registered_commands:
        names.add(command.name or getattr(command.callback, "__name__", "").replace("_", "-"))
    return names


def main() -> None:
    """Run the `pneu` command line on `sys.argv` and exit with its status."""
    process.prepare()
    show_log()
    try:
        app = build_app(wanted=next(iter(sys.argv[1:]), None))  # no subcommand begins with "-"
    except KeyboardInterrupt as error:
        process.restore_signals()
        sys.exit(_report(error))
    app(prog_name="pneu")


def show_log() -> None:
    """Has what the packages log shown on stderr, as the command does."""
    hand_on(_say)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"pneu {version()}")
        raise typer.Exit


def _root(
    ctx: typer.Context,
    version: Annotated[
        bool,
        typer.Option(
            "--version", is_eager=True, callback=_print_version, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    if ctx.invoked_subcommand is None:
        print(ctx.get_help())


def _report(error: BaseException) -> int:
    """Print what went wrong as one line and return the exit status it stands for."""
    _print_traceback_if_asked(error)
    if isinstance(error, KeyboardInterrupt | _InterruptedError | typer.Abort):
        return _report_ending(error.__cause__ or error)
    if isinstance(error, InputError):
        _say(str(error))
        return EXIT_BAD_INPUT
    if hasattr(error, "format_message"):  # usage errors of typer, or of click below older typer
        context = getattr(error, "ctx", None)
        hint = f" (see {context.command_path} --help)" if context else ""
        _say(f"{error.format_message().rstrip('.')}{hint}")
        return int(getattr(error, "exit_code", EXIT_BAD_INPUT))
    if isinstance(error, _NotLoadedError):
        _say(str(error))
        return EXIT_INTERNAL_ERROR
    if isinstance(error, MemoryError):
        _say("the machine's memory is not enough for this")
        return EXIT_INTERNAL_ERROR
    if isinstance(error, OSError) and error.filename is not None:
        _say(f"{error.filename}: {error.strerror}")
        return EXIT_BAD_INPUT
    if (interrupt := process.received()) is not None:
        # Something on its way took the exception of the signal for another error.
        return _report_ending(interrupt)
    _say(
        f"error inside the program: {type(error).__name__}: {error}"
        " (PNEU_TRACEBACK=1 shows where it arose)"
    )
    return EXIT_INTERNAL_ERROR


def _report_ending(interrupt: BaseException) -> int:
    message, status = process.ending(interrupt)
    _say(message)
    return status


def _print_traceback_if_asked(error: BaseException) -> None:
    if os.environ.get("PNEU_TRACEBACK") == "1":
        traceback.print_exception(error)


def _say(message: str) -> None:
    print("pneu:", one_line(message, LONGEST_LINE), file=sys.stderr)


if __name__ == "__main__":
    main()
