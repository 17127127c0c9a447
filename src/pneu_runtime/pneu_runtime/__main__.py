# SPDX-License-Identifier: Apache-2.0
"""Runs a program that uses rclpy: `python -m pneu_runtime script.py ARGS` or `-m module ARGS`."""

import runpy
import sys
from pathlib import Path

from pneu_common.errors import InputError
from pneu_runtime import hook

_USAGE = """\
usage: python -m pneu_runtime SCRIPT.py [ARGUMENT ...]
       python -m pneu_runtime -m MODULE [ARGUMENT ...]

Runs a Python program that imports rclpy and ROS 2 messages; on the embedded
runtime where ROS 2 is not installed."""


def main(arguments: list[str] | None = None) -> int:
    """Runs a script or a module as Python itself would.

    Args:
        arguments: Script or module, then its own arguments; those of the process where None.

    Returns:
        int: 2 where there is nothing to run, else 0; a program that exits does so itself.
    """
    given = sys.argv[1:] if arguments is None else arguments
    if given[:1] in (["-h"], ["--help"]):
        print(_USAGE)
        return 0
    is_module = given[:1] == ["-m"]
    words = given[1:] if is_module else given
    if not words:
        print(_USAGE, file=sys.stderr)
        return 2
    target = words[0]
    if not is_module and not Path(target).is_file():
        print(f"{target}: there is no such script.", file=sys.stderr)
        return 2
    try:
        hook.install()
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    sys.argv = words
    if is_module:
        sys.path[0] = ""
        runpy.run_module(target, run_name="__main__", alter_sys=True)
    else:
        sys.path[0] = str(Path(target).resolve().parent)
        runpy.run_path(target, run_name="__main__")
    return 0


if __name__ == "__main__":
    sys.exit(main())
