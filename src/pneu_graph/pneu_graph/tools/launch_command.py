# SPDX-License-Identifier: Apache-2.0
"""`pneu launch`: from the words of the command line to running processes."""

import os
import shlex
import socket
import tempfile
import time
from pathlib import Path

from pneu_common.errors import InputError
from pneu_graph.launch.plan import Argument, Plan, declared_arguments
from pneu_graph.launch.supervisor import Supervisor


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
        plan = Plan(path, arguments, dict(os.environ), Path(scratch), logged.append)
        if print_only:
            for spec in plan.processes:
                print(f"[{spec.label}] {shlex.join(spec.command)}")
            return 0
        folder = _log_folder()
        with (folder / "launch.log").open("w", encoding="utf-8") as log:
            supervisor = Supervisor(plan.processes, log=log)
            print(f"[INFO] [launch]: All log files can be found below {folder}", flush=True)
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
    from pneu_runtime import hook

    hook.install()
    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

    try:
        share = Path(get_package_share_directory(package))
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


def _log_folder() -> Path:
    """Folder for the output of one launch, where ROS would put it."""
    home = os.environ.get("ROS_HOME") or str(Path.home() / ".ros")
    root = Path(os.environ.get("ROS_LOG_DIR") or Path(home, "log"))
    name = f"{time.strftime('%Y-%m-%d-%H-%M-%S')}-{socket.gethostname()}-{os.getpid()}"
    folder = root / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be made ({error.strerror}); ROS_LOG_DIR names another place"
        ) from None
    return folder
