# SPDX-License-Identifier: Apache-2.0
"""Running an executable of a package in this process: `python -m pneu_graph.tools.run PKG EXEC`.

Where real rclpy can be imported it is used; the embedded one stands behind it.
"""

import runpy
import signal
import sys
from pathlib import Path

if __name__ == "__main__" and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    # An interrupt while modules are imported ends the process at once. As an exception it can come
    # up inside the machinery of imports, which drops it, and the node would start nevertheless.
    signal.signal(signal.SIGINT, signal.SIG_DFL)

from pneu_common import process
from pneu_common.errors import InputError
from pneu_graph.tools import executables
from pneu_runtime import hook


def run_executable(package: str, name: str, arguments: list[str]) -> None:
    """Runs an executable until it ends.

    Args:
        package: Such as ``pneu_sim``.
        name: Such as ``simulator``.
        arguments: Command line, with `--ros-args`.

    Raises:
        InputError: There is no such executable.
    """
    process.restore_signals()  # from here on rclpy and the node handle them
    hook.install()
    main = executables.load(package, name)
    sys.argv = [name, *arguments]
    _raise_interrupts()
    main(None)


def run_script(path: Path, arguments: list[str]) -> None:
    """Runs a Python script that uses rclpy.

    Args:
        path: The script.
        arguments: Command line, with `--ros-args`.
    """
    process.restore_signals()
    hook.install()
    _raise_interrupts()
    sys.argv = [str(path), *arguments]
    sys.path.insert(0, str(path.absolute().parent))
    runpy.run_path(str(path), run_name="__main__")


def _raise_interrupts() -> None:
    """Has SIGINT raise an exception, as Python does, unless it is ignored."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def main() -> None:
    """Runs what the command line names and reports bad input in one line."""
    process.represent_all_characters()
    if len(sys.argv) < 3:
        sys.exit("usage: python -m pneu_graph.tools.run PACKAGE EXECUTABLE [ARGUMENTS]")
    try:
        run_executable(sys.argv[1], sys.argv[2], sys.argv[3:])
    except InputError as error:
        print(f"{sys.argv[0]}: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(process.INTERRUPTED)


if __name__ == "__main__":
    main()
