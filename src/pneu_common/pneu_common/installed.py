# SPDX-License-Identifier: Apache-2.0
"""The installation: its version, and the folder of files that are not Python.

A checkout holds the interface definitions (`msgs`), the bring-up (`ros_ws`), the rigs and the
recordings beside `src`. A wheel installs the same tree below `share/pneu` of its environment, where
nothing else writes: a separately built `pneu_msgs` owns `share/pneu_msgs`.
"""

import functools
import importlib.metadata
import sysconfig
from collections.abc import Iterator
from pathlib import Path

_LANDMARK = Path("msgs", "package.xml")


def version() -> str:
    """Return the version of the installed distribution; "(not installed)" where there is none."""
    for distribution in ("pneu", "pneu_sim"):  # installed by pip, or by colcon
        try:
            return importlib.metadata.version(distribution)
        except importlib.metadata.PackageNotFoundError:
            continue
    return "(not installed)"


@functools.cache
def own_tree() -> Path | None:
    """Return the top of the checkout, or the folder `share/pneu` of an installed wheel.

    None where this installation brought neither, as one by colcon does, whose packages lie below
    the prefixes of `AMENT_PREFIX_PATH`.
    """
    return next((folder for folder in _candidates() if (folder / _LANDMARK).is_file()), None)


def _candidates() -> Iterator[Path]:
    here = Path(__file__).resolve()
    if here.parents[2].name == "src":
        yield here.parents[3]  # <checkout>/src/pneu_common/pneu_common/installed.py
    try:
        files = importlib.metadata.files("pneu") or []
    except importlib.metadata.PackageNotFoundError:
        files = []
    for file in files:
        if file.parts[-4:] == ("share", "pneu", *_LANDMARK.parts):
            yield Path(str(file.locate())).resolve().parents[1]
    # `pip install --target` keeps `share` beside the packages, and records another place.
    for prefix in (sysconfig.get_path("data"), here.parents[1]):
        yield Path(prefix, "share", "pneu")
