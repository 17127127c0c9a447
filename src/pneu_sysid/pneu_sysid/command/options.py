# SPDX-License-Identifier: Apache-2.0
"""Options that several commands on recordings share."""

from pathlib import Path
from typing import Annotated

import typer

BagPaths = Annotated[
    list[Path],
    typer.Argument(
        metavar="BAG...", help="rosbag2 folders, .mcap files, or text recordings, of one rig."
    ),
]
RigPath = Annotated[Path, typer.Option("--rig", help="Rig file, or scene file (YAML).")]
JsonPath = Annotated[Path | None, typer.Option("--json", help="Write the result as JSON.")]
HtmlPath = Annotated[Path | None, typer.Option("--report", help="Write an HTML report.")]
EffectsPath = Annotated[
    Path | None, typer.Option("--effects", help="Python file with effects of your own.")
]
KeptAside = Annotated[
    list[str] | None,
    typer.Option(
        "--aside",
        metavar="FROM:TO",
        help="Part of the recordings, s, that is kept aside for judging; every third stretch"
        " unless given. May be given several times.",
    ),
]
Workers = Annotated[
    int | None, typer.Option("--workers", help="Threads; all cores by default.", min=1)
]
