# SPDX-License-Identifier: Apache-2.0
"""`pneu tune-joint`: gains of a PID (eq. 9.2) or a computed torque of a joint, in simulation."""

import math
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from pneu_common.documents import read_yaml
from pneu_common.errors import InputError
from pneu_common.options import Force
from pneu_common.outputs import check_output
from pneu_common.progress import progress


def register_tune_joint(app: typer.Typer) -> None:
    """Adds this subcommand to the `pneu` application.

    Args:
        app: The application.
    """
    app.command("tune-joint")(tune)


def tune(
    settings: Annotated[
        Path, typer.Argument(metavar="SETTINGS", help="What is tuned, and on what (YAML).")
    ],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="File for the controller (.yaml).", show_default=False),
    ],
    force: Force = False,
) -> None:
    """Tune a controller of a joint on simulated robots: same seed, same gains."""
    from pneu_policy.control.robot_controllers import save_robot_controller
    from pneu_policy.tune.joint_gains import JointTuneSettings, tune_joint

    if output.suffix not in (".yaml", ".yml"):
        raise InputError(f"{output}: a controller is written as .yaml")
    check_output(output, force)
    document = read_yaml(settings, "settings file")
    if not isinstance(document, dict):
        raise InputError(f"{settings}: settings are a mapping, found {type(document).__name__}")
    try:
        asked = JointTuneSettings(**document)
    except InputError as error:
        raise InputError(f"{settings}: {error}") from None
    with progress(f"tuning {asked.kind}") as tell:

        def after(generation: int, rmse: float) -> None:
            tell(f"tuning {asked.kind}", generation / asked.generations, f"rmse {rmse:.4g}")

        found = tune_joint(asked, after)
    save_robot_controller(found.controller, output, found.provenance())
    gains = ", ".join(f"{k} {v:g}" for k, v in vars(found.controller.gains[0]).items())
    Console().print(
        f"{output.name}: {gains}; {found.rmse:.4g} rad or m"
        f" ({math.degrees(found.rmse):.2f} degrees) off its targets on the model"
    )
