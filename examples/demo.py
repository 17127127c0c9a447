# SPDX-License-Identifier: Apache-2.0
"""The whole story on a bag that comes with the repository: compare, name what is missing, add it.

The rig was calibrated on a recording without a fault (``rigs/rig_a_fitted.yaml``). The bag below
was recorded later, with a fault that the program is not told.
"""

import os
import shutil
import sys
import time
from pathlib import Path

from rich.console import Console

from pneu_common.cli import build_app, show_log

ROOT = Path(__file__).resolve().parent.parent
HEALTHY = "data/bags/a_healthy_2"
BAG = "data/bags/a_leak"
OUT = "out/demo"

STORY: tuple[tuple[str, list[str]], ...] = (
    (
        "First a recording that was not used for the calibration: how good are the models?",
        [
            "compare",
            HEALTHY,
            "--rig",
            "rigs/rig_a_fitted.yaml",
            "--rig",
            "rigs/rig_a_thin_plate.yaml",
            "--no-refine",
        ],
    ),
    (
        "Now a recording with a fault that the model does not know. Where does it fail?",
        [
            "compare",
            BAG,
            "--rig",
            "rigs/rig_a_fitted.yaml",
            "--rig",
            "rigs/rig_a_thin_plate.yaml",
            "--report",
            f"{OUT}/compare.html",
        ],
    ),
    (
        "Which physical effect is missing, and where? Add it and watch the error fall.",
        ["learn", BAG, "--rig", "rigs/rig_a_fitted.yaml", "-o", OUT],
    ),
)


def main() -> int:
    """Runs the story; returns the exit status."""
    os.chdir(ROOT)
    console = Console(width=140) if not sys.stdout.isatty() else Console()
    shutil.rmtree(ROOT / OUT, ignore_errors=True)  # of an earlier run
    (ROOT / OUT).mkdir(parents=True)
    started = time.monotonic()
    show_log()
    app = build_app()
    for text, arguments in STORY:
        console.rule()
        console.print(f"[bold]{text}[/bold]")
        console.print(f"$ pneu {' '.join(arguments)}", style="cyan")
        try:
            app(arguments, standalone_mode=True)
        except SystemExit as status:
            if status.code:
                return int(status.code)
    console.rule()
    console.print(
        f"The report: {ROOT / OUT / 'report.html'}   ({time.monotonic() - started:.0f} s)"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
