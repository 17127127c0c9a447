# SPDX-License-Identifier: Apache-2.0
"""Subcommands of `pneu` on the ROS graph: run, launch, topic, node, param, service, action, bag."""

import os
from pathlib import Path
from typing import Annotated

import typer

from pneu_graph.tools import action, bag, interface, lifecycle, node, param, service, topic

GROUPS = {
    "action": action.app,
    "bag": bag.app,
    "interface": interface.app,
    "lifecycle": lifecycle.app,
    "node": node.app,
    "param": param.app,
    "service": service.app,
    "topic": topic.app,
}

PASS_ON = {"ignore_unknown_options": True, "allow_interspersed_args": False}


def register(app: typer.Typer) -> None:
    """Adds the subcommands.

    Args:
        app: The `pneu` command.
    """
    app.command("run", context_settings=PASS_ON)(run)
    app.command("launch")(launch)
    for name, group in GROUPS.items():
        app.add_typer(group, name=name)


def run(
    words: Annotated[
        list[str],
        typer.Argument(
            metavar="PACKAGE EXECUTABLE | SCRIPT.py [ARGUMENTS]",
            help="What to run, and its arguments such as --ros-args -p name:=value.",
        ),
    ],
) -> None:
    """Runs a node: an executable of a package, or a Python script that uses rclpy."""
    from pneu_common.errors import InputError
    from pneu_graph.tools.run import run_executable, run_script

    script = Path(words[0])
    if script.suffix == ".py" or os.sep in words[0]:
        if not script.is_file():
            raise InputError(f"{script}: no such script")
        run_script(script, words[1:])
        return
    if len(words) < 2:
        raise InputError(f"run {words[0]}: the executable is missing; run takes PACKAGE EXECUTABLE")
    run_executable(words[0], words[1], words[2:])


def launch(
    words: Annotated[
        list[str],
        typer.Argument(
            metavar="PACKAGE FILE | PATH [NAME:=VALUE]...",
            help="The launch file, then values of its arguments.",
        ),
    ],
    show_args: Annotated[
        bool, typer.Option("--show-args", "-s", help="Show the arguments of the file only.")
    ] = False,
    print_only: Annotated[
        bool, typer.Option("--print", "-p", help="Show the processes only.")
    ] = False,
) -> None:
    """Runs a launch file in the YAML format of `ros2 launch`."""
    from pneu_graph.tools.launch_command import launch as launch_file

    status = launch_file(words, show_args, print_only)
    if status:
        raise typer.Exit(status)
