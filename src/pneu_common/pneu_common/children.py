# SPDX-License-Identifier: Apache-2.0
"""Child processes and imports that run nothing but what is installed.

Python looks for modules in the working folder first where it is started with ``-m``. Recordings and
rigs that somebody received lie there, and a file of theirs may be called ``numpy.py``.
"""

import importlib.machinery
import os
import sys
from pathlib import Path

PATHS = "PYTHONPATH"


def python(module: str, *words: str) -> list[str]:
    """Return the command line that runs a module, not looked for in the working folder.

    Args:
        module: Its name.
        *words: Its arguments.
    """
    return [sys.executable, "-P", "-m", module, *words]


def keep_to_installed() -> None:
    """Take places relative to the working folder, and empty ones, out of ``PYTHONPATH``."""
    if given := os.environ.get(PATHS):
        kept = [path for path in given.split(os.pathsep) if os.path.isabs(path)]
        os.environ[PATHS] = os.pathsep.join(kept)


def has_interfaces(package: str, kind: str) -> bool:
    """Return whether an installed package looks like one of messages, without importing it.

    A type's name comes from recordings, the graph and rig files, and an import runs code.

    Args:
        package: Such as ``sensor_msgs``.
        kind: ``msg``, ``srv`` or ``action``.
    """
    if package in sys.modules and f"{package}.{kind}" in sys.modules:
        return True
    for finder in sys.meta_path:
        spec = finder.find_spec(package, None, None)
        if spec is None:
            continue
        if type(finder).__module__ == "pneu_runtime.hook":  # which gives interfaces alone
            return True
        places = spec.submodule_search_locations or []
        endings = importlib.machinery.all_suffixes()
        return any(
            (Path(place) / kind / f"__init__{ending}").is_file()
            for place in places
            for ending in endings
        )
    return False
