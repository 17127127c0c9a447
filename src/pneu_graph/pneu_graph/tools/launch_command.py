# SPDX-License-Identifier: Apache-2.0
"""`pneu launch`: from the words of the command line to running processes."""

import contextlib
import os
import shlex
import socket
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from pneu_common.errors import InputError
from pneu_graph.launch.plan import Argument, Plan, declared_arguments
from pneu_graph.launch.supervisor import Supervisor
from pneu_runtime import hook
from pneu_runtime.packages import PackageNotFoundError, package_share


def launch(words: list[str], show_args: bool = False, print_only: bool = False) -> int:
    """Runs a launch file.

    Args:
        words: ``PACKAGE FILE`` or ``PATH``, then ``name:=value``.
        show_args: Print the arguments that the file declares, and run nothing.
        print_only: Print the processes, and run nothing.

    Returns:
        Exit status: 0 where every process ended well, else 1.

    Raises:
        InputError: The launch file is missing or wrong.
    """
    path, arguments = _target(words)
    if show_args:
        print(_arguments_text(declared_arguments(path)))
        return 0
    with tempfile.TemporaryDirectory(prefix="pneu_launch_") as scratch:
        logged: list[str] = []
        hook.install()  # chooses the runtime, once, for all processes of the launch
        plan = Plan(path, arguments, dict(os.environ), Path(scratch), logged.append)
        if print_only:
            for spec in plan.processes:
                print(f"[{spec.label}] {shlex.join(spec.command)}")
            return 0
        with _log_file() as log:
            supervisor = Supervisor(plan.processes, log=log)
            for sentence in logged:
                print(f"[INFO] [launch.user]: {sentence}", flush=True)
            return supervisor.run()


def _target(words: list[str]) -> tuple[Path, dict[str, str]]:
    names = [word for word in words if ":=" not in word]
    arguments = {}
    for word in words:
        name, sign, value = word.partition(":=")
        if sign:
            arguments[name] = value
    if len(names) == 1:
        path = Path(names[0])
        if not path.is_file():
            raise InputError(f"{path}: no such launch file")
        return path, arguments
    if len(names) != 2:
        raise InputError(
            "launch takes a path, or a package and a file of it, then arguments as name:=value;"
            f" found {' '.join(words) or 'nothing'}"
        )
    return _file_of_package(*names), arguments


def _file_of_package(package: str, name: str) -> Path:
    try:
        share = Path(package_share(package))
    except (PackageNotFoundError, ValueError):
        raise InputError(f"package {package!r} is not installed") from None
    found = sorted(path for path in share.rglob(name) if path.is_file())
    if len(found) == 1:
        return found[0]
    if found:
        raise InputError(f"{share}: several files are named {name}: {', '.join(map(str, found))}")
    files = sorted(path.name for path in (share / "launch").glob("*")) or ["none"]
    raise InputError(f"{share}: has no launch file {name!r}; it has {', '.join(files)}")


def _arguments_text(arguments: list[Argument]) -> str:
    if not arguments:
        return "Arguments (pass arguments as '<name>:=<value>'):\n\n  No arguments."
    lines = ["Arguments (pass arguments as '<name>:=<value>'):"]
    for argument in arguments:
        lines += ["", f"    '{argument.name}':"]
        about = argument.description or "no description given"
        if argument.choices:
            about += f". Valid choices are: {argument.choices}"
        lines.append(f"        {about}")
        if argument.default is not None:
            lines.append(f"        (default: '{argument.default}')")
    return "\n".join(lines)


@contextlib.contextmanager
def _log_file() -> Iterator[TextIO | None]:
    """Opens a file for the output of one launch, in the folder that ROS uses.

    Yields:
        The file; None where it cannot be made.
    """
    name = f"{time.strftime('%Y-%m-%d-%H-%M-%S')}-{socket.gethostname()}-{os.getpid()}"
    home = os.environ.get("ROS_HOME") or "~/.ros"
    folder = Path(os.environ.get("ROS_LOG_DIR") or Path(home, "log"), name)
    try:
        folder = folder.expanduser()
        folder.mkdir(parents=True, exist_ok=True)
        # Names of files may hold bytes that are no text.
        log = (folder / "launch.log").open("w", encoding="utf-8", errors="backslashreplace")
    except (OSError, RuntimeError) as error:  # the second where there is no home directory
        print(
            f"[WARNING] [launch]: No log is written, because {folder} cannot be made"
            f" ({getattr(error, 'strerror', None) or error}); ROS_LOG_DIR names another folder",
            flush=True,
        )
        yield None
        return
    with log:
        print(f"[INFO] [launch]: All log files can be found below {folder}", flush=True)
        yield log
